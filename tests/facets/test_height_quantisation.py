"""Quantised heights: the step is found after any levelling, and the density is that of the surface, not of the steps."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from scipy.ndimage import gaussian_filter

from brdfpipe import facets, surfaces, vocabulary
from brdfpipe.facets import height_quantisation
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity

SIGMA = 0.2
SLOPES = SIGMA * np.array([0.0, 0.5, 1.0, 1.5, 2.0])
EXACT = np.exp(-(SLOPES**2) / (2 * SIGMA**2)) / (2 * np.pi * SIGMA**2)


@pytest.fixture(scope="module")
def smooth():
    return samples.gaussian_surface(512, sigma=SIGMA, correlation=5)


def rounded(scan, step):
    return scan.assign(height=np.round(scan["height"] / step) * step)


def step_of(scan):
    return height_quantisation.height_step(scan["height"].values, (scan.attrs["pitch_x"], scan.attrs["pitch_y"]))


@pytest.mark.parametrize("share", [0.03, 0.15, 0.5, 1.0])
def test_the_step_is_found_on_a_tilt_and_under_a_levelled_form(smooth, share):
    step = share * SIGMA
    tilted = smooth.assign(
        height=smooth["height"] + 0.0137 * smooth["x"] + 0.0071 * smooth["y"] + 2e-5 * smooth["x"] ** 2
    )
    for form in ("plane", "polynomial-2"):
        assert step_of(surfaces.level(rounded(tilted, step), form)) == pytest.approx(step, rel=1e-3)


def test_the_step_is_found_in_heights_rounded_a_second_time_in_print(smooth):
    printed = smooth.assign(height=np.round(rounded(smooth, 0.0371)["height"], 4))
    assert step_of(printed) == pytest.approx(0.0371, rel=1e-3)


def test_the_step_is_found_beside_missing_heights_and_a_plateau(smooth):
    height = rounded(smooth, 0.03)["height"].values
    height[np.random.default_rng(1).random(height.shape) < 0.05] = np.nan
    height[:300] = 0
    assert step_of(samples.surface(height)) == pytest.approx(0.03, rel=1e-3)


@pytest.mark.parametrize(
    "change",
    [
        lambda height: height,
        lambda height: height.astype(np.float32),
        lambda height: np.round(height, 4),  # too fine to matter
        lambda height: np.where(height > 0, 0.5, 0.0),  # two plateaus: the shape of the surface
        lambda height: np.where(height > 0, height, 0.0),
        lambda height: np.full_like(height, np.nan),
    ],
)
def test_heights_that_are_not_quantised_have_no_step(smooth, change):
    assert step_of(smooth.assign(height=(("y", "x"), change(smooth["height"].values)))) == 0


def test_the_dither_of_a_height_does_not_depend_on_its_block():
    whole = height_quantisation.dither(slice(0, 300), slice(0, 200))
    assert np.array_equal(whole[40:60, 7:90], height_quantisation.dither(slice(40, 60), slice(7, 90)))


def test_the_dither_is_uniform_and_its_differences_are_triangular():
    values = height_quantisation.dither(slice(0, 1000), slice(0, 1000))
    assert -0.5 <= values.min() < -0.4999
    assert 0.4999 < values.max() < 0.5
    # A million values: 0.3 % is three standard deviations or more of each.
    assert values.var() == pytest.approx(1 / 12, rel=3e-3)
    for axis in (0, 1):
        difference = np.diff(values, axis=axis)
        assert difference.var() == pytest.approx(1 / 6, rel=3e-3)
        assert np.mean(np.abs(difference) < 0.5) == pytest.approx(0.75, rel=3e-3)


@pytest.mark.parametrize("share", [0.05, 0.15, 0.25, 0.5])
def test_the_density_of_rounded_heights_is_that_of_the_surface(smooth, share):
    table = facets.estimate(rounded(smooth, share * SIGMA), isotropic=True)
    assert float(table["slope_rms"]) == pytest.approx(float(facets.estimate(smooth)["slope_rms"]), rel=1e-3)
    # The map's own scatter is 2 to 6 %; without the spreading the middle is off by factors of 2 to 7.
    assert RadialDensity.of(table)(SLOPES**2) == pytest.approx(EXACT, rel=0.1)


@pytest.mark.parametrize("share", [0.05, 0.25, 0.5])
def test_the_density_of_rounded_heights_with_a_lay_is_that_of_the_surface(smooth, share):
    density = PlanarDensity.of(facets.estimate(rounded(smooth, share * SIGMA), isotropic=False))
    turned = np.stack([density(SLOPES * np.cos(a), SLOPES * np.sin(a)) for a in np.radians(np.arange(0, 360, 45))])
    # Eight azimuths together scatter hardly more than a ring.
    assert turned.mean(axis=0) == pytest.approx(EXACT, rel=0.12)


@pytest.mark.parametrize("isotropic", [True, False])
def test_a_sharp_peak_and_a_heavy_tail_are_recovered_from_quantised_heights(isotropic):
    # Amplitudes that vary from place to place: the slopes have a kurtosis of some 20, and half of them lie below a third of their rms.
    amplitude = np.exp(4 * samples.gaussian_surface(512, correlation=20, sigma=0.014)["height"].values)
    height = samples.gaussian_surface(512, correlation=5, seed=2)["height"].values * amplitude
    height *= SIGMA / np.diff(height, axis=1).std()
    exact, coarse = (
        facets.estimate(samples.surface(values), isotropic=isotropic)
        for values in (height, np.round(height / (0.4 * SIGMA)) * (0.4 * SIGMA))
    )
    slope = SIGMA * np.array([0, 0.5, 1, 2, 4])
    if isotropic:
        one, two = (RadialDensity.of(table)(slope**2) for table in (exact, coarse))
    else:
        turn = np.radians(np.arange(0, 360, 45))[:, None]
        one, two = (
            PlanarDensity.of(table)(slope * np.cos(turn), slope * np.sin(turn)).mean(axis=0)
            for table in (exact, coarse)
        )
    # Narrowed alike everywhere, as a Gaussian is, the density is off by 26 % at the peak and 15 % beside it.
    assert two[..., 0] == pytest.approx(one[..., 0], rel=0.2)
    assert two[..., 1:] == pytest.approx(one[..., 1:], rel=0.1)


def test_a_lay_is_detected_with_height_steps_as_large_as_the_slopes_along_it(smooth):
    stretched = smooth.assign_attrs(pitch_y=4.0)
    exact, coarse = (facets.estimate(scan) for scan in (stretched, rounded(stretched, 0.5 * SIGMA)))
    assert float(coarse["anisotropy"]) == pytest.approx(float(exact["anisotropy"]), rel=5e-3)
    assert float(coarse["lay"]) % 180 == pytest.approx(float(exact["lay"]) % 180, abs=0.5)


def test_a_skew_stays_along_its_axis_if_the_steps_widen_that_axis_more(smooth):
    # About as rough along x as along y, where the steps make smaller slopes: what is seen is roughest along x.
    size = smooth.sizes["x"]
    teeth = np.cumsum(np.where(np.random.default_rng(3).random((size, size)) < 0.2, 0.4, -0.1), axis=1)
    teeth = gaussian_filter(teeth - teeth[:, -1:] * np.arange(size) / (size - 1), (3, 0))
    height = teeth * SIGMA / np.diff(teeth, axis=1).std() + 0.2 * smooth["height"].values
    pitch = 1.02 * np.diff(height, axis=0).std() / np.diff(height, axis=1).std()
    skew = []
    for values in (height, np.round(height / 0.05) * 0.05):
        table = facets.estimate(samples.surface(values, pitch=(1.0, pitch)), isotropic=False)
        assert float(table["lay"]) % 180 == pytest.approx(88, abs=1)
        p, q, weight = PlanarDensity.of(table).rule()
        skew.append([np.sum(weight * slope**3) / np.sum(weight * slope**2) ** 1.5 for slope in (p, q)])
    assert skew[0][0] > 0.3
    # Spread over steps of a quarter of the slope rms, 3 % of the mean square, it is 1.03^(3/2) times smaller.
    assert skew[1] == pytest.approx(skew[0], rel=0.05, abs=0.01)


def test_gaps_and_a_tilt_do_not_change_the_quantum(smooth):
    height = (rounded(smooth, 0.05)["height"] + 0.3 * smooth["x"]).values
    height[np.random.default_rng(1).random(height.shape) < 0.02] = np.nan
    density = RadialDensity.of(facets.estimate(samples.surface(height), isotropic=True))
    assert density(SLOPES**2) == pytest.approx(EXACT, rel=0.1)


def test_the_step_is_recorded_and_a_coarse_one_causes_a_warning(smooth):
    fine, coarse = (facets.estimate(rounded(smooth, share * SIGMA), isotropic=True) for share in (0.2, 0.6))
    assert "steps of 40 nm" in fine.attrs["history"]
    assert not vocabulary.warnings(fine)
    assert any("120 nm" in text and "surface.lambda_s" in text for text in vocabulary.warnings(coarse))
    assert "steps" not in facets.estimate(smooth).attrs.get("history", "")


@pytest.mark.parametrize("name", ["plu-1.plu", "al3d-1.al3d"])
def test_the_density_of_a_real_scan_in_steps_is_smooth(shared_data, name):
    scan = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / name))
    radial, planar = (facets.estimate(scan, isotropic=isotropic) for isotropic in (True, False))
    # Counted as they are, neighbours differ by factors of 5 and 200.
    assert np.abs(np.diff(np.log(radial["slope_density"].values[:16]))).max() < 0.3
    middle, log_density = planar.sizes["slope_along"] // 2, np.log(planar["slope_density"].values)
    for profile in (log_density[middle, middle:], log_density[middle:, middle]):
        assert np.abs(np.diff(profile[:21])).max() < 1.5
        assert np.diff(profile[:21]).max() < 0.1

"""Height noise of a known rms is taken out of the slopes: gloss is that of the surface without noise."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from random_surfaces import gaussian, gaussian_line, heights

from brdfpipe import appearance, facets, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.facets.noise_removal import without_noise
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.slope_histogram import density_from_histogram, merge_bins
from brdfpipe.psd.k_correlation import PsdError

CORRELATION, SLOPE = 12.0, 0.05
SIGMA = SLOPE * CORRELATION / np.sqrt(2)


def gloss(found) -> np.ndarray:
    return np.asarray(appearance.gloss(microfacet.build(found, index=1.5, multiple_scattering="none"), [20, 60]))


def noisy(clean, share, seed=99):
    return clean + np.random.default_rng(seed).normal(scale=share * SIGMA, size=clean.shape)


@pytest.fixture(scope="module")
def clean():
    return heights(gaussian(SIGMA, CORRELATION), (512, 512), (1.0, 1.0), 1)


@pytest.fixture(scope="module")
def clean_gloss(clean):
    return gloss(facets.estimate(samples.surface(clean), isotropic=True, noise=0.0))


@pytest.mark.parametrize("share", [0.065, 0.2])
def test_gloss_under_noise_is_that_without(clean, clean_gloss, share: float) -> None:
    surface = samples.surface(noisy(clean, share))
    with_noise = gloss(facets.estimate(surface, isotropic=True, noise=0.0))
    found = facets.estimate(surface, isotropic=True)
    # Noise of 6.5 % of Sq takes a third of the gloss at 20°; of 20 % five sixths.
    assert with_noise[0] < 0.75 * clean_gloss[0]
    # Gloss at 20° goes as the density of level facets, and at 60° nearly so.
    relative_u = float((found["D_u"] / found["D"])[0])
    assert relative_u < 0.35
    np.testing.assert_allclose(gloss(found), clean_gloss, rtol=2 * relative_u)
    np.testing.assert_allclose(gloss(found), clean_gloss, rtol=0.05 if share < 0.1 else 0.15)
    assert float(found["noise_sigma"]) == pytest.approx(share * SIGMA, rel=0.02)
    assert float(found["noise_ratio"]) < 1.1
    assert "of the mean square slope, was subtracted" in found.attrs["history"]


def test_a_slope_rms_that_hangs_on_the_noise_is_reported(clean) -> None:
    found = facets.estimate(samples.surface(noisy(clean, 0.2)), isotropic=True)
    (warning,) = vocabulary.warnings(found)
    # 85 % of the mean square is noise, known to 3 %.
    assert "85% of the mean square slope" in warning
    assert "the slope rms is uncertain by 9%" in warning or "the slope rms is uncertain by 10%" in warning


def test_a_given_noise_is_as_uncertain_as_it_says(clean) -> None:
    noise, u = 0.1 * SIGMA, 0.01 * SIGMA
    surface = samples.surface(noisy(clean, 0.1)[:256, :256])
    found = facets.estimate(surface, isotropic=True, noise=noise, noise_uncertainty=u)
    assert (float(found["noise_sigma"]), float(found["noise_sigma_u"])) == (noise, u)
    given = RadialDensity.of(found)
    (change,) = found["slope_density_change"].values[found["uncertainty_source"].values == "noise"]
    changed = RadialDensity(given.slope, given.density + change)
    means = [float(weight @ s**2) for s, weight in (given.rule(), changed.rule())]
    # 2σ²/d² along each axis; of the tail, which noise moves too, only the length is fixed.
    assert means[1] - means[0] == pytest.approx(-8 * noise * u, rel=0.2)
    exact = facets.estimate(surface, isotropic=True, noise=noise)
    assert set(exact["uncertainty_source"].values) == {"facets"}
    assert "(uncertainty not stated)" in exact.attrs["history"]
    assert float(exact["slope_rms"]) == float(found["slope_rms"])


@pytest.mark.parametrize(
    ("noise", "u", "message"),
    [
        (0.02, 0.03, "30 nm was given for a height noise of 20 nm; accepted: 0 to the noise"),
        (None, 0.01, "without the noise"),
    ],
)
def test_an_impossible_uncertainty_of_noise_is_refused(clean, noise, u, message) -> None:
    with pytest.raises(PsdError, match=message):
        facets.estimate(samples.surface(clean[:64, :64]), noise=noise, noise_uncertainty=u)


def test_noise_is_removed_under_a_lay_too() -> None:
    stretched = heights(gaussian(SIGMA, CORRELATION), (512, 512), (1.0, 1.0), 1)
    clean, dirty = (samples.surface(height, (2.0, 1.0)) for height in (stretched, noisy(stretched, 0.065)))
    reference = facets.estimate(clean, isotropic=False, noise=0.0)
    found = facets.estimate(dirty, isotropic=False)
    assert float(found["anisotropy"]) == pytest.approx(float(reference["anisotropy"]), rel=0.02)
    assert float(found["slope_density"].max()) == pytest.approx(float(reference["slope_density"].max()), rel=0.1)


@pytest.mark.parametrize("method", ["mixture", "abel"])
def test_noise_is_removed_from_a_line(method: str) -> None:
    line = heights(gaussian_line(SIGMA, CORRELATION), (60_000,), (1.0,), 1)
    options = {"isotropic": True, "method": method}
    reference = facets.estimate(samples.surface(line), noise=0.0, **options)
    found = facets.estimate(samples.surface(noisy(line, 0.065)), **options)
    assert float(found["slope_rms"]) == pytest.approx(float(reference["slope_rms"]), rel=0.02)
    assert float(found["slope_density"][0] / reference["slope_density"][0]) == pytest.approx(1, abs=0.15)
    assert float(found["noise_ratio"]) < 1.05


def test_a_surface_without_plateau_is_left_alone() -> None:
    surface = samples.gaussian_surface(256)
    first, second = facets.estimate(surface), facets.estimate(surface, noise=0.0)
    assert first.equals(second)
    assert "noise_sigma" not in first


_N = 400_000


def _slopes(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Slopes (2, n) of rms 0.05 along each axis, and their density at zero."""
    if kind == "gaussian":
        return SLOPE * rng.standard_normal((2, _N)), 1 / (2 * np.pi * SLOPE**2)
    if kind == "two widths":
        narrow, wide = np.array([0.6, np.sqrt(2 - 0.36)]) * SLOPE
        width = np.where(rng.random(_N) < 0.5, narrow, wide)
        return width * rng.standard_normal((2, _N)), (1 / narrow**2 + 1 / wide**2) / (4 * np.pi)
    radius, turn = 2 * SLOPE * np.sqrt(rng.random(_N)), 2 * np.pi * rng.random(_N)
    return radius * np.array([np.cos(turn), np.sin(turn)]), 1 / (np.pi * 4 * SLOPE**2)


@pytest.mark.parametrize(
    ("kind", "share", "tolerance"),
    [("gaussian", 0.375, 0.1), ("gaussian", 0.8, 0.15), ("two widths", 0.375, 0.1), ("disc", 0.375, 0.35)],
)
def test_the_density_without_noise_comes_back(kind: str, share: float, tolerance: float) -> None:
    """The peak; a disc of even density, the shape farthest from a Gaussian, keeps what the counts do not tell."""
    rng = np.random.default_rng(5)
    slopes, peak = _slopes(kind, rng)
    mean_square = SLOPE**2 * share / (1 - share)
    z = rng.standard_normal((3, _N))
    # Two edges of a triangle share a height.
    observed = slopes + np.sqrt(mean_square / 2) * np.array([z[0] - z[1], z[2] - z[1]])
    bins = merge_bins(samples.histogram_of_slopes(np.split(np.hypot(*observed), 64), SLOPE))
    density = density_from_histogram(without_noise(bins, mean_square, (1.0, 1.0)))[0]
    near = np.linspace(0, 0.3 * SLOPE, 20)
    weight = near / near.sum()
    expected = peak if kind == "disc" else peak * 0.98
    assert float(density(near**2) @ weight) == pytest.approx(expected, rel=tolerance)
    s, ds = density.rule()
    assert float(np.sqrt(ds @ s**2 / 2)) == pytest.approx(SLOPE, rel=0.02)

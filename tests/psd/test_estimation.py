"""The roughness spectrum of synthetic heights is the one they were made of."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from numpy.typing import ArrayLike
from random_surfaces import gaussian, gaussian_line, heights

from brdfpipe import vocabulary
from brdfpipe.psd import PsdError, estimate
from brdfpipe.psd.k_correlation import KCorrelation
from brdfpipe.psd.noise_floor import NoiseFloor
from brdfpipe.psd.periodograms import Scan, periodograms

EXPONENTIAL = KCorrelation(0.1, 5.0, 3.0)


def rms_z(z: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(z))))


@pytest.mark.parametrize(("shape", "pitch"), [((300, 400), (0.5, 0.7)), ((600, 1100), (0.5, 0.5))])
def test_the_spectrum_is_the_one_of_the_heights(shape: tuple[int, int], pitch: tuple[float, float]) -> None:
    # The second map is halved once. Rings are independent; over 35 of them an rms z of 1 scatters by 0.12.
    found = estimate(samples.surface(heights(EXPONENTIAL.areal, shape, pitch, 2), pitch[::-1]))
    vocabulary.validate(found, "psd")
    ratio = found["psd"].values / EXPONENTIAL.areal(found["frequency"].values)
    z = (ratio - 1) / (found["psd_uncertainty"] / found["psd"]).values
    assert 0.4 < rms_z(z) < 1.5
    # Beyond 40 waves across the scan the rings hold hundreds of modes.
    fine = found["frequency"].values > 40 / (shape[0] * pitch[0])
    np.testing.assert_allclose(ratio[fine], 1, atol=0.15)


def test_the_fit_finds_sigma_length_and_slope_within_their_uncertainty() -> None:
    z = []
    for seed in range(6):
        found = estimate(samples.surface(heights(EXPONENTIAL.areal, (256, 256), (1.0, 1.0), seed)))
        for name, true in EXPONENTIAL._asdict().items():
            z.append(float((found[f"fit_{name}"] - true) / found[f"fit_{name}_u"]))
        # Waves longer than the map are in neither.
        assert float(found["sigma"]) == pytest.approx(0.1, abs=4 * float(found["sigma_u"]) + 0.005)
    # 18 values, of which the parameters of one map are correlated.
    assert 0.4 < rms_z(z) < 1.6


def test_the_integral_of_the_spectrum_is_the_variance_of_the_heights() -> None:
    # Parseval: windowed patches of white noise; the band is a disc of the frequency plane.
    noise = np.random.default_rng(1).normal(scale=0.02, size=(512, 512))
    found = estimate(samples.surface(noise), noise=0.0)
    assert float(found["sigma"]) == pytest.approx(0.02 * np.sqrt(np.pi) * float(found["band_high"]), rel=0.01)
    np.testing.assert_allclose(found["psd"].values[14:], 4e-4, rtol=0.12)


def test_white_noise_on_a_gaussian_surface_is_found_and_subtracted() -> None:
    clean = heights(gaussian(0.1, 8.0), (400, 400), (1.0, 1.0), 3)
    noisy = clean + np.random.default_rng(4).normal(scale=0.01, size=clean.shape)
    found, reference = estimate(samples.surface(noisy)), estimate(samples.surface(clean), noise=0.0)
    assert float(found["noise_sigma"]) == pytest.approx(0.01, abs=3 * float(found["noise_sigma_u"]))
    assert float(found["noise_sigma_u"]) < 3e-4
    # Three uncertainties of the noise, a tenth of it, are 1e-5: there exp(−π²ℓ²f²) = 5e-6. A ring is 12 % wide.
    assert float(found["band_high"]) == pytest.approx(0.139, rel=0.12)
    assert float(found["sigma"]) == pytest.approx(float(reference["sigma"]), rel=5e-3)
    assert float(found["sigma_heights"]) == pytest.approx(float(reference["sigma_heights"]), rel=2e-3)
    assert "White noise of " in found.attrs["history"]
    given = estimate(samples.surface(noisy), noise=0.01)
    np.testing.assert_allclose(given["psd"].values[:10], found["psd"].values[:10], rtol=1e-3)


def test_a_surface_with_a_lay_has_a_spectrum_over_both_frequencies() -> None:
    # Grooves along x: lengths of 4 um across and 16 um along it, by stretching an isotropic map.
    grooves = samples.surface(heights(gaussian(0.1, 8.0), (400, 400), (1.0, 1.0), 3), (2.0, 0.5))
    found = vocabulary.validate(estimate(grooves, noise=0.0), "psd")
    planar = found["psd_planar"]
    fx, fy = found["frequency_x"].values, found["frequency_y"].values
    assert fx[fx.size // 2] == fy[fy.size // 2] == 0
    true = np.pi * 64 * 0.01 * np.exp(-(np.pi**2) * (256 * fx**2 + 16 * fy[:, None] ** 2))
    inside = true > 0.1 * true.max()
    # Cells of a few modes scatter by tens of per cent; their sums do not.
    assert float(planar.values[inside].sum() / true[inside].sum()) == pytest.approx(1, abs=0.15)
    variance = float(np.gradient(fy) @ planar.values @ np.gradient(fx))
    assert variance == pytest.approx(float(found["sigma"]) ** 2, rel=1e-3)
    isotropic = estimate(samples.surface(heights(gaussian(0.1, 8.0), (400, 400), (1.0, 1.0), 3)), noise=0.0)
    assert "psd_planar" not in isotropic


def test_the_spectrum_of_a_line_is_inverted_to_that_of_the_plane() -> None:
    line = heights(EXPONENTIAL.line, (60_000,), (0.5,), 5)
    found = vocabulary.validate(estimate(samples.surface(line, (0.5,))), "psd")
    z = (found["psd"].values - EXPONENTIAL.areal(found["frequency"].values)) / found["psd_uncertainty"].values
    assert 0.3 < rms_z(z) < 1.5
    assert set(found["psd_quality"].values) == {vocabulary.quality("measured"), vocabulary.quality("interpolated")}
    # The plateau has no slope to invert.
    assert found["psd_quality"].values[0] == vocabulary.quality("interpolated")
    assert abs(float((found["fit_sigma"] - 0.1) / found["fit_sigma_u"])) < 3
    assert "isotropic" in found.attrs["history"]


def test_noise_changes_the_spectrum_of_a_line_as_more_noise_would() -> None:
    height = heights(EXPONENTIAL.line, (20_000,), (0.5,), 5) + np.random.default_rng(2).normal(0, 0.004, 20_000)
    line = samples.surface(height, (0.5,))
    given, more = (estimate(line, noise=NoiseFloor(noise, 0.0002, "given")) for noise in (0.004, 0.0042))
    common = min(given.sizes["frequency"], more.sizes["frequency"]) - 2
    given, more = (psd.isel(frequency=slice(common)) for psd in (given, more))
    np.testing.assert_array_equal(given["frequency"], more["frequency"])
    change, expected = given["psd_noise_change"].values[0], (more["psd"] - given["psd"]).values
    alike = (given["psd_quality"] == more["psd_quality"]).values & (np.abs(expected) > 1e-3 * given["psd"].values)
    assert alike.sum() > 5
    # σ² changes by 2σu + u², 2.5 % more than linearly.
    np.testing.assert_allclose(change[alike], expected[alike], rtol=0.3)
    assert (given["psd_uncertainty"].values >= np.abs(change)).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_line_across_a_gaussian_surface_has_the_rms_height_of_its_heights(seed: int) -> None:
    line = heights(gaussian_line(0.05, 5.0), (8192,), (0.5,), seed)
    found = estimate(samples.surface(line, (0.5,)))
    # 800 lengths ℓ: the rms height of the line itself scatters by 1/√(2 · 800/1.25).
    assert float(found["sigma"]) == pytest.approx(0.05, rel=0.06)
    assert float(found["sigma"]) == pytest.approx(float(found["sigma_heights"]), rel=0.03)
    assert float(found["fit_length"]) == pytest.approx(5.0, rel=0.03)
    assert found["fit_slope"].isnull()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("step", [0.0, 1e-6, 1e-3])
def test_a_line_across_any_gaussian_surface_has_a_spectrum(step: float) -> None:
    """Smooth surfaces fall to the rounding of their heights, or to the leakage of the window, where nothing of the surface is left to invert."""
    rng = np.random.default_rng(round(1e6 * step))
    for seed in range(25):
        sigma, length, points = 10 ** rng.uniform(-2, 1), 10 ** rng.uniform(-0.5, 2), int(rng.choice([200, 1000, 4000]))
        pitch = length * 10 ** rng.uniform(-2.0, -0.3)
        line = heights(gaussian_line(sigma, length), (points,), (pitch,), seed)
        line = np.round(line / step) * step if step else line
        found = vocabulary.validate(estimate(samples.surface(line - line.mean(), (pitch,))), "psd")
        assert (found["psd"].values > 0).all()
        # Rings of few modes scatter, but not by two decades above the peak of the true spectrum.
        assert (found["psd"].values < 100 * np.pi * (length * sigma) ** 2).all()
        if pitch * points > 100 * length:
            # 100 lengths: the rms height itself scatters by 1/√(2 · 100/1.25) = 8 %.
            assert float(found["sigma"]) == pytest.approx(sigma, rel=0.3)


def test_roughness_below_a_smooth_waviness_is_inverted() -> None:
    # The waviness is fitted; the fine roughness has 1e-6 of the variance, and a line spectrum far above the fitted Gaussian.
    fine = KCorrelation(0.001, 1.0, 3.0)
    line = heights(gaussian_line(1.0, 15.0), (60_000,), (0.5,), 1) + heights(fine.line, (60_000,), (0.5,), 2)
    found = estimate(samples.surface(line, (0.5,)), noise=0.0).sel(frequency=slice(0.25, 0.7))
    assert found.sizes["frequency"] > 5
    z = (found["psd"] - fine.areal(found["frequency"].values)) / found["psd_uncertainty"]
    assert rms_z(z) < 2


def test_missing_heights_are_kept_out_of_the_patches() -> None:
    height = heights(EXPONENTIAL.areal, (512, 512), (0.5, 0.5), 6)
    whole = estimate(samples.surface(height, (0.5, 0.5)))
    height[100:110, 200:260] = np.nan
    gaps = estimate(samples.surface(height, (0.5, 0.5)))
    assert "8 of 9 patches" not in whole.attrs["history"]
    assert "of 9 patches" in gaps.attrs["history"]
    assert "600 missing heights were filled in" in gaps.attrs["history"]
    fine = slice(0.2, None)
    np.testing.assert_allclose(
        gaps["psd"].sel(frequency=fine).values, whole["psd"].sel(frequency=fine).values, rtol=0.1
    )


def test_a_scan_full_of_gaps_is_filled_with_a_warning() -> None:
    height = heights(gaussian(0.1, 20.0), (128, 128), (1.0, 1.0), 6)
    sigma = float(estimate(samples.surface(height), noise=0.0)["sigma"])
    height[np.random.default_rng(1).random(height.shape) < 0.02] = np.nan
    found = estimate(samples.surface(height), noise=0.0)
    assert "missing heights were filled in" in vocabulary.warnings(found)[0]
    assert float(found["sigma"]) == pytest.approx(sigma, rel=0.02)


def test_filters_bound_the_band() -> None:
    height = heights(EXPONENTIAL.areal, (256, 256), (1.0, 1.0), 1)
    filtered = samples.surface(height).assign_attrs(lambda_s=8.0, lambda_c=80.0)
    found = estimate(filtered)
    # The outer rings lie within the band, half of their width may not.
    assert 0.0125 <= float(found["frequency"][0]) < float(found["frequency"][-1]) <= 0.125


def test_long_waves_of_a_large_map_come_from_its_coarser_copies() -> None:
    scan = Scan(heights(EXPONENTIAL.areal, (1100, 1100), (0.5, 0.5), 1), (0.5, 0.5))
    levels, count = periodograms(scan)
    assert [level.spectra.shape[1] for level in levels] == [256, 256, 550]
    assert count.used == count.positions == 64
    # Each copy is used for longer waves than the one before it.
    assert [level.low for level in levels] == pytest.approx([8 / 128, 8 / 256, 2 / 550])


@pytest.mark.parametrize("noise", [-1e-3, 0.2])
def test_an_impossible_noise_is_refused(noise: float) -> None:
    height = heights(EXPONENTIAL.areal, (64, 64), (1.0, 1.0), 1)
    with pytest.raises(PsdError, match=r"height noise of .* nm was given; accepted: 0 to the rms"):
        estimate(samples.surface(height), noise=noise)


def test_a_noise_of_smoothed_heights_is_refused() -> None:
    smoothed = samples.surface(heights(EXPONENTIAL.areal, (64, 64), (1.0, 1.0), 1)).assign_attrs(lambda_s=8.0)
    with pytest.raises(PsdError, match=r"smoothed with λs = 8 um"):
        estimate(smoothed, noise=0.01)


@pytest.mark.slow
def test_sigma_length_and_slope_agree_over_many_seeds_and_forms() -> None:
    for slope in (2.5, 3.0, 4.0):
        model = KCorrelation(0.05, 6.0, slope)
        z = []
        for seed in range(30):
            found = estimate(samples.surface(heights(model.areal, (400, 300), (0.5, 0.5), seed), (0.5, 0.5)))
            z.append([float((found[f"fit_{k}"] - v) / found[f"fit_{k}_u"]) for k, v in model._asdict().items()])
        spread, mean = np.std(z, axis=0), np.mean(z, axis=0)
        assert (spread < 1.4).all(), (slope, spread)
        # A mean of 30 scatters by 0.18.
        assert (np.abs(mean) < 0.7).all(), (slope, mean)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (8, 8), (1, 64), (64, 1), (2,), (16,)])
def test_a_scan_too_small_for_a_spectrum_is_refused(shape: tuple[int, ...]) -> None:
    tiny = samples.surface(np.random.default_rng(0).normal(size=shape))
    with pytest.raises(PsdError, match="Measure a larger area"):
        estimate(tiny)


@pytest.mark.parametrize("shape", [(64, 64), (640,)])
def test_a_perfectly_flat_surface_has_no_spectrum(shape: tuple[int, ...]) -> None:
    with pytest.raises(PsdError, match="perfectly flat"):
        estimate(samples.surface(np.full(shape, 5.0)))

"""Waves longer than the band of a roughness spectrum, and the variance of scans with gaps."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples
from random_surfaces import gaussian, gaussian_line, heights

from brdfpipe.psd import estimate, join
from brdfpipe.psd.long_waves import long_waves
from brdfpipe.psd.periodograms import Scan


@pytest.mark.parametrize("pitch", [(0.5, 0.5), (0.25, 0.5)])
def test_a_wave_below_the_band_has_its_height_and_slope(pitch):
    y, x = (np.arange(256) * step for step in pitch)
    height = 0.3 * np.cos(2 * np.pi * x / 64)[None, :] + 0.02 * np.cos(2 * np.pi * y / 4)[:, None]
    found = long_waves(Scan(height, pitch), 1 / 16, 0.02 / np.sqrt(2), 0.0)
    assert float(found["long_sigma"]) == pytest.approx(0.3 / np.sqrt(2), rel=0.01)
    assert float(found["long_slope"]) == pytest.approx(0.3 / np.sqrt(2) * 2 * np.pi / 64, rel=0.02)


def test_a_parabola_has_its_height_and_slope():
    x = np.arange(128) - 63.5
    found = long_waves(Scan((x[:, None] ** 2 + x**2) / 1e4, (1.0, 1.0)), 0.5, 0.0, 0.0)
    # Of 2x/R over ±L/2: L²/3R² for both axes; heights scatter by L²/(R √(6 · 30)) along each.
    assert float(found["long_slope"]) == pytest.approx(128 / 1e4 * np.sqrt(2 / 3), rel=0.03)
    assert float(found["long_sigma"]) == pytest.approx(128**2 / 4e4 * np.sqrt(2 * 4 / 45), rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_band_and_long_waves_have_the_variance_of_the_heights(seed):
    coarse, fine = heights(gaussian(0.1, 20), (256, 256), (0.5, 0.5), seed), gaussian(0.02, 1)
    surface = samples.surface(coarse + heights(fine, (256, 256), (0.5, 0.5), seed + 9), (0.5, 0.5))
    found = estimate(surface)
    assert float(found["sigma"]) < 0.5 * float(found["sigma_heights"])
    assert np.hypot(found["sigma"], found["long_sigma"]) == pytest.approx(float(found["sigma_heights"]), rel=0.01)


def test_a_line_has_long_waves_too():
    line = heights(gaussian_line(0.3, 400.0), (4096,), (1.0,), 1) + heights(
        gaussian_line(0.02, 4.0), (4096,), (1.0,), 2
    )
    found = estimate(samples.surface(line))
    assert np.hypot(found["sigma"], found["long_sigma"]) == pytest.approx(float(found["sigma_heights"]), rel=0.02)
    # An isotropic Gaussian surface has √⟨p² + q²⟩ = 2σ/ℓ; the line holds about ten waves.
    assert float(found["long_slope"]) == pytest.approx(2 * 0.3 / 400, rel=0.3)


def test_joined_scans_keep_the_long_waves_of_the_one_that_reaches_lowest():
    wide = estimate(samples.surface(heights(gaussian(0.1, 40), (128, 128), (2.0, 2.0), 1), (2.0, 2.0)))
    fine = estimate(samples.surface(heights(gaussian(0.1, 40), (128, 128), (0.5, 0.5), 2), (0.5, 0.5)))
    assert float(join(fine, wide)["long_sigma"]) == float(wide["long_sigma"])


@pytest.mark.parametrize("gaps", ["a hole", "steep places", "specks"])
def test_gaps_keep_the_variance_of_the_heights(gaps):
    whole = relief_maps.gaussian(0.2, 256, 5)
    height, slope = whole.copy(), np.hypot(*np.gradient(whole))
    if gaps == "a hole":
        height[100:200, 50:180] = np.nan
    elif gaps == "steep places":
        height[slope > np.quantile(slope, 0.9)] = np.nan
    else:
        height[np.random.default_rng(1).random(height.shape) < 0.014] = np.nan
    found = estimate(samples.surface(height))
    assert np.hypot(found["sigma"], found["long_sigma"]) == pytest.approx(whole.std(), rel=0.05)

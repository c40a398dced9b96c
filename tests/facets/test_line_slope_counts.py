"""Counts of slopes along lines: each once, by stretch, and in whole multiples of the step of quantised heights."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, surfaces
from brdfpipe.facets.line_slope_counts import MIN_SLOPES, STRETCHES, LineSlopeCounts, count_slopes
from brdfpipe.surfaces.heights import LINE_MIN


def heights(points=40_000, sigma=0.1, seed=1):
    """Of slopes that are Gaussian and correlated over a few points."""
    slope = np.convolve(np.random.default_rng(seed).normal(size=points), np.ones(5) / np.sqrt(5), "same")
    return np.cumsum(sigma * slope)


def test_every_slope_is_counted_once():
    lines = [samples.surface(heights(points)) for points in (300, 1001, 20_000)]
    assert count_slopes(lines).size == 299 + 1000 + 19_999


def test_a_missing_height_removes_its_two_slopes_alone():
    height = heights(5000)
    height[[100, 3000]] = np.nan
    marginal = count_slopes([samples.surface(height)])
    assert marginal.size == 4999 - 4
    assert marginal.rms == pytest.approx(np.nanstd(np.diff(height)), rel=1e-4)


def test_each_line_loses_its_own_mean_slope():
    flat = [heights(seed=1), heights(seed=2)]
    tilted = [height + tilt * np.arange(height.size) for height, tilt in zip(flat, (0.3, -0.2), strict=True)]
    of_tilted, expected = (count_slopes([samples.surface(height) for height in lines]) for lines in (tilted, flat))
    assert of_tilted.rms == pytest.approx(expected.rms, rel=1e-6)


def test_half_samples_give_the_variance_of_a_sum_exactly():
    by_stretch = np.random.default_rng(0).poisson(100, size=(STRETCHES, 3)).astype(float)
    bins = np.array([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]])
    halves = LineSlopeCounts(bins, by_stretch, np.ones(3), np.zeros((3, 1)), 1.0, 0.0).halves()
    assert halves[0] == pytest.approx(by_stretch.sum(axis=0))
    variance = STRETCHES * by_stretch.var(axis=0, ddof=1)
    assert np.mean((halves[1:] - halves[0]) ** 2, axis=0) == pytest.approx(variance, rel=1e-12)


def test_correlated_slopes_give_fewer_independent_slopes():
    independent = samples.surface(np.cumsum(np.random.default_rng(3).normal(size=40_000)))
    # Of five neighbours each: rectangles of 5 make about 5 slopes count as one or two for wide classes.
    assert count_slopes([independent]).redundancy < 1.2 < count_slopes([samples.surface(heights())]).redundancy


@pytest.mark.parametrize("share", [0.002, 0.03, 0.3, 1.0])
@pytest.mark.parametrize("tilt", [0.0, 0.0371])
def test_the_quantum_of_rounded_heights_is_found_and_their_rounding_is_removed(share, tilt):
    quantum = 0.1 * share
    height = heights() + tilt * np.arange(40_000)
    line = surfaces.level(samples.surface(quantum * np.round(height / quantum)))
    marginal = count_slopes([line])
    assert marginal.quantum == pytest.approx(quantum, rel=1e-4)
    # Two rounded heights add q²/6 to the mean square slope: 8 % of the rms at a quantum of the rms.
    assert marginal.rms == pytest.approx(np.std(np.diff(height)), rel=0.005)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_heights_that_take_any_value_have_no_quantum(seed):
    assert count_slopes([samples.surface(heights(2000, seed=seed))]).quantum == 0


def test_a_sawtooth_is_not_taken_for_quantised_heights():
    assert count_slopes([samples.surface(np.cumsum(np.where(np.arange(20_000) % 40 < 20, 0.1, -0.1)))]).quantum == 0


@pytest.mark.parametrize("share", [0.1, 0.5, 1.2])
def test_the_density_of_rounded_line_heights_is_that_of_the_heights(share):
    height = heights()
    exact = facets.estimate(samples.surface(height), isotropic=True)
    rounded = facets.estimate(samples.surface(0.1 * share * np.round(height / (0.1 * share))), isotropic=True)
    slope = np.array([0.0, 0.05, 0.1, 0.15, 0.2])
    of_rounded, expected = (np.interp(slope, table["slope"], table["slope_density"]) for table in (rounded, exact))
    # Unless rounding is taken out, a quantum of 1.2 rms lowers the peak by 20 %.
    assert of_rounded == pytest.approx(expected, rel=0.04)


def test_lines_of_different_tilt_share_one_quantum():
    tilts = (0.0, 0.0123, -0.0071)
    lines = [
        samples.surface(0.03 * np.round((heights(seed=seed) + tilt * np.arange(40_000)) / 0.03))
        for seed, tilt in enumerate(tilts)
    ]
    marginal = count_slopes(lines)
    assert marginal.quantum == pytest.approx(0.03, rel=1e-4)
    assert marginal.rms == pytest.approx(
        np.sqrt(np.mean([np.var(np.diff(heights(seed=s))) for s in range(3)])), rel=0.005
    )


def test_a_real_profile_of_coarse_heights_has_its_instruments_quantum(shared_data):
    # Heights in steps of 2.5 nm, printed to 1 nm, every 0.5 µm.
    profile = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "hfm-1.hfm"))
    assert count_slopes([profile]).quantum == pytest.approx(0.005, rel=0.003)


@pytest.mark.parametrize("share", [0.25, 1.0])
@pytest.mark.parametrize("curvature", [1e-7, 3e-6])
def test_the_quantum_is_found_after_a_parabola_was_subtracted(share, curvature):
    quantum, x = 0.1 * share, np.arange(40_000)
    bent = samples.surface(quantum * np.round((heights() + curvature * x**2 / 2) / quantum))
    marginal = count_slopes([surfaces.level(bent, "polynomial-2")])
    assert marginal.quantum == pytest.approx(quantum, rel=1e-4)
    # The parabola's slope runs over up to five quanta: the steps differ from point to point.
    assert marginal.rms == pytest.approx(np.std(np.diff(heights())), rel=0.005)


def test_the_quantum_is_found_after_a_parabola_was_subtracted_with_missing_heights():
    x = np.arange(40_000)
    height = 0.025 * np.round((heights() + 1e-6 * x**2 / 2) / 0.025)
    height[[10, 500, 501, 502, 30_000]] = np.nan
    marginal = count_slopes([surfaces.level(samples.surface(height), "polynomial-2")])
    assert marginal.quantum == pytest.approx(0.025, rel=1e-4)
    assert marginal.rms == pytest.approx(np.std(np.diff(heights())), rel=0.005)


def test_the_quantum_of_heights_in_single_precision_is_found():
    height = np.float32(0.025 * np.round(heights() / 0.025))
    assert count_slopes([samples.surface(height)]).quantum == pytest.approx(0.025, rel=1e-4)


def test_lines_of_different_quanta_are_counted_in_separate_bins():
    quanta = (0.01, 0.025, 0.08)
    marginal = count_slopes([samples.surface(q * np.round(heights(seed=n) / q)) for n, q in enumerate(quanta)])
    assert marginal.size == 3 * 39_999
    assert marginal.quantum == pytest.approx(0.08, rel=1e-4)
    assert marginal.rms == pytest.approx(
        np.sqrt(np.mean([np.var(np.diff(heights(seed=n))) for n in range(3)])), rel=0.005
    )
    # The bins of all lines together hold the whole of a model.
    assert marginal.shares(lambda p: np.tanh(p / 0.01)[..., None]).sum() == pytest.approx(1, abs=1e-6)


def test_lines_are_counted_from_the_shortest_that_is_read():
    assert MIN_SLOPES == LINE_MIN - 1

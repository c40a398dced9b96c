"""Gaussian filters: half transmitted at the cutoff, in every direction, with nothing filled in."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.surfaces import high_pass, level, low_pass, parameters
from brdfpipe.surfaces.filtering import ALPHA
from brdfpipe.surfaces.heights import Heights, surface_dataset

PITCH_X, PITCH_Y = 0.5, 0.7


def wave(wavelength: float, azimuth: float | None = None, count: int = 1000) -> xr.Dataset:
    """A sine along a line, or along an azimuth [degree] of a map."""
    if azimuth is None:
        return surface_dataset(Heights(np.sin(2 * np.pi * np.arange(count) * PITCH_X / wavelength + 0.3), PITCH_X))
    x, y = np.arange(260) * PITCH_X, np.arange(200)[:, None] * PITCH_Y
    along = x * np.cos(np.radians(azimuth)) + y * np.sin(np.radians(azimuth))
    return surface_dataset(Heights(np.sin(2 * np.pi * along / wavelength + 0.3), PITCH_X, PITCH_Y))


def transmission(before: xr.Dataset, after: xr.Dataset, margin: float) -> float:
    """The share of the amplitude that is left, ``margin`` [um] away from every edge, where nothing is one-sided."""
    steps = [before.attrs[f"pitch_{dim}"] for dim in before.height.dims]
    inner = tuple(slice(int(margin / step) + 1, -int(margin / step) - 1) for step in steps)
    a, b = before.height.values[inner], after.height.values[inner]
    valid = ~np.isnan(b)
    return float((a[valid] * b[valid]).sum() / (a[valid] ** 2).sum())


@pytest.mark.parametrize("filtered", [low_pass, high_pass])
@pytest.mark.parametrize("azimuth", [None, 0, 35, 90, 120])
@pytest.mark.parametrize("cutoff", [4.0, 20.0])
def test_half_is_transmitted_at_the_cutoff(filtered, azimuth: float | None, cutoff: float) -> None:
    before = wave(cutoff, azimuth)
    # Over no whole number of waves, the projection on a sine is half a percent off.
    assert transmission(before, filtered(before, cutoff), cutoff) == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize("ratio", [0.5, 0.8, 1.5, 3.0])
def test_other_waves_follow_the_transmission_of_the_standard(ratio: float) -> None:
    cutoff = 20.0
    before = wave(cutoff * ratio, count=4000)
    expected = np.exp(-np.pi * (ALPHA / ratio) ** 2)
    assert transmission(before, low_pass(before, cutoff), cutoff) == pytest.approx(expected, abs=1e-3)
    assert transmission(before, high_pass(before, cutoff), cutoff) == pytest.approx(1 - expected, abs=1e-3)


def test_the_cutoff_holds_where_a_third_is_missing_at_random() -> None:
    before = wave(20.0, 35)
    gaps = np.random.default_rng(1).random(before.height.shape) < 0.31
    holed = before.assign(height=before.height.where(~gaps))
    # The weights of the others make up for those missing; each mean is over some 200 heights instead of 300.
    assert transmission(before, low_pass(holed, 20.0), 20.0) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("filtered", [low_pass, high_pass])
def test_missing_stays_missing_and_nothing_is_filled(asymmetric: xr.Dataset, filtered) -> None:
    height = asymmetric.height.values.copy()
    height[5:15, 20:40] = np.nan
    holed = asymmetric.assign(height=asymmetric.height.copy(data=height))
    np.testing.assert_array_equal(np.isnan(filtered(holed, 5.0).height), np.isnan(height))


def test_what_stands_in_a_gap_has_no_weight(asymmetric: xr.Dataset) -> None:
    # The definition, point by point, without transforms.
    z = asymmetric.height.values.copy()
    z[5:15, 20:40] = np.nan
    filtered = low_pass(asymmetric.assign(height=asymmetric.height.copy(data=z)), 5.0).height.values
    y, x = asymmetric.y.values[:, None], asymmetric.x.values
    valid = ~np.isnan(z)
    for row, column in ((0, 0), (4, 30), (20, 25), (39, 49), (15, 19)):
        square = (x - x[column]) ** 2 + (y - y[row]) ** 2
        weight = np.exp(-np.pi * square / (ALPHA * 5.0) ** 2)[valid]
        # Weights below 1e-6 of the peak are left out.
        assert filtered[row, column] == pytest.approx((weight * z[valid]).sum() / weight.sum(), abs=1e-5)


@pytest.mark.parametrize("missing", [False, True])
def test_a_constant_passes_the_low_pass_whole_up_to_the_edges(missing: bool) -> None:
    height = np.full((50, 60), 1e4)
    if missing:
        height[np.random.default_rng(2).random(height.shape) < 0.4] = np.nan
    constant = surface_dataset(Heights(height, 0.5, 0.7))
    np.testing.assert_allclose(low_pass(constant, 10.0).height, height, rtol=1e-14)
    np.testing.assert_allclose(high_pass(constant, 10.0).height.values[~np.isnan(height)], 0, atol=1e-9)


def test_the_two_filters_share_a_surface_between_them(asymmetric: xr.Dataset) -> None:
    both = low_pass(asymmetric, 6.0).height + high_pass(asymmetric, 6.0).height
    np.testing.assert_allclose(both, asymmetric.height, atol=1e-14)


def test_what_was_done_is_recorded_and_the_original_left_alone(asymmetric: xr.Dataset) -> None:
    before = asymmetric.copy(deep=True)
    filtered = high_pass(low_pass(level(asymmetric), 3.0), 12.0)
    assert (filtered.attrs["lambda_s"], filtered.attrs["lambda_c"]) == (3.0, 12.0)
    assert filtered.attrs["band"] == "0.5 x 0.7 um pitch; λs 3 um, λc 12 um filter"
    assert low_pass(asymmetric, 3.0).attrs["band"] == "0.5 x 0.7 um pitch; λs 3 um, no λc filter"
    assert filtered.attrs["history"].count("Gaussian filter") == 2
    assert parameters(filtered).attrs["band"] == filtered.attrs["band"]
    xr.testing.assert_identical(asymmetric, before)


def test_single_precision_stays_single(asymmetric: xr.Dataset) -> None:
    assert low_pass(asymmetric.astype(np.float32), 5.0).height.dtype == np.float32


@pytest.mark.parametrize("filtered", [low_pass, high_pass])
@pytest.mark.parametrize("cutoff", [2.7, 25.1, 0.0, -5.0, np.nan])
def test_a_cutoff_outside_the_range_of_pitch_and_extent_is_refused(
    asymmetric: xr.Dataset, filtered, cutoff: float
) -> None:
    with pytest.raises(BrdfpipeError, match=r"is out of range; accepted: 2\.8 um \(4 pitches\) to 25 um"):
        filtered(asymmetric, cutoff)


def test_a_low_pass_coarser_than_the_high_pass_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(BrdfpipeError, match="not above λs"):
        high_pass(low_pass(asymmetric, 8.0), 8.0)
    with pytest.raises(BrdfpipeError, match="not below λc"):
        low_pass(high_pass(asymmetric, 8.0), 9.0)


def test_another_kind_of_dataset_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(VocabularyError):
        low_pass(asymmetric.assign_attrs(kind="spectrum"), 5.0)

"""Levelling takes exactly the plane away, and nothing that is not a plane."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.surfaces import level
from brdfpipe.surfaces.heights import Heights, surface_dataset

TILT = st.floats(-2, 2)


@settings(max_examples=30, deadline=None)
@given(a=TILT, b=TILT, offset=st.floats(-1e4, 1e4), gaps=st.floats(0, 0.6), seed=st.integers(0, 99))
def test_a_plane_is_removed_whole_whatever_is_missing(
    a: float, b: float, offset: float, gaps: float, seed: int
) -> None:
    x, y = np.arange(20) * 0.5, np.arange(15)[:, None] * 0.7
    height = offset + a * x + b * y
    height[np.random.default_rng(seed).random(height.shape) < gaps] = np.nan
    levelled = level(surface_dataset(Heights(height, 0.5, 0.7))).height
    np.testing.assert_array_equal(np.isnan(levelled), np.isnan(height))
    # Heights of 1e4 in double precision carry 2e-12.
    np.testing.assert_allclose(levelled.values[~np.isnan(height)], 0, atol=1e-10)


def test_it_is_the_least_squares_plane(asymmetric: xr.Dataset) -> None:
    height = asymmetric.height.values
    valid = ~np.isnan(height)
    y, x = np.broadcast_arrays(asymmetric.y.values[:, None], asymmetric.x.values)
    design = np.column_stack([np.ones(valid.sum()), x[valid], y[valid]])
    residual = height[valid] - design @ np.linalg.lstsq(design, height[valid], rcond=None)[0]
    np.testing.assert_allclose(level(asymmetric).height.values[valid], residual, atol=1e-13)


def test_a_line_loses_its_straight_line(line: xr.Dataset) -> None:
    x, z = line.x.values, line.height.values
    np.testing.assert_allclose(level(line).height, z - np.polyval(np.polyfit(x, z, 1), x), atol=1e-13)


def test_levelling_twice_changes_nothing_more(asymmetric: xr.Dataset) -> None:
    once = level(asymmetric)
    np.testing.assert_allclose(level(once).height, once.height, atol=1e-14)


def test_what_was_done_is_recorded_and_the_original_left_alone(asymmetric: xr.Dataset) -> None:
    before = asymmetric.copy(deep=True)
    levelled = level(asymmetric)
    assert levelled.attrs["levelling"] == "plane"
    assert "least-squares plane: slope" in levelled.attrs["history"]
    assert levelled.height.attrs["units"] == "um"
    xr.testing.assert_identical(asymmetric, before)


def test_single_precision_stays_single_and_loses_nothing_more(asymmetric: xr.Dataset) -> None:
    single = level(asymmetric.astype(np.float32))
    assert single.height.dtype == np.float32
    # The heights themselves carry 6e-8 of about 1 um.
    np.testing.assert_allclose(single.height, level(asymmetric).height, atol=2e-7)


def test_the_form_none_leaves_the_heights_alone(asymmetric: xr.Dataset) -> None:
    left = level(asymmetric, form="none")
    assert left.attrs["levelling"] == "none"
    xr.testing.assert_identical(left.height, asymmetric.height)


def test_an_unknown_form_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(BrdfpipeError, match="'sphere'; accepted: none, plane"):
        level(asymmetric, form="sphere")


def test_heights_that_fix_no_plane_are_refused(asymmetric: xr.Dataset) -> None:
    for keep in (np.s_[0, :2], np.s_[5, :], np.s_[:, 5]):
        height = np.full(asymmetric.height.shape, np.nan)
        height[keep] = asymmetric.height.values[keep]
        with pytest.raises(BrdfpipeError, match="cannot level"):
            level(asymmetric.assign(height=asymmetric.height.copy(data=height)))


def test_another_kind_of_dataset_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(VocabularyError, match="expected a dataset of kind 'surface'"):
        level(asymmetric.assign_attrs(kind="spectrum"))

"""Levelling takes exactly the form away, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.surfaces import level
from brdfpipe.surfaces.heights import Heights, surface_dataset
from brdfpipe.surfaces.levelling import FORMS

TILT = st.floats(-2, 2)


@settings(max_examples=30, deadline=None)
@given(a=TILT, b=TILT, offset=st.floats(-1e4, 1e4), gaps=st.floats(0, 0.6), seed=st.integers(0, 99))
def test_a_plane_is_removed_also_with_missing_heights(
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


X, Y = np.arange(60) * 0.5, np.arange(45)[:, None] * 0.7
COEFFICIENT = st.floats(-0.1, 0.1)


@settings(max_examples=30, deadline=None)
@given(c=st.tuples(*[COEFFICIENT] * 5), offset=st.floats(-1e4, 1e4), gaps=st.floats(0, 0.6), seed=st.integers(0, 99))
def test_a_polynomial_of_degree_2_is_removed_also_with_missing_heights(
    c: tuple[float, ...], offset: float, gaps: float, seed: int
) -> None:
    height = offset + c[0] * X + c[1] * Y + c[2] * X**2 + c[3] * X * Y + c[4] * Y**2
    height[np.random.default_rng(seed).random(height.shape) < gaps] = np.nan
    levelled = level(surface_dataset(Heights(height, 0.5, 0.7)), "polynomial-2").height
    np.testing.assert_array_equal(np.isnan(levelled), np.isnan(height))
    # Heights of 1e4 in double precision carry 2e-12.
    np.testing.assert_allclose(levelled.values[~np.isnan(height)], 0, atol=1e-10)


def test_the_polynomial_is_that_of_a_general_solver(asymmetric: xr.Dataset) -> None:
    height = asymmetric.height.values
    valid = ~np.isnan(height)
    y, x = np.broadcast_arrays(asymmetric.y.values[:, None], asymmetric.x.values)
    design = np.column_stack([x[valid] ** a * y[valid] ** b for a in range(3) for b in range(3 - a)])
    residual = height[valid] - design @ np.linalg.lstsq(design, height[valid], rcond=None)[0]
    np.testing.assert_allclose(level(asymmetric, "polynomial-2").height.values[valid], residual, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(angle=st.floats(0, 180), radius=st.floats(200, 1e5), sign=st.sampled_from([-1, 1]), gaps=st.floats(0, 0.6))
def test_a_parabolic_cylinder_of_any_direction_is_removed(angle: float, radius: float, sign: int, gaps: float) -> None:
    u = X * np.cos(np.radians(angle)) + Y * np.sin(np.radians(angle)) - 20
    height = sign * u**2 / (2 * radius) + 0.02 * X - 0.03 * Y + 5
    height[np.random.default_rng(3).random(height.shape) < gaps] = np.nan
    levelled = level(surface_dataset(Heights(height, 0.5, 0.7)), "cylinder")
    # The direction is searched to 1e-5 rad, and enters the residual by its square.
    np.testing.assert_allclose(levelled.height.values[~np.isnan(height)], 0, atol=1e-5 * 20**2 / radius)


def test_the_cylinder_names_its_curvature_and_direction() -> None:
    u = X * np.cos(np.radians(30)) + Y * np.sin(np.radians(30))
    levelled = level(surface_dataset(Heights(u**2 / 2000, 0.5, 0.7)), "cylinder")
    assert "curvature 0.001 per um along 30.0 degree" in levelled.attrs["history"]


def test_the_cylinder_bends_one_way_alone() -> None:
    # A saddle is no cylinder: half of it must stay, as half of it can go.
    saddle = ((X - X.mean()) ** 2 - (Y - Y.mean()) ** 2) / 2000
    left = {form: float(level(surface_dataset(Heights(saddle, 0.5, 0.7)), form).height.std()) for form in FORMS}
    assert left["polynomial-2"] < 1e-12
    assert 0.3 * left["plane"] < left["cylinder"] < 0.8 * left["plane"]


def test_the_remainder_of_a_circular_arc_is_that_of_the_docstring() -> None:
    radius, x = 1000.0, np.arange(-3000, 3001) * 0.1
    arc = surface_dataset(Heights(np.sqrt(radius**2 - x**2), 0.1))
    slope = float(np.gradient(level(arc, "cylinder").height.values, 0.1).std())
    # Of an edge slope of 0.3; the sixth power of the arc adds a tenth.
    assert slope == pytest.approx(0.09 * 0.3**3, rel=0.15)


def test_a_line_loses_its_parabola(line: xr.Dataset) -> None:
    x, z = line.x.values, line.height.values
    for form in ("polynomial-2", "cylinder"):
        np.testing.assert_allclose(level(line, form).height, z - np.polyval(np.polyfit(x, z, 2), x), atol=1e-12)


def test_levelling_by_a_polynomial_again_changes_nothing_more(asymmetric: xr.Dataset) -> None:
    once = level(asymmetric, "polynomial-2")
    assert once.attrs["levelling"] == "polynomial-2"
    assert "polynomial of degree 2: slope" in once.attrs["history"]
    np.testing.assert_allclose(level(once, "polynomial-2").height, once.height, atol=1e-13)


@pytest.mark.parametrize("form", ["polynomial-2", "cylinder"])
def test_heights_that_do_not_determine_a_bent_form_are_refused(asymmetric: xr.Dataset, form: str) -> None:
    for keep in (np.s_[:2, :], np.s_[:, 4:6], np.s_[0, :5]):
        height = np.full(asymmetric.height.shape, np.nan)
        height[keep] = asymmetric.height.values[keep]
        with pytest.raises(BrdfpipeError, match="cannot level"):
            level(asymmetric.assign(height=asymmetric.height.copy(data=height)), form)


def test_heights_along_one_diagonal_do_not_determine_a_plane() -> None:
    height = np.where(np.eye(40, dtype=bool), 1.0, np.nan)
    with pytest.raises(BrdfpipeError, match="too few lines"):
        level(surface_dataset(Heights(height, 1.0, 1.0)))


def test_an_unknown_form_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(BrdfpipeError, match="'sphere'; accepted: plane, polynomial-2, cylinder, none"):
        level(asymmetric, form="sphere")


def test_heights_that_do_not_determine_a_plane_are_refused(asymmetric: xr.Dataset) -> None:
    for keep in (np.s_[0, :2], np.s_[5, :], np.s_[:, 5]):
        height = np.full(asymmetric.height.shape, np.nan)
        height[keep] = asymmetric.height.values[keep]
        with pytest.raises(BrdfpipeError, match="cannot level"):
            level(asymmetric.assign(height=asymmetric.height.copy(data=height)))


def test_another_kind_of_dataset_is_refused(asymmetric: xr.Dataset) -> None:
    with pytest.raises(VocabularyError, match="expected a dataset of kind 'surface'"):
        level(asymmetric.assign_attrs(kind="spectrum"))

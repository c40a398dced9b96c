from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from brdfpipe import vocabulary
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import cells as rig_cells
from brdfpipe.rig.reduction.thumbnails import DECADES, LONGEST, drawing, squares, thumbnail


def test_levels_are_logarithms_of_the_light() -> None:
    picture = np.full((40, 40), 1e-4)
    picture[:4] = 10.0 ** -np.arange(4)[:, None]
    levels, decades = thumbnail(picture)
    assert decades == pytest.approx(4)  # the darkest quarter is at 1e-4 of the brightest
    assert levels[:4, 0].tolist() == [255, 191, 128, 64]  # 255 (1 - k/4)
    assert not levels[4:].any()


@pytest.mark.parametrize("dark", [np.nan, 0.0, -1e-3])
def test_parts_without_light_are_black(dark: float) -> None:
    levels, _ = thumbnail(np.array([[1.0, dark], [dark, dark]]))
    assert levels.tolist() == [[255, 0], [0, 0]]


def test_an_empty_picture_is_black() -> None:
    assert not thumbnail(np.full((8, 8), np.nan)).levels.any()


def test_a_large_camera_gives_a_small_picture_of_means() -> None:
    picture = np.zeros((600, 1001))
    picture[:, :7] = np.arange(7) + 1.0  # of the first column of squares, 4 on average
    picture[:, 7:14] = 4.0
    levels, _ = thumbnail(picture)
    assert squares(picture.shape) == 7
    assert levels.shape == (85, 143)
    assert max(levels.shape) <= LONGEST
    assert (levels[:, 0] == levels[:, 1]).all()


@given(arrays(float, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.floats(-1e9, 1e9)))
@example(np.array([[-2.0, 1e-308]]))
def test_the_brightest_part_of_any_picture_is_white(picture: np.ndarray) -> None:
    levels, decades = thumbnail(picture)
    assert levels.dtype == np.uint8
    assert DECADES[0] <= decades <= DECADES[1]
    assert levels.max() == (255 if picture.max() > 0 else 0)
    assert levels.flat[picture.argmax()] == levels.max()


def _drawn(rig: Rig):
    return drawing(np.ones((rig.camera.height, rig.camera.width)), rig, rig.screen, rig_cells.weights(rig, rig.screen))


def test_outlines_are_where_the_fibres_are_visible(rig: Rig) -> None:
    drawn = _drawn(rig)
    column, row = screens.to_pixel(rig.screen, [fibre.x for fibre in rig.fibres], [fibre.y for fibre in rig.fibres])
    count = len(rig.fibres)
    # To a hundredth of a pixel: a circle in sixths of pixels.
    assert drawn["column"].values[:count] == pytest.approx(column, abs=0.02)
    assert drawn["row"].values[:count] == pytest.approx(row, abs=0.02)
    radius = rig.screen.fibre_radius * rig.screen.scale + rig_cells.BLUR
    assert drawn["aperture"].values[:count] == pytest.approx(radius, rel=0.01)
    assert np.isnan(drawn["aperture"].values[count:]).all()


def test_the_last_ring_is_within_the_rim_of_the_disc(rig: Rig) -> None:
    radius = _drawn(rig)["ring_radius"].values
    rim = rig.screen.disc_radius * rig.screen.scale
    assert radius[0] == 0
    assert (np.diff(radius) > 0).all()
    assert rim - 3 < radius[-1] <= rim


def test_outlines_follow_the_picture(rig: Rig) -> None:
    centre = rig.screen.centre
    moved = dataclasses.replace(rig.screen, centre=(centre[0] + 1.5, centre[1] - 0.5))
    there = drawing(np.ones((rig.camera.height, rig.camera.width)), rig, moved, rig_cells.weights(rig, moved))
    here = _drawn(rig)
    of_fibres = slice(len(rig.fibres))
    assert (there["column"] - here["column"]).values[of_fibres] == pytest.approx(1.5, abs=0.02)
    assert (there["row"] - here["row"]).values[of_fibres] == pytest.approx(-0.5, abs=0.02)
    # Between rings of whole pixels the middles of the disc's cells are a little uneven.
    assert np.nanmedian(there["column"] - here["column"]) == pytest.approx(1.5, abs=0.1)


def test_a_drawing_can_be_stored_with_what_was_reduced(rig: Rig) -> None:
    drawn = vocabulary.label(_drawn(rig), "preview")
    assert all({"units", "long_name"} <= set(drawn[name].attrs) for name in drawn.data_vars)
    assert "sample" not in drawn["picture"].attrs["long_name"]
    assert "scale" in drawn["picture"].attrs["long_name"]

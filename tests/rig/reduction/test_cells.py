"""Cells of the disc and of the fibres: their directions, solid angles and pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.rig import screen
from brdfpipe.rig.description import CameraSettings, Fibre, Rig, Screen
from brdfpipe.rig.reduction import cells


def a_screen(disc_radius: float, focal_length: float, scale: float) -> Screen:
    return Screen(focal_length, disc_radius, (0.0, 0.0), (48.0, 34.0), 1.0, 1.5, scale, (159.5, 119.5))


@settings(max_examples=30, deadline=None)
@given(st.floats(2.0, 40.0), st.floats(50.0, 300.0), st.floats(1.0, 6.0))
def test_the_rings_cover_the_disc_up_to_its_margin_and_no_more(disc_radius, focal_length, scale):
    edges, per_ring = cells.rings(a_screen(disc_radius, focal_length, scale))
    assert edges[0] == 0
    assert (np.diff(edges) > 0).all()
    assert per_ring[0] == 1
    assert len(edges) == len(per_ring) + 1
    assert focal_length * np.tan(np.radians(edges[-1])) <= disc_radius


def test_the_rings_widen_from_half_a_degree_and_their_cells_are_about_as_wide_as_long(rig: Rig):
    edges, per_ring = cells.rings(rig.screen)
    width, middle = np.diff(edges), (edges[1:] + edges[:-1]) / 2
    assert width[1] == pytest.approx(0.5, rel=0.15)
    assert width[-1] == pytest.approx(0.5 + 0.07 * middle[-1], rel=0.1)
    assert 2 * np.pi * middle[1:] / per_ring[1:] == pytest.approx(width[1:], rel=0.2)


def test_solid_angles_add_up_to_the_cone_that_the_rings_cover(rig: Rig):
    described = cells.cells_of(rig)
    rim = np.radians(cells.rings(rig.screen)[0][-1])
    assert described.solid_angle[described.of_disc].sum() == pytest.approx(2 * np.pi * (1 - np.cos(rim)), rel=1e-12)
    assert np.isnan(described.solid_angle[~described.of_disc]).all()


def test_the_direction_of_a_cell_is_the_mean_direction_of_its_light(rig: Rig):
    """Sums over the directions of sub-pixels against the closed form."""
    seen = cells.cells_of(rig)
    share = cells.weights(rig, rig.screen).tocoo()
    row, column = np.divmod(share.col, rig.camera.width)
    theta, phi = screen.disc_direction(rig.screen, *screen.to_position(rig.screen, column, row))
    light = share.data * np.cos(np.radians(theta)) ** 3
    vector = np.stack(
        [np.sin(np.radians(theta)) * np.cos(np.radians(phi)), np.sin(np.radians(theta)) * np.sin(np.radians(phi))]
    )
    count = len(seen.names)
    total = np.bincount(share.row, light, count)
    mean = np.stack([np.bincount(share.row, light * axis, count) for axis in vector]) / total
    expected = np.sin(np.radians(seen.theta_s)) * np.stack(
        [np.cos(np.radians(seen.phi_s)), np.sin(np.radians(seen.phi_s))]
    )
    # A pixel is 0.13 degree wide; a cell has sixteen and more, whose edges are cut into sixths.
    assert np.degrees(np.abs(mean - expected)[:, seen.of_disc]).max() < 0.01


def test_the_middle_of_a_cell_is_within_its_ring_and_nearer_to_the_mirror_than_the_middle_of_the_ring(rig: Rig):
    described = cells.cells_of(rig)
    edges, per_ring = cells.rings(rig.screen)
    theta = described.theta_s[described.of_disc]
    assert theta[0] == 0
    ring = np.repeat(np.arange(len(per_ring)), per_ring)[1:]
    assert (theta[1:] > edges[ring]).all()
    assert (theta[1:] < np.sqrt((edges[ring] ** 2 + edges[ring + 1] ** 2) / 2)).all()


def test_no_pixel_is_counted_twice_and_every_inner_one_belongs_to_a_cell(rig: Rig):
    crowded = replace(rig, fibres=(*rig.fibres, Fibre("near", 20.0, 0.0, 34.0, 0.0)))
    share = np.asarray(cells.weights(crowded, crowded.screen).sum(axis=0)).reshape(240, 320)
    assert share.max() <= 1 + 1e-12
    assert share.min() >= 0
    rows, columns = np.mgrid[:240, :320]
    inner = np.hypot(columns - 159.5, rows - 119.5) < 3 * 26.4 - 4
    assert share[inner].min() == pytest.approx(1, abs=1e-12)


def test_fibres_sum_their_spot_and_its_blur_but_nothing_of_a_neighbour(rig: Rig):
    radii = cells.fibre_radii(rig, rig.screen)
    assert radii == pytest.approx(3 * 1.0 + cells.BLUR)
    crowded = replace(rig, fibres=(*rig.fibres, Fibre("near", 20.0, 0.0, 34.0, 0.0)))
    assert cells.fibre_radii(crowded, crowded.screen)[[0, -1]] == pytest.approx(3.0, rel=5e-3)


@settings(max_examples=30, deadline=None)
@given(st.floats(20, 300), st.floats(20, 220), st.floats(1.0, 8.0))
def test_a_disk_has_the_area_of_a_circle_and_its_middle(column, row, radius):
    share = cells.disk(CameraSettings("emulated"), column, row, radius).tocoo()
    # Sixths of a pixel: the area of a circle of a few pixels is counted to a percent or two.
    assert share.data.sum() == pytest.approx(np.pi * radius**2, rel=0.06 / radius + 0.01)
    y, x = np.divmod(share.col, 320)
    assert (share.data * x).sum() / share.data.sum() == pytest.approx(column, abs=0.05)
    assert (share.data * y).sum() / share.data.sum() == pytest.approx(row, abs=0.05)


def test_a_disk_beyond_the_picture_is_empty_and_one_at_its_edge_is_cut(rig: Rig):
    assert cells.disk(rig.camera, -50.0, 100.0, 5.0).nnz == 0
    half = cells.disk(rig.camera, -0.5, 100.0, 5.0).sum()
    assert half == pytest.approx(np.pi * 25 / 2, rel=0.02)


def test_the_cells_do_not_depend_on_the_position_of_the_picture(rig: Rig):
    """A registered scale or focal length must not make other rings: etalon and sample would not match."""
    moved = replace(
        rig.screen, scale=3.02, focal_length=150.8, centre=(160.1, 118.9), disc_centre=(0.2, -0.1), radial=2e-6
    )
    here, there = cells.weights(rig, rig.screen), cells.weights(rig, moved)
    assert here.shape == there.shape
    # A cell's pixels follow it.
    row, column = np.divmod(np.arange(here.shape[1]), 320)
    for matrix, place in ((here, rig.screen), (there, moved)):
        total = matrix.sum(axis=1)
        theta, _ = screen.disc_direction(
            place, *screen.to_position(place, matrix @ column / total, matrix @ row / total)
        )
        of_disc = cells.cells_of(rig).of_disc
        assert theta[of_disc][1:] == pytest.approx(cells.cells_of(rig).theta_s[of_disc][1:], abs=0.02)

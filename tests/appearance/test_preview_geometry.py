"""What the camera sees of a preview's subjects."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from brdfpipe.appearance import preview_geometry as shots

SHOTS = pytest.mark.parametrize("shot", [shots.sphere(64), shots.panel(64)], ids=["sphere", "panel"])


@SHOTS
def test_all_that_is_covered_faces_the_camera(shot):
    for points in (shot.pixels, shot.coarse):
        assert np.linalg.norm(points.normal, axis=1) == pytest.approx(np.ones(len(points.normal)))
        assert np.linalg.norm(points.view, axis=1) == pytest.approx(np.ones(len(points.view)))
        assert (points.normal * points.view).sum(axis=1).min() > 0
        assert np.abs((points.normal * points.lay).sum(axis=1)).max() < 1e-12
    assert len(shot.pixels.normal) == np.count_nonzero(shot.coverage)


@SHOTS
def test_the_subject_is_inside_its_picture(shot):
    edge = np.concatenate([shot.coverage[[0, -1]].ravel(), shot.coverage[:, [0, -1]].ravel()])
    assert edge.max() == 0
    assert shot.coverage.max() == 1


def test_the_edge_of_the_sphere_covers_the_area_of_a_disc():
    shot = shots.sphere(128)
    assert shot.coverage.sum() == pytest.approx(np.pi * (shots.SPHERE_RADIUS * 128) ** 2, rel=1e-4)


def test_the_panel_covers_the_area_of_its_projection():
    # The corners, as a pinhole at the camera's place sees them.
    normal = np.array(shots.PANEL_NORMAL) / np.linalg.norm(shots.PANEL_NORMAL)
    up = np.cross(normal, [1.0, 0.0, 0.0])
    corners = np.array([x * np.array([1.0, 0, 0]) + s * up for x, s in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    x, z = (corners[:, [0, 2]] / (corners[:, 1:2] + shots.PANEL_DISTANCE)).T / shots.PANEL_FIELD * 32
    area = abs(np.dot(x, np.roll(z, 1)) - np.dot(z, np.roll(x, 1))) / 2
    assert shots.panel(64).coverage.sum() == pytest.approx(area, rel=0.005)


@SHOTS
def test_slowly_varying_light_is_interpolated_between_the_points_of_the_grid(shot):
    def slow(points):
        return np.stack(
            [points.normal[:, 2] * points.view[:, 0] + points.normal[:, 0], points.normal[:, 1] ** 2], axis=-1
        )

    assert np.abs(shot.upsampled(slow(shot.coarse)) - slow(shot.pixels)).max() < 2e-3


def test_light_between_the_coarse_points_is_that_of_an_interpolating_spline():
    shot = shots.panel(64)
    values = np.random.default_rng(3).normal(size=(len(shot.coarse.normal), 2))
    nodes = np.arange(shot.grid[0])
    splines = [RectBivariateSpline(nodes, nodes, column.reshape(shot.grid)) for column in values.T]
    expected = np.stack([spline.ev(*shot.grid_position) for spline in splines], axis=-1)
    # In single precision.
    np.testing.assert_allclose(shot.upsampled(values), expected, atol=2e-6)

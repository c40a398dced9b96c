"""The curvature correction of disc cells, and the noise it adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy

from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import cells
from brdfpipe.rig.reduction.curvature import curvature_correction
from brdfpipe.rig.reduction.registration import Registration


@pytest.fixture(scope="module")
def rig() -> Rig:
    return accuracy.plan_of(fibres=20).rig


def corrected(rig: Rig, pictures: np.ndarray):
    """Sums over cells, their curvature correction, the weights of both, the areas, and which cells are clear of the rim."""
    registration = Registration(rig.screen, 0.0, 0.0, 0)
    weights, described = cells.weights(rig, rig.screen), cells.cells_of(rig)
    area = np.maximum(weights.sum(axis=1), 1e-9)
    bend, bends = curvature_correction(rig, registration, weights, pictures, area, described.of_disc)
    sums = (weights @ pictures.reshape(len(pictures), -1).T).T
    return sums, bend, weights, bends, area, described.of_disc & (described.theta_s < 7)


def test_the_curvature_of_a_paraboloid_is_the_second_moment_of_the_cell(rig) -> None:
    row, column = np.indices((rig.camera.height, rig.camera.width)).astype(float)
    x, y = (float(pixel) for pixel in screens.to_pixel(rig.screen, *rig.screen.disc_centre))
    bowl = 1 + 3e-4 * (column - x) ** 2 + 1e-4 * (column - x) * (row - y) + 2e-4 * (row - y) ** 2
    sums, bend, weights, _, area, inside = corrected(rig, bowl[None])
    column_of, row_of = (weights @ axis.ravel() / area for axis in (column, row))
    # The light itself is the mean over a pixel of the bowl; sampled in its middle, it lacks a twelfth of the curvature.
    own = area * (3e-4 + 2e-4) / 12
    a, b = column_of - x, row_of - y
    middle = 1 + 3e-4 * a**2 + 1e-4 * a * b + 2e-4 * b**2
    left = (sums[0] - (bend[0] - own)) / area - middle
    np.testing.assert_allclose(left[inside], 0, atol=2e-5)
    assert np.median(bend[0, inside] / area[inside]) > 5e-4


def test_noise_includes_that_of_the_curvature_correction(rig) -> None:
    noise = np.random.default_rng(1).standard_normal((150, rig.camera.height, rig.camera.width))
    sums, bend, weights, bends, _, inside = corrected(rig, 1000 + noise)
    observed = (sums - bend).std(axis=0, ddof=1)
    stated = np.sqrt((weights - bends).power(2).sum(axis=1))
    # Of 150 pictures a standard deviation is known to 6 %, the mean over two hundred cells to half a percent.
    assert np.mean(observed[inside] / stated[inside]) == pytest.approx(1, abs=0.02)
    plain = np.sqrt(weights.power(2).sum(axis=1))
    assert np.median(stated[inside] / plain[inside]) > 1.15
    far = weights[np.flatnonzero(~inside)[0]]
    assert far.nnz
    assert not bends[:20].nnz


def test_a_disc_too_small_for_a_curvature_has_no_correction(rig) -> None:
    small = replace(rig, screen=replace(rig.screen, disc_radius=1.0))
    _, bend, _, bends, _, _ = corrected(small, np.ones((1, rig.camera.height, rig.camera.width)))
    assert not bend.any()
    assert not bends.nnz

"""Maps between an even square and a density that is bilinear between nodes."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.exchange.bilinear_warp import BilinearWarp, Slices


@pytest.fixture
def family():
    """Densities of three incidences, with a row and a column of zeros."""
    values = np.random.default_rng(0).random((3, 5, 7)) ** 3
    values[:, 0] = values[:, :, 3] = 0.0
    return BilinearWarp.of(values)


def at(theta, count):
    return Slices.at((np.array([0.0, 0.5, 1.0]),), (np.full(count, theta),))


@pytest.mark.parametrize("theta", [0.0, 0.3, 1.0])
def test_to_even_undoes_from_even(family, theta):
    even = np.random.default_rng(1).random((2, 4000))
    x, y = family.from_even(at(theta, 4000), *even)
    back = family.to_even(at(theta, 4000), x, y)
    # The plugin takes densities as constant if both ends agree to 1e-4.
    assert np.stack(back) == pytest.approx(even, abs=1e-4)


def test_the_density_is_that_of_mapped_even_points(family):
    even = np.random.default_rng(2).random((2, 400_000))
    slices = at(0.3, even.shape[1])
    x, y = family.from_even(slices, *even)
    # The mean of 1/density over the mapped points is the area where there is any.
    inside = (np.abs(x - 0.75) < 0.1) & (np.abs(y - 0.6) < 0.2)
    density = family.at(slices, x, y)
    area = np.sum(1 / density[inside]) / x.size
    assert area == pytest.approx(0.2 * 0.4, rel=0.02)


def test_a_density_has_integral_one(family):
    nodes, weights = np.polynomial.legendre.leggauss(200)
    x, y = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2)
    values = family.at(at(1.0, x.size), x.ravel(), y.ravel())
    assert values @ np.outer(weights, weights).ravel() / 4 == pytest.approx(1.0, rel=1e-3)


def test_an_axis_of_one_node_has_no_influence():
    slices = Slices.at((np.zeros(1), np.array([0.0, 1.0])), (np.array([0.4, -2.0]), np.array([0.25, 5.0])))
    values = np.array([10.0, 20.0])
    assert slices.mean(values) == pytest.approx([12.5, 20.0])

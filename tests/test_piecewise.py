"""Piecewise cubics by the bits of their argument: the same as scipy's, to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from brdfpipe.piecewise import PiecewiseCubic


def spline(nodes, trailing=()):
    values = np.random.default_rng(3).normal(size=(nodes.size, *trailing))
    return CubicSpline(nodes, values)


@pytest.mark.parametrize(
    "nodes",
    [
        np.linspace(0, 10, 5),
        np.sinh(np.linspace(0, np.arcsinh(1e7), 1024)) ** 2,
        np.concatenate([[0], np.geomspace(1e-12, 1, 100)]),
        np.concatenate([np.linspace(0, 1, 40), 1 + np.geomspace(1e-3, 1, 40)]),
        np.array([0.0, 2.0]),
    ],
    ids=["even", "long tail", "crowded at zero", "crowded elsewhere", "one interval"],
)
def test_values_are_those_of_the_spline_at_nodes_between_them_and_at_both_ends(nodes):
    exact = spline(nodes)
    between = nodes[:-1] + np.diff(nodes) * np.random.default_rng(1).random((7, nodes.size - 1))
    x = np.concatenate([nodes, between.ravel(), np.nextafter(nodes[1:], 0)])
    # Intervals are half open in both, so the very same polynomial is taken: no more than rounding lies between.
    assert PiecewiseCubic.of(exact)(x) == pytest.approx(exact(x), rel=1e-12, abs=1e-11)


def test_several_functions_are_evaluated_at_once():
    exact = spline(np.linspace(0, 1, 9), (3,))
    x = np.random.default_rng(0).random((4, 5))
    assert PiecewiseCubic.of(exact)(x).shape == (4, 5, 3)
    assert PiecewiseCubic.of(exact)(x) == pytest.approx(exact(x), abs=1e-13)


@given(st.floats(0, 1))
def test_a_single_number_is_accepted(x):
    exact = spline(np.array([0, 0.1, 0.2, 0.4, 1.0]))
    assert float(PiecewiseCubic.of(exact)(np.asarray(x))) == pytest.approx(float(exact(x)), abs=1e-12)

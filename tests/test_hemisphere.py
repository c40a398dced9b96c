"""Quadrature rules, against integrals known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe import hemisphere


def test_a_rule_of_order_n_is_exact_for_degree_2n_minus_1():
    x, w = hemisphere.panel_rule([0.0, 0.3, 1.0], 4)
    assert w @ x**7 == pytest.approx(1 / 8, rel=1e-14)


def test_empty_panels_weigh_nothing():
    x, w = hemisphere.panel_rule([0.0, 0.5, 0.5, 1.0], 3)
    assert w[3:6].tolist() == [0, 0, 0]
    assert w.sum() == pytest.approx(1)
    assert np.isfinite(x).all()


def test_rules_stack_along_leading_axes():
    x, w = hemisphere.panel_rule([[0.0, 1.0], [0.0, 2.0]], 5)
    assert np.sum(w * x**2, axis=1) == pytest.approx([1 / 3, 8 / 3])


def test_graded_edges_cover_the_interval_and_never_go_back():
    edges = hemisphere.graded_edges(np.array([-0.2, 0.1, 3.0]), 1e-3, 0.0, 1.0)
    assert (edges[:, 0] == 0).all()
    assert (edges[:, -1] == 1).all()
    assert (np.diff(edges, axis=1) >= 0).all()


def test_graded_panels_resolve_a_narrow_peak():
    x, w = hemisphere.panel_rule(hemisphere.graded_edges(0.3, 1e-3, 0.0, 1.0, 12), 8)
    assert w @ np.exp(-(((x - 0.3) / 1e-3) ** 2)) == pytest.approx(1e-3 * np.sqrt(np.pi), rel=1e-6)


@pytest.mark.parametrize("theta", [0.0, 8.0, 60.0, 89.0])
def test_the_projected_hemisphere_measures_pi(theta):
    assert hemisphere.around_mirror(theta).weight.sum() == pytest.approx(np.pi, rel=1e-13)

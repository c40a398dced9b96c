"""Quadrature rules, against integrals known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe import hemisphere
from brdfpipe.geometry import unit_vector


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


@pytest.mark.parametrize("theta", [0.0, 8.0, 60.0, 89.0, 90.0])
@pytest.mark.parametrize("slope", [1e-6, 0.3])
def test_the_projected_hemisphere_measures_pi(theta, slope):
    rule = hemisphere.around_mirror(theta, slope)
    assert rule.weight.sum() == pytest.approx(np.pi, rel=1e-9)
    # ∫ cos² θ dω = 2π/3.
    assert rule.weight @ np.cos(np.radians(rule.theta)) == pytest.approx(2 * np.pi / 3, rel=1e-9)


def test_a_cone_measures_its_projected_solid_angle():
    # A cone of half angle c whose axis lies at θ, all above the horizon: π sin² c cos θ.
    rule = hemisphere.around_mirror(30.0, 0.01, half_angle=5.0)
    assert rule.weight.sum() == pytest.approx(np.pi * np.sin(np.radians(5)) ** 2 * np.cos(np.radians(30)), rel=1e-12)


def test_the_rule_resolves_a_narrow_lobe_about_the_mirror_direction():
    rule = hemisphere.around_mirror(40.0, 1e-3)
    mirror = np.array([-np.sin(np.radians(40)), 0, np.cos(np.radians(40))])
    away = 2 * np.arcsin(np.linalg.norm(unit_vector(rule.theta, rule.phi) - mirror, axis=1) / 2)
    # ∫ exp(−r²/w²) cos θ dω ≈ π w² cos 40° for a narrow lobe.
    assert rule.weight @ np.exp(-((away / 2e-3) ** 2)) == pytest.approx(np.pi * 4e-6 * np.cos(np.radians(40)), rel=1e-5)


@pytest.mark.parametrize("theta", [0.0, 8.0, 60.0, 89.0, 90.0])
@pytest.mark.parametrize("azimuth", [0.0, 20.0, 90.0])
def test_the_rule_for_a_lay_measures_the_projected_hemisphere(theta, azimuth):
    rule = hemisphere.around_mirror_with_lay(theta, azimuth, 1e-3, 0.1, lay=15.0)
    assert rule.weight.sum() == pytest.approx(np.pi, rel=1e-6)
    assert rule.weight @ np.cos(np.radians(rule.theta)) == pytest.approx(2 * np.pi / 3, rel=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("azimuth", [15.0, 60.0, 105.0])
def test_the_rule_for_a_lay_resolves_a_long_and_narrow_lobe(ratio, azimuth):
    lay, theta, along = 15.0, 40.0, 1e-3
    rule = hemisphere.around_mirror_with_lay(theta, azimuth, along, along * ratio, lay)
    away = np.radians(azimuth - lay)
    sine = np.sin(np.radians(rule.theta))
    x = sine * np.cos(np.radians(rule.phi - lay)) + np.sin(np.radians(theta)) * np.cos(away)
    y = sine * np.sin(np.radians(rule.phi - lay)) + np.sin(np.radians(theta)) * np.sin(away)
    # cos θ dω = dx dy: of a Gaussian lobe in the plane of the direction's horizontal part the integral is 2π times both widths.
    lobe = np.exp(-((x / along) ** 2 + (y / (along * ratio)) ** 2) / 2)
    assert rule.weight @ lobe == pytest.approx(2 * np.pi * along**2 * ratio, rel=1e-3)

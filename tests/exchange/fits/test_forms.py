"""Shading models of renderers: against integrals over the hemisphere, and against the facets of this package."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.exchange.fits.forms import Lobe, Material, base_share, by_albedo, by_fresnel, dielectric, schlick


def hemisphere(count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ_o, φ_o and projected solid angle of a product rule."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    cosine, phi = np.meshgrid((nodes + 1) / 2, 90 * (nodes + 1), indexing="ij")
    weight = np.outer(weights, weights) / 4 * 2 * np.pi * cosine
    return np.degrees(np.arccos(cosine)).ravel(), phi.ravel(), weight.ravel()


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.2, 0.6])
def test_the_reflectance_of_a_lobe_is_its_integral(distribution: str, alpha: float) -> None:
    lobe = Lobe(distribution, alpha, dielectric(1.5))
    theta_o, phi_o, weight = hemisphere()
    for theta_i in (0.0, 45.0, 75.0):
        values = lobe.evaluate(np.full(theta_o.size, theta_i), np.zeros(theta_o.size), theta_o, phi_o)
        assert lobe.albedo(np.array([theta_i]))[0] == pytest.approx(weight @ values, rel=3e-3)


@pytest.mark.parametrize("alpha", [0.2, 0.6])
def test_white_facets_with_light_reflected_more_than_once_reflect_all(alpha: float) -> None:
    lobe = Lobe("ggx", alpha, schlick(np.ones(3)), compensated=True)
    theta, phi, weight = hemisphere()
    for view in (0.0, 45.0, 70.0):
        # From all directions to one direction of view.
        values = lobe.evaluate(theta, phi, np.full(theta.size, view), np.zeros(theta.size))
        assert weight @ values == pytest.approx(np.ones(3), abs=5e-3)
        out = lobe.evaluate(np.full(theta.size, view), np.zeros(theta.size), theta, phi)
        assert lobe.albedo(np.array([view]))[0] == pytest.approx(weight @ out, rel=5e-3)


def test_light_reflected_more_than_once_is_as_in_materialx() -> None:
    """At the normal, rough metal: MaterialX's own rational fit gives E = 0.691 for white facets of width 0.5 (mx_ggx_dir_albedo_analytic)."""
    compensated, once = (Lobe("ggx", 0.5, schlick(np.full(3, 0.8)), added) for added in (True, False))
    at = tuple(np.zeros((4, 1)))
    assert compensated.evaluate(*at) / once.evaluate(*at) == pytest.approx(1 + 0.8 * 0.309 / 0.691, rel=0.03)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_a_lobe_is_that_of_facets_of_the_same_slopes(distribution: str) -> None:
    facet_model = microfacet.build(
        facets.analytic(distribution, 0.3),
        index=optics.refractive_index(1.5),
        multiple_scattering="none",
        diffuse="none",
    )
    at = tuple(
        np.array(angles) for angles in ([20.0, 45.0, 70.0], [0.0] * 3, [30.0, 45.0, 50.0], [180.0, 170.0, 150.0])
    )
    expected = facet_model.bsdf.evaluate(*at).values
    assert Lobe(distribution, 0.3, dielectric(1.5)).evaluate(*at)[:, 0] == pytest.approx(expected, rel=5e-3)


@given(st.floats(0, 85), st.floats(0, 85), st.floats(0, 360), st.floats(0.01, 1.0))
def test_a_lobe_is_reciprocal_and_not_negative(theta_i: float, theta_o: float, phi: float, alpha: float) -> None:
    one, other = np.array([theta_i]), np.array([theta_o])
    lobe, zero, turned = Lobe("ggx", alpha, dielectric(1.5)), np.zeros(1), np.array([phi])
    there, back = lobe.evaluate(one, zero, other, turned), lobe.evaluate(other, turned, one, zero)
    assert (there >= 0).all()
    assert there == pytest.approx(back, rel=1e-9)


@pytest.mark.parametrize("under_lobe", [by_albedo, by_fresnel])
def test_a_white_base_below_a_lobe_reflects_no_more_than_it_receives(under_lobe) -> None:
    for curve in (dielectric(1.5), schlick(np.full(3, 0.04))):
        material = Material(Lobe("ggx", 0.3, curve), np.ones(3), under_lobe)
        assert (material.albedo(np.array([0.0, 30.0, 60.0])) <= 1.02).all()


def test_the_share_of_the_base_is_its_integral() -> None:
    lobe = Lobe("ggx", 0.4, dielectric(1.5))
    theta_o, phi_o, weight = hemisphere(120)
    for under_lobe in (by_albedo, by_fresnel):
        values = under_lobe(lobe, np.full(theta_o.size, 50.0), np.zeros(theta_o.size), theta_o, phi_o)[:, 0] / np.pi
        assert base_share(lobe, under_lobe, np.array([50.0]))[0, 0] == pytest.approx(weight @ values, rel=2e-3)

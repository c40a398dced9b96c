"""Light through a rough interface: the printed value, n²-reciprocity, closure, total internal reflection."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import transmission
from brdfpipe.bsdf.registry import representation


@cache
def interface(a=0.3, n=1.5, masking="height-correlated", **lay):
    table = facets.analytic("beckmann", **lay) if lay else facets.analytic("beckmann", a)
    return microfacet.build(table, index=n, transparent=True, masking=masking)


def through(bsdf, theta, phi=0.0):
    theta = np.atleast_1d(np.asarray(theta, dtype=float))
    return representation(bsdf).transmittance(theta, np.full_like(theta, phi), None)[:, 0]


def test_the_btdf_is_the_printed_one():
    bsdf = interface(0.1 * np.sqrt(2), masking="separable")
    assert float(bsdf.bsdf.evaluate(30, 0, 155, 170)) == pytest.approx(0.6376523682, abs=5e-10)


@given(
    theta_i=st.floats(0, 89.9),
    theta_o=st.floats(90.1, 180),
    phi=st.floats(0, 360),
    a=st.floats(0.05, 2),
    n=st.floats(1.05, 3),
    masking=st.sampled_from(["height-correlated", "separable"]),
)
@settings(max_examples=25, deadline=None)
def test_the_btdf_over_n_squared_is_reciprocal(theta_i, theta_o, phi, a, n, masking):
    with samples.coarse_albedo_tables():
        bsdf = interface.__wrapped__(a, n, masking)
    down, up = (
        float(bsdf.bsdf.evaluate(*directions))
        for directions in ((theta_i, 0, theta_o, phi), (theta_o, phi, theta_i, 0))
    )
    assert np.isfinite([down, up]).all()
    assert min(down, up) >= 0
    # Near the end of its support the facet's two cosines are differences of nearly equal numbers.
    assert down / n**2 == pytest.approx(up, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("azimuth", [0.0, 35.0])
def test_a_lay_is_reciprocal_from_below_as_well(azimuth):
    with samples.coarse_albedo_tables():
        bsdf = interface.__wrapped__(a_x=0.1, a_y=0.4, azimuth=azimuth)
    rng = np.random.default_rng(2)
    above, below = np.degrees(np.arccos(rng.random(200))), 180 - np.degrees(np.arccos(rng.random(200)))
    phi_i, phi_o = 360 * rng.random((2, 200))
    down = bsdf.bsdf.evaluate(above, phi_i, below, phi_o).values
    up = bsdf.bsdf.evaluate(below, phi_o, above, phi_i).values
    assert down / 2.25 == pytest.approx(up, rel=1e-6, abs=1e-9 * down.max())
    inside = bsdf.bsdf.evaluate(below, phi_i, below[::-1], phi_o).values
    back = bsdf.bsdf.evaluate(below[::-1], phi_o, below, phi_i).values
    assert inside == pytest.approx(back, rel=1e-12)


@pytest.mark.cases(3)
@pytest.mark.parametrize("theta", [20.0, 70.0, 115.0, 150.0])
@pytest.mark.parametrize("masking", ["height-correlated", "separable"])
def test_the_transmittance_is_the_btdf_over_the_other_hemisphere(theta, masking):
    bsdf = interface(0.4, masking=masking)
    cos, phi = (np.arange(600) + 0.5) / 600, (np.arange(360) + 0.5)
    polar = np.degrees(np.arccos(cos))
    polar = 180 - polar if theta < 90 else polar
    grid, azimuth = (axis.ravel() for axis in np.meshgrid(polar, phi))
    values = bsdf.bsdf.evaluate(theta, 0.0, grid, azimuth).values
    integral = 2 * np.pi * np.mean(values * np.abs(np.cos(np.radians(grid))))
    # A midpoint rule against a rule over the facets, both across the kink of total reflection.
    assert integral == pytest.approx(through(bsdf, theta)[0], abs=2e-4)


@pytest.mark.cases(5)
@pytest.mark.parametrize("n", [1.0001, 1.5, 3.0])
@pytest.mark.parametrize("a", [1e-3, 0.1, 0.5, 2.0])
def test_reflectance_and_transmittance_sum_to_at_most_1(a, n):
    bsdf = interface(a, n)
    theta = np.array([0, 30, 60, 80, 89, 91, 100, 120, 135, 150, 180.0])
    reflected = representation(bsdf).albedo(theta, 0 * theta, None)[:, 0]
    # Two rules over the facets, each with panels about the kink of total reflection.
    assert (reflected + through(bsdf, theta)).max() <= 1 + 1e-7


@pytest.mark.parametrize(("a", "theta"), [(0.1, 130.0), (0.1, 138.0), (0.3, 135.0), (0.3, 140.0), (1.0, 120.0)])
def test_both_albedos_near_total_reflection_are_those_of_an_adaptive_quadrature(a, theta):
    bsdf, at = interface(a), np.array([theta])
    reflected = representation(bsdf).integrate(at, np.zeros(1), None)
    passed = representation(bsdf).integrate(at, np.zeros(1), None, transmitted_side=True)
    assert representation(bsdf).albedo(at, np.zeros(1), None)[0, 0] == pytest.approx(
        float(reflected.value.ravel()[0]), abs=2e-6
    )
    assert through(bsdf, theta)[0] == pytest.approx(float(passed.value.ravel()[0]), abs=2e-6)


def test_facets_of_small_slopes_lose_no_light():
    bsdf = interface(0.01)
    theta = np.array([0, 30, 60, 150.0, 180.0])
    total = representation(bsdf).albedo(theta, 0 * theta, None)[:, 0] + through(bsdf, theta)
    assert total == pytest.approx(1.0, abs=1e-7)


def test_beyond_the_critical_angle_facets_of_small_slopes_reflect_everything():
    bsdf = interface(1e-3)
    assert representation(bsdf).albedo(np.array([130.0]), np.zeros(1), None)[0, 0] == pytest.approx(1.0, abs=1e-6)
    assert through(bsdf, 130.0)[0] == pytest.approx(0.0, abs=1e-9)


def test_a_smooth_interface_sends_all_light_into_two_directions():
    bsdf = microfacet.build(facets.flat(), index=1.5, transparent=True)
    theta = np.array([0.0, 60.0, 150.0, 130.0])
    mirrored, refracted = representation(bsdf).specular(theta, 0 * theta, None)
    assert mirrored[:, 0] == pytest.approx(
        [0.04, 0.0891867, optics.fresnel(np.cos(np.pi / 6), 1 / 1.5).mean, 1.0], abs=1e-6
    )
    assert (mirrored + refracted)[:, 0] == pytest.approx(1.0, abs=1e-15)
    assert (bsdf.bsdf.evaluate(30.0, 0.0, [30.0, 160.0], 180.0).values == 0).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"index": optics.refractive_index(1.5), "masking": "blinn"}, "not defined for transmission"),
        ({"index": optics.refractive_index(1.5), "multiple_scattering": "compensated"}, "opaque bodies alone"),
    ],
)
def test_modes_without_transmission_are_refused(options, said):
    with pytest.raises(microfacet.ModelError, match=said):
        microfacet.build(facets.analytic("beckmann", 0.2), transparent=True, **options)


def test_a_rough_interface_to_an_index_of_1_is_refused():
    with pytest.raises(microfacet.ModelError, match="the index of the body below a rough interface is 1"):
        interface(0.2, 1.0)


def test_every_masking_of_transmission_is_1_for_flat_facets():
    for masking in transmission.MASKING.values():
        assert masking(np.zeros(1), np.zeros(1)) == pytest.approx(1.0)

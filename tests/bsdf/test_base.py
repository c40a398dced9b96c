"""Defaults that follow from ``evaluate`` alone: the adaptive integral over both sides, and its error."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import synthetic
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe import facets, flakes, psd
from brdfpipe.bsdf import flake, lambert_gauss, microfacet, slab, wave
from brdfpipe.bsdf.lambert_gauss_fit import fit_lambert_gauss
from brdfpipe.bsdf.registry import representation

THETA = np.array([0.0, 8.0, 30.0, 60.0, 80.0, 85.0, 89.0])


def quadrature(bsdf, theta, phi=0.0, **options):
    theta = np.atleast_1d(np.asarray(theta, dtype=float))
    return representation(bsdf).integrate(theta, np.full_like(theta, phi), None, **options)


@pytest.mark.parametrize("a", [1e-4, 1e-3, 0.01, 0.1, 1.0])
def test_a_lobe_of_unknown_width_is_integrated(a):
    # Against the model's own albedo, an integral over the facets.
    bsdf = microfacet.build(facets.analytic("beckmann", a), index=1.55, multiple_scattering="none")
    integral = quadrature(bsdf, THETA)
    own = representation(bsdf).albedo(THETA, np.zeros_like(THETA), None)
    assert integral.value == pytest.approx(own, rel=2e-6)
    assert (integral.error <= 1.001e-6 * integral.value).all()


def test_a_lay_is_integrated_at_every_azimuth():
    bsdf = microfacet.build(
        facets.analytic("beckmann", a_x=0.05, a_y=0.3, azimuth=25.0), index=1.5, multiple_scattering="none"
    )
    for phi in (0.0, 70.0):
        own = representation(bsdf).albedo(np.array([55.0]), np.array([phi]), None)
        # The model's own albedo of a lay is good to 1e-4.
        assert quadrature(bsdf, 55.0, phi).value == pytest.approx(own, rel=1e-4)


SYMMETRIC = {
    "facets": lambda: samples.beckmann_bsdf(0.2, reflectance=None),
    "interface": lambda: microfacet.build(facets.analytic("beckmann", 0.1), index=1.5, transparent=True),
    "several reflections": lambda: samples.beckmann_bsdf(0.4, reflectance=None, multiple_scattering="directional"),
    "waves": lambda: wave.build(
        psd.analytic("gaussian", sigma=0.05, length=5.0), facets=facets.analytic("beckmann", 0.02), index=1.5
    ),
    "slab": lambda: slab.build(facets.flat(), facets.analytic("beckmann", 0.4), index=1.5),
    "flakes": lambda: flake.build(
        flakes.ingest(
            {
                "colours": [
                    {"geometry": f"45as{angle}", "lab": [lightness, 0, 0]}
                    for angle, lightness in ((15, 90), (45, 50), (110, 30))
                ],
                "illuminant": "D65",
                "observer": 10,
            }
        ),
        index=1.5,
        model="flake-physical",
        clear_coat=0.05,
    ),
    "Lambert and Gauss": lambda: fit_lambert_gauss(samples.beckmann_bsdf(0.2, reflectance=None), theta_i=[0, 45]),
}


@pytest.mark.parametrize("material", SYMMETRIC)
def test_a_model_that_is_symmetric_about_the_plane_of_incidence_says_so(material):
    model = representation(SYMMETRIC[material]())
    assert model.mirror_symmetric
    rng = np.random.default_rng(4)
    theta_i, theta_o, phi_i, turn = (rng.uniform(0, high, 300) for high in (180, 180, 360, 180))
    left, right = (model.evaluate(theta_i, phi_i, theta_o, phi_i + side * turn, None) for side in (-1, 1))
    # Rounding of the azimuths moves steep flanks of narrow lobes.
    assert left == pytest.approx(right, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("material", ["facets", "Lambert and Gauss"])
def test_half_of_the_azimuths_of_a_symmetric_bsdf_have_half_of_its_light(material, monkeypatch):
    bsdf = SYMMETRIC[material]()
    half = quadrature(bsdf, 75.0, 20.0)
    monkeypatch.setattr(type(representation(bsdf)), "mirror_symmetric", False)
    # Cells of equal error are halved in another order.
    assert half.value == pytest.approx(quadrature(bsdf, 75.0, 20.0).value, rel=1e-8)


def test_both_sides_of_an_interface_are_integrated():
    bsdf = microfacet.build(facets.analytic("beckmann", 0.01), index=1.5, transparent=True)
    theta = np.array([0.0, 60.0, 160.0])
    reflected, passed = quadrature(bsdf, theta), quadrature(bsdf, theta, transmitted_side=True)
    own = representation(bsdf).transmittance(theta, np.zeros(3), None)
    assert passed.value == pytest.approx(own, rel=1e-5)
    # The loss by multiple reflection is negligible for such small slopes.
    assert reflected.value + passed.value == pytest.approx(1.0, abs=1e-4)


def test_a_lambertian_is_exact():
    bsdf = lambert_gauss.lambertian(samples.spectrum(0.5)).bsdf.nonspectral()
    assert quadrature(bsdf, [0.0, 60.0, 89.9]).value == pytest.approx(0.5, rel=1e-9)


@given(theta=st.floats(0, 70), phi=st.floats(-180, 180), kappa=st.floats(1, 1500), incidence=st.floats(0, 89.9))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_lobe_in_any_direction_is_integrated(monkeypatch, theta, phi, kappa, incidence):
    # κ = 1500 is a standard deviation of 1.5°. The lobe integrates to 1 minus the part below the horizon.
    bsdf = synthetic.register(monkeypatch, synthetic.cap_lobe(theta, phi, kappa))
    integral = quadrature(bsdf, incidence)
    below = np.exp(-kappa * (1 - np.sin(np.radians(theta))))
    assert float(integral.value[0, 0]) <= 1 + 2e-6
    assert float(integral.value[0, 0]) >= 1 - below - 2e-6


def test_the_stated_error_covers_an_integral_that_does_not_converge(monkeypatch):
    # A step along a line that no cell follows cannot be integrated to 1e-12.
    def step(_w_i, w_o):
        return (w_o[..., 0] + 0.3 * w_o[..., 1] > 0.2).astype(float)

    bsdf = synthetic.register(monkeypatch, step)
    integral = quadrature(bsdf, 30.0, relative=1e-12)
    assert integral.error[0, 0] > 1e-12 * integral.value[0, 0]
    # The step cuts a cap off the projected disc: π/2 − asin(d) − d √(1 − d²) with d = 0.2 / √1.09.
    d = 0.2 / np.sqrt(1.09)
    expected = np.pi / 2 - np.arcsin(d) - d * np.sqrt(1 - d * d)
    assert abs(integral.value[0, 0] - expected) <= integral.error[0, 0]


def test_many_wavelengths_and_incidences_are_integrated_together():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=np.linspace(0.1, 0.6, samples.WAVELENGTH.size))
    theta = np.array([[10.0, 50.0], [20.0, 70.0]])
    reflectance = representation(bsdf).integrate(theta, np.zeros_like(theta), None).value
    assert reflectance.shape == (2, 2, 85)
    assert reflectance == pytest.approx(representation(bsdf).albedo(theta, np.zeros_like(theta), None), rel=2e-6)


def test_no_incidences_give_no_values():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=None)
    assert representation(bsdf).integrate(np.empty(0), np.empty(0), None).value.shape == (0, 1)


def test_mirror_reflection_is_part_of_the_albedo_and_not_of_the_integral():
    bsdf = microfacet.build(facets.flat(), index=1.5)
    at = np.array([0.0]), np.zeros(1)
    mirror, straight = representation(bsdf).specular(*at, None)
    assert mirror[0, 0] == pytest.approx(0.04, rel=1e-9)
    assert straight[0, 0] == 0
    assert quadrature(bsdf, 0.0).value[0, 0] == 0
    assert float(bsdf.bsdf.albedo(0.0)) == pytest.approx(0.04, rel=1e-9)


def test_the_transmitted_ray_follows_snell_from_either_side():
    bsdf = microfacet.build(facets.flat(), index=1.5, transparent=True)
    into = representation(bsdf).refracted(np.array([0.0, 30.0, 90.0]))
    assert into == pytest.approx(180 - np.degrees(np.arcsin(np.array([0, 0.5, 1]) / 1.5)))
    out = representation(bsdf).refracted(np.array([180.0, into[1], 120.0]))
    assert out[:2] == pytest.approx([0.0, 30.0], abs=1e-6)
    assert np.isnan(out[2])


def test_an_opaque_material_transmits_nothing():
    assert (samples.beckmann_bsdf(0.1).bsdf.transmittance([0.0, 45.0]).values == np.zeros((2, 85))).all()

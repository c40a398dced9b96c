"""Scaled slopes: the same facets, steeper by a factor."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.scaling import scaled_surface
from brdfpipe.geometry import half_vector


@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
@pytest.mark.parametrize("factor", [0.5, 1.07, 3.0])
def test_a_scaled_density_is_the_one_of_the_scaled_width(distribution, factor):
    scaled, expected = (
        facets.scaled(facets.analytic(distribution, 0.1), factor),
        facets.analytic(distribution, 0.1 * factor),
    )
    for name in ("slope_density", "D", "lambda_smith", "slope_rms", "slope", "alpha", "theta"):
        # The tables are made at the same nodes, but for the rounding of the factor; Λ by a quadrature worth 1e-9.
        np.testing.assert_allclose(scaled[name], expected[name], rtol=1e-7, atol=1e-300, err_msg=name)
    assert scaled["slope"].attrs == expected["slope"].attrs


@pytest.mark.parametrize("factor", [0.6, 1.3])
def test_a_scaled_lay_is_that_of_scaled_widths(factor):
    scaled = facets.scaled(facets.analytic("beckmann", a_x=0.05, a_y=0.15, azimuth=30), factor)
    expected = facets.analytic("beckmann", a_x=0.05 * factor, a_y=0.15 * factor, azimuth=30)
    for name in (
        "slope_density",
        "lambda_smith",
        "slope_rms",
        "anisotropy",
        "lay",
        "slope_along",
        "theta",
        "phi",
        "alpha",
    ):
        np.testing.assert_allclose(scaled[name], expected[name], rtol=1e-7, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(scaled["D"], expected["D"], rtol=1e-6, atol=1e-9)
    assert scaled["slope_along"].attrs["scale"] == pytest.approx(0.05 * factor)
    generator = np.random.default_rng(1)
    theta_i, theta_o = generator.uniform(0, 80, (2, 200))
    phi_i, phi_o = generator.uniform(0, 360, (2, 200))
    pair = half_vector(theta_i, phi_i, theta_o, phi_o)
    brdf = [Microsurface.of(table).reflected(pair, phi_i, phi_o, "height-correlated") for table in (scaled, expected)]
    np.testing.assert_allclose(*brdf, rtol=1e-6, atol=1e-12)


@given(factor=st.floats(0.01, 100))
@settings(max_examples=20, deadline=None)
def test_scaling_back_gives_the_facets_again(factor):
    start = facets.estimate(samples.gaussian_surface(128, sigma=0.1), isotropic=True)
    back = facets.scaled(facets.scaled(start, factor), 1 / factor)
    assert set(back.variables) == set(start.variables)
    for name in start.variables:
        assert back[name].dims == start[name].dims
        assert back[name].attrs == start[name].attrs
        if name == "uncertainty_source":
            assert (back[name] == start[name]).all()
        else:
            np.testing.assert_allclose(back[name], start[name], rtol=1e-9, atol=1e-12)


def test_counts_stay_and_uncertainties_follow_the_density():
    start = facets.estimate(samples.gaussian_surface(256, sigma=0.1), isotropic=True)
    scaled = vocabulary.validate(facets.scaled(start, 1.5), "facets")
    np.testing.assert_array_equal(scaled["count"], start["count"])
    np.testing.assert_allclose(scaled["D_u"].values * start["D"].values, start["D_u"].values * scaled["D"].values)
    assert float(scaled["slope_rms"]) == pytest.approx(1.5 * float(start["slope_rms"]))


def test_the_density_of_a_lay_stays_as_uncertain_as_it_was():
    height = samples.gaussian_surface(256, sigma=0.1)
    stretched = height.assign_coords(x=height["x"] * 2).assign_attrs(pitch_x=2.0)
    start = facets.estimate(stretched, isotropic=False)
    scaled = facets.scaled(start, 0.7)
    np.testing.assert_allclose(
        scaled["slope_density_u"].values * start["slope_density"].values,
        start["slope_density_u"].values * scaled["slope_density"].values,
    )


def test_flat_facets_stay_flat():
    assert facets.scaled(facets.flat(), 2.0).identical(facets.flat())


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_an_invalid_scale_factor_is_refused(factor):
    with pytest.raises(facets.FacetError, match="accepted: a factor above 0"):
        facets.scaled(facets.analytic("beckmann", 0.1), factor)


def test_the_surface_alone_is_scaled_as_all_facets_are():
    start = facets.analytic("ggx", 0.2)
    alone, scaled = scaled_surface(start, 0.7), facets.scaled(start, 0.7)
    for name in alone.variables:
        np.testing.assert_array_equal(alone[name], scaled[name], err_msg=name)

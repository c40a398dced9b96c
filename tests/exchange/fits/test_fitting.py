"""Fits of shading models: known parameters are found, and the stated error is that of the fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.exchange.fits.fitting import Fit, Form, checked
from brdfpipe.exchange.fits.fitting import fit as fit_light
from brdfpipe.exchange.fits.forms import by_albedo, by_fresnel, dielectric
from brdfpipe.exchange.fits.light import ReflectedLight, index_of, is_smooth
from brdfpipe.exchange.registry import ExchangeError


def fit(bsdf: xr.Dataset, form: Form) -> Fit:
    return fit_light(ReflectedLight(bsdf), form)


def form(distribution: str = "beckmann", index: float | None = 1.55) -> Form:
    return Form(distribution, dielectric, by_albedo, index)


def test_the_width_of_facets_is_found() -> None:
    found = fit(samples.beckmann_bsdf(0.2), form())
    # Beckmann's width is √2 times the slope rms of one axis.
    assert found.material.lobe.alpha == pytest.approx(0.2 * np.sqrt(2), rel=0.02)
    assert found.median < 0.05
    assert found.delta_e < 2


def test_an_unknown_index_is_found_with_the_width() -> None:
    found = fit(samples.beckmann_bsdf(0.2), form(index=None))
    assert found.index == pytest.approx(1.55, abs=0.05)
    assert found.material.lobe.alpha == pytest.approx(0.2 * np.sqrt(2), rel=0.03)


def test_another_distribution_fits_worse() -> None:
    bsdf = samples.beckmann_bsdf(0.2)
    assert fit(bsdf, form("ggx")).median > 1.5 * fit(bsdf, form("beckmann")).median


def test_the_colour_of_the_base_is_that_of_the_material() -> None:
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, 85))
    found = fit(red, form())
    assert found.material.base[0] > 2 * found.material.base[2]
    assert found.delta_e < 2


def test_a_perfect_diffuser_has_hardly_a_lobe() -> None:
    found = fit(lambertian(samples.spectrum(0.5)), form(index=None))
    assert found.index < 1.15
    assert found.median < 0.01


def test_a_smooth_face_has_no_width_and_its_base() -> None:
    smooth = microfacet.build(facets.flat(), index=optics.refractive_index(1.5), spectrum=samples.spectrum(0.3))
    assert is_smooth(smooth)
    assert not is_smooth(samples.beckmann_bsdf(0.1))
    found = fit(smooth, form(index=1.5))
    assert found.median < 0.1
    # OpenPBR does not reduce the base by what the face reflects of the incident light: at 75 degree a quarter of 0.3, of 0.25 + 0.75 * 0.3.
    assert found.albedo < 0.25 * 0.3 / (0.25 + 0.75 * 0.3)


def test_an_index_of_several_wavelengths_is_weighted_with_luminance() -> None:
    bsdf = samples.beckmann_bsdf(0.2).drop_vars("n")
    assert index_of(bsdf) == (None, 0.0)
    slope = bsdf.assign(n=("wavelength", np.linspace(1.6, 1.5, bsdf.sizes["wavelength"])))
    assert 1.545 < index_of(slope)[0] < 1.56


def test_a_lay_is_refused() -> None:
    with pytest.raises(ExchangeError, match="lay"):
        fit(samples.brushed_bsdf(0.3, 0.1), form())


def test_a_fit_beyond_a_limit_is_refused_with_its_error_and_the_key() -> None:
    found = fit(samples.beckmann_bsdf(0.2), form())
    assert checked(found, 0.25, 5.0, "OpenPBR") is found
    with pytest.raises(ExchangeError, match=r"OpenPBR.*BRDF·cos θ_o.*`largest_error: 1e-06`"):
        checked(found, 1e-6, 5.0, "OpenPBR")
    with pytest.raises(ExchangeError, match=r"CIEDE2000.*`largest_delta_e: 1e-06`"):
        checked(found, 0.25, 1e-6, "OpenPBR")
    with pytest.raises(ExchangeError, match="largest_error is 0"):
        checked(found, 0, 5.0, "OpenPBR")


def test_the_index_of_a_mean_over_wavelengths_has_its_weights() -> None:
    """A nonspectral BSDF of waves keeps n at each mixed wavelength, with the weight of each."""
    mixed = xr.Dataset(
        {"n": ("mixed", [1.4, 1.6, 2.0]), "k": ("mixed", [0.0, 0.0, 1.0]), "mixture": ("mixed", [0.5, 0.4, 0.1])}
    )
    assert index_of(mixed) == pytest.approx((0.5 * 1.4 + 0.4 * 1.6 + 0.1 * 2.0, 0.1))


@pytest.mark.parametrize("under_lobe", [by_fresnel, by_albedo])
def test_a_free_index_of_a_black_surface_reflects_what_the_surface_does(under_lobe: Any) -> None:
    """A black body below facets of n = 1.55: the lobe alone reflects, and GGX has a higher peak than Beckmann for the same light."""
    black = samples.beckmann_bsdf(0.02, reflectance=0.045)
    found = fit(black, Form("ggx", dielectric, under_lobe, None))
    assert found.index == pytest.approx(1.55, abs=0.05)
    assert found.albedo < 0.1
    assert found.luminous_base < 0.002


def test_the_base_of_a_dark_matt_surface_is_not_what_the_lobe_misses_at_grazing_incidence() -> None:
    """The surface reflects 0.045 at 8 degree, of which the face reflects nearly all: little is left for the base."""
    dark = samples.beckmann_bsdf(0.1, reflectance=0.045)
    found = fit(dark, Form("ggx", dielectric, by_albedo, 1.55))
    assert found.luminous_base < 0.003

"""Errors of approximate forms: zero for what is equal, and known where it is made up."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import approximation_error as comparison
from brdfpipe.bsdf import lambert_gauss, microfacet


def dispersive(spread, mean=1.5):
    index = xr.Dataset(
        {"n": ("wavelength", mean + spread * np.array([1.0, 0.0, -1.0])), "k": ("wavelength", np.zeros(3))},
        coords={"wavelength": [360.0, 550.0, 780.0]},
        attrs={"source": "synthetic"},
    )
    return vocabulary.label(index, "index")


def test_a_form_that_is_too_bright_by_a_factor_has_that_error():
    weight, model = np.array([1.0, 2.0]), np.array([0.3, 0.1])
    assert comparison.misfit(weight, 1.1 * model, model) == pytest.approx((0.1, 0.1, 0.1))


def test_only_black_matches_black():
    weight, nothing = np.ones(2), np.zeros(2)
    assert comparison.misfit(weight, nothing, nothing) == (0, 0, 0)
    assert comparison.misfit(weight, np.ones(2), nothing).rms == np.inf


def test_a_neutral_index_is_averaged_without_error():
    bsdf = samples.beckmann_bsdf(0.1, reflectance=np.linspace(0.1, 0.6, 85))
    error = bsdf.bsdf.nonspectral_error()
    assert float(error["rms"].max()) < 1e-12
    vocabulary.validate(error, "nonspectral")


def test_a_bsdf_without_wavelengths_has_no_error():
    assert float(samples.beckmann_bsdf(0.1, reflectance=None).bsdf.nonspectral_error()["largest"].max()) == 0
    matt = lambert_gauss.lambertian(samples.spectrum(np.linspace(0, 1, 85)))
    assert float(matt.bsdf.nonspectral_error()["rms"].max()) < 1e-12


def test_the_error_of_averaging_a_dispersive_index_is_of_second_order():
    errors = []
    for spread in (0.02, 0.04):
        bsdf = microfacet.build(facets.analytic("beckmann", 0.05), index=dispersive(spread), multiple_scattering="none")
        errors.append(bsdf.bsdf.nonspectral_error(np.ones(3), [0.0, 60.0])["rms"].values)
    assert errors[1][1] / errors[0][1] == pytest.approx(4.0, rel=0.02)
    # The one index has the mean reflectance of the three at normal incidence, and another at 60° by as much as its second
    # derivative differs.
    n = np.array([1.52, 1.5, 1.48])
    amplitude = np.sqrt(np.mean(((n - 1) / (n + 1)) ** 2))
    mean = optics.fresnel(0.5, n).mean.mean()
    alone = optics.fresnel(0.5, (1 + amplitude) / (1 - amplitude)).mean
    assert errors[0][1] == pytest.approx(abs(1 - alone / mean), rel=0.1)
    assert errors[0][0] < 1e-6


def test_a_lay_is_compared_on_both_sides_of_the_plane_of_incidence():
    bsdf = microfacet.build(
        facets.analytic("beckmann", a_x=0.1, a_y=0.3, azimuth=30.0), index=1.5, multiple_scattering="none"
    )
    rule = comparison.directions(bsdf, 40.0, 70.0)
    assert rule.weight.sum() == pytest.approx(np.pi, rel=1e-7)
    # Few directions, for a measure of two digits.
    flux = rule.weight @ comparison.brdf_at(bsdf, 40.0, 70.0, rule)[:, 0]
    assert flux == pytest.approx(float(bsdf.bsdf.albedo(40.0, 70.0)), rel=4e-3)

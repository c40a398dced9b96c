"""Lambert + Gaussian: evaluated by its formula, and fitted back."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.bsdf import lambert_gauss_fit as fitting
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.lambert_gauss import FWHM
from brdfpipe.errors import VocabularyError


def lobe(peak=5.0, parallel=10.0, perpendicular=6.0, rho=0.2, theta_i=(0.0, 30.0, 60.0)):
    ones = np.ones(len(theta_i))
    return vocabulary.label(
        xr.Dataset(
            {
                "lambert": ("theta_i", rho * ones),
                "gauss_peak": ("theta_i", peak * ones),
                "gauss_fwhm_parallel": ("theta_i", parallel * ones),
                "gauss_fwhm_perpendicular": ("theta_i", perpendicular * ones),
            },
            coords={"theta_i": list(theta_i)},
            attrs={"representation": "lambert_gauss"},
        ),
        "bsdf",
    )


def test_the_lobe_peaks_at_the_mirror_direction_and_halves_at_half_its_width():
    bsdf = lobe(rho=0.0)
    assert float(bsdf.bsdf.evaluate(30, 0, 30, 180)) == pytest.approx(5.0)
    assert bsdf.bsdf.evaluate(30, 0, [25, 35], 180).values == pytest.approx(2.5)


def test_a_lambertian_is_the_same_in_every_direction():
    bsdf = lambert_gauss.lambertian(samples.spectrum(0.5))
    values = bsdf.bsdf.evaluate([0, 30, 89], 0, [80, 0, 89], [0, 90, 180], wavelength=[400, 700]).values
    assert values == pytest.approx(0.5 / np.pi)
    assert (bsdf.bsdf.albedo([0.0, 60.0, 89.0]).values == 0.5).all()
    integral = representation(bsdf).integrate(np.array([0.0, 60.0, 89.0]), np.zeros(3), None)
    assert integral.value == pytest.approx(0.5, abs=1e-9)
    assert "Add a `surface`" in vocabulary.warnings(bsdf)[0]


def test_a_diffuse_part_of_incidence_and_wavelength_together_is_refused():
    bsdf = lambert_gauss.lambertian(samples.spectrum(0.5))
    both = bsdf["lambert"].broadcast_like(bsdf["gauss_peak"]).transpose("theta_i", "wavelength")
    with pytest.raises(VocabularyError, match=r"'lambert' has dimensions \('theta_i', 'wavelength'\)"):
        vocabulary.validate(bsdf.assign(lambert=both), "bsdf")


@pytest.mark.parametrize(("fwhm", "ratio"), [(5, 0.99794), (10, 0.99181), (20, 0.96781)])
def test_the_small_angle_formula_of_the_reflectance_errs_as_printed(fwhm, ratio):
    # R_gauss ≈ 2π G0 σ⊥ σ∥ cos θ_i; the references are exact over approximate.
    bsdf = lobe(peak=1.0, parallel=fwhm, perpendicular=fwhm, rho=0.0)
    sigma = np.radians(fwhm / FWHM)
    theta = 30.0
    exact = float(bsdf.bsdf.albedo(theta))
    assert exact / (2 * np.pi * sigma**2 * np.cos(np.radians(theta))) == pytest.approx(ratio, abs=1e-4)


@pytest.mark.parametrize("theta", [0.0, 30.0, 60.0])
def test_a_fit_recovers_the_parameters_of_its_own_form(theta):
    fit = fitting.fit_lambert_gauss(lobe(), [theta])
    assert float(fit["lambert"][0]) == pytest.approx(0.2, rel=1e-6)
    assert float(fit["gauss_peak"][0]) == pytest.approx(5.0, rel=1e-6)
    assert float(fit["gauss_fwhm_parallel"][0]) == pytest.approx(10.0, rel=1e-6)
    assert float(fit["gauss_fwhm_perpendicular"][0]) == pytest.approx(6.0, rel=1e-6)
    assert float(fit["fit_residual"][0]) < 1e-6
    assert float(fit["fit_error_max"][0]) < 1e-5
    # The reflectance of the model is a quadrature to 1e-6.
    assert float(fit["reflectance_error"][0]) == pytest.approx(0, abs=1e-6)


def test_a_lambertian_has_no_lobe_to_fit():
    fit = fitting.fit_lambert_gauss(lambert_gauss.lambertian(samples.spectrum(0.5)), [0.0, 45.0])
    assert fit["lambert"].values == pytest.approx(0.5, rel=1e-9)
    assert (fit["gauss_peak"].values == 0).all()


def test_black_fits_to_nothing():
    fit = fitting.fit_lambert_gauss(lambert_gauss.lambertian(samples.spectrum(0.0)), [30.0])
    assert (fit["lambert"].values, fit["gauss_peak"].values) == (0, 0)


def test_a_fit_of_a_real_lobe_states_its_residual_and_keeps_the_flux():
    bsdf = samples.beckmann_bsdf(0.08)
    fit = fitting.fit_lambert_gauss(bsdf, [0.0, 30.0, 45.0])
    total = (fit["lambert"] + fit["gauss_reflectance"]).values
    # The fit minimises the flux-weighted square, it does not conserve the flux: a lobe that is no Gaussian costs half a percent.
    assert total == pytest.approx(bsdf.bsdf.nonspectral().bsdf.albedo([0.0, 30.0, 45.0]).values, rel=0.006)
    assert (fit["fit_residual"].values < 0.2).all()
    assert (fit["fit_residual"].values > 0).all()
    model = bsdf.bsdf.nonspectral().bsdf.albedo([0.0, 30.0, 45.0]).values
    assert fit["reflectance_error"].values == pytest.approx(total / model - 1, abs=1e-5)
    assert (fit["fit_error_max"] > fit["fit_residual"]).all()


@pytest.mark.parametrize("a", [0.7, 2.0])
def test_a_lobe_wider_than_the_hemisphere_is_left_to_the_lambertian_part(a):
    bsdf = microfacet.build(
        facets.analytic("ggx", a), index=1.5, spectrum=samples.spectrum(0.3), multiple_scattering="none"
    )
    fit = fitting.fit_lambert_gauss(bsdf, [0.0, 20.0, 30.0, 60.0])
    widths = fit[["gauss_fwhm_parallel", "gauss_fwhm_perpendicular"]].to_array()
    assert float(widths.max()) <= 90 * (1 + 1e-9)
    assert (fit["gauss_reflectance"].values < 0.3).all()


@pytest.mark.parametrize("sigma", [1e-4, 1e-3])
def test_a_very_narrow_lobe_is_fitted_with_its_flux(sigma):
    fit = fitting.fit_lambert_gauss(samples.beckmann_bsdf(sigma, reflectance=None), [0.0, 45.0])
    albedo = samples.beckmann_bsdf(sigma, reflectance=None).bsdf.albedo([0.0, 45.0]).values
    assert fit["gauss_reflectance"].values == pytest.approx(albedo, rel=0.002)


def test_parameters_between_incidences_are_interpolated():
    bsdf = lobe()
    bsdf["gauss_peak"][:] = [1.0, 3.0, 5.0]
    assert float(bsdf.bsdf.evaluate(15, 0, 15, 180)) == pytest.approx(2.0 + 0.2 / np.pi)


def test_a_weighted_mean_of_a_lambertian_is_the_mean_reflectance():
    bsdf = lambert_gauss.lambertian(samples.spectrum(np.linspace(0, 1, 85)))
    assert float(nonspectral(bsdf, np.ones(85))["lambert"]) == pytest.approx(0.5)


def test_a_fit_of_a_lay_warns_that_it_is_valid_for_one_azimuth():
    bsdf = samples.brushed_bsdf(0.05, 0.1, 90.0)
    fit = fitting.fit_lambert_gauss(bsdf, [0.0])
    assert "the surface has a lay" in vocabulary.warnings(fit)[0]
    # The steep slopes, of 0.1 along x turned by 90°, are those along x: the lobe is wide in the plane of incidence's y.
    ratio = float(fit["gauss_fwhm_parallel"][0] / fit["gauss_fwhm_perpendicular"][0])
    assert ratio == pytest.approx(2.0, rel=0.05)


def test_a_single_incidence_needs_no_list():
    alone, listed = (fitting.fit_lambert_gauss(lobe(), angle) for angle in (30.0, [30.0]))
    assert alone.identical(listed)


def test_incidences_in_two_dimensions_are_refused():
    with pytest.raises(VocabularyError, match=r"theta_i of a fit .* shape \(1, 2\)"):
        fitting.fit_lambert_gauss(lobe(), [[0.0, 30.0]])

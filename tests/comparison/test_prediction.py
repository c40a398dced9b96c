"""Predictions with changed inputs and their uncertainty, against rebuilt BSDFs and against integrals."""

from __future__ import annotations

import comparison_primary
import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.comparison import scan_uncertainty as scan
from brdfpipe.comparison.measurement import Measurement
from brdfpipe.comparison.prediction import NOMINAL, Predicted, PredictionInputs, PredictionModel

CHOICES = [{}, {"masking": "crf", "diffuse": "crf"}, {"multiple_scattering": "compensated"}]
PRIOR_U = {"index": 0.02, "slope": 0.1, "diffuse": 0.05}


def spectrum(**options) -> xr.Dataset:
    return samples.spectrum(0.05 + 0.3 * (samples.WAVELENGTH > 540), **options)


def seen_by(bsdf: xr.Dataset, every: int = 5) -> Measurement:
    primary = comparison_primary.measured(bsdf, None, incidences=(10.0, 60.0), wavelengths=(500.0, 600.0))
    return Measurement.of(primary.isel(cell=slice(None, None, every)), np.array([0, 1]))


# --- BSDFs


@pytest.mark.cases(1)
@pytest.mark.parametrize("choices", CHOICES)
def test_without_a_change_the_prediction_is_built_again(choices) -> None:
    finish, reflectance = facets.analytic("beckmann", 0.2), spectrum()
    predicted = microfacet.build(finish, index="PMMA", spectrum=reflectance, **choices)
    again = PredictionInputs.of(predicted, finish, "PMMA", reflectance).bsdf(NOMINAL)
    for name in predicted.variables:
        # The facets are scaled by 1, of which their angles take the rounding.
        np.testing.assert_allclose(again[name], predicted[name], rtol=1e-9, atol=1e-300)


@pytest.mark.cases(2)
@pytest.mark.parametrize("geometry", ["sci", "sce"])
@pytest.mark.parametrize("choices", CHOICES[:2])
def test_a_darker_base_is_that_of_a_darker_spectrum(choices, geometry) -> None:
    finish, reflectance = facets.analytic("beckmann", 0.2), spectrum(geometry=geometry)
    predicted = microfacet.build(finish, index=1.5, spectrum=reflectance, **choices)
    darker = PredictionInputs.of(predicted, finish, 1.5, reflectance).bsdf({**NOMINAL, "diffuse": 0.8})
    lost = darker["total_reflectance"] - predicted["total_reflectance"]
    expected = microfacet.build(
        finish,
        index=1.5,
        spectrum=reflectance.assign(total_reflectance=reflectance["total_reflectance"] + lost.values),
        **choices,
    )
    np.testing.assert_allclose(darker["diffuse"], 0.8 * predicted["diffuse"], rtol=1e-12)
    np.testing.assert_allclose(darker["diffuse"], expected["diffuse"], rtol=1e-6)
    np.testing.assert_allclose(darker["total_reflectance"], expected["total_reflectance"], rtol=1e-9)


def test_a_steeper_finish_and_a_higher_index_are_those_of_a_build() -> None:
    predicted = microfacet.build(
        facets.analytic("beckmann", 0.2), index=1.5, spectrum=spectrum(), multiple_scattering="none"
    )
    changed = PredictionInputs.of(predicted, facets.analytic("beckmann", 0.2), 1.5, spectrum()).bsdf(
        {"index": 0.1, "slope": 1.5, "diffuse": 1.0}
    )
    expected = microfacet.build(
        facets.analytic("beckmann", 0.3), index=1.6, spectrum=spectrum(), multiple_scattering="none"
    )
    angles = (40.0, 0.0, np.linspace(0, 80, 9), 180.0, [500.0, 600.0])
    np.testing.assert_allclose(changed.bsdf.evaluate(*angles), expected.bsdf.evaluate(*angles), rtol=1e-6)


def test_the_index_of_a_clear_body_stays_above_that_of_air_and_a_metals_may_fall_below() -> None:
    given = {
        index: PredictionInputs(facets.flat(), optics.refractive_index({"n": 1.1, "k": index}), None, {})
        for index in (0, 5)
    }
    assert [float(inputs.shifted(xr.DataArray(1.1), -0.3)) for inputs in given.values()] == pytest.approx([1.001, 0.8])


@pytest.mark.cases(1)
@pytest.mark.parametrize("choices", [{"multiple_scattering": "none"}, *CHOICES])
def test_the_derivatives_are_those_of_rebuilt_bsdfs(choices) -> None:
    finish = facets.analytic("beckmann", 0.25)
    predicted = microfacet.build(finish, index=1.5, spectrum=spectrum(), **choices)
    measurement = seen_by(predicted, 20)
    model = PredictionModel(
        PredictionInputs.of(predicted, finish, 1.5, spectrum(), measurement.wavelength), measurement, PRIOR_U
    )
    slopes = model.at(np.array([0.5, -0.5, 0.5])).slopes()
    for row, step in enumerate(0.2 * np.eye(3)):
        ends = [model.at(np.array([0.5, -0.5, 0.5]) + way * step).values for way in (-1, 1)]
        expected = (ends[1] - ends[0]) / 0.4
        used = measurement.used
        # To 3 % of the largest: the base is differentiated at one place and forwards.
        assert np.abs(slopes[row] - expected)[used].max() < 0.03 * np.abs(expected[used]).max()


# --- what cells resolve


def test_the_unresolved_part_of_a_cell_is_of_fourth_order_in_its_side() -> None:
    predicted = microfacet.build(facets.analytic("beckmann", 0.03), index=1.5, multiple_scattering="none")
    primary = comparison_primary.measured(predicted, None, incidences=(10.0,), wavelengths=(500.0,))
    halved = primary.assign_coords(solid_angle=primary["solid_angle"] / 4)
    wide, narrow = (Predicted(predicted, Measurement.of(dataset, np.array([0]))).own_u for dataset in (primary, halved))
    middle = primary["theta_s"].values < 3
    assert np.median(wide[0, 0, middle] / narrow[0, 0, middle]) == pytest.approx(16, rel=0.1)
    assert not wide[0, 0, ~(primary["solid_angle"].values > 0)].any()


def test_the_mean_over_a_cell_is_its_middle_plus_curvature_and_remainder() -> None:
    """A Gaussian lobe over a square cell at the mirror direction, against its integral in closed form."""
    from scipy.special import erf

    a, side = 0.04, np.radians(2.0)
    predicted = microfacet.build(facets.analytic("beckmann", a), index=1.5, masking="none")
    primary = comparison_primary.measured(predicted, None, incidences=(0.0,), wavelengths=(500.0,))
    primary["solid_angle"][0] = side**2
    measurement = Measurement.of(primary, np.array([0]))
    assert measurement.theta_s[0] == 0
    remainder, curved = (effect[0, 0, 0] for effect in Predicted(predicted, measurement)._cell_effects)
    width = 2 * a / np.sqrt(2)  # of the lobe [rad]: reflection doubles the tilt
    peak = float(predicted.bsdf.evaluate(0, 0, 0, 0))
    mean = np.sqrt(np.pi / 2) * 2 * width / side * erf(side / (2 * np.sqrt(2) * width))
    curvature = -2 * peak / width**2 * np.exp(-(side**2) / (8 * width**2)) * mean
    # In the tangent plane, and without 1/cos: those are of second order in the width.
    assert curved == pytest.approx(side**2 / 24 * curvature, rel=0.01)
    assert remainder == pytest.approx(peak * mean**2 - peak - side**2 / 24 * curvature, rel=0.1)


def test_wider_angles_on_the_disc_are_a_common_change() -> None:
    """Of a Gaussian lobe about the mirror direction at normal incidence: f changes by −f θ²/w² of the change; fibres do not."""
    a, u = 0.04, 0.003
    predicted = microfacet.build(facets.analytic("beckmann", a), index=1.5, masking="none")
    primary = comparison_primary.measured(predicted, None, incidences=(0.0,), wavelengths=(500.0,))
    measurement = Measurement.of(primary.assign_attrs(disc_scale_u=u), np.array([0]))
    prediction = Predicted(predicted, measurement)
    inside, theta = measurement.of_disc & (measurement.theta_s < 5), np.radians(measurement.theta_s)
    change = prediction.common[2][0, 0]
    assert not change[~measurement.of_disc].any()
    width = 2 * a / np.sqrt(2)
    relative = change[inside] / prediction.values[0, 0, inside]
    np.testing.assert_allclose(relative, -u * theta[inside] ** 2 / width**2, atol=0.03 * u, rtol=0.05)


# --- what a scan leaves uncertain


@pytest.fixture(scope="module")
def scanned() -> xr.Dataset:
    return facets.estimate(samples.gaussian_surface(256, sigma=0.1, correlation=6, seed=2), isotropic=True)


@pytest.fixture(scope="module")
def with_lay() -> xr.Dataset:
    rng = np.random.default_rng(3)
    size = 256
    frequency = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size))
    shape = np.exp(-((np.pi * frequency[0] * 6) ** 2 + (np.pi * frequency[1] * 14) ** 2) / 2)
    height = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * shape).real
    return facets.estimate(samples.surface(0.5 * height / height.std()), isotropic=False)


def test_at_its_values_the_density_has_the_stated_uncertainty(scanned, with_lay) -> None:
    picked = scanned.isel(alpha=slice(0, 40, 3))
    slope = np.tan(np.radians(picked["alpha"].values))
    for turn in (0.0, 0.7, 2.0):
        u = scan.relative_u(scanned, slope * np.cos(turn), slope * np.sin(turn))
        np.testing.assert_allclose(u, picked["D_u"] / picked["D"], rtol=1e-9)
    corner = with_lay.isel(slope_along=slice(100, 140, 7), slope_across=slice(90, 130, 7))
    lay = np.radians(float(with_lay["lay"]))
    along, across = np.meshgrid(corner["slope_along"], corner["slope_across"])
    p, q = along * np.cos(lay) - across * np.sin(lay), along * np.sin(lay) + across * np.cos(lay)
    expected = np.minimum(corner["slope_density_u"] / corner["slope_density"], 1)
    np.testing.assert_allclose(scan.relative_u(with_lay, p, q), expected, rtol=1e-6)


@pytest.mark.parametrize("kind", ["scanned", "with_lay"])
def test_beyond_its_table_a_density_is_no_more_certain_than_at_its_end(kind, request) -> None:
    finish = request.getfixturevalue(kind)
    u = scan.relative_u(finish, np.array([50.0, -50.0, 0.0]), np.array([0.0, 0.0, 50.0]))
    assert ((u > 0.2) & (u <= 1)).all()


def test_errors_of_single_values_and_between_them_add_up_to_the_stated_uncertainty(scanned) -> None:
    slope = scanned["slope"].values[:30]
    errors = scan.errors(scanned, slope, np.zeros(30))
    single, wide = errors[: scanned.sizes["slope"]], errors[scanned.sizes["slope"] :]
    np.testing.assert_allclose((single**2).sum(axis=0) + scan.BETWEEN**2, 1, rtol=1e-9)
    np.testing.assert_allclose(wide.sum(axis=0), 1, rtol=1e-9)


def test_facets_of_a_surface_with_a_lay_have_common_errors_along_its_ellipse(with_lay) -> None:
    lay, widths = (
        np.radians(float(with_lay["lay"])),
        [float(with_lay[f"slope_{way}"].attrs["scale"]) for way in ("along", "across")],
    )
    towards = np.array([[np.cos(lay), -np.sin(lay)], [np.sin(lay), np.cos(lay)]]) * widths
    p, q = towards @ np.array([[1.3, 0.0, -1.3], [0.0, 1.3, 0.0]])
    errors = scan.errors(with_lay, p, q)
    np.testing.assert_allclose(errors, errors[:, :1] * np.ones(3), atol=1e-9)


def test_an_assumed_finish_is_certain() -> None:
    finish, slope = facets.analytic("beckmann", 0.1), np.array([0.0, 0.1])
    assert not scan.relative_u(finish, slope, slope).any()
    assert scan.errors(finish, slope, slope).shape == (0, 2)
    assert scan.smooth(finish) is finish


@pytest.mark.parametrize("kind", ["scanned", "with_lay"])
def test_a_smooth_density_is_within_the_uncertainty_of_the_counted_one(kind, request) -> None:
    finish = request.getfixturevalue(kind)
    smooth = scan.smooth(finish)
    ratio = np.log(smooth["slope_density"] / finish["slope_density"]).values
    if kind == "scanned":
        u = (finish["D_u"] / finish["D"]).values
    else:
        u = np.minimum(finish["slope_density_u"] / finish["slope_density"], 1).values
    counted = finish["slope_density"].values > 1e-2 * float(finish["slope_density"].max())
    assert np.sqrt(np.mean((ratio[counted] / u[counted]) ** 2)) < 1.5

"""Measured and predicted BRDF: a known deviation is recovered within its stated uncertainty, and stated in sentences."""

from __future__ import annotations

import json
from collections.abc import Iterator

import comparison_primary
import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.comparison import ComparisonError, findings, measured_predicted

TRUE = {"index": 0.03, "slope": 1.1, "diffuse": 0.95}
SPECTRUM = samples.spectrum(0.05 + 0.3 * (samples.WAVELENGTH > 540))


@pytest.fixture(scope="module", autouse=True)
def coarse_tables() -> Iterator[None]:
    """The noise of the measurement is a hundred times the error of such a table."""
    with samples.coarse_albedo_tables():
        yield


def finish() -> xr.Dataset:
    return facets.analytic("beckmann", 0.15)


@pytest.fixture(scope="module")
def predicted() -> xr.Dataset:
    return microfacet.build(finish(), index=1.5, spectrum=SPECTRUM, multiple_scattering="none")


@pytest.fixture(scope="module")
def deviating() -> xr.Dataset:
    return comparison_primary.deviating(finish(), 1.5, SPECTRUM)


def compare(primary: xr.Dataset, predicted: xr.Dataset, **options) -> xr.Dataset:
    given = {"facets": finish(), "index": 1.5, "spectrum": SPECTRUM, **options}
    return measured_predicted.compare(primary, predicted, **given)


def pulls(comparison: xr.Dataset, true: dict[str, float]) -> np.ndarray:
    """Error of each input over its uncertainty."""
    expected = np.array([true[str(name)] for name in comparison["input"].values])
    return ((comparison["posterior"] - expected) / comparison["posterior_u"]).values


@pytest.fixture(scope="module")
def primary(deviating) -> xr.Dataset:
    """As many values as a rig gives."""
    everywhere = {"incidences": (10.0, 20.0, 30.0, 45.0, 60.0), "wavelengths": np.arange(400.0, 731.0, 10.0)}
    return comparison_primary.measured(deviating, 1, **everywhere)


@pytest.fixture(scope="module")
def comparison(primary, predicted) -> xr.Dataset:
    return compare(primary, predicted)


# --- the fit


def test_a_deviation_is_recovered_within_its_uncertainty(comparison) -> None:
    assert list(comparison["input"].values) == ["index", "slope", "diffuse"]
    assert np.abs(pulls(comparison, TRUE)).max() < 3
    # Far less uncertain than before, or it would be no test.
    assert (comparison["posterior_u"] < 0.2 * comparison["prior_u"]).all()
    before, after = comparison["chi_squared_dof"].values
    assert before > 10
    assert after == pytest.approx(1, abs=4 * np.sqrt(2 / comparison.attrs["values"]))
    assert comparison.attrs["converged"]


def test_the_median_ratio_and_z_show_the_deviation_until_it_is_fitted(comparison) -> None:
    before, after = (comparison.sel(model=model) for model in ("predicted", "adjusted"))
    assert (before["rms_z"] > 2 * after["rms_z"]).all()
    np.testing.assert_allclose(after["median_ratio"], 1, atol=0.05)
    seen = (comparison["seen_reflectance_model"] - comparison["seen_reflectance"]) / comparison["seen_reflectance_u"]
    assert np.abs(seen.sel(model="adjusted")).max() < 4


def test_measured_values_are_passed_on_and_others_are_missing(comparison, primary) -> None:
    chosen = primary.sel(wavelength=comparison["wavelength"])
    np.testing.assert_array_equal(comparison["brdf"], chosen["brdf"])
    both = np.hypot(comparison["brdf_u_independent"], comparison["brdf_u_common"])
    np.testing.assert_allclose(both, comparison["brdf_u"], rtol=1e-12)
    missing = np.isnan(chosen["brdf"].values)
    assert missing.any()
    for name in ("ratio", "z"):
        assert (np.isnan(comparison[name].values) == missing).all()


def test_the_adjusted_bsdf_is_a_complete_bsdf(comparison, predicted) -> None:
    adjusted = measured_predicted.adjusted(comparison, predicted, facets=finish(), index=1.5, spectrum=SPECTRUM)
    incidence, cell = 2, 40
    from brdfpipe.specular_directions import outgoing

    theta_o, phi_o = outgoing(
        *(
            float(coordinate)
            for coordinate in (
                comparison["incidence"][incidence],
                comparison["theta_s"][cell],
                comparison["phi_s"][cell],
            )
        )
    )
    value = adjusted.bsdf.evaluate(
        float(comparison["incidence"][incidence]), 0, theta_o, phi_o, comparison["wavelength"].values
    )
    shown = comparison["brdf_model"].sel(model="adjusted")[incidence, :, cell]
    np.testing.assert_allclose(value.values.ravel(), shown, rtol=1e-6)
    verdicts = json.loads(adjusted.bsdf.check().attrs["verdicts"])
    assert {check["verdict"] for check in verdicts.values()} == {"pass"}


def test_without_a_deviation_nothing_is_changed_beyond_its_uncertainty(predicted) -> None:
    result = compare(comparison_primary.measured(predicted, 2), predicted)
    assert np.abs(pulls(result, {"index": 0.0, "slope": 1.0, "diffuse": 1.0})).max() < 3
    statements = findings.sentences(result)[2:5]
    assert [statement.rpartition(": ")[2] for statement in statements] == ["unchanged within its uncertainty"] * 3
    assert vocabulary.warnings(result) == []


def test_an_input_that_is_certain_is_not_changed(predicted, deviating) -> None:
    primary = comparison_primary.measured(deviating, 1, incidences=(30.0, 60.0))
    result = compare(primary, predicted, index_u=0.0)
    assert list(result["input"].values) == ["slope", "diffuse"]
    certain = compare(primary, predicted, index_u=0.0, slope_u=0.0, diffuse_u=0.0)
    assert list(certain["model"].values) == ["predicted"]
    assert "posterior" not in certain
    with pytest.raises(ComparisonError, match="nothing was fitted"):
        measured_predicted.adjusted(certain, predicted, facets=finish(), index=1.5, spectrum=SPECTRUM)


def test_without_a_base_there_is_none_to_change() -> None:
    bare = microfacet.build(finish(), index=1.5, multiple_scattering="none")
    truth = comparison_primary.deviating(finish(), 1.5)
    result = compare(comparison_primary.measured(truth, 1, incidences=(30.0, 60.0)), bare, spectrum=None)
    assert list(result["input"].values) == ["index", "slope"]
    assert np.abs(pulls(result, TRUE)).max() < 3


@pytest.mark.slow
def test_the_slopes_of_a_metal_are_recovered() -> None:
    index = optics.refractive_index({"n": 1.1, "k": 6.0})
    truth = comparison_primary.deviating(finish(), index, shift=0.0)
    result = compare(
        comparison_primary.measured(truth, 1, incidences=(30.0, 60.0)),
        microfacet.build(finish(), index=index, multiple_scattering="none"),
        index=index,
        spectrum=None,
    )
    assert np.abs(pulls(result, {"index": 0.0, "slope": 1.1})).max() < 3
    # The light of a metal hardly depends on n: the measurement adds nothing to the prior.
    assert "the measurement does not constrain it" in findings.sentences(result)[2]


def test_a_finish_twice_as_rough_is_recovered() -> None:
    truth = comparison_primary.deviating(finish(), 1.5, slope=2.0, shift=0.0)
    primary = comparison_primary.measured(truth, 1, incidences=(30.0, 60.0))
    result = compare(
        primary, microfacet.build(finish(), index=1.5, multiple_scattering="none"), spectrum=None, index_u=0.0
    )
    assert result.attrs["converged"]
    assert result["posterior"].values == pytest.approx([2.0], rel=0.001)
    (warning,) = vocabulary.warnings(result)
    assert "only if the slope scale changes by 10.0 times its assumed standard uncertainty" in warning


def test_a_comparison_takes_few_wavelengths(comparison) -> None:
    assert comparison.sizes["wavelength"] == measured_predicted.MOST_WAVELENGTHS
    assert comparison["wavelength"].values[[0, -1]].tolist() == [400.0, 730.0]


@pytest.mark.slow
def test_uncertainties_of_the_inputs_hold_over_many_seeds(predicted, deviating) -> None:
    result = [compare(comparison_primary.measured(deviating, seed), predicted) for seed in range(100, 124)]
    off = np.array([pulls(dataset, TRUE) for dataset in result])
    # Of 24 an rms is known to 14 %, a mean to 20 %.
    np.testing.assert_allclose(np.sqrt(np.mean(off**2, axis=0)), 1, atol=0.45)
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=0.7)
    scatter = [float(dataset["chi_squared_dof"][-1]) for dataset in result]
    assert np.mean(scatter) == pytest.approx(1, abs=0.005)


@pytest.mark.slow
def test_slopes_of_a_scan_are_recovered_within_the_uncertainty_of_the_scan() -> None:
    """Scans of 512² heights of one surface, each with slopes of its own; the truth is the surface, 5 % rougher."""
    sigma, off = 0.1, []
    truth = comparison_primary.deviating(
        facets.analytic("beckmann", sigma * np.sqrt(2)), 1.5, SPECTRUM, slope=1.05, diffuse=1.0
    )
    for seed in range(8):
        scanned = facets.estimate(samples.gaussian_surface(512, sigma=sigma, correlation=8, seed=seed), isotropic=True)
        predicted = microfacet.build(scanned, index=1.5, spectrum=SPECTRUM, multiple_scattering="none")
        result = compare(comparison_primary.measured(truth, seed), predicted, facets=scanned)
        assert result.attrs["converged"]
        true = {"index": 0.03, "slope": 1.05 * sigma * np.sqrt(2) / float(scanned["slope_rms"]), "diffuse": 1.0}
        off.append(pulls(result, true))
    # A scan is off by more than a scale, so that the factor that describes it best is one of several.
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 2


def displaced(bsdf: xr.Dataset, by: float) -> xr.Dataset:
    """Without errors except a disc displaced by an angle [degree], as stated in the component ``geometry``."""
    primary = comparison_primary.measured(bsdf, None, incidences=(10.0, 30.0))
    theta, phi = primary["theta_s"].values, primary["phi_s"].values
    beside = [primary.assign_coords(theta_s=("cell", theta), phi_s=("cell", phi))]
    for x, y in ((by, 0.0), (0.0, by)):
        across, down = theta * np.cos(np.radians(phi)) + x, theta * np.sin(np.radians(phi)) + y
        seen = comparison_primary.truth(bsdf, beside[0], np.hypot(across, down), np.degrees(np.arctan2(down, across)))
        beside.append(primary.assign(brdf=primary["brdf"].copy(data=np.where(primary["brdf"].notnull(), seen, np.nan))))
    disc = primary["solid_angle"].notnull()
    moved = [abs(shifted["brdf"] - primary["brdf"]).where(disc, 0.0) for shifted in beside[1:]]
    geometry = np.hypot(*moved).transpose(*primary["brdf"].dims).assign_attrs(correlation="independent")
    value = beside[1]["brdf"].where(disc, primary["brdf"]).transpose(*primary["brdf"].dims)
    return vocabulary.label(
        primary.assign(brdf=value, brdf_u_geometry=geometry, brdf_u=np.hypot(primary["brdf_u"], geometry)), "primary"
    )


def test_a_displaced_disc_is_not_mistaken_for_another_finish() -> None:
    narrow = microfacet.build(facets.analytic("beckmann", 0.03), index=1.5, multiple_scattering="none")
    result = compare(displaced(narrow, 0.1), narrow, facets=facets.analytic("beckmann", 0.03), spectrum=None)
    assert np.abs(pulls(result, {"index": 0.0, "slope": 1.0})).max() < 2
    assert float(result["posterior_u"].sel(input="slope")) < 0.02


# --- findings and warnings


def test_findings_state_the_changed_inputs_and_their_changes(comparison) -> None:
    agreement, after, index, slope, diffuse, *_ = findings.sentences(comparison)
    assert agreement.startswith("measured over predicted, median at 10°, 20°, 30°, 45°, 60° of incidence: 0.9")
    assert after.endswith("the prediction describes the measurement")
    assert index.startswith("refractive index 1.5")
    assert index.endswith("the facets reflect as if the index were higher than given")
    assert slope.startswith("slope scale × 1.1")
    assert slope.endswith("the surface scatters as if 10 % rougher than its facets say")
    assert diffuse.startswith("diffuse scale × 0.9")
    assert "darker than the spectrum says" in diffuse


@pytest.mark.parametrize(
    ("value", "u", "words"),
    [
        (1.0704, 0.0113, "1.070 ± 0.011"),
        (-0.02, 0.13, "−0.02 ± 0.13"),
        (1.5, 30.0, "2 ± 30"),
        (1.0, 0.0, "1.0000 ± 0.0000"),
    ],
)
def test_a_value_has_the_decimals_of_its_uncertainty(value, u, words) -> None:
    assert findings.plus_minus(value, u) == words


def test_a_model_of_the_wrong_form_gives_a_warning() -> None:
    truth = microfacet.build(facets.analytic("ggx", 0.1), index=1.5, multiple_scattering="none")
    wrong = microfacet.build(finish(), index=1.5, multiple_scattering="none")
    result = compare(comparison_primary.measured(truth, 1, incidences=(30.0, 60.0)), wrong, spectrum=None, index_u=0.0)
    (warning, *_) = vocabulary.warnings(result)
    assert warning.startswith("no change of the prediction's inputs makes it agree with the measurement")
    assert "they do not explain the difference" in findings.sentences(result)[1]
    assert result.attrs["enlarged"] > 2


LAY = facets.analytic("beckmann", a_x=0.1, a_y=0.25, azimuth=30)


def test_a_surface_with_a_lay_is_compared_with_a_warning() -> None:
    predicted = microfacet.build(LAY, index=1.5, multiple_scattering="none")
    certain = {"index_u": 0.0, "slope_u": 0.0, "spectrum": None}
    result = compare(comparison_primary.measured(predicted, 1, incidences=(30.0,)), predicted, facets=LAY, **certain)
    assert float(result["chi_squared_dof"][0]) == pytest.approx(1, abs=0.1)
    (warning,) = vocabulary.warnings(result)
    assert "has a lay, along 30°, and the rig saw it in one plane of incidence" in warning


@pytest.mark.slow
def test_a_deviation_of_a_surface_with_a_lay_is_recovered() -> None:
    predicted = microfacet.build(LAY, index=1.5, spectrum=SPECTRUM, multiple_scattering="none")
    truth = comparison_primary.deviating(LAY, 1.5, SPECTRUM)
    result = compare(comparison_primary.measured(truth, 1, incidences=(30.0, 60.0)), predicted, facets=LAY)
    assert np.abs(pulls(result, TRUE)).max() < 3


def test_a_prediction_averaged_over_its_lay_is_compared_unchanged() -> None:
    predicted = microfacet.build(LAY, index=1.5, isotropic=True, multiple_scattering="none")
    primary = comparison_primary.measured(predicted, 1, incidences=(30.0, 60.0))
    result = compare(primary, predicted, facets=LAY, spectrum=None, index_u=0.0)
    assert np.abs(pulls(result, {"slope": 1.0})).max() < 3
    assert vocabulary.warnings(result) == []


def test_a_clear_sheet_is_compared_and_not_fitted() -> None:
    sheet = slab.build(finish(), finish(), index=1.5, internal_transmittance=0.9)
    result = compare(comparison_primary.measured(sheet, 1, incidences=(30.0,)), sheet, spectrum=None)
    assert list(result["model"].values) == ["predicted"]
    assert float(result["chi_squared_dof"][0]) == pytest.approx(1, abs=0.3)
    (warning,) = vocabulary.warnings(result)
    assert "(slab) was compared and not fitted" in warning


# --- what is refused


def test_no_common_wavelength_is_refused(predicted) -> None:
    primary = comparison_primary.measured(predicted, None, incidences=(30.0,))
    shifted = primary["wavelength"].copy(data=np.arange(900.0, 1101.0, 50.0))
    primary = primary.assign_coords(wavelength=shifted)
    with pytest.raises(ComparisonError, match="900 to 1100 nm and the prediction covers 360 to 780 nm: they share no"):
        compare(primary, predicted)


def test_nothing_measured_is_refused(predicted) -> None:
    primary = comparison_primary.measured(predicted, None, incidences=(30.0,))
    with pytest.raises(ComparisonError, match="no cell of the rig has a measured value"):
        compare(primary.assign(brdf=primary["brdf"] * np.nan), predicted)


def test_a_flat_surface_is_refused(predicted) -> None:
    flat = microfacet.build(facets.flat(), index=1.5, spectrum=SPECTRUM)
    with pytest.raises(ComparisonError, match="perfectly flat and mirrors light into one single direction"):
        compare(comparison_primary.measured(predicted, None, incidences=(30.0,)), flat, facets=facets.flat())


def test_transmitted_light_is_refused(predicted) -> None:
    primary = comparison_primary.measured(predicted, None, incidences=(30.0,)).assign_attrs(side="transmission")
    with pytest.raises(ComparisonError, match="measured transmitted light"):
        compare(primary, predicted)


@pytest.mark.parametrize(
    "other", [{"index": 1.6}, {"facets": facets.analytic("beckmann", 0.2)}, {"spectrum": samples.spectrum(0.5)}]
)
def test_inputs_that_are_not_those_of_the_prediction_are_refused(predicted, other) -> None:
    with pytest.raises(ComparisonError, match="was not made from these facets"):
        compare(comparison_primary.measured(predicted, None, incidences=(30.0,)), predicted, **other)


@pytest.mark.parametrize("u", [-0.1, np.nan, np.inf])
def test_an_invalid_uncertainty_is_refused(predicted, u) -> None:
    with pytest.raises(ComparisonError, match=r"the input 'slope' is .*; accepted: 0 or more"):
        compare(comparison_primary.measured(predicted, None, incidences=(30.0,)), predicted, slope_u=u)


def test_something_else_than_primary_data_is_refused(predicted) -> None:
    with pytest.raises(vocabulary.VocabularyError, match="expected a dataset of kind 'primary'"):
        compare(predicted, predicted)

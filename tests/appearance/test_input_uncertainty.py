"""Uncertainty of gloss, haze and colours from the inputs of a prediction."""

import numpy as np
import pytest
import random_surfaces
import xarray as xr
from samples import beckmann, beckmann_bsdf, coarse_albedo_tables, gaussian_surface, spectrum, surface

from brdfpipe import facets, optics, vocabulary
from brdfpipe import psd as roughness
from brdfpipe.appearance import gloss
from brdfpipe.appearance.computation import compute_appearance
from brdfpipe.appearance.quantities import quantity, values
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.report import combine, summarise
from brdfpipe.report.material.head import key_numbers
from brdfpipe.report.material.reflection import source_table


def with_model_error(
    bsdf: xr.Dataset,
    relative: float,
    of_gloss: tuple[float, ...] = (),
    last: float = 75.0,
    of_map: tuple[float, ...] = (0.0, 0.0),
    **inputs: xr.Dataset,
) -> xr.Dataset:
    """A BSDF with the same relative error up to a last incidence and not known at 85°, and errors of gloss at 20 and 60°."""
    values = np.full((3, 3), relative)
    values[2] = np.nan
    axes = {"theta_i": [0.0, last, 85.0], "region": ["peak", "shoulder", "rest"]}
    of_both = {"model_gloss_error": of_gloss, "reference_gloss_u": of_map}
    own = {name: ("gloss_angle", [*known, np.nan]) for name, known in of_both.items()}
    changes = uncertainty(
        bsdf,
        relative_error=xr.DataArray(values, axes, ("theta_i", "region")),
        gloss_error=xr.Dataset(own, {"gloss_angle": [20.0, 60.0, 85.0]}) if of_gloss else None,
        spectrum=spectrum(0.3),
        **inputs,
    )
    return bsdf.merge(changes, combine_attrs="override")


@pytest.fixture(scope="module")
def index_alone() -> tuple[xr.Dataset, xr.Dataset]:
    """A BSDF whose index is uncertain, and its appearance."""
    bsdf = microfacet.build(beckmann(0.1), index=1.5, spectrum=spectrum(0.3), multiple_scattering="none")
    changes = uncertainty(bsdf, index=optics.refractive_index(1.5, uncertainty=0.01), spectrum=spectrum(0.3))
    bsdf = bsdf.merge(changes, combine_attrs="override")
    bsdf.attrs |= {"uncertainty_not_stated": changes.attrs["uncertainty_not_stated"]}
    return bsdf, compute_appearance(bsdf)


def test_gloss_is_as_uncertain_as_the_difference_to_another_index(index_alone):
    _, appearance = index_alone
    higher = gloss(microfacet.build(beckmann(0.1), index=1.51, spectrum=spectrum(0.3), multiple_scattering="none"))
    found = appearance["gloss_u_source"].sel(source="index")
    np.testing.assert_allclose(found, higher - appearance["gloss"], rtol=0.02, atol=1e-3)


def test_sources_and_instrument_add_in_quadrature(index_alone):
    _, appearance = index_alone
    exact = compute_appearance(
        microfacet.build(beckmann(0.1), index=1.5, spectrum=spectrum(0.3), multiple_scattering="none")
    )
    assert "gloss_u_source" not in exact
    for name in ("gloss", "haze", "reflectance_haze"):
        parts = appearance[f"{name}_u_source"]
        np.testing.assert_allclose(parts.sel(source="instrument"), exact[f"{name}_u"])
        np.testing.assert_allclose(np.hypot(*parts.values), appearance[f"{name}_u"])
        np.testing.assert_array_equal(appearance[name], exact[name])


def test_a_total_reflectance_is_not_better_known_than_its_spectrum(index_alone):
    _, appearance = index_alone
    assert np.isnan(appearance["lab_u"].sel(geometry="8:total")).all()
    assert np.isnan(appearance["luminous_reflectance_u"])
    # The index changes how light a grey is, and by rounding alone its hue.
    assert float(appearance["lab_u"].sel(geometry="45as15", component="L*")) > 0


def test_errors_of_two_receptors_that_go_together_partly_cancel_in_a_haze():
    bsdf = with_model_error(beckmann_bsdf(0.03, reflectance=0.05), 0.1)
    appearance = compute_appearance(bsdf)
    of_gloss = appearance["gloss_u_source"].sel(source="model", gloss_angle=[20, 60]).values
    of_haze = float(appearance["haze_u_source"].sel(source="model"))
    assert of_haze == pytest.approx(abs(of_gloss[1] - of_gloss[0]), rel=1e-9)
    assert of_haze < np.hypot(*of_gloss)


def test_where_a_reference_states_gloss_its_error_is_that_of_gloss_and_not_of_the_light_by_region():
    # The light is known to 10 % everywhere, gloss at 20 and 60 degree much worse and much better than that.
    bsdf = with_model_error(beckmann_bsdf(0.03, reflectance=0.05), 0.1, (-36.0, 1e-3)).fillna({"relative_error": 0.1})
    appearance = compute_appearance(bsdf)
    of_model = appearance["gloss_u_source"].sel(source="model").values
    np.testing.assert_allclose(of_model[:2], [36.0, 1e-3])
    assert float(appearance["haze_u_source"].sel(source="model")) == pytest.approx(36.001)
    # Of gloss at 85 degree and of a haze beside the mirror direction nothing is stated: there the light counts.
    by_light = compute_appearance(bsdf.drop_vars("model_gloss_error"))
    for name, at in (("gloss", {"gloss_angle": 85}), ("reflectance_haze", {})):
        found, expected = (one[f"{name}_u_source"].sel(source="model", **at) for one in (appearance, by_light))
        assert (expected > 0.01).all()
        np.testing.assert_array_equal(found, expected)


def test_gloss_whose_error_is_not_known_has_the_uncertainty_of_the_other_sources():
    appearance = compute_appearance(with_model_error(beckmann_bsdf(0.03, reflectance=0.05), 0.01, (-36.0, 1e-3)))
    of_model = appearance["gloss_u_source"].sel(source="model")
    assert np.isnan(of_model[2])
    others = appearance["gloss_u_source"].sel(gloss_angle=85).drop_sel(source="model")
    assert float(appearance["gloss_u"].sel(gloss_angle=85)) == pytest.approx(float(np.hypot.reduce(others.values)))


def test_light_that_finer_roughness_may_scatter_adds_to_a_known_error_of_gloss():
    # A scan shows its reference solution no more than the prediction.
    plateau = roughness.analytic("gaussian", sigma=1.0, length=500.0).assign(unresolved_sigma=0.03)
    bsdf = with_model_error(beckmann_bsdf(0.03, reflectance=0.05), 0.1, (3.0, -4.0), psd=plateau)
    finer = bsdf.drop_vars("model_gloss_error").assign(relative_error=bsdf["finer_roughness_loss"])
    of_both, of_finer = (compute_appearance(one)["gloss_u_source"].sel(source="model")[:2] for one in (bsdf, finer))
    assert (of_finer > 1).all()
    np.testing.assert_allclose(of_both, np.hypot([3.0, 4.0], of_finer.values))


def test_that_a_map_is_finite_counts_once():
    counted = facets.estimate(gaussian_surface(128, correlation=8.0), isotropic=True)
    bsdf = microfacet.build(counted, index=1.5, multiple_scattering="none")
    of_facets = compute_appearance(bsdf.merge(uncertainty(bsdf, facets=counted), combine_attrs="override"))
    u = of_facets["gloss_u_source"].sel(source="facets").values[:2]
    assert (u > 0.01).all()
    # The reference knows the surface half as well at 20 degree as the facets, and twice as well at 60.
    error = 0.3 * u
    given = with_model_error(bsdf, 0.1, tuple(error), of_map=(2 * u[0], 0.5 * u[1]), facets=counted)
    parts = compute_appearance(given)["gloss_u_source"][:, :2]
    np.testing.assert_allclose(parts.sel(source="facets"), u)
    np.testing.assert_allclose(parts.sel(source="model"), [np.hypot(error[0], np.sqrt(3) * u[0]), error[1]])


def test_a_colour_beyond_the_last_known_incidence_has_no_error_of_the_model():
    appearance = compute_appearance(with_model_error(beckmann_bsdf(0.1), 0.1, last=30.0))
    of_colour = appearance["lab_u_source"].sel(source="model", component="L*")
    assert np.isnan(of_colour.sel(geometry="45as15"))
    assert np.isfinite(appearance["lab_u"].sel(geometry="45as15")).all()
    of_gloss = appearance["gloss_u_source"].sel(source="model")
    assert np.isfinite(of_gloss).values.tolist() == [True, False, False]
    assert np.isfinite(appearance["gloss_u"]).all()


def test_the_page_and_the_catalogue_show_the_uncertainty(index_alone):
    bsdf, appearance = index_alone
    datasets = {"facets": beckmann(0.1), "bsdf": bsdf.assign_attrs(route="predicted"), "appearance": appearance}
    table = source_table(datasets)
    assert [row[0] for row in table.rows] == ["Refractive index", "Instrument", "All together"]
    assert "Not known, and none assumed: facets counted, reflectance spectrum, model." in table.note
    tiles = {tile.name: tile.value for tile in key_numbers(datasets, values(datasets))}
    value, u = float(appearance["gloss"].sel(gloss_angle=60)), float(appearance["gloss_u"].sel(gloss_angle=60))
    assert tiles["Gloss 60°"] == f"{value:.1f}\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}{u:.1f}"
    row = combine([summarise({name: one.assign_attrs(stage=name, material="m") for name, one in datasets.items()})])
    assert row["gloss_60_u"].item() == pytest.approx(u)
    assert np.isnan(row["luminous_reflectance_u"].item())


def meter_readings(height: np.ndarray, noise: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Gloss at 20, 60 and 85° and G60 − G20 of a map of 1 um pitch, and their uncertainty without that of the instrument."""
    axis = np.arange(float(len(height)))
    attributes = {"pitch_x": 1.0, "pitch_y": 1.0, "levelling": "plane", "band": "1 um pitch"}
    surface = vocabulary.label(
        xr.Dataset({"height": (("y", "x"), height)}, {"y": axis, "x": axis}, attributes), "surface"
    )
    counted = facets.estimate(surface, isotropic=True, noise=noise)
    with coarse_albedo_tables():
        bsdf = microfacet.build(counted, index=1.5, multiple_scattering="none")
    appearance = compute_appearance(bsdf.merge(uncertainty(bsdf, facets=counted), combine_attrs="override"))
    values, parts = (
        np.append(appearance[f"gloss{name}"].values, appearance[f"haze{name}"].values[..., None], axis=-1)
        for name in ("", "_u_source")
    )
    return values, np.sqrt(np.square(parts[:-1]).sum(axis=0))


@pytest.mark.slow
def test_thirty_maps_scatter_in_gloss_and_haze_as_each_states():
    spectrum_of_heights = random_surfaces.gaussian(0.4, 8.0)
    maps = [random_surfaces.heights(spectrum_of_heights, (256, 256), (1.0, 1.0), seed) for seed in range(500, 530)]
    readings, u = map(np.array, zip(*(meter_readings(height, 0.0) for height in maps), strict=True))
    ratio = np.sqrt(np.mean(np.square(u), axis=0)) / readings.std(axis=0, ddof=1)
    assert (ratio > 0.8).all()
    assert (ratio < 1.3).all()


@pytest.mark.slow
def test_ten_polished_maps_scatter_in_gloss_as_each_states():
    # σ 50 nm, 32 correlation lengths of 2 µm wide. The scatter of ten maps is known to 1/√18.
    sampling = 1 / np.sqrt(18)
    readings, variance = [], []
    for seed in range(100, 110):
        height = random_surfaces.heights(random_surfaces.gaussian(0.05, 2.0), (256, 256), (0.25, 0.25), seed)
        scan = surface(height, (0.25, 0.25))
        counted, psd = facets.estimate(scan, isotropic=True, noise=0.0), roughness.estimate(scan, noise=0.0)
        with coarse_albedo_tables():
            predicted = microfacet.build(counted, index=1.5, multiple_scattering="none")
            bsdf = wave.build(psd, index=1.5, facets=counted, predicted=predicted, optics="auto", wavelength=[550.0])
        changes = uncertainty(bsdf, facets=counted, psd=psd)
        appearance = compute_appearance(bsdf.merge(changes, combine_attrs="override"))
        readings.append(appearance["gloss"].values)
        variance.append(np.square(appearance["gloss_u_source"].drop_sel(source="instrument")).sum("source").values)
    ratio = np.sqrt(np.mean(variance, axis=0)) / np.std(readings, axis=0, ddof=1)
    assert (ratio > 0.8 * (1 - sampling)).all()
    assert (ratio < 1.3 * (1 + sampling)).all()


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
def test_gloss_of_noisy_maps_is_within_its_uncertainty_of_that_without_noise(share):
    z = []
    for seed in range(600, 606):
        height = random_surfaces.heights(random_surfaces.gaussian(0.6, 12.0), (256, 256), (1.0, 1.0), seed)
        noisy = height + np.random.default_rng(seed).normal(0, share * 0.6, height.shape)
        (clean, _), (found, u) = meter_readings(height, 0.0), meter_readings(noisy, None)
        z.append((found - clean) / u)
    # An rms of six values of one standard uncertainty exceeds 1.5 in 3 of 100 cases.
    assert (np.sqrt(np.mean(np.square(z), axis=0)) < 1.5).all()


def test_a_tolerance_alone_is_no_uncertainty_of_a_material():
    appearance = compute_appearance(beckmann_bsdf(0.1))
    assert np.isnan(quantity("gloss_60").uncertainty({"appearance": appearance}))
    assert source_table({"appearance": appearance}) is None


def test_the_appearance_has_the_declared_variables(index_alone):
    vocabulary.validate(index_alone[1], "appearance")

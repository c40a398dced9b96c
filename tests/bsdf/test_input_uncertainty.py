"""Changes of a predicted BSDF by its inputs, against the BSDF that is built anew with the changed input."""

import numpy as np
import pytest
import random_surfaces
import xarray as xr
from samples import beckmann, beckmann_bsdf, coarse_albedo_tables, spectrum, surface

from brdfpipe import facets, hemisphere, optics, vocabulary
from brdfpipe import psd as roughness
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.change_variables import between_phases
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations import wave as representations_wave
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.radial_density import RadialDensity

AT = np.array([10.0, 45.0, 45.0, 70.0]), np.zeros(4), np.array([15.0, 45.0, 0.0, 60.0]), np.full(4, 180.0), None


def uncertain_facets(factor: float = 1.02) -> xr.Dataset:
    """A Gaussian finish whose slopes are uncertain by a common factor."""
    given = beckmann(0.2)
    slope = given["slope"].values
    steeper = RadialDensity(slope, given["slope_density"].values)((slope / factor) ** 2) / factor**2
    change = RadialDensity(slope, np.maximum(steeper, 1e-300)).normalised().density - given["slope_density"].values
    fields = {"slope_density_change": (("uncertain_change", "slope"), change[None])}
    return vocabulary.label(
        given.assign(fields).assign_coords(uncertainty_source=("uncertain_change", ["facets"])), "facets"
    )


def index_of(n: float, u: float | None = None) -> xr.Dataset:
    return optics.refractive_index(n, uncertainty=u)


def with_u(reflectance: float, u: float, **options) -> xr.Dataset:
    given = spectrum(reflectance, **options)
    return vocabulary.label(given.assign(total_reflectance_u=xr.full_like(given["total_reflectance"], u)), "spectrum")


def beside(bsdf: xr.Dataset, **inputs) -> xr.Dataset:
    """A BSDF with the changes by its inputs."""
    changes = vocabulary.validate(uncertainty(bsdf, **inputs), "uncertainty")
    return vocabulary.validate(bsdf.merge(changes, combine_attrs="override"), "bsdf")


def assert_changes_as_rebuilt(bsdf: xr.Dataset, rebuilt: xr.Dataset, *, within: float) -> None:
    changes, given = SourceChanges(bsdf), representation(bsdf)
    found = changes.of_brdf(*AT)[0]
    wanted = representation(rebuilt).evaluate(*AT) - given.evaluate(*AT)
    assert np.abs(wanted).max() > 0
    np.testing.assert_allclose(found, wanted + 0 * found, atol=within * np.abs(wanted).max())
    incidence = np.array([8.0, 60.0, 80.0]), np.zeros(3), None
    albedo = representation(rebuilt).albedo(*incidence) - given.albedo(*incidence)
    np.testing.assert_allclose(
        changes.of_albedo(*incidence)[0], albedo + 0 * found[:3], atol=2e-5 + within * np.abs(albedo).max()
    )


@pytest.mark.parametrize("geometry", ["sci", "sce"])
def test_an_index_changes_the_bsdf_as_if_it_was_built_with_it(geometry):
    given = spectrum(0.3, geometry=geometry)
    options = {"spectrum": given, "multiple_scattering": "none"}
    bsdf = microfacet.build(beckmann(0.2), index=1.5, **options)
    rebuilt = microfacet.build(beckmann(0.2), index=1.505, **options)
    assert_changes_as_rebuilt(beside(bsdf, index=index_of(1.5, 0.005), spectrum=given), rebuilt, within=0.02)


@pytest.mark.parametrize("reflectance", [None, 0.3, 0.9])
def test_facets_change_the_bsdf_as_if_it_was_built_with_them(reflectance):
    given = uncertain_facets()
    base = None if reflectance is None else spectrum(reflectance)
    options = {"index": 1.5, "spectrum": base, "multiple_scattering": "none"}
    bsdf = microfacet.build(given, **options)
    rebuilt = microfacet.build(facets.scaled(beckmann(0.2), 1.02), **options)
    inputs = {"facets": given, "spectrum": options["spectrum"]}
    assert_changes_as_rebuilt(beside(bsdf, **inputs), rebuilt, within=0.01)


def test_a_spectrum_changes_the_base_alone():
    options = {"index": 1.5, "multiple_scattering": "none"}
    bsdf = microfacet.build(beckmann(0.2), spectrum=spectrum(0.3), **options)
    rebuilt = microfacet.build(beckmann(0.2), spectrum=spectrum(0.31), **options)
    found = beside(bsdf, spectrum=with_u(0.3, 0.01))
    assert_changes_as_rebuilt(found, rebuilt, within=1e-6)
    total = SourceChanges(found).of_albedo(np.array([8.0]), np.zeros(1), None)
    np.testing.assert_allclose(total, 0.01, rtol=1e-6)


def test_a_colour_alone_is_as_uncertain_as_its_spectrum():
    bsdf = lambertian(with_u(0.3, 0.01))
    found = beside(bsdf, spectrum=with_u(0.3, 0.01))
    np.testing.assert_allclose(found.bsdf.uncertainty(30, 0, 10, 0), 0.01 / np.pi)
    assert found.bsdf.uncertainty_sources == ("spectrum",)


def test_a_polished_face_is_uncertain_by_its_index():
    bsdf = microfacet.build(facets.flat(), index=1.5, spectrum=spectrum(0.3))
    rebuilt = microfacet.build(facets.flat(), index=1.51, spectrum=spectrum(0.3))
    changes = SourceChanges(beside(bsdf, index=index_of(1.5, 0.01), spectrum=spectrum(0.3)))
    at = np.array([20.0, 60.0]), np.zeros(2), None
    found = changes.changed[0].specular(*at)[0] - changes.given.specular(*at)[0]
    wanted = representation(rebuilt).specular(*at)[0] - changes.given.specular(*at)[0]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_all_directions_of_a_source_change_together_and_sources_are_independent():
    given = uncertain_facets()
    bsdf = microfacet.build(given, index=1.5, spectrum=spectrum(0.3), multiple_scattering="none")
    found = beside(bsdf, facets=given, index=index_of(1.5, 0.005), spectrum=with_u(0.3, 0.003))
    angles = 45, 0, [45, 40, 0], 180
    parts = [found.bsdf.uncertainty(*angles, source=source) for source in found.bsdf.uncertainty_sources]
    assert found.bsdf.uncertainty_sources == ("facets", "index", "spectrum")
    np.testing.assert_allclose(found.bsdf.uncertainty(*angles), np.sqrt(sum(part**2 for part in parts)))
    with pytest.raises(VocabularyError, match="no uncertainty from the source 'psd'; known: facets, index, spectrum"):
        found.bsdf.uncertainty(*angles, source="psd")


def test_the_uncertainty_of_a_mean_over_wavelength_is_that_of_all_wavelengths_together():
    given = uncertain_facets()
    index = vocabulary.label(index_of("ABS").assign(n_u=lambda one: 0 * one["n"] + 0.005), "index")
    bsdf = microfacet.build(given, index=index, spectrum=spectrum(0.3), multiple_scattering="none")
    found = beside(bsdf, facets=given, index=index, spectrum=with_u(0.3, 0.003))
    mean = SourceChanges(nonspectral(found)).of_brdf(*AT)[..., 0]
    by_wavelength = SourceChanges(found).of_brdf(*AT)
    assert (mean >= by_wavelength.min(axis=-1) - 1e-4 * np.abs(mean)).all()
    assert (mean <= by_wavelength.max(axis=-1) + 1e-4 * np.abs(mean)).all()


def model_error(peak: float, shoulder: float, rest: float) -> xr.DataArray:
    theta = [0.0, 30.0, 60.0, 75.0]
    values = np.tile([peak, shoulder, rest], (4, 1))
    return xr.DataArray(values, {"theta_i": theta, "region": ["peak", "shoulder", "rest"]}, ("theta_i", "region"))


def test_the_error_of_the_model_is_that_of_the_light_the_surface_reflects():
    bsdf = beckmann_bsdf(0.1)
    found = beside(bsdf, relative_error=model_error(0.03, 0.1, 0.4))
    assert found.bsdf.uncertainty_sources == ("model",)
    without = representation(bsdf).without_diffuse()
    for theta_o, relative in ((45, 0.03), (0, 0.4)):
        lobe = representation(without).evaluate(*np.array([[45.0], [0.0], [theta_o], [180.0]]), None)[0, 0]
        u = found.bsdf.uncertainty(45, 0, theta_o, 180).values.max()
        assert u == pytest.approx(relative * lobe, rel=1e-6)
    # Light that is moved stays part of the total.
    np.testing.assert_allclose(found.bsdf.albedo_uncertainty([8, 60]), 0)


def test_that_the_map_is_finite_counts_once_in_the_light_of_a_region():
    bsdf, steeper = beckmann_bsdf(0.2, reflectance=None), beckmann_bsdf(0.2 * 1.02, reflectance=None)
    error, of_reference = model_error(0.03, 0.1, 0.4), model_error(0.05, 0.001, 0.0)
    stated = uncertainty(bsdf, facets=uncertain_facets(1.02), relative_error=error, reference_light_u=of_reference)[
        "relative_error"
    ].sel(error_theta=30.0)
    # The light in the peak, and how 2 % steeper slopes change it.
    rule = hemisphere.around_mirror(30.0, 0.2)
    at = np.full_like(rule.theta, 30.0), np.zeros_like(rule.theta), rule.theta, rule.phi, None
    given, changed = (representation(one).evaluate(*at)[:, 0] for one in (bsdf, steeper))
    weight = rule.weight * (given > 0.3 * given.max())
    of_map = weight @ changed / (weight @ given) - 1
    assert 0.01 < abs(of_map) < 0.05
    assert np.hypot(stated.sel(region="peak"), of_map) == pytest.approx(np.hypot(0.03, 0.05), rel=0.02)
    # Facets state more of the shoulder than the reference scatters.
    assert stated.sel(region="shoulder") == pytest.approx(0.1)
    assert stated.sel(region="rest") == pytest.approx(0.4)


def test_beyond_the_last_known_incidence_the_error_of_the_model_is_stated_as_unknown():
    error = model_error(0.03, 0.1, 0.4)
    found = beside(beckmann_bsdf(0.1), relative_error=error.where(error["theta_i"] < 60), index=index_of(1.5, 0.01))
    stated = uncertainty(beckmann_bsdf(0.1), relative_error=error.where(error["theta_i"] < 60))
    assert stated.attrs["uncertainty_not_stated"] == "facets, index, model beyond 30°"
    at = [30, 60], 0, [30, 60], 180
    assert np.isfinite(found.bsdf.uncertainty(*at)).all()
    of_model = found.bsdf.uncertainty(*at, source="model")
    np.testing.assert_allclose(found.bsdf.uncertainty(*at)[1], found.bsdf.uncertainty(*at, source="index")[1])
    assert (of_model[0] > 0).all()
    assert not of_model[1].any()


def test_an_error_that_is_not_known_is_no_source():
    bsdf = beckmann_bsdf(0.1)
    unknown = model_error(np.nan, np.nan, np.nan)
    found = uncertainty(bsdf, relative_error=unknown, spectrum=spectrum(0.3))
    assert found.attrs["uncertainty_not_stated"] == "facets, index, spectrum, model"
    with pytest.raises(VocabularyError, match="'microfacet' states no uncertainty; those that do"):
        bsdf.merge(found, combine_attrs="override").bsdf.uncertainty(30, 0, 30, 180)


def test_total_reflection_and_black_bases_stay_within_their_ranges():
    bsdf = microfacet.build(uncertain_facets(), index=1.5, spectrum=spectrum(0.041), multiple_scattering="none")
    inputs = {"facets": uncertain_facets(), "index": index_of(1.5, 0.3), "spectrum": with_u(0.041, 0.02)}
    found = beside(bsdf, **inputs)
    for changed in SourceChanges(found).changed:
        assert (changed.evaluate(*AT) >= 0).all()
        assert (changed.albedo(np.array([0.0, 89.0]), np.zeros(2), None) <= 1).all()


def test_noise_that_is_stated_exactly_is_named_as_not_stated():
    noisy = vocabulary.label(uncertain_facets().assign(noise_sigma=0.01, noise_sigma_u=0.0), "facets")
    bsdf = microfacet.build(noisy, index=1.5, multiple_scattering="none")
    assert uncertainty(bsdf, facets=noisy).attrs["uncertainty_not_stated"] == "noise, index, model"


def test_the_noise_of_a_spectrum_changes_all_frequencies_together():
    height = random_surfaces.heights(random_surfaces.gaussian(0.03, 5.0), (128, 128), (0.5, 0.5), 1)
    height += np.random.default_rng(3).normal(0, 0.004, height.shape)
    psd = roughness.estimate_joined([surface(height, (0.5, 0.5))], noise=0.004, noise_uncertainty=0.0008)
    bsdf = wave.build(psd, index=1.5, wavelength=550.0)
    changes = SourceChanges(beside(bsdf, psd=psd))
    assert set(changes.sources) == {"psd", "noise"}
    (after,) = (
        one.dataset for one, source in zip(changes.of_inputs, changes.sources, strict=True) if source == "noise"
    )
    area = np.pi * (float(psd["band_high"]) ** 2 - float(psd["band_low"]) ** 2)
    # S falls by 2 σ u ΔA in all of the band, and what goes on beyond it with its last ring.
    expected = -2 * 0.004 * 0.0008 * 0.25 * area / (2 * float(bsdf["sigma"]))
    assert float(after["sigma"] - bsdf["sigma"]) == pytest.approx(expected, rel=0.3)
    # That of another instrument is independent of the first.
    change = psd["psd_noise_change"]
    of_two = psd.drop_dims("uncertain_noise").assign(
        psd_noise_change=xr.concat([change, 0.5 * change], "uncertain_noise")
    )
    assert list(uncertainty(bsdf, psd=of_two)["uncertainty_source"].values).count("noise") == 2


@pytest.fixture(scope="module")
def polished() -> tuple[xr.Dataset, xr.Dataset, float]:
    """Roughness spectrum and facets of a polished map, and its rms height [um]."""
    height = random_surfaces.heights(random_surfaces.gaussian(0.03, 5.0), (128, 128), (0.5, 0.5), 1)
    scan = surface(height, (0.5, 0.5))
    return roughness.estimate(scan, noise=0.0), facets.estimate(scan, isotropic=True, noise=0.0), float(height.std())


def by_waves(psd: xr.Dataset, counted: xr.Dataset, wavelength: list[float]) -> xr.Dataset:
    """The BSDF that the default optics predict."""
    with coarse_albedo_tables():
        predicted = microfacet.build(counted, index=1.5, multiple_scattering="none")
        return wave.build(psd, index=1.5, facets=counted, predicted=predicted, optics="auto", wavelength=wavelength)


def test_a_tenth_more_rms_height_dims_coherent_light_and_gives_it_to_the_halo(polished):
    psd, counted, sigma = polished
    psd = psd.assign(coherent_sigma_u=0.1 * psd["coherent_sigma"], psd_uncertainty=1e-9 * psd["psd"])
    found = beside(by_waves(psd, counted, [550.0]), psd=vocabulary.label(psd, "psd"))
    changes = SourceChanges(found)
    after, given = changes.changed[-1], changes.given
    incidence = np.array([20.0, 60.0]), np.zeros(2), None
    before, dimmed = (one.specular(*incidence)[0][:, 0] for one in (given, after))
    g = (4e3 * np.pi * sigma * np.cos(np.radians(incidence[0])) / 550) ** 2
    np.testing.assert_allclose(np.log(dimmed / before), -(1.1**2 - 1) * g, rtol=0.03)
    # The halo has what the coherent light loses.
    rule = hemisphere.around_mirror(20.0, 0.02)
    at = np.full_like(rule.theta, 20.0), np.zeros_like(rule.theta), rule.theta, rule.phi, None
    gained = rule.weight @ (after.evaluate(*at) - given.evaluate(*at))[:, 0]
    assert gained == pytest.approx(before[0] - dimmed[0], rel=0.05)


@pytest.mark.parametrize("optics", ["wave", "auto"])
def test_a_roughness_spectrum_changes_coherent_light_and_halo_as_if_it_was_built_with_it(polished, optics):
    psd, counted, _ = polished
    psd = psd.drop_vars(["coherent_sigma", "coherent_sigma_u"])
    wavelength = [450.0, 550.0, 650.0]
    bsdf = wave.build(psd, index=1.5, wavelength=wavelength) if optics == "wave" else by_waves(psd, counted, wavelength)
    changes = SourceChanges(beside(bsdf, psd=psd))
    assert set(changes.sources) == {"psd"}
    incidence = np.array([0.0, 60.0]), np.zeros(2), None
    coherent = changes.given.specular(*incidence)[0]
    differences = [np.log(one.specular(*incidence)[0] / coherent) for one in changes.changed]
    # d ln e^(-g) = -g dσ²/σ², of the uncertainties of σ in the band and of longer waves. These change by much: (1 + u)² − 1 = 2u + u².
    of_band = 2 * float(psd["sigma_u"] * psd["sigma"])
    of_long = float((psd["long_sigma"] + psd["long_sigma_u"]) ** 2 - psd["long_sigma"] ** 2)
    relative = np.array([of_band, of_long]) / float(bsdf["sigma"]) ** 2
    g = (
        4 * np.pi * float(bsdf["sigma"]) * 1e3 * np.cos(np.radians(incidence[0]))[:, None] / bsdf["wavelength"].values
    ) ** 2
    expected = g * np.hypot(*relative)
    # Between rings the spectrum is a power: the band holds 4.3 % less than the sum of its rings. With `auto` coherent light loses what is scattered in
    # first order above the horizon, here 0.5 % less than g.
    tolerance = {"wave": 0.05, "auto": 0.06}[optics]
    np.testing.assert_allclose(np.sqrt(np.square(differences).sum(axis=0)), expected, rtol=tolerance)
    # All light that is not coherent is in the halo.
    halo = [one.evaluate(np.zeros(1), np.zeros(1), np.array([3.0]), np.zeros(1), None) for one in changes.changed]
    assert (
        max(
            abs(one / changes.given.evaluate(np.zeros(1), np.zeros(1), np.array([3.0]), np.zeros(1), None) - 1).max()
            for one in halo
        )
        > 0.02
    )


def test_changes_of_a_halo_are_linear_in_the_logarithm_of_the_phase_variance_and_exact_at_their_nodes():
    nodes, at = np.geomspace(0.1, 100.0, 7), np.geomspace(0.1, 100.0, 40)
    changes = np.random.default_rng(1).normal(size=(7, 3))
    between = [np.interp(np.log(at), np.log(nodes), column) for column in changes.T]
    np.testing.assert_allclose(between_phases(nodes, changes, at), np.stack(between, axis=1), rtol=0, atol=1e-14)


def test_roughness_that_may_hide_in_a_plateau_counts_as_an_uncertainty_of_the_lobe():
    bsdf = beckmann_bsdf(0.02)
    analytic = roughness.analytic("gaussian", sigma=1.0, length=500.0).assign(unresolved_sigma=0.05)
    changes = uncertainty(bsdf, psd=analytic)
    loss = 1 - np.exp(-((4 * np.pi * 0.05 * np.cos(np.radians(20)) / 0.55) ** 2))
    assert loss > 0.65
    found = changes["relative_error"].sel(error_theta=20.0)
    np.testing.assert_allclose(found.sel(region=["peak", "shoulder", "rest"]), [loss, loss, 0.0])
    # The error of the model itself stays unknown.
    assert "model" in changes.attrs["uncertainty_not_stated"]
    error = xr.DataArray(np.full((1, 3), 0.5), {"theta_i": [20.0], "region": ["peak", "shoulder", "rest"]})
    both = uncertainty(bsdf, psd=analytic, relative_error=error)["relative_error"].sel(error_theta=20.0)
    np.testing.assert_allclose(both, [np.hypot(0.5, loss), np.hypot(0.5, loss), 0.5])
    np.testing.assert_array_equal(changes["finer_roughness_loss"], changes["relative_error"])


def test_changes_that_are_evaluated_together_are_those_of_bsdfs_made_anew(polished, monkeypatch):
    psd, counted, _ = polished
    given = spectrum(0.3)
    with coarse_albedo_tables():
        options = {"index": 1.5, "spectrum": given}
        predicted = microfacet.build(counted, **options, multiple_scattering="none")
        options |= {"facets": counted, "predicted": predicted, "optics": "auto"}
        bsdf = wave.build(psd, **options)
    random = np.random.default_rng(4)
    at = (*np.degrees(np.arccos(random.random((2, 40)))), *random.uniform(0, 360, (2, 40)))
    at = at[0], at[2], at[1], at[3], None
    changes = beside(
        bsdf, psd=psd, facets=counted, spectrum=with_u(0.3, 0.01), relative_error=model_error(0.05, 0.1, 0.2)
    )
    for dataset in (changes, nonspectral(changes)):
        each = SourceChanges.of(dataset)
        assert {"facets", "psd", "spectrum", "model"} <= set(each.sources)
        made_anew = [representation(one.dataset.copy()).evaluate(*at) for one in (each.given, *each.of_inputs)]
        for found, expected in zip(each.evaluate_each(*at)[:-1], made_anew, strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-10)
        np.testing.assert_allclose(each.evaluate_each(*at)[-1], each.changed[-1].evaluate(*at), rtol=1e-10)
        differences = each.of_brdf(*at)
        np.testing.assert_allclose(each.variance(*at), np.square(differences).sum(axis=0), rtol=1e-9)
    assert SourceChanges.of(changes) is SourceChanges.of(changes)
    nothing = [np.empty(0)] * 4
    assert SourceChanges.of(changes).of_brdf(*nothing, None).shape[1:] == (0, given.sizes["wavelength"])
    monkeypatch.setattr(representations_wave, "_VALUES_TOGETHER", 1000)
    np.testing.assert_allclose(SourceChanges.of(nonspectral(changes)).of_brdf(*at), differences, rtol=1e-9, atol=1e-15)

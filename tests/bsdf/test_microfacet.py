"""The microfacet BRDF: reference values, reciprocity, energy, closure, and the edges of its domain."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, hemisphere, optics, spectra, surfaces, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.errors import VocabularyError


def at(bsdf, *directions):
    return float(bsdf.bsdf.evaluate(*directions).values.ravel()[0])


def specular_albedo(bsdf, theta, fresnel=None):
    model = microfacet._Model.of(bsdf, None)
    return microfacet.directional_albedo(model, np.radians(np.atleast_1d(theta).astype(float)), fresnel)[:, 0]


def perfect_mirror(cos_zeta, _n, _k):
    return np.ones_like(cos_zeta)


@pytest.mark.parametrize(
    ("sigma", "directions", "printed"),
    [
        (0.1, (0, 0, 0, 0), 0.1850994628),
        (0.3, (0, 0, 0, 0), 0.0205666070),
        (0.1, (30, 0, 30, 180), 0.2553902196),
        (0.3, (30, 0, 30, 180), 0.0283766911),
    ],
)
def test_the_specular_part_is_the_printed_one(sigma, directions, printed):
    assert at(samples.beckmann_bsdf(sigma, reflectance=None), *directions) == pytest.approx(printed, abs=5e-11)


def test_the_coupled_diffuse_part_is_the_printed_one():
    # n = 1.55, R = 0.30 at 8°, σ = 0.1.
    bsdf = samples.beckmann_bsdf(0.1)
    assert specular_albedo(bsdf, 8)[0] == pytest.approx(0.04656911, abs=5e-9)
    # Ē is the mean of E between its nodes: exact to 1e-8, not to the last printed digit.
    assert float(bsdf["mean_albedo"]) == pytest.approx(0.08975473, abs=1.5e-8)
    assert bsdf["diffuse"].values == pytest.approx(0.26580940, abs=5e-9)
    assert bsdf.bsdf.albedo(45.0).values == pytest.approx(0.30903334, abs=5e-9)


@pytest.mark.parametrize(("sigma", "printed"), [(0.1, 0.9207), (0.3, 0.9569), (0.5, 0.9633)])
def test_the_albedo_of_perfect_mirrors_at_85_degrees_is_the_printed_one(sigma, printed):
    assert specular_albedo(samples.beckmann_bsdf(sigma), 85, perfect_mirror)[0] == pytest.approx(printed, abs=5e-5)


@given(a=st.floats(1e-3, 5), distribution=st.sampled_from(facets.DISTRIBUTIONS))
@settings(max_examples=25, deadline=None)
def test_perfect_mirrors_never_reflect_more_than_they_receive(a, distribution):
    bsdf = microfacet.build(facets.analytic(distribution, a), index=optics.refractive_index(1.5))
    theta = np.array([0, 8, 30, 60, 80, 85, 89, 89.9, 89.99, 90])
    # Two quadratures, of the masking and of the albedo, meet at grazing: to 1e-9 for Beckmann, 1e-6 for GGX's long tail.
    assert specular_albedo(bsdf, theta, perfect_mirror).max() <= 1 + (1e-9 if distribution == "beckmann" else 1e-6)


@given(
    theta_i=st.floats(0, 89.99),
    theta_o=st.floats(0, 89.99),
    phi=st.floats(-360, 360),
    a=st.floats(1e-3, 5),
    n=st.floats(1.0001, 4),
)
@settings(max_examples=40, deadline=None)
def test_the_model_is_reciprocal_finite_and_not_negative(theta_i, theta_o, phi, a, n):
    bsdf = microfacet.build(
        facets.analytic("beckmann", a), index=optics.refractive_index(n), spectrum=samples.spectrum(0.6)
    )
    forward, backward = at(bsdf, theta_i, 0, theta_o, phi), at(bsdf, theta_o, phi, theta_i, 0)
    assert np.isfinite(forward)
    assert forward >= 0
    assert forward == pytest.approx(backward, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("theta", [8.0, 45.0, 75.0])
def test_the_albedo_is_that_of_the_brdf_over_the_hemisphere(theta):
    # Two independent integrals: over the facets, and over the outgoing directions.
    bsdf = samples.beckmann_bsdf(0.2, reflectance=0.4)
    rule = hemisphere.around_mirror(theta, 0.2)
    brdf = bsdf.bsdf.evaluate(theta, 0.0, rule.theta, rule.phi, wavelength=550).values[:, 0]
    assert rule.weight @ brdf == pytest.approx(float(bsdf.bsdf.albedo(theta, wavelength=550)[0]), abs=1e-6)


@pytest.mark.parametrize("reflectance", [0.05, 0.3, 1.0])
def test_the_total_reflectance_is_the_measured_one(reflectance):
    bsdf = samples.beckmann_bsdf(0.2, reflectance=reflectance)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(reflectance, abs=1e-12)


@pytest.mark.parametrize(("sigma", "share"), [(0.02, 0.91), (0.05, 0.32), (0.1, 0.09), (0.3, 0.011)])
def test_a_gloss_trap_takes_what_goes_near_the_mirror_direction_and_no_more(sigma, share):
    # Shares of the specular albedo at 8° within 5° of the mirror direction, n = 1.55, by brute force to two digits.
    excluded = samples.spectrum(0.3, geometry="sce")
    table = facets.analytic("beckmann", sigma * np.sqrt(2))
    bsdf = microfacet.build(table, index=1.55, spectrum=excluded)
    trapped = bsdf.bsdf.albedo(8.0).values - 0.3
    assert trapped == pytest.approx(share * specular_albedo(bsdf, 8.0)[0], rel=0.06)
    assert "gloss trap of half angle 5°" in bsdf.attrs["history"]


def test_a_trap_as_wide_as_the_hemisphere_excludes_the_whole_specular_part():
    excluded = samples.spectrum(0.3, geometry="sce").assign_attrs(specular_trap=180.0)
    bsdf = microfacet.build(facets.analytic("beckmann", 0.2), index=1.5, spectrum=excluded)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.3 + specular_albedo(bsdf, 8.0)[0], abs=1e-7)


def test_the_index_may_be_a_number_or_a_name():
    table = facets.analytic("beckmann", 0.2)
    for index in (1.55, "ABS", optics.refractive_index(1.55)):
        bsdf = microfacet.build(table, index=index)
        assert at(bsdf, 30, 0, 30, 180) == at(microfacet.build(table, index=1.55), 30, 0, 30, 180)


def test_an_index_that_covers_less_than_the_spectrum_is_held_and_warned_about():
    known = dispersive(0.02).assign_coords(wavelength=[400.0, 550.0, 700.0])
    known["wavelength"].attrs["units"] = "nm"
    bsdf = microfacet.build(facets.analytic("beckmann", 0.2), index=known, spectrum=samples.spectrum(0.3))
    assert float(bsdf["n"].sel(wavelength=780)) == pytest.approx(1.48)
    assert "known from 400 to 700 nm and was held constant" in vocabulary.warnings(bsdf)[0]


@pytest.mark.parametrize("a", [1e-4, 1e-3, 0.05])
def test_a_white_glossy_material_reflects_no_more_than_it_receives_close_to_grazing(a):
    bsdf = microfacet.build(facets.analytic("beckmann", a), index=1.5, spectrum=samples.spectrum(1.0))
    grazing = 90 - np.degrees(a) * np.geomspace(0.01, 100, 60)
    assert bsdf.bsdf.albedo(grazing[grazing > 0], wavelength=550).values.max() <= 1 + 1e-5


def test_too_dark_a_reflectance_is_clamped_flagged_and_warned_about():
    reflectance = np.where(samples.WAVELENGTH < 500, 0.02, 0.3)
    bsdf = samples.beckmann_bsdf(0.1, reflectance=reflectance)
    assert (bsdf["diffuse"].values[samples.WAVELENGTH < 500] == 0).all()
    clamped = bsdf["diffuse_quality"].values == vocabulary.quality("clamped")
    assert (clamped == (samples.WAVELENGTH < 500)).all()
    assert "360 to 495 nm" in vocabulary.warnings(bsdf)[0]
    assert "spectrum.geometry: sce" in vocabulary.warnings(bsdf)[0]


def test_no_light_comes_from_or_goes_below_the_horizon():
    bsdf = samples.beckmann_bsdf()
    values = bsdf.bsdf.evaluate([120.0, 30.0, 90.0, 30.0], 0.0, [30.0, 120.0, 30.0, 90.0], 180.0)
    assert (values.values == 0).all()


def test_without_a_spectrum_the_gloss_stands_alone_and_accepts_any_wavelength():
    bsdf = samples.beckmann_bsdf(reflectance=None)
    assert bsdf.bsdf.evaluate(0, 0, 0, 0).dims == ()
    assert bsdf.bsdf.evaluate(0, 0, 0, 0, wavelength=[300, 5000]).dims == ("wavelength",)


def dispersive(spread):
    wavelength = np.array([360.0, 550.0, 780.0])
    index = xr.Dataset(
        {"n": ("wavelength", 1.5 + spread * np.array([1, 0, -1])), "k": ("wavelength", np.zeros(3))},
        coords={"wavelength": wavelength},
        attrs={"source": "synthetic"},
    )
    return vocabulary.label(index, "index")


def test_dispersion_reaches_every_wavelength():
    bsdf = microfacet.build(facets.analytic("beckmann", 0.2), index=dispersive(0.02), spectrum=samples.spectrum(0.3))
    for wavelength, n in ((360, 1.52), (550, 1.5), (780, 1.48)):
        alone = samples.beckmann_bsdf(0.2 / np.sqrt(2), n=n)
        assert at(bsdf.sel(wavelength=[wavelength]), 30, 0, 30, 180) == pytest.approx(
            at(alone, 30, 0, 30, 180), rel=1e-8
        )
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.3, abs=1e-9)


def test_a_weighted_mean_over_wavelength_keeps_the_reflectance():
    reflectance = np.linspace(0.1, 0.6, samples.WAVELENGTH.size)
    weight = np.where(abs(samples.WAVELENGTH - 550) < 60, 1.0, 0.0)
    for index in (optics.refractive_index(1.5), dispersive(0.02)):
        bsdf = microfacet.build(facets.analytic("beckmann", 0.2), index=index, spectrum=samples.spectrum(reflectance))
        reduced = bsdf.bsdf.nonspectral(weight)
        expected = np.average(bsdf.bsdf.albedo(8.0).values, weights=weight)
        assert float(reduced.bsdf.albedo(8.0)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("index", [optics.refractive_index(1.5), dispersive(0.02)], ids=["constant", "dispersive"])
def test_the_gloss_alone_of_a_coloured_material_averages_too(index):
    options = {"index": index, "spectrum": samples.spectrum(0.4), "diffuse": "none"}
    bsdf = microfacet.build(facets.analytic("beckmann", 0.2), **options)
    expected = bsdf.bsdf.albedo(8.0).values.mean()
    assert float(bsdf.bsdf.nonspectral(np.ones(85)).bsdf.albedo(8.0)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("option", [{"masking": "v-groove"}, {"diffuse": "lambert"}])
def test_unknown_modes_are_refused_with_the_key_to_change(option):
    with pytest.raises(microfacet.ModelError, match=r"accepted: .*set `model\."):
        samples.beckmann_bsdf(**option)


def test_a_dataset_of_the_wrong_kind_is_refused():
    with pytest.raises(VocabularyError, match="expected a dataset of kind 'facets', found kind 'spectrum'"):
        microfacet.build(samples.spectrum(), index=optics.refractive_index(1.5))


@pytest.mark.parametrize("a", [1e-6, 10.0])
def test_the_extremes_of_roughness_stay_finite_and_closed(a):
    bsdf = microfacet.build(
        facets.analytic("beckmann", a), index=optics.refractive_index(1.5), spectrum=samples.spectrum(0.5)
    )
    values = bsdf.bsdf.evaluate([0, 30, 60, 89.99], 0, [0, 30, 60, 89.99], 180).values
    assert np.isfinite(values).all()
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.5, abs=1e-9)


def test_the_real_rubber_with_a_real_spectrum_closes(shared_data):
    rubber = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p"))
    white = spectra.read_spectrum(shared_data / "spectra" / "pvc_white_de.csv", geometry="sci")
    bsdf = microfacet.build(facets.estimate(rubber), index=optics.refractive_index(1.5), spectrum=white)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(white["total_reflectance"].values, abs=1e-9)
    # Independently, over the outgoing directions.
    rule = hemisphere.around_mirror(8.0, 0.1, order=12, turns=48)
    brdf = bsdf.bsdf.evaluate(8.0, 0.0, rule.theta, rule.phi).values
    assert rule.weight @ brdf == pytest.approx(white["total_reflectance"].values, abs=1e-6)
    assert bsdf.bsdf.check().attrs["verdicts"].count('"pass"') == 5

"""The microfacet BRDF: reference values, reciprocity, energy, closure, and the edges of its domain."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from mueller_matrices import physical
from scipy.special import erfc

from brdfpipe import facets, geometry, hemisphere, masking, optics, spectra, surfaces, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import energy, polarised
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import InputError, VocabularyError
from brdfpipe.facets import radial_density as density
from brdfpipe.masking import liu, modes


def at(bsdf, *directions):
    return float(bsdf.bsdf.evaluate(*directions).values.ravel()[0])


def specular_albedo(bsdf, theta):
    surface, n, k = (Microsurface.of(bsdf), *(np.atleast_1d(bsdf[name].values) for name in ("n", "k")))
    theta = np.atleast_1d(theta).astype(float)
    return energy.directional_albedo(surface, bsdf.attrs["masking"], n, k, theta)[:, 0]


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
    surface = Microsurface.of(facets.analytic("beckmann", sigma * np.sqrt(2)))
    albedo = energy.mirror_albedo(surface, "height-correlated", np.array([85.0]))
    assert albedo[0] == pytest.approx(printed, abs=5e-5)


@given(a=st.floats(1e-3, 5), distribution=st.sampled_from(facets.DISTRIBUTIONS))
@settings(max_examples=12, deadline=None)
def test_perfect_mirrors_never_reflect_more_than_they_receive(a, distribution):
    surface = Microsurface.of(facets.analytic(distribution, a))
    theta = np.array([0, 8, 30, 60, 80, 85, 89, 89.9, 89.99, 90])
    # The quadratures of the masking and of the albedo agree at grazing to 1e-9 for Beckmann, 1e-6 for GGX's long tail.
    albedo = energy.mirror_albedo(surface, "height-correlated", theta)
    assert albedo.max() <= 1 + (1e-9 if distribution == "beckmann" else 1e-6)


@given(
    theta_i=st.floats(0, 89.99),
    theta_o=st.floats(0, 89.99),
    phi=st.floats(-360, 360),
    a=st.floats(1e-3, 5),
    n=st.floats(1.0001, 4),
    mode=st.sampled_from(["none", "auto"]),
)
@settings(max_examples=15, deadline=None)
def test_the_model_is_reciprocal_finite_and_not_negative(theta_i, theta_o, phi, a, n, mode):
    options = {"index": n, "spectrum": samples.spectrum(0.6), "multiple_scattering": mode}
    with samples.coarse_albedo_tables():
        bsdf = microfacet.build(facets.analytic("beckmann", a), **options)
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


@pytest.mark.parametrize("reflectance", [0.05, 0.3, 0.999])
def test_the_total_reflectance_is_the_measured_one(reflectance):
    bsdf = samples.beckmann_bsdf(0.2, reflectance=reflectance)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(reflectance, abs=1e-12)


def test_a_perfectly_white_material_reflects_1_minus_parts_in_a_hundred_million():
    total = samples.beckmann_bsdf(0.2, reflectance=1.0).bsdf.albedo(8.0).values
    assert total == pytest.approx(1.0, abs=4e-8)
    assert (total <= 1 + 1e-15).all()


@pytest.mark.parametrize(("sigma", "share"), [(0.02, 0.91), (0.05, 0.32), (0.1, 0.09), (0.3, 0.011)])
def test_a_gloss_trap_absorbs_only_light_near_the_mirror_direction(sigma, share):
    # Shares of the specular albedo at 8° within 5° of the mirror direction, n = 1.55, by brute force to two digits.
    excluded = samples.spectrum(0.3, geometry="sce")
    table = facets.analytic("beckmann", sigma * np.sqrt(2))
    bsdf = microfacet.build(table, index=1.55, spectrum=excluded, multiple_scattering="none")
    trapped = bsdf.bsdf.albedo(8.0).values - 0.3
    assert trapped == pytest.approx(share * specular_albedo(bsdf, 8.0)[0], rel=0.06)
    assert "gloss trap of half angle 5°" in bsdf.attrs["history"]


def test_a_trap_as_wide_as_the_hemisphere_excludes_the_whole_specular_part():
    excluded = samples.spectrum(0.3, geometry="sce").assign_attrs(specular_trap=180.0)
    bsdf = microfacet.build(samples.beckmann(0.2), index=1.5, spectrum=excluded, multiple_scattering="none")
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.3 + specular_albedo(bsdf, 8.0)[0], abs=1e-7)


def test_the_index_may_be_a_number_or_a_name():
    same = at(samples.beckmann_bsdf(0.2 / np.sqrt(2), n=1.55, reflectance=None), 30, 0, 30, 180)
    for index in (1.55, "ABS", optics.refractive_index(1.55)):
        bsdf = microfacet.build(samples.beckmann(0.2), index=index, multiple_scattering="none")
        assert at(bsdf, 30, 0, 30, 180) == pytest.approx(same, rel=1e-12)


def test_an_index_that_covers_less_than_the_spectrum_is_held_constant_with_a_warning():
    known = dispersive(0.02).assign_coords(wavelength=[400.0, 550.0, 700.0])
    known["wavelength"].attrs["units"] = "nm"
    options = {"spectrum": samples.spectrum(0.3), "multiple_scattering": "none"}
    bsdf = microfacet.build(samples.beckmann(0.2), index=known, **options)
    assert float(bsdf["n"].sel(wavelength=780)) == pytest.approx(1.48)
    assert "known from 400 to 700 nm and was held constant" in vocabulary.warnings(bsdf)[0]


@given(
    a=st.floats(1e-4, 5),
    n=st.floats(1.0001, 4),
    k=st.sampled_from([0.0, 0.0, 1.0, 7.0, 100.0]),
    mode=st.sampled_from(["none", "auto"]),
)
@settings(max_examples=8, deadline=None)
def test_a_white_material_reflects_no_more_than_it_receives(a, n, k, mode):
    index = optics.refractive_index(1.5)
    index = index.assign(n=index["n"] * 0 + n, k=index["k"] * 0 + k)
    options = {"index": index, "spectrum": samples.spectrum(1.0), "multiple_scattering": mode}
    bsdf = microfacet.build(facets.analytic("beckmann", a), **options)
    grazing = 90 - np.degrees(a) * np.geomspace(0.01, 100, 40)
    theta = np.concatenate([np.linspace(0, 89.99, 30), grazing[(grazing > 0) & (grazing < 89.99)]])
    assert bsdf.bsdf.albedo(theta, wavelength=550).values.max() <= 1 + 1e-9


def test_a_reflectance_below_the_specular_part_is_clamped_flagged_and_warned_about():
    reflectance = np.where(samples.WAVELENGTH < 500, 0.02, 0.3)
    bsdf = samples.beckmann_bsdf(0.1, reflectance=reflectance)
    assert (bsdf["diffuse"].values[samples.WAVELENGTH < 500] == 0).all()
    clamped = bsdf["diffuse_quality"].values == vocabulary.quality("clamped")
    assert (clamped == (samples.WAVELENGTH < 500)).all()
    assert "360 to 495 nm" in vocabulary.warnings(bsdf)[0]
    assert "spectrum.geometry: sce" in vocabulary.warnings(bsdf)[0]


def test_the_warning_of_a_reflectance_without_specular_does_not_doubt_that():
    # A wide surface sends less into the trap than it reflects.
    bsdf = microfacet.build(samples.beckmann(0.4), index=1.55, spectrum=samples.spectrum(0.001, geometry="sce"))
    (found,) = [text for text in vocabulary.warnings(bsdf) if "the diffuse part was set to 0" in text]
    assert "Check the refractive index and the surface" in found


def test_the_brdf_of_an_opaque_body_is_0_below_the_horizon():
    bsdf = samples.beckmann_bsdf()
    values = bsdf.bsdf.evaluate([120.0, 30.0, 90.0, 30.0], 0.0, [30.0, 120.0, 30.0, 90.0], 180.0)
    assert (values.values == 0).all()


def test_without_a_spectrum_there_is_gloss_alone_at_any_wavelength():
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
    options = {"spectrum": samples.spectrum(0.3), "multiple_scattering": "none"}
    bsdf = microfacet.build(samples.beckmann(0.2), index=dispersive(0.02), **options)
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
        bsdf = microfacet.build(samples.beckmann(0.2), index=index, spectrum=samples.spectrum(reflectance))
        reduced = bsdf.bsdf.nonspectral(weight)
        expected = np.average(bsdf.bsdf.albedo(8.0).values, weights=weight)
        assert float(reduced.bsdf.albedo(8.0)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("index", [optics.refractive_index(1.5), dispersive(0.02)], ids=["constant", "dispersive"])
def test_the_gloss_alone_of_a_coloured_material_averages_too(index):
    options = {"index": index, "spectrum": samples.spectrum(0.4), "diffuse": "none"}
    bsdf = microfacet.build(samples.beckmann(0.2), **options)
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


def test_the_patents_recipe_is_not_reciprocal_by_the_printed_ratio():
    # σ = 0.5: f(30→75) / f(75→30) of the specular part alone.
    bsdf = samples.beckmann_bsdf(0.5, reflectance=None, recipe="crf")
    assert at(bsdf, 30, 0, 75, 180) / at(bsdf, 75, 0, 30, 180) == pytest.approx(0.7413888795, abs=2e-9)


def test_the_patents_diffuse_part_keeps_its_printed_share():
    bsdf = samples.beckmann_bsdf(0.1, recipe="crf")
    assert bsdf["diffuse"].values == pytest.approx(0.3 - specular_albedo(bsdf, 8.0)[0], abs=1e-12)
    base = bsdf.bsdf.albedo(60.0).values - specular_albedo(bsdf, 60.0)[0]
    assert base == pytest.approx(0.7726 * bsdf["diffuse"].values, rel=1e-4)
    assert "is not the measured one" in bsdf.attrs["history"]


def test_a_recipe_and_a_choice_against_it_are_refused():
    with pytest.raises(microfacet.ModelError, match=r"drop `model.recipe` or `model.masking`"):
        samples.beckmann_bsdf(recipe="crf", masking="separable")
    with pytest.raises(microfacet.ModelError, match="unknown recipe 'CRF'; accepted: crf"):
        samples.beckmann_bsdf(recipe="CRF")


@pytest.mark.cases(3)
@pytest.mark.parametrize("mode", modes.MODES["masking"])
def test_every_masking_closes_at_the_measuring_geometry(mode):
    options = {"visibility": samples.visibility_table(0.9)} if mode == "measured" else {}
    bsdf = microfacet.build(
        facets.analytic("beckmann", 0.3 * np.sqrt(2)),
        index=1.55,
        spectrum=samples.spectrum(0.3),
        masking=mode,
        multiple_scattering="none",
        **options,
    )
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.3, abs=1e-9)


def test_the_attenuation_of_liu_is_the_masking_of_that_name():
    bsdf, table = (
        samples.beckmann_bsdf(0.3, reflectance=None, masking="liu"),
        facets.analytic("beckmann", 0.3 * np.sqrt(2)),
    )
    bare = samples.beckmann_bsdf(0.3, reflectance=None, masking="none")
    attenuation = liu.LiuMasking.of(liu.Marginal.of(density.RadialDensity.of(table)))
    for directions in ((30, 0, 75, 180), (60, 10, 80, 150), (0, 0, 85, 40)):
        theta_i, phi_i, theta_o, phi_o = directions
        pair = geometry.half_vector(theta_i, phi_i, theta_o, phi_o)
        g = float(liu.attenuation(pair, phi_i, phi_o, attenuation))
        assert at(bsdf, *directions) == pytest.approx(g * at(bare, *directions), rel=1e-9)
        assert float(masking.g2(table, *directions, mode="liu")) == pytest.approx(g, abs=1e-12)


@pytest.mark.parametrize("mode", ["crf", "none", "liu"])
def test_a_masking_that_breaks_energy_warns_and_names_the_angle(mode):
    said = vocabulary.warnings(samples.beckmann_bsdf(0.3, reflectance=None, masking=mode))[0]
    assert re.search(
        r"(perfect mirrors would reflect more than they receive|albedo of perfect mirrors exceeds 1) from \d+(\.5)?° on",
        said,
    )
    assert "model.masking: height-correlated" in said


def test_liu_refuses_a_surface_with_a_lay():
    with pytest.raises(microfacet.ModelError, match=r"this one has a lay; set `surface\.isotropic"):
        brushed(masking="liu")


# --- polarised


@pytest.mark.parametrize("options", [{}, {"masking": "liu"}, {"multiple_scattering": "compensated"}, {"recipe": "crf"}])
def test_the_first_element_of_the_mueller_matrix_is_the_brdf(options):
    bsdf, rng = samples.beckmann_bsdf(0.3, **options), np.random.default_rng(4)
    theta_i, theta_o = 90 * rng.random((2, 50))
    phi_i, phi_o = 360 * rng.random((2, 50))
    matrices = representation(bsdf).mueller(theta_i, phi_i, theta_o, phi_o, None)
    assert matrices[..., 0, 0] == pytest.approx(bsdf.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values, rel=1e-12)
    assert physical(matrices).all()


def test_the_mueller_matrix_is_labelled_like_the_brdf():
    bsdf = samples.beckmann_bsdf(0.3)
    matrix = bsdf.bsdf.mueller(30, 0, [10, 30, 50], 180, wavelength=[450, 550])
    assert matrix.dims == ("direction", "wavelength", "stokes_out", "stokes_in")
    brdf = bsdf.bsdf.evaluate(30, 0, [10, 30, 50], 180, wavelength=[450, 550])
    assert matrix.sel(stokes_out="I", stokes_in="I").values == pytest.approx(brdf.values, rel=1e-12)
    assert samples.beckmann_bsdf(0.3, reflectance=None).bsdf.mueller(30, 0, 30, 180).dims == ("stokes_out", "stokes_in")
    table = bsdf.bsdf.tabulate({"theta_i": [0, 30], "theta_o": [0, 30, 60], "phi_o": [0, 90, 180]})
    assert float(abs(table.bsdf.mueller(30, 0, 30, 180).values[..., 1:, :]).max()) == 0


def test_light_mirrored_at_the_brewster_angle_is_polarised_across_the_plane_of_incidence():
    bsdf, brewster = samples.beckmann_bsdf(0.05, reflectance=None), np.degrees(np.arctan(1.55))
    matrix = representation(bsdf).mueller(*(np.array([angle]) for angle in (brewster, 0.0, brewster, 180.0)), None)[
        0, 0
    ]
    assert polarised.degree_of_polarisation(matrix[:, 0]) == pytest.approx(1.0, abs=1e-12)
    assert matrix[1, 0] > 0


# --- a lay


def brushed(a_x=0.05, a_y=0.3, azimuth=30.0, **options):
    options = {"multiple_scattering": "none"} | options
    return microfacet.build(facets.analytic("beckmann", a_x=a_x, a_y=a_y, azimuth=azimuth), index=1.5, **options)


def test_a_lay_has_the_closed_form_of_an_elliptic_gaussian():
    bsdf, rng = brushed(), np.random.default_rng(5)
    theta_i, theta_o = np.degrees(np.arccos(rng.random((2, 500))))
    phi_i, phi_o = 360 * rng.random((2, 500))
    w = geometry.unit_vector(theta_i, phi_i) + geometry.unit_vector(theta_o, phi_o)
    p, q = -w[:, 0] / w[:, 2], -w[:, 1] / w[:, 2]
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    p22 = np.exp(-(((p * cos + q * sin) / 0.05) ** 2) - ((q * cos - p * sin) / 0.3) ** 2) / (np.pi * 0.05 * 0.3)

    def smith(theta, phi):
        width = np.hypot(0.05 * np.cos(np.radians(phi - 30)), 0.3 * np.sin(np.radians(phi - 30)))
        nu = 1 / (np.tan(np.radians(theta)) * width)
        return (np.exp(-(nu**2)) / (nu * np.sqrt(np.pi)) - erfc(nu)) / 2

    d = p22 * (1 + p**2 + q**2) ** 2
    fresnel = optics.fresnel(np.linalg.norm(w, axis=1) / 2, 1.5).mean
    cosines = np.cos(np.radians(theta_i)) * np.cos(np.radians(theta_o))
    expected = d * fresnel / (1 + smith(theta_i, phi_i) + smith(theta_o, phi_o)) / (4 * cosines)
    brdf = bsdf.bsdf.evaluate(theta_i, phi_i, theta_o, phi_o).values
    assert brdf == pytest.approx(expected, rel=1e-5, abs=1e-9 * expected.max())


@given(
    theta_i=st.floats(0, 89.99),
    phi_i=st.floats(-360, 360),
    theta_o=st.floats(0, 89.99),
    phi_o=st.floats(-360, 360),
    a_x=st.floats(0.01, 0.5),
    ratio=st.floats(0.05, 20),
)
@settings(max_examples=3, deadline=None)
def test_a_lay_is_reciprocal_finite_and_not_negative(theta_i, phi_i, theta_o, phi_o, a_x, ratio):
    with samples.coarse_albedo_tables():
        bsdf = brushed(a_x, a_x * ratio, 20.0, multiple_scattering="auto")
    forward, backward = at(bsdf, theta_i, phi_i, theta_o, phi_o), at(bsdf, theta_o, phi_o, theta_i, phi_i)
    assert np.isfinite(forward)
    assert forward >= 0
    assert forward == pytest.approx(backward, rel=1e-9, abs=1e-290)


def test_a_lay_with_a_spectrum_reflects_it_on_average_over_azimuth():
    bsdf = brushed(spectrum=samples.spectrum(0.4))
    around = bsdf.bsdf.albedo(np.full(36, 8.0), np.arange(0, 360, 10.0), wavelength=550).values
    assert around.mean() == pytest.approx(0.4, abs=1e-6)
    assert bsdf.bsdf.albedo([0, 45, 85, 89.9], 77.0).values.max() < 1


def test_an_average_over_azimuth_has_a_warning():
    bsdf = brushed(isotropic=True)
    assert "phi_i" not in bsdf.dims
    assert "averaged over azimuth" in vocabulary.warnings(bsdf)[0]


# --- a perfectly flat surface


def test_a_flat_surface_has_a_mirror_reflectance_and_no_peak_in_the_brdf():
    bsdf = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3))
    assert bsdf.attrs["representation"] == "smooth"
    mirrored, _ = representation(bsdf).specular(np.array([0.0, 60.0, 89.99]), np.zeros(3), None)
    assert mirrored[:, 0] == pytest.approx(optics.fresnel(np.cos(np.radians([0, 60, 89.99])), 1.5).mean, abs=1e-15)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(0.3, abs=1e-12)
    base = bsdf.bsdf.evaluate(30, 0, 30, [0, 180], wavelength=550).values
    assert base[0] == base[1]


def test_the_limit_of_small_slopes_is_the_flat_surface():
    flat = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3))
    gentle = microfacet.build(facets.analytic("beckmann", 1e-5), index=1.5, spectrum=samples.spectrum(0.3))
    theta = np.array([0.0, 30, 60, 80, 89])
    # Where the albedo bends, within 1e-5 of grazing, is left out: the rest differs by a² and the tables' 1e-7.
    assert gentle.bsdf.albedo(theta, wavelength=550).values == pytest.approx(
        flat.bsdf.albedo(theta, wavelength=550).values, abs=1e-6
    )


def test_an_index_of_1_reflects_nothing():
    for table in (facets.flat(), samples.beckmann(0.2)):
        assert float(microfacet.build(table, index=1.0).bsdf.albedo(45.0)) == 0


def test_an_index_below_that_of_air_is_refused():
    with pytest.raises(InputError, match="1 <= n < 5"):
        microfacet.build(facets.flat(), index=0.9)


def test_a_single_wavelength_has_the_values_of_the_spectrum():
    bsdf = samples.beckmann_bsdf(0.2, reflectance=np.linspace(0.1, 0.6, 85))
    one = bsdf.sel(wavelength=[550.0])
    expected = float(bsdf.bsdf.evaluate(30, 0, 30, 180, wavelength=550).values[0])
    assert one.bsdf.evaluate(30, 0, 30, 180, wavelength=550).values == pytest.approx(expected, rel=1e-12)
    assert one.bsdf.evaluate(30, 0, 30, 180).values == pytest.approx(expected, rel=1e-12)
    table = one.bsdf.tabulate({"theta_i": [0, 30], "theta_o": [0, 30, 60], "phi_o": [0, 90, 180]})
    assert table.bsdf.evaluate(30, 0, 30, 180, wavelength=550).values == pytest.approx(expected, rel=1e-12)
    assert table.bsdf.albedo(30, wavelength=550).values == pytest.approx(table.bsdf.albedo(30).values, rel=1e-12)


@pytest.mark.cases(2)
@pytest.mark.parametrize(("low", "high"), [(1.45, 1.55), (1.3, 1.8), (1.01, 1.5), (2.0, 4.5)])
def test_any_dispersion_has_the_albedo_of_each_of_its_indices(low, high):
    n = np.linspace(high, low, samples.WAVELENGTH.size)
    coords = {"wavelength": ("wavelength", samples.WAVELENGTH, {"units": "nm"})}
    data = {"n": ("wavelength", n), "k": ("wavelength", 0 * n)}
    index = vocabulary.label(xr.Dataset(data, coords, {"source": "synthetic"}), "index")
    options = {"spectrum": samples.spectrum(0.9), "diffuse": "none", "multiple_scattering": "none"}
    bsdf = microfacet.build(samples.beckmann(0.3), index=index, **options)
    for k in (0, 40, 84):
        alone = samples.beckmann_bsdf(0.3 / np.sqrt(2), n=float(n[k]), reflectance=None)
        assert bsdf.bsdf.albedo(60.0).values[k] == pytest.approx(float(alone.bsdf.albedo(60.0)), abs=1e-8)


def test_an_index_dataset_below_that_of_air_is_refused_too():
    index = optics.refractive_index(1.5)
    with pytest.raises(microfacet.ModelError, match="below that of air"):
        microfacet.build(facets.flat(), index=index.assign(n=index["n"] * 0 + 0.7))


# --- the edges of the domain

EDGES = np.array([0.0, 1e-6, 30.0, 60.0, 89.0, 89.9, 89.999])


@pytest.mark.cases(11)
@pytest.mark.parametrize(
    ("reflectance", "multiple_scattering"),
    [
        (None, "auto"),
        (1.0, "auto"),
        (0.0, "compensated"),
        (None, "none"),
        (1.0, "none"),
        (1.0, "compensated"),
    ],
)
@pytest.mark.parametrize(("n", "k"), [(1.0, 0.0), (1.0001, 0.0), (4.0, 0.0), (1.5, 100.0)])
@pytest.mark.parametrize("a", [0.0, 1e-6, 0.5, 10.0])
def test_the_default_model_is_sound_at_every_corner(a, n, k, reflectance, multiple_scattering):
    table = samples.beckmann(a) if a else facets.flat()
    index = optics.refractive_index(1.5)
    index = index.assign(n=index["n"] * 0 + n, k=index["k"] * 0 + k)
    spectrum = None if reflectance is None else samples.spectrum(reflectance).isel(wavelength=[0, 20])
    bsdf = microfacet.build(table, index=index, spectrum=spectrum, multiple_scattering=multiple_scattering)
    theta_i, theta_o, phi = (axis.ravel() for axis in np.meshgrid(EDGES, EDGES, [0.0, 1e-7, 90.0, 180.0]))
    forward = bsdf.bsdf.evaluate(theta_i, 0.0, theta_o, phi).values
    backward = bsdf.bsdf.evaluate(theta_o, phi, theta_i, 0.0).values
    assert np.isfinite(forward).all()
    assert forward.min() >= 0
    assert forward == pytest.approx(backward, rel=1e-12, abs=1e-280)
    assert bsdf.bsdf.albedo(EDGES).values.max() <= 1 + 1e-9


def test_the_real_rubber_with_a_real_spectrum_closes(shared_data):
    rubber = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p"))
    white = spectra.read_spectrum(shared_data / "spectra" / "pvc_white_de.csv", geometry="sci")
    bsdf = microfacet.build(facets.estimate(rubber), index=optics.refractive_index(1.5), spectrum=white)
    assert bsdf.bsdf.albedo(8.0).values == pytest.approx(white["total_reflectance"].values, abs=1e-9)
    # Independently, over the outgoing directions.
    rule = hemisphere.around_mirror(8.0, 0.1, order=12, turns=48)
    brdf = bsdf.bsdf.evaluate(8.0, 0.0, rule.theta, rule.phi).values
    assert rule.weight @ brdf == pytest.approx(white["total_reflectance"].values, abs=1e-6)
    assert {check["verdict"] for check in json.loads(bsdf.bsdf.check().attrs["verdicts"]).values()} == {"pass"}

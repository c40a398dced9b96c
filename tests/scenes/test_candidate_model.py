"""The BSDF of a candidate."""

from dataclasses import replace

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.wave.builder import build as build_wave
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.optics.index import refractive_index
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.scenes.candidate_model import MEDIAN_WIDTH, banded, build
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.numerics import FINE, QUICK, USES

SIMPLE = {"optics": "facets", "masking": "height-correlated", "multiple_scattering": "none"}


@pytest.fixture(scope="module")
def inputs(made_once) -> ModelInputs:
    surface = samples.gaussian_surface(128, sigma=0.2)
    return ModelInputs(
        refractive_index(1.5),
        samples.spectrum(0.3).isel(wavelength=slice(None, None, 14)),
        estimate(surface),
        roughness_spectrum(surface),
        surface,
    )


@pytest.mark.parametrize("name", ["beckmann", "ggx"])
def test_a_named_density_has_the_median_slope_of_the_counted_one(name):
    facets = analytic(name, a=0.2 * MEDIAN_WIDTH[name])
    assert RadialDensity.of(facets).median_slope == pytest.approx(
        0.2, rel=5e-3
    )  # the nodes of the rule about the median


def test_every_candidate_of_a_map_is_a_bsdf(inputs):
    for candidate in inputs.structures:
        if candidate.masking == "height-correlated" and candidate.multiple_scattering == "none":
            vocabulary.validate(build(candidate, inputs), "bsdf")


def test_the_candidate_of_simple_rungs_is_the_model_with_these_modes(inputs):
    built = build(Candidate(**SIMPLE), inputs)
    modes = {"masking": "height-correlated", "multiple_scattering": "none"}
    expected = build_microfacet(inputs.facets, index=inputs.index, spectrum=inputs.spectrum, **modes)
    np.testing.assert_array_equal(gloss(built).values, gloss(expected).values)


def test_one_band_reflects_the_luminous_reflectance(inputs):
    one, _ = (build(Candidate(**SIMPLE, bands=bands), inputs) for bands in ("one", "all"))
    assert one.sizes["wavelength"] == 1
    reflectance = representation(one).total_reflectance()[1]
    assert reflectance == pytest.approx(0.3, abs=1e-9)


def test_bands_are_wavelengths_of_the_spectrum(inputs):
    known = set(inputs.spectrum["wavelength"].values)
    for bands in ("three", "every 40 nm"):
        _, spectrum = banded(replace(FULLEST, bands=bands), inputs)
        assert set(spectrum["wavelength"].values) <= known


def test_a_candidate_that_needs_what_is_missing_is_refused(inputs):
    with pytest.raises(ValueError, match="spectrum"):
        build(Candidate("lambert"), replace(inputs, spectrum=None))
    with pytest.raises(ValueError, match="roughness spectrum"):
        build(Candidate(**{**SIMPLE, "optics": "wave"}), replace(inputs, psd=None))


def test_no_warning_is_of_what_a_candidate_leaves_out(inputs):
    steep = replace(inputs, psd=inputs.psd.assign(psd=9 * inputs.psd["psd"], fit_sigma=3 * inputs.psd["fit_sigma"]))
    waves = build_wave(steep.psd, index=steep.index, spectrum=steep.spectrum, optics="wave")
    for candidate, text, model in (
        (Candidate("lambert", **SIMPLE), "No surface is given", lambertian(steep.spectrum)),
        (Candidate(**{**SIMPLE, "optics": "wave"}), "`model.optics", waves),
    ):
        assert any(text in warning for warning in vocabulary.warnings(model))
        assert not any(text in warning for warning in vocabulary.warnings(build(candidate, steep)))


def test_warnings_of_the_inputs_stay(inputs):
    dark = inputs.spectrum.assign(total_reflectance=0 * inputs.spectrum["total_reflectance"] + 0.01)
    for name in ("counted", "lambert-gauss"):
        texts = vocabulary.warnings(build(Candidate(name, **SIMPLE), replace(inputs, spectrum=dark)))
        assert any("specular albedo" in text for text in texts)


@pytest.mark.parametrize("masking", ["auto", "height-correlated"])
def test_quick_numerics_differ_from_fine_ones_by_less_than_their_stated_error(inputs, masking):
    fine, quick = (build(Candidate(masking=masking), inputs, numerics) for numerics in (FINE, QUICK))
    difference = (gloss(quick) - gloss(fine)).values
    assert 0 < np.abs(difference).max() < USES["no lay"]["gloss"].error


def test_quick_numerics_choose_the_same_masking(inputs):
    fine, quick = (build(FULLEST, inputs, numerics).attrs["masking"] for numerics in (FINE, QUICK))
    assert quick == fine

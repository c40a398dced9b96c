"""Features by which materials resemble each other."""

from dataclasses import replace

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.masking.visibility_choice import THRESHOLD, choose
from brdfpipe.optics.index import refractive_index
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.features import FEATURES, features, in_spreads, slope_lowness
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs


def test_valleys_and_the_map_upside_down_are_told_apart():
    height = relief_maps.cells(128, 0)
    assert slope_lowness(height) < -0.05
    assert slope_lowness(-height) == pytest.approx(-slope_lowness(height))


def test_normally_distributed_heights_have_slopes_that_do_not_depend_on_height():
    found = [slope_lowness(relief_maps.gaussian(0.2, 192, seed, length=6.0)) for seed in range(8)]
    assert abs(np.mean(found)) < 3 * np.std(found, ddof=1) / np.sqrt(8)
    assert np.std(found) < 0.1


@pytest.mark.parametrize("height", [np.zeros((8, 8)), np.zeros(8), np.full((5, 5), np.nan), np.arange(3.0)])
def test_a_map_without_slopes_has_no_lowness(height):
    assert slope_lowness(height) == 0


def test_a_feature_is_a_property_of_the_material_not_of_its_units():
    inputs = ModelInputs(refractive_index(1.5), samples.spectrum(0.3), analytic("beckmann", a=0.2))
    found = features(inputs)
    assert set(found) == set(FEATURES)
    assert found["log_slope"] == pytest.approx(np.log(0.2 * np.sqrt(np.log(2))), abs=2e-3)
    assert found["log_mirror"] == pytest.approx(np.log(0.04), abs=1e-9)
    assert found["diffuse"] == pytest.approx(0.3, abs=1e-9)
    of_scan = ("heights_known", "masking", "masking_in_peak", "masking_over_limit", "slope_lowness", "height_skewness")
    assert [found[name] for name in (*of_scan, "log_anisotropy")] == [0] * 7
    assert found["log_height"] == pytest.approx(np.log(3))
    assert found["facets_at_grazing"] == 1


def test_like_materials_are_near_and_a_metal_is_far_from_a_plastic():
    plastic = ModelInputs(refractive_index(1.5), samples.spectrum(0.3), estimate(samples.gaussian_surface(128)))
    other = replace(plastic, index=refractive_index(1.52))
    metal = replace(plastic, index=refractive_index({"n": 0.2, "k": 4}), spectrum=None)
    of_plastic, of_other, of_metal = (in_spreads(features(one)) for one in (plastic, other, metal))
    assert np.linalg.norm(of_plastic - of_other) < 0.2
    assert np.linalg.norm(of_plastic - of_metal) > 2


@pytest.mark.parametrize(("name", "tail"), [("beckmann", np.log(20) / np.log(2)), ("ggx", 19.0)])
def test_the_tail_is_the_slope_that_5_percent_exceed_also_where_no_mean_square_exists(name, tail):
    inputs = ModelInputs(refractive_index(1.5), None, analytic(name, a=0.2))
    # The rule of the density has nodes, between which the share of the facets is interpolated.
    assert features(inputs)["tail"] == pytest.approx(np.log(tail) / 2, rel=0.01)


def test_the_masking_of_valleys_differs_from_smiths_the_other_way_round_than_that_of_the_map_upside_down():
    cells = relief_maps.cells(192, 0)
    upright, inverted = (
        features(ModelInputs(refractive_index(1.5), None, estimate(surface), None, surface))
        for surface in (samples.surface(cells), samples.surface(-cells))
    )
    assert upright["masking"] < -0.05 < 0.05 < inverted["masking"]


@pytest.mark.parametrize(("seed", "slope"), [(0, 0.05), (1, 0.4)])
def test_masking_is_over_the_limit_where_auto_traces_it(seed, slope):
    for height in (relief_maps.cells(192, seed), relief_maps.gaussian(slope, 192, seed, length=6.0)):
        surface = samples.surface(height)
        inputs = ModelInputs(refractive_index(1.5), None, estimate(surface), None, surface)
        found, chosen = features(inputs), choose(surface, inputs.facets)
        if found["masking_over_limit"] == 0:
            assert chosen.attrs["masking"] == "height-correlated"
        elif max(abs(found["masking"]), abs(found["masking_in_peak"])) > 2 * THRESHOLD:
            assert chosen.attrs["masking"] == "measured"


@pytest.mark.parametrize("modulation", [0.0, 0.6])
def test_further_reflections_matter_at_grazing_only_where_facets_reflect_light_there(modulation):
    """Two lines of equal slopes, of which those of the modulated one are not normally distributed."""
    rng, count = np.random.default_rng(0), 4096
    height = np.fft.irfft(
        np.fft.rfft(rng.standard_normal(count)) * np.exp(-((np.pi * np.fft.rfftfreq(count) * 14) ** 2) / 2)
    )
    height *= 1 + modulation * np.sin(2 * np.pi * np.arange(count) / 1024)
    surface = samples.surface(0.1 * height / np.diff(height).std())
    facets = estimate(surface, isotropic=True)
    inputs = ModelInputs(refractive_index(1.5), None, facets, roughness_spectrum(surface), surface)
    complete, without = (
        float(gloss(build(candidate, inputs), [85])[0])
        for candidate in (FULLEST, Candidate(multiple_scattering="none"))
    )
    if modulation == 0:
        assert features(inputs)["facets_at_grazing"] == 0
        assert abs(complete - without) < 1e-3
    else:
        assert 0.2 < features(inputs)["facets_at_grazing"] < 0.8
        assert complete - without > 0.2

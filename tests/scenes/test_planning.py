"""The cheapest model that a scene allows."""

from dataclasses import replace

import numpy as np
import pytest
import samples
from tried_models import FACETS, ORIGIN, SLOPES, at, error, known

from brdfpipe import vocabulary
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.optics.index import refractive_index
from brdfpipe.scenes.experience import NONE, Experience
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.planning import ToleranceError, chosen, judge, plan, plan_dataset

CANDIDATES = (FACETS, FULLEST)


def test_the_error_is_that_of_like_materials_and_its_bound_is_above():
    facets, fullest = judge(CANDIDATES, at(0.1), known(*SLOPES))
    assert facets.expected_error == pytest.approx(error(0.1), rel=0.1)
    assert facets.expected_error < facets.bound < 3 * facets.expected_error
    assert facets.cost == pytest.approx(0.5, rel=0.02)
    assert (fullest.expected_error, fullest.bound) == (0, 0)


def test_the_cheapest_candidate_within_the_tolerance_is_chosen():
    judged = judge(CANDIDATES, ORIGIN, known(*SLOPES))
    assert chosen(judged, 3 * error(0.0)).candidate == FACETS
    assert chosen(judged, error(0.0)).candidate == FULLEST


def test_nothing_is_assumed_of_a_material_that_no_other_resembles():
    assert chosen(judge(CANDIDATES, ORIGIN, NONE), 100.0).candidate == FULLEST
    unlike = ORIGIN | {"diffuse": 100.0}
    like, far = (judge(CANDIDATES, features, known(*SLOPES))[0].bound for features in (ORIGIN, unlike))
    assert far > 3 * like


def test_a_plan_is_a_dataset_of_all_candidates_and_the_choice():
    judged = judge((Candidate(optics="wave"), *CANDIDATES), ORIGIN, known(*SLOPES))
    choice = chosen(judged, 1.0)
    attributes = {"scene": "gloss-sheet", "metric": "gloss", "unit": "GU", "tolerance": 1.0}
    plan = vocabulary.validate(plan_dataset(judged, choice, ORIGIN, **attributes), "plan")
    assert plan["chosen"].values.tolist() == [0, 1, 0]
    assert np.isnan(plan["error_bound"].values[0])
    assert plan["rung_optics"].values.tolist() == ["wave", "facets", "auto"]


@pytest.mark.parametrize(("missed", "refused"), [(5.0, True), (0.0, False)])
def test_a_tolerance_that_the_fullest_model_misses_is_refused_with_what_is_achievable(missed, refused):
    inputs = ModelInputs(refractive_index(1.5), samples.spectrum(0.3), analytic("beckmann", a=0.2))
    materials = tuple(replace(one, features=features(inputs), model_error=missed) for one in known(*SLOPES).materials)
    tried = Experience("gloss", "digest", materials).fitted()
    scene = {"scene": "mine", "metric": "gloss", "unit": "GU", "tolerance": 1.0, "errors_of": "digest"}
    if refused:
        with pytest.raises(ToleranceError, match=r"an error of about (4\.9|5|5\.1) GU with the fullest model"):
            plan(inputs, tried, **scene)
    else:
        assert plan(inputs, tried, **scene)["chosen"].values.sum() == 1

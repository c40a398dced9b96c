"""The cheapest model that a scene allows."""

import re
from dataclasses import replace

import numpy as np
import pytest
import samples
from tried_models import FACETS, ORIGIN, SLOPES, at, error, known

from brdfpipe import vocabulary
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.optics.index import refractive_index
from brdfpipe.scenes import experience
from brdfpipe.scenes.experience import NONE, Experience
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.numerics import FINE, QUICK, USES
from brdfpipe.scenes.planning import ToleranceError, chosen, judge, not_below, plan, plan_dataset
from brdfpipe.scenes.scene import load_scene, shipped_scenes
from brdfpipe.scenes.scene_keys import METRIC_UNITS

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
    attributes |= {"numerics": "fine", "numerical_error": 0.0}
    plan = vocabulary.validate(plan_dataset(judged, choice, ORIGIN, **attributes), "plan")
    assert plan["chosen"].values.tolist() == [0, 1, 0]
    assert np.isnan(plan["error_bound"].values[0])
    assert plan["rung_optics"].values.tolist() == ["wave", "facets", "auto"]


INPUTS = ModelInputs(refractive_index(1.5), samples.spectrum(0.3), analytic("beckmann", a=0.2))


def planned(metric: str, missed: float | None, tolerance: float):
    """A plan by materials like :data:`INPUTS`, of which the fullest model missed an error, for a scene of a metric."""
    materials = tuple(replace(one, features=features(INPUTS), model_error=missed) for one in known(*SLOPES).materials)
    tried = Experience(metric, "digest", materials, least_error=0.01).fitted()
    return plan(
        INPUTS, tried, scene="mine", metric=metric, unit=METRIC_UNITS[metric], tolerance=tolerance, errors_of="digest"
    )


@pytest.mark.parametrize("metric", METRIC_UNITS)
def test_a_tolerance_that_the_fullest_model_misses_is_refused_with_what_is_achievable(metric):
    unit = METRIC_UNITS[metric]
    with pytest.raises(ToleranceError) as refusal:
        planned(metric, 5.0, 1.0)
    assert f"scene 'mine': the metric '{metric}' cannot achieve `tolerance`: found 1 {unit}" in str(refusal.value)
    found = re.search(rf"the best achievable is ([\d.]+) {unit}: the fullest model itself", str(refusal.value))
    assert found is not None
    achievable = float(found[1])
    assert 1 < achievable < 5, "what it errs by at least"
    assert planned(metric, 5.0, achievable)["chosen"].values.sum() == 1, "the figure is accepted"
    with pytest.raises(ToleranceError):
        planned(metric, 5.0, 0.9 * achievable)
    assert planned(metric, 0.0, 1.0)["chosen"].values.sum() == 1
    assert planned(metric, None, 1.0)["chosen"].values.sum() == 1


def test_numerics_are_fine_where_the_error_of_quick_ones_and_that_of_the_fullest_model_exceed_the_tolerance_together():
    with pytest.raises(ToleranceError) as refusal:
        planned("gloss", 5.0, 1.0)
    found = re.search(r"the best achievable is ([\d.]+) GU", str(refusal.value))
    assert found is not None
    best, quick = float(found[1]), USES["no lay"]["gloss"].error
    numerics = {more: planned("gloss", 5.0, best + more).attrs for more in (0.5 * quick, 1.5 * quick)}
    assert [(one["numerics"], one["numerical_error"]) for one in numerics.values()] == [(FINE, 0.0), (QUICK, quick)]


@pytest.mark.parametrize("metric", METRIC_UNITS)
def test_a_tolerance_below_all_errors_that_were_told_apart_is_refused_with_the_least_of_them(metric):
    with pytest.raises(ToleranceError, match=f"found 0.009 {METRIC_UNITS[metric]}.* is 0.01 .* not told apart"):
        planned(metric, None, 0.009)
    assert planned(metric, None, 0.01)["chosen"].values.sum() == 1


@pytest.mark.parametrize("name", [scene.name for scene in map(load_scene, shipped_scenes()) if scene.plans])
def test_the_shipped_experience_refuses_an_impossible_tolerance_and_accepts_that_of_the_scene(name):
    scene = load_scene(name)
    assert scene.experience_file is not None
    tried = experience.read(scene.experience_file)
    with pytest.raises(ToleranceError, match=f"scene '{name}': .* the best achievable is [0-9.]+ "):
        plan(INPUTS, tried, **{**scene.accepted_error, "tolerance": 1e-3 * scene.content["tolerance"]})
    assert plan(INPUTS, tried, **scene.accepted_error)["chosen"].values.sum() == 1


def test_errors_of_another_scene_are_not_used():
    tried = replace(known(*SLOPES), scene="another")
    given = {"scene": "mine", "metric": "gloss", "unit": "GU", "tolerance": 1e-6, "errors_of": "digest"}
    assert plan(INPUTS, tried, **given).attrs["choice"] == "fullest"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.01, "0.01"), (0.614, "0.62"), (0.615, "0.62"), (9.95, "10"), (1.04e-5, "1.1e-05"), (123.0, "1.3e+02")],
)
def test_two_digits_of_what_is_achievable_are_not_below_it(value, text):
    assert not_below(value) == text
    assert float(not_below(value)) >= value

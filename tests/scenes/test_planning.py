"""The cheapest model that a scene allows."""

import numpy as np
import pytest
from tried_models import FACETS, ORIGIN, known

from brdfpipe import vocabulary
from brdfpipe.scenes.experience import NONE
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.planning import LEAST_NEIGHBOURS, MARGIN, chosen, judge, plan_dataset

CANDIDATES = (FACETS, FULLEST)
NEAR = (0.1, 0.2, 0.3, 0.4)


def test_the_bound_is_the_largest_error_of_like_materials_with_a_margin():
    facets, fullest = judge(CANDIDATES, ORIGIN, known(*NEAR, 9.0))
    assert (facets.error, facets.neighbours, facets.cost) == (pytest.approx(MARGIN * 0.4), 4, 0.5)
    assert fullest.error == 0


def test_the_cheapest_candidate_within_the_tolerance_is_chosen():
    judged = judge(CANDIDATES, ORIGIN, known(*NEAR))
    assert chosen(judged, 0.6).candidate == FACETS
    assert chosen(judged, 0.5).candidate == FULLEST


def test_nothing_is_assumed_of_a_material_that_no_other_resembles():
    for found in (NONE, known(*NEAR[: LEAST_NEIGHBOURS - 1]), known(5.0, 6.0, 7.0, 8.0)):
        judged = judge(CANDIDATES, ORIGIN, found)
        assert np.isinf(judged[0].error)
        assert chosen(judged, 100.0).candidate == FULLEST


def test_a_plan_is_a_dataset_of_all_candidates_and_the_choice():
    judged = judge((Candidate(optics="wave"), *CANDIDATES), ORIGIN, known(*NEAR))
    choice = chosen(judged, 0.6)
    attributes = {
        "scene": "gloss-sheet",
        "metric": "gloss",
        "unit": "GU",
        "tolerance": 0.6,
    }
    plan = vocabulary.validate(plan_dataset(judged, choice, ORIGIN, **attributes), "plan")
    assert plan["chosen"].values.tolist() == [0, 1, 0]
    assert np.isnan(plan["error_bound"].values[0])
    assert plan["rung_optics"].values.tolist() == ["wave", "facets", "auto"]

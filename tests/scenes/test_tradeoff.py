"""The planner tried on materials that are left out, and the width of its bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tradeoff import DEVIATIONS, calibrated, left_out
from tried_models import FACETS, SLOPES, known

from brdfpipe.scenes.experience import Experience
from brdfpipe.scenes.ladders import FULLEST
from brdfpipe.scenes.planning import chosen, judge
from brdfpipe.scenes.scene import load_scene

SCENE = load_scene("gloss-sheet")
TOLERANCE = SCENE.content["tolerance"]


def rows(experience: Experience, fresh: dict[str, float] | None = None) -> list[dict]:
    """What was measured of each material, with errors of facets at fresh directions by material."""
    return [
        {
            "name": one.name,
            "candidates": {
                candidate.key: {
                    "fresh_errors": {SCENE.name: fresh[one.name]} if candidate == FACETS and one.name in fresh else {}
                }
                for candidate in one.trials
            },
        }
        for fresh in [fresh or {}]
        for one in experience.materials
    ]


def choices(experience: Experience) -> dict:
    """The choice for each material by an experience that does not contain it."""
    return {
        one.name: chosen(
            judge(
                (FACETS, FULLEST),
                one.features,
                replace(experience, materials=tuple(other for other in experience.materials if other is not one)),
            ),
            TOLERANCE,
        ).candidate
        for one in experience.materials
    }


def test_a_material_that_is_left_out_is_planned_from_the_others_alone():
    tried = known(*SLOPES)
    found, by_name = left_out(SCENE, tried, rows(tried)), choices(tried)
    costs = {True: 0.5, False: 3.0}
    smallest = sum(costs[one.trials[FACETS].error <= TOLERANCE] for one in tried.materials)
    taken = sum(costs[choice == FACETS] for choice in by_name.values())
    assert 0 < found["cheaper"] < 1
    assert found["cheaper"] == np.mean([choice == FACETS for choice in by_name.values()])
    assert found["cost"] == pytest.approx(taken / smallest)
    assert found["saved"] == pytest.approx(1 - taken / (3 * len(SLOPES)))
    assert found["possible"] == pytest.approx(1 - smallest / (3 * len(SLOPES)))
    assert found["held"] == 1


def test_errors_at_fresh_directions_decide_whether_a_choice_held():
    tried = known(*SLOPES)
    missed = next(name for name, choice in choices(tried).items() if choice == FACETS)
    found = left_out(SCENE, tried, rows(tried, {missed: 2 * TOLERANCE}))
    assert found["held"] == pytest.approx(1 - 1 / len(SLOPES))


def test_bounds_are_widened_until_enough_choices_hold():
    tried = known(*SLOPES)
    assert calibrated(SCENE, tried, rows(tried)).deviations == DEVIATIONS[0]
    # The steepest material that gets facets misses the tolerance; wider bounds give it the fullest model.
    steepest = [name for name, choice in choices(tried).items() if choice == FACETS][-1]
    widened = calibrated(SCENE, tried, rows(tried, {steepest: 2 * TOLERANCE}))
    assert widened.deviations > DEVIATIONS[0]
    assert choices(widened)[steepest] == FULLEST

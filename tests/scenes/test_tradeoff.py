"""The planner tried on materials that are left out and on new ones, the width of its bounds, and the record of both."""

from __future__ import annotations

from dataclasses import replace

import planner_figures
import planner_record
import pytest
from planner_figures import (
    DEVIATIONS,
    Figures,
    Outcome,
    Predictions,
    WidthError,
    calibrated,
    figures,
    left_out,
    of_new_materials,
)
from planner_record import LEFT_OUT, NEW_MATERIALS, SceneOutcomes
from tradeoff import planned_scenes
from tried_models import FACETS, SLOPES, error, known

from brdfpipe.scenes.error_regression import Regression
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
            "features": one.features,
            "features_cost": 0.25,
            "candidates": {
                candidate.key: {
                    "costs": {SCENE.name: trial.cost},
                    "errors": {SCENE.name: trial.error},
                    "fresh_errors": {SCENE.name: fresh[one.name]} if candidate == FACETS and one.name in fresh else {},
                }
                for candidate, trial in one.trials.items()
            },
        }
        for fresh in [fresh or {}]
        for one in experience.materials
    ]


def tried_left_out(tried: Experience, fresh: dict[str, float] | None = None) -> Figures:
    return figures(left_out(SCENE, tried, rows(tried, fresh), Predictions.of(tried)), TOLERANCE)


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
    found, by_name = tried_left_out(tried), choices(tried)
    costs = {True: 0.5, False: 3.0}
    smallest = sum(costs[one.trials[FACETS].error <= TOLERANCE] for one in tried.materials)
    taken = sum(costs[choice == FACETS] for choice in by_name.values())
    assert 0 < found.cheaper < found.materials == len(SLOPES)
    assert found.cheaper == sum(choice == FACETS for choice in by_name.values())
    assert found.cost == pytest.approx(taken / smallest)
    assert found.saved == pytest.approx(1 - taken / (3 * len(SLOPES)))
    assert found.possible == pytest.approx(1 - smallest / (3 * len(SLOPES)))
    assert (found.held, found.cheaper_held) == (found.materials, found.cheaper)
    assert found.planning is None


def test_errors_at_fresh_directions_decide_whether_a_choice_held():
    tried = known(*SLOPES)
    missed = next(name for name, choice in choices(tried).items() if choice == FACETS)
    found = tried_left_out(tried, {missed: 2 * TOLERANCE})
    assert (found.held, found.cheaper_held) == (found.materials - 1, found.cheaper - 1)


def test_bounds_are_widened_until_enough_choices_hold():
    tried = known(*SLOPES)
    assert calibrated(SCENE, tried, rows(tried))[0].deviations == DEVIATIONS[0]
    # The steepest material that gets facets misses the tolerance; wider bounds give it the fullest model.
    steepest = [name for name, choice in choices(tried).items() if choice == FACETS][-1]
    widened, outcomes = calibrated(SCENE, tried, rows(tried, {steepest: 2 * TOLERANCE}))
    assert widened.deviations > DEVIATIONS[0]
    assert choices(widened)[steepest] == FULLEST
    assert figures(outcomes, TOLERANCE).held == len(SLOPES)


def test_bounds_that_no_width_makes_hold_are_refused_with_the_materials(monkeypatch):
    tried = known(*SLOPES)
    flattest = tried.materials[0].name  # facets err by 1e-2 of the tolerance there: no bound excludes them
    calls: list[Regression] = []
    found = Regression.left_out
    monkeypatch.setattr(Regression, "left_out", lambda self: (calls.append(self), found(self))[1])
    with pytest.raises(WidthError, match=f"gloss-sheet.*12 of 13 materials hold.*needed: 99%.*{flattest} miss it"):
        calibrated(SCENE, tried, rows(tried, {flattest: 2 * TOLERANCE}))
    assert len(calls) == 4, "error and cost of two candidates are predicted once, not for each width"


def test_new_materials_are_planned_by_the_experience_as_it_is():
    slopes = (-1.3, 0.1, 1.3)
    new = rows(known(*slopes))
    found = of_new_materials(SCENE, known(*SLOPES), 0.5, new)
    assert [one.choice for one in found] == [FACETS.key, FACETS.key, FULLEST.key]
    assert [one.error for one in found[:2]] == [error(slope) for slope in slopes[:2]]
    assert [one.cheapest for one in found] == [0.5, 0.5, 3.0]
    times = [one.planning or 0.0 for one in found]
    assert times[0] > 0.75, "features, and the reading once"
    assert all(seconds > 0.25 for seconds in times[1:])
    total = sum(times)
    assert figures(found, TOLERANCE).planning == pytest.approx(total / 5.0)


def test_materials_that_set_the_width_of_a_scene_are_not_new_for_it(monkeypatch):
    tried, new = known(*SLOPES), rows(known(-1.0, 0.0))
    for seed, row in enumerate(new, start=20_000):
        row["name"] = f"normal {seed}"
    monkeypatch.setattr(planner_figures, "WIDENED", {SCENE.name: (DEVIATIONS[1], range(20_001))})
    assert [one.material for one in of_new_materials(SCENE, tried, 0.0, new)] == ["normal 20001"]
    assert calibrated(SCENE, tried, rows(tried))[0].deviations == DEVIATIONS[1]


def test_a_refused_tolerance_and_a_choice_that_cannot_be_built_do_not_count_as_held():
    tried = known(*SLOPES)
    missing = replace(tried, materials=tuple(replace(one, model_error=9.0) for one in tried.materials)).fitted()
    refused = of_new_materials(SCENE, missing, 0.0, rows(known(0.0)))
    built = of_new_materials(SCENE, tried, 0.0, rows(known(-1.0)))
    unbuilt = [
        {**row, "candidates": {**row["candidates"], FACETS.key: {"refused": "why"}}} for row in rows(known(-1.0))
    ]
    found = figures([*refused, *built, *of_new_materials(SCENE, tried, 0.0, unbuilt)], TOLERANCE)
    assert (found.refused, found.materials, found.held, found.cheaper) == (1, 2, 1, 2)


def test_a_record_gives_back_its_outcomes(monkeypatch, tmp_path):
    monkeypatch.setattr(planner_record, "RECORD", tmp_path / "planner.json")
    outcomes = [
        Outcome("normal 1", FACETS.key, 0.123, 0.5, 0.5, 3.0, 0.04),
        Outcome("line 2", "", None, 3.0, 0.5, 3.0, None),
    ]
    written = {LEFT_OUT: {"gloss-sheet": SceneOutcomes(1.0, outcomes)}}
    planner_record.write(written)
    assert planner_record.read() == written


def test_the_interval_is_that_of_clopper_and_pearson():
    outcomes = [Outcome("a", FACETS.key, 0.5, 1.0, 1.0, 2.0, 0.01)] * 10
    row = planner_record.table({"one": SceneOutcomes(1.0, outcomes)}).splitlines()[-1]
    assert f"| 100.0% | {0.025 ** (1 / 10):.1%} to 100.0% | 10 of 10 |" in row  # n of n held: (α/2)^(1/n)


def test_the_tables_of_the_page_are_those_of_the_record():
    page = planner_record.PAGE.read_text()
    assert planner_record.with_tables(page) == page
    assert planner_record.with_tables(page.replace("| `gloss-sheet` | ", "| `gloss-sheet` | 1")) == page


def test_the_record_has_every_scene_that_plans_and_the_time_of_planning():
    scenes = [scene.name for scene in planned_scenes() if scene.plans]
    recorded = planner_record.read()
    for section in (LEFT_OUT, NEW_MATERIALS):
        assert list(recorded[section]) == scenes
    for name, one in recorded[NEW_MATERIALS].items():
        assert one.tolerance == load_scene(name).content["tolerance"]
        assert figures(one.outcomes, one.tolerance).planning is not None
        known_names = {outcome.material for outcome in recorded[LEFT_OUT][name].outcomes}
        assert not known_names & {outcome.material for outcome in one.outcomes}, "new materials set nothing"

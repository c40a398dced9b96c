"""How good the choices of the planner are: how often their errors are within the tolerance, and what they cost beside an exhaustive search.

Two kinds of materials: those that the experience knows, each planned from the others, and new ones, which set nothing of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes.error_regression import Prediction, Regression
from brdfpipe.scenes.experience import CERTAINTY, Experience, Known, candidate_of
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.planning import Judged, achievable, chosen, judge, judgement
from brdfpipe.scenes.scene import Scene

Row = Mapping[str, Any]
"""What was measured of a material: ``name``, ``features`` with their time ``features_cost`` [s], and by key of each of its ``candidates`` ``costs``
and ``errors`` by scene and ``fresh_errors`` at other directions."""

Result = TypeVar("Result")

ENOUGH_HELD = 0.99
"""Share of the materials whose choice has to err by less than the tolerance."""
DEVIATIONS = (CERTAINTY, 2.7, 3.1, 3.6, 4.2, 5.0)
"""Standard deviations above the expected error, at which its bound may be."""
WIDENED: Mapping[str, tuple[float, range]] = {"multiangle-qc": (2.7, range(20_000, 20_042))}
"""By scene the least of these where new materials missed more often than materials that are left out, and the seeds of these materials,
which are not new for the scene any more."""
REPEATS, ENOUGH = 2, 0.4
"""Most runs of an action that is timed, and the time [s] after which no other one follows."""
NEARLY_CHEAPEST = 1.3
"""Cost over that of the cheapest candidate within the tolerance, up to which a choice is nearly as cheap."""


class WidthError(BrdfpipeError):
    """No width of the bounds of errors is enough."""


class Outcome(NamedTuple):
    """What the planner chose for a material, beside what all candidates gave."""

    material: str
    choice: str
    """Key of the candidate; empty where the tolerance was refused"""
    error: float | None
    """Of the choice, in the unit of the metric, at fresh directions where these are sampled; None where the choice cannot be built"""
    cost: float
    """Processor time of the build of the choice [s]"""
    cheapest: float
    """That of the cheapest candidate with an error within the tolerance"""
    fullest: float
    """That of the fullest candidate"""
    planning: float | None
    """Processor time of the choice itself: features, reading of the experience and regressions [s]; None where it was not measured"""


class Figures(NamedTuple):
    """Of the planner for a scene, over materials."""

    materials: int
    refused: int
    """Materials for which the tolerance was refused; not among the others"""
    held: int
    """Choices with an error within the tolerance"""
    cheaper: int
    """Choices that are not the fullest"""
    cheaper_held: int
    cost: float
    """Of all choices, over that of the cheapest candidates within the tolerance"""
    nearly_cheapest: float
    """Share of choices within :data:`NEARLY_CHEAPEST`"""
    saved: float
    """Time that the choices save, over that of the fullest model"""
    possible: float
    """Time that the cheapest would save"""
    planning: float | None
    """Time of planning, over the time that the choices save; None where it was not measured, or nothing is saved"""


def figures(outcomes: Sequence[Outcome], tolerance: float) -> Figures:
    """The figures of the outcomes for a scene."""
    decided = [one for one in outcomes if one.choice]
    held = np.array([one.error is not None and one.error <= tolerance for one in decided])
    cheaper = np.array([one.choice != FULLEST.key for one in decided])
    cost, cheapest, fullest = (
        np.array([getattr(one, name) for one in decided]) for name in ("cost", "cheapest", "fullest")
    )
    saved = float(fullest.sum() - cost.sum())
    planning = [one.planning for one in decided if one.planning is not None]
    return Figures(
        materials=len(decided),
        refused=len(outcomes) - len(decided),
        held=int(held.sum()),
        cheaper=int(cheaper.sum()),
        cheaper_held=int((held & cheaper).sum()),
        cost=float(cost.sum() / cheapest.sum()),
        nearly_cheapest=float(np.mean(cost <= NEARLY_CHEAPEST * cheapest)),
        saved=saved / float(fullest.sum()),
        possible=1 - float(cheapest.sum() / fullest.sum()),
        planning=sum(planning) / saved if len(planning) == len(decided) and saved > 0 else None,
    )


# --- choices


def outcome(
    row: Row, scene: Scene, judged: Sequence[Judged], planning: float | None = None, *, refused: bool = False
) -> Outcome:
    """What the planner chose among candidates for a material, and what an exhaustive search finds."""
    tolerance = scene.content["tolerance"]
    of_scene = {key: one for key, one in row["candidates"].items() if scene.name in one.get("errors", {})}
    within = [one["costs"][scene.name] for one in of_scene.values() if one["errors"][scene.name] <= tolerance]
    fullest = of_scene[FULLEST.key]["costs"][scene.name]
    choice = "" if refused else chosen(judged, tolerance).candidate.key
    taken = of_scene.get(choice, {"costs": {scene.name: fullest}, "errors": {scene.name: None}})
    error = taken.get("fresh_errors", {}).get(scene.name, taken["errors"][scene.name])
    return Outcome(row["name"], choice, error, taken["costs"][scene.name], min(within), fullest, planning)


def of_new_materials(scene: Scene, experience: Experience, reading: float, rows: Sequence[Row]) -> list[Outcome]:
    """The planner on materials that the experience does not know.

    Parameters
    ----------
    experience : just read: the first material is charged with solving the regressions, which the others then find solved
    reading : processor time of reading the experience [s], which the first material is charged with
    rows : of the materials, with their seed at the end of their name; those without the scene are left out, and those that set the width of its bounds
    """
    found = []
    _, not_new = WIDENED.get(scene.name, (0.0, range(0)))
    for row in _of_scene(scene, rows):
        if int(row["name"].split()[-1]) in not_new:
            continue
        start = time.process_time()
        judged = judge([candidate_of(key) for key in row["candidates"]], row["features"], experience)
        best = achievable(row["features"], experience, scene.content["tolerance"])
        planning = row["features_cost"] + time.process_time() - start
        if not found:
            planning += reading
        found.append(outcome(row, scene, judged, planning, refused=best is not None))
    return found


def shortest(action: Callable[[], Result]) -> tuple[Result, float]:
    """The result of an action, and its processor time [s], the shortest of some where it is short."""
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < ENOUGH:
        start = time.process_time()
        result = action()
        times.append(time.process_time() - start)
    return result, min(times)


def left_out(scene: Scene, experience: Experience, rows: Sequence[Row], predictions: Predictions) -> list[Outcome]:
    """The planner on each material by what was measured on the others.

    The parameters of the regressions are those of all materials: some ten numbers for each candidate.
    """
    found = []
    for row, known in zip(_of_scene(scene, rows), experience.materials, strict=True):
        judged = [
            judgement(
                one,
                predictions.errors[one].get(row["name"]),
                predictions.costs[one].get(row["name"]),
                experience.deviations,
            )
            for one in known.trials
        ]
        found.append(outcome(row, scene, judged))
    return found


def calibrated(scene: Scene, experience: Experience, rows: Sequence[Row]) -> tuple[Experience, list[Outcome]]:
    """With the smallest bounds for which enough materials that are left out hold the tolerance, and the outcomes with these bounds; at least :data:`WIDENED`.

    Raises
    ------
    WidthError : the widest bounds are not wide enough.
    """
    predictions, tolerance = Predictions.of(experience), scene.content["tolerance"]
    least, _ = WIDENED.get(scene.name, (DEVIATIONS[0], range(0)))
    for deviations in (one for one in DEVIATIONS if one >= least):
        experience = replace(experience, deviations=deviations)
        outcomes = left_out(scene, experience, rows, predictions)
        found = figures(outcomes, tolerance)
        if found.held >= ENOUGH_HELD * found.materials:
            return experience, outcomes
    missed = ", ".join(one.material for one in outcomes if one.error is None or one.error > tolerance)
    raise WidthError(
        f"scene {scene.name!r}: with bounds {DEVIATIONS[-1]:g} standard deviations above the expected error, the choices for {found.held} of "
        f"{found.materials} materials hold the tolerance; needed: {ENOUGH_HELD:.0%}. Those for {missed} miss it: measure more materials like "
        "these, or add a feature that tells them apart"
    )


class Predictions(NamedTuple):
    """For each material from the others, by candidate and name of the material."""

    errors: Mapping[Candidate, Mapping[str, Prediction]]
    costs: Mapping[Candidate, Mapping[str, Prediction]]

    @classmethod
    def of(cls, experience: Experience) -> Predictions:
        """Those of the materials of an experience; they do not depend on the width of its bounds."""
        candidates = dict.fromkeys(candidate for known in experience.materials for candidate in known.trials)
        return cls(
            {one: _left_out(experience.error(one), experience.tried(one)) for one in candidates},
            {one: _left_out(experience.cost(one), experience.tried(one)) for one in candidates},
        )


def _left_out(regression: Regression | None, tried: Sequence[Known]) -> dict[str, Prediction]:
    predictions = [] if regression is None else regression.left_out()
    return {known.name: prediction for known, prediction in zip(tried, predictions, strict=regression is not None)}


def _of_scene(scene: Scene, rows: Sequence[Row]) -> Iterator[Row]:
    """The materials on which candidates were compared for a scene."""
    return (row for row in rows if scene.name in row["candidates"][FULLEST.key].get("errors", {}))

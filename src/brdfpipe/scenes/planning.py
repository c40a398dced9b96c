"""The cheapest model that a scene allows for a material.

The error of a candidate on this material is not known before both it and the fullest model are built, which costs more than it saves. It is
bounded by the errors of the same candidate on materials with like features (:mod:`brdfpipe.scenes.experience`). Where too few
resemble the material, nothing is assumed and the fullest model is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes.experience import NONE, Experience
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, LADDERS, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs

RADIUS = 2.5
"""Distance of features within which materials resemble each other."""

LEAST_NEIGHBOURS = 4
"""Materials that must resemble a material before their errors count."""

MOST_NEIGHBOURS = 12
"""Nearest materials whose errors count."""

MARGIN = 1.3
"""Factor by which the largest of their errors is enlarged."""


class ToleranceError(BrdfpipeError):
    """A tolerance that no model meets."""


class Judged(NamedTuple):
    """A candidate for a material."""

    candidate: Candidate
    error: float
    """Bound of its error; infinite where too few materials resemble this one"""
    cost: float
    """Expected processor time of its build [s]; NaN where it is not known"""
    neighbours: int


def judge(candidates: Sequence[Candidate], features: Mapping[str, float], experience: Experience) -> list[Judged]:
    """Bounds of the errors of candidates, and their expected costs, from materials with like features.

    The fullest candidate leaves nothing out: its error is 0, and it needs no likeness.
    """
    judged = []
    for candidate in candidates:
        near = experience.nearest(features, candidate, RADIUS)[:MOST_NEIGHBOURS]
        trials = [trial for _, trial in near]
        cost = float(np.median([trial.cost for trial in trials])) if trials else np.nan
        enough = len(trials) >= LEAST_NEIGHBOURS
        error = MARGIN * max(trial.error for trial in trials) if enough else np.inf
        judged.append(Judged(candidate, 0.0 if candidate == FULLEST else error, cost, len(trials)))
    return judged


def chosen(judged: Sequence[Judged], tolerance: float) -> Judged:
    """The cheapest candidate whose error is within the tolerance; the fullest one where no other is."""
    allowed = [one for one in judged if one.error <= tolerance and np.isfinite(one.cost)]
    fullest = next(one for one in judged if one.candidate == FULLEST)
    return min(allowed, key=lambda one: one.cost, default=fullest)


def plan(
    inputs: ModelInputs, experience: Experience, *, scene: str, metric: str, unit: str, tolerance: float, errors_of: str
) -> xr.Dataset:
    """The cheapest model of a material whose error a scene accepts.

    Parameters
    ----------
    inputs : of the material
    experience : errors that were measured for the scene; of another metric or domain they are not used
    scene, metric, unit, tolerance, errors_of : of the scene (:attr:`brdfpipe.scenes.scene.Scene.accepted_error`)

    Returns
    -------
    Dataset of kind ``plan``: ``error_bound(candidate)`` in the unit of the metric, ``expected_cost(candidate)`` [s], the number of
    ``similar_materials(candidate)``, and which is ``chosen``; the rungs of each candidate; the features of the material

    Raises
    ------
    ToleranceError : the fullest model misses the tolerance on like materials.
    """
    usable = experience if (experience.metric, experience.scene) == (metric, errors_of) else NONE
    found = features(inputs)
    judged = judge(inputs.structures, found, usable)
    choice = chosen(judged, tolerance)
    best = usable.model_error(found, RADIUS, LEAST_NEIGHBOURS)
    if best > tolerance:
        raise ToleranceError(
            f"scene {scene!r}: the tolerance {tolerance:g} {unit} of the metric {metric!r} is not achievable: on like materials the fullest model "
            f"errs by at least {best:.2g} {unit}; raise `tolerance` to that, or set `model: fullest`"
        )
    result = plan_dataset(judged, choice, found, scene=scene, metric=metric, unit=unit, tolerance=tolerance)
    return vocabulary.add_history(
        result, f"{choice.candidate} was chosen: {_reason(choice, judged, usable, tolerance, unit)}"
    )


def _reason(choice: Judged, judged: Sequence[Judged], experience: Experience, tolerance: float, unit: str) -> str:
    if not experience.materials:
        return "no errors were measured for this scene; `make tradeoff` measures those of the shipped scenes"
    if choice.candidate != FULLEST:
        return f"it errs by at most {choice.error:.2g} {unit} on {choice.neighbours} like materials, and {tolerance:g} {unit} is accepted"
    if all(one.neighbours < LEAST_NEIGHBOURS for one in judged):
        return f"fewer than {LEAST_NEIGHBOURS} of the {len(experience.materials)} materials tried resemble this one"
    return f"no cheaper one errs by less than {tolerance:g} {unit} on like materials"


def chosen_candidate(plan: xr.Dataset) -> Candidate:
    """The candidate that a plan chose."""
    at = int(plan["chosen"].values.argmax())
    return Candidate(**{name: str(plan[f"rung_{name}"].values[at]) for name in LADDERS})


def plan_dataset(
    judged: Sequence[Judged], choice: Judged, features: Mapping[str, float], **attributes: str | float
) -> xr.Dataset:
    """Dataset of kind ``plan``: the candidates with bounds of their errors, their costs, and the choice."""
    rungs = {name: ("candidate", [one.candidate.rungs[name] for one in judged]) for name in LADDERS}
    dataset = xr.Dataset(
        {
            "error_bound": ("candidate", [one.error if np.isfinite(one.error) else np.nan for one in judged]),
            "expected_cost": ("candidate", [one.cost for one in judged]),
            "similar_materials": ("candidate", [one.neighbours for one in judged]),
            "chosen": ("candidate", [int(one is choice) for one in judged]),
            "feature_value": ("feature", list(features.values())),
        },
        coords={"feature": list(features), **{f"rung_{name}": values for name, values in rungs.items()}},
        attrs={**attributes, "choice": str(choice.candidate)},
    )
    return vocabulary.label(dataset, "plan")

"""The cheapest model that a scene allows for a material.

The error of a candidate on this material is not known before both it and the fullest model are built, which costs more than it saves. It is
bounded by a regression of the errors that the same candidate had on other materials (:mod:`brdfpipe.scenes.experience`). Where none of
these resembles the material, the bound is wide and the fullest model is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes.error_regression import Prediction
from brdfpipe.scenes.experience import CERTAINTY, NONE, Experience
from brdfpipe.scenes.features import features, in_spreads
from brdfpipe.scenes.ladders import FULLEST, LADDERS, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.numerics import FINE, numerics_for


class ToleranceError(BrdfpipeError):
    """A tolerance that no model meets."""


class Judged(NamedTuple):
    """A candidate for a material."""

    candidate: Candidate
    expected_error: float
    """Infinite where it was tried on too few materials"""
    bound: float
    """Upper bound of its error, by which 99 % of random materials have errors within the tolerance of a shipped scene; infinite where it was
    tried on too few materials"""
    cost: float
    """Expected processor time of its build [s]; NaN where it is not known"""


def judge(candidates: Sequence[Candidate], features: Mapping[str, float], experience: Experience) -> list[Judged]:
    """Errors of candidates with their bounds, and their costs, expected from other materials.

    The fullest candidate leaves nothing out: its error is 0.
    """
    at = in_spreads(features).tolist()
    errors = {one: regression.at(at) for one in candidates if (regression := experience.error(one))}
    costs = {one: regression.at(at) for one in candidates if (regression := experience.cost(one))}
    return [judgement(one, errors.get(one), costs.get(one), experience.deviations) for one in candidates]


def judgement(candidate: Candidate, error: Prediction | None, cost: Prediction | None, deviations: float) -> Judged:
    """A candidate whose error and cost are expected to be these, None where they are not known; bounds are ``deviations`` above."""
    seconds = math.nan if cost is None else cost.bound(0.0)
    if candidate == FULLEST:
        return Judged(candidate, 0.0, 0.0, seconds)
    if error is None:
        return Judged(candidate, math.inf, math.inf, seconds)
    return Judged(candidate, error.bound(0.0), error.bound(deviations), seconds)


def chosen(judged: Sequence[Judged], tolerance: float) -> Judged:
    """The cheapest candidate whose error is within the tolerance; the fullest one where no other is."""
    allowed = [one for one in judged if one.bound <= tolerance and np.isfinite(one.cost)]
    fullest = next(one for one in judged if one.candidate == FULLEST)
    return min(allowed, key=lambda one: one.cost, default=fullest)


class Achievable(NamedTuple):
    """The best that can be achieved for a material: smaller tolerances are refused, this one and larger ones are not."""

    error: float
    """In the unit of the metric"""
    reason: str


def achievable(features: Mapping[str, float], experience: Experience, tolerance: float) -> Achievable | None:
    """The best error for a material, where it is certain that no model has one within the tolerance; else None.

    Either the fullest model itself misses smaller errors with 99 % certainty, by what it missed on other materials, or errors as small
    were not told apart when they were measured.
    """
    limits = []
    if experience.model_error is not None:
        of_model = experience.model_error.at(in_spreads(features).tolist())
        text = "the fullest model itself has a larger error with 99 % certainty, by what it misses on other materials"
        limits.append(Achievable(of_model.bound(-CERTAINTY), text))
    if experience.materials:
        text = "smaller errors were not told apart when those of models were measured"
        limits.append(Achievable(experience.least_error, text))
    best = max(limits, key=lambda limit: limit.error, default=None)
    return best if best is not None and tolerance < best.error else None


def not_below(value: float) -> str:
    """A positive number in two digits, rounded to the next that is not below it."""
    nearest = float(f"{value:.2g}")
    return f"{nearest if nearest >= value else nearest + 10 ** (math.floor(math.log10(value)) - 1):.2g}"


def plan(
    inputs: ModelInputs,
    experience: Experience,
    *,
    scene: str,
    metric: str,
    unit: str,
    tolerance: float,
    errors_of: str,
) -> xr.Dataset:
    """The cheapest model of a material whose error a scene accepts.

    Parameters
    ----------
    inputs : of the material
    experience : errors that were measured for the scene; of another metric or domain they are not used
    scene, metric, unit, tolerance, errors_of : of the scene (:attr:`brdfpipe.scenes.scene.Scene.accepted_error`)

    Returns
    -------
    Dataset of kind ``plan``: ``expected_error(candidate)`` and ``error_bound(candidate)`` in the unit of the metric,
    ``expected_cost(candidate)`` [s], and which is ``chosen``; the rungs of each candidate; the features of the material. The attribute
    ``numerics`` names how it is computed, and ``numerical_error`` is the error of that, which bounds do not contain

    Raises
    ------
    ToleranceError : a tolerance that cannot be achieved, with the best that can (:func:`achievable`).
    """
    usable = experience if experience.scene == errors_of else NONE
    found = features(inputs)
    best = achievable(found, usable, tolerance)
    if best is not None:
        raise ToleranceError(
            f"scene {scene!r}: the metric {metric!r} cannot achieve `tolerance`: found {tolerance:g} {unit}; the best achievable is "
            f"{not_below(best.error)} {unit}: {best.reason}; raise `tolerance` to that, or set `model: fullest`"
        )
    judged = judge(inputs.structures, found, usable)
    numerics, numerical_error = numerics_for(metric, tolerance, inputs.lay)
    if numerical_error and achievable(found, usable, tolerance - numerical_error) is not None:
        # The error of the fullest model and that of its numerics together would exceed the tolerance.
        numerics, numerical_error = FINE, 0.0
    choice = chosen(judged, tolerance - numerical_error)
    result = plan_dataset(
        judged,
        choice,
        found,
        scene=scene,
        metric=metric,
        unit=unit,
        tolerance=tolerance,
        numerics=numerics,
        numerical_error=numerical_error,
    )
    text = f"{choice.candidate} was chosen: {_reason(choice, judged, usable, tolerance - numerical_error, unit)}"
    if numerical_error:
        text += f"; {numerics} numerics, with an error of up to {numerical_error:g} {unit} of the {tolerance:g} {unit} of the scene"
    return vocabulary.add_history(result, text)


def _reason(choice: Judged, judged: Sequence[Judged], experience: Experience, tolerance: float, unit: str) -> str:
    if not experience.materials:
        return "no errors were measured for this scene; `make tradeoff` measures those of the shipped scenes"
    if choice.candidate != FULLEST:
        return (
            f"its error is expected to be {choice.expected_error:.2g} {unit}, and with the margin for a single material {choice.bound:.2g} {unit}; "
            f"{tolerance:g} {unit} is accepted"
        )
    if all(math.isinf(one.bound) for one in judged if one.candidate != FULLEST):
        return f"no other model was tried on enough of the {len(experience.materials)} materials"
    return (
        f"of no cheaper one the expected error, with the margin for a single material, is within {tolerance:g} {unit}"
    )


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
            "expected_error": ("candidate", [_finite(one.expected_error) for one in judged]),
            "error_bound": ("candidate", [_finite(one.bound) for one in judged]),
            "expected_cost": ("candidate", [one.cost for one in judged]),
            "chosen": ("candidate", [int(one is choice) for one in judged]),
            "feature_value": ("feature", list(features.values())),
        },
        coords={"feature": list(features), **{f"rung_{name}": values for name, values in rungs.items()}},
        attrs={**attributes, "choice": str(choice.candidate)},
    )
    return vocabulary.label(dataset, "plan")


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan

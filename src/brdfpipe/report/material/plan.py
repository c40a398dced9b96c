"""The model that a scene needs: candidates, their errors and costs, and the choice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import MISSING
from brdfpipe.scenes.ladders import LADDERS, Candidate
from brdfpipe.scenes.planning import chosen_candidate

_TITLE = "The cheapest model that the scene accepts"


def plan_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Candidates by cost, with the errors that are expected from other materials; empty without a plan."""
    section = Section(_TITLE)
    if (plan := datasets.get("plan")) is None:
        return section
    costs = plan["expected_cost"].values
    order = np.argsort(np.where(np.isnan(costs), np.inf, costs), kind="stable")
    rows = [_row(plan, int(at)) for at in order]
    unit, tolerance = plan.attrs["unit"], float(plan.attrs["tolerance"])
    columns = (
        "Model, by what it leaves out",
        f"Expected error [{unit}]",
        f"With the margin [{unit}]",
        "Processor time [s]",
        "",
    )
    accepted = (
        f"The scene {plan.attrs['scene']} accepts an error of {tolerance:g} {unit}, metric {plan.attrs['metric']}. "
    )
    history = str(plan.attrs.get("history", "")).splitlines()
    section.tables.append(Table("Models of the surface", columns, rows, accepted + (history[-1] if history else "")))
    return section


def choice_words(datasets: Mapping[str, xr.Dataset]) -> str:
    """What the planned model leaves out, and by how much it may err; empty without a plan, or where nothing is left out."""
    if (plan := datasets.get("plan")) is None or not (left_out := chosen_candidate(plan).leaves_out):
        return ""
    at = int(plan["chosen"].values.argmax())
    expected, bound = (float(plan[name].values[at]) for name in ("expected_error", "error_bound"))
    unit = plan.attrs["unit"]
    return (
        f"For the scene {plan.attrs['scene']}, the model leaves out: {'; '.join(left_out)}. The error by this is expected to be {expected:.2g} "
        f"{unit}, and with the margin for a single material {bound:.2g} {unit}; the scene accepts {float(plan.attrs['tolerance']):g} {unit}"
    )


def _row(plan: xr.Dataset, at: int) -> tuple[str, ...]:
    candidate = Candidate(**{name: str(plan[f"rung_{name}"].values[at]) for name in LADDERS})
    values = (float(plan[name].values[at]) for name in ("expected_error", "error_bound", "expected_cost"))
    return (
        str(candidate),
        *(MISSING if np.isnan(value) else f"{value:.2g}" for value in values),
        "chosen" if plan["chosen"].values[at] else "",
    )

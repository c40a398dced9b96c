"""Readings of instruments beside what the BSDF predicts of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import xarray as xr

from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.comparison import findings
from brdfpipe.comparison.findings import height_words, plus_minus
from brdfpipe.comparison.readings import FAIL_ABOVE, WARN_ABOVE
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import STANDARD, fixed, number, value_with_u


def readings_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The readings with their predictions, z and why some are not predicted; empty without readings."""
    section = Section("Readings")
    if (readings := datasets.get("readings")) is not None:
        section.tables.append(_table(readings))
        section.tables += filter(None, [_input_table(readings)])
    return section


def _table(readings: xr.Dataset) -> Table:
    units = json.loads(readings.attrs["units_of_readings"])
    reasons = json.loads(readings.attrs["not_predicted"])
    rows = [_row(readings.isel(reading=k), unit) for k, unit in enumerate(units)]
    source = ", ".join(filter(None, (str(readings.attrs.get(name, "")) for name in ("instrument", "date"))))
    notes = [f"Read with: {source}."] if source else []
    notes.append(
        f"z: read less predicted over the standard uncertainty of both; the verdict is warn above {WARN_ABOVE:g} and fail above {FAIL_ABOVE:g}."
    )
    if missing := str(readings.attrs.get(NOT_STATED, "")):
        notes.append(f"The uncertainty of the prediction leaves out: {missing}.")
    if fitted := json.loads(readings.attrs.get("fitted", "[]")):
        notes.append(
            f"The BRDF was fitted to {', '.join(fitted)}: their z is over the uncertainty of the reading alone, and says whether one finish explains them all."
        )
    notes += [f"{name} is not predicted: {reason}" for name, reason in reasons.items()]
    title = f"Readings of instruments and predictions ({STANDARD})"
    adjusted = ("z with the inputs below",) if "z_adjusted" in readings else ()
    if "posterior" not in readings:
        notes += [f"{text.removesuffix('.')}." for text in findings.sentences(readings)]
    header = ("Reading", "Read", "Predicted", "Read − predicted", "z", *adjusted)
    return Table(title, header, rows, " ".join(notes))


def _input_table(readings: xr.Dataset) -> Table | None:
    """The inputs that would agree with the readings; None where nothing was fitted."""
    if "posterior" not in readings:
        return None
    rows = []
    for name in map(str, readings["input"].values):
        one = readings.sel(input=name)
        before, before_u, after, after_u = (
            float(one[part]) for part in ("prior", "prior_u", "posterior", "posterior_u")
        )
        title = findings.NAMES[name]
        if name == "finer":
            words = height_words(before, before_u), height_words(after, after_u)
        else:
            sign = "+" if name == "index" else ""
            words = plus_minus(before, before_u, sign), plus_minus(after, after_u, sign)
        rows.append((title[:1].upper() + title[1:], *words))
    sentences = findings.sentences(readings)
    note = " ".join(f"{text[:1].upper()}{text[1:]}." for text in sentences)
    title = f"Inputs that would agree with the readings ({STANDARD}); not applied"
    return Table(title, ("Input", "As given", "As the readings ask"), rows, note)


def _row(one: xr.Dataset, unit: str) -> tuple[str, ...]:
    read, u, predicted, predicted_u, z = (
        float(one[name]) for name in ("read_value", "read_u", "predicted_value", "predicted_u", "z")
    )
    decimals = 3 if abs(read) <= 1 and unit == "1" else 1
    known = math.isfinite(predicted)
    return (
        f"{one['reading'].values!s}" + (f" [{unit}]" if unit != "1" else ""),
        value_with_u(read, u, decimals),
        value_with_u(predicted, predicted_u, decimals) if known else "–",
        fixed(read - predicted, decimals) if known else "–",
        number(z, 2) if known else "–",
        *([number(float(one["z_adjusted"]), 2)] if "z_adjusted" in one else []),
    )

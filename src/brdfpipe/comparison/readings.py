"""Readings of a laboratory's own instruments beside what the BSDF predicts of them.

A reading is judged by z, the difference over the standard uncertainty of both: that of the reading, and that of the prediction from the inputs of its
BSDF, its model and the tolerances of instruments.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.colours import TOTAL, WITHOUT_SPECULAR, colour, colour_without_specular
from brdfpipe.appearance.computation import compute_appearance
from brdfpipe.appearance.gloss_meter import gloss
from brdfpipe.appearance.haze import reflectance_haze
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges, uncertain
from brdfpipe.comparison.reading_defaults import LAB_U, REFLECTANCE_HAZE_U, TRANSMITTANCE_U, gloss_u
from brdfpipe.geometry import Array

WARN_ABOVE, FAIL_ABOVE = 2.0, 3.0
"""|z| of a reading above which its verdict is warn, or fail: 95 and 99.7 % of the readings of a right prediction are below."""

_COMPONENTS = ("L*", "a*", "b*")


class Reading(NamedTuple):
    """One number that an instrument read."""

    title: str
    unit: str
    """``GU`` (gloss units) or ``1``."""
    value: float
    u: float
    """Its standard uncertainty."""
    part: str
    """Of the appearance that predicts it."""
    variable: str
    at: Mapping[str, Any]
    """Coordinates of the variable."""
    seen_under: tuple[str, int] = ("D65", 10)
    """Illuminant, and observer [degree]."""


def readings_of(measured: Mapping[str, Any]) -> list[Reading]:
    """The readings of the key ``measured``, in the order of the page."""
    return list(_readings(measured))


def _readings(measured: Mapping[str, Any]) -> Iterator[Reading]:
    stated = measured.get("uncertainty", {})
    for angle, value in measured.get("gloss", {}).items():
        u = gloss_u(value, stated.get("gloss"))
        yield Reading(f"gloss {angle}°", "GU", value, u, "gloss", "gloss", {"gloss_angle": float(angle)})
    if "haze" in measured:
        u = stated.get("haze", math.sqrt(2) * gloss_u(measured["haze"], stated.get("gloss")))
        yield Reading("haze D4039", "GU", measured["haze"], u, "gloss", "haze", {})
    if "reflectance_haze" in measured:
        u = stated.get("reflectance_haze", REFLECTANCE_HAZE_U)
        yield Reading(
            "haze ISO 13803", "GU", measured["reflectance_haze"], u, "haze", "reflectance_haze", {"haze_window": 0}
        )
    for entry in measured.get("lab", []):
        seen_under = entry.get("illuminant", "D65"), entry.get("observer", 10)
        for component, value in zip(_COMPONENTS, entry["lab"], strict=True):
            title = f"{component} {entry['geometry']}, {seen_under[0]}/{seen_under[1]}°"
            at, variable = {"geometry": entry["geometry"], "component": component}, "lab"
            if at["geometry"] == WITHOUT_SPECULAR:
                at, variable = {"component": component}, "lab_sce"
            yield Reading(title, "1", value, stated.get("lab", LAB_U), "colour", variable, at, seen_under)
    if "transmittance" in measured:
        u = stated.get("transmittance", TRANSMITTANCE_U)
        yield Reading("transmittance", "1", measured["transmittance"], u, "transmission", "luminous_transmittance", {})


def compare_readings(bsdf: xr.Dataset, measured: Mapping[str, Any], fitted: Sequence[str] = ()) -> xr.Dataset:
    """Compare readings of instruments with what a BSDF predicts.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    measured : the key of that name: ``gloss`` (geometry in degree → gloss units), ``haze``, ``reflectance_haze``, ``lab`` (a list of ``geometry``,
        ``lab``, ``illuminant``, ``observer``), ``transmittance``; ``uncertainty`` of each, ``instrument`` and ``date``
    fitted : titles of readings that the BSDF was fitted to. The prediction is not independent of them, so that its uncertainty is left out of their z

    Returns
    -------
    Dataset of kind ``readings`` over ``reading``: ``read_value``, ``read_u``, ``predicted_value``, ``predicted_u`` (NaN where it is not known) and ``z``,
    read less predicted over the uncertainty of both. Attributes ``units_of_readings``, ``not_predicted`` (reasons by reading, JSON) and ``verdicts``

    Raises
    ------
    BrdfpipeError : an unknown geometry, illuminant or observer.
    """
    vocabulary.validate(bsdf, "bsdf")
    readings = readings_of(measured)
    predicted = _predicted(bsdf, readings)
    rows, reasons = [], {}
    for reading in readings:
        value, u, reason = predicted[reading.title]
        if reason:
            reasons[reading.title] = reason
        of_prediction = 0.0 if reading.title in fitted or math.isnan(u) else u
        rows.append(
            (reading.value, reading.u, value, u, (reading.value - value) / math.hypot(reading.u, of_prediction))
        )
    columns = np.array(rows, dtype=float).T
    names = ("read_value", "read_u", "predicted_value", "predicted_u", "z")
    result = xr.Dataset(
        {name: ("reading", column) for name, column in zip(names, columns, strict=True)},
        coords={"reading": [reading.title for reading in readings]},
        attrs={
            "units_of_readings": json.dumps([reading.unit for reading in readings]),
            "fitted": json.dumps(list(fitted), ensure_ascii=False),
            "not_predicted": json.dumps(reasons, ensure_ascii=False),
            "findings": "[]",
            NOT_STATED: str(bsdf.attrs.get(NOT_STATED, "" if uncertain(bsdf) else "all inputs")),
            **{name: str(measured[name]) for name in ("instrument", "date") if name in measured},
        },
    )
    result.attrs["verdicts"] = json.dumps(_verdicts(result), ensure_ascii=False)
    return vocabulary.label(result, "readings")


def _predicted(bsdf: xr.Dataset, readings: Sequence[Reading]) -> dict[str, tuple[float, float, str]]:
    """Value, standard uncertainty (NaN where not known) and reason of a missing value, of each reading by its title."""
    found = {}
    for seen_under in dict.fromkeys(reading.seen_under for reading in readings):
        group = [reading for reading in readings if reading.seen_under == seen_under]
        angles = sorted({one.at["gloss_angle"] for one in group if "gloss_angle" in one.at})
        if any(one.variable == "haze" for one in group):
            angles = sorted({*angles, 20.0, 60.0})
        geometries = dict.fromkeys(one.at["geometry"] for one in group if "geometry" in one.at)
        appearance = compute_appearance(
            bsdf,
            illuminant=seen_under[0],
            observer=seen_under[1],
            gloss_angles=angles,
            geometries=[name for name in geometries if name != TOTAL],
            parts=list(dict.fromkeys(one.part for one in group)),
            standard_geometries=False,
        )
        if any(one.variable == "lab_sce" for one in group):
            appearance["lab_sce_u"] = ("component", _without_specular_u(bsdf, seen_under))
        for reading in group:
            found[reading.title] = _one(appearance, bsdf, reading)
    return found


def _without_specular_u(bsdf: xr.Dataset, seen_under: tuple[str, int]) -> Array:
    """Standard uncertainty of L*a*b* with the specular excluded from the inputs of the BSDF, (3,); NaN where that of the spectrum is not known."""
    if not uncertain(bsdf) or "spectrum" in str(bsdf.attrs.get(NOT_STATED, "")).split(", "):
        return np.full(3, np.nan)
    changes = SourceChanges.of(bsdf)
    given, *changed = (
        colour_without_specular(bsdf, *seen_under, reflector=one).values for one in (changes.given, *changes.changed)
    )
    return np.asarray(np.sqrt(np.square(np.array(changed) - given).sum(axis=0)))


def predicted_values(bsdf: xr.Dataset, readings: Sequence[Reading]) -> Array:
    """What a BSDF predicts of gloss, haze and colours, (readings,), without uncertainties; other readings are NaN."""
    angles = sorted({20.0, 60.0} | {one.at["gloss_angle"] for one in readings if "gloss_angle" in one.at})
    units = dict(zip(angles, gloss(bsdf, angles).values.tolist(), strict=True))
    beside = float(reflectance_haze(bsdf)[0]) if any(one.part == "haze" for one in readings) else math.nan
    labs = {
        seen_under: colour(bsdf, [one for one in names if one != TOTAL], *seen_under)
        for seen_under, names in _geometries(readings).items()
    }
    excluded = {
        seen_under: xr.Dataset({"lab_sce": colour_without_specular(bsdf, *seen_under)})
        for seen_under in {one.seen_under for one in readings if one.variable == "lab_sce"}
    }
    values = []
    for one in readings:
        if one.variable == "lab_sce":
            values.append(_at(excluded[one.seen_under], "lab_sce", one.at))
        elif one.part == "colour":
            values.append(_at(xr.Dataset({"lab": labs[one.seen_under]}), "lab", one.at))
        else:
            known = {"gloss": units.get(one.at.get("gloss_angle"), math.nan), "haze": units[60.0] - units[20.0]}
            values.append((known | {"reflectance_haze": beside}).get(one.variable, math.nan))
    return np.array(values)


def _geometries(readings: Sequence[Reading]) -> dict[tuple[str, int], list[str]]:
    """Names of the geometries of colours by illuminant and observer."""
    found: dict[tuple[str, int], list[str]] = {}
    for one in readings:
        if "geometry" in one.at and one.at["geometry"] not in found.setdefault(one.seen_under, []):
            found[one.seen_under].append(one.at["geometry"])
    return found


def _one(appearance: xr.Dataset, bsdf: xr.Dataset, reading: Reading) -> tuple[float, float, str]:
    reason = _not_predicted(appearance, bsdf, reading)
    if reason:
        return math.nan, math.nan, reason
    value = _at(appearance, reading.variable, reading.at)
    # Without that of the BSDF the tolerances of instruments alone are known.
    return value, _at(appearance, f"{reading.variable}_u", reading.at), ""


def _not_predicted(appearance: xr.Dataset, bsdf: xr.Dataset, reading: Reading) -> str:
    """Why a reading is not predicted; empty where it is."""
    if reading.part in ("gloss", "haze"):
        if reason := str(appearance.attrs.get("no_gloss", "")):
            return reason
        if representation(bsdf).name == "lambert_gauss" and bsdf.attrs.get("route") == "predicted":
            return "No surface finish was measured or assumed. Set `surface` in material.yaml to predict gloss."
    if reading.variable not in appearance:
        return "The BRDF is that of an opaque body." if reading.part == "transmission" else "It was not computed."
    return ""


def _at(appearance: xr.Dataset, name: str, at: Mapping[str, Any]) -> float:
    if name not in appearance:
        return math.nan
    variable = appearance[name]
    for dimension, label in at.items():
        variable = variable.isel({dimension: label}) if isinstance(label, int) else variable.sel({dimension: label})
    return float(variable)


def _verdicts(readings: xr.Dataset) -> dict[str, dict[str, str]]:
    """The verdict of all readings together: that of the one that is furthest from its prediction."""
    z = np.abs(readings["z"].values)
    if not np.isfinite(z).any():
        return {"readings": {"verdict": "warn", "text": "none of the readings is predicted"}}
    worst = int(np.nanargmax(z))
    verdict = "fail" if z[worst] > FAIL_ABOVE else "warn" if z[worst] > WARN_ABOVE else "pass"
    one = readings.isel(reading=worst)
    u = float(one["predicted_u"])
    predicted = f"{float(one['predicted_value']):.4g}" + (f" ± {u:.2g}" if math.isfinite(u) else "")
    text = (
        f"{one['reading'].values!s}: read {float(one['read_value']):.4g} ± {float(one['read_u']):.2g}, predicted {predicted}, "
        f"z = {float(one['z']):.1f}"
    ).replace("z = -", "z = −")
    outside = int(np.sum(z > WARN_ABOVE))
    if verdict != "pass":
        text += f"; {outside} of {int(np.isfinite(z).sum())} readings are more than {WARN_ABOVE:g} standard uncertainties off"
    else:
        text = f"all within {WARN_ABOVE:g} standard uncertainties of their predictions; the furthest is {text}"
    return {"readings": {"verdict": verdict, "text": text}}


def readings_table(readings: xr.Dataset) -> str:
    """The readings as comma-separated values."""
    frame = pd.DataFrame(
        {
            "reading": [str(name) for name in readings["reading"].values],
            "unit": json.loads(readings.attrs["units_of_readings"]),
            "read": readings["read_value"].values,
            "read_u": readings["read_u"].values,
            "predicted": readings["predicted_value"].values,
            "predicted_u": readings["predicted_u"].values,
            "z": readings["z"].values,
        }
    )
    return str(frame.to_csv(index=False, float_format="%.6g", lineterminator="\n"))

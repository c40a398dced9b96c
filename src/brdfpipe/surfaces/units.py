"""Units and pitches, from the material file or from settings inside the data file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe.errors import InputError

UNITS = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "μm": 1.0, "mm": 1e3, "m": 1e6}
"""Length of each unit in µm."""


def scales(
    path: Path, settings: Mapping[str, str], unit: str | None, lateral_unit: str | None, *, setting: str
) -> tuple[float, float]:
    """Factors that convert heights and positions to µm.

    Parameters
    ----------
    settings : ``unit`` and ``lateral_unit`` of the data file
    unit, lateral_unit : of the material file, which have priority. Positions are in the unit of the heights by default
    setting : how a data file of this format states a unit, for the message
    """
    unit = unit or settings.get("unit")
    if unit is None:
        problem, accepted = "the unit of the heights is missing", f"nm, um, mm, m, or {setting} in the file"
        raise InputError(path, problem, accepted=accepted, key="surface.unit")
    lateral_unit = lateral_unit or settings.get("lateral_unit") or unit
    for key, value in (("unit", unit), ("lateral_unit", lateral_unit)):
        if value not in UNITS:
            found, accepted = repr(value)[:60], "nm, um, mm, m"
            raise InputError(path, "unknown unit", found=found, accepted=accepted, key=f"surface.{key}")
    return UNITS[unit], UNITS[lateral_unit]


def pitch_steps(path: Path, settings: Mapping[str, str], pitch: Any) -> tuple[float, ...]:
    """The stated pitch in x and, if given, in y; empty if none is stated."""
    if pitch is None:
        pitch = [part.replace(",", ".") for part in re.split(r"[;\s]+", settings.get("pitch", "")) if part]
    parts = pitch if isinstance(pitch, (list, tuple, np.ndarray)) else [pitch]
    try:
        steps = tuple(float(part) for part in parts)
    except (TypeError, ValueError):
        steps = (math.nan,)
    if len(steps) > 2 or not all(math.isfinite(step) and step > 0 for step in steps):
        found, accepted = repr(pitch)[:60], "a length above 0, or two: [x, y]"
        raise InputError(path, "invalid pitch", found=found, accepted=accepted, key="surface.pitch")
    return steps


def needed_steps(path: Path, steps: Sequence[float], *, setting: str) -> tuple[float, ...]:
    """The stated pitch, required for files without positions."""
    if not steps:
        accepted = f"a length or [x, y] in surface.lateral_unit, or {setting} in the file"
        raise InputError(path, "the pitch is missing", accepted=accepted, key="surface.pitch")
    return tuple(steps)

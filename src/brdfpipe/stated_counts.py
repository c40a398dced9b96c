"""Counts, ends and steps that the header of a table states, compared with its rows: lost or added rows contradict them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from brdfpipe.geometry import Array

_NUMBER = r"(\d+(?:[.,]\d*)?)"
_UNIT = r"(?:\s*[\[(]?(?:nm|[µμu]m)[\])]?)?"
_IS = r"\s*[:=;,\t]\s*"
_COUNT = re.compile(
    r"(?:number of (?:x )?(?:values|points|wavelengths|rows|data(?: points)?)|npoints|(?:data |measured )?points|wavelengths|messpunkte"
    rf"|anzahl(?: der)? \w+){_IS}(\d{{1,9}})[\s;,]*",
    re.IGNORECASE,
)
_END = re.compile(
    rf"(first|last|start|end)(?:ing)?(?: x| wavelength|wellenlänge)?(?: value)?{_UNIT}{_IS}{_NUMBER}{_UNIT}[\s;,]*",
    re.IGNORECASE,
)
_RANGE = re.compile(
    rf"(?:wavelength |data |scan )?range{_UNIT}{_IS}{_NUMBER}{_UNIT}\s*(?:-|–|to|bis|\.\.+|;|,|\s)\s*{_NUMBER}{_UNIT}[\s;,]*",
    re.IGNORECASE,
)
_STEP = re.compile(
    rf"(?:wavelength |data |scan )?(?:interval|step(?: size| width)?|increment|schrittweite|intervall){_UNIT}{_IS}{_NUMBER}{_UNIT}[\s;,]*",
    re.IGNORECASE,
)


def contradictions(header: Sequence[str], positions: Array) -> list[str]:
    """Doubts about a table whose rows contradict its header.

    Parameters
    ----------
    header : lines of words, without comment marks
    positions : (rows,) first column; numbers of the header in nm count where these are in µm
    """
    present = positions[np.isfinite(positions)]
    if present.size < 2:
        return []
    doubts = []
    for line in map(str.strip, header):
        if (count := _COUNT.fullmatch(line)) and int(count[1]) != positions.size:
            doubts.append(
                f"the header states {count[1]} rows, {positions.size} were found. Look for rows lost or added"
            )
        if end := _END.fullmatch(line):
            word = "first" if end[1].lower() in ("first", "start") else "last"
            doubts += _off(f"a {word} X of", end[2], float(present[0 if word == "first" else -1]))
        if ends := _RANGE.fullmatch(line):
            doubts += _off("a range from", ends[1], float(present.min()))
            doubts += _off("a range up to", ends[2], float(present.max()))
        if step := _STEP.fullmatch(line):
            doubts += _off("a step of", step[1], float(np.median(np.abs(np.diff(present)))), 1e-2)
    return doubts


def _off(what: str, stated: str, found: float, tolerance: float = 1e-3) -> list[str]:
    number = float(stated.replace(",", "."))
    # A header in nm above a table in µm.
    if any(abs(number - value) <= tolerance * abs(number) for value in (found, 1000 * found)):
        return []
    return [f"the header states {what} {number:g}, {found:g} was found. Look for lost rows"]

"""Units that the titles of columns state: ``X [mm];Z [µm]``, ``Lateral um,Raw Micrometer``, or a line of units below the titles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from brdfpipe.surfaces.units import UNITS

_NAMES = {"nano": "nm", "micro": "um", "milli": "mm", "": "m"}
_UNIT = r"nm|[uµμ]m|mm|m|microns?|(?:nano|micro|milli)?met(?:er|re)s?"
_ENCLOSED = re.compile(rf"[\[(]\s*({_UNIT})\s*[\])]", re.IGNORECASE)
_AFTER_NAME = re.compile(rf".*(?:/\s*|\s)({_UNIT})", re.IGNORECASE)
_ALONE = re.compile(rf"({_UNIT})", re.IGNORECASE)
_TITLE_LINES = 2
"""Lines above the numbers that may be titles: names, and a line of units."""


class TitledUnits(NamedTuple):
    """Units of a table; ``lateral`` is None for heights alone, or where the title of a position has none."""

    height: str
    lateral: str | None


def titled_units(header: Sequence[str], columns: int) -> TitledUnits | None:
    """The units of heights, in the last column, and of positions, in the columns before; None if the titles state none of the heights.

    Parameters
    ----------
    header : lines above the first line of numbers
    columns : of the table: 1 (heights), 2 (x and heights) or 3 (x, y and heights)
    """
    for line in reversed(header[-_TITLE_LINES:]):
        units = _units(line.strip().lstrip("#%").strip())
        if len(units) != columns or units[-1] is None or (columns == 1 and not _ENCLOSED.search(line)):
            continue
        lateral = set(units[:-1])
        if len(lateral) <= 1:
            return TitledUnits(units[-1], lateral.pop() if lateral else None)
    return None


def _units(line: str) -> list[str | None]:
    """The unit of each title of a line, None where a title has none."""
    separator = next((mark for mark in ";\t," if mark in line), None)
    if separator is None:
        # The blanks within titles are not separators: their units are counted instead.
        units: list[str | None] = [_name(unit) for unit in _ENCLOSED.findall(line)]
        units = units or [_of_title(word) for word in line.split()]
        return units if all(units) else []
    titles = [title.strip().strip('"') for title in line.split(separator)]
    while titles and not titles[-1]:
        titles.pop()
    return [_of_title(title) for title in titles]


def _of_title(title: str) -> str | None:
    if found := _ENCLOSED.search(title) or _ALONE.fullmatch(title):
        return _name(found[1])
    # A number above the table is a setting, as `Length 5 mm`, and the m of `Parameter m` is no unit.
    found = None if re.search(r"\d", title) else _AFTER_NAME.fullmatch(title)
    return _name(found[1]) if found and (found[1].lower() != "m" or "/" in title) else None


def _name(unit: str) -> str:
    """The unit as material.yaml writes it."""
    lower = unit.lower()
    if lower in UNITS:
        return "um" if UNITS[lower] == 1 else lower
    return "um" if lower.startswith("micro") else _NAMES[re.split("met(?:er|re)", lower)[0]]

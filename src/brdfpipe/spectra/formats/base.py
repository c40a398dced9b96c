"""What readers of spectra return and register, and the checks that they share."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from brdfpipe import columns
from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.file_formats import FileFormat
from brdfpipe.geometry import Array

PERCENT = "reflectance in percent"
FRACTION = "reflectance as a fraction"
UNSCALED = "reflectance"

_USUAL_STEPS = (1.0, 2.0, 5.0, 10.0, 20.0)
_USUAL_ENDS = (700.0, 730.0, 740.0, 750.0, 780.0, 830.0, 850.0)
"""Where spectra of colour instruments end [nm]."""


class Sample(NamedTuple):
    """One spectrum of a file."""

    name: str
    wavelength: Array
    """nm or µm according to ``unit``; in any order"""
    values: Array
    header: tuple[str, ...] = ()
    """Header lines of the file: scale, specular component, directions."""
    unit: str = "nm"
    """nm, um, or empty if the file does not state it"""
    doubts: tuple[str, ...] = ()
    """Signs of lost or damaged values, in words"""
    labels: tuple[tuple[str, str], ...] = ()
    """Title and text of the other cells that describe it, such as a date, or the specular component"""


Content = tuple[Columns | list[Sample], list[str]]
"""A table of columns, or the samples of a file; and notes for the history."""


@dataclass(frozen=True)
class SpectrumFormat(FileFormat):
    """A format of spectrum files."""

    read: Callable[[Path], Content]


def from_text(samples: Callable[[Path, str], list[Sample]]) -> Callable[[Path], Content]:
    """Reader of a file whose text ``samples`` parses."""

    def read(path: Path) -> Content:
        text, notes = columns.read_text(path)
        return samples(path, text), notes

    return read


def lines_of(text: str) -> list[str]:
    """Lines of a text with any line ends."""
    return re.split(r"\r\n|\r|\n", text)


def even_grid(low: float, step: float, count: int) -> Array:
    """Wavelengths from the first one in even steps."""
    return np.asarray(low + step * np.arange(count, dtype=float))


def parsed_sample(
    path: Path,
    where: str,
    name: str,
    wavelength: Array,
    cells: Sequence[str],
    header: tuple[str, ...] = (),
    unit: str = "nm",
    *,
    doubts: tuple[str, ...] = (),
    decimal: str = ".",
    labels: tuple[tuple[str, str], ...] = (),
) -> Sample:
    """A sample of printed numbers, with doubts about those of fewer digits than the others; ``where`` is for messages."""
    cut = columns.odd_decimals(cells, lambda i: f"at {wavelength[i]:g} nm")
    return Sample(name, wavelength, parse_numbers(path, where, cells, decimal), header, unit, (*doubts, *cut), labels)


def doubt_of_end(wavelength: Array, step: float) -> tuple[str, ...]:
    """Doubt about a spectrum whose end, from start, step and number of values, is unusual for colour instruments."""
    if not wavelength.size or (step in _USUAL_STEPS and wavelength[-1] in _USUAL_ENDS):
        return ()
    return (
        f"{wavelength.size} values from {wavelength[0]:g} nm by {step:g} nm end at {wavelength[-1]:g} nm, an unusual "
        "end. Look for lost or added values, or compare step and end with the instrument",
    )


def parse_numbers(path: Path, where: str, cells: Sequence[str], decimal: str = ".") -> Array:
    """Cells as numbers; an :class:`InputError` names the first that is invalid."""
    values = [columns.number(cell, decimal) for cell in cells]
    if None in values:
        raise InputError(path, "not a number", where=where, found=repr(cells[values.index(None)])[:60])
    return np.array(values, dtype=float)


def stated_number(path: Path, what: str, text: str) -> float:
    """A number that the file must state."""
    value = columns.number(text) if text else None
    if value is None or not np.isfinite(value):
        raise InputError(path, f"the file does not state its {what}", found=repr(text)[:40], accepted="a number")
    return value


def check_count(path: Path, count: int, stated: float) -> None:
    """Refuse a file whose number of values differs from the stated one."""
    if count != stated:
        accepted = f"{stated:g} values, as the file states"
        raise InputError(path, "truncated or damaged", found=f"{count} values", accepted=accepted)

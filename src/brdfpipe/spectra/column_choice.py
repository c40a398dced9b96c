"""Which columns of a table hold the reflectance and its standard uncertainty."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from brdfpipe.columns import Columns
from brdfpipe.errors import InputError, abbreviated
from brdfpipe.spectra import header_words, specular_words
from brdfpipe.spectra.specular_words import KnownGeometry

_MOST_NAMES = 10
"""Columns that a message lists."""


@dataclass(frozen=True)
class ChosenColumns:
    """Columns, counted from 0, with corrections for the history and doubts for the warnings."""

    value: int = 1
    deviation: int | None = None
    history: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def chosen(
    table: Columns, column: int | str | None, uncertainty: int | str | None, geometry: KnownGeometry
) -> ChosenColumns:
    """Columns of the reflectance and of its standard uncertainty.

    Parameters
    ----------
    table : the first column is the wavelength
    column, uncertainty : number (the wavelength is 1) or name; by default the first column that is not an uncertainty, and the next one
        if its title says so
    geometry : if known, a column with the other label is not taken; as a fallback only where there is another one

    Raises
    ------
    InputError : no such column, or one that holds something else.
    """
    width, names = table.values.shape[1], table.names or ()
    uncertainties = {i for i in range(1, width) if names and header_words.is_uncertainty(names[i], names)}
    values = [i for i in range(1, width) if i not in uncertainties]
    log = ChosenColumns()
    if column is not None:
        value = _position(table, column, "spectrum.column")
        _refuse_other_geometry(table, [value], geometry)
    elif values:
        value = _of_geometry(table, values, geometry)
    else:
        problem, found = "every column is an uncertainty; no column of reflectances", abbreviated(names, _MOST_NAMES)
        raise InputError(table.file, problem, found=found, accepted="a number or name", key="spectrum.column")
    deviation = value + 1 if value + 1 in uncertainties else None
    if uncertainty is not None:
        deviation = _position(table, uncertainty, "spectrum.uncertainty")
    read: list[int | None] = [value, deviation]
    if deviation is not None and (problem := _unusable(table, value, deviation)):
        column_words = in_words(table, deviation)
        if uncertainty is not None:
            raise InputError(
                table.file,
                f"{column_words} is not a standard uncertainty",
                found=problem,
                accepted="absolute standard uncertainties (k = 1, or `k = …` in the title), none below 0",
                key="spectrum.uncertainty",
            )
        log.warnings.append(
            f"the uncertainty in {column_words} was ignored: {problem}. Give absolute standard uncertainties, or the coverage factor in "
            "the title, as in `U (k=2)`."
        )
        deviation = None
    if deviation is not None:
        k = header_words.coverage_factor(title_of(table, deviation))
        how = f", after division by k = {k:g}" if k != 1 else ""
        log.history.append(f"{in_words(table, deviation)} was read as the standard uncertainty (k = 1){how}")
    unused = [i for i in range(1, width) if i not in read]
    if unused:
        listed = abbreviated([in_words(table, i) for i in unused], _MOST_NAMES)
        sentence = f"{in_words(table, value)} was read; ignored: {listed}"
        log.history.append(f"{table.file}: {sentence}")
        read_geometry = (stated_geometry(table, value) if geometry.is_fallback else None) or geometry.name
        told_apart = read_geometry is not None and all(
            stated_geometry(table, i) not in (None, read_geometry) for i in unused
        )
        if column is None and not told_apart:
            log.warnings.append(f"{sentence}. Name the column to read with `spectrum.column` in material.yaml.")
    return replace(log, value=value, deviation=deviation)


def stated_geometry(table: Columns, i: int) -> str | None:
    """``sci`` or ``sce`` as the title of a column says, or a cell in any row above the numbers; None if neither does, or they contradict each
    other."""
    own = specular_words.of_title(title_of(table, i))
    if own is not None:
        return own
    labels, _ = _labels(table.rows_above)
    found = {kinds[i - 1] for kinds in labels.values()} - {None}
    if not found and table.values.shape[1] > 2:  # one word below the other
        pairs = [pair for pair in pairwise(_cells_of(table, i)) if not any(map(specular_words.geometry, pair))]
        found = {specular_words.geometry(" ".join(pair)) for pair in pairs} - {None}
    return found.pop() if len(found) == 1 else None


def header_geometry(table: Columns) -> str | None:
    """``sci`` or ``sce`` as the header says of the whole file; None if it does not, or says both."""
    labels, of_all = _labels(table.rows_above)
    lines = set(table.header) - {*labels, *of_all}
    if table.names and len(table.names) > 2:
        lines -= {table.rows_above[-1][0]}
    found = {*map(specular_words.of_line, lines), *of_all.values()} - {None}
    return found.pop() if len(found) == 1 else None


def unclear_geometry(table: Columns, i: int) -> str:
    """Words of a column or of the header that may state the specular component and are not understood; empty if there are none."""
    own = [title_of(table, i), " ".join(_cells_of(table, i))]
    if found := next((text for text in own if specular_words.is_unclear(text) or specular_words.says_both(text)), ""):
        return found
    lines = [line for line in table.header if line not in {row for row, _ in table.rows_above}]
    return next((line for line in lines if specular_words.is_unclear_line(line)), "")


@lru_cache(maxsize=8)
def _labels(
    rows_above: tuple[tuple[str, tuple[str, ...]], ...],
) -> tuple[dict[str, tuple[str | None, ...]], dict[str, str]]:
    """What rows above the numbers say of each column of values, and what those say that are alike for all columns; both by line."""
    labels: dict[str, tuple[str | None, ...]] = {}
    of_all: dict[str, str] = {}
    for line, (title, *cells) in rows_above:
        filled: list[str] = []
        for cell in cells:
            # A spreadsheet writes the text of joined cells into the first of them.
            filled.append(cell or (filled[-1] if filled else ""))
        kinds = tuple(specular_words.of_cell(title, cell) for cell in filled)
        first, *others = {*kinds}
        is_sentence = re.search("[;,\t]", line) is None and None in kinds
        if others and not is_sentence:
            labels[line] = kinds
        elif not others and first is not None:
            of_all[line] = first
    return labels, of_all


def _cells_of(table: Columns, i: int) -> list[str]:
    """The cells above a column that are not empty, from the top."""
    return [cells[i] for _, cells in table.rows_above if cells[i]]


def _of_geometry(table: Columns, values: Sequence[int], geometry: KnownGeometry) -> int:
    """The first column with the label of the geometry, or else the first without any."""
    if geometry.name is None:
        return values[0]
    for label in (geometry.name, None):
        for i in values:
            if stated_geometry(table, i) == label:
                return i
    _refuse_other_geometry(table, values, geometry)
    return values[0]


def _refuse_other_geometry(table: Columns, values: Sequence[int], geometry: KnownGeometry) -> None:
    """Refuse columns that are labelled with the other specular component."""
    own = stated_geometry(table, values[0])
    if not geometry.contradicts(own):
        return
    fitting = [
        in_words(table, i) for i in range(1, table.values.shape[1]) if stated_geometry(table, i) == geometry.name
    ]
    raise InputError(
        table.file,
        f"the column is labelled {str(own).upper()}, and the description says {str(geometry.name).upper()}",
        found=in_words(table, values[0]),
        accepted=f"`geometry: {own}`" + (f", or {abbreviated(fitting, _MOST_NAMES)}" if fitting else ""),
        key="spectrum.column" if fitting else "spectrum.geometry",
    )


def _unusable(table: Columns, value: int, deviation: int) -> str:
    """Why a column cannot hold absolute standard uncertainties; empty if it can."""
    negative = table.values[:, deviation] < 0
    problem = header_words.unusable_uncertainty(title_of(table, deviation), title_of(table, value))
    if not problem and negative.any():
        return f"{int(negative.sum())} values are negative, the first in line {table.lines[np.argmax(negative)]}"
    return problem


def _position(table: Columns, column: int | str, key: str) -> int:
    """Position, counted from 0, of a column given by number or name."""
    width, names = table.values.shape[1], table.names or ()
    if isinstance(column, int) and not isinstance(column, bool) and 2 <= column <= width:
        return column - 1
    if isinstance(column, str):
        matches = [i for i, name in enumerate(names) if i and name.casefold() == column.strip().casefold()]
        if len(matches) == 1:
            return matches[0]
    choice = f", or one of {abbreviated(names[1:], _MOST_NAMES)}" if names else " (the columns have no names)"
    found, accepted = repr(column)[:60], f"2 to {width}{choice}"
    raise InputError(table.file, "unknown column", found=found, accepted=accepted, key=key)


def title_of(table: Columns, i: int) -> str:
    """Title of a column, counted from 0; empty without titles."""
    return table.names[i] if table.names else ""


def in_words(table: Columns, i: int) -> str:
    """Number and title of a column, counted from 0, for messages."""
    return f"column {i + 1}" + (f" ({table.names[i]})" if table.names else "")

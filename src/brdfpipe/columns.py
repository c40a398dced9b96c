"""Columns of numbers against wavelength, as instruments and spreadsheets write them in text files.

Separator and decimal mark are deduced from the whole file; a line that is neither numbers nor a comment is refused by its number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.stated_counts import contradictions

TEXT_SUFFIXES = (".csv", ".dat", ".prn", ".tab", ".tsv", ".txt")
"""Extensions read as columns of text."""

_MAX_BYTES = 2**24
_UNIT_ALONE = re.compile(r"[\[(]?\s*(?:nm|[uµμ]m|Å|cm-1|cm⁻¹|eV|%|1|-|)\s*[\])]?")
"""A cell of a line of units below the titles of columns."""
_COMMENT = ("#", "!", "%", "*", ";", "//")
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+(?:,\d+)?(?:[eEdD][+-]?\d+)?", re.ASCII)
_MISSING = frozenset({"", "-", "--", "---", "*", "nan", "na", "n/a", "#n/a", "null", "none", "inf", "+inf", "-inf"})
_SENTINELS = (-9999.0, -999.0)
_SENTINEL_MAGNITUDE = 1e30

_WAVELENGTH_WORDS = re.compile(r"wave|wellen|longueur|lunghezza|lambda|λ|x\s?units|\bnm\b|[µμ]m\b", re.IGNORECASE)
_NANOMETRE = re.compile(r"\bnm\b|nanomet", re.IGNORECASE)
_MICROMETRE = re.compile(r"[µμ]m\b|\bum\b|micromet|\bmicrons?\b", re.IGNORECASE)
_FEWEST_ALIKE = 10
_MOST_ODD = 2
"""If at least so many numbers have the usual number of decimals and at most so many another, the latter are mistakes and not the file's format."""
_MOST_IRREGULAR = 0.2
"""Share of other steps up to which a grid is regular."""
_OTHER_UNITS = {
    "Å": re.compile("[\u00c5\u212b]|(?i:\\bangstr(?:o|\u00f6)ms?\\b)|[\\[(]\\s*A\\s*[\\])]"),
    "cm-1": re.compile(r"cm\s?(?:\^?-1|⁻¹)|1\s?/\s?cm\b|wave\s?number|wellenzahl", re.IGNORECASE),
    "eV": re.compile(r"\bev\b|photon\s?energy|energie", re.IGNORECASE),
}
"""Units of the first column that are converted to nm."""
_NOT_A_WAVELENGTH = re.compile(r"\b[tp]?hz\b|frequen", re.IGNORECASE)
_HC = 1239.841984
"""Photon energy times wavelength [eV nm]."""


@dataclass(frozen=True)
class Columns:
    """Numbers of a text file, with the words above them."""

    file: str
    """Name of the file, for messages."""
    header: tuple[str, ...]
    """Lines of words, comments included, without their comment marks."""
    names: tuple[str, ...] | None
    """Names of the columns, if the last line above the numbers has as many cells."""
    values: Array
    """(rows, columns); missing cells and sentinels are NaN."""
    lines: NDArray[np.int64]
    """Line of the file of each row, from 1."""
    notes: tuple[str, ...]
    """Corrections, for the history."""
    doubts: tuple[str, ...] = ()
    """Signs of lost or damaged values, for warnings."""
    rows_above: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Lines above the numbers that have a cell for each column, from the top: the line as in ``header``, and its cells."""


def read_columns(path: Path) -> Columns:
    """Read a text file of two or more columns of numbers.

    Parameters
    ----------
    path : UTF-8, UTF-16, Latin-1 or Windows text, with or without a byte-order mark; columns separated by ``;``, tab, ``,`` or
        white space; decimal point or comma; words above the numbers and comments anywhere

    Raises
    ------
    InputError : naming the file and line: unreadable, no text, no numbers, rows of unequal length, ambiguous commas.

    Notes
    -----
    Missing are empty cells, ``NaN``, ``n/a``, infinities, ±1e30 and beyond (USGS writes −1.23e34), −999 and −9999.
    """
    text, notes = read_text(path)
    return parse_columns(text, path, notes)


def read_text(
    path: Path, most_bytes: int = _MAX_BYTES, key: str | None = None, if_binary: str = ""
) -> tuple[str, list[str]]:
    """Text of a file in UTF-8, UTF-16 or Latin-1, and a note if it was not UTF-8.

    Raises InputError: unreadable, too large, or binary; ``key`` is the key of material.yaml to set, ``if_binary`` what else the message
    accepts of a binary file.
    """
    try:
        if path.stat().st_size > most_bytes:
            raise InputError(path, "too large for a text file", accepted=f"up to {most_bytes >> 20} MiB", key=key)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    candidates = [("utf-8-sig", "UTF-8"), ("latin-1", "Latin-1")]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        candidates = [("utf-16", "UTF-16")]
    elif b"\0" in data:
        # Western text in UTF-16 has a zero in every other byte; its position gives the byte order.
        little = data[1:400:2].count(0) > data[:400:2].count(0)
        candidates = [("utf-16-le" if little else "utf-16-be", "UTF-16")]
    for codec, title in candidates:
        try:
            text = data.decode(codec)
        except UnicodeDecodeError:
            continue
        if re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text):
            break
        if not text.isascii():
            # Minus signs and no-break spaces come from spreadsheets.
            text = text.translate({0x2212: "-", 0xA0: " ", 0x202F: " ", 0xFEFF: None})
        return text, [] if title == "UTF-8" else [f"{path.name} was decoded as {title}."]
    accepted = f"text in UTF-8, UTF-16 or Latin-1{if_binary}"
    raise InputError(path, "the file is binary, not text", accepted=accepted, key=key)


def parse_columns(text: str, path: Path, notes: Sequence[str] = ()) -> Columns:
    """:func:`read_columns` of text that is in memory already; ``path`` is for messages, ``notes`` begin those of the table."""
    notes = list(notes)
    header: list[str] = []
    above: list[str] = []
    remarks: list[str] = []
    rows: list[tuple[int, str]] = []
    for place, raw in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        # "0,35" in quotes is one number, whatever separates the columns.
        line = re.sub(r'"([+-]?\d+),(\d+)"', r"\1.\2", raw).replace('"', "").strip(" \f\x1a")
        body = re.split(r"\s*(?:#|!|//)", line, maxsplit=1)[0].rstrip(" ")
        if not line.strip():
            continue
        if _is_numbers(body):
            rows.append((place, body))
        elif not rows or line.startswith(_COMMENT):
            (remarks if rows else header).append(re.sub(r"^[#!*;/]+\s*", "", line))
            above += [] if rows else [line]
        else:
            raise InputError(
                path,
                "neither numbers nor a comment",
                where=f"line {place}",
                found=repr(_shorten(line)),
                accepted="two or more columns of numbers, or a comment that starts with #",
            )
    if not rows:
        raise InputError(
            path, "no table of numbers found", accepted=f"text of two or more columns ({', '.join(TEXT_SUFFIXES)})"
        )
    separator, decimal = _layout(rows, path)
    if decimal == ",":
        notes.append("decimal commas were read as decimal points")
    split = _cells(rows, separator, path)
    values = np.array([[number(cell, decimal) for cell in cells] for cells in split], dtype=float)
    cells_above = [_cells_above(*lines, separator, values.shape[1]) for lines in zip(above, header, strict=True)]
    names = _names(cells_above)
    lines = np.array([place for place, _ in rows])
    doubts = contradictions(header, values[:, 0])
    for cells in zip(*split, strict=True):
        doubts += odd_decimals(cells, lambda i: f"in line {lines[i]}")
    rows_above = tuple((line, tuple(cells)) for line, cells in zip(header, cells_above, strict=True) if cells)
    return Columns(path.name, (*header, *remarks), names, values, lines, tuple(notes), tuple(doubts), rows_above)


def wavelengths(columns: Columns, *, key: str) -> tuple[Array, str]:
    """The first column as wavelengths.

    Parameters
    ----------
    columns : a table whose first column is a wavelength in nm or µm; or in Å, a wavenumber in cm⁻¹ or a photon energy in eV, as its title
        or the header says
    key : the key of ``material.yaml`` that names the file, for messages

    Returns
    -------
    wavelength : (rows,) nm; NaN where the cell is missing
    note : how the unit was found, for the history; empty where the header says nm

    Raises
    ------
    InputError : the unit is another, unclear, or contradicted by the values.
    """
    values = columns.values[:, 0]
    present = values[np.isfinite(values)]
    if present.size == 0:
        raise InputError(columns.file, "the first column holds no wavelengths", accepted="nm or µm", key=key)
    low, high = float(present.min()), float(present.max())
    other = _other_unit(columns)
    if other is not None:
        return _converted(columns, values, other, key)
    by_size = "nm" if low >= 100 and high <= 20000 else "um" if low >= 0.1 and high <= 20 else None
    unit = _stated_unit(columns, key)
    if unit is None and (likely := _likely_unit(low, high)):
        raise InputError(
            columns.file,
            f"the first column looks like {likely[1]}, and the header names no unit",
            found=f"{low:g} to {high:g}",
            accepted=f"wavelengths in nm or µm, or the title `{likely[0]}` above the column",
            key=key,
        )
    if by_size is None or (unit is not None and unit != by_size):
        raise InputError(
            columns.file,
            f"the first column does not hold wavelengths in {'µm' if unit == 'um' else unit or 'nm or µm'}",
            found=f"{low:g} to {high:g}",
            accepted="100 to 20000 nm or 0.1 to 20 µm, as the header says",
            key=key,
        )
    if by_size == "um":
        how = "" if unit else " (taken as µm from their size: the header names no unit)"
        # The factor leaves 350.09999999999997 where the file says 0.3501.
        return np.round(values * 1000, 6), f"wavelengths were converted from µm to nm{how}"
    return values, "" if unit else "wavelengths were taken as nm from their size: the header names no unit"


def _other_unit(columns: Columns) -> str | None:
    """Å, cm-1 or eV, if the title of the first column or the header says so and neither says nm or µm."""
    texts = [columns.names[0]] if columns.names else []
    texts += [line for line in columns.header if _WAVELENGTH_WORDS.search(line)]
    for text in texts:
        if _NANOMETRE.search(text) or _MICROMETRE.search(text):
            return None
        for unit, pattern in _OTHER_UNITS.items():
            if pattern.search(text):
                return unit
    return None


def _likely_unit(low: float, high: float) -> tuple[str, str] | None:
    """Title and name of the unit of a range that covers 400-700 nm in it and in no other; None for ranges in nm or µm."""
    if 1000 < low <= 4200 and 6800 <= high < 12000:
        return "wavelength [Å]", "wavelengths in Å"
    if 7000 < low <= 14500 and 24500 <= high < 60000:
        return "wavenumber [cm-1]", "wavenumbers in cm-1"
    if 0.9 < low <= 1.8 and 3.0 <= high < 7:
        return "energy [eV]", "photon energies in eV"
    return None


def _converted(columns: Columns, values: Array, unit: str, key: str) -> tuple[Array, str]:
    """Values in Å, cm-1 or eV as wavelengths [nm]."""
    with np.errstate(divide="ignore"):
        nm = {"Å": values / 10, "cm-1": 1e7 / values, "eV": _HC / values}[unit]
    present = nm[np.isfinite(values)]
    if not (np.isfinite(present).all() and present.min() >= 100 and present.max() <= 20000):
        found = f"{np.nanmin(values):g} to {np.nanmax(values):g}"
        problem = f"the first column does not hold values in {unit}, as the header says"
        raise InputError(columns.file, problem, found=found, accepted="100 to 20000 nm in this unit", key=key)
    return np.round(nm, 6), f"the first column was converted from {unit} to nm, as the header says"


def merge_duplicates(wavelength: Array, values: Array) -> tuple[Array, Array, int]:
    """Sort by wavelength and average rows of equal wavelength.

    Parameters
    ----------
    wavelength : (n,) nm
    values : (n, m)

    Returns
    -------
    wavelength : (k,) increasing strictly
    values : (k, m)
    merged : n − k
    """
    unique, inverse, counts = np.unique(wavelength, return_inverse=True, return_counts=True)
    sums = np.zeros((unique.size, values.shape[1]))
    np.add.at(sums, inverse, values)
    return unique, sums / counts[:, None], wavelength.size - unique.size


class SpectralTable(NamedTuple):
    """Values against wavelength, sorted and without missing ones."""

    wavelength: Array
    """(rows,) nm, increasing strictly"""
    values: Array
    """(rows, columns)"""
    titles: tuple[str, ...]
    """Lines of words above the numbers, and names of the columns"""
    notes: list[str]
    """Corrections, in words"""
    doubts: tuple[str, ...]


def read_spectral_table(path: Path, key: str, layout: str, *, most: int, widest: float) -> SpectralTable:
    """Read a text file of wavelengths and one to ``most`` columns of values that covers 400–700 nm.

    Rows without a value are dropped, rows of repeated wavelength are averaged; the notes say so.

    Parameters
    ----------
    path : see :func:`read_columns`
    key : the key of ``material.yaml`` that names the file, for messages
    layout : accepted columns, for messages
    most : columns of values
    widest : accepted distance of wavelengths [nm]

    Raises
    ------
    InputError : as :func:`read_columns`; too many columns; wavelengths that leave a gap.
    """
    table = read_columns(path)
    if table.values.shape[1] > 1 + most:
        raise InputError(path, "too many columns", found=table.values.shape[1], accepted=layout, key=key)
    nm, note = wavelengths(table, key=key)
    present = np.isfinite(nm) & np.isfinite(table.values).all(axis=1)
    wavelength, values, merged = merge_duplicates(nm[present], table.values[present, 1:])
    missing = gaps(wavelength, 400.0, 700.0, widest=widest)
    if missing:
        found = ", ".join(f"{low:g}–{high:g} nm missing" for low, high in missing)
        accepted = f"400–700 nm in steps of at most {widest:g} nm, or a number in place of the file"
        raise InputError(path, "must cover 400–700 nm", found=found, accepted=accepted, key=key)
    dropped = int((~present).sum())
    notes = [*table.notes, note, f"{dropped} rows without a value were dropped" if dropped else ""]
    notes.append(f"{merged} rows of repeated wavelength were averaged" if merged else "")
    titles = (*table.header, *(table.names or ()))
    return SpectralTable(wavelength, values, titles, [text for text in notes if text], table.doubts)


def odd_decimals(cells: Sequence[str], place: Callable[[int], str]) -> list[str]:
    """Doubts about one or two numbers printed with fewer or more decimals than all others, in a column with trailing zeros.

    Parameters
    ----------
    cells : numbers as printed
    place : position of a cell, in words
    """
    decimals = [len(match[1]) if (match := re.search(r"[.,](\d*)", cell)) else 0 for cell in cells]
    usual = max(set(decimals), key=decimals.count, default=0)
    odd = [i for i, count in enumerate(decimals) if count != usual and cells[i].lower() not in _MISSING]
    alike = [cell for cell, count in zip(cells, decimals, strict=True) if count == usual]
    keeps_zeros = usual > 0 and any(re.search(r"0(?:[eEdD]|$)", cell) for cell in alike)
    if not keeps_zeros or len(odd) > _MOST_ODD or len(alike) < _FEWEST_ALIKE:
        return []
    words = "has another number of decimals than the others. Look for a number that was cut or damaged"
    return [f"{_shorten(cells[i], 20)} {place(i)} {words}" for i in odd]


def odd_steps(wavelength: Array) -> list[tuple[float, float]]:
    """Neighbours whose distance differs from almost all others [nm]: lost rows, or mistyped wavelengths.

    Parameters
    ----------
    wavelength : (n,) nm, increasing strictly

    Returns
    -------
    Pairs of wavelengths; none if the grid is irregular, or changes its step from some wavelength on.
    """
    steps = np.diff(wavelength)
    if steps.size < _FEWEST_ALIKE:
        return []
    usual = float(np.median(steps))
    # Wavelengths are rounded to their last digit.
    regular = np.abs(steps - usual) <= 1.01 * last_digit(wavelength)
    if regular.mean() < 1 - _MOST_IRREGULAR:
        return []
    odd = ~regular
    # Three equal steps in a row are another part of the grid.
    alike = np.abs(np.diff(steps)) <= 1e-6 * usual
    three = np.flatnonzero(alike[:-1] & alike[1:])
    odd[np.unique(three[:, None] + np.arange(3))] = False
    return [(float(wavelength[i]), float(wavelength[i + 1])) for i in np.flatnonzero(odd)]


def last_digit(values: Array) -> float:
    """Unit of the last decimal of any of the values: 0.01 of 0.5, 0.53."""
    for digits in range(12):
        scaled = values * 10**digits
        if (np.abs(scaled - np.round(scaled)) <= 1e-6).all():
            return float(10.0**-digits)
    return 0.0


def gaps(wavelength: Array, low: float, high: float, widest: float, slack: float = 1.0) -> list[tuple[float, float]]:
    """Intervals of ``[low, high]`` that increasing wavelengths do not cover [nm].

    Neighbours further apart than ``widest`` leave a gap; the first and last wavelength may be off by ``slack``.
    """
    if wavelength.size == 0:
        return [(low, high)]
    inside = np.concatenate([[low], wavelength[(wavelength > low) & (wavelength < high)], [high]])
    starts, ends = inside[:-1], inside[1:]
    allowed = np.full(starts.size, widest)
    before, after = wavelength[wavelength <= low], wavelength[wavelength >= high]
    # Where points lie beyond both ends, their distance counts; where none do, only the slack is allowed.
    starts = np.concatenate([before[-1:], starts[1:]]) if before.size else starts
    ends = np.concatenate([ends[:-1], after[:1]]) if after.size else ends
    if not before.size:
        allowed[0] = slack
    if not after.size:
        allowed[-1] = slack
    missing = ends - starts > allowed
    return [(max(low, float(a)), min(high, float(b))) for a, b in zip(starts[missing], ends[missing], strict=True)]


def number(cell: str, decimal: str = ".") -> float | None:
    """A cell as a number: NaN if it is missing or a sentinel, None if it is not a number."""
    cell = cell.strip()
    if cell.lower() in _MISSING:
        return float("nan")
    if not _NUMBER.fullmatch(cell) or (decimal == "." and "," in cell):
        return None
    value = float(cell.translate(str.maketrans("Dd" + decimal, "ee.")))
    return float("nan") if abs(value) >= _SENTINEL_MAGNITUDE or value in _SENTINELS else value


def _stated_unit(columns: Columns, key: str) -> str | None:
    titles = [columns.names[0]] if columns.names else []
    for text in [*titles, *(line for line in columns.header if _WAVELENGTH_WORDS.search(line))]:
        if _NOT_A_WAVELENGTH.search(text):
            raise InputError(
                columns.file,
                "the first column does not hold wavelengths",
                found=repr(_shorten(text)),
                accepted="wavelengths in nm, µm or Å, wavenumbers in cm-1, or photon energies in eV",
                key=key,
            )
        nm, um = bool(_NANOMETRE.search(text)), bool(_MICROMETRE.search(text))
        if nm != um:
            return "nm" if nm else "um"
    return None


def _is_numbers(line: str) -> bool:
    tokens = re.split(r"[\s;,]+", line)
    return (
        len(tokens) > 1
        and _NUMBER.fullmatch(tokens[0]) is not None
        and all(_NUMBER.fullmatch(token) or token.lower() in _MISSING for token in tokens)
    )


def _layout(rows: Sequence[tuple[int, str]], path: Path) -> tuple[str | None, str]:
    """Separator (None: white space) and decimal mark of the whole table."""
    lines = [body for _, body in rows]
    comma, point = any("," in line for line in lines), any("." in line for line in lines)
    separator = ";" if any(";" in line for line in lines) else "\t" if any("\t" in line for line in lines) else None
    if separator is None and comma:
        if all(len(line.split()) > 1 and all(map(_DECIMAL_COMMA.fullmatch, line.split())) for line in lines):
            return None, ","
        if not point and any(line.count(",") > 1 for line in lines):
            raise InputError(
                path,
                "commas could separate columns or mark decimals",
                found=repr(_shorten(lines[0])),
                accepted="columns separated by ; or tab where decimals are commas",
            )
        return ",", "."
    if comma and point:
        # Of two marks, the one in fewer lines is the odd one.
        odd = min(",.", key=lambda mark: sum(mark in line for line in lines))
        place, bad = next((place, line) for place, line in rows if odd in line)
        found, accepted = repr(_shorten(bad)), "one decimal mark, no thousands mark"
        raise InputError(path, "both . and , inside numbers", where=f"line {place}", found=found, accepted=accepted)
    return separator, "," if comma else "."


def _cells(rows: Sequence[tuple[int, str]], separator: str | None, path: Path) -> list[list[str]]:
    split = [[cell.strip() for cell in body.split(separator)] for _, body in rows]
    while all(len(cells) > 2 and cells[-1] == "" for cells in split):
        split = [cells[:-1] for cells in split]
    width = len(split[0])
    for (line, _), cells in zip(rows, split, strict=True):
        if len(cells) != width or width < 2:
            found, accepted = f"{len(cells)} columns", f"{width} columns, as in line {rows[0][0]}"
            raise InputError(path, "rows of unequal length", where=f"line {line}", found=found, accepted=accepted)
        if any(number(cell, ",") is None for cell in cells):
            raise InputError(
                path, "not a number", where=f"line {line}", found=repr(_shorten(" ".join(cells))), accepted="numbers"
            )
    return split


def _names(cells_above: Sequence[list[str] | None]) -> tuple[str, ...] | None:
    """Titles of the columns, from the line above the numbers; from the two lines above them if the lower one has units alone."""
    titles = cells_above[-1] if cells_above else None
    if titles is None:
        return None
    above = cells_above[-2] if len(cells_above) > 1 else None
    if above is not None and all(map(_UNIT_ALONE.fullmatch, titles)):
        return tuple(f"{name} {unit}".strip() for name, unit in zip(above, titles, strict=True))
    return tuple(titles)


def _cells_above(line: str, without_mark: str, separator: str | None, width: int) -> list[str] | None:
    """Cells of a line above the numbers; None unless there is one for each column, empty ones at the end apart."""
    patterns = [re.escape(separator)] if separator else [r"\t+| {2,}", r"\s+"]
    # A separator before the first cell may look like the mark of a comment, or like a blank.
    blanks = " " if separator == "\t" else None
    texts = [re.sub("^[#!*/]+", "", line), without_mark] if separator else [without_mark]
    for text in texts:
        for pattern in patterns:
            cells = [cell.strip() for cell in re.split(pattern, text.strip(blanks))]
            while len(cells) > width and not cells[-1]:
                cells.pop()
            if len(cells) == width:
                return cells
    return None


def _shorten(text: str, length: int = 60) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"

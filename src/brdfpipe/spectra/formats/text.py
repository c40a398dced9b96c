"""Text: columns of wavelength and reflectance, or one row per sample below a header of wavelengths."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from brdfpipe import columns
from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base
from brdfpipe.stated_counts import contradictions

_LABEL = re.compile(r"[A-Za-zλ%_\s]{0,12}[\s_(\[]?(\d{3,5}(?:\.\d+)?|\d?\.\d{2,5})\s*(?:nm|[µμu]m)?[)\]]?", re.ASCII)
_FEWEST_LABELS = 7


def wide_rows(text: str) -> tuple[list[str], list[tuple[int, list[str]]], str] | None:
    """Lines above, then header and rows of a table whose header is wavelengths; None for other tables."""
    lines = base.lines_of(text)
    for place, line in enumerate(lines):
        if not line.strip(" ;,\t\r\n") or line.lstrip().startswith("#"):
            continue
        separator = next((mark for mark in ";\t," if mark in line), None)
        if len(_labels(_split(line, separator))) >= _FEWEST_LABELS:
            above = [re.sub(r"^[#!*;/]+\s*", "", above_line) for above_line in lines[:place] if above_line.strip()]
            if any(_is_row(above_line, separator) for above_line in above):
                return None
            if separator is None:
                return above, _blank_separated(lines, place), ","
            reader = csv.reader(lines[place:], delimiter=separator)
            try:
                rows = [(place + reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
            except csv.Error:
                return None
            return above, rows, "." if separator == "," else ","
        if columns.number(re.split(r"[;\t,\s]", line.strip())[0]) is not None:
            return None
    return None


def _split(line: str, separator: str | None) -> list[str]:
    """Cells of a line; None separates by blanks, of which a unit after a number is no cell of its own."""
    if separator is None:
        return re.sub(r"(\d)\s+(nm|[µμu]m)\b", r"\1\2", line).split()
    return next(csv.reader([line], delimiter=separator), [])


def _blank_separated(lines: Sequence[str], place: int) -> list[tuple[int, list[str]]]:
    """The header in line ``place`` and the rows below it: a name of several words is one cell if it is the only one before the values."""
    header = _split(lines[place], None)
    rows = [(place + 1, header)]
    only_name = min(_labels(header)) == 1
    for number, line in enumerate(lines[place + 1 :], start=place + 2):
        cells = line.split()
        extra = len(cells) - len(header)
        if extra > 0 and only_name:
            cells = [" ".join(cells[: extra + 1]), *cells[extra + 1 :]]
        if cells:
            rows.append((number, cells))
    return rows


def _is_row(line: str, separator: str | None) -> bool:
    """Whether most cells of a line are numbers: values above the header of wavelengths."""
    # Spreadsheets fill a row of one title up with empty cells, which are no values.
    values = [columns.number(cell, "," if separator == ";" else ".") for cell in line.split(separator) if cell.strip()]
    return len(values) > _FEWEST_LABELS and sum(value is not None for value in values) > len(values) / 2


def _labels(cells: Sequence[str]) -> dict[int, float]:
    """Wavelengths of a header row by column; empty unless they are monotonic and follow a text column."""
    matches = {i: _LABEL.fullmatch(cell.strip()) for i, cell in enumerate(cells)}
    labels = {i: float(match.group(1)) for i, match in matches.items() if match}
    if not labels or 0 in labels:
        return {}
    steps = np.diff(list(labels.values()))
    return labels if (steps > 0).all() or (steps < 0).all() else {}


def wide_samples(
    path: Path, above: Sequence[str], rows: Sequence[tuple[int, list[str]]], decimal: str
) -> list[base.Sample]:
    """Samples of the header and rows of :func:`wide_rows`."""
    header = rows[0][1]
    labels = _labels(header)
    unit = "nm" if any("nm" in header[i] for i in labels) else ""
    if decimal == "," and not any("," in row[i] for _, row in rows[1:] for i in labels if i < len(row)):
        decimal = "."
    wavelength = np.array(list(labels.values()))
    doubts = tuple(contradictions(above, wavelength))
    samples = []
    for line, row in rows[1:]:
        if len(row) != len(header):
            found, accepted = f"{len(row)} cells", f"{len(header)} cells, as in the header"
            raise InputError(path, "rows of unequal length", where=f"line {line}", found=found, accepted=accepted)
        name, cells = row[0].strip(), [row[i] for i in labels]
        others = tuple((header[i].strip(), row[i].strip()) for i in range(len(row)) if i not in labels)
        samples.append(
            base.parsed_sample(
                path,
                f"line {line}",
                name,
                wavelength,
                cells,
                tuple(above),
                unit,
                doubts=doubts,
                decimal=decimal,
                labels=others,
            )
        )
    return samples


def _read(path: Path) -> base.Content:
    text, notes = columns.read_text(path)
    table = wide_rows(text)
    return (columns.parse_columns(text, path, notes) if table is None else wide_samples(path, *table)), notes


FORMAT = base.SpectrumFormat(
    "text",
    columns.TEXT_SUFFIXES,
    "columns of wavelength (nm or µm; Å, cm⁻¹ or eV if the title says so) and reflectance; or one row per sample below a header of wavelengths. UTF-8, UTF-16 or Latin-1; `;`, tab, "
    "`,` or blanks; decimal point or comma",
    _read,
    tried="abs_black_3col.txt, fibreglass_green_um_sentinel.txt, hdpe_yellow_irregular.txt, munsell_over_unity.csv, pipe_blue_ecostress_style.txt, pvc_white_de.csv, all made",
)

"""Datacolor QTX files: standards and batches."""

from __future__ import annotations

import re
from pathlib import Path

from brdfpipe import columns
from brdfpipe.errors import InputError
from brdfpipe.spectra.formats.sample import (
    PERCENT,
    Sample,
    SpectrumFormat,
    doubt_of_end,
    doubts_of_cut_numbers,
    even_grid,
    lines_of,
    parse_numbers,
    stated_number,
    truncated,
)

_QTX_GRID = ("REFLLOW", "REFLINTERVAL", "REFLPOINTS")


def _read(path: Path) -> tuple[list[Sample], list[str]]:
    text, notes = columns.read_text(path)
    return _samples(path, text), notes


def _samples(path: Path, text: str) -> list[Sample]:
    sections: list[dict[str, str]] = []
    last = ""
    for place, line in enumerate(lines_of(text), start=1):
        line = line.strip()
        if line.startswith("["):
            sections.append({})
            last = ""
        elif "=" in line and sections:
            last, _, value = line.partition("=")
            last = re.sub("^(?:STD|BAT)_", "", last.strip().upper())
            if last in ("NAME", "VIEWING", "R", *_QTX_GRID) and last in sections[-1]:
                raise InputError(path, f"damaged: duplicate key {last} in a section", where=f"line {place}")
            sections[-1][last] = value.strip()
        elif line and sections and last == "R":
            sections[-1][last] += line
        elif line:
            raise InputError(
                path, "the line is neither a section nor a key", where=f"line {place}", found=repr(line)[:60]
            )
    samples = []
    for place, section in enumerate(sections, start=1):
        if "R" not in section and "REFLPOINTS" not in section:
            continue
        cells = [cell for cell in re.split(r"[,\s]+", section.get("R", "")) if cell]
        low, step, points = (stated_number(path, key, section.get(key, "").rstrip(", ")) for key in _QTX_GRID)
        if len(cells) != points:
            raise truncated(path, len(cells), points)
        wavelength, values = even_grid(low, step, len(cells)), parse_numbers(path, f"section {place}", cells)
        viewing = (f"viewing {section['VIEWING']}",) if "VIEWING" in section else ()
        name = section.get("NAME", f"sample {place}")
        doubts = (*doubt_of_end(wavelength, step), *doubts_of_cut_numbers(cells, wavelength))
        samples.append(Sample(name, wavelength, values, (PERCENT, *viewing), doubts=doubts))
    return samples


FORMAT = SpectrumFormat("qtx", (".qtx",), "Datacolor standards and batches, percent", _read)

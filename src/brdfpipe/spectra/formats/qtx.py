"""Datacolor QTX files: standards and batches."""

from __future__ import annotations

import re
from pathlib import Path

from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base

_GRID = ("REFLLOW", "REFLINTERVAL", "REFLPOINTS")


def _samples(path: Path, text: str) -> list[base.Sample]:
    sections: list[dict[str, str]] = []
    last = ""
    for number, line in enumerate(base.lines_of(text), start=1):
        line = line.strip()
        if line.startswith("["):
            sections.append({})
            last = ""
        elif "=" in line and sections:
            last, _, value = line.partition("=")
            last = re.sub("^(?:STD|BAT)_", "", last.strip().upper())
            if last in ("NAME", "VIEWING", "R", *_GRID) and last in sections[-1]:
                raise InputError(path, f"damaged: duplicate key {last} in a section", where=f"line {number}")
            sections[-1][last] = value.strip()
        elif line and sections and last == "R":
            sections[-1][last] += line
        elif line:
            raise InputError(
                path, "the line is neither a section nor a key", where=f"line {number}", found=repr(line)[:60]
            )
    samples = []
    for number, section in enumerate(sections, start=1):
        if "R" not in section and "REFLPOINTS" not in section:
            continue
        cells = [cell for cell in re.split(r"[,\s]+", section.get("R", "")) if cell]
        low, step, points = (base.stated_number(path, key, section.get(key, "").rstrip(", ")) for key in _GRID)
        base.check_count(path, len(cells), points)
        wavelength = base.even_grid(low, step, len(cells))
        viewing = (f"viewing: {section['VIEWING']}",) if "VIEWING" in section else ()
        name, doubts = section.get("NAME", f"sample {number}"), base.doubt_of_end(wavelength, step)
        header = (base.PERCENT, *viewing)
        samples.append(base.parsed_sample(path, f"section {number}", name, wavelength, cells, header, doubts=doubts))
    return samples


FORMAT = base.SpectrumFormat(
    "qtx", (".qtx",), "Datacolor standards and batches, percent", base.from_text(_samples), tried="abs_black.qtx, made"
)

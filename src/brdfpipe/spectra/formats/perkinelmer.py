"""PerkinElmer ASCII files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base
from brdfpipe.spectra.specular_words import spoken


def _samples(path: Path, text: str) -> list[base.Sample]:
    lines = [line.strip() for line in base.lines_of(text)]
    if "#DATA" not in lines or "#GR" not in lines or not lines[0].startswith("PE "):
        raise InputError(
            path, "not a PerkinElmer ASCII file", accepted="PE … in line 1, then #GR and #DATA", key="spectrum.format"
        )
    start, graph = lines.index("#DATA") + 1, lines.index("#GR") + 1
    stated = [*lines[graph : start - 1], "", "", "", "", "", "", ""]
    x_unit, y_unit = stated[0], stated[1]
    if x_unit.casefold() != "nm" or y_unit.replace(" ", "").casefold() not in ("%r", "r"):
        raise InputError(
            path,
            "not a reflectance over nm",
            where="#GR",
            found=f"{x_unit!r}, {y_unit!r}"[:60],
            accepted="nm and %R or R",
        )
    rows = [_row(path, line, place) for place, line in enumerate(lines[start:], start=start + 1) if line]
    points = base.stated_number(path, "number of points", stated[6])
    base.check_count(path, len(rows), points)
    cells = list(zip(*rows, strict=True)) or [(), ()]
    wavelength = base.parse_numbers(path, "#DATA", cells[0])
    scale, offset = (
        base.stated_number(path, word, cell) for word, cell in (("factor", stated[2]), ("offset", stated[3]))
    )
    if scale != 1 or offset != 0:
        raise InputError(
            path, "unsupported factor or offset", where="#GR", found=f"{scale:g}, {offset:g}", accepted="1 and 0"
        )
    first, step = (base.stated_number(path, key, cell) for key, cell in (("first nm", stated[4]), ("step", stated[5])))
    doubts: tuple[str, ...] = ()
    if wavelength.size and np.abs(wavelength - base.even_grid(first, step, wavelength.size)).max() > 0.5 * abs(step):
        doubts = (
            f"the header states wavelengths from {first:g} nm by {step:g} nm. The table differs from that: look for mistyped or lost ones",
        )
    header = (base.PERCENT if "%" in y_unit else base.FRACTION, *spoken(lines[3 : graph - 1]))
    return [base.parsed_sample(path, "#DATA", lines[2], wavelength, cells[1], header, doubts=doubts)]


def _row(path: Path, line: str, place: int) -> tuple[str, str]:
    cells = line.split()
    if len(cells) != 2:
        raise InputError(path, "not a row of two columns", where=f"line {place}", found=repr(line)[:60])
    base.parse_numbers(path, f"line {place}", cells)
    return cells[0], cells[1]


FORMAT = base.SpectrumFormat(
    "perkinelmer", (".asc",), "one spectrum in nm, %R or R", base.from_text(_samples), tried="vinyl_red_pe.asc, made"
)

"""Reading ASTM E1392 files by the rules of libbsdf, and refusing what it would guess.

As there: negative azimuths count from the other side, three channels without names in nm are red, green and blue, of a doubled direction the first row holds, and azimuths on one side of
the plane of incidence stand for both. Unlike there: missing cells are interpolated and flagged instead of taking the nearest row, and a file with fewer rows than it declares is refused.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd

from brdfpipe.errors import InputError
from brdfpipe.exchange.direction_rows import Rows, gridded_rows
from brdfpipe.exchange.read_table import Channels, ReadTable
from brdfpipe.exchange.text_lines import LARGEST_FILE
from brdfpipe.geometry import Array

TRANSMITTED = "BTDF in sr-1"
"""Words in the header of a file of transmitted light."""

_HEADER = 2**20
"""Bytes in which the line VARS is searched."""
_MOST_CHANNELS = 2000
_RED_GREEN_BLUE, _TRISTIMULUS = ["R", "G", "B"], ["X", "Y", "Z"]


def read(path: Path) -> ReadTable:
    """Read a file of reflected light, or of transmitted light if its header says so in the words of :mod:`brdfpipe.exchange.astm`.

    Raises InputError: the file contradicts itself, or its directions are no grid.
    """
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(path, "the file is too large", accepted=f"at most {LARGEST_FILE >> 20} MiB")
    content = path.read_bytes()
    found = re.search(rb"(?:^|\s)VARS[ \t]([^\r\n]*)\r?(?:\n|$)", content[:_HEADER])
    if found is None:
        raise InputError(path, "no ASTM file", found="no line VARS", accepted="a header that ends with the line VARS")
    header = content[: found.start()].decode("utf-8", "replace")
    first_line = content[: found.end()].count(b"\n") + 1
    names = [name.strip() for name in found.group(1).decode("utf-8", "replace").split(",")]
    kind, wavelength = _channels(names[4:], path, first_line - 1)
    values = _numbers(content[found.end() :], len(names), path, first_line)
    notes = _check_count(header, values.shape[0], path)
    angles, values = values[:, :4], values[:, 4:]
    if wavelength is not None:
        order = np.argsort(wavelength)
        wavelength, values = wavelength[order], values[:, order]
    _check_angles(angles, path)
    theta_i, phi_i, theta_s, phi_s = np.degrees(angles).T
    grid = gridded_rows(Rows(theta_i, phi_i, theta_s, phi_s, values), path)
    if len(names) == 5 and names[4].endswith("nm"):
        notes.append(f"the values are those of {names[4]}, and stand for all wavelengths")
    transmitted = TRANSMITTED in header
    scaled = re.search(r"\bCCBRDF\b|cosine[- ]corrected", header, re.IGNORECASE) is not None
    if not (scaled or transmitted or "BRDF in sr-1" in header):
        notes.append("the file does not say what its values are; they were taken as BRDF, not multiplied by the cosine")
    return ReadTable(
        "uniform",
        grid.axes,
        grid.values,
        channels=kind,
        wavelength=wavelength,
        quantity="brdf_cos" if scaled else "brdf",
        side="transmission" if transmitted else "reflection",
        notes=(*notes, *grid.notes),
    )


def _channels(names: list[str], path: Path, line: int) -> tuple[Channels, Array | None]:
    """What the columns of values are."""
    if not 1 <= len(names) <= _MOST_CHANNELS:
        raise InputError(
            path,
            "no columns of values",
            found=f"{len(names) + 4} columns",
            accepted="theta_i,phi_i,theta_s,phi_s and 1 to 2000 columns of values",
            where=f"line {line}",
        )
    numbers = [re.fullmatch(r"([0-9.]+)nm", name) for name in names]
    if all(numbers):
        wavelength = np.array([_wavelength(number.group(1)) for number in numbers if number])
        if not (wavelength > 0).all() or np.unique(wavelength).size < wavelength.size:
            raise InputError(
                path, "the wavelengths are not different", found=", ".join(names)[:60], where=f"line {line}"
            )
        return ("photopic", None) if wavelength.size == 1 else ("spectral", wavelength)
    if names == _TRISTIMULUS:
        return "xyz", None
    if names == _RED_GREEN_BLUE or (len(names) == 3 and not names[0].endswith("nm")):
        return "rgb", None
    if len(names) == 1:
        return "photopic", None
    raise InputError(
        path,
        "unknown columns of values",
        found=", ".join(names)[:60],
        accepted="450nm,…; R,G,B; X,Y,Z; or one",
        where=f"line {line}",
    )


def _wavelength(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return 0.0


def _numbers(body: bytes, columns: int, path: Path, first_line: int) -> Array:
    """(rows, columns)."""
    try:
        frame = pd.read_csv(io.BytesIO(body), header=None, dtype=float, encoding_errors="replace")
        values = frame.to_numpy()
    except (ValueError, OverflowError):
        values = np.empty((0, 0))
    if values.size == 0 or values.shape[1] != columns or not np.isfinite(values).all():
        raise _wrong_row(body.decode("utf-8", "replace"), columns, path, first_line)
    return values


def _wrong_row(body: str, columns: int, path: Path, first_line: int) -> InputError:
    """The error of the first row that is wrong."""
    for number, row in enumerate(body.split("\n"), start=first_line):
        if not row.strip():
            continue
        words = row.split(",")
        where = f"line {number}"
        if len(words) != columns:
            return InputError(path, "wrong number of columns", found=len(words), accepted=str(columns), where=where)
        for word in words:
            try:
                wrong = not np.isfinite(float(word))
            except ValueError:
                wrong = True
            if wrong:
                return InputError(path, "not a number", found=repr(word)[:40], accepted="numbers", where=where)
    return InputError(
        path,
        "no rows",
        found="nothing that can be read after the line VARS",
        accepted="a row for each pair of directions",
    )


def _check_count(header: str, rows: int, path: Path) -> list[str]:
    """Notes on the declared number of rows."""
    declared = re.search(r"(?:^|\s)NUM_POINTS\s+(\S+)", header)
    if declared is None:
        return []
    if not declared.group(1).isdecimal():
        raise InputError(path, "NUM_POINTS is not a count", found=repr(declared.group(1))[:40], accepted="an integer")
    count = int(declared.group(1)[:18])
    if count > rows:
        raise InputError(path, "the file ends early", found=f"{rows} rows", accepted=f"{count}, as NUM_POINTS says")
    return [] if count == rows else [f"the file has {rows} rows and declares {count}; all were read"]


def _check_angles(angles: Array, path: Path) -> None:
    incidence, _, scatter, _ = np.abs(angles).max(axis=0)
    turned = np.abs(angles[:, [1, 3]]).max()
    if incidence > np.pi / 2 + 1e-3 or scatter > np.pi + 1e-3 or turned > 4 * np.pi + 1e-3:
        found = f"theta_i to {incidence:g}, theta_s to {scatter:g}, azimuths to {turned:g}"
        raise InputError(path, "the angles are out of range", found=found, accepted="radian: to pi/2, pi, and 4 pi")

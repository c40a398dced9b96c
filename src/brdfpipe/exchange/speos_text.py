"""What the text files of Ansys Speos share: the lines before the numbers, and blocks of values about the normal.

Angles of scatter are counted about the normal. Azimuth 0 is the mirror direction of every incidence, counter-clockwise seen from above, so the source is at 180.
Values are proportional to the BRDF, or to its product with the cosine; the stated percentages give their scale.

References
----------
Ansys help, structure of BRDF files and of anisotropic BSDF files; ansys/optical-automation (converter, 2025).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.exchange import number_text
from brdfpipe.exchange.azimuths import with_source_at
from brdfpipe.exchange.gridded import Gridded
from brdfpipe.exchange.text_lines import LARGEST_FILE, Lines
from brdfpipe.geometry import Array

SOURCE = 180.0
"""Azimuth of the source [degree]."""
QUANTITIES = {1.0: "brdf", 0.0: "brdf_cos"}
"""What values are proportional to: the BSDF (1), or the intensity (0), which holds the cosine."""
PHOTOPIC = 555.0
"""Wavelength of values that are weighted with V(λ) [nm]: its maximum."""
MOST_VALUES = 40_000_000


def title(kind: str, notes: list[str]) -> str:
    """The lines before the numbers; ``kind`` is ``brdf`` or ``Anisotropic BSDF``."""
    first, description = (text.encode("ascii", "replace").decode() for text in (notes[0], "; ".join(notes)))
    return f"OPTIS - {kind} surface file v8.0\n0\n{first}\n{len(description)}\n{description}\n"


def block(table: Gridded, values: Array) -> bytes:
    """One block of values (θ_o, φ_o); the last row holds to the horizon."""
    theta, (phi, values) = table.axes["theta_o"], with_source_at(SOURCE, table.axes["phi_o"], np.maximum(values, 0.0))
    if theta[-1] < 90:
        theta, values = np.append(theta, 90.0), np.concatenate([values, values[-1:]])
    head = f"{theta.size}\t{phi.size}\n\t" + "\t".join(f"{angle:g}" for angle in phi) + "\n"
    polar = number_text.texts([f"{angle:g}" for angle in theta])
    columns = number_text.scientific(values)
    return head.encode() + number_text.lines([polar, *np.moveaxis(columns, 1, 0)], "\t")


def percent(reflectance: float) -> str:
    return f"{100 * reflectance:.6g}"


def after_title(path: Path, kind: str) -> Lines:
    """The lines of a file behind the description.

    Raises InputError: the file is not text of version 8 of this kind.
    """
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(path, "the file is too large", accepted=f"at most {LARGEST_FILE >> 20} MiB")
    ended = path.read_bytes().decode("utf-8", "replace").splitlines(keepends=True)
    lines = [line.rstrip("\r\n") for line in ended]
    if len(lines) < 6:
        raise InputError(path, "the file ends early", found=f"{len(lines)} lines", accepted=f"a Speos {kind} file")
    first, _, version = lines[0].lower().rpartition(" v")
    if not first.startswith("optis") or f"{kind.lower()} surface file" not in first:
        raise InputError(
            path,
            "not such a file",
            found=repr(lines[0])[:60],
            accepted=f"OPTIS - {kind} surface file v8.0",
            where="line 1",
        )
    try:
        supported, length = float(version) >= 8, int(lines[3])
    except ValueError as error:
        raise InputError(
            path,
            "not a number",
            found=str(error)[-60:],
            accepted="a version, and the length of the description",
            where="lines 1 to 4",
        ) from error
    if not supported:
        raise InputError(
            path,
            "the version is too old",
            found=version[:20],
            accepted="8.0; save the file with the BSDF viewer",
            where="line 1",
        )
    if lines[1].strip() != "0":
        raise InputError(
            path, "the file is not text", found=repr(lines[1])[:20], accepted="0, text mode", where="line 2"
        )
    # The description may have several lines; its length counts the ends between them, of one or two characters.
    skip, characters = 5, len(lines[4])
    while skip < len(lines) and characters < length:
        characters += len(ended[skip - 1]) - len(lines[skip - 1]) + len(lines[skip])
        skip += 1
    return Lines(path, "\0", skip)


def read_flags(lines: Lines) -> tuple[bool, str]:
    """Whether transmitted light follows the reflected light, and the quantity of the values."""
    reflects, transmits = lines.numbers(2, "flags of reflection and transmission")
    if reflects != 1:
        raise lines.error(
            "a file of transmitted light alone is not read", found=f"{reflects:g} {transmits:g}", accepted="1 0 or 1 1"
        )
    kind = lines.number(lines.next("the type of the values"))
    if kind not in QUANTITIES:
        raise lines.error("unknown type of values", found=f"{kind:g}", accepted="1, BSDF; 0, intensity")
    return transmits == 1, QUANTITIES[kind]


def read_block(lines: Lines, axes: dict[str, Array]) -> Array:
    """Values (θ_o, φ_o) of a block, whose angles become those of ``axes``.

    Raises InputError: the block has other angles than those before it.
    """
    counts = lines.next("the numbers of theta and phi").split()
    if len(counts) != 2:
        raise lines.error("a block begins with the numbers of theta and phi", found=f"{len(counts)} numbers")
    polar, around = (lines.count(count, 4000) for count in counts)
    phi = lines.numbers(around, "phi")
    rows = np.array([lines.numbers(around + 1, "theta and values") for _ in range(polar)])
    for name, found in (("phi", phi), ("theta", rows[:, 0])):
        known = axes.setdefault(name, found)
        if known.size != found.size or not np.array_equal(known, found):
            raise lines.error(
                f"the block has other angles {name} than the first one", accepted="the same angles in all blocks"
            )
    return rows[:, 1:]


def check_size(lines: Lines, *counts: int) -> None:
    """Raises InputError: a table of so many values is too large."""
    if np.prod([float(count) for count in counts]) > MOST_VALUES:
        raise lines.error(
            "the table is too large", found=" x ".join(map(str, counts)), accepted=f"at most {MOST_VALUES} values"
        )

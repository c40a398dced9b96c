"""Zemax OpticStudio and Radiant's Imaging Sphere: tabular BSDF, text (``.bsdf``).

Angles of scatter are counted about the specular ray: radial from it, azimuth 0 towards the normal. The angle of incidence is that of the specular
ray, or of the ray that passes a sheet straight on. The order of the header is fixed. ``TIS`` is the integral of the block that follows. Values of 0 mark cells that an instrument did not
measure.

References
----------
Zemax knowledge base, articles 229 and 231; libbsdf (reader, 2026).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.one_side import Side
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, number_text, records
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the specular ray, for Zemax OpticStudio",
    files={
        "reflection": {"write": (".zemax.bsdf",)},
        "transmission": {"write_transmission": (".transmission.zemax.bsdf",)},
    },
    takes="grid",
    longest_name=60,
    carries=("transmission", "lay", "colour"),
    options={"colour": False},
    read="read",
    begins=("\nSource",),
)

_BLOCKS = {"monochrome": ("Monochrome",), "xyz": ("TristimulusX", "TristimulusY", "TristimulusZ")}
_SIDES = {"brdf": "reflection", "btdf": "transmission"}
_MOST_CELLS = 20_000_000


def write(bsdf: xr.Dataset, path: Path, *, colour: bool = False, **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file, its name at most 60 characters long; it appears whole or not at all
    colour : X, Y and Z under D65 instead of one table weighted with V(λ) and D65
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : the name is too long, or an option is out of range.
    """
    return _write(bsdf, path, "reflection", colour, grid)


def write_transmission(bsdf: xr.Dataset, path: Path, *, colour: bool = False, **grid: Any) -> records.Record:
    """Write the light that passes a sheet, about the ray that goes straight on; as :func:`write`."""
    return _write(bsdf, path, "transmission", colour, grid)


def _write(bsdf: xr.Dataset, path: Path, side: Side, colour: bool, grid: Mapping[str, Any]) -> records.Record:
    if len(path.name) > FORMAT.longest_name:
        raise ExchangeError(
            f"{path.name}: OpticStudio reads names of at most {FORMAT.longest_name} characters; found {len(path.name)}"
        )
    seen = gridded.side_of(bsdf, side, path)
    channels = gridded.tristimulus(seen) if colour else gridded.photopic(seen)
    table = gridded.gridded(seen, "specular", channels, **grid)
    record, blocks = records.record(table, FORMAT, bsdf), list(table.blocks())
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(_header(table, records.sentences(record, records.VALUES[side]), side, colour))
        for channel, block in enumerate(_BLOCKS["xyz" if colour else "monochrome"]):
            file.write(f"{block}\nDataBegin\n".encode())
            file.writelines(_data(table, blocks, channel))
            file.write(b"DataEnd\n")
    return record


def _header(table: gridded.Gridded, notes: list[str], side: Side, colour: bool) -> Iterator[bytes]:
    rotations = table.axes.get("phi_i", np.zeros(1))
    yield "".join(f"# {note}\n" for note in notes).encode("ascii", "replace")
    symmetry = "PlaneSymmetrical" if table.axes["phi_s"][-1] <= 180 else "ASymmetrical"
    symmetry = "ASymmetrical4D" if "phi_i" in table.axes else symmetry
    content = "XYZ" if colour else "Monochrome"
    scatter = "BRDF" if side == "reflection" else "BTDF"
    yield f"Source  Measured\nSymmetry  {symmetry}\nSpectralContent  {content}\nScatterType  {scatter}\n".encode()
    lists = {
        "SampleRotation": rotations,
        "AngleOfIncidence": table.axes["theta_i"],
        "ScatterAzimuth": table.axes["phi_s"],
        "ScatterRadial": table.axes["theta_s"],
    }
    for name, angles in lists.items():
        yield f"{name}  {angles.size}\n{chr(9).join(f'{angle:g}' for angle in angles)}\n".encode()
    yield b"\n"


def _data(table: gridded.Gridded, blocks: list[tuple[float, Array, Array]], channel: int) -> Iterator[bytes]:
    """Blocks by rotation and incidence; rows by azimuth."""
    with_lay = "phi_i" in table.axes
    for rotation in range(table.axes["phi_i"].size if with_lay else 1):
        for _, of_incidence, reflectance in blocks:
            values, tis = (of_incidence[rotation], reflectance[rotation]) if with_lay else (of_incidence, reflectance)
            block = np.maximum(values[..., channel].T, 0.0)
            yield f"TIS {tis[channel]:.6f}\n".encode() + number_text.rows(block)


def read(path: Path) -> ReadTable:
    """Read a tabular BSDF.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    lines = Lines(path)
    header: dict[str, str] = {}
    axes: dict[str, Array] = {}
    counted = {
        "samplerotation": "phi_i",
        "angleofincidence": "theta_i",
        "scatterazimuth": "phi_s",
        "scatterradial": "theta_s",
    }
    while len(axes) < len(counted):
        key, value = _key_and_value(lines.next("a line of the header"))
        if key in counted:
            axes[counted[key]] = lines.numbers(lines.count(value, 4000), key)
        else:
            header[key] = value.lower()
    cells = int(np.prod([axis.size for axis in axes.values()]))
    if cells > _MOST_CELLS:
        raise InputError(path, "the table is too large", found=f"{cells} cells", accepted=f"at most {_MOST_CELLS}")
    content = header.get("spectralcontent", "")
    if content not in _BLOCKS:
        accepted = "Monochrome, XYZ"
        raise InputError(path, "unknown SpectralContent", found=repr(content)[:40], accepted=accepted)
    if (scatter := header.get("scattertype", "brdf")) not in _SIDES:
        raise InputError(path, "unknown ScatterType", found=repr(scatter)[:40], accepted="BRDF, BTDF")
    shape = axes["phi_i"].size, axes["theta_i"].size, axes["phi_s"].size, axes["theta_s"].size
    values, tis = np.empty((*shape, len(_BLOCKS[content]))), np.empty((*shape[:2], len(_BLOCKS[content])))
    for channel, block in enumerate(_BLOCKS[content]):
        lines.expect(block)
        lines.expect("DataBegin")
        for index in np.ndindex(shape[:2]):
            word, value = _key_and_value(lines.next("TIS"))
            if word != "tis":
                raise lines.error("a block of values begins with TIS", found=repr(word)[:40])
            tis[*index, channel] = lines.number(value)
            for row in range(shape[2]):
                values[*index, row, :, channel] = lines.numbers(shape[3], "values")
        lines.expect("DataEnd")
    with_lay = shape[0] > 1
    ordered = {name: axes[name] for name in (("phi_i",) if with_lay else ()) + ("theta_i", "theta_s", "phi_s")}
    values = values.swapaxes(2, 3)
    return ReadTable(
        "specular",
        ordered,
        values if with_lay else values[0],
        channels="photopic" if content == "monochrome" else "xyz",
        declared_integral=(tis if with_lay else tis[0]),
        zero_is_missing=True,
        side=_SIDES[scatter],
    )


def _key_and_value(line: str) -> tuple[str, str]:
    """The first word in small letters, and the rest; blanks or tabs are between them."""
    words = line.split(maxsplit=1)
    return words[0].lower(), "".join(words[1:])

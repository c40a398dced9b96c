"""NVIDIA's Material Definition Language: measured BSDF (``.mbsdf``), binary.

After lines ``key="value"`` follows a block for the reflected and one for the transmitted light, little endian: type (0 a scalar, 1 linear sRGB),
number of polar and of azimuthal cells, and float32 values by incident polar, outgoing polar and relative azimuth, the last fastest.
Isotropic, and symmetric about the plane of incidence. The mirror direction is in the last azimuthal cell. NVIDIA's renderer reads the values as a texture: at the centres of equal cells,
interpolated linearly, mean of both orders of the two directions.

References
----------
MDL specification 1.10, appendix B; MDL SDK (native runtime, 2025); media type vnd.mdl-mbsdf.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf import table_nodes
from brdfpipe.bsdf.one_side import Side, one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Limits, TableError
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, gridded, records
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="cell means of equal angles, for NVIDIA's MDL (Omniverse, V-Ray, Substance)",
    files={"reflection": {"write": (".mbsdf",)}},
    takes="grid",
    carries=("transmission", "colour"),
    options={"colour": True},
    read="read",
)

_MAGIC = b"NVIDIA ARC MBSDF V1\n"
_REFLECTION, _TRANSMISSION = b"MBSDF_DATA_REFLECTION=\n", b"MBSDF_DATA_TRANSMISSION=\n"
_REFLECTED = (_REFLECTION, b"MBSDF_DATA=\n")
_HEAD = struct.Struct("<3I")
_CHANNELS = {0: 1, 1: 3}
_FEWEST = 8
_NEAR = 1.05
"""Error over the least one with which cells are small enough."""
_MOST_CELLS = 50_000_000
_LONGEST_HEADER = 65_536


def write(
    bsdf: xr.Dataset, path: Path, *, colour: bool = True, tolerance: float, albedo_tolerance: float, largest: int
) -> records.Record:
    """Write the reflected light, and behind a sheet the transmitted light.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    colour : linear sRGB under D65 instead of one value weighted with V(λ) and D65
    tolerance, albedo_tolerance, largest : as of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    gridded.check_limits(tolerance, albedo_tolerance, largest, least=2 * _FEWEST**3)
    limits = Limits(tolerance, albedo_tolerance)
    both: tuple[Side, ...] = ("reflection", "transmission") if representation(bsdf).is_slab else ("reflection",)
    sides = {side: one_side(bsdf, side) for side in both}

    def error_at(count: int) -> TableError:
        return _larger(
            _error(seen, cell_means.cell_means(gridded.photopic(seen), _edges(count))) for seen in sides.values()
        )

    most = max(count for count in range(_FEWEST, 1000) if 2 * count**3 <= largest)
    least = cell_means.of_both_orders(sides["reflection"])
    # More cells than come near to the least error would not help.
    reached = max(tolerance, _NEAR * least.percentile_95), max(albedo_tolerance, _NEAR * least.albedo)
    count = cell_means.smallest(error_at, *reached, range(_FEWEST, most + 1))
    means = [
        cell_means.cell_means(gridded.linear_rgb(seen) if colour else gridded.photopic(seen), _edges(count))
        for seen in sides.values()
    ]
    displayed, gamut = cell_means.displayable(np.stack(means))
    values = displayed.astype("<f4")
    read_back = (cell_means.luminous(of_side.astype(float)) for of_side in values)
    error = _larger(_error(seen, of_side) for seen, of_side in zip(sides.values(), read_back, strict=True))
    reading = "averaged over both orders of the directions and interpolated linearly between the centres of its cells"
    record = records.record(
        cell_means.CellTable(bsdf, values, error, reading, "rgb" if colour else "luminous", limits), FORMAT
    )
    record["left_out"] |= gamut | cell_means.irreciprocity(least)
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(_MAGIC)
        for number, sentence in enumerate(records.sentences(record)):
            escaped = sentence.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
            file.write(f'note_{number}="{escaped}"\n'.encode("ascii", "replace"))
        for head, of_side in zip((_REFLECTION, _TRANSMISSION), values, strict=False):
            file.write(head + _HEAD.pack(int(colour), count, 2 * count))
            file.write(of_side.tobytes())
    return record


def _larger(errors: Iterable[TableError]) -> TableError:
    """The larger errors of both sides."""
    found = list(errors)
    return TableError(
        max(error.percentile_95 for error in found),
        max(error.rms for error in found),
        max(error.albedo for error in found),
        sum(error.directions for error in found),
    )


def _edges(count: int) -> dict[str, Array]:
    """Edges of the cells: as long in azimuth as in polar angle [degree]."""
    polar = np.linspace(0.0, 90.0, count + 1)
    return {"theta_i": polar, "theta_o": polar, "phi_o": np.linspace(0.0, 180.0, 2 * count + 1)}


def _error(bsdf: xr.Dataset, means: Array) -> TableError:
    """The error of cell means (θ_i, θ_o, φ_o, 1) as NVIDIA's renderer reads them."""
    axes = {name: cell_means.centres(edges) for name, edges in _edges(means.shape[0]).items()}
    return cell_means.table_error(bsdf, table_nodes.interpolation(axes, (means + means.swapaxes(0, 1)) / 2))


def read(path: Path) -> ReadTable:
    """Read the reflected light of a measured BSDF, and the transmitted light where it has cells of the same size.

    The values are those of the file: the order of the two directions is not averaged as a renderer does it.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    content = path.read_bytes()
    if not content.startswith(_MAGIC):
        raise InputError(
            path,
            "not an MBSDF file",
            found=repr(content[: len(_MAGIC)])[1:],
            accepted=f"a first line {_MAGIC.decode().strip()!r}",
        )
    starts = [(at, name) for name in _REFLECTED if (at := content.find(b"\n" + name, 0, _LONGEST_HEADER)) >= 0]
    if not starts:
        held = "transmitted light alone" if b"\n" + _TRANSMISSION in content[:_LONGEST_HEADER] else "none"
        raise InputError(path, "no block of reflected light", found=held, accepted="MBSDF_DATA_REFLECTION=")
    at, name = min(starts)
    values, rest = _block(path, content, at + 1 + len(name))
    notes: tuple[str, ...] = ()
    if rest < len(content):
        if not content.startswith(_TRANSMISSION, rest):
            found, accepted = f"{len(content) - rest} bytes after the values", "MBSDF_DATA_TRANSMISSION= or nothing"
            raise InputError(path, "unexpected content", found=found, accepted=accepted)
        passing, end = _block(path, content, rest + len(_TRANSMISSION))
        if end != len(content):
            raise InputError(path, "unexpected content", found=f"{len(content) - end} bytes after the values")
        if passing.shape == values.shape:
            values = np.concatenate([values, passing[:, ::-1]], axis=1)
        else:
            notes = ("the transmitted light of the file was not read, because its cells are of another size",)
    polar = cell_means.centres(np.linspace(0.0, 90.0, values.shape[0] + 1))
    around = cell_means.centres(np.linspace(0.0, 180.0, values.shape[2] + 1))
    outgoing = polar if values.shape[1] == polar.size else np.concatenate([polar, 180 - polar[::-1]])
    axes = {"theta_i": polar, "theta_o": outgoing, "phi_o": around}
    return ReadTable("uniform", axes, values, channels="rgb" if values.shape[-1] == 3 else "photopic", notes=notes)


def _block(path: Path, content: bytes, start: int) -> tuple[Array, int]:
    """Values (θ_i, θ_o, φ_o, channels) of a block, and where it ends."""
    if len(content) < start + _HEAD.size:
        raise InputError(path, "the file ends early", found="the end of the file", accepted="the head of a block")
    kind, polar, around = _HEAD.unpack_from(content, start)
    if kind not in _CHANNELS:
        raise InputError(path, "unknown type of values", found=kind, accepted="0 (a scalar), 1 (red, green, blue)")
    if not (polar >= 2 and around >= 2 and polar * polar * around <= _MOST_CELLS):
        found = f"{polar} polar, {around} azimuthal cells"
        raise InputError(
            path, "number of cells out of range", found=found, accepted=f"2 and more, {_MOST_CELLS} in all"
        )
    count, start = polar * polar * around * _CHANNELS[kind], start + _HEAD.size
    if len(content) - start < 4 * count:
        found = f"{len(content) - start} bytes of values"
        raise InputError(path, "the file ends early", found=found, accepted=f"{4 * count} for {count} values")
    values = np.frombuffer(content, "<f4", count, start)
    if not np.isfinite(values).all():
        raise InputError(path, "a value is not finite", found=f"{values[~np.isfinite(values)][0]:g}")
    return values.astype(float).reshape(polar, polar, around, _CHANNELS[kind]), start + 4 * count

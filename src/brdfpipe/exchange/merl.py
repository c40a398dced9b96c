"""The MERL BRDF database (``.binary``): half-angle table of 90 × 90 × 180 cells in red, green and blue.

Three int32 (90, 90, 180), then float64 of the red, the green and the blue table, little endian. Index φ_d + 180·(θ_d + 90·θ_h). Node i of θ_h is at i²/90 degree,
those of θ_d and φ_d are whole degrees; φ_d has the period 180, so the table is reciprocal. Stored is BRDF/scale with scales of (1, 1.15, 1.66)/1500.
Negative values are invalid. The lookup of the database takes the node below, other programs interpolate.

References
----------
Matusik, Pfister, Brand, McMillan 2003 (SIGGRAPH), and the reader of the database, BRDFRead.cpp; Rusinkiewicz 1998 (EGWR).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf import table_nodes
from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, gridded, records
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a half-angle table in red, green and blue, as of the MERL database",
    files={"reflection": {"write": (".binary",)}},
    takes="cells",
    carries=("colour",),
    read="read",
)

_SHAPE = (90, 90, 180)
_SCALE = np.array([1.0, 1.15, 1.66]) / 1500
_VALUES = 3 * 90 * 90 * 180
AXES = {"theta_h": np.arange(90.0) ** 2 / 90, "theta_d": np.arange(90.0), "phi_d": np.arange(180.0)}
"""Nodes of the table [degree]."""


def write(bsdf: xr.Dataset, path: Path) -> records.Record:
    """Write the reflecting side.

    The stated error is that of the lookup of the database, and beside it that of a program that interpolates. Nodes of which a direction is below the horizon hold the value at the horizon, so that a program that interpolates is not drawn to 0 there.
    """
    values, gamut = cell_means.displayable(_values(gridded.linear_rgb(bsdf)))
    error = cell_means.table_error(bsdf, lambda *at: lookup(cell_means.luminous(values), *at[:4]))
    reading = "looked up at the node below without interpolation"
    record = records.record(cell_means.CellTable(bsdf, values, error, reading, "rgb"), FORMAT)
    between = cell_means.table_error(bsdf, table_nodes.interpolation(*_around(cell_means.luminous(values))))
    record["error"] |= {"interpolated": {"percentile_95": between.percentile_95, "albedo": between.albedo}}
    record["left_out"] |= gamut | cell_means.irreciprocity(cell_means.of_both_orders(bsdf))
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(np.array(_SHAPE, dtype="<i4").tobytes())
        for channel, scale in enumerate(_SCALE):
            file.write((values[..., channel] / scale).astype("<f8").tobytes())
    return record


def _values(channels: gridded.Channels) -> Array:
    """Values on the nodes, (θ_h, θ_d, φ_d, channels) [sr-1]."""
    values = np.empty((*_SHAPE, len(channels.names)))
    for row in range(_SHAPE[0]):
        axes = {**AXES, "theta_h": AXES["theta_h"][[row]]}
        values[row] = cell_means.node_values(channels, "half", axes)[0]
    # Readers take the other half of the turn for the same with both directions exchanged, which mirrored about the plane of incidence is 180 - phi_d.
    exchanged = -np.arange(_SHAPE[2]) % _SHAPE[2]
    return (values + values[:, :, exchanged]) / 2


def _around(values: Array) -> tuple[dict[str, Array], Array]:
    """Axes, and the table with its first azimuth again at 180, so that it is interpolated around."""
    return {**AXES, "phi_d": np.arange(181.0)}, np.concatenate([values, values[:, :, :1]], axis=2)


def lookup(values: Array, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """What the reader of the database makes of a table (θ_h, θ_d, φ_d, channels), (directions, channels)."""
    at = GRIDS["half"].coordinates(theta_i, phi_i, theta_o, phi_o)
    rounding = 1e-9
    row = np.sqrt(np.maximum(at["theta_h"], 0.0) * 90) + rounding
    column, turn = at["theta_d"] + rounding, at["phi_d"] % 180 + rounding
    cells = (np.clip(at.astype(int), 0, last - 1) for at, last in zip((row, column, turn), _SHAPE, strict=True))
    return np.asarray(values[*cells])


def read(path: Path) -> ReadTable:
    """Read a table of the database.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    size, wanted = path.stat().st_size, 12 + 8 * _VALUES
    with path.open("rb") as file:
        head = np.frombuffer(file.read(12).ljust(12, b"\0"), "<i4")
        if tuple(head) != _SHAPE:
            raise InputError(path, "not a MERL table", found=" × ".join(map(str, head)), accepted="90 × 90 × 180 cells")
        if size != wanted:
            raise InputError(path, "wrong length of the file", found=f"{size} bytes", accepted=f"{wanted}")
        stored = np.fromfile(file, "<f8", _VALUES).reshape(3, *_SHAPE)
    if np.isinf(stored).any() or np.nanmax(stored, initial=0.0) > 1e30:
        raise InputError(path, "a value is not finite", found=f"{stored[np.abs(stored) > 1e30][0]:g}")
    values = np.moveaxis(stored, 0, -1) * _SCALE
    values[(values < 0).any(axis=-1)] = np.nan
    axes, values = _around(values)
    return ReadTable("half", axes, values, channels="rgb")

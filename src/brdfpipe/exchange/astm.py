"""ASTM E1392, the comma-separated dialect that BSDF viewers read (``.astm``).

The file has header lines ``KEY value``, a line ``VARS`` with the column names, and one row for each pair of directions: angles in
radian, values in sr⁻¹. Viewers search the whole header for ``NUM_POINTS`` and ``VARS``: no other word may be one of these. They ask the user whether a file is
a BRDF or a BTDF, and count θ_s from the normal of the side where the light leaves: the two sides are two files.

Rows are a full grid about the normal, and φ_s covers the full circle. libbsdf gives a missing row the value of the nearest one, for which it searches all rows; it
mirrors a half circle, other readers may not. With a lay φ_s counts from a fixed direction, see :mod:`brdfpipe.exchange.fixed_azimuths`.

References
----------
libbsdf (2026), ``AstmReader``: the rules of the reader.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.one_side import Side
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import astm_rows, fixed_azimuths, gridded, number_text, records, sidecar_tables
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="BSDF tables of ASTM E1392, and the total reflectance or transmittance beside them",
    files={
        "reflection": {"write": (".astm",), "write_total_reflectance": (".total_reflectance.csv",)},
        "transmission": {
            "write_transmission": (".transmission.astm",),
            "write_total_transmittance": (".total_transmittance.csv",),
        },
    },
    takes="grid",
    beside=("write_total_reflectance", "write_total_transmittance"),
    carries=("transmission", "lay", "spectrum", "colour"),
    options={"colour": "bw", "largest": 300_000},
    spectral={"colour": "spectral"},
    read="read",
)

COLOURS = ("bw", "xyz", "spectral")
_DECIMALS = 5
_VALUES: Mapping[Side, str] = {
    "reflection": "BRDF in sr-1, not multiplied by cos theta_s; angles in radian from the normal; mirror direction at phi_s = phi_i + pi",
    "transmission": f"{astm_rows.TRANSMITTED}, not multiplied by cos theta_s; angles in radian: theta_i from the normal of the front, theta_s from that of the other "
    "side, where the light leaves; undeviated light at theta_s = theta_i and phi_s = phi_i + pi",
}


def write(bsdf: xr.Dataset, path: Path, *, colour: str = "bw", **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    colour : ``bw`` (weighted with V(λ) and D65), ``xyz`` (under D65, Y of a perfect white diffuser is 1/π), or ``spectral`` (a column for each wavelength)
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`; ``largest`` is the number of rows

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    return _write(bsdf, path, "reflection", colour, grid)


def write_transmission(bsdf: xr.Dataset, path: Path, *, colour: str = "bw", **grid: Any) -> records.Record:
    """Write the light that passes a sheet; as :func:`write`."""
    return _write(bsdf, path, "transmission", colour, grid)


def write_total_reflectance(bsdf: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the spectrum that completes a non-spectral table to the "ASTM form" of the patent US 9,395,299."""
    sidecar_tables.write_total_reflectance(bsdf, path)


def write_total_transmittance(bsdf: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write the spectrum that completes the table of the transmitting side."""
    sidecar_tables.write_total_transmittance(bsdf, path)


def read(path: Path) -> ReadTable:
    """Read one side; see :func:`brdfpipe.exchange.astm_rows.read`."""
    return astm_rows.read(path)


def _write(bsdf: xr.Dataset, path: Path, side: Side, colour: str, grid: Mapping[str, Any]) -> records.Record:
    table = _table(gridded.side_of(bsdf, side, path), colour, grid)
    record = records.record(table, FORMAT, bsdf)
    rows = table.size // table.channel_count
    if isinstance(table, fixed_azimuths.FixedAzimuths):
        turned = table.turned_error
        record["error"]["relative_azimuths"] = {"percentile_95": turned.percentile_95, "albedo": turned.albedo}
    notes = records.sentences(record, _VALUES[side])
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(_header(table, path.name, notes, rows, records.day_of(record, "unknown")).encode("ascii", "replace"))
        file.writelines(_rows(table))
    return record


def _table(bsdf: xr.Dataset, colour: str, grid: Mapping[str, Any]) -> gridded.Gridded:
    if colour not in COLOURS:
        raise ExchangeError(f"colour is {colour!r}; accepted: {', '.join(COLOURS)}")
    channels = gridded.photopic(bsdf)
    if colour == "xyz":
        channels = gridded.tristimulus(bsdf)
    elif colour == "spectral" and "wavelength" in bsdf.coords:
        channels = gridded.spectral(bsdf, bsdf["wavelength"].values)
    if not representation(bsdf).isotropic:
        return fixed_azimuths.gridded(bsdf, channels, **grid)
    least, given = 2 * 3**3, grid["largest"]
    if given < least:
        raise ExchangeError(f"largest is {given!r}; accepted: at least {least} rows")
    # The grid has half of the azimuths, which are mirrored to the full circle.
    return gridded.gridded(bsdf, "uniform", channels, **{**grid, "largest": given // 2}).full_circle()


def _header(table: gridded.Gridded, file: str, notes: list[str], rows: int, day: str) -> str:
    names = ("Integrated",) if table.channels.names == ("photopic",) else table.channels.names
    lay = "NOT isotropic: the surface has a lay" if "phi_i" in table.axes else "isotropic"
    lines = {
        "LAB_NAME": "brdfpipe",
        "SYSTEM_NAME": "brdfpipe",
        "APERTURE": "0",
        "SAMPLE_NAME": str(table.bsdf.attrs.get("material", "unnamed")),
        "MEAS_NAME": "; ".join([*notes, lay]),
        "FILE_NAME": file,
        "MEAS_DATE": day,
        "MEAS_TIME": "unknown",
    }
    text = "".join(f"{key} {' '.join(value.split())}\n" for key, value in lines.items())
    # A word of the reader's in a name would derail it.
    text = re.sub(r"(?<!\S)(NUM_POINTS|VARS)(?!\S)", r"\1_", text)
    return f"{text}NUM_POINTS {rows}\nVARS theta_i,phi_i,theta_s,phi_s,{','.join(names)}\n"


def _rows(table: gridded.Gridded) -> Iterator[bytes]:
    """Rows by rising angles."""
    theta_i, theta_s = _angles(table.axes["theta_i"]), _angles(table.axes["theta_o"])
    with_lay = "phi_i" in table.axes
    phi_i = _angles(table.axes["phi_i"]) if with_lay else number_text.texts(["0"])
    phi_s = _angles(table.axes["phi_o"])
    for incidence in range(theta_i.shape[0]):
        block = table.block(incidence)
        for row, values in enumerate(block if with_lay else block[None]):
            if with_lay:
                values = fixed_azimuths.from_fixed(values, row, table.axes)
            shape = values.shape[:2]
            columns = [
                np.broadcast_to(text, (*shape, text.shape[-1])).reshape(-1, text.shape[-1])
                for text in (theta_i[incidence], phi_i[row], theta_s[:, None], phi_s[None])
            ]
            numbers = number_text.scientific(np.maximum(values, 0.0)).reshape(columns[0].shape[0], values.shape[-1], -1)
            yield number_text.lines([*columns, *np.moveaxis(numbers, 1, 0)])


def _angles(angles: Array) -> number_text.Bytes:
    """Radian, with as many decimals as tell the angles apart."""
    radian = np.radians(angles)
    decimals = _DECIMALS
    while np.unique(np.round(radian, decimals)).size < angles.size:
        decimals += 1
    return number_text.texts([f"{angle:.{decimals}f}" for angle in radian])

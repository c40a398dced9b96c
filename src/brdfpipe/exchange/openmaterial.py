"""ASAM OpenMATERIAL 3D: look-up table of a BRDF, JSON (``_brdf.xompt``).

Rows of wavelength [m], polar angles of the incident and the outgoing light and azimuth between them [rad], and BRDF [sr-1], sorted by column. The
incident light has the azimuth 0, so the mirror direction has π. The schema takes angles to 1.570796 and 6.283185.

References
----------
ASAM OpenMATERIAL 3D, material_brdf_schema.json (2026).
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, listed_points, records
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the normal in JSON, for programs that read ASAM OpenMATERIAL 3D; not for surfaces with a lay",
    files={"reflection": {"write": ("_brdf.xompt",)}},
    refuses=("lay",),
    takes="grid",
    carries=("spectrum",),
    options={"spectral": False, "author": "not stated", "copyright": "not stated", "license": "not stated"},
    read="read",
)

_VERSION = "1.0.0"
_PHOTOPIC = 555.0
"""Wavelength that rows weighted with V(λ) state [nm]: the maximum of V(λ)."""
_LARGEST = {"theta": 1.570796, "phi": 6.283185}
"""Largest angles that the schema accepts [rad]."""


def write(
    bsdf: xr.Dataset,
    path: Path,
    *,
    spectral: bool = False,
    author: str = "not stated",
    copyright: str = "not stated",
    license: str = "not stated",
    **grid: Any,
) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    spectral : a table for each wavelength of the BSDF instead of one weighted with V(λ) and D65
    author, copyright, license : of the metadata, which need them
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : the surface has a lay, or an option is out of range.
    """
    if not representation(bsdf).isotropic:
        raise ExchangeError(
            f"{path.name}: the surface has a lay; the azimuths of an OpenMATERIAL table are relative to the incident light"
        )
    seen = gridded.side_of(bsdf, "reflection", path)
    channels = gridded.photopic_or_spectral(seen, spectral)
    table = gridded.gridded(seen, "uniform", channels, **grid).full_circle()
    record = records.record(table, FORMAT, bsdf)
    notes = records.sentences(record)
    identity = f"{record['material']} {record['digest']}"
    metadata = {
        "name": record["material"],
        "description": ". ".join(notes),
        "uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, identity)),
        "materialVersion": _VERSION,
        "openMaterial3dVersion": _VERSION,
        "copyrights": [copyright],
        "license": license,
        "authors": [author],
        "sources": f"brdfpipe, {bsdf.attrs['representation']}, digest {record['digest']}",
    }
    wavelength = np.array([_PHOTOPIC]) if channels.wavelength is None else channels.wavelength
    with store.atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        listed = json.dumps([float(f"{one:.6g}e-9") for one in wavelength])
        file.write(f'{{"metadata": {json.dumps(metadata, indent=1, ensure_ascii=False)},\n')
        file.write(f'"brdf": {{"wavelengths": {listed},\n"lookupTable": [\n')
        for number, rows in enumerate(_rows(table, wavelength)):
            file.write(",\n" * (number > 0) + ",\n".join(rows))
        file.write("\n]}}\n")
    return record


def _rows(table: gridded.Gridded, wavelength: Array) -> Iterator[list[str]]:
    """Rows by wavelength and incidence."""
    blocks = [np.maximum(block, 0.0).astype(np.float32) for _, block, _ in table.blocks()]
    theta_o, phi_o = (_radians(table.axes[name], name[:-2]) for name in ("theta_o", "phi_o"))
    for channel, nm in enumerate(wavelength):
        for theta_i, block in zip(_radians(table.axes["theta_i"], "theta"), blocks, strict=True):
            yield [
                f"[{nm:.6g}e-9,{theta_i},{polar},{around},{value:.5g}]"
                for polar, row in zip(theta_o, block[..., channel], strict=True)
                for around, value in zip(phi_o, row, strict=True)
            ]


def _radians(angles: Array, name: str) -> list[str]:
    return [f"{min(angle, _LARGEST[name]):.6f}" for angle in np.radians(angles)]


def read(path: Path) -> ReadTable:
    """Read a look-up table of a BRDF.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    brdf = listed_points.read_object(path).get("brdf")
    if not isinstance(brdf, dict) or not isinstance(brdf.get("lookupTable"), list):
        raise InputError(
            path, "no look-up table of a BRDF", found="another file of a material", accepted="brdf.lookupTable"
        )
    rows = brdf["lookupTable"]
    if not rows or not all(isinstance(row, list) and len(row) == 5 for row in rows):
        raise InputError(
            path, "a row has not five values", found=f"{len(rows)} rows", accepted="[m, rad, rad, rad, 1/sr]"
        )
    points = listed_points.numbers(path, rows, "rows of the look-up table")
    wavelength, angles = points[:, 0] * 1e9, np.degrees(points[:, 1:4])
    if not (np.nanmin(wavelength, initial=1.0) > 0 and np.nanmax(wavelength, initial=0.0) <= 20e6):
        raise InputError(
            path, "a wavelength is out of range", found=f"{np.nanmin(points[:, 0]):g} m", accepted="1e-9 to 17e-3 m"
        )
    columns = {
        "phi_i": np.zeros(len(points)),
        "theta_i": angles[:, 0],
        "theta_o": angles[:, 1],
        "phi_o": angles[:, 2],
        "channel": np.round(wavelength, 6),
    }
    axes, values = listed_points.on_grid(path, columns, points[:, 4:])
    nm = np.unique(columns["channel"])
    notes: tuple[str, ...] = ()
    if nm.size == 1 and nm[0] != _PHOTOPIC:
        notes = (f"the values are those of {nm[0]:g} nm, and stand for all wavelengths",)
    return ReadTable(
        "uniform",
        axes,
        values[..., 0],
        channels="spectral" if nm.size > 1 else "photopic",
        wavelength=nm if nm.size > 1 else None,
        notes=notes + _receiver(brdf.get("receiverSolidAngles")),
    )


def _receiver(stated: object) -> tuple[str, ...]:
    """The solid angles of the receiver, which bound how narrow a lobe the table resolves."""
    if not isinstance(stated, list):
        return ()
    found = [
        f"{one['solidAngle']:g} sr at {1e9 * one['wavelength']:g} nm"
        for one in stated[:20]
        if isinstance(one, dict)
        and all(isinstance(one.get(name), int | float) for name in ("solidAngle", "wavelength"))
    ]
    return (f"measured with receivers of {', '.join(found)}",) if found else ()

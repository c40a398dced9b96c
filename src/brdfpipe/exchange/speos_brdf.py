"""Ansys Speos: BRDF by incidence and wavelength of a surface without a lay, text (``.brdf``).

Blocks by incidence and wavelength, each with its reflectance in percent, which gives the scale of its values.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import gridded, records, speos_text
from brdfpipe.exchange.azimuths import from_source_at
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the normal for each wavelength, for Ansys Speos; not for surfaces with a lay",
    files={"reflection": {"write": (".brdf",)}},
    refuses=("lay",),
    takes="grid",
    carries=("spectrum",),
    options={"spectral": False},
    spectral={"spectral": True},
    read="read",
    begins=("\nOPTIS",),
)

_KIND = "brdf"


def write(bsdf: xr.Dataset, path: Path, *, spectral: bool = False, **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    spectral : a table for each wavelength of the BSDF instead of one weighted with V(λ) and D65
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : the surface has a lay, or an option is out of range.
    """
    if not representation(bsdf).isotropic:
        raise ExchangeError(
            f"{path.name}: the surface has a lay, which a .brdf file cannot hold; use the format speos (.anisotropicbsdf)"
        )
    seen = gridded.side_of(bsdf, "reflection", path)
    channels = gridded.photopic_or_spectral(seen, spectral)
    table = gridded.gridded(seen, "uniform", channels, **grid)
    record = records.record(table, FORMAT, bsdf)
    theta_i = table.axes["theta_i"]
    wavelength = np.array([speos_text.PHOTOPIC]) if channels.wavelength is None else channels.wavelength
    lists = ("\t".join(f"{one:g}" for one in values) for values in (theta_i, wavelength))
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(speos_text.title(_KIND, records.sentences(record)).encode())
        file.write(f"1\t0\n1\n{theta_i.size}\t{wavelength.size}\n{chr(10).join(lists)}\n".encode())
        for _, values, reflectance in table.blocks():
            for channel, share in enumerate(reflectance):
                file.write(f"{speos_text.percent(share)}\n".encode() + speos_text.block(table, values[..., channel]))
        file.write(b"End of file\n")
    return record


def read(path: Path) -> ReadTable:
    """Read the reflecting side.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    lines = speos_text.after_title(path, _KIND)
    transmits, quantity = speos_text.read_flags(lines)
    counts = lines.next("the numbers of incidences and wavelengths").split()
    if len(counts) != 2:
        raise lines.error("expected the numbers of incidences and wavelengths", found=f"{len(counts)} numbers")
    incidences, wavelengths = (lines.count(count, 4000) for count in counts)
    theta_i, wavelength = lines.numbers(incidences, "incidences"), lines.numbers(wavelengths, "wavelengths")
    if wavelength[0] <= 0 or not (np.diff(wavelength) > 0).all():
        raise lines.error("the wavelengths do not increase", found=f"{wavelength[0]:g} to {wavelength[-1]:g}")
    if theta_i.min() < 0 or theta_i.max() > 90:
        raise lines.error("an incidence is out of range", found=f"{theta_i.max():g}", accepted="0 to 90")
    axes: dict[str, Array] = {}
    declared, blocks = np.empty((incidences, wavelengths)), []
    for index in np.ndindex(declared.shape):
        declared[index] = lines.number(lines.next("a percentage")) / 100
        if not 0 <= declared[index] < np.inf:
            raise lines.error("a percentage is out of range", found=f"{100 * declared[index]:g}", accepted="0 and more")
        blocks.append(speos_text.read_block(lines, axes))
        speos_text.check_size(lines, *declared.shape, blocks[0].size)
    if not transmits:
        lines.expect("End of file")
    values = np.moveaxis(np.array(blocks).reshape(*declared.shape, *blocks[0].shape), 1, -1)
    phi_o, values = from_source_at(speos_text.SOURCE, axes["phi"], values, path)
    notes = ["values on the scale of the declared reflectance of each incidence"]
    if transmits:
        notes.append("the transmitted light was not read")
    if wavelengths == 1 and wavelength[0] != speos_text.PHOTOPIC:
        notes.append(f"the values are those of {wavelength[0]:g} nm, and stand for all wavelengths")
    return ReadTable(
        "uniform",
        {"theta_i": theta_i, "theta_o": axes["theta"], "phi_o": phi_o},
        values,
        channels="photopic" if wavelengths == 1 else "spectral",
        wavelength=None if wavelengths == 1 else wavelength,
        declared_integral=declared,
        quantity=quantity,
        relative=True,
        notes=tuple(notes),
    )

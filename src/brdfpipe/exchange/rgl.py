"""Measured materials of the RGL laboratory, which Mitsuba's plugin ``measured`` renders (tensor file, ``.bsdf``).

The file holds a facet density ``ndf``, its projection ``sigma``, the density of visible facets ``vndf``, and the BRDF over that of mirror facets, on
even numbers: nodes lie where the material sends its light, and a program draws directions from the same tables. The BRDF·cos θ_o is
``spectra · ndf / (4 sigma)``, whatever density is chosen; here it is that of light that comes in along the normal.

References
----------
Dupuy & Jakob 2018 (ACM Trans. Graph. 37, 274); Mitsuba 3, plugin ``measured``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Limits, TableError, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, records, tensor_file
from brdfpipe.exchange.gridded import Channels
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.exchange.rgl_tables import Tables, chosen
from brdfpipe.geometry import Array

FORMAT = Format(
    description="tables for Mitsuba's plugin `measured`, one in colours and one by wavelength",
    files={"reflection": {"write": (".rgb.bsdf",), "write_spectral": (".spectral.bsdf",)}},
    takes="grid",
    carries=("lay", "spectrum", "colour"),
    read="read",
    begins=("tensor_file",),
)

_READ_TURNS = 24
"""Intervals of the azimuth of incidence at which a file of a surface with a lay is read."""
_READ_INCIDENCES, _READ_POLAR, _READ_AROUND = np.arange(0.0, 88.1, 4.0), 96, 37


def write(bsdf: xr.Dataset, path: Path, *, scale: float = 1.0, **grid: Any) -> records.Record:
    """Write linear sRGB (D65), for the variants of Mitsuba that render in colours.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    scale : of all values, for a blend; the description of the file states it
    grid : ``tolerance``, ``albedo_tolerance`` and ``largest``, see :data:`brdfpipe.exchange.registry.GRID_OPTIONS`
    """
    return _write(bsdf, path, gridded.linear_rgb(one_side(bsdf, "reflection")), None, scale, grid)


def write_spectral(bsdf: xr.Dataset, path: Path, *, scale: float = 1.0, **grid: Any) -> records.Record:
    """Write values by wavelength, for the spectral variants of Mitsuba; parameters as for :func:`write`."""
    wavelength = bsdf["wavelength"].values if "wavelength" in bsdf.coords else np.array([360.0, 830.0])
    return _write(bsdf, path, gridded.spectral(one_side(bsdf, "reflection"), wavelength), wavelength, scale, grid)


def _write(
    bsdf: xr.Dataset, path: Path, channels: Channels, wavelength: Array | None, scale: float, grid: Mapping[str, Any]
) -> records.Record:
    choice = chosen(bsdf, **grid)
    size, tables = choice.size, choice.tables_of(bsdf, channels)
    count = tables.values.shape[1]
    values = np.broadcast_to(
        scale * tables.values,
        (len(tables.values), wavelength.size if wavelength is not None else 3, size.side, size.side),
    )
    lead = tables.phi_i.size, tables.theta_i.size
    drawn = tables.values.mean(axis=1) * tables.visible
    luminance = np.maximum(drawn, 1e-9 * drawn.max())
    note = "" if scale == 1 else f"; the values are {scale:g} times the BRDF"
    fields = {
        "description": np.frombuffer((records.comment(bsdf) + note).encode("ascii", "replace"), dtype=np.uint8),
        "jacobian": np.ones(1, dtype=np.uint8),
        "phi_i": tables.phi_i,
        "theta_i": tables.theta_i,
        "ndf": tables.ndf,
        "sigma": tables.sigma,
        "vndf": tables.vndf.reshape(*lead, *tables.vndf.shape[1:]),
        "luminance": luminance.reshape(*lead, size.side, size.side),
        ("rgb" if wavelength is None else "spectra"): values.reshape(*lead, -1, size.side, size.side),
    }
    if wavelength is not None:
        fields["wavelengths"] = wavelength
    written = {name: field if field.dtype == np.uint8 else field.astype(np.float32) for name, field in fields.items()}
    tensor_file.write(path, written)
    record = records.record(
        _Written(
            bsdf,
            choice.error,
            Limits(grid["tolerance"], grid["albedo_tolerance"]),
            size.values * count,
            "rgb" if wavelength is None else "spectrum",
        ),
        FORMAT,
    )
    record["left_out"] |= _outside_gamut(bsdf, channels) if wavelength is None else {}
    return record


def _outside_gamut(bsdf: xr.Dataset, channels: Channels) -> dict[str, str]:
    """A sentence where colours outside sRGB have negative values, which the file cannot hold."""
    pairs = fresh_pairs(nonspectral(bsdf), seed=2)
    brdf = channels.convert(representation(channels.source).evaluate(*pairs, channels.wavelength))
    share = float((brdf < 0).any(axis=-1).mean())
    if share == 0:
        return {}
    sentence = f"colours outside sRGB: in {share:.1%} of the directions a negative value of R, G or B became 0; the spectral file has them"
    return {"gamut": sentence}


class _Written(NamedTuple):
    bsdf: xr.Dataset
    error: TableError
    limits: Limits
    size: int
    content: records.Content
    reading: str = "evaluated as Mitsuba does"


def read(path: Path) -> ReadTable:
    """Read a file as a table about the mirror direction.

    Raises InputError: the file is not of this kind, or its fields contradict each other.
    """
    fields = tensor_file.read(path)
    kind = "rgb" if "rgb" in fields else "spectra"
    needed = ("phi_i", "theta_i", "ndf", "sigma", "vndf", kind)
    if missing := [name for name in needed if name not in fields]:
        raise InputError(
            path, "the file lacks fields", found=", ".join(sorted(fields))[:80], accepted=", ".join(missing)
        )
    lead = fields["phi_i"].size, fields["theta_i"].size
    shapes = {"ndf": 2, "sigma": 2, "vndf": 4, kind: 5}
    for name, dimensions in shapes.items():
        array = fields[name]
        right = array.ndim == dimensions and (dimensions == 2 or array.shape[:2] == lead) and min(array.shape[-2:]) >= 2
        if not right:
            raise InputError(path, f"the field {name!r} does not fit the incidences", found=f"shape {array.shape}")
        if not np.isfinite(array).all():
            raise InputError(path, f"the field {name!r} has values that are not finite")
    wavelength = None
    if kind == "spectra":
        wavelength = np.asarray(fields.get("wavelengths", np.empty(0)), dtype=float)
        if wavelength.size != fields[kind].shape[2]:
            raise InputError(path, "wavelengths and spectra differ in number", found=f"{wavelength.size} wavelengths")
    tables = Tables.of_fields(fields, kind)
    return _resampled(tables, "rgb" if kind == "rgb" else "spectral", wavelength)


def _resampled(tables: Tables, channels: Any, wavelength: Array | None) -> ReadTable:
    from brdfpipe.bsdf.grids import GRIDS

    axes = {
        "theta_i": _READ_INCIDENCES,
        "theta_s": np.concatenate([[0.0], np.geomspace(0.05, 178.0, _READ_POLAR)]),
        "phi_s": np.linspace(0.0, 180.0 if tables.isotropic else 360.0, _READ_AROUND),
    }
    if not tables.isotropic:
        axes = {"phi_i": np.linspace(0.0, 360.0, _READ_TURNS + 1), **axes}
    nodes = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    theta_i, phi_i, theta_o, phi_o = (
        angle.ravel() for angle in np.broadcast_arrays(*GRIDS["specular"].directions(nodes))
    )
    shape = tuple(axis.size for axis in axes.values())
    parts = [
        tables.evaluate(theta_i[k], phi_i[k], np.minimum(theta_o[k], 89.0), phi_o[k], None)
        for k in np.array_split(np.arange(theta_i.size), max(1, theta_i.size // 50_000))
    ]
    note = "resampled about the mirror direction, to 88 degree of incidence"
    return ReadTable("specular", axes, np.concatenate(parts).reshape(*shape, -1), channels, wavelength, notes=(note,))

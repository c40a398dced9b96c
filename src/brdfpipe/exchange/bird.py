"""Universal BRDF data format of the project BiRD, JSON (``.bird.json``; others name it ``.brdf``).

Lists of one length: angles of the incident and the reflected light [degree], BRDF [sr-1], its standard uncertainty, and wavelengths [nm]; and metadata on origin and
sample. Polar angles are below 90 and azimuths below 360 degree.

References
----------
Lanevski et al. 2022, Color Res. Appl. 47, 1177; BiRD_view, BRDF_JSON_schema 1.0 (EMPIR 16NRM08, 18SIB03).
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import uncertain
from brdfpipe.bsdf.tabulation import tabulate
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, listed_points, records
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="values, their standard uncertainties and their origin in JSON, in the universal BRDF format of the project BiRD",
    files={"reflection": {"write": (".bird.json",)}},
    takes="grid",
    carries=("lay", "spectrum", "uncertainty"),
    options={
        "spectral": False,
        "timestamp": "1970-01-01T00:00:00Z",
        "organization": "not stated",
        "contact_person": "not stated",
        "email": "not.stated@example.org",
    },
    read="read",
    reads=(".brdf",),
    begins=("\n{",),
)

_SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
_ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
_NOT_STATED = "not stated"
_DEGREES = {"deg": 1.0, "°": 1.0, "rad": 180 / np.pi}
_NANOMETRES = {"nm": 1.0, "μm": 1e3, "µm": 1e3}
_UNPOLARISED = ("u", [1, 0, 0, 0])

_NO_TIME = "1970-01-01T00:00:00Z"
"""Where the time is not known; the default of ``timestamp``."""
_OWN = ("digest", "measurement", "uncertainty", "left_out", "error")
"""Parts of the record in the section of our own."""


def write(
    bsdf: xr.Dataset,
    path: Path,
    *,
    spectral: bool = False,
    timestamp: str = _NO_TIME,
    organization: str = _NOT_STATED,
    contact_person: str = _NOT_STATED,
    email: str = "not.stated@example.org",
    **grid: Any,
) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    spectral : values for each wavelength of the BSDF instead of those weighted with V(λ) and D65
    timestamp : of the measurement or simulation, ISO 8601; by default the day of the measurement, and a fixed one of what was not measured, so that equal inputs give equal files
    organization, contact_person, email : of the metadata, which need them
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    seen = gridded.side_of(bsdf, "reflection", path)
    spectral = spectral and "wavelength" in bsdf.coords
    channels = gridded.photopic_or_spectral(seen, spectral)
    table = gridded.gridded(seen, "uniform", channels, **grid).full_circle()
    record = records.record(table, FORMAT, bsdf)
    values = np.stack(
        [np.maximum(block, 0.0) for _, block, _ in table.blocks()], axis=list(table.axes).index("theta_i")
    )
    u = _uncertainty(seen if spectral else nonspectral(seen), table)
    kept, columns = _columns(table)
    data: dict[str, Any] = {
        name: {"unit": "deg", "values": _written(column, 7)} for name, column in zip(_ANGLES, columns, strict=True)
    }
    data["BRDF"] = {
        "unit": "1/sr",
        "values": _written(values.reshape(-1, len(channels.names))[kept].ravel(), 5),
        "comments": records.VALUES["reflection"] + ("" if spectral else "; weighted with V(lambda) and D65"),
    }
    if u is not None:
        data["uBRDF"] = {
            "unit": "1/sr",
            "values": _written(u.reshape(values.shape).reshape(-1, values.shape[-1])[kept].ravel(), 3),
        }
        data["uBRDF"]["comments"] = (
            "standard uncertainties (k = 1) of each value by itself: their errors are correlated"
        )
    elif uncertain(bsdf):
        record["left_out"]["uncertainty"] = "standard uncertainties"
    if channels.wavelength is not None:
        data["wavelength_i"] = {"unit": "nm", "values": _written(np.tile(channels.wavelength, int(kept.sum())), 7)}
    else:
        data["theta_i"]["comments"] = "light of the CIE illuminant D65"
    named = {"organization": organization, "contact_person": contact_person, "email": email}
    content = {"metadata": _metadata(bsdf, record, timestamp, named), "data": data}
    with store.atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        json.dump(content, file, ensure_ascii=False, separators=(",", ":"))
        file.write("\n")
    return record


def _uncertainty(bsdf: xr.Dataset, table: gridded.Gridded) -> Array | None:
    """Standard uncertainties on the nodes, (axes…[, wavelength]) [sr-1]; None where they are not known."""
    if not (uncertain(bsdf) or representation(bsdf).states_uncertainty):
        return None
    found = tabulate(bsdf, dict(table.axes))
    if "brdf_u" not in found or not np.isfinite(found["brdf_u"].values).all():
        return None
    return np.asarray(found["brdf_u"].transpose(*table.axes, ...).values)


def _columns(table: gridded.Gridded) -> tuple[Array, list[Array]]:
    """Which nodes are written, because no other has their directions, and θ_i, φ_i, θ_r and φ_r of each value of these."""
    axes = {"phi_i": np.zeros(1), **table.axes}
    phi_i, theta_i, theta_r, relative = (
        grid.ravel()
        for grid in np.meshgrid(*(axes[name] for name in ("phi_i", "theta_i", "theta_o", "phi_o")), indexing="ij")
    )
    kept = (phi_i < 360) & (relative < 360)
    count = len(table.channels.names)
    columns = theta_i, phi_i, np.minimum(theta_r, 89.999), (phi_i + relative) % 360
    return kept, [np.repeat(column[kept], count) for column in columns]


def _written(values: Array, digits: int) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values]


def _metadata(bsdf: xr.Dataset, record: records.Record, timestamp: str, named: Mapping[str, str]) -> dict[str, Any]:
    measured = representation(bsdf).states_quality
    address = dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), _NOT_STATED)
    identity = uuid.uuid5(uuid.NAMESPACE_OID, f"{record['material']} {record['digest']}")
    return {
        "schema": _SCHEMA,
        "id": f"urn:uuid:{identity}",
        "type": "BRDF",
        "timestamp": timestamp if timestamp != _NO_TIME else records.day_of(record, _NO_TIME[:10]) + _NO_TIME[10:],
        "provenance": {**named, "location": address},
        "description": ". ".join(records.sentences(record)),
        "method": "measurement" if measured else "simulation",
        "instrumentation": record.get("measurement", {}).get("rig", "NA"),
        "software": {"name": "brdfpipe", "description": f"representation {bsdf.attrs['representation']}"},
        "sample": {
            "name": record["material"],
            "type": _NOT_STATED,
            "dimensions": {},
            "shape": "flat",
            "zero_azimuth_location": "the x axis of the sample; a surface without a lay has none",
        },
        "environment": "NA",
        "adhoc_section": {key: record[key] for key in _OWN if key in record},
    }


def read(path: Path) -> ReadTable:
    """Read values on a grid, with their uncertainties where the file has them.

    Values of polarised light are refused: this package takes those of unpolarised light for a BRDF.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    content = listed_points.read_object(path)
    data = content.get("data")
    if not isinstance(data, dict) or not all(isinstance(data.get(name), dict) for name in (*_ANGLES, "BRDF")):
        found = ", ".join(map(str, content))[:60]
        raise InputError(path, "no BRDF data", found=found, accepted=f"data with {', '.join(_ANGLES)} and BRDF")
    angles = {name: _list(path, data, name, _DEGREES) for name in _ANGLES}
    brdf = _list(path, data, "BRDF", {"1/sr": 1.0, "sr^-1": 1.0})
    fields, wavelength = [brdf], np.zeros(brdf.size)
    for name in ("polarization_i", "polarization_r"):
        listed = data[name].get("values") if isinstance(data.get(name), dict) else None
        if isinstance(listed, list) and any(one not in _UNPOLARISED for one in listed):
            raise InputError(
                path, "values of polarised light are not read", where=name, accepted="unpolarised light, u"
            )
    if isinstance(data.get("wavelength_i"), dict):
        wavelength = _list(path, data, "wavelength_i", _NANOMETRES)
    if isinstance(data.get("uBRDF"), dict):
        fields.append(_u(path, data, brdf))
    columns = {**angles, "wavelength_i": wavelength}
    for name, column in columns.items():
        if column.size != brdf.size:
            raise InputError(path, "the lists differ in length", where=name, found=column.size, accepted=f"{brdf.size}")
    if not 0 < np.nanmax(wavelength, initial=1.0) < 1e7:
        wavelength = np.zeros(brdf.size)
    relative = np.round((angles["phi_r"] - angles["phi_i"]) % 360, 3) % 360
    ordered = {
        "phi_i": angles["phi_i"],
        "theta_i": angles["theta_i"],
        "theta_o": angles["theta_r"],
        "phi_o": relative,
        "channel": np.round(wavelength, 6),
    }
    axes, values = listed_points.on_grid(path, ordered, np.stack(fields, axis=-1))
    nm = np.unique(ordered["channel"])
    notes = (f"the values are those of {nm[0]:g} nm, and stand for all wavelengths",) if nm.size == 1 and nm[0] else ()
    return ReadTable(
        "uniform",
        axes,
        values[..., 0],
        channels="spectral" if nm.size > 1 else "photopic",
        wavelength=nm if nm.size > 1 else None,
        uncertainty=values[..., 1] if len(fields) == 2 else None,
        notes=notes,
    )


def _list(path: Path, data: Mapping[str, Any], name: str, units: Mapping[str, float]) -> Array:
    """Values of a variable in the unit of the first of ``units``."""
    unit = data[name].get("unit")
    if not isinstance(unit, str) or unit not in units:
        raise InputError(path, "unknown unit", where=name, found=repr(unit)[:40], accepted=", ".join(units))
    values = listed_points.numbers(path, data[name].get("values"), name)
    if values.ndim != 1 or values.size == 0:
        raise InputError(path, "no list of numbers", where=name, found=f"{values.ndim} dimensions", accepted="a list")
    return values * units[unit]


def _u(path: Path, data: Mapping[str, Any], brdf: Array) -> Array:
    values = _list(path, data, "uBRDF", {"1/sr": 1.0, "sr^-1": 1.0, "%": 0.01})
    if values.size != brdf.size or np.nanmin(values, initial=0.0) < 0:
        raise InputError(
            path, "uncertainties do not fit the values", found=f"{values.size}", accepted=f"{brdf.size}, 0 and more"
        )
    return values * brdf if data["uBRDF"]["unit"] == "%" else values

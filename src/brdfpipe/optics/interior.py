"""Internal transmittance of a clear body."""

from __future__ import annotations

import re
from collections.abc import Mapping
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import columns, vocabulary
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

NEUTRAL_SPAN = (360.0, 780.0)
"""Wavelengths at which a constant is stored [nm]; it applies at every wavelength."""

PER_MM = {"1/mm": 1.0, "1/cm": 0.1, "1/m": 1e-3}
"""Units of an absorption coefficient."""

_KEY = "slab.internal_transmittance"
_ABSORPTION = "slab.absorption"
_UNCERTAINTY = "slab.transmittance_uncertainty"
_LARGEST_UNCERTAINTY = 0.5
_WIDEST_GAP = 50.0
_NOISE = 1e-3
_PERCENT = re.compile(r"%|percent|prozent", re.IGNORECASE)


def ingest(spec: Mapping[str, Any], path: str | PathLike[str] | None = None) -> xr.Dataset:
    """Internal transmittance of a body from the ``slab`` section of material.yaml.

    Parameters
    ----------
    spec : ``{thickness}`` [mm] and ``internal_transmittance``, a number or ``{file, scale}``; or ``absorption``, a number [1/mm]
        or ``{file, unit}``; with neither the body absorbs nothing. ``transmittance_uncertainty`` is a standard uncertainty of the
        internal transmittance, common to all wavelengths [1]
    path : path of the file, if it differs from the name in ``spec``

    Returns
    -------
    Dataset of kind ``interior``: ``internal_transmittance(wavelength)`` [1], straight from face to face, without
    the reflection at the faces, and ``internal_transmittance_u`` where it is known; ``thickness`` [mm]. A constant is stored at 360 and 780 nm, with attribute ``dispersion``
    ``constant``

    Raises
    ------
    InputError : thickness not above 0, values out of range, or a table that does not cover 400–700 nm.

    Notes
    -----
    τ = exp(−a d) of an absorption coefficient a and a thickness d (Lambert's law); at a slant angle θ' inside τ^(1/cos θ').
    """
    thickness = spec.get("thickness")
    if isinstance(thickness, bool) or not isinstance(thickness, Real) or not 0 < float(thickness) < np.inf:
        raise _refusal("invalid thickness", thickness, "mm, above 0", "slab.thickness")
    thickness = float(thickness)
    absorbs = "absorption" in spec
    given = spec["absorption"] if absorbs else spec.get("internal_transmittance", 1.0)
    notes: list[str] = []
    doubts: tuple[str, ...] = ()
    if isinstance(given, Mapping):
        file = Path(path if path is not None else str(given["file"]))
        key = f"{_ABSORPTION if absorbs else _KEY}.file"
        table = columns.read_spectral_table(file, key, "wavelength and one value", most=1, widest=_WIDEST_GAP)
        wavelength, values, notes, doubts = table.wavelength, table.values[:, 0], table.notes, table.doubts
        lowest = int(np.argmin(values))
        if values[lowest] < -_NOISE:
            raise InputError(
                file,
                "negative transmittance or absorption",
                where=f"{wavelength[lowest]:g} nm",
                found=f"{values[lowest]:.4g}",
                accepted="values of at least 0",
                key=key,
            )
        values = np.maximum(values, 0.0)
        percent = any(_PERCENT.search(text) for text in table.titles)
        values = (
            values * PER_MM[given.get("unit", "1/mm")]
            if absorbs
            else _fraction(file, values, given.get("scale"), percent)
        )
        source, dispersion = f"table {file.name}", "table"
    else:
        wavelength, values = np.array(NEUTRAL_SPAN), np.full(2, _number(given, absorbs))
        source, dispersion = "constant from material.yaml", "constant"
    passed = np.exp(-values * thickness) if absorbs else values
    dataset = xr.Dataset(
        {"internal_transmittance": ("wavelength", passed), "thickness": thickness},
        coords={"wavelength": wavelength},
        attrs={"source": source, "dispersion": dispersion},
    )
    if (u := spec.get("transmittance_uncertainty")) is not None:
        if isinstance(u, bool) or not isinstance(u, Real) or not 0 <= float(u) <= _LARGEST_UNCERTAINTY:
            accepted = f"a number from 0 to {_LARGEST_UNCERTAINTY:g}"
            raise _refusal("invalid uncertainty of the internal transmittance", u, accepted, _UNCERTAINTY)
        dataset["internal_transmittance_u"] = xr.full_like(dataset["internal_transmittance"], float(u))
    return vocabulary.add_warning(vocabulary.add_history(vocabulary.label(dataset, "interior"), *notes), *doubts)


def spectral(interior: xr.Dataset) -> float | xr.DataArray:
    """Internal transmittance: a number if it is constant, otherwise a DataArray over wavelength."""
    vocabulary.validate(interior, "interior")
    passed = interior["internal_transmittance"]
    return float(passed[0]) if interior.attrs["dispersion"] == "constant" else passed


def _number(value: object, absorbs: bool) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 <= float(value) <= (np.inf if absorbs else 1.0):
        if absorbs:
            accepted = "a number at least 0 in 1/mm, or {file: table.txt}"
            raise _refusal("invalid absorption coefficient", value, accepted, _ABSORPTION)
        raise _refusal("invalid internal transmittance", value, "0 to 1, or {file: table.txt}", _KEY)
    return float(value)


def _fraction(path: Path, values: Array, scale: str | None, percent: bool) -> Array:
    highest = float(values.max())
    if scale is None and (percent or highest > 1 + _NOISE):
        raise InputError(
            path,
            "ambiguous scale: fraction or percent",
            found=f"values up to {highest:g}" + (" and a header that says percent" if percent else ""),
            accepted="fraction (at most 1) or percent",
            key=f"{_KEY}.scale",
        )
    fraction = values / 100 if scale == "percent" else values
    if fraction.max() > 1 + _NOISE:
        raise InputError(
            path,
            "internal transmittance above 1",
            found=f"{highest:g}" + (" percent" if scale == "percent" else ""),
            accepted="at most 1; without the reflection at the faces",
            key=f"{_KEY}.file",
        )
    return np.minimum(fraction, 1.0)


def _refusal(problem: str, found: object, accepted: str, key: str) -> InputError:
    return InputError("material.yaml", problem, where=key, found=repr(found)[:60], accepted=accepted, key=key)

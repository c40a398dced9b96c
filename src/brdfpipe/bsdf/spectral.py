"""Fields of a BSDF at other wavelengths than its own, and state that is prepared once per set of wavelengths."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array

State = TypeVar("State")

_WAVELENGTH_SETS = 4
"""Sets of wavelengths whose prepared state is kept."""


def at_wavelengths(field: xr.DataArray, wavelength: Array | None) -> Array:
    """Values of a field, linear between its own wavelengths.

    Parameters
    ----------
    field : of any dimensions; brought to have ``wavelength`` last, where it has it
    wavelength : (W,) nm, within the field's own; None for these

    Returns
    -------
    (…, W), or (…) of a field that does not depend on wavelength
    """
    if "wavelength" not in field.dims:
        return np.asarray(field.values, dtype=float)
    field = field.transpose(..., "wavelength")
    values = np.asarray(field.values, dtype=float)
    if wavelength is None:
        return values
    own = field["wavelength"].values
    if own.size == 1:
        return np.repeat(values, np.size(wavelength), axis=-1)
    above = np.clip(np.searchsorted(own, wavelength), 1, own.size - 1)
    part = (np.asarray(wavelength) - own[above - 1]) / (own[above] - own[above - 1])
    return np.asarray(values[..., above - 1] * (1 - part) + values[..., above] * part)


def per_wavelength(prepare: Callable[[Array | None], State]) -> Callable[[Array | None], State]:
    """Keep what ``prepare`` returns for the last few sets of wavelengths (None for those of the dataset)."""

    @lru_cache(maxsize=_WAVELENGTH_SETS)
    def prepared(wavelengths: bytes | None) -> State:
        return prepare(None if wavelengths is None else np.frombuffer(wavelengths))

    return lambda wavelength: prepared(None if wavelength is None else np.asarray(wavelength, dtype=float).tobytes())

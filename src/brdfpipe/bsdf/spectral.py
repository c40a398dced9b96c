"""Interpolation of the fields of a BSDF over wavelength, and a cache of state for each set of wavelengths."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array

State = TypeVar("State")

OnlyOnce = Callable[[tuple[Hashable, ...], Callable[[], Any]], Any]
"""What a function gives, under a name with the identities of all that it depends on beside the directions."""

_WAVELENGTH_SETS = 4
"""Sets of wavelengths whose state is cached."""


def at_wavelengths(field: xr.DataArray, wavelength: Array | None) -> Array:
    """Values of a field, linear between its wavelengths, (…, W); (…) if it does not depend on wavelength.

    ``wavelength`` is (W,) nm, within those of the field; None for these.
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
    fraction = (np.asarray(wavelength) - own[above - 1]) / (own[above] - own[above - 1])
    return np.asarray(values[..., above - 1] * (1 - fraction) + values[..., above] * fraction)


def spectral_values(bsdf: xr.Dataset, name: str, wavelength: Array | None) -> Array:
    """Values of a variable, as :func:`at_wavelengths`, (…, W); (…, 1) if it does not depend on wavelength."""
    variable = bsdf.variables[name]  # takes a fraction of the time of an array with coordinates
    if "wavelength" not in variable.dims:
        return np.asarray(variable.values, dtype=float)[..., None]
    if wavelength is None and variable.dims[-1] == "wavelength":
        return np.asarray(variable.values, dtype=float)
    return at_wavelengths(bsdf[name], wavelength)


def per_wavelength(prepare: Callable[[Array | None], State]) -> Callable[[Array | None], State]:
    """Cache ``prepare`` for the last few sets of wavelengths (None for those of the dataset)."""

    @lru_cache(maxsize=_WAVELENGTH_SETS)
    def prepared(wavelengths: bytes | None) -> State:
        return prepare(None if wavelengths is None else np.frombuffer(wavelengths))

    return lambda wavelength: prepared(None if wavelength is None else np.asarray(wavelength, dtype=float).tobytes())


def each_time(name: tuple[Hashable, ...], compute: Callable[[], Any]) -> Any:
    """Compute at every call: for a BSDF by itself."""
    return compute()


def only_once() -> OnlyOnce:
    """Compute at the first call of a name: for several BSDFs in the same directions, which share parts."""
    found: dict[tuple[Hashable, ...], Any] = {}

    def once(name: tuple[Hashable, ...], compute: Callable[[], Any]) -> Any:
        if name not in found:
            found[name] = compute()
        return found[name]

    return once

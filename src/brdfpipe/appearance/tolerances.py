"""Standard uncertainty of a reading from the tolerances of instruments: independent rectangular distributions."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.geometry import Array


def standard_uncertainty(half_ranges: ArrayLike, axis: int | None = -1) -> Array:
    """Standard uncertainty from the half ranges that each tolerance gives a reading: √(Σ r² / 3) along ``axis``."""
    return np.asarray(np.sqrt(np.sum(np.square(half_ranges), axis=axis) / 3))


def labelled(name: str, values: ArrayLike, **coordinates: Any) -> xr.DataArray:
    """Values with their dimension coordinates, unit and long name; ``<name>_u`` is the standard uncertainty of ``name``."""
    quantity = vocabulary.QUANTITIES[name.removesuffix("_u")]
    long_name = quantity.long_name
    if name.endswith("_u"):
        long_name = f"standard uncertainty of {long_name}, from tolerances"
    attrs = {"units": quantity.units, "long_name": long_name}
    return xr.DataArray(np.asarray(values, dtype=float), coordinates, tuple(coordinates), name, attrs)

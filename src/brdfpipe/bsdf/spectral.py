"""Fields of a BSDF at other wavelengths than its own."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array


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

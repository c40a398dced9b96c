"""The representation ``table``: a BRDF on a grid of directions, interpolated linearly."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.geometry import Array

AXES = ("theta_i", "theta_o", "phi_o")
"""Dimensions of a table of an isotropic BSDF; phi_o is taken from the azimuth of incidence."""


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF in sr⁻¹, (directions…, wavelength), linear between the nodes and constant beyond the outermost."""
    from scipy.interpolate import RegularGridInterpolator

    brdf = bsdf["brdf"].transpose(*AXES, ...)
    if "wavelength" in brdf.dims and wavelength is not None:
        brdf = brdf.interp(wavelength=wavelength)
    axes = [bsdf[name].values for name in AXES]
    above = (theta_i < 90) & (theta_o < 90)
    asked = [theta_i, theta_o, _fold(phi_o - phi_i, axes[2])]
    points = np.stack([np.clip(values, axis[0], axis[-1]) for values, axis in zip(asked, axes, strict=True)], axis=-1)
    values = brdf.values if "wavelength" in brdf.dims else brdf.values[..., None]
    interpolated = RegularGridInterpolator(axes, values)(points.reshape(-1, 3))
    interpolated = interpolated.reshape(*np.broadcast_shapes(theta_i.shape, theta_o.shape), -1)
    return np.where(above[..., None], interpolated, 0.0)


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The table averaged over wavelength with normalised weights."""
    if "wavelength" not in bsdf.coords:
        return bsdf
    response = xr.DataArray(weight, dims="wavelength")
    fields = {name: field @ response for name, field in bsdf.data_vars.items() if "wavelength" in field.dims}
    return vocabulary.label(bsdf.drop_dims("wavelength").assign(fields), "bsdf")


def _fold(phi: Array, axis: Array) -> Array:
    """Azimuth brought into the range of the table: modulo 360, and by mirror symmetry where the table holds a half circle."""
    turned = (phi - axis[0]) % 360 + axis[0]
    return np.where(turned > axis[-1], 360 - turned, turned) if axis[-1] - axis[0] < 360 else turned

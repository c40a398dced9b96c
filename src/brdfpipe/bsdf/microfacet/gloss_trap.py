"""The gloss trap of a sphere instrument, which excludes the mirrored light from a total reflectance."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf.microfacet.model import Model, total_reflectance_at
from brdfpipe.geometry import Array

SPECULAR_TRAP = 5.0
"""Half angle of the gloss trap of a sphere instrument, unless the spectrum says otherwise [degree]."""


def trap_of(spectrum: xr.Dataset) -> float:
    """Half angle of the gloss trap that excluded the specular [degree]."""
    return float(spectrum.attrs.get("specular_trap", SPECULAR_TRAP))


def trapped_light(model: Model, spectrum: xr.Dataset, theta_m: float) -> Array:
    """Light that the facets mirror into the gloss trap, (wavelength or 1,); 0 if the specular was included.

    A trap absorbs light within a few degrees of the mirror direction; a rough surface mirrors most light to other directions, where
    the instrument collects it with the diffuse light.
    """
    if spectrum.attrs["geometry"] != "sce":
        return np.zeros(1)
    if model.surface is None:
        return total_reflectance_at(model, theta_m)
    theta, phi, weight = hemisphere.around_mirror(theta_m, model.surface.typical_slope, trap_of(spectrum))
    return np.asarray(weight @ model.evaluate(np.full_like(theta, theta_m), np.zeros_like(phi), theta, phi))

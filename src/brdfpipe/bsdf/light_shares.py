"""Shares of the light: the parts of the directional reflectance, and the sum of reflected, transmitted and absorbed light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array


class ReflectanceParts(NamedTuple):
    """Shares of the light [1] against the incidence; None where a representation does not distinguish them."""

    total: Array
    mirrored: Array
    """Reflected into one direction by a perfectly smooth surface."""
    facets: Array | None
    """Scattered by the facets."""
    once: Array | None
    """The part of ``facets`` after one reflection; None where this is all of it."""
    below: Array | None
    """Diffuse, from below the surface."""


def reflectance_parts(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> ReflectanceParts:
    """Directional reflectance at incidences (n,) [degree] and the first wavelength [nm], total and parts.

    All come from one quadrature at the same angles: an interpolated part would cross the total towards grazing.
    """

    def reflectance(part: xr.Dataset) -> Array:
        return representation(part).albedo(theta_i, phi_i, wavelength)[..., 0]

    evaluator = representation(bsdf)
    total, mirrored = reflectance(bsdf), evaluator.specular(theta_i, phi_i, wavelength)[0][..., 0]
    facets, once = evaluator.without_diffuse(), evaluator.single_reflection()
    if facets is None:
        return ReflectanceParts(total, mirrored, None, None, None)
    of_surface = reflectance(facets)
    below = np.maximum(total - of_surface, 0.0)
    return ReflectanceParts(total, mirrored, of_surface - mirrored, None if once is None else reflectance(once), below)


def light_sum(bsdf: xr.Dataset, phi_i: float, wavelength: Array | None) -> float | None:
    """R + T + A at the stored incidence where it is farthest from 1; None for a BSDF that does not state its absorptance.

    ``phi_i`` is in degree; ``wavelength``, (1,) [nm], is one of the dataset.
    """
    if "absorptance" not in bsdf:
        return None
    stated = bsdf["absorptance"].isel(theta_i=bsdf["absorptance"]["theta_i"].values < 90)
    if wavelength is not None and "wavelength" in stated.dims:
        stated = stated.sel(wavelength=wavelength[0])
    theta_i = stated["theta_i"].values.astype(float)
    incidence, evaluator = (theta_i, np.full_like(theta_i, phi_i), wavelength), representation(bsdf)
    total = stated.values + evaluator.albedo(*incidence)[..., 0] + evaluator.transmittance(*incidence)[..., 0]
    return float(total[np.argmax(np.abs(total - 1))])

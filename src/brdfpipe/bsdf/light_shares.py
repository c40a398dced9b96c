"""Shares of the light: parts of the directional reflectance, the rms height they tell, and the sum of reflected, transmitted and absorbed light.

References
----------
Bennett & Porteus 1961, J. Opt. Soc. Am. 51, 123: total integrated scatter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array

_LEAST_MIRRORED = 1e-3
"""Share of the reflection by the surface that must be mirrored to tell the rms height: of a phase variance of 7."""


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


def scattered_rms_height(bsdf: xr.Dataset, theta_i: float = 5.0, wavelength: float = 550.0) -> float:
    """Rms height [um] that the scattered share of the surface's reflection tells: σ = λ √(−ln(1 − TIS)) / (4π cos θ).

    Parameters
    ----------
    bsdf : kind ``bsdf``
    theta_i : incidence, 0 to below 90 degree
    wavelength : [nm]; of a spectral BSDF the nearest one

    Returns
    -------
    float : of the waves that scatter into the hemisphere; 0 for a perfectly smooth surface. NaN where it cannot be recovered: less than
        a thousandth is mirrored, or the BSDF does not tell reflection by the surface from light out of its body
    """
    stored = bsdf["wavelength"].values if "wavelength" in bsdf.coords else np.array([wavelength])
    nearest = float(stored[np.argmin(np.abs(stored - wavelength))])
    one = np.array([nearest]) if "wavelength" in bsdf.coords else None
    parts = reflectance_parts(bsdf, np.array([theta_i]), np.zeros(1), one)
    if parts.facets is None:
        return float("nan")
    mirrored, halo = float(parts.mirrored[0]), max(float(parts.facets[0]), 0.0)
    if not mirrored > _LEAST_MIRRORED * (mirrored + halo):
        return float("nan")
    phase = float(np.log1p(halo / mirrored))
    return float(nearest * 1e-3 * np.sqrt(phase) / (4 * np.pi * np.cos(np.radians(theta_i))))


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

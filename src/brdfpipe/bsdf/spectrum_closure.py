"""The diffuse reflectance below a surface with which the total reflectance is the measured one; for surfaces that tabulate their albedo."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf.coupled_base import OfDirections
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.microfacet.builder import with_clamping_warning, with_diffuse_reflectance
from brdfpipe.bsdf.microfacet.gloss_trap import trap_of
from brdfpipe.geometry import Array

INCIDENCES = np.array([0, 8, 15, 22.5, 30, 37.5, 45, 52.5, 60, 65, 70, 74, 78, 81, 84, 86, 88, 89, 89.6, 90.0])
"""Nodes of the table of the directional albedo [degree], beside the incidence of the spectrum."""

_LARGEST_DIFFUSE = 1 - 2e-8  # below 1 by the error of the table, so that a white base conserves energy


def with_base(
    bsdf: xr.Dataset,
    albedo: Callable[[Array], Array],
    spectrum: xr.Dataset | None,
    trapped: Callable[[float, float], Array],
) -> xr.Dataset:
    """Add the table of the directional albedo, and the diffuse reflectance that closes a spectrum.

    Parameters
    ----------
    bsdf : with ``wavelength`` if the surface's reflection depends on it
    albedo : of the surface alone, (incidences,) degree → (incidences, wavelength or 1)
    spectrum : kind ``spectrum``, as for :func:`brdfpipe.bsdf.microfacet.build`; None for no diffuse part
    trapped : light of an incidence that the surface mirrors into a gloss trap, (incidence, half angle of the trap) in degree → (wavelength or 1,)
    """
    theta_m = 8.0 if spectrum is None else float(spectrum.attrs["theta_i"])
    theta = np.unique(np.append(INCIDENCES, theta_m))
    values = np.clip(albedo(theta), 0.0, 1.0)
    table = AlbedoTable(theta, values)
    spectral = ("wavelength",) if values.shape[1] > 1 else ()
    bsdf = bsdf.assign_coords(theta_i=theta).assign(
        directional_albedo=(("theta_i", *spectral), values if spectral else values[:, 0]),
        mean_albedo=(spectral, table.mean() if spectral else table.mean()[0]),
        diffuse=0.0,
        theta_m=theta_m,
    )
    if spectrum is None:
        return bsdf
    excluded = spectrum.attrs["geometry"] == "sce"
    in_trap = trapped(theta_m, trap_of(spectrum)) if excluded else np.zeros(1)
    total = spectrum["total_reflectance"].values.astype(float) + in_trap
    at_measured = table(np.array([theta_m]))[0]
    diffuse = np.minimum((total - at_measured) / np.maximum(1 - at_measured, 1e-12), _LARGEST_DIFFUSE)
    bsdf = with_diffuse_reflectance(bsdf, diffuse, total)
    return with_clamping_warning(bsdf, spectrum, diffuse < 0, at_measured - total, "reflectance of the surface")


def around_mirror_direction(brdf: OfDirections, theta_i: float, slope: float, half_angle: float = 180.0) -> Array:
    """∫ f cos θ_o dω_o over a cone about the mirror direction of an incidence [degree], or over the hemisphere, (wavelength or 1,)."""
    theta, phi, weight = hemisphere.around_mirror(theta_i, slope, half_angle)
    return np.asarray(weight @ brdf(np.full_like(theta, theta_i), np.zeros_like(phi), theta, phi))

"""How much light the facets of a microfacet dataset send back, and what that leaves to the base below them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance
from brdfpipe.optics.fresnel_equations import mean_fresnel as mean_fresnel_reflectance

_FACET_FIELDS = (
    "directional_albedo",
    "mean_albedo",
    "furnace_albedo",
    "mean_furnace_albedo",
    "compensation",
    "theta_i",
    "phi_i",
)
"""Variables that :func:`with_albedo` adds."""


def with_albedo(bsdf: xr.Dataset, theta_m: float) -> xr.Dataset:
    """Add the directional albedo, its mean, and what is needed to give back the light the facets lose."""
    spectral = bsdf["n"].dims
    n, k = np.atleast_1d(bsdf["n"].values), np.atleast_1d(bsdf["k"].values)
    if "slope_density" not in bsdf:
        return _smooth_albedo(bsdf, n, k, theta_m)
    surface, masking = Microsurface.of(bsdf), str(bsdf.attrs["masking"])
    compensated = bsdf.attrs["multiple_scattering"] == "compensated"

    def both(theta: Array, phi: Array) -> Array:
        # Some sources' masking reflects more than it receives: nothing is left for the base there.
        single = np.minimum(energy.directional_albedo(surface, masking, n, k, theta, phi), 1.0)
        if not compensated:
            return single
        mirrors = energy.directional_albedo(
            surface, masking, np.ones(1), np.zeros(1), theta, phi, energy.perfect_mirror
        )
        return np.concatenate([single, mirrors], axis=1)

    table = energy.tabulated(surface, both, np.array([0.0, theta_m, 90.0]))
    dims = ("theta_i",) if table.phi is None else ("theta_i", "phi_i")
    bsdf = bsdf.assign_coords({"theta_i": table.theta} | ({} if table.phi is None else {"phi_i": table.phi}))
    single = replace(table, values=table.values[..., : n.size])
    if compensated:
        furnace = replace(table, values=table.values[..., n.size :])
        mean_furnace = float(furnace.mean()[0])
        factor = _multiple_reflectance(mean_fresnel_reflectance(n, k), mean_furnace)
        single = replace(table, values=single.values + factor * (1 - furnace.values))
        bsdf = bsdf.assign(
            furnace_albedo=(dims, furnace.values[..., 0]),
            mean_furnace_albedo=mean_furnace,
            compensation=(spectral, factor if spectral else factor[0]),
        )
    else:
        bsdf = bsdf.assign(mean_furnace_albedo=_mean_mirror_albedo(surface, masking))
    values, mean = single.values, single.mean()
    return bsdf.assign(
        directional_albedo=((*dims, *spectral), values if spectral else values[..., 0]),
        mean_albedo=(spectral, mean if spectral else mean[0]),
    )


def _smooth_albedo(bsdf: xr.Dataset, n: Array, k: Array, theta_m: float) -> xr.Dataset:
    spectral = bsdf["n"].dims

    def fresnel(theta: Array) -> Array:
        cos = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
        return fresnel_reflectance(cos[:, None], n, k).mean

    # A mirror of index N bends within 1/|N| of grazing, one of hardly any contrast within √(2 (n − 1)).
    table = energy.refined(fresnel, 0.01, np.array([0.0, theta_m, 90.0]))
    mean = table.mean()
    return bsdf.assign_coords(theta_i=table.theta).assign(
        directional_albedo=(("theta_i", *spectral), table.values if spectral else table.values[:, 0]),
        mean_albedo=(spectral, mean if spectral else mean[0]),
        mean_furnace_albedo=1.0,
    )


def _multiple_reflectance(mean_fresnel: Array, mean_furnace: float) -> Array:
    """F_ms: reflectance of all reflections after the first, each coloured by the average facet."""
    return np.asarray(mean_fresnel**2 * mean_furnace / (1 - mean_fresnel * (1 - mean_furnace)))


def _mean_mirror_albedo(surface: Microsurface, masking: str) -> float:
    """Ē₁ to 1e-5: the share of the light that leaves perfect mirrors at their first reflection."""
    theta, weight = panel_rule(np.linspace(0, np.pi / 2, 3), 6)
    phi = hemisphere.azimuths(surface.isotropic)
    albedos = [
        energy.directional_albedo(
            surface, masking, np.ones(1), np.zeros(1), np.degrees(theta), azimuth, energy.perfect_mirror
        )[:, 0]
        for azimuth in phi
    ]
    return float((weight * np.sin(2 * theta)) @ np.mean(albedos, axis=0))


def total_reflectance_at(model: Model, theta: float) -> Array:
    """Total reflectance at an incidence [degree], (wavelength or 1,); mean over all azimuths where there is a lay."""
    phi = hemisphere.azimuths(model.isotropic)
    return np.asarray(model.directional_albedo(np.full(phi.size, theta), phi).mean(axis=0))


def diffuse_for(model: Model, total: Array, theta_m: float) -> Array:
    """Diffuse reflectance with which a model of ``diffuse`` 0 reflects ``total`` at an incidence; negative where it cannot."""
    left = total - total_reflectance_at(model, theta_m)
    if model.diffuse_mode == "crf":
        return np.asarray(left)
    phi = hemisphere.azimuths(model.isotropic)
    let_in = 1 - model.albedo(np.full(phi.size, theta_m), phi).mean(axis=0)
    # A perfectly white base keeps back what the table of the albedo may err by.
    return np.asarray(np.minimum(left / np.maximum(let_in, 1e-12), 1 - 2e-8))


def with_mean_index(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """A dataset whose index depends on wavelength, averaged with weights of sum 1: one index, and the diffuse reflectance that goes with it."""
    n, k = (np.broadcast_to(bsdf[name].values, weight.shape) for name in ("n", "k"))
    if k.any():
        mean_n, mean_k = weight @ n, weight @ k
    else:
        amplitude = np.sqrt(weight @ ((n - 1) / (n + 1)) ** 2)
        mean_n, mean_k = (1 + amplitude) / (1 - amplitude), 0.0
    reduced = bsdf.drop_dims("wavelength").assign(n=mean_n, k=mean_k)
    theta_m = float(bsdf["theta_m"])
    reduced = with_albedo(reduced.drop_vars(_FACET_FIELDS, errors="ignore"), theta_m).assign(diffuse=0.0)
    if not bsdf["diffuse"].values.any():
        return reduced
    by_wavelength = total_reflectance_at(Model.of(bsdf, None), theta_m)
    total = np.array([weight @ np.broadcast_to(by_wavelength, weight.shape)])
    diffuse = diffuse_for(Model.of(reduced, None), total, theta_m)
    return reduced.assign(diffuse=float(diffuse.clip(0.0)[0]))

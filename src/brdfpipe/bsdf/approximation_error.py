"""Error of an approximate form of a BSDF against the full model, for tables, fits and spectral averages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.nonspectral import nonspectral, normalised_response
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, check_angles
from brdfpipe.hemisphere import Directions

_UNKNOWN_SLOPE = 2e-3
"""Slope of the narrowest lobe that is resolved for a representation without a :attr:`lobe_slope`."""

_NEGLIGIBLE_SHARE = 1e-6
"""Share of the light in a single direction that no form needs."""


class Misfit(NamedTuple):
    """Error of an approximation over the hemisphere, for one incidence [1]."""

    rms: float
    """Flux-weighted rms error over the flux-weighted rms BRDF"""
    largest: float
    """Largest |error| over the BRDF or over that of a Lambertian of the same reflectance, whichever is larger"""
    reflectance: float
    """Relative error of the reflectance, signed"""


def misfit(weight: Array, approximation: Array, model: Array) -> Misfit:
    """Compare two BRDFs at directions of projected solid angles ``weight``."""
    error, flux = approximation - model, float(weight @ model)
    scale = np.maximum(model, flux / weight.sum())
    if not scale.any():
        return Misfit(0.0, 0.0, 0.0) if not error.any() else Misfit(np.inf, np.inf, np.inf)
    rms = np.sqrt(weight @ error**2 / (weight @ model**2))
    return Misfit(float(rms), float(np.max(np.abs(error) / scale)), float(weight @ error) / flux)


def directions(bsdf: xr.Dataset, theta_i: float, phi_i: float = 0.0, order: int = 4, turns: int = 12) -> Directions:
    """Directions over the hemisphere that resolve the lobe of incidence (θ_i, φ_i), with projected solid angles."""
    slope = representation(bsdf).lobe_slope
    rule = hemisphere.around_mirror(theta_i, _UNKNOWN_SLOPE if slope is None else slope, order=order, turns=turns)
    if not representation(bsdf).isotropic:
        # The rule covers one side of the plane of incidence; with a lay the other side differs.
        phi, weight = np.concatenate([rule.phi, -rule.phi]), np.tile(rule.weight / 2, 2)
        rule = Directions(np.tile(rule.theta, 2), phi, weight)
    return rule._replace(phi=rule.phi + phi_i)


def brdf_at(bsdf: xr.Dataset, theta_i: float, phi_i: float, rule: Directions, wavelength: Array | None = None) -> Array:
    """The BRDF of one incidence at directions, (directions, wavelength)."""
    incidence = np.full_like(rule.theta, theta_i), np.full_like(rule.phi, phi_i)
    return np.asarray(representation(bsdf).evaluate(*incidence, rule.theta, rule.phi, wavelength))


def brdf_of_incidences(
    evaluate: Callable[..., Array],
    theta_i: Array,
    phi_i: float,
    rules: Sequence[Directions],
    wavelength: Array | None = None,
) -> list[Array]:
    """The BRDF of each incidence at the directions of its rule, evaluated together, (incidences)(directions, wavelength).

    ``evaluate`` is that of a representation, or of another program.
    """
    if not rules:
        return []
    sizes = [rule.theta.size for rule in rules]
    theta_o, phi_o = (np.concatenate([getattr(rule, name) for rule in rules]) for name in ("theta", "phi"))
    values = evaluate(np.repeat(theta_i, sizes), np.full_like(theta_o, phi_i), theta_o, phi_o, wavelength)
    return np.split(values, np.cumsum(sizes)[:-1])


def lost_specular(bsdf: xr.Dataset, form: str) -> list[str]:
    """A warning if a form of finite values leaves out light that is reflected or transmitted into one single direction."""
    parts = representation(bsdf).specular(np.array([45.0]), np.zeros(1), None)
    share = max(float(part.max()) for part in parts)
    if share <= _NEGLIGIBLE_SHARE:
        return []
    text = f"the {form} does not hold the perfectly specular part of the surface: take it from the BSDF itself"
    # A rough surface has a coherent part too.
    return [text if "optics" in bsdf.attrs else f"{text}, or give the surface a roughness"]


def nonspectral_error(
    bsdf: xr.Dataset, weight: ArrayLike | None = None, theta_i: ArrayLike = (8.0, 30.0, 60.0, 80.0)
) -> xr.Dataset:
    """Error of averaging the optical constants over wavelength, against averaging the full model.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    weight : as for :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.nonspectral`
    theta_i : (incidences,) degree, below 90

    Returns
    -------
    Dataset of kind ``nonspectral``: ``rms``, ``largest`` and ``reflectance_error`` against ``theta_i``, see :class:`Misfit`; all 0 if
    the BSDF does not depend on wavelength
    """
    angles = np.atleast_1d(check_angles("theta_i", theta_i, 0, 89.99))
    response = normalised_response(bsdf, weight)
    reduced = nonspectral(bsdf, weight)
    errors = np.zeros((angles.size, 3))
    if response is not None:
        for row, angle in enumerate(angles):
            rule = directions(bsdf, float(angle))
            full = np.broadcast_to(brdf_at(bsdf, angle, 0.0, rule), (rule.theta.size, response.size)) @ response
            errors[row] = misfit(rule.weight, brdf_at(reduced, angle, 0.0, rule)[:, 0], full)
    texts = {
        "rms": "flux-weighted rms error of the non-spectral form over the flux-weighted rms BRDF",
        "largest": "largest error of the non-spectral form over the BRDF or that of a Lambertian as bright",
        "reflectance_error": "error of the reflectance of the non-spectral form over that of the model",
    }
    fields = {
        name: ("theta_i", values, {"units": "1", "long_name": text})
        for (name, text), values in zip(texts.items(), errors.T, strict=True)
    }
    return vocabulary.label(xr.Dataset(fields, coords={"theta_i": angles}), "nonspectral")

"""Fit Lambert + Gaussian to any BSDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.bsdf.lambert_gauss import FWHM, about_mirror, gaussian
from brdfpipe.geometry import Array, angles_of, check_angles

_RADII = 40
_TURNS = 24


def fit_lambert_gauss(bsdf: xr.Dataset, theta_i: ArrayLike) -> xr.Dataset:
    """Fit Lambert + Gaussian to a BSDF, per incidence, in the sense of reflected flux.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    theta_i : degree, (incidences,), 0 to 85

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``lambert_gauss``: ``lambert``, ``gauss_peak`` G0, the two FWHM,
        ``gauss_reflectance`` (integrated, not the small-angle formula) and ``fit_residual`` per ``theta_i``

    Notes
    -----
    The weights are the projected solid angles of a grid that is fine about the mirror direction and covers the hemisphere.
    """
    vocabulary.validate(bsdf, "bsdf")
    angles = check_angles("theta_i", theta_i, 0, 85)
    reduced = representations.nonspectral(bsdf)
    fits = np.array([_fit_one(reduced, float(angle)) for angle in angles])
    names = (
        "lambert",
        "gauss_peak",
        "gauss_fwhm_parallel",
        "gauss_fwhm_perpendicular",
        "gauss_reflectance",
        "fit_residual",
    )
    result = xr.Dataset(
        {name: ("theta_i", fits[:, column]) for column, name in enumerate(names)},
        coords={"theta_i": angles},
        attrs={"representation": "lambert_gauss", "source_representation": bsdf.attrs["representation"]},
    )
    return vocabulary.label(result, "bsdf")


def _directions(theta_i: float) -> tuple[Array, Array, Array]:
    """Directions about the mirror direction in rings that widen, those above the horizon, with projected solid angles.

    The rings are equal-angle cells of a polar grid about the mirror direction, (radius, turn).
    """
    edges = 0.05 * np.sinh(np.linspace(0, np.arcsinh(180 / 0.05), _RADII + 1))
    radius = np.radians((edges[1:] + edges[:-1]) / 2)
    turn = 2 * np.pi * (np.arange(_TURNS) + 0.5) / _TURNS
    solid_angle = np.repeat(-np.diff(np.cos(np.radians(edges))) * 2 * np.pi / _TURNS, _TURNS)
    radius, turn = (grid.ravel() for grid in np.meshgrid(radius, turn, indexing="ij"))
    mirror = np.radians(theta_i)
    forward, side, out = np.sin(radius) * np.cos(turn), np.sin(radius) * np.sin(turn), np.cos(radius)
    x = -(out * np.sin(mirror) + forward * np.cos(mirror))
    z = out * np.cos(mirror) - forward * np.sin(mirror)
    theta, phi = angles_of(np.stack([x, side, z], axis=-1))
    above = theta < 90
    return theta[above], phi[above], (solid_angle * z)[above]


def _fit_one(bsdf: xr.Dataset, theta_i: float) -> tuple[float, ...]:
    from scipy.optimize import least_squares

    theta_o, phi_o, weight = _directions(theta_i)
    module = representations.representation(bsdf)
    incidence = np.full_like(theta_o, theta_i)
    brdf = module.evaluate(bsdf, incidence, np.zeros_like(phi_o), theta_o, phi_o, None)[..., 0]
    along, across = about_mirror(theta_i, theta_o, phi_o)
    root = np.sqrt(weight / (weight @ brdf**2)) if brdf.any() else np.sqrt(weight)
    start = _starting_point(root, brdf, along, across)
    if start is None:
        return float(np.pi * (weight @ brdf) / weight.sum()), 0.0, 0.0, 0.0, 0.0, 0.0

    def model(parameters: Array) -> Array:
        floor, peak, parallel, perpendicular = np.exp(parameters)
        return floor + gaussian(along, across, peak, parallel, perpendicular)

    def misfit(parameters: Array) -> Array:
        return root * (model(parameters) - brdf)

    found = least_squares(misfit, np.log(start), method="trf", x_scale="jac")
    floor, peak, parallel, perpendicular = np.exp(found.x)
    residual = float(np.sqrt(np.sum(found.fun**2)))
    reflected = weight @ gaussian(along, across, peak, parallel, perpendicular)
    return float(np.pi * floor), float(peak), FWHM * parallel, FWHM * perpendicular, float(reflected), residual


def _starting_point(root: Array, brdf: Array, along: Array, across: Array) -> Array | None:
    """Floor, peak and a common width: the best of a ladder of widths, at each of which floor and peak are linear.

    None where no width gains anything over a constant: there is no lobe to fit.
    """
    best, least = None, float(np.sum((root * (brdf - root**2 @ brdf / np.sum(root**2))) ** 2)) * (1 - 1e-9)
    if least < 1e-20:
        return None
    for width in np.geomspace(0.05, 40, 28):
        design = root[:, None] * np.stack([np.ones_like(along), gaussian(along, across, 1.0, width, width)], axis=1)
        (floor, peak), *_ = np.linalg.lstsq(design, root * brdf, rcond=None)
        remainder = float(np.sum((design @ [floor, peak] - root * brdf) ** 2))
        if peak > 0 and remainder < least:
            best, least = np.array([max(floor, 1e-6 * peak), peak, width, width]), remainder
    return best

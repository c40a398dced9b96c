"""Fit Lambert + Gaussian to any BSDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.bsdf.lambert_gauss import FWHM, about_mirror, gaussian
from brdfpipe.geometry import Array, check_angles

_WIDEST = 90.0
"""Full width beyond which a lobe is no lobe: it is left to the Lambertian part [degree]."""


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
    The weights are the projected solid angles of a rule over the hemisphere that resolves the lobe. A lobe wider than 90° at half
    maximum is left to the Lambertian part.
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


def _fit_one(bsdf: xr.Dataset, theta_i: float) -> tuple[float, ...]:
    from scipy.optimize import least_squares

    slope = representations.lobe_slope(bsdf)
    theta_o, phi_o, weight = hemisphere.around_mirror(theta_i, 0.01 if slope is None else slope, order=4, turns=12)
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

    lowest = np.log([1e-9 * start[1], 1e-9 * start[1], 1e-3, 1e-3])
    highest = np.log([1e3 * start[1], 1e3 * start[1], _WIDEST / FWHM, _WIDEST / FWHM])
    found = least_squares(misfit, np.clip(np.log(start), lowest, highest), bounds=(lowest, highest), x_scale="jac")
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
    for width in np.geomspace(0.01, 0.9 * _WIDEST / FWHM, 28):
        design = root[:, None] * np.stack([np.ones_like(along), gaussian(along, across, 1.0, width, width)], axis=1)
        (floor, peak), *_ = np.linalg.lstsq(design, root * brdf, rcond=None)
        remainder = float(np.sum((design @ [floor, peak] - root * brdf) ** 2))
        if peak > 0 and remainder < least:
            best, least = np.array([max(floor, 1e-6 * peak), peak, width, width]), remainder
    return best

"""Fit Lambert + Gaussian to any BSDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import approximation_error as comparison
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.lambert_gauss import FWHM, LambertGauss, about_mirror, gaussian
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles

_WIDEST = 90.0
"""Full width beyond which a lobe is no lobe: it is left to the Lambertian part [degree]."""


def fit_lambert_gauss(bsdf: xr.Dataset, theta_i: ArrayLike, azimuth: float = 0.0) -> xr.Dataset:
    """Fit Lambert + Gaussian to a BSDF, per incidence, in the sense of reflected flux.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    theta_i : degree, one or (incidences,), 0 to 85
    azimuth : of the incidences [degree]; it matters to a surface with a lay

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``lambert_gauss``: ``lambert``, ``gauss_peak`` G0, the two FWHM,
        ``gauss_reflectance`` R_gauss (integrated, not the small-angle formula) per ``theta_i``; and the error against the full model:
        ``fit_residual``, ``fit_error_max`` and ``reflectance_error``, see :class:`brdfpipe.bsdf.approximation_error.Misfit`. Of a surface with
        a lay the fit holds for light from the one azimuth, with a warning

    Raises
    ------
    VocabularyError : theta_i is no list of angles, or out of range.

    Notes
    -----
    The weights are the projected solid angles of a rule over the hemisphere that resolves the lobe. A lobe wider than 90° at half
    maximum is left to the Lambertian part.
    """
    vocabulary.validate(bsdf, "bsdf")
    angles = np.atleast_1d(check_angles("theta_i", theta_i, 0, 85))
    if angles.ndim != 1:
        raise VocabularyError(f"theta_i of a fit must be one angle or a list of them; found shape {angles.shape}")
    reduced = nonspectral(bsdf)
    fits = np.array([_fit_one(reduced, float(angle), azimuth) for angle in angles])
    names = (
        "lambert",
        "gauss_peak",
        "gauss_fwhm_parallel",
        "gauss_fwhm_perpendicular",
        "gauss_reflectance",
        "fit_residual",
        "fit_error_max",
        "reflectance_error",
    )
    result = xr.Dataset(
        {name: ("theta_i", fits[:, column]) for column, name in enumerate(names)},
        coords={"theta_i": angles},
        attrs={"representation": LambertGauss.name, "source_representation": representation(bsdf).name},
    )
    return vocabulary.label(vocabulary.add_warning(result, *_left_out(bsdf, azimuth)), "bsdf")


def _left_out(bsdf: xr.Dataset, azimuth: float) -> list[str]:
    """What the model has and the fit has not."""
    warnings = []
    if not representation(bsdf).isotropic:
        warnings.append(
            f"the surface has a lay, and the Lambert + Gaussian fit holds for light from azimuth {azimuth:.1f}° alone: use the BSDF itself "
            "for others"
        )
    if any(part.any() for part in representation(bsdf).specular(np.array([45.0]), np.zeros(1), None)):
        warnings.append(
            "the perfectly specular part of the surface is in no Gaussian: take it from the BSDF itself, or give the surface a roughness"
        )
    return warnings


def _fit_one(bsdf: xr.Dataset, theta_i: float, azimuth: float) -> tuple[float, ...]:
    from scipy.optimize import least_squares

    rule = comparison.directions(bsdf, theta_i, azimuth)
    theta_o, phi_o, weight = rule
    brdf = comparison.brdf_at(bsdf, theta_i, azimuth, rule)[..., 0]
    along, across = about_mirror(theta_i, theta_o, phi_o - azimuth)
    root = np.sqrt(weight / (weight @ brdf**2)) if brdf.any() else np.sqrt(weight)
    start = _starting_point(root, brdf, along, across)
    if start is None:
        floor = float(weight @ brdf / weight.sum())
        error = comparison.misfit(weight, np.full_like(brdf, floor), brdf)
        return np.pi * floor, 0.0, 0.0, 0.0, 0.0, *error[:2], _against(bsdf, theta_i, azimuth, np.pi * floor)

    def model(parameters: Array) -> Array:
        floor, peak, parallel, perpendicular = np.exp(parameters)
        return floor + gaussian(along, across, peak, parallel, perpendicular)

    def misfit(parameters: Array) -> Array:
        return root * (model(parameters) - brdf)

    lowest = np.log([1e-9 * start[1], 1e-9 * start[1], 1e-3, 1e-3])
    highest = np.log([1e3 * start[1], 1e3 * start[1], _WIDEST / FWHM, _WIDEST / FWHM])
    found = least_squares(misfit, np.clip(np.log(start), lowest, highest), bounds=(lowest, highest), x_scale="jac")
    floor, peak, parallel, perpendicular = np.exp(found.x)
    error = comparison.misfit(weight, model(found.x), brdf)
    reflected = weight @ gaussian(along, across, peak, parallel, perpendicular)
    missed = _against(bsdf, theta_i, azimuth, np.pi * floor + float(reflected))
    return (
        float(np.pi * floor),
        float(peak),
        FWHM * parallel,
        FWHM * perpendicular,
        float(reflected),
        *error[:2],
        missed,
    )


def _against(bsdf: xr.Dataset, theta_i: float, azimuth: float, reflectance: float) -> float:
    """Error of a reflectance over that of the model, mirror reflection included."""
    told = float(representation(bsdf).albedo(np.array([theta_i]), np.array([azimuth]), None)[0, 0])
    return reflectance / told - 1 if told > 0 else 0.0


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

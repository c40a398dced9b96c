"""Fit of the Lambert + Gaussian form to a BSDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from brdfpipe import vocabulary
from brdfpipe.bsdf import approximation_error
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.lambert_gauss import FIT_RESULTS, FWHM, LambertGauss, about_mirror, gaussian
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, check_angles
from brdfpipe.hemisphere import Directions

_WIDEST = 90.0
"""Largest full width at half maximum of a lobe [degree]; wider ones belong to the Lambertian part."""


def fit_lambert_gauss(bsdf: xr.Dataset, theta_i: ArrayLike, azimuth: float = 0.0) -> xr.Dataset:
    """Fit Lambert + Gaussian to a BSDF at each incidence, by least squares weighted by reflected flux.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 if it depends on wavelength
    theta_i : degree, one or (incidences,), 0 to 85
    azimuth : of the incidences [degree], for a surface with a lay

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``lambert_gauss``: ``lambert``, ``gauss_peak`` G0, the two FWHM,
        ``gauss_reflectance`` R_gauss (integrated, not the small-angle formula) per ``theta_i``; and the error against the full model:
        ``fit_residual``, ``fit_error_max`` and ``reflectance_error``, see :class:`brdfpipe.bsdf.approximation_error.Misfit`. The fit of a
        surface with a lay is valid for the one azimuth, with a warning

    Raises
    ------
    VocabularyError : theta_i is not one angle or a list, or is out of range.

    Notes
    -----
    The weights are the projected solid angles of a quadrature of the hemisphere that resolves the lobe. A lobe wider than 90° at half
    maximum becomes part of the Lambertian part.
    """
    vocabulary.validate(bsdf, "bsdf")
    angles = np.atleast_1d(check_angles("theta_i", theta_i, 0, 85))
    if angles.ndim != 1:
        raise VocabularyError(f"theta_i of a fit has shape {angles.shape}; accepted: one angle or a list of angles")
    reduced = nonspectral(bsdf)
    rules = [approximation_error.directions(reduced, float(angle), azimuth) for angle in angles]
    each = approximation_error.brdf_of_incidences(representation(reduced).evaluate, angles, azimuth, rules)
    albedos = representation(reduced).albedo(angles, np.full(angles.size, azimuth), None)[:, 0]
    fits = np.array(
        [
            _fit_one(brdf[:, 0], rule, float(angle), azimuth, float(albedo))
            for brdf, rule, angle, albedo in zip(each, rules, angles, albedos, strict=True)
        ]
    )
    result = xr.Dataset(
        {
            name: ("theta_i", values)
            for name, values in zip((*LambertGauss.kind.required, *FIT_RESULTS), fits.T, strict=True)
        },
        coords={"theta_i": angles},
        attrs={"representation": LambertGauss.name, "source_representation": representation(bsdf).name},
    )
    if not representation(bsdf).isotropic:
        result.attrs["light_azimuth"] = float(azimuth)
        result = vocabulary.add_warning(
            result,
            f"the surface has a lay, and the Lambert + Gaussian fit is valid for light from azimuth {azimuth:.1f}° alone: use the BSDF "
            "itself for others",
        )
    texts = approximation_error.lost_specular(bsdf, "Lambert + Gaussian form")
    return vocabulary.label(vocabulary.add_warning(result, *texts), "bsdf")


def _fit_one(brdf: Array, rule: Directions, theta_i: float, azimuth: float, albedo: float) -> tuple[float, ...]:
    """The parameters of one incidence, from the BRDF at directions; ``albedo`` is the directional reflectance of the model."""
    theta_o, phi_o, weight = rule
    along, across = about_mirror(theta_i, theta_o, phi_o - azimuth)
    root = np.sqrt(weight / (weight @ brdf**2)) if brdf.any() else np.sqrt(weight)
    start = _starting_point(root, brdf, along, across)
    if start is None:
        floor = float(weight @ brdf / weight.sum())
        error = approximation_error.misfit(weight, np.full_like(brdf, floor), brdf)
        return np.pi * floor, 0.0, 0.0, 0.0, 0.0, *error[:2], _reflectance_error(albedo, np.pi * floor)

    def model(parameters: Array) -> Array:
        floor, peak, parallel, perpendicular = np.exp(parameters)
        return floor + gaussian(along, across, peak, parallel, perpendicular)

    lowest = np.log([1e-9 * start[1], 1e-9 * start[1], 1e-3, 1e-3])
    highest = np.log([1e3 * start[1], 1e3 * start[1], _WIDEST / FWHM, _WIDEST / FWHM])

    def residuals(parameters: Array) -> Array:
        return root * (model(parameters) - brdf)

    start = np.clip(np.log(start), lowest, highest)
    fitted = least_squares(residuals, start, bounds=(lowest, highest), x_scale="jac").x
    floor, peak, parallel, perpendicular = map(float, np.exp(fitted))
    error = approximation_error.misfit(weight, model(fitted), brdf)
    reflected = float(weight @ gaussian(along, across, peak, parallel, perpendicular))
    lambert = float(np.pi * floor)
    missing = _reflectance_error(albedo, lambert + reflected)
    return lambert, peak, FWHM * parallel, FWHM * perpendicular, reflected, *error[:2], missing


def _reflectance_error(albedo: float, reflectance: float) -> float:
    """Relative error of a reflectance against the model's, mirror reflection included."""
    return reflectance / albedo - 1 if albedo > 0 else 0.0


def _starting_point(root: Array, brdf: Array, along: Array, across: Array) -> Array | None:
    """Floor, peak and a common width: the best of a series of widths, with floor and peak by linear least squares.

    None if no width is better than a constant, so that there is no lobe to fit.
    """
    best, least = None, float(np.sum((root * (brdf - root**2 @ brdf / np.sum(root**2))) ** 2)) * (1 - 1e-9)
    if least < 1e-20:
        return None
    for width in np.geomspace(0.01, 0.9 * _WIDEST / FWHM, 28):
        design = root[:, None] * np.stack([np.ones_like(along), gaussian(along, across, 1.0, width, width)], axis=1)
        (floor, peak), *_ = np.linalg.lstsq(design, root * brdf, rcond=None)
        squares = float(np.sum((design @ [floor, peak] - root * brdf) ** 2))
        if peak > 0 and squares < least:
            best, least = np.array([max(floor, 1e-6 * peak), peak, width, width]), squares
    return best

"""A BSDF as the figures see it: at one wavelength, in the planes that matter, part by part.

All goes through the functions that every representation offers: nothing here knows how a material came in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.bsdf.registry import representation
from brdfpipe.report.plots.svg import Array

REFERENCE_WAVELENGTH = 550.0
"""Wavelength shown where one must stand for all, nm: near the peak of the eye's response."""

DARKEST = 1e-12
"""BSDF below which there is no light, but the rounding of some interpolation; sr-1."""

_WIDEST_STEP = 0.02
"""Distance from a peak at which a cut of unknown lobe is sampled first, degree."""


class Plane(NamedTuple):
    """A plane of incidence: light comes from the azimuth opposite to its own."""

    azimuth: float
    words: str
    """``along the lay``, ``across the lay``; empty where all azimuths are alike"""

    def outgoing(self, turn: ArrayLike) -> Array:
        """Azimuths that lie ``turn`` degree from the one away from the source."""
        return self.azimuth + np.asarray(turn, dtype=float)


def planes(bsdf: xr.Dataset) -> list[Plane]:
    """The plane of incidence, or with a lay the one along it and the one across it."""
    if representation(bsdf).isotropic:
        return [Plane(0.0, "")]
    if "lay" not in bsdf or not np.isfinite(bsdf["lay"]):
        return [Plane(0.0, "towards azimuth 0°"), Plane(90.0, "towards azimuth 90°")]
    lay = float(bsdf["lay"])
    return [Plane(lay, "along the lay"), Plane(lay + 90, "across the lay")]


def directions(
    plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """θ_i, φ_i, θ_o and φ_o [degree] of one shape; arguments as of :func:`value`."""
    angles = np.broadcast_arrays(incidence, plane.azimuth + 180, theta_o, plane.outgoing(turn))
    theta_i, phi_i, theta_o, phi_o = (np.array(angle, dtype=float) for angle in angles)
    return theta_i, phi_i, theta_o, phi_o


def value(bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike) -> Array:
    """BRDF or BTDF [sr-1] at the reference wavelength; 0 where it is below :data:`DARKEST`.

    Parameters
    ----------
    incidence : degree, in the plane
    theta_o, turn : polar angle, and azimuth from the one away from the source; degree, broadcastable
    """
    angles = directions(plane, incidence, theta_o, turn)
    values = representation(bsdf).evaluate(*angles, reference(bsdf))[..., 0].astype(float)
    return np.where(np.abs(values) < DARKEST, 0.0, values)


def cut(bsdf: xr.Dataset, plane: Plane, incidence: float, *, through: bool = False) -> tuple[Array, Array]:
    """The BSDF in a plane of incidence.

    Parameters
    ----------
    incidence : degree
    through : of the light that passes, instead of the light that is reflected

    Returns
    -------
    Angles from the normal (the one below the surface where the light passes) in degree, negative on the side of the source, and
    values [sr-1]; crowded about the directions in which a smooth surface would send the light
    """
    slope = representation(bsdf).lobe_slope
    first = _WIDEST_STEP if slope is None else float(np.clip(np.degrees(slope) / 4, 1e-4, _WIDEST_STEP))
    offsets = np.geomspace(first, 20, 44)
    peaks = smooth_angles(bsdf, incidence) if through else np.array([incidence])
    near = np.concatenate([np.r_[peak, peak - offsets, peak + offsets] for peak in peaks])
    theta = np.unique(np.r_[np.linspace(-89, 89, 179), near].round(6))
    theta = theta[np.abs(theta) <= 89]
    return theta, value(bsdf, plane, incidence, *in_plane(theta, through=through))


def in_plane(theta: Array, *, through: bool = False) -> tuple[Array, Array]:
    """θ_o, and azimuth from the one away from the source, of the angles of a :func:`cut`."""
    return np.where(through, 180 - np.abs(theta), np.abs(theta)), np.where(theta >= 0, 0.0, 180.0)


def smooth_angles(bsdf: xr.Dataset, incidence: float) -> Array:
    """Angles from the lower normal [degree] at which light from above would pass a smooth surface: refracted, and straight on."""
    refracted = 180 - float(representation(bsdf).refracted(np.array(incidence), reference(bsdf)))
    return np.unique(np.array([refracted, incidence]).round(6))


def reflectance(bsdf: xr.Dataset, plane: Plane, incidence: Array) -> Array:
    """Share of the light that is reflected [1], at the reference wavelength."""
    phi = np.full_like(incidence, plane.azimuth + 180)
    return np.asarray(representation(bsdf).albedo(incidence, phi, reference(bsdf)), dtype=float)[..., 0]


def transmittance(bsdf: xr.Dataset, plane: Plane, incidence: Array) -> Array:
    """Share of the light that passes [1], at the reference wavelength."""
    phi = np.full_like(incidence, plane.azimuth + 180)
    return np.asarray(representation(bsdf).transmittance(incidence, phi, reference(bsdf)), dtype=float)[..., 0]


def specular(bsdf: xr.Dataset, incidence: Array) -> tuple[Array, Array]:
    """Shares of the light that perfectly smooth surfaces send into one direction: reflected, and passed [1]."""
    shares = representation(bsdf).specular(incidence, np.zeros_like(incidence), reference(bsdf))
    mirrored, straight = (np.asarray(share, dtype=float)[..., 0] for share in shares)
    return mirrored, straight


def reference(dataset: xr.Dataset) -> Array | None:
    """The dataset's own wavelength nearest to the reference, (1,); None where it has none."""
    if "wavelength" not in dataset.coords or dataset["wavelength"].ndim != 1:
        return None
    own = dataset["wavelength"].values.astype(float)
    return own[[int(np.argmin(np.abs(own - REFERENCE_WAVELENGTH)))]]


def at_reference(values: xr.DataArray) -> xr.DataArray:
    if "wavelength" not in values.dims:
        return values
    return values.sel(wavelength=REFERENCE_WAVELENGTH, method="nearest")


def wavelength_words(dataset: xr.Dataset) -> str:
    wavelength = reference(dataset)
    return "all wavelengths alike" if wavelength is None else f"at {wavelength[0]:g} nm"

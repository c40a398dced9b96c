"""Values of a BSDF for the figures: at one wavelength, in the plane of incidence or the planes along and across the lay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.bsdf.registry import representation
from brdfpipe.report.plots.svg import Array

REFERENCE_WAVELENGTH = 550.0
"""Wavelength of figures that show a single one [nm]: near the peak of the eye's response."""

DARKEST = 1e-12
"""BSDF below which there is no light, only rounding of an interpolation [sr-1]."""

_SURFACE_WORDS = {
    "smooth": "mirrored by the smooth surface",
    "traced": "reflected by the facets, rays traced over the map",
    "kirchhoff": "reflected by the relief, with diffraction",
}
"""Representation → how its surface sends light back."""

_WIDEST_STEP = 0.02
"""First distance from a peak at which a cut is sampled, for a lobe of unknown width [degree]."""


class Plane(NamedTuple):
    """A plane of incidence: light comes from the azimuth opposite to its own."""

    azimuth: float
    words: str
    """``along the lay``, ``across the lay``; empty for an isotropic BSDF"""

    def title(self, text: str) -> str:
        return f"{text} {self.words}".strip()


def surface_words(bsdf: xr.Dataset | None) -> str:
    """How the surface sends light back, in the terms of the model: ``mirrored by the facets``, ``diffracted by the relief`` and the like."""
    if bsdf is not None and "optics" in bsdf.attrs:
        return "reflected by the relief, as waves and as facets"
    name = "" if bsdf is None else str(bsdf.attrs.get("representation", ""))
    return _SURFACE_WORDS.get(name, "mirrored by the facets")


def planes(bsdf: xr.Dataset) -> list[Plane]:
    """The plane of incidence, or with a lay the one along it and the one across it."""
    evaluator = representation(bsdf)
    if evaluator.isotropic:
        return [Plane(0.0, "")]
    if (lay := evaluator.lay) is None:
        return [Plane(0.0, "towards azimuth 0°"), Plane(90.0, "towards azimuth 90°")]
    return [Plane(lay, "along the lay"), Plane(lay + 90, "across the lay")]


def directions(
    plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """θ_i, φ_i, θ_o and φ_o [degree] of one shape; arguments as of :func:`value`."""
    angles = np.broadcast_arrays(incidence, plane.azimuth + 180, theta_o, plane.azimuth + np.asarray(turn, dtype=float))
    theta_i, phi_i, theta_o, phi_o = (np.array(angle, dtype=float) for angle in angles)
    return theta_i, phi_i, theta_o, phi_o


def value(bsdf: xr.Dataset, plane: Plane, incidence: ArrayLike, theta_o: ArrayLike, turn: ArrayLike) -> Array:
    """BRDF or BTDF [sr-1] at the reference wavelength; 0 where it is below :data:`DARKEST`.

    ``theta_o`` and ``turn`` are the polar angle, and the azimuth from the one away from the source [degree], broadcastable.
    """
    angles = directions(plane, incidence, theta_o, turn)
    values = representation(bsdf).evaluate(*angles, reference(bsdf))[..., 0].astype(float)
    return np.where(np.abs(values) < DARKEST, 0.0, values)


def cut(bsdf: xr.Dataset, plane: Plane, incidence: float, *, through: bool = False) -> tuple[Array, Array]:
    """The BRDF in a plane of incidence; the BTDF with ``through``.

    Returns
    -------
    Angles from the upper (``through``: lower) normal [degree], negative on the side of the source, and values [sr-1]; dense near the
    directions into which a smooth surface would reflect or transmit the light
    """
    theta = cut_angles(bsdf, incidence, through=through)
    return theta, value(bsdf, plane, incidence, *in_plane(theta, through=through))


def cut_angles(bsdf: xr.Dataset, incidence: float, *, through: bool = False) -> Array:
    """The angles of a :func:`cut`."""
    slope = representation(bsdf).lobe_slope
    first = _WIDEST_STEP if slope is None else float(np.clip(np.degrees(slope) / 4, 1e-4, _WIDEST_STEP))
    offsets = np.geomspace(first, 20, 44)
    peaks = smooth_angles(bsdf, incidence) if through else np.array([incidence])
    near = np.concatenate([np.r_[peak, peak - offsets, peak + offsets] for peak in peaks])
    theta = np.unique(np.r_[np.linspace(-89, 89, 179), near].round(6))
    return theta[np.abs(theta) <= 89]


def in_plane(theta: Array, *, through: bool = False) -> tuple[Array, Array]:
    """θ_o, and azimuth from the one away from the source, of the angles of a :func:`cut`."""
    return np.where(through, 180 - np.abs(theta), np.abs(theta)), np.where(theta >= 0, 0.0, 180.0)


def smooth_angles(bsdf: xr.Dataset, incidence: float) -> Array:
    """Angles from the lower normal [degree] of light that a smooth surface would transmit: refracted, and straight."""
    refracted = 180 - float(representation(bsdf).refracted(np.array(incidence), reference(bsdf)))
    return np.unique(np.array([refracted, incidence]).round(6))


def reflectance(bsdf: xr.Dataset, plane: Plane, incidence: Array) -> Array:
    """Share of the light that is reflected [1], at the reference wavelength."""
    phi = np.full_like(incidence, plane.azimuth + 180)
    return representation(bsdf).albedo(incidence, phi, reference(bsdf))[..., 0]


def transmittance(bsdf: xr.Dataset, plane: Plane, incidence: Array) -> Array:
    """Share of the light that is transmitted [1], at the reference wavelength."""
    phi = np.full_like(incidence, plane.azimuth + 180)
    return representation(bsdf).transmittance(incidence, phi, reference(bsdf))[..., 0]


def specular(bsdf: xr.Dataset, incidence: Array) -> tuple[Array, Array]:
    """Shares of the light [1] that are reflected, and transmitted, into one direction, as by a perfectly smooth surface."""
    mirrored, straight = representation(bsdf).specular(incidence, np.zeros_like(incidence), reference(bsdf))
    return mirrored[..., 0], straight[..., 0]


def reference(dataset: xr.Dataset) -> Array | None:
    """The dataset's own wavelength nearest to the reference, (1,); None where it has none."""
    if "wavelength" not in dataset.coords or dataset["wavelength"].ndim != 1:
        return None
    wavelength = dataset["wavelength"].values.astype(float)
    return wavelength[[int(np.argmin(np.abs(wavelength - REFERENCE_WAVELENGTH)))]]


def at_reference(values: xr.DataArray) -> xr.DataArray:
    return values.sel(wavelength=REFERENCE_WAVELENGTH, method="nearest") if "wavelength" in values.dims else values


def wavelength_words(dataset: xr.Dataset) -> str:
    wavelength = reference(dataset)
    return "all wavelengths alike" if wavelength is None else f"at {wavelength[0]:g} nm"

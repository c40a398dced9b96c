"""Where the reference solutions on a height map hold, and the BSDF of the one that does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import kirchhoff, traced
from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh

GEOMETRIC = 20.0
"""Variance of the phase from which rays are valid: waves then are within 10 % of facets."""
COHERENT = 1.0
"""Variance of the phase up to which most light is coherent, and no facet masks another."""
UNMASKED = 3.0
"""Cotangent of the incidence, in typical slopes, from which masking is negligible: Λ of a Gaussian surface is below 4e-4."""
WAVELENGTH = 555.0
"""Of the phase [nm]."""

_DECISIVE = 60.0  # incidence at which rays must hold to be preferred


class Holds(NamedTuple):
    """Whether each reference solution holds, of the shape of the incidences."""

    traced: NDArray[np.bool_]
    kirchhoff: NDArray[np.bool_]


def phase_variance(surface: xr.Dataset, theta_i: Array) -> Array:
    """g = (4πσ cos θ_i/λ)² at 555 nm of the heights of a ``surface``, at incidences [degree]."""
    sigma = float(np.nanstd(surface["height"].values))
    return np.asarray((4 * np.pi * sigma * np.cos(np.radians(theta_i)) / (WAVELENGTH * 1e-3)) ** 2)


def holds(variance: Array, slope: float, theta_i: Array) -> Holds:
    """Where the reference solutions hold.

    Parameters
    ----------
    variance : of the phase, at incidences ``theta_i`` [degree]
    slope : typical slope of the map along one axis

    Notes
    -----
    Rays need a variance of 20. Diffraction needs low slopes (:data:`brdfpipe.bsdf.kirchhoff.SLOPE_LIMIT`), and either negligible masking or
    mostly coherent light.
    """
    cosine, sine = np.cos(np.radians(theta_i)), np.sin(np.radians(theta_i))
    low_slopes = np.sqrt(2) * slope <= kirchhoff.SLOPE_LIMIT
    unmasked = low_slopes & (cosine >= UNMASKED * min(slope, 1.0) * sine)
    return Holds(variance >= GEOMETRIC, low_slopes & (unmasked | (variance <= COHERENT)))


def build(
    surface: xr.Dataset, *, index: xr.Dataset | float | str, spectrum: xr.Dataset | None = None, rays: int = 10**6
) -> xr.Dataset:
    """BSDF of a height map by the reference solution that holds on it.

    Parameters
    ----------
    surface : kind ``surface``, a levelled map
    index, spectrum : as for :func:`brdfpipe.bsdf.microfacet.build`
    rays : see :func:`brdfpipe.bsdf.traced.build`

    Returns
    -------
    Dataset of kind ``bsdf``: ``traced`` where the phase variance is at least 20 at 60°; else ``kirchhoff`` if slopes are low and the pitch is fine enough;
    else ``traced``, with a warning, if it is at least 20 at normal incidence

    Raises
    ------
    HeightMapError : no reference holds on the map, or the one that does refuses it.
    VocabularyError : a dataset of the wrong kind.
    """
    vocabulary.validate(surface, "surface")
    mesh = HeightMesh.of(surface)
    theta_i = np.array([0.0, _DECISIVE])
    variance = phase_variance(surface, theta_i)
    held = holds(variance, mesh.typical_slope, theta_i)
    if not held.traced[1] and held.kirchhoff[0]:
        try:
            bsdf = kirchhoff.build(surface, index=index, spectrum=spectrum)
        except HeightMapError:
            if not held.traced[0]:
                raise
        else:
            return vocabulary.add_history(
                bsdf, f"diffraction on the map: the phase variance is {variance[0]:.3g} at 0°"
            )
    if held.traced[0]:
        bsdf = traced.build(surface, index=index, spectrum=spectrum, rays=rays)
        bsdf = vocabulary.add_history(bsdf, f"rays traced over the map: the phase variance is {variance[0]:.3g} at 0°")
        last = np.degrees(np.arccos(np.sqrt(GEOMETRIC / variance[0])))
        return bsdf if held.traced[1] else vocabulary.add_warning(bsdf, _limited(float(last)))
    raise HeightMapError(
        f"no reference solution holds on this map: its phase variance is {variance[0]:.3g}, and rays need {GEOMETRIC:g} or more; its slope is "
        f"{np.sqrt(2) * mesh.typical_slope:.2g}, and diffraction needs {kirchhoff.SLOPE_LIMIT:g} or less. Set `model.truth: check`, with "
        "`model.optics: auto`"
    )


def _limited(last: float) -> str:
    return (
        f"rays hold up to {last:.0f}° of incidence on this map: beyond, its heights are too low against the wavelength, and its slopes are too "
        "steep, or its pitch too coarse, for diffraction; set `model.optics: auto` with `model.truth: check` for grazing light"
    )

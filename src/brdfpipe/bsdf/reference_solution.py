"""Where the reference solutions on a height map hold, and the BSDF of the one that does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import kirchhoff, traced
from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh

GEOMETRIC = 20.0
"""Variance of the phase from which rays are valid: waves then are within 10 % of facets."""
COHERENT = 1.0
"""Variance of the phase up to which most light is coherent, and no facet masks another."""
SMOOTH_FACETS = 0.95
"""Share of the mean square height difference over the width of coherence, of that which the slopes give, from which rays are valid: at
1 − δ, waves are 2δ brighter at the peak. Of Gaussian heights it is 1 − 1/(2g)."""
UNMASKED = 3.0
"""Cotangent of the incidence, in typical slopes, from which masking is negligible: Λ of a Gaussian surface is below 4e-4."""
WAVELENGTH = 555.0
"""Of the phase [nm]."""

_LAGS, _COMPARED = 24, 2**17
"""Distances at which heights are compared, up to a quarter of a map, and about how many heights."""
_DECISIVE = 60.0  # incidence at which rays must hold to be preferred


class Holds(NamedTuple):
    """Whether each reference solution holds, of the shape of the incidences."""

    traced: NDArray[np.bool_]
    kirchhoff: NDArray[np.bool_]


def phase_variance(surface: xr.Dataset, theta_i: Array) -> Array:
    """g = (4πσ cos θ_i/λ)² at 555 nm of the heights of a ``surface``, at incidences [degree]."""
    sigma = float(np.nanstd(surface["height"].values))
    return np.asarray((4 * np.pi * sigma * np.cos(np.radians(theta_i)) / (WAVELENGTH * 1e-3)) ** 2)


def facet_smoothness(surface: xr.Dataset, theta_i: Array) -> Array:
    """How smooth the facets of a map are to light of 555 nm, at incidences [degree]: ⟨(h(x + r) − h(x))²⟩ over ⟨slope²⟩ r² [1].

    r is the width of coherence, over which the difference of two heights gives a phase variance of 2; at most 1. Rays take facets as plane,
    so that the ratio is 1. Roughness that is fine against r, and too low to be facets of its own, has slopes but no height differences. Along
    the axis of the map with the smaller ratio; 1 where coherence is as narrow as the pitch.
    """
    height = surface["height"].values
    target = 2 / (4 * np.pi * np.cos(np.radians(theta_i)) / (WAVELENGTH * 1e-3)) ** 2
    smoothness = np.ones_like(target)
    for axis, size in enumerate(height.shape):
        lags = np.unique(np.geomspace(1, max(size // 4, 1), _LAGS).astype(int))
        # Of a large map some lines are enough.
        lines = np.moveaxis(height, axis, -1).reshape(-1, size)
        square, ratio = _differences(lines[:: max(height.size // _COMPARED, 1)], lags)
        lags, square, ratio = (values[np.isfinite(square)] for values in (lags, square, ratio))
        if lags.size == 0 or lags[0] > 1 or square[0] == 0:
            continue
        # The first lag at which the difference is large enough; a direction along which it never is has no facets.
        rising = np.log(np.maximum.accumulate(square))
        log_lag = np.interp(np.log(target), rising, np.log(lags), left=0.0, right=np.nan)
        smoothness = np.fmin(smoothness, np.interp(log_lag, np.log(lags), ratio))
    return np.asarray(smoothness)


def _differences(lines: Array, lags: NDArray[np.int64]) -> tuple[Array, Array]:
    """Mean square difference of heights so many samples apart along lines [um2], and over that of even slopes [1]; NaN without any."""
    steps = np.square(np.diff(lines, axis=-1), dtype=float)
    present = np.isfinite(steps)
    total, known = (
        np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=-1) for values in (np.where(present, steps, 0.0), present)
    )
    square, of_slopes = np.full((2, lags.size), np.nan)
    for row, lag in enumerate(lags):
        whole = known[:, lag:] - known[:, :-lag] == lag
        if whole.any():
            square[row] = np.square((lines[:, lag:] - lines[:, :-lag])[whole], dtype=float).mean()
            # Of the slopes between the same heights: a small map is not the same all over.
            of_slopes[row] = lag * (total[:, lag:] - total[:, :-lag])[whole].mean()
    return square, square / np.maximum(of_slopes, 1e-300)


def holds(variance: Array, slope: float, theta_i: Array, smoothness: ArrayLike = 1.0) -> Holds:
    """Where the reference solutions hold.

    Parameters
    ----------
    variance : of the phase, at incidences ``theta_i`` [degree]
    slope : typical slope of the map along one axis
    smoothness : of the facets, of the shape of the incidences (:func:`facet_smoothness`)

    Notes
    -----
    Rays need a variance of 20, and facets that are smooth (:data:`SMOOTH_FACETS`): roughness finer than the coarse relief, of a phase
    variance below 20, is none of facets. Diffraction needs low slopes (:data:`brdfpipe.bsdf.kirchhoff.SLOPE_LIMIT`), and either negligible masking or
    mostly coherent light.
    """
    cosine, sine = np.cos(np.radians(theta_i)), np.sin(np.radians(theta_i))
    low_slopes = np.sqrt(2) * slope <= kirchhoff.SLOPE_LIMIT
    unmasked = low_slopes & (cosine >= UNMASKED * min(slope, 1.0) * sine)
    smooth = np.asarray(smoothness) >= SMOOTH_FACETS
    return Holds((variance >= GEOMETRIC) & smooth, low_slopes & (unmasked | (variance <= COHERENT)))


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
    Dataset of kind ``bsdf``: ``traced`` where rays hold at 60° (:func:`holds`); else ``kirchhoff`` if slopes are low and the pitch is fine
    enough; else ``traced``, with a warning, if rays hold at normal incidence

    Raises
    ------
    HeightMapError : no reference holds on the map, or the one that does refuses it.
    VocabularyError : a dataset of the wrong kind.
    """
    vocabulary.validate(surface, "surface")
    mesh = HeightMesh.of(surface)
    theta_i = np.arange(900) / 10
    decisive = int(10 * _DECISIVE)
    variance = phase_variance(surface, theta_i)
    smoothness = facet_smoothness(surface, theta_i)
    held = holds(variance, mesh.typical_slope, theta_i, smoothness)
    if not held.traced[decisive] and held.kirchhoff[0]:
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
        if held.traced[decisive]:
            return bsdf
        return vocabulary.add_warning(bsdf, _limited(float(theta_i[np.argmin(held.traced) - 1])))
    raise HeightMapError(
        f"no reference solution holds on this map: its phase variance is {variance[0]:.3g}, and rays need {GEOMETRIC:g} or more; the "
        f"smoothness of its facets is {smoothness[0]:.2f}, and rays need {SMOOTH_FACETS:g} (finer roughness is none of facets); its slope is {np.sqrt(2) * mesh.typical_slope:.2g}, and diffraction needs {kirchhoff.SLOPE_LIMIT:g} or less. Set `model.truth: check`, with "
        "`model.optics: auto`"
    )


def _limited(last: float) -> str:
    return (
        f"rays hold up to {last:.0f}° of incidence on this map: beyond, its heights, or the finer part of them, are too low against the wavelength, and its "
        "slopes are too steep, or its pitch too coarse, for diffraction; set `model.optics: auto` with `model.truth: check` for grazing light"
    )

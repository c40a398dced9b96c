"""The coarsest pixel of a map whose pattern has, for an eye at a distance, the contrast of the finest one.

Light that facets mirror is far from proportional to slopes. Where a pixel averages slopes that an eye does not resolve, it also takes the difference of one
place from the next: places of the size of what an eye resolves differ in how many of their facets mirror the light. So pixels of that size show too little contrast.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.geometry import Array
from brdfpipe.texture.eye import eye_blur
from brdfpipe.texture.height_pixels import central_slopes, largest_pixel, pixel_heights, with_all_heights
from brdfpipe.texture.slope_split import INTERPOLATIONS, LEAST_UNRESOLVED

NOTICEABLE = 0.1
"""Relative difference of contrast that an eye does not notice (Legge & Foley 1980, J. Opt. Soc. Am. 70, 1458: 10 to 20 % of a clearly visible contrast)."""
_CLEARLY_VISIBLE = 0.2
"""Contrast below which the difference, not its ratio, counts: 2 %, as Weber's fraction of luminance is 1 to 2 %."""

_STEP = np.sqrt(2)
"""Ratio of one pixel to the next finer one."""
_PLACES, _PIXELS = 768, 8.0
"""Places along either side on which pictures are compared, and the least number of pixels that they extend over; fewer on smaller scans."""


class Level(NamedTuple):
    """A pixel that was tried."""

    pixel: float
    """[um]"""
    difference: float
    """Largest difference of the contrast that an eye sees from that of the finest map, over the latter, or over 0.2 where that is less [1]."""


def levels_of_detail(
    surface: xr.Dataset, facets: xr.Dataset, *, finest: float, distance: float, interpolation: str = INTERPOLATIONS[0]
) -> list[Level]:
    """Pixels of a map from the coarsest on, up to the first whose contrast an eye does not distinguish from that of the finest.

    Parameters
    ----------
    surface : kind ``surface``, an areal map, levelled
    facets : kind ``facets``, all facets of that surface
    finest : pixel [um], from the pitch of the scan to a 32nd of its shorter side
    distance : of the eye [m]
    interpolation : of the renderer between pixels (:data:`brdfpipe.texture.slope_split.INTERPOLATIONS`)

    Returns
    -------
    The pixels that were tried, from the coarsest. The last has a difference of at most :data:`NOTICEABLE`, or is the finest

    Raises
    ------
    BrdfpipeError, VocabularyError : as :func:`brdfpipe.texture.height_pixels.pixel_heights`.

    Notes
    -----
    The light at a place is that of facets whose slopes are normally distributed about the slope of the map there, with what the pixels leave of the mean
    square slope, blurred by the eye. Contrasts, the standard deviation of that over its mean, are compared for half vectors along the normal and one rms slope
    beside it, in both directions along x and y.
    """
    every = _mean_square_slopes(facets)
    # Once for all pixels.
    surface, _ = with_all_heights(surface)
    heights, _ = pixel_heights(surface, finest)
    slopes = central_slopes(heights, finest)
    rms = np.sqrt(np.diag(every))
    half_vectors = [(0.0, 0.0), (rms[0], 0.0), (-rms[0], 0.0), (0.0, rms[1]), (0.0, -rms[1])]
    tried = []
    for pixel in _coarser_pixels(finest, largest_pixel(surface)):
        ratio = pixel / finest
        shape = tuple(min(size, max(_PLACES, int(_PIXELS * ratio))) for size in heights.shape)
        coarse = central_slopes(pixel_heights(surface, pixel)[0], pixel)
        # The slopes at the borders of the scan are across its two ends.
        border = int(np.ceil(2 * ratio))
        within = tuple(slice(border, size - border) for size in shape)
        fine, here = (
            _contrasts([one[within] for one in seen], every, half_vectors, finest, distance)
            for seen in (slopes, [_between(one, ratio, shape, interpolation) for one in coarse])
        )
        difference = np.max(np.abs(here - fine) / np.maximum(fine, _CLEARLY_VISIBLE))
        tried.append(Level(float(pixel), float(difference)))
        if tried[-1].difference <= NOTICEABLE:
            return tried
    return [*tried, Level(finest, 0.0)]


def _coarser_pixels(finest: float, largest: float) -> Array:
    """Pixels above the finest, from the largest on."""
    count = int(np.floor(np.log(largest / finest) / np.log(_STEP) + 1e-9))
    return np.minimum(finest * _STEP ** np.arange(count, 0, -1), largest)


def _between(values: Array, ratio: float, shape: tuple[int, ...], interpolation: str) -> Array:
    """Values of coarse pixels at the middles of fine ones (shape), so many times smaller."""
    from scipy.ndimage import map_coordinates

    at = [(np.arange(size) + 0.5) / ratio - 0.5 for size in shape]
    order: Literal[0, 1] = 0 if interpolation == "nearest" else 1
    return np.asarray(map_coordinates(values, np.meshgrid(*at, indexing="ij"), order=order, mode="nearest"))


def _contrasts(
    slopes: list[Array], every: Array, half_vectors: list[tuple[float, float]], pixel: float, distance: float
) -> Array:
    """(half vectors,) contrasts that an eye sees of a map with the facets that it leaves."""
    covariance = np.cov(np.stack([one.ravel() for one in slopes]))
    values, axes = np.linalg.eigh(every - covariance)
    left = np.maximum(values, LEAST_UNRESOLVED * np.linalg.eigvalsh(every))
    along = [slopes[0] * axes[0, k] + slopes[1] * axes[1, k] for k in (0, 1)]
    contrasts = []
    for half in half_vectors:
        towards = [half[0] * axes[0, k] + half[1] * axes[1, k] for k in (0, 1)]
        exponent = sum((towards[k] - along[k]) ** 2 / (2 * left[k]) for k in (0, 1))
        light = np.exp(-exponent) / np.sqrt(left[0] * left[1])
        seen = eye_blur(light, pixel, distance)
        contrasts.append(seen.std() / seen.mean())
    return np.array(contrasts)


def _mean_square_slopes(facets: xr.Dataset) -> Array:
    """(2, 2) mean products of the slopes along x and y."""
    if facets["slope_density"].ndim == 1:
        return np.eye(2) * float(facets["slope_rms"]) ** 2 / 2
    _, mean, covariance = PlanarDensity.of(facets).moments
    return np.asarray(covariance + np.outer(mean, mean))

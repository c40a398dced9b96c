"""Heights of a scan on the pixels of a map, and the slopes of a periodic map."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, plain
from brdfpipe.geometry import Array

MOST_MISSING = 0.3
"""Largest share of missing heights; they are filled from their neighbours."""

LEAST_PIXELS = 32
"""Least number of pixels that a scan must fill along either side."""


def pixel_heights(surface: xr.Dataset, pixel: float) -> tuple[Array, float]:
    """Mean heights of a scan over square pixels.

    Parameters
    ----------
    surface : kind ``surface``, an areal map, levelled
    pixel : side of a pixel [um], at least the pitch of the scan

    Returns
    -------
    Heights (rows, columns) [um] of mean zero, and the share of the heights that were missing and are filled

    Raises
    ------
    BrdfpipeError : a line profile, a pixel out of range, or too many missing heights.
    VocabularyError : the dataset is not of kind ``surface``.

    Notes
    -----
    The mean over the area of a pixel, cut pitches included, is the integral of the heights, taken as constant about each of them.
    """
    check_pixel(vocabulary.validate(surface, "surface"), pixel)
    whole, share = with_all_heights(surface)
    height = whole["height"].values.astype(float)
    for axis, name in enumerate(("pitch_y", "pitch_x")):
        height = _area_means(height, axis, pixel / float(surface.attrs[name]))
    return height - height.mean(), share


def with_all_heights(surface: xr.Dataset) -> tuple[xr.Dataset, float]:
    """A surface whose missing heights are filled from their neighbours, and the share of them.

    Raises BrdfpipeError: more than :data:`MOST_MISSING` of them are missing.
    """
    share = _share_missing(surface)
    if not share:
        return surface, 0.0
    height = surface["height"].values.astype(float)
    return surface.assign(height=surface["height"].copy(data=_filled(height, np.isnan(height)))), share


def check_pixel(surface: xr.Dataset, pixel: float) -> None:
    """Refuse a pixel [um] on which the heights of a scan cannot be taken.

    Raises BrdfpipeError: a line profile, a pixel out of range, or too many missing heights.
    """
    if surface["height"].ndim != 2:
        raise BrdfpipeError("a line profile has no grain to map; accepted: an areal map as `surface.file`")
    least, most = max(float(surface.attrs["pitch_y"]), float(surface.attrs["pitch_x"])), largest_pixel(surface)
    # One part in a million for pitches that are not written with all digits.
    if not least * (1 - 1e-6) <= pixel <= most:
        raise BrdfpipeError(
            f"a pixel of {pixel:g} µm is out of range; accepted: {plain(least, 4)} µm (the pitch of the scan) to {plain(most, 4)} µm (a {LEAST_PIXELS}nd of its "
            "shorter side); set `texture.pixel`"
        )
    _share_missing(surface)


def _share_missing(surface: xr.Dataset) -> float:
    share = float(np.isnan(surface["height"].values).mean())
    if share > MOST_MISSING:
        raise BrdfpipeError(
            f"{share:.0%} of the heights are missing; accepted for a texture: at most {MOST_MISSING:.0%}. Choose a better part with `surface.region`"
        )
    return share


def largest_pixel(surface: xr.Dataset) -> float:
    """Side of the largest pixel [um] of a map of a scan: a 32nd of its shorter side."""
    pitches = float(surface.attrs["pitch_y"]), float(surface.attrs["pitch_x"])
    return min(pitch * size for pitch, size in zip(pitches, surface["height"].shape, strict=True)) / LEAST_PIXELS


def unit_normals(slope_x: Array, slope_y: Array) -> Array:
    """(rows, columns, 3) unit normals of slopes: x to the right, y upwards, z off the surface."""
    upright = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.stack([-slope_x * upright, -slope_y * upright, upright], axis=-1)


def central_slopes(height: Array, pixel: float) -> tuple[Array, Array]:
    """Slopes along x and y of a periodic height map (rows, columns) [um], by central differences over two pixels."""
    return (
        (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / (2 * pixel),
        (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) / (2 * pixel),
    )


def _area_means(height: Array, axis: int, step: float) -> Array:
    """Means over consecutive intervals of a length in pitches, along an axis."""
    height = np.moveaxis(height, axis, 0)
    integral = np.concatenate([np.zeros((1, *height.shape[1:])), np.cumsum(height, axis=0)])
    edges = np.arange(int(np.floor(height.shape[0] / step + 1e-6)) + 1) * step
    edges = np.minimum(edges, height.shape[0])
    below = np.minimum(edges.astype(int), height.shape[0] - 1)
    share = (edges - below)[:, None]
    at = integral[below] * (1 - share) + integral[below + 1] * share
    return np.moveaxis(np.diff(at, axis=0) / step, 0, axis)


def _filled(height: Array, missing: NDArray[np.bool_]) -> Array:
    """Missing heights from the means of their neighbours, wider where there are none."""
    from scipy.ndimage import gaussian_filter

    result, known = np.where(missing, 0.0, height), ~missing
    left, width = missing.copy(), 1.0
    while left.any():
        weight = gaussian_filter(known.astype(float), width)
        enough = left & (weight > 0.05)
        mean = gaussian_filter(np.where(known, height, 0.0), width)
        result[enough] = mean[enough] / weight[enough]
        left, width = left & ~enough, 2 * width
    return result

"""Gaussian filters of ISO 16610: λs removes short waves, λc long ones.

Missing heights have no weight and stay missing: the weights of the others are normalised (normalised convolution), at gaps and
at edges.

References
----------
ISO 16610-21:2011 (lines) and ISO 16610-61:2015 (areas); α = sqrt(ln 2 / π), so that half of a wave at the cutoff is transmitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe.errors import BrdfpipeError, plain
from brdfpipe.geometry import Array
from brdfpipe.surfaces.heights import band
from brdfpipe.vocabulary import add_history, validate

ALPHA = math.sqrt(math.log(2) / math.pi)
LEAST_PITCHES = 4

_BLOCK = 2**21
_REACH = 1.0
"""Half width of the weights in cutoffs: exp(-π/α²) = 7e-7 of the peak remains there."""


def low_pass(surface: xr.Dataset, lambda_s: float) -> xr.Dataset:
    """Low-pass filter: remove waves shorter than the cutoff λs.

    Parameters
    ----------
    surface : kind ``surface``; level it first
    lambda_s : cutoff wavelength λs [um], at least 4 pitches and at most the shortest side; a wave of this length keeps half
        its height, in any direction

    Returns
    -------
    Dataset of kind ``surface`` of the same floating type; missing heights stay missing; attributes ``lambda_s`` [um] and
    ``band``, and the history, record the filter.

    Raises
    ------
    VocabularyError : the dataset is not of kind ``surface``.
    BrdfpipeError : a cutoff too short for the pitch, too long for the extent, or not below λc of an earlier filter.
    """
    validate(surface, "surface")
    _check(surface, lambda_s, "λs")
    if lambda_s >= surface.attrs.get("lambda_c", math.inf):
        raise BrdfpipeError(f"the cutoff λs of {lambda_s:g} um is not below λc, {surface.attrs['lambda_c']:g} um")
    smooth = _smooth(surface, lambda_s)
    return _filtered(surface, smooth, "lambda_s", lambda_s, "Low-pass Gaussian filter, λs")


def high_pass(surface: xr.Dataset, lambda_c: float) -> xr.Dataset:
    """High-pass filter: remove waves longer than the cutoff λc, the waviness.

    Parameters
    ----------
    surface : kind ``surface``; level it first, since the mean of a slope near an edge is one-sided
    lambda_c : cutoff wavelength λc [um], above λs, at least 4 pitches and at most the shortest side; a wave of this length
        keeps half its height, in any direction

    Returns
    -------
    As :func:`low_pass`, with the attribute ``lambda_c``

    Raises
    ------
    VocabularyError : the dataset is not of kind ``surface``.
    BrdfpipeError : a cutoff too short for the pitch, too long for the extent, or not above λs of an earlier filter.
    """
    validate(surface, "surface")
    _check(surface, lambda_c, "λc")
    if lambda_c <= surface.attrs.get("lambda_s", 0.0):
        raise BrdfpipeError(f"the cutoff λc of {lambda_c:g} um is not above λs, {surface.attrs['lambda_s']:g} um")
    rough = surface.height.values - _smooth(surface, lambda_c)
    return _filtered(surface, rough, "lambda_c", lambda_c, "High-pass Gaussian filter, λc")


def _check(surface: xr.Dataset, cutoff: float, name: str) -> None:
    pitches = _pitches(surface)
    least = LEAST_PITCHES * max(pitches)
    most = min(pitch * count for pitch, count in zip(pitches, surface.height.shape, strict=True))
    if not least <= cutoff <= most:
        raise BrdfpipeError(
            f"the cutoff {name} of {cutoff:g} um is out of range; accepted: {plain(least, 4)} um ({LEAST_PITCHES} pitches) to "
            f"{plain(most, 4)} um (the shortest side)"
        )


def _pitches(surface: xr.Dataset) -> list[float]:
    return [float(surface.attrs[f"pitch_{dim}"]) for dim in surface.height.dims]


def _filtered(surface: xr.Dataset, height: Array, attribute: str, cutoff: float, words: str) -> xr.Dataset:
    filtered = surface.copy()
    original = surface.height
    filtered["height"] = original.copy(data=height.astype(original.dtype, copy=False))
    filtered.attrs[attribute] = float(cutoff)
    filtered.attrs["band"] = band(filtered.attrs)
    return add_history(filtered, f"{words} = {cutoff:g} um (ISO 16610, half transmitted at the cutoff).")


def _smooth(surface: xr.Dataset, cutoff: float) -> Array:
    """Gaussian-weighted mean of the valid heights around every valid point; NaN elsewhere."""
    height = surface.height.values.astype(np.float64)
    missing = np.isnan(height)
    # The mean height is removed before the transforms, where it would cost digits.
    offset = float(height[~missing].mean()) if not missing.all() else 0.0
    height -= offset
    height[missing] = 0
    kernels = [_weights(cutoff / pitch, count) for pitch, count in zip(_pitches(surface), height.shape, strict=True)]
    if missing.any():
        share = _convolve((~missing).astype(np.float64), kernels)
        smooth = _convolve(height, kernels)
        smooth[missing] = np.nan
        # A valid point has at least its own weight.
        np.divide(smooth, share, out=smooth, where=~missing)
    else:
        smooth = _convolve(height, kernels)
        for axis, kernel in enumerate(kernels):
            along = [1] * height.ndim
            along[axis] = -1
            smooth /= _convolve(np.ones(height.shape[axis]), [kernel]).reshape(along)
    smooth += offset
    return smooth


def _weights(cutoff: float, count: int) -> Array:
    """The Gaussian weights of a cutoff in pitches, of sum 1, no wider than ``count`` points can use."""
    reach = min(math.ceil(_REACH * cutoff), count - 1)
    weights = np.exp(-math.pi * (np.arange(-reach, reach + 1) / (ALPHA * cutoff)) ** 2)
    return np.asarray(weights / weights.sum())


def _convolve(values: Array, kernels: Sequence[Array]) -> Array:
    """Convolution with a kernel along each axis, with nothing beyond the edges; by transforms, a block of lines at a time."""
    from scipy.signal import oaconvolve

    if values.ndim == 1:
        return np.asarray(oaconvolve(values, kernels[0], mode="same"))
    result = np.empty_like(values)
    lines = max(1, _BLOCK // values.shape[1])
    for start in range(0, values.shape[0], lines):
        part = slice(start, start + lines)
        result[part] = oaconvolve(values[part], kernels[1][None, :], mode="same", axes=1)
    lines = max(1, _BLOCK // values.shape[0])
    for start in range(0, values.shape[1], lines):
        columns = np.s_[:, start : start + lines]
        result[columns] = oaconvolve(result[columns], kernels[0][:, None], mode="same", axes=0)
    return result

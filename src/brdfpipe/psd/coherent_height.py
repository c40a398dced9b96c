"""Rms of the normally distributed heights that would reflect as much light coherently as measured ones do.

The coherent share of the light that heights h reflect is |⟨exp(iqh)⟩|², q the change of the wave vector along the normal [rad/um]. Of normally
distributed heights it is exp(−q²σ²). Heights of other distributions, such as those of flat faces with scratches, have a σ that depends on q.

References
----------
Beckmann & Spizzichino 1963, §5.3 (characteristic function of the heights).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array

LARGEST_PHASE = 4 * np.pi / 0.3
"""Largest q [rad/um]: mirror reflection of 300 nm."""

_NODES = 48
_DIMMEST = 4.0  # q times the rms height beyond which no coherent light is left
_BIN_PHASE = 0.01  # phase that a bin of heights spans at the largest q [rad]
_BLOCKS = 64  # stretches of rows, whose scatter is the chance part of the coherent light
_SIGNIFICANT = 3.0  # times its chance part, which coherent light must exceed


def coherent_height(height: NDArray[np.floating], noise: float) -> xr.Dataset:
    """Rms height [um] by q.

    Parameters
    ----------
    height : levelled heights [um], (y, x) or (x,); NaN where missing
    noise : rms of white height noise [um], which is left out

    Returns
    -------
    ``coherent_sigma(phase_per_height)`` [um]. Where the area reflects hardly more coherently than by chance, the last value is held
    """
    rows = height if height.ndim == 2 else height[None, :]
    middle, sigma = float(np.nanmean(height, dtype=float)), float(np.nanstd(height, dtype=float))
    if not sigma > noise:
        return _dataset(np.array([LARGEST_PHASE]), np.zeros(1))
    phase = np.linspace(0.0, min(LARGEST_PHASE, _DIMMEST / sigma), _NODES + 1)[1:]
    low, width = float(np.nanmin(height)) - middle, _BIN_PHASE / phase[-1]
    bins = int((float(np.nanmax(height)) - middle - low) / width) + 1
    parts = np.array_split(rows, min(_BLOCKS, rows.shape[0])) if rows.shape[0] > 1 else np.array_split(rows[0], _BLOCKS)
    counts = np.stack([_histogram(part - middle - low, width, bins) for part in parts])
    counts = counts[counts.sum(axis=1) > 0]
    field = counts @ np.exp(1j * (low + width * (np.arange(bins) + 0.5))[:, None] * phase)
    # Heights are even within a bin.
    field /= np.sinc(phase * width / (2 * np.pi)) ** -1 * counts.sum(axis=1, keepdims=True)
    amplitude = np.average(field, axis=0, weights=counts.sum(axis=1))
    chance = np.mean(np.abs(field - amplitude) ** 2, axis=0) / max(len(field) - 1, 1)
    share = np.abs(amplitude) ** 2
    found = share > _SIGNIFICANT * chance
    found[0] = True
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = -np.log(np.clip(share - chance, 1e-300, 1.0)) / phase**2 - noise**2
    # Up to the first q without coherent light.
    last = int(np.argmin(np.append(found, False)))
    variance[last:] = variance[last - 1]
    return _dataset(phase, np.sqrt(np.maximum(variance, 0.0)))


def _histogram(height: NDArray[np.floating], width: float, bins: int) -> Array:
    present = height[np.isfinite(height)]
    return np.bincount(np.minimum((present / width).astype(np.int64), bins - 1), minlength=bins).astype(float)


def _dataset(phase: Array, sigma: Array) -> xr.Dataset:
    return xr.Dataset({"coherent_sigma": ("phase_per_height", sigma)}, coords={"phase_per_height": phase})

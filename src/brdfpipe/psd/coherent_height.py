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
_TILES = 8  # parts along each side of a map, whose scatter is its uncertainty: rows next to each other are much alike
_SIGNIFICANT = 3.0  # times its chance part, which coherent light must exceed


def coherent_height(height: NDArray[np.floating], noise: float) -> xr.Dataset:
    """Rms height [um] by q.

    Parameters
    ----------
    height : levelled heights [um], (y, x) or (x,); NaN where missing
    noise : rms of white height noise [um], which is left out

    Returns
    -------
    ``coherent_sigma(phase_per_height)`` [um], and its standard uncertainty ``coherent_sigma_u``, by which it differs from that of an endless
    surface. Where the area reflects hardly more coherently than by chance, the last values are held
    """
    rows = height if height.ndim == 2 else height[None, :]
    middle, sigma = float(np.nanmean(height, dtype=float)), float(np.nanstd(height, dtype=float))
    if not sigma > noise:
        return _dataset(np.array([LARGEST_PHASE]), np.zeros(1), np.zeros(1))
    phase = np.linspace(0.0, min(LARGEST_PHASE, _DIMMEST / sigma), _NODES + 1)[1:]
    low, width = float(np.nanmin(height)) - middle, _BIN_PHASE / phase[-1]
    bins = int((float(np.nanmax(height)) - middle - low) / width) + 1
    parts = np.array_split(rows, min(_BLOCKS, rows.shape[0])) if rows.shape[0] > 1 else np.array_split(rows[0], _BLOCKS)
    columns = _TILES if rows.shape[0] > 1 else 1
    bands = min(_TILES, len(parts)) if columns > 1 else len(parts)
    strips, tiles = np.zeros((len(parts), bins)), np.zeros((bands, columns, bins))
    for number, part in enumerate(parts):
        for column, tile in enumerate(np.array_split(part, columns, axis=-1)):
            counts = _histogram(tile - middle - low, width, bins)
            strips[number] += counts
            tiles[number * bands // len(parts), column] += counts
    wave = np.exp(1j * (low + width * (np.arange(bins) + 0.5))[:, None] * phase)
    # Heights are even within a bin.
    wave *= np.sinc(phase * width / (2 * np.pi))
    field, weight = _mean_fields(strips, wave)
    amplitude = weight @ field
    chance = np.mean(np.abs(field - amplitude) ** 2, axis=0) / max(len(field) - 1, 1)
    field, weight = _mean_fields(tiles.reshape(-1, bins), wave)
    # Of ln |amplitude|²; the phase of a part is that of its mean height, and has no effect on it.
    spread = 2 * np.sqrt(weight**2 @ np.real(field / amplitude - 1) ** 2 * len(field) / max(len(field) - 1, 1))
    share = np.abs(amplitude) ** 2
    found = share > _SIGNIFICANT * chance
    found[0] = True
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = -np.log(np.clip(share - chance, 1e-300, 1.0)) / phase**2 - noise**2
    # Up to the first q without coherent light.
    last = int(np.argmin(np.append(found, False)))
    variance[last:] = variance[last - 1]
    found_sigma = np.sqrt(np.maximum(variance, 0.0))
    u = spread / (2 * phase**2 * np.maximum(found_sigma, 1e-300))
    u[last:] = u[last - 1]
    return _dataset(phase, found_sigma, np.minimum(u, found_sigma))


def _mean_fields(counts: Array, wave: Array) -> tuple[NDArray[np.complexfloating], Array]:
    """Mean of the reflected field over each part of the area that has heights (parts, q), and shares of all heights."""
    present = counts.sum(axis=1)
    used = present > 0
    return counts[used] @ wave / present[used, None], present[used] / present.sum()


def _histogram(height: NDArray[np.floating], width: float, bins: int) -> Array:
    present = height[np.isfinite(height)]
    return np.bincount(np.minimum((present / width).astype(np.int64), bins - 1), minlength=bins).astype(float)


def _dataset(phase: Array, sigma: Array, u: Array) -> xr.Dataset:
    dim = "phase_per_height"
    return xr.Dataset({"coherent_sigma": (dim, sigma), "coherent_sigma_u": (dim, u)}, coords={dim: phase})

"""Waves longer than the band of a roughness spectrum: their rms height and slope, from the whole of a scan.

A window leaves few of them, and levelled patches none; light meets them nevertheless. The heights are developed in cosines, whose sum has
no step at the edges of the scan: the modes below the band are the long waves, and their squares add up to those of heights and slopes.

References
----------
Ahmed, Natarajan & Rao 1974, IEEE Trans. Comput. C-23, 90 (discrete cosine transform).
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.psd.periodograms import Scan, coarser, filled

_SAMPLES = 16.0
"""Fewest heights along the shortest long wave: means of neighbours lower it by 0.6 % then."""


def long_waves(scan: Scan, lowest: float, sigma: float, noise: float) -> xr.Dataset:
    """Rms height [um] and rms slope √⟨p² + q²⟩ [1] of the waves below a frequency ``lowest`` [um-1].

    Parameters
    ----------
    scan : levelled heights, NaN where missing
    sigma : rms height of the spectrum above that frequency [um]. What it lacks of the variance of the heights bounds that of the long
        waves: by chance the spectrum may have more of it, and a line also crosses shorter waves at a low angle
    noise : rms of white height noise [um]

    Returns
    -------
    ``long_sigma`` and ``long_slope``, and ``long_sigma_u``, which follows from the number of modes that hold the waves
    """
    points, coarse = scan.height.size, scan
    while max(coarse.pitch) * 2 * _SAMPLES < 1 / lowest and min(coarse.height.shape) >= 4:
        coarse = coarser(coarse)
    coarse, scale = filled(coarse)
    square, power = _modes(coarse, lowest)
    # Each mode of all points holds an even part of the noise.
    height = max(scale * float(power.sum()) - power.size / points * noise**2, 0.0)
    height = min(height, max(scan.variance - noise**2 - sigma**2, 0.0))
    # Along a line waves of all directions have half of their square slope.
    slope = (2 * np.pi) ** 2 * float(square @ power) / max(float(power.sum()), 1e-300) * height
    slope *= 2 if len(scan.pitch) == 1 else 1
    # The square of each mode of normal heights has a relative variance of 2.
    relative_u = np.sqrt(2 * float(np.square(power).sum())) / max(float(power.sum()), 1e-300)
    sigma_long = float(np.sqrt(height))
    return xr.Dataset(
        {"long_sigma": sigma_long, "long_sigma_u": sigma_long * relative_u / 2, "long_slope": float(np.sqrt(slope))}
    )


def _modes(scan: Scan, lowest: float) -> tuple[Array, Array]:
    """Square of the frequency [um-2] and mean square height [um2] of the modes between 0 and a frequency."""
    from scipy.fft import dctn

    height = scan.height.astype(float)
    axes = [np.arange(n) / (2 * n * pitch) for n, pitch in zip(height.shape, scan.pitch, strict=True)]
    square = np.asarray(sum(axis**2 for axis in np.meshgrid(*axes, indexing="ij", sparse=True)))
    inside = (square > 0) & (square < lowest**2)
    amplitude = np.asarray(dctn(height - height.mean(), norm="ortho"))[inside]
    return square[inside], np.square(amplitude) / height.size

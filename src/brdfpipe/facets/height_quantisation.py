"""Quantised heights: find the height step of the instrument, and dither the heights over it.

Slopes between rounded heights take a few values. Dithering moves every height independently by up to half a step; the slopes
then take any value. Their density is that of the surface, convolved twice with a triangle of half width one step: once by the
rounding (of heights that vary over many steps), once by the dither. The triangles' mean squares are known and removed by :func:`brdfpipe.facets.slope_histogram.remove_broadening`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

FINEST, COARSEST = 0.02, 1.5
"""Slope of one height step over the slope rms: finer steps are harmless, coarser ones are the shape of the surface."""

_SAMPLED = 2**15
# Limits of the step over the rms of second differences (rounding alone gives an rms of 0.58 steps).
_FINEST_STEP, _COARSEST_STEP = 1 / 2048, 2.5
# Second differences closer than this share of their rms count as equal.
_ALIKE = 1e-6


def height_step(height: Array, pitch: tuple[float, float]) -> float:
    """Quantisation step of the heights of a map [um]; 0 if they are not quantised, or too finely to matter.

    Mixed second differences (along x of those along y) are multiples of the step, whichever forms along x and along y were
    subtracted.
    """
    if min(height.shape) < 2:
        return 0.0
    every = max(1, height.size // _SAMPLED)
    upper, lower = height[:-1:every].astype(float), height[1::every].astype(float)
    rises = np.diff(upper, axis=1), lower - upper
    mixed = np.diff(rises[1], axis=1)
    # Zeros are multiples of any step: a plateau must not outvote the rest.
    varying, level = mixed[np.isfinite(mixed) & (mixed != 0)], int(np.count_nonzero(mixed == 0))
    quantum = _common_step(np.concatenate([varying, np.zeros(min(level, varying.size // 2))]))
    if quantum == 0:
        return 0.0
    slopes = [quantum / step for step in pitch]
    rms = [float(np.nanstd(rise)) / step for rise, step in zip(rises, pitch, strict=True)]
    return quantum if min(slopes) < COARSEST * max(rms) and max(slopes) > FINEST * min(rms) else 0.0


def _common_step(values: Array) -> float:
    """Step of which values are multiples; 0 if there is none.

    It is the inverse of the lowest frequency at which the characteristic function returns towards 1. Unlike a greatest common
    divisor, this tolerates heights that were rounded a second time when they were printed.
    """
    from scipy.fft import rfft

    rms = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    if not 0 < rms < np.inf:
        return 0.0
    distinct, counts = np.unique(np.rint(values / (_ALIKE * rms)), return_counts=True)
    if distinct.size > values.size / 2:
        return 0.0
    distinct, limit = distinct * _ALIKE, 4.0
    near = np.abs(distinct) < limit
    distinct, counts = distinct[near], counts[near]
    bins = int(2 * limit / _FINEST_STEP) * 2
    bin_index = ((distinct + limit) * (bins / (2 * limit))).astype(np.int64)
    characteristic = np.abs(rfft(np.bincount(bin_index, counts, minlength=bins))) / counts.sum()
    peaks = (
        np.flatnonzero((characteristic[1:-1] > characteristic[:-2]) & (characteristic[1:-1] >= characteristic[2:])) + 1
    )
    peaks = peaks[characteristic[peaks] > 0.5]
    if peaks.size == 0 or peaks[0] < 2 * limit / _COARSEST_STEP:
        return 0.0
    # The peak is accurate enough to count the steps in every value; the counts then give the exact step.
    steps = np.rint(distinct * (peaks[0] / (2 * limit)))
    return rms * float((counts * steps) @ distinct) / float((counts * steps) @ steps)


def dither(rows: slice, columns: slice) -> Array:
    """Uniform, independent numbers in [-1/2, 1/2), one for each (row, column) of a map and independent of the block it is read in.

    A hash, because differences between neighbours in a low-discrepancy sequence take two values only.

    References
    ----------
    Steele, Lea & Flood 2014, OOPSLA: the mixer of SplitMix64.
    """
    row, column = (np.arange(span.start, span.stop, dtype=np.uint64) for span in (rows, columns))
    mixed: NDArray[np.uint64] = (row[:, None] << np.uint64(32) | column) * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed ^= mixed >> np.uint64(shift)
        mixed *= np.uint64(factor)
    mixed ^= mixed >> np.uint64(31)
    return np.asarray((mixed >> np.uint64(11)) * 2.0**-53 - 0.5)

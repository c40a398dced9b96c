"""Quantised heights: find the height step of the instrument, and dither the heights over it.

Slopes between rounded heights take a few values. Dithering moves every height independently by up to half a step; the slopes
then take any value. Their density is that of the surface, convolved twice with a triangle of half width one step: once by the
rounding (of heights that vary over many steps), once by the dither. The triangles' mean squares are known and removed by :func:`brdfpipe.facets.slope_histogram.remove_broadening`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

FINEST, COARSEST = 0.02, 1.5
"""Slope of one height step over the slope rms: finer steps are harmless, coarser ones are the shape of the surface."""

_SAMPLED = 2**15
# Limits of the step over the rms of second differences (rounding alone gives an rms of 0.58 steps).
_FINEST_STEP, _COARSEST_STEP = 1 / 2048, 2.5
# Second differences closer than this share of their rms count as equal.
_EQUAL = 1e-6


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
    """Step of which values are multiples; 0 if there is none."""
    rms = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    multiples = distinct_multiples(values, rms, _EQUAL, 4.0) if 0 < rms < np.inf else None
    if multiples is None or multiples.frequency < 1 / _COARSEST_STEP:
        return 0.0
    # The peak is accurate enough to count the steps in every value; the counts then give the exact step.
    steps = np.rint(multiples.values * multiples.frequency)
    return rms * float((multiples.counts * steps) @ multiples.values) / float((multiples.counts * steps) @ steps)


class Multiples(NamedTuple):
    """Values that are multiples of a step, but for an offset."""

    values: Array
    """Distinct values over their rms, increasing"""
    counts: NDArray[np.int64]
    frequency: float
    """Inverse of the step over the rms, approximately"""


def distinct_multiples(values: Array, rms: float, equal: float, reach: float) -> Multiples | None:
    """Distinct values and the frequency of their step; None if they are not multiples of a step above 1/2048 of their rms.

    The step is the inverse of the lowest frequency at which the characteristic function returns towards 1. Unlike a greatest
    common divisor, this tolerates heights that were rounded a second time when they were printed.

    Parameters
    ----------
    values : of mean or median zero
    rms : of the values
    equal : share of the rms within which values count as equal
    reach : largest value used, over the rms
    """
    from scipy.fft import rfft

    distinct, counts = np.unique(np.rint(values / (equal * rms)), return_counts=True)
    if distinct.size > values.size / 2:
        return None
    distinct = distinct * equal
    near = np.abs(distinct) < reach
    distinct, counts = distinct[near], counts[near]
    bins = int(2 * reach / _FINEST_STEP) * 2
    index = ((distinct + reach) * (bins / (2 * reach))).astype(np.int64)
    characteristic = np.abs(rfft(np.bincount(index, counts, minlength=bins))) / counts.sum()
    inner = characteristic[1:-1]
    peaks = np.flatnonzero((inner > characteristic[:-2]) & (inner >= characteristic[2:]) & (inner > 0.5)) + 1
    return Multiples(distinct, counts, float(peaks[0]) / (2 * reach)) if peaks.size else None


def dither(rows: slice, columns: slice) -> Array:
    """Uniform, independent numbers in [-1/2, 1/2), one for each (row, column) of a map and independent of the block it is read in.

    A hash, because differences between neighbours in a low-discrepancy sequence take two values only.

    Source: Steele, Lea & Flood 2014, OOPSLA: the mixer of SplitMix64.
    """
    row, column = (np.arange(span.start, span.stop, dtype=np.uint64) for span in (rows, columns))
    mixed: NDArray[np.uint64] = (row[:, None] << np.uint64(32) | column) * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed ^= mixed >> np.uint64(shift)
        mixed *= np.uint64(factor)
    mixed ^= mixed >> np.uint64(31)
    return np.asarray((mixed >> np.uint64(11)) * 2.0**-53 - 0.5)

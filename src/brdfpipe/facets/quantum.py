"""Heights that an instrument gives in steps: the step is found, and the heights are spread over it.

Slopes between rounded heights lie on a few values. Spread by half a step either way, each height on its own, they lie
anywhere, and the density of the slopes is the surface's, twice convolved with a triangle of the step's width either way
(once by the rounding of heights that vary over many steps, once by the spreading). The triangles' mean squares are known, and
taken out of the density by :func:`brdfpipe.facets.counting.narrowed`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

FINEST, COARSEST = 0.02, 1.5
"""Slope of one step from one height to the next, over the slope rms: what is finer does no harm, what is coarser is the shape
of the surface."""

_SAMPLED = 2**15
# The step is looked for between these shares of the rms of differences of differences, which rounding alone makes 0.58 steps,
# and in values that are told apart where they differ by so much of it.
_FINEST_STEP, _COARSEST_STEP = 1 / 2048, 2.5
_ALIKE = 1e-6


def quantum_of(height: Array, pitch: tuple[float, float]) -> float:
    """Step in which the heights of a map come [um]; 0 where they take any, or where the steps are too fine to matter.

    Differences between neighbours along x of differences along y are multiples of the step whatever was levelled away along
    x and along y.
    """
    if min(height.shape) < 2:
        return 0.0
    every = max(1, height.size // _SAMPLED)
    upper, lower = height[:-1:every].astype(float), height[1::every].astype(float)
    rises = np.diff(upper, axis=1), lower - upper
    mixed = np.diff(rises[1], axis=1)
    # What does not vary lies on every lattice: a plateau must not outvote the rest.
    varying, level = mixed[np.isfinite(mixed) & (mixed != 0)], int(np.count_nonzero(mixed == 0))
    quantum = _common_step(np.concatenate([varying, np.zeros(min(level, varying.size // 2))]))
    if quantum == 0:
        return 0.0
    slopes = [quantum / step for step in pitch]
    rms = [float(np.nanstd(rise)) / step for rise, step in zip(rises, pitch, strict=True)]
    return quantum if min(slopes) < COARSEST * max(rms) and max(slopes) > FINEST * min(rms) else 0.0


def _common_step(values: Array) -> float:
    """Step of which values are multiples; 0 where they take any.

    That of the lowest frequency at which the characteristic function comes back towards 1: unlike a greatest common divisor,
    it stands heights that were rounded once more when they were printed.
    """
    from scipy.fft import rfft

    rms = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    if not 0 < rms < np.inf:
        return 0.0
    taken, counts = np.unique(np.rint(values / (_ALIKE * rms)), return_counts=True)
    if taken.size > values.size / 2:
        return 0.0
    taken, reach = taken * _ALIKE, 4.0
    near = np.abs(taken) < reach
    taken, counts = taken[near], counts[near]
    bins = int(2 * reach / _FINEST_STEP) * 2
    place = ((taken + reach) * (bins / (2 * reach))).astype(np.int64)
    returned = np.abs(rfft(np.bincount(place, counts, minlength=bins))) / counts.sum()
    peaks = np.flatnonzero((returned[1:-1] > returned[:-2]) & (returned[1:-1] >= returned[2:])) + 1
    peaks = peaks[returned[peaks] > 0.5]
    if peaks.size == 0 or peaks[0] < 2 * reach / _COARSEST_STEP:
        return 0.0
    # The peak tells the step well enough to count the steps in every value; they tell it exactly.
    steps = np.rint(taken * (peaks[0] / (2 * reach)))
    return rms * float((counts * steps) @ taken) / float((counts * steps) @ steps)


def spread(rows: slice, columns: slice) -> Array:
    """Numbers in [-1/2, 1/2), uniform and independent, of places in a map: the same for a place however it is cut out.

    A hash and no low-discrepancy sequence, of which the difference between neighbours takes two values alone.

    References
    ----------
    Steele, Lea & Flood 2014, OOPSLA: the mixer of SplitMix64.
    """
    row, column = (np.arange(each.start, each.stop, dtype=np.uint64) for each in (rows, columns))
    mixed: NDArray[np.uint64] = (row[:, None] << np.uint64(32) | column) * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed ^= mixed >> np.uint64(shift)
        mixed *= np.uint64(factor)
    mixed ^= mixed >> np.uint64(31)
    return np.asarray((mixed >> np.uint64(11)) * 2.0**-53 - 0.5)

"""Spikes of a scan: single heights far above or below their neighbours, as dust, stray reflections and failed fits leave them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TIMES_MEDIAN = 20.0
"""Deviation of a spike from its neighbours over the median deviation: 14 standard deviations of normally distributed ones."""

_LEVEL = 0.5
"""Difference of the neighbours on either side over the deviation, up to which they are the ground of a spike and not a flank."""
_SAMPLE = 20011


def find(height: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Heights that stand out of their neighbours along every axis, in the same direction.

    Parameters
    ----------
    height : (y, x) or (x,), any unit, NaN where missing

    Returns
    -------
    True at spikes, of the shape of ``height``. The edges of a map and heights beside missing ones have no neighbours to compare with.

    Notes
    -----
    The deviation of a height is that from the mean of its two neighbours, along the axis where it is smaller. A spike deviates by more
    than 20 times the median deviation of all, and the neighbours differ by less than half as much. Sharp ridges and grooves deviate along
    one axis alone.
    """
    spikes = np.zeros(height.shape, dtype=bool)
    if min(height.shape) < 3:
        return spikes
    inner = (slice(1, -1),) * height.ndim
    least: NDArray[np.floating] | None = None
    stands_out = np.ones(height[inner].shape, dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        for axis in range(height.ndim):
            before, after = (_shifted(height, axis, step) for step in (-1, 1))
            deviation = height[inner] - (before + after) / 2
            stands_out &= np.abs(after - before) <= _LEVEL * np.abs(deviation)
            if least is None:
                least = deviation
            else:
                stands_out &= least * deviation > 0
                least = np.minimum(np.abs(least), np.abs(deviation))
        size = np.abs(least) if least is not None else np.zeros(0)
        sample = size.ravel()[:: max(1, size.size // _SAMPLE)]
        sample = sample[np.isfinite(sample)]
        # Coarsely quantised heights have a median of zero, and no measure of what is usual.
        usual = float(np.median(sample)) if sample.size else 0.0
        spikes[inner] = stands_out & (size > TIMES_MEDIAN * usual) & (usual > 0)
    return spikes


def _shifted(height: NDArray[np.floating], axis: int, step: int) -> NDArray[np.floating]:
    """The neighbours of the inner heights, one step along an axis."""
    return height[
        tuple(slice(1 + step, height.shape[k] - 1 + step) if k == axis else slice(1, -1) for k in range(height.ndim))
    ]


def mean_square_step(height: NDArray[np.floating]) -> float:
    """Mean square difference of neighbouring heights, summed over the axes; missing ones are left out."""
    with np.errstate(over="ignore", invalid="ignore"):
        return sum(
            float(np.nanmean(np.square(np.diff(height, axis=axis), dtype=np.float64))) for axis in range(height.ndim)
        )

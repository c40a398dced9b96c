"""The median of the values that are not missing."""

from __future__ import annotations

import numpy as np

from brdfpipe.geometry import Array


def finite_median(values: Array, axis: int) -> Array:
    """Median of the finite values along an axis; NaN where there are none.

    Faster than numpy's ``nanmedian`` and without its warnings.
    """
    ordered = np.sort(values, axis=axis)  # NaN last
    count = np.isfinite(ordered).sum(axis=axis, keepdims=True)
    lower, upper = (np.take_along_axis(ordered, np.maximum(at, 0), axis) for at in ((count - 1) // 2, count // 2))
    return np.where(count > 0, (lower + upper) / 2, np.nan).squeeze(axis)

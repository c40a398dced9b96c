"""Values that stand for missing heights: declared ones become NaN, undeclared ones are found by how far off they lie."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_LEAST_SHARE = 0.002
_FAR = 3.0
"""Distance of a placeholder from all other heights, over their range."""
_EXACT = 1e-6
"""Relative difference up to which a height equals the declared value: that of single precision."""


class Placeholder(NamedTuple):
    """A height that looks like a mark of missing ones."""

    value: float
    """In the unit of the heights"""
    share: float
    """Of the heights that are not missing"""


def find(sample: NDArray[np.floating]) -> Placeholder | None:
    """The one value that many heights have, further below or above all others than three times their range; None without one.

    Parameters
    ----------
    sample : (n,) heights, or an even sample of them, in any unit; NaN where missing
    """
    values, counts = np.unique(sample[np.isfinite(sample)], return_counts=True)
    if values.size < 3:
        return None
    total = int(counts.sum())
    for place, others in ((0, values[1:]), (-1, values[:-1])):
        gap = float(np.abs(others - values[place]).min())
        if counts[place] > max(1.0, _LEAST_SHARE * total) and gap > _FAR * float(others[-1] - others[0]):
            return Placeholder(float(values[place]), float(counts[place]) / total)
    return None


def as_missing(height: NDArray[np.floating], value: float, unit: float) -> tuple[NDArray[np.floating], str]:
    """The heights with NaN in place of the declared value, and a note for the history.

    Parameters
    ----------
    height : um
    value : in the unit of the file
    unit : that unit [um]
    """
    scaled = value * unit
    marks = np.abs(height - scaled) <= _EXACT * abs(scaled)
    count = int(np.count_nonzero(marks))
    cleared = np.where(marks, height.dtype.type(np.nan), height)
    return cleared, f"{count or 'No'} heights of {value:g} taken as missing, as declared."

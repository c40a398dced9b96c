"""Values that stand for missing heights: declared ones become NaN, undeclared ones are found by how far off they lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_FAR = 3.0
"""Distance of a placeholder from all heights, over their range."""
_SIDES = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""How many lowest and highest values are tried at once: two may lie so far apart that neither alone lies far from the others."""
_LEVELS = 16
"""Distinct heights that remain when two are taken away at once: few levels have gaps of any width."""
_SAMPLE = 20011
_EXACT = 1e-6
"""Relative difference up to which a height equals the declared value: that of single precision."""


class Placeholder(NamedTuple):
    """A height that looks like a mark of missing ones."""

    value: float
    """In the unit of the heights"""
    times: int
    """How many heights have it"""


def find(height: NDArray[np.floating]) -> tuple[Placeholder, ...]:
    """Values that two or more heights have exactly, further below or above all others than three times their range.

    A spike has no value twice, a flat peak or a clipped one is not far from the heights beside it, and a step is not far against its sides.

    Parameters
    ----------
    height : in any unit and shape; NaN where missing

    Returns
    -------
    Lowest first; empty without any. A map of several levels, each far from the others, may have more than one.
    """
    values = _ends(height)
    found: list[Placeholder] = []
    while (sides := _far_off(values)) is not None:
        marks = [*values[: sides[0]], *values[values.size - sides[1] :]]
        counts = [int(np.count_nonzero(height == mark)) for mark in marks]
        if min(counts) < 2:
            break
        found += [Placeholder(float(mark), count) for mark, count in zip(marks, counts, strict=True)]
        values = values[sides[0] : values.size - sides[1]]
    return tuple(sorted(found)) if found and _apart(height, found) else ()


def _ends(height: NDArray[np.floating]) -> NDArray[np.floating]:
    """Distinct heights in rising order, without most of those within the range of an even sample."""
    sample = height.ravel()[:: max(1, height.size // _SAMPLE)]
    sample = sample[np.isfinite(sample)]
    if sample.size == 0:
        return sample
    outside = height[(height < sample.min()) | (height > sample.max())]
    return np.unique(np.concatenate([sample, outside[np.isfinite(outside)]]))


def _far_off(values: NDArray[np.floating]) -> tuple[int, int] | None:
    """How many of the lowest and of the highest values lie far from the rest; None without any."""
    for low, high in _SIDES:
        rest = values[low : values.size - high]
        if rest.size < (2 if low + high == 1 else _LEVELS):
            continue
        first, last = float(rest[0]), float(rest[-1])
        gaps = [first - float(values[low - 1])] if low else []
        gaps += [float(values[values.size - high]) - last] if high else []
        if min(gaps) > _FAR * (last - first):
            return low, high
    return None


def _apart(height: NDArray[np.floating], found: Sequence[Placeholder]) -> bool:
    """Whether the values lie far from every height, not from a sample alone."""
    rest = np.isfinite(height)
    for mark in found:
        rest &= height != mark.value
    others = height[rest]
    first, last = float(others.min()), float(others.max())
    return all(max(first - mark.value, mark.value - last) > _FAR * (last - first) for mark in found)


def as_missing(
    height: NDArray[np.floating], values: Sequence[float], unit: float
) -> tuple[NDArray[np.floating], tuple[str, ...]]:
    """The heights with NaN in place of the declared values, and a note on each for the history.

    Parameters
    ----------
    height : um
    values : in the unit of the file
    unit : that unit [um]
    """
    notes = []
    cleared = height
    for value in values:
        scaled = value * unit
        marks = np.abs(height - scaled) <= _EXACT * abs(scaled)
        count = int(np.count_nonzero(marks))
        cleared = np.where(marks, height.dtype.type(np.nan), cleared)
        notes.append(f"{count or 'No'} heights of {value:g} taken as missing, as declared.")
    return cleared, tuple(notes)

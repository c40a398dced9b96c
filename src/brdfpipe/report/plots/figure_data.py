"""The data of a chart, which its picture carries and the page offers as CSV."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from brdfpipe.report.plots.svg import Mark

UPPER, ERROR = "upper edge", "half length of the error bar"


def metadata(x: str, y: str, marks: Sequence[Mark]) -> str:
    """An element of an SVG, which no browser shows: the labels of the axes, and of each mark its name and columns of numbers, as JSON.

    A mark is ``[name, x, y]``, an area ``[name, x, lower edge, upper edge]``, points with error bars ``[name, x, y, half length]``; x is null
    where it is that of the mark before. Numbers have four significant digits, x five. Undefined values are left out. Empty without any.
    """
    curves: list[list[object]] = []
    before, fourth = None, ""
    for mark in marks:
        columns = list(_columns(mark))
        numbers = np.stack(np.broadcast_arrays(*columns), axis=-1)
        numbers = numbers[np.isfinite(numbers[:, :2]).all(axis=1)]
        if len(numbers) == 0:
            continue
        across, *rest = (
            [_short(value, digits) for value in column]
            for column, digits in zip(numbers.T.tolist(), (5, 4, 4), strict=False)
        )
        curves.append([mark.label, None if across == before else across, *rest])
        before = across
        if len(rest) > 1:
            fourth = ERROR if hasattr(mark, "error") else UPPER
    if not curves:
        return ""
    text = json.dumps(
        {"columns": ["curve", x, y, *([fourth] if fourth else [])], "curves": curves},
        ensure_ascii=False,
        separators=(",", ":"),
    )
    return f"<metadata>{text.replace('&', chr(92) + 'u0026').replace('<', chr(92) + 'u003c')}</metadata>"


def _columns(mark: Mark) -> Iterator[Array]:
    names = (
        ("x", "y", "error") if hasattr(mark, "error") else ("x", "y") if hasattr(mark, "y") else ("x", "low", "high")
    )
    for name in names:
        values = _numbers(getattr(mark, name))
        if name != "error" or np.isfinite(values).any():
            yield values


def _numbers(values: ArrayLike) -> Array:
    return np.atleast_1d(np.asarray(values, dtype=float))


def _short(value: float, digits: int) -> float | int | None:
    """A number that JSON writes in few characters; None if it is not finite."""
    if not np.isfinite(value):
        return None
    rounded = float(f"{value:.{digits}g}")
    return int(rounded) if rounded == int(rounded) and abs(rounded) < 1e15 else rounded

"""The data of a chart, which its picture carries and the page offers as CSV."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from brdfpipe.report.plots.svg import Mark

UPPER, ERROR = "upper edge", "half length of the error bar"
_THIRD = {"high": UPPER, "error": ERROR}
"""Names of the third column of a mark, by its field."""


def metadata(x: str, y: str, marks: Sequence[Mark]) -> str:
    """An element of an SVG, which no browser shows: the labels of the axes, and of each mark its name and columns of numbers, as JSON.

    A mark is ``[name, x, y]``, an area ``[name, x, lower edge, upper edge]``, points with error bars ``[name, x, y, half length]``; x is null
    where it is that of the mark before. Numbers have four significant digits, x five. Undefined values are left out. Empty without any.
    """
    curves, before, fourth = [], "", ""
    for mark in marks:
        numbers = np.stack(np.broadcast_arrays(*_columns(mark)), axis=-1)
        numbers = numbers[np.isfinite(numbers[:, :2]).all(axis=1)]
        if len(numbers) == 0:
            continue
        across, *rest = (
            _listed(column, form) for column, form in zip(numbers.T, ("%.5g", "%.4g", "%.4g"), strict=False)
        )
        curves.append(
            f"[{','.join([json.dumps(mark.label, ensure_ascii=False), 'null' if across == before else across, *rest])}]"
        )
        before = across
        if len(rest) > 1:
            fourth = _THIRD[mark.columns[2]]
    if not curves:
        return ""
    columns = json.dumps(["curve", x, y, *([fourth] if fourth else [])], ensure_ascii=False)
    text = f'{{"columns":{columns},"curves":[{",".join(curves)}]}}'
    return f"<metadata>{_escaped(text)}</metadata>"


def of_charts(titles: Sequence[str]) -> str:
    """The same element for a picture of the data that charts with these titles carry."""
    return f"<metadata>{_escaped(json.dumps({'charts': list(titles)}, ensure_ascii=False))}</metadata>"


def _escaped(text: str) -> str:
    return text.replace("&", "\\u0026").replace("<", "\\u003c")


def _columns(mark: Mark) -> Iterator[Array]:
    for name in mark.columns:
        values = _numbers(getattr(mark, name))
        if name != "error" or np.isfinite(values).any():
            yield values


def _numbers(values: ArrayLike) -> Array:
    return np.atleast_1d(np.asarray(values, dtype=float))


def _listed(values: Array, form: str) -> str:
    """A list of numbers in JSON, which has null for what is not finite."""
    text = ",".join([form] * values.size) % tuple(values.tolist())
    return f"[{re.sub('-?(nan|inf)', 'null', text)}]"

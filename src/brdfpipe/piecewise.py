"""Piecewise cubics, evaluated fast for many values: a table indexed by the bits of a number gives its interval."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from brdfpipe.geometry import Array

_MOST_CELLS = 2**13
_FEW = 64


@dataclass(frozen=True)
class PiecewiseCubic:
    """A piecewise cubic on [0, last], evaluated in bulk.

    Parameters
    ----------
    nodes : (n + 1,) increasing, from 0
    coefficients : (4, n, …), highest power first, of x − nodes[i]

    Notes
    -----
    The upper bits of the floating-point number ``x + offset`` grow with x, evenly while x is below ``offset`` and
    logarithmically beyond, like the nodes of a density. A table over these bits gives the first interval that may contain x;
    the remaining steps, at most the nodes in a cell of the table, find it. The polynomials are scipy's.
    """

    nodes: Array
    coefficients: Array
    offset: float
    shift: int
    first_key: int
    guide: NDArray[np.int64]
    steps: int

    @classmethod
    def of(cls, spline: PPoly) -> PiecewiseCubic:
        """The same function as a scipy spline of third order whose nodes begin at 0."""
        nodes, coefficients = np.asarray(spline.x, dtype=float), np.asarray(spline.c, dtype=float)
        offset = float(nodes[min(8, nodes.size - 1)])
        first, last = _bits(nodes[:1] + offset)[0], _bits(nodes[-1:] + offset)[0]
        shift = 52
        # Finer cells until no two inner nodes share one, as long as the table stays small.
        while shift > 30:
            keys = _bits(nodes[1:-1] + offset) >> shift
            crowded = keys.size > 1 and not np.diff(keys).all()
            if not crowded or ((last - first) >> (shift - 1)) > _MOST_CELLS:
                break
            shift -= 1
        first_key = int(first >> shift)
        cells = np.arange(first_key, int(last >> shift) + 2, dtype=np.int64)
        starts = (cells << shift).view(np.float64) - offset
        guide = np.clip(np.searchsorted(nodes, starts, side="right") - 1, 0, nodes.size - 2)
        steps = int(np.diff(guide).max(initial=0))
        return cls(nodes, coefficients, offset, shift, first_key, guide, steps)

    @property
    def last(self) -> float:
        return float(self.nodes[-1])

    def __call__(self, x: Array) -> Array:
        """Values at x, in [0, last] (not checked), of the shape of x and the trailing shape of the coefficients."""
        if x.size <= _FEW:
            # The same numbers by fewer operations, each of which takes as long as for a thousand numbers.
            interval = np.minimum(self.nodes.searchsorted(x, side="right") - 1, self.nodes.size - 2)
            c = self.coefficients[:, interval]
            distance = x - self.nodes[interval]
            distance = distance.reshape(distance.shape + (1,) * (c.ndim - 1 - distance.ndim))
            return np.asarray(((c[0] * distance + c[1]) * distance + c[2]) * distance + c[3])
        key = _bits(x + self.offset)
        key >>= self.shift
        key -= self.first_key
        # mode="clip" is the fastest; all indices are in range.
        index = self.guide.take(key, mode="clip")
        for _ in range(self.steps):
            index += x >= self._ends.take(index, mode="clip")
        step = x - self.nodes.take(index, mode="clip")
        trailing = self.coefficients.shape[2:]
        if trailing == (1,):
            return self._horner(self.coefficients[..., 0], index, step)[..., None]
        return self._horner(self.coefficients, index, step.reshape(step.shape + (1,) * len(trailing)))

    @staticmethod
    def _horner(coefficients: Array, index: NDArray[np.int64], step: Array) -> Array:
        value: Array = coefficients[0].take(index, axis=0, mode="clip")
        for coefficient in coefficients[1:]:
            value *= step
            value += coefficient.take(index, axis=0, mode="clip")
        return value

    @cached_property
    def _ends(self) -> Array:
        """Upper ends of the intervals; infinite for the last."""
        return np.append(self.nodes[1:-1], np.inf)


def _bits(x: Array) -> NDArray[np.int64]:
    return np.asarray(x, dtype=np.float64).view(np.int64)

"""Densities on the unit square that are bilinear between nodes, and the maps from and to even density.

A family of densities depends on parameters, the angles of incidence: between their nodes densities and running integrals are interpolated
linearly. The first coordinate of the even square is that of the rows of constant second coordinate (conditional), the second that of their
integrals (marginal).

References
----------
Dupuy & Jakob 2018, An adaptive parameterization for efficient material acquisition and rendering (ACM Trans. Graph. 37, 274); its tensor files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

Integers = NDArray[np.intp]

_EVEN = 1e-4
"""Relative difference of two ends below which a density between them counts as constant."""


@dataclass(frozen=True)
class Slices:
    """For points of the parameters: indices of the slices around them and their weights, (corners, points) each."""

    index: Integers
    weight: Array

    @classmethod
    def at(cls, axes: Sequence[Array], points: Sequence[Array]) -> Slices:
        """Around points (n,) of each axis; constant beyond the outermost nodes, an axis of one node has no influence."""
        count = np.shape(points[0])[0] if len(points) else 1
        index, weight = np.zeros((1, count), dtype=np.intp), np.ones((1, count))
        for axis, point in zip(axes, points, strict=True):
            position = np.interp(point, axis, np.arange(axis.size))
            low = np.minimum(position.astype(np.intp), max(axis.size - 2, 0))
            share = position - low
            high = np.minimum(low + 1, axis.size - 1)
            index = np.concatenate([index * axis.size + low, index * axis.size + high])
            weight = np.concatenate([weight * (1 - share), weight * share])
        return cls(index, weight)

    def mean(self, values: Array, *at: Integers) -> Array:
        """Values (slices, …) at further indices, interpolated between the slices."""
        return np.asarray(sum(w * values[(i, *at)] for i, w in zip(self.index, self.weight, strict=True)))


@dataclass(frozen=True)
class BilinearWarp:
    """A family of densities on the unit square."""

    density: Array
    """(slices, rows, columns), of integral 1 over the square"""

    @classmethod
    def of(cls, values: Array) -> BilinearWarp:
        """From values >= 0, (slices, rows, columns), which are normalised."""
        corners = values[:, 1:, 1:] + values[:, 1:, :-1] + values[:, :-1, 1:] + values[:, :-1, :-1]
        return cls(values / (corners.mean(axis=(1, 2)) / 4)[:, None, None])

    @cached_property
    def _within_row(self) -> Array:
        """Running integral along each row, in units of a cell."""
        steps = (self.density[..., 1:] + self.density[..., :-1]) / 2
        return np.concatenate([np.zeros((*steps.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)

    @cached_property
    def _over_rows(self) -> Array:
        whole = self._within_row[..., -1]
        steps = (whole[:, 1:] + whole[:, :-1]) / 2
        return np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=-1)], axis=-1)

    def at(self, slices: Slices, x: Array, y: Array) -> Array:
        """Density at points of the square."""
        column, row, u, v = self._cell(x, y)
        low, high = (
            (1 - u) * slices.mean(self.density, row + step, column)
            + u * slices.mean(self.density, row + step, column + 1)
            for step in (0, 1)
        )
        return np.asarray((1 - v) * low + v * high)

    def to_even(self, slices: Slices, x: Array, y: Array) -> tuple[Array, Array]:
        """The point of the even square that :meth:`from_even` maps to (x, y)."""
        column, row, u, v = self._cell(x, y)
        whole, over_rows = self._within_row[..., -1], self._over_rows
        low, high = slices.mean(whole, row), slices.mean(whole, row + 1)
        second = slices.mean(over_rows, row) + v * (low + v * (high - low) / 2)
        left, right = (
            (1 - v) * slices.mean(self.density, row, column + step)
            + v * slices.mean(self.density, row + 1, column + step)
            for step in (0, 1)
        )
        before = (1 - v) * slices.mean(self._within_row, row, column) + v * slices.mean(
            self._within_row, row + 1, column
        )
        first = before + u * (left + u * (right - left) / 2)
        total = (1 - v) * low + v * high
        last = slices.mean(over_rows[:, -1])
        return np.divide(first, total, out=np.zeros_like(first), where=total > 0), np.asarray(second / last)

    def from_even(self, slices: Slices, first: Array, second: Array) -> tuple[Array, Array]:
        """Points of the square, in density like this one, of points of the even square."""
        whole, over_rows = self._within_row[..., -1], self._over_rows
        wanted = second * slices.mean(over_rows[:, -1])
        row = _last_below(lambda k: slices.mean(over_rows, k), wanted, over_rows.shape[1] - 1)
        low, high = slices.mean(whole, row), slices.mean(whole, row + 1)
        v = _solve(wanted - slices.mean(over_rows, row), low, high)

        def running(k: Integers) -> Array:
            return (1 - v) * slices.mean(self._within_row, row, k) + v * slices.mean(self._within_row, row + 1, k)

        wanted = first * ((1 - v) * low + v * high)
        column = _last_below(running, wanted, self.density.shape[2] - 1)
        left, right = (
            (1 - v) * slices.mean(self.density, row, column + step)
            + v * slices.mean(self.density, row + 1, column + step)
            for step in (0, 1)
        )
        u = _solve(wanted - running(column), left, right)
        return (column + u) / (self.density.shape[2] - 1), (row + v) / (self.density.shape[1] - 1)

    def _cell(self, x: Array, y: Array) -> tuple[Integers, Integers, Array, Array]:
        cells = self.density.shape[2] - 1, self.density.shape[1] - 1
        positions = [np.clip(value, 0.0, 1.0) * count for value, count in zip((x, y), cells, strict=True)]
        column, row = (
            np.minimum(position.astype(np.intp), count - 1) for position, count in zip(positions, cells, strict=True)
        )
        return column, row, positions[0] - column, positions[1] - row


def _last_below(running: Callable[[Integers], Array], wanted: Array, last: int) -> Integers:
    """The last index, below ``last``, whose running integral is not above what is wanted."""
    low, high = np.zeros(wanted.shape, dtype=np.intp), np.full(wanted.shape, last, dtype=np.intp)
    while (high - low > 1).any():
        middle = (low + high) // 2
        below = running(middle) <= wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return low


def _solve(area: Array, low: Array, high: Array) -> Array:
    """Position between 0 and 1 up to which a density that rises linearly from ``low`` to ``high`` has an area."""
    even = np.abs(low - high) < _EVEN * (low + high)
    root = np.sqrt(np.maximum(low * low - 2 * area * (low - high), 0.0))
    above, below = np.where(even, 2 * area, low - root), np.where(even, low + high, low - high)
    return np.clip(np.divide(above, below, out=np.zeros_like(area), where=below != 0), 0.0, 1.0)

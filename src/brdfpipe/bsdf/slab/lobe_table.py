"""Tables over pairs of directions in coordinates that follow the ridge of a lobe of any width.

The coordinates of two polar angles and the azimuth between them are the smaller angle, the distance of the larger from it, and the
distance across, both on a scale that is linear within the lobe and logarithmic beyond. The order of the directions does not matter, so
the interpolation is exactly reciprocal. Logarithms are interpolated: the result is positive, and exact for Gaussian lobes.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from brdfpipe.geometry import Array

_POLE_NODES, _MIDDLE_NODES, _GRAZING_NODES = 36, 16, 16
_MIDDLE, _GRAZING = 30.0, 70.0

PATH_ENDS = ((0, 0), (1, 1), (0, 1), (1, 0))
"""The faces, front 0 and back 1, of the smaller and the larger angle, for each path of a table."""


class LobeGrid(NamedTuple):
    """Nodes of a table, evenly spaced along the stretched distances."""

    low: Array
    """(X,) the smaller polar angle, from 0 to 90 degree"""
    spans: int
    """Number of nodes along the ridge"""
    turns: int
    """Number of nodes across the ridge"""
    scale: float
    """Width up to which distances are linear [degree]"""

    @classmethod
    def of(cls, scale: float, spans: int = 64, turns: int = 40) -> LobeGrid:
        """A grid for lobes of at least a width [degree]."""
        pole = scale * np.sinh(np.linspace(0, np.arcsinh(_MIDDLE / scale), _POLE_NODES))
        grazing = 90 - (90 - _GRAZING) * np.linspace(1, 0, _GRAZING_NODES) ** 2
        low = np.concatenate([pole[:-1], np.linspace(_MIDDLE, _GRAZING, _MIDDLE_NODES)[:-1], grazing])
        return cls(low, spans, turns, scale)

    def coarser(self) -> LobeGrid:
        """A grid of every fourth of the smaller angles and every third of the other nodes, for what varies little."""
        return LobeGrid(
            self.low[self.coarser_nodes(self.low.size)], self.spans // 3 + 1, self.turns // 3 + 1, self.scale
        )

    @staticmethod
    def coarser_nodes(count: int) -> Array:
        """Which of the smaller angles a coarser grid has."""
        return np.unique(np.append(np.arange(0, count, 4), count - 1))

    def directions(self, low: Array, span: Array, turn: Array) -> tuple[Array, Array]:
        """The larger polar angle (X, T) and the azimuth (X, T, V) [degree] of stretched distances in [0, 1]."""
        reach = np.arcsinh((90 - low[:, None]) / self.scale)
        high = np.minimum(low[:, None] + self.scale * np.sinh(span * reach), 90.0)
        across = self._across(low[:, None], high)[..., None]
        stretch = np.arcsinh(across / self.scale)
        with np.errstate(divide="ignore", invalid="ignore"):
            sine = np.where(across > 1e-9, self.scale * np.sinh(turn * stretch) / across, turn)
        return high, 180 - 2 * np.degrees(np.arcsin(np.clip(sine, 0.0, 1.0)))

    @staticmethod
    def _across(low: Array, high: Array) -> Array:
        """Scale of the distance across the plane of incidence, of two directions of azimuths 180 degree apart [degree]."""
        return np.asarray(np.degrees(2 * np.sqrt(np.sin(np.radians(low)) * np.sin(np.radians(high)))))

    def interpolate(self, table: Array, path: Array, low: Array, high: Array, azimuth: Array) -> Array:
        """Values of a table (paths, X, T, V, nodes) at pairs, (D, nodes), or at one, (nodes,).

        Parameters
        ----------
        path : (D,) which of the paths, or one number like the angles
        low, high : (D,) degree, low <= high
        azimuth : (D,) degree between the two; the ridge is at 180, the azimuth of mirrored and of straight light
        """
        reach = np.arcsinh((90 - low) / self.scale)
        along = np.arcsinh((high - low) / self.scale) / np.maximum(reach, 1e-300)
        across = self._across(low, high)
        stretch = np.arcsinh(across / self.scale)
        sine = np.abs(np.cos(np.radians(azimuth) / 2))
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.where(across > 1e-9, np.arcsinh(across * sine / self.scale) / stretch, sine)[()]
        i = np.minimum(self.low.searchsorted(low, side="right") - 1, self.low.size - 2)
        w_i = (low - self.low[i]) / (self.low[i + 1] - self.low[i])
        j, w_j = _cell(along, reach, self.spans)
        k, w_k = _cell(turn, stretch, self.turns)
        result = 0.0
        for a, u in ((i, 1 - w_i), (i + 1, w_i)):
            for b, v in ((j, 1 - w_j), (j + 1, w_j)):
                for c, w in ((k, 1 - w_k), (k + 1, w_k)):
                    result = result + table[path, a, b, c] * (u * v * w)[..., None]
        return np.asarray(result)


def _cell(position: Array, stretch: Array, nodes: int) -> tuple[Array, Array]:
    """The cell of a stretched position, and the weight of its upper end: linear in the square of the distance."""
    fractional = np.minimum(np.maximum(position, 0.0), 1.0) * (nodes - 1)
    cell = np.minimum(fractional.astype(np.intp), nodes - 2)
    first, last, at = (np.sinh(node / (nodes - 1) * stretch) ** 2 for node in (cell, cell + 1, fractional))
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = (at - first) / (last - first)
    return cell, np.where(last > first, weight, fractional - cell)[()]


def grazing_factor(smooth: tuple[bool, bool], path: Array, low: Array, high: Array) -> Array:
    """Factor by which a table is divided: cos θ at a smooth face, where light from inside vanishes at grazing; 1 at a rough face."""
    if not any(smooth):
        return np.ones(np.broadcast_shapes(np.shape(path), np.shape(low), np.shape(high)))
    at_smooth = np.array(smooth)[np.array(PATH_ENDS)][path]
    first, second = (np.where(at_smooth[..., k], np.cos(np.radians(t)), 1.0) for k, t in enumerate((low, high)))
    return np.asarray(np.maximum(first * second, 0.0))


def barycentric(nodes: Array, x: Array) -> Array:
    """Matrix (…, nodes) of polynomial interpolation from Gauss–Legendre nodes in [0, 90] to x.

    Source: Berrut & Trefethen 2004 (SIAM Review 46); the weights are those of Wang & Xiang 2012 for Legendre points.
    """
    weight = _barycentric_weights(nodes.size)
    difference = np.asarray(x, dtype=float)[..., None] - nodes
    at_node = difference == 0
    terms = weight / np.where(at_node, 1.0, difference)
    return np.where(at_node.any(axis=-1, keepdims=True), at_node, terms / terms.sum(axis=-1, keepdims=True))


@cache
def _barycentric_weights(count: int) -> Array:
    unit, gauss = np.polynomial.legendre.leggauss(count)
    return np.asarray((-1.0) ** np.arange(count) * np.sqrt((1 - unit**2) * gauss))

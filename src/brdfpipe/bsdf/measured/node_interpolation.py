"""One side of a measured BSDF: sums of functions at a few incidences (nodes), interpolated between them at equal ϑ and φ.

Linearly in the abscissa x = −ln cos σ: the light of facets grows with powers of 1/cos σ, and near normal incidence x is σ²/2, even in σ.
Coefficients of cos kφ with odd k are odd in σ and interpolated in √x. Beyond the last node, and below the lowest measured direction, the BSDF
is constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from types import EllipsisType
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured import coordinates
from brdfpipe.bsdf.measured.basis import Basis
from brdfpipe.geometry import Array

TINY = 1e-30

_MARGIN = float(np.log(2.0))
"""Largest excess of the logarithm over the values fitted at cells: a lobe is higher between cells, and a spline is unbounded beyond them."""


@dataclass(frozen=True)
class Side:
    """The measured nodes of one side of the sample."""

    incidence: Array  # (node,)
    horizon: Array  # (node,) largest polar angle of a cell
    measured: NDArray[np.bool_]  # (node, wavelength) measured, not completed
    coefficient: Array  # (node, wavelength, term)
    factor: Array  # (node, wavelength, term, any) factor of the coefficients' covariance
    common: Array
    """(component, node, wavelength, term) change of the coefficients by one standard uncertainty of a common error."""
    lowest: Array  # (node, wavelength) smallest fitted value at a cell
    highest: Array
    basis: Basis
    about: str
    logarithmic: bool
    incidence_error: tuple[Array, Array] | None
    """θ_i, and the relative error of the BSDF from there; None where the two directions of light are not averaged."""

    @classmethod
    def of(cls, bsdf: xr.Dataset, transmitted: bool, wavelengths: NDArray[np.int64] | slice) -> Side:
        """Reflection or transmission of a dataset of kind ``bsdf``, at some of its wavelengths."""
        nodes = np.flatnonzero(bsdf["transmitted"].values == transmitted)
        basis = bases.from_json(bsdf.attrs["transmitted_basis" if transmitted else "basis"])
        terms = basis.harmonic.size
        averaged = not transmitted and bsdf.attrs["reciprocity"] == "averaged" and "incidence_error" in bsdf
        common = bsdf["coefficient_common"].values if "coefficient_common" in bsdf else np.zeros((0, 0, 0, 0))

        def values(name: str) -> Array:
            return np.asarray(bsdf[name].values[nodes][:, wavelengths])

        return cls(
            bsdf["incidence"].values[nodes],
            bsdf["horizon"].values[nodes],
            values("coefficient_quality") == vocabulary.quality("measured"),
            values("coefficient")[..., :terms],
            values("coefficient_factor")[:, :, :terms],
            common[:, nodes][:, :, wavelengths, :terms] if common.size else np.zeros((0, nodes.size, 1, terms)),
            values("lowest"),
            values("highest"),
            basis,
            "mirror" if transmitted else str(bsdf.attrs["about"]),
            bsdf.attrs["link"] == "log",
            (bsdf["theta_i"].values, bsdf["incidence_error"].values) if averaged else None,
        )

    @cached_property
    def abscissa(self) -> Array:
        """(node,)"""
        return interpolation_abscissa(self.incidence)

    @cached_property
    def root_abscissa(self) -> Array:
        """(node,)"""
        return np.sqrt(self.abscissa)

    @cached_property
    def windows(self) -> list[tuple[Array, ...]]:
        """The coefficients of each node, as one direction needs them."""
        return [self.basis.windows(of_node.T) for of_node in self.coefficient]

    def sums(self, part: NodeContribution, even: Array, odd: Array) -> Array:
        """Weighted sums of the functions of a node, (directions, wavelength), or (wavelength,) of one pair as numbers."""
        if np.ndim(part.even) == 0:
            return self.basis.sum_of_one(self.windows[part.node], *part.coordinates, even, odd)
        return self.basis.sums(self.coefficient[part.node].T, *part.coordinates, even, odd)


class PathDirection(NamedTuple):
    """Pairs of directions, or one as numbers, for light that takes their paths in one direction, and the weight of that direction."""

    theta_i: Array
    theta_o: Array
    phi: Array
    weight: Array


class LobeCoordinates(NamedTuple):
    """Directions in the coordinates of the bases."""

    theta: Array  # ϑ from the mirror direction [degree]
    phi: Array  # φ about it [degree]
    cosine: Array  # cos θ_o

    def select(self, index: NDArray[np.int64]) -> LobeCoordinates:
        return LobeCoordinates(*(part[index] for part in self))


class NodeContribution(NamedTuple):
    """The contribution of a node to the BSDF of some pairs of directions."""

    node: int
    pairs: NDArray[np.int64] | EllipsisType  # which pairs; ... for the one
    even: Array  # weight of functions even in σ, the weight of the path direction included
    odd: Array  # weight of functions odd in σ; that of the even ones where no logarithm was fitted
    coordinates: LobeCoordinates


def interpolation_abscissa(theta_i: Array | float) -> Array:
    """x = −ln cos θ_i of angles [degree], in which incidences are interpolated."""
    return -np.log(np.cos(np.radians(np.minimum(theta_i, 89.999999))))


def path_directions(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> list[PathDirection]:
    """The two directions of light along a path; the sum of their weights is 1. One direction if they are not averaged."""
    if side.incidence_error is None:
        return [PathDirection(theta_i, theta_o, phi, np.ones(np.shape(theta_i))[()])]
    forward, backward = (np.interp(theta, *side.incidence_error) ** 2 for theta in (theta_i, theta_o))
    weight = backward / (forward + backward)
    return [PathDirection(theta_i, theta_o, phi, weight), PathDirection(theta_o, theta_i, -phi, 1 - weight)]


def side_values(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """BSDF (directions, wavelength), or (wavelength,) of one pair as numbers."""
    return path_values(side, path_directions(side, theta_i, theta_o, phi))


def path_values(side: Side, paths: list[PathDirection]) -> Array:
    """BSDF averaged over path directions, (directions, wavelength), or (wavelength,) of one pair as numbers."""
    shape = (*np.shape(paths[0].theta_i), side.coefficient.shape[1])
    total, geometric, positive = np.zeros(shape), np.zeros(shape), np.ones(shape, dtype=bool)
    low, high = np.zeros(shape), np.zeros(shape)
    for part in node_contributions(side, paths):
        pairs, even = part.pairs, part.even[..., None]
        if side.logarithmic:
            total[pairs] += side.sums(part, part.even, part.odd)
            low[pairs] += even * side.lowest[part.node]
            high[pairs] += even * side.highest[part.node]
            continue
        one = np.ones(np.shape(part.even))
        value = side.sums(part, one, one)
        total[pairs] += even * value
        geometric[pairs] += even * np.log(np.maximum(value, TINY))
        positive[pairs] &= (value > 0) | (even == 0)
    if side.logarithmic:
        return np.exp(np.minimum(np.maximum(total, low - _MARGIN), high + _MARGIN))
    return np.where(positive, np.exp(geometric), np.maximum(total, 0.0))


def node_contributions(side: Side, paths: list[PathDirection]) -> Iterator[NodeContribution]:
    """The contribution of each node to the directions next to it, for each path direction."""
    for path in paths:
        lobe = lobe_coordinates(side, path)
        if np.ndim(path.theta_i) == 0:
            for node, (even, odd) in _weights_of_one(side, path.theta_i).items():
                even, odd = even * path.weight, odd * path.weight
                if even > 0 or odd > 0:
                    at_node, _ = coordinates_at_node(side, node, lobe)
                    yield NodeContribution(node, ..., even, odd if side.logarithmic else even, at_node)
            continue
        for node in _nodes_beside(side, path.theta_i):
            even, odd = (weight * path.weight for weight in node_weights(side, node, path.theta_i))
            pairs = np.flatnonzero((even > 0) | (odd > 0))
            if pairs.size:
                at_node, _ = coordinates_at_node(side, node, lobe.select(pairs))
                yield NodeContribution(node, pairs, even[pairs], (odd if side.logarithmic else even)[pairs], at_node)


def _weights_of_one(side: Side, theta_i: Array) -> dict[int, tuple[Any, Any]]:
    """:func:`node_weights` of the nodes that have any at one incidence."""
    x = interpolation_abscissa(theta_i)
    even, odd = (_hats_of_one(nodes, at) for nodes, at in ((side.abscissa, x), (side.root_abscissa, np.sqrt(x))))
    return {node: (even.get(node, np.float64(0.0)), odd.get(node, np.float64(0.0))) for node in sorted({*even, *odd})}


def _hats_of_one(nodes: Array, at: Array) -> dict[int, Any]:
    """Hat functions of the nodes beside a number."""
    after = int(nodes.searchsorted(at, side="right"))
    if after in (0, nodes.size):
        return {min(after, nodes.size - 1): np.float64(1.0)}
    share = (1 / (nodes[after] - nodes[after - 1])) * (at - nodes[after - 1])
    return {after - 1: 1 - share, after: share}


def _nodes_beside(side: Side, theta_i: Array) -> Iterable[int]:
    """Nodes that may have a weight at some of the incidences."""
    if theta_i.size > side.incidence.size:
        return range(side.incidence.size)
    x = interpolation_abscissa(theta_i)
    above = (nodes.searchsorted(at) for nodes, at in ((side.abscissa, x), (side.root_abscissa, np.sqrt(x))))
    beside = {int(place) + step for places in above for place in places for step in (-1, 0, 1)}
    return sorted(node for node in beside if 0 <= node < side.incidence.size)


def lobe_coordinates(side: Side, path: PathDirection) -> LobeCoordinates:
    angles = coordinates.angles(side.about, path.theta_i, path.theta_o, path.phi)
    return LobeCoordinates(*angles, np.cos(np.radians(path.theta_o)))


def node_weights(side: Side, node: int, theta_i: Array) -> tuple[Array, Array]:
    """Weights of a node for functions even and odd in σ: hat functions of x and of √x."""
    hat = np.zeros(side.incidence.size)
    hat[node] = 1.0
    x = interpolation_abscissa(theta_i)
    return np.interp(x, side.abscissa, hat), np.interp(np.sqrt(x), side.root_abscissa, hat)


def coordinates_at_node(
    side: Side, node: int, lobe: LobeCoordinates, *, clamped: bool = True
) -> tuple[LobeCoordinates, NDArray[np.bool_]]:
    """The coordinates at which a node is evaluated, clamped to its horizon, and which of them are below it.

    The functions of cos θ_o are evaluated where the light leaves, not where it would leave at the node.
    """
    theta, phi, cosine = lobe
    if np.ndim(theta) == 0:
        theta_o, phi_o = coordinates.outgoing(side.about, side.incidence[node], theta, phi)
        lowest = side.horizon[node]
        if clamped:
            cosine = np.maximum(cosine, np.cos(np.radians(lowest)))
            if theta_o > lowest:
                theta, phi = coordinates.angles(side.about, side.incidence[node], lowest, phi_o)
        return LobeCoordinates(theta, phi, cosine), np.asarray(theta_o > lowest)
    incidence = np.full_like(theta, side.incidence[node])
    theta_o, phi_o = coordinates.outgoing(side.about, incidence, theta, phi)
    below = theta_o > side.horizon[node]
    if clamped:
        cosine = np.maximum(cosine, np.cos(np.radians(side.horizon[node])))
        theta, phi = theta.copy(), phi.copy()
        lowest = np.full(int(below.sum()), side.horizon[node])
        theta[below], phi[below] = coordinates.angles(side.about, incidence[below], lowest, phi_o[below])
    return LobeCoordinates(theta, phi, cosine), below

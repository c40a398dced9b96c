"""One side of a measured BSDF: sums of functions at a few incidences (nodes), interpolated between them at equal ϑ and φ.

Linearly in the abscissa x = −ln cos σ: the light of facets grows with powers of 1/cos σ, and near normal incidence x is σ²/2, even in σ.
Coefficients of cos kφ with odd k are odd in σ and interpolated in √x. Beyond the last node, and below the lowest measured direction, the BSDF
is constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured import coordinates, node_kernel
from brdfpipe.bsdf.measured.basis import Basis, PSpline
from brdfpipe.bsdf.measured.node_arrays import Covariances, Nodes
from brdfpipe.bsdf.measured.node_kernel import ERROR_SCALE
from brdfpipe.geometry import Array

TINY = 1e-30

MARGIN = float(np.log(2.0))
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
    path_error: PathError | None
    """None where the two directions of light are not averaged."""

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
            PathError.of(bsdf) if averaged else None,
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
    def arrays(self) -> Nodes | None:
        """For :mod:`~brdfpipe.bsdf.measured.node_kernel`; None unless a logarithm was fitted with P-splines."""
        return Nodes.of(self, self.basis, MARGIN) if self.logarithmic and isinstance(self.basis, PSpline) else None

    @cached_property
    def covariances(self) -> Covariances | None:
        """The same; None also where incidences were measured at some wavelengths alone."""
        return Covariances.of(self, self.basis) if self.arrays and isinstance(self.basis, PSpline) else None


class PathError(NamedTuple):
    """Standard uncertainty of the logarithm of the BSDF in one direction of light; linear in its coordinates, constant beyond their ends."""

    theta_i: Array  # (incidence,) radian, rising
    t: Array  # (angle,) asinh of ϑ over :data:`ERROR_SCALE`, rising
    cosine: Array  # (azimuth,) cos φ, rising
    error: Array  # (incidence, angle, azimuth)

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> PathError:
        """Of a dataset of kind ``bsdf``."""
        field = bsdf["incidence_error"].sortby("error_azimuth", ascending=False)
        return cls(
            np.radians(field["theta_i"].values),
            np.arcsinh(field["error_angle"].values / ERROR_SCALE),
            np.cos(np.radians(field["error_azimuth"].values)),
            np.ascontiguousarray(field.values, dtype=float),
        )

    def at(self, theta_i: Array, lobe: LobeCoordinates) -> Array:
        """Interpolated, of the shape of the angles [degree]."""
        from scipy.interpolate import RegularGridInterpolator

        axes = self.theta_i, self.t, self.cosine
        places = np.radians(theta_i), np.arcsinh(lobe.theta / ERROR_SCALE), np.cos(np.radians(lobe.phi))
        inside = [np.clip(place, axis[0], axis[-1]) for place, axis in zip(places, axes, strict=True)]
        return np.asarray(RegularGridInterpolator(axes, self.error)(np.stack(np.broadcast_arrays(*inside), axis=-1)))


class PathDirection(NamedTuple):
    """Pairs of directions for light that takes their paths in one direction, and the weight of that direction."""

    theta_i: Array
    theta_o: Array
    phi: Array
    weight: Array
    error: Array
    """Standard uncertainty of the logarithm in this direction, as of :class:`PathError`; 0 without averaging"""


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
    pairs: NDArray[np.int64]  # which pairs
    even: Array  # weight of functions even in σ, the weight of the path direction included
    odd: Array  # weight of functions odd in σ; that of the even ones where no logarithm was fitted
    coordinates: LobeCoordinates


def interpolation_abscissa(theta_i: Array | float) -> Array:
    """x = −ln cos θ_i of angles [degree], in which incidences are interpolated."""
    return -np.log(np.cos(np.radians(np.minimum(theta_i, 89.999999))))


def path_directions(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> list[PathDirection]:
    """The two directions of light along a path; the sum of their weights is 1. One direction if they are not averaged."""
    one_way = PathDirection(theta_i, theta_o, phi, np.ones(np.shape(theta_i)), np.zeros(np.shape(theta_i)))
    if side.path_error is None:
        return [one_way]
    paths = [one_way, PathDirection(theta_o, theta_i, -phi, one_way.weight, one_way.error)]
    forward, backward = (side.path_error.at(path.theta_i, lobe_coordinates(side, path)) for path in paths)
    weight = backward**2 / (forward**2 + backward**2)
    return [
        path._replace(weight=share, error=error)
        for path, share, error in zip(paths, (weight, 1 - weight), (forward, backward), strict=True)
    ]


def side_values(side: Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """BSDF (directions, wavelength)."""
    if side.arrays:
        return node_kernel.values(side.arrays, theta_i, theta_o, phi)
    return path_values(side, path_directions(side, theta_i, theta_o, phi))


def path_values(side: Side, paths: list[PathDirection]) -> Array:
    """BSDF averaged over path directions, (directions, wavelength)."""
    shape = (*np.shape(paths[0].theta_i), side.coefficient.shape[1])
    total, geometric, positive = np.zeros(shape), np.zeros(shape), np.ones(shape, dtype=bool)
    low, high = np.zeros(shape), np.zeros(shape)
    for part in node_contributions(side, paths):
        pairs, even = part.pairs, part.even[..., None]
        if side.logarithmic:
            total[pairs] += side.basis.sums(side.coefficient[part.node].T, *part.coordinates, part.even, part.odd)
            low[pairs] += even * side.lowest[part.node]
            high[pairs] += even * side.highest[part.node]
            continue
        one = np.ones(np.shape(part.even))
        value = side.basis.sums(side.coefficient[part.node].T, *part.coordinates, one, one)
        total[pairs] += even * value
        geometric[pairs] += even * np.log(np.maximum(value, TINY))
        positive[pairs] &= (value > 0) | (even == 0)
    if side.logarithmic:
        return np.exp(np.minimum(np.maximum(total, low - MARGIN), high + MARGIN))
    return np.where(positive, np.exp(geometric), np.maximum(total, 0.0))


def node_contributions(side: Side, paths: list[PathDirection]) -> Iterator[NodeContribution]:
    """The contribution of each node to the directions next to it, for each path direction."""
    for path in paths:
        lobe = lobe_coordinates(side, path)
        for node in _nodes_beside(side, path.theta_i):
            even, odd = (weight * path.weight for weight in node_weights(side, node, path.theta_i))
            pairs = np.flatnonzero((even > 0) | (odd > 0))
            if pairs.size:
                at_node, _ = coordinates_at_node(side, node, lobe.select(pairs))
                yield NodeContribution(node, pairs, even[pairs], (odd if side.logarithmic else even)[pairs], at_node)


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
    incidence = np.full_like(theta, side.incidence[node])
    theta_o, phi_o = coordinates.outgoing(side.about, incidence, theta, phi)
    below = theta_o > side.horizon[node]
    if clamped:
        cosine = np.maximum(cosine, np.cos(np.radians(side.horizon[node])))
        theta, phi = theta.copy(), phi.copy()
        lowest = np.full(int(below.sum()), side.horizon[node])
        theta[below], phi[below] = coordinates.angles(side.about, incidence[below], lowest, phi_o[below])
    return LobeCoordinates(theta, phi, cosine), below

"""Adaptive cubature over the sphere: rectangles of polar angle and azimuth that are halved where the error is large.

A smooth function of direction is smooth in these coordinates, at the pole too. All cells of a round, of all incidences, are evaluated
together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

Indices: TypeAlias = NDArray[np.intp]

Integrand: TypeAlias = Callable[[Indices, Array, Array], Array]
"""Values (points, wavelength) from the index of the incidence, θ_o and φ_o [degree] of each point, (points,) each."""

HALVINGS = 17
"""Of cells towards the mirror direction: down to 0.001 degree."""

_STEP_THETA, _STEP_PHI = 7.5, 15.0
_MOST_VALUES = 2_000_000
"""Values that are evaluated at a time, to limit memory."""
_ABSOLUTE_ERROR, _MOST_ROUNDS, _MOST_CELLS = 1e-12, 40, 40_000


class Estimate(NamedTuple):
    """Estimates for cells."""

    value: Array
    """(cells, wavelength)"""
    error: Array
    """(cells, wavelength), >= 0"""
    axis: Indices
    """(cells,) along which to halve: 0 for θ, 1 for φ"""


Rule: TypeAlias = Callable[[Indices, Array, Array], Estimate]
"""From owner, low and high of cells to their estimates."""


@dataclass(frozen=True)
class Mesh:
    """A binary tree of cells."""

    owner: Indices
    """(cells,) index of the incidence"""
    low: Array
    """(cells, 2) smallest θ and φ [degree]"""
    high: Array
    """(cells, 2) largest θ and φ [degree]"""
    value: Array
    error: Array
    axis: Indices
    child: Indices
    """(cells,) index of the first of the two halves, which is followed by the second; -1 for a leaf"""

    @property
    def leaves(self) -> Indices:
        return np.flatnonzero(self.child < 0)

    def totals(self, field: Array, owners: int) -> Array:
        """Sums over the leaves of each incidence, (owners, wavelength)."""
        sums = np.zeros((owners, field.shape[1]))
        np.add.at(sums, self.owner[self.leaves], field[self.leaves])
        return sums

    def leaf_of(self, root: Indices, theta: Array, phi: Array) -> Indices:
        """The leaf that contains each direction, from the root cell that contains it."""
        cell, at = root.copy(), np.stack([theta, phi], axis=-1)
        inner = np.flatnonzero(self.child[cell] >= 0)
        while inner.size:
            parent = cell[inner]
            axis, first = self.axis[parent], self.child[parent]
            cell[inner] = first + (at[inner, axis] >= self.low[first + 1, axis])
            inner = inner[self.child[cell[inner]] >= 0]
        return cell


def graded(peaks: Array, low: float, high: float, step: float, halvings: int = HALVINGS) -> Array:
    """Edges on ``[low, high]`` [degree], at most ``step`` apart and with distances that halve towards each peak."""
    offsets = (high - low) * 0.5 ** np.arange(halvings + 1)
    dense = (peaks[:, None] + np.concatenate([-offsets, [0.0], offsets])).ravel()
    regular = np.linspace(low, high, 1 + round((high - low) / step))
    edges = np.concatenate([regular, dense[(dense > low) & (dense < high)]])
    edges = np.unique(np.round(edges, 9))
    # Narrow cells between a regular and a graded edge cost time and resolve nothing.
    keep = np.concatenate([[True], np.diff(edges) > 0.4 * offsets[-1]])
    keep[-1] = True
    return edges[keep]


def theta_edges(peaks: Array, below: bool, halvings: int = HALVINGS) -> Array:
    """Polar edges of one hemisphere, graded towards peaks."""
    low = 90.0 if below else 0.0
    return graded(peaks, low, low + 90, _STEP_THETA, halvings)


def phi_edges(centre: float, halvings: int = HALVINGS) -> Array:
    """Azimuths of a full turn, graded towards its centre."""
    return graded(np.array([centre]), centre - 180, centre + 180, _STEP_PHI, halvings)


def rectangles(theta: Array, phi: Array) -> tuple[Array, Array]:
    """Lower and upper corners (cells, 2) of all rectangles between the edges, φ fastest."""
    low = np.stack(np.meshgrid(theta[:-1], phi[:-1], indexing="ij"), axis=-1).reshape(-1, 2)
    high = np.stack(np.meshgrid(theta[1:], phi[1:], indexing="ij"), axis=-1).reshape(-1, 2)
    return low, high


def refine(start: tuple[Indices, Array, Array], rule: Rule, relative: float) -> Mesh:
    """Halve cells until the sum of their errors is small enough for each incidence.

    Parameters
    ----------
    start : owner, low and high of the first cells
    relative : largest error over the total at any wavelength

    Notes
    -----
    In each round all cells are halved except those with the smallest errors, whose sum is below half of the limit. The refinement ends
    after 40 rounds, or with 40 000 new cells for each incidence.
    """
    owner, low, high = start
    owners = int(owner.max()) + 1
    mesh = Mesh(owner, low, high, *rule(owner, low, high), np.full(owner.size, -1))
    for _ in range(_MOST_ROUNDS):
        limit = relative * np.abs(mesh.totals(mesh.value, owners)) + _ABSOLUTE_ERROR
        cells = _inaccurate_leaves(mesh, limit)
        if cells.size == 0 or mesh.owner.size - owner.size > _MOST_CELLS * owners:
            break
        mesh = _halve(mesh, cells, rule)
    return mesh


def _inaccurate_leaves(mesh: Mesh, limit: Array) -> Indices:
    leaves = mesh.leaves
    error = (mesh.error[leaves] / limit[mesh.owner[leaves]]).max(axis=1)
    order = np.lexsort((error, mesh.owner[leaves]))
    leaves, error, owner = leaves[order], error[order], mesh.owner[leaves][order]
    running = np.cumsum(error)
    first = np.searchsorted(owner, np.arange(limit.shape[0] + 1))
    before = np.concatenate([[0.0], running])[first]
    cumulative, total = running - before[owner], (before[1:] - before[:-1])[owner]
    return leaves[(cumulative > 0.5) & (total > 1)]


def _halve(mesh: Mesh, cells: Indices, rule: Rule) -> Mesh:
    axis = mesh.axis[cells]
    low, high = mesh.low[cells].repeat(2, axis=0), mesh.high[cells].repeat(2, axis=0)
    first = 2 * np.arange(cells.size)
    middle = (mesh.low[cells, axis] + mesh.high[cells, axis]) / 2
    high[first, axis] = middle
    low[first + 1, axis] = middle
    owner = mesh.owner[cells].repeat(2)
    child = mesh.child.copy()
    child[cells] = mesh.owner.size + first
    old = (mesh.owner, mesh.low, mesh.high, mesh.value, mesh.error, mesh.axis, child)
    new = (owner, low, high, *rule(owner, low, high), np.full(owner.size, -1))
    return Mesh(*(np.concatenate(fields) for fields in zip(old, new, strict=True)))


def _in_parts(rule: Rule, points: int, wavelengths: int) -> Rule:
    """The same rule, on as many cells at a time as memory allows."""
    size = max(1, _MOST_VALUES // (points * wavelengths))

    def parts(owner: Indices, low: Array, high: Array) -> Estimate:
        starts = range(0, owner.size, size)
        estimates = [rule(owner[k : k + size], low[k : k + size], high[k : k + size]) for k in starts]
        return Estimate(*(np.concatenate(fields) for fields in zip(*estimates, strict=True)))

    return parts


# --- the integral over a cell and its error: Genz & Malik 1980 (J. Comput. Appl. Math. 6), degree 7 with embedded degree 5

_NEAR, _FAR, _INNER = np.sqrt(9 / 70), np.sqrt(9 / 10), np.sqrt(9 / 19)
_SIGNS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
_AXES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_GENZ_MALIK = np.concatenate([np.zeros((1, 2)), _NEAR * _AXES, _FAR * _AXES, _FAR * _SIGNS, _INNER * _SIGNS])
_DEGREE_7 = np.repeat(np.array([-3816, 2940, 1020, 200, 6859 / 4]) / 19683, [1, 4, 4, 4, 4])
_DEGREE_5 = np.repeat(np.array([-971 / 729, 245 / 486, 65 / 1458, 25 / 729, 0.0]), [1, 4, 4, 4, 4])


def integral(integrand: Integrand, wavelengths: int = 1) -> Rule:
    """Rule for ∫ f |cos θ| dω over cells."""

    def rule(owner: Indices, low: Array, high: Array) -> Estimate:
        values = _at(_GENZ_MALIK, integrand, owner, low, high)
        return _genz_malik(values, np.prod(np.radians(high - low), axis=1), low, high)

    return _in_parts(rule, len(_GENZ_MALIK), wavelengths)


def plane_integral(integrand: Integrand) -> Rule:
    """Rule for ∫ f dx dy over cells of a plane; the integrand takes x and y, in any unit, in place of directions."""

    def rule(owner: Indices, low: Array, high: Array) -> Estimate:
        points = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * _GENZ_MALIK
        values = integrand(owner.repeat(len(_GENZ_MALIK)), points[..., 0].ravel(), points[..., 1].ravel())
        return _genz_malik(values.reshape(*points.shape[:2], -1), np.prod(high - low, axis=1), low, high)

    return _in_parts(rule, len(_GENZ_MALIK), 1)


def _genz_malik(values: Array, area: Array, low: Array, high: Array) -> Estimate:
    """Integrals over cells from values at their nodes, (cells, nodes, wavelength)."""
    fine = np.einsum("p,cpw->cw", _DEGREE_7, values) * area[:, None]
    coarse = np.einsum("p,cpw->cw", _DEGREE_5, values) * area[:, None]
    centre, ratio = 2 * values[:, 0], (_NEAR / _FAR) ** 2

    def fourth_difference(first: int) -> Array:
        near, far = (values[:, [k, k + 1]].sum(axis=1) - centre for k in (first, first + 4))
        return np.abs(near - ratio * far).max(axis=1)

    along_first, along_second = fourth_difference(1), fourth_difference(3)
    wide = (high - low)[:, 1] > (high - low)[:, 0]
    tie = np.isclose(along_first, along_second, rtol=1e-3)
    axis = np.where(tie, wide, along_second > along_first).astype(np.intp)
    return Estimate(fine, np.abs(fine - coarse), axis)


def _at(nodes: Array, integrand: Integrand, owner: Indices, low: Array, high: Array) -> Array:
    """f |cos θ| sin θ at nodes of cells, (cells, nodes, wavelength)."""
    points = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * nodes
    theta, phi = points[..., 0], points[..., 1]
    values = integrand(owner.repeat(len(nodes)), theta.ravel(), phi.ravel())
    jacobian = np.abs(np.cos(np.radians(theta))) * np.sin(np.radians(theta))
    return values.reshape(*theta.shape, -1) * jacobian[..., None]


# --- the best constant density over a cell

_ORDER = 3


def solid_angle(low: Array, high: Array) -> Array:
    """Solid angle of cells [sr], without cancellation for narrow cells."""
    middle, half = np.radians(low + high)[:, 0] / 2, np.radians(high - low)[:, 0] / 2
    return np.asarray(2 * np.sin(middle) * np.sin(half) * np.radians(high - low)[:, 1])


def constant(integrand: Integrand, wavelengths: int = 1) -> Rule:
    """Rule for the solid angle times the rms of g = mean over wavelength of f |cos θ|; its error is that times rms − mean.

    Cells drawn in proportion to that value, with uniform directions inside, have the smallest variance of all densities that are
    constant in each cell: with S the sum of the values, the weights g / pdf have the mean square S².
    """
    unit, weight = panel_rule([-1.0, 1.0], _ORDER)
    nodes = np.stack(np.meshgrid(unit, unit, indexing="ij"), axis=-1).reshape(-1, 2)
    product = np.outer(weight, weight).ravel()

    def rule(owner: Indices, low: Array, high: Array) -> Estimate:
        weighted = _at(nodes, integrand, owner, low, high).mean(axis=2)
        theta = np.radians((low + high)[:, :1] / 2 + (high - low)[:, :1] / 2 * nodes[:, 0])
        share = product * np.sin(theta)
        share /= share.sum(axis=1, keepdims=True)
        g = np.maximum(weighted / np.sin(theta), 0.0)
        mean, rms = (share * g).sum(axis=1), np.sqrt((share * g * g).sum(axis=1))
        size = solid_angle(low, high)
        square = g.reshape(-1, _ORDER, _ORDER)
        axis = (square.mean(axis=1).std(axis=1) > square.mean(axis=2).std(axis=1)).astype(np.intp)
        return Estimate((size * rms)[:, None], (size * np.maximum(rms - mean, 0.0))[:, None], axis)

    return _in_parts(rule, len(nodes), wavelengths)

"""Adaptive cells of the sphere: rectangles of polar angle and azimuth, halved where a function needs it.

In these coordinates every smooth function of direction is smooth, at the pole too; the solid angle carries the sine. All cells
of a round, of all incidences, are evaluated together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

Indices: TypeAlias = NDArray[np.intp]

Integrand: TypeAlias = Callable[[Indices, Array, Array], Array]
"""Values (points, wavelength) from the incidence each point belongs to (points,), its θ_o and φ_o [degree, (points,)]."""

_DOUBLINGS = 17
_EVERY_THETA, _EVERY_PHI = 7.5, 15.0
_MOST_VALUES = 2_000_000


class Rule(NamedTuple):
    """What a rule says of cells."""

    value: Array
    """(cells, wavelength)"""
    error: Array
    """(cells, wavelength), >= 0"""
    axis: Indices
    """(cells,) 0 where halving θ helps most, 1 where halving φ does"""


@dataclass(frozen=True)
class Mesh:
    """Cells and, of those that were halved, what became of them."""

    owner: Indices
    """(cells,) the incidence a cell belongs to"""
    low: Array
    """(cells, 2) smallest θ and φ [degree]"""
    high: Array
    """(cells, 2) largest θ and φ [degree]"""
    value: Array
    error: Array
    axis: Indices
    child: Indices
    """(cells,) the first of the two halves, which lie next to each other; -1 for a leaf"""

    @property
    def leaves(self) -> Indices:
        return np.flatnonzero(self.child < 0)

    def totals(self, field: Array, owners: int) -> Array:
        """Sums over the leaves of each incidence, (owners, wavelength)."""
        sums = np.zeros((owners, field.shape[1]))
        np.add.at(sums, self.owner[self.leaves], field[self.leaves])
        return sums

    def leaf_of(self, root: Indices, theta: Array, phi: Array) -> Indices:
        """The leaf that holds each direction, from the starting cell that does."""
        cell, at = root.copy(), np.stack([theta, phi], axis=-1)
        inside = np.flatnonzero(self.child[cell] >= 0)
        while inside.size:
            parent = cell[inside]
            axis, first = self.axis[parent], self.child[parent]
            cell[inside] = first + (at[inside, axis] >= self.low[first + 1, axis])
            inside = inside[self.child[cell[inside]] >= 0]
        return cell


def graded(peaks: Array, low: float, high: float, every: float) -> Array:
    """Edges on ``[low, high]`` [degree], no further apart than ``every`` and halving in distance towards each peak."""
    reach = (high - low) * 0.5 ** np.arange(_DOUBLINGS + 1)
    about = (peaks[:, None] + np.concatenate([-reach, [0.0], reach])).ravel()
    regular = np.linspace(low, high, 1 + round((high - low) / every))
    edges = np.concatenate([regular, about[(about > low) & (about < high)]])
    edges = np.unique(np.round(edges, 9))
    # A sliver between an edge and a peak's costs cells and resolves nothing.
    keep = np.concatenate([[True], np.diff(edges) > 0.4 * reach[-1]])
    keep[-1] = True
    return edges[keep]


def theta_edges(peaks: Array, below: bool) -> Array:
    """Polar edges of one hemisphere, graded towards the peaks that lie in it or near."""
    low = 90.0 if below else 0.0
    return graded(peaks, low, low + 90, _EVERY_THETA)


def phi_edges(centre: float) -> Array:
    """Azimuths of a full turn that ends opposite to ``centre``, graded towards it."""
    return graded(np.array([centre]), centre - 180, centre + 180, _EVERY_PHI)


def rectangles(theta: Array, phi: Array) -> tuple[Array, Array]:
    """Lower and upper corners (cells, 2) of all rectangles between the edges, φ fastest."""
    low = np.stack(np.meshgrid(theta[:-1], phi[:-1], indexing="ij"), axis=-1).reshape(-1, 2)
    high = np.stack(np.meshgrid(theta[1:], phi[1:], indexing="ij"), axis=-1).reshape(-1, 2)
    return low, high


def refine(
    start: tuple[Indices, Array, Array],
    rule: Callable[[Indices, Array, Array], Rule],
    relative: float,
    *,
    absolute: float = 1e-12,
    rounds: int = 40,
    most: int = 40_000,
) -> Mesh:
    """Halve cells until the errors of each incidence add up to less than wanted.

    Parameters
    ----------
    start : owner, low and high of the first cells
    rule : what to know of cells from their owner, low and high
    relative, absolute : the error wanted, as a share of the total and in itself, at every wavelength
    rounds, most : when to stop nevertheless: after so many rounds, or with so many new cells an incidence

    Notes
    -----
    In each round every cell is halved but those with the least errors, which together stay below half of what is allowed.
    """
    owner, low, high = start
    found = rule(owner, low, high)
    owners = int(owner.max()) + 1
    mesh = Mesh(owner, low, high, *found, np.full(owner.size, -1))
    for _ in range(rounds):
        allowed = relative * np.abs(mesh.totals(mesh.value, owners)) + absolute
        halved = _to_halve(mesh, allowed)
        if halved.size == 0 or mesh.owner.size - owner.size > most * owners:
            break
        mesh = _halve(mesh, halved, rule)
    return mesh


def _to_halve(mesh: Mesh, allowed: Array) -> Indices:
    leaves = mesh.leaves
    share = (mesh.error[leaves] / allowed[mesh.owner[leaves]]).max(axis=1)
    order = np.lexsort((share, mesh.owner[leaves]))
    leaves, share, owner = leaves[order], share[order], mesh.owner[leaves][order]
    running = np.cumsum(share)
    first = np.searchsorted(owner, np.arange(allowed.shape[0] + 1))
    before = np.concatenate([[0.0], running])[first]
    left, total = running - before[owner], (before[1:] - before[:-1])[owner]
    return leaves[(left > 0.5) & (total > 1)]


def _halve(mesh: Mesh, cells: Indices, rule: Callable[[Indices, Array, Array], Rule]) -> Mesh:
    axis = mesh.axis[cells]
    low, high = mesh.low[cells].repeat(2, axis=0), mesh.high[cells].repeat(2, axis=0)
    first = 2 * np.arange(cells.size)
    middle = (mesh.low[cells, axis] + mesh.high[cells, axis]) / 2
    high[first, axis] = middle
    low[first + 1, axis] = middle
    owner = mesh.owner[cells].repeat(2)
    found = rule(owner, low, high)
    child = mesh.child.copy()
    child[cells] = mesh.owner.size + first
    return replace(
        mesh,
        owner=np.concatenate([mesh.owner, owner]),
        low=np.concatenate([mesh.low, low]),
        high=np.concatenate([mesh.high, high]),
        value=np.concatenate([mesh.value, found.value]),
        error=np.concatenate([mesh.error, found.error]),
        axis=np.concatenate([mesh.axis, found.axis]),
        child=np.concatenate([child, np.full(owner.size, -1)]),
    )


def _in_parts(rule: Callable[[Indices, Array, Array], Rule], points: int, wavelengths: int) -> Callable[..., Rule]:
    """The same rule, on no more cells at a time than memory likes."""
    size = max(1, _MOST_VALUES // (points * wavelengths))

    def parts(owner: Indices, low: Array, high: Array) -> Rule:
        starts = range(0, owner.size, size)
        found = [rule(owner[k : k + size], low[k : k + size], high[k : k + size]) for k in starts]
        return Rule(*(np.concatenate(fields) for fields in zip(*found, strict=True)))

    return parts


# --- the integral over a cell, with an error: Genz & Malik 1980 (J. Comput. Appl. Math. 6), degree 7 with embedded degree 5

_NEAR, _FAR, _INNER = np.sqrt(9 / 70), np.sqrt(9 / 10), np.sqrt(9 / 19)
_SIGNS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
_AXES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_GENZ_MALIK = np.concatenate([np.zeros((1, 2)), _NEAR * _AXES, _FAR * _AXES, _FAR * _SIGNS, _INNER * _SIGNS])
_DEGREE_7 = np.repeat(np.array([-3816, 2940, 1020, 200, 6859 / 4]) / 19683, [1, 4, 4, 4, 4])
_DEGREE_5 = np.repeat(np.array([-971 / 729, 245 / 486, 65 / 1458, 25 / 729, 0.0]), [1, 4, 4, 4, 4])


def integral(integrand: Integrand, wavelengths: int = 1) -> Callable[..., Rule]:
    """Rule for ∫ f |cos θ| dω over cells."""

    def rule(owner: Indices, low: Array, high: Array) -> Rule:
        values = _at(_GENZ_MALIK, integrand, owner, low, high)
        area = np.prod(np.radians(high - low), axis=1)[:, None]
        fine = np.einsum("p,cpw->cw", _DEGREE_7, values) * area
        coarse = np.einsum("p,cpw->cw", _DEGREE_5, values) * area
        centre = 2 * values[:, :1]
        ratio = (_NEAR / _FAR) ** 2
        along_theta, along_phi = (
            np.abs(
                values[:, [k, k + 1]].sum(axis=1)
                - centre[:, 0]
                - ratio * (values[:, [k + 4, k + 5]].sum(axis=1) - centre[:, 0])
            ).max(axis=1)
            for k in (1, 3)
        )
        wide = (high - low)[:, 1] > (high - low)[:, 0]
        tie = np.isclose(along_theta, along_phi, rtol=1e-3)
        axis = np.where(tie, wide, along_phi > along_theta).astype(np.intp)
        return Rule(fine, np.abs(fine - coarse), axis)

    return _in_parts(rule, len(_GENZ_MALIK), wavelengths)


def _at(nodes: Array, integrand: Integrand, owner: Indices, low: Array, high: Array) -> Array:
    """f |cos θ| sin θ at nodes of cells, (cells, nodes, wavelength)."""
    points = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * nodes
    theta, phi = points[..., 0], points[..., 1]
    values = integrand(owner.repeat(len(nodes)), theta.ravel(), phi.ravel())
    jacobian = np.abs(np.cos(np.radians(theta))) * np.sin(np.radians(theta))
    return values.reshape(*theta.shape, -1) * jacobian[..., None]


# --- how well one constant stands for f |cos θ| over a cell

_ORDER = 3


def solid_angle(low: Array, high: Array) -> Array:
    """Solid angle of cells [sr], to the last digit of narrow ones too."""
    middle, half = np.radians(low + high)[:, 0] / 2, np.radians(high - low)[:, 0] / 2
    return np.asarray(2 * np.sin(middle) * np.sin(half) * np.radians(high - low)[:, 1])


def constant(integrand: Integrand, wavelengths: int = 1) -> Callable[..., Rule]:
    """Rule that gives each cell the solid angle times the rms of g = mean over wavelength of f |cos θ|; the error is rms − mean.

    Drawing cells in proportion to that value, and directions evenly inside, has the least variance that a constant a cell allows:
    with S its sum and I the integral of g, the weights g / pdf have the mean square S².
    """
    unit, weight = panel_rule([-1.0, 1.0], _ORDER)
    nodes = np.stack(np.meshgrid(unit, unit, indexing="ij"), axis=-1).reshape(-1, 2)
    product = np.outer(weight, weight).ravel()

    def rule(owner: Indices, low: Array, high: Array) -> Rule:
        weighted = _at(nodes, integrand, owner, low, high).mean(axis=2)
        theta = np.radians((low + high)[:, :1] / 2 + (high - low)[:, :1] / 2 * nodes[:, 0])
        share = product * np.sin(theta)
        share /= share.sum(axis=1, keepdims=True)
        g = np.maximum(weighted / np.sin(theta), 0.0)
        mean, rms = (share * g).sum(axis=1), np.sqrt((share * g * g).sum(axis=1))
        size = solid_angle(low, high)
        square = g.reshape(-1, _ORDER, _ORDER)
        axis = (square.mean(axis=1).std(axis=1) > square.mean(axis=2).std(axis=1)).astype(np.intp)
        return Rule((size * rms)[:, None], (size * np.maximum(rms - mean, 0.0))[:, None], axis)

    return _in_parts(rule, len(nodes), wavelengths)

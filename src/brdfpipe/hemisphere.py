"""Quadrature over intervals, the hemisphere and apertures."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@cache
def _gauss_legendre(order: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return (nodes + 1) / 2, weights / 2


def panel_rule(edges: ArrayLike, order: int) -> tuple[Array, Array]:
    """Composite Gauss–Legendre rule.

    Parameters
    ----------
    edges : (..., panels + 1), increasing along the last axis; panels of width zero weigh nothing
    order : points in each panel

    Returns
    -------
    nodes, weights : (..., panels · order)
    """
    edges = np.asarray(edges, dtype=float)
    unit_nodes, unit_weights = _gauss_legendre(order)
    width = np.diff(edges, axis=-1)[..., None]
    nodes = edges[..., :-1, None] + width * unit_nodes
    weights = np.broadcast_to(width * unit_weights, nodes.shape)
    shape = (*nodes.shape[:-2], nodes.shape[-2] * order)
    return nodes.reshape(shape), weights.reshape(shape)


def graded_edges(centre: ArrayLike, scale: ArrayLike, low: float, high: float, steps: int = 8) -> Array:
    """Panel edges on ``[low, high]`` that double in width away from a peak, so that a rule resolves its core and its tails.

    Parameters
    ----------
    centre : (...) where the peak lies; may lie outside the interval
    scale : (...) half width of the peak
    low, high : the interval
    steps : doublings on each side, starting from half the scale

    Returns
    -------
    edges : (..., 2 · steps + 3), from ``low`` to ``high``
    """
    centre, scale = np.broadcast_arrays(np.asarray(centre, dtype=float), np.asarray(scale, dtype=float))
    reach = 0.5 * 2.0 ** np.arange(steps)
    offsets = np.concatenate([-reach[::-1], [0.0], reach])
    edges = centre[..., None] + scale[..., None] * offsets
    edges = np.concatenate([np.full((*centre.shape, 1), low), edges, np.full((*centre.shape, 1), high)], axis=-1)
    return np.clip(edges, low, high)


class Directions(NamedTuple):
    """Directions of a quadrature over the upper hemisphere, with projected solid angles."""

    theta: Array
    phi: Array
    weight: Array
    """cosθ dω of each direction [sr]; sums to π."""


def around_mirror(theta_i: float, order: int = 8, steps: int = 10, finest: float = 0.02) -> Directions:
    """A hemisphere rule graded towards the mirror direction of incidence (theta_i, 0).

    Panels in θ and φ double in width away from (theta_i, 180): lobes down to ``finest`` degree are resolved while the whole
    hemisphere is covered. The integrand must be even in φ.
    """
    doublings = int(np.ceil(np.log2(90 / finest)))
    theta_edges = graded_edges(theta_i, finest, 0.0, 90.0, max(steps, doublings))
    theta, theta_weight = panel_rule(np.radians(theta_edges), order)
    phi_edges = graded_edges(180.0, finest, 0.0, 180.0, max(steps, doublings + 1))
    phi, phi_weight = panel_rule(np.radians(phi_edges), order)
    keep_theta, keep_phi = theta_weight > 0, phi_weight > 0
    theta, theta_weight, phi, phi_weight = (
        theta[keep_theta],
        theta_weight[keep_theta],
        phi[keep_phi],
        phi_weight[keep_phi],
    )
    weight = 2 * (theta_weight * np.sin(theta) * np.cos(theta))[:, None] * phi_weight
    theta_grid, phi_grid = np.broadcast_arrays(np.degrees(theta)[:, None], np.degrees(phi))
    return Directions(theta_grid.ravel(), phi_grid.ravel(), weight.ravel())

"""Quadrature over intervals, the hemisphere and apertures."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_LEAST_COSINE = 1e-4
"""Cosine of incidence below which a lobe is not resolved further."""
_PANEL_GROWTH = 0.7
"""Step between the panels of a lobe with a lay, in asinh of the angle over the lobe's width."""
_RULES_KEPT = 64
"""Rules about mirror directions that are kept for whoever asks for the same, 40 to 120 kB each."""


@cache
def _gauss_legendre(order: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return (nodes + 1) / 2, weights / 2


def panel_rule(edges: ArrayLike, order: int) -> tuple[Array, Array]:
    """Composite Gauss–Legendre rule.

    Parameters
    ----------
    edges : (..., panels + 1), increasing along the last axis; panels of zero width are allowed
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
    """Panel edges on ``[low, high]`` that double in width away from a peak, to resolve its core and its tails.

    Parameters
    ----------
    centre : (...) position of the peak, also outside the interval
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


def azimuths(isotropic: bool) -> Array:
    """Azimuths of incidence over which a BSDF is averaged [degree]: one if it is isotropic, else eight."""
    return np.arange(0.0, 360.0, 360.0 if isotropic else 45.0)


class Directions(NamedTuple):
    """Directions of a quadrature over the upper hemisphere, with projected solid angles."""

    theta: Array
    phi: Array
    weight: Array
    """cosθ dω of each direction [sr]; sums to π."""


@lru_cache(maxsize=_RULES_KEPT)
def around_mirror(
    theta_i: float, slope: float, half_angle: float = 180.0, order: int = 6, turns: int = 24
) -> Directions:
    """A rule over the hemisphere, or a cone, about the mirror direction of incidence (theta_i, 0).

    Parameters
    ----------
    theta_i : degree
    slope : typical slope of the facets: the lobe the rule must resolve, from a quarter of it outwards
    half_angle : of the cone, degree; 180 for the whole hemisphere
    order, turns : points in each of the panels along the radius, which double in width, and in half a turn

    Notes
    -----
    Along each ring the rule covers exactly the part above the horizon.
    The integrand must be even about the plane of incidence. The same arguments give the same arrays, which cannot be changed.
    """
    reach = np.radians(half_angle)
    doublings = int(np.clip(np.ceil(np.log2(8 * reach / slope)), 4, 40))
    mirror = np.radians(theta_i)
    # Rings meet the horizon first at 90° − θ_i and last at 90° + θ_i, there like a square root: panels crowd towards both.
    near = (0.25 ** np.arange(1, 7))[:, None]
    first, last = np.pi / 2 - mirror, np.pi / 2 + mirror
    crowded = [first, last, *(first + (last - first) * near).ravel(), *(last - (last - first) * near).ravel()]
    edges = np.concatenate([[0.0], reach * 2.0 ** np.arange(-doublings, 1), crowded])
    radius, radius_weight = panel_rule(np.unique(edges[edges <= reach]), order)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.cos(radius) * np.cos(mirror) / (np.sin(radius) * np.sin(mirror))
    start = np.arccos(np.clip(np.nan_to_num(limit, nan=1.0, posinf=1.0, neginf=-1.0), -1.0, 1.0))
    turn, turn_weight = panel_rule(np.stack([start, np.full_like(start, np.pi)], axis=-1), turns)
    r = radius[:, None]
    outwards = np.sin(r) * np.cos(turn)
    x = -(np.cos(r) * np.sin(mirror) + outwards * np.cos(mirror))
    z = np.cos(r) * np.cos(mirror) - outwards * np.sin(mirror)
    y = np.sin(r) * np.sin(turn)
    weight = 2 * radius_weight[:, None] * turn_weight * np.sin(r) * np.maximum(z, 0.0)
    theta, phi = np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))
    above = (weight > 0) & (theta < 90)
    rule = Directions(theta[above], phi[above], weight[above])
    for part in rule:
        part.flags.writeable = False
    return rule


def around_mirror_with_lay(
    theta_i: float, phi_i: float, along: float, across: float, lay: float, order: int = 6
) -> Directions:
    """A rule over the hemisphere for the lobe of a surface with a lay, also where that is long and narrow.

    Parameters
    ----------
    theta_i, phi_i : of the incident light, degree
    along, across : typical slopes along the lay and across it: the lobe the rule must resolve
    lay : azimuth, degree
    order : points in each panel

    Notes
    -----
    Directions are sin γ along the lay and cos γ sin β across it, with the projected solid angle cos² γ cos β dγ dβ. Facets without
    slope along the lay mirror light to one γ, and those without slope across it to one cos γ sin β: panels crowd towards both. The horizon
    is at the limits of γ and β, so that the rule ends there exactly.
    """
    turn, sine, cosine = np.radians(phi_i + 180 - lay), np.sin(np.radians(theta_i)), np.cos(np.radians(theta_i))
    mirror = float(np.arcsin(np.clip(sine * np.cos(turn), -1.0, 1.0)))
    # A slope along the lay turns light by less where the light comes from across it.
    narrow = 2 * along * min(max(cosine, _LEAST_COSINE) / max(np.cos(mirror), _LEAST_COSINE), 1.0)
    gamma, gamma_weight = panel_rule(_growing_edges(np.array(mirror), narrow), order)
    middle = np.arcsin(np.clip(sine * np.sin(turn) / np.cos(gamma), -1.0, 1.0))
    beta, beta_weight = panel_rule(_growing_edges(middle, 2 * across), order)
    g = gamma[:, None]
    x, y, z = np.broadcast_arrays(np.sin(g), np.cos(g) * np.sin(beta), np.cos(g) * np.cos(beta))
    weight = gamma_weight[:, None] * beta_weight * np.cos(g) * z
    theta, phi = np.degrees(np.arctan2(np.hypot(x, y), z)), lay + np.degrees(np.arctan2(y, x))
    above = (weight > 0) & (theta < 90)
    return Directions(theta[above], phi[above], weight[above])


def _growing_edges(centre: Array, scale: float) -> Array:
    """Panel edges (..., panels + 1) on ±90° [rad] that grow exponentially away from a centre, from the scale of its peak."""
    steps = int(np.ceil(np.arcsinh(np.pi / scale) / _PANEL_GROWTH))
    offset = scale * np.sinh(_PANEL_GROWTH * np.arange(-steps, steps + 1))
    return np.clip(centre[..., None] + offset, -np.pi / 2, np.pi / 2)

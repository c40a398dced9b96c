"""Directions of equal projected solid angle within a cone that the horizon may cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array

_NEWTON_STEPS = 8
_SERIES_BELOW = 0.3


def within_cone(theta: ArrayLike, half_angle: ArrayLike, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Directions above the horizon within a cone, spread evenly in projected solid angle cos θ dω.

    Parameters
    ----------
    theta : polar angle of the cone's axis, 0 to 90 degree
    half_angle : above 0, at most 90 degree
    u, v : in [0, 1]; uniform ones give directions of the density cos θ / ∫ cos θ dω

    Returns
    -------
    θ, and φ from the azimuth of the axis [degree], of the broadcast shape

    Notes
    -----
    Projected solid angle is area on the unit disc (Nusselt). The cone's edge projects to an ellipse with the centre sin θ cos h and the
    half axes cos θ sin h and sin h. Where the horizon cuts the cone, a segment of the disc's rim replaces the end of the ellipse. In
    both the area of a segment is proportional to p − sin p, p the angle that it subtends: one equation to solve for the first
    coordinate, while the second is uniform along the chord.
    """
    theta, half, u, v = np.broadcast_arrays(np.radians(theta), np.radians(half_angle), u, v)
    s, c, sin_h, cos_h = np.sin(theta), np.cos(theta), np.sin(half), np.cos(half)
    rise = np.pi / 2 - theta
    # The angles that both segments subtend; forms without cancellation for narrow cones at the horizon.
    cut = np.clip(np.tan(np.minimum(rise, half)) / np.tan(half), 0.0, 1.0)
    ellipse = 2 * np.arccos(-np.where(rise >= half, 1.0, cut))
    beyond = np.sin(np.maximum(half - rise, 0)) * np.sin(half + rise) / np.maximum(s * s, 1e-300)
    rim = 2 * np.arcsin(np.sqrt(np.clip(beyond, 0.0, 1.0)))
    scale = c * sin_h * sin_h
    inner, outer = scale * _minus_sine(ellipse), _minus_sine(rim)
    area = u * (inner + outer)
    on_rim = (area > inner) | (scale == 0)
    p = _angle_of_segment(np.where(on_rim, 0.0, area / np.where(scale > 0, scale, 1.0)))
    q = _angle_of_segment(np.maximum(inner + outer - area, 0.0))
    x = np.where(on_rim, np.cos(q / 2), s * cos_h - c * sin_h * np.cos(p / 2))
    chord = np.where(on_rim, np.sin(q / 2), sin_h * np.sin(p / 2))
    lowest = np.where(on_rim, 0.0, c * cos_h + s * sin_h * np.cos(p / 2))
    w = 2 * v - 1
    y, z = chord * w, np.hypot(lowest, chord * np.sqrt((1 - w) * (1 + w)))
    return np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))


def _minus_sine(p: Array) -> Array:
    """p − sin p, without cancellation."""
    square = p * p
    series = p * square / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110))))
    return np.where(p < _SERIES_BELOW, series, p - np.sin(p))


def _angle_of_segment(area: Array) -> Array:
    """p in [0, 2π] with p − sin p = ``area``, in [0, 2π]."""
    area = np.clip(area, 0.0, 2 * np.pi)
    less = np.minimum(area, 2 * np.pi - area)
    p = np.cbrt(
        np.pi**2 * less
    )  # not below the root, from where Newton's steps fall to it: p − sin p is convex up to π
    for _ in range(_NEWTON_STEPS):
        slope = 2 * np.sin(p / 2) ** 2
        p = p - np.where(slope > 0, (_minus_sine(p) - less) / np.where(slope > 0, slope, 1.0), 0.0)
    return np.where(area <= np.pi, p, 2 * np.pi - p)

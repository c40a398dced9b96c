"""The screen and its image: directions of light, positions on the screen, and pixels of the camera.

Light leaves the sample in a direction (ϑ, φ) about the mirror direction, with φ = 0 towards the sample's normal. Within about ten degrees
a lens maps it onto a frosted disc, r = f tan ϑ with unchanged φ. Elsewhere a fibre guides it to its end on the same screen. The camera maps
the screen with a scale, a centre and one radial term: the position (x, y) [mm] at distance r from the origin appears at
centre + scale (1 + radial r²) (x, −y), because rows of an image count downwards.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig, Screen

REFERENCE_MARGIN = 2.0
"""Pixels about the reference spot that belong to no spot: the point spread blurs its edge."""

_NEWTON_STEPS, _CONVERGED = 20, 1e-12


class ScreenPositions(NamedTuple):
    """Positions on the screen [mm]."""

    x: Array
    y: Array


def to_pixel(screen: Screen, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Pixel coordinates (column, row) of positions on the screen [mm]; not rounded."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    stretch = screen.scale * (1 + screen.radial * (x * x + y * y))
    return screen.centre[0] + stretch * x, screen.centre[1] - stretch * y


def to_position(screen: Screen, column: ArrayLike, row: ArrayLike) -> ScreenPositions:
    """Position on the screen [mm] imaged onto a pixel: the inverse of :func:`to_pixel`, for radial r² well below 1/3."""
    u = (np.asarray(column, dtype=float) - screen.centre[0]) / screen.scale
    v = (screen.centre[1] - np.asarray(row, dtype=float)) / screen.scale
    distorted = np.hypot(u, v)
    radius = distorted
    for _ in range(_NEWTON_STEPS if screen.radial else 0):  # Newton's method for r (1 + radial r²) = distorted
        step = (radius * (1 + screen.radial * radius**2) - distorted) / (1 + 3 * screen.radial * radius**2)
        radius = radius - step
        if np.abs(step).max(initial=0.0) < _CONVERGED * np.max(distorted, initial=1.0):
            break
    shrink = np.divide(radius, distorted, out=np.ones_like(radius), where=distorted > 0)
    return ScreenPositions(u * shrink, v * shrink)


def disc_position(screen: Screen, theta_s: ArrayLike, phi_s: ArrayLike) -> ScreenPositions:
    """Position on the screen to which the lens maps a direction about the mirror direction [degree], below 90 degree."""
    radius, phi = screen.focal_length * np.tan(np.radians(theta_s)), np.radians(phi_s)
    return ScreenPositions(screen.disc_centre[0] + radius * np.cos(phi), screen.disc_centre[1] + radius * np.sin(phi))


def disc_direction(screen: Screen, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Direction (theta_s, phi_s) about the mirror direction [degree] that the lens maps to a position of the disc."""
    dx, dy = np.asarray(x, dtype=float) - screen.disc_centre[0], np.asarray(y, dtype=float) - screen.disc_centre[1]
    theta = np.degrees(np.arctan2(np.hypot(dx, dy), screen.focal_length))
    return theta, np.degrees(np.arctan2(dy, dx))


def disc_solid_angle(screen: Screen, theta_s: ArrayLike) -> Array:
    """Solid angle per area of the disc [sr/mm²] at a distance from its centre [degree]: cos³ϑ / f²."""
    return np.asarray(np.cos(np.radians(theta_s)) ** 3 / screen.focal_length**2)


@cache
def spot_masks(rig: Rig) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pixels (height, width) of the reference spot, and of disc and fibres; blurred edges belong to neither."""
    rows, columns = np.mgrid[: rig.camera.height, : rig.camera.width]
    positions = to_position(rig.screen, columns, rows)
    margin = REFERENCE_MARGIN / rig.screen.scale

    def within(centre: tuple[float, float], radius: float) -> NDArray[np.bool_]:
        return np.hypot(positions.x - centre[0], positions.y - centre[1]) <= radius

    reference = within(rig.screen.reference_centre, max(rig.screen.reference_radius, 0.5 / rig.screen.scale))
    sample = within(rig.screen.disc_centre, rig.screen.disc_radius - margin)
    for fibre in rig.fibres:
        sample |= within((fibre.x, fibre.y), rig.screen.fibre_radius)
    return reference, sample & ~within(rig.screen.reference_centre, rig.screen.reference_radius + margin)


def linear_limit(rig: Rig) -> float:
    """Electrons up to which counts are proportional to light."""
    return min(rig.camera.linear_to, rig.camera.gain * rig.camera.full)

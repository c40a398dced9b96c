"""Where directions of light meet pixels of the camera.

Light leaves the sample in a direction (ϑ, φ) about the mirror direction, φ = 0 towards the normal of the sample. Within about ten
degrees a lens maps it onto a frosted disc, r = f tan ϑ with φ kept; elsewhere a fibre carries it to its end on the same screen. The
camera maps the screen with a scale, a centre and one radial term: place (x, y) [mm] at distance r from the origin appears at
centre + scale (1 + radial r²) (x, −y), because rows of a picture run down.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Screen

_STEPS, _NEAR = 20, 1e-12


class Places(NamedTuple):
    """Places on the screen [mm]."""

    x: Array
    y: Array


def to_pixel(screen: Screen, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Pixel (column, row), fractions of one included, of places on the screen [mm]."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    stretch = screen.scale * (1 + screen.radial * (x * x + y * y))
    return screen.centre[0] + stretch * x, screen.centre[1] - stretch * y


def to_place(screen: Screen, column: ArrayLike, row: ArrayLike) -> Places:
    """Place on the screen [mm] seen at a pixel: the inverse of :func:`to_pixel`, for radial r² well below 1/3."""
    u = (np.asarray(column, dtype=float) - screen.centre[0]) / screen.scale
    v = (screen.centre[1] - np.asarray(row, dtype=float)) / screen.scale
    distorted = np.hypot(u, v)
    radius = distorted
    for _ in range(_STEPS if screen.radial else 0):  # Newton's steps towards r (1 + radial r²) = distorted
        step = (radius * (1 + screen.radial * radius**2) - distorted) / (1 + 3 * screen.radial * radius**2)
        radius = radius - step
        if np.abs(step).max(initial=0.0) < _NEAR * np.max(distorted, initial=1.0):
            break
    shrink = np.divide(radius, distorted, out=np.ones_like(radius), where=distorted > 0)
    return Places(u * shrink, v * shrink)


def disc_place(screen: Screen, theta_s: ArrayLike, phi_s: ArrayLike) -> Places:
    """Where the lens puts a direction about the mirror direction [degree] on the screen, below 90 degree."""
    radius, phi = screen.focal_length * np.tan(np.radians(theta_s)), np.radians(phi_s)
    return Places(screen.disc[0] + radius * np.cos(phi), screen.disc[1] + radius * np.sin(phi))


def disc_direction(screen: Screen, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Direction (theta_s, phi_s) about the mirror direction [degree] that the lens puts at a place of the disc."""
    dx, dy = np.asarray(x, dtype=float) - screen.disc[0], np.asarray(y, dtype=float) - screen.disc[1]
    theta = np.degrees(np.arctan2(np.hypot(dx, dy), screen.focal_length))
    return theta, np.degrees(np.arctan2(dy, dx))


def disc_solid_angle(screen: Screen, theta_s: ArrayLike) -> Array:
    """Solid angle per area of the disc [sr/mm²] at a distance from its centre [degree]: cos³ϑ / f²."""
    return np.asarray(np.cos(np.radians(theta_s)) ** 3 / screen.focal_length**2)

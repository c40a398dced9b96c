"""A mirror turned by known angles: where it sends the light, and the directions at which a calibration of the fibres aims it.

Directions (theta_s, phi_s) are about the mirror direction of the sample. The light of entrance σ comes from 2σ off it, azimuth 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array, angles_of, unit_vector

Aim = tuple[float, float]
"""Direction (theta_s, phi_s) to which a mirror sends the light [degree]."""

_DECIMALS = 2  # of the angles of an aim, as an operator sets them


def towards_light(entrance: float) -> Array:
    """Unit vector towards the light of an entrance [degree]."""
    return unit_vector(2 * np.array(entrance), np.zeros(1))[0]


def half_vectors(light: Array, directions: Array) -> Array:
    """Unit vectors (…, 3) halfway between the light (3,) and directions (…, 3)."""
    half = light + directions
    # Of a direction opposite to the light there is none.
    return np.asarray(half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9))


def normals(entrance: float, theta_s: ArrayLike, phi_s: ArrayLike) -> Array:
    """Unit normals (…, 3) of a mirror that sends the light of an entrance to directions [degree]."""
    return half_vectors(towards_light(entrance), unit_vector(theta_s, phi_s))


def normal_angles(entrance: float, aim: Aim) -> Aim:
    """Direction of the mirror's normal about the mirror direction of the sample [degree]."""
    theta, phi = angles_of(normals(entrance, *aim))
    return float(theta), float(phi)


def grid(step: float, to: float) -> tuple[Aim, ...]:
    """Directions on rings, about ``step`` apart [degree], from the mirror direction to ``to``."""
    aims: list[Aim] = [(0.0, 0.0)]
    for number, theta in enumerate(np.arange(step, to + 1e-9, step)):
        count = max(round(360 * np.sin(np.radians(theta)) / step), 4)
        phi = (np.arange(count) + number % 2 / 2) * 360 / count
        aims += [(round(float(theta), _DECIMALS), round(float(angle), _DECIMALS)) for angle in phi]
    return tuple(aims)

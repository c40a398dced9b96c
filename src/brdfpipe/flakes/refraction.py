"""Refraction into a clear coat, and the flake that mirrors one direction into another below it.

References
----------
Patent US 7,991,596 (DuPont): vector refraction and flake angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector


def refract(vector: ArrayLike, index: float) -> Array:
    """Direction inside the clear coat of a ray outside; both point away from the flakes.

    Parameters
    ----------
    vector : (..., 3) unit vectors, z along the normal, z >= 0
    index : refractive index of the coat, n2/n1, 1 or above

    Returns
    -------
    (..., 3) unit vectors

    Raises
    ------
    BrdfpipeError : an index below 1.

    Notes
    -----
    v' = (n1/n2) v + [√(1 − (n1/n2)²(1 − cos²τ)) − (n1/n2) cos τ] N.
    """
    _check_index(index)
    v = np.asarray(vector, dtype=float)
    ratio, cos_tau = 1 / index, v[..., 2:]
    along = np.sqrt(1 - ratio**2 * (1 - cos_tau**2)) - ratio * cos_tau
    return np.asarray(ratio * v + along * np.array([0.0, 0.0, 1.0]))


def flake_normal(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike, index: float) -> Array:
    """Unit normal (..., 3) of the flake that mirrors ``i`` into ``o`` below a coat of this index; angles in degree."""
    total = refract(unit_vector(theta_i, phi_i), index) + refract(unit_vector(theta_o, phi_o), index)
    return np.asarray(total / np.linalg.norm(total, axis=-1, keepdims=True))


def flake_angle(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike, index: float) -> Array:
    """Tilt θf [degree] of the flake that mirrors ``i`` into ``o``: 0 in the mirror direction, at most arcsin(1/n).

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; 0 <= θ <= 90
    index : refractive index of the clear coat, 1 or above

    Raises
    ------
    BrdfpipeError : an index below 1.

    Notes
    -----
    Refraction scales the tangential part of a direction by 1/n, so tan θf = |w_i + w_o|_xy / [n (cos θ_i' + cos θ_o')]. The
    tangential part is (sin θ_i − sin θ_o)² + 4 sin θ_i sin θ_o cos²(Δφ/2), which does not cancel near the mirror direction,
    where arccos f_z would lose half the digits. The difference of the sines is written as a product, for grazing directions.
    """
    _check_index(index)
    sin_i, sin_o = np.sin(np.radians(theta_i)), np.sin(np.radians(theta_o))
    half = np.cos(np.radians(np.subtract(phi_i, phi_o)) / 2)
    mean, difference = np.radians(np.add(theta_i, theta_o)) / 2, np.radians(np.subtract(theta_i, theta_o)) / 2
    tangential = np.sqrt((2 * np.cos(mean) * np.sin(difference)) ** 2 + 4 * sin_i * sin_o * half**2)
    normal = index * (inner_cosine(theta_i, index) + inner_cosine(theta_o, index))
    return np.asarray(np.degrees(np.arctan2(tangential, normal)))


def largest_flake_angle(index: float) -> float:
    """Largest flake angle [degree] that light from outside can reach."""
    return float(np.degrees(np.arcsin(1 / index)))


def inner_cosine(theta: ArrayLike, index: float) -> Array:
    """Cosine of the polar angle inside the coat of a direction outside."""
    # Not √(1 − sin²θ / n²), which cancels at grazing angles as n → 1.
    return np.asarray(np.sqrt((index - 1) * (index + 1) + np.cos(np.radians(theta)) ** 2) / index)


def _check_index(index: float) -> None:
    """Refuse a coat whose index would reflect light from outside totally."""
    if not np.min(index) >= 1:
        raise BrdfpipeError(f"the refractive index of the clear coat is {np.min(index):g}; accepted: 1 or above")

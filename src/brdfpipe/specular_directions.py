"""Directions about the mirror direction of an incidence, or about the light that passes straight.

A direction (theta_s, phi_s) is counted from the direction e that smooth surfaces send the light to, phi_s = 0 towards the normal.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint), angles about the specular ray.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.geometry import Array


def cos_view(incidence: ArrayLike, theta_s: ArrayLike, phi_s: ArrayLike) -> Array:
    """Cosine of the angle γ between a direction about the mirror direction and the sample's normal.

    cos γ = sin ϑ cos φ sin σ + cos ϑ cos σ; negative below the sample's horizon.
    """
    sigma, theta, phi = (np.radians(angle) for angle in (incidence, theta_s, phi_s))
    return np.asarray(np.sin(theta) * np.cos(phi) * np.sin(sigma) + np.cos(theta) * np.cos(sigma))


def cos_view_etalon(entrance: ArrayLike, theta_s: ArrayLike, phi_s: ArrayLike) -> Array:
    """Cosine of the angle ϑ_st to the etalon's normal, where it is lit at normal incidence through an entrance.

    The light of entrance σ comes from 2σ off the fixed direction the hemisphere is centred on, and so does the etalon's normal:
    cos ϑ_st = sin ϑ cos φ sin 2σ + cos ϑ cos 2σ.
    """
    return cos_view(2 * np.asarray(entrance, dtype=float), theta_s, phi_s)


def outgoing(
    incidence: ArrayLike, theta_s: ArrayLike, phi_s: ArrayLike, *, side: str = "reflection"
) -> tuple[Array, Array]:
    """Outgoing direction (theta_o, phi_o) [degree], from the sample's normal, for light that comes from (incidence, 0).

    Parameters
    ----------
    incidence : angle of incidence σ
    theta_s, phi_s : direction about the mirror direction, or with ``side="transmission"`` about the light that passes straight;
        φ = 0 towards the normal
    side : reflection or transmission

    Notes
    -----
    With e the direction the hemisphere is centred on, at (σ, 180) for reflection, and t the unit vector from it towards the normal,
    the direction is sin ϑ cos φ t + sin ϑ sin φ (e × t) + cos ϑ e. In transmission the picture is mirrored in the sample's plane.
    """
    sigma, theta, phi = np.broadcast_arrays(*(np.radians(angle) for angle in (incidence, theta_s, phi_s)))
    along, across, ahead = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    # e = (−sin σ, 0, cos σ), t = (cos σ, 0, sin σ), e × t = (0, 1, 0).
    x = along * np.cos(sigma) - ahead * np.sin(sigma)
    z = along * np.sin(sigma) + ahead * np.cos(sigma)
    theta_o = np.degrees(np.arctan2(np.hypot(x, across), z))
    return (theta_o if side == "reflection" else 180 - theta_o), np.degrees(np.arctan2(across, x))

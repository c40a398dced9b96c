"""The angles ϑ and φ about the mirror direction in which a BSDF is smoothed, and interpolated between incidences.

``mirror``  ϑ from the mirror direction, φ about it (Voloboy et al. 2005, Keldysh Institute preprint)
``half``    ϑ is twice the tilt of the half vector and φ its azimuth (Rusinkiewicz 1998): the lobe of facets is round at every incidence

In both, ϑ = 0 is the mirror direction, φ = 0 is towards the normal, and ϑ in the plane of incidence is the same.
"""

from __future__ import annotations

import numpy as np

from brdfpipe import specular_directions
from brdfpipe.bsdf.grids import from_mirror, specular_angles
from brdfpipe.geometry import Array, angles_of, half_vector, slope_towards, unit_vector

ABOUT = ("half", "mirror")


def angles(about: str, theta_i: Array, theta_o: Array, phi: Array) -> tuple[Array, Array]:
    """ϑ and φ [degree] of outgoing directions.

    Parameters
    ----------
    about : ``half`` or ``mirror``
    theta_i, theta_o : degree from the normal, of one shape; in ``half`` the angles of directions below the horizon are arbitrary but finite
    phi : azimuth of the outgoing direction from that of incidence [degree]
    """
    if about == "mirror":
        return specular_angles(theta_i, 0.0, theta_o, phi)
    half = half_vector(theta_i, 0.0, theta_o, phi)
    with np.errstate(divide="ignore", invalid="ignore"):
        p, q = slope_towards(half, 0.0, phi)
    theta = 2 * np.degrees(np.arctan(np.sqrt(half.slope_squared)))
    turn = np.degrees(np.arctan2(-q, -p))
    return (theta, turn) if np.all(np.isfinite(theta + turn)) else (np.nan_to_num(theta), np.nan_to_num(turn))


def outgoing(about: str, theta_i: Array, theta: Array, phi: Array) -> tuple[Array, Array]:
    """Inverse of :func:`angles`: θ_o, which may exceed 90, and φ_o from the azimuth of incidence [degree]."""
    if about == "mirror":
        return from_mirror(theta_i, 0.0, theta, phi)
    incoming, half = unit_vector(theta_i, np.zeros_like(theta_i)), unit_vector(theta / 2, phi)
    return angles_of(2 * (incoming * half).sum(axis=-1, keepdims=True) * half - incoming)


def cell_angles(about: str, incidence: float, theta_s: Array, phi_s: Array) -> tuple[Array, Array]:
    """ϑ and φ [degree] of cells at (theta_s, phi_s) about the mirror direction."""
    if about == "mirror":
        return theta_s, phi_s
    theta_o, phi_o = specular_directions.outgoing(incidence, theta_s, phi_s)
    return angles(about, np.full_like(theta_o, incidence), theta_o, phi_o)

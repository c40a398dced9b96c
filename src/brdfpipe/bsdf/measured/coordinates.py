"""The angles ϑ and φ about the mirror direction in which a BSDF is smoothed, and carried from one incidence to another.

``mirror``  ϑ from the mirror direction, φ about it
``half``    ϑ is twice the tilt of the half vector and φ its azimuth

In both ϑ = 0 is the mirror direction, φ = 0 leads towards the normal, and ϑ in the plane of incidence is the same. Facets mirror light by
their tilt: in ``half`` their lobe is round at every incidence, where about the mirror direction it is 1/cos σ times as long as wide.

References
----------
Rusinkiewicz 1998 (EGWR), half-angle coordinates; Voloboy et al. 2005 (Keldysh Institute preprint), angles about the specular ray.
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
    theta_i, theta_o : degree from the normal, of one shape; in ``half`` directions below the horizon have some ϑ and φ or other
    phi : azimuth of the outgoing direction from that of incidence [degree]
    """
    if about == "mirror":
        return specular_angles(theta_i, np.zeros_like(theta_i), theta_o, phi)
    half = half_vector(theta_i, 0.0, theta_o, phi)
    with np.errstate(divide="ignore", invalid="ignore"):
        p, q = slope_towards(half, 0.0, phi)
    theta = 2 * np.degrees(np.arctan(np.sqrt(half.slope_squared)))
    return np.nan_to_num(theta), np.nan_to_num(np.degrees(np.arctan2(-q, -p)))


def outgoing(about: str, theta_i: Array, theta: Array, phi: Array) -> tuple[Array, Array]:
    """θ_o, and φ_o from the azimuth of incidence, of ϑ and φ [degree]: the inverse of :func:`angles`; θ_o may exceed 90."""
    if about == "mirror":
        return from_mirror(theta_i, np.zeros_like(theta_i), theta, phi)
    incoming, half = unit_vector(theta_i, np.zeros_like(theta_i)), unit_vector(theta / 2, phi)
    return angles_of(2 * (incoming * half).sum(axis=-1, keepdims=True) * half - incoming)


def of_cells(about: str, incidence: float, theta_s: Array, phi_s: Array) -> tuple[Array, Array]:
    """ϑ and φ of cells, which look from (theta_s, phi_s) about the mirror direction [degree]."""
    if about == "mirror":
        return theta_s, phi_s
    theta_o, phi_o = specular_directions.outgoing(incidence, theta_s, phi_s)
    return angles(about, np.full_like(theta_o, incidence), theta_o, phi_o)

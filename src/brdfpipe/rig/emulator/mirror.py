"""The mirror of a calibration of the fibres: a metallised matt glass, whose lobe is some degrees wide, turned to send the light somewhere.

Source: Walter et al. 2007 (EGSR), facets of a distribution with long tails; Schlick's approximation of the reflectance of aluminium.
"""

from __future__ import annotations

import numpy as np

from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.emulator.effects import Effects, random_stream
from brdfpipe.rig.turned_mirror import Aim, half_vectors, normals, towards_light

WIDTH = 0.12
"""Of the distribution of slopes."""

REFLECTANCE = 0.9
"""At normal incidence."""


def true_normal(entrance: float, aim: Aim, effects: Effects, seed: int, session: int) -> Array:
    """The normal (3,) of the mirror as it is turned to an aim, with the errors of its mount."""
    normal = normals(entrance, *aim)
    key = [round(1000 * (angle % 360)) for angle in aim]
    error = np.radians(effects.mirror_angles / np.sqrt(2)) * random_stream(
        seed, "mirror angles", session, *key
    ).standard_normal(3)
    turned = normal + np.cross(error, normal)
    return np.asarray(turned / np.linalg.norm(turned))


def brightness(entrance: float, normal: Array, theta_s: Array, phi_s: Array) -> Array:
    """BRDF × cosine of view [1/sr] of the mirror in directions about the mirror direction of the sample [degree]."""
    light, view = towards_light(entrance), unit_vector(theta_s, phi_s)
    half = half_vectors(light, view)
    cos_i, cos_o, cos_h = float(light @ normal), view @ normal, half @ normal
    seen = (cos_o > 1e-3) & (cos_h > 1e-3)
    cos_o, cos_h = np.where(seen, cos_o, 1.0), np.where(seen, cos_h, 1.0)
    density = WIDTH**2 / (np.pi * (cos_h**2 * (WIDTH**2 - 1) + 1) ** 2)
    masking = 2 / (_masked(cos_o) + _masked(np.array(cos_i)))
    fresnel = REFLECTANCE + (1 - REFLECTANCE) * (1 - half @ light) ** 5
    return np.where(seen, fresnel * density * masking / (4 * cos_i), 0.0)


def _masked(cosine: Array) -> Array:
    """1 + 2 Λ of these slopes."""
    return np.asarray(np.sqrt(1 + WIDTH**2 * (1 / cosine**2 - 1)))

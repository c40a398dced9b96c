"""Luminance of the sky, of the kinds that the CIE standardises."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from brdfpipe.geometry import Array, unit_vector
from brdfpipe.hemisphere import panel_rule

_ORDER = 12


class Distribution(NamedTuple):
    """Parameters of the relative luminance (1 + a e^(b / cos Z)) [1 + c (e^(d χ) − e^(d π/2)) + e cos² χ].

    Z is the angle from the zenith, χ from the sun [radian]: gradation, and indicatrix.
    """

    a: float
    b: float
    c: float
    d: float
    e: float


SKIES: Mapping[str, Distribution] = {
    "uniform": Distribution(0.0, -1.0, 0.0, -1.0, 0.0),
    "clear": Distribution(-1.0, -0.32, 10.0, -3.0, 0.45),
    "overcast": Distribution(4.0, -0.70, 0.0, -1.0, 0.0),
}
"""Types 5 (uniform), 12 (CIE standard clear sky, low turbidity) and 1 (CIE standard overcast sky) of CIE S 011 / ISO 15469:2004."""


def sky_luminance(kind: str, illuminance: float, sun: tuple[float, float], directions: Array) -> Array:
    """Luminance of a sky without clouds in front of others, and without the sun itself [cd/m²].

    Parameters
    ----------
    kind : one of :data:`SKIES`
    illuminance : of the whole sky on the horizontal plane [lx]
    sun : elevation and azimuth [degree]
    directions : (…, 3) unit vectors, z upwards; 0 from below the horizon

    References
    ----------
    CIE S 011/E:2003 = ISO 15469:2004, Spatial distribution of daylight: CIE standard general sky.
    """
    towards = unit_vector(90 - sun[0], sun[1])
    up = directions[..., 2]
    relative = _relative(SKIES[kind], np.maximum(up, 1e-12), directions @ towards)
    return np.where(up > 0, illuminance / _horizontal(kind, sun[0]) * relative, 0.0)


def _relative(sky: Distribution, cos_zenith: Array, cos_sun: Array) -> Array:
    chi = np.arccos(np.clip(cos_sun, -1.0, 1.0))
    gradation = 1 + sky.a * np.exp(sky.b / cos_zenith)
    halo = np.exp(sky.d * chi) - np.exp(sky.d * np.pi / 2)
    return np.asarray(gradation * (1 + sky.c * halo + sky.e * np.cos(chi) ** 2))


@cache
def _horizontal(kind: str, elevation: float) -> float:
    """∫ of the relative luminance times cos Z over the hemisphere [sr]."""
    rise = 90 - elevation
    # The indicatrix has a tip at the sun.
    zenith = np.unique(np.concatenate([np.linspace(0, 90, 7), rise + np.array([-8, -2, 0, 2, 8])]))
    theta, theta_weight = panel_rule(np.radians(zenith[(zenith >= 0) & (zenith <= 90)]), _ORDER)
    phi, phi_weight = panel_rule(np.radians([0, 1, 4, 15, 60, 180]), _ORDER)
    z, turn = np.meshgrid(theta, phi, indexing="ij")
    cos_sun = np.cos(z) * np.cos(np.radians(rise)) + np.sin(z) * np.sin(np.radians(rise)) * np.cos(turn)
    weight = theta_weight[:, None] * np.sin(z) * np.cos(z) * 2 * phi_weight
    return float((_relative(SKIES[kind], np.cos(z), cos_sun) * weight).sum())

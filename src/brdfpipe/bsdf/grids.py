"""Coordinates of the tables of a BSDF.

- ``uniform``: θ_i, θ_o, and φ_o counted from the azimuth of incidence; either θ may exceed 90 (transmission).
- ``specular``: θ_i, and the outgoing direction in polar coordinates about the mirror direction: θ_s from it, φ_s = 0 towards the
  normal in the plane of incidence. The position of a lobe does not change with the incidence.
- ``half``: θ_h of the half vector from the normal, θ_d of the directions from it, and φ_d of the incidence about it.

``uniform`` holds both sides of the surface, ``specular`` the side of incidence, and ``half`` light from above. With a lay a table has one
more axis: φ_i, or φ_h.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint), angles about the specular ray; Rusinkiewicz 1998 (EGWR), half-angle coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from brdfpipe.geometry import Array, angles_of, unit_vector

Angles: TypeAlias = tuple[Array, Array, Array, Array]
"""θ_i, φ_i, θ_o and φ_o [degree], of one shape."""


class Grid(NamedTuple):
    """One layout: its axes, and the conversion from and to directions."""

    axes: tuple[str, str, str]
    azimuth: str
    """The additional first axis of a surface with a lay"""
    coordinates: Callable[[Array, Array, Array, Array], Mapping[str, Array]]
    """All coordinates of pairs of directions"""
    directions: Callable[[Mapping[str, Array]], Angles]
    """Pairs of directions from coordinates; ``azimuth`` is 0 by default"""

    def named(self, lay: bool) -> tuple[str, ...]:
        return (self.azimuth, *self.axes) if lay else self.axes


def specular_angles(theta_i: Array, phi_i: Array | float, theta_o: Array, phi_o: Array) -> tuple[Array, Array]:
    """θ_s and φ_s of outgoing directions [degree]."""
    towards_normal, across, mirror = _mirror_frame(theta_i, phi_i)
    (x, y, z), (mirror_x, mirror_y, mirror_z) = _components(theta_o, phi_o), mirror
    away = x - mirror_x, y - mirror_y, z - mirror_z
    theta_s = 2 * np.degrees(np.arcsin(np.minimum(np.sqrt(_dot(away, away)) / 2, 1.0)))
    return theta_s, np.degrees(np.arctan2(_dot(away, across), _dot(away, towards_normal)))


def from_mirror(theta_i: Array, phi_i: Array | float, theta_s: Array, phi_s: Array) -> tuple[Array, Array]:
    """θ_o and φ_o of directions about the mirror direction [degree]."""
    towards_normal, across, mirror = _mirror_frame(theta_i, phi_i)
    x, y, z = _components(theta_s, phi_s)
    along_x, along_y, along_z = (x * a + y * b + z * c for a, b, c in zip(towards_normal, across, mirror, strict=True))
    theta_o = np.degrees(np.arctan2(np.hypot(along_x, along_y), along_z))
    return theta_o, np.degrees(np.arctan2(along_y, along_x))


_Vector = tuple[Array, Array, Array]
"""Components along x, y and z: of arrays or of numbers, which take a fraction of their time"""


def _components(theta: Array, phi: Array | float) -> _Vector:
    """Unit vectors of directions in degree."""
    theta, phi = np.radians(theta), np.radians(phi)
    sine = np.sin(theta)
    return sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)


def _dot(a: _Vector, b: _Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _mirror_frame(theta_i: Array, phi_i: Array | float) -> tuple[_Vector, _Vector, _Vector]:
    """Unit vectors towards the normal, across the plane of incidence, and along the mirror direction."""
    mirror = x, y, z = _components(theta_i, phi_i + 180)
    u, v, w = _components(theta_i + 90, phi_i + 180)
    towards_normal = u, v, w = -u, -v, -w
    return towards_normal, (y * w - z * v, z * u - x * w, x * v - y * u), mirror


def half_angles(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Mapping[str, Array]:
    """θ_h, φ_h, θ_d and φ_d of pairs of directions [degree]."""
    w_i, w_o = unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)
    both = w_i + w_o
    theta_h, phi_h = angles_of(both)
    theta_d = np.degrees(np.arctan2(np.linalg.norm(w_i - w_o, axis=-1), np.linalg.norm(both, axis=-1)))
    x_axis, y_axis = unit_vector(theta_h + 90, phi_h), unit_vector(np.full_like(theta_h, 90.0), phi_h + 90)
    phi_d = np.degrees(np.arctan2((w_i * y_axis).sum(axis=-1), (w_i * x_axis).sum(axis=-1)))
    return {"theta_h": theta_h, "phi_h": phi_h, "theta_d": theta_d, "phi_d": phi_d}


def from_half_angles(at: Mapping[str, Array]) -> Angles:
    """Pairs of directions at half-angle coordinates [degree]; they may be below the horizon."""
    theta_h, theta_d, phi_d = at["theta_h"], at["theta_d"], at["phi_d"]
    phi_h = at.get("phi_h", np.zeros_like(theta_h))
    x_axis, y_axis = unit_vector(theta_h + 90, phi_h), unit_vector(np.full_like(theta_h, 90.0), phi_h + 90)
    x, y, z = (component[..., None] for component in np.moveaxis(unit_vector(theta_d, phi_d), -1, 0))
    across, along = x * x_axis + y * y_axis, z * unit_vector(theta_h, phi_h)
    return *angles_of(along + across), *angles_of(along - across)


def _uniform(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Mapping[str, Array]:
    return {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o - phi_i}


def _from_uniform(at: Mapping[str, Array]) -> Angles:
    phi_i = at.get("phi_i", np.zeros_like(at["theta_i"]))
    return at["theta_i"], phi_i, at["theta_o"], at["phi_o"] + phi_i


def _specular(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Mapping[str, Array]:
    theta_s, phi_s = specular_angles(theta_i, phi_i, theta_o, phi_o)
    return {"theta_i": theta_i, "phi_i": phi_i, "theta_s": theta_s, "phi_s": phi_s}


def _from_specular(at: Mapping[str, Array]) -> Angles:
    phi_i = at.get("phi_i", np.zeros_like(at["theta_i"]))
    return at["theta_i"], phi_i, *from_mirror(at["theta_i"], phi_i, at["theta_s"], at["phi_s"])


GRIDS: Mapping[str, Grid] = {
    "uniform": Grid(("theta_i", "theta_o", "phi_o"), "phi_i", _uniform, _from_uniform),
    "specular": Grid(("theta_i", "theta_s", "phi_s"), "phi_i", _specular, _from_specular),
    "half": Grid(("theta_h", "theta_d", "phi_d"), "phi_h", half_angles, from_half_angles),
}

AZIMUTHS = ("phi_o", "phi_s", "phi_d")
"""Axes that hold a full circle, or half a circle that is mirrored about the plane of incidence."""


def layout_of(axes: Collection[Hashable]) -> Grid:
    """The layout to which the names of axes belong; ``uniform`` if none is characteristic."""
    if {"theta_s", "phi_s"} & set(axes):
        return GRIDS["specular"]
    return GRIDS["half" if {"theta_h", "theta_d", "phi_d", "phi_h"} & set(axes) else "uniform"]

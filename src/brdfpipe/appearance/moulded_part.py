"""The third subject of a preview: a distant moulded part, a crowned cover with ribs, a boss, fillets and draft.

Light from a distant subject depends only on the normal and the lay. The sphere of the preview has every normal that faces the camera,
and both are brushed horizontally. The part is therefore lit like the sphere: each of its pixels is interpolated between the pixels of
the sphere that have its normal. Shadows of the part on itself are not included.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import cos, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from brdfpipe.appearance.preview_geometry import SPHERE_RADIUS, sphere
from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

DRAFT = tan(radians(5.0))
"""Slope of the walls against the direction of the mould."""

_HALF_LENGTH, _HALF_DEPTH, _HEIGHT, _CORNER = 0.90, 0.60, 0.13, 0.20
_CROWN = 0.05
"""Curvature of the top along the part; across it is twice as large."""
_RIBS = (-0.52, -0.28, -0.04)
_RIB_HALF_WIDTH, _RIB_HALF_LENGTH, _RIB_HEIGHT, _RIB_CORNER = 0.055, 0.40, 0.11, 0.03
_BOSS, _BOSS_RADIUS, _BOSS_HEIGHT = 0.48, 0.23, 0.13
_DISH_RADIUS, _DISH_HEIGHT = 0.21, 0.26
_EDGE, _FILLET = 0.045, 0.05
"""Radii of edges, and of the fillets where walls meet."""

_TURN, _TILT = radians(27.0), radians(47.0)
"""About the direction of the mould, and of that from the vertical towards the camera."""
_HALF_FIELD = 1.06
"""Half the width of the picture."""
_ABOVE, _BELOW = 0.45, -0.2
"""Heights between which the part is met."""

_FINER = 2
"""Rays along each side of a pixel where its neighbours have other normals."""
_BEND = 0.08
"""Difference of normals between neighbours from which a pixel is seen by several rays."""
_WEIGHTS = 16
"""Pixels of the sphere for each pixel of the part: 4 × 4 for one ray, 2 × 2 for each of four."""


class Part(NamedTuple):
    """The part in a square picture."""

    coverage: Array
    """(side, side) share of each pixel that the part covers"""
    of_sphere: csr_array
    """(covered pixels, covered pixels of the sphere): the weights that interpolate between the pixels of the sphere"""

    def lit_as(self, sphere: Array) -> Array:
        """Values of the covered pixels, (pixels, channels), from those of the sphere."""
        return np.asarray(self.of_sphere @ np.ascontiguousarray(sphere, dtype=np.float32))


@lru_cache(maxsize=4)
def moulded_part(side: int) -> Part:
    """The part in a picture of ``side`` pixels, to be lit as :func:`brdfpipe.appearance.preview_geometry.sphere` of the same side."""
    centre = ((np.arange(side) + 0.5) / side * 2 - 1) * _HALF_FIELD
    x, z = (axis.ravel() for axis in np.meshgrid(centre, -centre))
    normal = _seen_normals(x, z)
    several = _bent(normal.reshape(side, side, 3)).ravel()
    offset = ((np.arange(_FINER) + 0.5) / _FINER - 0.5) * 2 * _HALF_FIELD / side
    dx, dz = (axis.ravel() for axis in np.meshgrid(offset, offset))
    finer = _seen_normals((x[several, None] + dx).ravel(), (z[several, None] + dz).ravel()).reshape(-1, dx.size, 3)
    met = np.isfinite(finer[..., 0])
    coverage = np.where(np.isfinite(normal[:, 0]), 1.0, 0.0)
    coverage[several] = met.mean(axis=1)
    pixels = np.zeros((side * side, _WEIGHTS), dtype=np.int32)
    weight = np.zeros((side * side, _WEIGHTS), dtype=np.float32)
    alone = np.flatnonzero(~several & (coverage > 0))
    pixels[alone], weight[alone] = _on_sphere(normal[alone], side, _cubic)
    of_rays, weight_of_rays = (
        part.reshape(-1, _WEIGHTS) for part in _on_sphere(np.nan_to_num(finer).reshape(-1, 3), side, _linear)
    )
    shared = np.repeat(met / np.maximum(met.sum(axis=1, keepdims=True), 1), _WEIGHTS // dx.size, axis=1)
    pixels[several], weight[several] = of_rays, weight_of_rays * shared
    covered = coverage > 0
    ends = np.arange(np.count_nonzero(covered) + 1, dtype=np.int32) * _WEIGHTS
    shape = (len(ends) - 1, int(np.count_nonzero(sphere(side).coverage)))
    of_sphere = csr_array((weight[covered].ravel(), pixels[covered].ravel(), ends), shape=shape)
    return Part(coverage.reshape(side, side), of_sphere)


def _bent(normal: Array) -> NDArray[np.bool_]:
    """Pixels (rows, columns) of which a neighbour has another normal, or sees nothing where it sees the part."""
    shown = np.nan_to_num(normal, nan=9.0)
    bent = np.zeros(shown.shape[:2], dtype=bool)
    across, down = (np.abs(np.diff(shown, axis=axis)).max(axis=2) > _BEND for axis in (1, 0))
    bent[:, :-1] |= across
    bent[:, 1:] |= across
    bent[:-1] |= down
    bent[1:] |= down
    return bent


def _on_sphere(normal: Array, side: int, weights_at: Callable[[Array], Array]) -> tuple[NDArray[np.intp], Array]:
    """Covered pixels of the sphere about each normal (n, 3), and their weights, (n, nodes²) both."""
    coverage = sphere(side).coverage
    index = np.cumsum(coverage.ravel() > 0).reshape(side, side) - 1
    radius = SPHERE_RADIUS * side
    # Beyond the last pixels that the sphere covers whole, these are taken again.
    across = normal[:, [2, 0]] * [-1.0, 1.0]
    across *= np.minimum(1.0, (1 - 1.5 / radius) / np.maximum(np.hypot(*across.T), 1e-12))[:, None]
    position = across * radius + (side - 1) / 2
    first = np.floor(position)
    weights = weights_at(position - first)
    count = weights.shape[-1]
    nodes = first[:, :, None] + np.arange(count) - (count // 2 - 1) - (side - 1) / 2
    rows, columns = nodes[:, 0, :, None], nodes[:, 1, None, :]
    inwards = np.minimum(1.0, (radius - 1.0) / np.maximum(np.hypot(rows, columns), 1e-12))
    rows, columns = (np.rint(axis * inwards + (side - 1) / 2).astype(np.intp) for axis in (rows, columns))
    weight = weights[:, 0, :, None] * weights[:, 1, None, :]
    return index[rows, columns].reshape(len(normal), -1), weight.reshape(len(normal), -1)


def _cubic(t: Array) -> Array:
    """Weights of four nodes at ``t`` from 0 to 1 between the middle ones (Catmull and Rom's cubics)."""
    return 0.5 * np.stack(
        [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2], axis=-1
    )


def _linear(t: Array) -> Array:
    return np.stack([1 - t, t], axis=-1)


# --- the shape, in axes of the mould: x along the part, y across it, z in the direction of the mould


def _seen_normals(x: Array, z: Array) -> Array:
    """Unit normals (n, 3) in the world where rays along y meet the part, NaN where they do not."""
    up = np.array([0.0, -sin(_TILT), cos(_TILT)])
    along = np.array([cos(_TURN), sin(_TURN) * cos(_TILT), sin(_TURN) * sin(_TILT)])
    axes = np.stack([along, np.cross(up, along), up])
    normal = np.full((x.size, 3), np.nan)
    _meet(np.stack([x, z], axis=-1), axes, normal)
    # In the world: towards the camera.
    normal = normal @ axes
    normal[~(normal[:, 1] < -1e-3)] = np.nan
    return normal


@compiled
def _meet(place: Array, axes: Array, normal: Array) -> None:
    """Sphere tracing (Hart 1996, The Visual Computer 12): steps as long as the distance from the surface."""
    rx, ry, rz = axes[0, 1], axes[1, 1], axes[2, 1]
    for ray in range(place.shape[0]):
        px = axes[0, 0] * place[ray, 0] + axes[0, 2] * place[ray, 1]
        py = axes[1, 0] * place[ray, 0] + axes[1, 2] * place[ray, 1]
        pz = axes[2, 0] * place[ray, 0] + axes[2, 2] * place[ray, 1]
        step = (_ABOVE - pz) / rz
        for _ in range(200):
            px, py, pz = px + rx * step, py + ry * step, pz + rz * step
            if pz < _BELOW or abs(px) > 2 or abs(py) > 2:
                break
            distance = _distance(px, py, pz)
            if distance < 2e-4:
                # From four corners of a tetrahedron.
                h = 1e-4
                a, b = _distance(px + h, py - h, pz - h), _distance(px - h, py - h, pz + h)
                c, d = _distance(px - h, py + h, pz - h), _distance(px + h, py + h, pz + h)
                nx, ny, nz = a - b - c + d, -a - b + c + d, -a + b - c + d
                length = sqrt(nx * nx + ny * ny + nz * nz)
                normal[ray, 0], normal[ray, 1], normal[ray, 2] = nx / length, ny / length, nz / length
                break
            step = 0.8 * distance


@compiled
def _distance(x: float, y: float, z: float) -> float:
    """Distance from the surface, at least nearly: walls with draft are somewhat nearer."""
    z += 0.5 * _CROWN * (x * x + 2 * y * y)
    shape = _block(x, y, z, _HALF_LENGTH, _HALF_DEPTH, _HEIGHT, _CORNER)
    above = z - _HEIGHT
    for rib in _RIBS:
        shape = _joined(shape, _block(x - rib, y, above, _RIB_HALF_WIDTH, _RIB_HALF_LENGTH, _RIB_HEIGHT, _RIB_CORNER))
    from_boss = sqrt((x - _BOSS) ** 2 + y * y)
    shape = _joined(shape, _wall(from_boss - _BOSS_RADIUS + DRAFT * above, above, _BOSS_HEIGHT))
    # Less a ball, that leaves a dish in the boss.
    return -_joined(-shape, sqrt(from_boss * from_boss + (above - _DISH_HEIGHT) ** 2) - _DISH_RADIUS)


@compiled
def _block(x: float, y: float, z: float, half_x: float, half_y: float, height: float, corner: float) -> float:
    """A rectangle with round corners, drawn up to ``height`` with draft."""
    a, b = abs(x) - half_x + corner, abs(y) - half_y + corner
    return _wall(_outside(a, b) - corner + DRAFT * z, z, height)


@compiled
def _wall(outline: float, z: float, height: float) -> float:
    """All where ``outline`` is negative, up to ``height``, with round edges."""
    return _outside(outline + _EDGE, z - height + _EDGE) - _EDGE


@compiled
def _outside(a: float, b: float) -> float:
    """Distance from the quarter of a plane where both are negative."""
    return sqrt(a * a + b * b) if a > 0 and b > 0 else max(a, b)


@compiled
def _joined(a: float, b: float) -> float:
    """Both shapes, with a fillet where they meet."""
    near = max(1 - abs(a - b) / (2 * _FILLET), 0.0)
    return min(a, b) - 0.5 * _FILLET * near * near

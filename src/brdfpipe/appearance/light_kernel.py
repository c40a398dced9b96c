"""Compiled look-up of lights in the directions that facets mirror, for many points of a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

Floats = NDArray[np.float32]


def mirrored_light(
    frame: Array,
    facets: Array,
    view: Array,
    levels: tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats],
    table: Floats,
    straight_down: np.float32,
) -> Floats:
    """Radiance (points, facets) from the directions that facets mirror towards the camera.

    Parameters
    ----------
    frame : (points, 3, 3) axes of the surface at each point
    facets : (facets, 3) unit normals in these
    view : (points, 3) unit vectors towards the camera
    levels : of each facet the size of its level of the table, where it starts, its scale and half its size
        (:meth:`brdfpipe.appearance.lights.Filtered.levels`)
    table : all levels
    straight_down : z below which the map has no azimuth

    Notes
    -----
    In single precision, as :meth:`brdfpipe.appearance.lights.Filtered.__call__`.
    """
    light = np.empty((len(frame), len(facets)), dtype=np.float32)
    normals = np.ascontiguousarray(facets.T)
    towards = np.ascontiguousarray(view, dtype=np.float32)
    _mirrored_light(np.ascontiguousarray(frame), normals, towards, levels, table, straight_down, light)
    return light


@compiled
def _mirrored_light(
    frame: Array,
    normals: Array,
    view: Floats,
    levels: tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats],
    table: Floats,
    straight_down: np.float32,
    light: Floats,
) -> None:
    sizes, starts, scales, halves = levels
    one, two, least, zero = np.float32(1), np.float32(2), np.float32(1e-6), np.int32(0)
    last = sizes - np.int32(1)
    u, v, w = normals[0], normals[1], normals[2]
    for point in range(light.shape[0]):
        axes, found = frame[point], light[point]
        vx, vy, vz = view[point, 0], view[point, 1], view[point, 2]
        for node in range(light.shape[1]):
            nx = np.float32(axes[0, 0] * u[node] + axes[1, 0] * v[node] + axes[2, 0] * w[node])
            ny = np.float32(axes[0, 1] * u[node] + axes[1, 1] * v[node] + axes[2, 1] * w[node])
            nz = np.float32(axes[0, 2] * u[node] + axes[1, 2] * v[node] + axes[2, 2] * w[node])
            cosine = (nx * vx + ny * vy + nz * vz) * two
            z = cosine * nz - vz
            stretch = scales[node] / np.sqrt(max(one + z, least))
            column = np.int32((cosine * nx - vx) * stretch + halves[node])
            row = np.int32((cosine * ny - vy) * stretch + halves[node])
            column = min(max(column, zero), last[node])
            row = zero if z < straight_down else min(max(row, zero), last[node])
            found[node] = table[starts[node] + row * sizes[node] + column]

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
    """Radiance (lights, points, facets) from the directions that facets mirror towards the camera.

    Parameters
    ----------
    frame : (points, 3, 3) axes of the surface at each point
    facets : (facets, 3) unit normals in these
    view : (points, 3) unit vectors towards the camera
    levels : of each facet the size of its level of the table, where it starts, its scale and half its size
        (:meth:`brdfpipe.appearance.lights.Filtered.levels`)
    table : all levels, (texels, lights)
    straight_down : z below which the map has no azimuth

    Notes
    -----
    In single precision, as :meth:`brdfpipe.appearance.lights.Filtered.__call__`.
    """
    light = np.empty((table.shape[1], len(frame), len(facets)), dtype=np.float32)
    normals = np.ascontiguousarray(facets.T, dtype=np.float32)
    axes, towards = (np.ascontiguousarray(vectors, dtype=np.float32) for vectors in (frame, view))
    _mirrored_light(axes, normals, towards, levels, table, straight_down, light)
    return light


@compiled
def _mirrored_light(
    frame: Floats,
    normals: Floats,
    view: Floats,
    levels: tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats],
    table: Floats,
    straight_down: np.float32,
    light: Floats,
) -> None:
    sizes, starts, scales, halves = levels
    one, two, least, zero = np.float32(1), np.float32(2), np.float32(1e-6), np.int32(0)
    u, v, w = normals[0], normals[1], normals[2]
    texel = np.empty(light.shape[2], dtype=np.int32)
    for point in range(light.shape[1]):
        # Numbers instead of elements, comparisons instead of `min` and `max`, and the look-up in a loop of its own: so the compiler computes
        # many nodes at once.
        xx, xy, xz = frame[point, 0, 0], frame[point, 0, 1], frame[point, 0, 2]
        yx, yy, yz = frame[point, 1, 0], frame[point, 1, 1], frame[point, 1, 2]
        zx, zy, zz = frame[point, 2, 0], frame[point, 2, 1], frame[point, 2, 2]
        vx, vy, vz = view[point, 0], view[point, 1], view[point, 2]
        for node in range(light.shape[2]):
            nx = xx * u[node] + yx * v[node] + zx * w[node]
            ny = xy * u[node] + yy * v[node] + zy * w[node]
            nz = xz * u[node] + yz * v[node] + zz * w[node]
            cosine = (nx * vx + ny * vy + nz * vz) * two
            z = cosine * nz - vz
            rise = one + z
            stretch = scales[node] / np.sqrt(rise if rise > least else least)
            last = sizes[node] - np.int32(1)
            column = np.int32((cosine * nx - vx) * stretch + halves[node])
            row = np.int32((cosine * ny - vy) * stretch + halves[node])
            column = column if column > zero else zero
            column = column if column < last else last
            row = row if row > zero else zero
            row = row if row < last else last
            row = zero if z < straight_down else row
            texel[node] = np.int32(starts[node] + row * sizes[node] + column)
        for lamp in range(light.shape[0]):
            for node in range(light.shape[2]):
                light[lamp, point, node] = table[texel[node], lamp]

"""Compiled kernel: rays over a mesh of heights, with every bounce and Jones matrices between them.

All compiled functions that call each other are in this module, because the compiler's cache of a function does not see changes in other
modules. No reduction depends on the number of threads, and there is no ``fastmath``: results are the same for any number of threads.

Positions along x and y count cells from the first height; heights, and distances along a ray, are in µm. A ray is the point
(x + t·dx, y + t·dy, z + t·dz) with dx and dy divided by the pitch. Where it leaves the map it continues in the map's mirror image (or its
repetition), so that the stored ray always is on the map; ``flip_x`` and ``flip_y`` are −1 where it is in an image.

References
----------
Tevs, Ihrke & Seidel 2008 (I3D), maximum mipmaps for the traversal; Roberts' additive recurrence for the positions of rays.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

MIRRORED, PERIODIC, OPEN = 0, 1, 2
"""What is beyond the edges of a map: its mirror image, its repetition, or nothing."""
ORDERS = 3
"""Orders of reflection that are counted apart: one, two, and three or more."""

RECORDED = 16
"""Reflections of a path whose angles are recorded; to further ones, of 1e-5 of the light and less, no light is lost."""

_MOST_BOUNCES = 64
_MOST_STEPS = 200_000
_FIRST_LEVEL = 4  # of a ray from above: blocks of 16 × 16 cells
_NEGLIGIBLE_POWER = 1e-12
_HIT, _ESCAPED, _LOST = 0, 1, 2
_TURN = 2 * math.pi


@compiled
def folded(position: float, cells: int, edges: int) -> tuple[float, float]:
    """Position in [0, cells) of any position along an axis, and −1 where it is in a mirror image."""
    if edges == MIRRORED:
        position = position % (2 * cells)
        if position >= cells:
            return min(2 * cells - position, np.nextafter(cells, 0)), -1.0
        return position, 1.0
    return position % cells, 1.0


@compiled
def triangle(height: Array, ix: int, iy: int, upper: bool) -> tuple[float, float, float]:
    """Height at the corner (ix, iy), and rises per cell along x and y, of the plane of one of a cell's two triangles.

    Cells are cut along one diagonal and the other by turns, like the fields of a chessboard: the slopes of the triangles then are an
    even half of those of the four triangles a cell that are counted for the slope density.
    """
    low, right = height[iy, ix], height[iy, ix + 1]
    above, far = height[iy + 1, ix], height[iy + 1, ix + 1]
    if (ix + iy) & 1:
        if upper:
            return right + above - far, far - above, far - right
        return low, right - low, above - low
    if upper:
        return low, far - above, above - low
    return low, right - low, far - right


@compiled
def first_hit(
    height: Array,
    ceiling: Array,
    offset: NDArray[np.int64],
    low: float,
    edges: int,
    ray: Array,
    at: NDArray[np.int64],
    from_above: bool,
) -> int:
    """Follow a ray to the first triangle that it meets.

    Parameters
    ----------
    height : (rows, columns) um
    ceiling, offset : highest height of every block of 2^level × 2^level cells, levels one after the other, and where each begins
    low : lowest height
    edges : what is beyond the map
    ray : (8,) x, y, z, dx, dy, dz, flip_x, flip_y; moved to the hit, or to where it leaves
    at : (3,) column, row and side of the triangle on which the ray starts, which it cannot meet; then of the one it meets
    from_above : start at the top of the map instead

    Returns
    -------
    int : 0 for a hit, 1 if the ray leaves the surface, 2 if it leaves an open map sideways
    """
    columns, rows = height.shape[1] - 1, height.shape[0] - 1
    top = offset.size - 2
    x, y, z, dx, dy, dz = ray[0], ray[1], ray[2], ray[3], ray[4], ray[5]
    flip_x, flip_y = ray[6], ray[7]
    high = ceiling[offset[top]]
    if from_above:
        ix, iy, level = min(int(x), columns - 1), min(int(y), rows - 1), min(top, _FIRST_LEVEL)
        start_x, start_y, start_side = -1, -1, -1
    else:
        ix, iy, level = at[0], at[1], 0
        start_x, start_y, start_side = ix, iy, at[2]
    end = math.inf
    if dz > 0:
        end = max((high - z) / dz, 0.0)
    elif dz < 0:
        end = (low - z) / dz + 1.0
    t = 0.0
    per_x = 1 / dx if dx != 0 else math.inf
    per_y = 1 / dy if dy != 0 else math.inf
    status = _LOST
    for _ in range(_MOST_STEPS):
        if dz >= 0 and t >= end:
            status = _ESCAPED
            break
        side = 1 << level
        node_x, node_y = ix >> level, iy >> level
        bound_x, bound_y = math.inf, math.inf
        if dx > 0:
            bound_x = (min((node_x + 1) * side, columns) - x) * per_x
        elif dx < 0:
            bound_x = (node_x * side - x) * per_x
        if dy > 0:
            bound_y = (min((node_y + 1) * side, rows) - y) * per_y
        elif dy < 0:
            bound_y = (node_y * side - y) * per_y
        leave = max(min(bound_x, bound_y, end), t)
        nodes = (columns + side - 1) >> level
        if min(z + dz * t, z + dz * leave) <= ceiling[offset[level] + node_y * nodes + node_x]:
            if level > 0:
                level -= 1
                continue
            # Signed distance from the diagonal, positive in the upper triangle.
            if (ix + iy) & 1:
                first = x + dx * t - ix + y + dy * t - iy - 1
                last = x + dx * leave - ix + y + dy * leave - iy - 1
            else:
                first = y + dy * t - iy - (x + dx * t - ix)
                last = y + dy * leave - iy - (x + dx * leave - ix)
            crosses = (first > 0) != (last > 0)
            begin = t
            for part in range(2 if crosses else 1):
                upper = (first > 0) != (part == 1)
                if not crosses:
                    upper = first + last > 0
                finish = leave
                if crosses and part == 0:
                    finish = t + (leave - t) * first / (first - last)
                if not (ix == start_x and iy == start_y and upper == (start_side == 1)):
                    base, p, q = triangle(height, ix, iy, upper)
                    gap_end = z + dz * finish - base - p * (x + dx * finish - ix) - q * (y + dy * finish - iy)
                    closing = dz - p * dx - q * dy
                    if gap_end < 0 and closing < 0:
                        t = min(max(finish - gap_end / closing, begin), finish)
                        at[0], at[1], at[2] = ix, iy, 1 if upper else 0
                        status = _HIT
                        break
                begin = finish
            if status == _HIT:
                break
        if leave >= end:
            # Below the lowest height there is nothing to meet: the rounding of a ray along an edge.
            status = _ESCAPED if dz > 0 else _LOST
            break
        t = leave
        old_x, old_y = ix, iy
        if bound_x <= bound_y:
            ix = min((node_x + 1) * side, columns) if dx > 0 else node_x * side - 1
            iy = min(max(int(y + dy * t), node_y * side), min((node_y + 1) * side, rows) - 1)
        else:
            iy = min((node_y + 1) * side, rows) if dy > 0 else node_y * side - 1
            ix = min(max(int(x + dx * t), node_x * side), min((node_x + 1) * side, columns) - 1)
        outside = ix < 0 or ix >= columns or iy < 0 or iy >= rows
        if outside:
            # The triangle at the start may be met again, in an image of the map.
            start_x = -1
            if edges == OPEN:
                break
            if edges == PERIODIC:
                if ix < 0 or ix >= columns:
                    x += -columns if dx > 0 else columns
                    ix = 0 if dx > 0 else columns - 1
                else:
                    y += -rows if dy > 0 else rows
                    iy = 0 if dy > 0 else rows - 1
            elif ix < 0 or ix >= columns:
                x = (2 * columns if dx > 0 else 0) - x
                ix = columns - 1 if dx > 0 else 0
                dx, per_x, flip_x = -dx, -per_x, -flip_x
            else:
                y = (2 * rows if dy > 0 else 0) - y
                iy = rows - 1 if dy > 0 else 0
                dy, per_y, flip_y = -dy, -per_y, -flip_y
        elif level < top and (old_x >> (level + 1) != ix >> (level + 1) or old_y >> (level + 1) != iy >> (level + 1)):
            level += 1
    ray[0], ray[1], ray[2] = x + dx * t, y + dy * t, z + dz * t
    ray[3], ray[4], ray[6], ray[7] = dx, dy, flip_x, flip_y
    return status


@compiled
def random_unit(seed: int, stream: int) -> float:
    """Uniform number in [0, 1) of a counter (splitmix64)."""
    state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream) * np.uint64(0xD1B54A32D192ED03)
    for _ in range(2):
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = state ^ (state >> np.uint64(31))
    return float(state >> np.uint64(11)) / 9007199254740992.0


@compiled
def start_above(
    ray: Array,
    number: int,
    shift: Array,
    area: Array,
    incidence: Array,
    high: float,
    mean: float,
    pitch: Array,
    edges: int,
    columns: int,
    rows: int,
) -> float:
    """Start a ray at the top of the map, so that all rays together are spread evenly over a part of it at its mean height.

    Parameters
    ----------
    number, shift : of the ray, and (3,) shifts of the sequence of numbers along x, y and azimuth
    area, incidence : as in :func:`trace`

    Returns
    -------
    float : azimuth of the incidence [rad]; NaN where the ray is beside an open map
    """
    # Roberts' recurrence in three dimensions: even over area and azimuth.
    u = (shift[0] + (number + 1) * 0.8191725133961645) % 1.0
    v = (shift[1] + (number + 1) * 0.6710436067037893) % 1.0
    phi = incidence[2]
    if math.isnan(phi):
        phi = _TURN * ((shift[2] + (number + 1) * 0.5497004779019703) % 1.0)
    cos_phi, sin_phi = math.cos(phi), math.sin(phi)
    cos_i, sin_i = incidence[0], incidence[1]
    back = (high - mean) / cos_i
    x = area[0] + u * (area[1] - area[0]) + back * sin_i * cos_phi / pitch[0]
    y = area[2] + v * (area[3] - area[2]) + back * sin_i * sin_phi / pitch[1]
    if edges == OPEN and not (0 <= x < columns and 0 <= y < rows):
        return math.nan
    ray[0], ray[6] = folded(x, columns, edges)
    ray[1], ray[7] = folded(y, rows, edges)
    ray[2] = high
    ray[3], ray[4], ray[5] = -sin_i * cos_phi * ray[6] / pitch[0], -sin_i * sin_phi * ray[7] / pitch[1], -cos_i
    return phi


@compiled
def reflect(
    ray: Array, normal: Array, pitch: Array, frame: Array, jones: NDArray[np.complex128], epsilon: complex, mirror: bool
) -> None:
    """Reflect a ray at a facet: its direction, the s direction of its frame (3,), and its Jones matrix (2, 2), s first.

    The second axis of a frame is the direction of propagation × the first. E ∝ exp(−iωt).
    """
    dx, dy, dz = ray[3] * pitch[0], ray[4] * pitch[1], ray[5]
    nx, ny, nz = normal[0], normal[1], normal[2]
    cos = -(dx * nx + dy * ny + dz * nz)
    sx, sy, sz = dy * nz - dz * ny, dz * nx - dx * nz, dx * ny - dy * nx
    size = math.sqrt(sx * sx + sy * sy + sz * sz)
    if size > 1e-12:
        sx, sy, sz = sx / size, sy / size, sz / size
    else:
        sx, sy, sz = frame[0], frame[1], frame[2]
    fx, fy, fz = dy * frame[2] - dz * frame[1], dz * frame[0] - dx * frame[2], dx * frame[1] - dy * frame[0]
    c = frame[0] * sx + frame[1] * sy + frame[2] * sz
    q = fx * sx + fy * sy + fz * sz
    cos = min(max(cos, 0.0), 1.0)
    if mirror:
        r_s, r_p = -1.0 + 0.0j, 1.0 + 0.0j
    else:
        inner = np.sqrt(epsilon - 1.0 + cos * cos)
        r_s = -(epsilon - 1.0) / ((cos + inner) * (cos + inner))
        r_p = (epsilon * cos - inner) / (epsilon * cos + inner)
    for column in range(2):
        s, p = jones[0, column], jones[1, column]
        jones[0, column] = r_s * (c * s + q * p)
        jones[1, column] = r_p * (c * p - q * s)
    dx, dy, dz = dx + 2 * cos * nx, dy + 2 * cos * ny, dz + 2 * cos * nz
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    ray[3], ray[4], ray[5] = dx / length / pitch[0], dy / length / pitch[1], dz / length
    frame[0], frame[1], frame[2] = sx, sy, sz


@compiled
def facet_normal(height: Array, pitch: Array, at: NDArray[np.int64], normal: Array) -> None:
    """Unit normal (3,) of the triangle ``at`` (3,) column, row and side."""
    _, p, q = triangle(height, at[0], at[1], at[2] == 1)
    p, q = p / pitch[0], q / pitch[1]
    length = math.sqrt(1 + p * p + q * q)
    normal[0], normal[1], normal[2] = -p / length, -q / length, 1 / length


@compiled
def facets_at(height: Array, pitch: Array, position: Array, facet: Array) -> None:
    """Facets below positions (n, 2) in cells: writes their height, slopes along x and y, and side, (n, 4)."""
    for number in range(position.shape[0]):
        x, y = position[number, 0], position[number, 1]
        ix, iy = min(int(x), height.shape[1] - 2), min(int(y), height.shape[0] - 2)
        x, y = x - ix, y - iy
        upper = x + y > 1 if (ix + iy) & 1 else y > x
        base, p, q = triangle(height, ix, iy, upper)
        facet[number, 0] = base + p * x + q * y
        facet[number, 1], facet[number, 2] = p / pitch[0], q / pitch[1]
        facet[number, 3] = 1.0 if upper else 0.0


@compiled
def follow_from_facets(
    height: Array,
    ceiling: Array,
    offset: NDArray[np.int64],
    low: float,
    pitch: Array,
    edges: int,
    position: Array,
    facet: Array,
    direction: Array,
    leaves: NDArray[np.bool_],
) -> None:
    """Which rays from facets leave the surface without meeting it again.

    Parameters
    ----------
    position, facet : as in :func:`facets_at`
    direction : (n, 3) unit vectors
    leaves : (n,) which rays to follow; is made false for those that meet the surface, or start into it
    """
    ray, at = np.empty(8), np.empty(3, np.int64)
    for number in range(position.shape[0]):
        if not leaves[number]:
            continue
        dx, dy, dz = direction[number, 0], direction[number, 1], direction[number, 2]
        if dz <= facet[number, 1] * dx + facet[number, 2] * dy:
            leaves[number] = False
            continue
        ray[0], ray[1], ray[2] = position[number, 0], position[number, 1], facet[number, 0]
        ray[3], ray[4], ray[5] = dx / pitch[0], dy / pitch[1], dz
        ray[6], ray[7] = 1.0, 1.0
        at[0], at[1] = min(int(ray[0]), height.shape[1] - 2), min(int(ray[1]), height.shape[0] - 2)
        at[2] = int(facet[number, 3])
        leaves[number] = first_hit(height, ceiling, offset, low, edges, ray, at, False) == _ESCAPED


@compiled
def _power(amplitude: complex) -> float:
    return amplitude.real * amplitude.real + amplitude.imag * amplitude.imag


@compiled
def trace(
    height: Array,
    present: NDArray[np.bool_],
    ceiling: Array,
    offset: NDArray[np.int64],
    low: float,
    mean: float,
    pitch: Array,
    edges: int,
    area: Array,
    incidence: Array,
    epsilon: complex,
    mirror: bool,
    rays: int,
    seed: int,
    grid: Array,
    power: Array,
    square: Array,
    balance: Array,
) -> int:
    """Trace rays of one incidence through a part of the map, and add the light that leaves to bins of the half vector's slope.

    Parameters
    ----------
    present : (rows − 1, columns − 1) whether all heights of a cell were measured; light that meets another is lost
    area : (4,) lowest and highest column and row of the part of the map, at its mean height
    incidence : (3,) cos θ_i, sin θ_i, φ_i [rad]; NaN for azimuths all around, which give slopes about the plane of incidence
    grid : (3,) width w and step of the bins, and number of bins on each side of 0: bin ⌊asinh(slope/w)/step⌋
    power : (ORDERS, 2, bins, bins) light of incident s and p, per ray; across by along
    square : (bins, bins) squared power of unpolarised light, all orders
    balance : (2, ORDERS + 1, 2) reflected light by order, and refracted light by the order of the facet; last the lost light

    Returns
    -------
    int : rays whose first facet was measured; all sums are of these
    """
    columns, rows = height.shape[1] - 1, height.shape[0] - 1
    cos_i, sin_i = incidence[0], incidence[1]
    around = math.isnan(incidence[2])
    high = ceiling[offset[offset.size - 2]]
    width, step, half = grid[0], grid[1], int(grid[2])
    ray, frame, normal = np.empty(8), np.empty(3), np.empty(3)
    at = np.empty(3, np.int64)
    jones = np.empty((2, 2), np.complex128)
    shift = np.array([random_unit(seed, 0), random_unit(seed, 1), random_unit(seed, 2)])
    counted = 0
    for number in range(rays):
        phi = start_above(ray, number, shift, area, incidence, high, mean, pitch, edges, columns, rows)
        if math.isnan(phi):
            continue
        cos_phi, sin_phi = math.cos(phi), math.sin(phi)
        frame[0], frame[1], frame[2] = -sin_phi * ray[6], cos_phi * ray[7], 0.0
        jones[0, 0], jones[0, 1], jones[1, 0], jones[1, 1] = 1.0, 0.0, 0.0, ray[6] * ray[7]
        before_s, before_p = 1.0, 1.0
        bounce, order = 0, 0
        while True:
            flip_x, flip_y = ray[6], ray[7]
            status = first_hit(height, ceiling, offset, low, edges, ray, at, bounce == 0)
            # In a mirror image the frame is mirrored, and its second axis points the other way.
            flip_x, flip_y = flip_x * ray[6], flip_y * ray[7]
            frame[0] *= flip_x
            frame[1] *= flip_y
            jones[1, 0] *= flip_x * flip_y
            jones[1, 1] *= flip_x * flip_y
            if status == _HIT and present[at[1], at[0]]:
                counted += bounce == 0
                order = min(bounce, ORDERS - 1)
                bounce += 1
                facet_normal(height, pitch, at, normal)
                reflect(ray, normal, pitch, frame, jones, epsilon, mirror)
                after_s = _power(jones[0, 0]) + _power(jones[1, 0])
                after_p = _power(jones[0, 1]) + _power(jones[1, 1])
                balance[1, order, 0] += before_s - after_s
                balance[1, order, 1] += before_p - after_p
                before_s, before_p = after_s, after_p
                if bounce < _MOST_BOUNCES and before_s + before_p > _NEGLIGIBLE_POWER:
                    continue
                status = _LOST
            if bounce == 0:
                break
            if status != _ESCAPED:
                balance[0, ORDERS, 0] += before_s
                balance[0, ORDERS, 1] += before_p
                break
            balance[0, order, 0] += before_s
            balance[0, order, 1] += before_p
            out_x, out_y = ray[3] * ray[6] * pitch[0], ray[4] * ray[7] * pitch[1]
            rise = cos_i + ray[5]
            p = -(sin_i * cos_phi + out_x) / rise
            q = -(sin_i * sin_phi + out_y) / rise
            if around:
                p, q = p * cos_phi + q * sin_phi, abs(q * cos_phi - p * sin_phi)
            column = min(max(math.floor(math.asinh(p / width) / step) + half, 0), 2 * half - 1)
            row = min(max(math.floor(math.asinh(q / width) / step) + half, 0), 2 * half - 1)
            power[order, 0, row, column] += before_s
            power[order, 1, row, column] += before_p
            square[row, column] += (before_s + before_p) ** 2 / 4
            break
    return counted


@compiled
def record_paths(
    height: Array,
    present: NDArray[np.bool_],
    ceiling: Array,
    offset: NDArray[np.int64],
    low: float,
    mean: float,
    pitch: Array,
    edges: int,
    area: Array,
    incidence: Array,
    rays: int,
    seed: int,
    direction: Array,
    angles: Array,
) -> tuple[int, int]:
    """Follow rays of one incidence through a part of the map, and record those that leave it after more than one reflection.

    Parameters
    ----------
    present, area, incidence : as in :func:`trace`
    direction : (rays, 5) is written: direction that the light leaves to, azimuth that it comes from [rad], and number of reflections
    angles : (rays, RECORDED, 3) is written: cosine of the angle of incidence on every facet, and cosine and sine of the turn from the plane
        of incidence of the last facet to its own

    Returns
    -------
    int : paths that were recorded
    int : rays whose first facet was measured; light that meets others, or leaves an open map sideways, is lost
    """
    columns, rows = height.shape[1] - 1, height.shape[0] - 1
    high = ceiling[offset[offset.size - 2]]
    ray, normal, across, beside = np.empty(8), np.empty(3), np.empty(3), np.empty(3)
    at = np.empty(3, np.int64)
    shift = np.array([random_unit(seed, 0), random_unit(seed, 1), random_unit(seed, 2)])
    recorded, counted = 0, 0
    for number in range(rays):
        phi = start_above(ray, number, shift, area, incidence, high, mean, pitch, edges, columns, rows)
        if math.isnan(phi):
            continue
        bounce = 0
        while True:
            status = first_hit(height, ceiling, offset, low, edges, ray, at, bounce == 0)
            if status != _HIT or not present[at[1], at[0]] or bounce == _MOST_BOUNCES:
                break
            counted += bounce == 0
            facet_normal(height, pitch, at, normal)
            # Directions as without the mirror images.
            nx, ny, nz = normal[0] * ray[6], normal[1] * ray[7], normal[2]
            dx, dy, dz = ray[3] * ray[6] * pitch[0], ray[4] * ray[7] * pitch[1], ray[5]
            cos = min(max(-(dx * nx + dy * ny + dz * nz), 0.0), 1.0)
            sx, sy, sz = dy * nz - dz * ny, dz * nx - dx * nz, dx * ny - dy * nx
            size = max(math.sqrt(sx * sx + sy * sy + sz * sz), 1e-300)
            sx, sy, sz = sx / size, sy / size, sz / size
            if bounce < angles.shape[1]:
                angles[recorded, bounce, 0] = cos
                if bounce > 0:
                    angles[recorded, bounce, 1] = across[0] * sx + across[1] * sy + across[2] * sz
                    angles[recorded, bounce, 2] = beside[0] * sx + beside[1] * sy + beside[2] * sz
            dx, dy, dz = dx + 2 * cos * nx, dy + 2 * cos * ny, dz + 2 * cos * nz
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx / length, dy / length, dz / length
            ray[3], ray[4], ray[5] = dx * ray[6] / pitch[0], dy * ray[7] / pitch[1], dz
            across[0], across[1], across[2] = sx, sy, sz
            beside[0], beside[1], beside[2] = dy * sz - dz * sy, dz * sx - dx * sz, dx * sy - dy * sx
            bounce += 1
        if bounce > 1 and status == _ESCAPED:
            direction[recorded, 0] = ray[3] * ray[6] * pitch[0]
            direction[recorded, 1] = ray[4] * ray[7] * pitch[1]
            direction[recorded, 2] = ray[5]
            direction[recorded, 3], direction[recorded, 4] = phi, bounce
            recorded += 1
    return recorded, counted

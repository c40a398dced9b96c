"""Compiled kernels: slopes of maps and lines, counted and summed in one pass over the heights.

All compiled functions that call each other are in this module, because the compiler's cache of a function does not see changes in other
modules. One thread, no ``fastmath``: results are the same on every run.

Squared slopes are binned by the upper 16 bits of a 32-bit float, in bins of 1/128 octave: no logarithm, no search. Heights are
subtracted in double precision; squares are rounded to single precision for the bins alone, and sums have double precision.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array

_TABLE = 2**16
"""Bins of all 32-bit floats; squares use the first half, NaN may have a sign."""
_TABLES = 4
"""Counts of neighbouring slopes are kept apart: they often fall into one bin, and each addition would wait for the one before."""
_STRIP = 512
"""Quads of a row, or slopes of a line, that are read together: what they need stays in the nearest cache."""
_SECOND, _THIRD, _FOURTH, _FIFTH, _SIXTH, _SEVENTH = (part * (_STRIP + 16) for part in range(1, 7))
"""Where parts of one array begin. Since these distances are known, the compiler sees that no result overlaps an operand, and vectorises.

They are no powers of two: parts at such distances would displace each other from the nearest cache.
"""
_UPPER_HALF = 1 if np.little_endian else 0
_MOVED = 128
"""Bins that are moved together, unless all are empty."""


@compiled
def _read_row(height: Array, row: int, first: int, at: int, quantum: float, out: Array) -> None:
    """Heights of a row from the column ``first`` on, dithered as :func:`brdfpipe.facets.height_quantisation.dither` says."""
    if quantum == 0:
        for k in range(out.size):
            out[k] = height[row, first + k]
        return
    for k in range(out.size):
        mixed = (np.uint64(at + row) << np.uint64(32) | np.uint64(first + k)) * np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
        out[k] = height[row, first + k] + quantum * (np.float64(mixed >> np.uint64(11)) * 2.0**-53 - 0.5)


@compiled
def _begin_quads(top: Array, pitch: Array, tilt: Array, totals: Array, squares: NDArray[np.float32]) -> None:
    """Empty the totals, and keep the slopes along x of the first row of heights for :func:`_add_quads`."""
    lean_x, per_x, tilt_x = tilt[0] * pitch[0], np.float32(1 / pitch[0]), np.float32(tilt[0])
    totals[:] = 0.0
    for k in range(top.size - 1):
        rise = top[k + 1] - top[k]
        p = np.float32(rise) * per_x - tilt_x
        squares[_FIFTH + k] = p * p
        totals[_FOURTH + k] = rise - lean_x


@compiled
def _add_quads(
    above: Array, below: Array, pitch: Array, tilt: Array, totals: Array, squares: NDArray[np.float32]
) -> None:
    """Squared slopes of the four triangles of each quad between two rows of heights, in the first four parts of ``squares``.

    The first three parts of ``totals`` get products of the rises of each column without their tilt: the squares of the lower along x
    and of the left along y, and those of both, of all four triangles. The other parts of both hold the rises along x, the upper of
    which were the lower of the row before, and those along y, each of which is left of one quad and right of another.
    """
    lean_x, lean_y = tilt[0] * pitch[0], tilt[1] * pitch[1]
    per_x, per_y = np.float32(1 / pitch[0]), np.float32(1 / pitch[1])
    tilt_x, tilt_y = np.float32(tilt[0]), np.float32(tilt[1])
    for k in range(above.size):
        left = below[k] - above[k]
        q = np.float32(left) * per_y - tilt_y
        squares[_SIXTH + k] = q * q
        totals[_FIFTH + k] = left - lean_y
    for k in range(above.size - 1):
        rise = below[k + 1] - below[k]
        p_below = np.float32(rise) * per_x - tilt_x
        p, p_below = squares[_FIFTH + k], p_below * p_below
        q, q_right = squares[_SIXTH + k], squares[_SIXTH + k + 1]
        squares[_FIFTH + k] = p_below
        squares[k] = p + q
        squares[_SECOND + k] = p + q_right
        squares[_THIRD + k] = p_below + q
        squares[_FOURTH + k] = p_below + q_right
        top, bottom = totals[_FOURTH + k], rise - lean_x
        left, right = totals[_FIFTH + k], totals[_FIFTH + k + 1]
        totals[_FOURTH + k] = bottom
        totals[k] += bottom * bottom
        totals[_SECOND + k] += left * left
        totals[_THIRD + k] += (top + bottom) * (left + right)


@compiled
def _count(bits: NDArray[np.uint16], size: int, tables: NDArray[np.uint32]) -> None:
    """Add to each table ``size`` squares of one part of ``bits``."""
    first, second, third, fourth = tables[0], tables[1], tables[2], tables[3]
    for k in range(size):
        upper = 2 * k + _UPPER_HALF
        first[bits[upper]] += np.uint32(1)
        second[bits[2 * _SECOND + upper]] += np.uint32(1)
        third[bits[2 * _THIRD + upper]] += np.uint32(1)
        fourth[bits[2 * _FOURTH + upper]] += np.uint32(1)


@compiled
def move_counts(tables: NDArray[np.uint32], counts: NDArray[np.int64]) -> None:
    """Add the tables to counts (bins,), and empty them."""
    first, second, third, fourth = tables[0], tables[1], tables[2], tables[3]
    for start in range(0, counts.size, _MOVED):
        stop, occupied = min(start + _MOVED, counts.size), np.uint32(0)
        for k in range(start, stop):
            occupied |= first[k] | second[k] | third[k] | fourth[k]
        if occupied == 0:
            continue
        for k in range(start, stop):
            counts[k] += np.int64(first[k]) + second[k] + third[k] + fourth[k]
            first[k] = second[k] = third[k] = fourth[k] = 0
    # Infinity, and NaN of either sign, are not counted.
    tables[:, counts.size : _TABLE // 2] = 0
    tables[:, _TABLE // 2 + counts.size :] = 0


def empty_tables() -> NDArray[np.uint32]:
    """Tables for the counts of squared slopes."""
    return np.zeros((_TABLES, _TABLE), dtype=np.uint32)


@compiled
def count_map_slopes(
    height: Array,
    at: int,
    columns: NDArray[np.int64],
    pitch: Array,
    quantum: float,
    tilt: Array,
    counts: NDArray[np.int64],
    sums: Array,
) -> None:
    """Count the four triangles of every quad in a row of blocks of a map, and sum the products of their slopes.

    Parameters
    ----------
    height : (rows, columns) um, of one row of blocks with its border heights
    at : row of the map where it begins
    columns : (blocks + 1,) borders of the blocks
    pitch : (2,) um, along x and y
    quantum : step over which the heights are dithered [um]; 0 for none
    tilt : (2,) slopes along x and y that are subtracted
    counts : (blocks, bins) to which the facets are added by the upper 16 bits of their squared slopes; NaN and infinity are left out
    sums : (blocks, 6) number of facets, and their sums of p, q, p², q² and pq; not finite where a height is missing
    """
    rows, lean_x, lean_y = height.shape[0], tilt[0] * pitch[0], tilt[1] * pitch[1]
    tables = np.zeros((_TABLES, _TABLE), dtype=np.uint32)
    squares, totals, lines = np.empty(_SEVENTH, dtype=np.float32), np.empty(_SIXTH), np.empty((3, _STRIP + 1))
    bits = squares.view(np.uint16)
    sums[:] = 0.0
    for block in range(columns.size - 1):
        rise_x, rise_y = 0.0, 0.0
        for first in range(columns[block], columns[block + 1], _STRIP):
            quads = min(columns[block + 1] - first, _STRIP)
            top, below = lines[2, : quads + 1], lines[0, : quads + 1]
            _read_row(height, 0, first, at, quantum, top)
            above = top
            _begin_quads(top, pitch, tilt, totals, squares)
            for row in range(1, rows):
                below = lines[row & 1, : quads + 1]
                _read_row(height, row, first, at, quantum, below)
                _add_quads(above, below, pitch, tilt, totals, squares)
                _count(bits, quads, tables)
                rise_x += (above[quads] - above[0]) + (below[quads] - below[0])
                left, right = below[0] - above[0] - lean_y, below[quads] - above[quads] - lean_y
                sums[block, 4] += 2 * (right * right - left * left) / pitch[1] ** 2
                above = below
            # A row or a column inside the strip has quads on both sides.
            for k in range(quads):
                first_row, last_row = top[k + 1] - top[k] - lean_x, below[k + 1] - below[k] - lean_x
                both_sides = 2 * totals[k] + first_row * first_row - last_row * last_row
                rise_y += (below[k] - top[k]) + (below[k + 1] - top[k + 1])
                sums[block, 3] += 2 * both_sides / pitch[0] ** 2
                sums[block, 4] += 4 * totals[_SECOND + k] / pitch[1] ** 2
                sums[block, 5] += totals[_THIRD + k] / (pitch[0] * pitch[1])
        move_counts(tables, counts[block])
        facets = 4 * (rows - 1) * (columns[block + 1] - columns[block])
        sums[block, 0] = facets
        sums[block, 1] = 2 * rise_x / pitch[0] - facets * tilt[0]
        sums[block, 2] = 2 * rise_y / pitch[1] - facets * tilt[1]


@compiled
def facet_slopes(
    height: Array, row: int, first: int, at: int, pitch: Array, quantum: float, tilt: Array, slopes: Array
) -> None:
    """Slopes (2, rows, 4, quads) along x and y of the four triangles of quads from a row and a column on, less ``tilt``; as :func:`count_map_slopes`."""
    quads = slopes.shape[3]
    lines = np.empty((2, quads + 1))
    for k in range(slopes.shape[1] + 1):
        above, below = lines[1 - (k & 1)], lines[k & 1]
        _read_row(height, row + k, first, at, quantum, below)
        if k == 0:
            continue
        along, across = slopes[0, k - 1], slopes[1, k - 1]
        for n in range(quads):
            p, p_below = (
                (above[n + 1] - above[n]) * (1 / pitch[0]) - tilt[0],
                (below[n + 1] - below[n]) * (1 / pitch[0]) - tilt[0],
            )
            q, q_right = (
                (below[n] - above[n]) * (1 / pitch[1]) - tilt[1],
                (below[n + 1] - above[n + 1]) * (1 / pitch[1]) - tilt[1],
            )
            along[0, n], along[1, n], along[2, n], along[3, n] = p, p, p_below, p_below
            across[0, n], across[1, n], across[2, n], across[3, n] = q, q_right, q, q_right


@compiled
def sum_gentle_slopes(slopes: Array, limit: float, sums: Array) -> None:
    """Add to ``sums`` (6,) the number of facets gentler than a limit, and their sums of p, q, p², q² and pq, from ``slopes`` (2, facets).

    Facets that touch a missing height are left out.
    """
    for k in range(slopes.shape[1]):
        p, q = slopes[0, k], slopes[1, k]
        if p * p + q * q < limit * limit:
            sums[0] += 1
            sums[1] += p
            sums[2] += q
            sums[3] += p * p
            sums[4] += q * q
            sums[5] += p * q


@compiled
def count_scaled_slopes(slopes: Array, scaling: Array, tables: NDArray[np.uint32]) -> None:
    """Add slopes (2, facets) times a (2, 2) matrix to tables of :func:`empty_tables`, by the upper 16 bits of their squares."""
    squares = np.empty(_FIFTH, dtype=np.float32)
    bits = squares.view(np.uint16)
    for start in range(0, slopes.shape[1], squares.size):
        p, q = slopes[0, start : start + squares.size], slopes[1, start : start + squares.size]
        for k in range(p.size):
            x, y = p[k] * scaling[0, 0] + q[k] * scaling[0, 1], p[k] * scaling[1, 0] + q[k] * scaling[1, 1]
            squares[k] = x * x + y * y
        squares[p.size :] = np.nan
        _count(bits, _SECOND, tables)


@compiled
def count_in_cells(slopes: Array, scaling: Array, borders: Array, counts: NDArray[np.int64]) -> None:
    """Add slopes (2, facets) times a (2, 2) matrix to counts (across, along) of square cells between ``borders`` (cells − 1,).

    The outer cells have no end. Missing slopes are left out.
    """
    # Cells by even steps: no step is wider than the narrowest cell, so the cell is that of the step, or the next one.
    low, narrowest = borders[0], np.min(borders[1:] - borders[:-1])
    steps = int(np.ceil((borders[-1] - low) / narrowest))
    per_step = steps / (borders[-1] - low)
    cell_of_step = np.searchsorted(borders, low + np.arange(steps + 2) / per_step, side="right")
    for k in range(slopes.shape[1]):
        p, q = slopes[0, k], slopes[1, k]
        x, y = p * scaling[0, 0] + q * scaling[0, 1], p * scaling[1, 0] + q * scaling[1, 1]
        if math.isfinite(x + y):
            counts[_cell(y, borders, per_step, cell_of_step), _cell(x, borders, per_step, cell_of_step)] += 1


@compiled
def _cell(slope: float, borders: Array, per_step: float, cell_of_step: NDArray[np.int64]) -> int:
    if slope < borders[0]:
        return 0
    cell = cell_of_step[int(min((slope - borders[0]) * per_step, cell_of_step.size - 2.0))]
    while cell < borders.size and slope >= borders[cell]:
        cell += 1
    while cell > 0 and slope < borders[cell - 1]:
        cell -= 1
    return cell


@compiled
def count_line_slopes(ahead: Array, behind: Array, per: float, shift: float, tables: NDArray[np.uint32]) -> None:
    """Add slopes along a line, (ahead − behind) · per − shift, to tables of :func:`empty_tables`, by the upper 16 bits of their squares."""
    squares = np.empty(_FIFTH, dtype=np.float32)
    bits = squares.view(np.uint16)
    for start in range(0, ahead.size, squares.size):
        after, before = ahead[start : start + squares.size], behind[start : start + squares.size]
        for k in range(after.size):
            slope = np.float32((np.float64(after[k]) - before[k]) * per - shift)
            squares[k] = slope * slope
        squares[after.size :] = np.nan
        _count(bits, _SECOND, tables)

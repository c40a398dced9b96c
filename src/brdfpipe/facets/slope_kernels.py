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

_TABLE = 2**15
"""Bins of finite squares, of infinity and of NaN."""
_TABLES = 4
"""Counts of neighbouring slopes are kept apart: they often fall into one bin, and each addition would wait for the one before."""
_LINE_PART = 1024
"""Slopes of a line that are binned together."""
_UPPER_HALF = 1 if np.little_endian else 0


@compiled
def _dithered_row(height: Array, row: int, first: int, at: int, quantum: float, out: Array) -> None:
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


# Short loops of few arrays: the compiler vectorises them, since it can check that no result overlaps an operand.


@compiled
def _add_slopes(
    ahead: Array, behind: Array, per: float, tilt: float, weight: float, slope: Array, total: Array
) -> None:
    """Slopes, whose weighted squares are added to a total of each column."""
    for k in range(slope.size):
        value = (ahead[k] - behind[k]) * per - tilt
        slope[k] = value
        total[k] += weight * (value * value)


@compiled
def _single_squares(
    ahead: Array, behind: Array, per: np.float32, tilt: np.float32, square: NDArray[np.float32]
) -> None:
    for k in range(square.size):
        slope = np.float32(ahead[k] - behind[k]) * per - tilt
        square[k] = slope * slope


@compiled
def _two_sums(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    first: NDArray[np.float32],
    second: NDArray[np.float32],
) -> None:
    for k in range(first.size):
        first[k] = a[k] + b[k]
        second[k] = a[k] + c[k]


@compiled
def _add_products(a: Array, b: Array, c: Array, d: Array, total: Array) -> None:
    for k in range(total.size):
        total[k] += (a[k] + b[k]) * (c[k] + d[k])


@compiled
def _count(bits: NDArray[np.uint16], size: int, tables: NDArray[np.uint32]) -> None:
    """Add to each table the squares of one row of ``bits``."""
    for k in range(size):
        upper = 2 * k + _UPPER_HALF
        tables[0, bits[0, upper] & (_TABLE - 1)] += np.uint32(1)
        tables[1, bits[1, upper] & (_TABLE - 1)] += np.uint32(1)
        tables[2, bits[2, upper] & (_TABLE - 1)] += np.uint32(1)
        tables[3, bits[3, upper] & (_TABLE - 1)] += np.uint32(1)


@compiled
def move_counts(tables: NDArray[np.uint32], counts: NDArray[np.int64]) -> None:
    """Add the tables to counts (bins,), and empty them."""
    for table in tables:
        for k in range(counts.size):
            counts[k] += table[k]
    tables[:] = 0


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
    rows, widest = height.shape[0], 1 + np.max(columns[1:] - columns[:-1])
    tables = np.zeros((_TABLES, _TABLE), dtype=np.uint32)
    squares = np.empty((_TABLES, widest), dtype=np.float32)
    bits = squares.view(np.uint16)
    square_x, square_y = np.empty((2, widest), dtype=np.float32), np.empty(widest, dtype=np.float32)
    lines, slope_x, slope_y = np.empty((2, widest)), np.empty((2, widest)), np.empty(widest)
    top, totals = np.empty(widest), np.empty((3, widest))
    per_x, per_y = 1 / pitch[0], 1 / pitch[1]
    single_x, single_y = np.float32(per_x), np.float32(per_y)
    tilt_x, tilt_y = np.float32(tilt[0]), np.float32(tilt[1])
    for block in range(columns.size - 1):
        first, quads = columns[block], columns[block + 1] - columns[block]
        if quads == 0:
            continue
        totals[:] = 0.0
        rise_x, rise_y = 0.0, 0.0
        for row in range(rows):
            new, old = row & 1, 1 - (row & 1)
            line = lines[new, : quads + 1]
            _dithered_row(height, row, first, at, quantum, line)
            # A row or a column inside the block has quads on both sides.
            weight = 2.0 if 0 < row < rows - 1 else 1.0
            _add_slopes(line[1:], line[:-1], per_x, tilt[0], weight, slope_x[new, :quads], totals[0, :quads])
            _single_squares(line[1:], line[:-1], single_x, tilt_x, square_x[new, :quads])
            rise_x += weight * (line[quads] - line[0])
            if row == 0:
                top[: quads + 1] = line
                continue
            before = lines[old, : quads + 1]
            _add_slopes(line, before, per_y, tilt[1], 2.0, slope_y[: quads + 1], totals[1, : quads + 1])
            _single_squares(line, before, single_y, tilt_y, square_y[: quads + 1])
            left, right = square_y[:quads], square_y[1 : quads + 1]
            _two_sums(square_x[0, :quads], left, right, squares[0, :quads], squares[1, :quads])
            _two_sums(square_x[1, :quads], left, right, squares[2, :quads], squares[3, :quads])
            _count(bits, quads, tables)
            _add_products(
                slope_x[0, :quads], slope_x[1, :quads], slope_y[:quads], slope_y[1 : quads + 1], totals[2, :quads]
            )
        move_counts(tables, counts[block])
        bottom = lines[(rows - 1) & 1]
        for k in range(quads + 1):
            rise_y += (1.0 if k == 0 or k == quads else 2.0) * (bottom[k] - top[k])
        totals[1, 0] /= 2
        totals[1, quads] /= 2
        facets = 4 * (rows - 1) * quads
        sums[block, 0] = facets
        sums[block, 1] = 2 * rise_x * per_x - facets * tilt[0]
        sums[block, 2] = 2 * rise_y * per_y - facets * tilt[1]
        sums[block, 3] = 2 * totals[0, :quads].sum()
        sums[block, 4] = 2 * totals[1, : quads + 1].sum()
        sums[block, 5] = totals[2, :quads].sum()


@compiled
def _row_of_slopes(
    height: Array,
    row: int,
    first: int,
    at: int,
    pitch: Array,
    quantum: float,
    tilt: Array,
    lines: Array,
    slope_x: Array,
    slope_y: Array,
) -> None:
    """Read the next row of a block: its slopes along x into ``slope_x`` (2, quads) by turns, those along y from the row before."""
    quads, new, old = slope_x.shape[1], row & 1, 1 - (row & 1)
    _dithered_row(height, row, first, at, quantum, lines[new])
    for k in range(quads):
        slope_x[new, k] = (lines[new, k + 1] - lines[new, k]) * (1 / pitch[0]) - tilt[0]
    for k in range(quads + 1):
        slope_y[k] = (lines[new, k] - lines[old, k]) * (1 / pitch[1]) - tilt[1]


@compiled
def sum_gentle_slopes(
    height: Array,
    at: int,
    columns: NDArray[np.int64],
    pitch: Array,
    quantum: float,
    tilt: Array,
    limit: float,
    sums: Array,
) -> None:
    """Number of facets gentler than a limit, and their sums of p, q, p², q² and pq, in ``sums`` (blocks, 6); as :func:`count_map_slopes`.

    Facets that touch a missing height are left out.
    """
    sums[:] = 0
    for block in range(columns.size - 1):
        first, quads = columns[block], columns[block + 1] - columns[block]
        lines, slope_x, slope_y = np.empty((2, quads + 1)), np.empty((2, quads)), np.empty(quads + 1)
        for row in range(height.shape[0]):
            _row_of_slopes(height, row, first, at, pitch, quantum, tilt, lines, slope_x, slope_y)
            if row == 0:
                continue
            for side in range(2):
                for k in range(quads):
                    for end in range(2):
                        p, q = slope_x[side, k], slope_y[k + end]
                        if p * p + q * q < limit * limit:
                            sums[block, 0] += 1
                            sums[block, 1] += p
                            sums[block, 2] += q
                            sums[block, 3] += p * p
                            sums[block, 4] += q * q
                            sums[block, 5] += p * q


@compiled
def count_scaled_slopes(
    height: Array,
    at: int,
    columns: NDArray[np.int64],
    pitch: Array,
    quantum: float,
    tilt: Array,
    scaling: Array,
    counts: NDArray[np.int64],
) -> None:
    """Count as :func:`count_map_slopes`, after multiplying the slopes (p, q) with a (2, 2) matrix in double precision."""
    tables = np.zeros((_TABLES, _TABLE), dtype=np.uint32)
    for block in range(columns.size - 1):
        first, quads = columns[block], columns[block + 1] - columns[block]
        lines, slope_x, slope_y = np.empty((2, quads + 1)), np.empty((2, quads)), np.empty(quads + 1)
        squares = np.empty((_TABLES, quads), dtype=np.float32)
        bits = squares.view(np.uint16)
        for row in range(height.shape[0]):
            _row_of_slopes(height, row, first, at, pitch, quantum, tilt, lines, slope_x, slope_y)
            if row == 0:
                continue
            for side in range(2):
                for end in range(2):
                    for k in range(quads):
                        p, q = slope_x[side, k], slope_y[k + end]
                        x, y = p * scaling[0, 0] + q * scaling[0, 1], p * scaling[1, 0] + q * scaling[1, 1]
                        squares[2 * side + end, k] = x * x + y * y
            _count(bits, quads, tables)
        move_counts(tables, counts[block])


@compiled
def count_in_cells(
    height: Array,
    at: int,
    columns: NDArray[np.int64],
    pitch: Array,
    quantum: float,
    tilt: Array,
    scaling: Array,
    borders: Array,
    counts: NDArray[np.int64],
) -> None:
    """Count scaled slopes, as :func:`count_scaled_slopes`, in square cells between ``borders`` (cells − 1,) along both axes.

    ``counts`` is (blocks, cells, cells), across and along; the outer cells have no end.
    """
    # Cells by even steps: no step is wider than the narrowest cell, so the cell is that of the step, or the next one.
    low, narrowest = borders[0], np.min(borders[1:] - borders[:-1])
    steps = int(np.ceil((borders[-1] - low) / narrowest))
    per_step = steps / (borders[-1] - low)
    cell_of_step = np.searchsorted(borders, low + np.arange(steps + 2) / per_step, side="right")
    for block in range(columns.size - 1):
        first, quads = columns[block], columns[block + 1] - columns[block]
        lines, slope_x, slope_y = np.empty((2, quads + 1)), np.empty((2, quads)), np.empty(quads + 1)
        for row in range(height.shape[0]):
            _row_of_slopes(height, row, first, at, pitch, quantum, tilt, lines, slope_x, slope_y)
            if row == 0:
                continue
            for side in range(2):
                for k in range(quads):
                    for end in range(2):
                        p, q = slope_x[side, k], slope_y[k + end]
                        x, y = p * scaling[0, 0] + q * scaling[0, 1], p * scaling[1, 0] + q * scaling[1, 1]
                        if not math.isfinite(x + y):
                            continue
                        along, across = (
                            _cell(x, borders, per_step, cell_of_step),
                            _cell(y, borders, per_step, cell_of_step),
                        )
                        counts[block, across, along] += 1


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
def count_line_slopes(slopes: Array, tables: NDArray[np.uint32]) -> None:
    """Add slopes of a line to tables of :func:`empty_tables`, by the upper 16 bits of their squares."""
    squares = np.empty((_TABLES, _LINE_PART), dtype=np.float32)
    bits = squares.view(np.uint16)
    for start in range(0, slopes.size, _TABLES * _LINE_PART):
        for row in range(_TABLES):
            part = slopes[start + row * _LINE_PART : start + (row + 1) * _LINE_PART]
            for k in range(part.size):
                slope = np.float32(part[k])
                squares[row, k] = slope * slope
            for k in range(part.size, _LINE_PART):
                squares[row, k] = np.nan
        _count(bits, _LINE_PART, tables)


def empty_tables() -> NDArray[np.uint32]:
    """Tables for :func:`count_line_slopes`."""
    return np.zeros((_TABLES, _TABLE), dtype=np.uint32)

"""Slopes of a height map's facets, and what they say as a whole.

Every quad is cut along both diagonals into four triangles; a single diagonal would correlate the two slope components and
show a false lay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array

SCALES = np.array([1.0, 2.0, 4.0, 8.0])
"""Distances, in pixels, over which the slope rms is reported."""

BLOCKS = 8
"""A map is cut into this many blocks along each axis, a line into their square."""


class Moments(NamedTuple):
    """First and second moments of the slopes."""

    facets: int
    mean: Array
    """(2,) mean slope along x and y."""
    covariance: Array
    """(2, 2) about the mean."""

    @property
    def slope_rms(self) -> float:
        return float(np.sqrt(np.trace(self.covariance) + self.mean @ self.mean))

    @property
    def anisotropy(self) -> float:
        """Larger over smaller principal slope rms; NaN where one of them vanishes."""
        smaller, larger = np.linalg.eigvalsh(self.covariance)
        return float(np.sqrt(larger / smaller)) if smaller > 0 else float("nan")

    @property
    def lay(self) -> float:
        """Azimuth of the smaller principal slope rms, an axis in [-90, 90) degree."""
        x, y = np.linalg.eigh(self.covariance)[1][:, 0]
        return float((np.degrees(np.arctan2(y, x)) + 90) % 180 - 90)


def pitch_of(surface: xr.Dataset) -> tuple[float, float]:
    """Pitch along x and y of a map [um]."""
    return float(surface.attrs["pitch_x"]), float(surface.attrs["pitch_y"])


class SlopeCounts(NamedTuple):
    """Counts of squared slopes in bins of one 128th of an octave, block by block: the upper half of a 32-bit float's bits."""

    counts: NDArray[np.int64]
    """(blocks, bins)"""

    @property
    def edges(self) -> Array:
        """(bins + 1,) slopes that bound the bins."""
        bits = np.arange(FINE_BINS + 1, dtype=np.uint32) << 16
        return np.sqrt(bits.view(np.float32).astype(float))


FINE_BINS = 0x7F80
"""Upper half of the bits of infinity: what lies below is finite, what lies above is no number."""

_BLOCK_POINTS = 2**15


def _blocks(maps: Sequence[xr.Dataset]) -> Iterator[tuple[int, Array, tuple[float, float]]]:
    """Blocks of the maps that share their border heights, a few hundred thousand heights at a time, and the pitch."""
    for scan, surface in enumerate(maps):
        height, pitch = surface["height"].values, pitch_of(surface)
        rows = np.linspace(0, height.shape[0] - 1, BLOCKS + 1).astype(int)
        columns = np.linspace(0, height.shape[1] - 1, BLOCKS + 1).astype(int)
        for block in range(BLOCKS**2):
            row, column = divmod(block, BLOCKS)
            across = slice(columns[column], columns[column + 1] + 1)
            step = max(1, _BLOCK_POINTS // max(1, across.stop - across.start))
            for start in range(rows[row], rows[row + 1], step):
                part = height[start : min(start + step, rows[row + 1]) + 1, across]
                yield scan * BLOCKS**2 + block, part, pitch


def _edges_of(part: Array, pitch: tuple[float, float], dtype: type = np.float64) -> tuple[Array, Array]:
    """Slopes of the edges of a block's quads, along x (rows + 1, columns) and along y (rows, columns + 1).

    Heights are subtracted in double precision whatever ``dtype`` the slopes are kept in.
    """
    rows, columns = part.shape
    along_x, along_y = np.empty((rows, columns - 1), dtype), np.empty((rows - 1, columns), dtype)
    np.subtract(part[:, 1:], part[:, :-1], out=along_x, dtype=np.float64, casting="same_kind")
    np.subtract(part[1:], part[:-1], out=along_y, dtype=np.float64, casting="same_kind")
    along_x *= dtype(1 / pitch[0])
    along_y *= dtype(1 / pitch[1])
    return along_x, along_y


def _triangles(along_x: Array, along_y: Array) -> Iterator[tuple[Array, Array]]:
    """The edges along x and y of each of a quad's four triangles."""
    for edge_x in (along_x[:-1], along_x[1:]):
        for edge_y in (along_y[:, :-1], along_y[:, 1:]):
            yield edge_x, edge_y


def triangle_slopes(maps: Sequence[xr.Dataset]) -> Iterator[tuple[int, Array, Array]]:
    """Slopes (p, q) of the four triangles of every quad, block by block; a triangle that touches a missing height is left out.

    Yields the number of the block, p and q.
    """
    for block, part, pitch in _blocks(maps):
        along_x, along_y = _edges_of(part, pitch)
        whole = bool(np.isfinite(along_x).all() and np.isfinite(along_y).all())
        for p, q in _triangles(along_x, along_y):
            if whole:
                yield block, p.ravel(), q.ravel()
            else:
                complete = np.isfinite(p) & np.isfinite(q)
                yield block, p[complete], q[complete]


def count_maps(maps: Sequence[xr.Dataset]) -> tuple[SlopeCounts, Moments]:
    """Counts of the squared slopes of every triangle of one or several scans, and the moments of the slopes, in one pass.

    Squares are binned by the bits of a 32-bit float, in bins of 0.5 %: no logarithm, no search. A triangle that touches a missing
    height has no number for a slope, and falls beyond the last bin by itself.
    """
    counts = np.zeros((len(maps) * BLOCKS**2, FINE_BINS), dtype=np.int64)
    facets, total, products = 0, np.zeros(2), np.zeros(3)
    for block, part, pitch in _blocks(maps):
        along_x, along_y = _edges_of(part, pitch, np.float32)
        square_x, square_y = along_x * along_x, along_y * along_y
        squares = np.empty((4, square_y.shape[0], square_x.shape[1]), dtype=np.float32)
        for square, (xx, yy) in zip(squares, _triangles(square_x, square_y), strict=True):
            np.add(xx, yy, out=square)
        counts[block] += count_bits(squares)
        n, first, second = _block_moments(part, pitch, (along_x, along_y), (square_x, square_y))
        facets, total, products = facets + n, total + first, products + second
    if facets == 0:
        return SlopeCounts(counts), Moments(0, np.zeros(2), np.zeros((2, 2)))
    mean = total / facets
    square_mean = products / facets
    covariance = np.array([[square_mean[0], square_mean[2]], [square_mean[2], square_mean[1]]]) - np.outer(mean, mean)
    return SlopeCounts(counts), Moments(facets, mean, covariance)


_HIGH = 1 if np.little_endian else 0


def count_bits(squares: NDArray[np.float32]) -> NDArray[np.int64]:
    """Counts by the upper half of the bits; what is no number, of either sign, lies beyond the last bin and is left out."""
    return np.bincount(squares.reshape(-1).view(np.uint16)[_HIGH::2], minlength=FINE_BINS)[:FINE_BINS]


def _block_moments(
    part: Array, pitch: tuple[float, float], along: tuple[Array, Array], square: tuple[Array, Array]
) -> tuple[int, Array, Array]:
    """Number of triangles of a block, sums of p and q, and sums of p², q² and pq over them.

    Every edge along x meets the four edges along y of the quads beside it: sums over triangles are sums over edges. Rows are
    summed in the precision of the slopes, their sums in double precision.
    """
    along_x, along_y = along
    mixed = float(np.einsum("ij,ij->i", along_x[:-1] + along_x[1:], along_y[:, :-1] + along_y[:, 1:]).sum(dtype=float))
    if np.isfinite(mixed):
        # Along a row or a column the slopes add up to what the ends differ by.
        rises = (part[:, -1] - part[:, 0]) / pitch[0], (part[-1] - part[0]) / pitch[1]
        first = 2 * np.array([2 * rise.sum() - rise[0] - rise[-1] for rise in rises])
        # Each edge counts twice for every quad beside it: those on the block's border have one.
        rows_x, rows_y = (each.sum(axis=1).astype(float) for each in square)
        square_x = 2 * rows_x.sum() - rows_x[0] - rows_x[-1]
        square_y = 2 * rows_y.sum() - square[1][:, [0, -1]].sum(dtype=float)
        return 4 * (along_x.shape[0] - 1) * along_x.shape[1], first, np.array([2 * square_x, 2 * square_y, mixed])
    count, first, second = 0, np.zeros(2), np.zeros(3)
    for p, q in _triangles(along_x, along_y):
        complete = np.isfinite(p) & np.isfinite(q)
        p_there, q_there = p[complete].astype(float), q[complete].astype(float)
        count += p_there.size
        first += p_there.sum(), q_there.sum()
        second += inner(p_there, p_there), inner(q_there, q_there), inner(p_there, q_there)
    return count, first, second


def count_line(slopes: Array) -> SlopeCounts:
    """Counts of the squared slopes along a line, in as many blocks as a map has."""
    borders = np.linspace(0, slopes.size, BLOCKS**2 + 1).astype(int)
    counts = np.zeros((BLOCKS**2, FINE_BINS), dtype=np.int64)
    for block, (start, stop) in enumerate(pairwise(borders)):
        square = np.square(slopes[start:stop], dtype=np.float32, casting="same_kind")
        counts[block] = count_bits(square)
    return SlopeCounts(counts)


def slope_rms_by_scale(surface: xr.Dataset) -> Array:
    """Root mean square slope of a map over 1, 2, 4 and 8 pixels, from some of its rows; NaN where the map is too small."""
    height, pitch = surface["height"].values, pitch_of(surface)
    values = []
    for step in SCALES.astype(int):
        if min(height.shape) <= step:
            values.append(np.nan)
            continue
        rows = slice(0, height.shape[0] - step, max(1, height.size // _SAMPLED))
        along_x = (height[rows, step:] - height[rows, :-step]) / (step * pitch[0])
        along_y = (height[step:][rows] - height[rows]) / (step * pitch[1])
        values.append(np.sqrt(mean_square(along_x) + mean_square(along_y)))
    return np.asarray(values)


_SAMPLED = 2**18
"""Heights from which slopes by scale and correlation are taken: more would not tell more."""


def inner(a: Array, b: Array) -> float:
    """Σ a b. Not by BLAS: it splits large sums over threads, and their number would change the last bits."""
    return float(np.einsum("i,i->" if a.ndim == 1 else "ij,ij->", a, b))


def mean_square(values: Array) -> float:
    """Mean square of the values that are there; NaN where none is."""
    finite = values[np.isfinite(values)]
    return inner(finite, finite) / finite.size if finite.size else float("nan")


def correlation_length(surface: xr.Dataset) -> float:
    """Distance at which the height correlation falls to 1/e, the geometric mean over the axes; NaN where it never does."""
    height = surface["height"].values
    pitches = [float(surface.attrs[f"pitch_{axis}"]) for axis in surface["height"].dims]
    lengths = [
        _along(np.moveaxis(height, axis, -1).reshape(-1, n), pitches[axis]) for axis, n in enumerate(height.shape)
    ]
    return float(np.exp(np.mean(np.log(lengths)))) if np.isfinite(lengths).all() else float("nan")


def _along(lines: Array, pitch: float) -> float:
    from scipy.fft import irfft, next_fast_len, rfft

    # Some lines, or stretches of a long one, tell the correlation as well as all of them.
    if lines.shape[1] > 2**16:
        lines = lines[:, : lines.shape[1] // 2**15 * 2**15].reshape(-1, 2**15)
    lines = lines[:: max(1, lines.size // (_SAMPLED // 2))]
    present = np.isfinite(lines)
    if not present.any():
        return float("nan")
    centred = np.where(present, lines - np.nanmean(lines), 0.0).astype(np.float64)
    length = next_fast_len(2 * lines.shape[1], real=True)
    lags = lines.shape[1] // 2

    def power(values: Array) -> Array:
        spectrum = np.zeros(length // 2 + 1)
        for part in np.array_split(values, max(1, values.size // 2**20)):
            transform = rfft(part, length, axis=1)
            spectrum += (transform.real**2 + transform.imag**2).sum(axis=0)
        return np.asarray(irfft(spectrum, length)[:lags])

    if present.all():
        pairs = lines.shape[0] * (lines.shape[1] - np.arange(lags, dtype=float))
    else:
        pairs = power(present.astype(np.float64))
    correlation = power(centred) / np.maximum(pairs, 1.0)
    below = np.flatnonzero(correlation < correlation[0] / np.e) if correlation.size else np.empty(0, int)
    if below.size == 0 or correlation[0] <= 0:
        return float("nan")
    k = below[0]
    step = (correlation[k - 1] - correlation[0] / np.e) / (correlation[k - 1] - correlation[k])
    return float((k - 1 + step) * pitch)

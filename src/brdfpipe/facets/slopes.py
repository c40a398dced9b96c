"""Slopes of the facets of a height map: counts, moments, correlation length.

Every quad is cut along both diagonals into four triangles; a single diagonal would correlate the two slope components and
show a false lay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.facets.height_quantisation import height_step
from brdfpipe.geometry import Array
from brdfpipe.psd.noise_floor import NoiseFloor, noise_besides_rounding, noise_floor

SCALES = np.array([1.0, 2.0, 4.0, 8.0])
"""Distances, in pixels, over which the slope rms is reported."""

BLOCKS = 8
"""A map is cut into this many blocks along each axis."""


class HeightMap(NamedTuple):
    """Heights of a scan, with pitch and quantisation."""

    height: Array
    """(rows, columns) [um]"""
    pitch: tuple[float, float]
    """Along x and y [um]."""
    quantum: float
    """Quantisation step of the heights [um], over which they are dithered; 0 if they are not quantised."""
    noise: float = 0.0
    """Rms of white height noise besides rounding [um]."""
    noise_u: float = 0.0
    """Standard uncertainty of the noise [um]."""

    @classmethod
    def of(cls, surface: xr.Dataset, noise: float | NoiseFloor | None = None) -> HeightMap:
        """The heights of a map; its ``noise`` [um] is that of the plateau of its spectrum, unless it is given."""
        height, pitch = surface["height"].values, (float(surface.attrs["pitch_x"]), float(surface.attrs["pitch_y"]))
        step, floor = height_step(height, pitch), noise_floor(surface, noise)
        return cls(height, pitch, step, noise_besides_rounding(floor, step), floor.uncertainty)

    @property
    def rounding(self) -> Array:
        """(2,) mean square that rounding and noise add to the slopes along x and y."""
        return (self.quantum**2 / 6 + 2 * self.noise**2) / np.square(self.pitch)

    @property
    def added(self) -> Array:
        """(2,) mean square that rounding, dither and noise add to the counted slopes along x and y."""
        return (self.quantum**2 / 3 + 2 * self.noise**2) / np.square(self.pitch)

    @property
    def largest_correction(self) -> float:
        """Largest share of the mean square slope that is subtracted."""
        return _LARGEST_NOISE if self.noise else _LARGEST_CORRECTION


_LARGEST_CORRECTION, _LARGEST_NOISE = 0.75, 0.95
"""Largest share of the mean square slope that is subtracted for rounding and dither, and for noise."""


class Moments(NamedTuple):
    """First and second moments of the slopes of one or several scans, without outlying facets (:func:`outlying`)."""

    facets: int
    """Number of all facets."""
    tilts: Array
    """(scans, 2) mean slope along x and y of each scan, removed from all statistics."""
    covariance: Array
    """(2, 2) of the surface's slopes, each scan's about its own mean."""
    apparent_covariance: Array
    """(2, 2) of the counted slopes, including rounding, dither and noise of the heights."""
    scan_rms: Array
    """(scans,) slope rms of each scan."""

    @property
    def slope_rms(self) -> float:
        """Slope rms about the mean, since masking assumes a mean slope of zero."""
        return float(np.sqrt(max(np.trace(self.covariance), 0.0)))

    @property
    def anisotropy(self) -> float:
        """Larger over smaller principal slope rms; NaN where one of them vanishes."""
        smaller, larger = np.linalg.eigvalsh(self.covariance)
        return float(np.sqrt(larger / smaller)) if smaller > 0 else float("nan")

    @property
    def lay(self) -> float:
        """Azimuth of the smaller principal slope rms, an axis in [0, 180) degree."""
        x, y = np.linalg.eigh(self.covariance)[1][:, 0]
        return float(np.degrees(np.arctan2(y, x)) % 180)


FINE_BINS = 0x7F80
"""Bins of squared slopes, of 1/128 octave: the upper 16 bits of a 32-bit float. Those of infinity; NaN has larger ones."""


def fine_edges() -> Array:
    """(FINE_BINS + 1,) slopes that bound the fine bins of squared slopes."""
    bits = np.arange(FINE_BINS + 1, dtype=np.uint32) << 16
    return np.sqrt(bits.view(np.float32).astype(float))


_RowOfBlocks = tuple[Array, int, NDArray[np.int64], Array, float]
"""Heights of a row of blocks with their border, the row where it begins, the columns of the blocks, pitch and quantum."""


def _rows_of_blocks(maps: Sequence[HeightMap]) -> Iterator[tuple[int, slice, _RowOfBlocks]]:
    """Rows of blocks of the maps, with their border heights: the number of the scan, those of the blocks, and what kernels read."""
    for scan, (height, pitch, quantum, *_) in enumerate(maps):
        rows, columns = (np.linspace(0, n - 1, BLOCKS + 1).astype(np.int64) for n in height.shape)
        dtype = np.float32 if height.dtype == np.float32 else np.float64
        for row in np.flatnonzero(np.diff(rows)).tolist():
            part = np.require(height[rows[row] : rows[row + 1] + 1], dtype, ["C", "W"])
            first = scan * BLOCKS**2 + row * BLOCKS
            yield scan, slice(first, first + BLOCKS), (part, int(rows[row]), columns, np.asarray(pitch), quantum)


def mean_slope(heights: HeightMap) -> Array:
    """(2,) mean slope along x and y of a map's facets, from the heights along its border.

    Along a row or a column without gaps, the slopes add up to the difference of its ends. The result is 0 if heights of the
    border are missing, or if it is too small to matter.
    """
    height, pitch = heights.height, heights.pitch
    if min(height.shape) < 2:  # no facet
        return np.zeros(2)
    rises = [
        (height[:, -1] - height[:, 0]) / ((height.shape[1] - 1) * pitch[0]),
        (height[-1] - height[0]) / ((height.shape[0] - 1) * pitch[1]),
    ]
    # A row or a column inside the map has quads on both sides.
    mean = np.array([(2 * rise.sum() - rise[0] - rise[-1]) / (2 * (rise.size - 1)) for rise in rises])
    steps = np.diff(height[:: max(1, height.shape[0] // _SAMPLED_ROWS)], axis=1)
    return mean if np.hypot(*mean) > _NEGLIGIBLE_TILT * np.sqrt(mean_square(steps)) / pitch[0] else np.zeros(2)


_NEGLIGIBLE_TILT = 1e-3
"""Mean slope over slope rms that may stay in the counts: it changes the density by its square."""

_SAMPLED_ROWS = 64


def _slopes_of_blocks(maps: Sequence[HeightMap], tilts: Array) -> Iterator[tuple[int, int, Array]]:
    """Slopes (2, facets) about ``tilts`` of a few rows of a block at a time, with the numbers of the scan and the block."""
    for scan, blocks, part in _rows_of_blocks(maps):
        for column, block in enumerate(range(blocks.start, blocks.stop)):
            for slopes in _slopes_of_block(part, column, tilts[scan]):
                yield scan, block, slopes


def _slopes_of_block(part: _RowOfBlocks, column: int, tilt: Array) -> Iterator[Array]:
    from brdfpipe.facets import slope_kernels

    height, at, columns, pitch, quantum = part
    first, quads = int(columns[column]), int(columns[column + 1] - columns[column])
    for row in range(0, height.shape[0] - 1 if quads else 0, _ROWS):
        slopes = np.empty((2, min(_ROWS, height.shape[0] - 1 - row), 4, quads))
        slope_kernels.facet_slopes(height, row, first, at, pitch, quantum, tilt, slopes)
        yield slopes.reshape(2, -1)


_ROWS = 8
"""Rows of quads whose slopes are held at a time."""


def count_scaled(maps: Sequence[HeightMap], tilts: Array, scaling: Array) -> NDArray[np.int64]:
    """Counts (blocks, fine bins) of the squared slopes about ``tilts``, multiplied by a (2, 2) matrix."""
    from brdfpipe.facets import slope_kernels

    counts, tables = np.zeros((len(maps) * BLOCKS**2, FINE_BINS), dtype=np.int64), slope_kernels.empty_tables()
    for block, parts in groupby(_slopes_of_blocks(maps, tilts), key=itemgetter(1)):
        for *_, slopes in parts:
            slope_kernels.count_scaled_slopes(slopes, scaling, tables)
        slope_kernels.move_counts(tables, counts[block])
    return counts


def count_in_cells(maps: Sequence[HeightMap], tilts: Array, scaling: Array, borders: Array) -> NDArray[np.int64]:
    """Counts (blocks, across, along) of the same slopes in square cells between ``borders`` along both axes."""
    from brdfpipe.facets import slope_kernels

    counts = np.zeros((len(maps) * BLOCKS**2, borders.size + 1, borders.size + 1), dtype=np.int64)
    for _, block, slopes in _slopes_of_blocks(maps, tilts):
        slope_kernels.count_in_cells(slopes, scaling, borders, counts[block])
    return counts


def count_maps(maps: Sequence[HeightMap]) -> tuple[NDArray[np.int64], Moments]:
    """Counts (blocks, fine bins) of the squared slopes of every triangle of one or several scans, and the moments of the slopes.

    Slopes are about each scan's own mean. The border of a map without gaps gives the mean, so that one pass suffices; otherwise
    a second pass counts about the mean of the first. The moments of outlying facets are left out in a further pass.
    """
    tilts = np.array([mean_slope(heights) for heights in maps])
    counts, moments = _count_about(tilts, maps)
    residual_tilt = np.abs(moments.tilts - tilts).max()
    if residual_tilt > _NEGLIGIBLE_TILT * moments.slope_rms:
        tilts = moments.tilts
        counts, moments = _count_about(tilts, maps)
    limit = outlying(counts).slope
    if not np.isfinite(limit):
        return counts, moments
    moments = _moments_below(limit, tilts, maps)._replace(facets=moments.facets)
    residual_tilt = np.abs(moments.tilts - tilts).max()
    if residual_tilt > _NEGLIGIBLE_TILT * moments.slope_rms:
        counts, every = _count_about(moments.tilts, maps)
        moments = _moments_below(limit, moments.tilts, maps)._replace(facets=every.facets)
    return counts, moments


class Outlying(NamedTuple):
    """Facets, or slopes along a line, so much steeper than the others that no statistic of the finish may hang on them."""

    slope: float
    """From which on they are outlying; infinity where there are none."""
    share: float
    """Of all."""
    contribution: float
    """Part of the mean square slope that they hold."""

    def warning(self, what: str, robust: str) -> list[str]:
        """A warning if some of ``what`` are outlying; ``robust`` says which statistics are without them."""
        if not self.share:
            return []
        return [
            f"{100 * self.share:.2g} % of the {what}, steeper than {self.slope:.2g}, hold {self.contribution:.0%} of the mean square slope: "
            f"{robust} without them. If they are not of the finish, mark the spikes as missing heights"
        ]


NOT_OUTLYING = Outlying(float("inf"), 0.0, 0.0)


def outlying(counts: NDArray[np.int64]) -> Outlying:
    """The outlying facets of (blocks, fine bins) counts.

    They are steeper than ten times the median slope, no more than a hundredth of all, and hold over 30 % of the mean
    square slope. Spikes and pits do. A Gaussian has 1e-30 of its facets there, and finishes with a kurtosis of 20 hold 24 % there.
    """
    totals = counts.sum(axis=0)
    occupied = np.flatnonzero(totals)
    if occupied.size == 0:
        return NOT_OUTLYING
    totals, edges = totals[: occupied[-1] + 1], fine_edges()[: occupied[-1] + 2]
    cumulated = np.cumsum(totals) / totals.sum()
    median, steep = (float(edges[np.searchsorted(cumulated, share) + 1]) for share in (0.5, 1 - _MOST_OUTLYING))
    limit = max(_OUTLYING * median, steep)
    squares, outlying = totals * (edges[1:] ** 2 + edges[:-1] ** 2), edges[:-1] >= limit
    found = Outlying(
        limit, float(totals[outlying].sum() / totals.sum()), float(squares[outlying].sum() / squares.sum())
    )
    return found if found.contribution > _LEAST_CONTRIBUTION else NOT_OUTLYING


_OUTLYING, _MOST_OUTLYING = 10.0, 0.01
"""Outlying slopes over the median, and the largest share of all that they are."""

_LEAST_CONTRIBUTION = 0.3
"""Share of the mean square slope above which so few facets are outlying."""


def _moments_below(limit: float, tilts: Array, maps: Sequence[HeightMap]) -> Moments:
    """Moments of the facets whose slopes about ``tilts`` are below a limit."""
    sums = np.zeros((len(maps), 6))
    for scan, _, part in _rows_of_blocks(maps):
        sums[scan] += _sums_below(limit, part, tilts[scan])
    return _moments(maps, tilts, sums)


def _sums_below(limit: float, part: _RowOfBlocks, tilt: Array) -> Array:
    """(6,) sums of the facets of a row of blocks whose slopes are below a limit; none of them touches a missing height."""
    from brdfpipe.facets import slope_kernels

    of_block = np.zeros((BLOCKS, 6))
    for column in range(BLOCKS):
        for slopes in _slopes_of_block(part, column, tilt):
            slope_kernels.sum_gentle_slopes(slopes, limit, of_block[column])
    return np.asarray(of_block.sum(axis=0))


def _count_about(tilts: Array, maps: Sequence[HeightMap]) -> tuple[NDArray[np.int64], Moments]:
    """Counts about given mean slopes, and moments about the exact ones."""
    from brdfpipe.facets import slope_kernels

    counts = np.zeros((len(maps) * BLOCKS**2, FINE_BINS), dtype=np.int64)
    sums, of_row = np.zeros((len(maps), 6)), np.zeros((BLOCKS, 6))
    for scan, blocks, part in _rows_of_blocks(maps):
        slope_kernels.count_map_slopes(*part, tilts[scan], counts[blocks], of_row)
        sums[scan] += of_row.sum(axis=0) if np.isfinite(of_row).all() else _sums_below(np.inf, part, tilts[scan])
    return counts, _moments(maps, tilts, sums)


def _moments(maps: Sequence[HeightMap], tilts: Array, sums: Array) -> Moments:
    """Moments from (scans, 6) the number of facets, and their sums of p, q, p², q² and pq about ``tilts``."""
    facets, total = sums[:, :1], max(float(sums[:, 0].sum()), 1.0)
    mean = sums[:, 1:3] / np.maximum(facets, 1)
    products = sums[:, 3:] - facets * np.column_stack([mean**2, mean.prod(axis=1)])
    xx, yy, xy = products.sum(axis=0) / total
    covariance = apparent = np.array([[xx, xy], [xy, yy]])
    widening = np.array([heights.added for heights in maps])
    if widening.any() and facets.any():
        # If the steps dominate the slopes, the formula for the mean square of rounding no longer holds.
        widest = np.diag((facets * widening).sum(axis=0) / total)
        largest = float(np.linalg.eigvals(np.linalg.solve(apparent, widest)).real.max())
        covariance = apparent - widest * min(1.0, max(heights.largest_correction for heights in maps) / largest)
    squares, left = products[:, :2] / np.maximum(facets, 1), [[1 - heights.largest_correction] for heights in maps]
    rms = np.sqrt(np.maximum(np.maximum(squares - widening, left * squares).sum(axis=1), 0.0))
    return Moments(int(facets.sum()), tilts + mean, covariance, apparent, rms)


def slope_rms_by_scale(heights: HeightMap, tilt: Array, limit: float = np.inf) -> Array:
    """Root mean square slope of a map about ``tilt``, over 1, 2, 4 and 8 pixels, from some of its rows; NaN where it is too small.

    Slopes steeper than a limit are left out.
    """
    height, pitch = heights.height, heights.pitch
    values = []
    for step in SCALES.astype(int):
        if min(height.shape) <= step:
            values.append(np.nan)
            continue
        rows = slice(0, height.shape[0] - step, max(1, height.size // _SAMPLED))
        along_x = (height[rows, step:] - height[rows, :-step]) / (step * pitch[0]) - tilt[0]
        along_y = (height[step:][rows] - height[rows]) / (step * pitch[1]) - tilt[1]
        if np.isfinite(limit):
            along_x, along_y = (np.where(np.abs(slopes) < limit, slopes, np.nan) for slopes in (along_x, along_y))
        square = mean_square(along_x) + mean_square(along_y)
        values.append(
            np.sqrt(
                max(
                    square - heights.rounding.sum() / step**2,
                    square * (1 - max(heights.largest_correction, _LARGEST_CORRECTION)),
                )
            )
        )
    return np.asarray(values)


_SAMPLED = 2**18
"""Heights used for slopes by scale and for the correlation length; more would not change them."""


def inner(a: Array, b: Array) -> float:
    """Σ a b. Not by BLAS: it splits large sums over threads, and their number would change the last bits."""
    return float(np.einsum("i,i->" if a.ndim == 1 else "ij,ij->", a, b))


def mean_square(values: Array) -> float:
    """Mean square of the finite values; NaN if there is none."""
    total = inner(values, values)
    if np.isfinite(total) and values.size:
        return total / values.size
    finite = values[np.isfinite(values)]
    return inner(finite, finite) / finite.size if finite.size else float("nan")


def correlation_length(surface: xr.Dataset) -> float:
    """Distance at which the height correlation falls to 1/e, the geometric mean over the axes; NaN where it never does."""
    height = surface["height"].values
    pitches = [float(surface.attrs[f"pitch_{axis}"]) for axis in surface["height"].dims]
    lengths = [
        _correlation_length_along(np.moveaxis(height, axis, -1).reshape(-1, n), pitches[axis])
        for axis, n in enumerate(height.shape)
    ]
    return float(np.exp(np.mean(np.log(lengths)))) if np.isfinite(lengths).all() else float("nan")


def _correlation_length_along(lines: Array, pitch: float) -> float:
    from scipy.fft import irfft, next_fast_len, rfft

    # Some lines, or parts of a long one, give the correlation as well as all of them.
    if lines.shape[1] > 2**16:
        lines = lines[:, : lines.shape[1] // 2**15 * 2**15].reshape(-1, 2**15)
    lines = np.ascontiguousarray(lines[:: max(1, lines.size // (_SAMPLED // 2))])
    present = np.isfinite(lines)
    if not present.any():
        return float("nan")
    centred = np.where(present, lines - lines[present].mean(), 0.0).astype(np.float64)
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

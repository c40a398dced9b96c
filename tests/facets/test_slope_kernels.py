"""The compiled kernels against the same arithmetic in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.facets import slope_kernels
from brdfpipe.facets.height_quantisation import dither
from brdfpipe.facets.planar_density import SlopeAxis
from brdfpipe.facets.slopes import FINE_BINS, HeightMap, count_in_cells, count_maps, count_scaled, mean_slope

PITCH, SCALING = (0.5, 2.0), np.array([[3.0, 0.4], [-0.2, 2.0]])


def triangles(height, tilt, dtype=float):
    """Slopes (2, facets) of the four triangles of every quad that has all its heights."""
    along = (np.diff(height, axis=1).astype(dtype) * dtype(1 / PITCH[0])) - dtype(tilt[0])
    across = (np.diff(height, axis=0).astype(dtype) * dtype(1 / PITCH[1])) - dtype(tilt[1])
    edges = [(x, y) for x in (along[:-1], along[1:]) for y in (across[:, :-1], across[:, 1:])]
    slopes = np.concatenate([np.stack(np.broadcast_arrays(x, y)).reshape(2, -1) for x, y in edges], axis=1)
    return slopes[:, np.isfinite(slopes).all(axis=0)]


def bits_counted(squares):
    upper = squares.astype(np.float32).view(np.uint32) >> 16
    return np.bincount(upper[upper < FINE_BINS], minlength=FINE_BINS)


@pytest.fixture(params=["complete", "with gaps", "of single precision", "quantised", "narrow"])
def scan(request):
    height = np.random.default_rng(7).normal(size=(5 if request.param == "narrow" else 41, 67))
    if request.param == "with gaps":
        height[3, 5], height[20:24, 10:30] = np.nan, np.nan
    if request.param == "of single precision":
        height = height.astype(np.float32)
    return HeightMap(height, PITCH, 0.3 if request.param == "quantised" else 0.0)


def dithered(scan):
    rows, columns = (slice(0, n) for n in scan.height.shape)
    return scan.height.astype(float) + scan.quantum * dither(rows, columns)


def test_counts_and_moments_of_a_map_are_those_of_its_triangles(scan):
    counts, moments = count_maps([scan])
    tilt = mean_slope(scan)
    slopes = triangles(dithered(scan), np.zeros(2))
    assert moments.facets == slopes.shape[1]
    assert moments.tilts[0] == pytest.approx(slopes.mean(axis=1), rel=1e-12)
    assert moments.apparent_covariance == pytest.approx(np.cov(slopes, bias=True), rel=1e-12)
    assert counts.sum() == moments.facets
    about = tilt if np.hypot(*(tilt - moments.tilts[0])) < 1e-3 * moments.slope_rms else moments.tilts[0]
    p, q = triangles(dithered(scan), about, np.float32)
    assert np.array_equal(counts.sum(axis=0), bits_counted(p * p + q * q))


def test_scaled_slopes_are_counted_by_magnitude_and_in_cells(scan):
    tilt, axis = np.array([[0.2, -0.1]]), SlopeAxis(1.0, 12.0, 21)
    x, y = SCALING @ triangles(dithered(scan), tilt[0])
    assert np.array_equal(count_scaled([scan], tilt, SCALING).sum(axis=0), bits_counted(x * x + y * y))
    column, row = (np.clip(np.rint(axis.position(slope)), 0, 20).astype(int) for slope in (x, y))
    expected = np.bincount(row * 21 + column, minlength=21**2).reshape(21, 21)
    assert np.array_equal(count_in_cells([scan], tilt, SCALING, axis.borders).sum(axis=0), expected)


def test_slopes_of_a_line_are_counted_by_magnitude_those_beside_gaps_left_out():
    slopes = np.random.default_rng(2).normal(size=9001)
    slopes[::100] = np.nan
    counts, tables = np.zeros(FINE_BINS, dtype=np.int64), slope_kernels.empty_tables()
    slope_kernels.count_line_slopes(slopes + 1.0, np.ones(9001), 0.5, -0.25, tables)
    slopes = (slopes + 1.0 - 1.0) * 0.5 + 0.25
    slope_kernels.move_counts(tables, counts)
    assert np.array_equal(counts, bits_counted(slopes[np.isfinite(slopes)].astype(np.float32) ** 2))
    assert not tables.any()

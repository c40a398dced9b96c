"""From counts to a density: its uncertainty is what repeated measurements scatter by, clumped as facets are."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets, vocabulary
from brdfpipe.facets import slope_histogram
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.hemisphere import panel_rule

SIGMA = 0.15
BLOCKS = 64


def gaussian_maps(size, correlation, seeds):
    """Maps of one Gaussian process, whose facets have the slope rms SIGMA per axis exactly; two quarters of a periodic map each."""
    fx, fy = np.meshgrid(np.fft.fftfreq(2 * size), np.fft.fftfreq(2 * size))
    shape = np.exp(-((np.pi * np.hypot(fx, fy) * correlation) ** 2) / 2)
    # Of noise of unit variance: the variance of the difference of two neighbours, from their spectrum.
    variance = np.mean(shape**2 * (2 - 2 * np.cos(2 * np.pi * fx)))
    for seed in seeds:
        noise = np.random.default_rng(seed).normal(size=shape.shape)
        height = np.fft.ifft2(np.fft.fft2(noise) * shape).real * SIGMA / np.sqrt(variance)
        yield samples.surface(height[:size, :size])
        yield samples.surface(height[size:, size:])


def deviations(table):
    """Slope over the slope rms, and the deviation from the density of the process over its uncertainty, where measured."""
    slope = table["slope"].values
    measured = table["slope_density_quality"].values == vocabulary.quality("measured")
    truth = np.exp(-(slope**2) / (2 * SIGMA**2)) / (2 * np.pi * SIGMA**2)
    z = (table["slope_density"].values / truth - 1) / (table["D_u"] / table["D"]).values
    return slope[measured] / (np.sqrt(2) * SIGMA), z[measured]


@pytest.fixture(scope="module")
def scattered():
    maps = gaussian_maps(256, 6.0, range(6))
    return np.concatenate([deviations(facets.estimate(scan, isotropic=True)) for scan in maps], axis=1)


def test_maps_of_one_surface_scatter_by_the_uncertainty(scattered):
    _, z = scattered
    # Six hundred nodes of twelve maps, a few of each map independent: the rms is known to some 10 %. Forty other maps give 0.91.
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2
    assert 0.9 < np.mean(np.abs(z) < 2) < 0.99


@pytest.mark.parametrize(("low", "high"), [(0, 0.5), (0.5, 1), (1, 1.5), (1.5, 2.5)])
def test_the_uncertainty_holds_from_the_peak_to_the_tail(scattered, low, high):
    slope, z = scattered
    # One redundancy for all bins gives an rms of 1.5 to 2 from 1.5 rms slopes on. Forty maps give 0.78 to 1.06 in narrower bands.
    assert 0.7 < np.sqrt(np.mean(z[(slope >= low) & (slope < high)] ** 2)) < 1.3


def ggx_counts(seed, a=0.1, clumps=40_000):
    """Counts of the slopes of a GGX surface whose facets come in clumps of one slope, the larger the steeper."""
    rng = np.random.default_rng(seed)
    size = np.array([10, 40])
    chance = np.array([0.8, 0.2])
    u = rng.random(clumps)
    steep = (rng.random(clumps) < chance[1]).astype(int)
    # Four fifths of the clumps are gentle, and half of the facets: GGX below and above its median slope, a.
    slope = a * np.sqrt((u + steep) / (2 - u - steep))
    block = rng.integers(BLOCKS, size=clumps)
    facets = (np.repeat(slope[block == b], size[steep[block == b]]) for b in range(BLOCKS))
    return samples.histogram_of_slopes(facets, 1.5 * a)


def test_the_uncertainty_follows_clumps_that_grow_with_the_slope_of_a_heavy_tail():
    a, gentle, steep = 0.1, [], []
    for seed in range(12):
        bins = slope_histogram.merge_bins(ggx_counts(seed))
        density, quality, relative_u, _ = slope_histogram.density_from_histogram(bins)
        slope = density.slope
        z = (density.density * np.pi * (a**2 + slope**2) ** 2 / a**2 - 1) / relative_u
        measured = quality == vocabulary.quality("measured")
        # The step of the clumps' size at a is smoothed over neighbouring nodes.
        gentle.append(z[measured & (slope < 0.7 * a)])
        steep.append(z[measured & (slope > 1.3 * a)])
    assert 0.8 < np.sqrt(np.mean(np.concatenate(gentle) ** 2)) < 1.25
    assert 0.8 < np.sqrt(np.mean(np.concatenate(steep) ** 2)) < 1.25


def test_correlated_steep_facets_widen_their_bins():
    bins = slope_histogram.merge_bins(ggx_counts(0))
    for bin_index in range(bins.edges.size - 1):
        independent = bins.totals[bin_index] / slope_histogram.redundancy_of(
            bins.counts, np.arange(bins.totals.size) == bin_index
        )
        assert independent >= slope_histogram.MIN_PER_BIN * (1 - 1e-9)


@pytest.mark.parametrize("repeats", [1, 4, 30])
def test_clumps_of_facets_count_as_one_facet_each(repeats):
    counts = repeats * np.random.default_rng(2).poisson(50.0, size=(BLOCKS, 40))
    # 63 × 40 independent squares: 3 %; and never fewer than one facet for one.
    assert slope_histogram.redundancy_of(counts) == pytest.approx(repeats, rel=0.1)
    assert slope_histogram.redundancy_of(counts) >= 1


def test_blocks_of_unequal_size_are_compared_by_their_shares():
    rng = np.random.default_rng(3)
    sizes = np.concatenate([np.full(32, 20), np.full(32, 2000), np.zeros(8, int)])
    counts = np.array([rng.multinomial(size, np.full(20, 0.05)) for size in sizes])
    # Without shares the blocks' sizes would count as scatter, a redundancy of hundreds.
    assert slope_histogram.redundancy_of(counts) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("grain", [0.5, 1.0])
def test_grains_on_the_borders_of_blocks_count_in_the_uncertainty(grain):
    """Grains of up to a block, of which the variance of a mean over all blocks is known exactly."""
    steps = 8
    size = round(grain * steps)
    cells = 8 * steps
    rng = np.random.default_rng(7)
    # Each grain covers `size` cells along both axes: of its share of all cells, a mean over the map has the sum of squares.
    along = np.convolve(np.ones(cells), np.ones(size)) / cells
    truth = float(np.square(along).sum())
    stated, by_blocks = [], []
    for _ in range(100):
        grains = rng.normal(size=(along.size, along.size))
        values = np.lib.stride_tricks.sliding_window_view(grains, (size, size)).sum(axis=(2, 3))
        of_blocks = values.reshape(8, steps, 8, steps).mean(axis=(1, 3)).ravel()
        shares = 0.5 + 1e-4 * of_blocks
        counts = np.column_stack([1 - shares, shares])
        bins = slope_histogram.MergedHistogram(np.array([0.0, 0.1]), counts, 0.05, 0.5, 100, "")
        stated.append(np.square(bins.scatter[-1]).sum() / (1e-4 * 64) ** 2)
        by_blocks.append(of_blocks.var(ddof=1) / 64)
    # A hundred maps know it to 2 %.
    assert 0.8 < np.sqrt(np.mean(stated)) / truth < 1.3
    # Independent blocks would state too little of grains as large as a block.
    assert grain < 1 or np.sqrt(np.mean(by_blocks)) / truth < 0.8


def test_a_large_map_of_few_clumps_has_bins_of_25_independent_facets():
    # 300 clumps of 300 facets: too few for six bins of a hundred.
    clumps = np.random.default_rng(6).poisson(300 / (BLOCKS * 40), size=(BLOCKS, 40))
    edges = np.linspace(0, 0.4, 41)
    counts, middle = 300.0 * clumps, (edges[1:] + edges[:-1]) / 2
    sums = counts.sum(axis=0) * middle
    bins = slope_histogram.merge_bins(slope_histogram.Histogram(edges, counts, sums, sums * middle))
    assert bins.least == slope_histogram.MIN_PER_BIN_OF_SMALL_MAPS


def test_bins_of_few_independent_facets_have_a_larger_uncertainty():
    bins = slope_histogram.merge_bins(ggx_counts(0))
    plenty, few = (
        slope_histogram.density_from_histogram(bins._replace(least=least))[2]
        for least in (slope_histogram.MIN_PER_BIN, slope_histogram.MIN_PER_BIN_OF_SMALL_MAPS)
    )
    assert few == pytest.approx(np.minimum(1.3 * plenty, 1))


def test_the_uncertainty_grows_along_the_tail_by_that_of_its_length():
    start = 0.4
    rng, a = np.random.default_rng(4), 0.1
    slopes = np.concatenate([np.sqrt(rng.random(300_000)) * start, start + rng.gamma(1, a, size=3_000)])
    block = rng.integers(BLOCKS, size=slopes.size)
    bins = slope_histogram.merge_bins(samples.histogram_of_slopes((slopes[block == b] for b in range(BLOCKS)), 0.2))
    density, quality, relative_u, _ = slope_histogram.density_from_histogram(bins)
    tail = density.slope[quality == vocabulary.quality("extrapolated")]
    u = relative_u[-tail.size :]
    assert np.all(np.diff(u) >= 0)
    # exp(−Δs/L) of a length known to u is known to u Δs/L more; Δs/L is the fall of the logarithm.
    fall = np.log(density.density[-tail.size] / density.density[-tail.size :])
    inside = u < 1
    assert np.count_nonzero(inside) > 8
    assert u[inside] == pytest.approx(u[0] * np.hypot(1, fall[inside]), rel=1e-6)


@pytest.mark.slow
def test_maps_with_a_lay_scatter_by_the_uncertainty_at_the_peak():
    z = []
    for scan in gaussian_maps(256, 4.0, range(5)):
        table = facets.estimate(scan, isotropic=False)
        density, middle = table["slope_density"].values, table.sizes["slope_along"] // 2
        truth = 1 / (2 * np.pi * SIGMA**2)
        z.append(
            (density[middle, middle] / truth - 1)
            * density[middle, middle]
            / table["slope_density_u"].values[middle, middle]
        )
    # Ten maps: the rms is known to a quarter. The counts of cells alone promise too much by a factor of 2.
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_no_facet_is_lost_between_the_bins_and_the_tail():
    histogram = ggx_counts(1)
    bins = slope_histogram.merge_bins(histogram)
    assert bins.counts.sum(axis=1) == pytest.approx(histogram.counts.sum(axis=1))
    density, *_ = slope_histogram.density_from_histogram(bins)
    assert density.mass == pytest.approx(1, abs=1e-12)
    assert bins.at_nodes(density.slope.size).sum() == histogram.counts.sum()


def test_the_density_of_every_bin_holds_its_share():
    bins = slope_histogram.merge_bins(ggx_counts(2))
    density, *_ = slope_histogram.density_from_histogram(bins)
    fine = np.interp(np.arange(20 * bins.edges.size - 19) / 20, np.arange(bins.edges.size), bins.edges)
    s, ds = panel_rule(fine, 4)
    share = np.histogram(s, bins.edges, weights=2 * np.pi * s * density(s**2) * ds)[0]
    # The nodes were moved by a rule of four points a panel, and the iteration stops at some 1e-4.
    assert share == pytest.approx(bins.totals[:-1] / bins.totals.sum(), rel=2e-3)


def test_the_sharp_peak_of_flat_tops_is_resolved():
    height = relief_maps.cells(512, 0)
    density = RadialDensity.of(facets.estimate(samples.surface(height), isotropic=True))
    across, along = np.diff(height, axis=1), np.diff(height, axis=0)
    slope = np.hypot(across[:-1], along[:, :-1])
    edges = density.median_slope * np.array([0.0, 0.05, 0.1, 0.2, 0.4])
    counted = np.histogram(slope, edges)[0] / slope.size
    s, ds = panel_rule(np.sort(np.concatenate([edges, np.linspace(0, edges[-1], 200)])), 4)
    expected = np.histogram(s.ravel(), edges, weights=(2 * np.pi * s * density(s**2) * ds).ravel())[0]
    # One of the four triangles a quad was counted here; bins are wider than the tops at the peak.
    assert expected == pytest.approx(counted, rel=0.1)
    assert counted[0] / edges[1] ** 2 > 5 * counted[3] / (edges[4] ** 2 - edges[3] ** 2)


def test_the_bins_of_a_smooth_maximum_stay_as_they_are(monkeypatch):
    maps = list(gaussian_maps(256, 6.0, range(2)))
    usual = [facets.estimate(rough, isotropic=True) for rough in maps]
    monkeypatch.setattr(slope_histogram, "_SHARP", np.inf)
    for rough, density in zip(maps, usual, strict=True):
        assert facets.estimate(rough, isotropic=True).identical(density)

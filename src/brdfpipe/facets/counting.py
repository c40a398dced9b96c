"""From counts of slope magnitudes to a radial density with uncertainty."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.slopes import FINE_BINS, SlopeCounts, count_bits
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_COARSE_BINS = 112
_TAIL_NODES, _TAIL_LENGTHS = 24, 40
_LEAST_BINS = 6

_LEAST_IN_BLOCK = 1000
_CLASSES = 16
_POORER = 1.3
"""How much more uncertain than their counts tell densities are whose bins hold few independent facets."""

PLENTY, FEW = 100, 25
"""Independent facets that every bin should hold, and that must do where the map has no more."""


class FacetError(BrdfpipeError):
    """A surface does not yield a facet distribution."""


class Histogram(NamedTuple):
    edges: Array
    """(bins + 1,) slopes, from 0 to the steepest."""
    counts: Array
    """(blocks, bins) facets of each block of the map."""
    sums: Array
    """(bins,) sum of the slopes in each bin."""


class Binned(NamedTuple):
    edges: Array
    """(bins + 1,) slopes, from 0."""
    counts: Array
    """(blocks, bins + 1) facets of each block of the map in each bin, and steeper than the last edge."""
    tail_excess: float
    """Mean slope of those steeper ones above the last edge."""
    least: int
    """Independent facets that every bin holds."""
    remedy: str
    """What gives more of them."""

    @property
    def found(self) -> Array:
        """(bins + 1,) facets in each bin, and steeper than the last edge."""
        return np.asarray(self.counts.sum(axis=0))

    def over(self, scale: float) -> Binned:
        """The slopes over a scale."""
        return self._replace(edges=self.edges / scale, tail_excess=self.tail_excess / scale)

    def at_nodes(self, nodes: int) -> Array:
        """Counts on the density's nodes: bins at theirs, the tail at its first, none at the auxiliary nodes."""
        return np.pad(self.found, (1, nodes))[:nodes]


def histogram(slopes: SlopeCounts, scale: float, bins: int = _COARSE_BINS) -> Histogram:
    """Counts in at most ``bins`` bins that widen beyond twice ``scale``, a typical slope, from the fine ones."""
    there = np.flatnonzero(slopes.counts.any(axis=0))
    if there.size == 0:
        raise FacetError("the surface has no complete facet; check the missing heights")
    used = int(there[-1]) + 1
    fine, fine_counts = slopes.edges[: used + 1], slopes.counts[:, :used]
    wanted = 2 * scale * np.sinh(np.linspace(0, np.arcsinh(fine[-1] / (2 * scale)), bins + 1))
    cuts = np.unique(np.concatenate([[0, used], np.clip(np.searchsorted(fine, wanted), 0, used)]))
    middles = np.sqrt((fine[1:] ** 2 + fine[:-1] ** 2) / 2)
    return Histogram(
        fine[cuts],
        np.add.reduceat(fine_counts, cuts[:-1], axis=1).astype(float),
        np.add.reduceat(fine_counts.sum(axis=0) * middles, cuts[:-1]),
    )


def histogram_of(squares: Iterable[tuple[int, Array]], scale: float, blocks: int) -> Histogram:
    """The same of squared slopes given block by block."""
    counts = np.zeros((blocks, FINE_BINS), dtype=np.int64)
    for block, square in squares:
        counts[block] += count_bits(square.astype(np.float32))
    return histogram(SlopeCounts(counts), scale)


def redundancy_of(counts: Array, bins: NDArray[np.bool_] | slice = slice(None)) -> float:
    """How many facets count as one independent facet in some ``bins`` of (blocks, bins) counts, taken together; at least 1.

    Neighbouring facets share heights and belong to the same grain, so n facets scatter like n / redundancy. The blocks also
    see what a correlation length does not: a map that is not the same everywhere.
    """
    return max(1.0, float(np.sum(_deviations(counts)[:, bins] ** 2) / max(counts[:, bins].sum(), 1.0)))


def redundancy_in_classes(counts: Array | NDArray[np.int64]) -> float:
    """How many facets count as one in 16 classes of as many facets each: wide enough for neighbours to share them.

    Parameters
    ----------
    counts : (blocks, bins) in bins that are much narrower
    """
    found = counts.sum(axis=0)
    cumulative = np.cumsum(found)
    classes = np.minimum(cumulative - found / 2, cumulative[-1] - 0.5) * _CLASSES // cumulative[-1]
    starts = np.flatnonzero(np.diff(classes, prepend=-1))
    return redundancy_of(np.add.reduceat(counts, starts, axis=1).astype(float))


def _deviations(counts: Array) -> Array:
    """What each block's counts (blocks, bins) are above its share of all, so that a sum of squares is the variance of a bin.

    Shares, not counts: the density is normalised, and blocks with missing heights hold fewer facets.
    """
    facets = counts.sum(axis=1, keepdims=True)
    blocks = int(np.count_nonzero(facets))
    share = facets / max(float(counts.sum()), 1.0)
    return np.asarray((counts - share * counts.sum(axis=0)) * np.sqrt(blocks / max(blocks - 1, 1)))


def merged(histogram: Histogram) -> Binned:
    """Bins of at least a hundred independent facets each, or 25 if no six such bins are there; beyond the last is the tail.

    A small map does not pass with 25: its blocks are hardly wider than its grains, and their variance promises too much.
    """
    blocks, facets = histogram.counts.shape[0], float(histogram.counts.sum())
    for least in (PLENTY, FEW) if facets >= _LEAST_IN_BLOCK * blocks else (PLENTY,):
        cuts = _cuts(histogram, least)
        if len(cuts) > _LEAST_BINS:
            break
    else:
        raise FacetError(
            f"too few independent facets: {facets:.0f} facets fill {len(cuts) - 1} bins of at least {least} "
            f"independent ones, {_LEAST_BINS} are needed; {_remedy(histogram)}"
        )
    last = cuts[-1]
    counts = np.add.reduceat(np.pad(histogram.counts, ((0, 0), (0, 1))), cuts, axis=1)
    tail = float(counts[:, -1].sum())
    excess = float(histogram.sums[last:].sum() / tail - histogram.edges[last]) if tail else 0.0
    return Binned(histogram.edges[cuts], counts, excess, least, _remedy(histogram))


def _remedy(histogram: Histogram) -> str:
    """What to do about too few independent facets: spikes and plateaus fill few bins however large the map is."""
    found = histogram.counts.sum(axis=0)
    middles = (histogram.edges[1:] + histogram.edges[:-1]) / 2
    beyond, squares = (np.cumsum(each[::-1])[::-1] for each in (found, found * middles**2))
    spikes = np.flatnonzero((squares > squares[0] / 2) & (beyond < 1e-3 * beyond[0]))
    if spikes.size:
        return (
            f"{beyond[spikes[0]]:.0f} of them, steeper than {histogram.edges[spikes[0]]:.2g}, hold most of the mean square slope: "
            "take spikes out of the heights, as missing ones"
        )
    if found[0] > _PLATEAU * beyond[0]:
        return (
            f"{found[0] / beyond[0]:.0%} of them have slopes below {histogram.edges[1]:.2g}, a plateau: measure where the finish "
            "is, or take the plateau out of the heights, as missing ones"
        )
    return "measure a larger area, or at a finer pitch"


_PLATEAU = 0.5
"""Share of the facets in the first of a hundred bins, of which no rough surface has more than a few per cent there."""


def _cuts(histogram: Histogram, least: int) -> list[int]:
    """Where to cut, so that every bin holds at least ``least`` independent facets.

    Facets of a wide bin come in larger clumps than those of a narrow one, and steep ones in larger clumps than gentle ones: how
    many count as one is found anew for each bin.
    """
    cumulative, deviations = (
        np.pad(np.cumsum(each, axis=1), ((0, 0), (1, 0))) for each in (histogram.counts, _deviations(histogram.counts))
    )
    found = cumulative.sum(axis=0)
    cuts = [0]
    while True:
        facets, left = found[cuts[-1] + 1 :] - found[cuts[-1]], found[-1] - found[cuts[-1]]
        variance = ((deviations[:, cuts[-1] + 1 :] - deviations[:, cuts[-1], None]) ** 2).sum(axis=0)
        redundancy = np.maximum(variance / np.maximum(facets, 1), 1)
        # Four times as many where there are plenty halve the noise; only the last bins make do with the least.
        wanted = np.where(left >= 8 * least * redundancy, 4, 1) * least
        enough = np.flatnonzero(facets >= wanted * redundancy)
        if enough.size == 0:
            return cuts
        cuts.append(cuts[-1] + 1 + int(enough[0]))


def counted_density(binned: Binned) -> tuple[RadialDensity, NDArray[np.int8], Array]:
    """Density whose integral over every bin is that bin's share, with a log-linear tail that carries the tail's share.

    Returns the density, and on its nodes the quality flag and the relative standard uncertainty.
    """
    edges, share = binned.edges, binned.found / binned.found.sum()
    tail_slope, tail_density = _tail(edges[-1], share[-1], binned.tail_excess)
    share = share[:-1]
    middle = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)
    log_density = np.log(share / (np.pi * np.diff(edges**2)))
    slope = np.concatenate([[0.0], middle, tail_slope])
    body = slope[: share.size + 2] ** 2
    split = np.sort(np.concatenate([edges, middle]))
    s, ds = panel_rule(split, 4)
    owner = np.minimum(np.searchsorted(edges, s, side="right") - 1, share.size - 1)

    def with_ends(log_density: Array) -> Array:
        return _with_ends(body, log_density, tail_density)

    def masses(log_density: Array) -> Array:
        density = RadialDensity(slope, np.concatenate([np.exp(with_ends(log_density)), tail_density[1:]]))
        return 2 * np.pi * s * density(s**2) * ds

    # A bin's mean is not the density at its middle: move each node until the interpolant holds the bin's share.
    for _ in range(12):
        mass = masses(log_density)
        log_density = log_density + np.log(share / np.bincount(owner, mass, minlength=share.size))
    density = RadialDensity(slope, np.concatenate([np.exp(with_ends(log_density)), tail_density[1:]]))
    # How the nodes, and with them the shares, answer to the middles: along straight lines, near enough for an uncertainty.
    step = 1e-6
    answer = (
        np.stack([with_ends(row) - with_ends(log_density) for row in log_density + step * np.eye(share.size)]) / step
    )
    shares = [np.bincount(owner, mass * np.interp(s**2, body, column), minlength=share.size) for column in answer]
    relative_u = _relative_uncertainty(binned, answer.T @ np.linalg.inv(np.stack(shares, axis=1) / share[:, None]))
    relative_u = _along_tail(relative_u, tail_slope)
    quality = np.full(slope.size, vocabulary.quality("measured"))
    quality[share.size + 1 :] = vocabulary.quality("extrapolated")
    return RadialDensity(slope, density.density / density.mass), quality, relative_u


def narrowed(binned: Binned, mean_square: float) -> Binned:
    """The bins of slopes, moved to where noise of a ``mean_square`` along each axis has moved them from.

    A density that spreads by noise flows along its gradient: to first order slopes came from s + mean_square/2 · d log P22/ds.
    A Gaussian keeps its shape; a tail has moved less, and a sharp peak has widened more.

    References
    ----------
    Song et al. 2021, ICLR, eq. 13: the probability flow of a diffusion.
    """
    # The gradient is that of a smooth curve through the bins: of their own scatter it would be too large.
    squares, found = binned.edges**2, binned.found[:-1]
    middle = (squares[1:] + squares[:-1]) / 2
    width = middle[np.searchsorted(np.cumsum(found), found.sum() / 2)]
    degree, log_density = min(_SMOOTH_DEGREE, found.size - 2), np.log(found / np.diff(squares))
    curve = np.polynomial.Polynomial.fit(np.log1p(middle / width), log_density, degree, w=np.sqrt(found))
    inside = np.minimum(squares, middle[-1])
    gradient = curve.deriv()(np.log1p(inside / width)) / (width + inside)
    moved = binned.edges * np.clip(1 + mean_square * gradient, 0.5, 1)
    widths = np.maximum(np.diff(moved), _NARROWEST * np.diff(binned.edges))
    return binned._replace(edges=np.concatenate([[0.0], np.cumsum(widths)]))


_SMOOTH_DEGREE = 4
_NARROWEST = 0.2
"""What at least is left of a bin."""


def _relative_uncertainty(binned: Binned, answer: Array) -> Array:
    """Relative standard uncertainty of the density at the first node, the bins' and the tail's, at most 1.

    The deviations of the blocks' shares are carried to the nodes by ``answer`` (bins + 2, bins). Of few blocks a variance is
    uncertain itself: its ratio to the counts, the redundancy, is smoothed over neighbouring nodes along its own trend.
    """
    found, deviations = binned.found, _deviations(binned.counts)
    at_nodes = answer @ (deviations[:, :-1] / found[:-1]).T
    counts = np.concatenate([found[:1], found[:-1]])
    redundancy = (at_nodes[:-1] ** 2).sum(axis=1) * counts
    weight = np.array([1, 2, 3, 2, 1]) / 9
    redundancy = np.convolve(np.pad(redundancy, 2, mode="reflect", reflect_type="odd"), weight, mode="valid")
    relative_u = np.sqrt(np.maximum(redundancy, 1) / counts)
    tail = np.sqrt(max((deviations[:, -1] ** 2).sum(), found[-1], 1)) / max(found[-1], 1)
    relative_u = np.append(relative_u, max(relative_u[-1], tail)) * (1.0 if binned.least == PLENTY else _POORER)
    return np.minimum(relative_u, 1.0)


def _along_tail(relative_u: Array, tail_slope: Array) -> Array:
    """Continue the uncertainty from the tail's first node to its others, at most 1.

    Of exp(−(s − start)/L) the length L is as uncertain as the share of the facets that gave it.
    """
    lengths = (tail_slope[1:] - tail_slope[0]) / (tail_slope[-1] - tail_slope[0]) * _TAIL_LENGTHS
    return np.minimum(np.concatenate([relative_u, relative_u[-1] * np.hypot(1, lengths)]), 1.0)


def _with_ends(u: Array, log_density: Array, tail_density: Array) -> Array:
    """Extend bin values to zero slope, along the neighbouring secant but never downwards, and to where the tail begins."""
    first = log_density[0] + max((log_density[0] - log_density[1]) / (u[2] - u[1]), 0.0) * (u[1] - u[0])
    if tail_density.size > 1:
        last = np.log(tail_density[0])
    else:
        last = log_density[-1] + min((log_density[-1] - log_density[-2]) / (u[-2] - u[-3]), 0.0) * (u[-1] - u[-2])
    return np.concatenate([[first], log_density, [last]])


def _tail(start: float, share: float, excess: float) -> tuple[Array, Array]:
    """Log-linear tail P exp(−(s − start)/L) that holds the share of the facets beyond ``start`` and their mean slope.

    2π ∫ P s ds = 2πP (start·L + L²) and E[s − start] = L (start + 2L) / (start + L). Both decide the masking at grazing.
    Without facets beyond ``start`` the density ends there.
    """
    if share == 0:
        return np.array([start]), np.zeros(1)
    length = (excess - start + np.sqrt((start - excess) ** 2 + 8 * start * excess)) / 4
    step = np.concatenate([[0.0], np.geomspace(0.05, _TAIL_LENGTHS, _TAIL_NODES)])
    return start + length * step, share / (2 * np.pi * length * (start + length)) * np.exp(-step)

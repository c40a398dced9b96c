"""From counts of slope magnitudes to a radial density with uncertainty."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.slopes import FINE_BINS, SlopeCounts, count_bits
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_COARSE_BINS = 112
_TAIL_NODES = 24
_LEAST_BINS = 6


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
    """(bins,) facets in each bin."""
    tail: int
    """Facets steeper than the last edge."""
    tail_excess: float
    """Mean slope of those facets above the last edge."""

    @property
    def total(self) -> int:
        return int(self.counts.sum()) + self.tail

    def at_nodes(self, nodes: int) -> Array:
        """Counts on the density's nodes: bins at theirs, the tail at its first, none at the auxiliary nodes."""
        counts = np.zeros(nodes)
        counts[1 : 1 + self.counts.size] = self.counts
        if self.tail:
            counts[1 + self.counts.size] = self.tail
        return counts


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


def redundancy_of(counts: Array) -> float:
    """How many facets count as one independent facet: the variance of the counts between blocks over their mean.

    Neighbouring facets share heights and belong to the same grain, so n facets scatter like n / redundancy. The blocks also
    see what a correlation length does not: a map that is not the same everywhere.
    """
    share = counts.sum(axis=1, keepdims=True) / max(counts.sum(), 1.0)
    used = share[:, 0] > 0
    expected = share[used] * counts.sum(axis=0)
    freedom = max(1, np.count_nonzero(used) - 1)
    return max(1.0, float(np.sum((counts[used] - expected) ** 2) / freedom / (expected.sum() / np.count_nonzero(used))))


def merged(histogram: Histogram) -> tuple[Binned, float]:
    """Bins of at least a hundred independent facets each, and how many facets count as one in them.

    Neighbouring facets share a wide bin more often than a narrow one, so merging bins raises the redundancy that decides how
    far to merge; two or three rounds settle it.
    """
    counts, redundancy = histogram.counts, 1.0
    for _ in range(6):
        found = max(redundancy, redundancy_of(counts))
        bins = _merge_bins(histogram, 100 * found)
        if found < 1.05 * redundancy:
            break
        redundancy = found
        starts = np.searchsorted(histogram.edges, bins.edges[:-1])
        counts = np.add.reduceat(histogram.counts, starts, axis=1)
    return bins, redundancy


def _merge_bins(histogram: Histogram, least: float) -> Binned:
    """Merge bins until each holds at least ``least`` facets; what is left beyond the last is the tail."""
    counts = histogram.counts.sum(axis=0)
    cumulative = np.concatenate([[0.0], np.cumsum(counts)])
    kept = [0]
    for cut in range(1, cumulative.size):
        # Four times as many where there are plenty halve the noise; only the last bins make do with the least.
        plenty = cumulative[-1] - cumulative[kept[-1]] >= 8 * least
        if cumulative[cut] - cumulative[kept[-1]] >= (4 * least if plenty else least):
            kept.append(cut)
    if len(kept) - 1 < _LEAST_BINS:
        raise FacetError(
            f"too few independent facets: {cumulative[-1]:.0f} facets fill {len(kept) - 1} bins of at least {least:.0f}, "
            f"{_LEAST_BINS} are needed; measure a larger area, or at a finer pitch"
        )
    last = kept[-1]
    tail = int(cumulative[-1] - cumulative[last])
    excess = float(histogram.sums[last:].sum() / tail - histogram.edges[last]) if tail else 0.0
    return Binned(histogram.edges[kept], np.diff(cumulative[kept]), tail, excess)


def counted_density(binned: Binned, redundancy: float) -> tuple[RadialDensity, NDArray[np.int8], Array]:
    """Density whose integral over every bin is that bin's share, with a log-linear tail that carries the tail's share.

    Returns the density, and on its nodes the quality flag and the relative standard uncertainty.
    """
    edges, share = binned.edges, binned.counts / binned.total
    tail_slope, tail_density = _tail(edges[-1], binned.tail / binned.total, binned.tail_excess)
    middle = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)
    log_density = np.log(share / (np.pi * np.diff(edges**2)))
    slope = np.concatenate([[0.0], middle, tail_slope])
    split = np.sort(np.concatenate([edges, middle]))
    s, ds = panel_rule(split, 4)
    owner = np.minimum(np.searchsorted(edges, s, side="right") - 1, share.size - 1)

    def density_with(log_density: Array) -> RadialDensity:
        body = _with_ends(slope[: share.size + 2] ** 2, log_density, tail_density)
        return RadialDensity(slope, np.concatenate([np.exp(body), tail_density[1:]]))

    # A bin's mean is not the density at its middle: move each node until the interpolant holds the bin's share.
    for _ in range(12):
        mass = np.bincount(owner, 2 * np.pi * s * density_with(log_density)(s**2) * ds, minlength=share.size)
        log_density = log_density + np.log(share / mass)
    density = density_with(log_density)
    relative_u = np.sqrt(redundancy / binned.counts)
    tail_u = max(relative_u[-1], np.sqrt(redundancy / max(binned.tail, 1)))
    relative_u = np.concatenate([relative_u[:1], relative_u, np.full(tail_slope.size, min(tail_u, 1.0))])
    quality = np.full(slope.size, vocabulary.quality("measured"))
    quality[share.size + 1 :] = vocabulary.quality("extrapolated")
    return RadialDensity(slope, density.density / density.mass), quality, relative_u


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
    step = np.concatenate([[0.0], np.geomspace(0.05, 40, _TAIL_NODES)])
    return start + length * step, share / (2 * np.pi * length * (start + length)) * np.exp(-step)

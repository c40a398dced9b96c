"""Histogram of slope magnitudes, and the radial density with uncertainty that follows from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.density_tail import Junction, tail
from brdfpipe.facets.radial_density import RadialDensity, log_spline
from brdfpipe.facets.slopes import BLOCKS, fine_edges
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_COARSE_BINS = 112
_MIN_BINS = 6

_MIN_FACETS_PER_BLOCK = 1000
_CLASSES = 16
_SMALL_MAP_FACTOR = 1.3
"""Factor of the relative uncertainty of densities whose bins have few independent facets."""

_PLATEAU = 0.5
"""Share of the facets in the first of a hundred bins that indicates a plateau; rough surfaces have a few per cent there."""

_SMOOTH_DEGREE = 4
"""Degree of the polynomial through the logarithm of the density, whose gradient moves the bins."""

_SHARP, _SIGNIFICANT = 0.1, 3.0
"""Logarithm of the density of the inner over the outer half of the first bin, and standard uncertainties, beyond which the bin is halved."""

_NARROWEST = 0.2
"""Smallest ratio of new to old width of a bin."""

MIN_PER_BIN, MIN_PER_BIN_OF_SMALL_MAPS = 100, 25
"""Smallest number of independent facets in a bin; the second on maps that are too small for the first."""


class FacetError(BrdfpipeError):
    """A surface does not yield a facet distribution."""


_SLOPE_RMS = (1e-9, 1e9)
"""Range of the slope rms; outside it the squares of slopes may overflow or underflow in single precision."""


def check_slope_rms(rms: float, subject: str = "") -> None:
    """Refuse an impossible slope rms; ``subject`` is the end of its name in the message."""
    if not _SLOPE_RMS[0] < rms < _SLOPE_RMS[1]:
        raise FacetError(
            f"impossible slope rms {rms:.2g}{subject}; accepted: {_SLOPE_RMS[0]:g} to {_SLOPE_RMS[1]:g}; check the unit of the heights "
            "(`surface.unit`) and of the pitch (`surface.lateral_unit`)"
        )


class Histogram(NamedTuple):
    """Facets by the magnitude of their slope."""

    edges: Array
    """(bins + 1,) slopes, from 0 to the steepest."""
    counts: Array
    """(blocks, bins) facets of each block of the map."""
    sums: Array
    """(bins,) sum of the slopes in each bin."""
    squares: Array
    """(bins,) sum of their squares."""


class MergedHistogram(NamedTuple):
    """Facets in bins that hold enough independent ones each, and in the tail beyond."""

    edges: Array
    """(bins + 1,) slopes, from 0."""
    counts: Array
    """(blocks, bins + 1) facets of each block of the map in each bin, and steeper than the last edge."""
    tail_excess: float
    """Mean slope of those steeper ones above the last edge."""
    tail_contribution: float
    """Share of the sum of all squared slopes that those steeper ones hold."""
    least: int
    """Smallest number of independent facets in a bin."""
    remedy: str
    """How to obtain more independent facets."""

    @property
    def totals(self) -> Array:
        """(bins + 1,) facets in each bin, and steeper than the last edge."""
        return np.asarray(self.counts.sum(axis=0))

    @property
    def scatter(self) -> Array:
        """(bins + 1, windows) deviations of neighbouring blocks, whose products add up to the covariance of the facets in each bin."""
        return self.of_neighbouring_blocks(_deviations(self.counts).T)

    def of_neighbouring_blocks(self, changes: Array) -> Array:
        """Changes (…, windows) from those of blocks that are correlated with their neighbours.

        Parameters
        ----------
        changes : (…, blocks) of anything known from the facets, by as much as each of the 8 × 8 blocks of each map deviates. The sum of their
            products would be the covariance if the blocks were independent. That of the result is the covariance

        Notes
        -----
        Blocks share the grains on their borders. Windows of 2 × 2 blocks that overlap have half of the covariance of two blocks side by side,
        and a quarter of that along the diagonal (Bartlett). The variance that is missed falls as the windows widen, in inverse proportion: what
        the mean square slope has more by windows than by blocks is added once more (Vats & Flegal 2022, Biometrika 109, 735: a lugsail
        window with r = 2 and c = 1/2).
        """
        facets = self.counts.sum(axis=1)
        used = max(int(np.count_nonzero(facets)), 2)
        share = _windows(facets / max(float(facets.sum()), 1.0))
        # Both deviate from a mean that is their own, which takes a part of the variance.
        factor = np.sqrt((1 - 1 / used) / max(1 - float(share @ share), 1 / used))
        squares = np.append((self.edges[1:] ** 2 + self.edges[:-1] ** 2) / 2, (self.edges[-1] + self.tail_excess) ** 2)
        of_slope = _deviations(self.counts) @ squares
        by_blocks, by_windows = (float(np.square(part).sum()) for part in (of_slope, factor * _windows(of_slope)))
        more = max(1 - by_blocks / by_windows, 0.0) if by_windows > 0 else 0.0
        return factor * np.sqrt(1 + more) * _windows(changes)

    def divided_by(self, scale: float) -> MergedHistogram:
        """The same counts of slopes divided by ``scale``."""
        return self._replace(edges=self.edges / scale, tail_excess=self.tail_excess / scale)

    def at_nodes(self, nodes: int) -> Array:
        """Counts on the density's nodes: bins at theirs, the tail at its first, none at the auxiliary nodes."""
        return np.pad(self.totals, (1, nodes))[:nodes]


def histogram(fine_counts: NDArray[np.int64], scale: float) -> Histogram:
    """Counts in at most 112 bins that widen beyond twice ``scale``, a typical slope, from (blocks, fine bins)."""
    occupied = np.flatnonzero(fine_counts.any(axis=0))
    if occupied.size == 0:
        raise FacetError(
            "the surface has no complete facet: every triangle touches a missing height; measure again with fewer missing heights"
        )
    size = int(occupied[-1]) + 1
    fine, fine_counts = fine_edges()[: size + 1], fine_counts[:, :size]
    targets = 2 * scale * np.sinh(np.linspace(0, np.arcsinh(fine[-1] / (2 * scale)), _COARSE_BINS + 1))
    cuts = np.unique(np.concatenate([[0, size], np.clip(np.searchsorted(fine, targets), 0, size)]))
    middles = np.sqrt((fine[1:] ** 2 + fine[:-1] ** 2) / 2)
    return Histogram(
        fine[cuts],
        np.add.reduceat(fine_counts, cuts[:-1], axis=1).astype(float),
        np.add.reduceat(fine_counts.sum(axis=0) * middles, cuts[:-1]),
        np.add.reduceat(fine_counts.sum(axis=0) * middles**2, cuts[:-1]),
    )


def redundancy_of(counts: Array, bins: NDArray[np.bool_] | slice = slice(None)) -> float:
    """Facets per independent facet in some ``bins`` of (blocks, bins) counts, taken together; at least 1.

    Neighbouring facets share heights and belong to the same grain, so n facets scatter like n / redundancy. The blocks also
    see what a correlation length does not: a map that is not the same everywhere.
    """
    return max(1.0, float(np.sum(_deviations(counts)[:, bins] ** 2) / max(counts[:, bins].sum(), 1.0)))


def redundancy_in_classes(counts: Array | NDArray[np.int64]) -> float:
    """Facets per independent facet in 16 classes of equal share, wide enough to hold neighbouring facets together.

    Parameters
    ----------
    counts : (blocks, bins) in bins that are much narrower
    """
    totals = counts.sum(axis=0)
    cumulative = np.cumsum(totals)
    classes = np.minimum(cumulative - totals / 2, cumulative[-1] - 0.5) * _CLASSES // cumulative[-1]
    starts = np.flatnonzero(np.diff(classes, prepend=-1))
    return redundancy_of(np.add.reduceat(counts, starts, axis=1).astype(float))


def _deviations(counts: Array) -> Array:
    """Deviation of each block's counts (blocks, bins) from its share of all; their sum of squares is the variance of a bin.

    Shares, not counts: the density is normalised, and blocks with missing heights hold fewer facets.
    """
    facets = counts.sum(axis=1, keepdims=True)
    blocks = int(np.count_nonzero(facets))
    share = facets / max(float(counts.sum()), 1.0)
    return np.asarray((counts - share * counts.sum(axis=0)) * np.sqrt(blocks / max(blocks - 1, 1)))


def _windows(values: Array) -> Array:
    """(…, windows) half of the sums of values (…, blocks) over 2 × 2 neighbouring blocks; each block is in four windows."""
    grid = values.reshape(*values.shape[:-1], -1, BLOCKS, BLOCKS)
    padded = np.pad(grid, [(0, 0)] * (grid.ndim - 2) + [(1, 1), (1, 1)])
    pairs = padded[..., 1:, :] + padded[..., :-1, :]
    return np.asarray((pairs[..., 1:] + pairs[..., :-1]) / 2).reshape(*values.shape[:-1], -1)


def merge_bins(histogram: Histogram) -> MergedHistogram:
    """Bins of at least 100 independent facets each, or 25 if that gives fewer than six bins; the tail is beyond the last.

    Bins of a small map need 100: its blocks are as narrow as its grains, and their variance understates the uncertainty.
    """
    blocks, facets = histogram.counts.shape[0], float(histogram.counts.sum())
    small = facets < _MIN_FACETS_PER_BLOCK * blocks
    for least in (MIN_PER_BIN,) if small else (MIN_PER_BIN, MIN_PER_BIN_OF_SMALL_MAPS):
        cuts = _cut_positions(histogram, least)
        if len(cuts) > _MIN_BINS:
            break
    else:
        raise FacetError(
            f"too few independent facets: {facets:.0f} facets fill {len(cuts) - 1} bins of at least {least} "
            f"independent ones, {_MIN_BINS} are needed; {_remedy(histogram)}"
        )
    cuts = _with_sharp_peak(histogram, cuts)
    last = cuts[-1]
    counts = np.add.reduceat(np.pad(histogram.counts, ((0, 0), (0, 1))), cuts, axis=1)
    tail = float(counts[:, -1].sum())
    excess = float(histogram.sums[last:].sum() / tail - histogram.edges[last]) if tail else 0.0
    contribution = float(histogram.squares[last:].sum() / histogram.squares.sum())
    return MergedHistogram(histogram.edges[cuts], counts, excess, contribution, least, _remedy(histogram))


def _remedy(histogram: Histogram) -> str:
    """Advice about too few independent facets. A plateau fills few bins on a map of any size."""
    totals = histogram.counts.sum(axis=0)
    if totals[0] > _PLATEAU * totals.sum():
        return (
            f"{totals[0] / totals.sum():.0%} of them have slopes below {histogram.edges[1]:.2g}, a plateau: measure where the finish "
            "is, or mark the plateau as missing heights"
        )
    return "measure a larger area, or at a finer pitch"


def _cut_positions(histogram: Histogram, least: int) -> list[int]:
    """Cuts between bins, so that every bin holds at least ``least`` independent facets.

    Facets of a wide bin are more correlated than those of a narrow one, and steep ones more than gentle ones: the redundancy is
    determined for each bin.
    """
    cumulative, deviations = (
        np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0)))
        for values in (histogram.counts, _deviations(histogram.counts))
    )
    totals = cumulative.sum(axis=0)
    cuts = [0]
    while True:
        facets, left = totals[cuts[-1] + 1 :] - totals[cuts[-1]], totals[-1] - totals[cuts[-1]]
        variance = ((deviations[:, cuts[-1] + 1 :] - deviations[:, cuts[-1], None]) ** 2).sum(axis=0)
        redundancy = np.maximum(variance / np.maximum(facets, 1), 1)
        # Four times as many where there are plenty halve the noise; the last bins have only the least number.
        required = np.where(left >= 8 * least * redundancy, 4, 1) * least
        sufficient = np.flatnonzero(facets >= required * redundancy)
        if sufficient.size == 0:
            return cuts
        cuts.append(cuts[-1] + 1 + int(sufficient[0]))


def _with_sharp_peak(histogram: Histogram, cuts: list[int]) -> list[int]:
    """Cuts that resolve a sharp maximum at slope 0, as of cells with flat tops.

    The first bin is halved in area as long as its inner half is significantly denser than its outer one, and holds enough facets. Of a
    density that is smooth at slope 0 both halves are alike, and nothing is cut.
    """
    deviations = _deviations(histogram.counts)
    while cuts[1] > 1:
        half = int(np.searchsorted(histogram.edges, histogram.edges[cuts[1]] / np.sqrt(2)))
        half = min(max(half, 1), cuts[1] - 1)
        parts = slice(0, half), slice(half, cuts[1])
        facets = [histogram.counts[:, part].sum() for part in parts]
        areas = np.diff(histogram.edges[[0, half, cuts[1]]] ** 2)
        if min(facets) == 0:
            break
        scatter = [deviations[:, part].sum(axis=1) / count for part, count in zip(parts, facets, strict=True)]
        contrast = np.log(facets[0] * areas[1] / (facets[1] * areas[0]))
        significant = contrast > _SHARP + _SIGNIFICANT * np.linalg.norm(scatter[0] - scatter[1])
        if not significant or np.linalg.norm(scatter[0]) > MIN_PER_BIN_OF_SMALL_MAPS**-0.5:
            break
        cuts = [0, half, *cuts[1:]]
    return cuts


class CountedDensity(NamedTuple):
    """A radial density from counts; fields are on its nodes."""

    density: RadialDensity
    quality: NDArray[np.int8]
    relative_u: Array
    """Relative standard uncertainty, at most 1."""
    changes: Array
    """(nodes, windows) changes of ln P22, by as much as neighbouring blocks deviate from all: their products add up to its covariance."""


def density_from_histogram(binned: MergedHistogram) -> CountedDensity:
    """Density whose integral over every bin is that bin's share, with a tail that carries the share of steeper facets."""
    edges, share = binned.edges, binned.totals / binned.totals.sum()
    share, tail_share = share[:-1], float(share[-1])
    middle = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)
    log_density = np.log(share / (np.pi * np.diff(edges**2)))
    tail_slope, tail_density = tail(Junction.of(edges, log_density), tail_share, binned.tail_excess)
    slope = np.concatenate([[0.0], middle, tail_slope])
    body = slope[: share.size + 2] ** 2
    split = np.sort(np.concatenate([edges, middle]))
    s, ds = panel_rule(split, 4)
    owner = np.minimum(np.searchsorted(edges, s, side="right") - 1, share.size - 1)

    def with_ends(log_density: Array) -> Array:
        return _with_ends(body, log_density, tail_density)

    log_tail = np.log(tail_density[1:])
    # A bin's mean is not the density at its middle: move each node until the interpolant holds the bin's share.
    for _ in range(12):
        at_rule = log_spline(slope**2, np.concatenate([with_ends(log_density), log_tail]))(s**2)
        mass = 2 * np.pi * s * np.exp(at_rule) * ds
        log_density = log_density + np.log(share / np.bincount(owner, mass, minlength=share.size))
    # Derivatives of the nodes, and of the shares, with respect to the middles; linear interpolation is accurate enough here.
    step = 1e-6
    moved = log_density + step * np.eye(share.size)
    jacobian = np.stack([with_ends(row) - with_ends(log_density) for row in moved]) / step
    shares = [np.bincount(owner, mass * np.interp(s**2, body, column), minlength=share.size) for column in jacobian]
    of_shares = jacobian.T @ np.linalg.inv(np.stack(shares, axis=1) / share[:, None])
    scatter = binned.scatter
    relative_u, changes = _relative_uncertainty(binned, scatter, of_shares), _changes(binned, scatter, of_shares)
    # In the tail the change of its share takes over from that where it begins.
    changes = np.concatenate([changes, np.repeat(changes[-1:], tail_slope.size - 1, axis=0)])
    # The relative uncertainty of the length over which the tail falls is that of the share of the facets in it.
    with np.errstate(divide="ignore"):
        lengths = -np.diff(np.log(tail_density)).cumsum()
    relative_u = np.minimum(np.concatenate([relative_u, relative_u[-1] * np.hypot(1, lengths)]), 1.0)
    quality = np.full(slope.size, vocabulary.quality("measured"))
    quality[share.size + 1 :] = vocabulary.quality("extrapolated")
    density = RadialDensity(slope, np.concatenate([np.exp(with_ends(log_density)), tail_density[1:]]))
    return CountedDensity(density.normalised(), quality, relative_u, changes)


def remove_broadening(binned: MergedHistogram, mean_square: float) -> MergedHistogram:
    """Move the edges of the bins to undo the broadening by noise of a ``mean_square`` along each axis.

    Noise moves a density along its gradient: to first order slopes came from s + mean_square/2 · d log P22/ds. A Gaussian keeps
    its shape; a tail moves less and a sharp peak more. Where the counted density falls, the result falls too.

    Source: Song et al. 2021, ICLR, eq. 13: the probability flow of a diffusion.
    """
    # The gradient of a smooth curve through the bins, since their scatter would exaggerate it.
    squares, totals = binned.edges**2, binned.totals[:-1]
    middle = (squares[1:] + squares[:-1]) / 2
    width = middle[np.searchsorted(np.cumsum(totals), totals.sum() / 2)]
    degree, log_density = min(_SMOOTH_DEGREE, totals.size - 2), np.log(totals / np.diff(squares))
    curve = np.polynomial.Polynomial.fit(np.log1p(middle / width), log_density, degree, w=np.sqrt(totals))
    inside = np.minimum(squares, middle[-1])
    gradient = curve.deriv()(np.log1p(inside / width)) / (width + inside)
    moved = binned.edges * np.clip(1 + mean_square * gradient, 0.5, 1)
    widths = np.maximum(np.diff(moved), _NARROWEST * np.diff(binned.edges))
    areas = np.diff(np.concatenate([[0.0], np.cumsum(widths)]) ** 2)
    areas = _falling(areas, totals, np.diff(totals / np.diff(squares)) <= 0)
    return binned._replace(edges=np.sqrt(np.concatenate([[0.0], np.cumsum(areas)])))


def _falling(areas: Array, totals: Array, falls: NDArray[np.bool_]) -> Array:
    """Areas of bins of given ``totals``, changed least so that totals over areas fall from bin to bin where they must."""
    from scipy.optimize import isotonic_regression

    runs = np.split(np.arange(areas.size), np.flatnonzero(~falls) + 1)
    density = [
        isotonic_regression(totals[run] / areas[run], weights=areas[run], increasing=False).x
        if run.size > 1
        else totals[run] / areas[run]
        for run in runs
    ]
    return np.asarray(totals / np.concatenate(density))


def _relative_uncertainty(binned: MergedHistogram, scatter: Array, jacobian: Array) -> Array:
    """Relative standard uncertainty of the density at the first node, the bins' and the tail's, at most 1.

    The derivatives ``jacobian`` (bins + 2, bins) propagate the ``scatter`` (bins + 1, windows) to the nodes. A variance of few blocks is
    uncertain, so its ratio to the counts, the redundancy, is smoothed over neighbouring nodes along its trend.
    """
    totals = binned.totals
    at_nodes = jacobian @ (scatter[:-1] / totals[:-1, None])
    counts = np.concatenate([totals[:1], totals[:-1]])
    redundancy = (at_nodes[:-1] ** 2).sum(axis=1) * counts
    weight = np.array([1, 2, 3, 2, 1]) / 9
    redundancy = np.convolve(np.pad(redundancy, 2, mode="reflect", reflect_type="odd"), weight, mode="valid")
    relative_u = np.sqrt(np.maximum(redundancy, 1) / counts)
    tail = np.sqrt(max((scatter[-1] ** 2).sum(), totals[-1], 1)) / max(totals[-1], 1)
    relative_u = np.append(relative_u, max(relative_u[-1], tail)) * (
        1.0 if binned.least == MIN_PER_BIN else _SMALL_MAP_FACTOR
    )
    return np.minimum(relative_u, 1.0)


def _changes(binned: MergedHistogram, scatter: Array, jacobian: Array) -> Array:
    """Changes of ln P22 (bins + 2, windows) at the first node, the bins' and the tail's, that the ``scatter`` (bins + 1, windows) makes."""
    totals = binned.totals
    inside = jacobian[:-1] @ (scatter[:-1] / totals[:-1, None])
    tail = scatter[-1] / max(totals[-1], 1.0)
    factor = 1.0 if binned.least == MIN_PER_BIN else _SMALL_MAP_FACTOR
    return np.asarray(factor * np.concatenate([inside, np.clip(tail, -1.0, 1.0)[None]]))


def _with_ends(u: Array, log_density: Array, tail_density: Array) -> Array:
    """Extend bin values to zero slope, along the neighbouring secant but never downwards, and to where the tail begins."""
    first = log_density[0] + max((log_density[0] - log_density[1]) / (u[2] - u[1]), 0.0) * (u[1] - u[0])
    if tail_density.size > 1:
        last = np.log(tail_density[0])
    else:
        last = log_density[-1] + min((log_density[-1] - log_density[-2]) / (u[-2] - u[-3]), 0.0) * (u[-1] - u[-2])
    return np.concatenate([[first], log_density, [last]])

"""Histogram of the slopes along line profiles, by stretches of the lines; of quantised heights, in whole multiples of the step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.facets.height_quantisation import distinct_multiples
from brdfpipe.facets.slope_histogram import FacetError, check_slope_rms, redundancy_in_classes
from brdfpipe.facets.slopes import FINE_BINS, NOT_OUTLYING, Outlying, fine_edges, outlying
from brdfpipe.geometry import Array
from brdfpipe.psd.noise_floor import NoiseFloor, noise_besides_rounding, noise_floor

STRETCHES = 32
"""Number of stretches the lines are cut into, a power of two; their scatter gives the uncertainty."""

MIN_SLOPES = 63
"""Smallest number of slopes in a line: that of the shortest line that is read."""

BINS = 128

_CHUNK = 2**15
_LEAST_SURFACE = 0.05
"""Least share of the mean square slope that is left to the surface beside noise."""
_BLUR, _FINE_BLUR = 32, 256
"""Distances that stand for rounding, and for noise, whose tails matter."""

# Search for a quantum: number of slopes, and largest slope over the slope rms.
_SAMPLED = 2**15
_REACH = 16.0

_EQUAL_CURVATURES = 1e-4
_EQUAL_SLOPES = 3e-5
"""Slopes closer than this share of their rms count as equal; rounding in single precision is smaller."""


class LineSlopeCounts(NamedTuple):
    """Histogram of |p| of the slopes p along lines of one direction: the marginal P1."""

    bins: Array
    """(bins, 2) lower and upper |p|, by increasing middle. Lines of different quantum have separate bins, which overlap."""
    by_stretch: Array
    """(stretches, bins) slopes in each bin."""
    share: Array
    """(bins,) share of the slopes that belong to lines of the same quantum."""
    blur: Array
    """(bins, n) distances from a bin's edges at which rounding and noise bring slopes into it, of equal weight; 0 without them."""
    rms: float
    """Of the slopes without rounding, noise and outlying ones."""
    quantum: float
    """Largest quantum of the slopes of a line; 0 if no line is quantised."""
    noise: float = 0.0
    """Mean square that height noise adds to the slopes, besides rounding; it is part of the blur."""
    noise_u: float = 0.0
    """Standard uncertainty of that mean square."""
    outlying: Outlying = NOT_OUTLYING
    """Slopes that are left out of the rms."""

    @property
    def counts(self) -> Array:
        return np.asarray(self.by_stretch.sum(axis=0))

    @property
    def middles(self) -> Array:
        return np.asarray(self.bins.mean(axis=1))

    @property
    def size(self) -> int:
        return int(self.by_stretch.sum())

    @property
    def steepest(self) -> float:
        return float(self.bins[:, 1].max())

    def on_nodes(self, nodes: Array) -> Array:
        """Slopes at the nearest of increasing nodes (n,): by magnitude, or half of them on either side of nodes about zero."""
        sides = (1.0,) if nodes[0] >= 0 else (1.0, -1.0)
        borders, result = (nodes[1:] + nodes[:-1]) / 2, np.zeros(nodes.size)
        for side in sides:
            np.add.at(result, np.searchsorted(borders, side * self.middles), self.counts / len(sides))
        return result

    @property
    def median(self) -> float:
        cumulative = np.concatenate([[0.0], np.cumsum(self.counts)])
        return float(np.interp(0.5 * cumulative[-1], cumulative, np.append(0.0, self.bins[:, 1])))

    @property
    def redundancy(self) -> float:
        """Slopes per independent slope, from classes wide enough to hold neighbouring slopes together."""
        return redundancy_in_classes(self.by_stretch)

    @property
    def independent(self) -> float:
        """Number of independent slopes."""
        return self.size / self.redundancy

    @property
    def rounding(self) -> float:
        """Mean square error of the slopes by rounding of the heights, over the mean square slope."""
        blur = float(self.counts @ (self.blur**2).mean(axis=1)) / self.size
        return 2 * max(blur - self.noise, 0.0) / self.rms**2

    @property
    def narrowing(self) -> float:
        """Rms of the slopes without noise over that with it."""
        return self.rms / float(np.sqrt(self.rms**2 + self.noise))

    @property
    def slope_rms(self) -> float:
        """Slope rms of an isotropic surface: √2 times that along a line."""
        return float(np.sqrt(2) * self.rms)

    @property
    def measured_to(self) -> float:
        """The largest edge beyond which there are 100 independent slopes."""
        steeper = np.cumsum(self.counts[::-1])[::-1]
        return float(self.bins[np.flatnonzero(steeper >= min(100 * self.redundancy, steeper[0]))[-1], 0])

    @property
    def rms_of_halves(self) -> Array:
        """(1 + halves,) rms of all slopes and of each half-sample, from the bins; without outlying slopes."""
        counts = self.halves() * (self.middles < self.outlying.slope)
        return np.asarray(np.sqrt(counts @ self.middles**2 / counts.sum(axis=1)))

    def halves(self) -> Array:
        """Counts (stretches, bins): of all stretches, then of balanced half-samples of them, doubled.

        The half-samples are the rows of a Hadamard matrix. The mean square deviation over them is the variance of an estimate
        from all stretches; exactly so for estimates that are linear in the counts.

        Source: McCarthy 1969, Rev. Int. Stat. Inst. 37, 239: balanced half-samples.
        """
        from scipy.linalg import hadamard

        weights = 1.0 + hadamard(STRETCHES)
        weights[0] = 1
        return np.asarray(weights @ self.by_stretch)

    def shares(self, below: Callable[[Array], Array]) -> Array:
        """Probabilities of the bins (bins, parts) of a model; ``below`` gives its probability within ± p, (..., parts) of p (...)."""
        low, high = (below(edge[:, None] + self.blur).mean(axis=1) for edge in self.bins.T)
        return np.asarray((high - low) * self.share[:, None])

    def divided_by(self, scale: float) -> LineSlopeCounts:
        """The same counts of slopes divided by ``scale``."""
        return self._replace(
            bins=self.bins / scale,
            blur=self.blur / scale,
            rms=self.rms / scale,
            quantum=self.quantum / scale,
            noise=self.noise / scale**2,
            noise_u=self.noise_u / scale**2,
            outlying=self.outlying._replace(slope=self.outlying.slope / scale),
        )


def count_slopes(lines: Sequence[xr.Dataset], noise: float | NoiseFloor | None = None) -> LineSlopeCounts:
    """Count the slopes between neighbouring points of lines, each line's mean removed.

    Slopes next to a missing height are left out. Of quantised heights, slopes are multiples of a quantum, and a bin holds whole
    multiples. If the heights vary over many steps, rounding turns a slope into the multiple above or below with probabilities
    in proportion to the distances: slopes within half a quantum of an edge may cross it. Lines of different quantum are counted
    in separate bins. White height noise, given [um] or seen as a plateau of the spectrum of a line, blurs the edges of the bins.

    Raises FacetError: a line has fewer than 63 slopes, slopes that are all equal, or an impossible slope rms.
    """
    profiles = [_with_noise(_profile(line), line, noise) for line in lines]
    profiles.sort(key=lambda profile: profile.quantum)
    quanta = np.array([profile.quantum for profile in profiles])
    begins = np.flatnonzero(quanta[1:] > 1.01 * quanta[:-1]) + 1
    parts = [_count_one_quantum(profiles[a:b]) for a, b in zip([0, *begins], [*begins, len(profiles)], strict=True)]
    return parts[0] if len(parts) == 1 else _merged_bins(parts)


def _merged_bins(parts: Sequence[LineSlopeCounts]) -> LineSlopeCounts:
    sizes = np.array([part.size for part in parts]) / sum(part.size for part in parts)
    bins = np.concatenate([part.bins for part in parts])
    order = np.argsort(bins.sum(axis=1), kind="stable")
    finest = max(part.blur.shape[1] for part in parts)
    return LineSlopeCounts(
        bins[order],
        np.concatenate([part.by_stretch for part in parts], axis=1)[:, order],
        np.concatenate([size * part.share for size, part in zip(sizes, parts, strict=True)])[order],
        np.concatenate([np.repeat(part.blur, finest // part.blur.shape[1], axis=1) for part in parts])[order],
        float(np.sqrt(sizes @ np.array([part.rms**2 for part in parts]))),
        max(part.quantum for part in parts),
        float(sizes @ np.array([part.noise for part in parts])),
        float(sizes @ np.array([part.noise_u for part in parts])),
        Outlying(
            min(part.outlying.slope for part in parts),
            float(sizes @ np.array([part.outlying.share for part in parts])),
            max(part.outlying.contribution for part in parts),
        ),
    )


def _count_one_quantum(profiles: Sequence[_Profile]) -> LineSlopeCounts:
    """Count the slopes of lines of one quantum."""
    quantum = float(np.mean([profile.quantum for profile in profiles]))
    sizes = np.array([profile.size for profile in profiles]) / sum(profile.size for profile in profiles)
    noise, noise_u = (float(sizes @ [getattr(p, name) for p in profiles]) for name in ("noise", "noise_u"))
    blur = _with_gaussian(_blur(profiles, quantum), noise)
    edges, fine = _fine_counts(profiles, quantum)
    steep = outlying(fine)
    counts = fine.sum(axis=0) * (edges[:-1] < steep.slope)
    mean_square = float(counts @ (edges[1:] ** 2 + edges[:-1] ** 2)) / 2 / float(counts.sum())
    # Rounding two heights adds q²/6; half of it is the blur about the edges.
    rms = float(
        np.sqrt(
            max(
                mean_square - float(np.mean(blur**2)) - quantum**2 / 12,
                mean_square * (_LEAST_SURFACE if noise else 1 / 4),
            )
        )
    )
    targets = rms * np.sinh(np.linspace(0, np.arcsinh(edges[-1] / rms), BINS + 1))
    if quantum:
        edges, by_stretch = _count_multiples(profiles, quantum, targets)
    else:
        cuts = np.unique(np.concatenate([[0], np.minimum(np.searchsorted(edges, targets), edges.size - 1)]))
        edges, by_stretch = edges[cuts], np.add.reduceat(fine, cuts[:-1], axis=1).astype(float)
    bins = np.column_stack([edges[:-1], edges[1:]])
    return LineSlopeCounts(
        bins, by_stretch, np.ones(len(bins)), np.tile(blur, (len(bins), 1)), rms, quantum, noise, noise_u, steep
    )


def _with_gaussian(blur: Array, mean_square: float) -> Array:
    """A blur, convolved with a Gaussian of a mean square."""
    if not mean_square:
        return blur
    from scipy.special import ndtri

    quantiles = (np.arange(_FINE_BLUR) + 0.5) / _FINE_BLUR
    both = np.quantile((blur[:, None] + np.sqrt(mean_square) * ndtri(quantiles)).ravel(), quantiles)
    return np.asarray(both * np.sqrt((np.mean(blur**2) + mean_square) / np.mean(both**2)))


def _blur(profiles: Sequence[_Profile], quantum: float) -> Array:
    """Distances from an edge at which slopes are rounded across it: half a quantum either way, plus the remainder of their mean."""
    if not quantum:
        return np.zeros(1)
    numbers = [np.linspace(0, profile.size - 1, 64).astype(int) for profile in profiles]
    remainders = np.concatenate(
        [p.mean - p.shift(p.positions(some), quantum) for p, some in zip(profiles, numbers, strict=True)]
    )
    within = quantum * ((np.arange(_BLUR) + 0.5) / _BLUR - 0.5)
    blur = (np.concatenate([remainders, -remainders])[:, None] + within).ravel()
    return np.asarray(np.quantile(blur, (np.arange(_BLUR) + 0.5) / _BLUR))


def _fine_counts(profiles: Sequence[_Profile], quantum: float) -> tuple[Array, NDArray[np.int64]]:
    """Edges of bins of 0.3 % of the slope up to the steepest, and counts in them (stretches, bins)."""
    from brdfpipe.facets import slope_kernels

    fine, tables = np.zeros((STRETCHES, FINE_BINS), dtype=np.int64), slope_kernels.empty_tables()
    for stretch, parts in groupby(_stretches(profiles), key=itemgetter(0)):
        for _, profile, span in parts:
            if profile.present is None and profile.is_steady(quantum):
                ahead, behind = profile.rises[span.start + 1 : span.stop + 1], profile.rises[span]
                shift = float(np.ravel(profile.shift(np.arange(1), quantum))[0])
                slope_kernels.count_line_slopes(ahead, behind, 1 / profile.pitch, shift, tables)
            else:
                slopes = profile.slopes(span, quantum)
                slope_kernels.count_line_slopes(slopes, np.zeros_like(slopes), 1.0, 0.0, tables)
        slope_kernels.move_counts(tables, fine[stretch])
    used = int(np.flatnonzero(fine.any(axis=0))[-1]) + 1
    return fine_edges()[: used + 1], fine[:, :used]


def _count_multiples(profiles: Sequence[_Profile], quantum: float, targets: Array) -> tuple[Array, Array]:
    """Edges of bins of whole multiples of the quantum, about those of the targets, and counts in them (stretches, bins)."""
    cuts = np.unique(np.concatenate([[0, 1], np.rint(targets / quantum + 0.5).astype(np.int64)]))
    by_stretch = np.zeros((STRETCHES, cuts.size - 1))
    for stretch, profile, span in _stretches(profiles):
        slopes = profile.slopes(span, quantum)
        multiples = np.rint(np.abs(slopes[np.isfinite(slopes)]) / quantum).astype(np.int64)
        counted = np.bincount(np.minimum(multiples, cuts[-1] - 1), minlength=cuts[-1])
        by_stretch[stretch] += np.add.reduceat(counted, cuts[:-1])
    return np.maximum(cuts - 0.5, 0) * quantum, by_stretch


class _Profile(NamedTuple):
    """Height differences of a line, with the mean and the quantisation of its slopes."""

    rises: Array
    """Differences between neighbouring heights; the heights themselves if none is missing."""
    present: NDArray[np.intp] | None
    """Positions of the differences in the line; None if none is missing."""
    pitch: float
    size: int
    """Number of slopes."""
    mean: float
    quantum: float
    offset: float
    """Offset of the grid of possible slopes, at the first slope; 0 without a quantum."""
    growth: float
    """Growth of the offset from slope to slope, caused by a parabola subtracted from quantised heights."""
    noise: float = 0.0
    """Mean square that height noise adds to the slopes, besides rounding."""
    noise_u: float = 0.0
    """Standard uncertainty of that mean square."""

    def positions(self, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Positions in the line of slopes given by number."""
        return numbers if self.present is None else self.present[numbers]

    def shift(self, positions: NDArray[np.intp], quantum: float) -> Array | float:
        """What to subtract from slopes: their mean; of quantised ones, the possible value nearest to it."""
        if not quantum:
            return self.mean
        lattice = self.offset + self.growth * positions
        # Whole multiples are removed, so that lines of different tilt share them; the remainder of each mean adds to the blur.
        return np.asarray(lattice + quantum * np.rint((self.mean - lattice) / quantum))

    def is_steady(self, quantum: float) -> bool:
        """Whether what to subtract is the same for all slopes."""
        return not quantum or abs(self.growth) * self.size < 0.01 * quantum

    def slopes(self, span: slice, quantum: float) -> Array:
        """Slopes given by number, less their shift."""
        if self.present is None:
            slopes = np.diff(self.rises[span.start : span.stop + 1].astype(float)) * (1 / self.pitch)
        else:
            slopes = self.rises[span] / self.pitch
        steady = self.is_steady(quantum)
        positions = np.arange(1) if steady else self.positions(np.arange(span.start, span.stop))
        return np.asarray(slopes - self.shift(positions, quantum))


def _with_noise(profile: _Profile, line: xr.Dataset, noise: float | NoiseFloor | None) -> _Profile:
    floor = noise_floor(line, noise)
    rest = noise_besides_rounding(floor, profile.quantum * profile.pitch)
    return profile._replace(
        noise=2 * (rest / profile.pitch) ** 2, noise_u=4 * rest * floor.uncertainty / profile.pitch**2 if rest else 0.0
    )


def _profile(line: xr.Dataset) -> _Profile:
    height, pitch = np.asarray(line["height"].values), float(line.attrs["pitch_x"])
    if height.size > 1 and np.isfinite(height.sum(dtype=float)):
        rises, present, size = height, None, height.size - 1
        total, sample = float(height[-1]) - float(height[0]), np.diff(height[: _SAMPLED + 1].astype(float))
    else:
        rises = np.diff(height.astype(float))
        present = np.flatnonzero(np.isfinite(rises))
        rises, size = rises[present], present.size
        total, sample = float(rises.sum()), rises[:_SAMPLED]
    if size < MIN_SLOPES:
        raise FacetError(
            f"a line profile has {size} slopes between neighbouring heights; at least {MIN_SLOPES} are needed; measure a longer line"
        )
    profile = _Profile(rises, present, pitch, size, total / (size * pitch), 0.0, 0.0, 0.0)
    sample = sample / pitch - profile.mean
    _check_slopes(sample, profile.mean)
    quantum, offset, growth = _lattice(sample, profile.positions(np.arange(sample.size)))
    return profile._replace(quantum=quantum, offset=profile.mean + offset, growth=growth)


def _check_slopes(slopes: Array, mean: float) -> None:
    """Refuse slopes about their mean that are all equal, or of an impossible rms."""
    largest = float(np.abs(slopes).max())
    if largest <= 1e-12 * abs(mean):
        raise FacetError("a line profile is flat: all its slopes are equal; check the heights (`surface.file`)")
    rms = largest * float(np.sqrt(np.mean((slopes / largest) ** 2)))
    check_slope_rms(rms, " of a line profile")


def _stretches(profiles: Sequence[_Profile]) -> Iterator[tuple[int, _Profile, slice]]:
    """The slopes of all lines in chunks: the number of their stretch, their line, and which of its slopes they are."""
    borders, begin = np.linspace(0, sum(profile.size for profile in profiles), STRETCHES + 1).astype(int).tolist(), 0
    for profile in profiles:
        for stretch in range(STRETCHES):
            low, high = (min(max(border - begin, 0), profile.size) for border in borders[stretch : stretch + 2])
            for start in range(low, high, _CHUNK):
                yield stretch, profile, slice(start, min(start + _CHUNK, high))
        begin += profile.size


def _lattice(slopes: Array, positions: NDArray[np.intp]) -> tuple[float, float, float]:
    """Quantum of slopes, a value they take, and its growth along the line; zeros if the slopes are not quantised.

    Subtracting a parabola makes the possible values grow along the line. The second differences are then that growth plus whole
    quanta; the smallest of them is the growth, which is less than half a quantum.
    """
    curvatures, growth = np.diff(slopes)[np.diff(positions) == 1], 0.0
    if curvatures.size:
        smallest, largest = curvatures[np.argmin(np.abs(curvatures))], np.abs(curvatures).max()
        growth = float(np.mean(curvatures[np.abs(curvatures - smallest) <= _EQUAL_CURVATURES * largest]))
    slopes = slopes - growth * positions
    rms = float(slopes.std())
    centre = float(np.median(slopes))
    slopes = slopes - centre
    multiples = distinct_multiples(slopes, rms, _EQUAL_SLOPES, _REACH) if rms else None
    if multiples is None:
        return 0.0, 0.0, 0.0
    values, counts, frequency = multiples
    quantum, offset = 1 / frequency, 0.0
    # The peak gives the quantum within a few per cent, enough to count the steps between values; the counts then give it exactly.
    for _ in range(2):
        steps = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(values) / quantum))])
        if steps[-1] < 2:
            # Slopes of two values are the shape of the surface, not quantisation.
            return 0.0, 0.0, 0.0
        quantum, offset = np.polyfit(steps, values, 1, w=np.sqrt(counts)).tolist()
    # Arbitrary values next to a plateau are not quantised either.
    others = np.where(counts < counts.max(), counts, 0)
    if abs(others @ np.exp(2j * np.pi * values / quantum)) < 0.5 * others.sum():
        return 0.0, 0.0, 0.0
    return quantum * rms, centre + offset * rms, growth

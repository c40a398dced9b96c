"""Slopes along line profiles, counted in stretches; where heights come in steps, in whole steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.facets.counting import FacetError, redundancy_of
from brdfpipe.facets.slopes import FINE_BINS, SlopeCounts, count_bits
from brdfpipe.geometry import Array

STRETCHES = 32
"""Lines are cut into this many stretches, from whose scatter uncertainties come: a power of two."""

LEAST = 63
"""Slopes that must be there: those of the shortest line that is read."""

BINS = 128

_SLOPE_RMS = (1e-9, 1e9)
"""Slope rms outside which the squares of slopes may not even be numbers of single precision."""

_CHUNK = 2**15
_CLASSES = 16
_BLUR = 32

# A quantum is looked for in this many slopes, from this share of their rms, below which it does no harm, in slopes up to so many.
_SAMPLED = 2**15
_FINEST = 1 / 2048
_REACH = 16.0

_BENT_ALIKE = 1e-4
_ALIKE = 3e-5
"""Slopes that differ by this share of their rms count as one value: more than single precision makes of one."""


class Marginal(NamedTuple):
    """Slopes p along lines of one direction, counted by |p|."""

    bins: Array
    """(bins, 2) |p| between which each bin lies, by increasing middle. Lines of different quantum have bins of their own."""
    by_stretch: Array
    """(stretches, bins) slopes in each bin."""
    share: Array
    """(bins,) what part of all slopes is counted in bins of the same quantum."""
    blur: Array
    """(bins, n) from where about its edges slopes are rounded into a bin, in equal shares; 0 where they are not rounded."""
    rms: float
    quantum: float
    """Largest step between the values that slopes of a line take; 0 where they take any."""

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

    @property
    def median(self) -> float:
        cumulative = np.concatenate([[0.0], np.cumsum(self.counts)])
        return float(np.interp(0.5 * cumulative[-1], cumulative, np.append(0.0, self.bins[:, 1])))

    @property
    def redundancy(self) -> float:
        """How many slopes count as one, in classes wide enough for neighbouring slopes to share them."""
        cumulative = np.cumsum(self.counts)
        classes = np.minimum(cumulative - self.counts / 2, cumulative[-1] - 0.5) * _CLASSES // cumulative[-1]
        starts = np.flatnonzero(np.diff(classes, prepend=-1))
        return redundancy_of(np.add.reduceat(self.by_stretch, starts, axis=1))

    @property
    def effective(self) -> float:
        """Independent slopes."""
        return self.size / self.redundancy

    @property
    def rounding(self) -> float:
        """Mean square of what rounding the heights may have changed slopes by, over that of the slopes."""
        return float(self.counts @ (2 * self.blur**2).mean(axis=1)) / self.size / self.rms**2

    @property
    def slope_rms(self) -> float:
        """Of an isotropic surface, which has twice the mean square slope of any line on it."""
        return float(np.sqrt(2) * self.rms)

    @property
    def measured_to(self) -> float:
        """The last edge beyond which a hundred independent slopes lie."""
        beyond = np.cumsum(self.counts[::-1])[::-1]
        return float(self.bins[np.flatnonzero(beyond >= min(100 * self.redundancy, beyond[0]))[-1], 0])

    @property
    def rms_of_halves(self) -> Array:
        """(1 + halves,) rms of all slopes and of those of the halves, as the bins tell it."""
        counts = self.halves()
        return np.asarray(np.sqrt(counts @ self.middles**2 / counts.sum(axis=1)))

    def halves(self) -> Array:
        """Counts of all stretches, and of as many halves of them, each counted twice (stretches, bins).

        The halves are the rows of a Hadamard matrix: the mean square deviation over them is the variance of what is estimated from
        all stretches, exactly so for what is linear in the counts, and they are as far off as the lines themselves may be.

        References
        ----------
        McCarthy 1969, Rev. Int. Stat. Inst. 37, 239: balanced half-samples.
        """
        from scipy.linalg import hadamard

        weights = 1.0 + hadamard(STRETCHES)
        weights[0] = 1
        return np.asarray(weights @ self.by_stretch)

    def shares(self, below: Callable[[Array], Array]) -> Array:
        """From what part of a model lies within ± p, (..., parts) of p (...), its share of each bin (bins, parts)."""
        low, high = (below(edge[:, None] + self.blur).mean(axis=1) for edge in self.bins.T)
        return np.asarray((high - low) * self.share[:, None])

    def over(self, scale: float) -> Marginal:
        """The slopes over a scale."""
        return self._replace(
            bins=self.bins / scale, blur=self.blur / scale, rms=self.rms / scale, quantum=self.quantum / scale
        )


def count(lines: Sequence[xr.Dataset]) -> Marginal:
    """Count the slopes between neighbouring points of lines, each line's mean removed.

    Points next to a missing height are left out. Where the heights come in steps, slopes take multiples of a quantum alone. Then
    a bin holds whole multiples. From a difference of heights, rounding makes the multiple above or below with probabilities in
    proportion (for heights over many steps), so what lies between two multiples is shared out between them: an edge is crossed
    anywhere within half a quantum of it. Lines of different quantum are counted in bins of their own.

    Raises
    ------
    FacetError : a line of fewer than 63 slopes, or whose slopes are all equal, or slopes that no surface has.
    """
    profiles = [_profile(line) for line in lines]
    profiles.sort(key=lambda profile: profile.quantum)
    quanta = np.array([profile.quantum for profile in profiles])
    begins = np.flatnonzero(quanta[1:] > 1.01 * quanta[:-1]) + 1
    parts = [_count_alike(profiles[a:b]) for a, b in zip([0, *begins], [*begins, len(profiles)], strict=True)]
    return parts[0] if len(parts) == 1 else _together(parts)


def _together(parts: Sequence[Marginal]) -> Marginal:
    sizes = np.array([part.size for part in parts]) / sum(part.size for part in parts)
    bins = np.concatenate([part.bins for part in parts])
    order = np.argsort(bins.sum(axis=1), kind="stable")
    return Marginal(
        bins[order],
        np.concatenate([part.by_stretch for part in parts], axis=1)[:, order],
        np.concatenate([size * part.share for size, part in zip(sizes, parts, strict=True)])[order],
        np.concatenate([np.broadcast_to(part.blur, (len(part.bins), _BLUR)) for part in parts])[order],
        float(np.sqrt(sizes @ np.array([part.rms**2 for part in parts]))),
        max(part.quantum for part in parts),
    )


def _count_alike(profiles: Sequence[_Profile]) -> Marginal:
    """Count the slopes of lines of one quantum."""
    quantum = float(np.mean([profile.quantum for profile in profiles]))
    blur = _blur(profiles, quantum)
    edges, fine = _fine_counts(profiles, quantum)
    counts = fine.sum(axis=0)
    mean_square = float(counts @ (edges[1:] ** 2 + edges[:-1] ** 2)) / 2 / float(counts.sum())
    # Rounding two heights adds q²/6, of which the blur about the edges is the half.
    rms = float(np.sqrt(max(mean_square - float(np.mean(blur**2)) - quantum**2 / 12, mean_square / 4)))
    wanted = rms * np.sinh(np.linspace(0, np.arcsinh(edges[-1] / rms), BINS + 1))
    if quantum:
        edges, by_stretch = _count_multiples(profiles, quantum, wanted)
    else:
        cuts = np.unique(np.concatenate([[0], np.minimum(np.searchsorted(edges, wanted), edges.size - 1)]))
        edges, by_stretch = edges[cuts], np.add.reduceat(fine, cuts[:-1], axis=1).astype(float)
    bins = np.column_stack([edges[:-1], edges[1:]])
    return Marginal(bins, by_stretch, np.ones(len(bins)), np.tile(blur, (len(bins), 1)), rms, quantum)


def _blur(profiles: Sequence[_Profile], quantum: float) -> Array:
    """Where about an edge slopes are rounded across it: within half a quantum, and by what of their mean is no whole multiple."""
    if not quantum:
        return np.zeros(1)
    places = [np.linspace(0, profile.size - 1, 64).astype(int) for profile in profiles]
    rests = np.concatenate([p.mean - p.shift(p.places(at), quantum) for p, at in zip(profiles, places, strict=True)])
    within = quantum * ((np.arange(_BLUR) + 0.5) / _BLUR - 0.5)
    blur = (np.concatenate([rests, -rests])[:, None] + within).ravel()
    return np.asarray(np.quantile(blur, (np.arange(_BLUR) + 0.5) / _BLUR))


def _fine_counts(profiles: Sequence[_Profile], quantum: float) -> tuple[Array, NDArray[np.int64]]:
    """Edges of bins of 0.3 % of the slope up to the steepest, and counts in them (stretches, bins)."""
    fine = np.zeros((STRETCHES, FINE_BINS), dtype=np.int64)
    with np.errstate(over="ignore"):
        for stretch, slopes in _stretches(profiles, quantum):
            fine[stretch] += count_bits(np.square(slopes, dtype=np.float32, casting="same_kind"))
    used = int(np.flatnonzero(fine.any(axis=0))[-1]) + 1
    return SlopeCounts(fine).edges[: used + 1], fine[:, :used]


def _count_multiples(profiles: Sequence[_Profile], quantum: float, wanted: Array) -> tuple[Array, Array]:
    """Edges of bins of whole multiples of the quantum, about as wide as wanted, and counts in them (stretches, bins)."""
    cuts = np.unique(np.concatenate([[0, 1], np.rint(wanted / quantum + 0.5).astype(np.int64)]))
    by_stretch = np.zeros((STRETCHES, cuts.size - 1))
    for stretch, slopes in _stretches(profiles, quantum):
        multiples = np.rint(np.abs(slopes[np.isfinite(slopes)]) / quantum).astype(np.int64)
        counted = np.bincount(np.minimum(multiples, cuts[-1] - 1), minlength=cuts[-1])
        by_stretch[stretch] += np.add.reduceat(counted, cuts[:-1])
    return np.maximum(cuts - 0.5, 0) * quantum, by_stretch


class _Profile(NamedTuple):
    """Heights of a line, and what its slopes are like."""

    rises: Array
    """Differences between neighbouring heights, or the heights where none is missing: then all differences are there."""
    there: NDArray[np.intp] | None
    """Where the differences stand in the line; None where all are there."""
    pitch: float
    size: int
    """Number of slopes."""
    mean: float
    quantum: float
    offset: float
    """Slope on which, and on whose multiples of the quantum, the first slope lies; 0 without a quantum."""
    bend: float
    """By how much it grows from slope to slope: a parabola was subtracted from heights in steps."""

    def places(self, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Where in the line the slopes of given numbers stand."""
        return numbers if self.there is None else self.there[numbers]

    def shift(self, places: NDArray[np.intp], quantum: float) -> Array | float:
        """What to take from the slopes at places: their mean; with a quantum, the nearest value that they may take."""
        if not quantum:
            return self.mean
        lattice = self.offset + self.bend * places
        # Whole multiples are removed, lest lines of different tilt lie on different multiples; the rest of each mean blurs.
        return np.asarray(lattice + quantum * np.rint((self.mean - lattice) / quantum))


def _profile(line: xr.Dataset) -> _Profile:
    height, pitch = np.asarray(line["height"].values), float(line.attrs["pitch_x"])
    if height.size > 1 and np.isfinite(height.sum(dtype=float)):
        rises, there, size = height, None, height.size - 1
        total, sample = float(height[-1]) - float(height[0]), np.diff(height[: _SAMPLED + 1].astype(float))
    else:
        rises = np.diff(height.astype(float))
        there = np.flatnonzero(np.isfinite(rises))
        rises, size = rises[there], there.size
        total, sample = float(rises.sum()), rises[:_SAMPLED]
    if size < LEAST:
        raise FacetError(
            f"a line profile has {size} slopes between neighbouring heights, at least {LEAST} are needed; measure a longer line"
        )
    profile = _Profile(rises, there, pitch, size, total / (size * pitch), 0.0, 0.0, 0.0)
    sample = sample / pitch - profile.mean
    _check_slopes(sample, profile.mean)
    quantum, offset, bend = _lattice(sample, profile.places(np.arange(sample.size)))
    return profile._replace(quantum=quantum, offset=profile.mean + offset, bend=bend)


def _check_slopes(slopes: Array, mean: float) -> None:
    """Refuse slopes about their mean that are all equal, or none that a surface can have."""
    largest = float(np.abs(slopes).max())
    if largest <= 1e-12 * abs(mean):
        raise FacetError("a line profile is flat: all its slopes are equal; check the heights (`surface.file`)")
    rms = largest * float(np.sqrt(np.mean((slopes / largest) ** 2)))
    if not _SLOPE_RMS[0] < rms < _SLOPE_RMS[1]:
        raise FacetError(
            f"the slope rms {rms:.2g} of a line profile is none that a surface can have; check the unit of the heights "
            "(`surface.unit`) and of the pitch (`surface.lateral_unit`)"
        )


def _stretches(profiles: Sequence[_Profile], quantum: float) -> Iterator[tuple[int, Array]]:
    """Slopes of all lines less the shift of each, some at a time, and the number of the stretch they belong to."""
    borders = np.linspace(0, sum(profile.size for profile in profiles), STRETCHES + 1).astype(int)
    slopes, begin = np.empty(_CHUNK), 0
    for profile in profiles:
        end = begin + profile.size
        first = max(0, int(np.searchsorted(borders, begin, side="right")) - 1)
        steady = not quantum or abs(profile.bend) * profile.size < 0.01 * quantum
        shift = profile.shift(np.arange(1), quantum)
        for stretch in range(first, STRETCHES):
            low, high = max(borders[stretch], begin) - begin, min(borders[stretch + 1], end) - begin
            for start in range(low, high, _CHUNK):
                stop = min(start + _CHUNK, high)
                part = slopes[: stop - start]
                if profile.there is None:
                    np.subtract(profile.rises[start + 1 : stop + 1], profile.rises[start:stop], out=part, dtype=float)
                    part *= 1 / profile.pitch
                else:
                    np.divide(profile.rises[start:stop], profile.pitch, out=part)
                part -= shift if steady else profile.shift(profile.places(np.arange(start, stop)), quantum)
                yield stretch, part
        begin = end


def _lattice(slopes: Array, places: NDArray[np.intp]) -> tuple[float, float, float]:
    """Quantum of slopes that take few values, a value they take, and its growth from place to place; zeros where they take any.

    A parabola that was subtracted makes what they take grow along the line. Three heights in steps then bend by it and whole
    quanta: the least of all bends is the parabola's, which hardly bends by half a quantum itself.

    The quantum is that of the lowest frequency at which the characteristic function comes back towards 1: unlike a greatest
    common divisor, it stands heights that were rounded once more when they were printed.
    """
    from scipy.fft import rfft

    bends = np.diff(slopes)[np.diff(places) == 1]
    bend = float(bends[np.argmin(np.abs(bends))]) if bends.size else 0.0
    bend = float(np.mean(bends[np.abs(bends - bend) <= _BENT_ALIKE * np.abs(bends).max()])) if bends.size else 0.0
    slopes = slopes - bend * places
    rms = float(slopes.std())
    centre = float(np.median(slopes))
    slopes = slopes - centre
    if rms == 0:
        return 0.0, 0.0, 0.0
    values, counts = np.unique(np.rint(slopes / (_ALIKE * rms)), return_counts=True)
    if values.size > slopes.size / 2:
        return 0.0, 0.0, 0.0
    values = values * _ALIKE
    near = np.abs(values) < _REACH
    values, counts = values[near], counts[near]
    bins = int(2 * _REACH / _FINEST) * 2
    place = ((values + _REACH) * (bins / (2 * _REACH))).astype(np.int64)
    returned = np.abs(rfft(np.bincount(place, counts, minlength=bins))) / counts.sum()
    peaks = np.flatnonzero((returned[1:-1] > returned[:-2]) & (returned[1:-1] >= returned[2:])) + 1
    peaks = peaks[returned[peaks] > 0.5]
    if peaks.size == 0:
        return 0.0, 0.0, 0.0
    quantum, offset = 2 * _REACH / float(peaks[0]), 0.0
    # The peak tells the quantum within a few per cent, enough to count the steps from value to value; they tell it exactly.
    for _ in range(2):
        steps = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(values) / quantum))])
        if steps[-1] < 2:
            # Two values are the shape of the surface.
            return 0.0, 0.0, 0.0
        quantum, offset = np.polyfit(steps, values, 1, w=np.sqrt(counts)).tolist()
    # So are any values beside a plateau.
    others = np.where(counts < counts.max(), counts, 0)
    if abs(others @ np.exp(2j * np.pi * values / quantum)) < 0.5 * others.sum():
        return 0.0, 0.0, 0.0
    return quantum * rms, centre + offset * rms, bend

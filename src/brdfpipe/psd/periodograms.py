"""Periodograms of a map or a line: windowed patches at full pitch for high frequencies, coarser heights for low ones.

A patch is levelled by its least-squares plane and multiplied by a Hann window w along each axis; S = |Σ w z e|² ΔA / Σ w². The
heights are halved by means of neighbours, again and again: each coarser copy gives the next octave, and the last one, taken
whole, the longest waves. So the cost is that of a few sums over the map, of any size.

References
----------
Welch 1967, IEEE Trans. AU-15, 70; Elson & Bennett 1995, Appl. Opt. 34, 201; Jacobs, Junge & Pastewka 2017, Surf. Topogr. 5, 013001.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.psd.k_correlation import PsdError

CYCLES = 8
"""Fewest waves across a patch that is not the whole map."""

RINGS_PER_DECADE = 20

_PATCH = {1: 4096, 2: 256}
"""Heights along a side of a patch, of a line and of a map."""
_SHORTEST_PATCH = 32
_ENOUGH = f"accepted: {_SHORTEST_PATCH} or more along each side. Measure a larger area"
_MOST_PATCHES = 64
_BATCH = 8
_SUMMED = 2**18
_WAVES_OF_WHOLE = 2
_COMPLETE = 0.25
"""Least share of patches at full pitch without a gap: fewer would be the smoothest ones, if steep places are missing."""
_RIMS = 4
"""Heights from the rim of a gap that are filled in one after the other."""
_MODES = 4.0
"""Fewest independent modes of a ring."""
_SYSTEMATIC = 0.01
"""Relative standard uncertainty of a ring from its width and from the leakage of the window."""
_LARGEST_BIAS = 0.5
"""Largest correction for the width of the window, relative to the spectrum; lower frequencies are left out."""
_STEEPEST = 8.0
_HANN_LOSS = 35 / 18
"""Modes of a Hann window per independent one, along an axis: ⟨w⁴⟩/⟨w²⟩²."""


class Scan(NamedTuple):
    """Heights of a map or a line, and the pitch."""

    height: Array
    """(rows, columns) or (points,) [um]"""
    pitch: tuple[float, ...]
    """Along each axis of the heights [um]."""

    @classmethod
    def of(cls, surface: xr.Dataset) -> Scan:
        height = surface["height"]
        return cls(height.values, tuple(float(surface.attrs[f"pitch_{axis}"]) for axis in height.dims))

    @property
    def variance(self) -> float:
        """Of the heights that are present, about their mean [um2]."""
        total = float(self.height.sum(dtype=float))
        if not np.isfinite(total):
            return float(np.nanvar(self.height.astype(float)))
        mean, rows = total / self.height.size, max(1, _SUMMED // max(1, self.height[0].size))
        parts = (self.height[start : start + rows] - mean for start in range(0, self.height.shape[0], rows))
        return sum(float(np.square(part, dtype=float).sum()) for part in parts) / self.height.size

    @property
    def nyquist(self) -> float:
        """Highest frequency that is sampled in all directions [um-1]."""
        return 0.5 / max(self.pitch)

    @property
    def cell(self) -> float:
        """Area of a cell of a map [um2], or pitch of a line [um]."""
        return float(np.prod(self.pitch))


class Periodogram(NamedTuple):
    """Spectra of patches of one size, at one pitch."""

    axes: tuple[Array, ...]
    """Frequencies along each axis of a patch [um-1], in the order of a real transform."""
    spectra: Array
    """(patches, …) two-sided spectra, with the noise [um4; of a line um3]."""
    length: float
    """Shortest side of a patch [um]."""
    low: float
    """Lowest frequency that these patches are used for [um-1]."""

    @property
    def radius(self) -> Array:
        """Magnitude of the frequency of each mode [um-1]."""
        return np.sqrt(sum(axis**2 for axis in np.meshgrid(*self.axes, indexing="ij", sparse=True)))

    @property
    def weight(self) -> Array:
        """Of each mode of a real transform: half of a pair, so that modes of weight 1 are independent but for the window."""
        last = np.full(self.spectra.shape[-1], 1.0)
        last[0] = 0.5
        last[-1] = 0.5
        return np.broadcast_to(last, self.spectra.shape[1:])


class Rings(NamedTuple):
    """Spectrum in rings of frequency."""

    frequency: Array
    """Logarithmic mean of the modes [um-1], increasing."""
    density: Array
    """Mean over modes and patches, with the noise [um4; of a line um3]."""
    uncertainty: Array
    """Standard uncertainty of that mean: from the number of modes, or from the scatter of the patches if that is larger."""

    def __add__(self, other: Rings) -> Rings:  # type: ignore[override]
        return Rings(*(np.concatenate(parts) for parts in zip(self, other, strict=True)))

    def between(self, low: float, high: float) -> Rings:
        """The rings from one frequency to another."""
        inside = (self.frequency >= low) & (self.frequency <= high)
        return Rings(*(values[inside] for values in self))


class PatchCount(NamedTuple):
    """What a spectrum was estimated from."""

    side: int
    """Heights along a side of a patch at full pitch."""
    used: int
    """Patches at full pitch without a gap."""
    positions: int
    """Patches at full pitch in all."""
    filled: int
    """Missing heights filled in from their neighbours: for the longest waves, or for all if few patches are complete."""
    complete: bool
    """Whether the patches had no gaps before."""


def periodograms(scan: Scan) -> tuple[list[Periodogram], PatchCount]:
    """Periodograms from the highest frequencies to the lowest, each used up to the ``low`` of the one before it.

    Where most patches of 32 heights along a side have a gap, all missing heights are filled in. A spectrum of filled heights is scaled
    so that the variance is that of the heights that are present.
    """
    size, count, scale, complete = _PATCH[scan.height.ndim], 0, 1.0, True
    try:
        full, positions = full_pitch(scan, size, _MOST_PATCHES)
        complete = full.spectra.shape[0] >= _COMPLETE * positions
    except PsdError:
        complete = False
    if not complete:
        count = int(np.count_nonzero(~np.isfinite(scan.height)))
        scan, scale = filled(scan)
        full, positions = full_pitch(scan, size, _MOST_PATCHES)
    levels, coarse, factor = [full], scan, 1
    while min(coarse.height.shape) >= 4 * size:
        coarse, factor = coarser(coarse), 2 * factor
        corners = _corners(coarse.height.shape, (size,) * coarse.height.ndim, _MOST_PATCHES)
        level = _periodogram(coarse, (size,) * coarse.height.ndim, corners, factor)
        levels += [level] if level.spectra.size else []
    levels = [level._replace(spectra=level.spectra * scale) for level in levels] if scale != 1 else levels
    gaps = coarse
    if missing := int(np.count_nonzero(~np.isfinite(coarse.height))):
        count = missing
        coarse, _ = filled(coarse)
    shortest = min(n * pitch for n, pitch in zip(coarse.height.shape, coarse.pitch, strict=True))
    sides = [int(min(n, 2 * shortest / pitch)) for n, pitch in zip(coarse.height.shape, coarse.pitch, strict=True)]
    whole = tuple(side - side % 2 for side in sides)
    corners = _corners(coarse.height.shape, whole, _BATCH)
    level = _periodogram(coarse, whole, corners, factor)
    if missing:
        # A gap in the middle, where the window is largest, has more weight than others.
        weight = _window_weight(coarse.height.shape, whole, corners)
        scale = _weighted_variance(gaps.height, weight) / max(_weighted_variance(coarse.height, weight), 1e-300)
    levels.append(level._replace(low=_WAVES_OF_WHOLE / level.length, spectra=level.spectra * scale))
    side = 2 * (full.axes[-1].size - 1)
    return levels, PatchCount(side, full.spectra.shape[0], positions, count, complete)


def full_pitch(scan: Scan, size: int, most: int) -> tuple[Periodogram, int]:
    """Periodograms of patches at full pitch, the largest of which at least a quarter is without a gap, and the number of patches.

    Parameters
    ----------
    size : heights along a side of a patch, at most; a small map is cut into smaller ones
    most : patches, at most, evenly spread over the scan

    Raises
    ------
    PsdError : every patch of 32 heights along a side has a gap.
    """
    if min(scan.height.shape) < 2:
        raise PsdError(f"no roughness spectrum of {' x '.join(map(str, scan.height.shape))} heights; {_ENOUGH}")
    largest = min(size, *(n // 2 for n in scan.height.shape))
    while True:
        side = max(largest - largest % 2, _SHORTEST_PATCH)
        shape = tuple(min(side, n - n % 2) for n in scan.height.shape)
        corners = _corners(scan.height.shape, shape, most)
        full = _periodogram(scan, shape, corners, 1)
        if full.spectra.shape[0] >= len(corners) / 4 or (side == _SHORTEST_PATCH and full.spectra.size):
            return full, len(corners)
        if side == _SHORTEST_PATCH:
            raise PsdError(
                f"no roughness spectrum: every patch of {' x '.join(map(str, shape))} heights has a missing height; accepted: some "
                "patches without gaps. Measure again with fewer missing heights"
            )
        largest //= 2


def rings(levels: Sequence[Periodogram], high: float) -> Rings:
    """Mean spectra in logarithmic rings, from the lowest frequency of the periodograms to ``high`` [um-1].

    Raises PsdError: there is no frequency between these.
    """
    parts = []
    for level in levels:
        if level.low < high:
            parts.append(_rings_of(level, level.low, high))
            high = level.low
    if not parts:
        raise PsdError(f"no roughness spectrum: no wave fits into the scan between its size and its pitch; {_ENOUGH}")
    result = parts[-1]
    for part in parts[-2::-1]:
        result = result + part
    return result


def _rings_of(level: Periodogram, low: float, high: float) -> Rings:
    radius, weight = level.radius.ravel(), level.weight.ravel()
    # The end itself belongs to the last ring: the highest frequency is a mode.
    inside = np.flatnonzero((radius >= low * (1 - 1e-9)) & (radius < high * (1 + 1e-9)))
    inside = inside[np.argsort(radius[inside], kind="stable")]
    radius, weight = radius[inside], weight[inside]
    patches = level.spectra.shape[0]
    loss = _HANN_LOSS ** len(level.axes)
    edges = np.geomspace(low, high, max(1, round(RINGS_PER_DECADE * np.log10(high / low))) + 1)
    starts = _ring_starts(np.searchsorted(radius, edges[:-1] * (1 - 1e-9)), weight, _MODES * loss / patches)
    if starts.size == 0:
        return Rings(*np.zeros((3, 0)))
    total = np.add.reduceat(weight, starts)
    values = (
        np.stack([np.add.reduceat(spectrum.ravel()[inside] * weight, starts) for spectrum in level.spectra]) / total
    )
    density = values.mean(axis=0)
    variance = density**2 * loss / (total * patches)
    if patches > _BATCH:
        excess = values.var(axis=0, ddof=1) / patches / np.maximum(variance, np.finfo(float).tiny)
        kernel = np.ones(5) / 5
        variance *= np.maximum(1.0, np.convolve(np.pad(excess, 2, mode="edge"), kernel, mode="valid"))
    frequency = np.exp(np.add.reduceat(np.log(radius) * weight, starts) / total)
    bias = _window_bias(frequency, density, level)
    variance = (variance + (_SYSTEMATIC * density) ** 2 + (bias / 2 * density) ** 2) / (1 + bias) ** 2
    kept = slice(int(np.argmax(bias < _LARGEST_BIAS)), None)
    return Rings(frequency[kept], (density / (1 + bias))[kept], np.sqrt(variance)[kept])


def _window_bias(frequency: Array, density: Array, level: Periodogram) -> Array:
    """Relative excess of the spectrum of a Hann window of side L: half its mean square width, 1/3L², times the Laplacian of S.

    Of S ∝ f^−p it is p(p + 2 − d)/6(fL)² in d dimensions; p is that of a parabola through the rings, in logarithms.
    """
    if frequency.size < 2 or density.min() <= 0:
        return np.zeros_like(frequency)
    x = np.log(frequency / frequency[0])
    curve = np.polynomial.Polynomial.fit(x, np.log(density), min(2, frequency.size - 2) or 1)
    power = np.clip(-curve.deriv()(x), 0, _STEEPEST)
    return np.asarray(power * (power + 2 - len(level.axes)) / (6 * (frequency * level.length) ** 2))


def _ring_starts(starts: NDArray[np.intp], weight: Array, least: float) -> NDArray[np.intp]:
    """First modes of rings that hold enough modes each; a ring with fewer joins the next one, the last one the ring before it."""
    cumulative = np.concatenate([[0.0], np.cumsum(weight)])
    kept = [0] if cumulative[-1] > 0 else []
    for start in np.unique(starts)[1:]:
        if cumulative[start] - cumulative[kept[-1]] >= least and cumulative[-1] - cumulative[start] >= least:
            kept.append(int(start))
    return np.asarray(kept, dtype=np.intp)


def _corners(shape: Sequence[int], patch: Sequence[int], most: int) -> list[tuple[int, ...]]:
    """First heights of patches that overlap by half, or are evenly spread where these would be more than ``most``."""
    counts = [
        max(1, int(np.ceil(2 * (n - side) / side)) + 1) if n > side else 1 for n, side in zip(shape, patch, strict=True)
    ]
    excess = (np.prod(counts) / most) ** (1 / len(counts))
    if excess > 1:
        counts = [max(1, int(count / excess)) for count in counts]
        # A long, narrow map has few rows of patches: its length takes the rest.
        longest = int(np.argmax(counts))
        counts[longest] = max(1, int(most / np.prod([c for axis, c in enumerate(counts) if axis != longest])))
    starts = [
        np.linspace(0, n - side, count + 2)[1:-1].astype(int)
        if count == 1 and n > side
        else np.linspace(0, n - side, count).astype(int)
        for n, side, count in zip(shape, patch, counts, strict=True)
    ]
    return list(itertools.product(*(map(int, axis) for axis in starts)))


def _periodogram(scan: Scan, patch: tuple[int, ...], corners: Sequence[tuple[int, ...]], factor: int) -> Periodogram:
    """Periodograms of the patches without gaps of heights that are means of ``factor`` heights along each axis."""
    from scipy.fft import fftfreq, rfftfreq, rfftn

    window, attenuation = np.ones(()), np.ones(())
    frequencies: list[Array] = []
    for axis, (side, pitch) in enumerate(zip(patch, scan.pitch, strict=True)):
        hann = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
        frequency = rfftfreq(side, pitch) if axis == len(patch) - 1 else fftfreq(side, pitch)
        window, frequencies = np.multiply.outer(window, hann), [*frequencies, frequency]
        attenuation = np.multiply.outer(attenuation, _box_transfer(frequency, pitch, factor) ** 2)
    scale = scan.cell / np.square(window).sum() / attenuation
    complete = [part for part in _patches(scan.height, patch, corners) if np.isfinite(part.sum())]
    spectra = np.empty((len(complete), *attenuation.shape))
    axes = tuple(range(1, len(patch) + 1))
    for start in range(0, len(complete), _BATCH):
        batch = _levelled(np.stack(complete[start : start + _BATCH]).astype(float)) * window
        transform = rfftn(batch, axes=axes)
        spectra[start : start + _BATCH] = (transform.real**2 + transform.imag**2) * scale
    length = min(side * pitch for side, pitch in zip(patch, scan.pitch, strict=True))
    return Periodogram(tuple(frequencies), spectra, length, CYCLES / length)


def _window_weight(shape: Sequence[int], patch: Sequence[int], corners: Sequence[tuple[int, ...]]) -> Array:
    """Sum of the squared windows of all patches, at each height."""
    weight, window = np.zeros(shape), np.ones(())
    for side in patch:
        window = np.multiply.outer(window, np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 4)
    for corner in corners:
        weight[tuple(slice(start, start + side) for start, side in zip(corner, patch, strict=True))] += window
    return weight


def _weighted_variance(height: Array, weight: Array) -> float:
    """Of the heights that are present, about their mean over the area."""
    present = np.isfinite(height)
    return float(np.average((height[present] - height[present].mean()) ** 2, weights=weight[present]))


def _patches(height: Array, patch: Sequence[int], corners: Sequence[tuple[int, ...]]) -> list[Array]:
    return [
        height[tuple(slice(start, start + side) for start, side in zip(corner, patch, strict=True))]
        for corner in corners
    ]


def _box_transfer(frequency: Array, pitch: float, factor: int) -> Array:
    """Amplitude that a mean of ``factor`` neighbours leaves of a wave; ``pitch`` is that of the means."""
    phase = np.pi * frequency * pitch
    fine = factor * np.sin(phase / factor)
    return np.divide(np.sin(phase), fine, out=np.ones_like(phase), where=np.abs(fine) > 1e-12)


def _levelled(patches: Array) -> Array:
    """Patches (patches, …) less their least-squares planes."""
    axes = tuple(range(1, patches.ndim))
    result = patches - patches.mean(axis=axes, keepdims=True)
    for axis in axes:
        n = patches.shape[axis]
        position = (np.arange(n) - (n - 1) / 2).reshape([-1 if a == axis else 1 for a in range(patches.ndim)])
        slope = (result * position).mean(axis=axes, keepdims=True) / np.square(position).mean()
        result -= slope * position
    return result


def coarser(scan: Scan) -> Scan:
    """Means of neighbouring heights, two along each axis; missing where fewer than half are present."""
    height = scan.height[tuple(slice(0, n - n % 2) for n in scan.height.shape)]
    mean = height.astype(float, copy=False)
    for axis in range(height.ndim):
        even, odd = (
            tuple(slice(start if a == axis else None, None, 2 if a == axis else None) for a in range(height.ndim))
            for start in (0, 1)
        )
        mean = mean[even] + mean[odd]
    mean /= 2**height.ndim
    if not np.isfinite(mean.sum()):
        parts = [
            height[tuple(slice(start, None, 2) for start in offset)]
            for offset in itertools.product((0, 1), repeat=height.ndim)
        ]
        present = sum(np.isfinite(part).astype(float) for part in parts)
        total = sum(np.where(np.isfinite(part), part, 0.0) for part in parts)
        mean = np.where(present >= len(parts) / 2, total / np.maximum(present, 1), np.nan)
    return Scan(mean, tuple(2 * pitch for pitch in scan.pitch))


def filled(scan: Scan) -> tuple[Scan, float]:
    """The scan without gaps, and the variance of the heights that are present over that of all then.

    A gap is filled from its rim inwards with means of the nearest neighbours, and further inside with those of larger and larger
    squares: a large gap varies less than its surroundings.
    """
    from scipy.ndimage import uniform_filter

    missing = ~np.isfinite(scan.height)
    if not missing.any():
        return scan, 1.0
    height = scan.height.astype(float)
    for _ in range(_RIMS):
        present = uniform_filter((~missing).astype(float), 3, mode="constant")
        total = uniform_filter(np.where(missing, 0.0, height), 3, mode="constant")
        rim = missing & (present > 1e-6)
        height[rim] = total[rim] / present[rim]
        missing &= ~rim
    whole = scan._replace(height=np.where(missing, _from_means(height), height) if missing.any() else height)
    variance = whole.variance
    return whole, scan.variance / variance if variance else 1.0


def _from_means(height: Array) -> Array:
    """Heights at all places from means of those present among two along each axis; where there are none, from those of the means."""
    from scipy.ndimage import map_coordinates

    padded = np.pad(height, [(0, n % 2) for n in height.shape], constant_values=np.nan)
    shape = [part for n in padded.shape for part in (n // 2, 2)]
    pairs = padded.reshape(shape)
    axes, present = tuple(range(1, len(shape), 2)), np.isfinite(pairs)
    count = present.sum(axis=axes)
    means = np.where(count, np.where(present, pairs, 0.0).sum(axis=axes) / np.maximum(count, 1), np.nan)
    if not count.all():
        means = np.where(count, means, _from_means(means))
    places = np.meshgrid(*((np.arange(n) - 0.5) / 2 for n in height.shape), indexing="ij")
    return np.asarray(map_coordinates(means, places, order=1, mode="nearest"))

"""Periodic height maps of any size that look like a small sample, from a seed.

``spectrum`` has the power spectrum and the distribution of heights of the sample, and random phases: for a grain without shapes that repeat.
``structure`` places pieces of the sample beside one another, each chosen to fit those that are there, and blends their edges: cells and
ridges stay whole. A smooth gain then gives each ring of frequencies the power that it has in the sample.

References
----------
Schreiber & Schmitz 1996 (PRL 77) for the iteration of spectrum and distribution; Galerne et al. 2011 (IEEE TIP 20) for random phases; Efros &
Freeman 2001 (SIGGRAPH) for the choice of pieces; Heitz & Neyret 2018 (PACM CGIT 1) for blending normally distributed values so that
their variance stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

METHODS = ("spectrum", "structure")
"""How a map is made from a sample; the first is the default."""

LEAST_SIZE, LARGEST_SIZE = 32, 8192
"""Pixels along either side of a map."""

_ITERATIONS = 20
_PIECES = 4
"""Pieces of a map along the shorter side of the sample."""
OVERLAP, NARROW_OVERLAP = 0.4, 0.1
"""Widths over which pieces are blended, over their distance: of heights, whose slopes must not jump; and of pictures, where a wide blend makes two faint sparkles of one."""
_CANDIDATES = 300
_RING_ITERATIONS = 8
_POSITIVE_ITERATIONS = 30
_LEAST_MODES = 200
"""Frequencies whose power is averaged where two spectra are compared."""
_HIGHEST_COMPARED = 0.25
"""Cycles per pixel: half the Nyquist frequency."""
_LEAST_POWER = 1e-4
"""Of the largest power: less is not compared, since the windows bring as much of it from other frequencies."""


class Likeness(NamedTuple):
    """What remains between a sample and a map."""

    spectrum: float
    """Largest relative difference of the power spectra, averaged over rings of frequencies, up to half the Nyquist frequency, where the power is 1e-4 of the largest or more."""
    heights: float
    """Largest difference of the cumulated distributions of heights (Kolmogorov's), 0 to 1."""
    slopes: float
    """The same of the slopes over one pixel, along x or y."""


def synthesise(sample: Array, size: int, *, method: str = METHODS[0], seed: int = 0, overlap: float = OVERLAP) -> Array:
    """A periodic map (size, size) that looks like a sample.

    Parameters
    ----------
    sample : (rows, columns) heights, none missing, at least 32 pixels along either side
    size : pixels along either side, 32 to 8192
    method : one of :data:`METHODS`
    seed : the same seed gives the same map
    overlap : of the pieces of ``structure``, :data:`OVERLAP` or :data:`NARROW_OVERLAP`

    Raises
    ------
    BrdfpipeError : the method is unknown, a size is out of range, or the sample is flat.
    """
    if method not in METHODS:
        raise BrdfpipeError(f"unknown method {method!r} of synthesis; accepted: {' or '.join(METHODS)}")
    if not LEAST_SIZE <= size <= LARGEST_SIZE:
        raise BrdfpipeError(f"a map of {size} pixels is out of range; accepted: {LEAST_SIZE} to {LARGEST_SIZE}")
    if min(sample.shape) < LEAST_SIZE:
        raise BrdfpipeError(
            f"a sample of {sample.shape[1]} x {sample.shape[0]} pixels is too small; accepted: at least {LEAST_SIZE} along either side"
        )
    if not np.ptp(sample) > 0:
        raise BrdfpipeError("a flat sample has no grain; accepted: heights that vary")
    rng = np.random.default_rng(seed)
    return _random_phases(sample, size, rng) if method == "spectrum" else _pieces(sample, size, rng, overlap)


def likeness(sample: Array, tile: Array) -> Likeness:
    """What remains between a sample (rows, columns) and a periodic map of the same pixel."""
    _, *rings = ring_spectra(sample, tile, _HIGHEST_COMPARED)
    compared = rings[0] >= _LEAST_POWER * rings[0].max()
    slopes = [
        _kolmogorov(np.diff(sample, axis=axis).ravel(), (np.roll(tile, -1, axis) - tile).ravel()) for axis in (0, 1)
    ]
    heights = _kolmogorov(sample.ravel() - sample.mean(), tile.ravel() - tile.mean())
    return Likeness(float(np.abs(rings[1][compared] / rings[0][compared] - 1).max()), heights, max(slopes))


def ring_spectra(
    sample: Array, tile: Array, highest: float = 0.5, shortest: int | None = None
) -> tuple[Array, Array, Array]:
    """Mean frequency [cycles per pixel] of rings of frequencies up to the highest, and the power of a sample and of a periodic map of the same pixel there.

    ``shortest`` is the shorter side in pixels of the smallest of several samples that are to have the same rings.
    """
    frequency = _frequency(tile.shape)
    least = _least_frequency(sample, tile)
    rings = _rings(frequency, least if shortest is None else max(least, 1.5 / shortest), highest)
    # A periodic map has no edges and needs no window.
    of_sample, of_tile = (_means(power, rings) for power in (windowed_power(sample, tile.shape), _power_of(tile)))
    return _means(frequency, rings), of_sample, of_tile


def _least_frequency(sample: Array, tile: Array) -> float:
    """Of waves that fit into both, in cycles per pixel."""
    return 1.5 / min(*sample.shape, *tile.shape)


def _rings(frequency: Array, least: float, highest: float) -> list[NDArray[np.int64]]:
    """Places of frequencies in rings of about as many each."""
    order = np.argsort(frequency, axis=None, kind="stable")
    order = order[(frequency.flat[order] > least) & (frequency.flat[order] <= highest)]
    return np.array_split(order, max(1, order.size // _LEAST_MODES))


def _means(field: Array, rings: list[NDArray[np.int64]]) -> Array:
    return np.array([field.flat[ring].mean() for ring in rings])


def _power_of(tile: Array) -> Array:
    """Power of a periodic map on the frequencies of ``numpy.fft.fft2``."""
    return np.asarray(np.abs(np.fft.fft2(tile - tile.mean())) ** 2 / tile.size)


def windowed_power(height: Array, shape: tuple[int, ...]) -> Array:
    """Mean power of the windowed parts of a map, on the frequencies of ``numpy.fft.fft2`` of a shape, per area of the window.

    The parts overlap by half (Welch 1967); a map that is smaller than the shape is one part, with zeros around it.
    """
    sides = [min(n, m) for n, m in zip(height.shape, shape, strict=True)]
    window = np.outer(*(np.hanning(n + 2)[1:-1] for n in sides))
    starts = [
        np.unique(np.linspace(0, n - side, max(1, int(np.ceil(2 * n / side)) - 1)).astype(int))
        for n, side in zip(height.shape, sides, strict=True)
    ]
    power = np.zeros(shape)
    for row in starts[0]:
        for column in starts[1]:
            part = height[row : row + sides[0], column : column + sides[1]]
            part = part - np.average(part, weights=window)
            power += np.abs(np.fft.fft2(part * window, s=shape)) ** 2
    return np.asarray(power / (starts[0].size * starts[1].size * np.sum(window**2)))


def _random_phases(sample: Array, size: int, rng: np.random.Generator) -> Array:
    """Heights of the spectrum of the sample, and nearly of its distribution; the spectrum has the last word."""
    amplitude = np.sqrt(windowed_power(sample, (size, size)) * size**2)
    amplitude[0, 0] = 0.0
    values = _quantiles(sample, size**2)
    height = rng.permutation(values).reshape(size, size)
    for _ in range(_ITERATIONS):
        height = _of_amplitude(height, amplitude)
        height = _ranked(height, values)
    return _of_amplitude(height, amplitude)


def _quantiles(sample: Array, count: int) -> Array:
    """Evenly spaced quantiles of the heights about their mean, in ascending order."""
    values = np.sort(sample, axis=None) - sample.mean()
    shares = [(np.arange(n) + 0.5) / n for n in (count, values.size)]
    return np.asarray(np.interp(shares[0], shares[1], values))


def _of_amplitude(height: Array, amplitude: Array) -> Array:
    """Heights of given amplitudes and the phases of other heights."""
    spectrum = np.fft.rfft2(height)
    magnitude = np.abs(spectrum)
    scale = amplitude[:, : spectrum.shape[1]] / np.where(magnitude > 0, magnitude, 1.0)
    return np.asarray(np.fft.irfft2(spectrum * scale, s=height.shape))


def _pieces(sample: Array, size: int, rng: np.random.Generator, overlap: float) -> Array:
    """Pieces of the sample on a periodic lattice, blended as normally distributed values."""
    from scipy.special import ndtri

    ranks = np.argsort(np.argsort(sample, axis=None, kind="stable"), kind="stable")
    normal = ndtri((ranks.reshape(sample.shape) + 0.5) / sample.size)
    distance = min(sample.shape) / _PIECES
    count = max(2, round(size / distance))
    blend = max(2, int(overlap * size / count))
    windows = [_window(size, count, k, blend) for k in range(count)]
    side = max(window.size for _, window in windows)
    if side >= min(sample.shape):
        raise BrdfpipeError(
            f"a map of {size} pixels is made of pieces of {side} pixels, and the sample has {min(sample.shape)}; accepted: a smaller map or a larger sample"
        )
    weighted, weights, squares = (np.zeros((size, size)) for _ in range(3))
    agreement, compared = 0.0, 0.0
    for rows, row_window in windows:
        for columns, column_window in windows:
            at = np.ix_(rows, columns)
            weight = np.outer(row_window, column_window)
            piece, error, area = _fitting(normal, weighted[at], weights[at], weight, rng)
            agreement, compared = agreement + error, compared + area
            weighted[at] += weight * piece
            weights[at] += weight
            squares[at] += weight**2
    # Two values of correlation ρ: half of the mean square of their difference is 1 − ρ.
    correlation = min(1.0, max(0.0, 1 - agreement / max(compared, 1e-300) / 2))
    blended = weighted / np.sqrt((1 - correlation) * squares + correlation * weights**2)
    return _of_ring_power(_ranked(blended, _quantiles(sample, size**2)), sample)


def _ranked(height: Array, values: Array) -> Array:
    """Ascending values in the order of given heights."""
    ranked = np.empty(height.size)
    ranked[np.argsort(height, axis=None, kind="stable")] = values
    return ranked.reshape(height.shape)


def _of_ring_power(height: Array, sample: Array) -> Array:
    """Heights whose rings of frequencies have the power of those of the sample, with the phases and nearly the distribution of given ones.

    Few pieces of a small sample have other long waves than the whole of it. The gain depends on the frequency alone and is smooth, so that shapes stay.
    """
    values, frequency = np.sort(height, axis=None), _frequency(height.shape)
    power = windowed_power(sample, height.shape)
    every = _rings(frequency, 0.0, 1.0)
    at = _means(frequency, every)
    for _ in range(_RING_ITERATIONS):
        ratio = _means(power, every) / np.maximum(_means(_power_of(height), every), 1e-300)
        gain = np.sqrt(np.interp(frequency, at, np.clip(ratio, 0.1, 10.0)))
        height = _ranked(np.fft.ifft2(np.fft.fft2(height) * gain).real, values)
    # The rings that are compared have the last word.
    return _with_rings(height, sample, power)


def positive(tile: Array, sample: Array) -> Array:
    """A periodic map of mean 1 without negative values, whose rings of frequencies have nearly the power of those of a sample of mean 1."""
    power = windowed_power(sample, tile.shape)
    for _ in range(_POSITIVE_ITERATIONS):
        tile = np.maximum(tile, 0.0)
        tile = 1 + _with_rings(tile / tile.mean() - 1, sample, power)
    tile = np.maximum(tile, 0.0)
    return np.asarray(tile / tile.mean())


def _with_rings(height: Array, sample: Array, power: Array) -> Array:
    """Values with the power of a sample in the rings that are compared."""
    spectrum, own = np.fft.fft2(height), _power_of(height)
    for ring in _rings(_frequency(height.shape), _least_frequency(sample, height), _HIGHEST_COMPARED):
        spectrum.flat[ring] *= np.sqrt(power.flat[ring].mean() / max(own.flat[ring].mean(), 1e-300))
    return np.asarray(np.fft.ifft2(spectrum).real)


def _window(size: int, count: int, k: int, blend: int) -> tuple[NDArray[np.int64], Array]:
    """Indices of a piece along one axis, and its weights; those of all pieces add up to 1."""
    first, last = round(k * size / count), round((k + 1) * size / count)
    at = np.arange(first - blend // 2, last + blend - blend // 2)
    rise = np.sin(np.clip((np.arange(at.size) + 0.5) / blend, 0, 1) * np.pi / 2) ** 2
    fall = np.cos(np.clip((np.arange(at.size) + 0.5 - (last - first)) / blend, 0, 1) * np.pi / 2) ** 2
    return (at % size).astype(np.int64), rise * fall


def _fitting(
    normal: Array, weighted: Array, weights: Array, weight: Array, rng: np.random.Generator
) -> tuple[Array, float, float]:
    """A piece of a sample that fits the values around it, and its weighted mean square difference from them, times the weight."""
    rows, columns = weight.shape
    at = rng.integers(0, (normal.shape[0] - rows + 1, normal.shape[1] - columns + 1), size=(_CANDIDATES, 2))
    there = weights > 1e-3
    if not there.any():
        row, column = at[0]
        return normal[row : row + rows, column : column + columns], 0.0, 0.0
    importance = np.minimum(weights, weight)[there]
    around = weighted[there] / weights[there]
    inside = np.nonzero(there)
    errors = [float(importance @ (normal[inside[0] + row, inside[1] + column] - around) ** 2) for row, column in at]
    row, column = at[int(np.argmin(errors))]
    return normal[row : row + rows, column : column + columns], min(errors), float(importance.sum())


def _frequency(shape: tuple[int, ...]) -> Array:
    """Frequencies of ``numpy.fft.fft2`` in cycles per pixel."""
    return np.asarray(np.hypot(np.fft.fftfreq(shape[1]), np.fft.fftfreq(shape[0])[:, None]))


def _kolmogorov(a: Array, b: Array) -> float:
    a, b = np.sort(a), np.sort(b)
    at = np.concatenate([a, b])
    return float(np.abs(np.searchsorted(a, at, "right") / a.size - np.searchsorted(b, at, "right") / b.size).max())

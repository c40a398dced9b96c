"""Random Gaussian heights of a given spectrum, cut from a larger map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray


def heights(spectrum: Callable[[Array], Array], shape: tuple[int, ...], pitch: tuple[float, ...], seed: int) -> Array:
    """Heights [um] whose two-sided spectrum [um4, of a line um3] is a function of frequency [um-1]; not periodic.

    They are cut from a map twice as wide: a period would show no edges.
    """
    large = tuple(2 * n for n in shape)
    axes = [np.fft.fftfreq(n, step) for n, step in zip(large[:-1], pitch[:-1], strict=True)]
    axes.append(np.fft.rfftfreq(large[-1], pitch[-1]))
    frequency = np.sqrt(sum(axis**2 for axis in np.meshgrid(*axes, indexing="ij", sparse=True)))
    amplitude = np.sqrt(spectrum(np.maximum(frequency, 1e-12)) / np.prod(pitch))
    amplitude.flat[0] = 0
    white = np.fft.rfftn(np.random.default_rng(seed).standard_normal(large))
    full = np.fft.irfftn(white * amplitude, s=large, axes=range(len(large)))
    return full[tuple(slice(n) for n in shape)]


def gaussian(sigma: float, length: float) -> Callable[[Array], Array]:
    """Plane spectrum of the autocovariance σ² exp(−r²/ℓ²)."""
    return lambda frequency: np.pi * (length * sigma) ** 2 * np.exp(-((np.pi * length * frequency) ** 2))


def gaussian_line(sigma: float, length: float) -> Callable[[Array], Array]:
    """Line spectrum of the same surface."""
    return lambda frequency: np.sqrt(np.pi) * length * sigma**2 * np.exp(-((np.pi * length * frequency) ** 2))

"""Rings about frequency 0, which share the light of the modes of a field."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from brdfpipe.geometry import Array

SLOWEST = 0.02
"""Share of the variance of heights in waves that the first ring need not tell apart."""
_STEP = 0.05  # between the rings in asinh(f/f0)


class FrequencyRings(NamedTuple):
    """Rings about frequency 0, up to the highest frequency that is sampled in all directions.

    Between two rings the spectrum is linear. The light of a mode is shared by both so that the rings have all of it.
    """

    frequency: Array
    scale: float
    area: Array
    """∫ d²f of the part of the spectrum that a ring of height 1 makes [um-2]"""
    inner: NDArray[np.intp]
    """Last ring within the frequency of every mode; modes beyond the last ring have the number after it"""
    outer_share: NDArray[np.float32]
    """Share of the light of every mode that the next ring has"""

    @classmethod
    def of(cls, height: Array, pitch: Array) -> FrequencyRings:
        """Rings as close as the modes of a map of some pitch (x, y) [um], or as the spectrum of its heights needs; without modes."""
        spacing = 0.5 / (np.array(height.shape[::-1]) * pitch)
        frequency = _frequency_of_modes(height.shape, spacing).ravel()
        mode = float(spacing.max())
        heights = np.square(fft.dctn(height - height.mean())).ravel()
        within = np.cumsum(np.bincount((frequency / mode).astype(np.intp), heights))
        some, quarter = np.searchsorted(within, np.array([SLOWEST, 0.25]) * within[-1])
        nyquist = 0.5 / float(pitch.max())
        # In powers of 2, so that maps of one surface have the same rings.
        modes = 2.0 ** np.floor(np.log2(max(1.0, min(float(some), float(quarter) / 4))))
        scale = mode * modes / _STEP
        count = int(np.arcsinh(nyquist / scale) / _STEP) + 1
        node = np.arange(count)
        frequency = scale * np.sinh(_STEP * node)
        # ∫ f² over the number of the ring.
        integral = scale**2 / 2 * (np.sinh(2 * _STEP * node) / (2 * _STEP) - node)
        between = np.diff(integral)
        area = np.zeros(count)
        area[1:] += frequency[1:] ** 2 - between
        area[:-1] += between - frequency[:-1] ** 2
        return cls(frequency, scale, np.pi * area, np.zeros(0, np.intp), np.zeros(0, np.float32))

    def with_modes(self, shape: tuple[int, ...], spacing: Array) -> FrequencyRings:
        """The same rings for modes (rows, columns) at the multiples of a frequency along each axis (x, y) [um-1]."""
        position = np.arcsinh(_frequency_of_modes(shape, spacing).ravel() / self.scale) / _STEP
        last = self.frequency.size - 1
        inner = np.where(position < last, position, last + 1).astype(np.intp)
        share = np.where(inner < last, position - inner, 0.0)
        return self._replace(inner=inner, outer_share=share.astype(np.float32))

    def at_modes(self, spectrum: Array) -> Array:
        """Value at every mode of a spectrum (rings), 0 beyond them."""
        known = np.append(spectrum, (0.0, 0.0))
        return known[self.inner] * (1 - self.outer_share) + known[self.inner + 1] * self.outer_share

    def light(self, power: NDArray[np.float32]) -> Array:
        """Light of every ring, of the power of every mode; last, that beyond the rings."""
        outwards = power.ravel() * self.outer_share
        size = self.frequency.size
        light = np.bincount(self.inner, power.ravel() - outwards, minlength=size + 1)
        light[1:] += np.bincount(self.inner, outwards, minlength=size + 1)[:-1]
        return np.asarray(light)


def _frequency_of_modes(shape: tuple[int, ...], spacing: Array) -> Array:
    """Frequency of modes at multiples of a frequency along each axis [um-1]."""
    along, across = (np.arange(n) * step for n, step in zip(shape[::-1], spacing, strict=True))
    return np.hypot(along, across[:, None])

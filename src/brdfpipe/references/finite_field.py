"""Spectrum of a field that is known on a finite area: continued by its mirror image, or faded out towards its edges.

Continued by its mirror image (a cosine transform), the field has no step at the edges and needs no window, which would blur the light of waves
about as long as the area. The mirror image of a surface that leans to one side leans to the other; the mean over azimuth is the same. The slope of
the continued field has a step at the edges, which scatters light far beside a narrow lobe; a field that fades out has none.

References
----------
Ahmed, Natarajan & Rao 1974, IEEE Trans. Comput. C-23, 90 (cosine transform); Harris 1978, Proc. IEEE 66, 51 (Tukey's window).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.signal.windows import tukey

from brdfpipe.geometry import Array
from brdfpipe.references.frequency_rings import FrequencyRings

_FADED = 0.2  # of the map, at each edge


def mirrored_power(field: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Power of the modes of a field that is continued by its mirror image, at the frequencies k/2L along each axis."""
    power = np.square(fft.dctn(field.real, norm="ortho"))
    power += np.square(fft.dctn(field.imag, norm="ortho"))
    return np.asarray(power)


def remove_doubling(power: NDArray[np.float32]) -> None:
    """Take from the power of mirrored modes, in place, what the mirror image doubles: light that is diffracted by chance straight along an axis.

    It is as much again as half of the row beside it. Light of a grating along the axis has nothing there, and is kept.
    """
    mean = power[0, 0]
    power[0] -= power[1] / 2
    power[:, 0] -= power[:, 1] / 2
    power[0, 0] = mean / 4


class MirroredField(NamedTuple):
    """Light of a field that is continued by its mirror image.

    What the mirror image doubles along the axes it takes from the modes nearby, about 0.7 s/L of the peak of a field that is coherent over a
    length s. Near the mirror direction the light is given back to the modes that lack it, and what the edges scatter is taken off. Both follow
    from what the mirror image makes of waves of random phase.
    """

    rings: FrequencyRings
    near: FrequencyRings
    """Of the modes near the mirror direction"""
    share: Array
    """Share of every ring that counts as near"""
    expected: tuple[Array, Array]
    """Expected power of these modes across and along of unit power at each mode, without the doubling, (mode, mode)"""
    modes: Array
    """Modes of each ring"""

    @classmethod
    def of(cls, shape: tuple[int, ...], pitch: Array, rings: FrequencyRings, share: Array) -> MirroredField:
        """Of a field (rows, columns) of some pitch (x, y) [um]; ``share`` of every ring counts as near."""
        spacing = 0.5 / (np.array(shape[::-1]) * pitch)
        reach = rings.frequency[min(np.flatnonzero(share)[-1] + 1, share.size - 1)]
        columns, rows = (int(one) for one in np.minimum(np.ceil(reach / spacing) + 1, shape[::-1]))
        near, expected = (
            rings.with_modes((rows, columns), spacing),
            (_expected(shape[0], rows), _expected(shape[1], columns)),
        )
        return cls(rings.with_modes(shape, spacing), near, share, expected, rings.area / (4 * np.prod(spacing)))

    def light(self, field: NDArray[np.complex64]) -> Array:
        """Light of every ring, and beyond them."""
        across, along = self.expected
        rows, columns = len(across), len(along)
        power = mirrored_power(field)
        doubled = power[:rows, :columns].copy()
        remove_doubling(power)
        doubled -= power[:rows, :columns]
        light = self.rings.light(power)
        modes = self.near.at_modes(self.share * np.maximum(light[:-1], 0) / self.modes).reshape(rows, columns)
        expected = across @ modes @ along.T
        modes[0] /= 2
        modes[:, 0] /= 2
        lacking = self.near.light((modes - expected).astype(np.float32))[:-1]
        if lacking.sum() > 0:
            # Of gratings along an axis nothing is doubled.
            taken = doubled.ravel() @ self.near.at_modes(self.share)
            light[:-1] += lacking * np.clip(taken / lacking.sum(), 0, 2)
        # Negative by chance, in rings of few modes.
        return np.asarray(np.maximum(light, 0))


def _expected(size: int, number: int) -> Array:
    """Expected power of the first modes along an axis of so many points of unit power at each, (mode, mode), less half of the second in the first."""
    phase = np.pi * (np.arange(size)[:, None] + 0.5) * np.arange(number) / size
    even, odd = (fft.dct(wave, norm="ortho", axis=0)[:number] for wave in (np.cos(phase), np.sin(phase)))
    expected = (even**2 + odd**2) / size
    expected[:, 0] /= 2
    expected[0] -= expected[1] / 2
    return np.asarray(expected)


class FadedField(NamedTuple):
    """Light far from the mirror direction, of a field that fades out towards its edges."""

    window: NDArray[np.float32]
    rings: FrequencyRings

    @classmethod
    def of(
        cls, shape: tuple[int, ...], pitch: Array, rings: FrequencyRings, measured: NDArray[np.float32] | None
    ) -> FadedField:
        """Of a field (rows, columns) of some pitch (x, y) [um], measured where 1 (None: everywhere)."""
        across, along = (tukey(size, 2 * _FADED) for size in shape)
        window = (across[:, None] * along).astype(np.float32)
        power = np.sum(np.square(window if measured is None else window * measured), dtype=float)
        window *= np.float32(1 / np.sqrt(power * window.size))
        modes = shape[0] // 2 + 1, shape[1] // 2 + 1
        return cls(window, rings.with_modes(modes, 1 / (np.array(shape[::-1]) * pitch)))

    def light(self, field: NDArray[np.complex64]) -> Array:
        """Light of every ring, and beyond them, as shares of what the measured part of the field reflects."""
        transform = fft.fft2(field * self.window)
        return self.rings.light(_folded(_folded(np.square(transform.real) + np.square(transform.imag)).T).T)


def _folded(power: NDArray[np.float32]) -> NDArray[np.float32]:
    """Power of the rows of a Fourier transform by the size of their frequency."""
    half = len(power) // 2 + 1
    folded = power[:half].copy()
    folded[1 : len(power) - half + 1] += power[: half - 1 : -1]
    return folded

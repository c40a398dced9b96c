"""The point spread of the camera: a narrow core and a wide, faint halo."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from brdfpipe.geometry import Array

_CORE_REACH = 6.0
"""Standard deviations of the core beyond which it is nothing."""


class PointSpread:
    """Spreads the light of a picture.

    Parameters
    ----------
    shape : (height, width) of the pictures
    core : standard deviation of the core [pixel]; 0 leaves points points
    halo : share of the light that goes into the halo
    radius : scale of the halo [pixel], well above one

    Notes
    -----
    No light is lost but what leaves the picture. The core falls within a few pixels and is summed there; only the halo goes by way
    of Fourier, in single precision: rounding of a transform is a share of the brightest pixel, and must not reach the darkest.
    """

    def __init__(self, shape: tuple[int, int], core: float, halo: float, radius: float) -> None:
        self._shape, self._core, self._halo, self._radius = shape, core, halo, radius
        self._padded = tuple(fft.next_fast_len(2 * size - 1, real=True) for size in shape)

    def __call__(self, picture: Array) -> Array:
        """The picture (height, width) as the sensor has it."""
        sharp = picture
        if self._core:
            sharp = ndimage.gaussian_filter(picture, self._core, mode="constant", truncate=_CORE_REACH)
        if not self._halo:
            return sharp
        spectrum = fft.rfft2(picture.astype(np.float32), s=self._padded)
        glare = fft.irfft2(spectrum * self._transfer, s=self._padded)[: self._shape[0], : self._shape[1]]
        return np.asarray((1 - self._halo) * sharp + self._halo * np.maximum(glare, 0.0))

    @cached_property
    def _transfer(self) -> NDArray[np.complex64]:
        row, column = (np.fft.fftfreq(size, 1 / size) for size in self._padded)
        return np.asarray(fft.rfft2(halo(np.hypot(row[:, None], column), self._radius).astype(np.float32)))


def halo(distance: Array, radius: float) -> Array:
    """Light of the halo in a pixel at a distance [pixel], of 1 in all: (1 + r²/R²)^(−3/2) / 2πR².

    What falls beyond a distance r is (1 + r²/R²)^(−1/2).
    """
    return np.asarray((1 + (distance / radius) ** 2) ** -1.5 / (2 * np.pi * radius**2))

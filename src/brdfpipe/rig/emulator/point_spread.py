"""Point spread function of the camera: a narrow core and a wide, faint halo."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from brdfpipe.geometry import Array

_CORE_CUTOFF = 6.0
"""The core is truncated at so many standard deviations."""


class PointSpread:
    """Convolution of an image with the point spread function.

    Light is lost only beyond the edges of the image. The core is summed directly over a few pixels. Only the halo is computed by a Fourier
    transform, in single precision: its rounding errors scale with the brightest pixel and must stay below the darkest.

    Parameters
    ----------
    shape : (height, width) of the images
    core : standard deviation of the core [pixel]; 0 for no spread
    halo : share of the light in the halo
    radius : scale of the halo [pixel], well above one
    """

    def __init__(self, shape: tuple[int, int], core: float, halo: float, radius: float) -> None:
        self._shape, self._core, self._halo, self._radius = shape, core, halo, radius
        self._padded = tuple(fft.next_fast_len(2 * size - 1, real=True) for size in shape)

    def __call__(self, image: Array) -> Array:
        """Image (height, width) on the sensor."""
        sharp = image
        if self._core:
            sharp = ndimage.gaussian_filter(image, self._core, mode="constant", truncate=_CORE_CUTOFF)
        if not self._halo:
            return sharp
        spectrum = fft.rfft2(image.astype(np.float32), s=self._padded)
        glare = fft.irfft2(spectrum * self._transfer, s=self._padded)[: self._shape[0], : self._shape[1]]
        return np.asarray((1 - self._halo) * sharp + self._halo * np.maximum(glare, 0.0))

    @cached_property
    def _transfer(self) -> NDArray[np.complex64]:
        row, column = (np.fft.fftfreq(size, 1 / size) for size in self._padded)
        return np.asarray(fft.rfft2(halo(np.hypot(row[:, None], column), self._radius).astype(np.float32)))


def halo(distance: Array, radius: float) -> Array:
    """Halo of unit total light at a distance [pixel]: (1 + r²/R²)^(−3/2) / 2πR². The share beyond r is (1 + r²/R²)^(−1/2)."""
    return np.asarray((1 + (distance / radius) ** 2) ** -1.5 / (2 * np.pi * radius**2))

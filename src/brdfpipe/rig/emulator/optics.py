"""Electrons on each pixel, from the object in the holder and the reference fibre.

The signal of a pixel is proportional to BRDF × cosine of view in the direction it sees (:data:`SAMPLE_RATE`), that of the reference spot to the light
of the lamp (:data:`REFERENCE_RATE`); both rates are for a lamp of 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.emulator.camera_view import camera_view
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.illumination import SPLIT, Illumination
from brdfpipe.rig.emulator.sample_holder import Etalon, SampleHolder, Setup, Truth

SAMPLE_RATE = 5000.0
"""Electrons per second and pixel for BRDF × cosine of view = 1 sr⁻¹, at the middle wavelength and without a filter.

Nine pixels together reach a signal-to-noise ratio of 50 at 500 electrons each, 1/50 of the linear range: 0.01 sr⁻¹ takes 10 s, and 2500 sr⁻¹ is just
within the range behind a filter of 1 % in 0.2 s. Five frames a factor of 8.4 apart overlap over the whole range.
"""

REFERENCE_RATE = 25_000.0
"""Electrons per second and pixel of the reference spot for a splitter ratio of 1; with 8 % it is linear up to 12 s."""

_STEP = 10_000
"""Wavelengths at this spacing [pm] are evaluated together with the requested one: a scan requests them next."""

_CACHED_SIGNALS, _CACHED_IMAGES = 400, 64

_CORE_CUTOFF = 6.0
"""The core is truncated at so many standard deviations."""


class Optics:
    """Light on the sensor for every state of the rig; parameters as of :class:`~brdfpipe.rig.emulator.sample_holder.SampleHolder`.

    Filters and mirrors are evaluated at the middle of the band.
    """

    def __init__(
        self, rig: Rig, truth: Truth | None, effects: Effects, *, seed: int, session: int, etalon: Etalon
    ) -> None:
        self._rig = rig
        self.illumination = Illumination(rig, effects, seed, session)
        self._holder = SampleHolder(rig, truth, self.illumination, effects, seed=seed, session=session, etalon=etalon)
        self._view = camera_view(rig, effects, seed, session)
        self._point_spread = PointSpread(self._view.reference.shape, effects.core, effects.halo, effects.halo_radius)
        self._reference = REFERENCE_RATE * self._point_spread(self._view.reference)
        self._signals: dict[tuple[Setup, int], Array] = {}
        self._image: Callable[[Setup, int], Array] = lru_cache(_CACHED_IMAGES)(self._sample_image)

    def rates(self, setup: Setup, wavelength: float, position: int) -> Array:
        """Electrons per second on each pixel (height, width), for a warm and stable lamp.

        ``wavelength`` is that of the monochromator [nm], ``position`` that of the filter wheel. Errors as of :meth:`SampleHolder.brightness`.
        """
        transmittance = self.illumination.filter_transmittance(position, wavelength)
        if setup.load == "line-lamp":
            lines = self.illumination.line_lamp(wavelength) * SPLIT
            return np.asarray(
                (transmittance if self._rig.nd_location == "reference" else 1.0) * lines * self._reference
            )
        nodes, light = self.illumination.band(wavelength)
        reference = float((light * self.illumination.split_ratio(nodes)).sum())
        if self._rig.nd_location == "reference":
            reference *= transmittance
        return transmittance * self._image(setup, round(1000 * wavelength)) + reference * self._reference

    def _sample_image(self, setup: Setup, picometres: int) -> Array:
        """Light of the object in the holder, without a filter."""
        if (setup, picometres) not in self._signals:
            self._evaluate(setup, picometres)
        image = np.zeros(self._view.reference.shape)
        image.ravel()[self._view.pixels] = self._signals[setup, picometres]
        return self._point_spread(image)

    def _evaluate(self, setup: Setup, picometres: int) -> None:
        """Signals of the illuminated pixels at this wavelength and at all wavelengths in whole steps from it."""
        low, high = (round(1000 * wavelength) for wavelength in self._rig.wavelengths)
        # A wavelength outside the range of the rig, as of a monochromator that moves from rest, is evaluated alone.
        in_range = low <= picometres <= high
        grid = range(low + (picometres - low) % _STEP, high + 1, _STEP) if in_range else [picometres]
        wavelengths = np.array(grid) / 1000
        brightness = self._holder.brightness(setup, self._view.theta_s, self._view.phi_s, wavelengths)
        signals = self._view.matrix @ brightness
        signals *= SAMPLE_RATE * self.illumination.path_factor(setup.entrance, wavelengths)
        if len(self._signals) + len(grid) > _CACHED_SIGNALS:
            self._signals.clear()
        self._signals |= {(setup, node): signals[:, k].copy() for k, node in enumerate(grid)}


class PointSpread:
    """Convolution of an image with the point spread function of the camera: a narrow core and a wide, faint halo.

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

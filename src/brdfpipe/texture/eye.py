"""What an eye resolves at a viewing distance."""

from __future__ import annotations

import numpy as np

from brdfpipe.geometry import Array

EYE_RESOLVES = 1 / 60
"""Angle that an eye of normal acuity resolves [degree] (visual acuity 1.0, ISO 8596)."""


def resolved_size(distance: float) -> float:
    """Side of what an eye resolves at a viewing distance [m], in um."""
    return float(1e6 * distance * np.radians(EYE_RESOLVES))


def blur_width(distance: float) -> float:
    """Standard deviation [um] of the blur of an eye at a viewing distance [m]: a Gaussian, at half maximum as wide as what the eye resolves."""
    return resolved_size(distance) / float(np.sqrt(8 * np.log(2)))


def eye_blur(light: Array, pixel: float, distance: float) -> Array:
    """Periodic light (rows, columns) on pixels [um], blurred by an eye at a distance [m]."""
    sigma = blur_width(distance) / pixel
    frequency = np.hypot(np.fft.rfftfreq(light.shape[1]), np.fft.fftfreq(light.shape[0])[:, None])
    seen = np.fft.rfft2(light) * np.exp(-2 * (np.pi * sigma * frequency) ** 2)
    return np.asarray(np.fft.irfft2(seen, s=light.shape))

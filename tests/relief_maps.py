"""Synthetic height maps of known kinds, on which predictions are compared with reference solutions; periodic, pitch 1 µm."""

from __future__ import annotations

import numpy as np
import samples

Array = np.ndarray


def gaussian(slope: float, size: int, seed: int, length: float = 12.0) -> Array:
    """Normally distributed heights of a Gaussian correlation; rms slope along one axis."""
    return samples.gaussian_surface(size, sigma=slope, correlation=length, seed=seed)["height"].values


def of_spectrum(spectrum: Array, pitch: float, seed: int) -> Array:
    """Normally distributed heights of a power spectral density, over the frequencies of ``numpy.fft.fftfreq`` along y and x."""
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal(spectrum.shape))
    return np.fft.ifft2(noise * np.sqrt(spectrum)).real / pitch


def two_scales(size: int, seed: int) -> Array:
    """Coarse waviness of slope 0.15 under fine roughness of slope 0.2."""
    return gaussian(0.15, size, seed, length=40.0) + gaussian(0.2, size, seed + 1000, length=8.0)


def ggx_like(size: int, seed: int, width: float = 0.15) -> Array:
    """Roughness whose amplitude varies from place to place, so that its slopes have the long tail of GGX: a mixture of normal ones."""
    from scipy.special import ndtr

    place = gaussian(1.0, size, seed + 2000, length=60.0)
    share = ndtr(place / place.std())
    amplitude = np.minimum(1 / np.sqrt(-2 * np.log(np.clip(share, 1e-6, 1 - 1e-6))), 3.0)
    return gaussian(width, size, seed, length=10.0) * amplitude


def cells(size: int, seed: int) -> Array:
    """A grain: round cells that rise from narrow valleys between them."""
    from scipy.ndimage import gaussian_filter
    from scipy.spatial import cKDTree

    centres = np.random.default_rng(seed).random((size * size // 2000, 2)) * size
    rows, columns = np.mgrid[:size, :size]
    at = np.stack([rows.ravel(), columns.ravel()], axis=1).astype(float)
    nearest = cKDTree(centres, boxsize=size).query(at, k=2)[0]
    to_border = (nearest[:, 1] - nearest[:, 0]).reshape(size, size) / 2
    return gaussian_filter(-12 * np.exp(-to_border / 5), 2, mode="wrap")


def ridges(size: int, seed: int, slope: float = 0.25) -> Array:
    """Ridges along x: four times longer than wide, slopes across them four times those along."""
    rng = np.random.default_rng(seed)
    x, y = np.fft.fftfreq(size), np.fft.fftfreq(size)[:, None]
    shape = np.exp(-(np.pi**2) * ((40 * x) ** 2 + (10 * y) ** 2) / 2)
    height = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * shape).real
    return height * slope / np.diff(height, axis=0).std()


MAPS = {
    "slope 0.1": lambda size, seed: gaussian(0.1, size, seed),
    "slope 0.3": lambda size, seed: gaussian(0.3, size, seed),
    "slope 0.6": lambda size, seed: gaussian(0.6, size, seed),
    "two scales": two_scales,
    "GGX": ggx_like,
    "cells": cells,
    "cells upside down": lambda size, seed: -cells(size, seed),
    "ridges": ridges,
}
"""Heights [um] by kind, of (size, seed)."""

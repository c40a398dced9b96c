"""Synthetic pictures of paints with flakes of known size, density and spread of tilt; nothing here is measured."""

from __future__ import annotations

import numpy as np


def flakes(
    size: int = 384,
    *,
    radius: float = 2.0,
    density: float = 0.004,
    spread: float = 4.0,
    at: float = 0.0,
    lobe: float = 2.0,
    seed: int = 1,
) -> np.ndarray:
    """Light of a paint: discs, each as bright as its tilt mirrors the light to the camera, on an even body; periodic.

    Parameters
    ----------
    size : pixels along a side
    radius : of the flakes [pixel]
    density : flakes per pixel
    spread : rms of their tilts along either axis [degree]
    at : tilt of the flakes that mirror the light to the camera [degree]
    lobe : rms width in tilt of the light of one flake [degree]: aperture and the flake's own roughness
    """
    rng = np.random.default_rng(seed)
    count = rng.poisson(density * size**2)
    tilt = rng.normal(scale=spread, size=(2, count))
    light = np.exp(-((tilt[0] - at) ** 2 + tilt[1] ** 2) / (2 * lobe**2))
    rows, columns = rng.random((2, count)) * size
    points = np.zeros((size, size))
    np.add.at(points, (rows.astype(int), columns.astype(int)), light)
    # Discs with a soft edge, as a lens draws them.
    distance = np.hypot(
        *(np.minimum(np.arange(size), size - np.arange(size))[axis] for axis in (np.s_[:, None], np.s_[None, :]))
    )
    disc = 1 / (1 + np.exp(np.minimum((distance - radius) * 4, 100)))
    drawn = np.fft.irfft2(np.fft.rfft2(points) * np.fft.rfft2(disc), s=points.shape)
    return np.maximum(drawn, 0) + 0.05

"""Cosmic hits: pixels with charge that no light of the lens can have left, and their removal within a bracket.

A hit is sharper than the point spread of any lens: it stands out of all its neighbours. One that covers several pixels stands out of the other
frames of its bracket, scaled to the same light. Reference: van Dokkum 2001, PASP 113, 1420 (the sharpness of hits).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array

SHARPEST = 1.3
"""Largest ratio of a pixel of a picture to its brightest neighbour: the ends of fibres are several pixels wide, and blurred."""

MANY = 5e-4
"""Share of pixels with hits above which a bench is not as it should be: two per minute and square centimetre leave far fewer."""

SMALLEST_SPOT = 1.5
"""Radius of a fibre's spot [pixel] below which its light may be as sharp as a hit, so that a single frame cannot tell them apart."""

_SIGMA = 6.0  # standard deviations of noise by which a hit stands out
_MODEL_U = 0.03  # relative standard uncertainty with which the other frames of a bracket predict a pixel: flicker, filters, linearity
_LONGEST_TRACK = 3  # pixels of a track that are removed one after the other

Picture = NDArray[np.float32]
Mask = NDArray[np.bool_]


def isolated_peaks(light: Picture, floor: float) -> Mask:
    """Pixels (y, x) that stand out of all their neighbours by more than a sharp picture and noise allow.

    ``floor`` is the variance of a pixel without light [e⁻²].
    """
    expected = np.maximum(_brightest_neighbours(light), 0.0)
    return np.asarray(light > SHARPEST * expected + _SIGMA * np.sqrt(expected + np.float32(floor)))


def _brightest_neighbours(light: Picture) -> Picture:
    """Brightest of the eight neighbours of each pixel."""
    padded = np.pad(light, 1, constant_values=-np.inf)
    of_row = np.maximum(padded[:, :-2], padded[:, 2:])
    with_itself = np.maximum(of_row, padded[:, 1:-1])
    brightest = np.maximum(with_itself[:-2], with_itself[2:])
    return np.maximum(brightest, of_row[1:-1], out=brightest)


def replace_peaks(light: Picture, floor: float, known: Mask | None = None) -> int:
    """Replace isolated peaks of a picture (y, x), and ``known`` hot pixels, by the median of their neighbours, in place.

    Returns the number of peaks. A track of several pixels is removed from its brightest pixel on.
    """
    if known is not None and known.any():
        _replace(light, known)
    count = 0
    for _ in range(_LONGEST_TRACK):
        peaks = isolated_peaks(light, floor)
        found = int(np.count_nonzero(peaks))
        if not found:
            break
        count += found
        _replace(light, peaks)
    return count


def _replace(light: Picture, pixels: Mask) -> None:
    row, column = np.nonzero(pixels)
    padded = np.pad(light, 1, mode="reflect")
    around = [padded[row + i, column + j] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    light[row, column] = np.median(around, axis=0)


def contradicted(light: Picture, usable: Mask, k: Array, floor: Array) -> Mask:
    """Pixels (frame, y, x) much brighter than the other frames of the bracket show them.

    Parameters
    ----------
    light : (frame, y, x) [e⁻]
    usable : (frame, y, x) within the linear range
    k : (frame,) electrons per unit of relative light
    floor : (frame,) variance of a pixel without light [e⁻²]
    """
    hits = np.zeros(light.shape, dtype=bool)
    if len(light) < 2:
        return hits
    scale, least = (values.astype(np.float32)[:, None, None] for values in (k, floor))
    # Each frame weighs as its exposure to light, whatever its own count, so that a hit in one does not hide in the mean.
    weight = np.where(usable, scale * scale / least, np.float32(0.0))
    value = weight * (light / scale)
    total, mean = weight.sum(axis=0), value.sum(axis=0)
    for frame, own_scale in enumerate(scale):
        left = total - weight[frame]
        known = left > 0
        q = np.maximum((mean - value[frame]) / np.where(known, left, 1.0), 0.0)
        expected = q * own_scale
        # The others have at least the photon noise of as much light as they saw.
        others = own_scale**2 * (
            1 / np.where(known, left, 1.0)
            + q / np.maximum((scale * usable).sum(axis=0) - own_scale * usable[frame], 1e-9)
        )
        sigma = np.sqrt(expected + least[frame] + others + (np.float32(_MODEL_U) * expected) ** 2)
        hits[frame] = known & usable[frame] & (light[frame] - expected > _SIGMA * sigma)
    return hits

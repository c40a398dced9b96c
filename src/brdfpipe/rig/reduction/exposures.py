"""From counts to relative light: dark frames, masks, electrons, and the merge of a bracket.

A bracket is several frames of one arrangement that differ by exposure and neutral filter. Each is first divided by the light of its
own reference spot and by the transmittance of its filter; what remains of frame b is q, the same for all of them, with a noise of

    var q_b = (q k_b + floor_b) / k_b²,    k_b = reference electrons × transmittance,

and their mean is weighted with the inverse of that. The q in it is the merged one, never the pixel's own count: weights that follow
the noise of the counts would pull the mean down. Pictures are in single precision, sums over them in double: a count has 16 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import gammaincinv

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.rig.description import CameraSettings

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]

FEWEST_DARKS = 5
"""Dark frames of an exposure time below which their noise adds to that of every other frame."""

_HOT, _LEAST_HOT = 8.0, 3.0
"""From how many robust standard deviations above its surroundings, and counts, a pixel of the mean dark frame is hot."""

_ROUNDS = 2


class ExposureError(BrdfpipeError):
    """Frames that cannot be reduced."""


@dataclass(frozen=True)
class Dark:
    """What the camera reads without light in one exposure time."""

    mean: Picture
    """(y, x) [count]."""
    variance: float
    """Of an ordinary pixel of one frame [count²]."""
    hot: Mask
    frames: int

    @property
    def floor(self) -> float:
        """Variance of a pixel [count²] of a frame without light, when this mean has been subtracted."""
        return self.variance * (1 + 1 / self.frames)


@dataclass(frozen=True)
class Mending:
    """Hot pixels, and the ordinary ones about them of which each takes the mean."""

    hot: Mask

    @cached_property
    def _neighbours(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        height, width = self.hot.shape
        row, column = np.nonzero(self.hot)
        steps = np.array([(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)])
        y, x = row[:, None] + steps[:, 0], column[:, None] + steps[:, 1]
        within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        near = np.where(within, y * width + x, 0)
        good = within & ~self.hot.ravel()[near]
        return row * width + column, near, good / np.maximum(good.sum(axis=1, keepdims=True), 1)

    def __call__(self, light: Picture) -> None:
        """Mend pictures (…, y, x) in place, so that sums over pixels need no mask. Without a neighbour a hot pixel is 0."""
        hot, near, share = self._neighbours
        flat = light.reshape(-1, self.hot.size)
        flat[:, hot] = (flat[:, near] * share).sum(axis=-1)


class Merged(NamedTuple):
    """One picture of relative light q, from a bracket."""

    light: Picture
    """(y, x); NaN where no frame of the bracket can be used."""
    variance: Picture
    shares: Picture
    """(frame, y, x): weight of each frame, 1 in sum, or 0."""
    saturated: Mask
    """Where no frame is within the linear range."""


def dark(counts: NDArray[np.uint16], camera: CameraSettings) -> Dark:
    """The mean of dark frames of one exposure time.

    Parameters
    ----------
    counts : (frame, y, x)
    camera : its read noise stands in where one frame does not tell

    Raises
    ------
    ExposureError : there is no frame.
    """
    count = len(counts)
    if not count:
        raise ExposureError(
            "no dark frame of this exposure time; accepted: at least one, better five (`darks` of the plan)"
        )
    frames = counts.astype(np.float32)
    mean = frames.mean(axis=0, dtype=float)
    # Rounding to whole counts alone has a variance of 1/12.
    variance = 1 / 12 + (camera.read_noise / camera.gain) ** 2
    if count > 1:
        # One number for all ordinary pixels is known far better than each pixel's own from five frames. The median of sample
        # variances, which hot pixels leave alone, lies below their mean as that of χ² does.
        median = float(np.median(frames.var(axis=0, ddof=1)))
        variance = max(median * (count - 1) / (2 * float(gammaincinv((count - 1) / 2, 0.5))), 1 / 12)
    excess = mean - ndimage.median_filter(mean, size=3, mode="nearest")
    scale = 1.4826 * float(np.median(np.abs(excess)))
    return Dark(mean.astype(np.float32), variance, excess > max(_HOT * scale, _LEAST_HOT), count)


def electrons(counts: NDArray[np.uint16], darks: Dark, camera: CameraSettings) -> tuple[Picture, Mask]:
    """Electrons of light, and which pixels are within the camera's linear range, of one frame.

    A pixel beside one out of range is taken for out of range too: charge flows over.
    """
    light = np.float32(camera.gain) * (counts - darks.mean)
    beyond = (light > camera.linear_to) | (counts >= camera.full)
    return light, ~(_grown(beyond) if beyond.any() else beyond)


def merge(light: Picture, usable: Mask, scale: Array, floor: Array) -> Merged:
    """The inverse-variance mean of a bracket.

    Parameters
    ----------
    light : (frame, y, x) [e⁻]
    usable : (frame, y, x), whether a pixel is within the linear range
    scale : (frame,) k, electrons per unit of relative light
    floor : (frame,) variance of a pixel without light [e⁻²]
    """
    k, least = (each.astype(np.float32)[:, None, None] for each in (scale, floor))
    relative = light / k
    q = np.zeros(light.shape[1:], dtype=np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(_ROUNDS + 1):
            # Light never makes the noise smaller than it is in the dark. The first round weighs as if all were dark.
            weight = np.where(usable, k * k / (np.fmax(q, 0.0) * k + least), np.float32(0.0))
            total = weight.sum(axis=0)
            q = (weight * relative).sum(axis=0) / total
        variance, shares = 1 / total, np.nan_to_num(weight / total)
    saturated = total == 0
    return Merged(q, np.where(saturated, np.float32(np.nan), variance), shares, saturated)


def _grown(mask: Mask) -> Mask:
    """A mask and the eight neighbours of each of its pixels."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    grown = tall.copy()
    grown[:, 1:] |= tall[:, :-1]
    grown[:, :-1] |= tall[:, 1:]
    return grown

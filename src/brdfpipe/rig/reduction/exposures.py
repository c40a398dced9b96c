"""From counts to relative light: dark frames, linear range, electrons, and the merge of a bracket.

A bracket is several frames of one arrangement that differ in exposure time and neutral filter. Pictures are in single precision, sums over
them in double: a count has 16 bits.
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

_HOT_SIGMA, _HOT_LEAST = 8.0, 3.0
"""A pixel is hot if its mean dark frame exceeds the surroundings by this many robust standard deviations, and this many counts."""
_REWEIGHTINGS = 2


class ExposureError(BrdfpipeError):
    """Frames that cannot be reduced."""


@dataclass(frozen=True)
class MeanDark:
    """The mean of the dark frames of one exposure time."""

    mean: Picture  # (y, x) [count]
    variance: float  # of an ordinary pixel of one frame [count²]
    hot: Mask
    frames: int

    @property
    def floor(self) -> float:
        """Variance of a pixel [count²] of a frame without light after subtraction of this mean."""
        return self.variance * (1 + 1 / self.frames)


@dataclass(frozen=True)
class HotPixels:
    """Hot pixels, which take the mean of their ordinary neighbours."""

    mask: Mask

    @cached_property
    def _neighbours(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Flat indices of the hot pixels and of their eight neighbours, and the weights of these."""
        height, width = self.mask.shape
        row, column = np.nonzero(self.mask)
        steps = np.array([(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)])
        y, x = row[:, None] + steps[:, 0], column[:, None] + steps[:, 1]
        within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        near = np.where(within, y * width + x, 0)
        ordinary = within & ~self.mask.ravel()[near]
        return row * width + column, near, ordinary / np.maximum(ordinary.sum(axis=1, keepdims=True), 1)

    def interpolate(self, light: Picture) -> None:
        """Replace hot pixels of pictures (…, y, x) in place, so that sums over pixels need no mask; 0 without an ordinary neighbour."""
        hot, near, weight = self._neighbours
        flat = light.reshape(-1, self.mask.size)
        flat[:, hot] = (flat[:, near] * weight).sum(axis=-1)


class Merged(NamedTuple):
    """One picture of relative light q, from a bracket."""

    light: Picture  # (y, x); NaN where no frame of the bracket can be used
    variance: Picture
    shares: Picture  # (frame, y, x): weight of each frame, 1 in sum, or 0
    saturated: Mask  # where no frame is within the linear range


def mean_dark(counts: NDArray[np.uint16], camera: CameraSettings) -> MeanDark:
    """The mean of dark frames (frame, y, x) of one exposure time; the variance of a single frame is the camera's read noise."""
    count = len(counts)
    frames = counts.astype(np.float32)
    mean = frames.mean(axis=0, dtype=float)
    # Rounding to whole counts alone has a variance of 1/12.
    variance = 1 / 12 + (camera.read_noise / camera.gain) ** 2
    if count > 1:
        # One variance for all ordinary pixels is known far better than each pixel's own from five frames. The median of the sample
        # variances ignores hot pixels; it is below their mean as the median of χ² is.
        median = float(np.median(frames.var(axis=0, ddof=1)))
        variance = max(median * (count - 1) / (2 * float(gammaincinv((count - 1) / 2, 0.5))), 1 / 12)
    excess = mean - ndimage.median_filter(mean, size=3, mode="nearest")
    sigma = 1.4826 * float(np.median(np.abs(excess)))
    return MeanDark(mean.astype(np.float32), variance, excess > max(_HOT_SIGMA * sigma, _HOT_LEAST), count)


def subtract_dark(counts: NDArray[np.uint16], dark: MeanDark, camera: CameraSettings) -> tuple[Picture, Mask]:
    """Electrons of light, and which pixels are within the camera's linear range, of one frame.

    Charge of a saturated pixel spills over: its eight neighbours count as out of range too.
    """
    light = np.float32(camera.gain) * (counts - dark.mean)
    beyond = (light > camera.linear_to) | (counts >= camera.full)
    return light, ~(ndimage.binary_dilation(beyond, np.ones((3, 3), dtype=bool)) if beyond.any() else beyond)


def merge(light: Picture, usable: Mask, scale: Array, floor: Array) -> Merged:
    """The inverse-variance mean of a bracket.

    Parameters
    ----------
    light : (frame, y, x) [e⁻]
    usable : (frame, y, x), whether a pixel is within the linear range
    scale : (frame,) k, electrons per unit of relative light: reference electrons times transmittance of the filter
    floor : (frame,) variance of a pixel without light [e⁻²]

    Notes
    -----
    Relative light q = light/k has the variance (q k + floor)/k². The q in it is the merged one: weights from a pixel's own noisy count would
    bias the mean.
    """
    k, least = (values.astype(np.float32)[:, None, None] for values in (scale, floor))
    relative = light / k
    q = np.zeros(light.shape[1:], dtype=np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(_REWEIGHTINGS + 1):
            # The first weights are those of dark pixels; negative light has no less noise than the dark.
            weight = np.where(usable, k * k / (np.fmax(q, 0.0) * k + least), np.float32(0.0))
            total = weight.sum(axis=0)
            q = (weight * relative).sum(axis=0) / total
        variance, shares = 1 / total, np.nan_to_num(weight / total)
    saturated = total == 0
    return Merged(q, np.where(saturated, np.float32(np.nan), variance), shares, saturated)

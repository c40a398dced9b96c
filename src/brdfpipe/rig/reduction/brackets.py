"""The frames of one wavelength made comparable: their reference light, and the filters they were taken through.

The reference spot of a frame tells how much light the sample had; a frame whose spot is out of range borrows the lamp from the others
of its bracket. Transmittances of filters are known to a percent or two: frames that overlap tell them better.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage, sparse

from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import cells as celled
from brdfpipe.rig.reduction import exposures, registration
from brdfpipe.rig.reduction.exposures import Dark, ExposureError, Mask, Mending, Picture

_CLEAR_ELECTRONS = 500.0
"""Electrons of a pixel in the darker of two frames from which their overlap is looked at."""

_WINDOW = 5
"""Side of the square about a pixel by whose light it is chosen."""

_FEWEST_PIXELS = 4
"""Pixels that an overlap needs."""

_SHARED_U = 1e-3
"""Relative standard uncertainty of an overlap beyond noise: counts are linear, and dark frames right, to no better."""

_RING = (3.0, 5.0)
"""Where the background of the reference spot is taken: from so far to so far beyond its light [pixel]."""

_CLEAR_REFERENCE = 10.0
"""A reference spot counts if its light is so many times its noise."""

_LAMP_U = 0.01
"""Relative standard uncertainty of the lamp where it is taken from the other frames of a bracket."""


class Spot(NamedTuple):
    """Sums over the reference spot: its pixels, and those of the ring about it scaled to as many."""

    inside: sparse.csr_array
    ring: sparse.csr_array
    away: Mask
    """(y, x), pixels beyond the ring."""


@dataclass(frozen=True)
class Darkness:
    """What all frames of a run have in common: the dark frames by their exposure time [s], and the hot pixels in any of them."""

    darks: Mapping[float, Dark]
    mending: Mending

    @classmethod
    def of(cls, frames: xr.Dataset, rig: Rig) -> Darkness:
        """Of the dark ones among frames."""
        own = frames.isel(frame=frames["purpose"].values == "dark")
        darks = {
            float(exposure): exposures.dark(own["counts"].values[own["exposure"].values == exposure], rig.camera)
            for exposure in np.unique(own["exposure"].values)
        }
        hot = np.zeros((rig.camera.height, rig.camera.width), dtype=bool)
        return cls(darks, Mending(np.logical_or.reduce([hot, *(each.hot for each in darks.values())])))


@dataclass(frozen=True)
class Bracket:
    """The frames of one wavelength."""

    light: Picture
    """(frame, y, x) [e⁻], hot pixels mended."""
    usable: Mask
    exposure: Array
    """(frame,) [s]"""
    positions: NDArray[np.int64]
    floor: Array
    """(frame,) variance of a pixel without light [e⁻²]."""


@dataclass(frozen=True)
class Scale:
    """What makes the frames of a bracket comparable."""

    k: Array
    """(frame,) electrons per unit of relative light: those of the reference, times the transmittance of a filter the sample alone is behind."""
    reference: Array
    """(frame, frame) covariance of ln k that the references leave."""
    filters: Array
    """(frame, frame) covariance of ln k that the transmittances leave besides."""
    lamp: float
    """Electrons a second of the reference spot behind no filter; NaN if no frame shows it."""
    lamp_u: float
    """Its standard uncertainty: noise, and that of filters before the reference."""


def bracket(frames: xr.Dataset, darkness: Darkness, rig: Rig) -> Bracket:
    """The light of some frames of one arrangement.

    Raises
    ------
    ExposureError : there is no dark frame of an exposure time.
    """
    light, usable, floor = [], [], []
    for counts, exposure in zip(frames["counts"].values, frames["exposure"].values, strict=True):
        if (dark := darkness.darks.get(float(exposure))) is None:
            raise ExposureError(
                f"no dark frame of {exposure:g} s; `brdfpipe rig scan … --resume` takes what is missing of a run"
            )
        electrons, good = exposures.electrons(counts, dark, rig.camera)
        light.append(electrons)
        usable.append(good)
        floor.append(rig.camera.gain**2 * dark.floor)
    stacked = np.array(light)
    darkness.mending(stacked)
    return Bracket(stacked, np.array(usable), frames["exposure"].values, frames["nd_position"].values, np.array(floor))


def reference_spot(rig: Rig, frames: Bracket) -> Spot:
    """Where the light of the reference is gathered: about its centroid if it is clear, else where it is described."""
    screen = rig.screen
    column, row = screens.to_pixel(screen, *screen.reference)
    radius = screen.reference_radius * screen.scale
    variance = np.full(frames.light.shape[1:], frames.floor.sum()) + np.maximum(frames.light, 0).sum(axis=0)
    seen = registration.centroids(frames.light.sum(axis=0), variance, column, row, radius)
    place = float(seen.column[0]), float(seen.row[0])
    inside, narrow, wide = (celled.disk(rig.camera, *place, radius + celled.BLUR + beyond) for beyond in (0.0, *_RING))
    ring = wide - narrow
    away = wide.toarray().reshape(frames.light.shape[1:]) == 0
    return Spot(inside, sparse.csr_array(ring * (inside.sum() / max(ring.sum(), 1e-9))), away)


def scaled(frames: Bracket, spot: Spot, rig: Rig) -> Scale:
    """What makes the frames of a bracket comparable: their references, the filters as described, and what overlapping frames share.

    Notes
    -----
    Unknown are the logarithms of the corrections of each frame's reference, known to its noise, and of each filter, known to what the
    description says of it; the clearest filter has none, for what it is wrong by is the same for etalon and sample. Two frames that
    share well exposed pixels tell their difference, better by far than the reference of a short exposure does.
    """
    reference, relative = reference_light(frames, spot)
    through, through_u = _filters(frames, rig)
    both = rig.nd_location == "reference"
    per_lamp = per_rate(frames, rig)
    dim = ~np.isfinite(reference)
    rate = (reference / per_lamp)[~dim]
    count = len(reference)
    if dim.all():
        return Scale(reference, np.full((count, count), np.nan), np.full((count, count), np.nan), np.nan, np.nan)
    lamp = float(rate.mean())
    rate_u = rate * np.hypot(relative, both * through_u)[~dim]
    reference = np.where(dim, lamp * per_lamp, reference)
    # Light that both beams lost divides out.
    k = reference * (np.ones_like(through) if both else through)
    positions, where = np.unique(frames.positions, return_inverse=True)
    of_filter = np.array([through_u[where == place][0] for place in range(positions.size)])
    of_filter[both | (np.arange(positions.size) == where[int(np.argmax(through))])] = 0.0
    prior = np.concatenate([np.where(dim, _LAMP_U, relative), of_filter])
    # ln k of each frame from the unknowns, and what is measured of their differences.
    told = np.hstack([np.eye(count), np.eye(positions.size)[where]])
    overlaps = list(_overlaps(frames, k, spot.away))
    rows = np.array([(told[one] - told[other]) / u for one, other, _, u in overlaps]).reshape(-1, prior.size)
    values = np.array([difference / u for _, _, difference, u in overlaps])
    solution, covariance = _solved(rows, values, prior)
    references_alone = _solved(rows, values, np.append(prior[:count], np.zeros(positions.size)))[1]
    whole, alone = (told @ each @ told.T for each in (covariance, references_alone))
    return Scale(k * np.exp(told @ solution), alone, whole - alone, lamp, float(np.linalg.norm(rate_u) / rate.size))


def per_rate(frames: Bracket, rig: Rig) -> Array:
    """Electrons of the reference spot of each frame over those a second behind no filter [s]."""
    return frames.exposure * (_filters(frames, rig)[0] if rig.nd_location == "reference" else 1.0)


def _filters(frames: Bracket, rig: Rig) -> tuple[Array, Array]:
    """Transmittances of the filters of each frame as described, and their relative uncertainties."""
    filters = [rig.filter_at(int(position)) for position in frames.positions]
    return np.array([each.transmittance for each in filters]), np.array([each.u for each in filters])


def _solved(rows: Array, values: Array, prior: Array) -> tuple[Array, Array]:
    """Least squares of unknowns with prior standard deviations about 0, and their covariance."""
    # In units of the prior, so that what is known exactly stays 0.
    design = rows * prior
    covariance = np.linalg.inv(np.eye(prior.size) + design.T @ design)
    return prior * (covariance @ (design.T @ values)), covariance * np.outer(prior, prior)


def reference_light(frames: Bracket, spot: Spot) -> tuple[Array, Array]:
    """Electrons of the reference spot and their relative uncertainty; NaN where it is out of range or dark."""
    flat = frames.light.reshape(len(frames.light), -1).T
    total = (spot.inside @ flat - spot.ring @ flat).ravel().astype(float)
    beyond = (spot.inside @ (~frames.usable.reshape(flat.shape[::-1])).T.astype(float)).ravel() > 0
    pixels = float(spot.inside.power(2).sum() + spot.ring.power(2).sum())
    noise = np.sqrt(np.maximum(total, 0) + pixels * frames.floor)
    good = ~beyond & (total > _CLEAR_REFERENCE * noise)
    return np.where(good, total, np.nan), np.where(good, noise / np.where(good, total, 1.0), np.nan)


def _overlaps(frames: Bracket, k: Array, away: Mask) -> Iterator[tuple[int, int, float, float]]:
    """For frames next to each other in brightness: the logarithm of how much more light one has than its k says against that of the
    other, and its standard uncertainty."""
    order = np.argsort(k)
    for faint, bright in pairwise(order):
        ratio = float(k[faint] / k[bright])
        # Chosen by the brighter frame's light about each pixel, without its own: choosing by its own noise would lift what is chosen.
        light = frames.light[bright]
        about = (_WINDOW**2 * ndimage.uniform_filter(light, _WINDOW, mode="nearest") - light) / (_WINDOW**2 - 1)
        shared = away & frames.usable[bright] & frames.usable[faint] & (about * np.float32(ratio) > _CLEAR_ELECTRONS)
        count = int(np.count_nonzero(shared))
        low, high = (float(frames.light[place][shared].sum(dtype=float)) for place in (faint, bright))
        if count >= _FEWEST_PIXELS and low > 0 and high > 0:
            noise = (low + count * frames.floor[faint]) / low**2 + (high + count * frames.floor[bright]) / high**2
            yield int(faint), int(bright), float(np.log(low / high / ratio)), float(np.hypot(np.sqrt(noise), _SHARED_U))

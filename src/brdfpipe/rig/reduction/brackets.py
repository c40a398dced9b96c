"""The frames of one wavelength on a common scale: their reference light, and the filters they were taken through.

The light of a frame's reference spot scales the frame. Where the spot is out of range, the lamp's light comes from the other frames of the
bracket. Transmittances of filters are stated to a percent or two; pixels that two frames both expose well give them more accurately.
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
from brdfpipe.rig.reduction import cells as rig_cells
from brdfpipe.rig.reduction import cosmic_hits, exposures, registration
from brdfpipe.rig.reduction.exposures import ExposureError, HotPixels, Mask, MeanDark, Picture

_OVERLAP_ELECTRONS = 500.0  # electrons in the darker of two frames above which a pixel belongs to their overlap
_WINDOW = 5  # side of the square about a pixel whose mean light is compared with that limit [pixel]
_FEWEST_PIXELS = 4  # pixels that an overlap needs
_OVERLAP_U = 1e-3  # relative standard uncertainty of an overlap beyond its noise: accuracy of linearity and dark frames
_RING = (3.0, 5.0)  # inner and outer distance from the reference spot's edge at which its background is taken [pixel]
_CLEAR_RING = 0.2  # share of this ring that must be clear of fibres
_REFERENCE_SNR = 10.0  # smallest ratio of a usable reference spot's light to its noise
_LAMP_U = 0.01  # relative standard uncertainty of the lamp's light if it is taken from the other frames of a bracket


class ReferenceSpot(NamedTuple):
    """Weights for sums over the reference spot's pixels, and over the ring about it scaled to as many pixels."""

    inside: sparse.csr_array
    ring: sparse.csr_array
    outside: Mask  # (y, x), pixels beyond the ring


@dataclass(frozen=True)
class DarkFrames:
    """The mean dark frames of a run by exposure time [s], and the pixels that are hot in any of them."""

    by_exposure: Mapping[float, MeanDark]
    hot_pixels: HotPixels

    @classmethod
    def of(cls, frames: xr.Dataset, rig: Rig) -> DarkFrames:
        """From the dark ones among frames of kind ``frames``."""
        dark = frames.isel(frame=frames["purpose"].values == "dark")
        by_exposure = {
            float(exposure): exposures.mean_dark(dark["counts"].values[dark["exposure"].values == exposure], rig.camera)
            for exposure in np.unique(dark["exposure"].values)
        }
        none = np.zeros((rig.camera.height, rig.camera.width), dtype=bool)
        hot = np.logical_or.reduce([none, *(mean.hot for mean in by_exposure.values())])
        return cls(by_exposure, HotPixels(hot))


@dataclass(frozen=True)
class Bracket:
    """The frames of one wavelength."""

    light: Picture  # (frame, y, x) [e⁻], hot pixels interpolated
    usable: Mask  # (frame, y, x) within the linear range
    exposure: Array  # (frame,) [s]
    positions: NDArray[np.int64]  # (frame,) of the filter wheel
    floor: Array  # (frame,) variance of a pixel without light [e⁻²]
    cosmic_hits: int = 0  # isolated bright pixels that were replaced


@dataclass(frozen=True)
class Scale:
    """The common scale of the frames of a bracket."""

    k: Array
    """(frame,) electrons per unit of relative light: reference electrons times the transmittance of a filter before the sample alone."""
    reference: Array  # (frame, frame) covariance of ln k from the references
    filters: Array  # (frame, frame) covariance of ln k that the transmittances add
    lamp: float  # electrons per second of the reference spot without a filter; NaN if no frame shows the spot
    lamp_u: float  # its standard uncertainty: noise, and that of filters before the reference


def read_bracket(frames: xr.Dataset, darks: DarkFrames, rig: Rig) -> Bracket:
    """The light of some frames of one arrangement, without isolated cosmic hits unless spots are as sharp. Raises ExposureError: there is no dark frame of an exposure time."""
    light, usable, floor = [], [], []
    for counts, exposure in zip(frames["counts"].values, frames["exposure"].values, strict=True):
        if (dark := darks.by_exposure.get(float(exposure))) is None:
            raise ExposureError(
                f"no dark frame of {exposure:g} s; `brdfpipe rig scan … --resume` takes the missing frames of a run"
            )
        electrons, linear = exposures.subtract_dark(counts, dark, rig.camera)
        light.append(electrons)
        usable.append(linear)
        floor.append(rig.camera.gain**2 * dark.floor)
    stacked = np.array(light)
    darks.hot_pixels.interpolate(stacked)
    hits = 0
    if rig.screen.fibre_radius * rig.screen.scale >= cosmic_hits.SMALLEST_SPOT:
        hits = sum(cosmic_hits.replace_peaks(light, variance) for light, variance in zip(stacked, floor, strict=True))
    exposure, positions = frames["exposure"].values, frames["nd_position"].values
    return Bracket(stacked, np.array(usable), exposure, positions, np.array(floor), hits)


def locate_reference_spot(rig: Rig, frames: Bracket) -> ReferenceSpot:
    """The reference spot about its centroid, or about its described position where the centroid is unclear."""
    screen = rig.screen
    column, row = screens.to_pixel(screen, *screen.reference_centre)
    radius = screen.reference_radius * screen.scale
    variance = np.full(frames.light.shape[1:], frames.floor.sum()) + np.maximum(frames.light, 0).sum(axis=0)
    centroid = registration.centroids(frames.light.sum(axis=0), variance, column, row, radius)
    inside, inner, outer = (
        rig_cells.disk(rig.camera, float(centroid.column[0]), float(centroid.row[0]), radius + rig_cells.BLUR + beyond)
        for beyond in (0.0, *_RING)
    )
    ring: sparse.csr_array = _without_fibres(sparse.csr_array(outer - inner), rig)
    outside = outer.toarray().reshape(frames.light.shape[1:]) == 0
    return ReferenceSpot(inside, sparse.csr_array(ring * (float(inside.sum()) / max(float(ring.sum()), 1e-9))), outside)


def _without_fibres(ring: sparse.csr_array, rig: Rig) -> sparse.csr_array:
    """The ring without the ends of fibres, whose light is no background; as it is if they cover it."""
    column, row = screens.to_pixel(rig.screen, [fibre.x for fibre in rig.fibres], [fibre.y for fibre in rig.fibres])
    pixel_row, pixel_column = np.divmod(ring.indices, rig.camera.width)
    distance = np.hypot(pixel_row[:, None] - row, pixel_column[:, None] - column)
    clear = distance.min(axis=1) > rig.screen.fibre_radius * rig.screen.scale + rig_cells.BLUR
    if clear.mean() < _CLEAR_RING:
        return ring
    return sparse.csr_array(
        (ring.data[clear], (np.zeros(clear.sum(), dtype=int), ring.indices[clear])), shape=ring.shape
    )


def scale_bracket(frames: Bracket, spot: ReferenceSpot, rig: Rig) -> Scale:
    """The common scale of the frames of a bracket, from their references, the described filters, and overlapping frames.

    Unknown are the logarithms of the corrections of each frame's reference and of each filter, with the noise and the stated
    uncertainty as priors. The clearest filter has none: its error is the same for etalon and sample. Two frames that share
    well-exposed pixels give their ratio, far better than the reference of a short exposure does.
    """
    reference, relative_u = reference_light(frames, spot)
    transmittance, transmittance_u = _filters(frames, rig)
    both_beams = rig.nd_location == "reference"
    exposure = reference_exposure(frames, rig)
    missing = ~np.isfinite(reference)
    count = len(reference)
    if missing.all():
        unknown = np.full((count, count), np.nan)
        return Scale(reference, unknown, unknown, np.nan, np.nan)
    rate = (reference / exposure)[~missing]
    lamp = float(rate.mean())
    rate_u = rate * np.hypot(relative_u, both_beams * transmittance_u)[~missing]
    reference = np.where(missing, lamp * exposure, reference)
    # A filter in both beams divides out.
    k = reference * (1.0 if both_beams else transmittance)
    positions, of_frame = np.unique(frames.positions, return_inverse=True)
    filter_u = np.array([transmittance_u[of_frame == index][0] for index in range(positions.size)])
    filter_u[both_beams | (np.arange(positions.size) == of_frame[int(np.argmax(transmittance))])] = 0.0
    prior_u = np.concatenate([np.where(missing, _LAMP_U, relative_u), filter_u])
    # ln k of each frame from the unknowns, and the measured differences of ln k.
    design = np.hstack([np.eye(count), np.eye(positions.size)[of_frame]])
    overlaps = list(_overlaps(frames, k, spot.outside))
    rows = np.array([(design[i] - design[j]) / u for i, j, _, u in overlaps]).reshape(-1, prior_u.size)
    differences = np.array([difference / u for _, _, difference, u in overlaps])
    correction, covariance = _solve_with_prior(rows, differences, prior_u)
    exact_filters = np.append(prior_u[:count], np.zeros(positions.size))
    _, references_alone = _solve_with_prior(rows, differences, exact_filters)
    of_all, of_references = (design @ part @ design.T for part in (covariance, references_alone))
    lamp_u = float(np.linalg.norm(rate_u) / rate.size)
    return Scale(k * np.exp(design @ correction), of_references, of_all - of_references, lamp, lamp_u)


def reference_exposure(frames: Bracket, rig: Rig) -> Array:
    """Exposure time of the reference spot, reduced by a filter before it (frame,) [s]."""
    return frames.exposure * (_filters(frames, rig)[0] if rig.nd_location == "reference" else 1.0)


def _filters(frames: Bracket, rig: Rig) -> tuple[Array, Array]:
    """Described transmittances of the filter of each frame, and their relative uncertainties."""
    filters = [rig.filter_at(int(position)) for position in frames.positions]
    return np.array([nd.transmittance for nd in filters]), np.array([nd.u for nd in filters])


def _solve_with_prior(rows: Array, values: Array, prior_u: Array) -> tuple[Array, Array]:
    """Least squares of unknowns with prior standard deviations about 0, and their covariance."""
    # In units of the prior, so that an exactly known unknown stays 0.
    design = rows * prior_u
    covariance = np.linalg.inv(np.eye(prior_u.size) + design.T @ design)
    return prior_u * (covariance @ (design.T @ values)), covariance * np.outer(prior_u, prior_u)


def reference_light(frames: Bracket, spot: ReferenceSpot) -> tuple[Array, Array]:
    """Electrons of the reference spot (frame,) and their relative uncertainty; NaN where it is out of range or dark."""
    total, noise = reference_sums(frames, spot)
    good = total > _REFERENCE_SNR * noise
    return np.where(good, total, np.nan), np.where(good, noise / np.where(good, total, 1.0), np.nan)


def reference_sums(frames: Bracket, spot: ReferenceSpot) -> tuple[Array, Array]:
    """Electrons of the reference spot (frame,), NaN where it is out of range, and their standard uncertainty."""
    flat = frames.light.reshape(len(frames.light), -1).T
    total = (spot.inside @ flat - spot.ring @ flat).ravel().astype(float)
    beyond = (spot.inside @ (~frames.usable.reshape(flat.shape[::-1])).T.astype(float)).ravel() > 0
    pixels = float(spot.inside.power(2).sum() + spot.ring.power(2).sum())
    return np.where(beyond, np.nan, total), np.sqrt(np.maximum(total, 0) + pixels * frames.floor)


def _overlaps(frames: Bracket, k: Array, outside: Mask) -> Iterator[tuple[int, int, float, float]]:
    """For frames next to each other in brightness: their indices (faint, bright), the logarithm of the ratio of their light over that
    of their k, and its standard uncertainty."""
    for faint, bright in pairwise(np.argsort(k)):
        ratio = float(k[faint] / k[bright])
        # Pixels are chosen by their neighbours in the brighter frame: choosing by a pixel's own noise would bias the ratio.
        light = frames.light[bright]
        around = (_WINDOW**2 * ndimage.uniform_filter(light, _WINDOW, mode="nearest") - light) / (_WINDOW**2 - 1)
        bright_enough = around * np.float32(ratio) > _OVERLAP_ELECTRONS
        shared = outside & frames.usable[bright] & frames.usable[faint] & bright_enough
        count = int(np.count_nonzero(shared))
        low, high = (float(frames.light[frame][shared].sum(dtype=float)) for frame in (faint, bright))
        if count >= _FEWEST_PIXELS and low > 0 and high > 0:
            noise = (low + count * frames.floor[faint]) / low**2 + (high + count * frames.floor[bright]) / high**2
            yield (
                int(faint),
                int(bright),
                float(np.log(low / high / ratio)),
                float(np.hypot(np.sqrt(noise), _OVERLAP_U)),
            )

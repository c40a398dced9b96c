"""What the checks of a bench need of one frame: its digest, saturation, reference spot, light in blocks of pixels, and cosmic hits."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig
from brdfpipe.rig.raw_frame import Counts
from brdfpipe.rig.reduction import cosmic_hits, registration

BLOCK = 8
"""Side of the blocks of pixels [pixel]."""

WIDEST_SEARCH = 8.0
"""Distance [pixel] from its expected position up to which a displaced reference spot is searched."""

_RING = 5.0  # pixels beyond the reference spot in which its background is taken
_NOT_SHOWN = 25.0  # ratio of light to noise below which a spot is too faint to be located
_CLEARLY_LESS = 0.8  # share of the light of a displaced spot that its described position may still show
_CLEAR_OF_SPOT = 8.0  # distance from the reference spot within which blocks are not used [pixel]


@dataclass(frozen=True)
class ReferenceLight:
    """The reference spot in one frame."""

    light: float
    """Electrons above the surroundings."""
    noise: float
    """Standard uncertainty of the light [e⁻]."""
    saturated: bool
    plateau: float
    """Median light of the pixels of the spot above their surroundings, over its standard uncertainty: hot pixels do not matter."""
    offset: tuple[float, float] | None
    """Position (column, row) relative to the described one [pixel]; None if the spot is too faint or saturated."""

    @property
    def snr(self) -> float:
        """Ratio of light to noise."""
        return self.light / self.noise


@dataclass(frozen=True)
class FrameSummary:
    """One frame, reduced to what the checks compare."""

    digest: bytes
    lowest: int
    highest: int
    saturated: float
    """Share of the pixels out of the camera's linear range."""
    reference: ReferenceLight
    blocks: Array
    """(block,) electrons of light in blocks of pixels, NaN where a pixel is saturated or the reference spot is near."""
    blocks_noise: Array
    """(block,) their standard uncertainty [e⁻]."""
    cosmic_hits: int
    """Isolated bright pixels; 0 without a dark frame."""
    light: NDArray[np.float32]
    """(y, x) electrons of light."""
    variance: float
    """Variance of a pixel without light [e⁻²]."""
    beyond: NDArray[np.bool_]
    """(y, x) pixels out of the linear range."""

    @classmethod
    def of(cls, counts: Counts, dark: Array | None, rig: Rig, hot: NDArray[np.bool_] | None = None) -> FrameSummary:
        """Summarise a frame (y, x).

        ``dark`` is the mean of the dark frames of its exposure time (y, x) [counts]; without one, the median of the frame is subtracted.
        ``hot`` are its :func:`hot_pixels`, found if they are not given.
        """
        camera = rig.camera
        level = np.median(counts) if dark is None else dark
        light = np.asarray(camera.gain * (counts - level), dtype=np.float32)
        beyond = (light > camera.linear_to) | (counts >= camera.full)
        variance = camera.read_noise**2 + camera.gain**2 / 12
        # Without a dark frame hot pixels cannot be distinguished from hits.
        hits = 0
        if dark is not None:
            hits = cosmic_hits.replace_peaks(light, variance, hot_pixels(dark, rig) if hot is None else hot)
        blocks, noise = _blocks(light, beyond, variance, rig)
        return cls(
            digest=hashlib.blake2b(np.ascontiguousarray(counts).tobytes(), digest_size=16).digest(),
            lowest=int(counts.min()),
            highest=int(counts.max()),
            saturated=float(beyond.mean()),
            reference=_reference(light, beyond, variance, rig),
            blocks=blocks,
            blocks_noise=noise,
            cosmic_hits=hits,
            light=light,
            variance=variance,
            beyond=beyond,
        )

    def spots(self, column: Array, row: Array, radius: float) -> registration.Centroids:
        """Centroids of spots of a radius near expected positions (spot,) [pixel]."""
        light = self.light.astype(float)
        return registration.centroids(light, np.maximum(light, 0) + self.variance, column, row, radius)


def hot_pixels(dark: Array | None, rig: Rig) -> NDArray[np.bool_] | None:
    """Pixels (y, x) whose mean dark frame is far above the others."""
    if dark is None:
        return None
    scatter = max(rig.camera.read_noise / rig.camera.gain, 1.0)
    return np.asarray(dark > np.median(dark) + 3 * scatter)


@cache
def block_directions(rig: Rig) -> tuple[Array, Array]:
    """Direction about the mirror direction (theta_s, phi_s) [degree] that each block shows (block,); NaN for none.

    The disc's direction in the middle of a block within it, or that of the fibre that ends in the block.
    """
    rows, columns = (size // BLOCK for size in (rig.camera.height, rig.camera.width))
    row, column = (BLOCK * np.arange(count) + (BLOCK - 1) / 2 for count in (rows, columns))
    x, y = screens.to_position(rig.screen, *np.meshgrid(column, row))
    theta, phi = screens.disc_direction(rig.screen, x, y)
    distance = np.hypot(x - rig.screen.disc_centre[0], y - rig.screen.disc_centre[1])
    outside = distance > rig.screen.disc_radius - BLOCK / rig.screen.scale
    theta[outside] = phi[outside] = np.nan
    for fibre in rig.fibres:
        at_column, at_row = screens.to_pixel(rig.screen, fibre.x, fibre.y)
        i, j = int(np.rint(at_row)) // BLOCK, int(np.rint(at_column)) // BLOCK
        if 0 <= i < rows and 0 <= j < columns:
            theta[i, j], phi[i, j] = fibre.theta_s, fibre.phi_s
    return theta.ravel(), phi.ravel()


def _blocks(light: NDArray[np.float32], beyond: NDArray[np.bool_], variance: float, rig: Rig) -> tuple[Array, Array]:
    rows, columns = (size // BLOCK for size in light.shape)

    def summed(values: NDArray[Any]) -> Array:
        whole = values[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK)
        return whole.sum(axis=(1, 3), dtype=float).ravel()

    total = summed(light)
    noise = np.sqrt(np.maximum(total, 0.0) + BLOCK**2 * variance)
    return np.where((summed(beyond) > 0) | _near_reference(rig), np.nan, total), noise


@cache
def _near_reference(rig: Rig) -> NDArray[np.bool_]:
    rows, columns = (size // BLOCK for size in (rig.camera.height, rig.camera.width))
    column, row = screens.to_pixel(rig.screen, *rig.screen.reference_centre)
    x, y = (BLOCK * np.arange(count) + (BLOCK - 1) / 2 for count in (columns, rows))
    distance = np.hypot(x - column, y[:, None] - row)
    reach = rig.screen.reference_radius * rig.screen.scale + _CLEAR_OF_SPOT + BLOCK
    return np.asarray(distance < reach).ravel()


def _reference(light: NDArray[np.float32], beyond: NDArray[np.bool_], variance: float, rig: Rig) -> ReferenceLight:
    """Light and position of the reference spot, in a window about its described position."""
    screen = rig.screen
    column, row = (float(at) for at in screens.to_pixel(screen, *screen.reference_centre))
    radius = screen.reference_radius * screen.scale
    half = int(np.ceil(radius + _RING + WIDEST_SEARCH)) + 1
    top, left = max(int(row) - half, 0), max(int(column) - half, 0)
    window = light[top : int(row) + half + 1, left : int(column) + half + 1]
    saturated = beyond[top : int(row) + half + 1, left : int(column) + half + 1]
    y, x = np.indices(window.shape)

    def measured(at: tuple[float, float]) -> tuple[float, float, bool]:
        distance = np.hypot(x - (at[0] - left), y - (at[1] - top))
        inside, ring = distance <= radius + 1, (distance > radius + 2) & (distance <= radius + _RING)
        count = int(np.count_nonzero(inside))
        background = float(np.median(window[ring])) if ring.any() else 0.0
        total = float(window[inside].sum(dtype=float)) - count * background
        noise = float(np.sqrt(max(float(window[inside].sum(dtype=float)), 0.0) + 2 * count * variance))
        return total, max(noise, 1e-9), bool(saturated[inside].any())

    total, noise, is_saturated = measured((column, row))
    offset: tuple[float, float] | None = None
    if not is_saturated:
        picture = light.astype(float)
        noise_of_pixels = np.maximum(picture, 0) + variance
        brightest = _brightest_place(window, radius, (left, top), rig)
        for start in ((column, row), brightest):
            found = registration.centroids(picture, noise_of_pixels, [start[0]], [start[1]], radius)
            at = float(found.column[0]), float(found.row[0])
            light_there, noise_there, _ = measured(at)
            if np.isfinite(found.u[0]) and light_there > _NOT_SHOWN * noise_there:
                offset = (at[0] - column, at[1] - row)
                total, noise = light_there, noise_there
                break
        else:
            # A spot moved to the edge of the picture has no surroundings of which a centroid could be taken.
            light_there, noise_there, _ = measured(brightest)
            moved = np.hypot(brightest[0] - column, brightest[1] - row) > registration.SEARCH
            if moved and light_there > _NOT_SHOWN * noise_there and total < _CLEARLY_LESS * light_there:
                offset = (brightest[0] - column, brightest[1] - row)
    distance = np.hypot(x - (column - left), y - (row - top))
    inside, ring = distance <= radius - 1, (distance > radius + 2) & (distance <= radius + _RING)
    plateau = float(np.median(window[inside]) - np.median(window[ring])) if inside.any() and ring.any() else 0.0
    plateau /= float(1.2533 * np.sqrt(variance * (1 / max(inside.sum(), 1) + 1 / max(ring.sum(), 1))))
    return ReferenceLight(total, noise, is_saturated, plateau, offset)


def _brightest_place(
    window: NDArray[np.float32], radius: float, corner: tuple[int, int], rig: Rig
) -> tuple[float, float]:
    """The pixel (column, row) near the described reference spot, and clear of fibres, about which a disc of a radius has most light."""
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.hypot(x, y) <= radius
    views = np.lib.stride_tricks.sliding_window_view(window, disc.shape)
    total = np.tensordot(views, disc, axes=((2, 3), (0, 1)))
    unlikely = _unlikely_places(rig, total.shape, (corner[0] + reach, corner[1] + reach), radius)
    best = np.unravel_index(int(np.where(unlikely, -np.inf, total).argmax()), total.shape)
    return float(best[1] + reach + corner[0]), float(best[0] + reach + corner[1])


@cache
def _unlikely_places(rig: Rig, shape: tuple[int, int], corner: tuple[int, int], radius: float) -> NDArray[np.bool_]:
    """Pixels (y, x), from a corner (column, row) on, that are far from the described reference spot or within reach of a fibre."""
    rows, columns = np.indices(shape)
    columns, rows = columns + corner[0], rows + corner[1]
    described = screens.to_pixel(rig.screen, *rig.screen.reference_centre)
    unlikely = np.hypot(columns - described[0], rows - described[1]) > WIDEST_SEARCH
    clear = radius + rig.screen.fibre_radius * rig.screen.scale + 1
    for fibre in rig.fibres:
        column, row = (float(at) for at in screens.to_pixel(rig.screen, fibre.x, fibre.y))
        if np.hypot(column - described[0], row - described[1]) < WIDEST_SEARCH + clear:
            unlikely |= np.hypot(columns - column, rows - row) < clear
    return np.asarray(unlikely)

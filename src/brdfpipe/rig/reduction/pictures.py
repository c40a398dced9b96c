"""Merged pictures of a bracket, and the parts of a picture: the disc, and the background that holds only glare."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.reduction import brackets, cosmic_hits, exposures
from brdfpipe.rig.reduction.brackets import Bracket, DarkFrames, Scale
from brdfpipe.rig.reduction.exposures import Mask, Merged

_MARGIN = 4.0  # distance from disc and spots beyond which the picture holds only glare [pixel]


def merge_bracket(bracket: Bracket, scale: Scale) -> Merged | None:
    """The merged picture of a bracket, without cosmic hits that its other frames reveal; None if no frame shows the reference."""
    if not np.isfinite(scale.lamp):
        return None
    hits = cosmic_hits.contradicted(bracket.light, bracket.usable, scale.k, bracket.floor)
    return exposures.merge(bracket.light, bracket.usable & ~hits, scale.k, bracket.floor)


def fill_saturated(merged: Merged) -> Array:
    """A merged picture in which saturated pixels are as bright as the brightest others, a lower limit for the glare they cause."""
    brightest = np.nanmax(merged.light, initial=0.0)
    return np.where(merged.saturated, brightest, merged.light).astype(float)


def lamp_weighted_mean(merged: list[Merged | None], scales: list[Scale]) -> tuple[Array, Array]:
    """The mean picture over wavelengths, weighted by the lamp's spectrum, and its variance."""
    weighted = [(picture, scale.lamp) for picture, scale in zip(merged, scales, strict=True) if picture is not None]
    lamp = sum(weight for _, weight in weighted)
    light, variance = np.zeros(()), np.zeros(())
    for picture, weight in weighted:
        light = light + weight * fill_saturated(picture)
        variance = variance + weight**2 * np.where(picture.saturated, np.nanmax(picture.variance), picture.variance)
    return np.asarray(light / lamp), np.asarray(variance / lamp**2, dtype=float)


def merge_frames(frames: xr.Dataset, darks: DarkFrames, rig: Rig) -> tuple[Array, Array] | None:
    """The picture of one wavelength and its variance; None if no frame shows the reference."""
    bracket = brackets.read_bracket(frames, darks, rig)
    scale = brackets.scale_bracket(bracket, brackets.locate_reference_spot(rig, bracket), rig)
    merged = merge_bracket(bracket, scale)
    return None if merged is None else lamp_weighted_mean([merged], [scale])


def background(rig: Rig, screen: Screen) -> Mask:
    """Pixels that hold only glare."""
    margin = _MARGIN / screen.scale
    lit = within_disc(rig, screen, margin)
    spots = [(fibre.x, fibre.y, screen.fibre_radius) for fibre in rig.fibres]
    for x, y, radius in (*spots, (*screen.reference_centre, screen.reference_radius)):
        lit |= _within_circle(rig, screen, x, y, radius + margin)
    return ~lit


def within_disc(rig: Rig, screen: Screen, margin: float = 0.0) -> Mask:
    """Pixels within the rim of the disc, widened by a margin [mm]."""
    return _within_circle(rig, screen, *screen.disc_centre, screen.disc_radius + margin)


def _within_circle(rig: Rig, screen: Screen, x: float, y: float, radius: float) -> Mask:
    """Pixels that see the screen within a radius of a position [mm]."""
    inside = np.zeros((rig.camera.height, rig.camera.width), dtype=bool)
    column, row = (float(pixel) for pixel in screens.to_pixel(screen, x, y))
    half_width = 1.1 * radius * screen.scale + 2
    rows, columns = (
        np.arange(max(int(middle - half_width), 0), min(int(middle + half_width) + 2, size))
        for middle, size in ((row, rig.camera.height), (column, rig.camera.width))
    )
    position = screens.to_position(screen, columns, rows[:, None])
    inside[np.ix_(rows, columns)] = np.hypot(position.x - x, position.y - y) < radius
    return inside

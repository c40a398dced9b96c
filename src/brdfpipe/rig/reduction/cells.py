"""The cells of a picture, the ends of the fibres and pieces of the disc, and the sparse matrix (cell, pixel) that sums pictures over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import CameraSettings, Rig, Screen

FIBRE, DISC = "fibre", "disc"

BLUR = 2.0
"""Distance beyond the image of a spot to which its light is summed [pixel]: the core of the camera's point spread."""

_RING_WIDTH, _WIDENING = 0.5, 0.07  # of the disc's rings at the mirror direction [degree], and per degree from it
_RIM = 1.5  # distance of the outermost cells from the rim of the disc [pixel]
_SUBPIXELS = 6  # parts of a pixel's side for shares of pixels


@dataclass(frozen=True)
class Cells:
    """Directions of the cells about the mirror direction."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]  # ``fibre`` or ``disc``
    theta_s: Array  # degree
    phi_s: Array  # degree, 0 towards the normal of the sample
    solid_angle: Array  # steradian; NaN for fibres, whose description does not state it

    @property
    def of_disc(self) -> NDArray[np.bool_]:
        return np.array([kind == DISC for kind in self.kinds])


def cells_of(rig: Rig) -> Cells:
    """The cells of a rig: its fibres, then the disc in rings about the mirror direction; the same in every session."""
    count = len(rig.fibres)
    edges, per_ring = rings(rig.screen)
    theta, phi, solid_angle = [], [], []
    for low, high, number in zip(edges, edges[1:], per_ring, strict=False):
        middle, size = _mean_angle(np.radians(low), np.radians(high), 2 * np.pi / number)
        theta += [middle if number > 1 else 0.0] * number
        phi += [0.0] if number == 1 else list((np.arange(number) + 0.5) * 360 / number - 180)
        solid_angle += [size] * number
    return Cells(
        names=(*(fibre.name for fibre in rig.fibres), *(f"disc-{number}" for number in range(1, len(theta) + 1))),
        kinds=(FIBRE,) * count + (DISC,) * len(theta),
        theta_s=np.array([*(fibre.theta_s for fibre in rig.fibres), *theta]),
        phi_s=np.array([*(fibre.phi_s for fibre in rig.fibres), *phi]),
        solid_angle=np.array([np.nan] * count + solid_angle),
    )


def rings(screen: Screen) -> tuple[Array, list[int]]:
    """Edges of the rings of the disc [degree], and the number of about square cells in each.

    Of the described screen: that of a session would have other rings, and its cells would not be the etalon's.
    """
    rim = float(np.degrees(np.arctan((screen.disc_radius - _RIM / screen.scale) / screen.focal_length)))
    if rim <= _RING_WIDTH:
        return np.array([0.0, max(rim, 1e-6)]), [1]
    # Edges at which ∫ dϑ / width is half a ring, then whole rings.
    stretch = np.log1p(_WIDENING * rim / _RING_WIDTH)
    count = max(round(stretch / _WIDENING - 0.5), 1)
    fraction = np.concatenate([[0.0], (np.arange(count + 1) + 0.5) / (count + 0.5)])
    edges = (np.exp(fraction * stretch) - 1) * _RING_WIDTH / _WIDENING
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    per_ring = [max(round(2 * np.pi * radius / step), 1) for radius, step in zip(middle[1:], width[1:], strict=True)]
    return edges, [1, *per_ring]


def _mean_angle(low: float, high: float, turn: float) -> tuple[float, float]:
    """Angle of the mean direction [degree], and solid angle [sr], of a piece of a ring; edges and turn in radian.

    With the middle of the ring instead, light on the flank of a lobe would differ by a percent.
    """
    solid_angle = turn * (np.cos(low) - np.cos(high))
    # ∫∫ of sin ϑ cos φ and of cos ϑ over the piece, about its own azimuth.
    across = np.sin(turn / 2) * ((high - low) - (np.sin(2 * high) - np.sin(2 * low)) / 2)
    ahead = turn * (np.sin(high) ** 2 - np.sin(low) ** 2) / 2
    return float(np.degrees(np.arctan2(across, ahead))), float(solid_angle)


def weights(rig: Rig, screen: Screen) -> sparse.csr_array:
    """Share of each pixel in each cell of a rig, (cells, pixels by rows), for the screen of the registered session."""
    return sparse.csr_array(sparse.vstack([_fibre_weights(rig, screen), _disc_weights(rig, screen)]))


def cell_sums(weights: sparse.csr_array, pictures: Array) -> Array:
    """Sums of pictures (picture, y, x) over cells, (picture, cell)."""
    return np.asarray((weights @ pictures.reshape(len(pictures), -1).T).T, dtype=float)


def disk(camera: CameraSettings, column: float, row: float, radius: float) -> sparse.csr_array:
    """Share of each pixel within a radius [pixel] of a point of the picture, (1, pixels)."""
    height, width = camera.height, camera.width
    half_width = int(np.ceil(radius)) + 1
    x = np.arange(max(int(column) - half_width, 0), min(int(column) + half_width + 2, width))
    y = np.arange(max(int(row) - half_width, 0), min(int(row) + half_width + 2, height))
    inside = (_subpixels(y)[:, None] - row) ** 2 + (_subpixels(x) - column) ** 2 <= radius**2
    share = inside.reshape(y.size, _SUBPIXELS, x.size, _SUBPIXELS).mean(axis=(1, 3))
    pixel = y[:, None] * width + x
    lit = share > 0
    return sparse.csr_array((share[lit], (np.zeros(lit.sum(), dtype=int), pixel[lit])), shape=(1, height * width))


def fibre_radii(rig: Rig, screen: Screen) -> Array:
    """Radii [pixel] within which the light of the fibres is summed: a little larger than their ends, at most half way to the next."""
    column, row = _fibre_ends(rig, screen)
    distance = np.hypot(column[:, None] - column, row[:, None] - row)
    np.fill_diagonal(distance, np.inf)
    return np.minimum(screen.fibre_radius * screen.scale + BLUR, distance.min(axis=1) / 2)


def _fibre_weights(rig: Rig, screen: Screen) -> sparse.csr_array:
    spots = zip(*_fibre_ends(rig, screen), fibre_radii(rig, screen), strict=True)
    return sparse.vstack([disk(rig.camera, *map(float, spot)) for spot in spots])


def _fibre_ends(rig: Rig, screen: Screen) -> tuple[Array, Array]:
    """Columns and rows of the ends of the fibres."""
    return screens.to_pixel(screen, [fibre.x for fibre in rig.fibres], [fibre.y for fibre in rig.fibres])


def _disc_weights(rig: Rig, screen: Screen) -> sparse.csr_array:
    height, width = rig.camera.height, rig.camera.width
    columns, rows = _disc_pixels(screen, width, height)
    position = screens.to_position(screen, *np.meshgrid(_subpixels(columns), _subpixels(rows)))
    pixel = (rows.repeat(_SUBPIXELS)[:, None] * width + columns.repeat(_SUBPIXELS)).ravel()
    cell = _disc_cell(rig.screen, *screens.disc_direction(screen, position.x, position.y)).ravel()
    inside = cell >= 0
    share = np.full(int(inside.sum()), 1 / _SUBPIXELS**2)
    return sparse.csr_array((share, (cell[inside], pixel[inside])), shape=(sum(rings(rig.screen)[1]), height * width))


def _subpixels(pixels: NDArray[np.int64]) -> Array:
    """Centres of the parts of pixels along one axis."""
    return (pixels[:, None] + (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5).ravel()


def _disc_pixels(screen: Screen, width: int, height: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows that the disc spans."""
    corners = np.array([-1.0, 1.0]) * screen.disc_radius
    ends = screens.to_pixel(screen, screen.disc_centre[0] + corners, screen.disc_centre[1] + corners)
    # Radial distortion may bend the sides beyond the corners, hence the margin.
    columns, rows = (
        np.arange(max(int(end.min()) - 3, 0), min(int(end.max()) + 4, size), dtype=np.int64)
        for end, size in zip(ends, (width, height), strict=True)
    )
    return columns, rows


def _disc_cell(described: Screen, theta: Array, phi: Array) -> NDArray[np.int64]:
    """Number of the disc's cell in a direction; −1 outside the last ring."""
    edges, per_ring = rings(described)
    ring = np.searchsorted(edges, theta, side="right") - 1
    outside = ring >= len(per_ring)
    ring = np.where(outside, 0, ring)
    number = np.asarray(per_ring)[ring]
    before = np.concatenate([[0], np.cumsum(per_ring)])[ring]
    around = np.minimum(((phi + 180) / 360 * number).astype(int), number - 1)
    return np.where(outside, -1, before + around)

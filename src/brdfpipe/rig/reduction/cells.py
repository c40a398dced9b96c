"""The cells a picture is read in: the ends of the fibres, and pieces of the disc.

One sparse matrix, of cells by pixels, holds which share of each pixel belongs to which cell; it is made once for a session and then
sums any number of pictures at the price of one product.
"""

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
"""How far beyond the image of a spot its light is gathered [pixel]: what the core of the camera's point spread reaches."""

_FINEST, _WIDENING = 0.5, 0.07
"""Width of the rings of the disc: at the mirror direction [degree], and how much wider per degree from it."""

_INSIDE = 1.5
"""How far from the rim of the disc its cells end [pixel]."""

_SUB = 6
"""Parts of a pixel's side for shares of pixels."""


@dataclass(frozen=True)
class Cells:
    """Where each cell looks from, about the mirror direction."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    """``fibre`` or ``disc``."""
    theta_s: Array
    """Degree."""
    phi_s: Array
    """Degree, 0 towards the normal of the sample."""
    solid_angle: Array
    """Steradian; NaN of a fibre, of which the description does not say it."""

    @property
    def of_disc(self) -> NDArray[np.bool_]:
        return np.array([kind == DISC for kind in self.kinds])


def cells_of(rig: Rig) -> Cells:
    """The cells of a rig: its fibres, then the disc in rings about the mirror direction; the same in every session."""
    count = len(rig.fibres)
    edges, per_ring = rings(rig.screen)
    theta, phi, solid_angle = [], [], []
    for low, high, number in zip(edges, edges[1:], per_ring, strict=False):
        middle, each = _piece(np.radians(low), np.radians(high), 2 * np.pi / number)
        theta += [middle if number > 1 else 0.0] * number
        phi += [0.0] if number == 1 else list((np.arange(number) + 0.5) * 360 / number - 180)
        solid_angle += [each] * number
    return Cells(
        names=(*(fibre.name for fibre in rig.fibres), *(f"disc-{number}" for number in range(1, len(theta) + 1))),
        kinds=(FIBRE,) * count + (DISC,) * len(theta),
        theta_s=np.array([*(fibre.theta_s for fibre in rig.fibres), *theta]),
        phi_s=np.array([*(fibre.phi_s for fibre in rig.fibres), *phi]),
        solid_angle=np.array([np.nan] * count + solid_angle),
    )


def rings(screen: Screen) -> tuple[Array, list[int]]:
    """Edges of the rings of the disc [degree], and the number of cells in each; about as wide as they are long.

    They are those of the description. A session's own screen would make other rings, and its cells would not be the etalon's.
    """
    rim = float(np.degrees(np.arctan((screen.disc_radius - _INSIDE / screen.scale) / screen.focal_length)))
    if rim <= _FINEST:
        return np.array([0.0, max(rim, 1e-6)]), [1]
    # Edges at which ∫ dϑ / width is half a ring, then whole rings.
    count = max(round(np.log1p(_WIDENING * rim / _FINEST) / _WIDENING - 0.5), 1)
    place = np.concatenate([[0.0], (np.arange(count + 1) + 0.5) / (count + 0.5)])
    edges = (np.exp(place * np.log1p(_WIDENING * rim / _FINEST)) - 1) * _FINEST / _WIDENING
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    around = [max(round(2 * np.pi * each / wide), 1) for each, wide in zip(middle[1:], width[1:], strict=True)]
    return edges, [1, *around]


def _piece(low: float, high: float, turn: float) -> tuple[float, float]:
    """Angle of the mean direction [degree], and solid angle, of a piece of a ring; edges and the turn about it in radian.

    The mean direction of all light of a cell, and not the middle of its ring: on the flank of a lobe the two differ by a percent.
    """
    solid_angle = turn * (np.cos(low) - np.cos(high))
    # ∫∫ of sin ϑ cos φ and of cos ϑ over the piece, about its own azimuth.
    across = np.sin(turn / 2) * ((high - low) - (np.sin(2 * high) - np.sin(2 * low)) / 2)
    ahead = turn * (np.sin(high) ** 2 - np.sin(low) ** 2) / 2
    return float(np.degrees(np.arctan2(across, ahead))), float(solid_angle)


def weights(rig: Rig, screen: Screen) -> sparse.csr_array:
    """Share of each pixel in each cell, (cells, pixels by rows).

    Parameters
    ----------
    rig : what the cells are
    screen : where they are in these pictures; of a registered session, not of the description
    """
    return sparse.csr_array(sparse.vstack([_fibres(rig, screen), _disc(rig, screen)]))


def cell_sums(weights: sparse.csr_array, pictures: Array) -> Array:
    """Sums of pictures (picture, y, x) over cells, (picture, cell)."""
    return np.asarray((weights @ pictures.reshape(len(pictures), -1).T).T, dtype=float)


def disk(camera: CameraSettings, column: float, row: float, radius: float) -> sparse.csr_array:
    """Share of each pixel within a radius [pixel] of a point of the picture, (1, pixels)."""
    height, width = camera.height, camera.width
    reach = int(np.ceil(radius)) + 1
    x = np.arange(max(int(column) - reach, 0), min(int(column) + reach + 2, width))
    y = np.arange(max(int(row) - reach, 0), min(int(row) + reach + 2, height))
    part = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    dx = ((x[:, None] + part).ravel() - column) ** 2
    dy = ((y[:, None] + part).ravel() - row) ** 2
    share = (dy[:, None] + dx <= radius**2).reshape(y.size, _SUB, x.size, _SUB).mean(axis=(1, 3))
    pixel = y[:, None] * width + x
    kept = share > 0
    return sparse.csr_array((share[kept], (np.zeros(kept.sum(), dtype=int), pixel[kept])), shape=(1, height * width))


def fibre_radii(rig: Rig, screen: Screen) -> Array:
    """Radii [pixel] within which the light of the fibres is gathered: a little larger than their ends, but up to no other's."""
    column, row = _ends(rig, screen)
    distance = np.hypot(column[:, None] - column, row[:, None] - row)
    np.fill_diagonal(distance, np.inf)
    return np.minimum(screen.fibre_radius * screen.scale + BLUR, distance.min(axis=1) / 2)


def _fibres(rig: Rig, screen: Screen) -> sparse.csr_array:
    spots = zip(*_ends(rig, screen), fibre_radii(rig, screen), strict=True)
    return sparse.vstack([disk(rig.camera, *map(float, spot)) for spot in spots])


def _ends(rig: Rig, screen: Screen) -> tuple[Array, Array]:
    """Columns and rows of the ends of the fibres."""
    return screens.to_pixel(screen, [fibre.x for fibre in rig.fibres], [fibre.y for fibre in rig.fibres])


def _disc(rig: Rig, screen: Screen) -> sparse.csr_array:
    height, width = rig.camera.height, rig.camera.width
    across, down = _about_disc(screen, width, height)
    part = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    place = screens.to_position(screen, *np.meshgrid((across[:, None] + part).ravel(), (down[:, None] + part).ravel()))
    pixel = (down.repeat(_SUB)[:, None] * width + across.repeat(_SUB)).ravel()
    cell = _disc_cell(rig.screen, *screens.disc_direction(screen, place.x, place.y)).ravel()
    inside = cell >= 0
    share = np.full(int(inside.sum()), 1 / _SUB**2)
    return sparse.csr_array((share, (cell[inside], pixel[inside])), shape=(sum(rings(rig.screen)[1]), height * width))


def _about_disc(screen: Screen, width: int, height: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows among which the disc lies."""
    corners = np.array([-1.0, 1.0]) * screen.disc_radius
    column, row = screens.to_pixel(screen, screen.disc[0] + corners, screen.disc[1] + corners)
    # The middles of its sides may bulge beyond its corners by what the radial term does.
    across, down = (
        np.arange(max(int(ends.min()) - 3, 0), min(int(ends.max()) + 4, size), dtype=np.int64)
        for ends, size in ((column, width), (row, height))
    )
    return across, down


def _disc_cell(described: Screen, theta: Array, phi: Array) -> NDArray[np.int64]:
    """Number of the disc's cell a direction lies in; −1 outside the last ring."""
    edges, per_ring = rings(described)
    ring = np.searchsorted(edges, theta, side="right") - 1
    outside = ring >= len(per_ring)
    ring = np.where(outside, 0, ring)
    number = np.asarray(per_ring)[ring]
    before = np.concatenate([[0], np.cumsum(per_ring)])[ring]
    around = np.minimum(((phi + 180) / 360 * number).astype(int), number - 1)
    return np.where(outside, -1, before + around)

"""Where things really are in the pictures of a session: ends of fibres by their centroids, the disc by an angular target.

A camera that was touched, or a bench that warmed up, shifts the whole picture by a fraction of a pixel; half a tenth of a degree on
the disc is seven percent on the flank of a narrow lobe. Shift, scale and radial term follow from the spots of the fibres and of the
reference; where on the screen the mirror direction falls, and the focal length, from a target whose spots stand in known directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from brdfpipe import specular_directions
from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen

DIRECTION_U = 0.1
"""Standard uncertainty [degree], along either axis, of the direction of the disc's centre where no target was looked at."""

SCALE_U = 0.01
"""Relative standard uncertainty of angles on the disc where no target was looked at: at its rim of 10 degree that of its centre."""

FIBRES_ENOUGH = 12
"""Spots from which scale and radial term can be told beside the shift."""

_LONE = 0.2
"""Standard uncertainty of a shift [pixel] told by few spots, whose places hang on a scale and a radial term as described."""

_LOST = 0.5
"""Standard uncertainty of where the picture lies [pixel] that no spot tells."""

_LEAST_TARGET = 3

_SEARCH = 4
"""How far from where it should be a spot is looked for [pixel]."""

_CLEAR = 25.0
"""A spot is used if its light is so many times its uncertainty."""

_UNEVEN = 0.02
"""Standard deviation [pixel] that a sensor of uneven response adds to a centroid."""

_ROUNDS = 3

_INSIDE = 4.0
"""Distance from the rim of the disc within which its light is not even [pixel]."""

_LEAST_KEPT = 0.05
"""Share of the light, of that in the middle of the disc, below which no lens is taken to fall."""


@dataclass(frozen=True)
class Registration:
    """Where the screen lies in the pictures, and how well that is known."""

    screen: Screen
    shift_u: float
    """Standard uncertainty, along either axis, of where a cell is in the picture [pixel]."""
    direction_u: float
    """Standard uncertainty, along either axis, of the direction that falls on the disc's centre [degree]."""
    spots: int
    """Spots used."""
    scale_u: float = SCALE_U
    """Relative standard uncertainty of all angles on the disc together: of the focal length."""
    blur: float = 0.0
    """Standard deviation of the core of the camera's point spread, as the spots show it [pixel]."""

    def shift(self, rig: Rig) -> tuple[float, float]:
        """Of the screen's origin against the description (column, row) [pixel]."""
        return self.screen.centre[0] - rig.screen.centre[0], self.screen.centre[1] - rig.screen.centre[1]


@dataclass(frozen=True)
class Centroids:
    """Where spots were found."""

    column: Array
    row: Array
    u: Array
    """Standard uncertainty along either [pixel]; infinite where no spot was clear."""
    variance: Array
    """Mean square distance of the light from the centroid along either axis [pixel²]."""


def centroids(picture: Array, variance: Array, column: ArrayLike, row: ArrayLike, radius: float) -> Centroids:
    """Centroids of spots near the places given.

    Parameters
    ----------
    picture, variance : (y, x), finite
    column, row : where to look [pixel], (spot,)
    radius : of a spot [pixel]

    Notes
    -----
    The window follows the spot in three steps; the median of a ring about it is taken for background. A spot whose window leaves the
    picture, or that wanders off, is not clear.
    """
    start = x, y = np.ravel(np.asarray(column, dtype=float)), np.ravel(np.asarray(row, dtype=float))
    clear, u, wide = np.ones(x.shape, dtype=bool), np.full(x.shape, np.inf), np.zeros(x.shape)
    reach = int(np.ceil(radius)) + _SEARCH
    steps = np.arange(-reach, reach + 1)
    height, width = picture.shape
    for _ in range(_ROUNDS):
        left, top = np.rint(np.where(clear, x, 0.0)).astype(int), np.rint(np.where(clear, y, 0.0)).astype(int)
        clear &= (left >= reach) & (top >= reach) & (left < width - reach) & (top < height - reach)
        columns = np.where(clear, left, reach)[:, None, None] + steps
        rows = np.where(clear, top, reach)[:, None, None] + steps[:, None]
        dx, dy = columns - x[:, None, None], rows - y[:, None, None]
        distance = np.hypot(dx, dy)
        inside = distance <= radius + 2
        ring = np.where(~inside & (distance <= radius + _SEARCH), picture[rows, columns], np.nan)
        clear &= np.isfinite(ring).any(axis=(1, 2))
        ring[~clear] = 0.0
        light = np.where(inside, picture[rows, columns] - np.nanmedian(ring, axis=(1, 2))[:, None, None], 0.0)
        noise = np.where(inside, variance[rows, columns], 0.0)
        total = light.sum(axis=(1, 2))
        clear &= total > _CLEAR * np.sqrt(noise.sum(axis=(1, 2)))
        total = np.where(clear, total, 1.0)
        step = (light * dx).sum(axis=(1, 2)) / total, (light * dy).sum(axis=(1, 2)) / total
        wide = ((light * distance**2).sum(axis=(1, 2)) / total - step[0] ** 2 - step[1] ** 2) / 2
        x, y = x + step[0], y + step[1]
        u = np.sqrt((noise * distance**2 / 2).sum(axis=(1, 2))) / total
        clear &= np.hypot(x - start[0], y - start[1]) <= _SEARCH
    return Centroids(np.where(clear, x, start[0]), np.where(clear, y, start[1]), np.where(clear, u, np.inf), wide)


def register(rig: Rig, picture: Array, variance: Array, screen: Screen | None = None) -> Registration:
    """Fit where the screen lies to the spots of the fibres and of the reference.

    Parameters
    ----------
    picture, variance : (y, x), a mean over wavelengths; finite
    screen : if given, scale and radial term are as here, and only the shift is fitted; by default as described to begin with, and
        fitted if enough spots are seen
    """
    known = screen is not None
    screen = screen or rig.screen
    x = np.array([*(fibre.x for fibre in rig.fibres), screen.reference[0]])
    y = np.array([*(fibre.y for fibre in rig.fibres), screen.reference[1]])
    radius = np.append(np.full(len(rig.fibres), screen.fibre_radius), screen.reference_radius) * screen.scale
    column, row = screens.to_pixel(screen, x, y)
    fibres = centroids(picture, variance, column[:-1], row[:-1], radius[0])
    lamp = centroids(picture, variance, column[-1:], row[-1:], radius[-1])
    seen = [np.append(getattr(fibres, name), getattr(lamp, name)) for name in ("column", "row", "u", "variance")]
    used = np.isfinite(seen[2])
    if not used.any():
        return Registration(screen, _LOST, DIRECTION_U, 0)
    u = np.hypot(seen[2][used], _UNEVEN)
    whole = not known and used.sum() >= FIBRES_ENOUGH

    def moved(by: Array) -> Screen:
        dx, dy, stretch, bend = np.pad(by, (0, 4 - by.size))
        centre = (screen.centre[0] + dx, screen.centre[1] + dy)
        # The last two in units that make a pixel at the rim: a per mille of scale, 1e-7 of the radial term.
        return replace(
            screen, centre=centre, scale=screen.scale * (1 + 1e-3 * stretch), radial=screen.radial + 1e-7 * bend
        )

    def misses(by: Array) -> Array:
        column, row = screens.to_pixel(moved(by), x[used], y[used])
        return np.concatenate([(column - seen[0][used]) / u, (row - seen[1][used]) / u])

    by, u_of = _fitted(misses, 4 if whole else 2)
    shift_u = _of_shift(u_of)
    # A disc of radius R has R²/4 along either axis, a pixel 1/12.
    blur = float(np.sqrt(max(np.median(seen[3][used] - radius[used] ** 2 / 4) - 1 / 12, 0.0)))
    if not (known or whole):
        shift_u = float(np.hypot(shift_u, _LONE))
    return Registration(moved(by), shift_u, DIRECTION_U, int(used.sum()), blur=blur)


def falloff(found: Registration, picture: Array, entrance: float) -> Array:
    """What lens and camera keep of the light of a direction, (y, x), smooth and 1 in the disc's centre, told by the etalon.

    Parameters
    ----------
    found : the registration of the picture
    picture : (y, x), of the etalon lit through the entrance [degree]; finite

    Notes
    -----
    A polynomial of the second degree of place, of the light over the etalon's cosine; its other changes over twenty degrees are none
    beside a lens'. Beyond the disc it is that of the rim.
    """
    screen = found.screen
    row, column = np.indices(picture.shape)
    place = screens.to_position(screen, column, row)
    x, y = (place.x - screen.disc[0]) / screen.disc_radius, (place.y - screen.disc[1]) / screen.disc_radius
    radius = np.hypot(x, y)
    inside = radius < 1 - _INSIDE / (screen.scale * screen.disc_radius)
    cosine = specular_directions.cos_view_etalon(entrance, *screens.disc_direction(screen, place.x, place.y))
    shrink = 1 / np.maximum(radius, 1.0)
    terms = np.stack([np.ones_like(x), x * shrink, y * shrink, *(shrink**2 * each for each in (x * x, x * y, y * y))])
    lit = inside & (cosine > 0)
    shares = np.linalg.lstsq(terms[:, lit].T, picture[lit] / cosine[lit], rcond=None)[0]
    # Without light there is nothing to tell.
    return np.maximum(np.tensordot(shares / shares[0], terms, 1), _LEAST_KEPT) if shares[0] > 0 else np.ones_like(x)


def centre_disc(
    found: Registration,
    picture: Array,
    variance: Array,
    theta_s: ArrayLike,
    phi_s: ArrayLike,
    radius: float,
    kept: Array | None = None,
) -> Registration:
    """Fit where the disc's centre is, and the focal length, to the spots of an angular target.

    Parameters
    ----------
    found : the registration of the pictures of the target
    picture, variance : (y, x), finite
    theta_s, phi_s : directions of the target's spots [degree]
    radius : of a spot [degree]
    kept : (y, x) :func:`falloff`, if known; it draws centroids inwards as a shorter focal length does, by 0.02 % of it where the rim of
        10 degree keeps 0.7 of the light and spots have a radius of 0.3 degree
    """
    screen = found.screen
    theta, phi = np.asarray(theta_s, dtype=float), np.asarray(phi_s, dtype=float)
    pixels = float(np.radians(radius)) * screen.focal_length * screen.scale
    seen = centroids(picture, variance, *screens.to_pixel(screen, *screens.disc_position(screen, theta, phi)), pixels)
    used = np.isfinite(seen.u)
    if used.sum() < _LEAST_TARGET:
        return found
    u = np.hypot(seen.u[used], _UNEVEN)
    drawn = np.zeros((2, int(used.sum())))
    if kept is not None:
        # Light that changes by a share g a pixel moves the centroid of a disc by g R²/4.
        at = np.rint(seen.row[used]).astype(int), np.rint(seen.column[used]).astype(int)
        drawn = pixels**2 / 4 * np.array([each[at] for each in np.gradient(np.log(kept))])

    def moved(by: Array) -> Screen:
        disc = (screen.disc[0] + by[0], screen.disc[1] + by[1])
        return replace(screen, disc=disc, focal_length=screen.focal_length * (1 + 1e-2 * by[2]))

    def misses(by: Array) -> Array:
        trial = moved(by)
        column, row = screens.to_pixel(trial, *screens.disc_position(trial, theta[used], phi[used]))
        column, row = column + drawn[1], row + drawn[0]
        return np.concatenate([(column - seen.column[used]) / u, (row - seen.row[used]) / u])

    by, u_of = _fitted(misses, 3)
    # So many spots tell by how far they miss what one is uncertain by, and better than what any sensor may add.
    missed = misses(by)
    scatter = np.sqrt((missed**2).sum() / max(missed.size - by.size, 1))
    millimetres, scale_u = _of_shift(u_of), 1e-2 * float(u_of[2] * min(scatter, 1.0))
    shift = found.shift_u / screen.scale
    direction_u = float(np.degrees(np.arctan(np.hypot(millimetres, shift) / screen.focal_length)))
    return replace(found, screen=moved(by), direction_u=direction_u, scale_u=scale_u)


def _fitted(misses: Callable[[Array], Array], free: int) -> tuple[Array, Array]:
    """Robust least squares from nought, and the standard uncertainty of each parameter."""
    fit = optimize.least_squares(misses, np.zeros(free), loss="soft_l1", f_scale=3.0)
    jacobian = np.asarray(fit.jac, dtype=float)
    variance = np.diag(np.linalg.pinv(jacobian.T @ jacobian))
    spread = max(1.0, float(np.median(np.abs(fit.fun))) / 0.6745) if fit.fun.size > 2 * free else 1.0
    return np.asarray(fit.x), spread * np.sqrt(np.maximum(variance, 0.0))


def _of_shift(u: Array) -> float:
    """Standard uncertainty of a shift along either axis, the first two parameters."""
    return float(np.sqrt((u[:2] ** 2).mean()))

"""What each pixel of the camera looks at: directions about the mirror direction, through the disc and the ends of the fibres.

The screen is where it truly is, which is not quite where the description has it. A picture of any pattern of light is then one
product of a sparse matrix: pixels × directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe import specular_directions
from brdfpipe.geometry import Array, angles_of, unit_vector
from brdfpipe.rig import screen
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.emulator.effects import Effects, stream

Indices = NDArray[np.intp]

_CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) / np.sqrt(12)
"""Gauss's rule of 2 × 2 points on a pixel: exact where the lobe is a polynomial of degree 3."""

_RING = np.array([0.25, *np.full(6, 0.125)])
"""Rule of 7 points on a circle, its middle and six at √(2/3) of its radius: exact for polynomials of degree 5."""


@dataclass(frozen=True)
class View:
    """Directions that reach the camera, and the pixels they light.

    theta_s, phi_s : (directions,), about the mirror direction [degree]
    matrix : (lit pixels, directions), light of a pixel over f cos γ of the directions, 1 in the middle of the disc
    pixels : (lit pixels,), their place in the flattened picture
    reference : (height, width), light of the reference spot over that in its middle
    """

    theta_s: Array
    phi_s: Array
    matrix: sparse.csr_array
    pixels: Indices
    reference: Array


def true_screen(rig: Rig, effects: Effects, seed: int, session: int) -> Screen:
    """The screen as it is in a session."""
    described = rig.screen
    azimuth, side = stream(seed, "screen").uniform(-1, 1, 2) * [np.pi, 1]
    away = described.focal_length * np.tan(np.radians(effects.disc_offset))
    shift = effects.registration * stream(seed, "registration", session).standard_normal(2)
    return replace(
        described,
        disc=(described.disc[0] + away * np.cos(azimuth), described.disc[1] + away * np.sin(azimuth)),
        radial=described.radial + float(np.copysign(effects.radial_error, side)),
        centre=(described.centre[0] + float(shift[0]), described.centre[1] + float(shift[1])),
    )


def view(rig: Rig, effects: Effects, seed: int, session: int) -> View:
    """What the camera of a rig sees in a session."""
    true = true_screen(rig, effects, seed, session)
    shape = rig.camera.height, rig.camera.width
    corners = _camera_vignetting(shape, effects)
    on_disc, disc = _disc(true, shape, effects)
    of_fibres, fibres = _fibres(rig, true, shape, effects, seed)
    theta_s, phi_s = np.concatenate([on_disc, of_fibres], axis=1)
    whole = sparse.csr_array(sparse.diags_array(corners.ravel()) @ sparse.hstack([disc, fibres]))
    lit = np.flatnonzero(np.diff(whole.indptr))
    reference = np.zeros(corners.size)
    spot = _spots(true, shape, np.array([true.reference]), true.reference_radius)
    reference[spot.pixel] = spot.covered
    return View(theta_s, phi_s, whole[lit], lit, reference.reshape(shape) * corners)


def hidden(
    rig: Rig, effects: Effects, entrance: float, theta_s: Array, phi_s: Array, *, through: bool
) -> NDArray[np.bool_]:
    """Whether nothing comes from directions, because an entrance is there.

    Parameters
    ----------
    entrance : the one the light comes through [degree]
    theta_s, phi_s : about the fixed direction [degree]; the entrance of incidence σ is 2σ from it, at φ = 0
    through : the light passes the sample, and so comes from behind

    Notes
    -----
    The lens lies in the fixed direction: an entrance so near to it has its mirror moved out of the lens' sight while another is used.
    """
    rim = np.degrees(np.arctan(rig.screen.disc_radius / rig.screen.focal_length)) + effects.holes
    holes = {each for each in rig.entrances if 2 * each > rim} | (set() if through else {entrance})
    found = np.zeros(theta_s.shape, dtype=bool)
    for each in holes if effects.holes else ():
        # Towards an entrance the etalon's normal points when it is lit through it.
        found |= specular_directions.cos_view_etalon(each, theta_s, phi_s) > np.cos(np.radians(effects.holes))
    return found


@dataclass(frozen=True)
class _Spots:
    """Which spot lights which pixel, and how much of the pixel it covers."""

    owner: Indices
    pixel: Indices
    covered: Array


def _disc(true: Screen, shape: tuple[int, int], effects: Effects) -> tuple[Array, sparse.coo_array]:
    """Directions (2, n) seen through the disc, and the pixels they light."""
    spot = _spots(true, shape, np.array([true.disc]), true.disc_radius)
    row, column = np.divmod(spot.pixel, shape[1])
    places = screen.to_place(true, column[:, None] + _CORNERS[:, 0], row[:, None] + _CORNERS[:, 1])
    theta_s, phi_s = screen.disc_direction(true, *places)
    rim = np.degrees(np.arctan(true.disc_radius / true.focal_length))
    lens = np.maximum(0.0, 1 - effects.vignetting * (theta_s / rim) ** 2)
    weight = (
        spot.covered[:, None] / len(_CORNERS) * true.focal_length**2 * screen.disc_solid_angle(true, theta_s) * lens
    )
    count = weight.size
    matrix = sparse.coo_array(
        (weight.ravel(), (np.repeat(spot.pixel, len(_CORNERS)), np.arange(count))), shape=(shape[0] * shape[1], count)
    )
    return np.stack([theta_s.ravel(), phi_s.ravel()]), matrix


def _fibres(
    rig: Rig, true: Screen, shape: tuple[int, int], effects: Effects, seed: int
) -> tuple[Array, sparse.coo_array]:
    """Directions (2, n) seen by the fibres, and the pixels they light."""
    efficiency = fibre_efficiency(len(rig.fibres), effects, seed)
    spots = _spots(true, shape, np.array([[fibre.x, fibre.y] for fibre in rig.fibres]), true.fibre_radius)
    light = spots.covered * efficiency[spots.owner]
    points = len(_RING)
    matrix = sparse.coo_array(
        (
            (light[:, None] * _RING).ravel(),
            (np.repeat(spots.pixel, points), (points * spots.owner[:, None] + np.arange(points)).ravel()),
        ),
        shape=(shape[0] * shape[1], points * len(rig.fibres)),
    )
    theta = np.array([fibre.theta_s for fibre in rig.fibres])
    phi = np.array([fibre.phi_s for fibre in rig.fibres])
    return np.stack([angle.ravel() for angle in _field(theta, phi, effects.fibre_field)]), matrix


def fibre_efficiency(count: int, effects: Effects, seed: int) -> Array:
    """Efficiency of each fibre over the mean; 0 of a dead one."""
    efficiency = 1 + effects.fibres * stream(seed, "fibres").uniform(-1, 1, count)
    efficiency[stream(seed, "dead fibres").permutation(count)[: round(effects.dead_fibres * count)]] = 0.0
    return efficiency


def _field(theta: Array, phi: Array, radius: float) -> tuple[Array, Array]:
    """Directions (n, 7) of the points of :data:`_RING` about directions (n,)."""
    ahead, up, across = unit_vector(theta, phi), unit_vector(theta + 90, phi), unit_vector(90.0, phi + 90)
    turn = np.radians(60.0 * np.arange(6))[:, None]
    ring = np.cos(turn) * up[:, None] + np.sin(turn) * across[:, None]
    around = ahead[:, None] + np.tan(np.radians(np.sqrt(2 / 3) * radius)) * ring
    return angles_of(np.concatenate([ahead[:, None], around], axis=1))


def _camera_vignetting(shape: tuple[int, int], effects: Effects) -> Array:
    row, column = (np.arange(size) - (size - 1) / 2 for size in shape)
    square = row[:, None] ** 2 + column**2
    return 1 - effects.vignetting * square / square.max()


def _spots(true: Screen, shape: tuple[int, int], places: Array, radius: float) -> _Spots:
    """Round spots of one radius [mm] at places (n, 2) of the screen [mm], as they lie on the pixels."""
    column, row = screen.to_pixel(true, places[:, 0], places[:, 1])
    size = radius * true.scale * (1 + true.radial * (places**2).sum(axis=1))
    reach = int(np.ceil(size.max())) + 1
    box = np.arange(-reach, reach + 1)
    columns = np.rint(column).astype(int)[:, None, None] + box
    rows = np.rint(row).astype(int)[:, None, None] + box[:, None]
    covered = overlap(columns - column[:, None, None], rows - row[:, None, None], size[:, None, None])
    seen = (covered > 0) & (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    owner = np.broadcast_to(np.arange(len(places))[:, None, None], seen.shape)
    return _Spots(owner[seen], (rows * shape[1] + columns)[seen], covered[seen])


def overlap(x: Array, y: Array, radius: Array | float) -> Array:
    """Area that a circle about the origin has in common with the unit square about (x, y), exactly."""
    corners = ((x + i, y + j) for i in (-0.5, 0.5) for j in (-0.5, 0.5))
    low_low, low_high, high_low, high_high = (_quadrant(u, v, radius) for u, v in corners)
    # Differences of areas: what is left over of nothing is rounding.
    area = high_high - high_low - low_high + low_low
    return np.where(area > 1e-9, np.minimum(area, 1.0), 0.0)


def _quadrant(x: Array, y: Array, radius: Array | float) -> Array:
    """Area of a circle about the origin to the left of x and below y.

    Notes
    -----
    With s(u) = √(R² − u²) it is ∫ s + min(y, s) du for y > 0, ∫ max(s + y, 0) du else, from −R to x; the line y meets the circle at ±c.
    """
    radius, y = np.broadcast_arrays(np.asarray(radius, dtype=float), np.clip(y, -radius, radius))
    x = np.clip(x, -radius, radius)
    c = np.sqrt(radius**2 - y**2)

    def under(u: Array) -> Array:
        return (u * np.sqrt(np.maximum(radius**2 - u**2, 0)) + radius**2 * np.arcsin(u / radius)) / 2

    def between(low: Array, high: Array) -> Array:
        return under(np.clip(x, low, high)) - under(low)

    middle, chord = between(-c, c), y * (np.clip(x, -c, c) + c)
    whole = between(-radius, radius)
    return np.where(y > 0, 2 * whole - middle + chord, middle + chord)

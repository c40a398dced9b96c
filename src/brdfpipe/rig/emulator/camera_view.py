"""Directions about the mirror direction that each pixel of the camera sees, through the disc and the fibres.

The true position of the screen differs slightly from the description. An image of any light distribution is one product with a sparse matrix,
pixels × directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe import specular_directions
from brdfpipe.geometry import Array, angles_of, unit_vector
from brdfpipe.rig import screen
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.emulator.effects import Effects, random_stream

Indices = NDArray[np.intp]

_PIXEL_NODES = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) / np.sqrt(12)
"""Nodes of the 2 × 2 Gauss rule on a pixel: exact for polynomials of degree 3."""

_CIRCLE_WEIGHTS = np.array([0.25, *np.full(6, 0.125)])
"""Weights of a 7-point rule on a disc, its centre and six nodes at √(2/3) of its radius: exact to degree 5."""


@dataclass(frozen=True)
class CameraView:
    """Directions that the camera sees, and the pixels they illuminate.

    theta_s, phi_s : (directions,), about the mirror direction [degree]
    matrix : (illuminated pixels, directions), light of a pixel relative to BRDF × cos γ of the directions, 1 in the middle of the disc
    pixels : (illuminated pixels,), indices into the flattened image
    reference : (height, width), light of the reference spot relative to its middle
    """

    theta_s: Array
    phi_s: Array
    matrix: sparse.csr_array
    pixels: Indices
    reference: Array


def true_screen(rig: Rig, effects: Effects, seed: int, session: int) -> Screen:
    """True position and distortion of the screen in a session."""
    described = rig.screen
    azimuth, sign = random_stream(seed, "screen").uniform(-1, 1, 2) * [np.pi, 1]
    x, y = described.disc_centre
    offset = described.focal_length * np.tan(np.radians(effects.disc_offset))
    shift = effects.registration * random_stream(seed, "registration", session).standard_normal(2)
    return replace(
        described,
        disc_centre=(x + offset * np.cos(azimuth), y + offset * np.sin(azimuth)),
        radial=described.radial + float(np.copysign(effects.radial_error, sign)),
        centre=(described.centre[0] + float(shift[0]), described.centre[1] + float(shift[1])),
    )


def camera_view(rig: Rig, effects: Effects, seed: int, session: int) -> CameraView:
    """View of the camera in a session."""
    true = true_screen(rig, effects, seed, session)
    shape = rig.camera.height, rig.camera.width
    vignetting = _camera_vignetting(shape, effects)
    disc_directions, disc = _disc(true, shape, effects)
    fibre_directions, fibres = _fibres(rig, true, shape, effects, seed)
    theta_s, phi_s = np.concatenate([disc_directions, fibre_directions], axis=1)
    matrix = sparse.csr_array(sparse.diags_array(vignetting.ravel()) @ sparse.hstack([disc, fibres]))
    illuminated = np.flatnonzero(np.diff(matrix.indptr))
    reference = np.zeros(vignetting.size)
    spot = _spots(true, shape, np.array([true.reference_centre]), true.reference_radius)
    reference[spot.pixel] = spot.coverage
    return CameraView(theta_s, phi_s, matrix[illuminated], illuminated, reference.reshape(shape) * vignetting)


def in_entrance_hole(
    rig: Rig, effects: Effects, entrance: float, theta_s: Array, phi_s: Array, *, transmission: bool
) -> NDArray[np.bool_]:
    """Whether directions point to an entrance, which returns no light.

    The lens is in the mirror direction. The mirror of an entrance close to it is moved out of the field of view while another entrance is in use.

    Parameters
    ----------
    entrance : in use [degree]
    theta_s, phi_s : about the mirror direction [degree]; the entrance of incidence σ is at ϑ = 2σ, φ = 0
    transmission : the entrance in use is behind the sample
    """
    rim = np.degrees(np.arctan(rig.screen.disc_radius / rig.screen.focal_length)) + effects.holes
    holes = {sigma for sigma in rig.entrances if 2 * sigma > rim} | (set() if transmission else {entrance})
    inside = np.zeros(theta_s.shape, dtype=bool)
    for sigma in holes if effects.holes else ():
        # The normal of the etalon points to the entrance that illuminates it.
        inside |= specular_directions.cos_view_etalon(sigma, theta_s, phi_s) > np.cos(np.radians(effects.holes))
    return inside


class _Spots(NamedTuple):
    """Pairs of a spot and a pixel it illuminates, and the covered share of the pixel."""

    spot: Indices
    pixel: Indices
    coverage: Array


def _disc(true: Screen, shape: tuple[int, int], effects: Effects) -> tuple[Array, sparse.coo_array]:
    """Directions (2, n) seen through the disc, and matrix to the pixels (pixels, n)."""
    spot = _spots(true, shape, np.array([true.disc_centre]), true.disc_radius)
    row, column = np.divmod(spot.pixel, shape[1])
    positions = screen.to_position(true, column[:, None] + _PIXEL_NODES[:, 0], row[:, None] + _PIXEL_NODES[:, 1])
    theta_s, phi_s = screen.disc_direction(true, *positions)
    rim = np.degrees(np.arctan(true.disc_radius / true.focal_length))
    lens = np.maximum(0.0, 1 - effects.vignetting * (theta_s / rim) ** 2)
    share = spot.coverage[:, None] / len(_PIXEL_NODES) * true.focal_length**2
    weight = share * screen.disc_solid_angle(true, theta_s) * lens
    pixels, directions = np.repeat(spot.pixel, len(_PIXEL_NODES)), np.arange(weight.size)
    matrix = sparse.coo_array((weight.ravel(), (pixels, directions)), shape=(shape[0] * shape[1], weight.size))
    return np.stack([theta_s.ravel(), phi_s.ravel()]), matrix


def _fibres(
    rig: Rig, true: Screen, shape: tuple[int, int], effects: Effects, seed: int
) -> tuple[Array, sparse.coo_array]:
    """Directions (2, n) seen by the fibres, and matrix to the pixels (pixels, n)."""
    efficiency = fibre_efficiency(len(rig.fibres), effects, seed)
    spots = _spots(true, shape, np.array([[fibre.x, fibre.y] for fibre in rig.fibres]), true.fibre_radius)
    light = spots.coverage * efficiency[spots.spot]
    nodes = len(_CIRCLE_WEIGHTS)
    weight = (light[:, None] * _CIRCLE_WEIGHTS).ravel()
    pixels, directions = np.repeat(spots.pixel, nodes), (nodes * spots.spot[:, None] + np.arange(nodes)).ravel()
    size = shape[0] * shape[1], nodes * len(rig.fibres)
    matrix = sparse.coo_array((weight, (pixels, directions)), shape=size)
    theta, phi = fibre_directions(rig, effects, seed)
    return np.stack([angle.ravel() for angle in _field_nodes(theta, phi, effects.fibre_field)]), matrix


def fibre_directions(rig: Rig, effects: Effects, seed: int) -> tuple[Array, Array]:
    """True directions of the fibres about the mirror direction [degree]."""
    theta, phi = (np.array([getattr(fibre, angle) for fibre in rig.fibres]) for angle in ("theta_s", "phi_s"))
    if not effects.fibre_directions:
        return theta, phi
    azimuth = random_stream(seed, "fibre directions").uniform(0, 2 * np.pi, theta.size)[:, None]
    aside = np.cos(azimuth) * unit_vector(theta + 90, phi) + np.sin(azimuth) * unit_vector(90.0, phi + 90)
    return angles_of(unit_vector(theta, phi) + np.tan(np.radians(effects.fibre_directions)) * aside)


def fibre_efficiency(count: int, effects: Effects, seed: int) -> Array:
    """Relative efficiency of each fibre; 0 for a dead one."""
    efficiency = 1 + effects.fibres * random_stream(seed, "fibres").uniform(-1, 1, count)
    efficiency[random_stream(seed, "dead fibres").permutation(count)[: round(effects.dead_fibres * count)]] = 0.0
    return efficiency


def _field_nodes(theta: Array, phi: Array, radius: float) -> tuple[Array, Array]:
    """Directions (n, 7) of the nodes of :data:`_CIRCLE_WEIGHTS` in fields of view about directions (n,)."""
    axis, up, across = unit_vector(theta, phi), unit_vector(theta + 90, phi), unit_vector(90.0, phi + 90)
    azimuth = np.radians(60.0 * np.arange(6))[:, None]
    ring = np.cos(azimuth) * up[:, None] + np.sin(azimuth) * across[:, None]
    outer = axis[:, None] + np.tan(np.radians(np.sqrt(2 / 3) * radius)) * ring
    return angles_of(np.concatenate([axis[:, None], outer], axis=1))


def _camera_vignetting(shape: tuple[int, int], effects: Effects) -> Array:
    row, column = (np.arange(size) - (size - 1) / 2 for size in shape)
    square = row[:, None] ** 2 + column**2
    return 1 - effects.vignetting * square / square.max()


def _spots(true: Screen, shape: tuple[int, int], positions: Array, radius: float) -> _Spots:
    """Pixels covered by round spots of one radius [mm] at positions (n, 2) of the screen [mm]."""
    column, row = screen.to_pixel(true, positions[:, 0], positions[:, 1])
    size = radius * true.scale * (1 + true.radial * (positions**2).sum(axis=1))
    half = int(np.ceil(size.max())) + 1
    box = np.arange(-half, half + 1)
    columns = np.rint(column).astype(int)[:, None, None] + box
    rows = np.rint(row).astype(int)[:, None, None] + box[:, None]
    coverage = overlap_area(columns - column[:, None, None], rows - row[:, None, None], size[:, None, None])
    inside = (coverage > 0) & (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    spot = np.broadcast_to(np.arange(len(positions))[:, None, None], inside.shape)
    return _Spots(spot[inside], (rows * shape[1] + columns)[inside], coverage[inside])


def overlap_area(x: Array, y: Array, radius: Array | float) -> Array:
    """Exact common area of a circle about the origin and the unit square about (x, y)."""
    corners = ((x + i, y + j) for i in (-0.5, 0.5) for j in (-0.5, 0.5))
    low_low, low_high, high_low, high_high = (_quadrant(u, v, radius) for u, v in corners)
    # A difference of areas: tiny values are rounding errors.
    area = high_high - high_low - low_high + low_low
    return np.where(area > 1e-9, np.minimum(area, 1.0), 0.0)


def _quadrant(x: Array, y: Array, radius: Array | float) -> Array:
    """Area of a circle about the origin to the left of x and below y.

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

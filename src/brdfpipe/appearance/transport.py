"""Light transport of the preview: ∫ L(ω_i) f(ω_i, ω_o) cos θ_i dω_i towards the camera at many points, for any BSDF.

The BSDF is evaluated on a table of view directions, once for all points. Two sets of nodes share the directions of light by a
smooth weight. Near the mirror direction the nodes are facets on a log-polar grid of slopes: their contributions vary slowly with
the view, and the grid resolves peak and tail of a lobe of any width. Elsewhere the nodes are directions of equal solid angle.
Every node looks up the lights blurred by its own solid angle (Křivánek & Colbert 2008, Computer Graphics Forum 27), so that the
picture has no noise and no pattern.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.appearance.lights import STRAIGHT_DOWN, Filtered, Floats, Lights, filtered, golden_spiral
from brdfpipe.appearance.preview_geometry import Points
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, angles_of, unit_vector

_NARROWEST, _WIDEST = 7e-4, 0.15
"""Half widths of lobes, in slope: narrower ones are below a pixel, wider ones are resolved by the directions."""

_NEAR, _FAR = 0.1, 0.25
"""Slopes, along the narrow axis of the lobe, between which the weight moves from facets to directions."""

_FACET_BLUR = 0.6
"""Standard deviation of the blur over the distance of nodes. The ripple of a square lattice is then
2 exp(−2 π² 0.36) = 0.2 %, and the lobe 2 % wider."""

_MOST_LOOKUPS = 2**17
"""Pairs of point and node that are looked up together."""

_MOST_VALUES = 2**22
"""Values of a BSDF, directions times wavelengths, that are evaluated together."""


class Resolution(NamedTuple):
    """Numbers of nodes and views."""

    directions: int
    facets_per_circle: int
    """On each circle of equal slope."""
    thetas: int
    phis: int
    """Azimuths of view; 1 for an isotropic BSDF."""


ISOTROPIC = Resolution(1600, 20, 40, 1)
WITH_LAY = Resolution(900, 32, 18, 24)


@dataclass(frozen=True)
class Table:
    """The contribution of each node to each view."""

    theta: Array
    """(views,) degree, increasing"""
    phi: Array
    """(azimuths,) degree, increasing over a full turn; one for an isotropic BSDF"""
    lay: float
    width: float
    """Slope at which the lobe at normal view has half its height, across its narrow axis"""
    facets: Array
    """(nodes, 3) unit normals in the frame of the surface"""
    facet_angle: Array
    """(nodes,) solid angle of each facet [sr]"""
    near: Floats
    """(views, azimuths, nodes, channels) contributions of facets"""
    directions: Array
    """(nodes, 3)"""
    far: Floats
    """(views, azimuths, nodes, channels) contributions of directions"""
    mirror: Array
    """(views, azimuths, channels) share of the light that a smooth surface mirrors"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None, channels: Array) -> Table:
        """Tabulate a BSDF; ``channels`` (wavelength or 1, channels) are the weights of the wavelengths in each channel."""
        isotropic = representation(bsdf).isotropic
        resolution = ISOTROPIC if isotropic else WITH_LAY
        theta = _views(resolution.thetas)
        phi = np.arange(resolution.phis) * 360 / resolution.phis
        lay = 0.0 if isotropic else representation(bsdf).lay or 0.0
        widths = _lobe_widths(bsdf, lay, wavelength)
        facets, facet_angle, share = _facets(widths, lay, resolution.facets_per_circle)
        directions = golden_spiral(1 - (np.arange(resolution.directions) + 0.5) / resolution.directions)
        nodes = len(facets) + len(directions)
        values = phi.size * nodes * (1 if wavelength is None else wavelength.size)
        both = np.empty((theta.size, phi.size, nodes, channels.shape[1]), dtype=np.float32)
        mirror = np.empty((theta.size, phi.size, channels.shape[1]))
        # Many views at once: a representation evaluates many directions faster, and prepares for each call.
        for rows in np.array_split(np.arange(theta.size), max(1, min(theta.size, theta.size * values // _MOST_VALUES))):
            polar, around = (grid.ravel() for grid in np.meshgrid(theta[rows], phi, indexing="ij"))
            view = unit_vector(polar, around)
            lights = np.empty((len(view), nodes, 3))
            weight = np.empty((len(view), nodes))
            of_facets, others = lights[:, : len(facets)], slice(len(facets), None)
            of_facets[:] = 2 * (view @ facets.T)[..., None] * facets - view[:, None]
            weight[:, : len(facets)] = 4 * np.maximum(view @ facets.T, 0) * facet_angle * share
            lights[:, others] = directions
            weight[:, others] = (
                (1 - _facet_share(directions + view[:, None], widths, lay)) * 2 * np.pi / len(directions)
            )
            reflected = _reflected(bsdf, lights, weight, (polar, around), wavelength, channels)
            both[rows] = reflected.reshape(rows.size, phi.size, nodes, -1)
            shares = representation(bsdf).specular(polar, around + 180, wavelength)[0]
            mirror[rows] = in_channels(shares, channels).reshape(rows.size, phi.size, -1)
        near, far = both[:, :, : len(facets)], both[:, :, len(facets) :]
        return cls(theta, phi, lay, min(widths), facets, facet_angle, near, directions, far, mirror)

    @cached_property
    def has_facets(self) -> bool:
        """Whether facets contribute anything."""
        return bool(self.near.any())

    def near_light(self, points: Points, *lights: Lights) -> Array:
        """Light that facets near the mirror direction reflect to the camera, (points, channels).

        With several lights each has its own equal share of the channels, in their order.
        """
        return self._reflected_light(points, lights, near=True)

    def far_light(self, points: Points, *lights: Lights) -> Array:
        """Light from all other directions, which varies slowly: (points, channels)."""
        return self._reflected_light(points, lights, near=False)

    def mirrored_light(self, points: Points, *lights: Lights) -> Array:
        """Light that a smooth surface mirrors to the camera: (points, channels)."""
        radiance = np.zeros((len(points.normal), self.mirror.shape[-1]))
        if not self.mirror.any():
            return radiance
        light = _mirrored(points, lights)
        for in_cell, corners, shares in self._cells(points, *self._local_views(points)[1:]):
            reflectance = np.stack([self.mirror[corner] for corner in corners])
            radiance[in_cell] = shares @ reflectance
        radiance.reshape(*light.shape, -1)[:] *= light[..., None]
        return radiance

    def _reflected_light(self, points: Points, lights: tuple[Lights, ...], near: bool) -> Array:
        weights = self.near if near else self.far
        radiance = np.zeros((len(points.normal), weights.shape[-1]))
        if weights.shape[2] == 0 or not weights.any():
            return radiance
        (frame, theta, phi), lamps = self._local_views(points), filtered(lights)
        every = None if near else lamps.in_frames(frame, self.directions)
        for in_cell, corners, shares in self._cells(points, theta, phi):
            # (corners, nodes, lights, channels) to (lights, nodes, corners, channels)
            table = np.stack([weights[corner] for corner in corners])
            table = table.reshape(*table.shape[:2], len(lights), -1).transpose(2, 1, 0, 3)
            table = np.ascontiguousarray(table).reshape(len(lights), weights.shape[2], -1)
            step = max(1, _MOST_LOOKUPS // weights.shape[2])
            for start in range(0, in_cell.size, step):
                at = in_cell[start : start + step]
                if every is None:
                    light = self._from_facets(frame[at], points.view[at], points.spread[at], lamps)
                else:
                    whole = at[-1] - at[0] == at.size - 1  # without a copy
                    light = every[:, at[0] : at[-1] + 1] if whole else every[:, at]
                by_corner = (light @ table).reshape(len(lights), at.size, len(corners), -1)
                share = shares[start : start + step].astype(np.float32)[..., None]
                seen = sum(share[:, corner] * by_corner[:, :, corner] for corner in range(len(corners)))
                radiance[at] = np.moveaxis(seen, 0, 1).reshape(at.size, -1)
        return radiance

    def _from_facets(self, frame: Array, view: Array, spread: Array, lamps: Filtered) -> Floats:
        from brdfpipe.appearance.light_kernel import mirrored_light

        turned = np.einsum("pa,pca->pc", view, frame).mean(axis=0)
        solid = 4 * np.maximum(self.facets @ (turned / np.linalg.norm(turned)), 0.01) * self.facet_angle
        blur = np.hypot(_FACET_BLUR * np.sqrt(solid), float(spread.mean()))
        return mirrored_light(frame, self.facets, view, lamps.levels(blur), lamps.table, STRAIGHT_DOWN)

    def _local_views(self, points: Points) -> tuple[Array, Array, Array]:
        """Axes of the surface (points, 3, 3), and the view in them [degree]."""
        if self.phi.size == 1:
            frame, theta = points.seen_from_x
            return frame, np.minimum(theta, self.theta[-1]), np.zeros(len(theta))
        normal, view = points.normal, points.view
        across = np.cross(normal, points.lay)
        x = np.cos(np.radians(self.lay)) * points.lay - np.sin(np.radians(self.lay)) * across
        frame = np.stack([x, np.cross(normal, x), normal], axis=1)
        theta, phi = angles_of(np.einsum("pca,pa->pc", frame, view))
        return frame, np.minimum(theta, self.theta[-1]), phi % 360

    def _cells(self, points: Points, theta: Array, phi: Array) -> Sequence[_Cell]:
        """Points by cell of the table; ``theta`` and ``phi`` (points,) are their local views [degree]."""
        if self.phi.size == 1:
            return _cells_of_isotropic(points, self.theta.size)
        return _cells_of(self.theta, self.phi.size, theta, phi)


class _Cell(NamedTuple):
    """A cell of a table of views."""

    points: NDArray[np.intp]
    """Indices of the points in it, increasing"""
    corners: Sequence[tuple[int, int]]
    """Polar angle and azimuth, as indices of the table"""
    shares: Array
    """(points, corners) bilinear weights"""


def _views(count: int) -> Array:
    """Polar angles of the views of a table [degree]."""
    return np.asarray(89.9 * np.sin(np.linspace(0, np.pi / 2, count)))


@lru_cache(maxsize=8)
def _cells_of_isotropic(points: Points, thetas: int) -> Sequence[_Cell]:
    """The same for all isotropic materials."""
    theta, seen = _views(thetas), points.seen_from_x[1]
    return _cells_of(theta, 1, np.minimum(seen, theta[-1]), np.zeros(len(seen)))


def _cells_of(thetas: Array, phis: int, theta: Array, phi: Array) -> Sequence[_Cell]:
    """Views (n,) by cell of a table with the polar angles ``thetas`` and ``phis`` azimuths."""
    row_of = np.clip(np.searchsorted(thetas, theta, side="right") - 1, 0, thetas.size - 2)
    theta_fraction = (theta - thetas[row_of]) / np.diff(thetas)[row_of]
    step = 360 / phis
    column_of = np.minimum((phi / step).astype(int), phis - 1)
    phi_fraction = phi / step - column_of
    cells = []
    for cell in np.unique(row_of * phis + column_of):
        row, column = divmod(int(cell), phis)
        in_cell = np.flatnonzero((row_of == row) & (column_of == column))
        a, b = theta_fraction[in_cell], phi_fraction[in_cell]
        if phis == 1:
            cells.append(_Cell(in_cell, [(row, 0), (row + 1, 0)], np.stack([1 - a, a], axis=1)))
            continue
        after = (column + 1) % phis
        corners = [(row, column), (row + 1, column), (row, after), (row + 1, after)]
        cells.append(_Cell(in_cell, corners, np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)))
    return cells


@lru_cache(maxsize=8)
def _mirrored(points: Points, lights: tuple[Lights, ...]) -> Array:
    """Light from the directions that smooth surfaces mirror to the camera, (points, lights)."""
    directions = 2 * points.cosine[:, None] * points.normal - points.view
    return np.stack([one.of_pixels(directions, points.spread) for one in lights], axis=-1)


def in_channels(values: Array, channels: Array) -> Array:
    """Channels (…, channels) of values (…, wavelength), or (…, 1) for values that do not depend on wavelength."""
    return np.asarray(values * channels.sum(axis=0) if values.shape[-1] == 1 else values @ channels)


def _reflected(
    bsdf: xr.Dataset,
    lights: Array,
    weight: Array,
    view: tuple[Array, Array],
    wavelength: Array | None,
    channels: Array,
) -> Array:
    """f cos θ_i times the weight in channels, (views, nodes, channels), for light from directions (views, nodes, 3).

    ``view`` are θ_o and φ_o [degree], (views,) each.
    """
    used = (lights[..., 2] > 1e-9) & (weight > 0)
    if used.all():
        used = np.ones((), dtype=bool)  # views instead of copies
    if not used.any():
        return np.zeros((*weight.shape, channels.shape[1]))
    chosen = lights[used].reshape(-1, 3)
    theta_i, phi_i = angles_of(chosen)
    theta_o, phi_o = (np.broadcast_to(angle[:, None], weight.shape)[used].ravel() for angle in view)
    values = representation(bsdf).evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
    light = in_channels(values, channels)
    light *= (chosen[:, 2] * weight[used].ravel())[:, None]
    if used.ndim == 0:
        return light.reshape(*weight.shape, -1)
    reflected = np.zeros((*weight.shape, channels.shape[1]))
    reflected[used] = light
    return reflected


# --- nodes


def _lobe_widths(bsdf: xr.Dataset, lay: float, wavelength: Array | None) -> tuple[float, float]:
    """Slopes along the lay and across it at which the lobe at normal view has half its height; the widest where there is no lobe.

    Found by evaluation, so that it works for every representation.
    """
    slope = np.concatenate([[_NARROWEST / 10], np.geomspace(_NARROWEST, 0.5, 60)])
    widths = []
    for turn in (lay, lay + 90):
        theta = np.degrees(2 * np.arctan(slope))
        at = np.full(slope.size, turn)
        values = representation(bsdf).evaluate(theta, at, 0 * theta, at, wavelength).mean(axis=-1)
        height = values - values[-1]
        fallen = np.flatnonzero(height < height[0] / 2)
        peaked = height[0] > 0.05 * abs(values[-1]) and fallen.size > 0
        widths.append(float(np.clip(slope[fallen[0]], _NARROWEST, _WIDEST)) if peaked else _WIDEST)
    return widths[0], widths[1]


def _facets(widths: tuple[float, float], lay: float, per_circle: int) -> tuple[Array, Array, Array]:
    """Normals (nodes, 3), solid angles and weights of facets on a log-polar grid of slopes, stretched like the lobe.

    The trapezoidal rule in the logarithm of the slope and in azimuth converges faster than any power for smooth densities. The
    innermost circle is a disc of constant value.
    """
    narrow = min(widths)
    if narrow >= _WIDEST:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    step = 2 * np.pi / per_circle
    ring = np.exp(np.arange(np.log(narrow / 4), np.log(_FAR), step))
    turn = np.arange(per_circle) * step
    r, phi = (grid.ravel() for grid in np.meshgrid(ring, turn, indexing="ij"))
    along, across = r * np.cos(phi) * widths[0] / narrow, r * np.sin(phi) * widths[1] / narrow
    stretch = widths[0] * widths[1] / narrow**2
    area = r * r * step * step * stretch
    inner = ring[0] * np.exp(-step / 2)
    along, across, r = (np.concatenate([[0.0], values]) for values in (along, across, r))
    area = np.concatenate([[np.pi * inner * inner * stretch], area])
    azimuth = np.radians(lay)
    p = along * np.cos(azimuth) - across * np.sin(azimuth)
    q = along * np.sin(azimuth) + across * np.cos(azimuth)
    length = np.sqrt(1 + p * p + q * q)
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1) / length[:, None]
    return normals, area / length**3, _near_weight(r)


def _facet_share(vectors: Array, widths: tuple[float, float], lay: float) -> Array:
    """Weight of the facets along vectors (…, 3)."""
    narrow = min(widths)
    if narrow >= _WIDEST:
        return np.zeros(vectors.shape[:-1])
    azimuth = np.radians(lay)
    cos, sin = np.cos(azimuth) / vectors[..., 2], np.sin(azimuth) / vectors[..., 2]
    along, across = vectors[..., 0] * cos + vectors[..., 1] * sin, vectors[..., 1] * cos - vectors[..., 0] * sin
    return _near_weight(np.hypot(along * narrow / widths[0], across * narrow / widths[1]))


def _near_weight(slope: Array) -> Array:
    """1 at slopes near the mirror direction, 0 far from it, smooth between."""
    t = np.clip(np.log(np.maximum(slope, 1e-12) / _NEAR) / np.log(_FAR / _NEAR), 0, 1)
    return np.asarray(1 - t * t * (3 - 2 * t))

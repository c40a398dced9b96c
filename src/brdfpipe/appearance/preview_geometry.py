"""The two subjects of a preview in front of the camera: a distant sphere, and a flat panel in perspective.

World axes as in :mod:`brdfpipe.appearance.lights`; the camera looks along +y. As the lights are infinitely far away, the light from
a point depends only on its normal, the direction to the camera and the direction of the lay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from brdfpipe.content_cache import cached_by_content
from brdfpipe.geometry import Array, angles_of

SPHERE_RADIUS = 0.45
"""Share of the picture's side."""

PANEL_HALF_SIDE = 1.0
PANEL_NORMAL = (0.0, -0.62, 0.78)
PANEL_DISTANCE = 5.0
"""Distance from the camera to the panel's centre; the panel's side is 2."""
PANEL_FIELD = 0.262
"""Tangent of half the field of view."""

_WRAPPED = 4
"""Nodes of a polar grid beyond its ends."""

_CAMERA = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a subject. What follows from them alone is kept with them, as every material is seen at the same ones."""

    normal: Array
    """(n, 3)"""
    view: Array
    """(n, 3) unit vectors towards the camera"""
    lay: Array
    """(n, 3) unit tangents along the lay"""
    spread: Array
    """(n,) half the angle between the mirror directions of neighbouring pixels [radian]"""

    def at(self, chosen: NDArray[Any] | slice) -> Points:
        """Some of the points."""
        return Points(self.normal[chosen], self.view[chosen], self.lay[chosen], self.spread[chosen])

    @cached_property
    def cosine(self) -> Array:
        """(n,) of the angle between the normal and the view"""
        return np.asarray((self.normal * self.view).sum(axis=1))

    @cached_property
    def seen_from_x(self) -> tuple[Array, Array]:
        """Axes (n, 3, 3) of the surface with the view above x, and the angle of the view from the normal (n,) [degree].

        Where the view is along the normal, any tangent is x.
        """
        normal, view = self.normal, self.view
        x = view - self.cosine[:, None] * normal + 1e-12 * self.lay
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        frame = np.stack([x, np.cross(normal, x), normal], axis=1)
        return frame, angles_of(np.einsum("pca,pa->pc", frame, view))[0]


class Shot(NamedTuple):
    """A subject in a square picture."""

    pixels: Points
    """Points of the covered pixels, in the order of the non-zero values of ``coverage``"""
    coverage: Array
    """(side, side) share of each pixel that the subject covers"""
    coarse: Points
    """Points of a coarse grid, for light that varies slowly"""
    grid: tuple[int, int]
    grid_position: Array
    """(2, n) positions of the pixels on that grid"""
    polar: bool
    """Whether the second axis of the grid is a full turn"""
    step: float
    """Largest angle between the facets [radian] that mirror one light to the camera from neighbouring points of the grid"""
    with_step: Callable[[float, float], Shot | None]
    """The same subject with a grid of a smaller step, None if that would have more points than the second argument"""

    def upsampled(self, values: Array) -> Array:
        """Values of the coarse grid (points, channels) at the pixels (n, channels), by cubic splines."""
        field, position = values.reshape(*self.grid, -1), self.grid_position
        if self.polar:
            # Beyond the centre a ring continues half a turn away.
            field = np.concatenate([np.roll(field[_WRAPPED:0:-1], self.grid[1] // 2, axis=1), field])
            field = np.concatenate([field[:, -_WRAPPED:], field, field[:, :_WRAPPED]], axis=1)
            position = position + _WRAPPED
        return _splines(np.array(field.shape[:2]), position)(field)


class _Splines(NamedTuple):
    """Cubic splines through the values of a grid, at fixed positions: linear in the values, whatever these are."""

    coefficients: tuple[Array, Array]
    """Values along either axis to coefficients"""
    basis: csr_array
    """(positions, coefficients)"""

    def __call__(self, field: Array) -> Array:
        """Values (first, second, channels) to those at the positions, (positions, channels)."""
        first, second = self.coefficients
        solved = second @ np.tensordot(first, field, 1)
        return np.asarray(self.basis @ solved.reshape(-1, field.shape[-1]).astype(np.float32))


@cached_by_content(6)
def _splines(shape: NDArray[np.int64], position: Array) -> _Splines:
    """The splines over a grid of a shape, at positions (2, n) of it; the same pixels for every material."""
    (solve_first, first, of_first), (solve_second, second, of_second) = (
        _basis(int(count), at) for count, at in zip(shape, position, strict=True)
    )
    weights = of_first[:, :, None] * of_second[:, None, :]
    columns = (first[:, :, None] * shape[1] + second[:, None, :]).astype(np.int32)
    ends = np.arange(len(weights) + 1, dtype=np.int32) * weights[0].size
    basis = csr_array(
        (weights.ravel().astype(np.float32), columns.ravel(), ends), shape=(len(weights), int(np.prod(shape)))
    )
    return _Splines((solve_first, solve_second), basis)


def _basis(count: int, position: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Along one axis: values to coefficients; and of each position the four coefficients and their weights."""
    from scipy.interpolate import BSpline

    nodes = np.arange(float(count))
    # Without a knot at the second node and the last but one.
    knots = np.concatenate([np.zeros(4), nodes[2:-2], np.full(4, nodes[-1])])
    values = BSpline.design_matrix(nodes, knots, 3).toarray()
    at = BSpline.design_matrix(np.clip(position, 0, nodes[-1]), knots, 3)
    columns: NDArray[np.int64] = at.indices.reshape(-1, 4).astype(np.int64)
    return np.asarray(np.linalg.inv(values)), columns, np.asarray(at.data.reshape(-1, 4))


@lru_cache(maxsize=8)
def sphere(side: int, rings: int = 40, turns: int = 72) -> Shot:
    """A distant sphere, brushed along its circles of latitude."""
    x, z = _pixels(side, 0.5 / SPHERE_RADIUS)
    radius = np.hypot(x, z)
    width = 1 / (SPHERE_RADIUS * side)
    coverage = np.clip((1 - radius) / width + 0.5, 0, 1)
    covered = coverage > 0
    # A pixel on the rim shows the part of it that is on the sphere.
    sine = np.minimum(radius[covered], 1 - width / 4)
    turn = np.arctan2(z[covered], x[covered])
    position = np.stack([np.arcsin(sine) * 2 / np.pi * (rings - 1), turn % (2 * np.pi) * turns / (2 * np.pi)])
    sines = np.minimum(np.sin(np.linspace(0, np.pi / 2, rings)), 1 - 1e-5)
    sine_grid, turn_grid = np.meshgrid(sines, np.arange(turns) * 2 * np.pi / turns, indexing="ij")
    return Shot(
        _on_sphere(sine, turn, width),
        coverage,
        _on_sphere(sine_grid.ravel(), turn_grid.ravel(), width),
        (rings, turns),
        position,
        True,
        max(np.pi / 2 / (rings - 1), 2 * np.pi / turns),
        partial(_finer_sphere, side),
    )


def _finer_sphere(side: int, step: float, most: float) -> Shot | None:
    rings, turns = int(np.ceil(np.pi / 2 / step)) + 1, 2 * int(np.ceil(np.pi / step))
    return sphere(side, rings, turns) if rings * turns < most else None


def _on_sphere(sine: Array, turn: Array, width: float) -> Points:
    cosine = np.sqrt(1 - sine * sine)
    normal = np.stack([sine * np.cos(turn), -cosine, sine * np.sin(turn)], axis=-1)
    lay = np.stack([cosine, normal[:, 0], np.zeros(sine.size)], axis=-1)
    lay /= np.linalg.norm(lay, axis=1, keepdims=True)
    return Points(normal, np.broadcast_to(_CAMERA, normal.shape), lay, width / np.sqrt(cosine))


@lru_cache(maxsize=8)
def panel(side: int, lines: int = 24) -> Shot:
    """A square panel that leans back, brushed from left to right."""
    normal = np.array(PANEL_NORMAL) / np.linalg.norm(PANEL_NORMAL)
    across = np.cross([0.0, 0.0, 1.0], normal)
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(normal, across)])
    camera = PANEL_DISTANCE * _CAMERA
    x, z = _pixels(side, PANEL_FIELD)
    ray = np.stack([x, np.ones_like(x), z], axis=-1)
    hit = camera + ray * (-(camera @ normal) / (ray @ normal))[..., None]
    u, v = np.moveaxis(hit @ axes.T, -1, 0) / PANEL_HALF_SIDE
    width_u, width_v = (np.hypot(*np.gradient(coordinate)) for coordinate in (u, v))
    coverage = np.clip((1 - np.abs(u)) / width_u + 0.5, 0, 1) * np.clip((1 - np.abs(v)) / width_v + 0.5, 0, 1)
    covered = coverage > 0
    even = np.linspace(-1, 1, lines)
    grid = np.stack(np.meshgrid(even, even, indexing="ij"), axis=-1).reshape(-1, 2)
    spread = PANEL_FIELD / side
    points = partial(_on_panel, normal=normal, axes=axes, camera=camera, spread=spread)
    pixels = np.clip(np.stack([v[covered], u[covered]], axis=-1), -1, 1)
    position = (pixels.T + 1) / 2 * (lines - 1)
    # Half of the angle between the views.
    step = PANEL_HALF_SIDE / (lines - 1) / PANEL_DISTANCE
    return Shot(
        points(pixels), coverage, points(grid), (lines, lines), position, False, step, partial(_finer_panel, side)
    )


def _finer_panel(side: int, step: float, most: float) -> Shot | None:
    lines = int(np.ceil(PANEL_HALF_SIDE / PANEL_DISTANCE / step)) + 1
    return panel(side, lines) if lines * lines < most else None


def _on_panel(position: Array, normal: Array, axes: Array, camera: Array, spread: float) -> Points:
    """Points at (v, u) of the panel, both -1 to 1."""
    view = camera - PANEL_HALF_SIDE * (position[:, ::-1] @ axes)
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    count = (len(position), 3)
    return Points(np.broadcast_to(normal, count), view, np.broadcast_to(axes[0], count), np.full(len(position), spread))


def _pixels(side: int, half_field: float) -> tuple[Array, Array]:
    """x and z of the pixels' centres, top row first, on a plane of half width ``half_field``."""
    centres = ((np.arange(side) + 0.5) / side * 2 - 1) * half_field
    x, z = np.meshgrid(centres, -centres)
    return x, z

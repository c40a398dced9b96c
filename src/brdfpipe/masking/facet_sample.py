"""Facets of a height map or a line at evenly spread places, and which of them rays from a direction reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMesh

BLOCKS = 8
"""Blocks of a map along each axis, whose scatter is the uncertainty; a line has as many blocks altogether as a map."""
_GOLDEN = (np.sqrt(5) - 1) / 2
_EXCESS_NODES = 512


class FacetSample(NamedTuple):
    """Measured facets of a mesh, block after block."""

    mesh: HeightMesh
    position: Array
    """(n, 2) along x and y, in cells"""
    facet: Array
    """(n, 4) height, slopes along x and y, and side of the cell"""
    block: NDArray[np.intp]
    """(n,) number of the block"""

    @classmethod
    def of(cls, mesh: HeightMesh, facets: int, seed: int) -> FacetSample:
        """About ``facets`` facets; those without measured heights are left out."""
        from brdfpipe.references import ray_kernel

        number = np.arange(facets)
        block = number * BLOCKS**2 // facets
        # Roberts' additive recurrence in two dimensions.
        shift = np.random.default_rng(seed).random(2)
        within = (shift + (number[:, None] + 1) * [0.7548776662466927, 0.5698402909980532]) % 1.0
        rows, columns = mesh.present.shape
        split = np.array([BLOCKS, BLOCKS] if not mesh.is_line else [BLOCKS**2, 1])
        place = np.stack([block % split[0], block // split[0]], axis=1) + within
        position = np.ascontiguousarray(place * [columns, rows] / split)
        measured = mesh.present[position[:, 1].astype(int), position[:, 0].astype(int)]
        position, block = position[measured], block[measured]
        facet = np.empty((position.shape[0], 4))
        ray_kernel.facets_at(mesh.height, mesh.pitch, position, facet)
        return cls(mesh, position, facet, block)

    def take(self, indices: NDArray[np.intp]) -> FacetSample:
        """Some of the facets."""
        return self._replace(position=self.position[indices], facet=self.facet[indices], block=self.block[indices])

    @property
    def slopes(self) -> tuple[Array, Array]:
        """Slopes along x and y, (n,) each."""
        return self.facet[:, 1], self.facet[:, 2]

    @property
    def azimuth(self) -> Array:
        """Azimuths spread evenly over the circle, (n,) [rad]; of a line, both of its directions by turns."""
        number = np.arange(self.block.size)
        if self.mesh.is_line:
            return np.asarray(np.pi * (number % 2), dtype=float)
        return np.asarray(2 * np.pi * (_GOLDEN * number % 1.0))

    def slope_towards(self, azimuth: Array) -> Array:
        """Slope of the facets' fall towards an azimuth, (n,): positive where a facet turns to that side."""
        p, q = self.slopes
        return np.asarray(-p * np.cos(azimuth) - q * np.sin(azimuth))

    def visible(self, *directions: Array, among: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
        """Whether all of some directions see the facets; unit vectors, (n, 3) each. Facets that are not ``among`` (n,) count as hidden."""
        from brdfpipe.references import ray_kernel

        mesh = self.mesh
        arrays = mesh.height, mesh.ceiling, mesh.offset, float(mesh.height.min()), mesh.pitch, mesh.edges
        visible = np.ones(self.block.size, dtype=bool) if among is None else among.copy()
        for direction in directions:
            ray_kernel.follow_from_facets(*arrays, self.position, self.facet, np.ascontiguousarray(direction), visible)
        return visible

    def smith_excess(self) -> Callable[[Array], Array]:
        """The mean excess slope g(cot θ) of Smith's masking, of the sampled facets themselves, over all azimuths."""
        towards = self.slope_towards(self.azimuth)
        slopes = np.sort(np.abs(towards))[::-1]
        typical = float(np.median(slopes)) or 1.0
        mu = typical * np.sinh(np.linspace(0, np.arcsinh(slopes[0] / typical), _EXCESS_NODES))
        # Every slope counts with its opposite.
        steeper = np.searchsorted(-slopes, -mu)
        sums = np.concatenate([[0.0], np.cumsum(slopes)])
        excess = (sums[steeper] - mu * steeper) / (2 * slopes.size)
        return lambda cotangents: np.interp(cotangents, mu, excess, right=0.0)


def direction(theta: Array, azimuth: Array) -> Array:
    """Unit vectors (n, 3) of polar angles and azimuths [rad]."""
    sin = np.sin(theta)
    return np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), np.broadcast_to(np.cos(theta), sin.shape)], axis=-1)

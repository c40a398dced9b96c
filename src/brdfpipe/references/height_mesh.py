"""A height map as a mesh of triangles, with the hierarchy of heights by which rays find them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.slopes import HeightMap, mean_slope
from brdfpipe.geometry import Array

EDGES = ("mirrored", "periodic", "open")
"""What is beyond the edges of a map, in the order of the kernel's numbers: its mirror image, its repetition, or nothing."""
LEAST_HEIGHTS = 16
"""Heights along each axis of the smallest map."""

NOISE_LIMIT = 0.05
"""Share of noise in the mean square slope, which a prediction leaves out, above which rays are not traced over it."""

_SAMPLED_FACETS = 2**20


class HeightMapError(BrdfpipeError):
    """A height map, or an option, that a reference solution cannot use."""


class HeightMesh(NamedTuple):
    """Triangles over a map, two a cell, as the arrays of the compiled kernel."""

    height: Array
    """(rows, columns) um about the mean plane, without gaps"""
    present: NDArray[np.bool_]
    """(rows − 1, columns − 1) whether all heights of the cell were measured"""
    ceiling: Array
    """Highest height of every block of 2^level × 2^level cells, levels one after the other"""
    offset: NDArray[np.int64]
    """(levels + 1,) where each level begins in ``ceiling``"""
    pitch: Array
    """(2,) along x and y [um]"""
    edges: int
    """Index into :data:`EDGES`"""

    @classmethod
    def of(cls, surface: xr.Dataset, edges: str = "mirrored") -> HeightMesh:
        """Mesh of a dataset of kind ``surface``.

        Parameters
        ----------
        surface : a map, levelled; a remaining tilt is removed. Cells without measured heights are filled from the nearest height, so
            that they shade, and light that meets them is counted as lost
        edges : one of :data:`EDGES`

        Raises
        ------
        HeightMapError : a line profile, a map below 16 × 16 heights, a map without complete cells, or unknown edges.
        VocabularyError : the dataset is not of kind ``surface``.
        """
        vocabulary.validate(surface, "surface")
        if edges not in EDGES:
            raise HeightMapError(f"unknown edges {edges!r}; accepted: {', '.join(EDGES)}")
        if surface["height"].ndim == 1:
            raise HeightMapError(
                "a line profile has no second dimension for rays; measure an areal map (`surface.file`), or use the facet model"
            )
        height = np.array(surface["height"].values, dtype=float)
        if min(height.shape) < LEAST_HEIGHTS:
            found = " × ".join(map(str, height.shape))
            raise HeightMapError(f"the map has {found} heights; accepted: {LEAST_HEIGHTS} × {LEAST_HEIGHTS} or more")
        pitch = np.array([float(surface.attrs["pitch_x"]), float(surface.attrs["pitch_y"])])
        rows, columns = np.arange(height.shape[0])[:, None], np.arange(height.shape[1])
        tilt = mean_slope(HeightMap(height, (pitch[0], pitch[1]), 0.0))
        height -= tilt[0] * pitch[0] * columns + tilt[1] * pitch[1] * rows
        missing = np.isnan(height)
        present = ~(missing[:-1, :-1] | missing[1:, :-1] | missing[:-1, 1:] | missing[1:, 1:])
        if not present.any():
            raise HeightMapError("the map has no complete cell of four heights; measure with fewer missing heights")
        if missing.any():
            from scipy.ndimage import distance_transform_edt

            nearest = distance_transform_edt(missing, sampling=pitch[::-1], return_distances=False, return_indices=True)
            height = height[tuple(nearest)]
        height -= height.mean()
        if edges == "periodic":
            height, present = (
                np.pad(height, ((0, 1), (0, 1)), mode="wrap"),
                np.pad(present, ((0, 1), (0, 1)), mode="edge"),
            )
        return cls(height, present, *_ceilings(height), pitch, EDGES.index(edges))

    @classmethod
    def of_line(cls, surface: xr.Dataset) -> HeightMesh:
        """A line as a strip of a single row of cells, for rays in the plane of the line; mirrored at its ends.

        Parameters
        ----------
        surface : kind ``surface``, a levelled line profile

        Raises
        ------
        HeightMapError : a map, a line below 16 heights, or one without two heights beside each other.
        """
        vocabulary.validate(surface, "surface")
        height = np.array(surface["height"].values, dtype=float)
        if height.ndim != 1 or height.size < LEAST_HEIGHTS:
            found = " × ".join(map(str, height.shape))
            raise HeightMapError(f"the line has {found} heights; accepted: a line of {LEAST_HEIGHTS} or more")
        known = np.isfinite(height)
        present = known[:-1] & known[1:]
        if not present.any():
            raise HeightMapError("the line has no two heights beside each other; measure with fewer missing heights")
        place = np.arange(height.size)
        height = np.interp(place, place[known], height[known])
        height -= np.mean(np.diff(height)[present]) * place
        height = np.tile(height - height.mean(), (2, 1))
        pitch = np.full(2, float(surface.attrs["pitch_x"]))
        return cls(height, present[None], *_ceilings(height), pitch, EDGES.index("mirrored"))

    @property
    def is_line(self) -> bool:
        """Whether the mesh is that of a line."""
        return self.present.shape[0] == 1

    def slopes(self) -> tuple[Array, Array]:
        """Slopes along x and y of a sample of evenly spaced facets, (facets,)."""
        step = max(1, self.present.size // _SAMPLED_FACETS)
        cells = np.flatnonzero(self.present)[::step]
        row, column = np.divmod(cells, self.present.shape[1])
        low = self.height[row, column]
        return (
            (self.height[row, column + 1] - low) / self.pitch[0],
            (self.height[row + 1, column] - low) / self.pitch[1],
        )

    @property
    def typical_slope(self) -> float:
        """Slope rms along one axis of a Gaussian surface of the same median slope; spikes do not change it."""
        return float(np.median(np.hypot(*self.slopes())) / np.sqrt(2 * np.log(2)))

    def noise_share(self, noise: float) -> float:
        """Share of the mean square slope that is white height noise of rms ``noise`` [um]."""
        # A step between neighbours has the noise of both.
        return noise**2 * float(np.sum(2 / self.pitch**2)) / (2 * max(self.typical_slope, 1e-12) ** 2)

    @property
    def anisotropy(self) -> float:
        """Larger over smaller principal slope rms; infinite where the smaller vanishes."""
        smaller, larger = np.linalg.eigvalsh(np.cov(np.stack(self.slopes())))
        return float(np.sqrt(larger / smaller)) if smaller > 0 else float("inf")


def _ceilings(height: Array) -> tuple[Array, NDArray[np.int64]]:
    """Highest height of the blocks of cells, by level, up to a single block."""
    level = _highest_of_four(height[:-1, :-1], height[:-1, 1:], height[1:, :-1], height[1:, 1:])
    levels = [level]
    while level.size > 1:
        even = np.pad(level, [(0, size % 2) for size in level.shape], constant_values=-np.inf)
        level = _highest_of_four(even[::2, ::2], even[::2, 1::2], even[1::2, ::2], even[1::2, 1::2])
        levels.append(level)
    return np.concatenate([level.ravel() for level in levels]), np.cumsum([0, *(level.size for level in levels)])


def _highest_of_four(*corners: Array) -> Array:
    return np.maximum.reduce(corners)

"""The grain of a scan: a tileable height and normal map, and the facets that its pixels do not resolve."""

from __future__ import annotations

from typing import NamedTuple

import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.texture.height_pixels import central_slopes, pixel_heights, unit_normals
from brdfpipe.texture.slope_split import INTERPOLATIONS, MapSlopes, split
from brdfpipe.texture.synthesis import METHODS, Likeness, likeness, synthesise

NOTABLE_DIFFERENCE = 0.05
"""Share of facets with other slopes from which on the split is doubtful."""

NOTABLE_MISSING = 0.05


class Grain(NamedTuple):
    """A tileable map, and what goes with it."""

    height: Array
    """(rows, columns) [um] of mean zero, periodic; the first row at the lowest y."""
    sample: Array
    """(rows, columns) [um] of mean zero: the scan on pixels of the same size."""
    pixel: float
    """Side of a pixel [um]."""
    slope_x: Array
    """(rows, columns) slopes along x [1]."""
    slope_y: Array
    """(rows, columns) slopes along y [1]."""
    facets: xr.Dataset
    """Kind ``facets``: those that the pixels do not resolve. The BRDF of these goes with the map."""
    map_slopes: MapSlopes
    """As a renderer sees them."""
    unresolved: float
    """Share of the mean square slope of all facets that the pixels do not resolve."""
    split_difference: float
    """Share of facets that have other slopes when those of the map and of the rest are put together, 0 to 1."""
    likeness: Likeness
    """What remains between the scan and the map."""
    warnings: tuple[str, ...]

    @property
    def normals(self) -> Array:
        """(rows, columns, 3) unit normals: x to the right, y upwards, z off the surface."""
        return unit_normals(self.slope_x, self.slope_y)


def grain(
    surface: xr.Dataset,
    facets: xr.Dataset,
    pixel: float,
    *,
    size: int = 512,
    method: str = METHODS[0],
    seed: int = 0,
    interpolation: str = INTERPOLATIONS[0],
) -> Grain:
    """A tileable map of a scan and the facets that its pixels do not resolve.

    Parameters
    ----------
    surface : kind ``surface``, an areal map, levelled
    facets : kind ``facets``, all facets of that surface (:func:`brdfpipe.facets.estimate`)
    pixel : side of a pixel of the map [um], from the pitch of the scan to a 32nd of its shorter side
    size : pixels along either side of the map, 32 to 8192
    method : how the map is made from the scan (:func:`brdfpipe.texture.synthesis.synthesise`)
    seed : the same seed gives the same map
    interpolation : of the renderer between pixels (:data:`brdfpipe.texture.slope_split.INTERPOLATIONS`)

    Raises
    ------
    BrdfpipeError : a line profile, a flat surface, a value out of range, too many missing heights, or a map that leaves too little of the slopes.
    VocabularyError : a dataset of the wrong kind.
    """
    sample, missing = pixel_heights(surface, pixel)
    height = synthesise(sample, size, method=method, seed=seed)
    slopes = central_slopes(height, pixel)
    found = split(facets, *slopes, interpolation)
    warnings = []
    if missing > NOTABLE_MISSING:
        warnings.append(
            f"{missing:.0%} of the heights are missing and were filled smoothly: the map is smoother than the surface; choose a better part with "
            "`surface.region`"
        )
    if found.difference > NOTABLE_DIFFERENCE:
        warnings.append(
            f"the map and the BRDF of what its pixels do not resolve put {found.difference:.0%} of the facets at other slopes than the scan: "
            "its fine roughness depends on the place, or its slopes are steep; another pixel may do better"
        )
    return Grain(
        height,
        sample,
        pixel,
        *slopes,
        found.facets,
        found.map_slopes,
        found.unresolved,
        found.difference,
        likeness(sample, height),
        tuple(warnings),
    )

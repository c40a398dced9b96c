"""A small picture of the camera for the page, and the positions of the cells in it."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse

from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.reduction import cells as rig_cells

LONGEST = 160
"""Largest size of a thumbnail's longer side [pixel]."""

DECADES = (3.0, 6.0)
"""Smallest and largest range from black to white: it makes the darkest quarter of a picture, glare and noise, black."""


class Thumbnail(NamedTuple):
    """A small picture on a logarithmic scale."""

    levels: NDArray[np.uint8]  # (y, x), 255 for the brightest part, 0 without light or below the scale
    decades: float  # from 0 to 255


def thumbnail(picture: Array) -> Thumbnail:
    """Means over squares of :func:`squares` pixels a side, on a logarithmic scale.

    Parameters
    ----------
    picture : (y, x) light in any unit; negative values and NaN count as no light
    """
    side = squares(picture.shape)
    rows, columns = picture.shape[0] // side, picture.shape[1] // side
    cropped = np.nan_to_num(picture[: rows * side, : columns * side])
    small = cropped.reshape(rows, side, columns, side).mean(axis=(1, 3))
    brightest = float(small.max(initial=0.0))
    if brightest <= 0:
        return Thumbnail(np.zeros(small.shape, dtype=np.uint8), DECADES[0])
    logarithm = np.log10(np.maximum(np.maximum(small, 0.0) / brightest, 10.0 ** -DECADES[1]))
    decades = float(np.clip(-np.percentile(logarithm, 25), *DECADES))
    return Thumbnail(np.asarray((255 * np.maximum(logarithm / decades + 1, 0)).round(), dtype=np.uint8), decades)


def squares(shape: tuple[int, ...]) -> int:
    """Pixels of the camera along one side of a thumbnail's pixel."""
    return ceil(max(shape) / LONGEST)


def drawing(picture: Array, rig: Rig, screen: Screen, weights: sparse.csr_array) -> xr.Dataset:
    """The data that show a picture with the outlines of its cells.

    Parameters
    ----------
    picture : (y, x) merged light
    rig : defines the cells
    screen : their position in this picture; of a registered session
    weights : share of each pixel in each cell, see :func:`brdfpipe.rig.reduction.cells.weights`

    Returns
    -------
    ``picture(y, x)``, see :func:`thumbnail`; the ``column`` and ``row`` of the middle of each cell [pixel of the camera], missing for a cell
    outside the picture; the radius of the ``aperture`` over which a fibre's light is summed; the ``ring_radius(ring)`` of the edges of the
    disc's rings, about its first cell
    """
    rows, columns = np.indices(picture.shape)
    area = np.asarray(weights.sum(axis=1), dtype=float).ravel()
    area = np.where(area > 0, area, np.nan)
    column, row = (weights @ axis.ravel() / area for axis in (columns, rows))
    aperture = np.where(rig_cells.cells_of(rig).of_disc, np.nan, np.sqrt(area / np.pi))
    edges, _ = rig_cells.rings(rig.screen)
    rim = screens.to_pixel(screen, *screens.disc_position(screen, edges, 0.0))
    middle = screens.to_pixel(screen, *screen.disc_centre)
    ring_radius = np.hypot(rim[0] - middle[0], rim[1] - middle[1])
    levels, decades = thumbnail(picture)
    scale = {"decades": decades, "squares": squares(picture.shape)}

    def pixels(dim: str, values: Array, long_name: str) -> tuple[str, Array, dict[str, str]]:
        return dim, values, {"units": "pixel", "long_name": long_name}

    return xr.Dataset(
        {
            "picture": (("y", "x"), levels, {"units": "1", "long_name": "light on a logarithmic scale", **scale}),
            "column": pixels("cell", column, "column of the middle of the cell"),
            "row": pixels("cell", row, "row of the middle of the cell"),
            "aperture": pixels("cell", aperture, "radius in which the light of a fibre is gathered"),
            "ring_radius": pixels("ring", ring_radius, "radius of an edge of the disc's rings"),
        }
    )

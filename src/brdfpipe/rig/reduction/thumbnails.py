"""A picture of the camera made small for people, and where the cells are in it."""

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
from brdfpipe.rig.reduction import cells as celled

LONGEST = 160
"""Pixels of a thumbnail's longer side at most."""

DECADES = (3.0, 6.0)
"""From black to white, at least and at most: as many as keep the darkest quarter of a picture black, its glare and its noise."""

_PIXEL = {"units": "pixel"}


class Thumbnail(NamedTuple):
    """A small picture on a logarithmic scale."""

    levels: NDArray[np.uint8]
    """(y, x), 255 for the brightest part, 0 without light or for less than can be shown."""
    decades: float
    """From 0 to 255."""


def thumbnail(picture: Array) -> Thumbnail:
    """Means over squares of :func:`squares` pixels a side, on a logarithmic scale.

    Parameters
    ----------
    picture : (y, x) light, of any scale; noise may make it negative, and NaN is without light
    """
    side = squares(picture.shape)
    rows, columns = picture.shape[0] // side, picture.shape[1] // side
    cut = np.nan_to_num(picture[: rows * side, : columns * side])
    small = cut.reshape(rows, side, columns, side).mean(axis=(1, 3))
    brightest = float(small.max(initial=0.0))
    if brightest <= 0:
        return Thumbnail(np.zeros(small.shape, dtype=np.uint8), DECADES[0])
    logarithm = np.log10(np.maximum(small / brightest, 10.0 ** -DECADES[1]))
    decades = float(np.clip(-np.percentile(logarithm, 25), *DECADES))
    return Thumbnail(np.asarray((255 * np.maximum(logarithm / decades + 1, 0)).round(), dtype=np.uint8), decades)


def squares(shape: tuple[int, ...]) -> int:
    """Pixels of the camera along the side of one of a thumbnail."""
    return ceil(max(shape) / LONGEST)


def drawing(picture: Array, rig: Rig, screen: Screen, weights: sparse.csr_array) -> xr.Dataset:
    """What is needed to show a picture with the outlines of its cells.

    Parameters
    ----------
    picture : (y, x) merged light
    rig : what the cells are
    screen : where they are in this picture; of a registered session
    weights : share of each pixel in each cell, as of :func:`brdfpipe.rig.reduction.cells.weights`

    Returns
    -------
    ``picture(y, x)`` as of :func:`thumbnail`; of each cell the ``column`` and ``row`` of its middle [pixel of the camera], missing
    where it has no pixel, and of a fibre the radius of the ``aperture`` in which its light is gathered; the ``ring_radius(ring)``
    of the edges of the disc's rings, about its first cell
    """
    rows, columns = np.indices(picture.shape)
    area = np.asarray(weights.sum(axis=1), dtype=float).ravel()
    seen = np.where(area > 0, area, np.nan)
    column, row = (weights @ axis.ravel() / seen for axis in (columns, rows))
    aperture = np.where(celled.cells_of(rig).of_disc, np.nan, np.sqrt(seen / np.pi))
    edges, _ = celled.rings(rig.screen)
    rim = screens.to_pixel(screen, *screens.disc_position(screen, edges, 0.0))
    middle = screens.to_pixel(screen, *screen.disc)
    levels, decades = thumbnail(picture)
    told = {
        "units": "1",
        "long_name": "light on a logarithmic scale",
        "decades": decades,
        "squares": squares(picture.shape),
    }
    return xr.Dataset(
        {
            "picture": (("y", "x"), levels, told),
            "column": ("cell", column, {**_PIXEL, "long_name": "column of the middle of the cell"}),
            "row": ("cell", row, {**_PIXEL, "long_name": "row of the middle of the cell"}),
            "aperture": ("cell", aperture, {**_PIXEL, "long_name": "radius in which the light of a fibre is gathered"}),
            "ring_radius": (
                "ring",
                np.hypot(rim[0] - middle[0], rim[1] - middle[1]),
                {**_PIXEL, "long_name": "radius of an edge of the disc's rings"},
            ),
        }
    )

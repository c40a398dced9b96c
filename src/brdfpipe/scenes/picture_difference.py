"""The difference of two materials in the pictures of the preview, pixel by pixel, as ITU-R BT.2124 measures it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview import channels_of, radiance
from brdfpipe.appearance.preview_geometry import panel, sphere
from brdfpipe.appearance.transport import Table
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

LIGHTS = ("studio", "sun")
"""Lights of the pictures: large soft boxes, and a small disc that shows the lobe."""

WHITE_LUMINANCE = 203.0
"""Luminance of the screen's white [cd/m²]: the reference white of ITU-R BT.2408."""


def picture_differences(first: xr.Dataset, second: xr.Dataset, side: int = 64) -> dict[str, tuple[float, float]]:
    """Mean of ΔE_ITP over the pixels of a sphere and a panel, and its uncertainty, by light.

    Parameters
    ----------
    first, second : kind ``bsdf``
    side : pixels along each side of the two pictures

    Returns
    -------
    light → (mean [1], standard uncertainty from the number of pixels: half the difference of both halves of a chessboard)

    Notes
    -----
    The light is not compressed to the range of a screen: highlights count up to the 10 000 cd/m² of the PQ curve. Light through a
    slab from behind is not part of it.
    """
    for bsdf in (first, second):
        vocabulary.validate(bsdf, "bsdf")
    tables = [Table.of(bsdf, *channels_of(bsdf)) for bsdf in (first, second)]
    result = {}
    for light in LIGHTS:
        differences, weights, halves = [], [], []
        for shot in (sphere(side), panel(side)):
            one, other = (_xyz(radiance(table, shot, lights(light))) for table in tables)
            differences.append(colorimetry.delta_e_itp(one, other))
            row, column = np.nonzero(shot.coverage > 0)
            weights.append(shot.coverage[row, column])
            halves.append((row + column) % 2)
        difference, weight, half = (np.concatenate(parts) for parts in (differences, weights, halves))
        means = [float(np.average(difference[half == k], weights=weight[half == k])) for k in (0, 1)]
        result[light] = float(np.average(difference, weights=weight)), abs(means[0] - means[1]) / 2
    return result


def _xyz(linear: Array) -> Array:
    """Tristimulus values [cd/m²] of linear sRGB."""
    return np.asarray(
        WHITE_LUMINANCE * linear @ np.linalg.inv(colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white)).T / 100
    )

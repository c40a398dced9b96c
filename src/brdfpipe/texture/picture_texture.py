"""The texture of an effect paint from pictures at stated geometries: light relative to its mean, which is that of the BRDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.flakes.geometries import directions
from brdfpipe.flakes.refraction import flake_angle
from brdfpipe.geometry import Array
from brdfpipe.texture.illumination import without_gradient
from brdfpipe.texture.picture_reading import read_picture
from brdfpipe.texture.sparkle import THRESHOLD, VIEWING_DISTANCE, graininess, sparkle
from brdfpipe.texture.synthesis import NARROW_OVERLAP, likeness, positive, ring_spectra, synthesise

DIFFUSE = "diffuse"
"""Name of a geometry of light from everywhere."""

COAT_INDEX = 1.5
"""Refractive index of the clear coat of the flake angles that choose a picture."""

NOTABLE_GRADIENT = 0.5
"""Change of the illumination over a picture from which on its removal is doubtful."""

QUANTILES = np.array([0.001, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 0.999, 1.0])


def of_files(
    paths: Sequence[Path], *, geometries: Sequence[str], curve: str | None = None, **options: Any
) -> xr.Dataset:
    """The texture of pictures, as :func:`of_pictures` makes it; the order of the paths is that of their geometries.

    Raises InputError: a picture that cannot be read.
    """
    read = [read_picture(path, curve) for path in paths]
    pictures = {name: one.values for name, one in zip(geometries, read, strict=True)}
    return vocabulary.add_warning(of_pictures(pictures, **options), *(text for one in read for text in one.warnings))


def of_pictures(
    pictures: Mapping[str, Array], *, pixel: float, size: int = 512, method: str = "structure", seed: int = 0
) -> xr.Dataset:
    """A stationary, tileable texture of unit mean for each geometry.

    Parameters
    ----------
    pictures : geometry → (rows, columns) light in any unit, at least 64 pixels along either side, the lower row first. Geometries are those of
        :mod:`brdfpipe.flakes.geometries`, or :data:`DIFFUSE`
    pixel : side of a pixel [um]
    size : pixels along either side of the texture, 32 to 8192
    method : as :func:`brdfpipe.texture.synthesis.synthesise` takes it. ``structure`` keeps single sparkles
    seed : the same seed gives the same texture

    Returns
    -------
    Dataset of kind ``texture``: ``relative_light(geometry, y, x)`` of mean 1, the first row at the lowest y; the spectra, the distribution and the measures of each picture
    (:mod:`brdfpipe.texture.sparkle`), and what remains between picture and texture

    Raises
    ------
    BrdfpipeError : an unknown geometry, or a value out of range.
    """
    angles = [picture_angle(name) for name in pictures]
    shortest = min(min(np.shape(values)) for values in pictures.values())
    found = [
        _of_picture(values, pixel, size, method, seed + number, shortest)
        for number, values in enumerate(pictures.values())
    ]
    names = list(found[0])
    dimensions = {
        "relative_light": ("geometry", "y", "x"),
        **dict.fromkeys(("sample_contrast_psd", "tile_contrast_psd"), ("geometry", "texture_frequency")),
        "light_quantile": ("geometry", "quantile"),
    }
    positions = (np.arange(size) + 0.5) * pixel
    variables = {
        name: (dimensions.get(name, ("geometry",)), np.stack([one[name] for one in found]))
        for name in names
        if name != "texture_frequency"
    }
    texture = xr.Dataset(
        {**variables, "theta_f": ("geometry", np.array(angles))},
        coords={
            "geometry": list(pictures),
            "x": positions,
            "y": positions,
            "quantile": QUANTILES,
            "texture_frequency": found[0]["texture_frequency"],
        },
        attrs={
            "source": "pictures",
            "pixel": pixel,
            "method": method,
            "seed": seed,
            "interpolation": "bilinear",
            "sparkle_threshold": THRESHOLD,
            "graininess_distance": VIEWING_DISTANCE,
        },
    )
    warnings = [
        f"the illumination of the picture at {name} changes by {float(one['illumination_range']):.0%}, and was divided out; light it more evenly"
        for name, one in zip(pictures, found, strict=True)
        if one["illumination_range"] > NOTABLE_GRADIENT
    ]
    return vocabulary.add_warning(vocabulary.label(texture, "texture"), *warnings)


def nearest_geometry(texture: xr.Dataset, angle: Array) -> NDArray[np.intp]:
    """Number of the picture whose flake angle [degree] is nearest; pictures in diffuse light are not asked for if there is another."""
    angles = texture["theta_f"].values
    if np.isnan(angles).all():
        return np.zeros(np.shape(angle), dtype=np.intp)
    distance = np.abs(np.asarray(angle)[..., None] - angles)
    return np.asarray(np.nanargmin(distance, axis=-1), dtype=np.intp)


def picture_angle(geometry: str) -> float:
    """Flake angle [degree] of a geometry, below a coat of :data:`COAT_INDEX`; NaN in diffuse light.

    Raises BrdfpipeError: an unknown geometry, or directions below the surface.
    """
    if geometry == DIFFUSE:
        return np.nan
    try:
        pair = directions(geometry)
    except BrdfpipeError:
        words = f"geometry {geometry[:40]!r} of a picture is unknown, or not above the surface"
        raise BrdfpipeError(f"{words}; accepted: {DIFFUSE}, or as 45as15, 45:-30, 45as25az90") from None
    return float(flake_angle(*pair, COAT_INDEX))


def _of_picture(values: Array, pixel: float, size: int, method: str, seed: int, shortest: int) -> dict[str, Any]:
    sample, gradient = without_gradient(np.asarray(values, dtype=float))
    tile = positive(1 + synthesise(sample, size, method=method, seed=seed, overlap=NARROW_OVERLAP), sample)
    frequency, of_sample, of_tile = ring_spectra(sample, tile - 1, shortest=shortest)
    remains, points = likeness(sample, tile), sparkle(sample, pixel)
    return {
        "relative_light": tile.astype(np.float32),
        "texture_frequency": frequency / pixel,
        "sample_contrast_psd": of_sample * pixel**2,
        "tile_contrast_psd": of_tile * pixel**2,
        "light_quantile": np.quantile(sample, QUANTILES),
        "illumination_range": gradient,
        "sparkle_density": points.density,
        "sparkle_area": points.area,
        "sparkle_contrast": points.contrast,
        "graininess": graininess(sample, pixel),
        "tile_sparkle_density": sparkle(tile, pixel).density,
        "tile_graininess": graininess(tile, pixel),
        "spectrum_difference": remains.spectrum,
        "value_difference": remains.heights,
        "slope_difference": remains.slopes,
    }

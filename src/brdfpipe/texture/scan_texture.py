"""The texture of a scan as a dataset: a tileable height map, its spectrum beside that of the scan, and the facets that its pixels do not resolve."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import plain
from brdfpipe.geometry import Array
from brdfpipe.texture.grain import grain
from brdfpipe.texture.height_pixels import central_slopes, unit_normals
from brdfpipe.texture.level_of_detail import NOTICEABLE, levels_of_detail
from brdfpipe.texture.slope_split import INTERPOLATIONS, MapSlopes, binned_slopes, interpolated_slopes
from brdfpipe.texture.synthesis import METHODS, ring_spectra

_FACET_VARIABLES = ("slope_density", "D", "lambda_smith", "slope_rms", "anisotropy", "lay")


def of_scan(
    surface: xr.Dataset,
    facets: xr.Dataset,
    *,
    pixel: float,
    size: int = 512,
    method: str = METHODS[0],
    seed: int = 0,
    interpolation: str = INTERPOLATIONS[0],
    distance: float | None = None,
) -> xr.Dataset:
    """A tileable map of a scan and the facets that it leaves to the BRDF.

    Parameters
    ----------
    surface, facets, pixel, size, method, seed, interpolation : as :func:`brdfpipe.texture.grain.grain` takes them
    distance : viewing distance [m]. The pixel is then the coarsest whose contrast an eye there does not distinguish from that of ``pixel``, the finest one
        (:func:`brdfpipe.texture.level_of_detail.levels_of_detail`)

    Returns
    -------
    Dataset of kind ``texture``: ``height(y, x)`` [um], the first row at the lowest y; ``sample_psd`` and ``tile_psd`` [um4] over ``texture_frequency``;
    the variables of kind ``facets`` of what the pixels do not resolve (:func:`facets_of`); the figures of the split and of the likeness; and of a viewing
    distance ``level_difference(level_pixel)`` [1], ``level_pixel`` [um], the chosen one first

    Raises
    ------
    BrdfpipeError, VocabularyError : as :func:`brdfpipe.texture.grain.grain`.
    """
    levels, warnings = [], []
    if distance is not None:
        levels = levels_of_detail(surface, facets, finest=pixel, distance=distance, interpolation=interpolation)
        pixel = levels[-1].pixel
        if len(levels) == 1 and levels[0].difference <= NOTICEABLE:
            warnings.append(
                f"at {distance:g} m an eye sees with pixels of {plain(pixel)} µm, the coarsest for a scan of this size, the contrast of the finest: at that "
                "distance the BRDF of all facets may need no map"
            )
    found = grain(surface, facets, pixel, size=size, method=method, seed=seed, interpolation=interpolation)
    frequency, sample_power, tile_power = ring_spectra(found.sample, found.height)
    positions = (np.arange(size) + 0.5) * pixel
    of_rest = [name for name in _FACET_VARIABLES if name in found.facets]
    texture = xr.Dataset(
        {
            "height": (("y", "x"), found.height),
            "sample_psd": ("texture_frequency", sample_power * pixel**2),
            "tile_psd": ("texture_frequency", tile_power * pixel**2),
            "unresolved_share": found.unresolved,
            "split_difference": found.split_difference,
            "spectrum_difference": found.likeness.spectrum,
            "value_difference": found.likeness.heights,
            "slope_difference": found.likeness.slopes,
            **{name: found.facets[name].variable for name in of_rest},
        },
        coords={"x": positions, "y": positions, "texture_frequency": frequency / pixel}
        | {name: found.facets[name].variable for name in found.facets.coords},
        attrs={
            "source": "scan",
            "pixel": pixel,
            "method": method,
            "seed": seed,
            "interpolation": interpolation,
            "band": str(found.facets.attrs["band"]),
        },
    )
    if levels:
        pixels, differences = zip(*reversed(levels), strict=True)
        texture = texture.assign_coords(level_pixel=list(pixels)).assign_attrs(viewing_distance=distance)
        texture["level_difference"] = "level_pixel", list(differences)
    return vocabulary.add_warning(vocabulary.label(texture, "texture"), *warnings, *found.warnings)


def facets_of(texture: xr.Dataset) -> xr.Dataset:
    """Kind ``facets``: those that the pixels of the texture of a scan do not resolve."""
    rest = texture[[name for name in _FACET_VARIABLES if name in texture]]
    used = {str(dimension) for name in rest.data_vars for dimension in rest[name].dims}
    rest = rest.drop_vars([name for name in rest.coords if str(name) not in used])
    rest.attrs = {"method": "facets that a normal map does not resolve", "band": texture.attrs["band"]}
    return vocabulary.label(rest, "facets")


def map_slopes(texture: xr.Dataset, bins_per_width: float, most: int, places: int = 4) -> MapSlopes:
    """The slopes of the map of a texture as a renderer sees them, in bins (:func:`brdfpipe.texture.slope_split.binned_slopes`), of so many places between pixels."""
    height, pixel = np.asarray(texture["height"].values, dtype=float), float(texture.attrs["pixel"])
    seen = interpolated_slopes(*central_slopes(height, pixel), str(texture.attrs["interpolation"]), places)
    return binned_slopes(seen, _narrower_rms(texture), bins_per_width, most)


def _narrower_rms(texture: xr.Dataset) -> float:
    """Slope rms of the rest along the axis along which it is smaller."""
    total, ratio = float(texture["slope_rms"]), float(texture.get("anisotropy", 1.0))
    return total / np.sqrt(1 + max(ratio, 1 / ratio) ** 2)


def normals_of(texture: xr.Dataset) -> Array:
    """(rows, columns, 3) unit normals of the pixels of a scan's texture: x to the right, y upwards, z off the surface; the first row at the lowest y."""
    height = np.asarray(texture["height"].values, dtype=float)
    return unit_normals(*central_slopes(height, float(texture.attrs["pixel"])))

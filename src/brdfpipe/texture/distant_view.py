"""A picture of a textured surface as an eye sees it from a distance: sparkles and shaded grain under a spot, graininess in diffuse light."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.lights import WHITE_LEVEL
from brdfpipe.appearance.preview import channels_of, tone
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry
from brdfpipe.texture.eye import eye_blur, resolved_size
from brdfpipe.texture.picture_texture import DIFFUSE
from brdfpipe.texture.scan_texture import normals_of
from brdfpipe.texture.sparkle import VIEWING_DISTANCE
from brdfpipe.texture.textured import Textured

LIGHTS = ("spot", "diffuse")
"""``spot``: from one direction, 45 degree from the normal, seen 15 degree from its mirror direction. ``diffuse``: from everywhere, seen along the normal."""

_SPOT = np.array([45.0]), np.array([0.0]), np.array([30.0]), np.array([180.0])
_PIXELS_PER_EYE = 2.0
"""Pixels of the picture along what an eye resolves."""
_ALBEDO_NODES = 90
_EVALUATED = 65_536
"""Places that are evaluated at once."""


def structure_preview(
    bsdf: xr.Dataset,
    texture: xr.Dataset,
    rest: xr.Dataset | None = None,
    *,
    distance: float = VIEWING_DISTANCE,
    light: str = LIGHTS[0],
    illuminant: str = "D65",
    side: int = 256,
) -> xr.Dataset:
    """A square of a flat panel at a viewing distance.

    Parameters
    ----------
    bsdf, texture, rest : as :class:`brdfpipe.texture.textured.Textured` takes them
    distance : of the eye [m]; a pixel of the picture is half of what an eye resolves there
    light : one of :data:`LIGHTS`
    illuminant : spectrum of the light; the eye is assumed to be adapted to it
    side : pixels along either side of the picture

    Returns
    -------
    Dataset of kind ``preview``: ``picture(row, column, channel)``, sRGB from 0 to 255, the upper row first. A perfect white diffuser in the same light has
    :data:`brdfpipe.appearance.lights.WHITE_LEVEL`. ``relative_light(y, x)`` is the light of the picture over its mean over the tile

    Raises
    ------
    BrdfpipeError : an unknown light, a distance that is not above 0, or diffuse light on pictures of which none is of it.

    Notes
    -----
    The eye blurs by a Gaussian of one minute of arc, full width at half maximum. Places differ in the amount of light and not in its colour, which is
    that of the BRDF. In diffuse light a place of a scan is as bright as the albedo of the rest at the angle between its normal and the view, by reciprocity; its
    neighbours hide nothing of the sky.
    """
    if light not in LIGHTS:
        raise BrdfpipeError(f"unknown light {light!r}; accepted: {' or '.join(LIGHTS)}")
    if not distance > 0:
        raise BrdfpipeError(f"a viewing distance of {distance:g} m; accepted: above 0")
    textured = Textured(nonspectral(bsdf), texture, None if rest is None else nonspectral(rest))
    tile = _under_spot(textured, texture) if light == "spot" else _in_diffuse_light(texture, rest)
    tile = tile / tile.mean()
    seen = _seen(tile, float(texture.attrs["pixel"]), distance, side)
    wavelengths, channels = channels_of(bsdf, illuminant)
    model = representation(bsdf)
    # Relative to a perfect diffuser, of a BRDF of 1/π and an albedo of 1.
    values = (
        np.pi * model.evaluate(*_SPOT, wavelengths)
        if light == "spot"
        else model.albedo(np.zeros(1), np.zeros(1), wavelengths)
    )
    colour = values[0] @ channels
    shown = (255 * colorimetry.encoded_srgb(tone(WHITE_LEVEL * seen[..., None] * colour))).round().astype(np.uint8)
    picture = xr.Dataset(
        {"picture": (("row", "column", "channel"), shown[::-1]), "relative_light": (("y", "x"), seen)},
        coords={"channel": ["R", "G", "B"]},
        attrs={
            "illuminant": colorimetry.illuminant_name(illuminant),
            "light": light,
            "white_level": WHITE_LEVEL,
            "viewing_distance": distance,
        },
    )
    return vocabulary.label(picture, "preview")


def structure_previews(
    bsdf: xr.Dataset,
    texture: xr.Dataset,
    rest: xr.Dataset | None = None,
    *,
    distance: float = VIEWING_DISTANCE,
    illuminant: str = "D65",
) -> xr.Dataset:
    """Pictures of :func:`structure_preview` under a spot, and in diffuse light where the texture has it.

    Returns
    -------
    Dataset of kind ``preview``: ``picture`` under a spot and, of a scan or of pictures with one in diffuse light, ``picture_in`` that light. The attribute ``contrast`` [1] has the
    rms contrast of each, and ``picture_width`` the side of the pictures [mm]
    """
    diffuse = texture.attrs["source"] == "scan" or DIFFUSE in texture["geometry"].values
    shown = [
        structure_preview(bsdf, texture, rest, distance=distance, light=light, illuminant=illuminant)
        for light in (LIGHTS if diffuse else LIGHTS[:1])
    ]
    both = shown[0].drop_vars("relative_light")
    if diffuse:
        both["picture_in"] = (("lighting", "row", "column", "channel"), shown[1]["picture"].values[None])
        both = both.assign_coords(
            light_of=("lighting", [LIGHTS[1]]), illuminant_of=("lighting", [both.attrs["illuminant"]])
        )
    contrasts = [float(one["relative_light"].std() / one["relative_light"].mean()) for one in shown]
    side = both.sizes["row"] * resolved_size(distance) / _PIXELS_PER_EYE / 1000
    return vocabulary.label(both.assign_attrs(contrast=contrasts, picture_width=side), "preview")


def _under_spot(textured: Textured, texture: xr.Dataset) -> Array:
    """(rows, columns) light of the pixels of a tile."""
    x, y = (one.ravel() for one in np.meshgrid(texture["x"].values, texture["y"].values))
    light = np.empty(x.size)
    for start in range(0, x.size, _EVALUATED):
        part = slice(start, start + _EVALUATED)
        values = textured.evaluate(*_SPOT, x[part], y[part]).values
        light[part] = values.reshape(len(values), -1).mean(axis=1)
    return light.reshape(texture.sizes["y"], texture.sizes["x"])


def _in_diffuse_light(texture: xr.Dataset, rest: xr.Dataset | None) -> Array:
    """The same in light from everywhere."""
    if rest is not None and texture.attrs["source"] == "scan":
        normals = normals_of(texture)
        # By the bins of the polar angle: a surface with a lay has nearly the same albedo from all azimuths.
        nodes = np.linspace(0.0, 89.0, _ALBEDO_NODES)
        albedo = representation(nonspectral(rest)).albedo(nodes, np.zeros(_ALBEDO_NODES), None).mean(axis=-1)
        return np.interp(np.degrees(np.arccos(np.clip(normals[..., 2], 0, 1))), nodes, albedo)
    if DIFFUSE not in texture["geometry"].values:
        raise BrdfpipeError(
            f"no picture of the texture is in diffuse light; accepted: one with `geometry: {DIFFUSE}`, or light {LIGHTS[0]!r}"
        )
    return np.asarray(texture["relative_light"].sel(geometry=DIFFUSE).values, dtype=float)


def _seen(tile: Array, pixel: float, distance: float, side: int) -> Array:
    """(side, side) values of a periodic tile, as an eye sees them at a distance [m], at the pixels of the picture."""
    from scipy.ndimage import map_coordinates

    blurred = eye_blur(tile, pixel, distance)
    at = (np.arange(side) + 0.5) * resolved_size(distance) / _PIXELS_PER_EYE / pixel - 0.5
    rows, columns = np.meshgrid(at, at, indexing="ij")
    return np.asarray(map_coordinates(blurred, [rows, columns], order=1, mode="grid-wrap"))

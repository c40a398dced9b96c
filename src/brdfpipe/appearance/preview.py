"""A picture of a material: a sphere and a flat panel under known lights.

The picture is a rendering of the model, through ``evaluate`` and ``specular``, at a fixed exposure: pictures of different materials
are comparable. The brightest spot of a perfect white diffuser has :data:`brdfpipe.appearance.lights.WHITE_LEVEL`. Below that level
the picture is linear; above it :func:`tone` compresses each channel towards the screen's white. Light that one subject reflects to
the other is not included. Light through a slab comes from an evenly lit backdrop.
"""

from __future__ import annotations

from io import BytesIO

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from brdfpipe import vocabulary
from brdfpipe.appearance.lights import WHITE_LEVEL, Lights, lights
from brdfpipe.appearance.preview_geometry import Shot, panel, sphere
from brdfpipe.appearance.transport import Table, in_channels
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

SIDE = 256
"""Pixels along the side of each of the two pictures."""

BACKDROP = (0.42, 0.30)
"""Linear grey of the backdrop at its top and its bottom."""

_WAVELENGTHS = np.arange(400.0, 701.0, 20.0)
_FEWEST_OF_SPLINE = 4


def preview(bsdf: xr.Dataset, *, illuminant: str = "D65", light: str = "studio", side: int = SIDE) -> xr.Dataset:
    """Render a material.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of any representation
    illuminant : spectrum of all lights; the eye is assumed to be adapted to it
    light : one of :data:`brdfpipe.appearance.lights.LIGHTS`
    side : pixels along each side of each of the two pictures

    Returns
    -------
    Dataset of kind ``preview``: ``picture(row, column, channel)``, sRGB from 0 to 255, the sphere to the left and the panel to the right

    Raises
    ------
    LightError : an unknown light.
    BrdfpipeError : an unknown illuminant.
    """
    vocabulary.validate(bsdf, "bsdf")
    environment, channels = lights(light), channels_of(bsdf, illuminant)
    table = Table.of(bsdf, *channels)
    pictures = []
    for shot in (sphere(side), panel(side)):
        pictures.append(_composed(shot, radiance(table, shot, environment), _transmitted(bsdf, shot, *channels)))
    shown = (255 * colorimetry.encoded_srgb(np.concatenate(pictures, axis=1))).round().astype(np.uint8)
    picture = xr.Dataset(
        {"picture": (("row", "column", "channel"), shown)},
        coords={"channel": ["R", "G", "B"]},
        attrs={"illuminant": colorimetry.illuminant_name(illuminant), "light": light, "white_level": WHITE_LEVEL},
    )
    return vocabulary.label(picture, "preview")


def png(preview: xr.Dataset) -> bytes:
    """The picture as a PNG file, the same bytes for the same picture."""
    from PIL import Image

    stream = BytesIO()
    pixels: NDArray[np.uint8] = np.ascontiguousarray(preview["picture"].values, dtype=np.uint8)
    Image.fromarray(pixels).save(stream, "PNG")  # to optimise it takes ten times as long and saves a tenth
    return stream.getvalue()


def radiance(table: Table, shot: Shot, environment: Lights) -> Array:
    """Radiance of the pixels that a subject covers, (pixels, channels), at the exposure of the picture."""
    far = shot.upsampled(table.far_light(shot.coarse, environment))
    return (table.near_light(shot.pixels, environment) + far) * environment.exposure


def channels_of(bsdf: xr.Dataset, illuminant: str = "D65") -> tuple[Array | None, Array]:
    """Wavelengths to evaluate at, and their weights in linear sRGB (wavelength, 3), for white (1, 1, 1).

    A reflectance between wavelengths 20 nm apart is that of a cubic spline, and constant beyond 400 and 700 nm; between the wavelengths of a BSDF
    that has fewer it is linear. Other illuminants are adapted to D65 with the Bradford matrix.
    """
    *_, grid, weights, white = colorimetry.weights(illuminant, 2)
    to_screen = colorimetry.srgb_from_xyz(white)
    if "wavelength" not in bsdf.coords:
        return None, (to_screen @ white)[None]
    own = bsdf["wavelength"].values
    first, last = np.searchsorted(_WAVELENGTHS, own[0]), np.searchsorted(_WAVELENGTHS, own[-1], side="right")
    inside = _WAVELENGTHS[first:last]
    if inside.size < own.size and inside.size >= _FEWEST_OF_SPLINE:
        # Straight lines 20 nm long would take off as much from the peaks of a spectrum as saturated colours have of their weakest channel.
        spline = CubicSpline(inside, np.eye(inside.size), bc_type="natural")
        return inside, spline(np.clip(grid, inside[0], inside[-1])).T @ weights @ to_screen.T
    wavelength = own if own.size <= max(inside.size, 1) else inside if inside.size else own[[0, -1]]
    hats = np.stack([np.interp(grid, wavelength, row) for row in np.eye(wavelength.size)])
    return wavelength, hats @ weights @ to_screen.T


def tone(linear: Array) -> Array:
    """Linear light in the linear range of the screen: unchanged up to :data:`WHITE_LEVEL`, then an exponential that ends at 1."""
    room = 1 - WHITE_LEVEL
    above = np.maximum(linear - WHITE_LEVEL, 0)
    return np.clip(np.minimum(linear, WHITE_LEVEL) + room * (1 - np.exp(-above / room)), 0, 1)


def _transmitted(bsdf: xr.Dataset, shot: Shot, wavelength: Array | None, channels: Array) -> Array | float:
    """Share of an even light behind a slab that reaches the camera, (pixels, channels): the transmittance, by reciprocity."""
    if not representation(bsdf).is_slab:
        return 0.0
    theta = np.linspace(0.0, 85.0, 18)
    share = representation(bsdf).transmittance(theta, np.zeros(theta.size), wavelength)
    share = in_channels(share, channels)
    view_angle = np.degrees(np.arccos(np.minimum((shot.pixels.normal * shot.pixels.view).sum(axis=1), 1)))
    # At grazing all light is reflected.
    nodes, share = np.append(theta, 90.0), np.concatenate([share, np.zeros((1, share.shape[1]))])
    return np.stack([np.interp(view_angle, nodes, column) for column in share.T], axis=-1)


def _composed(shot: Shot, reflected: Array, transmitted: Array | float) -> Array:
    """The subject in front of the backdrop, (side, side, 3), linear."""
    side = len(shot.coverage)
    grey = np.broadcast_to(np.linspace(*BACKDROP, side)[:, None, None], (side, side, 3))
    covered = shot.coverage > 0
    subject = np.zeros((side, side, 3))
    # Toned before it is blended: a highlight much brighter than white would leave a jagged edge.
    subject[covered] = tone(reflected + transmitted * grey[covered])
    share = shot.coverage[..., None]
    return np.asarray(share * subject + (1 - share) * grey)

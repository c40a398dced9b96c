"""A picture of a material: a sphere, a flat panel and a moulded part, in the light that a scene chooses and in some others.

The picture is a rendering of the model, through ``evaluate`` and ``specular``, at a fixed exposure: pictures of different materials
are comparable. The brightest spot of a perfect white diffuser has :data:`brdfpipe.appearance.lights.WHITE_LEVEL`. Below that level
the picture is linear; above it :func:`tone` compresses each channel towards the screen's white. Light that one subject reflects to
the other is not included. Light through a slab comes from an evenly lit backdrop.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from io import BytesIO
from typing import NamedTuple

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
"""Pixels along the side of the picture of each subject."""

SUBJECTS = ("sphere", "panel", "part")
"""From left to right."""


class Lighting(NamedTuple):
    """Lights and their spectrum."""

    light: str
    """One of :data:`brdfpipe.appearance.lights.LIGHTS`"""
    illuminant: str


OTHER_LIGHTS = (Lighting("spot", "A"), Lighting("tubes", "FL11"))
"""In which a material is shown besides the light that the scene chooses."""

BACKDROP = (0.42, 0.30)
"""Linear grey of the backdrop at its top and its bottom."""

_STEPS = 0.042 / np.sqrt(2.0) ** np.arange(14)
"""Angles between the facets of neighbouring points [radian] at which the light of a lobe may be seen. A few, so that materials share grids."""

_STEP = 0.7
"""Largest such angle over the width of the lobe and of the edges of the lights."""

_FEWER = 0.7
"""Share of the number of pixels up to which the points of a grid are worth it."""

_WAVELENGTHS = np.arange(400.0, 701.0, 20.0)
_FEWEST_OF_SPLINE = 4


def preview(
    bsdf: xr.Dataset,
    *,
    illuminant: str = "D65",
    light: str = "studio",
    side: int = SIDE,
    others: Sequence[Lighting] = OTHER_LIGHTS,
) -> xr.Dataset:
    """Render a material.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of any representation
    illuminant : spectrum of all lights; the eye is assumed to be adapted to it
    light : one of :data:`brdfpipe.appearance.lights.LIGHTS`
    side : pixels along each side of the picture of a subject
    others : further lights and illuminants; one that is ``light`` and ``illuminant`` is left out

    Returns
    -------
    Dataset of kind ``preview``: ``picture(row, column, channel)``, sRGB from 0 to 255, of :data:`SUBJECTS` from left to right; and where
    there are further lights ``picture_in(lighting, row, column, channel)``, with their ``light_of`` and ``illuminant_of``

    Raises
    ------
    LightError : an unknown light.
    BrdfpipeError : an unknown illuminant.
    """
    from brdfpipe.appearance.moulded_part import moulded_part

    vocabulary.validate(bsdf, "bsdf")
    own = Lighting(light, colorimetry.illuminant_name(illuminant))
    lightings = [own, *(other for other in others if other != own)]
    environments = [lights(one.light) for one in lightings]
    weights = [channels_of(bsdf, one.illuminant) for one in lightings]
    wavelength, channels = weights[0][0], np.concatenate([channels for _, channels in weights], axis=1)
    table = Table.of(bsdf, wavelength, channels)
    pictures = []
    for shot in (sphere(side), panel(side)):
        seen = radiance(table, shot, *environments) + _transmitted(bsdf, shot, wavelength, channels)
        # Toned before it is blended: a highlight much brighter than white would leave a jagged edge.
        pictures.append((shot.coverage, tone(seen)))
    part = moulded_part(side)
    pictures.append((part.coverage, part.lit_as(pictures[0][1])))
    shown = np.concatenate([_composed(*picture) for picture in pictures], axis=1)
    # One picture after the other in memory: all that is done with them afterwards takes them in that order.
    shown = np.ascontiguousarray(np.moveaxis(shown.reshape(side, len(SUBJECTS) * side, len(lightings), 3), 2, 0))
    picture = xr.Dataset(
        {"picture": (("row", "column", "channel"), shown[0])},
        coords={"channel": ["R", "G", "B"]},
        attrs={"illuminant": own.illuminant, "light": light, "white_level": WHITE_LEVEL},
    )
    if lightings[1:]:
        picture["picture_in"] = (("lighting", "row", "column", "channel"), shown[1:])
        picture = picture.assign_coords(
            light_of=("lighting", [one.light for one in lightings[1:]]),
            illuminant_of=("lighting", [one.illuminant for one in lightings[1:]]),
        )
    return vocabulary.label(picture, "preview")


def png(preview: xr.Dataset) -> bytes:
    """The picture as a PNG file, the same bytes for the same picture."""
    from PIL import Image

    stream = BytesIO()
    pixels: NDArray[np.uint8] = np.ascontiguousarray(preview["picture"].values, dtype=np.uint8)
    # The default level takes half as long again, to optimise ten times as long; either saves less than a tenth.
    Image.fromarray(pixels).save(stream, "PNG", compress_level=5)
    return stream.getvalue()


def radiance(table: Table, shot: Shot, *environments: Lights) -> Array:
    """Radiance of the pixels that a subject covers, (pixels, channels), at the exposure of the picture.

    In several lights, each has its own equal share of the channels.
    """
    seen = table.mirrored_light(shot.pixels, *environments)
    seen += shot.upsampled(table.far_light(shot.coarse, *environments))
    if table.has_facets:
        edge = min([box.softness for one in environments for box in one.boxes], default=np.inf)
        grid = shot.with_step(_step(float(np.hypot(table.width, edge / 2))), _FEWER * len(shot.pixels.normal))
        if grid:
            seen += grid.upsampled(table.near_light(grid.coarse, *environments))
        else:
            seen += table.near_light(shot.pixels, *environments)
    seen *= np.repeat([one.exposure for one in environments], seen.shape[1] // len(environments))
    return seen


def _step(width: float) -> float:
    """The step of the grid for a lobe of a half width, in slope."""
    return float(_STEPS[min(np.searchsorted(-_STEPS, -_STEP * width), len(_STEPS) - 1)])


def channels_of(bsdf: xr.Dataset, illuminant: str = "D65") -> tuple[Array | None, Array]:
    """Wavelengths to evaluate at, and their weights in linear sRGB (wavelength, 3), for white (1, 1, 1).

    A reflectance between wavelengths 20 nm apart is that of a cubic spline, and constant beyond 400 and 700 nm; between the wavelengths of a BSDF
    that has fewer it is linear. Other illuminants are adapted to D65 with the Bradford matrix.
    """
    return _channels(tuple(bsdf["wavelength"].values.tolist()) if "wavelength" in bsdf.coords else (), illuminant)


@lru_cache(maxsize=64)
def _channels(wavelengths: tuple[float, ...], illuminant: str) -> tuple[Array | None, Array]:
    """Of a BSDF at these wavelengths; catalogues have few sets of them."""
    *_, grid, weights, white = colorimetry.weights(illuminant, 2)
    to_screen = colorimetry.srgb_from_xyz(white)
    if not wavelengths:
        return None, (to_screen @ white)[None]
    own = np.array(wavelengths)
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
    shown = np.clip(linear, 0, None)
    bright = shown > WHITE_LEVEL
    shown[bright] = WHITE_LEVEL + room * (1 - np.exp((WHITE_LEVEL - shown[bright]) / room))
    return np.asarray(shown)


def _transmitted(bsdf: xr.Dataset, shot: Shot, wavelength: Array | None, channels: Array) -> Array | float:
    """Light of the backdrop that a slab lets through to the camera, (pixels, channels): by reciprocity its transmittance."""
    if not representation(bsdf).is_slab:
        return 0.0
    theta = np.linspace(0.0, 85.0, 18)
    share = representation(bsdf).transmittance(theta, np.zeros(theta.size), wavelength)
    share = in_channels(share, channels)
    view_angle = np.degrees(np.arccos(np.minimum(shot.pixels.cosine, 1)))
    # At grazing all light is reflected.
    nodes, share = np.append(theta, 90.0), np.concatenate([share, np.zeros((1, share.shape[1]))])
    cell = np.searchsorted(nodes[1:-1], view_angle, side="right")
    passed = (np.diff(share, axis=0) / np.diff(nodes)[:, None])[cell]
    passed *= (view_angle - nodes[cell])[:, None]
    passed += share[cell]
    passed *= _backdrop(len(shot.coverage))[np.nonzero(shot.coverage)[0], None]
    return passed


def _composed(coverage: Array, subject: Array) -> NDArray[np.uint8]:
    """The subject (pixels, channels) in front of the backdrop, as the screen shows it: (side, side, channels), sRGB from 0 to 255."""
    side = len(coverage)
    screen = _screen()
    shown = np.empty((side, side, subject.shape[1]), dtype=np.uint8)
    shown[:] = screen[_levels(_backdrop(side))][:, None, None]
    covered = np.flatnonzero(coverage)
    share = coverage.ravel()[covered].astype(np.float32)[:, None]
    blended = share * subject + (1 - share) * _backdrop(side)[covered // side, None]
    shown.reshape(side * side, -1)[covered] = screen[_levels(blended)]
    return shown


def _backdrop(side: int) -> Array:
    """Linear grey of each row."""
    return np.linspace(*BACKDROP, side)


def _levels(linear: Array) -> NDArray[np.uint16]:
    """Linear light from 0 to 1 in 65 535 steps: below a fifth of a step of the screen, also in the dark."""
    return (linear * 65535 + 0.5).astype(np.uint16)


@cache
def _screen() -> NDArray[np.uint8]:
    """sRGB from 0 to 255 of each level."""
    return np.asarray((255 * colorimetry.encoded_srgb(np.arange(65536) / 65535)).round().astype(np.uint8))

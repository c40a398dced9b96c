"""The lights of a preview: soft boxes and a sky, infinitely far away.

World axes: x to the right, y away from the camera, z up. Every light has the spectrum of the illuminant, so that each direction
has one radiance. The edges of a box are Gaussian integrals, which a Gaussian blur turns into wider Gaussian integrals, exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from brdfpipe.content_cache import cached_by_content
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

Floats = NDArray[np.float32]

WHITE_LEVEL = 0.75
"""Brightest spot of a perfect white diffuser, as a share of the screen's white: L* 89."""

SOFTNESS = 0.02
"""Standard deviation of the edges of a box, in the tangent plane of its axis [1]; a little over 1 degree."""


class LightError(BrdfpipeError):
    """Unknown light."""


@dataclass(frozen=True)
class SoftBox:
    """An area light."""

    axis: tuple[float, float, float]
    """Towards the centre of the box; need not be normalised."""
    half_width: float
    """Horizontal, in the plane tangent to the axis [1]."""
    half_height: float
    radiance: float
    softness: float = SOFTNESS

    def light_from(self, directions: Array, blur: float = 0.0) -> Array:
        """Radiance from directions (…, 3), the light convolved with a Gaussian of standard deviation ``blur`` [radian]."""
        from scipy.special import ndtr

        centre = np.array(self.axis) / np.linalg.norm(self.axis)
        across = np.cross([0.0, 0.0, 1.0], centre)
        across /= np.linalg.norm(across)
        along = directions @ centre
        sigma = np.hypot(self.softness, blur)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = directions @ across / along, directions @ np.cross(centre, across) / along
        reach = 5 * sigma
        near = (along > 0.05) & (np.abs(u) < self.half_width + reach) & (np.abs(v) < self.half_height + reach)
        value = np.zeros(along.shape)
        inside = [
            ndtr((half + at[near]) / sigma) - ndtr((at[near] - half) / sigma)
            for at, half in ((u, self.half_width), (v, self.half_height))
        ]
        # The tangent plane is larger than the solid angle by cos⁻³: a blur in it loses light, which this factor restores.
        value[near] = self.radiance * (1 + 3 * blur**2) * inside[0] * inside[1]
        return value


@dataclass(frozen=True)
class Lights:
    """Soft boxes and a sky."""

    boxes: tuple[SoftBox, ...]
    zenith: float
    """Radiance of the sky overhead"""
    ground: float
    """Radiance from straight below"""

    def radiance(self, directions: Array, blur: float = 0.0) -> Array:
        """Radiance from unit vectors (…, 3), before exposure, convolved with a Gaussian of ``blur`` [radian]."""
        rise = np.clip((directions[..., 2] + 0.4) / 1.4, 0, 1)
        sky = self.ground + (self.zenith - self.ground) * rise * rise * (3 - 2 * rise)
        return np.asarray(sky + sum(box.light_from(directions, blur) for box in self.boxes))

    @cached_property
    def exposure(self) -> float:
        """Factor that gives the brightest spot of a white matt sphere :data:`WHITE_LEVEL`."""
        directions, solid_angle = sphere_rule(20_000)
        light = self.radiance(directions, float(np.sqrt(solid_angle)) / 2)
        normals, _ = sphere_rule(400)
        irradiance = (float(light @ np.maximum(directions @ normal, 0.0)) for normal in normals)
        return WHITE_LEVEL / max(total * solid_angle / np.pi for total in irradiance)

    @cached_property
    def filtered(self) -> Filtered:
        """Lookup tables of the same lights."""
        return filtered((self,))

    def of_pixels(self, directions: Array, spread: Array) -> Array:
        """Radiance from single directions (pixels, 3), each blurred by the spread of its pixel (pixels,) [radian]."""
        light, order = np.empty(len(spread)), np.argsort(spread, kind="stable")
        for group in np.array_split(order, min(32, len(order))):
            light[group] = self.radiance(directions[group], float(spread[group].mean()))
        return light


LIGHTS: Mapping[str, Lights] = {
    "studio": Lights(
        (
            SoftBox((-0.62, -0.62, 0.58), 0.42, 0.42, 1.0),
            SoftBox((0.12, 0.42, 1.0), 0.62, 0.22, 0.8),
            SoftBox((0.92, -0.30, 0.12), 0.10, 0.75, 0.6),
        ),
        zenith=0.16,
        ground=0.05,
    ),
    "sun": Lights((SoftBox((-0.50, -0.55, 0.72), 0.045, 0.045, 60.0, 0.012),), zenith=0.16, ground=0.06),
    "overcast": Lights((), zenith=1.0, ground=0.15),
    "spot": Lights((SoftBox((-0.45, -0.70, 0.55), 0.10, 0.10, 30.0),), zenith=0.05, ground=0.03),
    "tubes": Lights(
        tuple(SoftBox((0.0, y, 1.0), 1.6, 0.05, 2.0) for y in (-1.1, -0.45, 0.1, 0.7)), zenith=0.10, ground=0.06
    ),
}
"""``studio``: three soft boxes, in front to the left, above, and a strip to the right. ``sun``: a small bright disc and a clear sky.
``overcast``: only a sky. ``spot``: a lamp in a dim room. ``tubes``: four rows of tubes under a ceiling."""


def lights(name: str) -> Lights:
    """Lights by name. Raises LightError: an unknown name, with those known."""
    if name not in LIGHTS:
        raise LightError(
            f"unknown light {str(name)[:40]!r}; accepted: {', '.join(LIGHTS)}; set `preview_light`, in Python `light`"
        )
    return LIGHTS[name]


_DIRECTION_BLUR = 0.75
"""Standard deviation of the blur over the distance of nodes that share a hemisphere evenly."""

_MOST_LOOKUPS = 2**17
"""Pairs of point and direction that are looked up together."""

_LEVELS = 8
_FIRST_BLUR = 0.01
_COARSEST_SIZE = 320
"""Texels along the side of the coarsest level."""
STRAIGHT_DOWN = np.float32(-1 + 2e-6)
"""z below which the map has no azimuth; a corner of it contains the radiance from there."""


@lru_cache(maxsize=8)
def filtered(lights: tuple[Lights, ...]) -> Filtered:
    """Lookup tables of lights that a point is seen in, one after the other: a direction is looked up once for all."""
    return Filtered(lights)


class Filtered:
    """Lights tabulated at several blurs on Lambert's equal-area map of the sphere about the zenith.

    The texels of each level are smaller than its blur, so that the nearest one is accurate enough.
    """

    def __init__(self, lights: tuple[Lights, ...]) -> None:
        self.blur = _FIRST_BLUR * np.sqrt(2.0) ** np.arange(_LEVELS) * (np.arange(_LEVELS) > 0)
        finest = min([box.softness for light in lights for box in light.boxes], default=SOFTNESS)
        width = np.hypot(finest, self.blur)
        self.size = np.round(_COARSEST_SIZE * (width[-1] / width) ** 0.7).astype(np.int32)
        levels = [_texels(int(n)) for n in self.size]
        self.table: Floats = np.stack(
            [
                np.concatenate(
                    [
                        light.radiance(texels, float(blur)).ravel()
                        for texels, blur in zip(levels, self.blur, strict=True)
                    ]
                )
                for light in lights
            ],
            axis=-1,
        ).astype(np.float32)
        """(texels, lights), so that what is looked up together is stored together"""
        self.start = np.concatenate([[0], np.cumsum(self.size**2)[:-1]]).astype(np.int32)

    def __call__(self, x: Floats, y: Floats, z: Floats, blur: Array) -> Floats:
        """Radiance (lights, points, nodes) from unit vectors, each (points, nodes), blurred by (nodes,) [radian]."""
        size, start, scale, half = self.levels(blur)
        stretch = scale / np.sqrt(np.maximum(1 + z, np.float32(1e-6)))
        # In single precision, positions on the rim of the map (straight down) are slightly off to either side.
        column = np.clip((x * stretch + half).astype(np.int32), 0, size - 1)
        row = np.clip((y * stretch + half).astype(np.int32), 0, size - 1)
        if z.min() < STRAIGHT_DOWN:
            row = np.where(z < STRAIGHT_DOWN, 0, row)
        row *= size
        row += column
        row += start
        return np.ascontiguousarray(np.moveaxis(np.take(self.table, row, axis=0), -1, 0))

    @cached_property
    def in_frames(self) -> Callable[[Array, Array], Floats]:
        """Radiance (lights, points, nodes) from directions (nodes, 3) in the frames of points (points, 3, 3), as a function of frames and directions.

        The nodes share a hemisphere evenly; each light is blurred by the share of one. The last few results are kept: they are the same for
        all isotropic materials.
        """
        return cached_by_content(2)(self._in_frames)

    def _in_frames(self, frame: Array, directions: Array) -> Floats:
        blur = np.full(len(directions), _DIRECTION_BLUR * np.sqrt(2 * np.pi / len(directions)))
        light = np.empty((self.table.shape[1], len(frame), len(directions)), dtype=np.float32)
        step = max(1, _MOST_LOOKUPS // len(directions))
        for start in range(0, len(frame), step):
            at = slice(start, start + step)
            x, y, z = ((frame[at, :, axis] @ directions.T).astype(np.float32) for axis in range(3))
            light[:, at] = self(x, y, z, blur)
        return light

    def levels(self, blur: Array) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats]:
        """Of the levels that are blurred most nearly as (nodes,) [radian]: size, first texel, texels for 1 of the map, and half the size."""
        level = np.abs(np.log(np.maximum(blur, 1e-9)[:, None] / np.maximum(self.blur, _FIRST_BLUR / 2))).argmin(axis=1)
        size = self.size[level]
        return (
            size,
            self.start[level],
            (size / (2 * np.sqrt(2.0))).astype(np.float32),
            (size / 2).astype(np.float32),
        )


def _texels(size: int) -> Array:
    """Directions (size, size, 3) of the texels' centres; outside the map, of its rim."""
    centres = (np.arange(size) + 0.5) / size * 2 * np.sqrt(2) - np.sqrt(2)
    x, y = np.meshgrid(centres, centres)
    square = np.minimum(x * x + y * y, 2.0)
    stretch = np.sqrt(2 - square)
    z = 1 - square
    # x = X √(1 + z) on Lambert's map, X² + Y² = 1 − z.
    return np.stack([x * stretch, y * stretch, z], axis=-1)


def sphere_rule(count: int) -> tuple[Array, float]:
    """Directions (count, 3) spread evenly over the sphere, and the solid angle of each [sr]."""
    return golden_spiral(1 - (np.arange(count) + 0.5) * 2 / count), 4 * np.pi / count


def golden_spiral(z: Array) -> Array:
    """Directions (…, 3) at heights z along a golden spiral; evenly spaced heights give equal solid angles."""
    azimuth = np.arange(z.size) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)

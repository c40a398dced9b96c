"""The part of a scan that counts: a rectangle of it, and places of it that are left out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.surfaces.archives import MAX_POINTS
from brdfpipe.surfaces.heights import Heights

if TYPE_CHECKING:
    from PIL import Image

PIXELS = "pixels"
PICTURES = (".bmp", ".png", ".tif", ".tiff")
"""Extensions of pictures that mask a map."""

_MOST_VERTICES = 10_000
_DARK = 128
"""Grey value of 256 below which a point of a picture is dark."""
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr")
"""Pillow's names of pictures of 8 bits, whose black and white are known."""


def cropped(heights: Heights, region: Mapping[str, Any], file: Path) -> Heights:
    """A rectangle of a map, or a stretch of a line.

    Parameters
    ----------
    region : ``x`` and ``y``, each [from, to], in µm from the left and the lower edge, or counted in points if ``unit`` is ``pixels``;
        an axis that is not named is kept whole
    file : for messages

    Raises
    ------
    InputError : a range that is not rising or leaves the scan; ``y`` of a line.
    """
    height = heights.height
    steps = _steps(heights)
    part = []
    for axis, name in zip(range(height.ndim - 1, -1, -1), "xy", strict=False):
        part.append(
            _range(
                region.get(name), steps[axis], height.shape[axis], region.get("unit"), f"surface.region.{name}", file
            )
        )
    if height.ndim == 1 and region.get("y") is not None:
        raise InputError(file, "a line has no y", found="a line profile", accepted="x alone", key="surface.region.y")
    chosen = tuple(reversed(part))
    kept, left_out = height[chosen], None if heights.left_out is None else heights.left_out[chosen]
    if left_out is not None and left_out.all():
        raise InputError(file, "the mask leaves out all of the region", accepted="a part", key="surface.mask")
    words = " × ".join(str(count) for count in reversed(kept.shape))
    starts = ", ".join(str(item.start) for item in part)
    note = f"Cropped to {words} points from point {starts} on, as surface.region says."
    return replace(heights, height=kept, left_out=left_out, history=(*heights.history, note))


def masked(heights: Heights, mask: Mapping[str, Any], picture: Path | None, file: Path) -> Heights:
    """A map without the heights that a picture or polygons mask: they become missing.

    Parameters
    ----------
    mask : ``polygons``, each a list of corners [x, y] in µm from the lower left, or counted in points if ``unit`` is ``pixels``: the heights
        inside are left out; or ``file``, a picture of as many points as the map, upper edge first, whose dark points are left out: those
        below half of the range of 8 or 16 bits, as the picture looks on white where it is transparent
    picture : path of that file
    file : of the map, for messages

    Raises
    ------
    InputError : a line; a picture of another size, of 32 bits or of floating point, or one that cannot be read; a polygon of fewer than three corners; nothing or everything
        is left out.
    """
    if heights.height.ndim != 2:
        raise InputError(
            file, "a mask needs a map", found="a line profile", accepted="`region` for lines", key="surface.mask"
        )
    if "polygons" in mask:
        rows, columns = heights.height.shape
        steps = (1.0, 1.0) if mask.get("unit") == PIXELS else _steps(heights)
        out = np.zeros((rows, columns), dtype=bool)
        for number, corners in enumerate(mask["polygons"], start=1):
            out |= _inside(corners, out.shape, steps, f"surface.mask.polygons, {number}", file)
        source = f"{len(mask['polygons'])} polygons"
    elif picture is None:
        accepted = "polygons; a picture masks the first scan of `surface` alone"
        raise InputError(file, "no picture for this scan", accepted=accepted, key="surface.mask")
    else:
        out, source = _dark(picture, heights.height.shape), picture.name
    share = float(out.mean())
    if not 0 < share < 1:
        found = "every height" if share else "no height"
        raise InputError(file, "the mask leaves out all or nothing", found=found, accepted="a part", key="surface.mask")
    note = f"{np.count_nonzero(out)} heights ({share:.2%}) left out by {source}, as surface.mask says."
    height = np.where(out, heights.height.dtype.type(np.nan), heights.height)
    return replace(heights, height=height, left_out=out, history=(*heights.history, note))


def _steps(heights: Heights) -> tuple[float, ...]:
    """Pitch along each axis of the heights [um]."""
    return (heights.pitch_x,) if heights.pitch_y is None else (heights.pitch_y, heights.pitch_x)


def _range(limits: Sequence[float] | None, step: float, count: int, unit: str | None, key: str, file: Path) -> slice:
    """Points of an axis from a limit up to, without, the other."""
    if limits is None:
        return slice(0, count)
    scale = 1.0 if unit == PIXELS else step
    extent = count * scale
    # Limits in µm are printed with few digits: half a point beyond the edge is the edge.
    rising = limits[0] < limits[1]
    if not rising or not 0 <= limits[0] <= limits[1] <= extent + 0.5 * scale:
        problem = "the region leaves the scan" if rising else "the region ends where it begins, or before"
        found = f"{limits[0]:g} to {limits[1]:g}"
        accepted = f"two rising numbers from 0 to {extent:.6g} {PIXELS if unit == PIXELS else 'um'}"
        raise InputError(file, problem, found=found, accepted=accepted, key=key)
    first, last = math.ceil(limits[0] / scale - 1e-6), min(count, math.ceil(limits[1] / scale - 1e-6))
    return slice(first, last)


def _inside(
    corners: Sequence[Sequence[float]], shape: tuple[int, int], steps: tuple[float, ...], where: str, file: Path
) -> NDArray[np.bool_]:
    """Points inside a polygon, by the even-odd rule; corners [x, y] in units of which ``steps`` are the pitches (y, x)."""
    if not 3 <= len(corners) <= _MOST_VERTICES:
        accepted = f"3 to {_MOST_VERTICES} corners [x, y]"
        raise InputError(file, "not a polygon", where=where, found=f"{len(corners)} corners", accepted=accepted)
    x, y = np.asarray(corners, dtype=float).T
    positions = np.arange(shape[1]) * steps[1]
    inside = np.zeros(shape, dtype=bool)
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    for row in range(shape[0]):
        level = row * steps[0]
        cut = (y <= level) != (next_y <= level)
        if cut.any():
            crossings = x[cut] + (level - y[cut]) / (next_y[cut] - y[cut]) * (next_x[cut] - x[cut])
            inside[row] = np.searchsorted(np.sort(crossings), positions) % 2 == 1
    return inside


def _dark(picture: Path, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Dark points of a picture, the lower edge first."""
    from PIL import Image, UnidentifiedImageError

    rows, columns = shape
    try:
        with Image.open(picture) as image:
            if image.width * image.height > MAX_POINTS or image.size != (columns, rows):
                raise InputError(
                    picture,
                    "the picture has another size than the map",
                    found=f"{image.width} x {image.height}",
                    accepted=f"{columns} x {rows} points, upper edge first",
                    key="surface.mask.file",
                )
            bright = _bright(image, picture)
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, ValueError, SyntaxError) as error:
        if isinstance(error, InputError):
            raise
        accepted = f"a whole picture ({', '.join(PICTURES)})"
        raise InputError(picture, "not a picture, or damaged", accepted=accepted, key="surface.mask.file") from error
    return ~bright[::-1]


def _bright(image: Image.Image, picture: Path) -> NDArray[np.bool_]:
    """Bright points of a picture, in its order."""
    from PIL import Image

    transparent = image.info.get("transparency")
    if image.mode.startswith("I;16"):
        # Pillow would cut these values off at 255.
        grey = np.asarray(image)
        return (grey >= 256 * _DARK) | (np.False_ if transparent is None else grey == transparent)
    if image.mode not in _MODES:
        found = f"a picture of mode {image.mode}, whose black and white are not known"
        accepted = "grey or colour of 8 bits, or grey of 16 bits"
        raise InputError(picture, "cannot tell dark points", found=found, accepted=accepted, key="surface.mask.file")
    if transparent is None and not image.mode.endswith("A"):
        return np.asarray(image.convert("RGB").convert("L")) >= _DARK
    white = Image.new("RGBA", image.size, "white")
    return np.asarray(Image.alpha_composite(white, image.convert("RGBA")).convert("L")) >= _DARK

"""Pictures of a paint as linear values."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from warnings import catch_warnings

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import linear_srgb

PICTURES = (".png", ".tif", ".tiff")
"""Extensions; JPEG changes the fine structure that a texture is made of."""
CURVES = ("linear", "srgb")
"""What the values of a file are to the light: proportional, or encoded as sRGB (IEC 61966-2-1)."""

LEAST_SIDE, MOST_PIXELS = 64, 64_000_000
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear sRGB (IEC 61966-2-1)."""
_NOTABLE_SATURATED = 1e-5


class Picture(NamedTuple):
    """Light of a picture, in any unit."""

    values: Array
    """(rows, columns), the lower row first."""
    stored: str
    """How the file has them, in words."""
    warnings: tuple[str, ...]


def read_picture(path: Path, curve: str | None = None) -> Picture:
    """Luminance of a picture.

    Parameters
    ----------
    path : PNG or TIFF, grey or colour of 8 bits, or grey of 16 bits or of 32-bit floats
    curve : one of :data:`CURVES`; without it 8 bits are taken as sRGB, with a warning, and others as linear

    Raises
    ------
    InputError : no such picture, too small or too large, transparent, black, or of another kind.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        # Pillow warns of what it skips in a damaged file, before it refuses it.
        with catch_warnings(action="ignore", category=UserWarning), Image.open(path, formats=("PNG", "TIFF")) as image:
            # Before it is unpacked: a small file may hold a huge picture.
            if image.width * image.height > MOST_PIXELS or min(image.size) < LEAST_SIDE:
                raise _refused_size(path, f"{image.width} x {image.height} pixels")
            mode = image.mode
            stored = np.asarray(image) if mode in _RANGES else None
    except InputError:
        raise
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise _refused_size(path, "more pixels than Pillow opens") from error
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError) as error:
        accepted = f"a whole picture ({', '.join(PICTURES)})"
        raise InputError(path, "not a picture, or damaged", accepted=accepted, key="texture.pictures") from error
    if stored is None:
        raise InputError(
            path,
            "the kind of the picture is not read",
            found=f"mode {mode} of Pillow",
            accepted="grey or colour of 8 bits without transparency, grey of 16 bits, or grey of 32-bit floats",
            key="texture.pictures",
        )
    values, largest, warnings = stored.astype(float), _RANGES[mode], list[str]()
    if no_light := _no_light(values):
        accepted = "finite values from 0 on, not all 0"
        raise InputError(path, "values that are no light", found=no_light, accepted=accepted, key="texture.pictures")
    if largest is not None:
        saturated = int(np.sum(values >= largest))
        if saturated > _NOTABLE_SATURATED * values.size:
            warnings.append(
                f"{path.name}: {saturated} of {values.size} values are saturated, so that sparkles are brighter than the picture says; take it with a shorter exposure"
            )
        values = values / largest
    encoded = curve == "srgb" or (curve is None and largest == 255)
    stored_as = f"{_WORDS[mode]}, {'sRGB' if encoded else 'linear'}"
    if curve is None and largest == 255:
        warnings.append(
            f"{path.name}: 8 bits were taken as sRGB, whose curve few cameras keep; take linear pictures of 16 bits, or state `texture.curve`"
        )
    if encoded:
        values = linear_srgb(values)
    return Picture((values @ _LUMINANCE if values.ndim == 3 else values)[::-1], stored_as, tuple(warnings))


def _no_light(values: Array) -> str:
    """What of the values cannot be light; empty if all can."""
    if unknown := int(np.sum(~np.isfinite(values))):
        return f"{unknown} of {values.size} not finite"
    if values.min() < 0:
        return f"{int(np.sum(values < 0))} of {values.size} below 0, down to {values.min():.3g}"
    return "" if values.max() > 0 else "0 everywhere"


def _refused_size(path: Path, found: str) -> InputError:
    accepted = f"{LEAST_SIDE} pixels along either side to {MOST_PIXELS // 1_000_000} million in all"
    return InputError(
        path, "the picture is too small or too large", found=found, accepted=accepted, key="texture.pictures"
    )


_RANGES: dict[str, float | None] = {"L": 255, "RGB": 255, "I;16": 65535, "I;16B": 65535, "F": None}
"""Pillow's names of what is read → the value of white; None for floats."""
_WORDS = {
    "L": "grey of 8 bits",
    "RGB": "colour of 8 bits",
    "I;16": "grey of 16 bits",
    "I;16B": "grey of 16 bits",
    "F": "grey of 32-bit floats",
}

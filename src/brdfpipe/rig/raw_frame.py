"""One exposure as the camera returned it, before it is labelled and stored."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeGuard

import numpy as np
from numpy.typing import NDArray

from brdfpipe.rig.description import CameraSettings

Counts = NDArray[np.uint16]


@dataclass(frozen=True)
class RawFrame:
    """Counts of one exposure, with the time and temperature the camera states."""

    counts: Counts
    """(height, width)."""
    started: float
    """Seconds of the camera's clock: Unix time, or time since the start of the run."""
    seconds: float
    """Exposure time the camera states."""
    temperature: float = math.nan
    """Degree Celsius of the sensor, NaN if unknown."""


def exposure_tolerance(seconds: float) -> float:
    """Largest accepted difference [s] between a requested and a stated exposure time: 1 %, and 1 ms for one tick of the camera's clock."""
    return 0.01 * seconds + 1e-3


def image_format(counts: NDArray[Any]) -> str:
    """Size and type of an image, for messages."""
    return f"{' × '.join(map(str, reversed(counts.shape)))} {counts.dtype}"


def expected_format(camera: CameraSettings) -> str:
    """Size and type that the description of the camera requires, for messages."""
    return f"{camera.width} × {camera.height} uint16"


def has_expected_format(counts: NDArray[Any], camera: CameraSettings) -> bool:
    """Whether counts have the size the description states, and are uint16."""
    return counts.shape == (camera.height, camera.width) and counts.dtype == np.uint16


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value of a header or of JSON is a number, not true or false."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_fits(
    content: bytes, on_warning: Literal["error", "ignore"], keywords: Sequence[str] | None = None
) -> tuple[dict[str, Any], NDArray[Any] | None, int]:
    """Header and data of the first image of a FITS file, and the number of bytes after it; negative if bytes are missing.

    Parameters
    ----------
    keywords : to be read, if they are there; by default all

    Raises
    ------
    Exception : not readable; astropy raises OSError, ValueError, TypeError, KeyError, VerifyError, warnings …
    """
    from astropy.io import fits  # type: ignore[import-untyped]

    with warnings.catch_warnings():
        warnings.simplefilter(on_warning)
        with fits.open(io.BytesIO(content), memmap=False) as images:
            image = images[0]
            header = image.header
            cards = dict(header) if keywords is None else {name: header[name] for name in keywords if name in header}
            layout = image.fileinfo()
            excess = len(content) - layout["datLoc"] - layout["datSpan"]
            return cards, None if excess < 0 or image.data is None else np.asarray(image.data), excess

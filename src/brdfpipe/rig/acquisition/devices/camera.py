"""The interface of a camera, and what its drivers share."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from brdfpipe.rig.acquisition.devices.errors import DeviceError
from brdfpipe.rig.description import CameraSettings
from brdfpipe.rig.raw_frame import Counts, RawFrame, expected_format, image_format

LONGEST_EXPOSURE = 3600.0
"""Seconds."""

POLL = 0.02
"""Seconds between two queries for a frame."""

CHECK_SIZE = "correct `camera.width` and `camera.height`, or switch off binning and regions of interest"


class Camera(Protocol):
    """Interface of a camera."""

    def identify(self) -> str:
        """Name the camera; raises DeviceError if it is not available."""

    def expose(self, seconds: float, *, shutter: bool = True) -> RawFrame:
        """Expose and read out; a dark frame if ``shutter`` is False. Raises DeviceError if there is no complete frame as requested."""


class InvalidCounts(Exception):
    """Counts that the described sensor cannot give: problem and advice."""


def check_exposure(seconds: float) -> None:
    """Refuse an exposure time out of range."""
    if not 0 <= seconds <= LONGEST_EXPOSURE:  # NaN fails too
        advice = f"accepted: 0 to {LONGEST_EXPOSURE:g} s"
        raise DeviceError("camera", f"exposure time {seconds!r} s out of range", advice=advice)


def valid_counts(image: NDArray[Any], camera: CameraSettings) -> Counts:
    """Counts of an image of integers that has the size and range of the described sensor.

    Raises
    ------
    InvalidCounts : wrong size, type or range.
    """
    if image.shape != (camera.height, camera.width) or image.dtype.kind not in "iu":
        raise InvalidCounts(f"image of {image_format(image)}, expected {expected_format(camera)}", CHECK_SIZE)
    if not (image.min() >= 0 and image.max() <= camera.full):
        raise InvalidCounts(
            f"counts from {image.min()} to {image.max()}, but {camera.bits} bits hold 0 to {camera.full}",
            "correct `camera.bits`, or write counts without an offset",
        )
    return np.ascontiguousarray(image, dtype=np.uint16)


def unix_time(text: str) -> float:
    """Unix time of a FITS date and time in UTC."""
    moment = datetime.fromisoformat(text.strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()

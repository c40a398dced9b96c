"""The interface of a camera, and what its drivers share."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
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


class CameraDriver(ABC):
    """What the drivers share. ``clock`` and ``sleep`` count seconds."""

    def __init__(
        self,
        settings: CameraSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings
        self.clock = clock
        self.sleep = sleep

    @property
    @abstractmethod
    def port(self) -> str:
        """Where the camera is, for messages."""

    def error(
        self, problem: str, command: str = "", advice: str = "", kind: type[DeviceError] = DeviceError
    ) -> DeviceError:
        """An error that names the camera and where it is."""
        return kind("camera", problem, port=self.port, command=command, advice=advice)

    def valid_counts(self, image: NDArray[Any], command: str) -> Counts:
        """Counts of an image of integers that has the size and range of the described sensor. Raises DeviceError: wrong size, type or range."""
        camera = self.settings
        if image.shape != (camera.height, camera.width) or image.dtype.kind not in "iu":
            problem = f"image of {image_format(image)}, expected {expected_format(camera)}"
            raise self.error(problem, command, CHECK_SIZE)
        if not (image.min() >= 0 and image.max() <= camera.full):
            problem = f"counts from {image.min()} to {image.max()}, but {camera.bits} bits hold 0 to {camera.full}"
            raise self.error(problem, command, "correct `camera.bits`, or write counts without an offset")
        return np.ascontiguousarray(image, dtype=np.uint16)


def check_exposure(seconds: float) -> None:
    """Refuse an exposure time out of range."""
    if not 0 <= seconds <= LONGEST_EXPOSURE:  # NaN fails too
        advice = f"accepted: 0 to {LONGEST_EXPOSURE:g} s"
        raise DeviceError("camera", f"exposure time {seconds!r} s out of range", advice=advice)


def unix_time(text: object, default: float) -> float:
    """Unix time of a FITS date and time in UTC; the default for other text."""
    try:
        moment = datetime.fromisoformat(str(text).strip())
    except ValueError:
        return default
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()

"""One exposure as the camera returned it, before it is labelled and stored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.rig.description import CameraSettings

Counts = NDArray[np.uint16]


@dataclass(frozen=True)
class RawFrame:
    """Counts of one exposure, with the time and temperature the camera states.

    counts : uint16 (height, width)
    started : seconds of the camera's clock: Unix time, or time since the start of the run
    seconds : exposure time the camera states
    temperature : degree Celsius of the sensor, NaN if unknown
    """

    counts: Counts
    started: float
    seconds: float
    temperature: float = math.nan


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

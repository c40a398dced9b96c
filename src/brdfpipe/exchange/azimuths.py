"""Circles of azimuths as other programs list them: closed at 360 degree, or a half circle that is mirrored."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array


def closed(azimuth: Array, values: Array, number: int) -> tuple[Array, Array]:
    """A circle that ends before its beginning with the first node repeated a full turn later.

    Parameters
    ----------
    azimuth : increasing [degree]
    values : of any shape, the azimuth along its axis ``number``
    """
    if azimuth.size < 3 or not 180 < azimuth[-1] - azimuth[0] < 360:
        return azimuth, values
    return np.append(azimuth, azimuth[0] + 360), np.concatenate([values, values.take([0], axis=number)], axis=number)


def circle(azimuth: Array, values: Array, path: Path, name: str) -> tuple[Array, Array]:
    """Outgoing azimuths, along the last axis but one, that cover a full circle or the half of it from 0 to 180 degree.

    One azimuth stands for all of them.

    Raises InputError: the azimuths cover neither.
    """
    if azimuth.size == 1:
        return np.array([0.0, 180.0]), np.repeat(values, 2, axis=-2)
    azimuth, values = closed(azimuth, values, values.ndim - 2)
    if (azimuth[0], azimuth[-1]) == (0.0, 180.0) or azimuth[-1] - azimuth[0] == 360:
        return azimuth, values
    found = f"{azimuth[0]:g} to {azimuth[-1]:g} degree"
    raise InputError(path, f"the azimuths {name} are no circle", found=found, accepted="0 to 180, or a turn of 360")

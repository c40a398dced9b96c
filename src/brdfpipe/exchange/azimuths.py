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


def with_source_at(source: float, phi_o: Array, values: Array) -> tuple[Array, Array]:
    """Azimuths from 0 to 360 counted so that the source is at ``source``, and the values there; those at 0 and 360 are interpolated between nodes.

    Parameters
    ----------
    source : 0 < source < 360 [degree]
    phi_o : relative to the azimuth of incidence, 0 to 360, or the half to 180 that is mirrored [degree]
    values : (θ_o, φ_o)
    """
    if phi_o[-1] <= 180:
        phi_o, values = np.append(phi_o, 360 - phi_o[-2::-1]), np.concatenate([values, values[:, -2::-1]], axis=1)
    last = 360 - source
    after = int(np.searchsorted(phi_o, last))
    if phi_o[after] != last:
        share = (last - phi_o[after - 1]) / (phi_o[after] - phi_o[after - 1])
        between = (1 - share) * values[:, after - 1] + share * values[:, after]
        phi_o, values = np.insert(phi_o, after, last), np.insert(values, after, between, axis=1)
    azimuth = np.concatenate([phi_o[after:] - last, phi_o[1 : after + 1] + source])
    return azimuth, np.concatenate([values[:, after:], values[:, 1 : after + 1]], axis=1)


def from_source_at(source: float, azimuth: Array, values: Array, path: Path) -> tuple[Array, Array]:
    """φ_o relative to the azimuth of incidence, a circle, or half of it that is mirrored, and the values (…, φ_o, channels) there.

    Raises InputError: the azimuths do not increase, or are neither a circle nor half of it from the source to the mirror direction.
    """
    first, last = float(azimuth[0]), float(azimuth[-1])
    if azimuth.size > 1 and not (np.diff(azimuth) > 0).all():
        raise InputError(path, "the azimuths of scatter do not increase", found=f"{first:g} to {last:g} degree")
    if azimuth.size == 1:
        return np.array([0.0, 180.0]), np.repeat(values, 2, axis=-2)
    if last - first == 180 and (first - source) % 360 == 0:
        return azimuth - first, values
    if last - first == 180 and (last - source) % 360 == 0:
        return last - azimuth[::-1], values[..., ::-1, :]
    if not 180 < last - first <= 360:
        found, accepted = (
            f"{first:g} to {last:g} degree",
            "a turn, or half of it from the source to the mirror direction",
        )
        raise InputError(path, "the azimuths are no circle", found=found, accepted=accepted)
    azimuth, values = closed(azimuth, values, values.ndim - 2)
    relative = (azimuth[:-1] - source) % 360
    order = np.argsort(relative)
    order = np.append(order, order[0])
    relative = relative[order]
    relative[-1] += 360
    return relative, values[..., order, :]

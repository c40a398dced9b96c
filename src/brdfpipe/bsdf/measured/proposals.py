"""What to measure next on a rig: wavelengths and incidences between which a measurement is known worst, and incidences that contradict others.

Between wavelengths a measured BSDF is linear; the remainder is at most an eighth of the second difference, which neighbouring wavelengths show.
Between and beyond incidences the completed BSDF states its own uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.geometry import Array

WORTHWHILE = 0.01
"""Relative error of interpolation below which no wavelength or incidence is proposed: about that of the measured ones."""

_CLEAR = 0.1  # relative uncertainty of a cell above which its spectrum does not count
_CLOSEST = 1.0  # distance of wavelengths below which none is put between them [nm]
_SIGMA = 2.0  # standard uncertainties that a second difference must exceed


class Proposal(NamedTuple):
    """A wavelength [nm] or incidence [degree], and the relative error that measuring it removes; of a contradiction, over its uncertainty."""

    at: float
    error: float


class Proposals(NamedTuple):
    """What to measure next, the most rewarding first."""

    wavelengths: tuple[Proposal, ...]
    incidences: tuple[Proposal, ...]
    again: tuple[Proposal, ...]
    """Incidences whose light contradicts that of the others."""


def propose(primary: xr.Dataset, bsdf: xr.Dataset, entrances: Sequence[float], most: int = 5) -> Proposals:
    """What to measure next.

    Parameters
    ----------
    primary : kind ``primary``, in reflection
    bsdf : the completed BSDF of the same measurement, representation ``rig``
    entrances : angles of incidence that the rig can be set to [degree]
    most : largest number of proposals of each sort
    """
    vocabulary.validate(primary, "primary")
    vocabulary.validate(bsdf, "bsdf")
    # One incidence is an array of no dimension in a file.
    at, times = (np.atleast_1d(bsdf.attrs.get(f"contradicting_{name}", [])) for name in ("incidences", "times"))
    again = [Proposal(float(incidence), float(size)) for incidence, size in zip(at, times, strict=True)]
    return Proposals(
        _ranked(_wavelengths(primary), WORTHWHILE, most),
        _ranked(_incidences(primary, bsdf, entrances), WORTHWHILE, most),
        _ranked(again, 0.0, most),
    )


def _ranked(proposals: list[Proposal], least: float, most: int) -> tuple[Proposal, ...]:
    return tuple(sorted((item for item in proposals if item.error > least), key=lambda item: -item.error)[:most])


def _wavelengths(primary: xr.Dataset) -> list[Proposal]:
    """The middle of each gap of the wavelengths, with the remainder of linear interpolation there."""
    wavelength = primary["wavelength"].values
    if wavelength.size < 3:
        return []
    value, u = (np.moveaxis(primary[name].values, 1, 0).reshape(wavelength.size, -1) for name in ("brdf", "brdf_u"))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nanmean(np.where(np.isfinite(value), value, 0.0), axis=0)
        clear = np.isfinite(value).all(axis=0) & (mean > 0) & (u.max(axis=0) < _CLEAR * mean)
    if not clear.any():
        return []
    value, u, mean = value[:, clear], u[:, clear], mean[clear]
    step = np.diff(wavelength)
    slope = np.diff(value, axis=0) / step[:, None]
    second = np.diff(slope, axis=0) / ((step[1:] + step[:-1]) / 2)[:, None]
    u_slope = np.hypot(u[1:], u[:-1]) / step[:, None]
    u_second = np.hypot(u_slope[1:], u_slope[:-1]) / ((step[1:] + step[:-1]) / 2)[:, None]
    # Of all cells, whose noise averages out.
    curvature = np.median(np.abs(second) / mean, axis=1)
    noise = np.median(u_second / mean, axis=1)
    curvature = np.where(curvature > _SIGMA * noise, curvature, 0.0)
    # An edge within a gap bends the spectrum at both of its ends, one beside it at one.
    of_gap = (np.append(0.0, curvature) + np.append(curvature, 0.0)) / 2
    remainder = of_gap * step**2 / 8
    return [
        Proposal(round(float(low + width / 2), 1), float(error))
        for low, width, error in zip(wavelength, step, remainder, strict=False)
        if width > _CLOSEST
    ]


def _incidences(primary: xr.Dataset, bsdf: xr.Dataset, entrances: Sequence[float]) -> list[Proposal]:
    """The entrances that were not measured, with the stated error of the completed BSDF there, its median over directions, beyond that of the measured ones."""
    measured = primary["incidence"].values
    theta, error = bsdf["theta_i"].values, bsdf["incidence_error"].median(("error_angle", "error_azimuth")).values
    known = float(np.median(np.interp(measured, theta, error)))

    def beyond(entrance: float) -> float:
        return float(np.sqrt(max(float(np.interp(entrance, theta, error)) ** 2 - known**2, 0.0)))

    others: Array = np.array([entrance for entrance in entrances if np.abs(measured - entrance).min() > 1e-6])
    return [Proposal(float(entrance), beyond(float(entrance))) for entrance in others]

"""The error of the monochromator's wavelength, from lines of known wavelength that are read through it.

The slit shows a line as a triangle about its wavelength, twice as wide at its foot as at half of its height. The middle of a symmetric shape does not
depend on how well it is that triangle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import least_squares

from brdfpipe.geometry import Array
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import LINE_LAMP, LINE_RANGE
from brdfpipe.rig.reduction import brackets
from brdfpipe.rig.reduction.brackets import DarkFrames

_SHOWN = 20.0  # ratio of a line's light to its noise from which it is read
_FOOT = 0.3  # uncertain width of the flanks of the triangle: of its half width, smallest and largest change
_CENTRED = 0.5  # largest offset, in widths of the slit: beyond, most of the line is not seen


class LineReading(NamedTuple):
    """One line."""

    line: float
    """Wavelength that is known [nm]."""
    offset: float
    """Wavelength at which the monochromator shows it, less the known one [nm]; missing without a clear line."""
    u: float
    """Standard uncertainty of the offset [nm]."""


def fit_line(position: Array, light: Array, u: Array, slit: float) -> tuple[float, float]:
    """Middle of a line, and its standard uncertainty [nm]; missing where no line is clear.

    Parameters
    ----------
    position : wavelengths of the monochromator, (reading,) nm
    light, u : of the line and its standard uncertainty, (reading,)
    slit : full width at half maximum of the band [nm]
    """
    used = np.isfinite(light) & (u > 0)
    if used.sum() < 5 or light[used].max() < _SHOWN * u[np.flatnonzero(used)[light[used].argmax()]]:
        return np.nan, np.nan
    position, light, u = position[used], light[used], u[used]
    peak = float(light.max())

    def shape(parameters: Array) -> Array:
        middle, height, width, ground = parameters[0] + position[0], *parameters[1:]
        return np.asarray(ground * peak + height * peak * np.maximum(1 - np.abs(position - middle) / width, 0.0))

    # The middle is counted from the first position: steps of differences are relative to it.
    start = np.array([float((light * position).sum() / light.sum()) - position[0], 1.0, slit, 0.0])
    low, high = [0.0, 0.2, (1 - _FOOT) * slit, -0.2], [position[-1] - position[0], 5.0, (1 + _FOOT) * slit, 0.2]

    def misfit(parameters: Array) -> Array:
        return np.asarray((shape(parameters) - light) / u)

    found = least_squares(misfit, np.clip(start, low, high), bounds=(low, high), diff_step=np.full(4, 1e-4))
    middle = float(found.x[0] + position[0])
    if abs(middle - position.mean()) > _CENTRED * slit:
        return np.nan, np.nan
    freedom = max(position.size - 4, 1)
    # A misfit beyond the noise, of a shape that is no triangle, enlarges the uncertainty.
    excess = max(2 * float(found.cost) / freedom, 1.0)
    slopes = np.asarray(found.jac)
    covariance = np.linalg.pinv(slopes.T @ slopes) * excess
    return middle, float(np.sqrt(covariance[0, 0]))


def read_lines(frames: xr.Dataset, rig: Rig) -> list[LineReading]:
    """Each line of frames of kind ``frames``, in the light of the reference spot; none without frames of a line lamp."""
    own = frames.isel(frame=frames["purpose"].values == LINE_LAMP)
    if not own.sizes["frame"]:
        return []
    darks = DarkFrames.of(frames, rig)
    own = own.sortby("shot")
    bracket = brackets.read_bracket(own, darks, rig)
    brightest = int((bracket.light * bracket.usable).sum(axis=(1, 2)).argmax())
    spot = brackets.locate_reference_spot(rig, brackets.read_bracket(own.isel(frame=[brightest]), darks, rig))
    light, u = brackets.reference_sums(bracket, spot)
    readings = []
    planned, position = own["wavelength"].values, own["wavelength_read"].values
    for known in map(float, frames.attrs["lines"]):
        near = np.abs(planned - known) <= LINE_RANGE * rig.slit + 0.01
        middle, middle_u = fit_line(position[near], light[near], u[near], rig.slit)
        readings.append(LineReading(known, middle - known, middle_u))
    return readings


def wavelength_u(readings: list[LineReading], stated: float) -> float:
    """Standard uncertainty of the wavelength [nm]: as stated, or the offsets of the lines, which are not corrected, if these are larger."""
    known = [reading.offset**2 + reading.u**2 for reading in readings if np.isfinite(reading.offset)]
    return max(stated, float(np.sqrt(np.mean(known)))) if known else stated


def line_warnings(readings: list[LineReading], tolerance: float) -> list[str]:
    """Lines beyond the tolerance [nm], and those that were not found."""
    beyond = [reading for reading in readings if abs(reading.offset) > tolerance]
    lost = [f"{reading.line:g}" for reading in readings if not np.isfinite(reading.offset)]
    warnings = []
    if beyond:
        listed = ", ".join(f"{reading.offset:+.2f} nm at {reading.line:g} nm" for reading in beyond)
        warnings.append(
            f"The monochromator shows lines beside their wavelengths: {listed} (reading less known wavelength; at most {tolerance:g} nm are expected). "
            "The offset counts as uncertainty of the wavelength. Calibrate the monochromator, and measure again."
        )
    if lost:
        warnings.append(
            f"No clear line at {', '.join(lost)} nm: check the line lamp, and the exposure of `line_lamp.step`, or the monochromator is off by half "
            "its slit or more."
        )
    return warnings

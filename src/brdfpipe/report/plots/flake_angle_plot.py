"""A paint with effect pigments: reflection against the flake angle, and tables of the fit and its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe.flakes.forms import FORMS, curve
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend
from brdfpipe.spectra import colorimetry

_SHOWN = (450.0, 550.0, 650.0)
"""Wavelengths at which a spectrum is shown [nm]."""
_STYLES = ("c3", "c4", "c0")
_BEYOND = 1.1
"""Largest angle shown, over the largest measured one."""


def flake_angle_plot(flake: xr.Dataset, multiangle: xr.Dataset) -> Figure:
    """Measured values and fitted curves against the flake angle, dotted beyond the measured geometries."""
    measured_theta = flake["theta_f_measured"].values
    values = _values(multiangle)
    channels, names = zip(*_shown_channels(values[values.dims[1]]), strict=True)
    low, high = float(measured_theta.min()), float(measured_theta.max())
    theta = np.linspace(0.0, _BEYOND * high, 241)
    fitted = _curves(flake, theta)[:, list(channels)]
    measured = _measured_values(flake)[:, list(channels)]
    inside = (theta >= low) & (theta <= high)
    marks: list[Mark] = []
    for k, (style, name) in enumerate(zip(_STYLES, names, strict=False)):
        marks.append(Line(theta, np.where(inside, fitted[:, k], np.nan), style, name))
        marks += [
            Line(theta, np.where(part, fitted[:, k], np.nan), style, "", "dots")
            for part in (theta <= low, theta >= high)
        ]
        marks.append(Points(measured_theta, measured[:, k], label="" if k else "measured"))
    bright = float(max(fitted.max(), measured.max(), 1e-6))
    dark = max(float(min(fitted.min(), measured[measured > 0].min(initial=bright))), bright * 1e-5)
    lowest, highest = (10.0 ** math.floor(math.log10(dark)), 10.0 ** math.ceil(math.log10(bright)))
    quantity = "X, Y, Z" if "channel" in multiangle.dims else "reflectance factor"
    note = f"Form: {flake.attrs['form']} plus a constant. Dotted: beyond the measured geometries."
    if flake.attrs["model"] == "flake-physical":
        note += " Values at normal incidence, without the interface and the gloss of the clear coat."
    svg = chart(
        f"{quantity} against the flake angle, logarithmic",
        Axis("flake angle θf, degree", 0.0, _BEYOND * high),
        Axis(quantity, lowest, max(highest, 10 * lowest), log=True),
        marks,
    )
    return Figure("Reflection against the flake angle", svg, legend(marks), note)


def geometry_rows(flake: xr.Dataset, multiangle: xr.Dataset) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows: each geometry with its flake angle, measured colour and the errors of the fit."""
    names = ("geometry", "theta_f_measured", "delta_e_00", "leave_one_out")
    columns = (flake[name].values.tolist() for name in names)
    rows = [
        (name, f"{fixed(theta, 2)}°", *(fixed(value, 2) for value in (*colour, error, left_out)))
        for (name, theta, error, left_out), colour in zip(zip(*columns, strict=True), _lab(multiangle), strict=True)
    ]
    return ("Geometry", "θf", "L*", "a*", "b*", "ΔE00", "left out"), rows


def parameter_rows(flake: xr.Dataset) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows: A, B and C of each channel, or of three wavelengths."""
    channel = flake["channel" if "channel" in flake.dims else "wavelength"]
    header = [str(channel.name).capitalize()]
    columns = []
    for term in range(flake.sizes["term"]):
        mark = f" {term + 1}" if flake.sizes["term"] > 1 else ""
        header += [f"A{mark}", f"B{mark}, °"]
        columns += [_with_uncertainty(flake, "flake_amplitude", term), _with_uncertainty(flake, "flake_decay", term)]
    columns.append(_with_uncertainty(flake, "flake_constant", None))
    return (*header, "C"), [(title, *(column[k] for column in columns)) for k, title in _shown_channels(channel)]


def _with_uncertainty(flake: xr.Dataset, name: str, term: int | None) -> list[str]:
    values, uncertainty = flake[name], flake.get(f"{name}_u", xr.full_like(flake[name], np.nan))
    if term is not None:
        values, uncertainty = values[term], uncertainty[term]
    return [
        number(value, 4) + (f" ± {number(u, 2)}" if math.isfinite(u) else "")
        for value, u in zip(values.values, uncertainty.values, strict=True)
    ]


def _values(multiangle: xr.Dataset) -> xr.DataArray:
    return multiangle["tristimulus" if "tristimulus" in multiangle else "reflectance_factor"]


def _shown_channels(channel: xr.DataArray) -> list[tuple[int, str]]:
    """Index and title of X, Y and Z, or of three wavelengths."""
    if channel.name == "channel":
        return list(enumerate(map(str, channel.values)))
    nearest = [int(np.argmin(np.abs(channel.values - wavelength))) for wavelength in _SHOWN]
    return [(k, f"{float(channel[k]):g} nm") for k in nearest]


def _curves(flake: xr.Dataset, theta: Array) -> Array:
    amplitude, decay, constant = (flake[f"flake_{name}"].values for name in ("amplitude", "decay", "constant"))
    return curve(theta, amplitude, decay, constant, FORMS[flake.attrs["form"]].power)


def _measured_values(flake: xr.Dataset) -> Array:
    """The measured values on the scale of the fit: the fitted value over one plus its misfit."""
    misfit = flake["misfit"].values
    return np.where(np.isnan(misfit), np.nan, _curves(flake, flake["theta_f_measured"].values) / (1 + misfit))


def _lab(multiangle: xr.Dataset) -> Array:
    viewing = multiangle.attrs.get("illuminant", "D65"), int(multiangle.attrs.get("observer", 10))
    values = _values(multiangle)
    if values.dims[1] == "wavelength":
        xyz = colorimetry.reflectance_to_xyz(values["wavelength"].values, values.values, *viewing)
    else:
        xyz = values.values
    return colorimetry.xyz_to_lab(xyz, colorimetry.weights(*viewing).white)

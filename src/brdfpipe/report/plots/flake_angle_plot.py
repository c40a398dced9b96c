"""What the page shows of a paint with effect pigments: the fall of its reflection along the flake angle, fit and errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe.flakes.forms import FORMS, curve
from brdfpipe.report.formatting import MISSING, fixed, number
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend
from brdfpipe.spectra import colorimetry

_SHOWN = (450.0, 550.0, 650.0)
"""Wavelengths that stand for a spectrum [nm]."""
_STYLES = ("c3", "c4", "c0")
_ROOM = 1.1


def flake_angle_plot(flake: xr.Dataset, multiangle: xr.Dataset) -> Figure:
    """Measured values and fitted curves against the flake angle, dotted where nothing was measured."""
    measured = _values(multiangle)
    known = flake["theta_f_measured"].values
    channels, names = _channels(measured)
    low, high = float(known.min()), float(known.max())
    theta = np.linspace(0.0, _ROOM * high, 241)
    fitted = _curves(flake, theta)[:, channels]
    seen = _as_stored(flake, multiangle)[:, channels]
    inside = (theta >= low) & (theta <= high)
    marks: list[Mark] = []
    for k, (style, name) in enumerate(zip(_STYLES, names, strict=False)):
        marks.append(Line(theta, np.where(inside, fitted[:, k], np.nan), style, name))
        marks += [
            Line(theta, np.where(part, fitted[:, k], np.nan), style, "", "dots")
            for part in (theta <= low, theta >= high)
        ]
        marks.append(Points(known, seen[:, k], np.full_like(known, np.nan), "c0", "" if k else "measured"))
    bright = float(max(fitted.max(), seen.max(), 1e-6))
    dark = max(float(min(fitted.min(), seen[seen > 0].min() if (seen > 0).any() else bright)), bright * 1e-5)
    lowest, highest = (10.0 ** math.floor(math.log10(dark)), 10.0 ** math.ceil(math.log10(bright)))
    what = "X, Y, Z" if "channel" in multiangle.dims else "reflectance factor"
    note = f"Form: {flake.attrs['form']} plus a constant. Dotted: beyond the measured geometries."
    if flake.attrs["model"] == "flake-physical":
        note += " Values at normal incidence, without the interface and the gloss of the clear coat."
    svg = chart(
        f"{what} against the flake angle, logarithmic",
        Axis("flake angle θf, degree", 0.0, _ROOM * high),
        Axis(what, lowest, max(highest, 10 * lowest), log=True),
        marks,
    )
    return Figure("Reflection against the flake angle", svg, legend(marks), note)


def geometry_rows(flake: xr.Dataset, multiangle: xr.Dataset) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows: each geometry with its flake angle, measured colour and the errors of the fit."""
    lab = _lab(multiangle)
    rows = [
        (
            str(name),
            f"{fixed(theta, 2)}°",
            *(fixed(float(value), 2) for value in colour),
            fixed(error, 2),
            MISSING if math.isnan(left_out) else fixed(left_out, 2),
        )
        for name, theta, colour, error, left_out in zip(
            flake["geometry"].values.tolist(),
            flake["theta_f_measured"].values.tolist(),
            lab,
            flake["delta_e_00"].values.tolist(),
            flake["leave_one_out"].values.tolist(),
            strict=True,
        )
    ]
    return ("Geometry", "θf", "L*", "a*", "b*", "ΔE00", "left out"), rows


def parameter_rows(flake: xr.Dataset) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows: A, B and C of each channel, or of three wavelengths."""
    across = "channel" if "channel" in flake.dims else "wavelength"
    values = flake[across].values
    chosen = range(values.size) if across == "channel" else _nearest(values)
    header = [across.capitalize()]
    columns = []
    for term in range(flake.sizes["term"]):
        mark = f" {term + 1}" if flake.sizes["term"] > 1 else ""
        header += [f"A{mark}", f"B{mark}, °"]
        columns += [_with_doubt(flake, "flake_amplitude", term), _with_doubt(flake, "flake_decay", term)]
    columns.append(_with_doubt(flake, "flake_constant", None))
    rows = [(_title(values[k]), *(column[k] for column in columns)) for k in chosen]
    return (*header, "C"), rows


def _with_doubt(flake: xr.Dataset, name: str, term: int | None) -> list[str]:
    doubt = flake.get(f"{name}_u")
    chosen: slice | int = slice(None) if term is None else term
    values = flake[name].values[chosen]
    if doubt is None:
        return [number(value, 4) for value in values]
    return [
        number(value, 4) + (f" ± {number(u, 2)}" if math.isfinite(u) else "")
        for value, u in zip(values, doubt.values[chosen], strict=True)
    ]


def _values(multiangle: xr.Dataset) -> xr.DataArray:
    return multiangle["tristimulus" if "tristimulus" in multiangle else "reflectance_factor"]


def _channels(measured: xr.DataArray) -> tuple[list[int], list[str]]:
    across = measured[measured.dims[1]].values
    chosen = list(range(across.size)) if measured.dims[1] == "channel" else _nearest(across)
    return chosen, [_title(across[k]) for k in chosen]


def _title(value: object) -> str:
    return value if isinstance(value, str) else f"{float(value):g} nm"  # type: ignore[arg-type]


def _nearest(wavelength: Array) -> list[int]:
    return [int(np.argmin(np.abs(wavelength - shown))) for shown in _SHOWN]


def _curves(flake: xr.Dataset, theta: Array) -> Array:
    amplitude, decay, constant = (flake[f"flake_{name}"].values for name in ("amplitude", "decay", "constant"))
    return curve(theta, amplitude, decay, constant, FORMS[flake.attrs["form"]].power)


def _as_stored(flake: xr.Dataset, multiangle: xr.Dataset) -> Array:
    """The measured values on the scale of the fit: what the fit says, over one plus its misfit."""
    fitted = _curves(flake, flake["theta_f_measured"].values)
    return np.where(np.isnan(flake["misfit"].values), np.nan, fitted / (1 + flake["misfit"].values))


def _lab(multiangle: xr.Dataset) -> Array:
    viewing = multiangle.attrs.get("illuminant", "D65"), int(multiangle.attrs.get("observer", 10))
    values = _values(multiangle)
    if values.dims[1] == "wavelength":
        xyz = colorimetry.reflectance_to_xyz(values["wavelength"].values, values.values, *viewing)
    else:
        xyz = values.values
    return colorimetry.xyz_to_lab(xyz, colorimetry.weights(*viewing).white)

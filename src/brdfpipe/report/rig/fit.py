"""Figures of the fit to the cells of a camera rig: curve and values, residuals, and the choice of the smoothing strength."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from brdfpipe.bsdf.measured import smoothing
from brdfpipe.report.formatting import number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.svg import Array, Axis, Band, Figure, Line, Mark, Points, chart, frame, legend, minus, text
from brdfpipe.specular_directions import cos_view

NEAR_PLANE = 10.0
"""Azimuth from the plane of incidence up to which a cell is shown in it [degree]."""

LINEAR_UP_TO = 3.0
"""Angle from the mirror direction up to which axes are linear, beyond which they are logarithmic [degree]."""

_TICKS = (0.0, 3.0, 10.0, 30.0, 90.0)
_CURVE_POINTS = 71
_CHART_HEIGHT, _DIFFERENCE_HEIGHT = 226.0, 96.0
"""Inner heights [figure units]."""
_SHORTEST_BAR = 5.0
"""Length of half an error bar that is hidden by its point [figure units]."""
_THINNEST_BAND = 3.0
"""Thickness of a band that is hidden by its curve [figure units]."""
_OUTLYING = 3.0
"""Multiple of the 90th percentile beyond which values are outside of an axis about zero."""
_MOST_DECADES = 7
_HIGHEST_GCV = 1e3
"""Largest generalised cross-validation shown, over the smallest."""

_STYLES = ("c0", "c1", "c4", "c2", "c3", "ref")

_MAP_X, _MAP_Y, _MAP_RADIUS = 196.0, 178.0, 160.0
"""Map of residuals [figure units]."""

_CLASS_LIMITS = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
_CLASS_NAMES = ("below −3", "−3 to −2", "−2 to −1", "−1 to 1", "1 to 2", "2 to 3", "above 3")
"""Classes of residuals, by colour."""


def _asinh(theta: ArrayLike) -> Array:
    """Angle on a scale that is linear near 0 and logarithmic far from it."""
    return np.asarray(np.arcsinh(np.asarray(theta, dtype=float) / LINEAR_UP_TO))


@dataclass(frozen=True)
class _AngleAxis(Axis):
    """Angles from the mirror direction on both sides, linear near it and logarithmic far from it."""

    def fraction(self, values: ArrayLike) -> Array:
        low, high = _asinh([self.low, self.high])
        return np.asarray((_asinh(values) - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        values = sorted({sign * value for value in _TICKS for sign in (-1.0, 1.0)})
        return [(value, minus(f"{value + 0.0:g}")) for value in values if self.low <= value <= self.high]


def fit_figure(primary: xr.Dataset, smoothed: xr.Dataset, index: int) -> Figure:
    """The smoothed BSDF of incidence number ``index`` against the cells near the plane of incidence, and the difference."""
    incidence, side = float(smoothed["incidence"][index]), str(smoothed.attrs["side"])
    quantity = "BTDF" if side == "transmission" else "BRDF"
    title = f"{incidence:g}° incidence: {quantity} in the plane, fit against data"
    cells = _in_plane(primary, smoothed, index)
    theta, fitted, u = _curve(smoothed, index, cells)
    if not (cells.value > 0).any() or not (fitted > 0).any():
        return Figure(title, note="No fitted cell near the plane of incidence has a value above 0.")
    axis = _AngleAxis(
        "angle from the mirror direction, °; positive towards the normal", float(theta[0]), float(theta[-1])
    )
    scale = _scale(f"{quantity}, sr⁻¹ (log)", np.concatenate([cells.value, fitted]))
    band = Band(theta, np.maximum(fitted - u, scale.low / 1e3), fitted + u, "c4", "± its standard uncertainty")
    points = _points(cells, cells.value, cells.u, scale, _CHART_HEIGHT)
    curve = Line(theta, fitted, "c4", "fit")
    thick = np.nanmax(_CHART_HEIGHT * np.abs(scale.fraction(band.high) - scale.fraction(band.low))) > _THINNEST_BAND
    above = chart(f"{title}, logarithmic", axis, scale, [*([band] if thick else []), *points, curve])
    below, left_out = _difference_chart(title, cells, axis, theta[::2], _percent(u, fitted)[::2])
    note = (
        f"{cells.value.size} cells within {NEAR_PLANE:g}° of azimuth from the plane, {bsdf_sections.wavelength_words(primary)}; "
        f"bars are ±\u202f1 standard uncertainty, drawn where they are longer than their point.{left_out}"
    )
    return Figure(title, above + below, legend([curve, band, *points]), note)


def _scale(label: str, values: Array) -> Axis:
    positive = values[np.isfinite(values) & (values > 0)]
    high = 1.6 * float(positive.max())
    # Noise about 0 may be arbitrarily small.
    low = max(float(np.percentile(positive, 2)) / 1.6, high * 10.0**-_MOST_DECADES)
    return Axis(label, min(low, high / 10), high, log=True)


def _difference_chart(title: str, cells: _Plane, axis: Axis, theta: Array, u: Array) -> tuple[Markup, str]:
    """Data less fit in percent with the uncertainty of the fit, and a note on values beyond the axis."""
    difference, error = _percent(cells.value - cells.fitted, cells.fitted), _percent(cells.u, cells.fitted)
    scale, left_out = axis_about_zero("data over fit less 1, %", difference, error, least=float(np.nanmedian(u)))
    difference = np.where(np.abs(difference) <= scale.high, difference, np.nan)
    zero = Line([axis.low, axis.high], [0.0, 0.0], "c4")
    marks: list[Mark] = [Band(theta, -u, u, "c4"), *_points(cells, difference, error, scale, _DIFFERENCE_HEIGHT), zero]
    return chart(f"{title}, difference in percent", axis, scale, marks, height=170), left_out


def axis_about_zero(label: str, values: Array, u: Array, *, least: float = 0.0) -> tuple[Axis, str]:
    """A symmetric axis in percent for most values with their bars, and a note on the values beyond it.

    Few values that are much larger than the others, or beyond 100 %, do not enlarge it. It contains ``least`` [%].
    """
    known = np.isfinite(values)
    size, bar = np.abs(values[known]), np.nan_to_num(u[known])
    usual = _OUTLYING * float(np.percentile(np.r_[size + bar, least], 90))
    ends = np.r_[(size + bar)[size + bar <= usual], least]
    top = 1.08 * float(np.clip(ends.max(), 1.0, 100.0))
    outside, cut = int((size > top).sum()), int(((size <= top) & (size + bar > top)).sum())
    words = [f"{outside} value{'s' if outside > 1 else ''}"] if outside else []
    words += [f"ends of {cut} bar{'s' if cut > 1 else ''}"] if cut else []
    return Axis(label, -top, top), f" Outside the range of the lower chart: {', '.join(words)}." if words else ""


def _percent(part: Array, whole: Array) -> Array:
    """Percent of a whole; NaN where the whole is not above 0, as where a linear fit is negative."""
    return np.asarray(100 * part / np.where(whole > 0, whole, np.nan))


@dataclass(frozen=True)
class _Plane:
    """Cells near the plane of incidence, at the reference wavelength."""

    theta: Array
    """Degree, negative away from the normal."""
    value: Array
    u: Array
    fitted: Array
    fibre: NDArray[np.bool_]


def _in_plane(primary: xr.Dataset, smoothed: xr.Dataset, index: int) -> _Plane:
    measured = primary.isel(incidence=index).sel(wavelength=bsdf_sections.REFERENCE_WAVELENGTH, method="nearest")
    theta, phi = measured["theta_s"].values, (measured["phi_s"].values + 180) % 360 - 180
    towards, away = np.abs(phi) <= NEAR_PLANE, np.abs(phi) >= 180 - NEAR_PLANE
    used = np.isfinite(bsdf_sections.at_reference(smoothed["residual"]).values[index])
    cells = np.flatnonzero((towards | away | (theta < 1e-6)) & used)
    fitted = np.zeros(0)
    if cells.size:
        fitted = smoothing.evaluate(_one_incidence(smoothed, index), theta[cells], phi[cells]).values[0, 0]
    return _Plane(
        np.where(away, -theta, theta)[cells],
        measured["brdf"].values[cells],
        measured["brdf_u"].values[cells],
        fitted,
        measured["kind"].values[cells] == "fibre",
    )


def _one_incidence(smoothed: xr.Dataset, index: int) -> xr.Dataset:
    """One incidence at the reference wavelength."""
    return smoothed.isel(incidence=[index]).sel(wavelength=[bsdf_sections.REFERENCE_WAVELENGTH], method="nearest")


def _curve(smoothed: xr.Dataset, index: int, cells: _Plane) -> tuple[Array, Array, Array]:
    """Angles, fit and its uncertainty over the range of the cells; NaN below the horizon."""
    ends = _asinh([cells.theta.min(initial=-1.0), cells.theta.max(initial=1.0)])
    margin = 0.02 * np.ptp(ends)
    theta = LINEAR_UP_TO * np.sinh(np.linspace(ends[0] - margin, ends[1] + margin, _CURVE_POINTS))
    theta = np.union1d(np.clip(theta, -180, 180).round(6), [0.0])
    phi = np.where(theta < 0, 180.0, 0.0)
    one = _one_incidence(smoothed, index)
    value, u = (method(one, np.abs(theta), phi).values[0, 0] for method in (smoothing.evaluate, smoothing.uncertainty))
    above_horizon = cos_view(float(one["incidence"][0]), np.abs(theta), phi) > 0
    return theta, np.where(above_horizon, value, np.nan), np.where(above_horizon, u, np.nan)


def _points(cells: _Plane, value: Array, u: Array, axis: Axis, tall: float) -> list[Mark]:
    with np.errstate(invalid="ignore"):
        length = tall * np.abs(axis.fraction(value + u) - axis.fraction(value - u))
    visible = length > 2 * _SHORTEST_BAR
    shown = np.where(value > 0, value, np.nan) if axis.log else value
    marks: list[Mark] = []
    for group, style, label in ((~cells.fibre, "c0", "disc"), (cells.fibre, "c2", "fibres")):
        if group.any():
            marks.append(bars(cells.theta, value, np.where(visible & group, u, np.nan), f"{style} thin"))
            marks.append(Points(cells.theta[group], shown[group], style=f"{style} small", label=label))
    return marks


def bars(x: Array, y: Array, u: Array, style: str) -> Line:
    """Error bars ± u as one broken curve, a quarter of the bytes of bars with ends."""
    gap = np.full(x.size, np.nan)
    return Line(np.stack([x, x, gap], axis=1).ravel(), np.stack([y - u, y + u, gap], axis=1).ravel(), style)


# --- residuals


def residual_map(primary: xr.Dataset, smoothed: xr.Dataset, index: int) -> Figure:
    """A map of the residuals of an incidence over their uncertainties, about the mirror direction."""
    incidence = float(smoothed["incidence"][index])
    title = f"{incidence:g}° incidence: residuals of the fit"
    residual = bsdf_sections.at_reference(smoothed["residual"]).values[index]
    theta, phi = smoothed["theta_s"].values, smoothed["phi_s"].values
    used = np.isfinite(residual)
    if not used.any():
        return Figure(title, note="No cell was fitted.")
    largest = max(float(theta[used].max()), 1.0)
    distance = _MAP_RADIUS * _asinh(theta) / _asinh(largest)
    x, y = _MAP_X + distance * np.cos(np.radians(phi)), _MAP_Y - distance * np.sin(np.radians(phi))
    level = np.digitize(residual, _CLASS_LIMITS)
    groups = {f"z{k}": used & (level == k) for k in range(len(_CLASS_NAMES))}
    groups["none"] = ~used & (distance <= _MAP_RADIUS)
    parts = [_rings(largest), *(_dots(x[group], y[group], f"dot {style}") for style, group in groups.items())]
    parts.append(_dot_legend({style: int(group.sum()) for style, group in groups.items()}))
    parts.append(text(4, 15, "ϑ from the mirror direction, asinh", "start", "t"))
    parts.append(text(_MAP_X + _MAP_RADIUS + 8, _MAP_Y + 4, "φ = 0, to the normal" if incidence else "φ = 0"))
    spectral = smoothed["residual"].values[index]
    spectral = spectral[np.isfinite(spectral)]
    note = (
        f"{bsdf_sections.wavelength_words(primary).capitalize()}. Of all wavelengths, rms "
        f"{number(float(np.sqrt(np.mean(spectral**2))))}, {100 * np.mean(np.abs(spectral) <= 1):.0f}\u202f% within ±\u202f1 and "
        f"{100 * np.mean(np.abs(spectral) <= 2):.0f}\u202f% within ±\u202f2; expected for correct uncertainties: slightly below 1, 68\u202f% and 95\u202f%."
    )
    svg = frame(f"Map of residuals over their uncertainty at {incidence:g} degrees of incidence", 356, parts)
    return Figure(title, svg, note=note)


def _rings(largest: float) -> str:
    """Circles of equal ϑ with labels on a diagonal; none near the outermost one."""
    x, y, radius = _MAP_X, _MAP_Y, _MAP_RADIUS
    parts = [f'<path class="g" d="M{x - radius:g} {y:g}h{2 * radius:g}M{x:g} {y - radius:g}v{2 * radius:g}"/>']
    for angle in (*(value for value in _TICKS[1:] if value < 0.8 * largest), largest):
        r = float(radius * _asinh(angle) / _asinh(largest))
        parts.append(f'<circle class="g" cx="{x:g}" cy="{y:g}" r="{r:.1f}"/>')
        parts.append(text(x + 0.743 * r + 1, y - 0.669 * r, f"{angle:.0f}°", "start", "h"))
    return "".join(parts)


def _dots(x: Array, y: Array, style: str) -> str:
    """A path of dots at whole units."""
    if not x.size:
        return ""
    steps = np.diff(np.stack([x, y], axis=1).round().astype(int), axis=0, prepend=0)
    return f'<path class="{style}" d="M0 0' + "".join(f"m{a}{b:+d}h0" for a, b in steps.tolist()) + '"/>'


def _dot_legend(counts: dict[str, int]) -> str:
    """Legend of the dots: number of cells by style."""
    parts = [text(404, 214, "residual / u: cells", "start", "t")]
    rows = [*reversed(list(zip(counts, _CLASS_NAMES, strict=False))), ("none", "not used")]
    for y, (style, name) in zip(range(234, 500, 16), rows, strict=False):
        parts.append(f'<path class="dot {style}" d="M408 {y - 4}h0"/>{text(418, y, f"{name}: {counts[style]}")}')
    return "".join(parts)


# --- strength of smoothing


def cross_validation(smoothed: xr.Dataset) -> Figure:
    """Generalised cross-validation against the strength of smoothing, for each incidence over its minimum."""
    gcv = smoothed["gcv"].values
    # fmin, other than nanmin, does not warn of an incidence without values.
    lines, points = _strength_curves(smoothed, "strength", gcv / np.fmin.reduce(gcv, axis=-1, keepdims=True))
    lines = [replace(line, y=np.where(np.asarray(line.y) < 1.5 * _HIGHEST_GCV, line.y, np.nan)) for line in lines]
    highest = float(np.clip(_range([line.y for line in lines])[1], 2.0, _HIGHEST_GCV))
    return _strength_figure(
        "Strength of smoothing: cross-validation",
        Axis("strength ε", *_range([line.x for line in lines]), log=True),
        Axis("GCV over its minimum", 0.9, highest, log=True),
        [*lines, *points],
        "The dot marks the strength used. In a deep, narrow minimum the strength is well determined; in a flat one it matters little.",
    )


def l_curve(smoothed: xr.Dataset) -> Figure:
    """Misfit against roughness over the strengths tried: beyond the corner, more roughness hardly improves the fit."""
    lines, points = _strength_curves(smoothed, "roughness", smoothed["chi_squared"].values)
    return _strength_figure(
        "Strength of smoothing: L-curve",
        Axis("roughness of the fit", *_range([line.x for line in lines]), log=True),
        Axis("χ², mean over wavelengths", *_range([line.y for line in lines]), log=True),
        [*lines, *points],
        "Smoothing increases from right to left. Dot: strength used; it should be at the corner.",
    )


def _strength_curves(smoothed: xr.Dataset, abscissa: str, y: Array) -> tuple[list[Line], list[Points]]:
    """Curves (incidence, strength) of the validated incidences, and their points at the strengths used."""
    lines: list[Line] = []
    points: list[Points] = []
    validated = np.flatnonzero(np.isfinite(smoothed["gcv"].values).any(axis=1)).tolist()
    for index, style in zip(validated, cycle(_STYLES), strict=False):
        label = f"{'' if lines else 'incidence '}{float(smoothed['incidence'][index]):g}°"
        x, strength = (smoothed[name].values[index] for name in (abscissa, "strength"))
        used = float(smoothed["chosen_strength"][index])
        lines.append(Line(x, y[index], style, label))
        x_used, y_used = (np.interp(np.log(used), np.log(strength), values) for values in (x, y[index]))
        points.append(Points([used if abscissa == "strength" else x_used], [y_used], style=style))
    return lines, points


def _strength_figure(title: str, x: Axis, y: Axis, marks: Sequence[Mark], note: str) -> Figure:
    description = f"{title}: {y.label} against {x.label}, by angle of incidence"
    return Figure(title, chart(description, x, y, marks), legend(marks), note)


def _range(curves: Sequence[ArrayLike]) -> tuple[float, float]:
    """Range of the positive values of curves, a little wider."""
    values = np.concatenate([np.asarray(curve, dtype=float) for curve in curves])
    values = values[np.isfinite(values) & (values > 0)]
    low, high = (float(values.min()), float(values.max())) if values.size else (1.0, 10.0)
    return low / 1.2, max(high * 1.2, low * 2)

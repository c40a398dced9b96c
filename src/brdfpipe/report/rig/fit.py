"""Figures of the fit to the cells of a camera rig: curve and values, residuals, and the choice of the smoothing strength."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured import smoothing
from brdfpipe.report.formatting import number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.svg import (
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    Points,
    chart,
    frame,
    legend,
    minus,
    sentence,
    text,
)
from brdfpipe.specular_directions import cos_view

NEAR_PLANE = 10.0
"""Azimuth from the plane of incidence up to which a cell is shown in it [degree]."""

KNEE = 3.0
"""Angle from the mirror direction [degree] up to which the figures count evenly, and beyond which by its logarithm."""

_TICKS = (0.0, 3.0, 10.0, 30.0, 90.0)
_CURVE = 71
_TALL, _STRIP_TALL = 226.0, 96.0
"""Of their areas [figure unit]."""
_VISIBLE = 5.0
"""Length [figure unit] below which an error bar lies within its point."""
_OUTLYING = 3.0
"""Times the 90th percentile of what lies about 0, up to which an axis holds it."""
_THIN = 3.0
"""Thickness [figure unit] up to which a band lies within its curve."""
_MOST_DECADES = 7

_MOST_GCV = 1e3
"""Beyond so many times the least cross-validation no one needs to look."""

_STYLES = ("c0", "c1", "c4", "c2", "c3", "ref")

_MIDDLE, _RADIUS = (196.0, 178.0), 160.0
"""Of the map of residuals [figure unit]."""

_LOPSIDED = 5.0
"""Standard deviations by which means of either side differ that is no chance."""

_BINS = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
"""Residuals at which the colour changes."""
_NAMES = ("below −3", "−3 to −2", "−2 to −1", "−1 to 1", "1 to 2", "2 to 3", "above 3")


@dataclass(frozen=True)
class _Angles(Axis):
    """Angles from the mirror direction, either way: even about it, logarithmic far from it."""

    def place(self, values: ArrayLike) -> Array:
        low, high = np.arcsinh(np.array([self.low, self.high]) / KNEE)
        return np.asarray((np.arcsinh(np.asarray(values, dtype=float) / KNEE) - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        either = sorted({sign * value for value in _TICKS for sign in (-1.0, 1.0)})
        return [(value, minus(f"{value + 0.0:g}")) for value in either if self.low <= value <= self.high]


def fit(primary: xr.Dataset, smoothed: xr.Dataset, at: int) -> Figure:
    """The smoothed BSDF of an incidence against the values of the cells near the plane of incidence, and their difference.

    Parameters
    ----------
    primary, smoothed : of one side
    at : which of the incidences
    """
    incidence, side = float(smoothed["incidence"][at]), str(smoothed.attrs["side"])
    quantity = "BTDF" if side == "transmission" else "BRDF"
    title = f"{incidence:g}° incidence: {quantity} in the plane, fit against data"
    cells = _in_plane(primary, smoothed, at)
    theta, fitted, u = _curve(smoothed, at, cells)
    if not (cells.value > 0).any() or not (fitted > 0).any():
        return sentence(title, "No fitted cell near the plane of incidence has a value above 0.")
    axis = _Angles("angle from the mirror direction, °; positive towards the normal", float(theta[0]), float(theta[-1]))
    scale = _scale(f"{quantity}, sr⁻¹ (log)", np.concatenate([cells.value, fitted]))
    band = Band(theta, np.maximum(fitted - u, scale.low / 1e3), fitted + u, "c4", "± its standard uncertainty")
    points = _points(cells, cells.value, cells.u, scale, _TALL)
    curve = Line(theta, fitted, "c4", "fit")
    thick = np.nanmax(_TALL * np.abs(scale.place(band.high) - scale.place(band.low))) > _THIN
    above = chart(f"{title}, logarithmic", axis, scale, [*([band] if thick else []), *points, curve])
    below, left_out = _strip(title, cells, axis, theta[::2], _percent(u, fitted)[::2])
    note = (
        f"{cells.value.size} cells within {NEAR_PLANE:g}° of azimuth from the plane, {bsdf_sections.wavelength_words(primary)}; "
        "bars are ±\u202f1 standard uncertainty, drawn where they are longer than their point."
    )
    note += left_out
    return Figure(title, above + below, legend([curve, band, *points]), note)


def _scale(label: str, values: Array) -> Axis:
    positive = values[np.isfinite(values) & (values > 0)]
    high = 1.6 * float(positive.max())
    # Noise about nothing may come as near to 0 as it likes.
    low = max(float(np.percentile(positive, 2)) / 1.6, high * 10.0**-_MOST_DECADES)
    return Axis(label, min(low, high / 10), high, log=True)


def _strip(title: str, cells: _Plane, axis: Axis, theta: Array, u: Array) -> tuple[Markup, str]:
    """Data less fit in percent, with the uncertainty of the fit, and what of it lies beyond the axis, in words."""
    off, error = _percent(cells.value - cells.fitted, cells.fitted), _percent(cells.u, cells.fitted)
    scale, left_out = about_zero("data over fit less 1, %", off, error, least=float(np.nanmedian(u)))
    off = np.where(np.abs(off) <= scale.high, off, np.nan)
    zero = Line([axis.low, axis.high], [0.0, 0.0], "c4")
    marks: list[Mark] = [Band(theta, -u, u, "c4"), *_points(cells, off, error, scale, _STRIP_TALL), zero]
    return chart(f"{title}, difference in percent", axis, scale, marks, height=170), left_out


def about_zero(label: str, off: Array, u: Array, *, least: float = 0.0) -> tuple[Axis, str]:
    """An axis in percent, as far up as down, that holds values and all of their bars; and in words what of them it does not.

    It does not follow a few that lie much farther than most, nor beyond 100 %.

    Parameters
    ----------
    off, u : values and their bars [%]; NaN where there is none
    least : that it holds at any rate [%]
    """
    there = np.isfinite(off)
    value, bar = np.abs(off[there]), np.nan_to_num(u[there])
    usual = _OUTLYING * float(np.percentile(np.r_[value + bar, least], 90))
    ends = np.r_[(value + bar)[value + bar <= usual], least]
    most = 1.08 * float(np.clip(ends.max(), 1.0, 100.0))
    beyond, cut = int((value > most).sum()), int(((value <= most) & (value + bar > most)).sum())
    words = [f"{beyond} value{'s' if beyond > 1 else ''}"] if beyond else []
    words += [f"ends of {cut} bar{'s' if cut > 1 else ''}"] if cut else []
    return Axis(label, -most, most), f" Beyond the lower axis: {', '.join(words)}." if words else ""


def _percent(part: Array, whole: Array) -> Array:
    """Percent of a whole above 0; NaN where it is none, as where a linear fit turns negative."""
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


def _in_plane(primary: xr.Dataset, smoothed: xr.Dataset, at: int) -> _Plane:
    own = primary.isel(incidence=at).sel(wavelength=bsdf_sections.REFERENCE_WAVELENGTH, method="nearest")
    theta, phi = own["theta_s"].values, (own["phi_s"].values + 180) % 360 - 180
    towards, away = np.abs(phi) <= NEAR_PLANE, np.abs(phi) >= 180 - NEAR_PLANE
    used = np.isfinite(bsdf_sections.at_reference(smoothed["residual"]).values[at])
    cells = np.flatnonzero((towards | away | (theta < 1e-6)) & used)
    fitted = (
        smoothing.evaluate(_one(smoothed, at), theta[cells], phi[cells]).values[0, 0] if cells.size else np.zeros(0)
    )
    return _Plane(
        np.where(away, -theta, theta)[cells],
        own["brdf"].values[cells],
        own["brdf_u"].values[cells],
        fitted,
        own["kind"].values[cells] == "fibre",
    )


def _one(smoothed: xr.Dataset, at: int) -> xr.Dataset:
    """One incidence at the reference wavelength."""
    return smoothed.isel(incidence=[at]).sel(wavelength=[bsdf_sections.REFERENCE_WAVELENGTH], method="nearest")


def _curve(smoothed: xr.Dataset, at: int, cells: _Plane) -> tuple[Array, Array, Array]:
    """Angles, fit and its uncertainty, as far as cells tell; missing below the horizon."""
    ends = np.arcsinh(np.array([cells.theta.min(initial=-1.0), cells.theta.max(initial=1.0)]) / KNEE)
    margin = 0.02 * np.ptp(ends)
    theta = KNEE * np.sinh(np.linspace(ends[0] - margin, ends[1] + margin, _CURVE))
    theta = np.union1d(np.clip(theta, -180, 180).round(6), [0.0])
    phi = np.where(theta < 0, 180.0, 0.0)
    one = _one(smoothed, at)
    value, u = (
        function(one, np.abs(theta), phi).values[0, 0] for function in (smoothing.evaluate, smoothing.uncertainty)
    )
    seen = cos_view(float(one["incidence"][0]), np.abs(theta), phi) > 0
    return theta, np.where(seen, value, np.nan), np.where(seen, u, np.nan)


def _points(cells: _Plane, value: Array, u: Array, axis: Axis, tall: float) -> list[Mark]:
    with np.errstate(invalid="ignore"):
        length = tall * np.abs(axis.place(value + u) - axis.place(value - u))
    visible = length > 2 * _VISIBLE
    shown = np.where(value > 0, value, np.nan) if axis.log else value
    marks: list[Mark] = []
    for own, style, label in ((~cells.fibre, "c0", "disc"), (cells.fibre, "c2", "fibres")):
        if own.any():
            marks.append(bars(cells.theta, value, np.where(visible & own, u, np.nan), f"{style} thin"))
            marks.append(Points(cells.theta[own], shown[own], np.full(own.sum(), np.nan), f"{style} small", label))
    return marks


def bars(x: Array, y: Array, u: Array, style: str) -> Line:
    """Error bars ± u as one curve, broken between them: a quarter of the bytes of bars with feet."""
    gap = np.full(x.size, np.nan)
    return Line(np.stack([x, x, gap], axis=1).ravel(), np.stack([y - u, y + u, gap], axis=1).ravel(), style)


# --- what is left over


def residuals(primary: xr.Dataset, smoothed: xr.Dataset, at: int) -> Figure:
    """A map of the residuals of an incidence over their uncertainties, about the mirror direction."""
    incidence = float(smoothed["incidence"][at])
    title = f"{incidence:g}° incidence: residuals of the fit"
    residual = bsdf_sections.at_reference(smoothed["residual"]).values[at]
    theta, phi = smoothed["theta_s"].values, smoothed["phi_s"].values
    used = np.isfinite(residual)
    if not used.any():
        return sentence(title, "No cell was fitted.")
    largest = max(float(theta[used].max()), 1.0)
    distance = _RADIUS * np.arcsinh(theta / KNEE) / np.arcsinh(largest / KNEE)
    x = _MIDDLE[0] + distance * np.cos(np.radians(phi))
    y = _MIDDLE[1] - distance * np.sin(np.radians(phi))
    level = np.digitize(residual, _BINS)
    groups = {f"z{place}": used & (level == place) for place in range(len(_NAMES))}
    groups["none"] = ~used & (distance <= _RADIUS)
    parts = [_rings(largest), *(_dots(x[own], y[own], f"dot {style}") for style, own in groups.items())]
    parts.append(_key({style: int(own.sum()) for style, own in groups.items()}))
    parts.append(text(4, 15, "ϑ from the mirror direction, asinh", "start", "t"))
    parts.append(text(_MIDDLE[0] + _RADIUS + 8, _MIDDLE[1] + 4, "φ = 0, to the normal" if incidence else "φ = 0"))
    every = smoothed["residual"].values[at]
    every = every[np.isfinite(every)]
    note = (
        f"{bsdf_sections.wavelength_words(primary).capitalize()}. Of all wavelengths, rms "
        f"{number(float(np.sqrt(np.mean(every**2))))}, {100 * np.mean(np.abs(every) <= 1):.0f}\u202f% within ±\u202f1 and "
        f"{100 * np.mean(np.abs(every) <= 2):.0f}\u202f% within ±\u202f2; expected for correct uncertainties: slightly below 1, 68\u202f% and 95\u202f%."
    )
    svg = frame(f"Map of residuals over their uncertainty at {incidence:g} degrees of incidence", 356, parts)
    return Figure(title, svg, note=note)


def lopsided(smoothed: xr.Dataset, at: int) -> float:
    """By how many standard uncertainties residuals on either side of the plane of incidence differ on average.

    0 where it may be chance, and where the fit does not take both sides for alike.
    """
    residual = bsdf_sections.at_reference(smoothed["residual"]).values[at]
    across = np.sin(np.radians(smoothed["phi_s"].values))
    either = [residual[np.isfinite(residual) & side] for side in (across > 0.1, across < -0.1)]
    if min(half.size for half in either) < 2 or not bases.from_json(smoothed.attrs["basis"]).symmetric:
        return 0.0
    differ = float(either[0].mean() - either[1].mean())
    chance = float(np.sqrt(sum(1 / half.size for half in either)))
    return abs(differ) if abs(differ) > _LOPSIDED * chance else 0.0


def _rings(largest: float) -> str:
    """Circles of equal ϑ, labelled on a slant, where there is room outside of the last one."""
    x, y = _MIDDLE
    parts = [f'<path class="g" d="M{x - _RADIUS:g} {y:g}h{2 * _RADIUS:g}M{x:g} {y - _RADIUS:g}v{2 * _RADIUS:g}"/>']
    for angle in (*(value for value in _TICKS[1:] if value < 0.8 * largest), largest):
        r = _RADIUS * np.arcsinh(angle / KNEE) / np.arcsinh(largest / KNEE)
        parts.append(f'<circle class="g" cx="{x:g}" cy="{y:g}" r="{r:.1f}"/>')
        parts.append(text(x + 0.743 * r + 1, y - 0.669 * r, f"{angle:.0f}°", "start", "h"))
    return "".join(parts)


def _dots(x: Array, y: Array, style: str) -> str:
    """A path of dots at whole units."""
    if not x.size:
        return ""
    places = np.stack([x, y], axis=1).round().astype(int)
    steps = np.diff(places, axis=0, prepend=0)
    return f'<path class="{style}" d="M0 0' + "".join(f"m{a}{b:+d}h0" for a, b in steps.tolist()) + '"/>'


def _key(counts: dict[str, int]) -> str:
    """Styles of dots → how many there are."""
    parts = [text(404, 214, "residual / u: cells", "start", "t")]
    rows = [*reversed(list(zip(counts, _NAMES, strict=False))), ("none", "not used")]
    for place, (style, name) in enumerate(rows):
        at = 234 + 16 * place
        parts.append(f'<path class="dot {style}" d="M408 {at - 4}h0"/>{text(418, at, f"{name}: {counts[style]}")}')
    return "".join(parts)


# --- why it is as smooth as it is


def cross_validation(smoothed: xr.Dataset) -> Figure:
    """Generalised cross-validation against the strength of smoothing, each incidence over its least."""
    lines: list[Line] = []
    points: list[Points] = []
    for at, style in _shown(smoothed):
        strength, score = smoothed["strength"].values[at], smoothed["gcv"].values[at]
        over = score / np.nanmin(score)
        shown = np.where(over < 1.5 * _MOST_GCV, over, np.nan)
        lines.append(Line(strength, shown, style, _label(smoothed, at, lines)))
        chosen = float(smoothed["chosen_strength"][at])
        points.append(Points([chosen], [np.interp(np.log(chosen), np.log(strength), over)], [np.nan], style))
    return _choice(
        "Strength of smoothing: cross-validation",
        Axis("strength ε", *_span([line.x for line in lines]), log=True),
        Axis("GCV over its least", 0.9, float(np.clip(_span([line.y for line in lines])[1], 2.0, _MOST_GCV)), log=True),
        [*lines, *points],
        "Dot: strength used. In a deep, narrow minimum the strength is well determined; in a flat one it matters little.",
    )


def l_curve(smoothed: xr.Dataset) -> Figure:
    """Misfit against roughness over the strengths tried: the corner is where more roughness no longer buys a better fit."""
    lines: list[Line] = []
    points: list[Points] = []
    for at, style in _shown(smoothed):
        misfit, roughness = smoothed["chi_squared"].values[at], smoothed["roughness"].values[at]
        lines.append(Line(roughness, misfit, style, _label(smoothed, at, lines)))
        chosen, strength = np.log(float(smoothed["chosen_strength"][at])), np.log(smoothed["strength"].values[at])
        across, up = (np.interp(chosen, strength, curve) for curve in (roughness, misfit))
        points.append(Points([across], [up], [np.nan], style))
    return _choice(
        "Strength of smoothing: L-curve",
        Axis("roughness of the fit", *_span([line.x for line in lines]), log=True),
        Axis("χ², mean over wavelengths", *_span([line.y for line in lines]), log=True),
        [*lines, *points],
        "Smoothing increases from right to left. Dot: strength used; it should be at the corner.",
    )


def _choice(title: str, x: Axis, y: Axis, marks: Sequence[Mark], note: str) -> Figure:
    description = f"{title}: {y.label} against {x.label}, by angle of incidence"
    return Figure(title, chart(description, x, y, marks), legend(marks), note)


def _shown(smoothed: xr.Dataset) -> list[tuple[int, str]]:
    """Incidences with a curve, and a style each."""
    incidences = [at for at in range(smoothed.sizes["incidence"]) if np.isfinite(smoothed["gcv"].values[at]).any()]
    return [(at, _STYLES[place % len(_STYLES)]) for place, at in enumerate(incidences)]


def _label(smoothed: xr.Dataset, at: int, before: Sequence[Line]) -> str:
    return f"{'' if before else 'incidence '}{float(smoothed['incidence'][at]):g}°"


def _span(values: Sequence[ArrayLike]) -> tuple[float, float]:
    """Range of positive numbers, a little wider."""
    every = np.concatenate([np.asarray(line, dtype=float) for line in values])
    every = every[np.isfinite(every) & (every > 0)]
    low, high = (float(every.min()), float(every.max())) if every.size else (1.0, 10.0)
    return low / 1.2, max(high * 1.2, low * 2)

"""Figures of a rig measurement: camera pictures, drift of the lamp, calibration profiles, and uncertainty of the values."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import xarray as xr
from markupsafe import Markup, escape
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.report.formatting import number, percent
from brdfpipe.report.plots.svg import (
    WIDTH,
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    Points,
    chart,
    data_uri,
    frame,
    image,
    legend,
    nice_range,
)

FITTED, HIDDEN, LEFT_OUT = "fitted", "below the sample's horizon", "left out"
"""States of a cell."""

STYLES = {FITTED: "fit", HIDDEN: "low", LEFT_OUT: "out"}

COMPONENT_NAMES = {"nd": "neutral filters", "repeat": "repeatability"}
"""Names of components of the uncertainty that are not clear by themselves."""

_WEBP_QUALITY = 40
"""Half the bytes of a PNG in few greys, with no visible difference."""

_INDEPENDENT, _COMMON = "independent", "common"
_COLOUR_FAMILY = {_INDEPENDENT: "i", _COMMON: "k"}
"""Cold and warm colours."""
_MOST_COLOURS = {_INDEPENDENT: 3, _COMMON: 6}
"""Number of colours of each."""
_MOST_BINS, _CELLS_PER_BIN = 14, 6
_SMALLEST_SHARE = 1e-5
"""Smallest share whose digits are shown."""

_COLOURS = ("c0", "c2", "c1", "c4", "c3", "ref")
"""Colours of the incidences, in turn."""

_LONG_SESSION = 7200.0
"""Duration from which the unit of time is the hour [s]."""

_MOST_TICKS = 12


def cell_states(primary: xr.Dataset, smoothed: xr.Dataset, index: int) -> NDArray[np.str_]:
    """State of each cell at incidence number ``index``, the best of all wavelengths."""
    hidden = (primary["brdf_quality"].values[index] == vocabulary.quality("shadowed")).all(axis=0)
    fitted = np.isfinite(smoothed["residual"].values[index]).any(axis=0)
    return np.select([fitted, hidden], [FITTED, HIDDEN], LEFT_OUT)


# --- pictures


def frames(pictures: Sequence[tuple[xr.Dataset, NDArray[np.str_]]]) -> Figure | None:
    """The merged pictures of reduced arrangements with their cells in the colours of :func:`cell_states`; None without pictures."""
    shown = [(reduced, states) for reduced, states in pictures if "picture" in reduced]
    if not shown:
        return None
    drawn = "".join(_frame(reduced.isel(incidence=0), states) for reduced, states in shown)
    columns = len(shown) if len(shown) < 5 else 3
    grid = Markup(f'<div class="frames" style="--columns:{columns}">{drawn}</div>')
    key = tuple(("line", style, f"cell {name}") for name, style in STYLES.items())
    decades = sorted({f"{float(reduced['picture'].attrs['decades']):.1f}" for reduced, _ in shown})
    note = (
        f"Logarithmic, {' to '.join(dict.fromkeys((decades[0], decades[-1])))} decades from black to white, each picture from its "
        "own brightest part. Exposures are merged, dark frames subtracted, pixels divided by the reference and averaged over the "
        "wavelengths. Rings: edges of the cells of the disc about the mirror direction. Circles: apertures over the fibre ends. Both "
        "are registered to the picture. On the disc, the normal of the sample is to the right."
    )
    return Figure("Camera pictures", grid, key, note, full=True)


def _frame(reduced: xr.Dataset, states: NDArray[np.str_]) -> str:
    from PIL import Image

    pixels, side = np.ascontiguousarray(reduced["picture"].values), int(reduced["picture"].attrs["squares"])
    # Half pixels of the camera as units: exact enough as whole numbers, which are short.
    tall, wide = 2 * side * pixels.shape[0], 2 * side * pixels.shape[1]
    picture = data_uri(Image.fromarray(pixels), "webp", quality=_WEBP_QUALITY, method=6)
    parts = [image(picture, -1, -1, wide, tall, smooth=True)]
    column, row, radius = (2 * reduced[name].values for name in ("column", "row", "aperture"))
    on_picture, is_fibre = np.isfinite(column), np.isfinite(radius)
    if (disc := np.flatnonzero(on_picture & ~is_fibre)).size:
        edges = 2 * reduced["ring_radius"].values[reduced["ring_radius"].values > 0]
        parts.append(_circles(np.full(edges.size, column[disc[0]]), np.full(edges.size, row[disc[0]]), edges, "v"))
    for state, style in STYLES.items():
        cells = on_picture & is_fibre & (states == state)
        parts.append(_circles(column[cells], row[cells], radius[cells], f"cells {style}"))
    words = f"{reduced.attrs['side']}, {float(reduced['incidence']):g}° incidence"
    height = WIDTH * tall / wide
    # A nested svg has half pixels as units, and clips.
    inner = f'<svg viewBox="-1 -1 {wide} {tall}" width="{WIDTH}" height="{height:g}">{"".join(parts)}</svg>'
    drawn = frame(f"Picture of the camera, {words}, with the outlines of the cells", height, [inner])
    return f"<figure>{drawn}<figcaption>{escape(words.capitalize())}</figcaption></figure>"


def _circles(column: Array, row: Array, radius: Array, style: str) -> str:
    """A path of circles, each a closed arc that leaves out one unit."""
    if not column.size:
        return ""
    around = np.maximum(radius.round(), 1).astype(int)
    start = np.stack([column.round(), row.round() - around], axis=1).astype(int)
    step = np.diff(start, axis=0, prepend=0)
    data = "".join(f"m{x}{y:+d}a{r} {r} 0 1 1-1 0z" for (x, y), r in zip(step.tolist(), around.tolist(), strict=True))
    return f'<path class="{style}" d="M0 0{data}"/>'


# --- the lamp, and the rig


def drift(reduced: Sequence[xr.Dataset]) -> Figure:
    """Light of the reference spot over a run: lamp monitor readings, and the brackets at their wavelength."""
    title = "Light of the lamp"
    wavelength = _monitor_wavelength(reduced)
    readings = np.concatenate([np.zeros((0, 4)), *(_lamp_readings(arrangement, wavelength) for arrangement in reduced)])
    readings = readings[np.isfinite(readings[:, :2]).all(axis=1) & (readings[:, 1] > 0)]
    if len(readings) < 2:
        advice = "Take more: reduce `drift.every` in plan.yaml."
        return Figure(title, note=f"Too few lamp monitor readings to show drift. {advice}")
    elapsed, value, u, incidence = readings[np.argsort(readings[:, 0], kind="stable")].T
    unit, seconds = ("h", 3600.0) if np.ptp(elapsed) > _LONG_SESSION else ("min", 60.0)
    time, change, error = elapsed / seconds, 100 * (value / value[0] - 1), 100 * u / value[0]
    marks: list[Mark] = [Line(time, change, "ref")]
    for angle, style in zip(np.unique(incidence), cycle(_COLOURS), strict=False):
        of_angle = incidence == angle
        marks.append(Points(time[of_angle], change[of_angle], error[of_angle], style, f"{angle:g}°"))
    shown = [float(np.nanmin([change - error, change])), float(np.nanmax([change + error, change]))]
    tolerance = 100 * max((float(arrangement.attrs.get("drift_tolerance", 0.0)) for arrangement in reduced), default=0)
    if tolerance:
        marks += [Line(time[[0, -1]], np.full(2, sign * tolerance), "c3", pattern="dash") for sign in (-1, 1)]
        shown = [min(shown[0], -tolerance), max(shown[1], tolerance)]
    low, high = nice_range(*shown, margin=0.1)
    svg = chart(
        "Light of the reference spot against time since the start of the run, by incidence",
        Axis(f"time since the start of the run, {unit}", *nice_range(float(time[0]), float(time[-1]))),
        Axis("change of the reference, %", min(low, -0.5), max(high, 0.5)),
        marks,
        height=240,
    )
    note = (
        f"Lamp monitor readings, and the bracket of each arrangement, at {wavelength:g}\u202fnm: {len(readings)} values; bars: ±\u202f1 standard "
        f"uncertainty. They span {number(float(np.ptp(change)), 2)}\u202f%. The drift cancels: each frame is divided by its own reference."
    )
    if tolerance:
        note += f" Dashed: ±\u202f{tolerance:g}\u202f%, beyond which the scan warns (`drift.tolerance` in plan.yaml)."
    return Figure(title, svg, legend(marks), note)


def _monitor_wavelength(reduced: Sequence[xr.Dataset]) -> float:
    """Wavelength of the lamp monitor readings; without readings, the wavelength with most light."""
    for arrangement in reduced:
        if "drift_wavelength" in arrangement:
            return float(arrangement["drift_wavelength"][0])
    references = (arrangement["reference"].mean("incidence") for arrangement in reduced)
    light = next((reference for reference in references if reference.notnull().any()), None)
    return float("nan") if light is None else float(light["wavelength"].values[np.nanargmax(light.values)])


def _lamp_readings(reduced: xr.Dataset, wavelength: float) -> Array:
    """Time, light, its uncertainty and incidence, (reading, 4), of an arrangement at a wavelength."""
    readings = [np.zeros((0, 3))]
    if "drift_wavelength" in reduced:
        monitored = reduced.isel(look=reduced["drift_wavelength"].values == wavelength)
        names = ("drift_elapsed", "drift_reference", "drift_reference_u")
        readings.append(np.stack([monitored[name].values for name in names], axis=1))
    if "elapsed" in reduced:
        selected = reduced["wavelength"].values == wavelength
        names = ("elapsed", "reference", "reference_u")
        readings.append(np.stack([reduced[name].values[0, selected] for name in names], axis=1))
    values = np.concatenate(readings)
    return np.column_stack([values, np.full(len(values), float(reduced["incidence"][0]))])


def profiles(calibration: xr.Dataset) -> Figure:
    """Control chart of calibration profiles: changes since the first one, with their limits."""
    title = "Calibration profiles of the rig"
    count = calibration.sizes.get("profile", 0)
    if count < 2:
        advice = "Name the preceding calibration as `previous` in calibration.yaml; each new profile is then compared with the earlier profiles."
        return Figure(title, note=f"A chart needs two profiles. {advice}")
    level = calibration["scale_change"].dropna("wavelength").mean("wavelength").values
    change, limit, violation = (
        calibration[name].transpose("watched", "profile").sel(watched=["level", "spectrum"]).values
        for name in ("change", "limit", "violation")
    )
    # The level of each profile is compared with the mean level of the earlier profiles, its spectrum with their mean spectrum.
    values, expected = np.array([level, change[1]]), np.array([level - change[0], np.zeros(count)])
    shown, low, high = (100 * np.expm1(logs) for logs in (values, expected - limit, expected + limit))
    number_of_profile = np.arange(1.0, count + 1)
    steps = (number_of_profile[1:, None] + [-0.5, 0.5]).ravel()
    bottom, top = (np.repeat(limits[:, 1:], 2, axis=1) for limits in (low, high))
    marks: list[Mark] = [
        Band(steps, bottom[0], top[0], "c0", "limits of the mean"),
        Line(steps, bottom[1], "c2", pattern="dash"),
        Line(steps, top[1], "c2", "limits of one wavelength", pattern="dash"),
    ]
    labels = {"c0": "mean over wavelengths", "c2": "wavelength that deviates most"}
    for curve, (style, label) in zip(shown, labels.items(), strict=True):
        marks += [Line(number_of_profile, curve, style), Points(number_of_profile, curve, style=style, label=label)]
    violated = np.asarray(violation, dtype=bool)
    if violated.any():
        violations = np.where(violated, shown, np.nan).ravel()
        marks.append(Points(np.tile(number_of_profile, 2), violations, style="c3", label="violation"))
    drawn = np.stack([low, high, shown])
    svg = chart(
        "Change of the scale of the cells against the number of the profile, with limits",
        Axis("profile, in the order they were made", 0.5, count + 0.5, step=-(-count // _MOST_TICKS)),
        Axis("change of the scale, %", *nice_range(float(np.nanmin(drawn)), float(np.nanmax(drawn)), margin=0.08)),
        marks,
        height=260,
    )
    return Figure(title, svg, legend(marks), _profile_note(calibration, violated[0] | violated[1]))


def _profile_note(calibration: xr.Dataset, violation: NDArray[np.bool_]) -> str:
    """The first profile of the chart, the one in use, and violations."""
    named = [
        f"{name} of {day}"
        for name, day in zip(calibration["profile"].values, calibration["profile_day"].values, strict=True)
    ]
    note = (
        f"From 1, {named[0]}, to {len(named)}, {named[-1]}, which is in use: scale of the cells over that of the first, median of "
        "the cells, and the wavelength that deviates most. Limits: 3 standard deviations about the mean of the earlier profiles. A change "
        "beyond them is significant: the etalon is dirty or aged, or the optics changed."
    )
    violations = [profile for profile, is_violation in zip(named, violation, strict=True) if is_violation]
    return note + (f" Violations: {', '.join(violations)}." if violations else " No profile is beyond them.")


# --- uncertainty


def components(primary: xr.Dataset) -> dict[str, str]:
    """Components of the uncertainty → ``independent`` or ``common``, independent ones first."""
    names = [str(name) for name in primary.data_vars if str(name).startswith("brdf_u_")]
    independent = {name: primary[name].attrs.get("correlation") == _INDEPENDENT for name in names}
    ordered = sorted(names, key=lambda name: not independent[name])
    return {name.removeprefix("brdf_u_"): _INDEPENDENT if independent[name] else _COMMON for name in ordered}


def valid(primary: xr.Dataset, kind: str) -> NDArray[np.bool_]:
    """Measured positive values (incidence, wavelength, cell) of one kind of cell, ``fibre`` or ``disc``."""
    measured = primary["brdf_quality"].values == vocabulary.quality("measured")
    return np.asarray(measured & (primary["brdf"].values > 0) & (primary["kind"].values == kind))


def budget(primary: xr.Dataset, kind: str) -> Figure | None:
    """Shares of the variance by component, stacked, against the angle from the mirror direction; None without values."""
    parts = components(primary)
    used = valid(primary, kind)
    cells = np.flatnonzero(used.any(axis=(0, 1)))
    if not parts or cells.size == 0:
        return None
    middle, mean = _binned(primary["theta_s"].values[cells], _shares(primary, list(parts), used)[:, cells])
    parts, mean = _largest(parts, mean)
    stacked = np.concatenate([np.zeros((1, middle.size)), np.cumsum(mean, axis=0)]) * 100 / mean.sum(axis=0)
    count = {_INDEPENDENT: 0, _COMMON: 0}
    marks: list[Mark] = []
    for k, (name, correlation) in enumerate(parts.items()):
        style = f"f {_COLOUR_FAMILY[correlation]}{count[correlation]}"
        label = name if name.startswith("others") else f"{COMPONENT_NAMES.get(name, name)} ({correlation})"
        marks.append(Band(middle, stacked[k], stacked[k + 1], style, label))
        count[correlation] += 1
    if 0 < count[_INDEPENDENT] < len(parts):
        marks.append(Line(middle, stacked[count[_INDEPENDENT]], "edge"))
    words = "on the disc" if kind == "disc" else "of the fibres"
    svg = chart(
        f"Shares of the variance {words} by component against the angle from the mirror direction",
        Axis("angle from the mirror direction, °", *nice_range(float(middle[0]), float(middle[-1]), margin=0.0)),
        Axis("share of the variance, %", 0, 100, step=20),
        marks,
    )
    note = (
        f"Median standard uncertainty {uncertainty_percent(median_uncertainty(primary, kind))}; {cells.size} cells. Below the line: errors independent "
        "from cell to cell, which a fit averages away; above it: errors common to all, which it cannot. Medians over wavelengths "
        "and incidences."
    )
    return Figure(f"Where the uncertainty {words} comes from", svg, legend(marks), note)


def _largest(parts: dict[str, str], mean: Array) -> tuple[dict[str, str], Array]:
    """The components with the largest shares (component, bin) of either kind, and the sum of its others."""
    shown: dict[str, str] = {}
    rows: list[Array] = []
    for correlation, most in _MOST_COLOURS.items():
        own = [k for k, kind in enumerate(parts.values()) if kind == correlation]
        order = sorted(own, key=lambda k: -float(mean[k].mean()))
        kept = order if len(order) <= most else order[: most - 1]
        for k in sorted(kept):
            shown[list(parts)[k]] = correlation
            rows.append(mean[k])
        if len(kept) < len(order):
            shown[f"others, {correlation}"] = correlation
            rows.append(mean[order[len(kept) :]].sum(axis=0))
    return shown, np.array(rows)


def median_uncertainty(primary: xr.Dataset, kind: str, component: str = "") -> float:
    """Median relative standard uncertainty of valid values, combined or of a component; NaN without values."""
    used = valid(primary, kind)
    u = primary[f"brdf_u_{component}" if component else "brdf_u"]
    relative_u = (u / primary["brdf"]).transpose(*primary["brdf"].dims).values[used]
    return float(np.median(relative_u)) if relative_u.size else float("nan")


def _shares(primary: xr.Dataset, names: list[str], used: NDArray[np.bool_]) -> Array:
    """Median over incidences and wavelengths of the share of each component (component, cell); NaN without used values."""
    variance = np.stack([primary[f"brdf_u_{name}"].values ** 2 for name in names])
    total = variance.sum(axis=0)
    share = np.where(used & (total > 0), variance / np.where(total > 0, total, 1.0), np.nan)
    flat = share.reshape(len(names), -1, share.shape[-1])
    medians = np.full((len(names), share.shape[-1]), np.nan)
    known = np.isfinite(flat[0]).any(axis=0)
    medians[:, known] = np.nanmedian(flat[:, :, known], axis=1)
    return medians


def _binned(theta: Array, share: Array) -> tuple[Array, Array]:
    """Mean angle and mean shares (component, bin) over bins of neighbouring angles with similar numbers of cells."""
    count = int(np.clip(theta.size // _CELLS_PER_BIN, 1, _MOST_BINS))
    # Cells of one ring stay together.
    edges = np.unique(np.quantile(theta, np.linspace(0, 1, count + 1))[1:-1])
    bins = np.searchsorted(edges, theta, side="left")
    weight = np.equal.outer(np.unique(bins), bins).astype(float)
    weight /= weight.sum(axis=1, keepdims=True)
    return weight @ theta, share @ weight.T


def uncertainty_percent(share: float) -> str:
    """A relative uncertainty [1] in percent; an upper limit where it is too small for its digits to matter."""
    return f"< {100 * _SMALLEST_SHARE:g}\u202f%" if 0 < share < _SMALLEST_SHARE else percent(share)

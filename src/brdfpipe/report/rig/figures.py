"""The figures of a measurement with a camera rig: what the camera saw, how steady the lamp was, and how sure each value is."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from io import BytesIO

import numpy as np
import xarray as xr
from markupsafe import Markup, escape
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.report.formatting import number
from brdfpipe.report.plots.svg import (
    WIDTH,
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Points,
    chart,
    frame,
    image,
    legend,
    nice_range,
    sentence,
)

FITTED, HIDDEN, LEFT_OUT = "fitted", "below the sample's horizon", "left out"
"""What became of a cell."""

STYLES = {FITTED: "fit", HIDDEN: "low", LEFT_OUT: "out"}

NAMES = {"nd": "neutral filters", "repeat": "repeatability"}
"""Of components of uncertainty, where the short one says little."""

_QUALITY = 40
"""Of pictures: half the bytes of a PNG in few greys, and no difference to the eye."""

_INDEPENDENT, _COMMON = "independent", "common"
_FAMILY = {_INDEPENDENT: "i", _COMMON: "k"}
"""Of colours: cold and warm ones."""
_MOST_BINS = 14
_CELLS_A_BIN = 6
_LEAST = 1e-5
"""Share below which its digits mean nothing."""

_COLOURS = ("c0", "c2", "c1", "c4", "c3", "ref")
"""Of incidences."""

_LONG = 7200.0
"""Of a session that is told in hours [s]."""

_MOST_TICKS = 12


def states(primary: xr.Dataset, smoothed: xr.Dataset, at: int) -> NDArray[np.str_]:
    """What became of each cell at an incidence, the best of all wavelengths."""
    hidden = (primary["brdf_quality"].values[at] == vocabulary.quality("shadowed")).all(axis=0)
    fitted = np.isfinite(smoothed["residual"].values[at]).any(axis=0)
    return np.select([fitted, hidden], [FITTED, HIDDEN], LEFT_OUT)


# --- pictures


def frames(looks: Sequence[tuple[xr.Dataset, NDArray[np.str_]]]) -> Figure | None:
    """The merged picture of each arrangement, with its cells; None where no dataset holds one.

    Parameters
    ----------
    looks : kind ``reduced``, and what became of its cells
    """
    shown = [(reduced, became) for reduced, became in looks if "picture" in reduced]
    if not shown:
        return None
    pictures = "".join(_frame(reduced.isel(incidence=0), became) for reduced, became in shown)
    columns = len(shown) if len(shown) < 5 else 3
    grid = Markup(f'<div class="frames" style="--columns:{columns}">{pictures}</div>')
    key = tuple(("line", style, f"cell {name}") for name, style in STYLES.items())
    decades = sorted({f"{float(reduced['picture'].attrs['decades']):.1f}" for reduced, _ in shown})
    note = (
        f"Logarithmic, {' to '.join(dict.fromkeys((decades[0], decades[-1])))} decades from black to white, each picture from its "
        "own brightest part. Exposures are merged, dark frames subtracted, pixels divided by the reference and averaged over the "
        "wavelengths. Rings: edges of the cells of the disc about the mirror direction. Circles: apertures over the fibre ends. Both "
        "are registered to the picture. On the disc, the normal of the sample is to the right."
    )
    return Figure("Camera pictures", grid, key, note)


def _frame(reduced: xr.Dataset, became: NDArray[np.str_]) -> str:
    pixels, side = reduced["picture"].values, int(reduced["picture"].attrs["squares"])
    # Half pixels of the camera as whole units: short numbers, and exact enough.
    tall, wide = 2 * side * pixels.shape[0], 2 * side * pixels.shape[1]
    parts = [image(_webp(pixels), -1, -1, wide, tall, smooth=True)]
    column, row, radius = (2 * reduced[name].values for name in ("column", "row", "aperture"))
    fibre = np.isfinite(radius) & np.isfinite(column)
    disc = np.flatnonzero(~np.isfinite(radius) & np.isfinite(column))
    if disc.size:
        edges = 2 * reduced["ring_radius"].values[reduced["ring_radius"].values > 0]
        middle = np.full((2, edges.size), [[column[disc[0]]], [row[disc[0]]]])
        parts.append(_circles(middle[0], middle[1], edges, "v"))
    for name, style in STYLES.items():
        chosen = fibre & (became == name)
        parts.append(_circles(column[chosen], row[chosen], radius[chosen], f"cells {style}"))
    words = f"{reduced.attrs['side']}, {float(reduced['incidence']):g}° incidence"
    height = WIDTH * tall / wide
    # A nested svg counts in half pixels, and clips.
    inner = f'<svg viewBox="-1 -1 {wide} {tall}" width="{WIDTH}" height="{height:g}">{"".join(parts)}</svg>'
    drawn = frame(f"Picture of the camera, {words}, with the outlines of the cells", height, [inner])
    return f"<figure>{drawn}<figcaption>{escape(words.capitalize())}</figcaption></figure>"


def _webp(pixels: NDArray[np.uint8]) -> str:
    """Data URI of a picture in greys."""
    from PIL import Image

    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "WEBP", quality=_QUALITY, method=6)
    return "data:image/webp;base64," + b64encode(stream.getvalue()).decode("ascii")


def _circles(column: Array, row: Array, radius: Array, style: str) -> str:
    """A path of circles: each an arc all around but for one unit, and closed."""
    if not column.size:
        return ""
    around = np.maximum(radius.round(), 1).astype(int)
    start = np.stack([column.round(), row.round() - around], axis=1).astype(int)
    step = np.diff(start, axis=0, prepend=0)
    data = "".join(f"m{x}{y:+d}a{r} {r} 0 1 1-1 0z" for (x, y), r in zip(step.tolist(), around.tolist(), strict=True))
    return f'<path class="{style}" d="M0 0{data}"/>'


# --- the lamp, and the rig


def drift(reduced: Sequence[xr.Dataset]) -> Figure:
    """Light of the reference spot over the session: lamp monitor readings, and the brackets at their wavelength.

    Parameters
    ----------
    reduced : kind ``reduced``, of one run
    """
    title = "Light of the lamp"
    wavelength = _monitor_wavelength(reduced)
    readings = np.concatenate([np.zeros((0, 4)), *(_lamp_readings(arrangement, wavelength) for arrangement in reduced)])
    readings = readings[np.isfinite(readings[:, :2]).all(axis=1) & (readings[:, 1] > 0)]
    if len(readings) < 2:
        return sentence(
            title, "Too few lamp monitor readings to show drift. Take more: reduce `drift.every` in plan.yaml."
        )
    elapsed, value, u, incidence = readings[np.argsort(readings[:, 0], kind="stable")].T
    unit, seconds = ("h", 3600.0) if np.ptp(elapsed) > _LONG else ("min", 60.0)
    time, change, error = elapsed / seconds, 100 * (value / value[0] - 1), 100 * u / value[0]
    marks: list[Line | Points] = [Line(time, change, "ref")]
    for place, angle in enumerate(np.unique(incidence)):
        own, style = incidence == angle, _COLOURS[place % len(_COLOURS)]
        marks.append(Points(time[own], change[own], error[own], style, f"{angle:g}°"))
    reach = [float(np.nanmin([change - error, change])), float(np.nanmax([change + error, change]))]
    tolerance = 100 * max(
        (float(arrangement.attrs.get("drift_tolerance", 0.0)) for arrangement in reduced), default=0.0
    )
    if tolerance:
        marks += [Line(time[[0, -1]], np.full(2, sign * tolerance), "c3", pattern="dash") for sign in (-1, 1)]
        reach = [min(reach[0], -tolerance), max(reach[1], tolerance)]
    low, high = nice_range(*reach, margin=0.1)
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
    light = [
        arrangement["reference"].mean("incidence")
        for arrangement in reduced
        if arrangement["reference"].notnull().any()
    ]
    return float(light[0]["wavelength"].values[np.nanargmax(light[0].values)]) if light else float("nan")


def _lamp_readings(reduced: xr.Dataset, wavelength: float) -> Array:
    """Time, light, its uncertainty and incidence (value, 4) of the readings of an arrangement at a wavelength."""
    readings = [np.zeros((0, 3))]
    if "drift_wavelength" in reduced:
        looks = reduced.isel(look=reduced["drift_wavelength"].values == wavelength)
        names = ("drift_elapsed", "drift_reference", "drift_reference_u")
        readings.append(np.stack([looks[name].values for name in names], axis=1))
    if "elapsed" in reduced:
        at = reduced["wavelength"].values == wavelength
        readings.append(
            np.stack([reduced[name].values[0, at] for name in ("elapsed", "reference", "reference_u")], axis=1)
        )
    values = np.concatenate(readings)
    return np.column_stack([values, np.full(len(values), float(reduced["incidence"][0]))])


def profiles(calibration: xr.Dataset) -> Figure:
    """The control chart of a calibration profile: how it and those before it differ, and by how much they may.

    Parameters
    ----------
    calibration : kind ``calibration``
    """
    title = "Calibration profiles of the rig"
    count = calibration.sizes.get("profile", 0)
    if count < 2:
        advice = (
            "A chart needs two profiles. Name the preceding calibration as `previous` in calibration.yaml; each new profile is then compared "
            "with those before."
        )
        return sentence(title, advice)
    level = calibration["scale_change"].dropna("wavelength").mean("wavelength").values
    change, limit, violation = (
        calibration[name].transpose("watched", "profile").sel(watched=["level", "spectrum"]).values
        for name in ("change", "limit", "violation")
    )
    # The level over that of the first, about the mean of those before; the spectrum about its own.
    values, middle = np.array([level, change[1]]), np.array([level - change[0], np.zeros(count)])
    shown, low, high = (100 * np.expm1(change) for change in (values, middle - limit, middle + limit))
    place, none = np.arange(1.0, count + 1), np.full(count, np.nan)
    steps = (place[1:, None] + [-0.5, 0.5]).ravel()
    bottom, top = (np.repeat(limits[:, 1:], 2, axis=1) for limits in (low, high))
    marks: list[Band | Line | Points] = [
        Band(steps, bottom[0], top[0], "c0", "limits of the mean"),
        Line(steps, bottom[1], "c2", pattern="dash"),
        Line(steps, top[1], "c2", "limits of one wavelength", pattern="dash"),
    ]
    for own, style, label in zip(
        shown, ("c0", "c2"), ("mean over wavelengths", "wavelength that deviates most"), strict=True
    ):
        marks += [Line(place, own, style), Points(place, own, none, style, label)]
    beyond = np.asarray(violation, dtype=bool)
    if beyond.any():
        marks.append(
            Points(np.tile(place, 2), np.where(beyond, shown, np.nan).ravel(), np.tile(none, 2), "c3", "violation")
        )
    drawn = np.stack([low, high, shown])
    svg = chart(
        "Change of the scale of the cells against the number of the profile, with limits",
        Axis("profile, in the order they were made", 0.5, count + 0.5, step=-(-count // _MOST_TICKS)),
        Axis("change of the scale, %", *nice_range(float(np.nanmin(drawn)), float(np.nanmax(drawn)), margin=0.08)),
        marks,
        height=260,
    )
    return Figure(title, svg, legend(marks), _told(calibration, beyond[0] | beyond[1]))


def _told(calibration: xr.Dataset, violation: NDArray[np.bool_]) -> str:
    """What a chart shows, from its first profile to the one in use, and which are violations."""
    named = [
        f"{name} of {day}"
        for name, day in zip(calibration["profile"].values, calibration["profile_day"].values, strict=True)
    ]
    note = (
        f"From 1, {named[0]}, to {len(named)}, {named[-1]}, which is in use: scale of the cells over that of the first, median of "
        "the cells, and the wavelength that deviates most. Limits: 3 standard deviations about the mean of the profiles before. A change "
        "beyond them is significant: the etalon is dirty or aged, or the optics changed."
    )
    violations = [profile for profile, is_violation in zip(named, violation, strict=True) if is_violation]
    return note + (f" Violations: {', '.join(violations)}." if violations else " No profile is beyond them.")


# --- the uncertainty


def components(primary: xr.Dataset) -> dict[str, str]:
    """Components of the uncertainty, independent ones first → ``independent`` or ``common``."""
    names = [str(name) for name in primary.data_vars if str(name).startswith("brdf_u_")]
    alone = {name: primary[name].attrs.get("correlation") == _INDEPENDENT for name in names}
    ordered = sorted(names, key=lambda name: not alone[name])
    return {name.removeprefix("brdf_u_"): _INDEPENDENT if alone[name] else _COMMON for name in ordered}


def sound(primary: xr.Dataset, kind: str) -> NDArray[np.bool_]:
    """Values (incidence, wavelength, cell) of one kind of cell, ``fibre`` or ``disc``, that are sound and positive."""
    measured = primary["brdf_quality"].values == vocabulary.quality("measured")
    return np.asarray(measured & (primary["brdf"].values > 0) & (primary["kind"].values == kind))


def budget(primary: xr.Dataset, kind: str) -> Figure | None:
    """Shares of the variance by component, stacked, against the angle from the mirror direction; None without values.

    Parameters
    ----------
    primary : kind ``primary``
    kind : of cells, ``fibre`` or ``disc``
    """
    parts = components(primary)
    used = sound(primary, kind)
    cells = np.flatnonzero(used.any(axis=(0, 1)))
    if not parts or cells.size == 0:
        return None
    share = _shares(primary, list(parts), used)[:, cells]
    theta = primary["theta_s"].values[cells]
    middle, mean = _binned(theta, share)
    stacked = np.concatenate([np.zeros((1, middle.size)), np.cumsum(mean, axis=0)]) * 100 / mean.sum(axis=0)
    count = {_INDEPENDENT: 0, _COMMON: 0}
    marks: list[Band | Line] = []
    for place, (name, correlation) in enumerate(parts.items()):
        style = f"f {_FAMILY[correlation]}{count[correlation]}"
        label = f"{NAMES.get(name, name)} ({correlation})"
        marks.append(Band(middle, stacked[place], stacked[place + 1], style, label))
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
        f"Median standard uncertainty {percent(relative(primary, kind))}; {cells.size} cells. Below the line: errors independent "
        "from cell to cell, which a fit averages away; above it: errors common to all, which it cannot. Medians over wavelengths "
        "and incidences."
    )
    return Figure(f"Where the uncertainty {words} comes from", svg, legend(marks), note)


def relative(primary: xr.Dataset, kind: str, component: str = "") -> float:
    """Median relative standard uncertainty of sound values, combined or of a component; NaN without values."""
    used = sound(primary, kind)
    u = primary[f"brdf_u_{component}" if component else "brdf_u"]
    relative_u = (u / primary["brdf"]).transpose(*primary["brdf"].dims).values[used]
    return float(np.median(relative_u)) if relative_u.size else float("nan")


def _shares(primary: xr.Dataset, names: list[str], used: NDArray[np.bool_]) -> Array:
    """Median over incidences and wavelengths of each component's share (component, cell); NaN where none is used."""
    variance = np.stack([primary[f"brdf_u_{name}"].values ** 2 for name in names])
    total = variance.sum(axis=0)
    share = np.where(used & (total > 0), variance / np.where(total > 0, total, 1.0), np.nan)
    flat = share.reshape(len(names), -1, share.shape[-1])
    medians = np.full((len(names), share.shape[-1]), np.nan)
    some = np.isfinite(flat[0]).any(axis=0)
    medians[:, some] = np.nanmedian(flat[:, :, some], axis=1)
    return medians


def _binned(theta: Array, share: Array) -> tuple[Array, Array]:
    """Means over bins of neighbouring angles with about as many cells each: the angle, and the shares (component, bin)."""
    count = int(np.clip(theta.size // _CELLS_A_BIN, 1, _MOST_BINS))
    # Cells of one ring stay together.
    edges = np.unique(np.quantile(theta, np.linspace(0, 1, count + 1))[1:-1])
    place = np.searchsorted(edges, theta, side="left")
    weight = np.equal.outer(np.unique(place), place).astype(float)
    weight /= weight.sum(axis=1, keepdims=True)
    return weight @ theta, share @ weight.T


def percent(share: float) -> str:
    """A small share in words."""
    if 0 < share < _LEAST:
        return f"< {100 * _LEAST:g}\u202f%"
    return f"{number(100 * share, 2)}\u202f%"

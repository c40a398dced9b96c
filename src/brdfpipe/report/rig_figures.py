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
from brdfpipe.report.pages import number
from brdfpipe.report.svg import (
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
        "own brightest part; exposures merged, dark frames taken away, every pixel over the reference, mean over the wavelengths. "
        "Rings: edges of the disc's cells about the mirror direction; circles: where the light of a fibre's end is gathered; both "
        "as registered in the picture. On the disc, the sample's normal is to the right."
    )
    return Figure("What the camera saw", grid, key, note)


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


# --- the lamp


def drift(reduced: Sequence[xr.Dataset]) -> Figure:
    """Light of the reference spot over the time of the run, at the looks taken for that purpose."""
    title = "Light of the lamp"
    held = [each for each in reduced if "drift_reference" in each and each.sizes["look"]]
    names = ("drift_elapsed", "drift_reference", "drift_reference_u")
    elapsed, value, u = (np.concatenate([np.zeros(0), *(each[name].values.ravel() for each in held)]) for name in names)
    seen = np.flatnonzero(np.isfinite(elapsed + value) & (value > 0))
    if seen.size < 2:
        advice = "Too few looks at the lamp tell of its drift; make `drift.every` of plan.yaml smaller to take more."
        return sentence(title, advice)
    seen = seen[np.argsort(elapsed[seen], kind="stable")]
    minutes, first = elapsed[seen] / 60, value[seen[0]]
    change, error = 100 * (value[seen] / first - 1), 100 * u[seen] / first
    low, high = nice_range(float(np.nanmin(change - error)), float(np.nanmax(change + error)), margin=0.1)
    svg = chart(
        "Light of the reference spot against time since the start of the run",
        Axis("time since the start of the run, min", *nice_range(float(minutes[0]), float(minutes[-1]))),
        Axis("change of the reference, %", min(low, -0.5), max(high, 0.5)),
        [Line(minutes, change, "ref"), Points(minutes, change, error, "c0")],
        height=240,
    )
    note = (
        f"{seen.size} looks at one wavelength and filter; bars are ±\u202f1 standard uncertainty, of noise. They span "
        f"{number(float(np.ptp(change)), 2)}\u202f%, which divides out: each frame is taken over its own reference."
    )
    return Figure(title, svg, note=note)


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
    found = (u / primary["brdf"]).transpose(*primary["brdf"].dims).values[used]
    return float(np.median(found)) if found.size else float("nan")


def _shares(primary: xr.Dataset, names: list[str], used: NDArray[np.bool_]) -> Array:
    """Median over incidences and wavelengths of each component's share (component, cell); NaN where none is used."""
    variance = np.stack([primary[f"brdf_u_{name}"].values ** 2 for name in names])
    total = variance.sum(axis=0)
    share = np.where(used & (total > 0), variance / np.where(total > 0, total, 1.0), np.nan)
    flat = share.reshape(len(names), -1, share.shape[-1])
    found = np.full((len(names), share.shape[-1]), np.nan)
    some = np.isfinite(flat[0]).any(axis=0)
    found[:, some] = np.nanmedian(flat[:, :, some], axis=1)
    return found


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

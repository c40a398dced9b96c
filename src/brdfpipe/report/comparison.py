"""Comparison of the measured with the predicted BRDF: figures and tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe import vocabulary
from brdfpipe.comparison import findings
from brdfpipe.comparison.findings import NAMES, plus_minus
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend
from brdfpipe.report.rig import fit as rig_fit

_BESIDE = 12.0
"""Azimuth from the plane of incidence up to which a cell is shown as if it lay in it [degree]."""

_MOST_DECADES = 6
_RATIOS = 0.5, 2.0
_BINS = 60

_STYLES: dict[str, tuple[str, Literal["line", "dash"]]] = {"predicted": ("c1", "dash"), "adjusted": ("c2", "line")}
"""Colour and pattern of each model."""


@dataclass(frozen=True)
class Chapter:
    """The comparison section of a page."""

    findings: Sequence[str]
    warnings: Sequence[str]
    parts: Sequence[Table | Figure]


def chapter(comparison: xr.Dataset | None) -> Chapter | None:
    """The comparison of a material; None without a dataset of kind ``comparison``."""
    if comparison is None:
        return None
    sentences = [f"{text[:1].upper()}{text[1:]}." for text in findings.sentences(comparison)]
    ratios, *cuts = figures(comparison)
    *inputs, incidences = tables(comparison)
    return Chapter(sentences, vocabulary.warnings(comparison), [*inputs, ratios, *cuts, incidences])


def tables(comparison: xr.Dataset) -> list[Table]:
    """The inputs before and after, where some were fitted; and how well each incidence agrees."""
    names = [] if "posterior" not in comparison else list(map(str, comparison["input"].values))
    fitted = [_input(name, comparison.sel(input=name)) for name in names]
    enlarged = float(comparison.attrs["enlarged"])
    note = "± standard uncertainty; u of a factor is relative."
    if enlarged > 1.05:
        note += f" The uncertainties were enlarged {number(enlarged, 2)} times: the values scatter more than stated."
    header = ("Input", "Before", "After", "Change / u before")
    return ([Table("Inputs of the prediction", header, fitted, note)] if fitted else []) + [_incidences(comparison)]


def figures(comparison: xr.Dataset) -> list[Figure]:
    """How the ratio of measured to modelled is distributed; then both in the plane of incidence, one chart an incidence."""
    places = range(comparison.sizes["incidence"])
    return [_ratios(comparison), *(figure for at in places for figure in _cut(comparison.isel(incidence=at)))]


def _input(name: str, one: xr.Dataset) -> tuple[str, ...]:
    before, before_u, after, after_u = (float(one[name]) for name in ("prior", "prior_u", "posterior", "posterior_u"))
    title = "refractive index, shift" if name == "index" else NAMES[name]
    sign = "+" if name == "index" else ""
    return (
        title[:1].upper() + title[1:],
        plus_minus(before, before_u, sign),
        plus_minus(after, after_u, sign),
        fixed((after - before) / before_u, 2),
    )


def _incidences(comparison: xr.Dataset) -> Table:
    seen = _at_reference(comparison)
    places = [(at, model) for at in range(seen.sizes["incidence"]) for model in range(seen.sizes["model"])]
    rows = [_row(seen.isel(incidence=at, model=model)) for at, model in places]
    header = ("Incidence", "Model", "Measured / model", "rms z", "Reflectance into the cells", "of the model")
    note = (
        "Median of the ratio and rms of the difference over its uncertainty: all values. Reflectance: into the directions of the cells, "
        f"{bsdf_sections.wavelength_words(comparison)}."
    )
    return Table("Agreement at each incidence", header, rows, note)


def _at_reference(comparison: xr.Dataset) -> xr.Dataset:
    wavelength = bsdf_sections.reference(comparison)
    assert wavelength is not None
    return comparison.sel(wavelength=wavelength[0])


def _row(one: xr.Dataset) -> tuple[str, ...]:
    return (
        f"{float(one['incidence']):g}°",
        str(one["model"].values),
        fixed(float(one["median_ratio"]), 3),
        fixed(float(one["rms_z"]), 2),
        plus_minus(float(one["seen_reflectance"]), float(one["seen_reflectance_u"])),
        number(float(one["seen_reflectance_model"]), 4),
    )


def _cut(comparison: xr.Dataset) -> Iterator[Figure]:
    """The cells near the plane of incidence, at one incidence and wavelength."""
    one = _at_reference(comparison)
    turn = (one["phi_s"].values + 90) % 180 - 90
    near = np.flatnonzero((np.abs(turn) < _BESIDE) & np.isfinite(one["brdf"].values))
    if not near.size:
        return
    one = one.isel(cell=near[np.argsort(_aspecular(one.isel(cell=near)), kind="stable")])
    angle, value = _aspecular(one), one["brdf"].values
    marks: list[Mark] = []
    for model, drawn in zip(map(str, one["model"].values), one["brdf_model"].values, strict=True):
        style, pattern = _STYLES[model]
        marks.append(Line(angle, _shown(drawn), style, model, pattern))
    u = one["brdf_u"].values
    marks += [rig_fit.bars(angle, value, u, "c0 thin"), _dots(angle, _shown(value), "c0", "measured ± u")]
    # A bar that reaches 0 has no lower end on this axis; the upper ends are all to be seen.
    shown = np.concatenate([value, value + np.nan_to_num(u), one["brdf_model"].values.ravel()])
    title = f"Measured and predicted at {float(one['incidence']):g}°"
    across = Axis("angle from the mirror direction, °; positive towards the normal", *_ends(angle))
    words = f"{title} of incidence: BRDF against the angle from the mirror direction"
    svg = chart(f"{words}, logarithmic", across, _decades(shown[shown > 0]), marks)
    strip, left_out = _strip(words, one, angle, across)
    note = (
        f"Cells within {_BESIDE:g}° of azimuth from the plane of incidence, {bsdf_sections.wavelength_words(comparison)}; models are "
        "drawn through their values at the same cells. Below: measured over model less 1, in the colour of the model; bars: "
        f"±\u202f1 standard uncertainty of the measurement.{left_out}"
    )
    yield Figure(title, svg + strip, legend(marks), note)


def _strip(words: str, one: xr.Dataset, angle: Array, across: Axis) -> tuple[Markup, str]:
    """Measured less each model in percent of it, with what of it lies beyond the axis, in words."""
    models = list(map(str, one["model"].values))
    modelled = np.where(one["brdf_model"].values > 0, one["brdf_model"].values, np.nan)
    off, u = 100 * (one["brdf"].values / modelled - 1), 100 * one["brdf_u"].values / modelled
    scale, left_out = rig_fit.about_zero("measured over model less 1, %", off.ravel(), u.ravel())
    marks: list[Mark] = [Line([across.low, across.high], [0.0, 0.0], "ref")]
    for model, own, error in zip(models, off, u, strict=True):
        style, _ = _STYLES[model]
        marks += [rig_fit.bars(angle, own, error, f"{style} thin"), _dots(angle, own, style)]
    return chart(f"{words}, difference in percent", across, scale, marks, height=190), left_out


def _dots(x: Array, y: Array, style: str, label: str = "") -> Points:
    """Points small enough to let their bars be seen."""
    return Points(x, y, np.full(x.size, np.nan), f"{style} tiny", label)


def _aspecular(cells: xr.Dataset) -> Array:
    """Angle from the mirror direction [degree], negative away from the normal."""
    towards = np.cos(np.radians(cells["phi_s"].values)) >= 0
    return np.where(towards, cells["theta_s"].values, -cells["theta_s"].values)


def _shown(values: Array) -> Array:
    return np.where(values > 0, values, np.nan)


def _ends(angle: Array) -> tuple[float, float]:
    return float(10 * np.floor(min(angle.min(), -1.0) / 10)), float(10 * np.ceil(max(angle.max(), 1.0) / 10))


def _decades(values: Array) -> Axis:
    """A logarithmic axis that shows some values, the largest of them at least."""
    if not values.size:
        return Axis("BRDF, sr⁻¹ (log)", 1e-3, 1.0, log=True)
    high = int(np.ceil(np.log10(values.max()) + 1e-9))
    low = max(int(np.floor(np.log10(values.min()))), high - _MOST_DECADES)
    return Axis("BRDF, sr⁻¹ (log)", 10.0**low, 10.0 ** max(high, low + 1), log=True)


def _ratios(comparison: xr.Dataset) -> Figure:
    """Share of the values by the ratio of measured to modelled."""
    edges = np.geomspace(*_RATIOS, _BINS + 1)
    marks: list[Mark] = []
    for model in map(str, comparison["model"].values):
        ratio = comparison["ratio"].sel(model=model).values.ravel()
        ratio = ratio[np.isfinite(ratio)]
        share = 100 * np.histogram(np.clip(ratio, *_RATIOS), edges)[0] / max(ratio.size, 1)
        style, pattern = _STYLES[model]
        marks.append(Line(np.repeat(edges, 2)[1:-1], np.repeat(share, 2), style, f"measured / {model}", pattern))
    top = max(float(np.max(np.asarray(mark.y))) for mark in marks if isinstance(mark, Line))
    svg = chart(
        "Histogram of the ratio of measured to modelled BRDF",
        Axis("measured / model (log)", *_RATIOS, log=True, at=(0.5, 0.7, 1.0, 1.4, 2.0)),
        Axis("values, %", 0.0, 1.05 * top if top > 0 else 1.0),
        marks,
        height=260,
    )
    count = f"{comparison.attrs['values']} values at {comparison.sizes['incidence']} incidences and {comparison.sizes['wavelength']} wavelengths"
    return Figure(
        "Measured over modelled BRDF",
        svg,
        legend(marks),
        f"{count}; values beyond the ends are counted in the last classes.",
    )

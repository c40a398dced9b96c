"""Section of the page on the comparison of the measured with the predicted BRDF."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.comparison import findings
from brdfpipe.comparison.findings import NAMES, plus_minus
from brdfpipe.report.cards import Chapter, Table
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Pattern, Points, chart, legend
from brdfpipe.report.rig import fit as rig_fit

_NEAR_PLANE = 12.0
"""Azimuth from the plane of incidence up to which a cell is shown in it [degree]."""

_MOST_DECADES = 6
_RATIOS = 0.5, 2.0
_CLASSES = 60

_STYLES: dict[str, tuple[str, Pattern]] = {"predicted": ("c1", "dash"), "adjusted": ("c2", "line")}
"""Colour and pattern of each model."""


def chapter(comparison: xr.Dataset | None) -> Chapter | None:
    """The comparison section; None without a dataset of kind ``comparison``."""
    if comparison is None:
        return None
    sentences = [f"{text[:1].upper()}{text[1:]}." for text in findings.sentences(comparison)]
    *inputs, agreement = tables(comparison)
    parts: list[Figure | Table] = [*inputs, *figures(comparison), agreement]
    warnings = vocabulary.warnings(comparison)
    return Chapter("Measured and predicted", "comparison", "the comparison", warnings, parts, findings=sentences)


def tables(comparison: xr.Dataset) -> list[Table]:
    """The inputs before and after the fit, if there was one, and the agreement at each incidence."""
    agreement = _agreement_table(comparison)
    if "posterior" not in comparison:
        return [agreement]
    rows = [_input_row(name, comparison.sel(input=name)) for name in map(str, comparison["input"].values)]
    enlarged = float(comparison.attrs["enlarged"])
    note = "± standard uncertainty; u of a factor is relative."
    if enlarged > 1.05:
        note += f" The uncertainties were enlarged {number(enlarged, 2)} times: the values scatter more than stated."
    header = ("Input", "Before", "After", "Change / u before")
    return [*([Table("Inputs of the prediction", header, rows, note)] if rows else []), agreement]


def figures(comparison: xr.Dataset) -> list[Figure]:
    """Histogram of measured over modelled values; then both in the plane of incidence, one chart for each incidence."""
    cuts = (_cut(comparison.isel(incidence=at)) for at in range(comparison.sizes["incidence"]))
    return [_ratio_histogram(comparison), *(figure for figure in cuts if figure is not None)]


def _input_row(name: str, one: xr.Dataset) -> tuple[str, ...]:
    before, before_u, after, after_u = (float(one[name]) for name in ("prior", "prior_u", "posterior", "posterior_u"))
    title = "refractive index, shift" if name == "index" else NAMES[name]
    sign = "+" if name == "index" else ""
    return (
        title[:1].upper() + title[1:],
        plus_minus(before, before_u, sign),
        plus_minus(after, after_u, sign),
        fixed((after - before) / before_u, 2),
    )


def _agreement_table(comparison: xr.Dataset) -> Table:
    reference = _at_reference(comparison)
    rows = [
        _agreement_row(reference.isel(incidence=at, model=model))
        for at in range(reference.sizes["incidence"])
        for model in range(reference.sizes["model"])
    ]
    header = ("Incidence", "Model", "Measured / model", "rms z", "Reflectance into the cells, measured", "of the model")
    note = (
        "Median of the ratio and rms of the difference over its uncertainty: all values. Reflectance: into the directions of the cells, "
        f"{bsdf_sections.wavelength_words(comparison)}."
    )
    return Table("Agreement at each incidence", header, rows, note)


def _at_reference(comparison: xr.Dataset) -> xr.Dataset:
    wavelength = bsdf_sections.reference(comparison)
    assert wavelength is not None
    return comparison.sel(wavelength=wavelength[0])


def _agreement_row(one: xr.Dataset) -> tuple[str, ...]:
    return (
        f"{float(one['incidence']):g}°",
        str(one["model"].values),
        fixed(float(one["median_ratio"]), 3),
        fixed(float(one["rms_z"]), 2),
        plus_minus(float(one["seen_reflectance"]), float(one["seen_reflectance_u"])),
        number(float(one["seen_reflectance_model"]), 4),
    )


def _cut(comparison: xr.Dataset) -> Figure | None:
    """The cells near the plane of incidence, at one incidence and wavelength; None where there are none."""
    one = _at_reference(comparison)
    turn = (one["phi_s"].values + 90) % 180 - 90
    near = np.flatnonzero((np.abs(turn) < _NEAR_PLANE) & np.isfinite(one["brdf"].values))
    if not near.size:
        return None
    one = one.isel(cell=near[np.argsort(_aspecular(one.isel(cell=near)), kind="stable")])
    angle, value, u = _aspecular(one), one["brdf"].values, one["brdf_u"].values
    models, modelled = list(map(str, one["model"].values)), one["brdf_model"].values
    marks: list[Mark] = [
        Line(angle, _positive(values), _STYLES[model][0], model, _STYLES[model][1])
        for model, values in zip(models, modelled, strict=True)
    ]
    marks += [rig_fit.bars(angle, value, u, "c0 thin"), _dots(angle, _positive(value), "c0", "measured ± u")]
    # A bar that reaches 0 has no lower end on a log axis; the upper ends are all shown.
    shown = np.concatenate([value, value + np.nan_to_num(u), modelled.ravel()])
    title = f"Measured and predicted at {float(one['incidence']):g}°"
    low, high = 10 * math.floor(min(angle.min(), -1.0) / 10), 10 * math.ceil(max(angle.max(), 1.0) / 10)
    across = Axis("angle from the mirror direction, °; positive towards the normal", low, high)
    description = f"{title} of incidence: BRDF against the angle from the mirror direction"
    svg = chart(f"{description}, logarithmic", across, _log_axis(shown[shown > 0]), marks)
    ratio, ratio_u = 100 * (value / _positive(modelled) - 1), 100 * u / _positive(modelled)
    scale, note_of_outside = rig_fit.axis_about_zero("measured over model less 1, %", ratio.ravel(), ratio_u.ravel())
    differences: list[Mark] = [Line([across.low, across.high], [0.0, 0.0], "ref")]
    for model, own, error in zip(models, ratio, ratio_u, strict=True):
        style = _STYLES[model][0]
        differences += [rig_fit.bars(angle, own, error, f"{style} thin"), _dots(angle, own, style)]
    svg += chart(f"{description}, difference in percent", across, scale, differences, height=190)
    note = (
        f"Cells within {_NEAR_PLANE:g}° of azimuth from the plane of incidence, {bsdf_sections.wavelength_words(comparison)}; models are "
        "drawn through their values at the same cells. Below: measured over model less 1, in the colour of the model; bars: "
        f"±\u202f1 standard uncertainty of the measurement.{note_of_outside}"
    )
    return Figure(title, svg, legend(marks), note)


def _dots(x: Array, y: Array, style: str, label: str = "") -> Points:
    """Points small enough to show their bars."""
    return Points(x, y, style=f"{style} tiny", label=label)


def _aspecular(cells: xr.Dataset) -> Array:
    """Angle from the mirror direction [degree], negative away from the normal."""
    towards = np.cos(np.radians(cells["phi_s"].values)) >= 0
    return np.where(towards, cells["theta_s"].values, -cells["theta_s"].values)


def _positive(values: Array) -> Array:
    return np.where(values > 0, values, np.nan)


def _log_axis(values: Array) -> Axis:
    """A logarithmic axis for positive values; the largest is always on it."""
    low, high = 1e-3, 1.0
    if values.size:
        last = int(np.ceil(np.log10(values.max()) + 1e-9))
        first = max(int(np.floor(np.log10(values.min()))), last - _MOST_DECADES)
        low, high = 10.0**first, 10.0 ** max(last, first + 1)
    return Axis("BRDF, sr⁻¹ (log)", low, high, log=True)


def _ratio_histogram(comparison: xr.Dataset) -> Figure:
    """Histogram of the ratio of measured to modelled values."""
    edges = np.geomspace(*_RATIOS, _CLASSES + 1)
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
        Axis("measured / model (log)", *_RATIOS, log=True, tick_values=(0.5, 0.7, 1.0, 1.4, 2.0)),
        Axis("values, %", 0.0, 1.05 * top if top > 0 else 1.0),
        marks,
        height=260,
    )
    note = (
        f"{comparison.attrs['values']} values at {comparison.sizes['incidence']} incidences and {comparison.sizes['wavelength']} "
        "wavelengths; values beyond the ends are counted in the last classes."
    )
    return Figure("Measured over modelled BRDF", svg, legend(marks), note)

"""Reciprocity of measured incidences: f(i → o) against f(o → i), before and after averaging them to one BSDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from markupsafe import Markup

from brdfpipe.bsdf.measured.agreement import pair_differences, uncertainty_enlargement
from brdfpipe.bsdf.measured.completion import is_isotropic
from brdfpipe.bsdf.measured.reciprocity import reciprocity
from brdfpipe.report.formatting import number
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend, nice_range

TITLE = "Reciprocity, before and after"

AZIMUTHS = 7
"""Directions shown of a pair, from φ = 0 to 180°."""

MOST_PAIRS = 8
"""Largest number of pairs shown, those that differ most."""

SIGNIFICANT = 2.0
"""Median of |f(i→o) − f(o→i)| over its uncertainty above which the note advises."""

_ENLARGED = 1.01
"""Factor of an uncertainty above which the note states it."""

_PAIR_WIDTH, _MARK_OFFSET = 0.7, 0.025
"""Width of the directions of a pair, and offset of the two marks of one direction, over the distance of two pairs."""


@dataclass(frozen=True)
class _PairAxis(Axis):
    """Pairs at 0, 1, … with their names as labels."""

    names: tuple[str, ...] = ()

    def ticks(self) -> list[tuple[float, str]]:
        return [(float(position), name) for position, name in enumerate(self.names)]


def figure(bsdf: xr.Dataset, smoothed: xr.Dataset) -> Figure:
    """Differences of f(i → o) and f(o → i) of measured incidences, and the change of each to their average in the BSDF.

    ``smoothed`` is the reflection from which the BSDF (representation ``rig``) was completed.
    """
    pairs = reciprocity(bsdf, AZIMUTHS)
    if not pairs.sizes["pair"]:
        return Figure(TITLE, note="Fewer than two incidences were measured: reciprocity cannot be tested.")
    enlarged = uncertainty_enlargement(bsdf, smoothed)
    differences = pair_differences(pairs, enlarged)
    score = np.median(np.abs(np.nan_to_num(differences["score"].values)), axis=1)
    shown = differences.isel(pair=np.sort(np.argsort(-score, kind="stable")[:MOST_PAIRS]))
    averaged = bsdf.attrs["reciprocity"] == "averaged"
    percent = {str(name): 100 * values.values for name, values in shown.data_vars.items()}
    zero = Line([-0.5, shown.sizes["pair"] - 0.5], [0.0, 0.0], "ref")
    before = [zero, *_points(percent["difference"], percent["difference_u"], 0.0, "c0", "before: f(i→o) / f(o→i)")]
    after = [
        zero,
        *_points(percent["change_of_forward"], percent["change_u"], -_MARK_OFFSET, "c2", "after: BSDF / f(i→o)"),
        *_points(percent["change_of_backward"], percent["change_u"], _MARK_OFFSET, "c4", "after: BSDF / f(o→i)"),
    ]
    drawn = [(percent["difference"], percent["difference_u"])]
    drawn += [(percent[name], percent["change_u"]) for name in ("change_of_forward", "change_of_backward") if averaged]
    low_high = _axis_range(*(np.concatenate(part) for part in zip(*drawn, strict=True)))
    svg = _chart("the two directions of light", "f(i→o) / f(o→i) − 1, %", shown, before, low_high)
    if averaged:
        svg += _chart("averaged BSDF over each direction", "averaged / measured − 1, %", shown, after, low_high)
    key = legend([*before, *(after if averaged else [])])
    isotropic = is_isotropic(bsdf)
    note = _note(differences, score, shown.sizes["pair"], averaged=averaged, isotropic=isotropic)
    return Figure(TITLE, svg, key, note + _enlargement_note(enlarged))


def _enlargement_note(enlarged: dict[float, float]) -> str:
    large = [f"{number(factor, 2)} times at {angle:g}°" for angle, factor in enlarged.items() if factor > _ENLARGED]
    return f" The uncertainty of the BSDF (bars after) was therefore enlarged {', '.join(large)}." if large else ""


def _points(values: Array, u: Array, offset: float, style: str, label: str) -> list[Mark]:
    """Directions of each pair, φ = 0 on the left, with bars, joined by a thin line."""
    count, directions = values.shape
    x = np.arange(count)[:, None] + offset + np.linspace(-_PAIR_WIDTH / 2, _PAIR_WIDTH / 2, directions)
    gap = np.full((count, 1), np.nan)
    line_x, line_y = (np.concatenate([part, gap], axis=1).ravel() for part in (x, values))
    return [
        Line(line_x, line_y, f"{style} thin"),
        Points(x.ravel(), values.ravel(), u.ravel(), f"{style} small", label),
    ]


def _axis_range(values: Array, u: Array) -> tuple[float, float]:
    """Range of an axis for values with their bars."""
    ends = np.concatenate([(values - u).ravel(), (values + u).ravel(), [0.0]])
    ends = ends[np.isfinite(ends)]
    return nice_range(float(ends.min()), float(ends.max()), margin=0.08)


def _pair_names(pairs: xr.Dataset) -> tuple[str, ...]:
    """``10°–60°``"""
    incidences = zip(pairs["incidence"].values.tolist(), pairs["incidence_2"].values.tolist(), strict=True)
    return tuple(f"{first:g}°–{second:g}°" for first, second in incidences)


def _chart(words: str, label: str, pairs: xr.Dataset, marks: list[Mark], low_high: tuple[float, float]) -> Markup:
    names = _pair_names(pairs)
    x = _PairAxis("pair of incidences; within one, from φ = 0 to 180°", -0.5, len(names) - 0.5, names=names)
    return chart(
        f"Reciprocity: {words}, by pair of incidences, in percent", x, Axis(label, *low_high), marks, height=200
    )


def _note(differences: xr.Dataset, pair_score: Array, shown: int, *, averaged: bool, isotropic: bool) -> str:
    rms, pairs = number(float(np.sqrt((differences["score"] ** 2).mean())), 2), differences.sizes["pair"]
    count = f"The {shown} of {pairs} pairs that differ most. " if shown < pairs else ""
    note = (
        f"{count}By reciprocity, the BRDF from one measured incidence to another equals the BRDF back. Medians over wavelength; bars: "
        f"±\u202f1 standard uncertainty. They include errors common to both directions, which cancel in the difference. Before: the difference over "
        f"its uncertainty has an rms of {rms}; up to about 1 the two agree. "
    )
    if not isotropic:
        return f"{note}For a surface with a lay they need not be equal. The BSDF keeps each direction as measured; there is no average."
    note += (
        "After: change of each to the averaged BSDF, larger for the less certain one. "
        if averaged
        else "The BSDF keeps each direction as measured; there is no average. "
    )
    significant = [name for name, z in zip(_pair_names(differences), pair_score, strict=True) if z > SIGNIFICANT]
    if not significant:
        return f"{note}No pair differs significantly."
    return (
        f"{note}Different by more than {SIGNIFICANT:g} standard uncertainties: {', '.join(significant)}. If one incidence is in all of "
        "them, scan it again, with the angular target first (`runs` in plan.yaml). If all pairs differ, calibrate again. Or the sample "
        "has a lay (`rig.smoothing.isotropic: false` in material.yaml), or is not uniform over the illuminated areas."
    )

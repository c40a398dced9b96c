"""Reciprocity of measured incidences: f(i → o) against f(o → i), before and after averaging them to one BSDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.reciprocity import reciprocity
from brdfpipe.report.formatting import MISSING, number
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend, nice_range

TITLE = "Reciprocity, before and after"

AZIMUTHS = 7
"""Directions shown of a pair, from φ = 0 to 180°."""

MOST_PAIRS = 8
"""Largest number of pairs shown, those that differ most."""

SIGNIFICANT = 2.0
"""Median of |there − back| over its uncertainty above which the note advises."""

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


@dataclass(frozen=True)
class _PairStatistics:
    """Statistics of pairs of incidences, medians over wavelength, (pair, direction)."""

    names: tuple[str, ...]
    """``10°–60°``"""
    difference: Array
    """There over back, less 1 [%]."""
    difference_u: Array
    change: tuple[Array, Array]
    """The BSDF over f there, and over f back, less 1 [%]."""
    change_u: Array
    score: Array
    """There less back, over its uncertainty."""

    def select(self, pairs: NDArray[np.int64]) -> _PairStatistics:
        names, (there, back) = tuple(self.names[at] for at in pairs), self.change
        difference, difference_u, change_u, score = (
            values[pairs] for values in (self.difference, self.difference_u, self.change_u, self.score)
        )
        return _PairStatistics(names, difference, difference_u, (there[pairs], back[pairs]), change_u, score)


def figure(bsdf: xr.Dataset, smoothed: xr.Dataset) -> Figure:
    """Differences of f(i → o) and f(o → i) of measured incidences, and the change of each to their average in the BSDF.

    ``smoothed`` is the reflection from which the BSDF (representation ``rig``) was completed.
    """
    pairs = reciprocity(bsdf, AZIMUTHS)
    if not pairs.sizes["pair"]:
        return Figure(TITLE, note="Fewer than two incidences were measured: reciprocity cannot be tested.")
    enlarged = _enlargement(bsdf, smoothed)
    all_pairs = _pair_statistics(_with_own_uncertainty(pairs, enlarged))
    score = np.median(np.abs(np.nan_to_num(all_pairs.score)), axis=1)
    shown = all_pairs.select(np.sort(np.argsort(-score, kind="stable")[:MOST_PAIRS]))
    averaged = bsdf.attrs["reciprocity"] == "averaged"
    zero = Line([-0.5, len(shown.names) - 0.5], [0.0, 0.0], "ref")
    before = [zero, *_points(shown.difference, shown.difference_u, 0.0, "c0", "before: there over back")]
    after = [
        zero,
        *_points(shown.change[0], shown.change_u, -_MARK_OFFSET, "c2", "after: the BSDF over there"),
        *_points(shown.change[1], shown.change_u, _MARK_OFFSET, "c4", "after: the BSDF over back"),
    ]
    drawn = [(shown.difference, shown.difference_u)]
    drawn += [(change, shown.change_u) for change in shown.change if averaged]
    low_high = _axis_range(*(np.concatenate(part) for part in zip(*drawn, strict=True)))
    svg = _chart("light there over light back", "there over back less 1, %", shown, before, low_high)
    if averaged:
        svg += _chart("averaged BSDF over each direction", "averaged / measured − 1, %", shown, after, low_high)
    key = legend([*before, *(after if averaged else [])])
    symmetric = bases.from_json(bsdf.attrs["basis"]).symmetric
    note = _note(all_pairs, score, len(shown.names), averaged=averaged, symmetric=symmetric)
    return Figure(TITLE, svg, key, note + _enlargement_note(enlarged))


def _enlargement(bsdf: xr.Dataset, smoothed: xr.Dataset) -> dict[float, float]:
    """Factor by which the completion enlarged the uncertainty of each measured incidence, as it contradicts the others."""
    nodes = bsdf.isel(node=bsdf["transmitted"].values == 0)
    factors = {}
    for node, incidence in enumerate(nodes["incidence"].values.tolist()):
        for own in smoothed["coefficient_factor"].values[smoothed["incidence"].values == incidence]:
            known = np.isfinite(own).all(axis=(1, 2))
            norms = [np.linalg.norm(part[known]) for part in (nodes["coefficient_factor"].values[node], own)]
            # The entrance, which hides cells at normal incidence, makes the ratio smaller than 1.
            factors[incidence] = max(float(norms[0] / norms[1]), 1.0) if known.any() else 1.0
    return factors


def _with_own_uncertainty(pairs: xr.Dataset, enlarged: dict[float, float]) -> xr.Dataset:
    """Pairs with the uncertainties of their incidences before the enlargement."""
    ends = {"there_u": "incidence", "back_u": "incidence_2"}
    factors = {name: [enlarged.get(angle, 1.0) for angle in pairs[end].values.tolist()] for name, end in ends.items()}
    return pairs.assign({name: pairs[name] / xr.DataArray(factor, dims="pair") for name, factor in factors.items()})


def _enlargement_note(enlarged: dict[float, float]) -> str:
    large = [f"{number(factor, 2)} times at {angle:g}°" for angle, factor in enlarged.items() if factor > _ENLARGED]
    return f" The uncertainty of the BSDF (bars after) was therefore enlarged {', '.join(large)}." if large else ""


def _pair_statistics(pairs: xr.Dataset) -> _PairStatistics:
    spectral = str(pairs["there"].dims[2])
    there, back, both = (pairs[name].where(pairs[name] > 0) for name in ("there", "back", "both"))
    there_u, back_u = pairs["there_u"] / there, pairs["back_u"] / back
    difference_u = there_u.copy(data=np.hypot(there_u.values, back_u.values))
    score = (there - back) / np.hypot(pairs["there_u"], pairs["back_u"])
    names = zip(pairs["incidence"].values.tolist(), pairs["incidence_2"].values.tolist(), strict=True)

    def median(values: xr.DataArray) -> Array:
        return np.asarray(values.median(spectral).values, dtype=float)

    return _PairStatistics(
        tuple(f"{first:g}°–{second:g}°" for first, second in names),
        median(100 * (there / back - 1)),
        median(100 * difference_u),
        (median(100 * (both / there - 1)), median(100 * (both / back - 1))),
        median(100 * pairs["both_u"] / both),
        median(score),
    )


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


def _chart(
    words: str, label: str, statistics: _PairStatistics, marks: list[Mark], low_high: tuple[float, float]
) -> Markup:
    x = _PairAxis(
        "pair of incidences; within one, from φ = 0 to 180°", -0.5, len(statistics.names) - 0.5, names=statistics.names
    )
    return chart(
        f"Reciprocity: {words}, by pair of incidences, in percent", x, Axis(label, *low_high), marks, height=200
    )


def _note(statistics: _PairStatistics, pair_score: Array, shown: int, *, averaged: bool, symmetric: bool) -> str:
    score, pairs = statistics.score[np.isfinite(statistics.score)], len(statistics.names)
    rms = number(float(np.sqrt(np.mean(score**2))), 2) if score.size else MISSING
    count = f"The {shown} of {pairs} pairs that differ most. " if shown < pairs else ""
    note = (
        f"{count}By reciprocity, the BRDF from one measured incidence to another equals the BRDF back. Medians over wavelength; bars: "
        f"±\u202f1 standard uncertainty, including errors common to both, which cancel in the difference. Before: the difference over "
        f"its uncertainty has an rms of {rms}; up to about 1 the two agree. "
    )
    if not symmetric:
        return f"{note}For a surface with a lay they need not be equal. The BSDF keeps each direction as measured; there is no average."
    note += (
        "After: change of each to the averaged BSDF, larger for the less certain one. "
        if averaged
        else "The BSDF keeps each direction as measured; there is no average. "
    )
    significant = [name for name, value in zip(statistics.names, pair_score, strict=True) if value > SIGNIFICANT]
    if not significant:
        return f"{note}No pair differs significantly."
    return (
        f"{note}Different by more than {SIGNIFICANT:g} standard uncertainties: {', '.join(significant)}. If one incidence is in all of "
        "them, scan it again, with the angular target first (`runs` in plan.yaml). If all pairs differ, calibrate again. Or the sample "
        "has a lay (`rig.smoothing.symmetric: false` in material.yaml), or is not uniform over the illuminated areas."
    )

"""Reciprocity of measured incidences: f(i → o) against f(o → i), before and after both are averaged to one BSDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured.reciprocity import reciprocity
from brdfpipe.report.formatting import MISSING, number
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, Mark, Points, chart, legend, nice_range, sentence

TITLE = "Reciprocity, before and after"

AZIMUTHS = 7
"""Directions shown of a pair, from φ = 0 to 180°."""

MOST_PAIRS = 8
"""Pairs shown; of more, those that differ most."""

OFF = 2.0
"""Median of |there − back| over its uncertainty, of a pair, beyond which advice is given."""

_GROWN = 1.01
"""Times an uncertainty was enlarged that is no rounding."""

_ROOM = 0.7
"""Share of a pair's room on the axis that its directions take."""
_APART = 0.025
"""By which the two marks of one direction stand aside, of a pair's room."""


@dataclass(frozen=True)
class _Pairs(Axis):
    """One room a pair, by name."""

    names: tuple[str, ...] = ()

    def ticks(self) -> list[tuple[float, str]]:
        return [(float(place), name) for place, name in enumerate(self.names)]


@dataclass(frozen=True)
class _PairStatistics:
    """What is known of pairs of incidences, medians over wavelength, (pair, direction)."""

    names: tuple[str, ...]
    """``10°–60°``"""
    apart: Array
    """There over back, less 1 [%]."""
    apart_u: Array
    moved: tuple[Array, Array]
    """The BSDF over f there, and over f back, less 1 [%]."""
    moved_u: Array
    score: Array
    """There less back over its uncertainty."""

    def taken(self, pairs: NDArray[np.int64]) -> _PairStatistics:
        names = tuple(self.names[at] for at in pairs)
        there, back = (way[pairs] for way in self.moved)
        return _PairStatistics(
            names, self.apart[pairs], self.apart_u[pairs], (there, back), self.moved_u[pairs], self.score[pairs]
        )


def figure(bsdf: xr.Dataset, smoothed: xr.Dataset) -> Figure:
    """By how much f(i → o) and f(o → i) of measured incidences differ, and how far each had to move to the BSDF, which is one.

    Parameters
    ----------
    bsdf : representation ``rig``
    smoothed : kind ``smoothed``, of reflection, that it was completed from
    """
    pairs = reciprocity(bsdf, AZIMUTHS)
    if not pairs.sizes["pair"]:
        return sentence(TITLE, "Fewer than two incidences were measured: reciprocity cannot be tested.")
    enlarged = _enlarged(bsdf, smoothed)
    all_pairs = _pair_statistics(_as_smoothed(pairs, enlarged))
    worst = np.median(np.abs(np.nan_to_num(all_pairs.score)), axis=1)
    largest = all_pairs.taken(np.sort(np.argsort(-worst, kind="stable")[:MOST_PAIRS]))
    averaged = bsdf.attrs["reciprocity"] == "averaged"
    before = [_zero(largest), *_points(largest.apart, largest.apart_u, 0.0, "c0", "before: there over back")]
    after = [
        _zero(largest),
        *_points(largest.moved[0], largest.moved_u, -_APART, "c2", "after: the BSDF over there"),
        *_points(largest.moved[1], largest.moved_u, _APART, "c4", "after: the BSDF over back"),
    ]
    shown = [(largest.apart, largest.apart_u), *((moved, largest.moved_u) for moved in largest.moved if averaged)]
    reach = _reach(*(np.concatenate(part) for part in zip(*shown, strict=True)))
    svg = _chart("light there over light back", "there over back less 1, %", largest, before, reach)
    if averaged:
        svg += _chart("averaged BSDF over each direction", "averaged / measured − 1, %", largest, after, reach)
    key = legend([*before, *(after if averaged else [])])
    symmetric = bases.from_json(bsdf.attrs["basis"]).symmetric
    return Figure(
        TITLE,
        svg,
        key,
        _words(all_pairs, worst, len(largest.names), averaged=averaged, symmetric=symmetric)
        + _enlarged_words(enlarged),
    )


def _enlarged(bsdf: xr.Dataset, smoothed: xr.Dataset) -> dict[float, float]:
    """By measured incidence, how many times the completion enlarged its uncertainty as it contradicts the others."""
    nodes = bsdf.isel(node=bsdf["transmitted"].values == 0)
    factors = {}
    for node, incidence in enumerate(nodes["incidence"].values.tolist()):
        for own in smoothed["coefficient_factor"].values[smoothed["incidence"].values == incidence]:
            known = np.isfinite(own).all(axis=(1, 2))
            spread = [np.linalg.norm(part[known]) for part in (nodes["coefficient_factor"].values[node], own)]
            # What the entrance hides at normal incidence makes it less.
            factors[incidence] = max(float(spread[0] / spread[1]), 1.0) if known.any() else 1.0
    return factors


def _as_smoothed(pairs: xr.Dataset, enlarged: dict[float, float]) -> xr.Dataset:
    """Pairs of which each way has the uncertainty that its incidence had before others contradicted it."""
    ends = {"there_u": "incidence", "back_u": "incidence_2"}
    factors = {
        name: [enlarged.get(incidence, 1.0) for incidence in pairs[end].values.tolist()] for name, end in ends.items()
    }
    return pairs.assign({name: pairs[name] / xr.DataArray(factor, dims="pair") for name, factor in factors.items()})


def _enlarged_words(enlarged: dict[float, float]) -> str:
    grown = [
        f"{number(factor, 2)} times at {incidence:g}°" for incidence, factor in enlarged.items() if factor > _GROWN
    ]
    if not grown:
        return ""
    return f" The uncertainty of the BSDF (bars after) was therefore enlarged {', '.join(grown)}."


def _pair_statistics(pairs: xr.Dataset) -> _PairStatistics:
    spectral = str(pairs["there"].dims[2])
    there, back, both = (pairs[name].where(pairs[name] > 0) for name in ("there", "back", "both"))
    there_u, back_u = pairs["there_u"] / there, pairs["back_u"] / back
    apart_u = there_u.copy(data=np.hypot(there_u.values, back_u.values))
    score = (there - back) / np.hypot(pairs["there_u"], pairs["back_u"])
    names = zip(pairs["incidence"].values.tolist(), pairs["incidence_2"].values.tolist(), strict=True)

    def median(values: xr.DataArray) -> Array:
        return np.asarray(values.median(spectral).values, dtype=float)

    return _PairStatistics(
        tuple(f"{first:g}°–{second:g}°" for first, second in names),
        median(100 * (there / back - 1)),
        median(100 * apart_u),
        (median(100 * (both / there - 1)), median(100 * (both / back - 1))),
        median(100 * pairs["both_u"] / both),
        median(score),
    )


def _zero(statistics: _PairStatistics) -> Line:
    return Line([-0.5, len(statistics.names) - 0.5], [0.0, 0.0], "ref")


def _points(values: Array, u: Array, aside: float, style: str, label: str) -> list[Mark]:
    """Directions of each pair, φ = 0 on the left, joined by a thin line, with their bars."""
    count, directions = values.shape
    x = np.arange(count)[:, None] + aside + np.linspace(-_ROOM / 2, _ROOM / 2, directions)
    gap = np.full((count, 1), np.nan)
    joined = Line(
        np.concatenate([x, gap], axis=1).ravel(), np.concatenate([values, gap], axis=1).ravel(), f"{style} thin"
    )
    return [joined, Points(x.ravel(), values.ravel(), u.ravel(), f"{style} small", label)]


def _reach(values: Array, u: Array) -> tuple[float, float]:
    """Of an axis that holds values with their bars."""
    ends = np.concatenate([(values - u).ravel(), (values + u).ravel(), [0.0]])
    ends = ends[np.isfinite(ends)]
    return nice_range(float(ends.min()), float(ends.max()), margin=0.08)


def _chart(
    words: str, label: str, statistics: _PairStatistics, marks: list[Mark], reach: tuple[float, float]
) -> Markup:
    x = _Pairs(
        "pair of incidences; within one, from φ = 0 to 180°", -0.5, len(statistics.names) - 0.5, names=statistics.names
    )
    return chart(f"Reciprocity: {words}, by pair of incidences, in percent", x, Axis(label, *reach), marks, height=200)


def _words(all_pairs: _PairStatistics, worst: Array, shown: int, *, averaged: bool, symmetric: bool) -> str:
    score = all_pairs.score[np.isfinite(all_pairs.score)]
    rms = number(float(np.sqrt(np.mean(score**2))), 2) if score.size else MISSING
    count = f"The {shown} of {len(all_pairs.names)} pairs that differ most. " if shown < len(all_pairs.names) else ""
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
    off = [name for name, score_of_pair in zip(all_pairs.names, worst, strict=True) if score_of_pair > OFF]
    if not off:
        return f"{note}No pair differs significantly."
    return (
        f"{note}Different by more than {OFF:g} standard uncertainties: {', '.join(off)}. If one incidence is in all of them, scan it again, with the "
        "angular target first (`runs` in plan.yaml). If all pairs differ, calibrate again. Or the sample has a lay "
        "(`rig.smoothing.symmetric: false` in material.yaml), or is not uniform over the illuminated areas."
    )

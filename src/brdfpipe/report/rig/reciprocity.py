"""The figure of reciprocity: what light tells on its way there and back, before both are averaged to one BSDF and after."""

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
class _Told:
    """What is known of pairs of incidences, medians over wavelength, (pair, direction)."""

    names: tuple[str, ...]
    """``10°–60°``"""
    apart: Array
    """There over back, less 1 [%]."""
    apart_u: Array
    moved: tuple[Array, Array]
    """The BSDF over what was told there, and over what was told back, less 1 [%]."""
    moved_u: Array
    score: Array
    """There less back over its uncertainty."""

    def taken(self, pairs: NDArray[np.int64]) -> _Told:
        names = tuple(self.names[at] for at in pairs)
        there, back = (each[pairs] for each in self.moved)
        return _Told(
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
        return sentence(TITLE, "Fewer than two incidences were measured: no light goes there and back between them.")
    enlarged = _enlarged(bsdf, smoothed)
    every = _told(_as_smoothed(pairs, enlarged))
    worst = np.median(np.abs(np.nan_to_num(every.score)), axis=1)
    told = every.taken(np.sort(np.argsort(-worst, kind="stable")[:MOST_PAIRS]))
    averaged = bsdf.attrs["reciprocity"] == "averaged"
    before = [_zero(told), *_points(told.apart, told.apart_u, 0.0, "c0", "before: there over back")]
    after = [
        _zero(told),
        *_points(told.moved[0], told.moved_u, -_APART, "c2", "after: the BSDF over there"),
        *_points(told.moved[1], told.moved_u, _APART, "c4", "after: the BSDF over back"),
    ]
    shown = [(told.apart, told.apart_u), *((moved, told.moved_u) for moved in told.moved if averaged)]
    reach = _reach(*(np.concatenate(each) for each in zip(*shown, strict=True)))
    svg = _chart("light there over light back", "there over back less 1, %", told, before, reach)
    if averaged:
        svg += _chart("the BSDF over light there and over light back", "BSDF over either less 1, %", told, after, reach)
    key = legend([*before, *(after if averaged else [])])
    symmetric = bases.from_json(bsdf.attrs["basis"]).symmetric
    return Figure(
        TITLE,
        svg,
        key,
        _words(every, worst, len(told.names), averaged=averaged, symmetric=symmetric) + _enlarged_words(enlarged),
    )


def _enlarged(bsdf: xr.Dataset, smoothed: xr.Dataset) -> dict[float, float]:
    """By measured incidence, how many times the completion enlarged its uncertainty as it contradicts the others."""
    nodes = bsdf.isel(node=bsdf["transmitted"].values == 0)
    found = {}
    for node, incidence in enumerate(nodes["incidence"].values.tolist()):
        for own in smoothed["coefficient_factor"].values[smoothed["incidence"].values == incidence]:
            told = np.isfinite(own).all(axis=(1, 2))
            spread = [np.linalg.norm(each[told]) for each in (nodes["coefficient_factor"].values[node], own)]
            # What the entrance hides at normal incidence makes it less.
            found[incidence] = max(float(spread[0] / spread[1]), 1.0) if told.any() else 1.0
    return found


def _as_smoothed(pairs: xr.Dataset, enlarged: dict[float, float]) -> xr.Dataset:
    """Pairs of which each way has the uncertainty that its incidence had before others contradicted it."""
    ends = {"there_u": "incidence", "back_u": "incidence_2"}
    factors = {name: [enlarged.get(each, 1.0) for each in pairs[end].values.tolist()] for name, end in ends.items()}
    return pairs.assign({name: pairs[name] / xr.DataArray(each, dims="pair") for name, each in factors.items()})


def _enlarged_words(enlarged: dict[float, float]) -> str:
    grown = [
        f"{number(factor, 2)} times at {incidence:g}°" for incidence, factor in enlarged.items() if factor > _GROWN
    ]
    if not grown:
        return ""
    return f" For that the BSDF's own uncertainty, of which are the bars after, was enlarged {', '.join(grown)}."


def _told(pairs: xr.Dataset) -> _Told:
    spectral = str(pairs["there"].dims[2])
    there, back, both = (pairs[name].where(pairs[name] > 0) for name in ("there", "back", "both"))
    there_u, back_u = pairs["there_u"] / there, pairs["back_u"] / back
    apart_u = there_u.copy(data=np.hypot(there_u.values, back_u.values))
    score = (there - back) / np.hypot(pairs["there_u"], pairs["back_u"])
    names = zip(pairs["incidence"].values.tolist(), pairs["incidence_2"].values.tolist(), strict=True)

    def median(values: xr.DataArray) -> Array:
        return np.asarray(values.median(spectral).values, dtype=float)

    return _Told(
        tuple(f"{first:g}°–{second:g}°" for first, second in names),
        median(100 * (there / back - 1)),
        median(100 * apart_u),
        (median(100 * (both / there - 1)), median(100 * (both / back - 1))),
        median(100 * pairs["both_u"] / both),
        median(score),
    )


def _zero(told: _Told) -> Line:
    return Line([-0.5, len(told.names) - 0.5], [0.0, 0.0], "ref")


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


def _chart(words: str, label: str, told: _Told, marks: list[Mark], reach: tuple[float, float]) -> Markup:
    x = _Pairs("pair of incidences; within one, from φ = 0 to 180°", -0.5, len(told.names) - 0.5, names=told.names)
    return chart(f"Reciprocity: {words}, by pair of incidences, in percent", x, Axis(label, *reach), marks, height=200)


def _words(every: _Told, worst: Array, shown: int, *, averaged: bool, symmetric: bool) -> str:
    score = every.score[np.isfinite(every.score)]
    rms = number(float(np.sqrt(np.mean(score**2))), 2) if score.size else MISSING
    count = f"The {shown} of {len(every.names)} pairs that differ most. " if shown < len(every.names) else ""
    note = (
        f"{count}Light from one measured incidence to another and back must tell the same. Medians over wavelength; bars are ±\u202f1 standard "
        f"uncertainty, errors common to both ways included, which cancel between them. Before: there less back over its uncertainty "
        f"has an rms of {rms}; up to about 1 the two agree. "
    )
    if not symmetric:
        return f"{note}Of a surface with a lay they need not, and the BSDF takes each way as its incidence tells it: there is no after."
    note += (
        "After: by how much each moved to the one value of the BSDF, the less certain one farther. "
        if averaged
        else "The BSDF takes each way as its incidence tells it: there is no after. "
    )
    off = [name for name, each in zip(every.names, worst, strict=True) if each > OFF]
    if not off:
        return f"{note}No pair is off."
    return (
        f"{note}Off by more than {OFF:g} standard uncertainties: {', '.join(off)}. If one incidence is in all of them, scan it anew, with the "
        "angular target first (`runs` in plan.yaml); if all pairs are off, calibrate anew, or the sample has a lay "
        "(`rig.smoothing.symmetric: false` in material.yaml) or is not alike where the light falls at each incidence."
    )

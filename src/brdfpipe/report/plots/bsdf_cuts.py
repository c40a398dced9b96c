"""BRDF and BTDF in planes of incidence, as curves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.report.formatting import share_percent
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, chart, legend, polar, sentence

INCIDENCES = (0.0, 30.0, 45.0, 60.0, 75.0)
"""Angles of incidence of the cuts, degree."""

_STYLES = ("c0", "c1", "c4", "c2", "c3")

_DECADES_SHOWN = 6

_MOST_DECADES = 9

_NARROW = 0.03
"""Slope below which a lobe is a mere spike between two horizons."""


class _Cut(NamedTuple):
    incidence: float
    style: str
    theta: Array
    value: Array
    quality: NDArray[np.int8] | None
    """None of a BSDF that rests on a model."""

    def lines(self) -> list[Line]:
        """The curve, dashed where it was not measured; the label states the basis of the mirror direction."""
        label = f"{'incidence ' if self.incidence == INCIDENCES[0] else ''}{self.incidence:g}°"
        line = Line(self.theta, np.where(self.value > 0, self.value, np.nan), self.style, label)
        if self.quality is None:
            return [line]
        mirror = int(np.argmin(np.abs(self.theta - self.incidence)))
        basis, measured = vocabulary.QUALITY_FLAGS[self.quality[mirror]], measurement_coverage.known(self.quality)
        label += "" if basis == "measured" else f" ({basis})"
        labels = (label, "") if measured[mirror] else ("", label)
        return [
            replace(part, label=text)
            for part, text in zip(measurement_coverage.split(line, measured), labels, strict=True)
        ]


def cuts(bsdf: xr.Dataset) -> list[Figure]:
    """BRDF, and BTDF where light passes, in the plane of incidence; with a lay, in the planes along and across it.

    A goniometric plot comes first where one plane says all. A sentence stands in for what has no density.
    """
    passes, planes = representation(bsdf).transmits, bsdf_sections.planes(bsdf)
    mirrored, straight = bsdf_sections.specular(bsdf, np.array(INCIDENCES))
    above = [_cuts(bsdf, plane, through=False) for plane in planes]
    below = [_cuts(bsdf, plane, through=True) for plane in planes] if passes else []
    figures: list[Figure] = []
    if len(planes) == 1 and not mirrored.any() and not straight.any():
        figures += _goniometric(bsdf, above[0], below[0] if below else [])
    figures += _cartesian(bsdf, "BRDF", planes, above, mirrored)
    figures += [] if mirrored.any() else _about_mirror(bsdf, planes, above)
    return figures + (_cartesian(bsdf, "BTDF", planes, below, straight) if passes else [])


def _cuts(bsdf: xr.Dataset, plane: Plane, *, through: bool) -> list[_Cut]:
    return [_cut(bsdf, plane, *curve, through=through) for curve in zip(INCIDENCES, _STYLES, strict=True)]


def _cut(bsdf: xr.Dataset, plane: Plane, incidence: float, style: str, *, through: bool) -> _Cut:
    theta, value = bsdf_sections.cut(bsdf, plane, incidence, through=through)
    polar, turn = bsdf_sections.in_plane(theta, through=through)
    return _Cut(incidence, style, theta, value, measurement_coverage.quality(bsdf, plane, incidence, polar, turn))


def _drawn(cuts: Sequence[_Cut]) -> list[Line]:
    return [line for cut in cuts for line in cut.lines()]


def _basis_words(bsdf: xr.Dataset, plane: Plane, cuts: Sequence[_Cut], *, through: bool = False) -> str:
    """What dashed parts of cuts mean; empty where there are none."""
    if all(cut.quality is None or measurement_coverage.known(cut.quality).all() for cut in cuts):
        return ""
    return f" Dashed: not measured.{measurement_coverage.words(bsdf, plane, INCIDENCES, through=through)}"


def _goniometric(bsdf: xr.Dataset, above: Sequence[_Cut], below: Sequence[_Cut]) -> list[Figure]:
    decades = _decades([*above, *below])
    if decades is None:
        return []
    marks = _drawn(above)
    quantity = "BSDF" if below else "BRDF"
    incidences = ", ".join(f"{angle:g}" for angle in INCIDENCES)
    svg = polar(
        f"{quantity} in the plane of incidence at {incidences} degrees of incidence, logarithmic radius",
        decades,
        marks,
        [(cut.incidence, cut.style) for cut in above],
        _drawn(below),
        quantity,
    )
    note = f"Plane of incidence, {bsdf_sections.wavelength_words(bsdf)}. Triangles mark the sources."
    note += _basis_words(bsdf, bsdf_sections.planes(bsdf)[0], above)
    return [Figure(f"{quantity}, goniometric", svg, legend(marks), note)]


def _cartesian(
    bsdf: xr.Dataset, quantity: str, planes: Sequence[Plane], cuts_by_plane: Sequence[Sequence[_Cut]], single: Array
) -> list[Figure]:
    """The cuts on Cartesian axes, one chart a plane, all to one scale.

    Parameters
    ----------
    single : (incidences,) shares of the light that smooth surfaces send into one direction, dotted
    """
    decades = _decades([cut for cuts in cuts_by_plane for cut in cuts])
    into_one = _into_one_words("mirrored" if quantity == "BRDF" else "transmitted", single)
    if decades is None:
        nothing = f"No light is {'reflected' if quantity == 'BRDF' else 'transmitted'} in these planes."
        words = (
            f"{into_one} Light in one single direction has no {quantity}; there is nothing to draw."
            if into_one
            else nothing
        )
        return [sentence(quantity, words)]
    low, high = (10.0**exponent for exponent in decades)
    figures = []
    for plane, cuts in zip(planes, cuts_by_plane, strict=True):
        curves = _drawn(cuts)
        marks = [*curves, *_rays(bsdf, quantity, single, low, high)]
        title = f"{quantity} {plane.words}" if plane.words else f"{quantity}, Cartesian"
        svg = chart(
            f"{quantity} in the plane of incidence {plane.words} against the angle of view, logarithmic",
            Axis(f"{_FROM[quantity]}, degree (positive: away from the source)", -90.0, 90.0, step=30),
            Axis(f"{quantity}, sr⁻¹", low, high, log=True),
            marks,
        )
        where = f"Plane of incidence {plane.words}".strip()
        dotted = f" Dotted: {into_one[:1].lower()}{into_one[1:]}" if into_one else ""
        note = f"{where}, {bsdf_sections.wavelength_words(bsdf)}.{dotted}{_inside(bsdf, quantity)}"
        note += _basis_words(bsdf, plane, cuts, through=quantity == "BTDF")
        figures.append(Figure(title, svg, legend(curves), note))
    return figures


def _about_mirror(bsdf: xr.Dataset, planes: Sequence[Plane], cuts_by_plane: Sequence[Sequence[_Cut]]) -> list[Figure]:
    """The lobe against the angle from the mirror direction, where it is too narrow for the other charts."""
    slope, decades = representation(bsdf).lobe_slope, _decades([cut for cuts in cuts_by_plane for cut in cuts])
    if slope is None or slope > _NARROW or decades is None:
        return []
    nearest = max(1e-3, 10.0 ** math.floor(math.log10(math.degrees(slope) / 4)))
    figures = []
    for plane, cuts in zip(planes, cuts_by_plane, strict=True):
        lines = [replace(line, x=cut.incidence - cut.theta) for cut in cuts for line in cut.lines()]
        lines = [replace(line, y=np.where(np.asarray(line.x) > 0, line.y, np.nan)) for line in lines]
        svg = chart(
            f"BRDF {plane.words} against the angle from the mirror direction, both logarithmic",
            Axis("angle from the mirror direction, degree (log)", nearest, 100.0, log=True),
            Axis("BRDF, sr⁻¹", 10.0 ** decades[0], 10.0 ** decades[1], log=True),
            lines,
        )
        title = f"BRDF about the mirror direction {plane.words}".strip()
        note = f"The same cuts, for a narrow lobe: from the mirror direction towards the normal and beyond; {bsdf_sections.wavelength_words(bsdf)}."
        note += _basis_words(bsdf, plane, cuts)
        figures.append(Figure(title, svg, legend(lines), note))
    return figures


_FROM = {"BRDF": "angle of view θₒ", "BTDF": "180° − θₒ"}


def _inside(bsdf: xr.Dataset, quantity: str) -> str:
    if quantity == "BRDF" or not representation(bsdf).is_interface:
        return ""
    return " The light is inside the body; its radiance is n² times that in air."


def _rays(bsdf: xr.Dataset, quantity: str, single: Array, low: float, high: float) -> Iterator[Line]:
    """Directions that hold a share of the light without width."""
    for incidence, style, share in zip(INCIDENCES, _STYLES, single.tolist(), strict=True):
        if share > 0:
            at = incidence if quantity == "BRDF" else float(bsdf_sections.smooth_angles(bsdf, incidence)[0])
            yield Line([at, at], [low, high], style, pattern="dots")


def _into_one_words(verb: str, single: Array) -> str:
    if not single.any():
        return ""
    shares = ", ".join(f"{share_percent(share)} at {angle:g}°" for angle, share in zip(INCIDENCES, single, strict=True))
    return f"Light {verb} into one direction by a perfectly smooth surface, {shares} incidence."


def _decades(cuts: Sequence[_Cut]) -> tuple[int, int] | None:
    """Exponents of ten between which the cuts are shown; None where there is nothing."""
    values = np.concatenate([cut.value for cut in cuts]) if cuts else np.empty(0)
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size == 0:
        return None
    high = math.ceil(math.log10(float(positive.max())) - 1e-6)
    lowest, base = (math.floor(math.log10(float(v)) + 1e-6) for v in (positive.min(), np.percentile(positive, 10)))
    low = max(lowest, high - _DECADES_SHOWN)
    # The base below a very narrow lobe must not drop out of sight.
    low = base if high - _MOST_DECADES <= base < low else low
    return min(low, high - 2), high

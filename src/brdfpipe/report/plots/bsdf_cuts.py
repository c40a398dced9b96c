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
from brdfpipe.report.formatting import SMALLEST_SHARE, share_percent
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array, Axis, Figure, Line, chart, legend, polar

INCIDENCES = (0.0, 30.0, 45.0, 60.0, 75.0)
"""Angles of incidence of the cuts, degree."""

_STYLES = ("c0", "c1", "c4", "c2", "c3")

_CARTESIAN = "{}, Cartesian"
"""Title of the chart of an isotropic BSDF, whose data the goniometric chart shows too."""

_DECADES_SHOWN = 6

_MOST_DECADES = 9

_NARROW = 0.03
"""Slope below which a lobe is only a spike in a cut from horizon to horizon."""

_WHAT_TO_SEE = {
    "BRDF": " The height of a peak over the level beside it is the gloss; the level is the diffuse light.",
    "BTDF": " The wider a peak, the more the body blurs what is behind it.",
}

_ANGLE_LABEL = {"BRDF": "angle of view θₒ", "BTDF": "180° − θₒ"}


class _Cut(NamedTuple):
    incidence: float
    style: str
    theta: Array
    value: Array
    quality: NDArray[np.int8] | None
    """None for a BSDF from a model."""

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
    """BRDF, and BTDF of a body that transmits, in the plane of incidence; with a lay, in the planes along and across it.

    A goniometric plot comes first for isotropic BSDFs. A note replaces the chart of light without a density.
    """
    transmits, planes = representation(bsdf).transmits, bsdf_sections.planes(bsdf)
    mirrored, straight = bsdf_sections.specular(bsdf, np.array(INCIDENCES))
    above, below = (
        [
            [_cut(bsdf, plane, *curve, through=through) for curve in zip(INCIDENCES, _STYLES, strict=True)]
            for plane in (planes if transmits or not through else [])
        ]
        for through in (False, True)
    )
    figures: list[Figure] = []
    if len(planes) == 1 and not mirrored.any() and not straight.any():
        figures += _goniometric(bsdf, above[0], below[0] if below else [])
    figures += _cartesian(bsdf, "BRDF", planes, above, mirrored)
    figures += [] if mirrored.any() else _about_mirror(bsdf, planes, above)
    return figures + (_cartesian(bsdf, "BTDF", planes, below, straight) if transmits else [])


def _cut(bsdf: xr.Dataset, plane: Plane, incidence: float, style: str, *, through: bool) -> _Cut:
    theta, value = bsdf_sections.cut(bsdf, plane, incidence, through=through)
    polar, turn = bsdf_sections.in_plane(theta, through=through)
    return _Cut(incidence, style, theta, value, measurement_coverage.quality(bsdf, plane, incidence, polar, turn))


def _lines(cuts: Sequence[_Cut]) -> list[Line]:
    return [line for cut in cuts for line in cut.lines()]


def _unmeasured_note(bsdf: xr.Dataset, plane: Plane, cuts: Sequence[_Cut], *, through: bool = False) -> str:
    """The meaning of dashed parts of cuts; empty where there are none."""
    if all(cut.quality is None or measurement_coverage.known(cut.quality).all() for cut in cuts):
        return ""
    return f" Dashed: not measured.{measurement_coverage.words(bsdf, plane, INCIDENCES, through=through)}"


def _goniometric(bsdf: xr.Dataset, above: Sequence[_Cut], below: Sequence[_Cut]) -> list[Figure]:
    decades = _decades([*above, *below])
    if decades is None:
        return []
    marks, quantity = _lines(above), "BSDF" if below else "BRDF"
    incidences = ", ".join(f"{angle:g}" for angle in INCIDENCES)
    svg = polar(
        f"{quantity} in the plane of incidence at {incidences} degrees of incidence, logarithmic radius",
        decades,
        marks,
        [(cut.incidence, cut.style) for cut in above],
        _lines(below),
        quantity,
        [_CARTESIAN.format(name) for name in (("BRDF", "BTDF") if below else ("BRDF",))],
    )
    note = f"Plane of incidence, {bsdf_sections.wavelength_words(bsdf)}. Triangles mark the sources. The narrower a lobe, the glossier; the round part is diffuse."
    note += _unmeasured_note(bsdf, bsdf_sections.planes(bsdf)[0], above)
    return [Figure(f"{quantity}, goniometric", svg, legend(marks), note)]


def _cartesian(
    bsdf: xr.Dataset, quantity: str, planes: Sequence[Plane], cuts_by_plane: Sequence[Sequence[_Cut]], single: Array
) -> list[Figure]:
    """The cuts on Cartesian axes, one chart for each plane, all to one scale; ``single`` (incidences,) is the share of the light that
    smooth surfaces reflect or transmit into one direction, dotted.
    """
    decades = _decades([cut for cuts in cuts_by_plane for cut in cuts])
    reflected = quantity == "BRDF"
    into_one = _into_one_words("mirrored" if reflected else "transmitted", single, bsdf)
    if decades is None:
        note = f"No light is {'reflected' if reflected else 'transmitted'} in these planes."
        if into_one:
            note = f"{into_one} Light in one single direction has no {quantity}; there is nothing to draw."
        return [Figure(quantity, note=note)]
    low, high = (10.0**exponent for exponent in decades)
    inside = " The light is inside the body; its radiance is n² times that in air."
    inside = inside if not reflected and representation(bsdf).transmits_into_body else ""
    figures = []
    for plane, cuts in zip(planes, cuts_by_plane, strict=True):
        curves = _lines(cuts)
        marks = [*curves, *_single_directions(bsdf, quantity, single, low, high)]
        title = f"{quantity} {plane.words}" if plane.words else _CARTESIAN.format(quantity)
        svg = chart(
            f"{quantity} in the plane of incidence {plane.words} against the angle of view, logarithmic",
            Axis(f"{_ANGLE_LABEL[quantity]}, degree (positive: away from the source)", -90.0, 90.0, step=30),
            Axis(f"{quantity}, sr⁻¹", low, high, log=True),
            marks,
        )
        dotted = f" Dotted: {into_one[:1].lower()}{into_one[1:]}" if into_one else ""
        note = f"{plane.title('Plane of incidence')}, {bsdf_sections.wavelength_words(bsdf)}.{dotted}{inside}{_WHAT_TO_SEE[quantity]}"
        note += _unmeasured_note(bsdf, plane, cuts, through=not reflected)
        figures.append(Figure(title, svg, legend(curves), note))
    return figures


def _about_mirror(bsdf: xr.Dataset, planes: Sequence[Plane], cuts_by_plane: Sequence[Sequence[_Cut]]) -> list[Figure]:
    """The lobe against the angle from the mirror direction, for lobes that are too narrow for the other charts."""
    slope, decades = representation(bsdf).lobe_slope, _decades([cut for cuts in cuts_by_plane for cut in cuts])
    if slope is None or slope > _NARROW or decades is None:
        return []
    nearest = max(1e-3, 10.0 ** math.floor(math.log10(math.degrees(slope) / 4)))
    figures = []
    for plane, cuts in zip(planes, cuts_by_plane, strict=True):
        lines = [
            replace(line, x=cut.incidence - cut.theta, y=np.where(cut.theta < cut.incidence, line.y, np.nan))
            for cut in cuts
            for line in cut.lines()
        ]
        svg = chart(
            f"BRDF {plane.words} against the angle from the mirror direction, both logarithmic",
            Axis("angle from the mirror direction, degree (log)", nearest, 100.0, log=True),
            Axis("BRDF, sr⁻¹", 10.0 ** decades[0], 10.0 ** decades[1], log=True),
            lines,
        )
        title = plane.title("BRDF about the mirror direction")
        note = f"The same cuts, for a narrow lobe: from the mirror direction towards the normal and beyond; {bsdf_sections.wavelength_words(bsdf)}."
        note += _unmeasured_note(bsdf, plane, cuts)
        figures.append(Figure(title, svg, legend(lines), note))
    return figures


def _single_directions(bsdf: xr.Dataset, quantity: str, single: Array, low: float, high: float) -> Iterator[Line]:
    """Directions of specular light, which has no width."""
    for incidence, style, share in zip(INCIDENCES, _STYLES, single.tolist(), strict=True):
        if share >= SMALLEST_SHARE:
            at = incidence if quantity == "BRDF" else float(bsdf_sections.smooth_angles(bsdf, incidence)[0])
            yield Line([at, at], [low, high], style, pattern="dots")


def _into_one_words(verb: str, single: Array, bsdf: xr.Dataset) -> str:
    if not (single >= SMALLEST_SHARE).any():
        return ""
    shares = ", ".join(f"{share_percent(share)} at {angle:g}°" for angle, share in zip(INCIDENCES, single, strict=True))
    coherent = "optics" in bsdf.attrs or bsdf.attrs.get("representation") == "kirchhoff"
    how = "coherently" if coherent else "by a perfectly smooth surface"
    return f"Light {verb} into one direction {how}, {shares} incidence."


def _decades(cuts: Sequence[_Cut]) -> tuple[int, int] | None:
    """Exponents of ten at both ends of the axis; None where there is no light."""
    values = np.concatenate([cut.value for cut in cuts]) if cuts else np.empty(0)
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size == 0:
        return None
    high = math.ceil(math.log10(float(positive.max())) - 1e-6)
    lowest, base = (math.floor(math.log10(float(v)) + 1e-6) for v in (positive.min(), np.percentile(positive, 10)))
    low = max(lowest, high - _DECADES_SHOWN)
    # The base below a very narrow lobe must stay visible.
    low = base if high - _MOST_DECADES <= base < low else low
    return min(low, high - 2), high

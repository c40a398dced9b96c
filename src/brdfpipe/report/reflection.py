"""The figures of a BSDF as curves: cuts through the planes of incidence, and how much light goes where."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.optics.fresnel_equations import mean_fresnel
from brdfpipe.report import measurement_coverage as reach
from brdfpipe.report import scattering
from brdfpipe.report.pages import fixed, number
from brdfpipe.report.scattering import Plane
from brdfpipe.report.svg import Array, Axis, Band, Figure, Line, Mark, chart, legend, polar, sentence

INCIDENCES = (0.0, 30.0, 45.0, 60.0, 75.0)
"""Angles of incidence of the cuts, degree."""

_STYLES = ("c0", "c1", "c4", "c2", "c3")

_DECADES_SHOWN = 6
_MOST_DECADES = 9

_NARROW = 0.03
"""Slope below which a lobe is a mere spike between two horizons."""

GRAZING = np.unique(np.r_[np.linspace(0, 80, 33), 90 - np.geomspace(10, 0.1, 24)])
"""Angles of incidence of the directional reflectance, crowding towards grazing, where it is steepest; degree."""

_GRAZING_LAY = np.r_[np.arange(0.0, 75.0, 7.5), 90 - np.geomspace(15, 0.1, 16)]
_GRAZING_FEW = np.r_[np.arange(0.0, 75.0, 15.0), 90 - np.geomspace(15, 0.1, 8)]

_NEGLIGIBLE = 1e-4
"""Share of the light below which nothing is said of it."""

_MOST_SHOWN = 1.25
"""Directional reflectance up to which a model that gains energy is drawn."""

_CLOSED = 1e-5
"""Difference from 1 up to which a balance closes: the accuracy of the quadratures."""


class _Cut(NamedTuple):
    incidence: float
    style: str
    theta: Array
    value: Array
    quality: NDArray[np.int8] | None
    """None of a BSDF that rests on a model."""

    def lines(self) -> list[Line]:
        """The curve, dashed where it was not measured; the part of the mirror direction is labelled, with what it rests on."""
        label = f"{'incidence ' if self.incidence == INCIDENCES[0] else ''}{self.incidence:g}°"
        line = Line(self.theta, np.where(self.value > 0, self.value, np.nan), self.style, label)
        if self.quality is None:
            return [line]
        mirror = int(np.argmin(np.abs(self.theta - self.incidence)))
        basis, told = vocabulary.QUALITY_FLAGS[self.quality[mirror]], reach.known(self.quality)
        label += "" if basis == "measured" else f" ({basis})"
        labels = (label, "") if told[mirror] else ("", label)
        return [replace(part, label=each) for part, each in zip(reach.split(line, told), labels, strict=True)]


def cuts(bsdf: xr.Dataset) -> list[Figure]:
    """BRDF, and BTDF where light passes, in the plane of incidence; with a lay, in the planes along and across it.

    A goniometric plot comes first where one plane says all. A sentence stands in for what has no density.
    """
    passes, planes = representations.transmits(bsdf), scattering.planes(bsdf)
    mirrored, straight = scattering.specular(bsdf, np.array(INCIDENCES))
    above = [_cuts(bsdf, plane, through=False) for plane in planes]
    below = [_cuts(bsdf, plane, through=True) for plane in planes] if passes else []
    figures: list[Figure] = []
    if len(planes) == 1 and not mirrored.any() and not straight.any():
        figures += _goniometric(bsdf, above[0], below[0] if below else [])
    figures += _cartesian(bsdf, "BRDF", planes, above, mirrored)
    figures += [] if mirrored.any() else _about_mirror(bsdf, planes, above)
    return figures + (_cartesian(bsdf, "BTDF", planes, below, straight) if passes else [])


def _cuts(bsdf: xr.Dataset, plane: Plane, *, through: bool) -> list[_Cut]:
    return [_cut(bsdf, plane, *each, through=through) for each in zip(INCIDENCES, _STYLES, strict=True)]


def _cut(bsdf: xr.Dataset, plane: Plane, incidence: float, style: str, *, through: bool) -> _Cut:
    theta, value = scattering.cut(bsdf, plane, incidence, through=through)
    polar, turn = scattering.in_plane(theta, through=through)
    return _Cut(incidence, style, theta, value, reach.quality(bsdf, plane, incidence, polar, turn))


def _drawn(cuts: Sequence[_Cut]) -> list[Line]:
    return [line for cut in cuts for line in cut.lines()]


def _basis_words(bsdf: xr.Dataset, plane: Plane, cuts: Sequence[_Cut], *, through: bool = False) -> str:
    """What dashed parts of cuts mean; empty where there are none."""
    if all(cut.quality is None or reach.known(cut.quality).all() for cut in cuts):
        return ""
    return f" Dashed: not measured.{reach.words(bsdf, plane, INCIDENCES, through=through)}"


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
    note = f"Plane of incidence, {scattering.wavelength_words(bsdf)}. Triangles mark the sources."
    note += _basis_words(bsdf, scattering.planes(bsdf)[0], above)
    return [Figure(f"{quantity}, goniometric", svg, legend(marks), note)]


def _cartesian(
    bsdf: xr.Dataset, quantity: str, planes: Sequence[Plane], found: Sequence[Sequence[_Cut]], single: Array
) -> list[Figure]:
    """The cuts on Cartesian axes, one chart a plane, all to one scale.

    Parameters
    ----------
    single : (incidences,) shares of the light that smooth surfaces send into one direction, dotted
    """
    decades = _decades([cut for cuts in found for cut in cuts])
    into_one = _into_one_words("mirrored" if quantity == "BRDF" else "transmitted", single)
    if decades is None:
        nothing = f"No light is {'reflected' if quantity == 'BRDF' else 'transmitted'} in these planes."
        words = f"{into_one} One direction has no {quantity}: there is nothing to draw." if into_one else nothing
        return [sentence(quantity, words)]
    low, high = (10.0**exponent for exponent in decades)
    figures = []
    for plane, cuts in zip(planes, found, strict=True):
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
        note = f"{where}, {scattering.wavelength_words(bsdf)}.{dotted}{_inside(bsdf, quantity)}"
        note += _basis_words(bsdf, plane, cuts, through=quantity == "BTDF")
        figures.append(Figure(title, svg, legend(curves), note))
    return figures


def _about_mirror(bsdf: xr.Dataset, planes: Sequence[Plane], found: Sequence[Sequence[_Cut]]) -> list[Figure]:
    """The lobe against the angle from the mirror direction, where it is too narrow for the other charts."""
    slope, decades = representations.lobe_slope(bsdf), _decades([cut for cuts in found for cut in cuts])
    if slope is None or slope > _NARROW or decades is None:
        return []
    nearest = max(1e-3, 10.0 ** math.floor(math.log10(math.degrees(slope) / 4)))
    figures = []
    for plane, cuts in zip(planes, found, strict=True):
        lines = [replace(line, x=cut.incidence - cut.theta) for cut in cuts for line in cut.lines()]
        lines = [replace(line, y=np.where(np.asarray(line.x) > 0, line.y, np.nan)) for line in lines]
        svg = chart(
            f"BRDF {plane.words} against the angle from the mirror direction, both logarithmic",
            Axis("angle from the mirror direction, degree (log)", nearest, 100.0, log=True),
            Axis("BRDF, sr⁻¹", 10.0 ** decades[0], 10.0 ** decades[1], log=True),
            lines,
        )
        title = f"BRDF about the mirror direction {plane.words}".strip()
        note = f"The same cuts, for a narrow lobe: from the mirror direction towards the normal and beyond; {scattering.wavelength_words(bsdf)}."
        note += _basis_words(bsdf, plane, cuts)
        figures.append(Figure(title, svg, legend(lines), note))
    return figures


_FROM = {"BRDF": "angle of view θₒ", "BTDF": "180° − θₒ"}


def _inside(bsdf: xr.Dataset, quantity: str) -> str:
    if quantity == "BRDF" or bsdf.attrs.get("transmission") != "interface":
        return ""
    return " The light is inside the body; its radiance counts n² times that in air."


def _rays(bsdf: xr.Dataset, quantity: str, single: Array, low: float, high: float) -> Iterator[Line]:
    """Directions that hold a share of the light without width."""
    for incidence, style, share in zip(INCIDENCES, _STYLES, single.tolist(), strict=True):
        if share > 0:
            at = incidence if quantity == "BRDF" else float(scattering.smooth_angles(bsdf, incidence)[0])
            yield Line([at, at], [low, high], style, pattern="dots")


def _into_one_words(verb: str, single: Array) -> str:
    if not single.any():
        return ""
    shares = ", ".join(f"{_percent(share)} at {angle:g}°" for angle, share in zip(INCIDENCES, single, strict=True))
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


# --- how much light goes where


def shares(checks: xr.Dataset | None, bsdf: xr.Dataset | None) -> list[Figure]:
    """Directional reflectance against the incidence, in parts; of what transmits, the balance of the light.

    Without a BSDF the reflectance that the checks found.
    """
    if bsdf is None:
        return _checked(checks)
    if representations.transmits(bsdf):
        return [_balance(bsdf, plane) for plane in scattering.planes(bsdf)]
    marks: list[Line] = []
    drawn: list[Line] = []
    note = f"{scattering.wavelength_words(bsdf).capitalize()}."
    for k, plane in enumerate(scattering.planes(bsdf)):
        total, *parts = _reflectance_lines(bsdf, plane, k)
        known = _known(bsdf, plane, total)
        marks, drawn = [*marks, total, *parts], [*drawn, *known, *parts]
        if known[0] is not total:
            note += f" Dashed: not measured.{reach.reflectance_words(bsdf, plane, INCIDENCES)}"
    return [_reflectance_figure(marks, note, drawn)]


def _known(bsdf: xr.Dataset, plane: Plane, total: Line) -> list[Line]:
    """A directional reflectance, dashed at incidences of which the mirror direction was not measured."""
    flags = reach.at_mirror(bsdf, plane, total.x)
    if flags is None or (told := reach.known(flags)).all():
        return [total]
    known, rest = reach.split(total, told)
    return [*([known] if told.any() else []), replace(rest, label=f"{total.label} (completed)")]


def _checked(checks: xr.Dataset | None) -> list[Figure]:
    if checks is None or "albedo" not in checks:
        return []
    checked = scattering.at_reference(checks["albedo"])
    note = f"{scattering.wavelength_words(checks).capitalize()}."
    total = [Line(checked["theta_i"].values, checked.values, "c0", "total")]
    return [_reflectance_figure(total, note, total)]


def _reflectance_figure(marks: Sequence[Line], note: str, drawn: Sequence[Line]) -> Figure:
    highest = max(float(np.nanmax(np.asarray(mark.y))) for mark in marks)
    top = next((limit for limit in (0.2, 0.5, 1.0) if highest <= limit * (1 + 1e-9)), min(highest * 1.05, _MOST_SHOWN))
    svg = chart(
        "Directional reflectance against the angle of incidence",
        Axis("angle of incidence θᵢ, degree", 0.0, 90.0, step=15),
        Axis("directional reflectance", 0.0, top),
        drawn,
    )
    return Figure("Directional reflectance", svg, legend(drawn), f"{note} {_excess_words(marks)}".strip())


def _excess_words(totals: Sequence[Line]) -> str:
    """Where more light leaves than arrives; empty where it does nowhere."""
    theta, most = max(
        ((np.asarray(line.x), np.asarray(line.y)) for line in totals), key=lambda curve: float(np.max(curve[1]))
    )
    if np.max(most) <= 1 + _CLOSED:
        return ""
    first, worst = int(np.argmax(most > 1 + _CLOSED)), int(np.argmax(most))
    return (
        f"From {theta[first]:.3g}° on more light leaves than arrives, {number(most[worst])} times as much at {theta[worst]:.3g}°: the "
        "masking chosen does not keep energy. Set `model.masking: height-correlated` where that matters."
    )


def _reflectance_lines(bsdf: xr.Dataset, plane: Plane, turn: int) -> Iterator[Line]:
    """Total and parts in one plane; ``turn`` counts the planes."""
    theta = _incidences(bsdf)
    words = f", {plane.words}" if plane.words else ""
    total_style, part_style = (("c0", "c2"), ("c1", "c3"))[turn]
    parts = reflectance_parts(bsdf, plane, theta)
    yield Line(theta, parts.total, total_style, f"total{words}")
    if parts.mirrored.any():
        yield Line(theta, parts.mirrored, part_style, f"mirrored{words}", "dash")
    if parts.facets is not None and parts.facets.max() > _NEGLIGIBLE and not np.allclose(parts.facets, parts.total):
        yield Line(theta, parts.facets, part_style, f"by the facets{words}", "dash")
    if parts.once is not None:
        yield Line(theta, parts.once, part_style, f"by one facet alone{words}", "dots")
    if parts.below is not None and parts.below.max() > _NEGLIGIBLE and not words:
        yield Line(theta, parts.below, "c4", "diffuse, from below", "dash")


class ReflectanceParts(NamedTuple):
    """Shares of the light [1] against the incidence; None where a representation cannot tell them apart."""

    total: Array
    mirrored: Array
    """Into one direction, by a perfectly smooth surface"""
    facets: Array | None
    """Into many directions by the facets"""
    once: Array | None
    """Of that, what left after one reflection; None where nothing else is in it"""
    below: Array | None


def reflectance_parts(bsdf: xr.Dataset, plane: Plane, theta: Array) -> ReflectanceParts:
    """Directional reflectance at incidences [degree], and what it is made of.

    Total and parts come from one rule at one set of angles: interpolated, a part would wiggle across the total towards grazing.
    """
    total = scattering.reflectance(bsdf, plane, theta)
    mirrored, _ = scattering.specular(bsdf, theta)
    facets, once = scattering.facets_alone(bsdf), scattering.once_reflected(bsdf)
    if facets is None:
        return ReflectanceParts(total, mirrored, None, None, None)
    of_surface = scattering.reflectance(facets, plane, theta)
    return ReflectanceParts(
        total,
        mirrored,
        of_surface - mirrored,
        None if once is None else scattering.reflectance(once, plane, theta),
        np.maximum(total - of_surface, 0.0),
    )


def _balance(bsdf: xr.Dataset, plane: Plane) -> Figure:
    theta = _incidences(bsdf)
    reflected, passed = scattering.reflectance(bsdf, plane, theta), scattering.transmittance(bsdf, plane, theta)
    mirrored, straight = scattering.specular(bsdf, theta)
    rest = 1 - reflected - passed
    other = "absorbed" if "absorptance" in bsdf else "lost between facets"
    layers = [
        (mirrored, "c2", "R, mirrored"),
        (reflected - mirrored, "c3", "R, scattered" if mirrored.any() else "R, reflected"),
        (straight, "c1", "T, straight" if other == "absorbed" else "T, refracted"),
        (passed - straight, "c0", "T, scattered" if straight.any() else "T, transmitted"),
        (rest, "ref", other),
    ]
    marks: list[Mark] = []
    floor = np.zeros_like(theta)
    for layer, style, label in layers:
        if layer.max() > _NEGLIGIBLE:
            marks.append(Band(theta, floor, floor + np.maximum(layer, 0.0), style, label))
            floor = floor + np.maximum(layer, 0.0)
            marks.append(Line(theta, floor, style))
    svg = chart(
        f"Shares of the light reflected and transmitted {plane.words} against the angle of incidence, stacked",
        Axis("angle of incidence θᵢ, degree", 0.0, 90.0, step=15),
        Axis("share of the light", 0.0, max(1.0, float(floor.max()))),
        marks,
    )
    title = f"Balance of the light {plane.words}".strip()
    entries = tuple(("area", mark.style, mark.label) for mark in marks if isinstance(mark, Band))
    note = f"{scattering.wavelength_words(bsdf).capitalize()}. {balance_words(theta, reflected, passed, _sum(bsdf, plane))}"
    note += reach.words(bsdf, plane, INCIDENCES)
    return Figure(title, svg, entries, note)


def _sum(bsdf: xr.Dataset, plane: Plane) -> float | None:
    """R + T + A where it is farthest from 1, of a BSDF that states its absorptance apart; None of one that does not."""
    if "absorptance" not in bsdf:
        return None
    stated = scattering.at_reference(bsdf["absorptance"])
    known = stated["theta_i"].values < 90
    theta, absorbed = (np.asarray(each.values[known], dtype=float) for each in (stated["theta_i"], stated))
    total = absorbed + scattering.reflectance(bsdf, plane, theta) + scattering.transmittance(bsdf, plane, theta)
    return float(total[np.argmax(np.abs(total - 1))])


def balance_words(theta: Array, reflected: Array, passed: Array, total: float | None = None) -> str:
    """What reflectance and transmittance add up to, and what that means.

    Parameters
    ----------
    theta, reflected, passed : (incidences,)
    total : R + T + A where it is farthest from 1, if absorption is known; else what is missing was lost by the model
    """
    rest = 1 - reflected - passed
    most, least = int(np.argmax(rest)), int(np.argmin(rest))
    if rest[least] < -_CLOSED:
        return (
            f"R + T reaches {fixed(1 - rest[least], 4)} at {theta[least]:.3g}° incidence: more leaves than arrives. "
            "Choose another `model.masking` if energy matters."
        )
    if rest[most] <= _CLOSED:
        return "R + T = 1.0000 at every incidence."
    if total is not None:
        return (
            f"R + T + A = {fixed(total, 4)}; A, what the body absorbs, is {_percent(rest[0])} at 0° and most at {theta[most]:.3g}°, "
            f"{_percent(rest[most])}."
        )
    return (
        f"R + T = {fixed(1 - rest[0], 4)} at 0° and least {fixed(1 - rest[most], 4)} at {theta[most]:.3g}°: the rest would leave after "
        "a second reflection between facets, which this model does not follow."
    )


def _incidences(bsdf: xr.Dataset) -> Array:
    """Angles of incidence; fewer where each costs more."""
    needed = ("albedo", "transmittance") if representations.transmits(bsdf) else ("albedo",)
    if not all(hasattr(representations.representation(bsdf), name) for name in needed):
        return _GRAZING_FEW
    return GRAZING if representations.isotropic(bsdf) else _GRAZING_LAY


# --- several reflections


class MultipleScattering(NamedTuple):
    """What the facets reflect more than once [1], mean over the hemisphere of incidence."""

    compensated: bool
    share: float
    """Of the light, in this material"""
    mirrors: float
    """Of the light, if the facets were perfect mirrors; negative where the masking gives out more than it receives"""


def multiple_scattering(bsdf: xr.Dataset) -> MultipleScattering | None:
    """How much light leaves the facets after several reflections; None where a BSDF does not say.

    Notes
    -----
    With Ē₁ the mean albedo of perfect mirrors and F̄ = 2 ∫ F μ dμ, F̄² Ē₁ (1 − Ē₁) / (1 − F̄ (1 − Ē₁)): a geometric series
    (Kulla & Conty 2017).
    """
    if "mean_furnace_albedo" not in bsdf or "slope_density" not in bsdf:
        return None
    mirrors = 1 - float(bsdf["mean_furnace_albedo"])
    if "compensation" in bsdf:
        return MultipleScattering(True, float(scattering.at_reference(bsdf["compensation"])) * mirrors, mirrors)
    fresnel = float(mean_fresnel(*(np.atleast_1d(scattering.at_reference(bsdf[name])) for name in ("n", "k")))[0])
    share = fresnel**2 * (1 - mirrors) * mirrors / max(1 - fresnel * mirrors, 1e-12)
    return MultipleScattering(False, max(share, 0.0), mirrors)


def _percent(share: float) -> str:
    return f"{number(100 * share, 3 if share >= 0.01 else 2)}\u202f%"

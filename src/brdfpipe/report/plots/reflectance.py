"""Directional reflectance and transmittance against the angle of incidence, total and parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe.bsdf.light_shares import light_sum, reflectance_parts
from brdfpipe.bsdf.registry import representation
from brdfpipe.report.formatting import fixed, number, share_percent
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_cuts import INCIDENCES
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array, Axis, Band, Figure, Line, Mark, chart, legend

GRAZING = np.unique(np.r_[np.linspace(0, 80, 33), 90 - np.geomspace(10, 0.1, 24)])
"""Angles of incidence of the directional reflectance [degree], dense towards grazing, where it is steepest."""
_GRAZING_LAY = np.r_[np.arange(0.0, 75.0, 7.5), 90 - np.geomspace(15, 0.1, 16)]
_GRAZING_FEW = np.r_[np.arange(0.0, 75.0, 15.0), 90 - np.geomspace(15, 0.1, 8)]

_NEGLIGIBLE = 1e-4
"""Share of the light below which a part is not drawn."""
_MOST_SHOWN = 1.25
"""Directional reflectance up to which a model that gains energy is drawn."""
_CLOSED = 1e-5
"""Accuracy of the quadratures, and so of a balance of the light."""

_INCIDENCE_AXIS = Axis("angle of incidence θᵢ, degree", 0.0, 90.0, step=15)


def shares(checks: xr.Dataset | None, bsdf: xr.Dataset | None) -> list[Figure]:
    """Directional reflectance against the incidence, in parts; the balance of the light of a body that transmits.

    Without a BSDF, the directional reflectance of the checks.
    """
    if bsdf is None:
        if checks is None or "albedo" not in checks:
            return []
        albedo = bsdf_sections.at_reference(checks["albedo"])
        total = Line(albedo["theta_i"].values, albedo.values, "c0", "total")
        return [_reflectance_figure([total], f"{bsdf_sections.wavelength_words(checks).capitalize()}.", [total])]
    if representation(bsdf).transmits:
        return [_balance(bsdf, plane) for plane in bsdf_sections.planes(bsdf)]
    marks: list[Line] = []
    drawn: list[Line] = []
    note = f"{bsdf_sections.wavelength_words(bsdf).capitalize()}."
    for k, plane in enumerate(bsdf_sections.planes(bsdf)):
        total, *parts = _reflectance_lines(bsdf, plane, k)
        known = _split_by_coverage(bsdf, plane, total)
        marks, drawn = [*marks, total, *parts], [*drawn, *known, *parts]
        if known[0] is not total:
            note += f" Dashed: not measured.{measurement_coverage.reflectance_words(bsdf, plane, INCIDENCES)}"
    return [_reflectance_figure(marks, note, drawn)]


def _split_by_coverage(bsdf: xr.Dataset, plane: Plane, total: Line) -> list[Line]:
    """A directional reflectance, dashed at incidences whose mirror direction was not measured."""
    flags = measurement_coverage.at_mirror(bsdf, plane, total.x)
    if flags is None or (measured := measurement_coverage.known(flags)).all():
        return [total]
    known, rest = measurement_coverage.split(total, measured)
    return [*([known] if measured.any() else []), replace(rest, label=f"{total.label} (completed)")]


def _reflectance_figure(marks: Sequence[Line], note: str, drawn: Sequence[Line]) -> Figure:
    highest = max(float(np.nanmax(np.asarray(mark.y))) for mark in marks)
    top = next((limit for limit in (0.2, 0.5, 1.0) if highest <= limit * (1 + 1e-9)), min(highest * 1.05, _MOST_SHOWN))
    svg = chart(
        "Directional reflectance against the angle of incidence",
        _INCIDENCE_AXIS,
        Axis("directional reflectance", 0.0, top),
        drawn,
    )
    see = "A rise towards 90° is light that the smooth parts of the surface mirror at grazing incidence."
    return Figure("Directional reflectance", svg, legend(drawn), f"{note} {see} {_excess_words(marks)}".strip())


def _excess_words(lines: Sequence[Line]) -> str:
    """The incidences at which more light leaves than arrives; empty where there are none."""
    worst = max(lines, key=lambda line: float(np.max(line.y)))
    theta, total = np.asarray(worst.x), np.asarray(worst.y)
    first, largest = int(np.argmax(total > 1 + _CLOSED)), int(np.argmax(total))
    if total[largest] <= 1 + _CLOSED:
        return ""
    return (
        f"From {theta[first]:.3g}° on more light leaves than arrives, up to {number(total[largest])} times at {theta[largest]:.3g}°. The "
        "chosen masking does not conserve energy. Set `model.masking: height-correlated` to conserve it."
    )


def _reflectance_lines(bsdf: xr.Dataset, plane: Plane, turn: int) -> Iterator[Line]:
    """Total and parts in plane number ``turn``."""
    theta = _incidences(bsdf)
    words = f", {plane.words}" if plane.words else ""
    total_style, part_style = (("c0", "c2"), ("c1", "c3"))[turn]
    parts = reflectance_parts(bsdf, theta, np.full_like(theta, plane.azimuth + 180), bsdf_sections.reference(bsdf))
    yield Line(theta, parts.total, total_style, f"total{words}")
    if parts.mirrored.any():
        # The colour of the total, not of the scattered light, which it crosses.
        yield Line(theta, parts.mirrored, total_style, f"mirrored{words}", "dots")
    if parts.facets is not None and parts.facets.max() > _NEGLIGIBLE and not np.allclose(parts.facets, parts.total):
        by_facets = "optics" not in bsdf.attrs and bsdf.attrs["representation"] != "kirchhoff"
        by_what = "by the facets" if by_facets else "scattered by the relief"
        yield Line(theta, parts.facets, part_style, f"{by_what}{words}", "dash")
    if parts.once is not None:
        yield Line(theta, parts.once, part_style, f"by one facet alone{words}", "dots")
    if parts.below is not None and parts.below.max() > _NEGLIGIBLE and not words:
        yield Line(theta, parts.below, "c4", "diffuse, from below", "dash")


def _balance(bsdf: xr.Dataset, plane: Plane) -> Figure:
    theta = _incidences(bsdf)
    reflected, passed = bsdf_sections.reflectance(bsdf, plane, theta), bsdf_sections.transmittance(bsdf, plane, theta)
    mirrored, straight = bsdf_sections.specular(bsdf, theta)
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
            top = floor + np.maximum(layer, 0.0)
            marks += [Band(theta, floor, top, style, label), Line(theta, top, style)]
            floor = top
    svg = chart(
        f"Shares of the light reflected and transmitted {plane.words} against the angle of incidence, stacked",
        _INCIDENCE_AXIS,
        Axis("share of the light", 0.0, max(1.0, float(floor.max()))),
        marks,
    )
    entries = tuple(("area", mark.style, mark.label) for mark in marks if isinstance(mark, Band))
    total = light_sum(bsdf, plane.azimuth + 180, bsdf_sections.reference(bsdf))
    note = f"{bsdf_sections.wavelength_words(bsdf).capitalize()}. {balance_words(theta, reflected, passed, total)}"
    note += measurement_coverage.words(bsdf, plane, INCIDENCES)
    return Figure(plane.title("Balance of the light"), svg, entries, note)


def balance_words(theta: Array, reflected: Array, passed: Array, total: float | None = None) -> str:
    """The sum of reflectance and transmittance, (incidences,), and what it means.

    ``total`` is R + T + A where it is farthest from 1; None where the absorptance is not known, and the model loses the rest.
    """
    rest = 1 - reflected - passed
    most, least = int(np.argmax(rest)), int(np.argmin(rest))
    if rest[least] < -_CLOSED:
        return (
            f"R + T reaches {fixed(1 - rest[least], 4)} at {theta[least]:.3g}° incidence: more light leaves than arrives. "
            "Choose another `model.masking` to conserve energy."
        )
    if rest[most] <= _CLOSED:
        return "R + T = 1.0000 at every incidence."
    if total is not None:
        return (
            f"R + T + A = {fixed(total, 4)}; A, absorbed by the body, is {share_percent(rest[0])} at 0° and largest at {theta[most]:.3g}°, "
            f"{share_percent(rest[most])}."
        )
    return (
        f"R + T = {fixed(1 - rest[0], 4)} at 0°, smallest {fixed(1 - rest[most], 4)} at {theta[most]:.3g}°. The rest would leave after "
        "a second reflection between facets, which the model does not include."
    )


def _incidences(bsdf: xr.Dataset) -> Array:
    """Angles of incidence; fewer for representations that take long."""
    evaluator = representation(bsdf)
    if evaluator.albedo_needs_quadrature or (evaluator.transmits and evaluator.transmittance_needs_quadrature):
        return _GRAZING_FEW
    return GRAZING if evaluator.isotropic else _GRAZING_LAY

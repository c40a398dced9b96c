"""Data of the directional viewer: a BSDF sampled about its lobe, small enough for the page.

Outgoing directions are points of the disc of direction cosines, with the light from the left. About the mirror (or straight, or refracted)
direction they have an azimuth ψ, 0 away from the source, and a distance ρ, which reaches R(ψ) at the rim. The nodes are even in ψ and in

    t = asinh(h sinh a) / a,   h = 1 − √(1 − ρ/R),   a = asinh(2 R / s),   s = 2 m cos θ,

with the slope m of the lobe and the angle θ of its direction: dense within the lobe, however narrow, and towards the rim. Between nodes the
logarithm is interpolated by Catmull–Rom splines in ψ and t, and by the cubic through four nodes in the incidence. ``templates/viewer.js`` does
the same; :func:`interpolated` is its reference, by which the page states the error.
"""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.predictions import best_prediction
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.svg import Array

INCIDENCES = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 67.0, 74.0, 80.0, 85.0])
"""Angles of incidence of the nodes [degree]."""

DISTANCES = 37
"""Nodes from the direction of the lobe to the rim."""

_TURNS, _EVERY_TURN = 25, 48
"""Nodes of ψ from 0 to 180 degrees, and over a full turn."""

_COARSE = (2, 3, 4)
"""Every second incidence, third distance and fourth azimuth has the ratios between wavelengths, which vary slowly."""

_WAVELENGTHS = np.arange(400.0, 701.0, 50.0)
_LEAST = 1e-9
"""Least value that is kept, of the largest."""

_DEFAULT_SLOPE, _SMALLEST_SLOPE = 0.1, 1e-4
_LEVELS = 65535
_PROBES = 256
"""Directions at which the error of the interpolation is determined."""


@dataclass(frozen=True)
class Sampled:
    """One side of a BSDF at one azimuth of incidence."""

    logs: Array
    """(incidence, ψ, t) decimal logarithm of the BSDF [sr-1]; NaN without light"""
    peak: Array
    """(incidence,) angle of the lobe's direction from the normal of its side [degree]"""
    slope: float
    floor: float | None
    """Decimal logarithm of the least value that is kept [sr-1], in place of all below it; None where none is."""

    @property
    def full_turn(self) -> bool:
        return self.logs.shape[1] == _EVERY_TURN


def sample(bsdf: xr.Dataset, plane: Plane, *, through: bool = False) -> Sampled:
    """The nodes of one side at one azimuth of incidence; the BSDF is evaluated at the wavelength of the figures."""
    slope = representation(bsdf).lobe_slope
    slope = _DEFAULT_SLOPE if slope is None else max(float(slope), _SMALLEST_SLOPE)
    peak = np.array([float(bsdf_sections.smooth_angles(bsdf, one)[0]) for one in INCIDENCES]) if through else INCIDENCES
    peak = np.minimum(peak, 89.0)
    polar, turn = _nodes(peak, slope, full_turn=not representation(bsdf).isotropic)
    values = bsdf_sections.value(bsdf, plane, INCIDENCES[:, None, None], 180 - polar if through else polar, turn)
    # Between light and none a logarithm cannot be interpolated: the least value stands for less, far below what any figure shows.
    least = _LEAST * float(np.nanmax(values, initial=0.0))
    below = values < least
    logs = np.log10(np.where(below | ~(values > 0), np.where(np.isfinite(values) & (least > 0), least, np.nan), values))
    return Sampled(logs, peak, slope, math.log10(least) if least > 0 and below.any() else None)


def _nodes(peak: Array, slope: float, *, full_turn: bool) -> tuple[Array, Array]:
    """Polar angle and azimuth of the nodes [degree], (incidence, ψ, t)."""
    psi = np.linspace(0, 2 * np.pi, _EVERY_TURN, endpoint=False) if full_turn else np.linspace(0, np.pi, _TURNS)
    centre = np.sin(np.radians(peak))[:, None, None]
    rim, stretch = _rim_and_stretch(centre, psi[:, None], slope)
    h = np.sinh(stretch * np.linspace(0, 1, DISTANCES)) / np.sinh(stretch)
    # The nodes of the rim are a little inside of it: the horizon itself has no light.
    distance = np.minimum(rim * (1 - (1 - h) ** 2), rim * (1 - 1e-5))
    x, y = centre + distance * np.cos(psi[:, None]), distance * np.sin(psi[:, None])
    return np.degrees(np.arcsin(np.minimum(np.hypot(x, y), 1.0))), np.degrees(np.arctan2(y, x))


def _rim_and_stretch(centre: Array, psi: Array, slope: float) -> tuple[Array, Array]:
    """R and a of the module's formula."""
    rim = -centre * np.cos(psi) + np.sqrt(np.maximum(1 - (centre * np.sin(psi)) ** 2, 0))
    rim = np.maximum(rim, 1e-9)
    return rim, np.clip(np.arcsinh(rim / (slope * np.sqrt(1 - centre**2))), 0.5, 14.0)


def interpolated(sampled: Sampled, incidence: Array, theta: Array, turn: Array) -> Array:
    """Decimal logarithm of the BSDF between the nodes; NaN beside a node without light.

    Parameters
    ----------
    incidence, theta, turn : (n,) angle of incidence, polar angle from the normal of the side, and azimuth from the one away from the source [degree]
    """
    logs, (_, turns, distances) = sampled.logs, sampled.logs.shape
    lower = np.clip(np.searchsorted(INCIDENCES, incidence, side="right") - 2, 0, INCIDENCES.size - 4)
    nodes = lower[:, None] + np.arange(4)
    weight_i = _lagrange(INCIDENCES[nodes], incidence)
    centre = np.sin(np.radians((weight_i * sampled.peak[nodes]).sum(axis=1)))
    radius, azimuth = np.minimum(np.sin(np.radians(theta)), 1 - 1e-9), np.radians(turn)
    x, y = radius * np.cos(azimuth) - centre, radius * np.sin(azimuth)
    psi = np.arctan2(y, x)
    rim, stretch = _rim_and_stretch(centre, psi, sampled.slope)
    h = 1 - np.sqrt(np.clip(1 - np.hypot(x, y) / rim, 0, 1))
    t = np.arcsinh(h * np.sinh(stretch)) / stretch * (distances - 1)
    at = psi % (2 * np.pi) / (2 * np.pi) * turns if sampled.full_turn else np.abs(psi) / np.pi * (turns - 1)
    (first_psi, weight_psi), (first_t, weight_t) = _catmull_rom(at), _catmull_rom(t)
    columns, rows = first_psi[:, None] + np.arange(4), first_t[:, None] + np.arange(4)
    value = np.zeros(incidence.size)
    for a in range(4):
        for b in range(4):
            column, row = columns[:, a], rows[:, b]
            # Beyond the direction of the lobe a ray continues half a turn away.
            opposite = row < 0
            half = turns // 2
            if sampled.full_turn:
                column = np.where(opposite, column + half, column) % turns
            else:
                column = np.abs(column)
                column = np.where(column > turns - 1, 2 * (turns - 1) - column, column)
                column = np.where(opposite, turns - 1 - column, column)
            row = np.minimum(np.abs(row), distances - 1)
            share = weight_psi[:, a] * weight_t[:, b]
            value += share * (weight_i * logs[nodes, column[:, None], row[:, None]]).sum(axis=1)
    return value


def _lagrange(nodes: Array, at: Array) -> Array:
    """Weights (n, 4) of the cubic through four nodes (n, 4)."""
    weights = np.ones_like(nodes)
    for k in range(4):
        for other in range(4):
            if other != k:
                weights[:, k] *= (at - nodes[:, other]) / (nodes[:, k] - nodes[:, other])
    return weights


def _catmull_rom(at: Array) -> tuple[NDArray[np.int64], Array]:
    """The first of the four nodes about a position, and their weights (n, 4)."""
    cell = np.floor(at)
    f = at - cell
    weights = [-f + 2 * f**2 - f**3, 2 - 5 * f**2 + 3 * f**3, f + 4 * f**2 - 3 * f**3, -(f**2) + f**3]
    return cell.astype(np.int64) - 1, np.stack(weights, axis=-1) / 2


def interpolation_error(
    bsdf: xr.Dataset, plane: Plane, sampled: Sampled, *, through: bool = False
) -> tuple[float, float]:
    """Median and 95th percentile of the relative error between the nodes, half of the directions within the lobe.

    The directions are up to 80° from the normal, for incidences to 80°; those with less than 1e-6 of the largest value are left out.
    """
    random = np.random.default_rng(0)
    incidence = random.uniform(0, 80, _PROBES)
    peak = np.interp(incidence, INCIDENCES, sampled.peak)
    radius, azimuth = (
        np.sin(np.radians(80)) * np.sqrt(random.uniform(size=_PROBES)),
        random.uniform(-np.pi, np.pi, _PROBES),
    )
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    lobe = np.arange(_PROBES) % 2 == 0
    reach = 4 * sampled.slope * np.cos(np.radians(peak)) * random.uniform(size=_PROBES)
    x = np.where(lobe, np.sin(np.radians(peak)) + reach * np.cos(azimuth), x)
    y = np.where(lobe, reach * np.sin(azimuth), y)
    inside = np.hypot(x, y) < np.sin(np.radians(80))
    incidence, x, y = incidence[inside], x[inside], y[inside]
    theta, turn = np.degrees(np.arcsin(np.hypot(x, y))), np.degrees(np.arctan2(y, x))
    true = bsdf_sections.value(bsdf, plane, incidence, 180 - theta if through else theta, turn)
    shown = 10 ** interpolated(sampled, incidence, theta, turn)
    kept = np.isfinite(shown) & (true > 1e-6 * true.max(initial=0.0)) & (true > 0)
    if not kept.any():
        return math.nan, math.nan
    error = np.abs(shown[kept] / true[kept] - 1)
    return float(np.median(error)), float(np.percentile(error, 95))


def viewer_data(datasets: Mapping[str, xr.Dataset]) -> dict[str, Any] | None:
    """What the viewer of a page shows; None without a BSDF that has a density, or where its directions are not covered.

    A measured BSDF is followed by the prediction of the same material, if there is one.
    """
    shown = {"BSDF": datasets.get("bsdf")}
    predicted_by = best_prediction(datasets)
    if predicted_by is not None and "bsdf" in datasets and datasets["bsdf"].attrs.get("route") == "measured":
        shown = {"measured": datasets["bsdf"], "predicted": datasets[predicted_by]}
    planes: list[Plane] = []
    sets = []
    for name, bsdf in shown.items():
        if bsdf is None:
            continue
        try:
            planes = planes or bsdf_sections.planes(bsdf)
            for through in (False, True) if representation(bsdf).transmits else (False,):
                sets += [_set(name, bsdf, k, plane, through) for k, plane in enumerate(planes)]
        except BrdfpipeError:  # a table may not cover the directions
            continue
    sets = [one for one in sets if one["high"] is not None]
    if not sets:
        return None
    bsdf = datasets["bsdf"]
    wavelength = bsdf_sections.reference(bsdf)
    return {
        "incidences": INCIDENCES.tolist(),
        "planes": [plane.words or "plane of incidence" for plane in planes],
        "reference": None if wavelength is None else float(wavelength[0]),
        "sets": sets,
    }


def _set(name: str, bsdf: xr.Dataset, plane_index: int, plane: Plane, through: bool) -> dict[str, Any]:
    sampled = sample(bsdf, plane, through=through)
    finite = sampled.logs[np.isfinite(sampled.logs)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, None)
    median, high_error = interpolation_error(bsdf, plane, sampled, through=through) if finite.size else (0.0, 0.0)
    mirrored, straight = bsdf_sections.specular(bsdf, INCIDENCES)
    return {
        "name": name,
        "side": "transmitted" if through else "reflected",
        "plane": plane_index,
        "slope": sampled.slope,
        "floor": sampled.floor,
        "shape": list(sampled.logs.shape),
        "peak": sampled.peak.round(4).tolist(),
        "specular": [float(f"{share:.4g}") for share in (straight if through else mirrored)],
        "low": low,
        "high": high,
        "logs": _packed(sampled.logs, low, high),
        "error": [None if math.isnan(value) else float(f"{value:.2g}") for value in (median, high_error)],
        **_spectral(bsdf, plane, sampled, through),
        **_quality(bsdf, plane, sampled, through),
    }


def _spectral(bsdf: xr.Dataset, plane: Plane, sampled: Sampled, through: bool) -> dict[str, Any]:
    """Logarithms of the ratios to the wavelength of the figures, at fewer nodes; nothing for a BSDF without wavelengths."""
    if (reference := bsdf_sections.reference(bsdf)) is None:
        return {}
    own = bsdf["wavelength"].values.astype(float)
    wavelengths = np.unique([own[np.abs(own - nm).argmin()] for nm in _WAVELENGTHS])
    if wavelengths.size < 2:
        return {}
    i, d, p = _COARSE
    polar, turn = _nodes(sampled.peak, sampled.slope, full_turn=sampled.full_turn)
    polar, turn = polar[::i, ::p, ::d], turn[::i, ::p, ::d]
    angles = bsdf_sections.directions(plane, INCIDENCES[::i, None, None], 180 - polar if through else polar, turn)
    values = representation(bsdf).evaluate(*angles, wavelengths)
    at_reference = 10 ** sampled.logs[::i, ::p, ::d]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log10(values / at_reference[..., None])
    if sampled.floor is not None:
        logs[at_reference <= 1.0001 * 10**sampled.floor] = 0.0  # the least value, not that of the BSDF
    logs = np.clip(np.where(np.isfinite(logs), logs, 0.0), -6, 6)
    low, high = float(logs.min()), float(logs.max())
    return {
        "wavelengths": wavelengths.tolist(),
        "reference": float(reference[0]),
        "ratios": _packed(np.moveaxis(logs, -1, 0), low, high),
        "ratio_range": [low, high],
    }


def _quality(bsdf: xr.Dataset, plane: Plane, sampled: Sampled, through: bool) -> dict[str, Any]:
    """Basis of the values, at the nodes of the ratios; nothing for a BSDF from a model."""
    if not representation(bsdf).states_quality:
        return {}
    i, d, p = _COARSE
    polar, turn = (grid[::i, ::p, ::d] for grid in _nodes(sampled.peak, sampled.slope, full_turn=sampled.full_turn))
    incidence = np.broadcast_to(INCIDENCES[::i, None, None], polar.shape)
    flags = measurement_coverage.quality(bsdf, plane, incidence, 180 - polar if through else polar, turn)
    assert flags is not None
    return {"quality": b64encode(flags.astype(np.uint8).tobytes()).decode(), "flags": list(vocabulary.QUALITY_FLAGS)}


def _packed(logs: Array, low: float, high: float | None) -> str:
    """Sixteen bits a value, little-endian; 0 for no light."""
    span = ((high if high is not None else low) - low) or 1.0
    levels = 1 + np.clip((logs - low) / span, 0, 1) * (_LEVELS - 1)
    return b64encode(np.where(np.isfinite(logs), levels.round(), 0).astype("<u2").tobytes()).decode()

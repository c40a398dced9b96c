"""Specular gloss: the aperture double integral on the model, and what the tolerances of the apertures do to it.

G = 100 · ∫source ∫receptor f cos θ_r cos θ_i dω_r dω_i ÷ ∫source F(θ_i; 1.567) cos θ_i dω_i, a polished black glass of index
1.567 being 100. A point source would overstate 20° by 2 to 10 % for narrow lobes, and a stored 1° grid 85° by far more. What a
polished surface mirrors into one single direction arrives whole: the image of the source lies inside the receptor.

References
----------
ASTM D523 (apertures and their tolerances); ISO 2813 (tolerance of the axes); ASTM D4039 (haze). Conformance is not claimed:
results are "D523-style".
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.apertures import (
    FINE,
    QUICK,
    SOURCE,
    Beam,
    Rule,
    Source,
    Window,
    centred,
    half_width,
    lobe_scale,
    received,
    source,
)
from brdfpipe.bsdf import representations
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

RECEPTOR = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}
"""Full angles of the receptor by geometry, in the plane of incidence and across it [degree] (ASTM D523, table 1)."""

SOURCE_TOLERANCE = (0.25, 0.5)
"""± of the full angles of the source image [degree] (ASTM D523, table 1)."""

RECEPTOR_TOLERANCE = {20.0: (0.05, 0.1), 60.0: (0.1, 0.2), 85.0: (0.3, 0.3)}
"""± of the full angles of the receptor by geometry [degree] (ASTM D523, table 1)."""

AXIS_TOLERANCE = 0.1
"""± of the angle of incidence, and of the receptor's axis from its mirror image [degree] (ISO 2813)."""

_AXES = (-AXIS_TOLERANCE, AXIS_TOLERANCE)
_POINT, _RIM_U, _RIM_V = Rule((1, 1), 4), Rule((1, 4), 4), Rule((3, 1), 4)
_EDGE_ORDER = 2
_FIRST_AZIMUTHS, _MOST_AZIMUTHS = 16, 256
_MEAN_ERROR = 1e-3


class GlossError(BrdfpipeError):
    """A gloss geometry is not known."""


class _Reading(NamedTuple):
    angle: float
    azimuth: float
    scale: float
    """Of the lobe [rad]."""
    light: Source
    reflected: Array
    """Share of the light of each point of the source that the receptor gets."""

    @property
    def units(self) -> float:
        return _units(self.light, self.reflected)


def gloss(bsdf: xr.Dataset, angles: Sequence[float] = (20, 60, 85), *, azimuth: float | None = None) -> xr.DataArray:
    """Gloss units at the given geometries.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    angles : degree, among 20, 60 and 85
    azimuth : of the plane of incidence [degree]; by default the mean over all azimuths, which matters to a surface with a lay

    Returns
    -------
    DataArray ``gloss(gloss_angle)`` [1]

    Raises
    ------
    GlossError : an unknown geometry.
    """
    reduced = _reduced(bsdf, angles)
    return _named([_measured(reduced, float(angle), azimuth)[0] for angle in angles], angles, "gloss")


def gloss_with_uncertainty(
    bsdf: xr.Dataset, angles: Sequence[float] = (20, 60, 85), *, azimuth: float | None = None
) -> tuple[xr.DataArray, xr.DataArray]:
    """Gloss units, and the standard uncertainty that the tolerances of conforming instruments leave.

    Each tolerance (source and receptor, in the plane of incidence and across it; angle of incidence; axis of the receptor) makes a
    rectangular distribution of its half range, which is the half range of the gloss over √3; the six are independent. Every
    instrument is set to 100 on black glass. That the BSDF itself is uncertain is not part of it.

    Parameters
    ----------
    bsdf, angles, azimuth : as of :func:`gloss`

    Returns
    -------
    ``gloss(gloss_angle)``, ``gloss_u(gloss_angle)`` [1]

    Notes
    -----
    The receptor's part is linear in the tolerance, from the light along its edges; the source's comes from the rim between its
    smallest and its largest; the angle of incidence is evaluated at both ends with a point source. To 5 % of the uncertainty.
    """
    reduced = _reduced(bsdf, angles)
    values, spreads = [], []
    for angle in map(float, angles):
        value, readings = _measured(reduced, angle, azimuth)
        ranges = np.mean([_half_ranges(reduced, reading) for reading in readings], axis=0)
        # Of a surface with a lay: eight azimuths tell the relative spread of the mean over all of them.
        known = np.mean([reading.units for reading in readings])
        spread = float(np.sqrt(np.sum(ranges**2) / 3))
        values.append(value)
        spreads.append(spread * value / float(known) if known > 0 else spread)
    return _named(values, angles, "gloss"), _named(spreads, angles, "gloss_u")


def _reduced(bsdf: xr.Dataset, angles: Sequence[float]) -> xr.Dataset:
    vocabulary.validate(bsdf, "bsdf")
    unknown = [angle for angle in angles if float(angle) not in RECEPTOR]
    if unknown:
        raise GlossError(f"no gloss geometry {unknown[0]:g}°; accepted: {', '.join(f'{a:g}' for a in RECEPTOR)}")
    return representations.nonspectral(bsdf)


def _named(values: Sequence[float], angles: Sequence[float], name: str) -> xr.DataArray:
    quantity = vocabulary.QUANTITIES["gloss"]
    title = quantity.long_name if name == "gloss" else f"standard uncertainty of {quantity.long_name}, from tolerances"
    return xr.DataArray(
        np.asarray(values, dtype=float),
        dims="gloss_angle",
        coords={"gloss_angle": np.asarray(angles, dtype=float)},
        name=name,
        attrs={"units": quantity.units, "long_name": title},
    )


def _measured(bsdf: xr.Dataset, angle: float, azimuth: float | None) -> tuple[float, list[_Reading]]:
    """Gloss units, and readings they rest on: one, or eight around a surface with a lay."""
    scale = lobe_scale(bsdf, angle, azimuth or 0.0)
    if azimuth is not None or representations.isotropic(bsdf):
        reading = _read(bsdf, angle, azimuth or 0.0, scale, FINE)
        return reading.units, [reading]
    first = [_read(bsdf, angle, turn, scale, QUICK) for turn in _turns(_FIRST_AZIMUTHS)]
    return _mean_gloss(bsdf, angle, first), first[::2]


def _mean_gloss(bsdf: xr.Dataset, angle: float, first: Sequence[_Reading]) -> float:
    """Mean over the azimuth of the plane of incidence: at 85° a fine lay shows within a few degrees of its own."""
    scale, count, known = first[0].scale, len(first), np.array([reading.units for reading in first])
    while True:
        between = np.array([_read(bsdf, angle, turn, scale, QUICK).units for turn in _turns(count) + 180 / count])
        settled = abs(between.mean() - known.mean()) <= 2 * _MEAN_ERROR * known.mean()
        known, count = np.concatenate([known, between]), 2 * count
        if settled or count >= _MOST_AZIMUTHS:
            return float(known.mean())


def _turns(count: int) -> Array:
    return np.arange(0.0, 360.0, 360 / count)


def _read(bsdf: xr.Dataset, angle: float, azimuth: float, scale: float, rule: Rule) -> _Reading:
    light = source(angle, rule)
    (scattered,) = received(bsdf, [Beam(angle, light, centred(*RECEPTOR[angle]), rule.receptor)], azimuth, scale)
    return _Reading(angle, azimuth, scale, light, _mirrored(bsdf, light, azimuth) + scattered)


def _mirrored(bsdf: xr.Dataset, light: Source, azimuth: float) -> Array:
    return representations.specular(bsdf, light.theta, light.phi + azimuth, None)[0][:, 0]


def _units(light: Source, reflected: Array) -> float:
    return float(100 * (light.weight @ reflected) / (light.weight @ light.glass))


# --- tolerances


def _half_ranges(bsdf: xr.Dataset, reading: _Reading) -> Array:
    """Half the range of the gloss over each of the six tolerances, signed so that means over azimuths are those of the gloss."""
    angle, receptor = reading.angle, centred(*RECEPTOR[reading.angle])
    edges, step = _edges(angle)
    light = source(angle, QUICK)
    beams = [Beam(angle, light, edge, _EDGE_ORDER) for edge in edges]
    beams += [Beam(angle, rim, receptor, QUICK.receptor) for rim in _rims(angle)]
    beams += [Beam(angle + off, source(angle + off, _POINT), receptor, QUICK.receptor) for off in _AXES]
    scattered = received(bsdf, beams, reading.azimuth, reading.scale)
    left, right, near, far = (_units(light, each) / 2 for each in scattered[:4])
    shifted = (right - left) * float(np.radians(AXIS_TOLERANCE)) / step
    seen = [beam.light for beam in beams[4:]]
    mirrored = np.split(_mirrored(bsdf, _joined(seen), reading.azimuth), np.cumsum([each.u.size for each in seen])[:-1])
    reflected = [one + other for one, other in zip(mirrored, scattered[4:], strict=True)]
    less, more = (_units(*each) for each in zip(seen[4:], reflected[4:], strict=True))
    incidence = reading.units * (more - less) / (more + less) if more + less > 0 else 0.0
    return np.array([left + right, near + far, shifted, incidence, *_source_ranges(reading, seen[:4], reflected[:4])])


def _edges(angle: float) -> tuple[list[Window], float]:
    """Strips about the four edges of the receptor, and how far the first two move: by half of what the full angle does."""
    full, tolerance = RECEPTOR[angle], RECEPTOR_TOLERANCE[angle]
    low_u, high_u, low_v, high_v = centred(*full)
    by_u, by_v = (half_width(each + more) - half_width(each) for each, more in zip(full, tolerance, strict=True))
    edges = [Window(at - by_u, at + by_u, low_v, high_v) for at in (low_u, high_u)]
    edges += [Window(low_u, high_u, at - by_v, at + by_v) for at in (low_v, high_v)]
    return edges, by_u


def _rims(angle: float) -> list[Source]:
    """What the smallest source lacks of the nominal one, and the largest has beyond it: in the plane of incidence, then across."""
    (full_u, full_v), (more_u, more_v) = SOURCE, SOURCE_TOLERANCE
    across, along = half_width(full_v), half_width(full_u)
    rims = []
    for low, high in pairwise(half_width(full_u + end * more_u) for end in (-1, 0, 1)):
        sides = [Window(-high, -low, -across, across), Window(low, high, -across, across)]
        rims.append(_joined([source(angle, _RIM_U, side) for side in sides]))
    for low, high in pairwise(half_width(full_v + end * more_v) for end in (-1, 0, 1)):
        sides = [Window(-along, along, -high, -low), Window(-along, along, low, high)]
        rims.append(_joined([source(angle, _RIM_V, side) for side in sides]))
    return rims


def _joined(sources: Sequence[Source]) -> Source:
    return Source(*(np.concatenate(each) for each in zip(*sources, strict=True)))


def _source_ranges(reading: _Reading, rims: Sequence[Source], reflected: Sequence[Array]) -> list[float]:
    whole = np.array([reading.light.weight @ reading.reflected, reading.light.weight @ reading.light.glass])
    rim = [
        np.array([light.weight @ sent, light.weight @ light.glass]) for light, sent in zip(rims, reflected, strict=True)
    ]
    ends = [(whole - rim[0], whole + rim[1]), (whole - rim[2], whole + rim[3])]
    return [float(50 * (large[0] / large[1] - small[0] / small[1])) for small, large in ends]

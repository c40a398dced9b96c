"""Specular gloss: the aperture double integral on the model, and what the tolerances of the apertures do to it.

G = 100 · ∫source ∫receptor f cos θ_r cos θ_i dω_r dω_i ÷ ∫source F(θ_i; 1.567) cos θ_i dω_i, a polished black glass of index
1.567 being 100. A point source would overstate 20° by 2 to 10 % for narrow lobes, and a stored 1° grid 85° by far more. What a
polished surface mirrors into one single direction arrives whole: the image of the source lies inside the receptor.

References
----------
ASTM D523; ISO 2813; JIS Z 8741; ASTM D4039 (haze, G60 − G20). Conformance is not claimed: results are "D523-style".

The standards are sold, not published. Confirmed by public sources: the receptors' full angles, index 1.567 for 100 units, and the
haze of D4039. Not confirmed, for want of a public copy of their tables: the source image, and the tolerances of the apertures and
of the axes. The standards' light is V(λ) and CIE illuminant C; here it is V(λ)·D65, which differs where a surface is coloured.
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
    all_round,
    centred,
    half_width,
    lobe_scale,
    mean_rule,
    received,
    source,
)
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

RECEPTOR = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}
"""Full angles of the receptor by geometry, in the plane of incidence and across it [degree] (ASTM D523, ISO 2813)."""

SOURCE_TOLERANCE = (0.25, 0.5)
"""± of the full angles of the source image [degree] (ASTM D523; not confirmed)."""

RECEPTOR_TOLERANCE = {20.0: (0.05, 0.1), 60.0: (0.1, 0.2), 85.0: (0.3, 0.3)}
"""± of the full angles of the receptor by geometry [degree] (ASTM D523; not confirmed)."""

AXIS_TOLERANCE = 0.1
"""± of the angle of incidence, and of the receptor's axis from its mirror image [degree] (ASTM D523, ISO 2813; not confirmed)."""

_AXES = (-AXIS_TOLERANCE, AXIS_TOLERANCE)
_POINT, _RIM_U, _RIM_V = (Rule(points, 0) for points in ((1, 1), (1, 4), (3, 1)))
_OWN = 4
"""Tolerances of the receptor and the axes, the first of the six; those of the source follow."""
_ORDER = 3
"""Points in each panel of the receptor, for an uncertainty."""


class GlossError(BrdfpipeError):
    """A gloss geometry is not known."""


class _Sample(NamedTuple):
    bsdf: xr.Dataset
    """Without wavelength."""
    azimuth: float | None
    """Of the plane of incidence [degree]; None for all of them."""
    scale: float
    """Of the lobe [rad]."""


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
    sample = _sample(bsdf, angles, azimuth)
    return _named([_measured(sample, float(angle))[1].mean() for angle in angles], angles, "gloss")


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
    smallest and its largest; the angle of incidence is evaluated at both ends with a point source. To 5 % of the uncertainty, and
    15 % of a lobe as narrow as the source's tolerance (a = 0.003 at 20°).
    """
    values, ranges = _with_ranges(bsdf, angles, azimuth)
    return _named(values, angles, "gloss"), _named(_combined(ranges), angles, "gloss_u")


def gloss_and_haze(bsdf: xr.Dataset, angles: Sequence[float] = (20, 60, 85)) -> xr.Dataset:
    """Gloss and the haze of D4039, with the standard uncertainties that the tolerances of conforming instruments leave.

    Parameters
    ----------
    bsdf, angles : as of :func:`gloss`

    Returns
    -------
    ``gloss(gloss_angle)``, ``gloss_u(gloss_angle)``, ``haze`` (G60 − G20) and ``haze_u`` [1]; haze NaN without both angles

    Notes
    -----
    Both glosses of a haze are taken to be read by one instrument, whose source images are off by the same: what they do to the two
    glosses cancels in part. Receptors and axes are those of each geometry and independent.
    """
    values, ranges = _with_ranges(bsdf, angles, None)
    at = {float(angle): k for k, angle in enumerate(angles)}
    haze = spread = float("nan")
    if {20.0, 60.0} <= set(at):
        low, high = at[20.0], at[60.0]
        haze = values[high] - values[low]
        own = [*ranges[low][:_OWN], *ranges[high][:_OWN]]
        spread = float(_combined(np.concatenate([own, (ranges[high] - ranges[low])[_OWN:]])))
    gloss = {"gloss": _named(values, angles, "gloss"), "gloss_u": _named(_combined(ranges), angles, "gloss_u")}
    title = "standard uncertainty of haze G60 - G20, from tolerances"
    return xr.Dataset(gloss).assign(haze=haze, haze_u=((), spread, {"units": "1", "long_name": title}))


def _with_ranges(bsdf: xr.Dataset, angles: Sequence[float], azimuth: float | None) -> tuple[list[float], Array]:
    """Gloss, and half its range over each of the six tolerances, (angles, tolerances)."""
    sample = _sample(bsdf, angles, azimuth)
    measured = [_measured(sample, float(angle)) for angle in angles]
    values = [float(units.mean()) for _, units in measured]
    ranges = [
        value * _relative_ranges(sample, float(angle), *readings)
        for value, angle, readings in zip(values, angles, measured, strict=True)
    ]
    return values, np.array(ranges).reshape(len(values), _OWN + 2)


def _combined(ranges: Array) -> Array:
    """Standard uncertainty from half the ranges of rectangular distributions, which are the last axis."""
    return np.asarray(np.sqrt(np.sum(ranges**2, axis=-1) / 3))


def _sample(bsdf: xr.Dataset, angles: Sequence[float], azimuth: float | None) -> _Sample:
    vocabulary.validate(bsdf, "bsdf")
    unknown = [angle for angle in angles if float(angle) not in RECEPTOR]
    if unknown:
        raise GlossError(f"no gloss geometry {unknown[0]:g}°; accepted: {', '.join(f'{a:g}' for a in RECEPTOR)}")
    reduced = nonspectral(bsdf)
    if azimuth is None and representation(reduced).isotropic:
        azimuth = 0.0
    return _Sample(reduced, azimuth, lobe_scale(reduced))


def _named(values: Sequence[float] | Array, angles: Sequence[float], name: str) -> xr.DataArray:
    quantity = vocabulary.QUANTITIES["gloss"]
    title = quantity.long_name if name == "gloss" else f"standard uncertainty of {quantity.long_name}, from tolerances"
    return xr.DataArray(
        np.asarray(values, dtype=float),
        dims="gloss_angle",
        coords={"gloss_angle": np.asarray(angles, dtype=float)},
        name=name,
        attrs={"units": quantity.units, "long_name": title},
    )


def _measured(sample: _Sample, angle: float) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence, and gloss units at each."""
    if sample.azimuth is None:
        rule = mean_rule(sample.scale)
        return all_round(lambda azimuths: _read(sample, angle, azimuths, rule), sample.bsdf)
    one = np.array([sample.azimuth])
    return one, _read(sample, angle, one, FINE)


def _read(sample: _Sample, angle: float, azimuths: Array, rule: Rule) -> Array:
    light = source(angle, rule)
    beam = Beam(angle, light, centred(*RECEPTOR[angle]), rule.receptor)
    (scattered,) = received(sample.bsdf, [beam], azimuths, sample.scale)
    return _units(light, _mirrored(sample.bsdf, light, azimuths) + scattered)


def _mirrored(bsdf: xr.Dataset, light: Source, azimuths: Array) -> Array:
    theta, phi = np.broadcast_arrays(light.theta, light.phi + azimuths[:, None])
    return representation(bsdf).specular(theta, phi, None)[0][..., 0]


def _units(light: Source, reflected: Array) -> Array:
    return np.asarray(100 * (reflected @ light.weight) / (light.weight @ light.glass))


# --- tolerances


def _relative_ranges(sample: _Sample, angle: float, azimuths: Array, units: Array) -> Array:
    """Half the range over each of the six tolerances, over the gloss; of a surface with a lay, of the mean over its azimuths."""
    some = slice(-(-azimuths.size // 2))
    known = units[some].mean()
    ranges = _half_ranges(sample, angle, azimuths[some], units[some]).mean(axis=1)
    return np.asarray(ranges / known if known > 0 else np.zeros_like(ranges))


def _half_ranges(sample: _Sample, angle: float, azimuths: Array, units: Array) -> Array:
    """Half the range of the gloss over each of the six tolerances, (tolerances, azimuths); signed, so that means are the mean's."""
    receptor, light = centred(*RECEPTOR[angle]), source(angle, QUICK)
    edges, step = _edges(angle)
    beams = [Beam(angle, light, edge, _ORDER) for edge in edges]
    beams += [Beam(angle, rim, receptor, _ORDER) for rim in _rims(angle)]
    beams += [Beam(angle + off, source(angle + off, _POINT), receptor, _ORDER) for off in _AXES]
    scattered = received(sample.bsdf, beams, azimuths, sample.scale)
    left, right, near, far = (_units(light, flux) / 2 for flux in scattered[:4])
    shifted = (right - left) * float(np.radians(AXIS_TOLERANCE)) / step
    seen = [beam.light for beam in beams[4:]]
    mirrored = _mirrored(sample.bsdf, _joined(seen), azimuths)
    parts = np.split(mirrored, np.cumsum([light_part.u.size for light_part in seen])[:-1], axis=1)
    reflected = [one + other for one, other in zip(parts, scattered[4:], strict=True)]
    less, more = (_units(*beam) for beam in zip(seen[4:], reflected[4:], strict=True))
    both = less + more
    incidence = np.divide(units * (more - less), both, out=np.zeros_like(both), where=both > 0)
    rims = [(sent @ rim.weight, float(rim.weight @ rim.glass)) for rim, sent in zip(seen[:4], reflected, strict=False)]
    whole = (units * (light.weight @ light.glass) / 100, float(light.weight @ light.glass))
    return np.array([left + right, near + far, shifted, incidence, *_source_ranges(whole, rims)])


def _edges(angle: float) -> tuple[list[Window], float]:
    """Strips about the four edges of the receptor, and how far the first two move: by half of what the full angle does."""
    full, tolerance = RECEPTOR[angle], RECEPTOR_TOLERANCE[angle]
    low_u, high_u, low_v, high_v = centred(*full)
    by_u, by_v = (half_width(angle + more) - half_width(angle) for angle, more in zip(full, tolerance, strict=True))
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
    return Source(*(np.concatenate(parts) for parts in zip(*sources, strict=True)))


def _source_ranges(whole: tuple[Array, float], rims: Sequence[tuple[Array, float]]) -> list[Array]:
    """From the light that the sample and black glass send on, of the nominal source and of its four rims."""
    sent, glass = whole
    ranges = []
    for (lost, dark), (gained, bright) in (rims[:2], rims[2:]):
        ranges.append(50 * ((sent + gained) / (glass + bright) - (sent - lost) / (glass - dark)))
    return ranges

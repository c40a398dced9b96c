"""Specular gloss in gloss units: receptors, the ratio to black glass, and the uncertainty from the tolerances of gloss meters.

The double integral over source and receptor is :func:`brdfpipe.appearance.apertures.received`.

G = 100 · ∫source ∫receptor f cos θ_r cos θ_i dω_r dω_i ÷ ∫source F(θ_i; 1.567) cos θ_i dω_i; polished black glass of index 1.567
has 100 units. A point source would overstate 20° by 2 to 10 % for narrow lobes, and a stored 1° grid 85° by far more. Light that
a polished surface mirrors into one single direction arrives completely: the image of the source is inside the receptor.

References
----------
ASTM D523; ISO 2813; JIS Z 8741; ASTM D4039 (haze, G60 − G20). Conformance is not claimed: results are "D523-style".

The standards are sold, not published. Public sources confirm the full angles of the receptors, index 1.567 for 100 units, and the
haze of D4039. They do not confirm the source image or the tolerances of the apertures and of the axes. The light of the standards
is V(λ) and CIE illuminant C; here it is V(λ)·D65, which differs for coloured surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.appearance import apertures
from brdfpipe.appearance.apertures import Beam, Rule, Sample, Source, Window, centred, half_width
from brdfpipe.appearance.tolerances import labelled, standard_uncertainty
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import Reflector
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

_POINT, _RIM_U, _RIM_V = (Rule(points, 0) for points in ((1, 1), (1, 4), (3, 1)))
_GEOMETRY_TOLERANCES, _TOLERANCES = 4, 6
"""Of the six tolerances, the first four (receptor and axes) differ from geometry to geometry; the last two are of the source."""


class GlossError(BrdfpipeError):
    """Unknown gloss geometry."""


def gloss(
    bsdf: xr.Dataset, angles: float | Sequence[float] = (20, 60, 85), *, azimuth: float | None = None
) -> xr.DataArray:
    """Gloss units at the given geometries.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    angles : one or several of 20, 60 and 85 [degree]
    azimuth : of the plane of incidence [degree]; by default the mean over all azimuths, for surfaces with a lay

    Returns
    -------
    DataArray ``gloss(gloss_angle)`` [1]

    Raises
    ------
    GlossError : an unknown geometry.
    """
    sample, gloss_angle = _checked(bsdf, angles, azimuth)
    return labelled("gloss", [_gloss(sample, angle)[1].mean() for angle in gloss_angle], gloss_angle=gloss_angle)


def gloss_with_uncertainty(
    bsdf: xr.Dataset, angles: float | Sequence[float] = (20, 60, 85), *, azimuth: float | None = None
) -> tuple[xr.DataArray, xr.DataArray]:
    """Gloss units, and their standard uncertainty from the tolerances of conforming instruments.

    The tolerances are those of source and receptor, in the plane of incidence and across it, of the angle of incidence, and of the
    axis of the receptor: six independent rectangular distributions. Every instrument is set to 100 on black glass. The uncertainty
    of the BSDF is not included.

    Parameters
    ----------
    bsdf, angles, azimuth : as for :func:`gloss`

    Returns
    -------
    ``gloss(gloss_angle)``, ``gloss_u(gloss_angle)`` [1]

    Notes
    -----
    The part of the receptor is linear in the tolerance, from the light along its edges. The part of the source follows from the rim
    between its smallest and its largest. The angle of incidence is evaluated at both ends with a point source. The uncertainty is
    accurate to 5 %; to 15 % for a lobe as narrow as the tolerance of the source (a = 0.003 at 20°).
    """
    gloss, half_ranges = _with_half_ranges(bsdf, angles, azimuth)
    return gloss, labelled("gloss_u", standard_uncertainty(half_ranges), gloss_angle=gloss["gloss_angle"].values)


def gloss_and_haze(bsdf: xr.Dataset, angles: float | Sequence[float] = (20, 60, 85)) -> xr.Dataset:
    """Gloss and the haze of D4039, with standard uncertainties from the tolerances of conforming instruments.

    Parameters
    ----------
    bsdf, angles : as for :func:`gloss`

    Returns
    -------
    ``gloss(gloss_angle)``, ``gloss_u(gloss_angle)``, ``haze`` (G60 − G20) and ``haze_u`` [1]; haze NaN without both angles

    Notes
    -----
    One instrument reads both gloss values of a haze, and its source image has the same error in both: its effects cancel in part.
    Errors of receptors and axes are independent at each geometry.
    """
    gloss, half_ranges = _with_half_ranges(bsdf, angles, None)
    position = {angle: k for k, angle in enumerate(gloss["gloss_angle"].values.tolist())}
    haze = haze_u = float("nan")
    if {20.0, 60.0} <= set(position):
        low, high = position[20.0], position[60.0]
        haze = float(gloss[high] - gloss[low])
        own = [*half_ranges[low][:_GEOMETRY_TOLERANCES], *half_ranges[high][:_GEOMETRY_TOLERANCES]]
        common = (half_ranges[high] - half_ranges[low])[_GEOMETRY_TOLERANCES:]
        haze_u = float(standard_uncertainty(np.concatenate([own, common])))
    gloss_u = labelled("gloss_u", standard_uncertainty(half_ranges), gloss_angle=gloss["gloss_angle"].values)
    title = "standard uncertainty of haze G60 - G20, from tolerances"
    haze_variables = {"haze": haze, "haze_u": ((), haze_u, {"units": "1", "long_name": title})}
    return xr.Dataset({"gloss": gloss, "gloss_u": gloss_u, **haze_variables})


def _checked(bsdf: xr.Dataset, angles: float | Sequence[float], azimuth: float | None) -> tuple[Sample, list[float]]:
    sample, gloss_angle = apertures.sample_of(bsdf, azimuth), np.atleast_1d(np.asarray(angles, dtype=float)).tolist()
    unknown = [angle for angle in gloss_angle if angle not in RECEPTOR]
    if unknown:
        raise GlossError(
            f"no gloss geometry {unknown[0]:g}°; accepted: {', '.join(f'{a:g}' for a in RECEPTOR)}; set `gloss_angles`"
        )
    return sample, gloss_angle


def _gloss(sample: Sample, angle: float) -> tuple[Array, Array]:
    """Azimuths of the plane of incidence, and gloss units at each."""

    def measure(azimuths: Array, rule: Rule) -> Array:
        return gloss_at(sample, angle, azimuths, rule)

    return apertures.over_azimuths(sample, measure, apertures.FINE)


def gloss_at(sample: Sample, angle: float, azimuths: Array, rule: Rule, reflector: Reflector | None = None) -> Array:
    """Gloss units at azimuths of the plane of incidence [degree], (azimuths,); of the sample, or of a ``reflector`` in its place."""
    beam = beam_of(angle, rule)
    (scattered,) = apertures.received(sample, [beam], azimuths, reflector)
    return gloss_of(sample, beam, scattered, azimuths, reflector)


def beam_of(angle: float, rule: Rule) -> Beam:
    """From the source into the receptor of a geometry [degree]."""
    return Beam(angle, apertures.source(angle, rule), centred(*RECEPTOR[angle]), rule.window)


def gloss_of(
    sample: Sample, beam: Beam, scattered: Array, azimuths: Array, reflector: Reflector | None = None
) -> Array:
    """Gloss units at azimuths, from the scattered light that its receptor has received (:func:`.apertures.received`)."""
    return gloss_of_each(sample, [beam], [scattered], azimuths, reflector)[0]


def gloss_of_each(
    sample: Sample,
    beams: Sequence[Beam],
    scattered: Sequence[Array],
    azimuths: Array,
    reflector: Reflector | None = None,
) -> list[Array]:
    """:func:`gloss_of` of several geometries, whose mirrored light is evaluated together."""
    joined = beams[0].light if len(beams) == 1 else Source.joined([beam.light for beam in beams])
    mirrored = _mirrored_of_each(sample, beams, joined, azimuths, reflector)
    return [
        apertures.gloss_units_of(beam.light, alone + flux)
        for beam, alone, flux in zip(beams, mirrored, scattered, strict=True)
    ]


def _mirrored_of_each(
    sample: Sample, beams: Sequence[Beam], joined: Source, azimuths: Array, reflector: Reflector | None = None
) -> list[Array]:
    """:func:`_mirrored` of the light of each beam, (beams)(azimuths, points), evaluated together; ``joined`` has the points of all."""
    ends = np.cumsum([beam.light.u.size for beam in beams])[:-1]
    return np.split(_mirrored(sample, joined, azimuths, reflector), ends, axis=1)


def _mirrored(sample: Sample, light: Source, azimuths: Array, reflector: Reflector | None = None) -> Array:
    """Share of the light of each source point that is mirrored into one single direction, (azimuths, points)."""
    theta, phi = np.broadcast_arrays(light.theta, light.phi + azimuths[:, None])
    return (representation(sample.bsdf) if reflector is None else reflector).specular(theta, phi, None)[0][..., 0]


# --- tolerances


def _with_half_ranges(
    bsdf: xr.Dataset, angles: float | Sequence[float], azimuth: float | None
) -> tuple[xr.DataArray, Array]:
    """Gloss, and half its range over each of the six tolerances, (angles, tolerances).

    For a surface with a lay, ranges are of the mean over half of the azimuths.
    """
    sample, gloss_angle = _checked(bsdf, angles, azimuth)
    values, ranges = [], []
    for angle in gloss_angle:
        azimuths, by_azimuth = _gloss(sample, angle)
        half = apertures.first_half(azimuths)
        values.append(float(by_azimuth.mean()))
        changes, mean = (
            _half_ranges(sample, angle, azimuths[half], by_azimuth[half]).mean(axis=1),
            by_azimuth[half].mean(),
        )
        ranges.append(values[-1] * (changes / mean if mean > 0 else np.zeros_like(changes)))
    gloss = labelled("gloss", values, gloss_angle=gloss_angle)
    return gloss, np.array(ranges).reshape(len(values), _TOLERANCES)


def _half_ranges(sample: Sample, angle: float, azimuths: Array, gloss_by_azimuth: Array) -> Array:
    """Half the range of gloss over each of the six tolerances, (tolerances, azimuths); signed, so that they can be averaged."""
    edges, others, edge_shift, joined = _tolerance_beams(angle)
    light = apertures.source(angle, apertures.QUICK)
    scattered = apertures.received(sample, [*edges, *others], azimuths)
    # Half the gloss units of the strips at the receptor's edges.
    low_u, high_u, low_v, high_v = (apertures.gloss_units_of(light, flux) / 2 for flux in scattered[:4])
    axis = (high_u - low_u) * float(np.radians(AXIS_TOLERANCE)) / edge_shift
    into_one = _mirrored_of_each(sample, others, joined, azimuths)
    reflected = [alone + flux for alone, flux in zip(into_one, scattered[4:], strict=True)]
    below, above = (
        apertures.gloss_units_of(beam.light, flux) for beam, flux in zip(others[4:], reflected[4:], strict=True)
    )
    total = below + above
    incidence = np.divide(gloss_by_azimuth * (above - below), total, out=np.zeros_like(total), where=total > 0)
    glass = float(light.weight @ light.glass)
    nominal = gloss_by_azimuth * (light.weight @ light.glass) / 100, glass
    rims = [
        (flux @ beam.light.weight, float(beam.light.weight @ beam.light.glass))
        for beam, flux in zip(others[:4], reflected, strict=False)
    ]
    return np.array([low_u + high_u, low_v + high_v, axis, incidence, *_source_half_ranges(nominal, rims)])


class _ToleranceBeams(NamedTuple):
    """The light that changes with the tolerances of a meter; the same for all materials."""

    edges: list[Beam]
    """Into the strips at the edges of the receptor"""
    others: list[Beam]
    """Into the receptor: from the four rims of the source, then from a point at either end of the tolerance of the incidence"""
    edge_shift: float
    """How far the first two edges move"""
    joined: Source
    """The lights of ``others``"""


@lru_cache(maxsize=8)
def _tolerance_beams(angle: float) -> _ToleranceBeams:
    receptor, light = centred(*RECEPTOR[angle]), apertures.source(angle, apertures.QUICK)
    edges, edge_shift = _receptor_edges(angle)
    moved = [angle + end * AXIS_TOLERANCE for end in (-1, 1)]
    lights = [
        *((angle, rim) for rim in _source_rims(angle)),
        *((other, apertures.source(other, _POINT)) for other in moved),
    ]
    return _ToleranceBeams(
        [Beam(angle, light, edge, apertures.UNCERTAINTY_ORDER) for edge in edges],
        [Beam(other, other_light, receptor, apertures.UNCERTAINTY_ORDER) for other, other_light in lights],
        edge_shift,
        Source.joined([other_light for _, other_light in lights]),
    )


def _receptor_edges(angle: float) -> tuple[list[Window], float]:
    """Strips about the four edges of the receptor, as wide as its full angles may change, and how far the first two edges move."""
    full, tolerance = RECEPTOR[angle], RECEPTOR_TOLERANCE[angle]
    low_u, high_u, low_v, high_v = centred(*full)
    by_u, by_v = (half_width(angle + more) - half_width(angle) for angle, more in zip(full, tolerance, strict=True))
    edges = [Window(at - by_u, at + by_u, low_v, high_v) for at in (low_u, high_u)]
    edges += [Window(low_u, high_u, at - by_v, at + by_v) for at in (low_v, high_v)]
    return edges, by_u


def _source_rims(angle: float) -> list[Source]:
    """The rims from the smallest source to the nominal one, and from it to the largest: in the plane of incidence, then across."""
    (full_u, full_v), (more_u, more_v) = apertures.SOURCE, SOURCE_TOLERANCE
    half_u, half_v = half_width(full_u), half_width(full_v)
    rims = []
    for low, high in pairwise(half_width(full_u + end * more_u) for end in (-1, 0, 1)):
        sides = [Window(-high, -low, -half_v, half_v), Window(low, high, -half_v, half_v)]
        rims.append(Source.joined([apertures.source(angle, _RIM_U, side) for side in sides]))
    for low, high in pairwise(half_width(full_v + end * more_v) for end in (-1, 0, 1)):
        sides = [Window(-half_u, half_u, -high, -low), Window(-half_u, half_u, low, high)]
        rims.append(Source.joined([apertures.source(angle, _RIM_V, side) for side in sides]))
    return rims


def _source_half_ranges(nominal: tuple[Array, float], rims: Sequence[tuple[Array, float]]) -> list[Array]:
    """Half ranges of gloss from the light that sample and black glass reflect, of the nominal source and of its four rims."""
    reflected, glass = nominal
    return [
        50 * ((reflected + gained) / (glass + glass_gained) - (reflected - lost) / (glass - glass_lost))
        for (lost, glass_lost), (gained, glass_gained) in (rims[:2], rims[2:])
    ]

"""Specular gloss and haze: the aperture double integral on the model.

G = 100 · ∫source ∫receptor f cos θ_r cos θ_i dω_r dω_i ÷ ∫source F(θ_i; 1.567) cos θ_i dω_i, a polished black glass of index
1.567 being 100. A point source would overstate 20° by 2 to 10 % for narrow lobes, and a stored 1° grid 85° by far more. What a
polished surface mirrors into one single direction arrives whole: the image of the source lies inside the receptor.

References
----------
ASTM D523 (apertures); ASTM D4039 (haze). Conformance is not claimed: results are "D523-style".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import optics, vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, angles_of
from brdfpipe.hemisphere import graded_edges, panel_rule

REFERENCE_INDEX = 1.567

SOURCE = (0.75, 2.5)
"""Full angles of the source image, in the plane of incidence and across it [degree]."""

RECEPTOR = {20.0: (1.8, 3.6), 60.0: (4.4, 11.7), 85.0: (4.0, 6.0)}
"""Full angles of the receptor by geometry, in the plane of incidence and across it [degree]."""

_NARROW = 1e-4
_FAINTEST = 1e-12
_FIRST_AZIMUTHS, _MOST_AZIMUTHS = 16, 256
_MEAN_ERROR = 1e-3


class Rule(NamedTuple):
    """Points of the quadrature."""

    source: tuple[int, int]
    """In the plane of incidence and across it."""
    receptor: int
    """In each panel."""


FINE = Rule((6, 10), 6)
QUICK = Rule((3, 4), 4)
"""To 1e-4 of the gloss, for means over many azimuths."""


class GlossError(BrdfpipeError):
    """A gloss geometry is not known."""


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
    vocabulary.validate(bsdf, "bsdf")
    unknown = [angle for angle in angles if float(angle) not in RECEPTOR]
    if unknown:
        raise GlossError(f"no gloss geometry {unknown[0]:g}°; accepted: {', '.join(f'{a:g}' for a in RECEPTOR)}")
    reduced = representations.nonspectral(bsdf)
    if azimuth is None and not representations.isotropic(bsdf):
        values = [_mean_gloss(reduced, float(angle)) for angle in angles]
    else:
        values = [_gloss(reduced, float(angle), azimuth or 0.0) for angle in angles]
    quantity = vocabulary.QUANTITIES["gloss"]
    return xr.DataArray(
        values,
        dims="gloss_angle",
        coords={"gloss_angle": np.asarray(angles, dtype=float)},
        name="gloss",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def _mean_gloss(bsdf: xr.Dataset, angle: float) -> float:
    """Mean over the azimuth of the plane of incidence: at 85° a fine lay shows within a few degrees of its own."""
    count, known = _FIRST_AZIMUTHS, np.array([_gloss(bsdf, angle, turn, QUICK) for turn in _turns(_FIRST_AZIMUTHS)])
    while True:
        between = np.array([_gloss(bsdf, angle, turn, QUICK) for turn in _turns(count) + 180 / count])
        settled = abs(between.mean() - known.mean()) <= 2 * _MEAN_ERROR * known.mean()
        known, count = np.concatenate([known, between]), 2 * count
        if settled or count >= _MOST_AZIMUTHS:
            return float(known.mean())


def _turns(count: int) -> Array:
    return np.arange(0.0, 360.0, 360 / count)


def _gloss(bsdf: xr.Dataset, angle: float, azimuth: float = 0.0, rule: Rule = FINE) -> float:
    source_u, source_v, source_weight = _rectangle(rule)
    theta_i, phi_i = _directions(source_u, source_v, angle)
    cos_i = np.cos(np.radians(theta_i))
    black_glass = np.sum(source_weight * optics.fresnel(cos_i, REFERENCE_INDEX)[2] * cos_i)
    mirrored = representations.specular(bsdf, theta_i, phi_i + azimuth, None)[0][:, 0]
    received = mirrored + _received(bsdf, angle, source_u, source_v, theta_i, phi_i, azimuth, rule)
    return float(100 * np.sum(source_weight * cos_i * received) / black_glass)


def _received(
    bsdf: xr.Dataset,
    angle: float,
    source_u: Array,
    source_v: Array,
    theta_i: Array,
    phi_i: Array,
    azimuth: float,
    rule: Rule,
) -> Array:
    """∫receptor f cos θ_r dω_r for every point of the source, the plane of incidence turned by the azimuth.

    The receptor's axis is the mirror image of the source's, so the mirror direction of source point (u, v) is (u, v) of the
    receptor; panels are graded towards it, on the scale of the lobe.
    """
    half_u, half_v = (_half_width(width) for width in RECEPTOR[angle])
    scale = _lobe_scale(bsdf, angle, azimuth)
    across = max(scale * np.cos(np.radians(angle)), 1e-9)
    u, weight_u = panel_rule(graded_edges(source_u, scale, -half_u, half_u, _doublings(half_u, scale)), rule.receptor)
    v, weight_v = panel_rule(graded_edges(source_v, across, -half_v, half_v, _doublings(half_v, across)), rule.receptor)
    u, v = np.broadcast_arrays(u[:, :, None], v[:, None, :])
    weight = weight_u[:, :, None] * weight_v[:, None, :] / (1 + u**2 + v**2) ** 1.5
    # Panels clipped to the rectangle have no width: most of them, for every single source point.
    used = weight > 0
    theta_o, phi_o = _directions(u[used], v[used], angle)
    owner = np.nonzero(used)[0]
    turned = phi_i[owner] + azimuth, phi_o + 180 + azimuth
    brdf = representations.representation(bsdf).evaluate(bsdf, theta_i[owner], turned[0], theta_o, turned[1], None)
    flux = weight[used] * brdf[:, 0] * np.cos(np.radians(theta_o))
    return np.bincount(owner, flux, minlength=source_u.size).astype(float)


def _rectangle(rule: Rule = FINE) -> tuple[Array, Array, Array]:
    half_u, half_v = (_half_width(width) for width in SOURCE)
    u, weight_u = panel_rule([-half_u, half_u], rule.source[0])
    v, weight_v = panel_rule([-half_v, half_v], rule.source[1])
    u, v = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    return u, v, np.outer(weight_u, weight_v).ravel() / (1 + u**2 + v**2) ** 1.5


def _half_width(full_angle: float) -> float:
    """Half width of an aperture in the tangent plane of its axis."""
    return float(np.tan(np.radians(full_angle) / 2))


def _directions(u: Array, v: Array, angle: float) -> tuple[Array, Array]:
    """θ and φ of points of the tangent plane of the axis (angle, 0); u lies in the plane of incidence and grows with θ."""
    sin, cos = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    return angles_of(np.stack([sin + u * cos, v, cos - u * sin], axis=-1))


def _doublings(half_width: float, scale: float) -> int:
    """Panels that double in width from half the scale until they cover the whole aperture, however narrow the lobe."""
    return int(np.clip(np.ceil(np.log2(4 * half_width / scale)), 4, 40))


def _lobe_scale(bsdf: xr.Dataset, angle: float, azimuth: float) -> float:
    """Half the half width of the specular lobe in radian, a typical slope; a moderate one where the lobe is not known."""
    slope = representations.lobe_slope(bsdf)
    if slope is None or (slope < _NARROW and not _peaks(bsdf, angle, azimuth)):
        return 0.02
    return float(np.clip(slope, 1e-6, 0.2))


def _peaks(bsdf: xr.Dataset, angle: float, azimuth: float) -> bool:
    """Whether the BSDF is any larger in the mirror direction than a degree beside it: a polished surface's is not."""
    at, beside = representations.representation(bsdf).evaluate(
        bsdf, np.full(2, angle), np.full(2, azimuth), np.array([angle, angle - 1]), np.full(2, azimuth + 180), None
    )[:, 0]
    return bool(at > 2 * beside and at > _FAINTEST)

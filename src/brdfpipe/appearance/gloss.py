"""Specular gloss and haze: the aperture double integral on the model.

G = 100 · ∫source ∫receptor f cos θ_r cos θ_i dω_r dω_i ÷ ∫source F(θ_i; 1.567) cos θ_i dω_i, a polished black glass of index
1.567 being 100. A point source would overstate 20° by 2 to 10 % for narrow lobes, and a stored 1° grid 85° by far more.

References
----------
ASTM D523 (apertures); ASTM D4039 (haze). Conformance is not claimed: results are "D523-style".
"""

from __future__ import annotations

from collections.abc import Sequence

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

_SOURCE_ORDER = (6, 10)
_ORDER = 6


class GlossError(BrdfpipeError):
    """A gloss geometry is not known."""


def gloss(bsdf: xr.Dataset, angles: Sequence[float] = (20, 60, 85)) -> xr.DataArray:
    """Gloss units at the given geometries.

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    angles : degree, among 20, 60 and 85

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
    values = [_gloss(reduced, float(angle)) for angle in angles]
    quantity = vocabulary.QUANTITIES["gloss"]
    return xr.DataArray(
        values,
        dims="gloss_angle",
        coords={"gloss_angle": np.asarray(angles, dtype=float)},
        name="gloss",
        attrs={"units": quantity.units, "long_name": quantity.long_name},
    )


def _gloss(bsdf: xr.Dataset, angle: float) -> float:
    source_u, source_v, source_weight = _rectangle(angle)
    theta_i, phi_i = _directions(source_u, source_v, angle)
    cos_i = np.cos(np.radians(theta_i))
    black_glass = np.sum(source_weight * optics.fresnel(cos_i, REFERENCE_INDEX)[2] * cos_i)
    received = _received(bsdf, angle, source_u, source_v, theta_i, phi_i)
    return float(100 * np.sum(source_weight * cos_i * received) / black_glass)


def _received(bsdf: xr.Dataset, angle: float, source_u: Array, source_v: Array, theta_i: Array, phi_i: Array) -> Array:
    """∫receptor f cos θ_r dω_r for every point of the source.

    The receptor's axis is the mirror image of the source's, so the mirror direction of source point (u, v) is (u, v) of the
    receptor; panels are graded towards it, on the scale of the lobe.
    """
    half_u, half_v = (_half_width(width) for width in RECEPTOR[angle])
    scale = _lobe_scale(bsdf)
    across = max(scale * np.cos(np.radians(angle)), 1e-9)
    u, weight_u = panel_rule(graded_edges(source_u, scale, -half_u, half_u, _doublings(half_u, scale)), _ORDER)
    v, weight_v = panel_rule(graded_edges(source_v, across, -half_v, half_v, _doublings(half_v, across)), _ORDER)
    u, v = np.broadcast_arrays(u[:, :, None], v[:, None, :])
    weight = weight_u[:, :, None] * weight_v[:, None, :] / (1 + u**2 + v**2) ** 1.5
    # Panels clipped to the rectangle have no width: most of them, for every single source point.
    used = weight > 0
    theta_o, phi_o = _directions(u[used], v[used], angle)
    owner = np.nonzero(used)[0]
    brdf = representations.representation(bsdf).evaluate(bsdf, theta_i[owner], phi_i[owner], theta_o, phi_o + 180, None)
    flux = weight[used] * brdf[:, 0] * np.cos(np.radians(theta_o))
    return np.bincount(owner, flux, minlength=source_u.size).astype(float)


def _rectangle(angle: float) -> tuple[Array, Array, Array]:
    half_u, half_v = (_half_width(width) for width in SOURCE)
    u, weight_u = panel_rule([-half_u, half_u], _SOURCE_ORDER[0])
    v, weight_v = panel_rule([-half_v, half_v], _SOURCE_ORDER[1])
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


def _lobe_scale(bsdf: xr.Dataset) -> float:
    """Half the half width of the specular lobe in radian, a typical slope; a moderate one where the lobe is not known."""
    slope = representations.lobe_slope(bsdf)
    return 0.02 if slope is None else float(np.clip(slope, 1e-6, 0.2))

"""BTDF and directional transmittance of a rough interface.

f_t = |i·h||o·h| / (|cos θ_i||cos θ_o|) · n_o² (1 − F) D G2 / (n_i i·h + n_o o·h)², h ∝ n_i w_i + n_o w_o. f_t is radiance over
irradiance. f_t / n_o² is reciprocal, because refraction into a body of index n compresses the solid angle and increases the radiance by
n².

References
----------
Walter 2007 (EGSR), eqs. 16 and 21; Heitz 2014 (JCGT 3(2)) for the masking; for directions on opposite sides its height-correlated form
is G2 = B(1 + Λ_i, 1 + Λ_o) with B Euler's beta function (Dupuy et al. 2016).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import beta

from brdfpipe.bsdf.microfacet import anisotropic_quadrature as quadrature
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.radial_density import PANELS, RadialDensity
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel

_AZIMUTHS, _CROWDED_AZIMUTHS = 16, 6
"""Nodes of the quadrature over the azimuths of a panel, and of the narrow panels that crowd about the critical angle."""
_NEGLIGIBLE = 1e-14
"""Weight of facets over the largest, below which a quadrature leaves them out."""
_LEAST_COSINE = 1e-12


MASKING: dict[str, Callable[[Array, Array], Array]] = {
    "height-correlated": lambda lambda_i, lambda_o: np.asarray(beta(1 + lambda_i, 1 + lambda_o)),
    "separable": lambda lambda_i, lambda_o: 1 / ((1 + lambda_i) * (1 + lambda_o)),
    "crf": lambda lambda_i, lambda_o: 1 / (1 + lambda_o),
    "none": lambda lambda_i, lambda_o: np.ones_like(lambda_i),
}
"""G2 of directions on opposite sides, from Λ of both; not defined for V-grooves (``blinn``, ``liu``)."""


def transmitted(
    surface: Microsurface, masking: str, index: float, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array
) -> Array:
    """BTDF of the facets [sr-1], of the shape of the angles.

    Parameters
    ----------
    surface : the facets, seen from above
    masking : a key of :data:`MASKING`
    index : of the body below, relative to the medium above
    theta_i, phi_i, theta_o, phi_o : degree; one of the polar angles is below 90, the other above
    """
    w_i, w_o = unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)
    from_above = theta_i < 90
    n_i, n_o = np.where(from_above, 1.0, index), np.where(from_above, index, 1.0)
    h = n_i[..., None] * w_i + n_o[..., None] * w_o
    length, up = np.linalg.norm(h, axis=-1), np.sign(h[..., 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        m = h * (up / length)[..., None]
        slope_x, slope_y = -m[..., 0] / m[..., 2], -m[..., 1] / m[..., 2]
    i_m, o_m = (w_i * m).sum(axis=-1), (w_o * m).sum(axis=-1)
    side = np.where(from_above, 1.0, -1.0)
    # Each direction is on the same side of the facet as of the surface.
    valid = (i_m * side > 0) & (o_m * side < 0) & np.isfinite(slope_x) & np.isfinite(slope_y)
    slope_x, slope_y = np.where(valid, slope_x, 0.0), np.where(valid, slope_y, 0.0)
    cos_m = np.abs(np.where(valid, np.clip(i_m, -1.0, 1.0), 1.0))
    transmittance = np.where(valid, 1 - fresnel(cos_m, n_o / n_i).mean, 0.0)
    spread = (1 + slope_x**2 + slope_y**2) ** 2
    masked = MASKING[masking](
        _smith_lambda(surface, theta_i, phi_i, from_above), _smith_lambda(surface, theta_o, phi_o, ~from_above)
    )
    cosines = np.maximum(np.abs(w_i[..., 2] * w_o[..., 2]), _LEAST_COSINE)
    denominator = np.where(valid, (n_i * i_m + n_o * o_m) ** 2, 1.0)
    facets = surface.density_at(slope_x, slope_y) * spread * masked
    return np.asarray(np.abs(i_m * o_m) / cosines * n_o**2 * transmittance * facets / denominator)


def _smith_lambda(surface: Microsurface, theta: Array, phi: Array, above: NDArray[np.bool_]) -> Array:
    """Λ towards directions above the surface, or below it, where the slopes change sign."""
    cos = np.maximum(np.abs(np.cos(np.radians(theta))), _LEAST_COSINE)
    sin = np.abs(np.sin(np.radians(theta)))
    return np.asarray(surface.excess(cos, sin, phi + np.where(above, 0.0, 180.0)) * sin / cos)


def directional_transmittance(
    surface: Microsurface,
    masking: str,
    index: Array,
    theta_i: Array,
    phi_i: Array | float = 0.0,
    *,
    panels: int = PANELS,
) -> Array:
    """Directional transmittance of the facets, (incidences, wavelength).

    Parameters
    ----------
    surface : the facets, seen from above
    masking : a key of :data:`MASKING`
    index : (wavelength,) of the body below, relative to the medium above
    theta_i, phi_i : (incidences,) degree; above 90 from within the body
    panels : of the slopes of an isotropic surface

    Notes
    -----
    T = ∫∫ P22 (1 − F) G2 (cos θ_i − p̃ sin θ_i) / cos θ_i dp dq over the facets that face the light and refract it to the other side.
    """
    azimuth = np.broadcast_to(np.asarray(phi_i, dtype=float), theta_i.shape)
    result = np.empty((theta_i.size, index.size))
    distinct, where = np.unique(index, return_inverse=True)
    for row, (theta, phi) in enumerate(zip(theta_i, azimuth, strict=True)):
        below = theta > 90
        # Seen from below the slopes change sign, as if the surface were turned by 180 degree.
        polar, around = (180 - theta, phi + 180) if below else (theta, phi)
        around = 0.0 if surface.isotropic else around
        values = []
        for ratio in 1 / distinct if below else distinct:
            facets = _facets_facing(surface, polar, around, float(np.arcsin(ratio)) if ratio < 1 else None, panels)
            values.append(_facet_transmittance(surface, masking, float(ratio), polar, around, facets))
        result[row] = np.array(values)[where]
    return result


def _facets_facing(
    surface: Microsurface, theta: float, phi: float, critical: float | None, panels: int
) -> tuple[Array, Array, Array]:
    """Slopes along x and y of the facets of a quadrature that face (θ, φ), and their shares; φ = 0 of an isotropic surface."""
    if not isinstance(surface.density, RadialDensity):
        at = np.array([theta]), np.array([phi])
        p, q, share = quadrature.facet_rule(surface.density, *at, critical, mirroring=False)
        return p[0], q[0], share[0]
    cot = 1 / np.tan(np.radians(max(theta, 1e-9)))
    reach = surface.density.slope[-1]
    edges = np.append(surface.density.panels(panels), min(cot, reach))
    if critical is not None:
        splits = energy.slopes_of_total_reflection(np.radians([theta]), critical, reach)[0]
        edges = np.concatenate([edges, splits])
    s, ds = panel_rule(np.sort(edges), 4)
    start = np.arccos(np.clip(cot / s, -1.0, 1.0))
    # In the second of the two panels few facets are steep enough to contribute.
    around = np.stack([start, (start + np.pi) / 2, np.full_like(start, np.pi)], axis=-1)
    if critical is not None:
        around = energy.azimuths_of_total_reflection(around, s, np.radians(theta), critical)
    turn, weight = panel_rule(around, _AZIMUTHS if critical is None else _CROWDED_AZIMUTHS)
    share = 2 * weight * (surface.density(s**2) * s * ds)[:, None]
    row, column = np.nonzero(share > _NEGLIGIBLE * share.max())
    s, turn = s[row], turn[row, column]
    return s * np.cos(turn), s * np.sin(turn), share[row, column]


def _facet_transmittance(
    surface: Microsurface, masking: str, ratio: float, theta: float, phi: float, facets: tuple[Array, Array, Array]
) -> float:
    """Transmittance for light from (θ, φ), with ``ratio`` the index of the other medium over that of its own."""
    cos_i, sin_i = max(np.cos(np.radians(theta)), _LEAST_COSINE), np.sin(np.radians(theta))
    p, q, share = facets
    azimuth = np.radians(phi)
    root = np.sqrt(1 + p * p + q * q)
    towards = cos_i - (p * np.cos(azimuth) + q * np.sin(azimuth)) * sin_i
    cos_m = np.clip(towards / root, 0.0, 1.0)
    inside = 1 - (1 - cos_m**2) / ratio**2
    refracted = cos_m / ratio - np.sqrt(np.maximum(inside, 0.0))
    o_x = -refracted * p / root - sin_i * np.cos(azimuth) / ratio
    o_y = -refracted * q / root - sin_i * np.sin(azimuth) / ratio
    o_z = refracted / root - cos_i / ratio
    valid = (towards > 0) & (inside > 0) & (o_z < 0)
    cos_o = np.clip(-o_z, _LEAST_COSINE, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    lambda_i = surface.excess(np.asarray(cos_i), np.asarray(sin_i), phi) * sin_i / cos_i
    phi_o = np.degrees(np.arctan2(o_y, o_x)) + 180
    lambda_o = surface.excess(cos_o, sin_o, phi_o) * sin_o / cos_o
    transmittance = 1 - fresnel(cos_m, ratio).mean
    weight = share * transmittance * MASKING[masking](lambda_i + 0 * lambda_o, lambda_o) * towards / cos_i
    return float(weight[valid].sum())

"""Quadrature over the facets of a surface with a lay that one direction meets, and azimuths that resolve its albedo.

Scaled by the two principal widths, the slope density is nearly round: with x = r cos t along the lay and y = r sin t across it, the
slope towards the light is w r cos(t − ω), and facets of one t mirror it above the horizon up to one r. The rule ends there, so that
its integrand is smooth.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ellipj, ellipkm1, elliprf

from brdfpipe.facets.planar_density import Ellipse, PlanarDensity
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

_PANELS_A_QUARTER = 4
_AROUND_ORDER = 5
_RADIAL_CORE = np.arange(0.0, 3.1, 0.5)
_RADIAL_GROWTH = 1.6
_RADIAL_ORDER = 4
_SHARPEST = 0.03
_LEAST_COSINE = 1e-150
_TOWARDS_KINK = np.concatenate([-(4.0 ** -np.arange(1, 6)), [0.0], 4.0 ** -np.arange(5, 0, -1)])


def facet_rule(
    density: PlanarDensity, theta: Array, phi: Array, critical: float | None = None, *, mirroring: bool = True
) -> tuple[Array, Array, Array]:
    """Slopes along x and y of the facets of a quadrature and their shares, (incidences, facets) each, for θ and φ in degree.

    The rule is split at the ``critical`` angle of total reflection on the facet [rad]. If ``mirroring``, it covers only facets that mirror
    the light above the horizon; otherwise all that face it.
    """
    ellipse = density.ellipse
    width, turn = ellipse.towards(phi)
    cos_i, sin_i = np.maximum(np.cos(np.radians(theta)), _LEAST_COSINE), np.sin(np.radians(theta))
    t, dt = _azimuthal_rule(ellipse, width, np.radians(turn), cos_i, sin_i, 1 if critical is None else 2)
    x, y = np.cos(t), np.sin(t)
    squared = (ellipse.along * x) ** 2 + (ellipse.across * y) ** 2
    towards = (width * sin_i)[:, None] * np.cos(t - np.radians(turn)[:, None])
    cos_i = np.broadcast_to(cos_i[:, None], t.shape)
    reach = density.along.reach / density.along.scale / np.maximum(np.abs(x), np.abs(y))
    end = np.arcsinh(np.minimum(_horizon_radius(cos_i, towards, squared if mirroring else None), reach))
    edges = end[..., None] * _radial_edges(float(np.arcsinh(reach.max())))
    if critical is not None:
        kinks = (
            np.arcsinh(_critical_radii(critical, cos_i, towards, squared))[..., None]
            + end[..., None, None] * _TOWARDS_KINK
        )
        crowding = np.clip(kinks, 0.0, end[..., None, None]).reshape(*end.shape, -1)
        edges = np.sort(np.concatenate([edges, crowding], axis=-1), axis=-1)
    v, dv = panel_rule(edges, _RADIAL_ORDER)
    r = np.sinh(v)
    along, across = ellipse.along * r * x[..., None], ellipse.across * r * y[..., None]
    area = ellipse.along * ellipse.across * r * np.cosh(v) * dv * dt[..., None]
    share = density.principal(along, across) * area / density.moments[0]
    cos, sin = np.cos(np.radians(ellipse.lay)), np.sin(np.radians(ellipse.lay))
    p, q = along * cos - across * sin, along * sin + across * cos
    count = theta.size
    return p.reshape(count, -1), q.reshape(count, -1), share.reshape(count, -1)


def _azimuthal_rule(
    ellipse: Ellipse, width: Array, turn: Array, cos_i: Array, sin_i: Array, finer: int
) -> tuple[Array, Array]:
    """Rule over t, (incidences, T): panels are dense where facets are edge-on to the light, and end on the axes."""
    sideways = np.hypot(ellipse.along * np.sin(turn), ellipse.across * np.cos(turn))
    with np.errstate(divide="ignore"):
        sharp = np.clip(cos_i * sideways / (width * sin_i), _SHARPEST, 1.0)[:, None]
    steps = np.linspace(-1, 1, 2 * _PANELS_A_QUARTER * finer + 1)
    offset = sharp * np.sinh(steps * np.arcsinh(np.pi / 2 / sharp))
    first = (turn - np.pi)[:, None]
    edges = np.concatenate([first + np.pi / 2 + offset, first + 3 * np.pi / 2 + offset], axis=1)
    axes = first + (np.arange(4) * np.pi / 2 - first) % (2 * np.pi)
    return panel_rule(np.sort(np.concatenate([edges, axes], axis=1), axis=1), _AROUND_ORDER)


def _radial_edges(end: float) -> Array:
    """Panel edges in asinh r, as shares of the last: uniform where most facets are, then widening to the ends of the tails."""
    tail = _RADIAL_CORE[-1] + np.cumsum(np.diff(_RADIAL_CORE)[0] * _RADIAL_GROWTH ** np.arange(1, 13))
    edges = np.concatenate([_RADIAL_CORE, tail])
    last = min(int(np.searchsorted(edges, end)), edges.size - 1)
    return edges[: last + 1] / edges[last]


def _horizon_radius(cos_i: Array, towards: Array, squared: Array | None) -> Array:
    """Largest r of facets that face the light and, of given s²/r², mirror it upwards: 2 r p̃ sin θ_i < (1 − s²) cos θ_i."""
    with np.errstate(divide="ignore", over="ignore"):
        if squared is None:
            return np.where(towards > 0, cos_i / np.maximum(towards, _LEAST_COSINE), np.inf)
        root = np.hypot(towards, np.sqrt(squared) * cos_i)
        # Either form of the root of the quadratic equation, so that no digits cancel.
        return np.where(towards > 0, cos_i / (root + np.abs(towards)), (root - towards) / (squared * cos_i))


def _critical_radii(critical: float, cos_i: Array, towards: Array, squared: Array) -> Array:
    """Up to two r ≥ 0, (…, 2), of facets met at an angle [rad]: cos θ_i − r p̃ sin θ_i = cos ζ √(1 + s²); 0 for none."""
    cos_c = np.cos(critical)
    a, b, c = towards**2 - cos_c**2 * squared, -towards * cos_i, cos_i**2 - cos_c**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        both = np.stack([(-b - root) / a, (-b + root) / a], axis=-1)
    return np.clip(np.nan_to_num(both, nan=0.0, posinf=0.0, neginf=0.0), 0.0, None)


def is_symmetric(density: PlanarDensity) -> bool:
    """Whether the density is symmetric about both axes, so that one quarter of the azimuths determines the others."""
    values = density.density
    return bool(np.allclose(values, values[::-1], rtol=1e-12) and np.allclose(values, values[:, ::-1], rtol=1e-12))


# --- azimuths


def azimuth_to_arc(ellipse: Ellipse, azimuth: Array | float) -> Array:
    """Arc [degree], in [0, 360), of an azimuth from the wider axis: ∫ dφ / w(φ), scaled to 90 for a quarter.

    It resolves the change of the width w of the slopes from wide to narrow at any ratio.
    """
    ratio, wide = axis_ratio(ellipse)
    angle = np.asarray(azimuth, dtype=float) - wide
    halves = np.round(angle / 180)
    rest = np.radians(angle - 180 * halves)
    sin, cos = np.sin(rest), np.cos(rest)
    # Carlson's form, because scipy's ellipkinc takes a wrong branch at isolated angles.
    arc = sin * elliprf(cos**2, cos**2 + (ratio * sin) ** 2, 1.0)
    return np.asarray((90 * arc / ellipkm1(ratio**2) + 180 * halves) % 360)


def arc_to_azimuth(ellipse: Ellipse, arc: Array) -> Array:
    """Azimuths [degree] of arcs, in their order; the inverse of :func:`azimuth_to_arc`."""
    ratio, wide = axis_ratio(ellipse)
    return np.asarray(wide + np.degrees(ellipj(arc / 90 * ellipkm1(ratio**2), 1 - ratio**2)[3]))


def quarter_arc(ellipse: Ellipse) -> float:
    """∫ dφ / w over a quarter, times the larger width [degree]: 90 for a circle, growing as the logarithm of the ratio."""
    return float(np.degrees(ellipkm1(axis_ratio(ellipse)[0] ** 2)))


def axis_ratio(ellipse: Ellipse) -> tuple[float, float]:
    """Smaller over larger width, and azimuth of the larger."""
    along_is_wide = ellipse.along >= ellipse.across
    ratio = min(ellipse.along, ellipse.across) / max(ellipse.along, ellipse.across)
    return ratio, ellipse.lay + (0.0 if along_is_wide else 90.0)

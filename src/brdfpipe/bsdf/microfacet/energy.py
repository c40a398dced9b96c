"""How much of the light the facets reflect: directional albedo, its mean, and its table.

The albedo is integrated over the facets instead of the outgoing directions,
E = ∫∫ P22 F G2 (cos θ_i − p̃ sin θ_i) / cos θ_i dp dq over facets that mirror upwards, so that a narrow lobe costs no more than
a wide one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RectBivariateSpline

from brdfpipe.bsdf.microfacet import anisotropic_quadrature as quadrature
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.piecewise import PiecewiseCubic

Reflectance = Callable[[Array, ArrayLike, ArrayLike], Array]
"""Reflectance of a facet from (cos ζ, n, k)."""

_AZIMUTHS = 12
_WINDOW_PANELS = 8
_INDEX_DIGITS = np.log(1e10)
_LEAST_COSINE = 1e-150

_INTERPOLATION = 2e-9
_NOISE = 1e-9
_MOST_NODES = 400
_LAY_STEP = 0.2
_LAY_AZIMUTH = 18.0
_LAY_FINENESS = 8.0
_LAY_MOST_GRAZING = 2.0


def fresnel_mean(cos_zeta: Array, n: ArrayLike, k: ArrayLike) -> Array:
    """Reflectance of a facet for unpolarised light."""
    return fresnel(cos_zeta, n, k).mean


def perfect_mirror(cos_zeta: Array, n: ArrayLike, k: ArrayLike) -> Array:
    """A facet that reflects everything: the furnace."""
    return np.ones_like(cos_zeta)


def directional_albedo(
    surface: Microsurface,
    masking: str,
    n: Array,
    k: Array,
    theta_i: Array,
    phi_i: Array | float = 0.0,
    reflectance: Reflectance = fresnel_mean,
) -> Array:
    """Directional albedo E of the facets' single reflection, (incidences, wavelength).

    Parameters
    ----------
    surface : the facets
    masking : one of :data:`brdfpipe.bsdf.microfacet.microsurface.MASKINGS`
    n, k : (wavelength,) index relative to the medium of incidence
    theta_i, phi_i : (incidences,) in degree, 0 <= theta_i <= 90; the azimuth matters to a surface with a lay
    reflectance : of a facet; Fresnel's for unpolarised light by default
    """
    theta_i = np.asarray(theta_i, dtype=float)
    if n.size > 1 and ((n < 1) & (k == 0)).any():
        # Total reflection begins elsewhere for every index.
        pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
        alone = [
            directional_albedo(surface, masking, each[:1], each[1:], theta_i, phi_i, reflectance) for each in pairs.T
        ]
        return np.concatenate(alone, axis=1)[:, where.ravel()]
    critical = float(np.arcsin(n[0])) if n[0] < 1 and k[0] == 0 else None
    blocks = []
    step = 64 if surface.isotropic and critical is None else 8
    azimuth = np.broadcast_to(np.asarray(phi_i, dtype=float), theta_i.shape)
    for start in range(0, theta_i.size, step):
        part = slice(start, start + step)
        if surface.isotropic:
            weight, cos_zeta = _isotropic_facets(surface, masking, np.radians(theta_i[part]), critical)
        else:
            weight, cos_zeta = _facets(surface, masking, theta_i[part], azimuth[part], critical)
        blocks.append(_spectral_sum(weight, cos_zeta, n, k, reflectance))
    return np.concatenate(blocks) if blocks else np.zeros((0, n.size))


def _isotropic_facets(
    surface: Microsurface, masking: str, theta_i: Array, critical: float | None = None
) -> tuple[Array, Array]:
    """Weights and cos ζ of the facets of a quadrature, (incidences, facets).

    In polar slope coordinates the horizon is p = s cos β < (1 − s²) cot θ_i / 2: β is integrated from there, and s in panels
    split from tan(45° − θ_i/2) to its inverse, where that limit enters and leaves. ``critical`` is the angle [rad] on the facet from
    which on it reflects everything.
    """
    assert isinstance(surface.density, RadialDensity)
    cos_i, sin_i = np.cos(theta_i)[:, None, None], np.sin(theta_i)[:, None, None]
    s, s_weight, beta, beta_weight = _slope_rule(surface.density, theta_i, critical)
    u, p = s[..., None] ** 2, s[..., None] * np.cos(beta)
    towards = np.maximum(cos_i - p * sin_i, 0.0)
    cos_o = np.clip(2 * towards / (1 + u) - cos_i, _LEAST_COSINE, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    pair = HalfVector(u, towards / np.sqrt(1 + u), np.maximum(cos_i, _LEAST_COSINE), sin_i, cos_o, sin_o)
    phi_o: Array | float = 0.0
    if masking == "liu":
        turned = 2 * towards / (1 + u)
        phi_o = np.degrees(np.arctan2(-turned * s[..., None] * np.sin(beta), -turned * p - sin_i))
    visible = surface.visibility(pair, 0.0, phi_o, masking)
    weight = (surface.density(s**2) * s * s_weight)[..., None] * beta_weight * visible * cos_o * towards
    return weight.reshape(theta_i.size, -1), pair.cos_zeta.reshape(theta_i.size, -1)


def _slope_rule(density: RadialDensity, theta_i: Array, critical: float | None) -> tuple[Array, Array, Array, Array]:
    """Quadrature over the facets that mirror (θ_i, 0) above the horizon: s and its weight (θ, S), β and its weight (θ, S, B)."""
    # The range of β opens and closes like a square root: panels crowd at both ends of where it does.
    tilt = np.pi / 4 - theta_i[:, None] / 2 * np.cos(np.linspace(0, np.pi, _WINDOW_PANELS + 1))
    splits = np.clip(np.tan(tilt), 0.0, density.slope[-1])
    splits[tilt >= np.pi / 2] = density.slope[-1]
    if critical is not None:
        splits = np.concatenate([splits, slopes_of_total_reflection(theta_i, critical, density.slope[-1])], axis=1)
    panels = np.broadcast_to(density.panels(), (theta_i.size, density.panels().size))
    s, s_weight = panel_rule(np.sort(np.concatenate([panels, splits], axis=1), axis=1), 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = (1 - s**2) / (2 * s * np.tan(theta_i)[:, None])
    start = np.arccos(np.clip(np.nan_to_num(limit, nan=1.0, posinf=1.0, neginf=-1.0), -1.0, 1.0))
    edges = np.stack([start, np.full_like(start, np.pi)], axis=-1)
    if critical is not None:
        edges = azimuths_of_total_reflection(edges, s, theta_i[:, None], critical)
    beta, beta_weight = panel_rule(edges, _AZIMUTHS)
    return s, s_weight, beta, 2 * beta_weight


_TOWARDS_KINK = np.concatenate([-(4.0 ** -np.arange(1, 7)), [0.0], 4.0 ** -np.arange(6, 0, -1)])


def slopes_of_total_reflection(theta_i: Array, critical: float, reach: float) -> Array:
    """Panel edges (θ, n) that crowd about the slope from which on some facets, not all, are met at the critical angle [rad]."""
    tilt = np.abs(critical - theta_i)[:, None] * (1 + _TOWARDS_KINK)
    return np.asarray(np.clip(np.tan(np.minimum(tilt, 1.57)), 0.0, reach))


def azimuths_of_total_reflection(edges: Array, slope: Array, theta_i: Array, critical: float) -> Array:
    """Panel edges (…, n) in the azimuth of facets, crowding about the one met at the critical angle: F bends there like a root.

    Parameters
    ----------
    edges : (…, 2) range of azimuths
    slope, theta_i : (…) of the facets, and of the light on the mean plane [rad]
    critical : angle of total reflection [rad]
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        cos = (np.cos(theta_i) - np.cos(critical) * np.sqrt(1 + slope**2)) / (slope * np.sin(theta_i))
    kink = np.arccos(np.clip(np.nan_to_num(cos, nan=1.0), -1.0, 1.0))[..., None]
    low, high = edges[..., :1], edges[..., -1:]
    crowding = np.clip(kink + np.pi * _TOWARDS_KINK, low, high)
    return np.sort(np.concatenate([edges, crowding], axis=-1), axis=-1)


def _facets(
    surface: Microsurface, masking: str, theta_i: Array, phi_i: Array, critical: float | None = None
) -> tuple[Array, Array]:
    """The same for a surface with a lay."""
    assert not isinstance(surface.density, RadialDensity)
    p, q, share = quadrature.facet_rule(surface.density, theta_i, phi_i, critical)
    u = p * p + q * q
    theta, phi = np.radians(theta_i)[:, None], np.radians(phi_i)[:, None]
    cos_i, sin_i = np.maximum(np.cos(theta), _LEAST_COSINE), np.sin(theta)
    towards = np.maximum(cos_i - (p * np.cos(phi) + q * np.sin(phi)) * sin_i, 0.0)
    turned = 2 * towards / (1 + u)
    cos_o = turned - cos_i
    mirrored_up = (cos_o > 0) & (towards > 0)
    cos_o = np.clip(cos_o, _LEAST_COSINE, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    phi_o = np.degrees(np.arctan2(-turned * q - sin_i * np.sin(phi), -turned * p - sin_i * np.cos(phi)))
    cos_zeta = np.where(mirrored_up, np.minimum(towards / np.sqrt(1 + u), 1.0), 1.0)
    pair = HalfVector(np.broadcast_to(u, cos_o.shape), cos_zeta, cos_i, sin_i, cos_o, sin_o)
    weight = share * surface.visibility(pair, phi_i[:, None], phi_o, masking) * cos_o * towards
    return np.where(mirrored_up, weight, 0.0), cos_zeta


def _spectral_sum(weight: Array, cos_zeta: Array, n: Array, k: Array, reflectance: Reflectance) -> Array:
    """Σ weight · F(cos ζ; λ), (incidences, wavelength).

    F is smooth in n > 1: where only n disperses, it is evaluated at a few Chebyshev nodes of n and interpolated, which costs the same
    for any number of wavelengths. The error falls by a factor ρ with every node, ρ = x + √(x² − 1) with x the distance of n = 1
    from the middle of the spread, in half spreads: there are as many nodes as make it 1e-10, or else every n has its turn.
    """
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    count = _index_nodes(pairs[0])
    if pairs.shape[1] > count and not pairs[1].any():
        unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        low, high = pairs[0, 0], pairs[0, -1]
        nodes = low + (high - low) * (unit + 1) / 2
        at_nodes = np.stack([(weight * reflectance(cos_zeta, each, 0.0)).sum(axis=-1) for each in nodes], axis=-1)
        chebyshev = np.polynomial.chebyshev
        coefficients = np.linalg.solve(chebyshev.chebvander(unit, count - 1), at_nodes.T)
        return np.asarray(chebyshev.chebval(2 * (n - low) / (high - low) - 1, coefficients))
    values = [(weight * reflectance(cos_zeta, *each)).sum(axis=-1) for each in pairs.T]
    return np.stack(values, axis=-1)[:, where.ravel()]


def _index_nodes(n: Array) -> int:
    """Chebyshev nodes that hold a function of n > 1 to 1e-10 between the least and the largest of n; more than there are, if none do."""
    if n.size < 3 or n[0] <= 1:
        return int(n.size)
    spread = n[-1] - n[0]
    distance = (n[0] + n[-1] - 2) / spread
    rate = np.log(distance + np.sqrt(distance**2 - 1))
    return int(min(np.ceil(_INDEX_DIGITS / rate), n.size)) + 1


# --- its table


@dataclass(frozen=True)
class AlbedoTable:
    """The directional albedo between its nodes: a spline in the angle from grazing, where it bends.

    Parameters
    ----------
    theta : (θ,) increasing, from 0 to 90 degree
    values : (θ, wavelength), or (θ, φ, wavelength) of a surface with a lay
    phi : (φ,) degree, increasing around the circle; of a surface with a lay
    ellipse : widths of its slopes: they say in which measures of both angles the albedo is smooth
    """

    theta: Array
    values: Array
    phi: Array | None = None
    ellipse: Ellipse | None = None

    def __call__(self, theta: Array, phi: Array | float = 0.0) -> Array:
        """E, (…, wavelength), in [0, 1]."""
        grazing = 90 - np.asarray(theta, dtype=float)
        if self.phi is None:
            return np.clip(self._spline(grazing), 0.0, 1.0)
        assert self.ellipse is not None
        at = np.arcsinh(grazing / _lay_scale(self.ellipse)), quadrature.azimuth_to_arc(self.ellipse, phi)
        return np.clip(np.stack([each.ev(*at) for each in self._surfaces], axis=-1), 0.0, 1.0)

    def mean(self) -> Array:
        """2 ∫ E μ dμ, averaged over azimuth, (wavelength,): exact for the spline."""
        theta, weight = panel_rule(np.radians(self.theta), 6)
        weight = weight * np.sin(2 * theta)
        if self.phi is None:
            return np.asarray(weight @ self(np.degrees(theta)))
        assert self.ellipse is not None
        around = quadrature.arc_to_azimuth(self.ellipse, np.linspace(0.0, 360.0, 4 * self.phi.size, endpoint=False))
        width, _ = self.ellipse.towards(around)
        return np.asarray(
            weight @ np.einsum("tpl,p->tl", self(np.degrees(theta)[:, None], around), width / width.sum())
        )

    @cached_property
    def _spline(self) -> PiecewiseCubic:
        return PiecewiseCubic.of(_even_spline(90 - self.theta[::-1], self.values[::-1]))

    @cached_property
    def _surfaces(self) -> list[RectBivariateSpline]:
        assert self.phi is not None
        assert self.ellipse is not None
        arc = quadrature.azimuth_to_arc(self.ellipse, self.phi)
        order = np.argsort(arc)
        around = np.concatenate([order[-4:], order, order[:4]])
        grazing = np.arcsinh((90 - self.theta[::-1]) / _lay_scale(self.ellipse))
        values = np.moveaxis(self.values[::-1][:, around], -1, 0)
        return [RectBivariateSpline(grazing, np.unwrap(arc[around] - 360, period=360), each) for each in values]


def _lay_scale(ellipse: Ellipse) -> float:
    """Angle from grazing [degree] within which the albedo of a surface with a lay may turn."""
    return min(float(np.degrees(min(ellipse.along, ellipse.across))) / _LAY_FINENESS, _LAY_MOST_GRAZING)


def _even_spline(grazing: Array, values: Array) -> CubicSpline:
    # E is even in θ: its derivative vanishes at the normal, 90 degree from grazing.
    return CubicSpline(grazing, values, axis=0, bc_type=("not-a-knot", (1, np.zeros(values.shape[1]))))


def tabulated(surface: Microsurface, albedo: Callable[[Array, Array], Array], exact: Array) -> AlbedoTable:
    """Table of a directional albedo, nowhere below it.

    Parameters
    ----------
    surface : the facets
    albedo : (θ, φ), both (n,) degree → (n, wavelength)
    exact : angles of incidence that must be among the nodes [degree]

    Notes
    -----
    What is not reflected by the facets is handed to the base. Between the nodes the spline errs by parts in 10⁹ to either side, so
    the table is lifted by the largest error found: the whole then never reflects more than it receives.
    """
    if surface.isotropic:
        return refined(lambda theta: albedo(theta, np.zeros_like(theta)), surface.median_slope, exact)
    assert not isinstance(surface.density, RadialDensity)
    return _tabulated_lay(surface.density, albedo, exact)


def _tabulated_lay(density: PlanarDensity, albedo: Callable[[Array, Array], Array], exact: Array) -> AlbedoTable:
    """The same for a surface with a lay: even in the measures in which its albedo is smooth, tried between all nodes."""
    ellipse = density.ellipse
    scale = _lay_scale(ellipse)
    end = np.arcsinh(90 / scale)
    even = np.linspace(0, end, int(np.ceil(end / _LAY_STEP)) + 1)
    wanted = np.arcsinh((90 - exact) / scale)
    # A node right beside another would make the spline ring.
    apart = (np.abs(even[:, None] - wanted) > _LAY_STEP / 3).all(axis=1)
    grazing = np.unique(np.concatenate([even[apart], wanted]))
    arcs = np.arange(0.0, 360.0, 90 / np.ceil(quadrature.quarter_arc(ellipse) / _LAY_AZIMUTH))

    def on_net(grazing: Array, arcs: Array) -> tuple[Array, Array, Array]:
        """θ, φ and the albedo on a net, of a symmetric surface from one quarter."""
        folded = np.minimum(arcs % 180, 180 - arcs % 180) if quadrature.is_symmetric(density) else arcs
        distinct, where = np.unique(np.round(folded, 9), return_inverse=True)
        theta = np.clip(90 - scale * np.sinh(grazing), 0.0, 90.0)
        polar, around = np.meshgrid(theta, quadrature.arc_to_azimuth(ellipse, distinct), indexing="ij")
        values = albedo(polar.ravel(), around.ravel()).reshape(*polar.shape, -1)
        return theta, quadrature.arc_to_azimuth(ellipse, arcs), values[:, where]

    theta, phi, values = on_net(grazing, arcs)
    theta[np.searchsorted(grazing, wanted)] = exact
    order = np.argsort(np.round(phi % 360, 9))
    table = AlbedoTable(theta[::-1], values[::-1][:, order], np.round(phi % 360, 9)[order], ellipse)
    # Of a surface without symmetry, for its cost, at every second azimuth.
    probes = arcs[:: 1 if quadrature.is_symmetric(density) else 2] + arcs[1] / 2
    between, around, found = on_net((grazing[1:] + grazing[:-1]) / 2, probes)
    miss = np.abs(table(between[:, None], around) - found).max(axis=(1, 2))
    error = np.maximum(np.append(miss, 0.0), np.append(0.0, miss))[::-1]
    # Raised and cut off at 1 the table would bend there, and ring: what is lost fades instead.
    lost = np.maximum(1 - table.values, 0.0)
    return replace(table, values=1 - lost**2 / (lost + _lift(table.theta, error)[:, None, None]))


def _lift(theta: Array, error: Array) -> Array:
    """How far to raise a table at its nodes for the errors found about them, both (θ,)."""
    # An error close to grazing says nothing about the rest; spread smoothly, lest the spline overshoot.
    grazing = np.maximum(90 - theta, 1e-9)
    return np.asarray(4 * np.max(error * np.minimum(1.0, grazing / grazing[:, None]), axis=1) + _NOISE)


def refined(albedo: Callable[[Array], Array], slope: float, exact: Array) -> AlbedoTable:
    """Table of the albedo of an isotropic surface, nowhere below it.

    Parameters
    ----------
    albedo : (θ,) degree → (θ, wavelength)
    slope : scale on which it bends close to grazing [rad]
    exact : angles of incidence that must be among the nodes [degree]
    """
    nodes, values, error = _bisected(albedo, slope, exact)
    return AlbedoTable(nodes, np.clip(values + _lift(nodes, error)[:, None], 0.0, 1.0))


def _bisected(albedo: Callable[[Array], Array], slope: float, exact: Array) -> tuple[Array, Array, Array]:
    """Nodes between which a spline keeps an albedo, its values, and at each node the error found half way to its neighbours."""
    theta = np.degrees(np.arccos(np.cos(np.linspace(0, np.pi / 2, 48)) ** 2))
    # Within a few slopes of grazing the masking decides: E turns there on the scale of the roughness.
    grazing = 90 - np.degrees(slope) * 2.0 ** np.arange(-5, 7, 0.25)
    nodes = np.unique(np.round(np.concatenate([theta, grazing[(grazing > 45) & (grazing < 90)], exact]), 9))
    values, error, pending = albedo(nodes), np.zeros(nodes.size), np.arange(nodes.size - 1)
    while pending.size:
        middle = (nodes[1:] + nodes[:-1])[pending] / 2
        found = albedo(middle)
        miss = np.abs(_even_spline(90 - nodes[::-1], values[::-1])(90 - middle) - found).max(axis=1)
        good = (miss <= _INTERPOLATION) | (nodes.size >= _MOST_NODES)
        settled = np.where(good, miss, 0.0)
        for neighbour in (pending, pending + 1):
            np.maximum.at(error, neighbour, settled)
        order = np.argsort(np.concatenate([nodes, middle]))
        split = np.flatnonzero(np.concatenate([np.zeros(nodes.size, dtype=bool), ~good])[order])
        nodes, values = np.concatenate([nodes, middle])[order], np.concatenate([values, found])[order]
        error = np.concatenate([error, settled])[order]
        pending = np.union1d(split - 1, split)
    return nodes, values, error

"""Directional albedo of the facets, its mean, and its table.

The albedo is integrated over the facets instead of the outgoing directions,
E = ∫∫ P22 F G2 (cos θ_i − p̃ sin θ_i) / cos θ_i dp dq over facets that mirror upwards, so that its cost does not depend on the width
of the lobe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from brdfpipe.bsdf.microfacet import anisotropic_quadrature as quadrature
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable, even_spline, lay_scale
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity
from brdfpipe.facets.radial_density import PANELS, RadialDensity
from brdfpipe.geometry import Array, HalfVector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking.modes import PHYSICAL_MASKINGS
from brdfpipe.optics.fresnel_equations import fresnel

_AZIMUTHS = 12  # nodes of the quadrature over the azimuths of a panel
_CROWDED_AZIMUTHS = 6  # the same of the narrow panels about the critical angle
_WINDOW_PANELS = 8  # panels of the tilts that mirror light upwards
_INDEX_DIGITS = np.log(1e10)  # accuracy of the interpolation over the index
_LEAST_COSINE = 1e-150  # avoids division by 0 at the horizon
_INTERPOLATION_ERROR = 2e-9  # of the albedo between the nodes of its table
_TRACED_ERROR = 1e-6  # the same with traced visibility, whose table has kinks that the quadrature resolves no better
_NOISE = 1e-9  # of the quadrature, by which the table is raised in any case
_FEW_INDICES = 4  # that are evaluated one by one
_SERIES_LENGTHS = 28, 36, 48, 64, 96, 128  # numbers of coefficients that are tried for the reflectance over the cosine
_SERIES_TAIL, _SERIES_ERROR = 4, 1e-13  # last coefficients that are left out, and up to what size relative to the first
_MANY_FACETS = 2**16  # of all incidences together, for which compiled code is loaded
_CLOSEST_TO_METAL = 1e70  # index up to which that code computes the reflectance
_MOST_NODES = 400  # of an isotropic table
_LAY_STEP = 0.2  # between nodes θ of a table with a lay, in scaled angles from grazing
_LAY_AZIMUTH = 18.0  # between its azimuths, in arc length of the ellipse [degree]


def directional_albedo(
    surface: Microsurface,
    masking: str,
    n: Array,
    k: Array,
    theta_i: Array,
    phi_i: Array | float = 0.0,
    *,
    mirrors: bool = False,
    panels: int = PANELS,
) -> Array:
    """Directional albedo E of the facets' single reflection, (incidences, wavelength).

    Parameters
    ----------
    surface : the facets
    masking : one of :data:`brdfpipe.masking.modes.MODES`
    n, k : (wavelength,) index relative to the medium of incidence
    theta_i, phi_i : (incidences,) degree, 0 <= theta_i <= 90; the azimuth is for a surface with a lay
    mirrors : add a last column, of the same facets as perfect mirrors
    panels : of the slopes of an isotropic surface
    """
    theta_i = np.asarray(theta_i, dtype=float)
    if n.size > 1 and ((n < 1) & (k == 0)).any():
        # The critical angle depends on the index.
        pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
        columns = [
            directional_albedo(surface, masking, pair[:1], pair[1:], theta_i, phi_i, panels=panels) for pair in pairs.T
        ]
        albedos = [np.concatenate(columns, axis=1)[:, where.ravel()]]
        if mirrors:
            albedos.append(mirror_albedo(surface, masking, theta_i, phi_i)[:, None])
        return np.concatenate(albedos, axis=1)
    critical = float(np.arcsin(n[0])) if n.size and n[0] < 1 and k[0] == 0 else None
    if critical is None and _is_worth_compiling(surface, masking, n, theta_i.size, panels):
        light = _compiled_albedo(surface, masking, n, k, np.radians(theta_i), panels)
        return light if mirrors else light[:, :-1]
    blocks = []
    step = 64 if surface.isotropic and critical is None else 8
    azimuth = np.broadcast_to(np.asarray(phi_i, dtype=float), theta_i.shape)
    for start in range(0, theta_i.size, step):
        part = slice(start, start + step)
        if surface.isotropic:
            weight, cos_zeta = _isotropic_facets(surface, masking, np.radians(theta_i[part]), critical, panels)
        else:
            weight, cos_zeta = _facets_with_lay(surface, masking, theta_i[part], azimuth[part], critical)
        block = _of_facets(weight, cos_zeta, n, k) if n.size else np.zeros((weight.shape[0], 0))
        blocks.append(np.concatenate([block, weight.sum(axis=-1, keepdims=True)], axis=1) if mirrors else block)
    return np.concatenate(blocks) if blocks else np.zeros((0, n.size + mirrors))


def mirror_albedo(surface: Microsurface, masking: str, theta_i: Array, phi_i: Array | float = 0.0) -> Array:
    """Directional albedo of the same facets as perfect mirrors, (incidences,)."""
    return directional_albedo(surface, masking, np.zeros(0), np.zeros(0), theta_i, phi_i, mirrors=True)[:, 0]


def _is_worth_compiling(surface: Microsurface, masking: str, n: Array, incidences: int, panels: int) -> bool:
    """Whether compiled code covers an integral over facets, and takes less time for it even if it is to be loaded."""
    facets = 4 * (panels + _WINDOW_PANELS) * _AZIMUTHS
    covered = surface.isotropic and masking in PHYSICAL_MASKINGS and bool((n <= _CLOSEST_TO_METAL).all())
    return covered and incidences * facets >= _MANY_FACETS


def _compiled_albedo(surface: Microsurface, masking: str, n: Array, k: Array, theta_i: Array, panels: int) -> Array:
    """Directional albedo of an isotropic surface, (incidences, wavelength + 1), at θ [rad]; last of perfect mirrors.

    Of many indices the sum over the facets is one over polynomials, at the same cost for any number of them.
    """
    from brdfpipe.bsdf.microfacet import evaluation_kernel

    assert isinstance(surface.density, RadialDensity)
    rule = _slope_rule(surface.density, theta_i, None, panels)
    azimuths = panel_rule(np.array([0.0, 1.0]), _AZIMUTHS)
    tables = evaluation_kernel.FacetTables.of(surface, masking)
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    series = _series_of_reflectance(*pairs) if pairs.shape[1] > _FEW_INDICES else None
    if series is None and pairs.size:
        sums = evaluation_kernel.sum_over_facets(tables, theta_i, *rule, azimuths, (pairs[0], pairs[1]))
        return np.concatenate([sums[:, 1:][:, where.ravel()], sums[:, :1]], axis=1)
    orders = 1 if series is None else series.shape[0]
    sums = evaluation_kernel.sum_over_facets(tables, theta_i, *rule, azimuths, None, orders)
    return sums if series is None else np.concatenate([(sums @ series)[:, where.ravel()], sums[:, :1]], axis=1)


def _series_of_reflectance(n: Array, k: Array) -> Array | None:
    """Coefficients (orders, index) of Fresnel's reflectance as a series of Chebyshev's polynomials of 2 cos ζ − 1.

    It is analytic about the cosines from 0 to 1, so that the coefficients fall exponentially. None where they do not fall fast, of an index
    near 1 and of nearly perfect mirrors.
    """
    for count in _SERIES_LENGTHS:
        turn = np.pi * (np.arange(count) + 0.5) / count
        values = fresnel((np.cos(turn)[:, None] + 1) / 2, n, k).mean
        coefficients = np.cos(np.arange(count)[:, None] * turn) @ values * (2 / count)
        coefficients[0] /= 2
        if np.all(np.abs(coefficients[-_SERIES_TAIL:]) <= _SERIES_ERROR * np.abs(coefficients[0])):
            return np.asarray(coefficients[:-_SERIES_TAIL])
    return None


def _isotropic_facets(
    surface: Microsurface, masking: str, theta_i: Array, critical: float | None, panels: int
) -> tuple[Array, Array]:
    """Weights and cos ζ of the facets of a quadrature, (incidences, facets); ``critical`` is the critical angle [rad].

    In polar slope coordinates the horizon is p = s cos β < (1 − s²) cot θ_i / 2: β is integrated from there, and s in panels
    split from tan(45° − θ_i/2) to its inverse, the range in which the horizon limits β.
    """
    assert isinstance(surface.density, RadialDensity)
    cos_i, sin_i = np.cos(theta_i)[:, None, None], np.sin(theta_i)[:, None, None]
    s, s_weight, first = _slope_rule(surface.density, theta_i, critical, panels)
    beta, beta_weight = _azimuth_rule(s, first, theta_i, critical)
    u, p = s[..., None] ** 2, s[..., None] * np.cos(beta)
    facing = np.maximum(cos_i - p * sin_i, 0.0)  # cos ζ √(1 + u)
    cos_o = np.clip(2 * facing / (1 + u) - cos_i, _LEAST_COSINE, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    pair = HalfVector(u, facing / np.sqrt(1 + u), np.maximum(cos_i, _LEAST_COSINE), sin_i, cos_o, sin_o)
    phi_o: Array | float = 0.0
    if masking == "liu":
        scale = 2 * facing / (1 + u)
        phi_o = np.degrees(np.arctan2(-scale * s[..., None] * np.sin(beta), -scale * p - sin_i))
    visible = surface.visibility(pair, 0.0, phi_o, masking)
    weight = (surface.density(s**2) * s * s_weight)[..., None] * beta_weight * visible * cos_o * facing
    return weight.reshape(theta_i.size, -1), pair.cos_zeta.reshape(theta_i.size, -1)


def _slope_rule(
    density: RadialDensity, theta_i: Array, critical: float | None, panels: int
) -> tuple[Array, Array, Array]:
    """Quadrature over the slopes of facets that mirror (θ_i, 0) above the horizon: s, its weight, and the β from which on they do, (θ, S)."""
    # The range of β opens and closes like a square root: panels are dense at both ends.
    tilt = np.pi / 4 - theta_i[:, None] / 2 * np.cos(np.linspace(0, np.pi, _WINDOW_PANELS + 1))
    splits = np.clip(np.tan(tilt), 0.0, density.slope[-1])
    splits[tilt >= np.pi / 2] = density.slope[-1]
    if critical is not None:
        splits = np.concatenate([splits, slopes_of_total_reflection(theta_i, critical, density.slope[-1])], axis=1)
    edges = np.tile(density.panels(panels), (theta_i.size, 1))
    s, s_weight = panel_rule(np.sort(np.concatenate([edges, splits], axis=1), axis=1), 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = (1 - s**2) / (2 * s * np.tan(theta_i)[:, None])
    first = np.arccos(np.clip(np.nan_to_num(limit, nan=1.0, posinf=1.0, neginf=-1.0), -1.0, 1.0))
    return s, s_weight, first


def _azimuth_rule(slope: Array, first: Array, theta_i: Array, critical: float | None) -> tuple[Array, Array]:
    """Quadrature over the azimuths of these facets on both sides: β and its weight, (θ, S, B)."""
    edges = np.stack([first, np.full_like(first, np.pi)], axis=-1)
    if critical is not None:
        edges = azimuths_of_total_reflection(edges, slope, theta_i[:, None], critical)
    beta, weight = panel_rule(edges, _AZIMUTHS if critical is None else _CROWDED_AZIMUTHS)
    return beta, 2 * weight


_TOWARDS_KINK = np.concatenate([-(4.0 ** -np.arange(1, 7)), [0.0], 4.0 ** -np.arange(6, 0, -1)])


def slopes_of_total_reflection(theta_i: Array, critical: float, reach: float) -> Array:
    """Panel edges (θ, n) about the smallest slope of facets that are met at the critical angle [rad]."""
    tilt = np.abs(critical - theta_i)[:, None] * (1 + _TOWARDS_KINK)
    return np.asarray(np.clip(np.tan(np.minimum(tilt, 1.57)), 0.0, reach))


def azimuths_of_total_reflection(edges: Array, slope: Array, theta_i: Array, critical: float) -> Array:
    """Panel edges (…, n) in a range of azimuths (…, 2), dense about the facets met at the critical angle, where F bends like a root.

    ``slope`` is that of the facets, ``theta_i`` the angle of incidence on the mean plane, (…) each; angles in radian.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        cos = (np.cos(theta_i) - np.cos(critical) * np.sqrt(1 + slope**2)) / (slope * np.sin(theta_i))
    kink = np.arccos(np.clip(np.nan_to_num(cos, nan=1.0), -1.0, 1.0))[..., None]
    low, high = edges[..., :1], edges[..., -1:]
    crowding = np.clip(kink + np.pi * _TOWARDS_KINK, low, high)
    return np.sort(np.concatenate([edges, crowding], axis=-1), axis=-1)


def _facets_with_lay(
    surface: Microsurface, masking: str, theta_i: Array, phi_i: Array, critical: float | None
) -> tuple[Array, Array]:
    """The same as :func:`_isotropic_facets` for a surface with a lay."""
    assert not isinstance(surface.density, RadialDensity)
    p, q, share = quadrature.facet_rule(surface.density, theta_i, phi_i, critical)
    u = p * p + q * q
    theta, phi = np.radians(theta_i)[:, None], np.radians(phi_i)[:, None]
    cos_i, sin_i = np.maximum(np.cos(theta), _LEAST_COSINE), np.sin(theta)
    facing = np.maximum(cos_i - (p * np.cos(phi) + q * np.sin(phi)) * sin_i, 0.0)
    scale = 2 * facing / (1 + u)
    cos_o = scale - cos_i
    mirrored_up = (cos_o > 0) & (facing > 0)
    cos_o = np.clip(cos_o, _LEAST_COSINE, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    phi_o = np.degrees(np.arctan2(-scale * q - sin_i * np.sin(phi), -scale * p - sin_i * np.cos(phi)))
    cos_zeta = np.where(mirrored_up, np.minimum(facing / np.sqrt(1 + u), 1.0), 1.0)
    pair = HalfVector(np.broadcast_to(u, cos_o.shape), cos_zeta, cos_i, sin_i, cos_o, sin_o)
    weight = share * surface.visibility(pair, phi_i[:, None], phi_o, masking) * cos_o * facing
    return np.where(mirrored_up, weight, 0.0), cos_zeta


def _of_facets(weight: Array, cos_zeta: Array, n: Array, k: Array) -> Array:
    """Σ weight · F(cos ζ; λ), (incidences, wavelength)."""

    def reflected(n: Array, k: Array) -> Array:
        return np.stack([(weight * fresnel(cos_zeta, *one).mean).sum(axis=-1) for one in zip(n, k, strict=True)], -1)

    return _spectral_sum(reflected, n, k)


def _spectral_sum(reflected: Callable[[Array, Array], Array], n: Array, k: Array) -> Array:
    """Light that facets reflect, (incidences, wavelength), from what they do of some indices, (index,) n and k → (incidences, index).

    F is smooth in n > 1: for k = 0 it is evaluated at a few Chebyshev nodes of n and interpolated, at the same cost for any number of
    wavelengths. The error falls by a factor ρ with every node, ρ = x + √(x² − 1) with x the distance of n = 1 from the middle of the
    range, in half ranges. The number of nodes gives an error of 1e-10; if it exceeds the number of indices, each index is evaluated.
    """
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    count = _chebyshev_count(pairs[0])
    if pairs.shape[1] > count and not pairs[1].any():
        unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        low, high = pairs[0, 0], pairs[0, -1]
        nodes = low + (high - low) * (unit + 1) / 2
        at_nodes = reflected(nodes, np.zeros(count))
        chebyshev = np.polynomial.chebyshev
        coefficients = np.linalg.solve(chebyshev.chebvander(unit, count - 1), at_nodes.T)
        return np.asarray(chebyshev.chebval(2 * (n - low) / (high - low) - 1, coefficients))
    return reflected(*pairs)[:, where.ravel()]


def _chebyshev_count(n: Array) -> int:
    """Number of Chebyshev nodes that interpolate a function of n > 1 to 1e-10; at least the number of n if interpolation does not help."""
    if n.size < 3 or n[0] <= 1:
        return int(n.size)
    distance = (n[0] + n[-1] - 2) / (n[-1] - n[0])
    rate = np.log(distance + np.sqrt(distance**2 - 1))
    return int(min(np.ceil(_INDEX_DIGITS / rate), n.size)) + 1


# --- its table


def tabulated(surface: Microsurface, albedo: Callable[[Array, Array], Array], exact: Array) -> AlbedoTable:
    """Table of a directional albedo, (θ, φ) in degree → (n, wavelength), with ``exact`` among its nodes θ.

    It is an upper bound: between the nodes the spline deviates by up to 2e-9 in both directions, and the table is raised by the largest
    deviation. Facets, and the base that the rest of the light enters, together then conserve energy. With traced visibility the spline deviates by
    up to 1e-6, and all this holds to 1e-5, the noise of the integral.
    """
    if surface.isotropic:
        error = _INTERPOLATION_ERROR if surface.ratio is None else _TRACED_ERROR
        return refined(lambda theta: albedo(theta, np.zeros_like(theta)), surface.typical_slope, exact, error)
    assert not isinstance(surface.density, RadialDensity)
    return _tabulated_lay(surface.density, albedo, exact)


def _tabulated_lay(density: PlanarDensity, albedo: Callable[[Array, Array], Array], exact: Array) -> AlbedoTable:
    """The same for a surface with a lay: uniform in scaled angles, with the error found between all nodes."""
    ellipse = density.ellipse
    scale = lay_scale(ellipse)
    grazing, _, arcs = _scaled_nodes(ellipse, exact)
    symmetric = quadrature.is_symmetric(density)

    def on_grid(grazing: Array, arcs: Array) -> tuple[Array, Array, Array]:
        """θ, φ and the albedo on a grid; only one quarter is computed for a symmetric surface."""
        folded = np.minimum(arcs % 180, 180 - arcs % 180) if symmetric else arcs
        distinct, where = np.unique(np.round(folded, 9), return_inverse=True)
        theta = np.clip(90 - scale * np.sinh(grazing), 0.0, 90.0)
        polar, around = np.meshgrid(theta, quadrature.arc_to_azimuth(ellipse, distinct), indexing="ij")
        values = albedo(polar.ravel(), around.ravel()).reshape(*polar.shape, -1)
        return theta, quadrature.arc_to_azimuth(ellipse, arcs), values[:, where]

    theta, phi = lay_nodes(density, exact)
    _, around, values = on_grid(grazing, arcs)
    order = np.argsort(np.round(around % 360, 9))
    table = AlbedoTable(theta, values[::-1][:, order], phi, ellipse)
    # Without symmetry at every second azimuth alone, to save time.
    probes = arcs[:: 1 if symmetric else 2] + arcs[1] / 2
    between, around, expected = on_grid((grazing[1:] + grazing[:-1]) / 2, probes)
    misses = np.abs(table(between[:, None], around) - expected).max(axis=(1, 2))
    error = np.maximum(np.append(misses, 0.0), np.append(0.0, misses))[::-1]
    # A clip at 1 would make a kink, and the spline ring: the loss decreases smoothly instead.
    lost = np.maximum(1 - table.values, 0.0)
    return replace(table, values=1 - lost**2 / (lost + _lift(table.theta, error)[:, None, None]))


def lay_nodes(density: PlanarDensity, exact: Array) -> tuple[Array, Array]:
    """Nodes θ and φ [degree] of the table of a surface with a lay, with ``exact`` among the first."""
    scale = lay_scale(density.ellipse)
    grazing, exact_grazing, arcs = _scaled_nodes(density.ellipse, exact)
    theta = np.clip(90 - scale * np.sinh(grazing), 0.0, 90.0)
    theta[np.searchsorted(grazing, exact_grazing)] = exact
    return theta[::-1], np.sort(np.round(quadrature.arc_to_azimuth(density.ellipse, arcs) % 360, 9))


def _scaled_nodes(ellipse: Ellipse, exact: Array) -> tuple[Array, Array, Array]:
    """The same from grazing and in scaled angles, with those of ``exact`` apart, and the arcs [degree]."""
    scale = lay_scale(ellipse)
    end = np.arcsinh(90 / scale)
    uniform = np.linspace(0, end, int(np.ceil(end / _LAY_STEP)) + 1)
    exact_grazing = np.arcsinh((90 - exact) / scale)
    # Nodes that are too close together would make the spline ring.
    separate = (np.abs(uniform[:, None] - exact_grazing) > _LAY_STEP / 3).all(axis=1)
    grazing = np.unique(np.concatenate([uniform[separate], exact_grazing]))
    return grazing, exact_grazing, np.arange(0.0, 360.0, 90 / np.ceil(quadrature.quarter_arc(ellipse) / _LAY_AZIMUTH))


def _lift(theta: Array, error: Array) -> Array:
    """By how much a table is raised at its nodes, for errors beside the nodes, both (θ,)."""
    # Errors near grazing are local; the smooth decrease keeps the spline from overshooting.
    grazing = np.maximum(90 - theta, 1e-9)
    return np.asarray(4 * np.max(error * np.minimum(1.0, grazing / grazing[:, None]), axis=1) + _NOISE)


def refined(
    albedo: Callable[[Array], Array], slope: float, exact: Array, accepted: float = _INTERPOLATION_ERROR
) -> AlbedoTable:
    """The same for an isotropic albedo that varies on the angle ``slope`` [rad] near grazing; intervals are halved until it is accurate."""
    theta = np.degrees(np.arccos(np.cos(np.linspace(0, np.pi / 2, 48)) ** 2))
    # Near grazing masking dominates: E varies on the scale of the slopes.
    grazing = 90 - np.degrees(slope) * 2.0 ** np.arange(-5, 7, 0.25)
    nodes = np.unique(np.round(np.concatenate([theta, grazing[(grazing > 45) & (grazing < 90)], exact]), 9))
    values, error, pending = albedo(nodes), np.zeros(nodes.size), np.arange(nodes.size - 1)
    while pending.size:
        middle = (nodes[1:] + nodes[:-1])[pending] / 2
        expected = albedo(middle)
        miss = np.abs(even_spline(90 - nodes[::-1], values[::-1])(90 - middle) - expected).max(axis=1)
        accurate = (miss <= accepted) | (nodes.size >= _MOST_NODES)
        final = np.where(accurate, miss, 0.0)
        for neighbour in (pending, pending + 1):
            np.maximum.at(error, neighbour, final)
        order = np.argsort(np.concatenate([nodes, middle]))
        split = np.flatnonzero(np.concatenate([np.zeros(nodes.size, dtype=bool), ~accurate])[order])
        nodes, values = np.concatenate([nodes, middle])[order], np.concatenate([values, expected])[order]
        error = np.concatenate([error, final])[order]
        pending = np.union1d(split - 1, split)
    return AlbedoTable(nodes, np.clip(values + _lift(nodes, error)[:, None], 0.0, 1.0))

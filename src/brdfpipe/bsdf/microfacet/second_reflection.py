"""Light that two facets of an isotropic surface reflect one after the other, each with its own Fresnel reflectance and masking.

The light leaves in the directions that the facets give it: mostly forward, towards grazing. Smith's surface has heights independent
of the slopes and of each other, so that the heights of both facets integrate in closed form. With Λ' = Λ of the direction between the
facets, w₁, or of −w₁ if it points downwards,

    f₂ = ∫ F₁ F₂ D₁ D₂ / (16 cos θ_i cos θ_o |cos θ₁|) / [(1 + Λ_i + Λ_o) (1 + Λ_x + Λ')] dω₁,   x = i if w₁ points upwards, else o.

A path with w₁ downwards is the reverse of one with w₁ upwards. Both polarisations pass from facet to facet.

References
----------
Heitz, Hanika, d'Eon & Dachsbacher 2016 (ACM TOG 35(4) 58), the random walk; Wang et al. 2022 (Computer Graphics Forum 41(4)), heights
integrated in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel

_POLAR_NODES = 24  # angles θ of the table
_AZIMUTH_NODES = 17  # azimuths of the table
_SLOPE_PANELS = 12  # of the quadrature over the first facet
_FACET_AZIMUTHS = 16  # nodes of its azimuth, on one side of the plane of incidence
_BASIS_ERROR = 1e-4  # of the Fresnel reflectance of all wavelengths, relative
_COSINES = np.linspace(0.0, 1.0, 513) ** 2  # where that reflectance is tabulated: dense at grazing, where it is steep
_PATHS = 4096  # of the quadrature over three facets
_LEAST = 1e-300

_Cell = tuple[NDArray[np.int64], Array]
"""Index of an interval of a table, and the position in it, from 0 to 1."""


@dataclass(frozen=True)
class SecondReflection:
    """Table of the second reflection, or of the second and all further ones; reciprocal by construction.

    f₂ = (μ_i A(i, o) + μ_o A(o, i)) / (16 (μ_i μ_o + g_i s_i μ_o + g_o s_o μ_i)), with μ = cos θ, s = sin θ and g the mean excess
    slope. A, of the paths with w₁ upwards, is finite at grazing; its logarithm is interpolated linearly.
    """

    surface: Microsurface
    theta: Array
    """(θ,) nodes of both polar angles [degree], increasing from 0 to 90"""
    azimuth: Array
    """(φ,) nodes of the scaled azimuth, from 0 (forward) to 1 (back)"""
    log_upward: Array
    """log A, (θ_i, θ_o, φ, wavelength or 1)"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, values: Array, surface: Microsurface) -> SecondReflection:
        """That of a ``bsdf`` dataset, with the values of ``second_reflection`` at some wavelengths, (θ_i, θ_o, φ, wavelength or 1)."""
        return cls(surface, bsdf["second_theta_i"].values, bsdf["second_azimuth"].values, _log(values))

    def __call__(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF of the second reflection [sr-1], (directions, wavelength or 1); angles in degree, (directions,) each."""
        cos_i, cos_o = np.cos(np.radians(theta_i)), np.cos(np.radians(theta_o))
        turn = np.radians(np.abs((np.asarray(phi_i) - phi_o) % 360 - 180))  # 0 in the forward plane
        scaled = np.arcsinh(turn / self._width(cos_i, cos_o)) / np.arcsinh(np.pi / self._width(cos_i, cos_o))
        at_i, at_o = _linear(self._grazing, 90 - theta_i), _linear(self._grazing, 90 - theta_o)
        at_phi = _linear(self.azimuth, scaled)
        flat = self._from_grazing.reshape(-1, self.log_upward.shape[-1])
        forwards, backwards = (self._gather(flat, *at, at_phi) for at in ((at_i, at_o), (at_o, at_i)))
        sum_of_paths = cos_i[:, None] * forwards + cos_o[:, None] * backwards
        return np.asarray(sum_of_paths * self._common_factor(theta_i, theta_o)[:, None])

    def albedo(self, theta: Array) -> Array:
        """Directional reflectance of this light [1], (incidences, wavelength or 1): the integral of the interpolated table."""
        return np.asarray(self._albedo(np.asarray(theta, dtype=float)))

    @cached_property
    def _albedo(self) -> PPoly:
        return piecewise(self.albedo_nodes, np.stack([self._integral(theta) for theta in self.albedo_nodes]))

    @property
    def albedo_nodes(self) -> Array:
        """Angles at which the albedo is integrated: between the nodes of the table it is smooth, at the nodes it has kinks [degree]."""
        width = np.diff(self.theta)[:, None]
        return np.append((self.theta[:-1, None] + width * np.array([0.0, 0.25, 0.75])).ravel(), self.theta[-1])

    def scale_for(self, further: Array) -> Array:
        """w(θ), (θ, wavelength), for which f₂ w(θ_i) w(θ_o) has the albedo ``further`` (θ, wavelength) at the nodes."""
        shares = np.stack([np.einsum("tl,tj->jl", self._rings(theta), self._hats) for theta in self.theta])
        scale = np.sqrt(further / np.maximum(shares.sum(axis=1), _LEAST))
        for _ in range(200):
            scale = np.sqrt(scale * further / np.maximum(np.einsum("ijl,jl->il", shares, scale), _LEAST))
        return np.asarray(scale)

    @cached_property
    def _hats(self) -> Array:
        theta, _ = panel_rule(self.theta, 3)
        return np.stack([np.interp(theta, self.theta, row) for row in np.eye(self.theta.size)], axis=1)

    def _integral(self, incidence: float) -> Array:
        return np.asarray(self._rings(incidence).sum(axis=0))

    def _rings(self, incidence: float) -> Array:
        """Light into the rings of a quadrature over θ_o, (θ_o, wavelength)."""
        theta, weight = panel_rule(self.theta, 3)
        weight = np.radians(weight) * np.sin(np.radians(theta)) * np.cos(np.radians(theta))
        width = self._width(np.cos(np.radians(incidence)), np.cos(np.radians(theta)))[:, None]
        turn, turn_weight = panel_rule(width * np.sinh(self.azimuth * np.arcsinh(np.pi / width)), 2)
        phi_o = 180 + np.degrees(turn).ravel()
        values = self(np.full(turn.size, incidence), np.zeros(1), np.repeat(theta, turn.shape[1]), phi_o)
        return np.einsum("t,tp,tpl->tl", weight, 2 * turn_weight, values.reshape(*turn.shape, -1))

    @property
    def _grazing(self) -> Array:
        return 90 - self.theta[::-1]

    @property
    def _from_grazing(self) -> Array:
        return self.log_upward[::-1, ::-1]

    def _width(self, cos_i: Array, cos_o: Array) -> Array:
        return azimuth_width(self.surface, cos_i, cos_o)

    def _common_factor(self, theta_i: Array, theta_o: Array) -> Array:
        (cos_i, excess_i), (cos_o, excess_o) = (_projected(self.surface, theta) for theta in (theta_i, theta_o))
        return 1 / (16 * np.maximum(cos_i * cos_o + excess_i * cos_o + excess_o * cos_i, _LEAST))

    def _gather(self, flat: Array, at_i: _Cell, at_o: _Cell, at_phi: _Cell) -> Array:
        count, azimuths = self.theta.size, self.azimuth.size
        result = np.zeros((at_i[0].size, flat.shape[-1]))
        for i, weight_i in ((at_i[0], 1 - at_i[1]), (at_i[0] + 1, at_i[1])):
            for o, weight_o in ((at_o[0], 1 - at_o[1]), (at_o[0] + 1, at_o[1])):
                row = (i * count + o) * azimuths + at_phi[0]
                weight = weight_i * weight_o
                result += (weight * (1 - at_phi[1]))[:, None] * flat[row]
                result += (weight * at_phi[1])[:, None] * flat[row + 1]
        return np.exp(result)


def piecewise(nodes: Array, values: Array) -> PPoly:
    """The function that is one cubic in each interval of the table, through four of the nodes (one shared with each neighbour)."""
    ends = nodes[::3]
    x = np.array([0.0, 0.25, 0.75, 1.0])
    at = np.arange(ends.size - 1)[:, None] * 3 + np.arange(4)
    coefficients = np.einsum("ck,ik...->ci...", np.linalg.inv(np.vander(x)), values[at])
    scale = np.diff(ends)[None] ** np.arange(3, -1, -1)[:, None]
    return PPoly(coefficients / scale.reshape(*scale.shape, *([1] * (values.ndim - 1))), ends)


def with_second_reflection(bsdf: xr.Dataset, second: SecondReflection, of_mirrors: SecondReflection) -> xr.Dataset:
    """The dataset with the table of the second reflection, and the albedo of that of perfect mirrors."""
    spectral, dims = bsdf["n"].dims, ("second_theta_i", "second_theta_o", "second_azimuth")
    values, nodes = np.exp(second.log_upward), second.albedo_nodes
    return bsdf.assign_coords(
        second_theta_i=second.theta, second_theta_o=second.theta, second_azimuth=second.azimuth, second_theta=nodes
    ).assign(
        second_reflection=((*dims, *spectral), values if spectral else values[..., 0]),
        second_mirror_albedo=("second_theta", of_mirrors.albedo(nodes)[:, 0]),
    )


def albedo_of_mirrors(bsdf: xr.Dataset) -> Callable[[Array], Array]:
    """Albedo of the second reflection by perfect mirrors, (θ,) degree → (θ, 1), of a dataset with that table."""
    return piecewise(bsdf["second_theta"].values, bsdf["second_mirror_albedo"].values[:, None])


def _linear(nodes: Array, values: Array) -> _Cell:
    """Index of the interval of each value, and its position in it."""
    index = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, nodes.size - 2)
    return index.astype(np.int64), np.clip((values - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)


def azimuth_width(surface: Microsurface, cos_i: Array, cos_o: Array) -> Array:
    """Azimuth over which the lobe extends beside the plane of incidence [rad]: a facet's slope across it is about that over μ_i + μ_o."""
    return np.asarray(np.minimum(surface.typical_slope * (cos_i + cos_o) + 1e-3, 4.0))


def _projected(surface: Microsurface, theta: Array) -> tuple[Array, Array]:
    """cos θ, and g sin θ: together cos θ (1 + Λ)."""
    cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    cos = np.where(theta >= 90, 0.0, cos)
    return cos, surface.excess(cos, sin, 0.0) * sin


def second_reflection(
    surface: Microsurface, n: Array, k: Array, mirror_albedo: Callable[[Array], Array]
) -> tuple[SecondReflection, SecondReflection]:
    """The second and further reflections of an isotropic surface, and those of the same facets as perfect mirrors.

    All further reflections together have the directions of the second one. Their share is what the first two leave of the light of
    perfect mirrors, reduced as the third reflection is.

    Parameters
    ----------
    surface : isotropic
    n, k : (wavelength,) index relative to the medium of incidence
    mirror_albedo : albedo of the first reflection by perfect mirrors, (θ,) degree → (θ,)

    Notes
    -----
    Where the error of the table would make perfect mirrors reflect more than they receive, both tables are reduced at these angles.
    """
    scale = np.degrees(min(surface.typical_slope, 0.6)) / 2
    grazing = scale * np.sinh(np.linspace(0.0, np.arcsinh(90 / scale), _POLAR_NODES))
    grazing[-1] = 90.0
    theta, azimuth = 90 - grazing[::-1], np.linspace(0.0, 1.0, _AZIMUTH_NODES)
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    basis, coefficients = fresnel_basis(pairs)
    products = np.stack([upward_paths(surface, incidence, theta, azimuth, basis) for incidence in theta])
    rank = coefficients.shape[0]
    # Of the products of two basis functions, (1 + rank², …): the first is that of perfect mirrors.
    weights = (coefficients[:, None] * coefficients[None]).reshape(rank * rank, -1)
    spectral = np.einsum("ibop,bl->iopl", products[:, 1:], weights)
    third_of_mirrors, third = _third_reflection(surface, theta, pairs)

    def table(values: Array, further: Array) -> SecondReflection:
        second = SecondReflection(surface, theta, azimuth, _log(values))
        scale = second.scale_for(further)
        return replace(second, log_upward=second.log_upward + np.log1p(scale[:, None, None] * scale[None, :, None]))

    single = mirror_albedo(theta)
    second_of_mirrors = SecondReflection(surface, theta, azimuth, _log(products[:, 0, ..., None]))
    # Where second reflections are rare, the rounding of 1 − E₁ must not appear as further ones.
    twice = second_of_mirrors.albedo(theta)
    left = np.clip(1 - single[:, None] - twice, 0.0, twice)
    attenuation = third / np.maximum(third_of_mirrors, _LEAST)[:, None]
    mirrors = table(products[:, 0, ..., None], left)
    material = table(spectral, left * attenuation)
    # Towards grazing the albedo of the first reflection bends within the last interval of the table.
    finer = np.concatenate([mirrors.albedo_nodes[1:-1], 90 - grazing[1] * 2.0 ** -np.arange(1, 12)])
    available = np.clip((1 - mirror_albedo(finer)) / np.maximum(mirrors.albedo(finer)[:, 0], _LEAST), 0.0, 1.0)
    reduction = np.ones(theta.size)
    interval = np.clip(np.searchsorted(theta, finer, side="right") - 1, 0, theta.size - 2)
    for node in (interval, interval + 1):
        np.minimum.at(reduction, node, available)
    by_pair = np.log(np.maximum(reduction[:, None] * reduction, _LEAST))[..., None, None]
    every = material.log_upward[..., where.ravel()]
    return replace(material, log_upward=every + by_pair), replace(mirrors, log_upward=mirrors.log_upward + by_pair)


def _third_reflection(surface: Microsurface, theta: Array, pairs: Array) -> tuple[Array, Array]:
    """Albedo after three reflections, of perfect mirrors, (θ,), and of unpolarised facets of each index, (θ, index).

    A quadrature over the slopes of three facets, at the points of Roberts' recurrence in six dimensions.
    """
    density = surface.density
    assert isinstance(density, RadialDensity)
    root = 1.0
    for _ in range(60):
        root = (1 + root) ** (1 / 7)
    uniform = np.modf(0.5 + np.arange(1, _PATHS + 1) * root ** -np.arange(1.0, 7.0)[:, None])[0]
    s, share = density.rule(4, 400)
    cumulative = np.cumsum(share) - share / 2
    slope = np.interp(uniform[:3], cumulative / share.sum(), s)
    p, q = slope * np.cos(2 * np.pi * uniform[3:]), slope * np.sin(2 * np.pi * uniform[3:])
    area = np.sqrt(1 + slope**2)
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / area[..., None]
    fresnel_of = np.stack([fresnel(_COSINES, *pair).mean for pair in pairs.T], axis=-1)
    mirrors, materials = [], []
    for incidence in np.radians(theta):
        towards = np.tile([np.sin(incidence), 0.0, np.cos(incidence)], (_PATHS, 1))
        weight, factor = np.ones(_PATHS), np.ones((_PATHS, pairs.shape[1]))
        steps = []
        for facet in range(3):
            cosine = np.einsum("nk,nk->n", towards, normal[facet])
            weight *= np.maximum(cosine, 0.0) * area[facet]
            factor *= _at_cosine(fresnel_of, np.clip(cosine, 0.0, 1.0))
            leaving = 2 * cosine[:, None] * normal[facet] - towards
            steps.append(leaving[:, 2])
            towards = -leaving
        weight *= (steps[2] > 0) * _height_factor(surface, np.degrees(incidence), *steps)
        mirrors.append(weight.mean())
        materials.append(weight @ factor / _PATHS)
    return np.array(mirrors), np.stack(materials)


def _height_factor(surface: Microsurface, theta_i: float, z_1: Array, z_2: Array, z_o: Array) -> Array:
    """The integral over the heights of three facets, over cos θ_i |cos θ₁| |cos θ₂|; z are the cosines of the directions after them."""
    cos_i, excess_i = _projected(surface, np.array(max(90 - theta_i, 1e-4) * -1 + 90))
    cosines = [np.maximum(np.abs(z), 1e-9) for z in (z_1, z_2, z_o)]
    lambdas = [surface.excess(c, np.sqrt((1 - c) * (1 + c)), 0.0) * np.sqrt((1 - c) * (1 + c)) / c for c in cosines]
    at_i, (at_1, at_2, at_o) = excess_i / cos_i, lambdas
    both_up = 1 / ((1 + at_i + at_1) * (1 + at_i + at_2))
    both_down = 1 / ((1 + at_1 + at_o) * (1 + at_2 + at_o))
    up_down = 1 / ((1 + at_i + at_1) * (1 + at_2 + at_o))
    down_up = (2 + at_1 + at_i + at_2 + at_o) / ((1 + at_1 + at_2) * (1 + at_1 + at_o) * (1 + at_i + at_2))
    paths = np.where(z_1 > 0, np.where(z_2 > 0, both_up, up_down), np.where(z_2 > 0, down_up, both_down))
    return np.asarray(paths / (1 + at_i + at_o) / (cos_i * cosines[0] * cosines[1]))


def _log(values: Array) -> Array:
    return np.asarray(np.log(np.maximum(values, 1e-30 * values.max())))


def fresnel_basis(pairs: Array) -> tuple[Array, Array]:
    """Functions of cos ζ that span F and its polarised part (F_s − F_p)/2 for all indices, (2, cos, rank), and their coefficients."""
    values = [fresnel(_COSINES, *pair) for pair in pairs.T]
    spectra = np.stack([np.concatenate([f.mean, (f.s - f.p) / 2]) for f in values], axis=1)
    left, singular, right = np.linalg.svd(spectra, full_matrices=False)
    rank = max(int((singular > _BASIS_ERROR * singular[0]).sum()), 1)
    return left[:, :rank].reshape(2, _COSINES.size, rank), singular[:rank, None] * right[:rank]


def upward_paths(surface: Microsurface, incidence: float, theta_o: Array, azimuth: Array, basis: Array) -> Array:
    """16-fold A of one incidence [degree], (1 + rank², θ_o, φ): for perfect mirrors, and for the products of Fresnel functions."""
    slope, turn, weight = _facets(surface, np.radians(incidence))
    cos_i, sin_i = np.cos(np.radians(incidence)), np.sin(np.radians(incidence))
    p, q, u = slope * np.cos(turn), slope * np.sin(turn), slope**2
    towards = np.maximum(cos_i - p * sin_i, 0.0)
    turned = 2 * towards / (1 + u)
    between = np.stack([-turned * p - sin_i, -turned * q, np.clip(turned - cos_i, 0.0, 1.0)], axis=1)
    cos_1 = np.minimum(towards / np.sqrt(1 + u), 1.0)
    z = between[:, 2]
    g_1 = surface.excess(z, np.sqrt((1 - z) * (1 + z)), 0.0) * np.sqrt((1 - z) * (1 + z))
    _, g_i = _projected(surface, np.array(incidence))
    share = 4 * towards * weight / np.maximum((z + g_1) * cos_i + g_i * z, _LEAST)

    cos_o, sin_o = np.cos(np.radians(theta_o))[:, None], np.sin(np.radians(theta_o))[:, None]
    width = azimuth_width(surface, np.array(cos_i), cos_o)
    forward = width * np.sinh(azimuth * np.arcsinh(np.pi / width))
    outgoing = np.stack(np.broadcast_arrays(-sin_o * np.cos(forward), sin_o * np.sin(forward), cos_o)).reshape(3, -1)
    along = between @ outgoing
    rise = outgoing[2] - z[:, None]
    upwards = rise > 0
    spread = np.where(upwards, 2 - 2 * along, 0.0) / np.where(upwards, rise, 1.0) ** 2
    kernel = np.where(upwards, surface.density_at(np.sqrt(np.maximum(spread - 1, 0.0)), np.zeros(1)) * spread**2, 0.0)
    kernel *= share[:, None]

    # Fresnel's factors: F₁ F₂ + ΔF₁ ΔF₂ cos 2ψ, ψ the angle between the two planes of incidence.
    first = np.stack([_at_cosine(values, cos_1) for values in basis])
    cos_2 = np.sqrt(np.clip((1 - along) / 2, 0.0, 1.0))
    deviation = 2 * cos_1**2 - 1
    total = np.array([sin_i, 0.0, cos_i]) @ outgoing
    sines = (1 - deviation**2)[:, None] * (1 - along**2)
    cos_2psi = 2 * (deviation[:, None] * along - total) ** 2 / np.maximum(sines, 1e-12) - 1
    polarised = kernel * np.clip(cos_2psi, -1.0, 1.0)
    rank = basis.shape[-1]
    result = np.empty((1 + rank * rank, outgoing.shape[1]))
    result[0] = kernel.sum(axis=0)
    for column in range(rank):
        mean, difference = (_at_cosine(values[:, column], cos_2) for values in basis)
        result[1 + column :: rank] = first[0].T @ (kernel * mean) + first[1].T @ (polarised * difference)
    return result.reshape(-1, theta_o.size, azimuth.size)


def _facets(surface: Microsurface, theta_i: float) -> tuple[Array, Array, Array]:
    """Quadrature over the facets that mirror (θ_i, 0) [rad] above the horizon: slope, its azimuth, and weight P22 dp dq."""
    density = surface.density
    assert isinstance(density, RadialDensity)
    # Splits where the horizon begins and ceases to limit the azimuth, which opens and closes like a square root.
    tilt = np.pi / 4 - theta_i / 2 * np.cos(np.linspace(0, np.pi, 9))
    splits = np.tan(np.minimum(tilt, 1.57)).clip(0.0, density.slope[-1])
    slope, weight = panel_rule(np.sort(np.concatenate([density.panels(_SLOPE_PANELS), splits])), 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = (1 - slope**2) / (2 * slope * np.tan(theta_i))
    start = np.arccos(np.clip(np.nan_to_num(limit, nan=1.0, posinf=1.0, neginf=-1.0), -1.0, 1.0))
    turn, turn_weight = panel_rule(np.stack([start, np.full_like(start, np.pi)], axis=-1), _FACET_AZIMUTHS)
    weight = (density(slope**2) * slope * weight)[:, None] * turn_weight
    both_sides = np.concatenate([turn, -turn], axis=1).ravel()
    repeated = np.repeat(slope, 2 * _FACET_AZIMUTHS)
    return repeated, both_sides, np.concatenate([weight, weight], axis=1).ravel()


def _at_cosine(values: Array, cos: Array) -> Array:
    """Linear interpolation of columns tabulated at ``_COSINES``, (…, column)."""
    position = np.sqrt(cos) * (_COSINES.size - 1)
    below = np.minimum(position.astype(int), _COSINES.size - 2)
    share = position - below
    if values.ndim > 1:
        share = share[..., None]
    return np.asarray(values[below] * (1 - share) + values[below + 1] * share)

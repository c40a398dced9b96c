"""Light that facets reflect one after the other, each with its own Fresnel reflectance and masking.

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

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from brdfpipe.bsdf.microfacet.energy import directional_albedo, mirror_albedo
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.compilation import compiled
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.optics.fresnel_equations import fresnel, mean_fresnel

if TYPE_CHECKING:
    from brdfpipe.bsdf.microfacet.evaluation_kernel import FurtherLight

JUDGED = np.array([60.0, 75.0])
"""Incidences whose light decides whether further reflections are modelled [degree]."""
LEAST_SHARE = 0.01
"""Share of the reflected light from which on they are."""

NODES = 24, 17
"""Angles θ of the table, and azimuths."""

_SLOPE_PANELS = 12  # of the quadrature over the first facet
_FACET_AZIMUTHS = 16  # nodes of its azimuth, on one side of the plane of incidence
_BASIS_ERROR = 1e-4  # of the Fresnel reflectance of all wavelengths, relative
_COSINES = np.linspace(0.0, 1.0, 513) ** 2  # where that reflectance is tabulated: dense at grazing, where it is steep
_DENSITY_NODES = 2048  # where the logarithm of the slope density is tabulated
_PATHS = 4096  # of the quadrature over three facets
_MOST_GAIN = 10.0  # of the light of perfect mirrors, by which a map or a lay may differ from Smith's isotropic surface
_MOST_STEP = 1.0  # of log A from the last node to grazing
_MARGIN = 0.9995  # of the missing light, up to which the table is not reduced between its nodes
_LEAST = 1e-300
_kernel = cache(compiled)  # the compiler is loaded at the first call


@dataclass(frozen=True)
class SecondReflection:
    """Table of the light that leaves after two reflections and more; reciprocal by construction.

    f₂ = A w_i w_o / [16 (1 + Λ_i + Λ_o)], with Λ that of a GGX surface of width ``slope``. A is finite at grazing and the same for
    exchanged directions; its logarithm is interpolated linearly. A surface with a lay has either factors w of both directions, or an A for
    each of several planes: their azimuth is the middle between those of the incidence and of the opposite of the light that leaves.
    Between planes f₂ is interpolated linearly.
    """

    slope: float
    """Typical slope, which sets the nodes [1]"""
    log_factor: Array
    """log A, (θ_i, θ_o, φ, plane and wavelength or 1), at :attr:`theta` and even steps of an azimuth that follows the width of the lobe"""
    weight: Array
    """w(θ, φ) of a surface with a lay, at even azimuths from 0; (θ, 0) without it"""
    planes: int = 1
    """Number of planes in half a turn, the first at azimuth 0"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, values: Array) -> SecondReflection:
        """That of a ``bsdf`` dataset, with the values of ``second_reflection`` at some wavelengths, (θ_i, θ_o, φ[, plane], wavelength or 1)."""
        weight = bsdf["second_weight"].values if "second_weight" in bsdf else np.empty((values.shape[0], 0))
        planes = values.shape[3] if values.ndim == 5 else 1
        return cls(float(bsdf["second_slope"]), _log(values).reshape(*values.shape[:3], -1), weight, planes)

    @property
    def azimuths(self) -> int:
        """Number of azimuths of incidence at which the light of a surface with a lay is known; 1 without a lay."""
        return self.weight.shape[1] or (2 * self.planes if self.planes > 1 else 1)

    @cached_property
    def theta(self) -> Array:
        """(θ,) nodes of both polar angles [degree], from 0 to 90"""
        return polar_nodes(self.slope, self.log_factor.shape[0])

    def __call__(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF of this light [sr-1], (directions, wavelength or 1); angles in degree, broadcast to (directions,)."""
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        angles = [np.atleast_1d(angle) for angle in np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)]
        width = self.log_factor.shape[-1] // self.planes
        return evaluation_kernel.further_light(self.for_kernel, angles, width)

    @cached_property
    def for_kernel(self) -> FurtherLight:
        """The table as compiled code reads it."""
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        by_plane = self.log_factor.reshape(*self.log_factor.shape[:3], self.planes, -1)
        table = np.moveaxis(by_plane, 3, 0), self.weight
        return evaluation_kernel.FurtherLight.of(*table, self.slope, grazing_scale(self.slope))

    def albedo(self, theta: Array, phi: Array | float = 0.0) -> Array:
        """Directional reflectance of this light [1], (incidences, wavelength or 1): the integral of the interpolated table."""
        theta = np.asarray(theta, dtype=float)
        if self.azimuths == 1:
            return np.asarray(self.albedo_pieces(90 - theta))
        turn = np.radians(np.broadcast_to(np.asarray(phi, dtype=float), theta.shape))
        around = self.planes if self.planes > 1 else self.weight.shape[1]
        orders = np.arange(around // 2 + 1)
        waves = (
            self.albedo_pieces(90 - theta) * np.exp(1j * (self.azimuths // around) * turn[:, None] * orders)[..., None]
        )
        # The highest order of an even number of azimuths is real.
        twice = np.where((orders == 0) | (2 * orders == around), 1.0, 2.0)
        several = np.einsum("nkl,k->nl", waves.real, twice)
        if self.planes > 1:
            return np.asarray(several)
        column = np.asarray(phi, dtype=float) / 360 * around
        polar = polar_hats(theta, self.slope, self.log_factor.shape[0])
        beside = periodic_hats(np.broadcast_to(column, theta.shape), around)
        return np.asarray(np.einsum("nt,nj,tj->n", polar, beside, self.weight)[:, None] * several)

    def mean_albedo(self) -> Array:
        """2 ∫ E μ dμ, averaged over azimuth, (wavelength,)."""
        theta, weight = panel_rule(self.theta, 4)
        phi = np.linspace(0.0, 360.0, self.azimuths, endpoint=False)
        polar, around = np.meshgrid(theta, phi, indexing="ij")
        albedo = self.albedo(polar.ravel(), around.ravel()).reshape(*polar.shape, -1).mean(axis=1)
        return np.asarray((np.radians(weight) * np.sin(np.radians(2 * theta))) @ albedo)

    @cached_property
    def albedo_pieces(self) -> PPoly:
        """Albedo over 90° − θ, (wavelength,); of a surface with a lay its Fourier series over φ without w_i, (order, wavelength)."""
        nodes = self.albedo_nodes
        if self.azimuths == 1:
            return piecewise(nodes, self.light(nodes)[0].sum(axis=(1, 2)))
        if self.planes > 1:
            light, _, turn = self.light(nodes)
            place = turn / (2 * np.pi) * self.planes
            azimuth = np.arange(self.planes)[:, None, None, None]
            shares = periodic_hats(azimuth + place, self.planes) + periodic_hats(azimuth - place, self.planes)
            by_plane = light.reshape(*turn.shape, self.planes, -1)
            from_all = np.einsum("iopkl,jiopk->ijl", by_plane, shares / 2, optimize=True)
            return piecewise(nodes, np.fft.rfft(from_all, axis=1) / self.planes)
        around = self.weight.shape[1]
        from_all = np.einsum("iojl,ojp->ipl", self.shares(nodes, around), _turned(self.weight))
        return piecewise(nodes, np.fft.rfft(from_all, axis=1) / around)

    @property
    def albedo_nodes(self) -> Array:
        """Angles at which the albedo is integrated: between the nodes of the table it is smooth, at the nodes it has kinks [degree]."""
        width = np.diff(self.theta)[:, None]
        return np.append((self.theta[:-1, None] + width * np.array([0.0, 0.25, 0.75])).ravel(), self.theta[-1])

    @property
    def closing_angles(self) -> Array:
        """The nodes θ, but for grazing, where the albedo vanishes: there an angle of the last interval [degree]."""
        return np.append(self.theta[:-1], 0.25 * self.theta[-2] + 0.75 * self.theta[-1])

    def weight_for(self, target: Array) -> Array:
        """w(θ, φ), (θ, φ, wavelength), with which f₂ w(i) w(o) of this table has the albedo ``target`` at the closing angles.

        ``target`` is (θ, φ, wavelength), with one φ for a surface without a lay.
        """
        shares = self.shares(self.closing_angles, target.shape[1])
        own = shares.sum(axis=(1, 2))[:, None]
        weight = np.sqrt(target / np.maximum(own, _LEAST))
        for _ in range(100):
            from_all = np.einsum("iojl,ojpl->ipl", shares, _turned(weight))
            weight = np.sqrt(weight * target / np.maximum(from_all, _LEAST))
        return np.asarray(weight)

    def within(self, theta: Array, available: Array) -> SecondReflection:
        """This light, reduced where it exceeds what is ``available`` at incidences ``theta`` [degree], (θ, wavelength)."""
        phi = np.linspace(0.0, 360.0, self.azimuths, endpoint=False)
        polar, around = np.meshgrid(theta, phi, indexing="ij")
        several = self.albedo(polar.ravel(), around.ravel()).reshape(*polar.shape, -1).max(axis=1)
        factor = np.clip(available, 0.0, several) / np.maximum(several, _LEAST)
        factor = np.where(several > 0, factor, 1.0).min(axis=1)
        if factor.min() == 1:
            return self
        # Of the intervals on both sides of a node the smallest one.
        low, high = np.append(0.0, self.theta[:-1])[:, None], np.append(self.theta[1:], 90.0)[:, None]
        at_nodes = np.where((theta >= low) & (theta <= high), factor, 1.0).min(axis=1)
        log = np.log(np.maximum(at_nodes, _LEAST))
        return replace(self, log_factor=self.log_factor + (log[:, None] + log)[..., None, None])

    def shares(self, incidence: Array, around: int) -> Array:
        """Light of each incidence that belongs to each node θ_o and azimuth φ_o − φ_i, (θ_i, θ_o, φ, wavelength)."""
        light, theta, turn = self.light(incidence)
        position = turn / (2 * np.pi) * around
        both = periodic_hats(around / 2 + position, around) + periodic_hats(around / 2 - position, around)
        polar = polar_hats(theta, self.slope, self.log_factor.shape[0])
        return np.einsum("itpl,to,itpj->iojl", light, polar, both / 2, optimize=True)

    def light(self, incidence: Array) -> tuple[Array, Array, Array]:
        """Light of each incidence into the nodes of a quadrature over θ_o and both sides in azimuth, without w.

        Returns
        -------
        light : (θ_i, θ_o, φ, plane and wavelength), as if all azimuths had the A of one plane
        theta : (θ_o,) degree
        turn : (θ_i, θ_o, φ) from the forward plane [rad]
        """
        theta, weight = panel_rule(self.theta, 3)
        weight = np.radians(weight) * np.sin(np.radians(theta)) * np.cos(np.radians(theta))
        width = azimuth_width(self.slope, np.cos(np.radians(incidence))[:, None], np.cos(np.radians(theta)))[..., None]
        azimuth = np.linspace(0.0, 1.0, self.log_factor.shape[2])
        turn, turn_weight = panel_rule(width * np.sinh(azimuth * np.arcsinh(np.pi / width)), 2)
        angles = np.broadcast_arrays(incidence[:, None, None], 0.0, theta[:, None], 180 + np.degrees(turn))
        bare = replace(self, weight=self.weight[:, :0], planes=1)
        values = bare(*(angle.ravel() for angle in angles)).reshape(*turn.shape, -1)
        return (2 * weight[:, None] * turn_weight)[..., None] * values, theta, turn


def periodic_hats(position: Array, count: int) -> Array:
    """Shares of ``count`` nodes around the circle in a linear interpolation at positions in steps, (…, node)."""
    distance = np.abs((position[..., None] - np.arange(count) + count / 2) % count - count / 2)
    return np.asarray(np.maximum(1 - distance, 0.0) if count > 1 else np.ones(distance.shape))


def _turned(weight: Array) -> Array:
    """w(θ_o, φ_i + φ) of w(θ_o, φ), (θ_o, φ, φ_i, …)."""
    count = weight.shape[1]
    return weight[:, (np.arange(count)[:, None] + np.arange(count)) % count]


def polar_hats(theta: Array, slope: float, count: int) -> Array:
    """Shares of the ``count`` nodes θ in an interpolation at angles [degree], (angles, θ)."""
    scale = grazing_scale(slope)
    at = count - 1 - np.arcsinh((90 - theta) / scale) * ((count - 1) / np.arcsinh(90 / scale))
    return np.asarray(np.maximum(1 - np.abs(at[:, None] - np.arange(count)), 0.0))


def polar_nodes(slope: float, count: int) -> Array:
    """Nodes θ of a table [degree], from 0 to 90, dense at grazing on the scale of the slopes."""
    scale = grazing_scale(slope)
    grazing = scale * np.sinh(np.linspace(0.0, np.arcsinh(90 / scale), count))
    grazing[-1] = 90.0
    return np.asarray(90 - grazing[::-1])


def grazing_scale(slope: float) -> float:
    """Angle from grazing up to which the nodes are evenly spaced [degree]."""
    return float(np.degrees(min(slope, 0.6)) / 2)


def azimuth_width(slope: float, cos_i: Array, cos_o: Array) -> Array:
    """Azimuth over which the lobe extends beside the plane of incidence [rad]: a facet's slope across it is about that over μ_i + μ_o."""
    return np.asarray(np.minimum(slope * (cos_i + cos_o) + 1e-3, 4.0))


def piecewise(nodes: Array, values: NDArray[np.inexact[Any]]) -> PPoly:
    """One cubic of 90° − θ in each interval of the table, through values at four of the nodes θ (one shared with each neighbour)."""
    nodes, values = 90 - nodes[::-1], values[::-1]
    ends = nodes[::3]
    x = np.array([0.0, 0.25, 0.75, 1.0])
    at = np.arange(ends.size - 1)[:, None] * 3 + np.arange(4)
    coefficients = np.einsum("ck,ik...->ci...", np.linalg.inv(np.vander(x)), values[at])
    scale = np.diff(ends)[None] ** np.arange(3, -1, -1)[:, None]
    return PPoly(coefficients / scale.reshape(*scale.shape, *([1] * (values.ndim - 1))), ends)


def with_second_reflection(bsdf: xr.Dataset, second: SecondReflection) -> xr.Dataset:
    """The dataset with the table of the second reflection."""
    spectral, dims = bsdf["n"].dims, ["second_theta_i", "second_theta_o", "second_azimuth"]
    values = np.exp(second.log_factor)
    azimuth = np.linspace(0.0, 1.0, values.shape[2])
    if second.planes > 1:
        dims.append("second_plane")
        values = values.reshape(*values.shape[:3], second.planes, -1)
        bsdf = bsdf.assign_coords(second_plane=np.linspace(0.0, 180.0, second.planes, endpoint=False))
    bsdf = bsdf.assign_coords(second_theta_i=second.theta, second_theta_o=second.theta, second_azimuth=azimuth).assign(
        second_reflection=((*dims, *spectral), values if spectral else values[..., 0]), second_slope=second.slope
    )
    if not second.weight.size:
        return bsdf
    phi = np.linspace(0.0, 360.0, second.weight.shape[1], endpoint=False)
    return bsdf.assign_coords(second_phi=phi).assign(second_weight=(("second_theta_i", "second_phi"), second.weight))


def second_reflection(
    surface: Microsurface, n: Array, k: Array, missing: Callable[[Array, Array], Array], azimuths: int = 1
) -> SecondReflection:
    """The second and further reflections of a surface.

    Smith's surface of the same slopes without a lay gives the directions. All further reflections together have those of the second
    one. Their share is what the first two leave of the light of perfect mirrors, reduced as the third reflection is; where it exceeds
    the second reflection, the rest is diffuse. Factors of either direction then give perfect mirrors the light that is missing.

    Parameters
    ----------
    surface : isotropic; of a surface with a lay the average over azimuth
    n, k : (wavelength,) index relative to the medium of incidence
    missing : light that the single reflection of perfect mirrors leaves, (θ, φ) in degree → (directions,)
    azimuths : number of azimuths at which it is sampled, of a surface with a lay

    Notes
    -----
    Where the interpolation would make perfect mirrors reflect more than they receive, the table is reduced at these angles.

    References
    ----------
    Kulla & Conty 2017, for the diffuse rest.
    """
    table, where = of_smith_surface(surface, n, k)
    weight = _closing_weight(replace(table, log_factor=table.log_factor[..., :1]), missing, azimuths)
    of_material = table.log_factor[..., 1:][..., where]
    if azimuths > 1:
        return replace(table, log_factor=of_material, weight=weight)
    by_pair = np.log(np.maximum(weight * weight.T, _LEAST))
    return replace(table, log_factor=of_material + by_pair[..., None, None])


def of_smith_surface(
    surface: Microsurface, n: Array, k: Array, nodes: tuple[int, int] = NODES
) -> tuple[SecondReflection, NDArray[np.intp]]:
    """The reflections of Smith's isotropic surface, of which perfect mirrors need not give all light that is missing.

    Returns
    -------
    SecondReflection : of perfect mirrors, and of each different index
    (wavelength,) : number of the index of each wavelength among them, from 0
    """
    slope = surface.typical_slope
    theta = polar_nodes(slope, nodes[0])
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    table = SecondReflection(slope, _log(_factors(surface, theta, pairs, nodes[1])), np.empty((theta.size, 0)))
    at = table.closing_angles
    third_of_mirrors, third = _several_reflections(surface, at, pairs)[1]
    every = np.concatenate([third_of_mirrors[:, None], third], axis=1)
    attenuation = every / np.maximum(third_of_mirrors, _LEAST)[:, None]
    left = 1 - mirror_albedo(surface, "height-correlated", at)
    twice = table.shares(at, 1)[..., 0].sum(axis=(1, 2))
    # Where second reflections are rare, the rounding of 1 − E₁ must not appear as further ones.
    further = np.clip(left - twice, 0.0, twice)
    scale = table.weight_for((further[:, None] * attenuation)[:, None])[:, 0]
    factors = np.exp(table.log_factor) * (1 + (scale[:, None] * scale)[..., None, :])
    rest = _diffuse_rest(slope, at, np.maximum(left - twice - further, 0.0), pairs)
    return replace(table, log_factor=_log(factors + rest[:, :, None])), where.ravel()


def _closing_weight(mirrors: SecondReflection, missing: Callable[[Array, Array], Array], azimuths: int) -> Array:
    """w(θ, φ) with which perfect mirrors, whose table is given, reflect what a single reflection leaves, but no more."""
    phi = np.linspace(0.0, 360.0, azimuths, endpoint=False)

    def on_grid(theta: Array) -> Array:
        polar, around = np.meshgrid(theta, phi, indexing="ij")
        return missing(polar.ravel(), around.ravel()).reshape(polar.shape)

    # Also between the nodes, and towards grazing, where the albedo of the first reflection bends within the last interval.
    theta = mirrors.theta
    last = np.concatenate([np.arange(7, 0, -1) / 8, 2.0 ** -np.arange(4, 12)])
    probes = np.unique(np.concatenate([mirrors.albedo_nodes[:-1], 90 - (90 - theta[-2]) * last]))
    interval = np.clip(np.searchsorted(theta, probes, side="right") - 1, 0, theta.size - 2)
    shares, hats = mirrors.shares(probes, azimuths)[..., 0], polar_hats(probes, mirrors.slope, theta.size)
    own = shares.sum(axis=(1, 2))[:, None]
    available = on_grid(probes)
    target = np.clip(available, 1e-6 * own, _MOST_GAIN * own)

    def worst(given: Array, limit: Array) -> Array:
        """The smallest ratio of the limit to what is given, in the intervals beside each node, (θ, φ)."""
        ratio = np.full((theta.size, azimuths), np.inf)
        for node in (interval, interval + 1):
            np.minimum.at(ratio, node, limit / np.maximum(given, _LEAST))
        return ratio

    weight = np.ones((theta.size, azimuths))
    for _ in range(100):
        from_all = np.einsum("ioj,ojp->ip", shares, _turned(weight), optimize=True)
        weight = weight * np.sqrt(worst(hats @ weight * from_all, target))
    # The shares of the nodes are linear, the table is interpolated by its logarithm.
    if azimuths > 1:
        closed = replace(mirrors, weight=weight)
    else:
        closed = replace(mirrors, log_factor=mirrors.log_factor + np.log(weight * weight.T)[..., None, None])
    around = np.broadcast_to(phi, available.shape)
    given = closed.albedo(np.repeat(probes, azimuths), around.ravel())[:, 0].reshape(available.shape)
    return np.asarray(weight * np.clip(_MARGIN * worst(given, available), 0.0, 1.0))


def _diffuse_rest(slope: float, theta: Array, rest: Array, pairs: Array) -> Array:
    """A of diffuse light, (θ_i, θ_o, 1 + index): what perfect mirrors, the first, lack after all other light, ``rest`` (θ,)."""
    polar, weight = panel_rule(np.append(theta, 90.0), 3)
    lost = float(
        np.radians(weight)
        * np.sin(np.radians(2 * polar))
        @ np.interp(polar, np.append(theta, 90.0), np.append(rest, 0.0))
    )
    reflectance = np.append(1.0, mean_fresnel(*pairs))
    shares = reflectance**3 * (1 - lost) / (1 - reflectance * lost)
    cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    hidden = (np.sqrt(1 + (slope * sin / cos) ** 2) - 1) / 2
    seen = 16 * (1 + hidden[:, None] + hidden)
    return np.asarray((seen * rest[:, None] * rest / (np.pi * max(lost, _LEAST)))[..., None] * shares)


def _factors(surface: Microsurface, theta: Array, pairs: Array, azimuths: int) -> Array:
    """A of the second reflection at the nodes, (θ_i, θ_o, φ, 1 + index): of perfect mirrors, and of each index."""
    basis, coefficients = fresnel_basis(pairs)
    azimuth = np.linspace(0.0, 1.0, azimuths)
    theta = theta[:-1]
    upwards = np.stack([upward_paths(surface, incidence, theta, azimuth, basis) for incidence in theta])
    products = (coefficients[:, None] * coefficients[None]).reshape(coefficients.shape[0] ** 2, -1)
    upwards = np.concatenate([upwards[..., :1], upwards[..., 1:] @ products], axis=-1)
    cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    smith = surface.excess(cos, sin, 0.0) * sin / cos
    ggx = (np.sqrt(1 + (surface.typical_slope * sin / cos) ** 2) - 1) / 2
    seen = [1 + hidden[:, None] + hidden for hidden in (ggx, smith)]
    # A path downwards is one upwards in reverse.
    upwards = upwards / (cos[:, None] * cos)[..., None, None] * cos[:, None, None, None]
    both = (upwards + upwards.swapaxes(0, 1)) * (seen[0] / seen[1])[..., None, None]
    # A is smooth up to grazing, where the quadrature has no paths.
    logs = _log(both)
    for axis in (0, 1):
        last, before = (np.take(logs, [place], axis=axis) for place in (-1, -2))
        logs = np.concatenate([logs, last + np.clip(last - before, -_MOST_STEP, _MOST_STEP)], axis=axis)
    return np.asarray(np.exp(logs))


def _projected(surface: Microsurface, theta: Array) -> tuple[Array, Array]:
    """cos θ, and g sin θ: together cos θ (1 + Λ)."""
    cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
    cos = np.where(theta >= 90, 0.0, cos)
    return cos, surface.excess(cos, sin, 0.0) * sin


def mean_share(surface: Microsurface, n: Array, k: Array) -> Array:
    """Light that leaves an isotropic surface after two or three reflections, mean over the hemisphere, (wavelength,), to about 10 %.

    Parameters
    ----------
    surface : isotropic, with Smith's masking
    n, k : (wavelength,) index relative to the medium of incidence
    """
    theta, weight = panel_rule(np.array([0.0, 45.0, 75.0, 90.0]), 4)
    (_, second), (_, third) = _several_reflections(surface, theta, np.stack(np.broadcast_arrays(n, k)))
    return np.asarray((np.radians(weight) * np.sin(np.radians(2 * theta))) @ (second + third))


def lost_share(surface: Microsurface, n: Array, k: Array) -> tuple[float, float]:
    """Largest share of the reflected light that leaves Smith's surface after two or three reflections, and its incidence [degree].

    Of the incidences :data:`JUDGED` and all wavelengths; 0 where perfect mirrors show that it is below :data:`LEAST_SHARE`.

    Parameters
    ----------
    surface : isotropic, with Smith's masking
    n, k : (wavelength,) index relative to the medium of incidence
    """
    single = directional_albedo(surface, "height-correlated", n, k, JUDGED)
    missing = 1 - mirror_albedo(surface, "height-correlated", JUDGED)
    if np.all(missing[:, None] < LEAST_SHARE * single):
        return 0.0, float(JUDGED[-1])
    pairs, where = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1, return_inverse=True)
    (_, second), (_, third) = _several_reflections(surface, JUDGED, pairs)
    return largest_share((second + third)[:, where.ravel()], single)


def largest_share(several: Array, single: Array) -> tuple[float, float]:
    """Largest share of light reflected more than once, (θ, wavelength) at :data:`JUDGED`, and its incidence [degree]."""
    share = several / np.maximum(several + single, _LEAST)
    row, column = np.unravel_index(int(share.argmax()), share.shape)
    return float(share[row, column]), float(JUDGED[row])


def _several_reflections(surface: Microsurface, theta: Array, pairs: Array) -> list[tuple[Array, Array]]:
    """Albedo after two and after three reflections, of perfect mirrors, (θ,), and of facets of each index, (θ, index), each.

    A quadrature over the slopes of the facets, at the points of Roberts' recurrence in six dimensions.
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
    stokes = reflection_of_stokes(pairs)
    sums = np.zeros((2, theta.size, 1 + pairs.shape[1]))
    cosines, steps = np.empty((2, 3, _PATHS))
    weight, turns = np.empty((2, _PATHS)), np.empty((2, 2, _PATHS))
    for row, incidence in enumerate(np.radians(theta)):
        _kernel(_follow_paths)(np.sin(incidence), np.cos(incidence), normal, area, cosines, steps, weight, turns)
        for several, heights in enumerate(_height_factors(surface, np.degrees(incidence), steps)):
            last = several + 2
            seen = weight[several] * (steps[several + 1] > 0) * heights
            _kernel(_add_several)(seen, cosines[:last], turns[: last - 1], stokes, sums[several, row])
    return [(albedo[:, 0] / _PATHS, albedo[:, 1:] / _PATHS) for albedo in sums]


def reflection_of_stokes(pairs: Array) -> Array:
    """Factors at ``_COSINES`` that a reflection gives to Stokes' parameters, (4, cos, index).

    (F_s + F_p)/2 and (F_s − F_p)/2, and real and imaginary part of r_s r_p*, which multiplies U + iV.
    """
    # Neither 0/0 at grazing nor an infinite index.
    cos, epsilon = np.maximum(_COSINES, 1e-12)[:, None], (np.minimum(pairs[0], 1e9) + 1j * pairs[1]) ** 2
    inner = np.sqrt(epsilon - 1 + cos**2)
    r_s, r_p = -(epsilon - 1) / (cos + inner) ** 2, (epsilon * cos - inner) / (epsilon * cos + inner)
    f_s, f_p = np.abs(r_s) ** 2, np.abs(r_p) ** 2
    crossed = r_s * r_p.conj()
    return np.stack([(f_s + f_p) / 2, (f_s - f_p) / 2, crossed.real, crossed.imag])


def _height_factors(surface: Microsurface, theta_i: float, steps: Array) -> tuple[Array, Array]:
    """The integrals over the heights of two and of three facets, over cos θ_i and |cos θ| between them, (paths,) each.

    ``steps`` (3, paths) are the cosines of the directions after each facet.
    """
    cos_i, excess_i = _projected(surface, np.array(max(90 - theta_i, 1e-4) * -1 + 90))
    cosines = np.maximum(np.abs(steps), 1e-9)
    sines = np.sqrt((1 - cosines) * (1 + cosines))
    at_1, at_2, at_3 = surface.excess(cosines, sines, 0.0) * sines / cosines
    at_i, upwards = excess_i / cos_i, steps > 0
    up = 1 + at_i + at_1
    twice = np.where(upwards[0], 1 / up, 1 / (1 + at_1 + at_2)) / (1 + at_i + at_2) / (cos_i * cosines[0])
    both_up = 1 / (up * (1 + at_i + at_2))
    both_down = 1 / ((1 + at_1 + at_3) * (1 + at_2 + at_3))
    up_down = 1 / (up * (1 + at_2 + at_3))
    down_up = (2 + at_1 + at_i + at_2 + at_3) / ((1 + at_1 + at_2) * (1 + at_1 + at_3) * (1 + at_i + at_2))
    paths = np.where(upwards[0], np.where(upwards[1], both_up, up_down), np.where(upwards[1], down_up, both_down))
    thrice = paths / (1 + at_i + at_3) / (cos_i * cosines[0] * cosines[1])
    return np.asarray(twice), np.asarray(thrice)


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
    """16-fold ∫ F₁ F₂ D₁ D₂ (cos θ_o + g_o sin θ_o)/… over paths upwards."""
    slope, turn, weight = _facets(surface, np.radians(incidence))
    cos_i, sin_i = np.cos(np.radians(incidence)), np.sin(np.radians(incidence))
    p, q, u = slope * np.cos(turn), slope * np.sin(turn), slope**2
    towards = np.maximum(cos_i - p * sin_i, 0.0)
    turned = 2 * towards / (1 + u)
    z = np.clip(turned - cos_i, 0.0, 1.0)
    cos_1 = np.minimum(towards / np.sqrt(1 + u), 1.0)
    g_1 = surface.excess(z, np.sqrt((1 - z) * (1 + z)), 0.0) * np.sqrt((1 - z) * (1 + z))
    _, g_i = _projected(surface, np.array(incidence))
    share = 4 * towards * weight / np.maximum((z + g_1) * cos_i + g_i * z, _LEAST)
    first = np.stack([_at_cosine(values, cos_1) for values in basis], axis=1)
    facets = np.stack([-turned * p - sin_i, -turned * q, z, share, 2 * cos_1**2 - 1], axis=1)[share > 0]

    cos_o, sin_o = np.cos(np.radians(theta_o))[:, None], np.sin(np.radians(theta_o))[:, None]
    width = azimuth_width(surface.typical_slope, np.array(cos_i), cos_o)
    forward = width * np.sinh(azimuth * np.arcsinh(np.pi / width))
    outgoing = np.stack(np.broadcast_arrays(-sin_o * np.cos(forward), sin_o * np.sin(forward), cos_o), axis=-1)
    result = np.zeros((*forward.shape, 1 + basis.shape[-1] ** 2))
    _kernel(_add_paths)(
        facets,
        first[share > 0],
        outgoing.reshape(-1, 3),
        np.array([sin_i, 0.0, cos_i]),
        *_log_density(surface),
        basis,
        result.reshape(-1, result.shape[-1]),
    )
    return result


def _log_density(surface: Microsurface) -> tuple[Array, float, float]:
    """log P22 at even steps of s/(s + w), the scale w, and the steepest slope."""
    density = surface.density
    assert isinstance(density, RadialDensity)
    scale, steepest = density.median_slope, float(density.slope[-1])
    share = np.linspace(0.0, steepest / (steepest + scale), _DENSITY_NODES)
    slope = np.minimum(scale * share / (1 - share), steepest)
    return np.log(np.maximum(density(slope**2), _LEAST)), scale, steepest


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


# --- compiled


def _add_paths(
    facets: Array,
    first: Array,
    outgoing: Array,
    incoming: Array,
    log_density: Array,
    density_scale: float,
    steepest: float,
    basis: Array,
    result: Array,
) -> None:
    """Add the light that a second facet reflects towards each of some directions.

    Parameters
    ----------
    facets : (n, 5) direction of the light from each first facet, its weight, and the cosine of the angle by which it was turned
    first : (n, 2, rank) Fresnel functions at the first facet
    outgoing, incoming : (m, 3) and (3,) directions
    log_density, density_scale, steepest : of :func:`_log_density`
    basis : (2, cosines, rank) Fresnel functions, F and (F_s − F_p)/2
    result : (m, 1 + rank²) is added to, for perfect mirrors and for the products of two functions
    """
    rank, cosines, nodes = basis.shape[2], basis.shape[1], log_density.size
    density_step = (nodes - 1) * (steepest + density_scale) / steepest
    for m in range(outgoing.shape[0]):
        ox, oy, oz = outgoing[m, 0], outgoing[m, 1], outgoing[m, 2]
        total = incoming[0] * ox + incoming[1] * oy + incoming[2] * oz
        for f in range(facets.shape[0]):
            hz = oz - facets[f, 2]
            if hz <= 0:
                continue
            hx, hy = ox - facets[f, 0], oy - facets[f, 1]
            across = hx * hx + hy * hy
            squared = across / (hz * hz)
            if squared >= steepest * steepest:
                continue
            slope = math.sqrt(squared)
            at = slope / (slope + density_scale) * density_step
            node = min(int(at), nodes - 2)
            value = log_density[node] + (at - node) * (log_density[node + 1] - log_density[node])
            power = facets[f, 3] * math.exp(value) * (1 + squared) * (1 + squared)
            # Fresnel's factors: F₁ F₂ + ΔF₁ ΔF₂ cos 2ψ, ψ the angle between the two planes of incidence.
            cos_squared = min((across + hz * hz) / 4, 1.0)
            along = 1 - 2 * cos_squared
            turned = facets[f, 4]
            sines = (1 - turned * turned) * (1 - along * along)
            difference = turned * along - total
            cos_2psi = 2 * difference * difference / max(sines, 1e-12) - 1
            cos_2psi = min(max(cos_2psi, -1.0), 1.0)
            at = math.sqrt(math.sqrt(cos_squared)) * (cosines - 1)
            node = min(int(at), cosines - 2)
            share = at - node
            result[m, 0] += power
            for b in range(rank):
                mean = basis[0, node, b] + share * (basis[0, node + 1, b] - basis[0, node, b])
                half = basis[1, node, b] + share * (basis[1, node + 1, b] - basis[1, node, b])
                for a in range(rank):
                    product = first[f, 0, a] * mean + first[f, 1, a] * half * cos_2psi
                    result[m, 1 + a * rank + b] += power * product


def _follow_paths(
    sin_i: float, cos_i: float, normal: Array, area: Array, cosines: Array, steps: Array, weight: Array, turns: Array
) -> None:
    """Directions of light that three facets reflect one after the other.

    Parameters
    ----------
    sin_i, cos_i : of the incidence
    normal, area : (3, n, 3) and (3, n) of the facets
    cosines, steps : (3, n) cosines of the angle of incidence on each facet and of the direction after it, which are filled in
    weight : (2, n) after two and after three facets, which is filled in
    turns : (2, 2, n) cosine and sine of the angle between the planes of incidence of a facet and the next, which are filled in
    """
    for path in range(normal.shape[1]):
        # Towards the light of a facet, and its frame: s, and the direction of the light × s.
        x, y, z, light = sin_i, 0.0, cos_i, 1.0
        s_x, s_y, s_z, p_x, p_y, p_z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for facet in range(3):
            n_x, n_y, n_z = normal[facet, path, 0], normal[facet, path, 1], normal[facet, path, 2]
            cosine = x * n_x + y * n_y + z * n_z
            light *= max(cosine, 0.0) * area[facet, path]
            cosines[facet, path] = min(max(cosine, 0.0), 1.0)
            a_x, a_y, a_z = n_y * z - n_z * y, n_z * x - n_x * z, n_x * y - n_y * x
            length = max(math.sqrt(a_x * a_x + a_y * a_y + a_z * a_z), _LEAST)
            a_x, a_y, a_z = a_x / length, a_y / length, a_z / length
            if facet > 0:
                turns[facet - 1, 0, path] = s_x * a_x + s_y * a_y + s_z * a_z
                turns[facet - 1, 1, path] = p_x * a_x + p_y * a_y + p_z * a_z
                weight[facet - 1, path] = light
            x, y, z = 2 * cosine * n_x - x, 2 * cosine * n_y - y, 2 * cosine * n_z - z
            steps[facet, path] = z
            s_x, s_y, s_z = a_x, a_y, a_z
            p_x, p_y, p_z = y * a_z - z * a_y, z * a_x - x * a_z, x * a_y - y * a_x
            x, y, z = -x, -y, -z


def _add_several(weight: Array, cosines: Array, turns: Array, stokes: Array, result: Array) -> None:
    """Add the unpolarised light that two or three facets reflect one after the other.

    Parameters
    ----------
    weight : (n,) of each path
    cosines : (2 or 3, n) of the angles of incidence on the facets
    turns : (1 or 2, 2, n) cosine and sine of the angle between the planes of incidence of a facet and the next
    stokes : of :func:`reflection_of_stokes`
    result : (1 + index,) is added to: for perfect mirrors, and for each index
    """
    last = stokes.shape[1] - 1
    for path in range(weight.size):
        if weight[path] <= 0:
            continue
        result[0] += weight[path]
        at = math.sqrt(cosines[0, path]) * last
        first = min(int(at), last - 1)
        share = at - first
        for index in range(stokes.shape[2]):
            # Stokes' parameters I, Q and U in the frame of each facet; V does not return to I within three reflections.
            intensity = stokes[0, first, index] * (1 - share) + stokes[0, first + 1, index] * share
            polarised = stokes[1, first, index] * (1 - share) + stokes[1, first + 1, index] * share
            diagonal = 0.0
            for facet in range(1, cosines.shape[0]):
                cos, sin = turns[facet - 1, 0, path], turns[facet - 1, 1, path]
                double, twice = cos * cos - sin * sin, 2 * cos * sin
                polarised, diagonal = polarised * double + diagonal * twice, diagonal * double - polarised * twice
                at = math.sqrt(cosines[facet, path]) * last
                node = min(int(at), last - 1)
                part = at - node
                mean = stokes[0, node, index] * (1 - part) + stokes[0, node + 1, index] * part
                half = stokes[1, node, index] * (1 - part) + stokes[1, node + 1, index] * part
                product = stokes[2, node, index] * (1 - part) + stokes[2, node + 1, index] * part
                intensity, polarised = mean * intensity + half * polarised, half * intensity + mean * polarised
                diagonal *= product
            result[1 + index] += weight[path] * intensity

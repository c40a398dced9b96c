"""Tables of Mitsuba's plugin ``measured``: those of a BSDF, the size that keeps a tolerance, and the BRDF that the plugin evaluates from them.

See :mod:`brdfpipe.exchange.rgl` for the fields.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Pairs, TableError, error_of, errors_at, fresh_pairs, rules
from brdfpipe.exchange import gridded
from brdfpipe.exchange.bilinear_warp import BilinearWarp, Slices
from brdfpipe.exchange.gridded import Channels
from brdfpipe.geometry import Array, angles_of, unit_vector

_SIDES = (16, 24, 32, 36, 40, 44, 48, 56, 64, 80, 96)
"""Numbers of nodes along a side of the square that are tried."""
_COMPARED_SHARES = 32
"""Side to which shares of nodes spread evenly are compared."""
_INCIDENCES_PER_SIDE, _AZIMUTHS_PER_SIDE = (0.4, 0.5), 0.9
"""Polar angles of incidence without a lay and with one, and then azimuths in a turn: with these finer steps of each take off about as much of the error for their size."""
_LEAST_INCIDENCES, _LEAST_AZIMUTHS = 10, 3
_SYMMETRIC = 0.1
"""Share of the tolerance by which the BSDF may contradict a symmetry for which less of the circle is written."""
_LAST_INCIDENCE = 88.0
_TOWARDS_GRAZING = 1.5
"""Power by which steps between incidences shrink towards grazing, where Fresnel's reflectance and masking change fastest."""
_FACETS, _VISIBLE = (128, 384), {False: (16, 64), True: (32, 96)}
"""Intervals of azimuth and nodes of the polar angle of the facet density, which is written once and is a factor of every value; and of that of visible
facets (key: without a lay), which is written for each incidence and places the nodes alone."""
_EVEN_SHARE = 1e-5
"""Share of facets that are spread evenly, so that the BRDF over the facet density is finite; more of them would make it fall as steeply as the lobe."""
_EVEN_SHARES_OF_NODES = (0.01, 0.1, 0.3)
"""Shares of nodes spread evenly that are tried: many serve a lay, whose lobe is narrow one way and wide the other, few a narrow lobe."""


@dataclass(frozen=True)
class Tables:
    """Content of a file, and the BRDF that the plugin evaluates from it."""

    phi_i: Array
    """(n,) radian; one or two: isotropic. Otherwise a circle, half or a quarter of it from −π"""
    theta_i: Array
    """(m,) radian"""
    ndf: Array
    """(azimuth, polar)"""
    sigma: Array
    """(azimuth, polar) of the direction of incidence"""
    vndf: Array
    """(n · m, azimuth, polar)"""
    values: Array
    """(n · m, channels, rows, columns)"""
    visible: Array
    """(n · m, rows, columns) density of the facets that each incidence sees, over ``vndf``"""

    @classmethod
    def of_fields(cls, fields: Mapping[str, Array], kind: str) -> Tables:
        """Of the fields of a file; ``kind`` is ``rgb`` or ``spectra``. What is visible is not read."""
        given = {name: np.asarray(fields[name], dtype=float) for name in ("phi_i", "theta_i", "ndf", "sigma")}
        vndf, values = (
            np.asarray(fields[name], dtype=float).reshape(-1, *fields[name].shape[2:]) for name in ("vndf", kind)
        )
        return cls(**given, vndf=vndf, values=values, visible=np.ones_like(values[:, 0]))

    @property
    def isotropic(self) -> bool:
        return self.phi_i.size <= 2

    @property
    def reduction(self) -> int:
        """1; 2 of a table that is the same half a turn further; 4 of one that is also the same on both sides of the axes, 0 and 90 degree."""
        return 1 if self.isotropic else round(2 * np.pi / (self.phi_i[-1] - self.phi_i[0]))

    @cached_property
    def _warp(self) -> BilinearWarp:
        return BilinearWarp.of(self.vndf)

    def slices(self, theta_i: Array, phi_i: Array) -> Slices:
        """Of incidences [radian]; azimuths are those of the file."""
        return Slices.at((self.phi_i, self.theta_i), (phi_i, theta_i))

    def _folded(self, incident: Array, outgoing: Array) -> tuple[Array, Array]:
        """Both directions (n, 3), turned or mirrored so that the azimuth of incidence is within that of the table."""
        if self.reduction < 2:
            return incident, outgoing
        sides = incident[..., :2] if self.reduction == 4 else incident[..., [1, 1]]
        signs = np.concatenate([-np.copysign(1.0, sides), np.ones_like(sides[..., :1])], axis=-1)
        return incident * signs, outgoing * signs

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF (directions, channels) [sr-1], angles in degree."""
        incident, outgoing = self._folded(unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o))
        polar, around = (np.radians(angle) for angle in angles_of(incident + outgoing))
        azimuth = np.arctan2(incident[..., 1], incident[..., 0])
        x, y = (
            np.sqrt(2 * polar / np.pi),
            ((around - azimuth if self.isotropic else around) + np.pi) / (2 * np.pi) % 1.0,
        )
        slices = self.slices(np.radians(theta_i), azimuth)
        first, second = self._warp.to_even(slices, x, y)
        here = Slices(np.zeros((1, x.size), dtype=np.intp), np.ones((1, x.size)))
        scale = _bilinear(self.ndf[None], here, x, y) / (
            4
            * _bilinear(
                self.sigma[None], here, np.sqrt(2 * np.radians(theta_i) / np.pi), (azimuth + np.pi) / (2 * np.pi)
            )
        )
        read = np.stack(
            [_bilinear(self.values[:, c], slices, first, second) for c in range(self.values.shape[1])], axis=-1
        )
        cosine = np.cos(np.radians(theta_o))
        above = (cosine > 0) & (np.asarray(theta_i) < 90)
        return np.asarray(np.where(above[:, None], read * scale[:, None] / np.maximum(cosine, 1e-9)[:, None], 0.0))


def _bilinear(values: Array, slices: Slices, x: Array, y: Array) -> Array:
    """Values (slices, rows, columns) at points of the unit square."""
    return BilinearWarp(values).at(slices, x, y)


class Size(NamedTuple):
    """Numbers of nodes."""

    side: int
    """Along each side of the square"""
    incidences: int
    """Polar angles"""
    azimuths: int
    """Of incidence, in the written part of the circle; 1 without a lay"""
    even_share: float
    """Share of the nodes that is spread evenly"""
    reduction: int = 1
    """See :attr:`Tables.reduction`"""

    @property
    def values(self) -> int:
        """Of one channel."""
        return self.side**2 * self.incidences * self.azimuths


def _facets(bsdf: xr.Dataset, intervals: int, nodes: int) -> tuple[Array, Array, Array]:
    """Facet density on its grid, from the light that returns to where it came from; its polar angles and azimuths [radian]."""
    model = representation(bsdf)
    x, y = np.linspace(0, 1, nodes), np.linspace(0, 1, intervals + 1)
    polar, around = np.minimum(np.pi / 2 * x**2, np.radians(89.0)), (2 * y - 1) * np.pi
    theta, phi = np.meshgrid(np.degrees(polar), np.degrees(around))
    azimuth = np.zeros_like(phi) if model.isotropic else phi
    returned = 4 * model.evaluate(theta, azimuth, theta, azimuth, None)[..., 0] * np.cos(np.radians(theta)) ** 2
    # Facets per projected area; the steps are those of even nodes in the root of the polar angle.
    projected = np.cos(polar) * np.sin(polar) * np.sqrt(2 * polar / np.pi)
    total = np.pi**2 * 2 * np.mean((returned * projected)[:-1].mean(axis=0))
    even = np.full_like(returned, 1 / np.pi)
    return (1 - _EVEN_SHARE) * returned / total + _EVEN_SHARE * even if total > 0 else even, polar, around


def tables_of(bsdf: xr.Dataset, channels: Channels, size: Size) -> Tables:
    """The tables of a BSDF."""
    model, reduced = representation(channels.source), nonspectral(bsdf)
    ndf = _facets(reduced, 1 if model.isotropic else _FACETS[0], _FACETS[1])[0]
    coarse, polar, around = _facets(reduced, *_VISIBLE[model.isotropic])
    normals = unit_vector(*np.degrees(np.broadcast_arrays(polar[None, :], around[:, None])))
    stretch = np.sqrt(2 * polar / np.pi) * np.sin(polar)
    phi_i = np.zeros(1) if model.isotropic else np.linspace(-np.pi, 2 * np.pi / size.reduction - np.pi, size.azimuths)
    theta_i = np.radians(_LAST_INCIDENCE * (1 - np.linspace(1.0, 0.0, size.incidences) ** _TOWARDS_GRAZING))
    facing = np.array(
        [
            np.maximum((normals * unit_vector(np.degrees(theta), np.degrees(phi))).sum(axis=-1), 0.0) * stretch
            for phi in phi_i
            for theta in theta_i
        ]
    )
    density = (1 - size.even_share) * coarse + size.even_share / np.pi
    vndf = facing * density
    vndf += 1e-6 * vndf.max(axis=(1, 2), keepdims=True)
    # The projection of the facets in any unit: it cancels in the BRDF. Even nodes in the square root of the polar angle.
    x = np.linspace(0.0, 1.0, 64)
    projected = (facing * coarse).mean(axis=(1, 2)).reshape(phi_i.size, theta_i.size)
    at = np.degrees(np.pi / 2 * x**2)
    sigma = _whole_circle(np.array([np.interp(at, np.degrees(theta_i), row) for row in projected]), size.reduction)
    sigma = np.repeat(sigma, 2, axis=0) if model.isotropic else sigma
    slices, side = phi_i.size * theta_i.size, size.side
    values, visible = np.empty((slices, len(channels.names), side, side)), np.empty((slices, side, side))
    bare = Tables(phi_i, theta_i, ndf, sigma, vndf, values, visible)
    first, second = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side)))
    for number, (phi, theta) in enumerate((p, t) for p in phi_i for t in theta_i):
        at_nodes, seen = _node_values(bare, channels, number, (theta, phi), first, second, density)
        values[number], visible[number] = at_nodes.T.reshape(-1, side, side), seen.reshape(side, side)
    if model.isotropic:
        # The plugin may exchange both sides of the plane of incidence.
        values = (values + values[:, :, ::-1]) / 2
    return Tables(phi_i, theta_i, ndf, sigma, vndf, values, visible)


def _whole_circle(rows: Array, reduction: int) -> Array:
    """Rows at even azimuths around the circle, of those in the part of it that a table has."""
    if reduction == 4:
        rows = np.concatenate([rows, rows[-2::-1]])
    return np.concatenate([rows, rows[1:]]) if reduction >= 2 else rows


def _node_values(
    bare: Tables,
    channels: Channels,
    number: int,
    incidence: tuple[float, float],
    first: Array,
    second: Array,
    density: Array,
) -> tuple[Array, Array]:
    """BRDF·cos θ_o · 4 sigma / ndf at even numbers of one incidence [radian], (points, channels), and the facets over the density of nodes, (points,)."""
    theta, phi = incidence
    one = Slices(np.full((1, first.size), number, dtype=np.intp), np.ones((1, first.size)))
    here = Slices(np.zeros((1, first.size), dtype=np.intp), np.ones((1, first.size)))
    x, y = bare._warp.from_even(one, first, second)
    normal = unit_vector(np.degrees(np.pi / 2 * x**2), np.degrees((2 * y - 1) * np.pi))
    towards = unit_vector(np.degrees(theta), np.degrees(phi))
    outgoing = 2 * (normal @ towards)[:, None] * normal - towards
    theta_o, phi_o = angles_of(outgoing)
    cosine = np.maximum(np.cos(np.radians(theta_o)), 0.0)
    brdf = channels.convert(
        representation(channels.source).evaluate(
            np.full_like(theta_o, np.degrees(theta)),
            np.full_like(theta_o, np.degrees(phi)),
            np.minimum(theta_o, 89.9),
            phi_o,
            channels.wavelength,
        )
    )
    position = np.full(x.size, np.sqrt(2 * theta / np.pi)), np.full(x.size, (phi + np.pi) / (2 * np.pi))
    ndf = _bilinear(bare.ndf[None], here, x, y)
    scale = 4 * _bilinear(bare.sigma[None], here, *position) / ndf
    return np.maximum(brdf, 0.0) * (cosine * scale)[:, None], ndf / _bilinear(density[None], here, x, y)


class Chosen(NamedTuple):
    """A size of tables."""

    size: Size
    factor: Array
    """(azimuths · incidences,) by which the values are scaled, so that the plugin reflects what the BSDF does; they differ from 1 by at most the tolerance of the reflectance"""
    error: TableError
    within_tolerance: bool

    def tables_of(self, bsdf: xr.Dataset, channels: Channels) -> Tables:
        """The tables of this size, scaled."""
        return _scaled(tables_of(bsdf, channels, self.size), self.factor)


def chosen(bsdf: xr.Dataset, *, tolerance: float, albedo_tolerance: float, largest: int) -> Chosen:
    """The smallest tables within the tolerances, or the most accurate ones within the largest size, weighted with V(λ) and D65."""
    reflected = one_side(nonspectral(bsdf), "reflection")
    channels, pairs = gridded.photopic(reflected), fresh_pairs(reflected, seed=2)
    reduction = _symmetry(reflected, pairs, _SYMMETRIC * tolerance)
    found: list[Chosen] = []
    shares: tuple[float, ...] = _EVEN_SHARES_OF_NODES
    for side in _SIDES:
        sizes = [_size(side, share, reduction) for share in shares]
        if found and sizes[0].values > largest:
            break
        for size in sizes:
            tables = tables_of(reflected, channels, size)
            factor = _albedo_factor(reflected, tables, albedo_tolerance)
            error = error_of(reflected, _scaled(tables, factor).evaluate, pairs)
            met = error.percentile_95 <= tolerance and error.albedo <= albedo_tolerance
            found.append(Chosen(size, factor, error, met))
        best = min(found[-len(shares) :], key=_both_errors)
        if side >= _COMPARED_SHARES:
            # The share that suits a size suits the larger ones.
            shares = (best.size.even_share,)
        if best.within_tolerance:
            return best
    return min(found, key=_both_errors)


def _albedo_factor(bsdf: xr.Dataset, tables: Tables, limit: float) -> Array:
    """See :attr:`Chosen.factor`; of a BSDF without wavelength and its tables, within ``limit`` of 1: a lobe that is not resolved is not hidden."""
    factors = []
    for phi_i, theta_i in ((p, t) for p in np.degrees(tables.phi_i) for t in np.degrees(tables.theta_i)):
        rule = rules(bsdf, theta_i, phi_i)[0]
        at = np.full_like(rule.theta, theta_i), np.full_like(rule.theta, phi_i), rule.theta, rule.phi
        wanted, read = (
            float(rule.weight @ brdf(*at, None)[:, 0]) for brdf in (representation(bsdf).evaluate, tables.evaluate)
        )
        factors.append(np.clip(wanted / read, 1 - limit, 1 + limit) if read > 0 else 1.0)
    return np.array(factors)


def _scaled(tables: Tables, factor: Array) -> Tables:
    return replace(tables, values=tables.values * factor[:, None, None, None])


def _size(side: int, even_share: float, reduction: int) -> Size:
    """Numbers of nodes in proportion to the side of the square; ``reduction`` is 0 without a lay."""
    incidences = max(_LEAST_INCIDENCES, round(_INCIDENCES_PER_SIDE[bool(reduction)] * side))
    if not reduction:
        return Size(side, incidences, 1, even_share)
    azimuths = 1 + max(_LEAST_AZIMUTHS, round(_AZIMUTHS_PER_SIDE * side / reduction))
    return Size(side, incidences, azimuths, even_share, reduction)


def _symmetry(bsdf: xr.Dataset, pairs: Pairs, tolerance: float) -> int:
    """The reduction of the circle that the BSDF allows, see :attr:`Tables.reduction`; 0 without a lay."""
    model = representation(bsdf)
    if model.isotropic:
        return 0

    def same(change: Callable[[Array], Array]) -> bool:
        changed = pairs._replace(phi_i=change(pairs.phi_i), phi_o=change(pairs.phi_o))
        return bool(errors_at(bsdf, lambda *_: model.evaluate(*changed, None), pairs).max() <= tolerance)

    if not same(lambda azimuth: azimuth + 180):
        return 1
    return 4 if same(np.negative) else 2


def _both_errors(found: Chosen) -> float:
    return found.error.percentile_95 + found.error.albedo

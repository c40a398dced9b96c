"""Measured materials of the RGL laboratory, which Mitsuba's plugin ``measured`` renders (tensor file, ``.bsdf``).

The file holds a facet density ``ndf``, its projection ``sigma``, the density of visible facets ``vndf``, and the BRDF over that of mirror facets, on
even numbers: nodes lie where the material sends its light, and a program draws directions from the same tables. The BRDF·cos θ_o is
``spectra · ndf / (4 sigma)``, whatever density is chosen; here it is that of light that comes in along the normal.

References
----------
Dupuy & Jakob 2018 (ACM Trans. Graph. 37, 274); Mitsuba 3, plugin ``measured``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import TableError, error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, records, tensor_file
from brdfpipe.exchange.bilinear_warp import BilinearWarp, Slices
from brdfpipe.exchange.gridded import Channels
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array, angles_of, unit_vector

FORMAT = Format(
    description="tables for Mitsuba's plugin `measured`, one in colours and one by wavelength",
    files={"reflection": {"write": (".rgb.bsdf",), "write_spectral": (".spectral.bsdf",)}},
    takes="grid",
    carries=("lay", "spectrum", "colour"),
    read="read",
    begins=("tensor_file",),
)

_SIZES = ((16, 8), (24, 10), (32, 12), (40, 16), (48, 20), (64, 24), (80, 32), (96, 40))
"""Numbers of nodes along a side of the square, and of incidences, that are tried; with a lay also of azimuths of incidence."""
_LAST_INCIDENCE = 88.0
_TOWARDS_GRAZING = 1.5
"""Power by which steps between incidences shrink towards grazing, where Fresnel's reflectance and masking change fastest."""
_FACETS = (32, 96)
"""Nodes of the facet densities along azimuth and polar angle."""
_AZIMUTHS_WITH_LAY = 128
"""Azimuths with a lay: 32 made the tail along it darker, 4 % of Gaussian slopes and 12 % of measured ones, whatever the number of values."""
_READ_TURNS = 24
"""Intervals of the azimuth of incidence at which a file of a surface with a lay is read."""
_EVEN_SHARE = 1e-5
"""Share of facets that are spread evenly, so that the BRDF over the facet density is finite; more of them would make it fall as steeply as the lobe."""
_EVEN_SHARES_OF_NODES = (0.01, 0.1, 0.3)
"""Shares of nodes spread evenly that are tried: many serve a lay, whose lobe is narrow one way and wide the other, few a narrow lobe."""
_READ_INCIDENCES, _READ_POLAR, _READ_AROUND = np.arange(0.0, 88.1, 4.0), 96, 37


@dataclass(frozen=True)
class Tables:
    """Content of a file, and the BRDF that the plugin evaluates from it."""

    phi_i: Array
    """(n,) radian; one or two: isotropic"""
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

    @cached_property
    def _warp(self) -> BilinearWarp:
        return BilinearWarp.of(self.vndf)

    def slices(self, theta_i: Array, phi_i: Array) -> Slices:
        """Of incidences [radian]; azimuths are those of the file."""
        return Slices.at((self.phi_i, self.theta_i), (phi_i, theta_i))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF (directions, channels) [sr-1], angles in degree."""
        incident, outgoing = unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)
        polar, around = (np.radians(angle) for angle in angles_of(incident + outgoing))
        azimuth = _wrapped(np.radians(phi_i))
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


def _wrapped(azimuth: Array) -> Array:
    return np.asarray((azimuth + np.pi) % (2 * np.pi) - np.pi)


def _bilinear(values: Array, slices: Slices, x: Array, y: Array) -> Array:
    """Values (slices, rows, columns) at points of the unit square."""
    return BilinearWarp(values).at(slices, x, y)


def _facets(bsdf: xr.Dataset) -> tuple[Array, Array, Array]:
    """Facet density on its grid, from the light that returns to where it came from; its polar angles and azimuths [radian]."""
    model = representation(bsdf)
    azimuths = _FACETS[0] if model.isotropic else _AZIMUTHS_WITH_LAY
    x, y = np.linspace(0, 1, _FACETS[1]), np.linspace(0, 1, azimuths + 1)
    polar, around = np.minimum(np.pi / 2 * x**2, np.radians(89.0)), (2 * y - 1) * np.pi
    theta, phi = np.meshgrid(np.degrees(polar), np.degrees(around))
    azimuth = np.zeros_like(phi) if model.isotropic else phi
    returned = 4 * model.evaluate(theta, azimuth, theta, azimuth, None)[..., 0] * np.cos(np.radians(theta)) ** 2
    # Facets per projected area; the steps are those of even nodes in the root of the polar angle.
    projected = np.cos(polar) * np.sin(polar) * np.sqrt(2 * polar / np.pi)
    total = np.pi**2 * 2 * np.mean((returned * projected)[:-1].mean(axis=0))
    even = np.full_like(returned, 1 / np.pi)
    return (1 - _EVEN_SHARE) * returned / total + _EVEN_SHARE * even if total > 0 else even, polar, around


def tables_of(
    bsdf: xr.Dataset, channels: Channels, side: int, incidences: int, even_share: float = _EVEN_SHARES_OF_NODES[0]
) -> Tables:
    """The tables of a BSDF of ``side``² nodes at each of ``incidences`` polar angles; ``even_share`` of the nodes is spread evenly."""
    model = representation(channels.source)
    ndf, polar, around = _facets(nonspectral(bsdf))
    normals = unit_vector(*np.degrees(np.broadcast_arrays(polar[None, :], around[:, None])))
    stretch = np.sqrt(2 * polar / np.pi) * np.sin(polar)
    phi_i = np.zeros(1) if model.isotropic else np.linspace(-np.pi, np.pi, incidences + 1)
    theta_i = np.radians(_LAST_INCIDENCE * (1 - np.linspace(1.0, 0.0, incidences) ** _TOWARDS_GRAZING))
    facing = np.array(
        [
            np.maximum((normals * unit_vector(np.degrees(theta), np.degrees(phi))).sum(axis=-1), 0.0) * stretch
            for phi in phi_i
            for theta in theta_i
        ]
    )
    density = (1 - even_share) * ndf + even_share / np.pi
    vndf = facing * density
    vndf += 1e-6 * vndf.max(axis=(1, 2), keepdims=True)
    # The projection of the facets in any unit: it cancels in the BRDF. Even nodes in the square root of the polar angle.
    x = np.linspace(0.0, 1.0, 64)
    projected = (facing * ndf).mean(axis=(1, 2)).reshape(phi_i.size, theta_i.size)
    at = np.degrees(np.pi / 2 * x**2)
    sigma = np.array([np.interp(at, np.degrees(theta_i), row) for row in projected])
    sigma = np.repeat(sigma, 2, axis=0) if model.isotropic else sigma
    slices = phi_i.size * theta_i.size
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


def write(bsdf: xr.Dataset, path: Path, *, scale: float = 1.0, **grid: Any) -> records.Record:
    """Write linear sRGB (D65), for the variants of Mitsuba that render in colours.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    scale : of all values, for a blend; the description of the file states it
    grid : ``tolerance``, ``albedo_tolerance`` and ``largest``, see :data:`brdfpipe.exchange.registry.GRID_OPTIONS`
    """
    return _write(bsdf, path, gridded.linear_rgb(one_side(bsdf, "reflection")), None, scale, grid)


def write_spectral(bsdf: xr.Dataset, path: Path, *, scale: float = 1.0, **grid: Any) -> records.Record:
    """Write values by wavelength, for the spectral variants of Mitsuba; parameters as for :func:`write`."""
    wavelength = bsdf["wavelength"].values if "wavelength" in bsdf.coords else np.array([360.0, 830.0])
    return _write(bsdf, path, gridded.spectral(one_side(bsdf, "reflection"), wavelength), wavelength, scale, grid)


def _write(
    bsdf: xr.Dataset, path: Path, channels: Channels, wavelength: Array | None, scale: float, grid: Mapping[str, Any]
) -> records.Record:
    (side, incidences, even_share), error, met = _chosen(bsdf, **grid)
    tables = tables_of(bsdf, channels, side, incidences, even_share)
    count = tables.values.shape[1]
    values = np.broadcast_to(
        scale * tables.values, (len(tables.values), wavelength.size if wavelength is not None else 3, side, side)
    )
    lead = tables.phi_i.size, tables.theta_i.size
    drawn = tables.values.mean(axis=1) * tables.visible
    luminance = np.maximum(drawn, 1e-9 * drawn.max())
    note = "" if scale == 1 else f"; the values are {scale:g} times the BRDF"
    fields = {
        "description": np.frombuffer((records.comment(bsdf) + note).encode("ascii", "replace"), dtype=np.uint8),
        "jacobian": np.ones(1, dtype=np.uint8),
        "phi_i": tables.phi_i,
        "theta_i": tables.theta_i,
        "ndf": tables.ndf,
        "sigma": tables.sigma,
        "vndf": tables.vndf.reshape(*lead, *tables.vndf.shape[1:]),
        "luminance": luminance.reshape(*lead, side, side),
        ("rgb" if wavelength is None else "spectra"): values.reshape(*lead, -1, side, side),
    }
    if wavelength is not None:
        fields["wavelengths"] = wavelength
    written = {name: field if field.dtype == np.uint8 else field.astype(np.float32) for name, field in fields.items()}
    tensor_file.write(path, written)
    size = int(np.prod(lead)) * side * side * count
    record = records.record(_Written(bsdf, error, met, size, "rgb" if wavelength is None else "spectrum"), FORMAT)
    record["left_out"] |= _outside_gamut(bsdf, channels) if wavelength is None else {}
    return record


def _outside_gamut(bsdf: xr.Dataset, channels: Channels) -> dict[str, str]:
    """A sentence where colours outside sRGB have negative values, which the file cannot hold."""
    pairs = fresh_pairs(nonspectral(bsdf), seed=2)
    brdf = channels.convert(representation(channels.source).evaluate(*pairs, channels.wavelength))
    share = float((brdf < 0).any(axis=-1).mean())
    if share == 0:
        return {}
    sentence = f"colours outside sRGB: in {share:.1%} of the directions a negative value of R, G or B became 0; the spectral file has them"
    return {"gamut": sentence}


class _Written(NamedTuple):
    bsdf: xr.Dataset
    error: TableError
    within_tolerance: bool
    size: int
    content: records.Content
    reading: str = "evaluated as Mitsuba does"


def _chosen(
    bsdf: xr.Dataset, *, tolerance: float, albedo_tolerance: float, largest: int
) -> tuple[tuple[int, int, float], TableError, bool]:
    """Side, incidences and even share of the smallest tables within the tolerances, or of the most accurate ones within the size, weighted with V(λ) and D65."""
    reflected = one_side(nonspectral(bsdf), "reflection")
    channels, pairs = gridded.photopic(reflected), fresh_pairs(reflected, seed=2)
    found: list[tuple[TableError, tuple[int, int, float]]] = []
    shares: tuple[float, ...] = _EVEN_SHARES_OF_NODES
    for side, incidences in _SIZES:
        azimuths = 1 if representation(reflected).isotropic else incidences + 1
        if found and side * side * incidences * azimuths > largest:
            break
        for share in shares:
            tables = tables_of(reflected, channels, side, incidences, share)
            found.append((error_of(reflected, tables.evaluate, pairs), (side, incidences, share)))
        error, size = min(found[-len(shares) :], key=_both_errors)
        # The share that suits a size suits the larger ones.
        shares = (size[-1],)
        if error.percentile_95 <= tolerance and error.albedo <= albedo_tolerance:
            return size, error, True
    error, size = min(found, key=_both_errors)
    return size, error, False


def _both_errors(found: tuple[TableError, tuple[int, int, float]]) -> float:
    return found[0].percentile_95 + found[0].albedo


def read(path: Path) -> ReadTable:
    """Read a file as a table about the mirror direction.

    Raises InputError: the file is not of this kind, or its fields contradict each other.
    """
    fields = tensor_file.read(path)
    kind = "rgb" if "rgb" in fields else "spectra"
    needed = ("phi_i", "theta_i", "ndf", "sigma", "vndf", kind)
    if missing := [name for name in needed if name not in fields]:
        raise InputError(
            path, "the file lacks fields", found=", ".join(sorted(fields))[:80], accepted=", ".join(missing)
        )
    lead = fields["phi_i"].size, fields["theta_i"].size
    shapes = {"ndf": 2, "sigma": 2, "vndf": 4, kind: 5}
    for name, dimensions in shapes.items():
        array = fields[name]
        right = array.ndim == dimensions and (dimensions == 2 or array.shape[:2] == lead) and min(array.shape[-2:]) >= 2
        if not right:
            raise InputError(path, f"the field {name!r} does not fit the incidences", found=f"shape {array.shape}")
        if not np.isfinite(array).all():
            raise InputError(path, f"the field {name!r} has values that are not finite")
    wavelength = None
    if kind == "spectra":
        wavelength = np.asarray(fields.get("wavelengths", np.empty(0)), dtype=float)
        if wavelength.size != fields[kind].shape[2]:
            raise InputError(path, "wavelengths and spectra differ in number", found=f"{wavelength.size} wavelengths")
    tables = Tables.of_fields(fields, kind)
    return _resampled(tables, "rgb" if kind == "rgb" else "spectral", wavelength)


def _resampled(tables: Tables, channels: Any, wavelength: Array | None) -> ReadTable:
    from brdfpipe.bsdf.grids import GRIDS

    axes = {
        "theta_i": _READ_INCIDENCES,
        "theta_s": np.concatenate([[0.0], np.geomspace(0.05, 178.0, _READ_POLAR)]),
        "phi_s": np.linspace(0.0, 180.0 if tables.isotropic else 360.0, _READ_AROUND),
    }
    if not tables.isotropic:
        axes = {"phi_i": np.linspace(0.0, 360.0, _READ_TURNS + 1), **axes}
    nodes = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    theta_i, phi_i, theta_o, phi_o = (
        angle.ravel() for angle in np.broadcast_arrays(*GRIDS["specular"].directions(nodes))
    )
    shape = tuple(axis.size for axis in axes.values())
    parts = [
        tables.evaluate(theta_i[k], phi_i[k], np.minimum(theta_o[k], 89.0), phi_o[k], None)
        for k in np.array_split(np.arange(theta_i.size), max(1, theta_i.size // 50_000))
    ]
    note = "resampled about the mirror direction, to 88 degree of incidence"
    return ReadTable("specular", axes, np.concatenate(parts).reshape(*shape, -1), channels, wavelength, notes=(note,))

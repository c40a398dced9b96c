"""Light that a height map reflects more than once, traced on it: the light of Smith's surface times a ratio.

Rays follow the map with all bounces. Each path has the Fresnel reflectance of its facets at every wavelength, with s and p kept between
them. Its light is counted by both polar angles and the azimuth between them, and a path in reverse counts as well as the path. The counts
over what Smith's surface sends into the same bins are a smooth ratio, by which the table of Smith's surface is multiplied.

References
----------
Heitz, Hanika, d'Eon & Dachsbacher 2016 (ACM Trans. Graph. 35(4), 58) for light by the number of its reflections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.second_reflection import (
    NODES,
    SecondReflection,
    azimuth_width,
    grazing_scale,
    of_smith_surface,
    polar_hats,
    polar_nodes,
    reflection_of_stokes,
)
from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array
from brdfpipe.references.height_mesh import HeightMesh
from brdfpipe.references.tracer import BLOCKS, areas

RAYS = 3 * 2**14
"""Rays of each of the 12 incidences: half a second, and 5 % in a bin that holds 1 % of all rays."""

_POLAR, _AZIMUTH = 12, 9  # nodes of the ratio along each polar angle, and along the azimuth
_CORRECTIONS = 3  # of the ratio, so that its interpolation sends the counted light into every bin
_PLANES = 16  # of a surface with a lay
_kernel = cache(compiled)  # the compiler is loaded at the first call


class TracedReflections(NamedTuple):
    """Table of the light that a map reflects more than once, and its statistical uncertainty."""

    table: SecondReflection
    relative_u: Array
    """Standard uncertainty of the table over its values, (θ_i, θ_o, φ), from the scatter between blocks of the map; 1 where no path was counted"""
    theta: Array
    """(θ_i,) incidences that were traced [degree]"""
    share: Array
    """Light reflected more than once, of the incident light, mean over wavelength, (θ_i,)"""
    share_u: Array


def trace_reflections(
    mesh: HeightMesh,
    surface: Microsurface,
    n: Array,
    k: Array,
    *,
    lay: bool = False,
    rays: int = RAYS,
    seed: int = 0,
    nodes: tuple[int, int] = NODES,
) -> TracedReflections:
    """Trace and tabulate the light that a map reflects more than once.

    Parameters
    ----------
    mesh : of the map
    surface : isotropic, with Smith's masking and the slopes of the map; of a surface with a lay the average over azimuth
    n, k : (wavelength,) index relative to the medium of incidence
    lay : let the light depend on both azimuths
    rays : of each of the 12 incidences
    seed : of the positions of the rays
    nodes : angles and azimuths of the table of an isotropic surface; at least 12 and 9, the nodes of the ratio

    Notes
    -----
    Bins are linear hats about nodes. Where few paths were counted, the ratio is that of two, four and eight times wider bins. Of a surface
    with a lay there is one ratio for each of 16 planes.
    """
    smith, where = of_smith_surface(surface, n, k, nodes)
    pairs = np.unique(np.stack(np.broadcast_arrays(n, k)), axis=1)
    planes = _PLANES if lay else 1
    theta = _incidences(smith.slope)
    counts = count_light(mesh, theta, smith.slope, pairs, rays, seed, planes)
    light = counts.by_direction
    both = light + light.swapaxes(0, 1)
    # One path of mean light counts beside all others.
    virtual = light.sum(axis=(0, 1, 2)) / max(counts.paths / planes, 1)
    shape = both.shape[:3] if lay else smith.log_factor.shape[:3]
    log_smith = np.tile(_resampled(smith.log_factor, shape), planes)
    base = replace(smith, weight=np.empty((shape[0], 0)), planes=planes)
    table, log_ratio = replace(base, log_factor=log_smith), np.zeros_like(both)
    for _ in range(_CORRECTIONS if counts.paths else 0):
        sent = _sent(table, theta)
        log_ratio += np.log(_ratio(both, sent + sent.swapaxes(0, 1), virtual))
        table = replace(base, log_factor=log_smith + _resampled(log_ratio, shape))
    of_material = table.log_factor.reshape(*shape, planes, -1)[..., 1:][..., where]
    by_index = light.reshape(*both.shape[:3], planes, -1)[..., 1:].mean(axis=(3, 4))
    blocks = counts.of_blocks
    least = virtual.reshape(planes, -1)[:, 1:].mean()
    in_bins = np.hypot(_scatter(blocks + blocks.swapaxes(1, 2)), least) / (by_index + by_index.swapaxes(0, 1) + least)
    return TracedReflections(
        replace(table, log_factor=of_material.reshape(*shape, -1)),
        _resampled(np.minimum(in_bins, 1.0)[..., None], shape)[..., 0],
        theta,
        by_index.sum(axis=(1, 2)),
        _scatter(blocks.sum(axis=(2, 3))),
    )


def _resampled(values: Array, nodes: Sequence[int]) -> Array:
    """Linear interpolation of columns, (θ_i, θ_o, φ, column), at other numbers of evenly spaced nodes."""
    places = [np.linspace(0, size - 1, count) for size, count in zip(values.shape[:3], nodes, strict=True)]
    at = np.meshgrid(*places, indexing="ij")
    columns = [map_coordinates(column, at, order=1, mode="nearest") for column in np.moveaxis(values, -1, 0)]
    return np.stack(columns, axis=-1)


class Counts(NamedTuple):
    """Light reflected more than once, over the incident light; perfect mirrors first, then each index."""

    by_direction: Array
    """(θ_i, θ_o, φ, plane and 1 + index), φ from the forward plane; of each plane as if all light were incident there"""
    of_blocks: Array
    """Parts of the mean over planes and indices by block of the map, (block, θ_i, θ_o, φ)"""
    paths: int


def count_light(
    mesh: HeightMesh, theta: Array, slope: float, pairs: Array, rays: int, seed: int, planes: int = 1
) -> Counts:
    """Light of each incidence (θ,) [degree] that a map reflects more than once.

    ``slope`` sets the nodes of the bins, ``pairs`` (2, index) are n and k, ``rays`` are those of each incidence, and ``planes`` is the
    number of planes of :class:`SecondReflection`.
    """
    from brdfpipe.references import ray_kernel

    each, stokes, blocks = -(-rays // BLOCKS**2), reflection_of_stokes(pairs), list(areas(mesh))
    directions, angles = np.empty((each, 5)), np.empty((each, ray_kernel.RECORDED, 3))
    light = np.zeros((theta.size, _POLAR, _AZIMUTH, planes, 1 + pairs.shape[1]))
    of_blocks = np.zeros((len(blocks), *light.shape[:3]))
    arrays = mesh.height, mesh.present, mesh.ceiling, mesh.offset, float(mesh.height.min()), float(mesh.height.mean())
    nodes = slope, grazing_scale(slope)
    paths = 0
    for row, incidence in enumerate(np.radians(theta)):
        towards = np.array([np.cos(incidence), np.sin(incidence), np.nan])
        measured = 0
        for block, area in enumerate(blocks):
            number = (seed * theta.size + row) * len(blocks) + block
            found, met = ray_kernel.record_paths(
                *arrays, mesh.pitch, mesh.edges, area, towards, each, number, directions, angles
            )
            _kernel(_add_light)(
                directions[:found], angles, towards[0], *nodes, stokes, light[row], of_blocks[block, row]
            )
            paths, measured = paths + int(found), measured + int(met)
        light[row] *= planes / max(measured, 1)
        of_blocks[:, row] /= max(measured, 1)
    return Counts(light.reshape(*light.shape[:3], -1), of_blocks, paths)


def _incidences(slope: float) -> Array:
    """Nodes of the ratio, but for grazing, where no ray arrives: there an angle of the last interval [degree]."""
    theta = polar_nodes(slope, _POLAR)
    return np.append(theta[:-1], 0.25 * theta[-2] + 0.75 * 90)


def _sent(table: SecondReflection, theta: Array) -> Array:
    """Light of a table in the bins, (θ_i, θ_o, φ, index)."""
    light, theta_o, turn = table.light(theta)
    width = azimuth_width(table.slope, np.cos(np.radians(theta))[:, None], np.cos(np.radians(theta_o)))[..., None]
    place = np.arcsinh(turn / width) / np.arcsinh(np.pi / width) * (_AZIMUTH - 1)
    azimuth = np.maximum(1 - np.abs(place[..., None] - np.arange(_AZIMUTH)), 0.0)
    return np.einsum("itql,tj,itqp->ijpl", light, polar_hats(theta_o, table.slope, _POLAR), azimuth, optimize=True)


def _ratio(traced: Array, sent: Array, virtual: Array) -> Array:
    """Traced over sent light by bin; of few paths that of wider bins."""
    if max(traced.shape[:3]) == 1:
        return (traced + virtual) / (sent + virtual)
    wider = _ratio(_in_wider_bins(traced), _in_wider_bins(sent), virtual)
    for axis, size in enumerate(traced.shape[:3]):
        wider = np.take(wider, np.arange(size) // 2, axis=axis)
    return (traced + virtual * wider) / (sent + virtual)


def _in_wider_bins(light: Array) -> Array:
    for axis in range(3):
        light = np.add.reduceat(light, np.arange(0, light.shape[axis], 2), axis=axis)
    return light


def _scatter(of_blocks: Array) -> Array:
    """Standard uncertainty of a sum over blocks (first axis) from their scatter."""
    return np.asarray(np.sqrt(of_blocks.shape[0]) * of_blocks.std(axis=0, ddof=1))


def _add_light(
    directions: Array,
    angles: Array,
    cos_i: float,
    slope: float,
    grazing_scale: float,
    stokes: Array,
    light: Array,
    of_block: Array,
) -> None:
    """Add the unpolarised light of paths of one incidence to bins.

    Parameters
    ----------
    directions, angles : of :func:`brdfpipe.references.ray_kernel.record_paths`
    cos_i : cosine of the incidence
    slope, grazing_scale : of the nodes
    stokes : of :func:`reflection_of_stokes`
    light : (θ_o, φ, plane, 1 + index) is added to: for perfect mirrors, and for each index
    of_block : (θ_o, φ), the same for the mean over the indices
    """
    polar, azimuths, planes = light.shape[0], light.shape[1], light.shape[2]
    last, materials = stokes.shape[1] - 1, stokes.shape[2]
    polar_step = (polar - 1) / math.asinh(90 / grazing_scale)
    weight = np.empty(1 + materials)
    for path in range(directions.shape[0]):
        bounces = min(int(directions[path, 4]), angles.shape[1])
        weight[0], mean_weight = 1.0, 0.0
        for index in range(materials):
            # Stokes' parameters I, Q, U and V in the frame of each facet.
            at = math.sqrt(angles[path, 0, 0]) * last
            node = min(int(at), last - 1)
            part = at - node
            intensity = stokes[0, node, index] * (1 - part) + stokes[0, node + 1, index] * part
            polarised = stokes[1, node, index] * (1 - part) + stokes[1, node + 1, index] * part
            diagonal, circular = 0.0, 0.0
            for facet in range(1, bounces):
                cos, sin = angles[path, facet, 1], angles[path, facet, 2]
                double, twice = cos * cos - sin * sin, 2 * cos * sin
                polarised, diagonal = polarised * double + diagonal * twice, diagonal * double - polarised * twice
                at = math.sqrt(angles[path, facet, 0]) * last
                node = min(int(at), last - 1)
                part = at - node
                mean = stokes[0, node, index] * (1 - part) + stokes[0, node + 1, index] * part
                half = stokes[1, node, index] * (1 - part) + stokes[1, node + 1, index] * part
                real = stokes[2, node, index] * (1 - part) + stokes[2, node + 1, index] * part
                imaginary = stokes[3, node, index] * (1 - part) + stokes[3, node + 1, index] * part
                intensity, polarised = mean * intensity + half * polarised, half * intensity + mean * polarised
                diagonal, circular = real * diagonal + imaginary * circular, real * circular - imaginary * diagonal
            weight[1 + index] = intensity
            mean_weight += intensity / materials
        x, y, z, phi = directions[path, 0], directions[path, 1], directions[path, 2], directions[path, 3]
        forward, beside = -(x * math.cos(phi) + y * math.sin(phi)), x * math.sin(phi) - y * math.cos(phi)
        turn = math.atan2(beside, forward)
        width = min(slope * (cos_i + z) + 1e-3, 4.0)
        at = math.asinh(abs(turn) / width) / math.asinh(math.pi / width) * (azimuths - 1)
        a = min(int(at), azimuths - 2)
        share_a = at - a
        grazing = math.degrees(math.atan2(z, math.sqrt(x * x + y * y)))
        at = max(polar - 1 - math.asinh(grazing / grazing_scale) * polar_step, 0.0)
        o = min(int(at), polar - 2)
        share_o = at - o
        at = (phi + turn / 2) / math.pi * planes
        plane, share_p = math.floor(at), at - math.floor(at)
        for step_o in range(2):
            for step_a in range(2):
                part = (share_o if step_o else 1 - share_o) * (share_a if step_a else 1 - share_a)
                of_block[o + step_o, a + step_a] += part * mean_weight
                for step_p in range(2):
                    in_plane = part * (share_p if step_p else 1 - share_p)
                    for index in range(1 + materials):
                        light[o + step_o, a + step_a, (plane + step_p) % planes, index] += in_plane * weight[index]

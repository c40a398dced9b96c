"""Nodes of a table that follow the lobe, as many as a tolerance needs or a size allows.

Linear interpolation between nodes at a distance h errs by up to h²·|f″|/8. Along each axis the nodes are dense where that is large, compared
with the BSDF itself: their density is proportional to the root of the relative curvature (de Boor 1973), taken along lines through
directions at which the BSDF is wanted. The number of nodes of an axis is the least that keeps the axis' part of the tolerance there. The
table as a whole is then compared with the BSDF at other directions, and made finer or coarser.

References
----------
de Boor 1973, Good approximation by splines with variable knots, in Spline Functions and Approximation Theory (Birkhäuser), 57.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.bsdf.grids import GRIDS, Grid
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.table import Table
from brdfpipe.bsdf.table_error import (
    FLOOR,
    LARGEST_INCIDENCE,
    Evaluate,
    Pairs,
    TableError,
    error_of,
    errors_at,
    fresh_pairs,
    light_of_incidences,
    rules,
)
from brdfpipe.bsdf.tabulation import values_on_nodes
from brdfpipe.geometry import Array

TOLERANCE, ALBEDO_TOLERANCE = 0.01, 0.001
"""Default limits of :attr:`TableError.percentile_95` and :attr:`TableError.albedo`."""

LARGEST_TABLE = 4_000_000
"""Default limit of the number of values of a table at one wavelength."""

_LINES = 96
"""Lines along each axis on which the curvature is taken."""
_FINE = 1024
"""Points of a line."""
_FEWEST_NODES, _MOST_NODES = 3, 720
_ATTEMPTS = 8
_CHOICE_SEED, _TEST_SEED = 1, 2


class ChosenNodes(NamedTuple):
    """Axes of a table, and what a program that interpolates it linearly errs by."""

    axes: Mapping[str, Array]
    """Increasing angles [degree], see :mod:`brdfpipe.bsdf.grids`"""
    values: Array
    """(axes…, 1) BSDF [sr-1], times :attr:`factor`"""
    factor: Array
    """Scale of the values, of shape (axes…, 1) with lengths of 1, see :func:`albedo_factor`"""
    error: TableError
    """At directions that had no part in the choice"""
    within_tolerance: bool
    """Whether the tolerance was reached within the size"""


class _Line(NamedTuple):
    """Values of the BSDF along one axis, through pairs of directions."""

    at: Array
    """(points,) coordinate along the axis [degree]"""
    values: Array
    """(lines, points) BSDF [sr-1]"""
    wanted: Array
    """(lines,) coordinate of the pair of directions"""
    scale: Array
    """(lines, points) BSDF to which errors are relative [sr-1]"""
    running: Array
    """(points,) integral of the density of nodes over the axis, from 0 to 1"""


def choose_nodes(
    bsdf: xr.Dataset,
    layout: str = "uniform",
    *,
    tolerance: float = TOLERANCE,
    albedo_tolerance: float = ALBEDO_TOLERANCE,
    largest: int = LARGEST_TABLE,
) -> ChosenNodes:
    """Axes of a table that a program interpolates linearly.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without wavelength
    layout : key of :data:`brdfpipe.bsdf.grids.GRIDS`
    tolerance, albedo_tolerance : limits of :attr:`TableError.percentile_95` and :attr:`TableError.albedo` [1]
    largest : number of values that the table may have

    Returns
    -------
    The axes of the smallest table found within both limits; if none has at most ``largest`` values, those of the most accurate one found.

    Raises
    ------
    ValueError : ``largest`` is less than :func:`smallest_table`.
    """
    if largest < smallest_table(bsdf, layout):
        raise ValueError(f"a table has at least {smallest_table(bsdf, layout)} values; found {largest}")
    grid, model = GRIDS[layout], representation(bsdf)
    pairs = fresh_pairs(bsdf, _CHOICE_SEED)
    lines = {name: _line(bsdf, grid, name, pairs) for name in grid.named(not model.isotropic)}
    test, best = fresh_pairs(bsdf, _TEST_SEED), None
    parts = dict.fromkeys(lines, tolerance / len(lines))
    for attempt in range(_ATTEMPTS):
        axes = {name: _nodes(line, parts[name]) for name, line in lines.items()}
        while _size(axes) > largest:
            parts = {name: 1.25 * part for name, part in parts.items()}
            axes = {name: _nodes(line, parts[name]) for name, line in lines.items()}
        is_last = _size(axes) > 0.6 * largest or attempt == _ATTEMPTS - 1
        values = values_on_nodes(model.evaluate, grid, axes, False, model.mirror_symmetric)
        excess = float(np.quantile(errors_at(bsdf, interpolation(axes, values), test), 0.95)) / tolerance
        of_albedo = 1.0
        if excess <= 1 or is_last:
            factor = albedo_factor(bsdf, values, axes, tolerance)
            values = values * factor
            error = error_of(bsdf, interpolation(axes, values), test)
            excess, of_albedo = error.percentile_95 / tolerance, error.albedo / albedo_tolerance
            choice = ChosenNodes(axes, values, factor, error, max(excess, of_albedo) <= 1)
            best = _better(choice, best)
            if is_last or 0.6 <= max(excess, of_albedo) <= 1:
                break
        parts = {name: part * _change(excess) for name, part in parts.items()}
        if of_albedo > 1 and "theta_i" in parts:
            # At its own incidences the table has the reflectance of the BSDF: more of them are needed.
            parts["theta_i"] *= _change(of_albedo) / max(_change(excess), 1.0)
    assert best is not None
    return best


def smallest_table(bsdf: xr.Dataset, layout: str) -> int:
    """The least number of values of a table, at one wavelength."""
    return int(_FEWEST_NODES ** len(GRIDS[layout].named(not representation(bsdf).isotropic)))


def _change(excess: float) -> float:
    """By how much to change a part of the tolerance after an error of ``excess`` times the tolerance."""
    return min(max(0.85 / max(excess, 0.1), 0.25), 3.0)


def _better(choice: ChosenNodes, best: ChosenNodes | None) -> ChosenNodes:
    """The smaller one of two within the tolerance, or else the more accurate one."""
    if best is None or choice.within_tolerance > best.within_tolerance:
        return choice
    if choice.within_tolerance < best.within_tolerance:
        return best
    if choice.within_tolerance:
        return choice if choice.values.size < best.values.size else best
    return choice if choice.error.percentile_95 < best.error.percentile_95 else best


def albedo_factor(bsdf: xr.Dataset, values: Array, axes: Mapping[str, Array], limit: float) -> Array:
    """Scale by incidence and side with which the linear interpolation of a table reflects and transmits what the BSDF does.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without wavelength
    values : (axes…, 1) BSDF on the nodes [sr-1]
    axes : increasing angles [degree]; without ``theta_i`` nothing is scaled
    limit : largest difference of the scale from 1: a grid that is too coarse for the lobe is not hidden

    Returns
    -------
    of as many dimensions as the values, of length 1 along azimuths of the outgoing direction
    """
    if "theta_i" not in axes:
        return np.ones((1,) * values.ndim)
    evaluate, read = representation(bsdf).evaluate, interpolation(axes, values)
    azimuths = axes.get("phi_i", np.zeros(1))
    factor = np.ones((azimuths.size, axes["theta_i"].size, 2))
    for row, phi_i in enumerate(azimuths):
        # All incidences of an azimuth at once: each evaluation has its own preparation.
        of_incidences = [rules(bsdf, min(theta_i, 89.5), phi_i) for theta_i in axes["theta_i"]]
        for side, of_side in enumerate(zip(*of_incidences, strict=True)):
            light = [light_of_incidences(brdf, axes["theta_i"], phi_i, of_side, None) for brdf in (evaluate, read)]
            for column, (wanted, found) in enumerate(zip(*light, strict=True)):
                factor[row, column, side] = np.clip(wanted[0] / found[0], 1 - limit, 1 + limit) if found[0] > 0 else 1.0
    polar = axes["theta_o"] if "theta_o" in axes else np.zeros(1)
    factor = factor[:, :, (polar > 90).astype(int), None, None]
    return factor if "phi_i" in axes else factor[0]


def interpolation(axes: Mapping[str, Array], values: Array) -> Evaluate:
    """The BSDF that a program reads which interpolates a table (axes…, wavelength) linearly."""
    spectral = () if values.shape[-1] == 1 else ("wavelength",)
    brdf = (*axes, *spectral), values if spectral else values[..., 0]
    coordinates = {**axes, **({"wavelength": np.arange(values.shape[-1]) + 400.0} if spectral else {})}
    return Table(xr.Dataset({"brdf": brdf}, coords=coordinates)).evaluate


def _line(bsdf: xr.Dataset, grid: Grid, name: str, pairs: Pairs) -> _Line:
    model = representation(bsdf)
    chosen = pairs.chosen(np.linspace(0, pairs.theta_i.size - 1, _LINES).round().astype(int))
    coordinates = {key: values[:, None] for key, values in grid.coordinates(*chosen).items()}
    at = _fine(name, model.mirror_symmetric, model.transmits)
    wanted = coordinates[name][:, 0]
    if name.startswith("phi"):
        wanted = wanted % 360
        wanted = np.where(wanted > at[-1], 360 - wanted, wanted)
    coordinates[name] = np.broadcast_to(at, (wanted.size, at.size))
    theta_i, phi_i, theta_o, phi_o = np.broadcast_arrays(*grid.directions(coordinates))
    theta_i, theta_o = np.minimum(theta_i, 89.9), np.where(model.transmits, theta_o, np.minimum(theta_o, 89.9))
    values = model.evaluate(theta_i, phi_i, theta_o, phi_o, None)[..., 0]
    scale = np.maximum(values, FLOOR / np.abs(np.cos(np.radians(theta_o))))
    return _Line(at, values, wanted, scale, _running_density(at, values, scale))


def _fine(name: str, symmetric: bool, transmits: bool) -> Array:
    """Points of a line, dense where lobes may be narrow."""
    if name in ("phi_i", "phi_h"):
        return np.linspace(0.0, 360.0, _FINE)
    if name.startswith("phi"):
        near = np.concatenate([[0.0], np.geomspace(1e-2, 90.0, _FINE // 4)])
        half = np.unique(np.concatenate([near, 180 - near]))
        return half if symmetric else np.unique(np.concatenate([half, 360 - half]))
    if name in ("theta_s", "theta_h"):
        return np.concatenate([[0.0], np.geomspace(1e-3, 180.0 if name == "theta_s" else 90.0, _FINE)])
    above = np.linspace(0.0, LARGEST_INCIDENCE if name == "theta_i" else 89.5, 2 * _FINE)
    return np.concatenate([above, 180 - above[::-1]]) if transmits and name == "theta_o" else above


def _size(axes: Mapping[str, Array]) -> int:
    return int(np.prod([axis.size for axis in axes.values()]))


def _nodes(line: _Line, tolerance: float) -> Array:
    """The fewest nodes whose interpolation along the axis errs by at most the tolerance at 95 % of the lines."""
    count = _FEWEST_NODES
    while count < _MOST_NODES:
        nodes = np.interp(np.linspace(0.0, 1.0, count), line.running, line.at)
        if _percentile(line, nodes) <= tolerance:
            break
        count = max(count + 1, int(1.1 * count))
    return np.unique(np.round(nodes, 3))


def _running_density(at: Array, values: Array, scale: Array) -> Array:
    """Integral over an axis of the density of nodes, from 0 to 1, (points,)."""
    step = np.diff(at)
    slope = np.diff(values, axis=1) / step
    curvature = np.abs(np.diff(slope, axis=1)) / ((step[1:] + step[:-1]) / 2)
    density = np.sqrt(np.quantile(curvature / scale[:, 1:-1], 0.9, axis=0))
    density = np.concatenate([density[:1], density, density[-1:]])
    panel = (density[1:] + density[:-1]) / 2 * step
    # A tenth of the nodes are spread evenly, so that nothing between them is left out.
    panel = panel / max(panel.sum(), 1e-300) * 0.9 + step / step.sum() * 0.1
    running = np.concatenate([[0.0], np.cumsum(panel)])
    return running / running[-1]


def _percentile(line: _Line, nodes: Array) -> float:
    """95th percentile over the lines of the error of interpolation between nodes, where each is wanted."""
    wanted = np.clip(line.wanted, nodes[0], nodes[-1])
    after = np.clip(np.searchsorted(nodes, wanted), 1, nodes.size - 1)
    share = (wanted - nodes[after - 1]) / (nodes[after] - nodes[after - 1])
    low, high = (_on_lines(line, line.values, nodes[k]) for k in (after - 1, after))
    given, scale = (_on_lines(line, values, line.wanted) for values in (line.values, line.scale))
    return float(np.quantile(np.abs(low * (1 - share) + high * share - given) / scale, 0.95))


def _on_lines(line: _Line, values: Array, at: Array) -> Array:
    """Values (lines, points) at one coordinate of each line, (lines,); those of the ends beyond them."""
    at = np.clip(at, line.at[0], line.at[-1])
    after = np.clip(np.searchsorted(line.at, at), 1, line.at.size - 1)
    share, number = (at - line.at[after - 1]) / (line.at[after] - line.at[after - 1]), np.arange(at.size)
    return np.asarray(values[number, after - 1] * (1 - share) + values[number, after] * share)

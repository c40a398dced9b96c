"""A grid of a surface with a lay whose azimuths of scatter are counted from a fixed direction, not from the azimuth of incidence.

A program that interpolates between two azimuths of incidence at the same azimuth of scatter blends two lobes at different places: it needs steps of the azimuth of incidence that are
finer than the lobe is wide. Azimuths are even here, so that those relative to any azimuth of incidence are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr

from brdfpipe.bsdf import table_nodes
from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Evaluate, Limits, TableError, error_of, fresh_pairs
from brdfpipe.bsdf.tabulation import values_on_nodes
from brdfpipe.exchange.gridded import Channels, Gridded, check_limits
from brdfpipe.geometry import Array

_AZIMUTHS = ((12, 3), (18, 2), (24, 2), (36, 1), (48, 1))
"""Numbers of azimuths of incidence that are tried, and of those of scatter for each of them."""
_FEWEST_POLAR = 5
_TEST_SEED = 2


@dataclass(frozen=True)
class FixedAzimuths(Gridded):
    """A BSDF on a grid whose axis ``phi_o``, relative to ``phi_i``, has the same steps, or a whole part of them."""

    turned_error: TableError
    """Error of a program that interpolates at azimuths relative to that of incidence"""

    reading = "interpolated linearly at azimuths from a fixed direction"


def gridded(
    bsdf: xr.Dataset, channels: Channels, *, tolerance: float, albedo_tolerance: float, largest: int
) -> FixedAzimuths:
    """The grid, of those tried with at most ``largest`` nodes, whose error of BRDF·cos θ_o and of the reflectance is least together; parameters and errors as of :func:`brdfpipe.exchange.gridded.gridded`.

    ``phi_i`` and ``phi_o`` run from 0 to 360.
    """
    fewest = min((n + 1) * (n * times + 1) for n, times in _AZIMUTHS) * _FEWEST_POLAR**2
    check_limits(tolerance, albedo_tolerance, largest, least=fewest)
    model = nonspectral(bsdf)
    limits = Limits(tolerance, albedo_tolerance)
    chosen = table_nodes.choose_nodes(model, "uniform", **limits._asdict(), largest=largest).axes
    pairs = fresh_pairs(model, _TEST_SEED)
    found = []
    for incidences, times in _AZIMUTHS:
        axes = _axes(chosen, incidences, incidences * times, largest)
        if axes is not None:
            error = error_of(model, between_nodes(model, axes), pairs)
            found.append((error.percentile_95 + error.albedo, axes))
    axes = min(found, key=lambda one: one[0])[1]
    values = values_on_nodes(representation(model).evaluate, GRIDS["uniform"], axes, False, False)
    factor = table_nodes.albedo_factor(model, values, axes, tolerance)
    error = error_of(model, between_nodes(model, axes, factor), pairs)
    turned = error_of(model, table_nodes.interpolation(axes, values * factor), pairs)
    return FixedAzimuths(bsdf, "uniform", axes, channels, factor, error, limits, turned)


def _axes(chosen: Mapping[str, Array], incidences: int, azimuths: int, largest: int) -> dict[str, Array] | None:
    """Even azimuths, and as many of the chosen polar angles as there is room for; None where there is too little."""
    polar = largest / ((incidences + 1) * (azimuths + 1))
    if polar < _FEWEST_POLAR**2:
        return None
    shrink = np.sqrt(polar / (chosen["theta_i"].size * chosen["theta_o"].size))
    theta_i, theta_o = (_fewer(chosen[name], int(shrink * chosen[name].size)) for name in ("theta_i", "theta_o"))
    around = np.linspace(0, 360, incidences + 1), np.linspace(0, 360, azimuths + 1)
    return {"phi_i": around[0], "theta_i": theta_i, "theta_o": theta_o, "phi_o": around[1]}


def _fewer(nodes: Array, count: int) -> Array:
    """As many nodes, of the same relative density; not more than there are."""
    count = min(max(count, _FEWEST_POLAR), nodes.size)
    return np.unique(np.round(np.interp(np.linspace(0, nodes.size - 1, count), np.arange(nodes.size), nodes), 3))


def from_fixed(values: Array, row: int, axes: Mapping[str, Array]) -> Array:
    """Values (…, φ_o, channels) of one azimuth of incidence in the order of azimuths from the fixed direction, 0 to 360."""
    times = (axes["phi_o"].size - 1) // (axes["phi_i"].size - 1)
    turned = np.roll(values[..., :-1, :], row * times, axis=-2)
    return np.concatenate([turned, turned[..., :1, :]], axis=-2)


def between_nodes(bsdf: xr.Dataset, axes: Mapping[str, Array], factor: Array | None = None) -> Evaluate:
    """The BSDF that a program reads which interpolates a table linearly at fixed azimuths of scatter, from the values of the BSDF at the nodes around.

    Parameters
    ----------
    bsdf : kind ``bsdf``, without wavelength
    axes : ``phi_i``, ``theta_i``, ``theta_o``, ``phi_o`` of the table
    factor : (φ_i, θ_i, θ_o, 1, 1) of its values, default 1
    """
    model = representation(bsdf)

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: Array | None) -> Array:
        angles = dict(zip(axes, np.broadcast_arrays(phi_i % 360, theta_i, theta_o, phi_o % 360), strict=True))
        below, share = {}, {}
        for name, axis in axes.items():
            at = np.clip(angles[name], axis[0], axis[-1])
            below[name] = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
            share[name] = (at - axis[below[name]]) / np.diff(axis)[below[name]]
        total = np.zeros(angles["phi_i"].size)
        for corner in product((0, 1), repeat=len(axes)):
            index = {name: below[name] + step for name, step in zip(axes, corner, strict=True)}
            weight = np.prod(
                [share[name] if step else 1 - share[name] for name, step in zip(axes, corner, strict=True)], axis=0
            )
            node = {name: axes[name][index[name]] for name in axes}
            value = model.evaluate(node["theta_i"], node["phi_i"], node["theta_o"], node["phi_o"], None)[:, 0]
            if factor is not None:
                value = value * factor[index["phi_i"], index["theta_i"], index["theta_o"], 0, 0]
            total += weight * value
        return total[:, None]

    return evaluate

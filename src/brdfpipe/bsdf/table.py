"""The representation ``table``: a BSDF on a grid of directions, interpolated linearly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.grids import AZIMUTHS, GRIDS, Grid, kind_of
from brdfpipe.bsdf.spectral import at_wavelengths
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

AXES = GRIDS["uniform"].axes
"""Dimensions of a uniform table of an isotropic BSDF; phi_o is taken from the azimuth of incidence."""

ACCURACY = 1e-3
"""Of integrals over a table whose nodes are no lines of θ_o and φ_o [1]: its bends cost a quadrature more than they are worth."""


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF or BTDF in sr⁻¹, (directions…, wavelength), linear between the nodes and constant beyond the outermost.

    The two sides of the surface are interpolated apart. A side of which the table holds fewer than two nodes gives 0.
    """
    brdf, grid, names = _layout(bsdf)
    values = at_wavelengths(brdf, wavelength)
    values = values if "wavelength" in brdf.dims else values[..., None]
    angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
    shape = angles[0].shape
    theta_i, phi_i, theta_o, phi_o = (np.asarray(angle, dtype=float).ravel() for angle in angles)
    at = _folded(bsdf, names, grid.coordinates(theta_i, phi_i, theta_o, phi_o))
    axes = [bsdf[name].values for name in names]
    result = np.zeros((theta_i.size, values.shape[-1]))
    for sides in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        asked = (sides[0] * (90 - theta_i) > 0) & (sides[1] * (90 - theta_o) > 0)
        if asked.any() and _holds(grid, sides):
            held = [_on_side(name, axis, sides) for name, axis in zip(names, axes, strict=True)]
            if min(nodes.sum() for nodes in held) >= 2:
                part = values[np.ix_(*(np.flatnonzero(nodes) for nodes in held))]
                kept = [axis[nodes] for axis, nodes in zip(axes, held, strict=True)]
                result[asked] = _interpolated(kept, part, [at[name][asked] for name in names])
    return result.reshape(*shape, -1)


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array | None:
    """Directional reflectance [1], (incidences…, wavelength), exactly that of the interpolated table.

    None for a table that is not uniform, or that reaches below the horizon.

    Notes
    -----
    Each node's share is the integral of its own hat function, and the sum is linear between the incidences as the table is.
    """
    brdf, grid, names = _layout(bsdf)
    if grid is not GRIDS["uniform"] or max(bsdf["theta_i"].values[-1], bsdf["theta_o"].values[-1]) > 90:
        return None
    values = at_wavelengths(brdf, wavelength)
    values = values if "wavelength" in brdf.dims else values[..., None]
    polar, azimuth = bsdf["theta_o"].values, bsdf["phi_o"].values
    sums = np.einsum("...opw,o,p->...w", values, _polar_shares(polar), _azimuth_shares(azimuth))
    incidence = {"theta_i": theta_i.ravel(), "phi_i": np.broadcast_to(phi_i, theta_i.shape).ravel()}
    at = _folded(bsdf, names[:-2], {name: incidence[name] for name in names[:-2]})
    axes = [bsdf[name].values for name in names[:-2]]
    found = _interpolated(axes, sums, [at[name] for name in names[:-2]])
    return np.where(theta_i[..., None] < 90, found.reshape(*theta_i.shape, -1), 0.0)


def isotropic(bsdf: xr.Dataset) -> bool:
    """Whether the table knows the azimuths by their difference alone."""
    return not {"phi_i", "phi_h"} & set(bsdf["brdf"].dims)


def kinks(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """θ_o and φ_o − φ_i at which a uniform table bends [degree]; none for the others, whose nodes are no lines of these."""
    if kind_of(tuple(map(str, bsdf["brdf"].dims))) != "uniform":
        return np.empty(0), np.empty(0)
    azimuth = bsdf["phi_o"].values
    return bsdf["theta_o"].values, np.unique(np.concatenate([azimuth, 360 - azimuth]) % 360)


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The table averaged over wavelength with normalised weights."""
    if "wavelength" not in bsdf.coords:
        return bsdf
    response = xr.DataArray(weight, dims="wavelength")
    fields = {name: field @ response for name, field in bsdf.data_vars.items() if "wavelength" in field.dims}
    return vocabulary.label(bsdf.drop_dims("wavelength").assign(fields), "bsdf")


def _layout(bsdf: xr.Dataset) -> tuple[xr.DataArray, Grid, tuple[str, ...]]:
    brdf = bsdf["brdf"]
    grid = GRIDS[kind_of(tuple(map(str, brdf.dims)))]
    names = grid.named(grid.azimuth in brdf.dims)
    return brdf.transpose(*names, ...), grid, names


def _holds(grid: Grid, sides: tuple[int, int]) -> bool:
    if grid is GRIDS["uniform"]:
        return True
    return sides == (1, 1) or (grid is GRIDS["specular"] and sides[0] == sides[1])


def _on_side(name: str, axis: Array, sides: tuple[int, int]) -> np.ndarray:
    """The nodes that light on these sides may use; the horizon belongs to both."""
    if name not in ("theta_i", "theta_o"):
        return np.ones(axis.size, dtype=bool)
    side = sides[0] if name == "theta_i" else sides[1]
    return side * (90 - axis) >= 0


def _folded(bsdf: xr.Dataset, names: Sequence[str], at: Mapping[str, Array]) -> dict[str, Array]:
    folded = {}
    for name in names:
        axis = bsdf[name].values
        if name in AZIMUTHS:
            folded[name] = _fold(at[name], axis)
        elif name in ("phi_i", "phi_h"):
            # A lay that half a turn leaves as it was needs half a circle.
            folded[name] = (at[name] - axis[0]) % (180 if axis[-1] - axis[0] <= 180 else 360) + axis[0]
        else:
            folded[name] = at[name]
    return folded


def _fold(phi: Array, axis: Array) -> Array:
    """Azimuth brought into the range of the table: modulo 360, and by mirror symmetry where the table holds a half circle."""
    turned = (phi - axis[0]) % 360 + axis[0]
    return np.where(turned > axis[-1], 360 - turned, turned) if axis[-1] - axis[0] < 360 else turned


def _interpolated(axes: Sequence[Array], values: Array, at: Sequence[Array]) -> Array:
    """Multilinear, constant beyond the outermost nodes; (points, wavelength)."""
    from scipy.interpolate import RegularGridInterpolator

    points = np.stack([np.clip(each, axis[0], axis[-1]) for each, axis in zip(at, axes, strict=True)], axis=-1)
    return np.asarray(RegularGridInterpolator(tuple(axes), values)(points))


def _polar_shares(axis: Array) -> Array:
    """∫ hat(θ) sin θ cos θ dθ of each node, over 0 to 90 degree."""
    edges = np.concatenate([[0.0], axis, [90.0]])
    theta, weight = panel_rule(np.unique(np.clip(edges, 0.0, 90.0)), 8)
    return _hats(axis, theta, np.radians(weight) * np.sin(np.radians(theta)) * np.cos(np.radians(theta)))


def _azimuth_shares(axis: Array) -> Array:
    """∫ hat(φ) dφ of each node, over a full turn."""
    edges = np.concatenate([axis, 360 - axis])
    edges = np.unique(np.concatenate([(edges - axis[0]) % 360, [0.0, 360.0]])) + axis[0]
    phi, weight = panel_rule(edges, 2)
    return _hats(axis, np.clip(_fold(phi, axis), axis[0], axis[-1]), np.radians(weight))


def _hats(axis: Array, points: Array, weight: Array) -> Array:
    place = np.interp(points, axis, np.arange(axis.size))
    before = np.minimum(place.astype(int), axis.size - 2)
    shares = np.zeros(axis.size)
    np.add.at(shares, before, weight * (1 - (place - before)))
    np.add.at(shares, before + 1, weight * (place - before))
    return shares

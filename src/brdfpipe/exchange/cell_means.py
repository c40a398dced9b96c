"""Tables of cells: what formats with a fixed layout share, whose nodes do not follow the lobe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Evaluate, Limits, TableError, error_of, fresh_pairs
from brdfpipe.bsdf.tabulation import values_on_nodes
from brdfpipe.exchange.gridded import Channels
from brdfpipe.exchange.records import Content
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

_TEST_SEED = 2
_GAUSS = 0.5 / np.sqrt(3)
"""Distance of the two Gauss-Legendre nodes from the centre of a cell of length 1."""


_RECIPROCAL = 5e-3
"""Error at the 95th percentile below which a BSDF counts as reciprocal."""


@dataclass(frozen=True)
class CellTable:
    """A table of cells, and its error."""

    bsdf: xr.Dataset
    values: Array
    """(cells…, channels) [sr-1]"""
    error: TableError
    reading: str
    """What the program does that reads the cells, ``interpolated linearly``"""
    content: Content = "luminous"
    limits: Limits | None = None
    """None of a format whose cells are not chosen"""

    @property
    def size(self) -> int:
        """Number of values of all channels."""
        return self.values.size


def centres(edges: Array) -> Array:
    """Middles of cells between their edges."""
    return (edges[1:] + edges[:-1]) / 2


def cell_means(channels: Channels, edges: Mapping[str, Array]) -> Array:
    """Means over the cells of a grid of θ_i, θ_o and φ_o, (θ_i, θ_o, φ_o, channels) [sr-1], and over the azimuth of incidence.

    Two Gauss-Legendre nodes along each axis: exact to the third power of the angles.
    """
    nodes = {name: _nodes(axis) for name, axis in edges.items()}
    shape = tuple(axis.size - 1 for axis in edges.values())
    means = np.empty((*shape, len(channels.names)))
    for row in range(shape[0]):
        of_row = {**nodes, "theta_i": nodes["theta_i"][2 * row : 2 * row + 2]}
        values = node_values(channels, "uniform", of_row)
        means[row] = values.reshape(2, shape[1], 2, shape[2], 2, -1).mean(axis=(0, 2, 4))
    return means


def node_values(channels: Channels, layout: str, axes: Mapping[str, Array]) -> Array:
    """Values on the nodes of a layout of :data:`brdfpipe.bsdf.grids.GRIDS`, (axes…, channels) [sr-1], means over the azimuth of incidence."""
    model = representation(channels.source)

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: None) -> Array:
        return channels.convert(model.evaluate(theta_i, phi_i, theta_o, phi_o, channels.wavelength))

    return values_on_nodes(evaluate, GRIDS[layout], axes, not model.isotropic, model.mirror_symmetric)


def _nodes(edges: Array) -> Array:
    middle, length = centres(edges), np.diff(edges)
    return np.stack([middle - _GAUSS * length, middle + _GAUSS * length], axis=-1).ravel()


def luminous(values: Array) -> Array:
    """The value weighted with V(λ) of one channel or of linear sRGB, (…, 1)."""
    if values.shape[-1] == 1:
        return values
    to_rgb = colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white) * 100
    return np.asarray(values @ np.linalg.inv(to_rgb)[1][:, None])


def displayable(values: Array) -> tuple[Array, dict[str, str]]:
    """Values >= 0, and a sentence where colours outside sRGB had negative ones."""
    if values.shape[-1] != 3 or values.min() >= 0:
        return np.maximum(values, 0.0), {}
    share = float((values < 0).any(axis=-1).mean())
    sentence = f"colours outside sRGB: in {share:.1%} of the cells a negative value of R, G or B became 0"
    return np.maximum(values, 0.0), {"gamut": sentence}


def of_both_orders(bsdf: xr.Dataset) -> TableError:
    """Error of the mean of both orders of the directions, which no table is below that a program reads so; that of reflected light."""
    model = representation(nonspectral(bsdf))

    def mean(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: Array | None) -> Array:
        orders = (theta_i, phi_i, theta_o, phi_o), (theta_o, phi_o, theta_i, phi_i)
        return np.asarray(sum(model.evaluate(*order, None) for order in orders) / 2)

    return table_error(bsdf, mean)


def irreciprocity(least: TableError) -> dict[str, str]:
    """A sentence where the error of :func:`of_both_orders` matters: measured tables are seldom reciprocal."""
    if least.percentile_95 < _RECIPROCAL:
        return {}
    sentence = (
        f"differences between both orders of the directions: the mean of both, which the program takes, is off by {least.percentile_95:.1%} of BRDF cos theta_o at "
        "the 95th percentile, and no resolution takes that off"
    )
    return {"reciprocity": sentence}


def table_error(bsdf: xr.Dataset, evaluate: Evaluate, *, transmission: bool = False) -> TableError:
    """The error of what a program reads, weighted with V(λ) and D65, at directions off its cells.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    evaluate : what the program makes of the table, one value for each pair of directions
    transmission : whether the table holds transmitted light; otherwise reflected light alone is compared
    """
    plain = nonspectral(bsdf)
    pairs, model = fresh_pairs(plain, _TEST_SEED), representation(plain)
    if transmission:
        return error_of(plain, evaluate, pairs)

    def reflected(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        at = theta_i, phi_i, theta_o, phi_o, wavelength
        return np.where((theta_o < 90)[:, None], evaluate(*at), model.evaluate(*at))

    return error_of(plain, reflected, pairs.chosen(pairs.theta_o < 90))


def smallest(error_at: Callable[[int], TableError], tolerance: float, albedo_tolerance: float, sizes: range) -> int:
    """The least number of cells along an axis that keeps both tolerances, to a tenth; the largest if none does.

    The error is taken to fall with the square of the number.
    """
    count = sizes.start
    while True:
        error = error_at(count)
        excess = max(error.percentile_95 / tolerance, error.albedo / albedo_tolerance)
        if excess <= 1 or count >= sizes.stop - 1:
            return count
        count = min(int(np.ceil(count * min(max(1.1, 1.05 * np.sqrt(excess)), 3.0))), sizes.stop - 1)

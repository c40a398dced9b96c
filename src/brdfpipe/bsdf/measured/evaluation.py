"""The representation ``rig``: a BSDF measured on a camera rig, smoothed at a few incidences, interpolated between them and completed.

At each incidence (a node) the BSDF, or its logarithm, is a sum of functions of ϑ and φ about the mirror direction. With ``reciprocity``
``averaged``, the logarithms of f(i → o) and f(o → i) are averaged, weighted by the uncertainty at their incidence (Helmholtz reciprocity:
Nicodemus 1977, NBS 160); incidences beyond the last are then known wherever light leaves at a measured incidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import coordinates
from brdfpipe.bsdf.measured.node_errors import side_uncertainties
from brdfpipe.bsdf.measured.node_interpolation import (
    LobeCoordinates,
    PathDirection,
    Side,
    lobe_coordinates,
    path_directions,
    side_values,
)
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.hemisphere import around_mirror

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_NodeCells: TypeAlias = "tuple[cKDTree, Array]"

REPRESENTATION = "rig"
"""Attribute ``representation`` of these datasets."""

ACCURACY = 1e-4
"""Of integrals [1]: the BSDF has kinks at the nodes, and no measurement is more accurate."""

_CHUNK = 8192  # directions evaluated at a time, to limit memory
_SAME_INCIDENCE = 0.5  # incidences within this distance of a node count as measured there [degree]


@dataclass(frozen=True)
class Prepared:
    """A dataset at some wavelengths; its sides are made when they are needed."""

    bsdf: xr.Dataset
    wavelength: Array | None
    """(wavelength,) nm; None for those of the dataset"""

    @cached_property
    def mixing(self) -> tuple[NDArray[np.int64] | slice, Array]:
        """See :func:`_wavelengths`."""
        return _wavelengths(self.bsdf, self.wavelength)

    @cached_property
    def reflection(self) -> Side:
        return Side.of(self.bsdf, False, self.mixing[0])

    @cached_property
    def transmission(self) -> Side:
        return Side.of(self.bsdf, True, self.mixing[0])

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """See :func:`evaluate`."""
        return _over_sides(side_values, self, (theta_i, phi_i, theta_o, phi_o))

    def uncertainty(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """See :func:`uncertainty`."""
        angles = theta_i, phi_i, theta_o, phi_o
        return np.hypot(_over_sides(side_uncertainties, self, angles), self._spectral_error(angles))

    def _spectral_error(self, angles: tuple[Array, Array, Array, Array]) -> Array | float:
        """Error of the linear interpolation between wavelengths (directions…, wavelength); 0 at those of the dataset.

        The remainder of linear interpolation, |f″|/2 (λ − λ₁)(λ₂ − λ), with the larger of the second differences at both ends. Between only
        two wavelengths the slope stands for it: the BSDF may change anywhere between them.
        """
        own = None if "mixture" in self.bsdf or self.wavelength is None else self.bsdf["wavelength"].values
        if own is None or own.size == 1:
            return 0.0
        requested = np.asarray(self.wavelength, dtype=float)
        after = np.clip(np.searchsorted(own, requested), 1, own.size - 1)
        remainder = np.abs((requested - own[after - 1]) * (own[after] - requested))
        if not remainder.any():
            return 0.0
        needed = np.unique(np.clip(after[:, None] + np.arange(-2, 2), 0, own.size - 1))
        values = Prepared(self.bsdf, own[needed]).evaluate(*angles)
        slope = np.diff(values, axis=-1) / np.diff(own[needed])
        interval = np.searchsorted(needed, after) - 1
        if needed.size == 2:
            return np.asarray(remainder * np.abs(slope[..., interval]) / (own[needed[1]] - own[needed[0]]))
        # Divided differences of three wavelengths, (first, middle, last) with the middle one at each end of the interval.
        bends = np.abs(np.diff(slope, axis=-1)) / (own[needed[2:]] - own[needed[:-2]])
        before, behind = (bends[..., np.clip(interval + step, 0, bends.shape[-1] - 1)] for step in (-1, 0))
        return np.asarray(remainder * np.maximum(before, behind))


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF or BTDF in sr⁻¹, (directions…, wavelength or 1); linear between the wavelengths."""
    return Prepared(bsdf, wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)


def uncertainty(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """Standard uncertainty of :func:`evaluate` in sr⁻¹, (directions…, wavelength or 1).

    Noise, smoothing and common errors follow from the covariance of the coefficients. The error of interpolation between incidences, and
    of completion beyond the last, is the next term of Newton's formula; where the BSDF is constant, the continued trend is added. Below the
    horizon the error is the change that the continued fit would make. An error s of the logarithm counts as exp s − 1. Where the two
    directions of light give different values, their weighted disagreement is added. Between wavelengths the remainder of linear interpolation
    is added.
    """
    return Prepared(bsdf, wavelength).uncertainty(theta_i, phi_i, theta_o, phi_o)


def quality(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.int8]:
    """Origin of each value at most of its wavelengths, one of ``QUALITY_FLAGS`` (int8).

    ``measured`` among the cells of an incidence, ``interpolated`` among those of the incidences on both sides, ``completed`` without
    incidences on both sides, ``extrapolated`` without cells; the better one of the two directions of light counts.
    """
    angles = _flat((theta_i, phi_i, theta_o, phi_o))
    flags = np.full(angles[0].size, vocabulary.quality("extrapolated"), dtype=np.int8)
    for transmitted, at, pairs in _pairs_by_side(bsdf, angles):
        side = Side.of(bsdf, transmitted, slice(0, 1))
        cells = _cells_by_node(bsdf, transmitted, side.basis.symmetric)
        flags[at] = np.min([_path_quality(side, cells, path) for path in path_directions(side, *pairs)], axis=0)
    return flags.reshape(np.broadcast_shapes(*(np.shape(angle) for angle in (theta_i, phi_i, theta_o, phi_o))))


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Directional reflectance [1], (incidences…, wavelength), of a BSDF even about the plane of incidence, to a relative 1e-4."""
    return _integrated(evaluate, bsdf, theta_i, wavelength)


def albedo_uncertainty(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Upper limit of the standard uncertainty of the directional reflectance [1]: as if errors were common to all directions."""
    return _integrated(uncertainty, bsdf, theta_i, wavelength)


def _integrated(quantity: Callable[..., Array], bsdf: xr.Dataset, theta_i: Array, wavelength: Array | None) -> Array:
    slope = lobe_slope(bsdf)
    shape, incidences = np.shape(theta_i), np.ravel(theta_i)
    width = _wavelengths(bsdf, wavelength)[1].shape[1]
    integral = np.zeros((incidences.size, width))
    for at in np.flatnonzero(incidences < 90):
        rule, theta = around_mirror(float(incidences[at]), slope), incidences[at : at + 1]
        integral[at] = rule.weight @ quantity(bsdf, theta, np.zeros(1), rule.theta, rule.phi, wavelength)
    return integral.reshape(*shape, width)


def lobe_slope(bsdf: xr.Dataset) -> float:
    """Facet slope whose lobe is as wide, across the plane of incidence, as that of the first measured incidence."""
    side = Side.of(bsdf, False, slice(None))
    node = int(np.flatnonzero(side.measured.any(axis=1))[0])
    theta = np.concatenate([[0.0], np.geomspace(0.05, 45.0, 200)])
    rows = side.basis.rows(theta, np.full_like(theta, 90.0), np.cos(np.radians(theta)))
    mean = (rows @ side.coefficient[node].T).mean(axis=1)
    below = mean < mean[0] - np.log(2) if side.logarithmic else mean < mean[0] / 2
    half_width = float(theta[below.argmax()]) if below.any() else 45.0
    return float(np.tan(np.radians(half_width / 2)) / np.sqrt(2 * np.log(2)))


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The dataset averaged over wavelength with normalised weights. Exact: every wavelength is evaluated before averaging."""
    if "wavelength" not in bsdf.dims:
        return bsdf
    mixed = bsdf.drop_vars("wavelength").rename_dims(wavelength="mixed")
    return vocabulary.label(mixed.assign(mixture=("mixed", weight)), "bsdf")


# --- sides, wavelengths, chunks


def _over_sides(
    quantity: Callable[[Side, Array, Array, Array], Array],
    prepared: Prepared,
    angles: tuple[Array, Array, Array, Array],
) -> Array:
    """A quantity of pairs of directions, each on its side, at the requested wavelengths, (directions…, wavelength or 1)."""
    mixing, flat = prepared.mixing[1], _flat(angles)
    result = np.zeros((flat[0].size, mixing.shape[1]))
    for transmitted, at, pairs in _pairs_by_side(prepared.bsdf, flat):
        side = prepared.transmission if transmitted else prepared.reflection
        for start in range(0, at.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            result[at[part]] = quantity(side, pairs[0][part], pairs[1][part], pairs[2][part]) @ mixing
    return result.reshape(*np.broadcast_shapes(*(np.shape(angle) for angle in angles)), mixing.shape[1])


def _flat(angles: tuple[Array, Array, Array, Array]) -> tuple[Array, ...]:
    return tuple(np.asarray(angle, dtype=float).ravel() for angle in np.broadcast_arrays(*angles))


def _wavelengths(bsdf: xr.Dataset, wavelength: Array | None) -> tuple[NDArray[np.int64] | slice, Array]:
    """Indices of the dataset's wavelengths that are needed, and the matrix from these to the requested ones."""
    if "mixture" in bsdf:
        return slice(None), bsdf["mixture"].values[:, None]
    own = bsdf["wavelength"].values
    if wavelength is None:
        return slice(None), np.eye(own.size)
    requested = np.asarray(wavelength, dtype=float)
    if own.size == 1:
        return slice(None), np.ones((1, requested.size))
    above = np.clip(np.searchsorted(own, requested), 1, own.size - 1)
    fraction = (requested - own[above - 1]) / (own[above] - own[above - 1])
    full = np.zeros((own.size, requested.size))
    column = np.arange(requested.size)
    full[above - 1, column], full[above, column] = 1 - fraction, fraction
    needed = np.flatnonzero(full.any(axis=1))
    return needed, full[needed]


def _pairs_by_side(
    bsdf: xr.Dataset, angles: tuple[Array, ...]
) -> Iterator[tuple[bool, NDArray[np.int64], tuple[Array, Array, Array]]]:
    """For each side: whether it is transmission, the indices of its pairs, and their θ_i, θ_o (from the side's normal) and φ_o − φ_i."""
    theta_i, phi_i, theta_o, phi_o = angles
    phi = phi_o - phi_i
    above_i, above_o = theta_i < 90, theta_o < 90
    at = np.flatnonzero(above_i & above_o)
    if at.size:
        yield False, at, (theta_i[at], theta_o[at], phi[at])
    if bsdf.attrs["transmission"] == "none":
        return
    at = np.flatnonzero(above_i & (theta_o > 90))
    if at.size:
        yield True, at, (theta_i[at], 180 - theta_o[at], phi[at])
    # Light from below is transmitted as light from above along the reversed path.
    at = np.flatnonzero((theta_i > 90) & above_o)
    if at.size:
        yield True, at, (theta_o[at], 180 - theta_i[at], -phi[at])


# --- quality


def _cells_by_node(bsdf: xr.Dataset, transmitted: bool, symmetric: bool) -> list[_NodeCells | None]:
    """Tree of the cells measured at each node of a side, and the distances [chord] that they cover; None at a completed node."""
    from scipy.spatial import cKDTree

    cells: list[_NodeCells | None] = []
    nodes = np.flatnonzero(bsdf["transmitted"].values == transmitted)
    for measured in bsdf["cell_quality"].values[nodes] == vocabulary.quality("measured"):
        theta, phi = bsdf["theta_s"].values[measured], bsdf["phi_s"].values[measured]
        radius = np.sqrt(bsdf["solid_angle"].values[measured])
        points = unit_vector(theta, phi)
        if symmetric:  # a cell counts for both sides of the plane of incidence
            points, radius = np.concatenate([points, unit_vector(theta, -phi)]), np.concatenate([radius, radius])
        cells.append((cKDTree(points), radius) if measured.any() else None)
    return cells


def _path_quality(side: Side, cells: list[_NodeCells | None], path: PathDirection) -> Array:
    """Quality flags of one path direction."""
    lobe = lobe_coordinates(side, path)
    covered = np.stack([_covered(side, node, of_node, lobe) for node, of_node in enumerate(cells)])
    nodes = np.flatnonzero(side.measured.mean(axis=1) >= 0.5)
    incidence, covered = side.incidence[nodes], covered[nodes]
    index = np.arange(path.theta_i.size)
    nearest = np.abs(path.theta_i[:, None] - incidence).argmin(axis=1)
    at_node = np.abs(path.theta_i - incidence[nearest]) <= _SAME_INCIDENCE
    after = np.clip(np.searchsorted(incidence, path.theta_i), 1, max(incidence.size - 1, 1))
    both_covered = covered[after - 1, index] & covered[np.minimum(after, incidence.size - 1), index]
    between = (path.theta_i >= incidence[0]) & (path.theta_i <= incidence[-1])
    flags = {
        "measured": at_node & covered[nearest, index],
        "interpolated": between & both_covered,
        "completed": ~between & ~at_node,
    }
    return np.select(
        list(flags.values()), [vocabulary.quality(name) for name in flags], vocabulary.quality("extrapolated")
    )


def _covered(side: Side, node: int, cells: _NodeCells | None, lobe: LobeCoordinates) -> NDArray[np.bool_]:
    """Whether cells of a node cover the directions at which it would be evaluated."""
    if cells is None:
        return np.zeros(lobe.theta.size, dtype=bool)
    incidence = np.full_like(lobe.theta, side.incidence[node])
    theta_o, phi_o = coordinates.outgoing(side.about, incidence, lobe.theta, lobe.phi)
    theta_s, phi_s = coordinates.angles("mirror", incidence, theta_o, phi_o)
    tree, radius = cells
    distance, nearest = tree.query(unit_vector(theta_s, phi_s))
    return np.asarray(distance <= radius[nearest])

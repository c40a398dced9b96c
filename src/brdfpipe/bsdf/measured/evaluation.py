"""The representation ``rig``: a BSDF measured on a camera rig, smoothed at a few incidences and told between and beyond them.

At each incidence (a node) the BSDF, or its logarithm, is a sum of functions of ϑ and φ about the mirror direction
(:mod:`brdfpipe.bsdf.measured.coordinates`). Between two nodes coefficients are interpolated at the same ϑ and φ, linearly in x = −ln cos σ: what
facets do grows with powers of 1/cos σ, and near the normal x is σ²/2, so that the BSDF is even there. Coefficients of cos kφ with odd k are
odd in σ, and go with √x. Beyond the last node (:mod:`brdfpipe.bsdf.measured.completion` may put one behind those that were measured) the BSDF stays
as it is about the mirror direction, and below the lowest direction
that was measured as it is there.

Light may go either way: where ``reciprocity`` is ``averaged``, f(i → o) and f(o → i) both tell of the same value, and their logarithms are
averaged, weighted by how well an incidence is known. The BSDF is reciprocal then, and incidences beyond the last are
known wherever light leaves at an angle that was measured as an incidence.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint), completion; Helmholtz reciprocity: Nicodemus 1977 (NBS 160).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import basis as bases
from brdfpipe.bsdf.measured import coordinates
from brdfpipe.bsdf.measured.basis import Basis
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.hemisphere import around_mirror

ACCURACY = 1e-4
"""Of integrals [1]: the BSDF bends at the nodes, and no measurement is worth more."""

_CHUNK = 8192
"""Directions at a time: their rows of functions take the memory."""

_MARGIN = float(np.log(2.0))
"""How far the logarithm may leave what was fitted at cells: between cells a lobe is higher, beyond them a spline goes anywhere."""

_TINY = 1e-30
_CERTAIN = 0.5
"""Incidences so near a node are of it [degree]."""
_UNKNOWN = float(np.log(10.0))
"""Error of a logarithm from which nothing is known."""
_TOWARDS_HORIZON = 0.5
"""Share of what a BSDF changes by that falls with cos θ_o, as below a dielectric face, that is unknown beyond the last cell."""
_FAR = 10.0
"""How far from the only incidence nothing is known any more [degree]."""


@dataclass(frozen=True)
class _Side:
    """What was measured on one side of the sample."""

    incidence: Array
    """(node,)"""
    horizon: Array
    """(node,) largest polar angle of a cell."""
    measured: NDArray[np.bool_]
    """(node, wavelength) whether it was."""
    coefficient: Array
    """(node, wavelength, term)"""
    factor: Array
    """(node, wavelength, term, any)"""
    common: Array
    """(component, node, wavelength, term)"""
    lowest: Array
    """(node, wavelength)"""
    highest: Array
    basis: Basis
    about: str
    logarithmic: bool
    known: tuple[Array, Array] | None
    """θ_i, and how well an incidence is known; None where light goes one way."""

    @property
    def place(self) -> Array:
        """x of the nodes."""
        return place_of(self.incidence)


class _Way(NamedTuple):
    """Pairs of directions as seen in one way, and how much that way counts."""

    theta_i: Array
    theta_o: Array
    phi: Array
    share: Array


class _Seen(NamedTuple):
    """Directions as the bases ask for them."""

    theta: Array
    """ϑ from the mirror direction [degree]."""
    phi: Array
    """φ about it [degree]."""
    cosine: Array
    """Of θ_o."""

    def taken(self, at: NDArray[np.int64]) -> _Seen:
        return _Seen(*(part[at] for part in self))


class _Told(NamedTuple):
    """What a node tells about some of the directions."""

    node: int
    pairs: NDArray[np.int64]
    """Which of the directions."""
    even: Array
    """Share of the node for functions even in σ, that of the way included."""
    odd: Array
    """Share for those odd in σ; that of the even ones where no logarithm was fitted."""
    seen: _Seen


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF or BTDF in sr⁻¹, (directions…, wavelength or 1); linear between the wavelengths."""
    return _over_sides(_values, bsdf, (theta_i, phi_i, theta_o, phi_o), wavelength)


def uncertainty(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """Standard uncertainty of :func:`evaluate` in sr⁻¹, (directions…, wavelength or 1).

    Noise, smoothing and common errors come with the covariance of the coefficients. Interpolation between incidences is taken
    to be off by what the next incidence says (the remainder of Newton's formula), completion beyond the last likewise, and by as much as
    its trend would change it where that was no longer followed, and completion below the horizon by as much as the fit continued
    would. Such an error s of the logarithm counts as exp s − 1. Where light that goes back tells another value, the mean of both is
    off by as much as the two disagree, each weighted with its share.
    """
    return _over_sides(_uncertainties, bsdf, (theta_i, phi_i, theta_o, phi_o), wavelength)


def quality(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.int8]:
    """Where a value comes from: a value of ``QUALITY_FLAGS`` each (int8), for most of its wavelengths.

    ``measured`` among the cells of an incidence, ``interpolated`` among those of the incidences on both sides, ``completed`` where no
    incidences are on both sides, ``extrapolated`` where no cells are; of the two ways of light the better one counts.
    """
    angles = _flat((theta_i, phi_i, theta_o, phi_o))
    found = np.full(angles[0].size, vocabulary.quality("extrapolated"), dtype=np.int8)
    for transmitted, at, pairs in _pairs_by_side(bsdf, angles):
        side = _side(bsdf, transmitted, slice(0, 1))
        cells = _cells_by_node(bsdf, transmitted, side.basis.symmetric)
        found[at] = np.min([_quality(side, cells, way) for way in _ways(side, *pairs)], axis=0)
    return found.reshape(np.broadcast_shapes(*(np.shape(angle) for angle in (theta_i, phi_i, theta_o, phi_o))))


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array | None:
    """Directional reflectance [1], (incidences…, wavelength), by a rule about the mirror direction, to some 1e-4 of itself.

    None of a BSDF that is not even about the plane of incidence.
    """
    if not bases.from_json(bsdf.attrs["basis"]).symmetric:
        return None
    return _integrated(evaluate, bsdf, theta_i, wavelength)


def albedo_uncertainty(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Standard uncertainty of the directional reflectance [1], at most: as if all directions were off together."""
    return _integrated(uncertainty, bsdf, theta_i, wavelength)


def _integrated(of: Callable[..., Array], bsdf: xr.Dataset, theta_i: Array, wavelength: Array | None) -> Array:
    slope = lobe_slope(bsdf)
    shape, incidences = np.shape(theta_i), np.ravel(theta_i)
    width = _wavelengths(bsdf, wavelength)[1].shape[1]
    found = np.zeros((incidences.size, width))
    for at in np.flatnonzero(incidences < 90):
        to = around_mirror(float(incidences[at]), slope)
        found[at] = to.weight @ of(bsdf, incidences[at : at + 1], np.zeros(1), to.theta, to.phi, wavelength)
    return found.reshape(*shape, width)


def lobe_slope(bsdf: xr.Dataset) -> float:
    """Slope of facets that would make the lobe as wide as it is across the plane of the first measured incidence."""
    side = _side(bsdf, False, slice(None))
    node = int(np.flatnonzero(side.measured.any(axis=1))[0])
    theta = np.concatenate([[0.0], np.geomspace(0.05, 45.0, 200)])
    rows = side.basis.rows(theta, np.full_like(theta, 90.0), np.cos(np.radians(theta)))
    mean = (rows @ side.coefficient[node].T).mean(axis=1)
    below = mean < mean[0] - np.log(2) if side.logarithmic else mean < mean[0] / 2
    half_width = float(theta[below.argmax()]) if below.any() else 45.0
    return float(np.tan(np.radians(half_width / 2)) / np.sqrt(2 * np.log(2)))


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The dataset averaged over wavelength with normalised weights; exact: it evaluates every wavelength and averages."""
    if "wavelength" not in bsdf.dims:
        return bsdf
    mixed = bsdf.drop_vars("wavelength").rename_dims(wavelength="mixed")
    return vocabulary.label(mixed.assign(mixture=("mixed", weight)), "bsdf")


# --- sides, wavelengths, chunks


def _over_sides(
    of: Callable[[_Side, Array, Array, Array], Array],
    bsdf: xr.Dataset,
    angles: tuple[Array, Array, Array, Array],
    wavelength: Array | None,
) -> Array:
    """A quantity of pairs of directions on whichever side, at the wavelengths asked for, (directions…, wavelength or 1)."""
    chosen, mixing = _wavelengths(bsdf, wavelength)
    flat = _flat(angles)
    result = np.zeros((flat[0].size, mixing.shape[1]))
    for transmitted, at, pairs in _pairs_by_side(bsdf, flat):
        side = _side(bsdf, transmitted, chosen)
        for start in range(0, at.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            result[at[part]] = of(side, pairs[0][part], pairs[1][part], pairs[2][part]) @ mixing
    return result.reshape(*np.broadcast_shapes(*(np.shape(angle) for angle in angles)), mixing.shape[1])


def _flat(angles: tuple[Array, Array, Array, Array]) -> tuple[Array, ...]:
    return tuple(np.asarray(angle, dtype=float).ravel() for angle in np.broadcast_arrays(*angles))


def _wavelengths(bsdf: xr.Dataset, wavelength: Array | None) -> tuple[NDArray[np.int64] | slice, Array]:
    """Which of the dataset's wavelengths are needed, and the matrix from these to the ones asked for."""
    if "mixture" in bsdf:
        return slice(None), bsdf["mixture"].values[:, None]
    own = bsdf["wavelength"].values
    if wavelength is None:
        return slice(None), np.eye(own.size)
    asked = np.asarray(wavelength, dtype=float)
    if own.size == 1:
        return slice(None), np.ones((1, asked.size))
    above = np.clip(np.searchsorted(own, asked), 1, own.size - 1)
    part = (asked - own[above - 1]) / (own[above] - own[above - 1])
    full = np.zeros((own.size, asked.size))
    column = np.arange(asked.size)
    full[above - 1, column], full[above, column] = 1 - part, part
    needed = np.flatnonzero(full.any(axis=1))
    return needed, full[needed]


def _pairs_by_side(
    bsdf: xr.Dataset, angles: tuple[Array, ...]
) -> Iterator[tuple[bool, NDArray[np.int64], tuple[Array, Array, Array]]]:
    """Whether it is transmission, which directions, and their θ_i, θ_o (both from the normal of its side) and φ_o − φ_i."""
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
    # Light from below passes as light from above would that goes the same way back.
    at = np.flatnonzero((theta_i > 90) & above_o)
    if at.size:
        yield True, at, (theta_o[at], 180 - theta_i[at], -phi[at])


def _side(bsdf: xr.Dataset, transmitted: bool, chosen: NDArray[np.int64] | slice) -> _Side:
    nodes = np.flatnonzero(bsdf["transmitted"].values == transmitted)
    basis = bases.from_json(bsdf.attrs["transmitted_basis" if transmitted else "basis"])
    terms = basis.harmonic.size
    averaged = not transmitted and bsdf.attrs["reciprocity"] == "averaged" and "incidence_error" in bsdf
    common = bsdf["coefficient_common"].values if "coefficient_common" in bsdf else np.zeros((0, 0, 0, 0))

    def taken(name: str) -> Array:
        return np.asarray(bsdf[name].values[nodes][:, chosen])

    return _Side(
        bsdf["incidence"].values[nodes],
        bsdf["horizon"].values[nodes],
        taken("coefficient_quality") == vocabulary.quality("measured"),
        taken("coefficient")[..., :terms],
        taken("coefficient_factor")[:, :, :terms],
        common[:, nodes][:, :, chosen, :terms] if common.size else np.zeros((0, nodes.size, 1, terms)),
        taken("lowest"),
        taken("highest"),
        basis,
        "mirror" if transmitted else str(bsdf.attrs["about"]),
        bsdf.attrs["link"] == "log",
        (bsdf["theta_i"].values, bsdf["incidence_error"].values) if averaged else None,
    )


# --- values


def _values(side: _Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """BSDF (directions, wavelength)."""
    return _told_by(side, _ways(side, theta_i, theta_o, phi))


def _told_by(side: _Side, ways: list[_Way]) -> Array:
    """What the ways tell together, (directions, wavelength)."""
    shape = (ways[0].theta_i.size, side.coefficient.shape[1])
    total, geometric, positive = np.zeros(shape), np.zeros(shape), np.ones(shape, dtype=bool)
    low, high = np.zeros(shape), np.zeros(shape)
    for told in _all_told(side, ways):
        at, even, coefficient = told.pairs, told.even[:, None], side.coefficient[told.node].T
        if side.logarithmic:
            total[at] += side.basis.sums(coefficient, *told.seen, told.even, told.odd)
            low[at] += even * side.lowest[told.node]
            high[at] += even * side.highest[told.node]
            continue
        one = np.ones(at.size)
        value = side.basis.sums(coefficient, *told.seen, one, one)
        total[at] += even * value
        geometric[at] += even * np.log(np.maximum(value, _TINY))
        positive[at] &= (value > 0) | (even == 0)
    if side.logarithmic:
        return np.exp(np.clip(total, low - _MARGIN, high + _MARGIN))
    return np.where(positive, np.exp(geometric), np.maximum(total, 0.0))


def _ways(side: _Side, theta_i: Array, theta_o: Array, phi: Array) -> list[_Way]:
    """The ways light may go, whose shares add up to 1; the same share of a pair seen from either end."""
    if side.known is None:
        return [_Way(theta_i, theta_o, phi, np.ones_like(theta_i))]
    there, back = (np.interp(theta, *side.known) ** 2 for theta in (theta_i, theta_o))
    share = back / (there + back)
    return [_Way(theta_i, theta_o, phi, share), _Way(theta_o, theta_i, -phi, 1 - share)]


def _all_told(side: _Side, ways: list[_Way]) -> Iterator[_Told]:
    """What each node tells about the directions next to it, in each way."""
    for way in ways:
        seen = _seen(side, way)
        for node in range(side.incidence.size):
            even, odd = (share * way.share for share in _node_shares(side, node, way.theta_i))
            pairs = np.flatnonzero((even > 0) | (odd > 0))
            if pairs.size:
                at, _ = _at_node(side, node, seen.taken(pairs))
                yield _Told(node, pairs, even[pairs], (odd if side.logarithmic else even)[pairs], at)


def _seen(side: _Side, way: _Way) -> _Seen:
    angles = coordinates.angles(side.about, way.theta_i, way.theta_o, way.phi)
    return _Seen(*angles, np.cos(np.radians(way.theta_o)))


def place_of(theta_i: Array | float) -> Array:
    """x = −ln cos θ_i of angles [degree], in which incidences are interpolated."""
    return -np.log(np.cos(np.radians(np.minimum(theta_i, 89.999999))))


def _node_shares(side: _Side, node: int, theta_i: Array) -> tuple[Array, Array]:
    """Shares of a node in what is even, and in what is odd in σ: hats over x, and over √x."""
    hat = np.zeros(side.incidence.size)
    hat[node] = 1.0
    place = place_of(theta_i)
    return np.interp(place, side.place, hat), np.interp(np.sqrt(place), np.sqrt(side.place), hat)


def _at_node(side: _Side, node: int, seen: _Seen, *, clamped: bool = True) -> tuple[_Seen, NDArray[np.bool_]]:
    """Where a node is asked, and which of it is its horizon instead of what lies below.

    What bends the BSDF towards grazing is asked where the light leaves, and not where it would leave at the node.
    """
    theta, phi, cosine = seen
    incidence = np.full_like(theta, side.incidence[node])
    theta_o, phi_o = coordinates.outgoing(side.about, incidence, theta, phi)
    below = theta_o > side.horizon[node]
    if clamped:
        cosine = np.maximum(cosine, np.cos(np.radians(side.horizon[node])))
        theta, phi = theta.copy(), phi.copy()
        lowest = np.full(int(below.sum()), side.horizon[node])
        theta[below], phi[below] = coordinates.angles(side.about, incidence[below], lowest, phi_o[below])
    return _Seen(theta, phi, cosine), below


# --- uncertainties


def _uncertainties(side: _Side, theta_i: Array, theta_o: Array, phi: Array) -> Array:
    """Standard uncertainty (directions, wavelength)."""
    ways = _ways(side, theta_i, theta_o, phi)
    rows: dict[int, Array] = {}
    odd = side.basis.harmonic % 2 == 1
    for told in _all_told(side, ways):
        # One coefficient may tell in both ways: its errors add up before they are squared.
        total = rows.setdefault(told.node, np.zeros((theta_i.size, side.coefficient.shape[2])))
        total[told.pairs] += side.basis.rows(*told.seen) * np.where(odd, told.odd[:, None], told.even[:, None])
    variance = np.zeros((theta_i.size, side.coefficient.shape[1]))
    common = np.zeros((side.common.shape[0], *variance.shape))
    for node, total in rows.items():
        for wavelength, factor in enumerate(side.factor[node]):
            variance[:, wavelength] += ((total @ factor) ** 2).sum(axis=1)
        if common.size:
            common += total @ np.swapaxes(side.common[:, node], 1, 2)
    variance += (common**2).sum(axis=0)
    carried = np.zeros_like(variance)
    for way in ways:
        # Both ways may carry the same error: in the mirror direction they are one.
        carried += way.share[:, None] * _carrying(side, way)
    value = _values(side, theta_i, theta_o, phi)
    carried = np.hypot(carried, _disagreement(side, ways))
    if side.logarithmic:
        return value * np.sqrt(variance + carried**2)
    return np.sqrt(variance + (value * carried) ** 2)


def _disagreement(side: _Side, ways: list[_Way]) -> Array | float:
    """Relative error of a mean of two ways that do not agree (directions, wavelength)."""
    if len(ways) == 1:
        return 0.0
    there, back = (
        np.log(np.maximum(_told_by(side, [way._replace(share=np.ones_like(way.share))]), _TINY)) for way in ways
    )
    return np.sqrt(ways[0].share * ways[1].share)[:, None] * np.minimum(np.abs(there - back), _UNKNOWN)


def _carrying(side: _Side, way: _Way) -> Array:
    """Relative error of telling a BSDF between and beyond incidences, and below the horizon (directions, wavelength)."""
    seen = _seen(side, way)
    below = np.zeros((way.theta_i.size, side.coefficient.shape[1]))
    for node in range(side.incidence.size):
        share = _node_shares(side, node, way.theta_i)[0]
        pairs = np.flatnonzero(share > 0)
        at, lifted = _at_node(side, node, seen.taken(pairs))
        changed = np.flatnonzero(lifted)
        if changed.size:
            there, _ = _at_node(side, node, seen.taken(pairs[changed]), clamped=False)
            change = np.abs(_logarithm(side, node, there) - _logarithm(side, node, at.taken(changed)))
            fallen = np.cos(np.radians(side.horizon[node])) / np.maximum(seen.cosine[pairs[changed]], _TINY)
            change = np.hypot(change, _TOWARDS_HORIZON * np.log(np.maximum(fallen, 1.0))[:, None])
            below[pairs[changed]] += share[pairs[changed], None] * change
    between = _interpolation(side, way, seen)
    return np.expm1(np.minimum(np.hypot(below, between), _UNKNOWN))


def _interpolation(side: _Side, way: _Way, seen: _Seen) -> Array:
    """By how much the logarithm may be off between and beyond the measured incidences (directions, wavelength)."""
    some = np.flatnonzero(side.measured.any(axis=1))
    told = np.stack([_logarithm(side, node, _at_node(side, node, seen)[0]) for node in map(int, some)])
    error = np.empty(told.shape[1:])
    # A wavelength that an incidence lost is no better known there than in between.
    for known in np.unique(side.measured[some], axis=1).T:
        at = (side.measured[some] == known[:, None]).all(axis=0)
        error[:, at] = _remainder(side, some[known], told[known][:, :, at], way.theta_i)
    return error


def _remainder(side: _Side, nodes: NDArray[np.int64], told: Array, theta_i: Array) -> Array:
    """The same from what some nodes tell, (node, directions, wavelength): the next term of Newton's formula."""
    place, x = side.place[nodes], place_of(theta_i)
    if nodes.size < 2:
        away = np.abs(theta_i - side.incidence[nodes].sum()) / _FAR
        return np.broadcast_to(away[:, None], told.shape[1:])
    slope = np.diff(told, axis=0) / np.diff(place)[:, None, None]
    first = np.clip(np.searchsorted(place, x, side="right") - 1, 0, nodes.size - 2)
    every = np.arange(x.size)
    if nodes.size == 2:
        bend = np.abs(slope[0]) / (place[1] - place[0])
    else:
        bends = np.diff(slope, axis=0) / (place[2:] - place[:-2])[:, None, None]
        before, after = np.maximum(first - 1, 0), np.minimum(first, nodes.size - 3)
        bend = np.maximum(np.abs(bends[before, every]), np.abs(bends[after, every]))
    error = np.abs((x - place[first]) * (x - place[first + 1]))[:, None] * bend
    if nodes.size > 3:  # where nothing lies on the other side the term behind it is no smaller
        change = np.abs(bends[-1] - bends[-2]) / (place[-1] - place[-4])
        error += (np.maximum(x - place[-1], 0.0) * np.prod(x[:, None] - place[-3:-1], axis=1))[:, None] * change
    # Beyond the last node it stays as it is there, where the trend would go on.
    return np.asarray(error + np.maximum(x - side.place[-1], 0.0)[:, None] * np.abs(slope[-1]))


def _logarithm(side: _Side, node: int, at: _Seen) -> Array:
    """Logarithm of what a node tells (directions, wavelength)."""
    one = np.ones_like(at.theta)
    told = side.basis.sums(side.coefficient[node].T, *at, one, one)
    return told if side.logarithmic else np.log(np.maximum(told, 1e-6 * np.abs(told).max(initial=_TINY)))


# --- quality


class _NodeCells(NamedTuple):
    """The cells that were measured at a node."""

    tree: object
    reach: Array
    """Distance up to which a cell tells, as a chord."""


def _cells_by_node(bsdf: xr.Dataset, transmitted: bool, symmetric: bool) -> list[_NodeCells | None]:
    """What was measured at each node of a side; None of a completed one."""
    from scipy.spatial import cKDTree

    found: list[_NodeCells | None] = []
    nodes = np.flatnonzero(bsdf["transmitted"].values == transmitted)
    for row in bsdf["cell_quality"].values[nodes] == vocabulary.quality("measured"):
        theta, phi = bsdf["theta_s"].values[row], bsdf["phi_s"].values[row]
        reach = np.sqrt(bsdf["solid_angle"].values[row])
        points = unit_vector(theta, phi)
        if symmetric:  # what is told of one side of the plane of incidence is told of the other
            points, reach = np.concatenate([points, unit_vector(theta, -phi)]), np.concatenate([reach, reach])
        found.append(_NodeCells(cKDTree(points), reach) if row.any() else None)
    return found


def _quality(side: _Side, cells: list[_NodeCells | None], way: _Way) -> Array:
    """Flags of one way."""
    seen = _seen(side, way)
    among = np.stack([_among(side, node, each, seen) for node, each in enumerate(cells)])
    nodes = np.flatnonzero(side.measured.mean(axis=1) >= 0.5)
    incidence, among = side.incidence[nodes], among[nodes]
    every = np.arange(way.theta_i.size)
    nearest = np.abs(way.theta_i[:, None] - incidence).argmin(axis=1)
    here = np.abs(way.theta_i - incidence[nearest]) <= _CERTAIN
    after = np.clip(np.searchsorted(incidence, way.theta_i), 1, max(incidence.size - 1, 1))
    both = among[after - 1, every] & among[np.minimum(after, incidence.size - 1), every]
    within = (way.theta_i >= incidence[0]) & (way.theta_i <= incidence[-1])
    flags = {"measured": here & among[nearest, every], "interpolated": within & both, "completed": ~within & ~here}
    return np.select(
        list(flags.values()), [vocabulary.quality(name) for name in flags], vocabulary.quality("extrapolated")
    )


def _among(side: _Side, node: int, cells: _NodeCells | None, seen: _Seen) -> NDArray[np.bool_]:
    """Whether cells of a node look where it would be asked."""
    if cells is None:
        return np.zeros(seen.theta.size, dtype=bool)
    incidence = np.full_like(seen.theta, side.incidence[node])
    theta_o, phi_o = coordinates.outgoing(side.about, incidence, seen.theta, seen.phi)
    theta_s, phi_s = coordinates.angles("mirror", incidence, theta_o, phi_o)
    distance, nearest = cells.tree.query(unit_vector(theta_s, phi_s))  # type: ignore[attr-defined]
    return np.asarray(distance <= cells.reach[nearest])

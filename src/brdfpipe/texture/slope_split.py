"""The slopes that a normal map does not resolve: the density that, with the normals of the map, gives the density of all facets.

A renderer turns the facets of a material with the normal of each point of a map. Seen from afar, the facets of all points add up.
Were the BRDF of all facets used with the map, the slopes that the map resolves would count twice.

Facets have the normal m, and the map has the normal n with probability w per area of the mean plane, whose normal is z. Then

    D(m) = Σ w D'(m turned into the frame of n) / (n·z),

where D = P22 / cos⁴ is that of all facets and D' that of the rest. D' is found from D and w by the iteration of Richardson (1972) and
Lucy (1974), which keeps it positive and its mass. It is one density for all points of the map. Where the fine structure depends
on the coarse one, no single density may exist; the remaining difference is stated.

References
----------
Olano & Baker 2010 (LEAN mapping, I3D) and Dupuy et al. 2013 (LEADR mapping, ACM TOG 32) split the variance alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.facet_dataset import planar_dataset, radial_dataset
from brdfpipe.facets.planar_density import PlanarDensity, SlopeAxis
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

INTERPOLATIONS = ("bilinear", "nearest")
"""How a renderer interpolates between the pixels of a normal map; the first is the default of renderers."""

LEAST_UNRESOLVED = 0.02
"""Least share of the mean square slope that a map may leave: a narrower density would be determined by the error of both."""

_BINS_PER_WIDTH = 3.0
"""Bins of the slopes of a map per rms of the slopes that it does not resolve."""
_MOST_BINS = 6000
_PIXELS_AT_ONCE = 2**18
_PLACES = 4
"""Places between the middles of two pixels: of the mean BRDF of a map they miss 0.2 %."""
_RADIAL_NODES, _PLANAR_NODES = 64, 33
_TARGET_AZIMUTHS = 24
_REACH = 5.0
"""Of the compared slopes, in their rms; a Gaussian has 1e-5 of its facets beyond."""
_ITERATIONS = 200
_CONVERGED = 1e-4
"""Largest relative change of the density, in one iteration, at which it ends."""


class MapSlopes(NamedTuple):
    """The slopes of a normal map as a renderer sees them, in bins."""

    slopes: Array
    """(2, bins) mean slope of a bin along x and y."""
    share: Array
    """(bins,) share of the area of the mean plane."""

    @property
    def covariance(self) -> Array:
        """(2, 2) about zero."""
        return np.asarray((self.slopes * self.share) @ self.slopes.T)


class SlopeSplit(NamedTuple):
    """The facets that a map does not resolve."""

    facets: xr.Dataset
    """Kind ``facets``."""
    unresolved: float
    """Their share of the mean square slope of all facets."""
    difference: float
    """Share of the facets that have other slopes when those of the map and of the rest are put together, 0 to 1."""
    map_slopes: MapSlopes
    """Of the map."""


SlopesAtPlaces = tuple[float, Array, Array]
"""Share of the area that each place stands for, and slopes along x and y, (places,) each."""


def interpolated_slopes(
    slope_x: Array, slope_y: Array, interpolation: str = INTERPOLATIONS[0], places: int = _PLACES
) -> Iterator[SlopesAtPlaces]:
    """Slopes of a periodic normal map between its pixels as well, some places at a time.

    Parameters
    ----------
    slope_x, slope_y : (rows, columns) slopes of the pixels
    interpolation : one of :data:`INTERPOLATIONS`; ``bilinear`` interpolates the components of the normals, which a renderer then normalises
    places : between the middles of two pixels, evenly spread; the error of means over the area falls with its square

    Raises
    ------
    BrdfpipeError : the interpolation is unknown.
    """
    if interpolation not in INTERPOLATIONS:
        raise BrdfpipeError(f"unknown interpolation {interpolation!r}; accepted: {' or '.join(INTERPOLATIONS)}")
    rows, columns = slope_x.shape
    between = (np.arange(places) + 0.5) / places
    step = max(1, _PIXELS_AT_ONCE // columns)
    for start in range(0, rows, step):
        lines = np.arange(start, min(start + step, rows) + 1) % rows
        if interpolation == "nearest":
            yield 1 / slope_x.size, slope_x[lines[:-1]].ravel(), slope_y[lines[:-1]].ravel()
            continue
        # One row and one column more, of the next tile.
        p, q = (np.pad(one[lines], ((0, 0), (0, 1)), mode="wrap") for one in (slope_x, slope_y))
        upright = 1 / np.sqrt(1 + p**2 + q**2)
        normals = np.stack([p * upright, q * upright, upright])
        share = 1 / (slope_x.size * places**2)
        for up in between:
            edge = (1 - up) * normals[:, :-1] + up * normals[:, 1:]
            for right in between:
                x, y, z = (1 - right) * edge[:, :, :-1] + right * edge[:, :, 1:]
                yield share, (x / z).ravel(), (y / z).ravel()


def split(facets: xr.Dataset, slope_x: Array, slope_y: Array, interpolation: str = INTERPOLATIONS[0]) -> SlopeSplit:
    """The facets that a periodic normal map does not resolve.

    Parameters
    ----------
    facets : kind ``facets``, of all facets, isotropic or with a lay
    slope_x, slope_y : (rows, columns) slopes of the pixels of the map along x and y, of mean zero
    interpolation : of the renderer between pixels, one of :data:`INTERPOLATIONS`

    Raises
    ------
    BrdfpipeError : the surface is flat, its slope rms is not finite, or the map leaves less than :data:`LEAST_UNRESOLVED` of the mean square slope.
    VocabularyError : the dataset is not of kind ``facets``.
    """
    vocabulary.validate(facets, "facets")
    if facets["slope_density"].size == 0:
        raise BrdfpipeError("a flat surface has no grain; accepted: a measured surface")
    if facets["slope_density"].ndim == 1:
        found, residual, slope_rms = _radial(RadialDensity.of(facets), (slope_x, slope_y), interpolation)
    else:
        found, residual, slope_rms = _planar(PlanarDensity.of(facets), (slope_x, slope_y), interpolation)
    residual.attrs = {
        "method": "facets that a normal map does not resolve, by Richardson and Lucy's iteration",
        "band": str(facets.attrs["band"]),
    }
    residual["slope_rms"] = slope_rms
    return found._replace(facets=vocabulary.label(residual, "facets"))


def binned_slopes(
    slopes: Iterable[SlopesAtPlaces],
    unresolved_rms: float,
    bins_per_width: float = _BINS_PER_WIDTH,
    most: int = _MOST_BINS,
) -> MapSlopes:
    """Slopes (:func:`interpolated_slopes`) in square bins that are fine beside the slopes that are not resolved: so many per rms, and not more than the most."""
    width = unresolved_rms / bins_per_width
    found = np.concatenate([_binned(np.stack([p, q]), np.full(p.size, share), width) for share, p, q in slopes], axis=1)
    found = _binned(found[:2], found[2], width)
    while found.shape[1] > most:
        width *= 1.3
        found = _binned(found[:2], found[2], width)
    return MapSlopes(found[:2], found[2] / found[2].sum())


def _binned(slopes: Array, share: Array, width: float) -> Array:
    """(3, bins) means of slopes (2, places), weighted with the shares, in bins of a width; and the sum of their shares."""
    cells = np.rint(slopes / width).astype(np.int64)
    _, inverse = np.unique(cells[0] * 2**24 + cells[1], return_inverse=True)
    total = np.bincount(inverse, share)
    return np.stack([*(np.bincount(inverse, share * one) / total for one in slopes), total])


def _mean_squares(slopes: Iterable[SlopesAtPlaces]) -> Array:
    """(2,) along x and y."""
    return np.sum([(share * (p @ p), share * (q @ q)) for share, p, q in slopes], axis=0)


def _unresolved(full: Array, resolved: Array) -> Array:
    """(axes,) mean square slopes that a map leaves, checked, of those of all facets and of the map."""
    left = full - resolved
    if not np.all(np.isfinite(full)) or np.any(left < LEAST_UNRESOLVED * full):
        worst = float(np.min(left / full))
        raise BrdfpipeError(
            f"the normal map leaves {worst:.1%} of the mean square slope of the facets; accepted: at least {LEAST_UNRESOLVED:.0%}. A coarser pixel "
            "leaves more of the map"
        )
    return np.asarray(left)


def _radial(
    full: RadialDensity, of_pixels: tuple[Array, Array], interpolation: str
) -> tuple[SlopeSplit, xr.Dataset, float]:
    s, weight = full.rule()
    mean_square = float(weight @ s**2)
    resolved = _mean_squares(interpolated_slopes(*of_pixels, interpolation)).sum()
    (left,) = _unresolved(np.array([mean_square]), resolved)
    shrink = np.sqrt(left / mean_square)
    bins = binned_slopes(interpolated_slopes(*of_pixels, interpolation), np.sqrt(left / 2))
    rms = np.sqrt(mean_square / 2)
    target = rms * np.sinh(np.linspace(0, np.arcsinh(_REACH), _RADIAL_NODES))
    # The correction is constant beyond the compared slopes.
    nodes = target * shrink
    azimuth = np.arange(_TARGET_AZIMUTHS) * (2 * np.pi / _TARGET_AZIMUTHS)
    matrix = np.zeros((target.size, nodes.size))
    for row, slope in enumerate(target):
        p, q = slope * np.cos(azimuth)[:, None], slope * np.sin(azimuth)[:, None]
        cosine, factor = _turned(p, q, bins)
        square = np.maximum(1 / cosine**2 - 1, 0)
        value = full(square / shrink**2) / shrink**2 * factor / _TARGET_AZIMUTHS
        matrix[row] = _deposited(np.sqrt(square).ravel(), value.ravel(), nodes)
    wanted = full(target**2)
    areas = 2 * np.pi * target * np.gradient(target)
    correction, composed = _deconvolved(matrix, wanted, areas)
    fine = RadialDensity(full.slope * shrink, full.density / shrink**2)
    values = fine.density * np.interp(fine.slope, nodes, correction)
    density = RadialDensity(fine.slope, values).normalised()
    s, weight = density.rule()
    slope_rms = float(np.sqrt(weight @ s**2))
    found = _split_of(left / mean_square, composed, wanted, areas, bins)
    return found, radial_dataset(density, slope_rms), slope_rms


def _planar(
    full: PlanarDensity, of_pixels: tuple[Array, Array], interpolation: str
) -> tuple[SlopeSplit, xr.Dataset, float]:
    angle = np.radians(full.azimuth)
    principal = (
        of_pixels[0] * np.cos(angle) + of_pixels[1] * np.sin(angle),
        of_pixels[1] * np.cos(angle) - of_pixels[0] * np.sin(angle),
    )
    a, b, weight = full.principal_rule()
    mean_squares = np.array([np.sum(weight * a**2), np.sum(weight * b**2)]) / weight.sum()
    left = _unresolved(mean_squares, _mean_squares(interpolated_slopes(*principal, interpolation)))
    shrink, rms = np.sqrt(left / mean_squares), np.sqrt(mean_squares)
    bins = binned_slopes(interpolated_slopes(*principal, interpolation), float(np.sqrt(left.min())))
    along, across = (SlopeAxis(one, one * _REACH, _PLANAR_NODES) for one in rms.tolist())
    along_left, across_left = (SlopeAxis(one, one * _REACH, _PLANAR_NODES) for one in (rms * shrink).tolist())
    size = _PLANAR_NODES**2
    matrix = np.zeros((size, size))
    for row, q in enumerate(across.nodes):
        for column, p in enumerate(along.nodes):
            x, y, factor = _turned_slopes(p, q, bins)
            value = full.principal(x / shrink[0], y / shrink[1]) / shrink.prod() * factor
            matrix[row * _PLANAR_NODES + column] = _deposited_in_plane(x, y, value, along_left, across_left)
    wanted = full.principal(along.nodes, across.nodes[:, None]).ravel()
    areas = (np.gradient(across.nodes)[:, None] * np.gradient(along.nodes)).ravel()
    correction, composed = _deconvolved(matrix, wanted, areas)
    density = _corrected(full, shrink, correction.reshape(_PLANAR_NODES, _PLANAR_NODES), along_left, across_left)
    covariance = density.moments[1][:, None] * density.moments[1] + density.moments[2]
    slope_rms = float(np.sqrt(np.trace(covariance)))
    # In the frame of the map again: its bins are along the lay.
    cos, sin = np.cos(angle), np.sin(angle)
    in_map = bins._replace(slopes=np.array([[cos, -sin], [sin, cos]]) @ bins.slopes)
    found = _split_of(float(left.sum() / mean_squares.sum()), composed, wanted, areas, in_map)
    return found, planar_dataset(density, slope_rms), slope_rms


def _turned(p: Array, q: Array, bins: MapSlopes) -> tuple[Array, Array]:
    """Cosine between facets of given slopes and the normals of the bins, and what the density of a facet's slope in their frame is multiplied by."""
    x, y = bins.slopes
    flat, steep = 1 + x**2 + y**2, 1 + p**2 + q**2
    dot = 1 + p * x + q * y
    cosine = np.clip(dot / np.sqrt(flat * steep), 1e-6, 1.0)
    # P22 = D cos⁴, in both frames; per area of the mean plane the map has the area 1/(n·z).
    factor = np.where(dot > 0, bins.share * np.sqrt(flat) / (steep**2 * cosine**4), 0.0)
    return cosine, factor


def _turned_slopes(p: float, q: float, bins: MapSlopes) -> tuple[Array, Array, Array]:
    """Slopes of a facet in the frames of the bins, whose first axis is that of x in their plane; and the factor of :func:`_turned`."""
    x, y = bins.slopes
    _, factor = _turned(np.array(p), np.array(q), bins)
    flat = np.sqrt(1 + x**2 + y**2)
    m_n = np.maximum(1 + p * x + q * y, 1e-9) / flat
    # First axis (1 + y², −x y, x) and second (0, 1, y), both before they are normalised; facets (−p, −q, 1), normals (−x, −y, 1)/flat.
    first = (-p * (1 + y**2) + q * x * y + x) / (np.sqrt(1 + y**2) * flat)
    second = (-q + y) / np.sqrt(1 + y**2)
    return -first / m_n, -second / m_n, factor


def _deposited(position: Array, value: Array, nodes: Array) -> Array:
    """Values on the nodes beside their positions, by linear interpolation; constant beyond the last one."""
    at = np.interp(position, nodes, np.arange(nodes.size))
    below = np.minimum(at.astype(int), nodes.size - 2)
    share = at - below
    return np.asarray(
        np.bincount(below, value * (1 - share), nodes.size) + np.bincount(below + 1, value * share, nodes.size)
    )


def _deposited_in_plane(x: Array, y: Array, value: Array, along: SlopeAxis, across: SlopeAxis) -> Array:
    size = along.size
    column, row = (np.clip(axis.position(one), 0, size - 1) for axis, one in ((along, x), (across, y)))
    left, low = (np.minimum(one.astype(int), size - 2) for one in (column, row))
    right_share, high_share = column - left, row - low
    result = np.zeros(size**2)
    for step_y, share_y in ((0, 1 - high_share), (1, high_share)):
        for step_x, share_x in ((0, 1 - right_share), (1, right_share)):
            result += np.bincount((low + step_y) * size + left + step_x, value * share_x * share_y, size**2)
    return result


def _deconvolved(matrix: Array, wanted: Array, areas: Array) -> tuple[Array, Array]:
    """The positive factors of a density whose composition with a map is as wanted, and that composition."""
    factors = np.ones(matrix.shape[1])
    total = areas @ matrix
    reached = total > 1e-12 * total.max()
    for _ in range(_ITERATIONS):
        composed = np.maximum(matrix @ factors, 1e-300)
        change = np.where(reached, (areas * wanted / composed) @ matrix / np.maximum(total, 1e-300), 1.0)
        # Where nothing is compared the factor of the first guess stays.
        factors *= change
        if np.abs(change[total > 1e-3 * total.max()] - 1).max() < _CONVERGED:
            break
    return factors, np.asarray(matrix @ factors)


def _split_of(unresolved: float, composed: Array, wanted: Array, areas: Array, bins: MapSlopes) -> SlopeSplit:
    difference = float(0.5 * (areas @ np.abs(composed - wanted)) / (areas @ wanted))
    return SlopeSplit(xr.Dataset(), float(unresolved), difference, bins)


def _corrected(
    full: PlanarDensity, shrink: Array, correction: Array, along: SlopeAxis, across: SlopeAxis
) -> PlanarDensity:
    """The first guess on its own fine grid, times the correction."""
    from scipy.ndimage import map_coordinates

    axes = [
        SlopeAxis(one.scale * factor, one.reach * factor, one.size)
        for one, factor in zip((full.along, full.across), shrink.tolist(), strict=True)
    ]
    position = np.meshgrid(across.position(axes[1].nodes), along.position(axes[0].nodes), indexing="ij")
    factor = map_coordinates(correction, position, order=1, mode="nearest")
    values = full.density / shrink.prod() * factor
    density = PlanarDensity(axes[0], axes[1], np.maximum(values, 1e-18 * values.max()), full.azimuth)
    return PlanarDensity(axes[0], axes[1], density.density / density.moments[0], full.azimuth)

"""Facet distribution of height maps: one scan, or several of one surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.facets.assembly import planar_dataset, positive, radial_dataset, with_noise_warning
from brdfpipe.facets.counting import (
    PLENTY,
    Binned,
    FacetError,
    counted_density,
    histogram,
    histogram_of,
    merged,
    narrowed,
    redundancy_in_classes,
    redundancy_of,
)
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity, SlopeAxis
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.scans import with_roughness_warning
from brdfpipe.facets.slopes import (
    BLOCKS,
    SCALES,
    HeightMap,
    Moments,
    SlopeCounts,
    correlation_length,
    count_maps,
    slope_rms_by_scale,
    triangle_slopes,
)
from brdfpipe.geometry import Array

LAY_LIMIT = 1.2
"""Anisotropy above which a map that is not declared isotropic is taken to have a lay."""

_SLOPE_RMS = (1e-9, 1e9)
"""Slope rms outside which the squares of slopes may not even be numbers of single precision."""

_FACETS_A_HEIGHT = 4
"""Triangles that have their right angle at one height: no more independent facets than heights are there."""

_COARSE_STEPS = 0.5
"""Slope of one step of the heights, over the slope rms, above which the density's shape is that of the correction."""

_CELLS = 41
_NODES = 129
_WINDOWS = 9, 5, 3, 1
_PRIOR = 20.0
_MEASURED = 50.0
"""Independent facets from which on a cell counts as measured."""


def of_maps(maps: Sequence[xr.Dataset], isotropic: bool | None) -> xr.Dataset:
    """Facet distribution of levelled maps; see :func:`brdfpipe.facets.estimate`."""
    heights = [HeightMap.of(surface) for surface in maps]
    counts, found = count_maps(heights)
    scans = zip(heights, found.tilts, strict=True)
    by_scale = np.mean([slope_rms_by_scale(each, tilt) for each, tilt in scans], axis=0)
    _check_slopes(found, float(by_scale[0]))
    has_lay = not isotropic if isotropic is not None else not found.anisotropy <= LAY_LIMIT
    facets = _with_lay(heights, found) if has_lay else _isotropic(counts, found)
    facets = facets.assign(
        effective_count=found.facets / max(redundancy_in_classes(counts.counts), _FACETS_A_HEIGHT),
        anisotropy=found.anisotropy,
        lay=found.lay,
        facet_count=float(found.facets),
        correlation_length=float(np.mean([correlation_length(surface) for surface in maps])),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1],
    ).assign_coords(scale=SCALES)
    levelled = all(surface.attrs["levelling"] != "none" for surface in maps)
    extent = min(
        pitch * count for each in heights for pitch, count in zip(each.pitch, each.height.shape[::-1], strict=True)
    )
    together = "" if len(maps) == 1 else f", {len(maps)} scans together"
    facets.attrs |= {"method": f"four triangles a quad{together}", "band": str(maps[0].attrs["band"])}
    facets = _with_warnings(facets, found, isotropic, levelled, extent)
    facets = with_roughness_warning(_with_quantum(facets, heights, found), found.scan_rms)
    return vocabulary.label(with_noise_warning(facets), "facets")


def _check_slopes(found: Moments, sampled_rms: float) -> None:
    # What single precision cannot hold is missing or zero in what was counted; the sample is of double precision.
    rms = found.slope_rms or sampled_rms
    if rms > 0 and not _SLOPE_RMS[0] < rms < _SLOPE_RMS[1]:
        raise FacetError(
            f"the slope rms {rms:.2g} is none that a surface can have; check the unit of the heights (`surface.unit`) and of the "
            "pitch (`surface.lateral_unit`)"
        )
    if not rms > 0 or found.facets == 0:
        raise FacetError(
            "the surface is perfectly flat or has no complete facet; check the height unit and the missing heights"
        )


def _isotropic(counts: SlopeCounts, found: Moments) -> xr.Dataset:
    bins = merged(histogram(counts, found.slope_rms))
    widened = float(np.trace(found.seen - found.covariance)) / 2
    density, quality, relative_u = counted_density(narrowed(bins, widened) if widened else bins)
    facets = radial_dataset(density, found.slope_rms)
    facets = facets.assign(
        count=("slope", bins.at_nodes(density.slope.size)),
        D_u=("alpha", facets["D"].values * relative_u),
        slope_density_quality=("slope", quality),
    )
    return _with_few_warning(facets, bins)


# --- a surface with a lay


def _with_lay(maps: Sequence[HeightMap], found: Moments) -> xr.Dataset:
    """Elliptic density of the slopes, corrected by the counts in cells of the slope plane.

    The ellipse gives the tails and the cells the shape: the density E is multiplied by (n + k) / (e + k), with n and e the
    independent facets found and expected of E in windows of ever fewer cells, and k the number at which the two are trusted alike.
    """
    if not np.isfinite(found.anisotropy):
        raise FacetError("the surface does not vary in one direction at all; no density of slopes can be counted")
    # Over its principal widths the ellipse is a circle, and both axes are one.
    along, across = np.sqrt(np.linalg.eigvalsh(found.covariance)).tolist()
    ellipse = Ellipse(along, across, found.lay)
    over_widths = _over_widths(found, ellipse)
    bins = _rings(maps, found.tilts, over_widths)
    round_density, _, ring_u = counted_density(bins)
    # What was counted is narrowed alike everywhere; but a sharp peak has to be narrowed more, and a tail less.
    share = float(np.sqrt(np.linalg.det(found.covariance) / np.linalg.det(found.seen)))
    sharp_density = (
        round_density if share == 1 else counted_density(narrowed(bins.over(np.sqrt(share)), 1 / share - 1))[0]
    )
    reach = float(max(round_density.slope[-1], sharp_density.slope[-1]))
    nodes, cells = (SlopeAxis(1.0, reach, size) for size in (_NODES, _CELLS))
    by_block = _cell_counts(maps, found.tilts, over_widths, cells)
    counts = by_block.sum(axis=0).reshape(cells.size, cells.size)
    redundancy = _cell_redundancies(by_block, cells)
    correction = _correction(counts / redundancy, found.facets * _cell_shares(round_density, cells) / redundancy)

    def corrected(square: Array) -> Array:
        return positive(sharp_density(square) * np.exp(_refine(np.log(correction), cells, nodes)), 1e-18)

    density = PlanarDensity.elliptic(corrected, ellipse, reach, _NODES)
    density = replace(density, density=density.density / density.moments[0])
    independent = _refine(counts / redundancy, cells, nodes)
    distance = np.hypot(nodes.nodes, nodes.nodes[:, None])
    relative_u = np.maximum(np.interp(distance, round_density.slope, ring_u), 1 / np.sqrt(np.maximum(independent, 1.0)))
    dims = ("slope_across", "slope_along")
    facets = planar_dataset(density, found.slope_rms).assign(
        count=(dims, _refine_counts(counts, cells, nodes)),
        slope_density_u=(dims, density.density * relative_u),
        slope_density_quality=(dims, _quality(independent >= _MEASURED)),
    )
    return _with_few_warning(facets, bins)


def _correction(found: Array, expected: Array) -> Array:
    """What to multiply a density by, from the independent facets found and expected of it in cells (across, along).

    Wide windows come first: they hold enough facets to show a skew or a lay that is no ellipse, which single cells would
    have to show against their prior.
    """
    from scipy.ndimage import uniform_filter

    correction = np.ones_like(found)
    for width in _WINDOWS:
        n, e = (width**2 * uniform_filter(each, width, mode="constant") for each in (found, expected * correction))
        correction *= (np.maximum(n, 0) + _PRIOR) / (np.maximum(e, 0) + _PRIOR)
    return correction


def _over_widths(found: Moments, ellipse: Ellipse) -> Array:
    """(2, 2) that takes the slopes that were counted to those of the surface, along the lay and across it, over their widths.

    Of the linear maps that give the surface's covariance, the one that moves the slopes least.
    """
    root = _power(found.covariance, 0.5)
    narrowed = root @ _power(root @ found.seen @ root, -0.5) @ root
    cos, sin = np.cos(np.radians(ellipse.lay)), np.sin(np.radians(ellipse.lay))
    return np.array([[cos, sin], [-sin, cos]]) / [[ellipse.along], [ellipse.across]] @ narrowed


def _power(symmetric: Array, exponent: float) -> Array:
    values, vectors = np.linalg.eigh(symmetric)
    return np.asarray(vectors * values**exponent @ vectors.T)


def _each(maps: Sequence[HeightMap], tilts: Array, over_widths: Array) -> Iterator[tuple[int, Array, Array]]:
    """The slopes along the lay and across it, over their widths, block by block."""
    (px, qx), (py, qy) = over_widths.tolist()
    for block, p, q in triangle_slopes(maps, tilts):
        yield block, p * px + q * qx, p * py + q * qy


def _rings(maps: Sequence[HeightMap], tilts: Array, over_widths: Array) -> Binned:
    """Counts of the slopes over their widths in rings about the mean."""
    squares = ((block, x * x + y * y) for block, x, y in _each(maps, tilts, over_widths))
    return merged(histogram_of(squares, np.sqrt(2.0), len(maps) * BLOCKS**2))


def _cell_counts(maps: Sequence[HeightMap], tilts: Array, over_widths: Array, cells: SlopeAxis) -> Array:
    """Facets of each block in the cells about the nodes, (blocks, across and along)."""
    counts = np.zeros((len(maps) * BLOCKS**2, cells.size**2))
    for block, x, y in _each(maps, tilts, over_widths):
        column, row = (np.clip(np.rint(cells.position(slope)), 0, cells.size - 1).astype(np.int64) for slope in (x, y))
        counts[block] += np.bincount(row * cells.size + column, minlength=cells.size**2)
    return counts


def _cell_redundancies(by_block: Array, cells: SlopeAxis) -> Array:
    """How many facets count as one in a cell, (across, along): that of all cells as far from the middle, taken together."""
    distance = np.hypot(cells.nodes, cells.nodes[:, None])
    ring = np.rint(cells.position(np.minimum(distance, cells.reach))).astype(int)
    redundancy = np.ones(cells.size)
    for each in np.unique(ring):
        redundancy[each] = redundancy_of(by_block, ring.ravel() == each)
    return redundancy[ring]


def _cell_shares(round_density: RadialDensity, cells: SlopeAxis) -> Array:
    """Share of a radial density in the same cells, by a midpoint rule of 5 × 5 points a cell."""
    step = 2 * cells.end / (cells.size - 1)
    t = (np.linspace(-cells.end, cells.end, cells.size)[:, None] + (np.arange(5) - 2.0) / 5 * step).ravel()
    x, weight = np.sinh(t), np.cosh(t) * step / 5
    share = round_density(x**2 + x[:, None] ** 2) * weight * weight[:, None]
    return np.asarray(share.reshape(cells.size, 5, cells.size, 5).sum(axis=(1, 3)))


def _refine(values: Array, cells: SlopeAxis, nodes: SlopeAxis) -> Array:
    """Values of cells, interpolated linearly onto nodes."""
    from scipy.ndimage import map_coordinates

    position = cells.position(nodes.nodes)
    return np.asarray(map_coordinates(values, np.meshgrid(position, position, indexing="ij"), order=1, mode="nearest"))


def _refine_counts(counts: Array, cells: SlopeAxis, nodes: SlopeAxis) -> Array:
    """Counts of cells shown on the nodes nearest to their middles, none elsewhere: their sum is the number of facets."""
    result = np.zeros((nodes.size, nodes.size))
    places = np.rint(nodes.position(cells.nodes)).astype(int)
    np.add.at(result, (places[:, None], places), counts)
    return result


def _quality(trusted: NDArray[np.bool_]) -> NDArray[np.int8]:
    return np.where(trusted, vocabulary.quality("measured"), vocabulary.quality("extrapolated")).astype(np.int8)


def _with_quantum(facets: xr.Dataset, heights: Sequence[HeightMap], found: Moments) -> xr.Dataset:
    """Say that heights came in steps, and warn where these are coarse."""
    quantum = max(each.quantum for each in heights)
    if not quantum:
        return facets
    rms = np.sqrt(np.diag(found.covariance))
    share = max(float(np.max(each.quantum / np.array(each.pitch) / rms)) for each in heights)
    facets = vocabulary.add_history(
        facets,
        f"the heights come in steps of {1000 * quantum:.3g} nm, a slope of up to {share:.2g} times the slope rms along x or y: they were "
        "spread over their steps, and what rounding and spreading add to the mean square slope was taken away",
    )
    if share < _COARSE_STEPS:
        return facets
    return vocabulary.add_warning(
        facets,
        f"one step of the heights, {1000 * quantum:.3g} nm, makes a slope of {share:.2g} times the slope rms along x or y: the shape of the "
        "density is hardly measured; export the heights with more digits, measure at a finer height resolution, or smooth them "
        "with `surface.lambda_s`",
    )


def _with_few_warning(facets: xr.Dataset, bins: Binned) -> xr.Dataset:
    if bins.least == PLENTY:
        return facets
    return vocabulary.add_warning(
        facets,
        f"the {bins.found.sum():.0f} facets are so few, or differ so much from place to place, that bins hold only {bins.least} "
        f"independent ones: the density is uncertain to 20 % or more; {bins.remedy}",
    )


def _with_warnings(
    facets: xr.Dataset, found: Moments, isotropic: bool | None, levelled: bool, extent: float
) -> xr.Dataset:
    tilt = float(np.hypot(*found.tilts.T).max())
    if tilt > 0.1 * found.slope_rms:
        facets = vocabulary.add_warning(
            facets,
            f"a mean slope of {tilt:.2g}, {tilt / found.slope_rms:.0%} of the slope rms, was left and taken away: "
            + (
                "try another `surface.form`, or measure a larger area"
                if levelled
                else "level the surface (`surface.form: plane`)"
            ),
        )
    lengths = extent / float(facets["correlation_length"])
    if lengths < 2 * BLOCKS:
        facets = vocabulary.add_warning(
            facets,
            f"the scan is {lengths:.0f} correlation lengths wide: from {2 * BLOCKS} on its {BLOCKS} x {BLOCKS} blocks tell the uncertainty, "
            "which here is understated; measure a larger area",
        )
    if np.isnan(lengths):
        facets = vocabulary.add_warning(
            facets,
            "the heights along x or y stay correlated over half of the scan, so that no correlation length is known: unless a lay "
            "runs along there, measure a larger area, or take longer waves away with `surface.lambda_c`",
        )
    if isotropic is True and found.anisotropy > LAY_LIMIT:
        facets = vocabulary.add_history(
            facets,
            f"declared isotropic; the scan's own anisotropy is {found.anisotropy:.2f}, the density an average over azimuth",
        )
    return facets

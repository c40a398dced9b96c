"""Facet distribution of height maps: one scan, or several of one surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import plain
from brdfpipe.facets.density_changes import (
    changed,
    changes_of_widths,
    planar_changes,
    radial_changes,
    with_changes,
)
from brdfpipe.facets.facet_dataset import noise_warning, planar_dataset, quality_flags, radial_dataset
from brdfpipe.facets.noise_removal import LEAST_SURFACE, with_noise_stated, without_noise
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity, SlopeAxis
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.slope_histogram import (
    MIN_PER_BIN,
    FacetError,
    MergedHistogram,
    check_slope_rms,
    density_from_histogram,
    histogram,
    merge_bins,
    redundancy_in_classes,
    redundancy_of,
    remove_broadening,
)
from brdfpipe.facets.slopes import (
    BLOCKS,
    SCALES,
    HeightMap,
    Moments,
    correlation_length,
    count_in_cells,
    count_maps,
    count_scaled,
    outlying,
    slope_rms_by_scale,
)
from brdfpipe.geometry import Array
from brdfpipe.psd.noise_floor import NoiseFloor

LAY_LIMIT = 1.2
"""Anisotropy above which a map that is not declared isotropic has a lay."""

_LARGEST_ANISOTROPY = 1e3
"""Ratio of the principal slopes above which the smaller one is rounding of the numbers."""

_FACETS_PER_HEIGHT = 4
"""Triangles per height: there are no more independent facets than heights."""

_COARSE_STEPS = 0.5
"""Slope of one height step, over the slope rms, above which the correction determines the shape of the density."""

_RMS_RATIO_LIMIT = 1.2
"""Ratio of slope rms between scans that is unlikely to arise by chance."""

_CELLS = 41
_NODES = 129
_WINDOWS = 9, 5, 3, 1
_PRIOR = 20.0
_MEASURED = 50.0
"""Smallest number of independent facets of a cell that counts as measured."""


def estimate_from_maps(
    maps: Sequence[xr.Dataset], isotropic: bool | None, noise: float | NoiseFloor | None
) -> xr.Dataset:
    """Facet distribution of levelled maps; see :func:`brdfpipe.facets.estimate`."""
    heights = [HeightMap.of(surface, noise) for surface in maps]
    counts, moments = count_maps(heights)
    scans, steep = zip(heights, moments.tilts, strict=True), outlying(counts)
    by_scale = np.mean([slope_rms_by_scale(scan, tilt, steep.slope) for scan, tilt in scans], axis=0)
    # Slopes out of the range of single precision are missing or zero in the counts; the sample has double precision.
    rms = moments.slope_rms or float(by_scale[0])
    if rms > 0:
        check_slope_rms(rms)
    if not rms > 0 or moments.facets == 0:
        raise FacetError(
            "the surface is perfectly flat or has no complete facet; check the height unit and the missing heights"
        )
    has_lay = not isotropic if isotropic is not None else not moments.anisotropy <= LAY_LIMIT
    facets = _with_lay(heights, moments) if has_lay else _isotropic(heights, counts, moments)
    facets = facets.assign(
        effective_count=moments.facets / max(redundancy_in_classes(counts), _FACETS_PER_HEIGHT),
        anisotropy=moments.anisotropy,
        lay=moments.lay,
        facet_count=float(moments.facets),
        correlation_length=float(np.mean([correlation_length(surface) for surface in maps])),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1],
    ).assign_coords(scale=SCALES)
    count = "" if len(maps) == 1 else f", {len(maps)} scans"
    facets.attrs |= {"method": f"four triangles a quad{count}", "band": str(maps[0].attrs["band"])}
    history, warnings = _remarks(facets, maps, heights, moments, isotropic)
    warnings += steep.warning("facets", "the slope rms and the lay are")
    facets = vocabulary.add_history(facets, *history) if history else facets
    facets = vocabulary.add_warning(facets, *warnings)
    return vocabulary.label(_with_noise_stated(facets, heights, moments), "facets")


def _isotropic(heights: Sequence[HeightMap], counts: NDArray[np.int64], moments: Moments) -> xr.Dataset:
    bins = merge_bins(histogram(counts, moments.slope_rms))
    widened = float(np.trace(moments.apparent_covariance - moments.covariance)) / 2
    sharp = _sharpened(heights, bins, widened) if widened else bins
    density, quality, relative_u, scatter = density_from_histogram(sharp)
    noise_change = _noise_change(heights, bins, widened, density)
    relative_u = np.minimum(np.hypot(relative_u, np.abs(noise_change).sum(axis=0)), 1.0)
    facets = radial_dataset(density, moments.slope_rms)
    # Removing noise of a share of the mean square slope makes the change of the rest as many times as large.
    apparent = float(np.trace(moments.apparent_covariance)) / 2
    scatter = scatter / max(1 - widened / apparent, LEAST_SURFACE)
    changes = {
        "facets": radial_changes(density, scatter),
        "noise": changed(density, np.log1p(np.maximum(noise_change, -0.99))),
    }
    facets = with_changes(facets, changes)
    facets = facets.assign(
        count=("slope", bins.at_nodes(density.slope.size)),
        D_u=("alpha", facets["D"].values * relative_u),
        slope_density_quality=("slope", quality),
        tail_slope=float(sharp.edges[-1]),
    )
    facets = facets.assign(_tail_shares(bins))
    return _with_few_warning(facets, bins)


def _sharpened(maps: Sequence[HeightMap], bins: MergedHistogram, widened: float) -> MergedHistogram:
    """Bins without the broadening by a mean square along each axis; noise may be much, rounding and dither are little."""
    noisy = [scan for scan in maps if scan.noise]
    return without_noise(bins, widened, noisy[0].pitch) if noisy else remove_broadening(bins, widened)


def _noise_change(maps: Sequence[HeightMap], bins: MergedHistogram, widened: float, density: RadialDensity) -> Array:
    """Relative change (1, nodes) of a density as the noise grows by its standard uncertainty; (0, nodes) without noise."""
    relative = max((2 * scan.noise_u / scan.noise for scan in maps if scan.noise), default=0.0)
    if not relative:
        return np.zeros((0, density.slope.size))
    other = density_from_histogram(_sharpened(maps, bins, widened * (1 + relative))).density(density.slope**2)
    return np.asarray(other / np.maximum(density.density, 1e-300) - 1)[None]


def _with_lay(maps: Sequence[HeightMap], moments: Moments) -> xr.Dataset:
    """Elliptic density of the slopes, corrected by the counts in cells of the slope plane.

    The ellipse gives the tails, the cells the shape. The elliptic density is multiplied by (n + k) / (e + k) in windows of
    decreasing size: n and e are the observed and expected independent facets, k the number at which both have equal weight.
    """
    if not moments.anisotropy <= _LARGEST_ANISOTROPY:
        raise FacetError(
            f"no slopes along the lay, at an azimuth of {moments.lay:.3g}°: the heights hardly vary in that direction; accepted: principal slopes with a "
            f"ratio up to {_LARGEST_ANISOTROPY:g}. Check that the rows of the heights (`surface.file`) are not copies of one line; a measured map has some "
            "roughness along its grooves"
        )
    # Divided by its principal widths the ellipse is a circle, and one axis serves both.
    along, across = np.sqrt(np.linalg.eigvalsh(moments.covariance)).tolist()
    ellipse = Ellipse(along, across, moments.lay)
    scaling = _slope_scaling(moments, ellipse)
    bins = merge_bins(histogram(count_scaled(maps, moments.tilts, scaling), np.sqrt(2.0)))
    round_density, _, ring_u, scatter = density_from_histogram(bins)
    # Dividing by the widths removes the broadening uniformly, but a sharp peak needs more of it and a tail less.
    share = float(np.sqrt(np.linalg.det(moments.covariance) / np.linalg.det(moments.apparent_covariance)))
    sharp_density, narrowed = round_density, bins
    if share != 1:
        narrowed = bins.divided_by(np.sqrt(share))
        sharp_density = density_from_histogram(_sharpened(maps, narrowed, 1 / share - 1))[0]
    reach = float(max(round_density.slope[-1], sharp_density.slope[-1]))
    nodes, cells = (SlopeAxis(1.0, reach, size) for size in (_NODES, _CELLS))
    by_block = count_in_cells(maps, moments.tilts, scaling, cells.borders)
    counts = by_block.sum(axis=0)
    redundancy = _cell_redundancies(by_block.reshape(len(by_block), -1).astype(float), cells)
    correction = _correction(counts / redundancy, moments.facets * _cell_shares(round_density, cells) / redundancy)

    def corrected(square: Array) -> Array:
        values = sharp_density(square) * np.exp(_refine(np.log(correction), cells, nodes))
        # Without zeros, so that the logarithm is finite.
        return np.maximum(values, 1e-18 * values.max())

    density = PlanarDensity.elliptic(corrected, ellipse, reach, _NODES)
    density = replace(density, density=density.density / density.moments[0])
    independent = _refine(counts / redundancy, cells, nodes)
    distance = np.hypot(nodes.nodes, nodes.nodes[:, None])
    relative_u = np.maximum(np.interp(distance, round_density.slope, ring_u), 1 / np.sqrt(np.maximum(independent, 1.0)))
    noise_change = _noise_change(maps, narrowed, 1 / share - 1, sharp_density)
    noise_u = np.abs(noise_change).sum(axis=0)
    relative_u = np.minimum(np.hypot(relative_u, np.interp(distance, sharp_density.slope, noise_u)), 1.0)
    dims = ("slope_across", "slope_along")
    facets = planar_dataset(density, moments.slope_rms).assign(
        count=(dims, _refine_counts(counts, cells, nodes)),
        slope_density_u=(dims, density.density * relative_u),
        slope_density_quality=(dims, quality_flags(independent >= _MEASURED)),
    )
    log_noise = np.log1p(np.maximum(noise_change, -0.99))
    on_rings = [np.interp(round_density.slope, sharp_density.slope, one) for one in log_noise]
    amplified = scatter / max(share, LEAST_SURFACE)
    widths = bins.of_neighbouring_blocks(changes_of_widths(by_block.astype(float), cells.nodes))
    widths = widths / max(share, LEAST_SURFACE)
    changes = planar_changes(
        density,
        round_density,
        amplified,
        widths,
        np.pad(np.reshape(on_rings, (-1, round_density.slope.size)), ((0, 0), (0, 2))),
    )
    facets = with_changes(facets.assign(_tail_shares(bins)), changes)
    return _with_few_warning(facets, bins)


def _tail_shares(bins: MergedHistogram) -> dict[str, float]:
    """What the facets beyond the last bin are of all facets, and of their mean square slope."""
    totals = bins.totals
    return {"tail_share": float(totals[-1] / totals.sum()), "tail_contribution": bins.tail_contribution}


def _correction(observed: Array, expected: Array) -> Array:
    """Factor of a density, from its observed and expected independent facets in cells (across, along).

    Wide windows come first: they hold enough facets to show a skew or a lay that is not elliptic; in single cells the prior
    would hide it.
    """
    from scipy.ndimage import uniform_filter

    correction = np.ones_like(observed)
    for width in _WINDOWS:
        n, e = (
            width**2 * uniform_filter(values, width, mode="constant") for values in (observed, expected * correction)
        )
        correction *= (np.maximum(n, 0) + _PRIOR) / (np.maximum(e, 0) + _PRIOR)
    return correction


def _slope_scaling(moments: Moments, ellipse: Ellipse) -> Array:
    """(2, 2) matrix from counted slopes to slopes of the surface along and across the lay, over their widths.

    Of the linear maps that give the covariance of the surface, the one that changes the slopes least.
    """
    root = _power(moments.covariance, 0.5)
    correction = root @ _power(root @ moments.apparent_covariance @ root, -0.5) @ root
    cos, sin = np.cos(np.radians(ellipse.lay)), np.sin(np.radians(ellipse.lay))
    return np.array([[cos, sin], [-sin, cos]]) / [[ellipse.along], [ellipse.across]] @ correction


def _power(symmetric: Array, exponent: float) -> Array:
    values, vectors = np.linalg.eigh(symmetric)
    # Rounding of the numbers may leave a vanishing one below zero.
    values = np.maximum(values, _LARGEST_ANISOTROPY**-2 * values[-1])
    return np.asarray(vectors * values**exponent @ vectors.T)


def _cell_redundancies(by_block: Array, cells: SlopeAxis) -> Array:
    """Facets per independent facet in a cell (across, along), from all cells at the same distance from the middle."""
    distance = np.hypot(cells.nodes, cells.nodes[:, None])
    ring = np.rint(cells.position(np.minimum(distance, cells.reach))).astype(int)
    redundancy = np.ones(cells.size)
    for index in np.unique(ring):
        redundancy[index] = redundancy_of(by_block, ring.ravel() == index)
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
    nearest = np.rint(nodes.position(cells.nodes)).astype(int)
    np.add.at(result, (nearest[:, None], nearest), counts)
    return result


def _with_few_warning(facets: xr.Dataset, bins: MergedHistogram) -> xr.Dataset:
    if bins.least == MIN_PER_BIN:
        return facets
    return vocabulary.add_warning(
        facets,
        f"few independent facets: {bins.totals.sum():.0f} facets fill bins of only {bins.least} independent ones, and the relative "
        f"uncertainty of the slope density is 20 % or more; {bins.remedy}",
    )


def _with_noise_stated(facets: xr.Dataset, heights: Sequence[HeightMap], moments: Moments) -> xr.Dataset:
    added = np.mean([2 * scan.noise**2 * np.sum(1 / np.square(scan.pitch)) for scan in heights])
    noisiest = max(heights, key=lambda scan: scan.noise)
    share = float(added / np.trace(moments.apparent_covariance))
    return with_noise_stated(facets, noisiest.noise, noisiest.noise_u, share)


def _remarks(
    facets: xr.Dataset,
    maps: Sequence[xr.Dataset],
    heights: Sequence[HeightMap],
    moments: Moments,
    isotropic: bool | None,
) -> tuple[list[str], list[str]]:
    """History and warnings of the facets of maps."""
    history, warnings = [], []
    tilt = float(np.hypot(*moments.tilts.T).max())
    if tilt > 0.1 * moments.slope_rms:
        levelled = all(surface.attrs["levelling"] != "none" for surface in maps)
        unlevelled = "level the surface (`surface.form: plane`)"
        advice = "try another `surface.form`, or measure a larger area" if levelled else unlevelled
        warnings.append(
            f"a mean slope of {tilt:.2g}, {tilt / moments.slope_rms:.0%} of the slope rms, remained and was subtracted: {advice}"
        )
    widths = (pitch * size for scan in heights for pitch, size in zip(scan.pitch, scan.height.shape[::-1], strict=True))
    lengths = min(widths) / float(facets["correlation_length"])
    needed = 2 * BLOCKS
    if lengths < needed:
        # Rounded down: 15.98 is not 16.
        warnings.append(
            f"the scan is only {np.floor(10 * lengths) / 10:.1f} correlation lengths wide, fewer than {needed}, and the uncertainty from its {BLOCKS} x "
            f"{BLOCKS} blocks is understated, by 10 % at 10 lengths, 20 % at 8 and more below; measure an area that is at least "
            f"{plain(needed * float(facets['correlation_length']))} µm wide"
        )
    if np.isnan(lengths):
        warnings.append(
            "unknown correlation length: the heights along x or y stay correlated over half of the scan. Unless the lay runs in "
            "that direction, measure a larger area, or remove long waves with `surface.lambda_c`"
        )
    if isotropic is True and moments.anisotropy > LAY_LIMIT:
        history.append(
            f"declared isotropic: the anisotropy of the scan is {moments.anisotropy:.2f}, and the density was averaged over azimuth"
        )
    quantum = max(scan.quantum for scan in heights)
    if quantum:
        rms = np.sqrt(np.diag(moments.covariance))
        share = max(float(np.max(scan.quantum / np.array(scan.pitch) / rms)) for scan in heights)
        history.append(
            f"the heights are quantised in steps of {1000 * quantum:.3g} nm, a slope of up to {share:.2g} times the slope rms along x or y: "
            "they were dithered, and the mean square slope that rounding and dither add was subtracted"
        )
        if not share < _COARSE_STEPS:
            warnings.append(
                f"coarse height steps: one step, {1000 * quantum:.3g} nm, is a slope of {share:.2g} times the slope rms along x or y, and "
                "the shape of the slope density is uncertain. Export the heights with more digits, measure at a finer height "
                "resolution, or smooth them with `surface.lambda_s`"
            )
    scan_rms = moments.scan_rms
    smooth, rough = int(np.argmin(scan_rms)), int(np.argmax(scan_rms))
    # The scans may show two finishes, or one may be worn or out of focus.
    if scan_rms[rough] > _RMS_RATIO_LIMIT * scan_rms[smooth]:
        warnings.append(
            f"the slope rms differs between scans: {scan_rms[smooth]:.3g} in scan {smooth + 1}, {scan_rms[rough]:.3g} in scan {rough + 1}; "
            "the facet distribution averages both. Check that they show the same finish, or remove one from `surface.scans`"
        )
    return history, [*warnings, *noise_warning(facets)]

"""Facet distribution of height maps: one scan, or several of one surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.facets.assembly import planar_axes, planar_dataset, positive, radial_dataset, with_noise_warning
from brdfpipe.facets.counting import FacetError, counted_density, histogram, histogram_of, merged
from brdfpipe.facets.slopes import (
    BLOCKS,
    SCALES,
    Moments,
    SlopeCounts,
    correlation_length,
    count_maps,
    slope_rms_by_scale,
    triangle_slopes,
)
from brdfpipe.geometry import Array
from brdfpipe.planar import PlanarDensity, SlopeAxis

LAY_LIMIT = 1.2
"""Anisotropy above which a map that is not declared isotropic is taken to have a lay."""

_CELLS = 41
_PRIOR = 50.0


def of_maps(maps: Sequence[xr.Dataset], isotropic: bool | None) -> xr.Dataset:
    """Facet distribution of levelled maps; see :func:`brdfpipe.facets.estimate`."""
    counts, found = count_maps(maps)
    if found.facets == 0 or found.slope_rms == 0:
        raise FacetError(
            "the surface is perfectly flat or has no complete facet; check the height unit and the missing heights"
        )
    has_lay = not isotropic if isotropic is not None else not found.anisotropy <= LAY_LIMIT
    facets = _with_lay(maps, found) if has_lay else _isotropic(counts, found)
    by_scale = np.mean([slope_rms_by_scale(surface) for surface in maps], axis=0)
    facets = facets.assign(
        anisotropy=found.anisotropy,
        lay=found.lay,
        facet_count=float(found.facets),
        correlation_length=float(np.mean([correlation_length(surface) for surface in maps])),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1],
    ).assign_coords(scale=SCALES)
    levelled = all(surface.attrs["levelling"] != "none" for surface in maps)
    scans = "" if len(maps) == 1 else f", {len(maps)} scans together"
    facets.attrs |= {"method": f"four triangles a quad{scans}", "band": str(maps[0].attrs["band"])}
    return vocabulary.label(with_noise_warning(_with_warnings(facets, found, isotropic, levelled)), "facets")


def _isotropic(counts: SlopeCounts, found: Moments) -> xr.Dataset:
    bins, redundancy = merged(histogram(counts, found.slope_rms))
    density, quality, relative_u = counted_density(bins, redundancy)
    facets = radial_dataset(density, found.slope_rms)
    return facets.assign(
        count=("slope", bins.at_nodes(density.slope.size)),
        D_u=("alpha", facets["D"].values * relative_u),
        slope_density_quality=("slope", quality),
        effective_count=found.facets / redundancy,
    )


# --- a surface with a lay


def _with_lay(maps: Sequence[xr.Dataset], found: Moments) -> xr.Dataset:
    """Elliptic density of the whitened slopes, corrected by the counts in cells of the slope plane.

    The ellipse gives the tails and the cells the shape: the density is E (n + k) / (e + k), with n and e the counts found and
    expected of the ellipse E in a cell, and k the number of facets at which the two are trusted alike.
    """
    if not np.isfinite(found.anisotropy):
        raise FacetError("the surface does not vary in one direction at all; no density of slopes can be counted")
    whiten = np.linalg.inv(np.linalg.cholesky(found.covariance))
    elliptic, redundancy = _elliptic(maps, found, whiten)
    scale = np.sqrt(np.diag(found.covariance))
    reach = float(elliptic.slope[-1])
    x, y = planar_axes(scale[0], scale[1], reach)
    coarse_x, coarse_y = planar_axes(scale[0], scale[1], reach, _CELLS)
    counts = _cell_counts(maps, found.mean, coarse_x, coarse_y)
    jacobian = float(np.linalg.det(whiten))
    expected = found.facets * _cell_shares(elliptic, whiten, jacobian, coarse_x, coarse_y)
    prior = _PRIOR * redundancy
    correction = np.log((counts + prior) / (expected + prior))
    fine_correction = _refine(correction, coarse_x, coarse_y, x, y)
    base = elliptic(_whitened_square(whiten, x.nodes, y.nodes)) * jacobian
    density = PlanarDensity(x, y, positive(base * np.exp(fine_correction), 1e-18))
    density = PlanarDensity(x, y, positive(density.density / density.moments[0]))
    facets = planar_dataset(density, found.slope_rms)
    nearby = _refine(counts, coarse_x, coarse_y, x, y)
    relative_u = np.sqrt(redundancy / np.maximum(nearby, redundancy))
    return facets.assign(
        count=(("slope_y", "slope_x"), _refine_counts(counts, coarse_x, coarse_y, x, y)),
        slope_density_u=(("slope_y", "slope_x"), density.density * np.minimum(relative_u, 1.0)),
        slope_density_quality=(("slope_y", "slope_x"), _quality(nearby >= prior)),
        effective_count=found.facets / redundancy,
    )


def _elliptic(maps: Sequence[xr.Dataset], found: Moments, whiten: Array) -> tuple[RadialDensity, float]:
    """Radial density of the slopes whitened to unit covariance, and the redundancy of its counts."""

    def squares() -> Iterator[tuple[int, Array]]:
        for block, p, q in triangle_slopes(maps):
            u, v = whiten @ np.stack([p - found.mean[0], q - found.mean[1]])
            yield block, u * u + v * v

    bins, redundancy = merged(histogram_of(squares(), np.sqrt(2.0), len(maps) * BLOCKS**2))
    return counted_density(bins, redundancy)[0], redundancy


def _whitened_square(whiten: Array, p: Array, q: Array) -> Array:
    grid_p, grid_q = np.meshgrid(p, q)
    u = whiten[0, 0] * grid_p + whiten[0, 1] * grid_q
    v = whiten[1, 0] * grid_p + whiten[1, 1] * grid_q
    return np.asarray(u * u + v * v)


def _cell_counts(maps: Sequence[xr.Dataset], mean: Array, x: SlopeAxis, y: SlopeAxis) -> Array:
    """Facets in the cells about the nodes of two axes, (y, x)."""
    counts = np.zeros(x.size * y.size)
    for _, p, q in triangle_slopes(maps):
        column = np.clip(np.rint(x.position(p - mean[0])), 0, x.size - 1).astype(np.int64)
        row = np.clip(np.rint(y.position(q - mean[1])), 0, y.size - 1).astype(np.int64)
        counts += np.bincount(row * x.size + column, minlength=counts.size)
    return counts.reshape(y.size, x.size)


def _cell_shares(elliptic: RadialDensity, whiten: Array, jacobian: float, x: SlopeAxis, y: SlopeAxis) -> Array:
    """Share of the ellipse in the same cells, by a midpoint rule of 5 × 5 points a cell."""
    inside = (np.arange(5) - 2.0) / 5

    def points(axis: SlopeAxis) -> tuple[Array, Array]:
        step = 2 * axis.end / (axis.size - 1)
        t = (np.linspace(-axis.end, axis.end, axis.size)[:, None] + inside * step).ravel()
        return axis.scale * np.sinh(t), axis.scale * np.cosh(t) * step / 5

    (p, weight_p), (q, weight_q) = points(x), points(y)
    share = elliptic(_whitened_square(whiten, p, q)) * jacobian * weight_q[:, None] * weight_p
    return np.asarray(share.reshape(y.size, 5, x.size, 5).sum(axis=(1, 3)))


def _refine(values: Array, coarse_x: SlopeAxis, coarse_y: SlopeAxis, x: SlopeAxis, y: SlopeAxis) -> Array:
    """Values on coarse nodes, interpolated linearly onto fine ones."""
    from scipy.ndimage import map_coordinates

    row, column = np.meshgrid(coarse_y.position(y.nodes), coarse_x.position(x.nodes), indexing="ij")
    return np.asarray(map_coordinates(values, [row, column], order=1, mode="nearest"))


def _refine_counts(counts: Array, coarse_x: SlopeAxis, coarse_y: SlopeAxis, x: SlopeAxis, y: SlopeAxis) -> Array:
    """Counts shown on the fine nodes that coincide with coarse ones; none elsewhere, so that their sum is the number of facets."""
    result = np.zeros((y.size, x.size))
    rows = np.rint(y.position(coarse_y.nodes)).astype(int)
    columns = np.rint(x.position(coarse_x.nodes)).astype(int)
    np.add.at(result, (rows[:, None], columns), counts)
    return result


def _quality(trusted: NDArray[np.bool_]) -> NDArray[np.int8]:
    return np.where(trusted, vocabulary.quality("measured"), vocabulary.quality("extrapolated")).astype(np.int8)


def _with_warnings(facets: xr.Dataset, found: Moments, isotropic: bool | None, levelled: bool) -> xr.Dataset:
    tilt = float(np.hypot(*found.mean))
    if tilt > 0.1 * found.slope_rms:
        facets = vocabulary.add_warning(
            facets,
            f"the mean slope {tilt:.2g} is {tilt / found.slope_rms:.0%} of the slope rms: "
            + (
                "try another `surface.form`, or measure a larger area"
                if levelled
                else "level the surface (`surface.form: plane`)"
            ),
        )
    if isotropic is True and found.anisotropy > LAY_LIMIT:
        facets = vocabulary.add_history(
            facets,
            f"declared isotropic; the scan's own anisotropy is {found.anisotropy:.2f}, the density an average over azimuth",
        )
    return facets

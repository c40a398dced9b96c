"""From a measured surface to its facet distribution.

On a constant-pitch grid every facet has the same projected area, so facets are counted in slope space: the count is the
slope density P22, and D(m) = P22 / cos⁴α.

References
----------
Patent US 9,395,299 (CRF), steps a3 and b; Heitz 2014 (JCGT 3(2)); Ribardière 2019.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.facet_dataset import radial_dataset
from brdfpipe.facets.height_maps import estimate_from_maps
from brdfpipe.facets.line_profiles import METHODS, estimate_from_lines
from brdfpipe.facets.planar_density import PlanarDensity, SlopeAxis
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.facets.scan_consistency import check_consistent
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.geometry import Array


def azimuthal_average(facets: xr.Dataset) -> xr.Dataset:
    """Average a facet distribution with a lay over azimuth.

    Parameters
    ----------
    facets : kind ``facets``; an isotropic one is returned unchanged

    Returns
    -------
    Dataset of kind ``facets``, with a warning that says what was averaged
    """
    vocabulary.validate(facets, "facets")
    if "slope" in facets.dims:
        return facets
    planar = PlanarDensity.of(facets)
    steepest = float(np.hypot(planar.along.reach, planar.across.reach))
    slope = SlopeAxis(planar.along.scale / 2, steepest, 1023).nodes[511:]
    average = _ring_means(planar, slope)
    slope, average = slope[average > 0], average[average > 0]
    density = RadialDensity(slope, average)
    radial = radial_dataset(RadialDensity(slope, average / density.mass), float(facets["slope_rms"]))
    radial.attrs = {name: facets.attrs[name] for name in ("method", "band")}
    return vocabulary.label(
        vocabulary.add_warning(
            radial,
            f"the surface has a lay (anisotropy {float(facets['anisotropy']):.2f}, along {float(facets['lay']):.0f}°) and the "
            "reflection model is isotropic: its density was averaged over azimuth; set `surface.isotropic: true` to confirm",
        ),
        "facets",
    )


def _ring_means(planar: PlanarDensity, slope: Array) -> Array:
    """Mean of the density around rings of given slopes."""
    # Small slopes vary along the lay, large ones across it: points are denser across, half as much as on the ellipse.
    turn = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    x, y = np.sqrt(planar.along.scale) * np.cos(turn), np.sqrt(planar.across.scale) * np.sin(turn)
    square = x**2 + y**2
    weight = 1 / square / np.sum(1 / square)
    radius = slope[:, None] / np.sqrt(square)
    return np.asarray(planar.principal(radius * x, radius * y) @ weight)


def estimate(
    surface: xr.Dataset | Sequence[xr.Dataset], *, method: str = "mixture", isotropic: bool | None = None
) -> xr.Dataset:
    """Facet distribution of a levelled surface, with counts and uncertainty.

    Parameters
    ----------
    surface : kind ``surface``, levelled; an areal map or a line profile; or several scans of one surface, all maps or all
        lines. A line's azimuth [degree] is its attribute ``azimuth``, 0 by default
    method : how a line profile is turned into a two-dimensional density: ``mixture`` (a scale mixture of Gaussians, whose
        inversion is exact; where it does not fit, rings), ``abel`` (rings) or ``crf`` (the patent's histogram). For a
        map, the last two have no effect but a warning
    isotropic : whether the surface is isotropic. A single line must be declared isotropic. A map that is
        not declared either way has a lay if its principal slopes differ by more than a factor of 1.2

    Returns
    -------
    Dataset of kind ``facets``: radial for an isotropic surface, on a grid of slopes for one with a lay; slopes are about each
    scan's mean. ``effective_count`` is the number of facets over how many count as one in classes of equal share, on average.
    Quantised heights of a map are dithered, which the history states

    Raises
    ------
    FacetError : no scan; an unknown method; a single line that is not declared isotropic; scans that are not all maps or all lines,
        of different bandwidth, or given twice; too few independent facets; an impossible slope rms.
    VocabularyError : a dataset is not of kind ``surface``.
    """
    scans = [surface] if isinstance(surface, xr.Dataset) else list(surface)
    if not scans:
        raise FacetError("no scan of a surface given; accepted: one scan, or several of one surface")
    if method not in METHODS:
        raise FacetError(f"unknown method {method!r}; accepted: {', '.join(METHODS)}")
    for scan in scans:
        vocabulary.validate(scan, "surface")
    dimensions = {scan["height"].ndim for scan in scans}
    if len(dimensions) != 1:
        raise FacetError(
            f"scans of one surface must be all maps or all lines; found {len(scans)} scans of {sorted(dimensions)} dimensions"
        )
    check_consistent(scans)
    if dimensions == {1}:
        return estimate_from_lines(scans, method, isotropic)
    facets = estimate_from_maps(scans, isotropic)
    if method == METHODS[0]:
        return facets
    return vocabulary.add_warning(
        facets,
        f"surface.method {method} is for line profiles and was ignored: an areal map gives slopes in all directions; "
        "remove `surface.method`",
    )

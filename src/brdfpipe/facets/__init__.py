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
from brdfpipe.density import RadialDensity
from brdfpipe.facets.analytic import DISTRIBUTIONS as DISTRIBUTIONS
from brdfpipe.facets.analytic import analytic as analytic
from brdfpipe.facets.areal import of_maps
from brdfpipe.facets.assembly import radial_dataset
from brdfpipe.facets.counting import FacetError as FacetError
from brdfpipe.facets.line import METHODS as METHODS
from brdfpipe.facets.line import of_lines
from brdfpipe.planar import PlanarDensity, SlopeAxis


def azimuthal_average(facets: xr.Dataset) -> xr.Dataset:
    """The isotropic facet distribution that a surface with a lay shows when it is seen from all azimuths in turn.

    Parameters
    ----------
    facets : kind ``facets``; one that is isotropic already is returned as it is

    Returns
    -------
    Dataset of kind ``facets``, with a warning that says what was averaged
    """
    vocabulary.validate(facets, "facets")
    if "slope" in facets.dims:
        return facets
    planar = PlanarDensity.of(facets)
    reach = float(np.hypot(planar.x.reach, planar.y.reach))
    slope = SlopeAxis(min(planar.x.scale, planar.y.scale) / 2, reach, 1023).nodes[511:]
    beta = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    average = planar(slope[:, None] * np.cos(beta), slope[:, None] * np.sin(beta)).mean(axis=1)
    there = average > 0
    slope, average = slope[there], average[there]
    density = RadialDensity(slope, average)
    if abs(density.mass - 1) > 1e-3:
        raise FacetError(
            f"the density of this lay is too narrow to be averaged over azimuth (its mass comes out as {density.mass:.4f}); "
            "measure or describe a surface with less anisotropy"
        )
    radial = radial_dataset(RadialDensity(slope, average / density.mass), float(facets["slope_rms"]))
    radial.attrs = {name: facets.attrs[name] for name in ("method", "band")}
    return vocabulary.label(
        vocabulary.add_warning(
            radial,
            f"the surface has a lay (anisotropy {float(facets['anisotropy']):.2f}, along {float(facets['lay']):.0f}°) and the "
            "reflection model is isotropic: its density was averaged over azimuth; set `surface.isotropic: true` if that is wanted",
        ),
        "facets",
    )


def estimate(
    surface: xr.Dataset | Sequence[xr.Dataset], *, method: str = "mixture", isotropic: bool | None = None
) -> xr.Dataset:
    """Facet distribution of a levelled surface, with counts and uncertainty.

    Parameters
    ----------
    surface : kind ``surface``, levelled; an areal map or a line profile; or several scans of one surface, all maps or all
        lines. A line's azimuth [degree] is its attribute ``azimuth``, 0 by default
    method : how a line profile is turned into a two-dimensional density: ``mixture`` (a scale mixture of Gaussians, whose
        inversion is exact; where it does not fit, rings), ``abel`` (rings) or ``crf`` (the patent's histogram)
    isotropic : whether the surface scatters alike in every azimuth. A lone line must be declared isotropic. A map that is
        not declared either way has a lay if its principal slopes differ by more than a factor of 1.2

    Returns
    -------
    Dataset of kind ``facets``: radial for an isotropic surface, on a grid of slopes for one with a lay

    Raises
    ------
    FacetError : a lone line is not declared isotropic, scans do not belong together, or there are too few independent facets.
    VocabularyError : a dataset is not of kind ``surface``.
    """
    scans = [surface] if isinstance(surface, xr.Dataset) else list(surface)
    for scan in scans:
        vocabulary.validate(scan, "surface")
    dimensions = {scan["height"].ndim for scan in scans}
    if len(dimensions) != 1:
        raise FacetError(
            f"scans of one surface must be all maps or all lines; found {len(scans)} scans of {sorted(dimensions)} dimensions"
        )
    return of_lines(scans, method, isotropic) if dimensions == {1} else of_maps(scans, isotropic)

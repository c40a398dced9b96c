"""What a scan leaves uncertain of the facets it counted.

Each value of the density has an uncertainty, and nothing says how errors go together. Neighbouring facets lie on the same grains: classes
of slopes come out too often together. Between two values the density is no better known than at them. So three kinds of
errors are taken, each as large as is stated: of wide classes of slopes, of single values, and of what lies between them, the last
two together as large as one. Without the wide ones a factor of all slopes would seem to be known to 0.01 %, of a scan that itself
knows its slopes to 1 %.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

BETWEEN = np.sqrt(0.5)
"""Share of the uncertainty of a value that lies between it and its neighbours."""

_WIDE = 0.4
"""Width of the wide classes, in asinh of the slope over its typical one."""

_DEGREE = 4
"""Of a smooth curve through the logarithm of a density."""

_SMOOTH = 0.2
"""Width of a smooth surface through that of one with a lay, in asinh of the slopes over their scales."""


def relative_u(facets: xr.Dataset, p: Array, q: Array) -> Array:
    """Relative standard uncertainty of the density of facets.

    Parameters
    ----------
    facets : kind ``facets``
    p, q : slopes along x and y, of one shape

    Returns
    -------
    The same shape [1], at most 1; 0 of an assumed finish, which has none
    """
    if "slope_density_u" in facets:
        relative = facets["slope_density_u"] / facets["slope_density"]
        found = relative.interp(
            _at(facets, dict(zip(("slope_along", "slope_across"), _turned(facets, p, q), strict=True)))
        )
    elif "D_u" in facets:
        relative = facets["D_u"] / facets["D"].where(facets["D"] > 0)
        found = relative.interp(_at(facets, {"alpha": np.degrees(np.arctan(np.hypot(p, q)))}))
    else:
        return np.zeros_like(p)
    return np.asarray(np.minimum(found.fillna(1.0).values, 1.0))


def _at(facets: xr.Dataset, places: dict[str, Array]) -> dict[str, xr.DataArray]:
    """Places as xarray wants them, not beyond the ends of the tables."""
    dims = [f"axis_{axis}" for axis in range(next(iter(places.values())).ndim)]
    ends = {name: facets[name].values[[0, -1]] for name in places}
    return {name: xr.DataArray(np.clip(place, *ends[name]), dims=dims) for name, place in places.items()}


def _turned(facets: xr.Dataset, p: Array, q: Array) -> tuple[Array, Array]:
    """Slopes along the lay and across it."""
    lay = np.radians(float(facets["lay"]))
    return p * np.cos(lay) + q * np.sin(lay), q * np.cos(lay) - p * np.sin(lay)


def errors(facets: xr.Dataset, p: Array, q: Array) -> Array:
    """Shares (error, …) of facets in the errors that many of them have in common, in their standard uncertainty; arguments as above."""
    if not {"D_u", "slope_density_u"} & set(facets.variables):
        return np.zeros((0, *p.shape))
    surface = Microsurface.of(facets).density
    if isinstance(surface, PlanarDensity):
        along, across = _turned(facets, p, q)
        slope, values = np.hypot(along / surface.along.scale, across / surface.across.scale), surface.along.nodes
        values = values[values >= 0] / surface.along.scale
    else:
        slope, values = np.hypot(p, q) / surface.median_slope, surface.slope / surface.median_slope
    place, values = np.arcsinh(slope), np.arcsinh(values)
    wide = np.arange(0.0, values[-1] + _WIDE, _WIDE)
    return np.concatenate([np.sqrt(1 - BETWEEN**2) * _hats(place, values), _hats(place, wide)])


def _hats(place: Array, nodes: Array) -> Array:
    """Shares (node, …) of places between nodes, that of two neighbours each."""
    return np.array([np.interp(place, nodes, hat) for hat in np.eye(nodes.size)])


def smooth(facets: xr.Dataset) -> xr.Dataset:
    """Facets of which the density has no bends within its uncertainty; an assumed finish stays as it is.

    A factor of the slopes moves each bend of the density. Bends that are chance would tell of the factor what is not known.
    """
    if not {"D_u", "slope_density_u"} & set(facets.variables):
        return facets
    density = Microsurface.of(facets).density
    log_density = _smooth_surface(density) if isinstance(density, PlanarDensity) else _smooth_curve(density, facets)
    return facets.assign(slope_density=facets["slope_density"].copy(data=np.exp(log_density)))


def _smooth_curve(density: RadialDensity, facets: xr.Dataset) -> Array:
    place = np.log1p((density.slope / density.median_slope) ** 2)
    weight = facets["D"].values / np.maximum(facets["D_u"].values, 1e-12 * facets["D"].values)
    return np.asarray(np.polynomial.Polynomial.fit(place, np.log(density.density), _DEGREE, w=weight)(place))


def _smooth_surface(density: PlanarDensity) -> Array:
    from scipy.ndimage import gaussian_filter

    widths = [_SMOOTH * (axis.size - 1) / (2 * axis.end) for axis in (density.across, density.along)]
    return np.asarray(gaussian_filter(np.log(density.density), widths, mode="nearest"))

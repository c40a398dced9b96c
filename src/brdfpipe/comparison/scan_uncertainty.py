"""The uncertainty of a facet density from a scan, and the correlation of its errors.

The values of the density have uncertainties of unknown correlation. Neighbouring facets are on the same grains, so whole classes of slopes err
together. Assumed are errors of wide classes of slopes, and errors of single values and between values, both kinds as large as stated.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

BETWEEN = np.sqrt(0.5)
"""Share of the uncertainty of a value that is an error between it and its neighbours."""

_CLASS_WIDTH = 0.4  # width of the wide classes, in asinh of the slope over its typical one
_DEGREE = 4  # degree of the polynomial that smooths the logarithm of a density
_SMOOTHING = 0.2  # standard deviation of a Gaussian for a density with a lay, in asinh of slopes over their scales


def relative_u(facets: xr.Dataset, p: Array, q: Array) -> Array:
    """Relative standard uncertainty of the density of facets.

    Parameters
    ----------
    facets : kind ``facets``
    p, q : slopes along x and y, of one shape

    Returns
    -------
    The same shape [1], at most 1; 0 for an assumed finish, which has no uncertainty
    """
    if "slope_density_u" in facets:
        relative = facets["slope_density_u"] / facets["slope_density"]
        positions = dict(zip(("slope_along", "slope_across"), _along_and_across(facets, p, q), strict=True))
    elif "D_u" in facets:
        relative = facets["D_u"] / facets["D"].where(facets["D"] > 0)
        positions = {"alpha": np.degrees(np.arctan(np.hypot(p, q)))}
    else:
        return np.zeros_like(p)
    dims = [f"axis_{axis}" for axis in range(p.ndim)]
    ends = {name: facets[name].values[[0, -1]] for name in positions}
    at = {name: xr.DataArray(np.clip(position, *ends[name]), dims=dims) for name, position in positions.items()}
    return np.asarray(np.minimum(relative.interp(at).fillna(1.0).values, 1.0))


def _along_and_across(facets: xr.Dataset, p: Array, q: Array) -> tuple[Array, Array]:
    """Slopes along the lay and across it."""
    lay = np.radians(float(facets["lay"]))
    return p * np.cos(lay) + q * np.sin(lay), q * np.cos(lay) - p * np.sin(lay)


def errors(facets: xr.Dataset, p: Array, q: Array) -> Array:
    """Share (error, …) of each common error in the standard uncertainty of facets; arguments as for :func:`relative_u`."""
    if not {"D_u", "slope_density_u"} & set(facets.variables):
        return np.zeros((0, *p.shape))
    density = Microsurface.of(facets).density
    if isinstance(density, PlanarDensity):
        along, across = _along_and_across(facets, p, q)
        slope, nodes = np.hypot(along / density.along.scale, across / density.across.scale), density.along.nodes
        nodes = nodes[nodes >= 0] / density.along.scale
    else:
        slope, nodes = np.hypot(p, q) / density.median_slope, density.slope / density.median_slope
    x, nodes = np.arcsinh(slope), np.arcsinh(nodes)
    classes = np.arange(0.0, nodes[-1] + _CLASS_WIDTH, _CLASS_WIDTH)
    return np.concatenate([np.sqrt(1 - BETWEEN**2) * _hat_functions(x, nodes), _hat_functions(x, classes)])


def _hat_functions(x: Array, nodes: Array) -> Array:
    """Hat functions (node, …) at x, for linear interpolation between nodes."""
    return np.array([np.interp(x, nodes, hat) for hat in np.eye(nodes.size)])


def smooth(facets: xr.Dataset) -> xr.Dataset:
    """Facets with a smooth density; an assumed finish is returned unchanged.

    Random bends of the density would be mistaken for information on a factor of the slopes.
    """
    if not {"D_u", "slope_density_u"} & set(facets.variables):
        return facets
    density = Microsurface.of(facets).density
    log_density = _smooth_surface(density) if isinstance(density, PlanarDensity) else _smooth_curve(density, facets)
    return facets.assign(slope_density=facets["slope_density"].copy(data=np.exp(log_density)))


def _smooth_curve(density: RadialDensity, facets: xr.Dataset) -> Array:
    x = np.log1p((density.slope / density.median_slope) ** 2)
    weight = facets["D"].values / np.maximum(facets["D_u"].values, 1e-12 * facets["D"].values)
    return np.asarray(np.polynomial.Polynomial.fit(x, np.log(density.density), _DEGREE, w=weight)(x))


def _smooth_surface(density: PlanarDensity) -> Array:
    from scipy.ndimage import gaussian_filter

    widths = [_SMOOTHING * (axis.size - 1) / (2 * axis.end) for axis in (density.across, density.along)]
    return np.asarray(gaussian_filter(np.log(density.density), widths, mode="nearest"))

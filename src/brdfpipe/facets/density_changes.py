"""Uncertainty of a slope density as a few changes of it, each common to all slopes and independent of the others.

The counts of neighbouring facets are correlated, and so are those of all slopes: facets are shares of one whole, and a grain that is
steeper than the others has more steep facets and fewer gentle ones. A standard uncertainty of each value cannot tell that. A change of
one standard uncertainty in each independent way can: the variance of anything that depends on the density is the sum of the squares of what the
changes make of it.

References
----------
JCGM 102:2011 (covariance of several quantities); Golub & Van Loan 2013, *Matrix Computations*, 5.2 (QR factorisation).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

CHANGES = "slope_density_change"
"""Variable of a dataset of facets: P22 after a change by one standard uncertainty, less P22, for each change."""

_CLASSES = 6
"""Classes of slopes, evenly spaced in asinh of the slope over its median, whose shares have the whole variance of the samples."""
_NEGLIGIBLE = 1e-3
"""Standard deviation, over the largest, below which a change is left out."""
_LARGEST = 3.0
"""Largest logarithm of a changed density over the density: what is more uncertain is unknown."""


def principal_changes(by_sample: Array, weights: Array) -> Array:
    """A few changes (changes, nodes) in place of many samples, with the whole variance of some sums over the nodes.

    Parameters
    ----------
    by_sample : (nodes, samples) whose sum of products over the samples is the covariance of the nodes
    weights : (sums, nodes); the first change has all that goes along with the first sum, the second what is left of the second, and so on

    Notes
    -----
    An orthonormal basis of the sums in the space of the samples: the variance of any combination of the sums is kept, and of other
    quantities that part which goes along with them.
    """
    basis, triangle = np.linalg.qr((weights @ by_sample).T)
    sizes = np.diag(triangle)
    kept = np.abs(sizes) > _NEGLIGIBLE * np.abs(sizes).max(initial=0.0)
    # The sign is arbitrary: each change increases its sum.
    return np.asarray((by_sample @ (basis * np.sign(sizes))[:, kept]).T)


def radial_changes(density: RadialDensity, by_sample: Array) -> Array:
    """Changed densities (changes, nodes) less a radial one, from logarithmic changes (nodes, samples) of its nodes.

    The sums whose variance is kept are the mean square slope, the density of level facets, and the shares of classes of slopes.
    """
    slope = density.slope
    edges = np.concatenate([[0.0], (slope[1:] + slope[:-1]) / 2, slope[-1:]])
    share = density.density * np.diff(edges**2)
    position = np.arcsinh(slope / density.median_slope)
    steepest = float(np.interp(0.999, np.cumsum(share) / share.sum(), position))
    classes = np.linspace(0.0, steepest, _CLASSES)
    hats = np.array([np.interp(position, classes, hat) for hat in np.eye(_CLASSES)])
    weights = np.vstack([share * slope**2 / (share @ slope**2), np.arange(slope.size) == 0, hats * share / share.sum()])
    return changed(density, principal_changes(by_sample, weights))


def changed(density: RadialDensity, logarithmic: Array) -> Array:
    """Normalised densities after logarithmic changes (changes, nodes) less the density itself."""
    factors = np.exp(np.clip(logarithmic, -_LARGEST, _LARGEST))
    one = density.density
    return np.array(
        [RadialDensity(density.slope, one * factor).normalised().density - one for factor in factors]
    ).reshape(-1, one.size)


def with_changes(facets: xr.Dataset, changes: Mapping[str, Array]) -> xr.Dataset:
    """Facets with the changes of their density by source, (changes, nodes…) each."""
    sources = [source for source, values in changes.items() for _ in range(len(values))]
    if not sources:
        return facets
    dims = ("uncertain_change", *facets["slope_density"].dims)
    values = np.concatenate([one for one in changes.values() if len(one)])
    return facets.assign({CHANGES: (dims, values)}).assign_coords(uncertainty_source=("uncertain_change", sources))

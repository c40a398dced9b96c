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

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity, masses
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
    return changed(density, principal_changes(by_sample, _sums(density)))


def _sums(density: RadialDensity) -> Array:
    """Weights (sums, nodes) of the sums whose variance is kept."""
    slope = density.slope
    edges = np.concatenate([[0.0], (slope[1:] + slope[:-1]) / 2, slope[-1:]])
    share = density.density * np.diff(edges**2)
    position = np.arcsinh(slope / density.median_slope)
    steepest = float(np.interp(0.999, np.cumsum(share) / share.sum(), position))
    classes = np.linspace(0.0, steepest, _CLASSES)
    hats = np.array([np.interp(position, classes, hat) for hat in np.eye(_CLASSES)])
    return np.vstack([share * slope**2 / (share @ slope**2), np.arange(slope.size) == 0, hats * share / share.sum()])


def planar_changes(
    density: PlanarDensity, ring: RadialDensity, by_sample: Array, anisotropy: Array, noise: Array
) -> dict[str, Array]:
    """Changes (changes, across, along) of a density with a lay by source, from those of its rings and of its two widths.

    Parameters
    ----------
    density : the density
    ring : that of the slopes over their widths
    by_sample : (nodes of the rings, samples) logarithmic changes of the rings
    anisotropy : (2, samples) relative change of the width along the lay less that across it, and turn of the lay, as
        :func:`changes_of_widths` gives them
    noise : (changes, nodes of the rings + 2) logarithmic changes of the rings, and the changes of the widths, by noise
    """
    weights = _sums(ring)
    weights = np.block([[weights, np.zeros((len(weights), 2))], [np.zeros((2, weights.shape[1])), np.eye(2)]])
    principal = principal_changes(np.vstack([by_sample, anisotropy]), weights)
    x, y = density.along.nodes / density.along.scale, density.across.nodes[:, None] / density.across.scale
    distance = np.hypot(x, y)
    fall = -np.gradient(np.log(ring.density), ring.slope**2)
    fall = np.interp(distance, ring.slope, fall)

    def of_plane(rings: Array, widths: Array) -> Array:
        log_change = np.interp(distance, ring.slope, rings)
        return np.asarray(log_change + fall * (widths[0] * (x**2 - y**2) + widths[1] * 2 * x * y))

    changes = {
        "facets": [of_plane(one[:-2], one[-2:]) for one in principal],
        "noise": [of_plane(one[:-2], one[-2:]) for one in noise],
    }
    return {source: _changed_planar(density, values) for source, values in changes.items()}


def changes_of_widths(by_block: Array, nodes: Array) -> Array:
    """Relative change of the widths of the slopes over them, along less across, and of their correlation, by each block.

    Parameters
    ----------
    by_block : (blocks, across, along) facets in cells of the slopes over their widths
    nodes : (along,) slopes in the middle of the cells

    Returns
    -------
    (2, blocks) whose products add up to the covariance of both
    """
    x, y = nodes, nodes[:, None]
    total = float((by_block.sum(axis=0) * (x**2 + y**2)).sum())
    parts = np.array([(by_block * (x**2 - y**2)).sum(axis=(1, 2)), (by_block * (2 * x * y)).sum(axis=(1, 2))])
    facets = by_block.sum(axis=(1, 2))
    used = max(int(np.count_nonzero(facets)), 2)
    share = facets / max(float(facets.sum()), 1.0)
    return np.asarray((parts - share * parts.sum(axis=1, keepdims=True)) / total * np.sqrt(used / (used - 1)))


def _changed_planar(density: PlanarDensity, logarithmic: Sequence[Array]) -> Array:
    after = [density.density * np.exp(np.clip(one, -_LARGEST, _LARGEST)) for one in logarithmic]
    normalised = [one / replace(density, density=one).moments[0] for one in after]
    return np.array([one - density.density for one in normalised]).reshape(-1, *density.density.shape)


def narrowing(density: RadialDensity, relative: float) -> Array:
    """Logarithmic change of a density (nodes,) as its mean square slope becomes smaller by a ``relative`` share, of the same shape."""
    square = density.slope**2
    fall = -np.gradient(np.log(density.density), square)
    return np.asarray(-relative * (square * fall - 1))


def changed(density: RadialDensity, logarithmic: Array) -> Array:
    """Normalised densities after logarithmic changes (changes, nodes) less the density itself."""
    after = density.density * np.exp(np.clip(logarithmic, -_LARGEST, _LARGEST))
    return np.asarray(after / masses(density.slope, after)[:, None] - density.density)


def with_changes(facets: xr.Dataset, changes: Mapping[str, Array]) -> xr.Dataset:
    """Facets with the changes of their density by source, (changes, nodes…) each."""
    sources = [source for source, values in changes.items() for _ in range(len(values))]
    if not sources:
        return facets
    dims = ("uncertain_change", *facets["slope_density"].dims)
    values = np.concatenate([one for one in changes.values() if len(one)])
    return facets.assign({CHANGES: (dims, values)}).assign_coords(uncertainty_source=("uncertain_change", sources))

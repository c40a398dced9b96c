"""Remove the noise of heights from a radial slope density, however large its share.

White height noise adds an independent Gaussian to each slope, of a known mean square m along each axis. The two components of a
triangle share a height, so their noise is correlated by ±1/2. Over all azimuths that is a mixture of isotropic Gaussians of mean squares m(1 +
e cos t), t even in [0, π], with e half the difference of the principal mean squares over m: 1/2 for square cells. The density without it is a set of
rings whose slopes, with the noise, are spread as the counts are: found by the iteration of Richardson and Lucy, which maximises the
likelihood and keeps densities positive. It starts from the counted density, narrowed uniformly, and stops before it follows the scatter of the
counts. So a Gaussian stays one, and details come back as far as the counts tell. Each bin then moves to the slopes that hold
the same share of the facets without noise as it does with it: its counts and their uncertainty stay.

References
----------
Richardson 1972, J. Opt. Soc. Am. 62, 55; Lucy 1974, Astron. J. 79, 745.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.line_inversion import accelerated_em_step
from brdfpipe.facets.slope_histogram import MergedHistogram, redundancy_of
from brdfpipe.geometry import Array
from brdfpipe.psd.noise_floor import noise_in_words

LEAST_SURFACE = 0.05
"""Least share of the mean square slope that is left to the surface."""
_MIN_GAIN = 0.03
"""Gain of log-likelihood per redundant facet below which the iteration stops, as in the fit of lines."""
_ROUNDS, _STEPS = 60, 4
_UNCERTAIN = 0.05
"""Relative uncertainty of the slope rms from the noise above which a warning is given."""
_GAUSSIANS = 4
_NARROWEST = 0.2
"""Smallest width of a bin, over that of a uniform narrowing."""
_FAR = 500.0
"""Squared slope over the mean square of the noise beyond which a ring is straight."""
_TAIL = -np.log(1 - (np.arange(4) + 0.5) / 4)
"""Quantiles of an exponential tail, over its length."""


def with_noise_stated(facets: xr.Dataset, noise: float, noise_u: float, share: float) -> xr.Dataset:
    """Facets with the noise that was removed: its rms and standard uncertainty [um], and its ``share`` of the mean square slope.

    Unchanged without noise.
    """
    if not noise:
        return facets
    relative_u = share / max(1 - share, 1e-3) * noise_u / noise
    text = f"white height noise of {noise_in_words(noise, noise_u)}, {share:.0%} of the mean square slope"
    facets = facets.assign(noise_sigma=noise, noise_sigma_u=noise_u)
    effect = f"uncertain by {relative_u:.1%} on its account" if noise_u else "taken as if the noise were exact"
    facets = vocabulary.add_history(facets, f"{text}, was subtracted: the slope rms is {effect}")
    if relative_u <= _UNCERTAIN:
        return facets
    return vocabulary.add_warning(
        facets,
        f"noise: {text}, was subtracted, and the slope rms is uncertain by {relative_u:.0%} on its account; measure with more averaging, at a larger "
        "pitch, or smooth the heights with `surface.lambda_s`",
    )


def without_noise(binned: MergedHistogram, mean_square: float, pitch: tuple[float, float]) -> MergedHistogram:
    """The histogram of the slopes without the noise of triangles of a ``pitch``, of a ``mean_square`` along an axis, mean of both."""
    totals, edges = binned.totals, binned.edges
    typical = np.append((edges[1:] ** 2 + edges[:-1] ** 2) / 2, (edges[-1] + binned.tail_excess) ** 2)
    apparent = float(totals @ typical) / totals.sum() / 2
    narrowing = np.sqrt(max(1 - mean_square / apparent, LEAST_SURFACE))
    rings = narrowing * edges
    mean_squares = mean_square * (1 + _eccentricity(pitch) * np.cos(np.pi * (np.arange(_GAUSSIANS) + 0.5) / _GAUSSIANS))
    spreads = [_spread(rings, narrowing * binned.tail_excess, edges, value) for value in mean_squares]
    spread = np.mean(spreads, axis=0)
    share = np.diff(spread, axis=0, append=1.0)
    start = np.maximum(totals, 1e-3)[None] / totals.sum()
    weight = start
    redundancy, likelihood = redundancy_of(binned.counts), -np.inf
    for _ in range(_ROUNDS):
        for _ in range(_STEPS):
            weight = start * np.exp(_smoothed(np.log(accelerated_em_step(weight, share, totals[None]) / start)))
        former, likelihood = likelihood, float(totals @ np.log(np.maximum(share @ weight[0], 1e-300)))
        if likelihood - former < _MIN_GAIN * redundancy:
            break
    moved = _slopes_beyond_which(1 - spread @ weight[0], rings, narrowing * binned.tail_excess, weight[0])
    # Noise only widens.
    moved = np.minimum(moved, edges)
    widths = np.maximum(np.diff(moved), _NARROWEST * narrowing * np.diff(edges))
    moved = np.concatenate([[0.0], np.cumsum(widths)])
    return binned._replace(edges=moved, tail_excess=narrowing * binned.tail_excess)


def _eccentricity(pitch: tuple[float, float]) -> float:
    """Half the difference of the principal mean squares of the noise of a triangle, over their mean."""
    x, y = 2 / pitch[0] ** 2, 2 / pitch[1] ** 2
    return float(np.hypot((x - y) / 2, 1 / (pitch[0] * pitch[1])) * 2 / (x + y))


def _smoothed(values: Array) -> Array:
    """Means of neighbouring rings, of weights 1, 2, 1: without them the iteration rings where the density ends."""
    padded = np.pad(values, ((0, 0), (1, 1)), mode="edge")
    return np.asarray((padded[:, :-2] + 2 * values + padded[:, 2:]) / 4)


def _spread(rings: Array, excess: float, edges: Array, mean_square: float) -> Array:
    """(edges, rings and tail) share of each ring of slopes, and of the tail beyond, that noise leaves within an edge."""
    from scipy.special import chndtr, ndtr

    squares, widths = rings[:-1] ** 2, np.diff(rings**2)
    # A ring is filled evenly by area.
    radii = np.sqrt(squares[:, None] + widths[:, None] * (np.arange(4) + 0.5) / 4)
    radii = np.concatenate([radii, rings[-1] + excess * _TAIL[None]])
    far = radii**2 > _FAR * mean_square
    ends = edges[:, None, None]
    near = chndtr(ends**2 / mean_square, 2, np.where(far, 0.0, radii**2 / mean_square))
    # Sideways noise adds m/2s to a steep slope s.
    straight = ndtr((ends - radii - mean_square / (2 * np.maximum(radii, 1e-300))) / np.sqrt(mean_square))
    return np.asarray(np.where(far, straight, near).mean(axis=2))


def _slopes_beyond_which(share: Array, rings: Array, excess: float, weight: Array) -> Array:
    """Slopes that have given shares of steeper facets, of rings with an exponential tail of mean ``excess`` beyond them."""
    steeper = np.cumsum(weight[::-1])[::-1] / weight.sum()
    depth = -np.log(np.maximum(np.append(steeper[0], steeper[1:]), 1e-300))
    wanted = -np.log(np.maximum(share, 1e-300))
    inside = np.sqrt(np.interp(wanted, depth, rings**2))
    return np.asarray(np.where(wanted > depth[-1], rings[-1] + excess * (wanted - depth[-1]), inside))

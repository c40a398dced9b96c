"""Invert the slopes along a line, a marginal, to a radial slope density: three methods, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from brdfpipe.facets.line_slope_counts import LineSlopeCounts
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array

_COMPONENTS = 24
_NODES = 384
_RINGS = 64

_START_SPREAD = 0.3
"""Spread of the logarithm of the widths at the start of the fit: broad enough for heavy tails, narrow enough for a Gaussian."""

_MIN_GAIN = 0.03
"""Gain of log-likelihood per independent slope below which the iteration stops."""

_ROUNDS, _LONGEST_STEP = 60, 32.0
_LONGER_AFTER = 24
"""Rounds after which the longest step doubles from round to round: counts that tell so much are gained from slowly.

Not where rounding or noise blurs them: there the last gains follow their scatter.
"""


class RadialEstimate(NamedTuple):
    """Slope density of an isotropic surface, from a line on it."""

    density: RadialDensity
    slope_rms: float
    relative_u: Array
    """Relative standard uncertainty on the nodes of the density, at most 1."""
    half_changes: Array
    """(nodes, halves) changes of ln P22 by the half-samples: their products add up to its covariance."""


def _relative_uncertainty(slope: Array, densities: Array) -> Array:
    """Relative standard uncertainty of the first of several densities (1 + halves, slope), from the scatter of the half-samples; at most 1.

    If the width of a nearly Gaussian density is wrong, small slopes are too rare and large ones too frequent. Between them the
    half-samples agree by accident, so the mean square is taken over slopes within a factor of 1.35.
    """
    square = np.mean((ratio_of(densities[1:], densities[0]) - 1) ** 2, axis=0)
    total = np.concatenate([[0.0], np.cumsum(square)])
    low, high = np.searchsorted(slope, slope / 1.35), np.searchsorted(slope, slope * 1.35, side="right")
    return np.minimum(1.0, np.sqrt(np.maximum(total[high] - total[low], 0) / (high - low)))


def _half_changes(densities: Array) -> Array:
    """Logarithms of the densities of half-samples over the first of several densities (1 + halves, slope), (slope, halves)."""
    ratio = ratio_of(densities[1:], densities[0])
    return np.log(np.maximum(ratio, 1e-6)).T / np.sqrt(max(len(ratio), 1))


def ratio_of(density: Array, reference: Array) -> Array:
    """Density over a reference, at most 1e6."""
    return np.asarray(np.minimum(density / np.maximum(reference, 1e-290), 1e6))


class Mixture(NamedTuple):
    """P1(p) = Σ w_k N(0, σ_k²)."""

    weights: Array
    """(1 + halves, components): of all slopes first, then of halves of the stretches."""
    sigma: Array
    misfit: float
    """Reduced χ²."""

    @property
    def widest(self) -> float:
        return float(self.sigma[self.weights[0] > 1e-9].max())

    def density(self, square: Array, half: int | slice = 0) -> Array:
        """P22 = Σ w_k N₂(0, σ_k² I) at squared slopes (...), of all slopes or of a half; (..., halves) of a slice of them."""
        variance = self.sigma**2
        kernel = np.exp(-np.minimum(square[..., None] / (2 * variance), 700.0)) / (2 * np.pi * variance)
        return np.asarray(kernel @ self.weights[half].T)


def fit_mixture(marginals: Sequence[LineSlopeCounts]) -> Mixture:
    """Fit P1(p) = Σ w_k N(0, σ_k²), w >= 0, to one or several marginals, by expectation maximisation on binned |p|.

    The inversion to two dimensions divides each weight by σ_k², so a small weight of narrow components would distort the peak.
    Therefore the components start at half the median slope, the weights start around a single component, and the iteration
    stops when 24 more steps gain no significant likelihood.
    """
    from scipy.special import erf

    size = sum(marginal.size for marginal in marginals)
    median = sum(marginal.median * marginal.narrowing * marginal.size for marginal in marginals) / size
    rms = float(np.sqrt(sum(marginal.rms**2 * marginal.size for marginal in marginals) / size))
    quantum, steepest = max(m.quantum for m in marginals), max(m.steepest for m in marginals)
    low = max(median / 2, rms / 50, quantum / 4)
    sigma = np.geomspace(low, max(steepest / 2, 2 * rms), _COMPONENTS)

    def within(slopes: Array) -> Array:
        return np.asarray(erf(slopes[..., None] / (np.sqrt(2) * sigma)))

    parts = [marginal.shares(within) * (marginal.size / size) for marginal in marginals]
    share, counts = np.concatenate(parts), np.concatenate([marginal.halves() for marginal in marginals], axis=1)
    redundancy = max(marginal.redundancy for marginal in marginals)
    # Under noise the counts tell little of the spread, and a Gaussian is the least that may be assumed.
    narrowing = min(marginal.narrowing for marginal in marginals)
    spread = max(_START_SPREAD * narrowing**2, float(np.log(sigma[1] / sigma[0])))
    least_gain = _MIN_GAIN * redundancy / narrowing**8
    start = np.exp(-0.5 * (np.log(sigma / max(median / 0.6745, low)) / spread) ** 2)
    weights = np.tile(start / start.sum(), (counts.shape[0], 1))
    likelihood, blurred = -np.inf, any(marginal.blur.any() for marginal in marginals)
    for number in range(_ROUNDS):
        longest = _LONGEST_STEP * (1.0 if blurred else 2.0 ** max(0, number + 1 - _LONGER_AFTER))
        for _ in range(8):
            weights = accelerated_em_step(weights, share, counts, longest)
        expected = weights[0] @ share.T
        former, likelihood = likelihood, float(counts[0] @ np.log(np.maximum(expected, 1e-300)))
        if 0 <= likelihood - former < least_gain:
            break
    return Mixture(weights, sigma, misfit(counts[0], size * expected, redundancy))


def accelerated_em_step(weights: Array, share: Array, counts: Array, longest: float = _LONGEST_STEP) -> Array:
    """Three steps of expectation maximisation (sets, components), with an extrapolation of the logarithms of the first two, ``longest`` times as far at most.

    Source: Varadhan and Roland 2008, Scand. J. Stat. 35, 335: squared extrapolation.
    """

    def maximised(weights: Array) -> Array:
        ratio = weights @ share.T
        np.divide(counts, np.maximum(ratio, 1e-300, out=ratio), out=ratio)
        result: Array = ratio @ share
        result *= weights
        result += 1e-300
        result /= np.add.reduce(result, axis=1, keepdims=True)
        return result

    first = maximised(weights)
    second = maximised(first)
    step = np.log(first / weights)
    curvature = np.log(second / first) - step
    # Components of small weight must not determine the length of the extrapolation.
    size, change = (np.add.reduce((second * rate) ** 2, axis=1, keepdims=True) for rate in (step, curvature))
    length = np.minimum(np.maximum(np.sqrt(size / np.maximum(change, 1e-300)), 1), longest)
    step *= 2 * length
    curvature *= length**2
    step += curvature
    return maximised(weights * np.exp(np.minimum(np.maximum(step, -600, out=step), 30, out=step)))


def estimate_from_mixture(marginal: LineSlopeCounts, fit: Mixture) -> RadialEstimate:
    """Radial density of a mixture: the same weights, in two dimensions."""
    scale = float(np.sqrt(2 * fit.weights[0] @ fit.sigma**2))
    slope = scale * np.sinh(np.linspace(0, np.arcsinh(8.3 * fit.widest / scale), _NODES))
    densities = fit.density(slope**2, slice(None)).T
    return RadialEstimate(
        RadialDensity(slope, densities[0]),
        marginal.slope_rms,
        _relative_uncertainty(slope, densities),
        _half_changes(densities),
    )


def misfit(counts: Array, expected: Array, redundancy: float) -> float:
    """Reduced χ² over bins merged to 25 independent slopes each."""
    group = np.floor(np.cumsum(expected) / (25 * redundancy))
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    observed, expected_sums = np.add.reduceat(counts, starts), np.add.reduceat(expected, starts)
    deviation = (observed - expected_sums) ** 2 / np.maximum(expected_sums, 1e-300)
    return float(deviation.sum()) / redundancy / max(1, starts.size - 1)


def estimate_from_rings(marginal: LineSlopeCounts, fit: Mixture) -> RadialEstimate | None:
    """Regularised Abel inversion: non-negative rings, as smooth as a reduced χ² of 1 allows.

    Returns None if the rings do not reproduce the mean slope along the line within 5 %, as for slopes of few distinct values.
    """
    from scipy.optimize import nnls

    counts, size, redundancy = marginal.counts, marginal.size, marginal.redundancy
    rings = marginal.rms * np.sinh(np.linspace(0, np.arcsinh(marginal.steepest / marginal.rms), _RINGS + 1))
    area = np.pi * np.diff(rings**2)
    share = np.diff(marginal.shares(lambda slopes: _disc_below(slopes, rings)), axis=1) / area
    root = 1 / np.sqrt(np.maximum(counts / size, 1 / size) * redundancy / size)
    middle = np.sqrt((rings[1:] ** 2 + rings[:-1] ** 2) / 2)
    # Smoothness is that of the ratio to the fitted mixture, which has the right tails.
    mixtures = np.maximum(fit.density(middle**2, slice(None)).T, 1e-9 * fit.density(np.zeros(1)))

    def rings_of(counts: Array, mixture: Array, strength: float) -> Array:
        smoothness = strength * np.diff(np.eye(_RINGS), 2, axis=0) / (area * mixture)
        target = np.concatenate([root * counts / counts.sum(), np.zeros(_RINGS - 2)])
        return np.asarray(nnls(np.concatenate([root[:, None] * share, smoothness]), target, maxiter=50 * _RINGS)[0])

    strengths = 10.0 ** np.arange(4.0, -4.5, -0.5)
    misfits = [misfit(counts, size * (share @ rings_of(counts, mixtures[0], trial)), redundancy) for trial in strengths]
    # The strongest smoothing whose misfit is not significantly worse than the best.
    strength = float(strengths[np.flatnonzero(np.array(misfits) <= max(1.0, min(misfits) + 0.2))[0]])
    halves = zip(marginal.halves(), mixtures, strict=True)
    weights = np.array([rings_of(half, mixture, strength) for half, mixture in halves])
    heights = weights / weights.sum(axis=1, keepdims=True) / area
    slope = np.concatenate([[0.0], middle, rings[-1:]])
    values = np.concatenate([heights[:, :1], heights, heights[:, -1:]], axis=1)
    density = RadialDensity(slope, np.maximum(values[0], 1e-12 * heights[0].max())).normalised()
    s, weight = density.rule()
    # Interpolation between rings must keep their mean slope, and the rings that along the line. Unlike the mean square, it is
    # insensitive to the tail.
    mean_of_rings = 2 * np.pi / 3 * float(np.diff(rings**3) @ heights[0])
    along = marginal.middles
    mean_along = float(along @ share @ (area * heights[0]))
    if abs(float(weight @ s) / mean_of_rings * mean_along / float(along @ counts / size) - 1) > 0.05:
        return None
    return RadialEstimate(density, marginal.slope_rms, _relative_uncertainty(slope, values), _half_changes(values))


def _disc_below(p: Array, radius: Array) -> Array:
    """Area (p..., radius) of the part |t| < p of a disc: the integral of 2 √(r² − t²), odd in p."""
    inside = np.clip(p[..., None], -radius, radius)
    ratio = np.divide(inside, radius, out=np.zeros_like(inside), where=radius > 0)
    return np.asarray(2 * inside * np.sqrt(np.maximum(radius**2 - inside**2, 0)) + 2 * radius**2 * np.arcsin(ratio))


def estimate_from_patent(marginal: LineSlopeCounts) -> RadialEstimate:
    """Use the histogram of α = arctan|p| as D, renormalised: P22 = P1(s) / (1 + s²) up to a constant.

    Patent US 9,395,299, step b, simplified mode.
    """
    least = 25 * marginal.redundancy
    cuts = [0]
    cumulative = np.concatenate([[0.0], np.cumsum(marginal.counts)])
    for cut in range(1, cumulative.size):
        if cumulative[cut] - cumulative[cuts[-1]] >= least:
            cuts.append(cut)
    # Bins of lines of different quantum overlap: each is as wide as its share of the slopes.
    widths = np.diff(marginal.bins, axis=1)[:, 0] * marginal.share

    def merged(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values[..., : cuts[-1]], cuts[:-1], axis=-1))

    middle = merged(widths * marginal.middles) / merged(widths)
    marginals = merged(marginal.halves()) / merged(widths)
    slope = np.concatenate([[0.0], middle, marginal.bins[cuts[-1] - 1, 1:]])
    values = np.concatenate([marginals[:, :1], marginals, marginals[:, -1:]], axis=1) / (1 + slope**2)
    values /= np.trapezoid(values * slope, slope)[:, None]
    density = RadialDensity(slope, values[0]).normalised()
    s, weight = density.rule()
    # Between the finish and outlying slopes there are no bins, and the density is no one's.
    slope_rms = marginal.slope_rms if marginal.outlying.share else float(np.sqrt(weight @ s**2))
    return RadialEstimate(density, slope_rms, _relative_uncertainty(slope, values), _half_changes(values))

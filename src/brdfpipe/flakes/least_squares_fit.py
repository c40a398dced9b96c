"""Least-squares curves through more points than parameters.

For a given B the form is linear in A and C, so only B is searched for.

References
----------
Golub & Pereyra 1973: variable projection.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from brdfpipe.flakes.forms import FAINTEST, NOT_CONVEX, ROUNDING, ChannelCurve, ChannelData, distinct
from brdfpipe.geometry import Array

_GRID = 48
_STARTS = 4
_ZOOMS, _ZOOM_NODES = 13, 17


def least_squares_or_refuse(data: ChannelData) -> ChannelCurve:
    """The least-squares curve; refused if a parameter at its bound shows that the form is wrong."""
    fitted = least_squares_curve(data)
    misfit = data.relative_misfit(fitted)
    if not fitted.amplitude.any():
        if misfit > 1:
            raise data.rising(data.theta[data.rho.argmin()], data.theta[data.rho.argmax()])
        return fitted
    reason = _undetermined_reason(data, fitted)
    if reason:
        constant = _constant_curve(data)
        if data.relative_misfit(constant) > 1:
            raise data.out_of_range("B", reason)
        return constant
    if fitted.constant == 0 and misfit > 1 and _unconstrained_misfit(data) < misfit / 2:
        reason = "the colour falls so steeply at large flake angles that C would be negative"
        raise data.out_of_range("C", reason)
    return fitted


def _constant_curve(data: ChannelData) -> ChannelCurve:
    """The least-squares constant."""
    weight, terms = data.scale**-2, data.form.terms
    span = np.full(terms, np.ptp(data.theta))
    return ChannelCurve(np.zeros(terms), span, float(weight @ data.rho / weight.sum()))


def _undetermined_reason(data: ChannelData, fitted: ChannelCurve) -> str:
    """Reason why the geometries do not determine B; empty if they do."""
    theta, predicted = data.theta, data.predicted(fitted)
    for amplitude, decay in zip(fitted.amplitude, fitted.decay, strict=True):
        if amplitude == 0:
            continue
        if decay > 0.98 * data.decay_range[1]:
            return NOT_CONVEX
        significant = amplitude * np.exp(-((theta / decay) ** data.form.power)) > FAINTEST * predicted
        if distinct(theta[significant]) < 2:
            return "the colour falls between two neighbouring geometries, so that B is undetermined"
    return ""


def _unconstrained_misfit(data: ChannelData) -> float:
    """Rms of misfit over tolerance of the best curve with A and C of any sign, over all B that are searched."""
    target = data.rho / data.scale
    design = _design(data, np.geomspace(*data.decay_range, _GRID)[:, None])
    error = (np.einsum("cgk,ck->cg", design, np.linalg.pinv(design) @ target) - target) * data.scale / data.tolerance
    return float(np.sqrt((error**2).mean(axis=1).min()))


def least_squares_curve(data: ChannelData, start: Array | None = None) -> ChannelCurve:
    """The least-squares curve; ``start`` are decays near which two terms are searched."""
    decay = _one_decay(data) if data.form.terms == 1 else _several_decays(data, start)
    linear = _project(data, decay[None])[0][0]
    # A term that decays before the first geometry has an arbitrary amplitude; it is 0 if it contributes less than rounding everywhere.
    contribution = linear[:-1] * np.exp(-((data.theta[:, None] / decay) ** data.form.power))
    amplitude = np.where(contribution.max(axis=0) > ROUNDING * data.rho.max(), linear[:-1], 0.0)
    # Terms without amplitude come last in every channel; their B is meaningless.
    decay = np.where(amplitude > 0, decay, np.ptp(data.theta))
    order = np.lexsort((decay, amplitude == 0))
    return ChannelCurve(amplitude[order], decay[order], float(linear[-1]))


def _one_decay(data: ChannelData) -> Array:
    """Best B by successively finer grids, which find the global minimum of one unknown."""
    low, high = np.log(data.decay_range)
    nodes = np.linspace(low, high, _GRID)
    for _ in range(_ZOOMS):
        error = (_project(data, np.exp(nodes)[:, None])[1] ** 2).sum(axis=1)
        best, step = nodes[int(np.argmin(error))], nodes[1] - nodes[0]
        nodes = np.clip(best + np.linspace(-step, step, _ZOOM_NODES), low, high)
    return np.exp(np.array([best]))


def _several_decays(data: ChannelData, start: Array | None) -> Array:
    from scipy.optimize import least_squares

    low, high = np.log(data.decay_range)
    starts, tolerance = (_starts(data), 1e-15) if start is None else (np.log(start)[None], 1e-8)

    def residuals(log_decay: Array) -> Array:
        return _project(data, np.exp(log_decay)[None])[1][0]

    # The gradient is lost where a term vanishes, so a search may end in a local minimum: start several.
    solutions = [
        least_squares(residuals, first, bounds=(low, high), xtol=tolerance, ftol=tolerance, gtol=tolerance)
        for first in np.clip(starts, low + 1e-9, high - 1e-9)
    ]
    return np.asarray(np.exp(np.sort(min(solutions, key=lambda solution: solution.cost).x)))


def _starts(data: ChannelData) -> Array:
    """Logarithms of starting decays (starts, terms): the best of a grid, at most one for each smaller decay."""
    low, high = np.log(data.decay_range)
    candidates = np.array(list(combinations(np.linspace(low, high, _GRID), data.form.terms)))
    errors = (_project(data, np.exp(candidates))[1] ** 2).sum(axis=1)
    order = np.argsort(errors, kind="stable")
    _, first = np.unique(candidates[order, 0], return_index=True)
    return np.asarray(candidates[order[np.sort(first)[:_STARTS]]])


def _design(data: ChannelData, decays: Array) -> Array:
    """Weighted columns exp[−(θf/B)^p] and 1: (candidates, geometries, terms + 1) of decays (candidates, terms)."""
    columns = np.exp(-((data.theta[:, None] / decays[:, None, :]) ** data.form.power))
    return np.concatenate([columns, np.ones((*columns.shape[:2], 1))], axis=2) / data.scale[:, None]


def _project(data: ChannelData, decays: Array) -> tuple[Array, Array]:
    """Best A and C >= 0 for given B: (candidates, terms + 1) and residuals (candidates, geometries).

    All subsets of at most three columns are tried, which is exact.
    """
    design, target = _design(data, decays), data.rho / data.scale
    width = design.shape[2]
    best, least = np.zeros((decays.shape[0], width)), np.full(decays.shape[0], float(target @ target))
    for size in range(1, width + 1):
        for subset in combinations(range(width), size):
            part = design[:, :, subset]
            solved = _solve(part, target)
            error = ((target - np.einsum("cgk,ck->cg", part, solved)) ** 2).sum(axis=1)
            better = (solved >= 0).all(axis=1) & (error < least)
            best[better] = 0.0
            best[np.ix_(better, subset)] = solved[better]
            least[better] = error[better]
    return best, np.einsum("cgk,ck->cg", design, best) - target


def _solve(design: Array, target: Array) -> Array:
    """Unconstrained least squares of one, two (closed form, in bulk) or three columns: (candidates, columns)."""
    size = design.shape[2]
    if size > 2:
        return np.asarray(np.linalg.pinv(design) @ target)
    normal, right = np.einsum("cgi,cgj->cij", design, design), np.einsum("cgi,g->ci", design, target)
    with np.errstate(divide="ignore", invalid="ignore"):
        if size == 1:
            solution = right / normal[:, 0]
        else:
            (a, b), (_, d) = normal[:, 0].T, normal[:, 1].T
            solution = np.stack([d * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]], axis=1)
            solution = solution / (a * d - b * b)[:, None]
    # If columns are collinear, a smaller subset fits as well.
    return np.where(np.isfinite(solution), solution, -1.0)

"""Named forms of the reflection along the flake angle, and their fits: one curve per channel.

ρ(θf) = Σ A exp[−(θf/B)^p] + C with A >= 0, C >= 0, B > 0: ``exponential`` (p = 1), ``gaussian`` (p = 2) and
``double-exponential`` (two terms). For a given B the form is linear in A and C, so only B is searched for.

References
----------
Patent US 7,991,596 (DuPont), exponential plus constant; Golub & Pereyra 1973 (variable projection).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

_SAME_ANGLE = 1e-3
"""Flake angles closer than this count as equal [degree]."""
_FAINTEST = 1e-3
"""Share of a channel's largest value below which noise is absolute instead of relative."""
_CONSTANT = 0.05
"""Relative rms misfit up to which a channel counts as constant."""
_DOUBT = 3.0
"""Misfit over standard uncertainty that is still tolerated."""
_STRAIGHT = 20.0
"""B over the range of flake angles, above which the decay is a straight line."""
_STEEP = 0.02
"""B over the smallest distance of two flake angles, below which B is undetermined."""
_GRID = 48
_STARTS = 4
_ZOOMS, _ZOOM_NODES = 13, 17
_ROUNDING = 1e-12
_BLACK = 1e-12
"""Smaller values count as 0: their square would underflow."""


class Form(NamedTuple):
    """A form of decay."""

    terms: int
    power: int

    @property
    def parameters(self) -> int:
        return 2 * self.terms + 1

    @property
    def others(self) -> str:
        """Names of the other forms, for advice."""
        return ", ".join(name for name, form in FORMS.items() if form != self)


FORMS: Mapping[str, Form] = {
    "exponential": Form(1, 1),
    "gaussian": Form(1, 2),
    "double-exponential": Form(2, 1),
}


class Fit(NamedTuple):
    """Fitted parameters of every channel."""

    form: Form
    amplitude: Array
    """(terms, channels) A, in the unit of the values"""
    decay: Array
    """(terms, channels) B [degree], increasing; terms with A = 0 come last, and their B is meaningless"""
    constant: Array
    """(channels,) C"""
    covariance: Array
    """(channels, parameters, parameters) of A, B of each term and C; NaN at a bound, and of an exact fit to values of unknown
    uncertainty"""

    def __call__(self, theta_f: ArrayLike) -> Array:
        """Values (..., channels) at flake angles [degree]."""
        return curve(theta_f, self.amplitude, self.decay, self.constant, self.form.power)


def curve(theta_f: ArrayLike, amplitude: Array, decay: Array, constant: Array, power: int) -> Array:
    """Σ A exp[−(θf/B)^p] + C: (..., channels) of θf (...) and parameters (terms, channels)."""
    theta = np.asarray(theta_f, dtype=float)[..., None]
    total = np.broadcast_to(constant, (*theta.shape[:-1], constant.size))
    for a, b in zip(amplitude, decay, strict=True):
        ratio = theta / b
        total = total + a * np.exp(-(ratio if power == 1 else ratio**power))
    return np.asarray(total)


def fit(
    theta_f: ArrayLike,
    values: ArrayLike,
    form: str = "exponential",
    channels: Sequence[str] | None = None,
    uncertainty: ArrayLike | None = None,
) -> Fit:
    """Fit a form to every channel.

    Parameters
    ----------
    theta_f : (geometries,) degree
    values : (geometries, channels) >= 0, any linear unit
    form : a key of :data:`FORMS`
    channels : their names, for messages
    uncertainty : (geometries, channels) > 0, standard uncertainties of the values, taken to be independent of each other

    Returns
    -------
    Fit : exact for three geometries and a form of one term; otherwise least squares, weighted by the uncertainties, or by the
        values if there are none. The covariance follows from the uncertainties, or from the misfits

    Raises
    ------
    InputError : unknown form, undefined or negative values, too few different flake angles, or a channel whose A, B or C would be
        out of range, with the reason.
    """
    shape, data = _validated(theta_f, values, form, uncertainty)
    names = [str(name) for name in (range(1, data.rho.shape[1] + 1) if channels is None else channels)]
    exact = data.theta.size == shape.parameters == 3
    solve = _exact if exact else _least_squares_or_refuse
    curves = [solve(channel, shape, name) for channel, name in zip(data.channels(), names, strict=True)]
    return _combined(data, curves, shape)


def leave_one_out(
    theta_f: ArrayLike, values: ArrayLike, form: str = "exponential", uncertainty: ArrayLike | None = None
) -> Array:
    """Prediction for each geometry by the fit to all others.

    Parameters
    ----------
    theta_f, values, form, uncertainty : as for :func:`fit`

    Returns
    -------
    (geometries, channels) in the unit of the values; NaN if there are too few others
    """
    shape, data = _validated(theta_f, values, form, uncertainty)
    predicted = np.full_like(data.rho, np.nan)
    whole: list[Array | None] = [None] * data.rho.shape[1]
    if shape.terms > 1:
        whole = [_least_squares(channel, shape).decay for channel in data.channels()]
    for left_out in range(data.theta.size):
        rest = data.without(left_out)
        if distinct(rest.theta) < shape.parameters:
            continue
        curves = [_least_squares(channel, shape, start) for channel, start in zip(rest.channels(), whole, strict=True)]
        predicted[left_out] = _combined(rest, curves, shape)(data.theta[left_out])
    return predicted


def distinct(theta_f: Array) -> int:
    """Number of different flake angles."""
    return int(1 + np.count_nonzero(np.diff(np.sort(theta_f)) > _SAME_ANGLE)) if theta_f.size else 0


class _ChannelCurve(NamedTuple):
    amplitude: Array
    decay: Array
    constant: float


class _Data(NamedTuple):
    """Values (geometries, channels), or those of one channel (geometries,)."""

    theta: Array
    rho: Array
    scale: Array
    """Standard uncertainty of each value, or its relative substitute"""
    tolerance: Array
    """Largest tolerated misfit"""
    known: bool
    """Whether the scale is the standard uncertainty"""

    def channels(self) -> list[_Data]:
        columns = zip(self.rho.T, self.scale.T, self.tolerance.T, strict=True)
        return [_Data(self.theta, rho, scale, tolerance, self.known) for rho, scale, tolerance in columns]

    def without(self, place: int) -> _Data:
        others = np.arange(self.theta.size) != place
        return _Data(self.theta[others], self.rho[others], self.scale[others], self.tolerance[others], self.known)


def _validated(theta_f: ArrayLike, values: ArrayLike, form: str, uncertainty: ArrayLike | None) -> tuple[Form, _Data]:
    if form not in FORMS:
        raise _refusal("unknown form", found=repr(form)[:40], accepted=", ".join(FORMS))
    theta, rho = np.asarray(theta_f, dtype=float), np.asarray(values, dtype=float)
    if theta.ndim != 1 or rho.ndim != 2 or rho.shape[0] != theta.size:
        raise _refusal("shapes do not match", found=f"{theta.shape} and {rho.shape}", accepted="(g,) and (g, channels)")
    if not (np.isfinite(theta).all() and np.isfinite(rho).all()) or (rho < 0).any():
        raise _refusal("negative or undefined colour values", found=None, accepted="finite values, at least 0")
    needed = FORMS[form].parameters
    if distinct(theta) < needed:
        raise InputError(
            "material.yaml",
            f"too few different flake angles for the form {form}",
            where="multiangle",
            found=f"{distinct(theta)} in {theta.size} geometries (mirrored or repeated geometries count once)",
            accepted=f"at least {needed}",
            key="multiangle.colours",
        )
    rho = np.where(rho < _BLACK, 0.0, rho)
    itself = _relative_scale(rho)
    if uncertainty is None:
        return FORMS[form], _Data(theta, rho, itself, _CONSTANT * itself, known=False)
    u = np.asarray(uncertainty, dtype=float)
    if u.shape != rho.shape or not np.isfinite(u).all() or (u <= 0).any():
        raise _refusal("invalid uncertainties", found=None, accepted="one for each value, above 0")
    return FORMS[form], _Data(theta, rho, u, np.maximum(_CONSTANT * itself, _DOUBT * u), known=True)


def _relative_scale(rho: Array) -> Array:
    """Weighting of values of unknown uncertainty: relative, like the noise of instruments and the eye."""
    brightest = rho.max(axis=0)
    return np.where(brightest > 0, np.maximum(rho, _FAINTEST * brightest), 1.0)


# --- three geometries


def _exact(data: _Data, form: Form, name: str) -> _ChannelCurve:
    """The curve through three points.

    With t = θf^p and κ = B^−p, (ρ1 − ρ2)/(ρ2 − ρ3) = expm1(κ(t2 − t1)) / −expm1(−κ(t3 − t2)) rises with κ from
    (t2 − t1)/(t3 − t2), so there is one solution or none.
    """
    from scipy.optimize import brentq

    theta, rho = data.theta, data.rho
    order = np.argsort(theta)
    t, (first, second, third) = theta[order] ** form.power, rho[order]
    if max(first, second, third) - min(first, second, third) <= _ROUNDING * max(first, 1e-300):
        return _ChannelCurve(np.zeros(1), np.array([theta.max() - theta.min()]), float(rho.mean()))
    _check_fall(theta[order], rho[order], form, name)
    near, far = t[1] - t[0], t[2] - t[1]
    ratio = (first - second) / (second - third)

    def misfit(kappa: float) -> float:
        return float(np.expm1(kappa * near) + ratio * np.expm1(-kappa * far))

    highest = np.log1p(ratio) / near * (1 + 1e-6)  # rounding may leave the bound itself on the wrong side
    lowest = highest * 1e-9
    if misfit(lowest) >= 0:
        raise _out_of_range(
            "B",
            form,
            name,
            "the colour falls linearly or ever faster with the flake angle, so that B would be infinite or negative",
        )
    kappa = float(brentq(misfit, lowest, highest, xtol=1e-300, rtol=4 * np.finfo(float).eps))
    constant = third - (second - third) * np.exp(-kappa * far) / -np.expm1(-kappa * far)
    with np.errstate(over="ignore"):
        amplitude = (first - second) * np.exp(kappa * t[0]) / -np.expm1(-kappa * near)
    if not np.isfinite(amplitude):
        raise _out_of_range("A", form, name, "the colour falls so fast with the flake angle that A would be infinite")
    if constant < -max(_ROUNDING * first, _BLACK):
        words = f"the colour falls so slowly with the flake angle that C would be negative ({constant:.4g})"
        raise _out_of_range("C", form, name, words)
    return _ChannelCurve(np.array([amplitude]), np.array([kappa ** (-1 / form.power)]), max(float(constant), 0.0))


def _check_fall(theta: Array, rho: Array, form: Form, name: str) -> None:
    for k in (0, 1):
        if rho[k] < rho[k + 1]:
            raise _out_of_range("A", form, name, f"{_rise(theta[k], theta[k + 1])}, so that A would be negative")
    if rho[0] == rho[1]:
        raise _out_of_range(
            "B", form, name, f"the colour is the same at {theta[0]:.4g} and {theta[1]:.4g} degree and falls beyond"
        )
    if rho[1] == rho[2]:
        raise _out_of_range(
            "B", form, name, f"the colour does not fall from {theta[1]:.4g} degree on, so that B would be 0"
        )


# --- more geometries


def _least_squares_or_refuse(data: _Data, form: Form, name: str) -> _ChannelCurve:
    """The least-squares curve; refused if a parameter at its bound shows that the form is wrong."""
    fitted = _least_squares(data, form)
    doubt = _misfit_over_tolerance(data, fitted, form)
    if not fitted.amplitude.any():
        if doubt > 1:
            near, far = data.theta[data.rho.argmin()], data.theta[data.rho.argmax()]
            raise _out_of_range("A", form, name, f"{_rise(near, far)}, so that A would be negative")
        return fitted
    reason = _undetermined_reason(data.theta, fitted, form)
    if reason:
        level = _level(data, form)
        if _misfit_over_tolerance(data, level, form) > 1:
            raise _out_of_range("B", form, name, reason)
        return level
    if fitted.constant == 0 and doubt > 1 and _unconstrained_misfit(data, form) < doubt / 2:
        raise _out_of_range(
            "C", form, name, "the colour falls so steeply at large flake angles that C would be negative"
        )
    return fitted


def _misfit_over_tolerance(data: _Data, solution: _ChannelCurve, form: Form) -> float:
    """Rms of misfit over tolerance."""
    constant = np.array([solution.constant])
    predicted = curve(data.theta, solution.amplitude[:, None], solution.decay[:, None], constant, form.power)[:, 0]
    return float(np.sqrt(np.mean(((predicted - data.rho) / data.tolerance) ** 2)))


def _level(data: _Data, form: Form) -> _ChannelCurve:
    """The least-squares constant."""
    weight = data.scale**-2
    span = np.full(form.terms, np.ptp(data.theta))
    return _ChannelCurve(np.zeros(form.terms), span, float(weight @ data.rho / weight.sum()))


def _undetermined_reason(theta: Array, solution: _ChannelCurve, form: Form) -> str:
    """Reason why the geometries do not determine B; empty if they do."""
    predicted = curve(
        theta, solution.amplitude[:, None], solution.decay[:, None], np.array([solution.constant]), form.power
    )[:, 0]
    for amplitude, decay in zip(solution.amplitude, solution.decay, strict=True):
        if amplitude == 0:
            continue
        if decay > 0.98 * _bounds(theta)[1]:
            return (
                "the colour falls linearly or ever faster with the flake angle, so that B would be infinite or negative"
            )
        significant = amplitude * np.exp(-((theta / decay) ** form.power)) > _FAINTEST * predicted
        if distinct(theta[significant]) < 2:
            return "the colour falls between two neighbouring geometries, so that B is undetermined"
    return ""


def _unconstrained_misfit(data: _Data, form: Form) -> float:
    """Rms of misfit over tolerance of the best curve with A and C of any sign, over all B that are searched."""
    theta, target = data.theta, data.rho / data.scale
    decays = np.geomspace(*_bounds(theta), _GRID)
    columns = np.exp(-((theta / decays[:, None]) ** form.power))
    design = np.stack([columns, np.ones_like(columns)], axis=2) / data.scale[:, None]
    error = (np.einsum("cgk,ck->cg", design, np.linalg.pinv(design) @ target) - target) * data.scale / data.tolerance
    return float(np.sqrt((error**2).mean(axis=1).min()))


def _least_squares(data: _Data, form: Form, start: Array | None = None) -> _ChannelCurve:
    """The least-squares curve; ``start`` are decays near which two terms are searched."""
    theta, rho, scale = data.theta, data.rho, data.scale
    if form.terms == 1:
        decay = _one_decay(theta, rho, scale, form.power)
    else:
        decay = _several_decays(theta, rho, scale, form, start)
    linear = _project(theta, rho, scale, decay[None], form.power)[0][0]
    # A term that decays before the first geometry has an arbitrary amplitude; it is 0 if it contributes less than rounding everywhere.
    contribution = linear[:-1] * np.exp(-((theta[:, None] / decay) ** form.power))
    amplitude = np.where(contribution.max(axis=0) > _ROUNDING * rho.max(), linear[:-1], 0.0)
    # Terms without amplitude come last in every channel; their B is meaningless.
    decay = np.where(amplitude > 0, decay, np.ptp(theta))
    order = np.lexsort((decay, amplitude == 0))
    return _ChannelCurve(amplitude[order], decay[order], float(linear[-1]))


def _one_decay(theta: Array, rho: Array, scale: Array, power: int) -> Array:
    """Best B by successively finer grids, which find the global minimum of one unknown."""
    low, high = np.log(_bounds(theta))
    nodes = np.linspace(low, high, _GRID)
    for _ in range(_ZOOMS):
        error = (_project(theta, rho, scale, np.exp(nodes)[:, None], power)[1] ** 2).sum(axis=1)
        best, step = nodes[int(np.argmin(error))], nodes[1] - nodes[0]
        nodes = np.clip(best + np.linspace(-step, step, _ZOOM_NODES), low, high)
    return np.exp(np.array([best]))


def _several_decays(theta: Array, rho: Array, scale: Array, form: Form, start: Array | None) -> Array:
    from scipy.optimize import least_squares

    low, high = np.log(_bounds(theta))
    if start is None:
        starts, tolerance = _starts(theta, rho, scale, form), 1e-15
    else:
        starts, tolerance = np.log(start)[None], 1e-8

    def residuals(log_decay: Array) -> Array:
        return _project(theta, rho, scale, np.exp(log_decay)[None], form.power)[1][0]

    # The gradient is lost where a term vanishes, so a search may end in a local minimum: start several.
    solutions = [
        least_squares(residuals, first, bounds=(low, high), xtol=tolerance, ftol=tolerance, gtol=tolerance)
        for first in np.clip(starts, low + 1e-9, high - 1e-9)
    ]
    return np.asarray(np.exp(np.sort(min(solutions, key=lambda solution: solution.cost).x)))


def _starts(theta: Array, rho: Array, scale: Array, form: Form) -> Array:
    """Logarithms of starting decays (starts, terms): the best of a grid, at most one for each smaller decay."""
    low, high = np.log(_bounds(theta))
    candidates = np.array(list(combinations(np.linspace(low, high, _GRID), form.terms)))
    errors = (_project(theta, rho, scale, np.exp(candidates), form.power)[1] ** 2).sum(axis=1)
    order = np.argsort(errors, kind="stable")
    _, first = np.unique(candidates[order, 0], return_index=True)
    return np.asarray(candidates[order[np.sort(first)[:_STARTS]]])


def _bounds(theta: Array) -> tuple[float, float]:
    gaps = np.diff(np.sort(theta))
    return _STEEP * float(gaps[gaps > _SAME_ANGLE].min()), _STRAIGHT * float(np.ptp(theta))


def _project(theta: Array, rho: Array, scale: Array, decays: Array, power: int) -> tuple[Array, Array]:
    """Best A and C >= 0 for given B: (candidates, terms + 1) and residuals (candidates, geometries).

    All subsets of at most three columns are tried, which is exact.
    """
    columns = np.exp(-((theta[:, None] / decays[:, None, :]) ** power))
    design = np.concatenate([columns, np.ones((*columns.shape[:2], 1))], axis=2) / scale[:, None]
    target = rho / scale
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


def _combined(data: _Data, curves: Sequence[_ChannelCurve], form: Form) -> Fit:
    covariance = np.stack([_covariance(*item, form) for item in zip(data.channels(), curves, strict=True)])
    return Fit(
        form,
        np.stack([item.amplitude for item in curves], axis=1),
        np.stack([item.decay for item in curves], axis=1),
        np.array([item.constant for item in curves]),
        covariance,
    )


def _covariance(data: _Data, solution: _ChannelCurve, form: Form) -> Array:
    """(JᵀWJ)⁻¹ of the parameters that are free, times s² of the misfits if W is unknown; NaN without degrees of freedom."""
    unknown = np.full((form.parameters, form.parameters), np.nan)
    if data.theta.size <= form.parameters and not data.known:
        return unknown
    columns = []
    ratio = data.theta[:, None] / solution.decay
    falling = np.exp(-(ratio**form.power))
    for k, amplitude in enumerate(solution.amplitude):
        columns += [
            falling[:, k],
            amplitude * falling[:, k] * form.power * ratio[:, k] ** form.power / solution.decay[k],
        ]
    jacobian = np.stack([*columns, np.ones_like(data.theta)], axis=1) / data.scale[:, None]
    free = np.array([*np.repeat(solution.amplitude > 0, 2), solution.constant > 0])
    misfit = (falling @ solution.amplitude + solution.constant - data.rho) / data.scale
    spread = 1.0 if data.known else float(misfit @ misfit) / (data.theta.size - form.parameters)
    used = jacobian[:, free]
    unknown[np.ix_(free, free)] = spread * np.linalg.pinv(used.T @ used, hermitian=True)
    return unknown


def _rise(near: float, far: float) -> str:
    return f"the colour is brighter at a flake angle of {far:.4g} than at {near:.4g} degree"


def _out_of_range(parameter: str, form: Form, channel: str, reason: str) -> InputError:
    return InputError(
        "material.yaml",
        f"{parameter} of the fit is out of range: {reason}",
        where=f"multiangle, channel {channel}",
        accepted=f"A >= 0, B > 0, C >= 0; another form ({form.others}), more geometries, or corrected colours",
        key="multiangle.form",
    )


def _refusal(problem: str, *, found: str | None, accepted: str) -> InputError:
    return InputError("material.yaml", problem, where="multiangle", found=found, accepted=accepted, key="multiangle")

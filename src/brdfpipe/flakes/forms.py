"""Named forms of the reflection along the flake angle, and their fits: one curve a channel.

ρ(θf) = Σ A exp[−(θf/B)^p] + C with A >= 0, C >= 0, B > 0: ``exponential`` (p = 1), ``gaussian`` (p = 2) and
``double-exponential`` (two terms). For a given B the form is linear in A and C, so that only B is searched for.

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
"""Flake angles closer than this [degree] are one: measured twice."""
_FAINTEST = 1e-3
"""Share of a channel's largest value below which noise is no longer taken as relative."""
_CONSTANT = 0.05
"""Relative rms up to which a channel that does not fall is taken as constant."""
_DOUBT = 3.0
"""Over the standard uncertainty, up to which a misfit is no misfit."""
_STRAIGHT = 20.0
"""B over the range of flake angles, from where on the fall is a straight line."""
_STEEP = 0.02
"""B over the smallest distance of two flake angles, below which nothing tells B."""
_GRID = 48
_STARTS = 4
_ZOOMS, _ZOOM_NODES = 13, 17
_ROUNDING = 1e-12
_BLACK = 1e-12
"""Below this a value is none: its square would be lost."""


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
    """A curve a channel."""

    form: Form
    amplitude: Array
    """(terms, channels) A, in the unit of the values"""
    decay: Array
    """(terms, channels) B [degree], rising but for terms with A = 0: they come last, and their B means nothing"""
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
    Fit : exact for three geometries and a form of one term; else of least squares, each misfit over its uncertainty, or over
        the value itself where there are none. The covariance follows from the uncertainties, or from the misfits

    Raises
    ------
    InputError : unknown form, undefined or negative values, too few different flake angles, or a channel whose A, B or C would be
        out of range, with the reason.
    """
    shape, data = _checked(theta_f, values, form, uncertainty)
    names = [str(name) for name in (range(1, data.rho.shape[1] + 1) if channels is None else channels)]
    exact = data.theta.size == shape.parameters == 3
    solve = _exact if exact else _accepted
    found = [solve(channel, shape, name) for channel, name in zip(data.channels(), names, strict=True)]
    return _gathered(data, found, shape)


def leave_one_out(
    theta_f: ArrayLike, values: ArrayLike, form: str = "exponential", uncertainty: ArrayLike | None = None
) -> Array:
    """What the fit to all other geometries says of each geometry.

    Parameters
    ----------
    theta_f, values, form, uncertainty : as for :func:`fit`

    Returns
    -------
    (geometries, channels) in the unit of the values; NaN where the others are too few
    """
    shape, data = _checked(theta_f, values, form, uncertainty)
    predicted = np.full_like(data.rho, np.nan)
    whole: list[Array | None] = [None] * data.rho.shape[1]
    if shape.terms > 1:
        whole = [_least_squares(channel, shape).decay for channel in data.channels()]
    for left_out in range(data.theta.size):
        rest = data.without(left_out)
        if distinct(rest.theta) < shape.parameters:
            continue
        found = [_least_squares(channel, shape, start) for channel, start in zip(rest.channels(), whole, strict=True)]
        predicted[left_out] = _gathered(rest, found, shape)(data.theta[left_out])
    return predicted


def distinct(theta_f: Array) -> int:
    """How many different flake angles there are."""
    return int(1 + np.count_nonzero(np.diff(np.sort(theta_f)) > _SAME_ANGLE)) if theta_f.size else 0


class _Curve(NamedTuple):
    amplitude: Array
    decay: Array
    constant: float


class _Data(NamedTuple):
    """Values (geometries, channels), or those of one channel (geometries,)."""

    theta: Array
    rho: Array
    scale: Array
    """What each misfit is measured by"""
    tolerance: Array
    """Misfit up to which a form is not doubted"""
    known: bool
    """Whether the scale is the standard uncertainty"""

    def channels(self) -> list[_Data]:
        columns = zip(self.rho.T, self.scale.T, self.tolerance.T, strict=True)
        return [_Data(self.theta, rho, scale, tolerance, self.known) for rho, scale, tolerance in columns]

    def without(self, place: int) -> _Data:
        kept = np.arange(self.theta.size) != place
        return _Data(self.theta[kept], self.rho[kept], self.scale[kept], self.tolerance[kept], self.known)


def _checked(theta_f: ArrayLike, values: ArrayLike, form: str, uncertainty: ArrayLike | None) -> tuple[Form, _Data]:
    if form not in FORMS:
        raise _refusal("unknown form", found=repr(form)[:40], accepted=", ".join(FORMS))
    theta, rho = np.asarray(theta_f, dtype=float), np.asarray(values, dtype=float)
    if theta.ndim != 1 or rho.ndim != 2 or rho.shape[0] != theta.size:
        raise _refusal("shapes do not match", found=f"{theta.shape} and {rho.shape}", accepted="(g,) and (g, channels)")
    if not (np.isfinite(theta).all() and np.isfinite(rho).all()) or (rho < 0).any():
        raise _refusal("a negative or undefined colour", found=None, accepted="finite values, at least 0")
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
    itself = _itself(rho)
    if uncertainty is None:
        return FORMS[form], _Data(theta, rho, itself, _CONSTANT * itself, known=False)
    u = np.asarray(uncertainty, dtype=float)
    if u.shape != rho.shape or not np.isfinite(u).all() or (u <= 0).any():
        raise _refusal("uncertainties that are no weights", found=None, accepted="one above 0 for each value")
    return FORMS[form], _Data(theta, rho, u, np.maximum(_CONSTANT * itself, _DOUBT * u), known=True)


def _itself(rho: Array) -> Array:
    """What the misfit of a value of unknown uncertainty is measured by: itself, as instruments' noise and the eye do."""
    brightest = rho.max(axis=0)
    return np.where(brightest > 0, np.maximum(rho, _FAINTEST * brightest), 1.0)


# --- three geometries


def _exact(data: _Data, form: Form, name: str) -> _Curve:
    """The one curve through three points.

    With t = θf^p and κ = B^−p, (ρ1 − ρ2)/(ρ2 − ρ3) = expm1(κ(t2 − t1)) / −expm1(−κ(t3 − t2)) rises with κ from
    (t2 − t1)/(t3 − t2), so that there is one solution or none.
    """
    from scipy.optimize import brentq

    theta, rho = data.theta, data.rho
    order = np.argsort(theta)
    t, (first, second, third) = theta[order] ** form.power, rho[order]
    if max(first, second, third) - min(first, second, third) <= _ROUNDING * max(first, 1e-300):
        return _Curve(np.zeros(1), np.array([theta.max() - theta.min()]), float(rho.mean()))
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
            "the colour falls along a straight line or ever faster, so that B would be infinite or negative",
        )
    kappa = float(brentq(misfit, lowest, highest, xtol=1e-300, rtol=4 * np.finfo(float).eps))
    constant = third - (second - third) * np.exp(-kappa * far) / -np.expm1(-kappa * far)
    with np.errstate(over="ignore"):
        amplitude = (first - second) * np.exp(kappa * t[0]) / -np.expm1(-kappa * near)
    if not np.isfinite(amplitude):
        raise _out_of_range("A", form, name, "the colour falls so fast that A would be infinite")
    if constant < -max(_ROUNDING * first, _BLACK):
        words = f"the colour falls so slowly that far from the gloss it would be below black, C = {constant:.4g}"
        raise _out_of_range("C", form, name, words)
    return _Curve(np.array([amplitude]), np.array([kappa ** (-1 / form.power)]), max(float(constant), 0.0))


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


def _accepted(data: _Data, form: Form, name: str) -> _Curve:
    """The curve of least squares, unless it lies at a bound that says the form is wrong."""
    found = _least_squares(data, form)
    doubt = _doubt(data, found, form)
    if not found.amplitude.any():
        if doubt > 1:
            near, far = data.theta[data.rho.argmin()], data.theta[data.rho.argmax()]
            raise _out_of_range("A", form, name, f"{_rise(near, far)}, so that A would be negative")
        return found
    reason = _untold(data.theta, found, form)
    if reason:
        level = _level(data, form)
        if _doubt(data, level, form) > 1:
            raise _out_of_range("B", form, name, reason)
        return level
    if found.constant == 0 and doubt > 1 and _freely(data, form) < doubt / 2:
        raise _out_of_range(
            "C", form, name, "the colours go down so fast that far from the gloss they would be below black"
        )
    return found


def _doubt(data: _Data, found: _Curve, form: Form) -> float:
    """Rms misfit over what is tolerated."""
    constant = np.array([found.constant])
    fitted = curve(data.theta, found.amplitude[:, None], found.decay[:, None], constant, form.power)[:, 0]
    return float(np.sqrt(np.mean(((fitted - data.rho) / data.tolerance) ** 2)))


def _level(data: _Data, form: Form) -> _Curve:
    """The constant of least squares."""
    weight = data.scale**-2
    span = np.full(form.terms, np.ptp(data.theta))
    return _Curve(np.zeros(form.terms), span, float(weight @ data.rho / weight.sum()))


def _untold(theta: Array, found: _Curve, form: Form) -> str:
    """Why the geometries do not tell a B; nothing where they do."""
    fitted = curve(theta, found.amplitude[:, None], found.decay[:, None], np.array([found.constant]), form.power)[:, 0]
    for amplitude, decay in zip(found.amplitude, found.decay, strict=True):
        if amplitude == 0:
            continue
        if decay > 0.98 * _bounds(theta)[1]:
            return "the colour falls along a straight line or ever faster, so that B would be infinite or negative"
        seen = amplitude * np.exp(-((theta / decay) ** form.power)) > _FAINTEST * fitted
        if distinct(theta[seen]) < 2:
            return "the colour falls within less than the distance of two geometries, so that nothing tells B"
    return ""


def _freely(data: _Data, form: Form) -> float:
    """Rms misfit, over what is tolerated, of the best A and C of any sign, over the B that are searched."""
    theta, target = data.theta, data.rho / data.scale
    decays = np.geomspace(*_bounds(theta), _GRID)
    columns = np.exp(-((theta / decays[:, None]) ** form.power))
    design = np.stack([columns, np.ones_like(columns)], axis=2) / data.scale[:, None]
    error = (np.einsum("cgk,ck->cg", design, np.linalg.pinv(design) @ target) - target) * data.scale / data.tolerance
    return float(np.sqrt((error**2).mean(axis=1).min()))


def _least_squares(data: _Data, form: Form, start: Array | None = None) -> _Curve:
    """The curve of least squares; ``start`` are decays to begin two terms at, near which it suffices to look."""
    theta, rho, scale = data.theta, data.rho, data.scale
    if form.terms == 1:
        decay = _one_decay(theta, rho, scale, form.power)
    else:
        decay = _several_decays(theta, rho, scale, form, start)
    linear = _project(theta, rho, scale, decay[None], form.power)[0][0]
    # Rounding decides whether a term that decays before the first geometry has an amplitude: below rounding at every geometry it has none.
    contribution = linear[:-1] * np.exp(-((theta[:, None] / decay) ** form.power))
    amplitude = np.where(contribution.max(axis=0) > _ROUNDING * rho.max(), linear[:-1], 0.0)
    # Terms that vanished come last in every channel; their B is that of nothing.
    decay = np.where(amplitude > 0, decay, np.ptp(theta))
    order = np.lexsort((decay, amplitude == 0))
    return _Curve(amplitude[order], decay[order], float(linear[-1]))


def _one_decay(theta: Array, rho: Array, scale: Array, power: int) -> Array:
    """The best B by ever finer grids: with one unknown they find the lowest of several minima."""
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

    # Where a term vanishes the slope is lost, so that a way down may end above one from elsewhere.
    found = [
        least_squares(residuals, first, bounds=(low, high), xtol=tolerance, ftol=tolerance, gtol=tolerance)
        for first in np.clip(starts, low + 1e-9, high - 1e-9)
    ]
    return np.asarray(np.exp(np.sort(min(found, key=lambda each: each.cost).x)))


def _starts(theta: Array, rho: Array, scale: Array, form: Form) -> Array:
    """Logarithms of decays to begin at, (starts, terms): the lowest of a grid, one for each smaller decay, of which a few are best."""
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

    All subsets of at most three columns are tried, which is exact where active-set rules are not needed yet.
    """
    columns = np.exp(-((theta[:, None] / decays[:, None, :]) ** power))
    design = np.concatenate([columns, np.ones((*columns.shape[:2], 1))], axis=2) / scale[:, None]
    target = rho / scale
    width = design.shape[2]
    best, least = np.zeros((decays.shape[0], width)), np.full(decays.shape[0], float(target @ target))
    for size in range(1, width + 1):
        for kept in combinations(range(width), size):
            part = design[:, :, kept]
            solved = _solve(part, target)
            error = ((target - np.einsum("cgk,ck->cg", part, solved)) ** 2).sum(axis=1)
            better = (solved >= 0).all(axis=1) & (error < least)
            best[better] = 0.0
            best[np.ix_(better, kept)] = solved[better]
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
            found = right / normal[:, 0]
        else:
            (a, b), (_, d) = normal[:, 0].T, normal[:, 1].T
            found = np.stack([d * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]], axis=1)
            found = found / (a * d - b * b)[:, None]
    # Where columns cannot be told apart, a smaller subset is as good.
    return np.where(np.isfinite(found), found, -1.0)


def _gathered(data: _Data, found: Sequence[_Curve], form: Form) -> Fit:
    covariance = np.stack([_covariance(*each, form) for each in zip(data.channels(), found, strict=True)])
    return Fit(
        form,
        np.stack([each.amplitude for each in found], axis=1),
        np.stack([each.decay for each in found], axis=1),
        np.array([each.constant for each in found]),
        covariance,
    )


def _covariance(data: _Data, found: _Curve, form: Form) -> Array:
    """(JᵀWJ)⁻¹ of the parameters that are free, times s² of the misfits where W is not known; NaN without degrees of freedom."""
    unknown = np.full((form.parameters, form.parameters), np.nan)
    if data.theta.size <= form.parameters and not data.known:
        return unknown
    columns = []
    ratio = data.theta[:, None] / found.decay
    falling = np.exp(-(ratio**form.power))
    for k, amplitude in enumerate(found.amplitude):
        columns += [falling[:, k], amplitude * falling[:, k] * form.power * ratio[:, k] ** form.power / found.decay[k]]
    jacobian = np.stack([*columns, np.ones_like(data.theta)], axis=1) / data.scale[:, None]
    free = np.array([*np.repeat(found.amplitude > 0, 2), found.constant > 0])
    misfit = (falling @ found.amplitude + found.constant - data.rho) / data.scale
    spread = 1.0 if data.known else float(misfit @ misfit) / (data.theta.size - form.parameters)
    used = jacobian[:, free]
    unknown[np.ix_(free, free)] = spread * np.linalg.pinv(used.T @ used, hermitian=True)
    return unknown


def _rise(near: float, far: float) -> str:
    return f"the colour is brighter at a flake angle of {far:.4g} than at {near:.4g} degree"


def _out_of_range(parameter: str, form: Form, channel: str, reason: str) -> InputError:
    return InputError(
        "material.yaml",
        f"{parameter} is out of range: {reason}",
        where=f"multiangle, channel {channel}",
        accepted=f"A >= 0, B > 0, C >= 0; another form ({form.others}), more geometries, or corrected colours",
        key="multiangle.form",
    )


def _refusal(problem: str, *, found: str | None, accepted: str) -> InputError:
    return InputError("material.yaml", problem, where="multiangle", found=found, accepted=accepted, key="multiangle")

"""Fits of a named form along the flake angle, one curve per channel.

References
----------
Patent US 7,991,596 (DuPont), exponential plus constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.errors import InputError
from brdfpipe.flakes.forms import BLACK, FAINTEST, FORMS, ChannelCurve, ChannelData, Form, curve, distinct
from brdfpipe.flakes.least_squares_fit import least_squares_curve, least_squares_or_refuse
from brdfpipe.flakes.three_point_fit import three_point_curve
from brdfpipe.geometry import Array

_CONSTANT = 0.05
"""Relative rms misfit up to which a channel counts as constant."""
_TOLERATED = 3.0
"""Misfit over standard uncertainty that is still tolerated."""


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

    @property
    def curves(self) -> list[ChannelCurve]:
        """Parameters of each channel."""
        return [
            ChannelCurve(amplitude, decay, float(constant))
            for amplitude, decay, constant in zip(self.amplitude.T, self.decay.T, self.constant, strict=True)
        ]

    def __call__(self, theta_f: ArrayLike) -> Array:
        """Values (..., channels) at flake angles [degree]."""
        return curve(theta_f, self.amplitude, self.decay, self.constant, self.form.power)


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
    data = _channel_data(theta_f, values, form, channels, uncertainty)
    exact = np.size(theta_f) == FORMS[form].parameters == 3
    solve = three_point_curve if exact else least_squares_or_refuse
    return _combined(data, [solve(channel) for channel in data], FORMS[form])


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
    data = _channel_data(theta_f, values, form, None, uncertainty)
    theta = np.asarray(theta_f, dtype=float)
    predicted = np.full((theta.size, len(data)), np.nan)
    starts = [least_squares_curve(channel).decay if channel.form.terms > 1 else None for channel in data]
    for left_out in range(theta.size):
        others = [channel.without(left_out) for channel in data]
        if distinct(np.delete(theta, left_out)) < FORMS[form].parameters:
            continue
        curves = [least_squares_curve(channel, start) for channel, start in zip(others, starts, strict=True)]
        predicted[left_out] = _combined(others, curves, FORMS[form])(theta[left_out])
    return predicted


def sensitivity(
    theta_f: ArrayLike, values: ArrayLike, fitted: Fit, form: str, uncertainty: ArrayLike | None = None
) -> Array:
    """Change of each parameter of a fit with each value, to first order; 0 of parameters at a bound.

    Parameters
    ----------
    theta_f, values, form, uncertainty : as for :func:`fit`, which gave ``fitted``

    Returns
    -------
    (channels, parameters, geometries), parameters as in the covariance
    """
    data = _channel_data(theta_f, values, form, None, uncertainty)
    result = np.zeros((len(data), FORMS[form].parameters, np.size(theta_f)))
    for k, (channel, one) in enumerate(zip(data, fitted.curves, strict=True)):
        slopes, free = _free_slopes(channel, one)
        result[k, free] = np.linalg.pinv(slopes / channel.scale[:, None]) / channel.scale
    return result


def relative_scale(values: Array) -> Array:
    """Values (geometries, channels), at least a thousandth of the largest of the channel; 1 in a black channel."""
    brightest = values.max(axis=0)
    return np.where(brightest > 0, np.maximum(values, FAINTEST * brightest), 1.0)


def _channel_data(
    theta_f: ArrayLike,
    values: ArrayLike,
    form: str,
    channels: Sequence[str] | None,
    uncertainty: ArrayLike | None,
) -> list[ChannelData]:
    """Checked values of every channel."""
    if form not in FORMS:
        raise _refusal("unknown form", repr(form)[:40], ", ".join(FORMS))
    theta, rho = np.asarray(theta_f, dtype=float), np.asarray(values, dtype=float)
    if theta.ndim != 1 or rho.ndim != 2 or rho.shape[0] != theta.size:
        raise _refusal("shapes do not match", f"{theta.shape} and {rho.shape}", "(g,) and (g, channels)")
    if not (np.isfinite(theta).all() and np.isfinite(rho).all()) or (rho < 0).any():
        raise _refusal("negative or undefined colour values", None, "finite values, at least 0")
    needed = FORMS[form].parameters
    if distinct(theta) < needed:
        found = f"{distinct(theta)} in {theta.size} geometries (mirrored or repeated geometries count once)"
        problem = f"too few different flake angles for the form {form}"
        raise _refusal(problem, found, f"at least {needed}", "multiangle.colours")
    rho = np.where(rho < BLACK, 0.0, rho)
    # Values of unknown uncertainty are weighted relatively, like the noise of instruments and the eye.
    scale = relative_scale(rho)
    tolerance = _CONSTANT * scale
    if uncertainty is not None:
        u = np.asarray(uncertainty, dtype=float)
        if u.shape != rho.shape or not np.isfinite(u).all() or (u <= 0).any():
            raise _refusal("invalid uncertainties", None, "one for each value, above 0")
        scale, tolerance = u, np.maximum(tolerance, _TOLERATED * u)
    names = map(str, range(1, rho.shape[1] + 1) if channels is None else channels)
    return [
        ChannelData(name, FORMS[form], theta, value, weight, limit, uncertainty is not None)
        for name, value, weight, limit in zip(names, rho.T, scale.T, tolerance.T, strict=True)
    ]


def _combined(data: Sequence[ChannelData], curves: Sequence[ChannelCurve], form: Form) -> Fit:
    return Fit(
        form,
        np.stack([fitted.amplitude for fitted in curves], axis=1),
        np.stack([fitted.decay for fitted in curves], axis=1),
        np.array([fitted.constant for fitted in curves]),
        np.stack([_covariance(*channel) for channel in zip(data, curves, strict=True)]),
    )


def _covariance(data: ChannelData, fitted: ChannelCurve) -> Array:
    """(JᵀWJ)⁻¹ of the parameters that are free, times s² of the misfits if W is unknown; NaN without degrees of freedom."""
    parameters = data.form.parameters
    covariance = np.full((parameters, parameters), np.nan)
    if data.theta.size <= parameters and not data.known:
        return covariance
    misfit = (data.predicted(fitted) - data.rho) / data.scale
    spread = 1.0 if data.known else float(misfit @ misfit) / (data.theta.size - parameters)
    slopes, free = _free_slopes(data, fitted)
    used = slopes / data.scale[:, None]
    covariance[np.ix_(free, free)] = spread * np.linalg.pinv(used.T @ used, hermitian=True)
    return covariance


def _free_slopes(data: ChannelData, fitted: ChannelCurve) -> tuple[Array, NDArray[np.bool_]]:
    """Derivatives of the values by the parameters that are not at a bound, (geometries, free), and which these are."""
    power = data.form.power
    ratio = data.theta[:, None] / fitted.decay
    falling = np.exp(-(ratio**power))
    columns = []
    for k, amplitude in enumerate(fitted.amplitude):
        columns += [falling[:, k], amplitude * falling[:, k] * power * ratio[:, k] ** power / fitted.decay[k]]
    free = np.array([*np.repeat(fitted.amplitude > 0, 2), fitted.constant > 0])
    return np.stack([*columns, np.ones_like(data.theta)], axis=1)[:, free], free


def _refusal(problem: str, found: str | None, accepted: str, key: str = "multiangle") -> InputError:
    return InputError("material.yaml", problem, where="multiangle", found=found, accepted=accepted, key=key)

"""The exact curve of one term through three points."""

from __future__ import annotations

import numpy as np

from brdfpipe.flakes.forms import BLACK, NOT_CONVEX, ROUNDING, ChannelCurve, ChannelData
from brdfpipe.geometry import Array


def three_point_curve(data: ChannelData) -> ChannelCurve:
    """The curve through three points.

    With t = θf^p and κ = B^−p, (ρ1 − ρ2)/(ρ2 − ρ3) = expm1(κ(t2 − t1)) / −expm1(−κ(t3 − t2)) rises with κ from
    (t2 − t1)/(t3 − t2), so there is one solution or none.

    Raises InputError: A, B or C would be out of range.
    """
    from scipy.optimize import brentq

    theta, rho, power = data.theta, data.rho, data.form.power
    order = np.argsort(theta)
    t, (first, second, third) = theta[order] ** power, rho[order]
    if max(first, second, third) - min(first, second, third) <= ROUNDING * max(first, 1e-300):
        return ChannelCurve(np.zeros(1), np.array([theta.max() - theta.min()]), float(rho.mean()))
    _check_fall(data, theta[order], rho[order])
    near, far = t[1] - t[0], t[2] - t[1]
    ratio = (first - second) / (second - third)

    def misfit(kappa: float) -> float:
        return float(np.expm1(kappa * near) + ratio * np.expm1(-kappa * far))

    highest = np.log1p(ratio) / near * (1 + 1e-6)  # rounding may leave the bound itself on the wrong side
    lowest = highest * 1e-9
    if misfit(lowest) >= 0:
        raise data.out_of_range("B", NOT_CONVEX)
    kappa = float(brentq(misfit, lowest, highest, xtol=1e-300, rtol=4 * np.finfo(float).eps))
    constant = third - (second - third) * np.exp(-kappa * far) / -np.expm1(-kappa * far)
    with np.errstate(over="ignore"):
        amplitude = (first - second) * np.exp(kappa * t[0]) / -np.expm1(-kappa * near)
    if not np.isfinite(amplitude):
        raise data.out_of_range("A", "the colour falls so fast with the flake angle that A would be infinite")
    if constant < -max(ROUNDING * first, BLACK):
        reason = f"the colour falls so slowly with the flake angle that C would be negative ({constant:.4g})"
        raise data.out_of_range("C", reason)
    return ChannelCurve(np.array([amplitude]), np.array([kappa ** (-1 / power)]), max(float(constant), 0.0))


def _check_fall(data: ChannelData, theta: Array, rho: Array) -> None:
    for k in (0, 1):
        if rho[k] < rho[k + 1]:
            raise data.rising(theta[k], theta[k + 1])
    if rho[0] == rho[1]:
        reason = f"the colour is the same at {theta[0]:.4g} and {theta[1]:.4g} degree and falls beyond"
        raise data.out_of_range("B", reason)
    if rho[1] == rho[2]:
        reason = f"the colour does not fall from {theta[1]:.4g} degree on, so that B would be 0"
        raise data.out_of_range("B", reason)

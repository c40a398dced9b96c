"""Forms of the spectrum of a rough surface, as a plane spectrum and as that of a line: K-correlation (ABC) and Gaussian.

References
----------
Church, Takacs & Leonard 1989, Proc. SPIE 1165, 136; Dittman 2006, Proc. SPIE 6291, 62910R.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array


class PsdError(BrdfpipeError):
    """A surface does not yield a roughness spectrum, or a spectrum is impossible."""


class KCorrelation(NamedTuple):
    """S(f) = A′ / (1 + (B f)²)^(slope/2), whose integral over the plane is σ².

    A′ = σ²B²(slope − 2)/2π and B = 2πℓ. Of slope 3 the autocovariance is σ² exp(−r/ℓ).
    """

    sigma: float
    """Rms height over all frequencies [um]."""
    length: float
    """ℓ = B/2π [um]."""
    slope: float
    """Exponent of the decay at high frequencies, above 2: C + 1 in the notation of Church."""

    def areal(self, frequency: Array) -> Array:
        """Two-sided spectrum of the plane [um4] at frequencies [um-1]."""
        b = 2 * np.pi * self.length
        peak = self.sigma**2 * b**2 * (self.slope - 2) / (2 * np.pi)
        return np.asarray(peak * (1 + (b * frequency) ** 2) ** (-self.slope / 2))

    def line(self, frequency: Array) -> Array:
        """Two-sided spectrum of a line across the surface [um3], A/(1 + (Bf)²)^(C/2), A′/A = BΓ((C + 1)/2)/(√πΓ(C/2))."""
        from scipy.special import gammaln

        b, c = 2 * np.pi * self.length, self.slope - 1
        ratio = b / np.sqrt(np.pi) * np.exp(gammaln((c + 1) / 2) - gammaln(c / 2))
        return np.asarray(self.areal(frequency) / ratio * np.sqrt(1 + (b * frequency) ** 2))

    def variance_beyond(self, frequency: float) -> float:
        """∬ S over all frequencies above one [um2]."""
        return float(self.sigma**2 * (1 + (2 * np.pi * self.length * frequency) ** 2) ** (1 - self.slope / 2))


class Gaussian(NamedTuple):
    """S(f) = πℓ²σ² exp(−π²ℓ²f²), of the autocovariance σ² exp(−r²/ℓ²)."""

    sigma: float
    """Rms height over all frequencies [um]."""
    length: float
    """ℓ, at which the autocovariance is 1/e [um]."""
    slope: float = np.nan
    """It decays faster than any power of the frequency."""

    def areal(self, frequency: Array) -> Array:
        """Two-sided spectrum of the plane [um4] at frequencies [um-1]."""
        return np.asarray(np.sqrt(np.pi) * self.length * self.line(frequency))

    def line(self, frequency: Array) -> Array:
        """Two-sided spectrum of a line across the surface [um3]."""
        return np.asarray(
            np.sqrt(np.pi) * self.length * self.sigma**2 * np.exp(-((np.pi * self.length * frequency) ** 2))
        )


class FittedForm(NamedTuple):
    """A form fitted to a spectrum."""

    model: KCorrelation | Gaussian
    uncertainty: KCorrelation
    """Standard uncertainties of its parameters; that of the slope of a Gaussian is 0."""
    residual: float
    """Rms of the logarithm of measured over fitted spectrum."""
    relative_uncertainty: Array
    """Of the fitted plane spectrum at the frequencies of the fit."""


SLOPES = (2.02, 12.0)
"""Exponents that a fit may find; that of a Gaussian surface grows without limit."""

LEAST_SHARE = 1e-4
"""Part of a ring in σ², per octave, over the largest, below which it is left out of a fit."""
_FEWEST = 4
_LEAST_SCATTER = 0.05
"""Relative departure of a real surface from the form: no ring weighs more."""


def fit(frequency: Array, density: Array, uncertainty: Array, *, line: bool = False) -> FittedForm:
    """Fit a K-correlation and a Gaussian to the logarithm of a spectrum, and return the one that fits better.

    Parameters
    ----------
    frequency, density, uncertainty : of the rings [um-1; um4, of a line um3]; all above 0, at least four. Rings whose part in σ², per
        octave, is below 1e-4 of the largest are left out, but for the four largest
    line : whether the spectrum is that of a line

    Raises
    ------
    PsdError : fewer than four frequencies.
    """
    from scipy.optimize import least_squares

    if frequency.size < _FEWEST:
        raise PsdError(
            f"the roughness spectrum has only {frequency.size} frequencies; accepted: four or more. Measure a larger area, or a longer line"
        )
    rings = density * frequency if line else density * frequency**2
    used = rings >= min(LEAST_SHARE * rings.max(), np.sort(rings)[-_FEWEST])
    all_frequencies = frequency
    frequency, density, uncertainty = frequency[used], density[used], uncertainty[used]
    spectrum: Callable[[KCorrelation, Array], Array] = KCorrelation.line if line else KCorrelation.areal
    relative = np.hypot(uncertainty / density, _LEAST_SCATTER)
    # The mean of a few modes scatters as χ²; the mean of its logarithm is low by half the relative variance.
    expected = np.log(density) + np.minimum(uncertainty / density, 1.0) ** 2 / 2

    def model(parameters: Array) -> KCorrelation:
        log_sigma, log_length, slope = parameters
        return KCorrelation(float(np.exp(log_sigma)), float(np.exp(log_length)), float(slope))

    def logarithm(parameters: Array) -> Array:
        return np.log(spectrum(model(parameters), frequency))

    def residual(parameters: Array) -> Array:
        return np.asarray((expected - logarithm(parameters)) / relative)

    sigma = np.sqrt(np.trapezoid(2 * density if line else 2 * np.pi * frequency * density, frequency))
    shortest, longest = np.log(0.01 / frequency[-1]), np.log(10 / frequency[0])
    bounds = ((-60, shortest, SLOPES[0]), (60, longest, SLOPES[1]))
    middles = np.clip(np.log(1 / (2 * np.pi * np.quantile(frequency, (0.1, 0.4, 0.7)))), shortest, longest)
    starts = [np.array([np.log(sigma), middle, slope]) for middle in middles for slope in (3.0, 5.0)]
    solutions = [least_squares(residual, start, bounds=bounds, x_scale=(0.1, 0.1, 0.3)) for start in starts]
    best = min(solutions, key=lambda solution: solution.cost)
    gaussian = _gaussian(frequency, expected, relative, line)
    if gaussian is not None and gaussian[1] < 2 * best.cost:
        return _fitted_gaussian(*gaussian, frequency, relative, all_frequencies, line)
    scale = max(1.0, 2 * best.cost / max(1, frequency.size - 3))
    jacobian = np.asarray(best.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * scale
    found = model(best.x)
    u_sigma, u_length, u_slope = np.sqrt(np.diag(covariance))
    step = 1e-5
    moved = [np.log(model(best.x + step * row).areal(all_frequencies)) for row in np.eye(3)]
    derivative = (np.array(moved) - np.log(found.areal(all_frequencies))) / step
    return FittedForm(
        found,
        KCorrelation(float(u_sigma * found.sigma), float(u_length * found.length), float(u_slope)),
        float(np.sqrt(np.mean((residual(best.x) * relative) ** 2))),
        np.sqrt(np.einsum("ik,ij,jk->k", derivative, covariance, derivative)),
    )


def _gaussian(
    frequency: Array, log_density: Array, relative: Array, line: bool
) -> tuple[Gaussian, float, float] | None:
    """The Gaussian whose logarithm, linear in f², fits best; its χ² and its residual. None where the spectrum does not fall."""
    matrix = np.stack([np.ones_like(frequency), -((np.pi * frequency) ** 2)], axis=1)
    (level, square), *_ = np.linalg.lstsq(matrix / relative[:, None], log_density / relative, rcond=None)
    if not square > 0:
        return None
    length = float(np.sqrt(square))
    misfit = log_density - matrix @ (level, square)
    area = np.sqrt(np.pi) * length if line else np.pi * square
    found = Gaussian(float(np.sqrt(np.exp(level) / area)), length)
    return found, float(np.square(misfit / relative).sum()), float(np.sqrt(np.mean(misfit**2)))


def _fitted_gaussian(
    found: Gaussian,
    misfit: float,
    residual: float,
    frequency: Array,
    relative: Array,
    all_frequencies: Array,
    line: bool,
) -> FittedForm:
    """With the uncertainties of log σ, log ℓ and of the plane spectrum at all frequencies."""

    def derivative(at: Array, power: int) -> Array:
        """Of log S, or log W, by log σ and log ℓ; the spectrum grows as ℓ to a power."""
        return np.stack([np.full_like(at, 2.0), power - 2 * (np.pi * found.length * at) ** 2], axis=1)

    jacobian = derivative(frequency, 1 if line else 2) / relative[:, None]
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * max(1.0, misfit / max(1, frequency.size - 2))
    u_sigma, u_length = np.sqrt(np.diag(covariance))
    areal = derivative(all_frequencies, 2)
    return FittedForm(
        found,
        KCorrelation(float(u_sigma * found.sigma), float(u_length * found.length), 0.0),
        residual,
        np.sqrt(np.einsum("ki,ij,kj->k", areal, covariance, areal)),
    )

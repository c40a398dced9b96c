"""What a positive quantity is for a material on which it was not measured, and how surely: its logarithm regressed on features.

Gaussian process regression with a constant mean and Matérn's covariance of smoothness 5/2, which has a length of its own for each feature
(Rasmussen and Williams 2006, Gaussian processes for machine learning, sections 2.2, 4.2.1, 5.4). Far from all materials that were
measured, it knows no more than the scatter of them all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from brdfpipe.geometry import Array

LEAST = 8
"""Measured materials below which nothing is predicted."""

_EXPECTED = {"amplitude": 0.3, "noise": -1.5, "length": 1.5}
"""Logarithms of the parameters that are expected: amplitude and noise of the logarithm, lengths in the units of the features."""
_SPREAD = 1.0
"""Standard deviation of these logarithms about what is expected."""
_RANGES = {"amplitude": (-3.0, 3.0), "noise": (-4.0, 3.0), "length": (-3.0, 6.0)}
"""Ranges of these logarithms, in which no covariance is singular."""
_MEAN_VARIANCE = 4.0
"""Variance of the constant mean, which is not known beforehand."""


class Prediction(NamedTuple):
    """Of the logarithm."""

    mean: float
    deviation: float
    """Standard deviation, > 0"""

    def bound(self, deviations: float) -> float:
        """The quantity so many standard deviations above its expected value; below it where negative."""
        return math.exp(self.mean + deviations * self.deviation)


@dataclass(frozen=True)
class Regression:
    """Logarithms of a quantity on materials, with the parameters of the covariance."""

    features: Array
    """(materials, features), in units of their spread"""
    logarithms: Array
    parameters: tuple[float, ...]
    """Logarithms of the amplitude, the noise and the length of each feature"""

    @classmethod
    def fitted(cls, features: Array, values: Array) -> Regression:
        """With the parameters of the largest posterior probability.

        Parameters
        ----------
        features : (materials, features), in units of their spread
        values : of the materials, > 0
        """
        logarithms = np.log(values)
        start = np.array(expected_parameters(features.shape[1]))
        bounds = [_RANGES["amplitude"], _RANGES["noise"], *[_RANGES["length"]] * features.shape[1]]
        found = minimize(_cost, start, args=(features, logarithms), jac=True, method="L-BFGS-B", bounds=bounds)
        return cls(features, logarithms, tuple(float(value) for value in found.x))

    def at(self, features: Sequence[float]) -> Prediction:
        """The logarithm of the quantity for a material, with the scatter of single materials."""
        factor, weights = self._solved
        near = _covariance(np.atleast_2d(features), self.features, self.parameters) + _MEAN_VARIANCE
        own = math.exp(2 * self.parameters[0]) + math.exp(2 * self.parameters[1]) + _MEAN_VARIANCE
        variance = own - float((near @ cho_solve(factor, near.T))[0, 0])
        return Prediction(float((near @ weights)[0]), math.sqrt(max(variance, math.exp(2 * self.parameters[1]))))

    def left_out(self) -> list[Prediction]:
        """The prediction for each material from the others, with the parameters of all (section 5.4.2)."""
        factor, weights = self._solved
        precision = np.diag(cho_solve(factor, np.eye(self.logarithms.size)))
        means = self.logarithms - weights / precision
        return [Prediction(float(mean), 1 / math.sqrt(p)) for mean, p in zip(means, precision, strict=True)]

    @cached_property
    def _solved(self) -> tuple[tuple[Array, bool], Array]:
        factor = cho_factor(_with_noise(_covariance(self.features, self.features, self.parameters), self.parameters))
        return factor, cho_solve(factor, self.logarithms)


def expected_parameters(features: int) -> tuple[float, ...]:
    """Parameters before any material was measured, for a number of features."""
    return (_EXPECTED["amplitude"], _EXPECTED["noise"], *[_EXPECTED["length"]] * features)


def _covariance(one: Array, other: Array, parameters: Sequence[float]) -> Array:
    lengths = np.exp(np.asarray(parameters[2:]))
    away = math.sqrt(5) * cdist(one / lengths, other / lengths)
    return np.asarray(math.exp(2 * parameters[0]) * (1 + away + away**2 / 3) * np.exp(-away))


def _with_noise(covariance: Array, parameters: Sequence[float]) -> Array:
    return covariance + math.exp(2 * parameters[1]) * np.eye(len(covariance)) + _MEAN_VARIANCE


def _cost(parameters: Array, features: Array, logarithms: Array) -> tuple[float, Array]:
    """Negative logarithm of the posterior probability of the parameters, and its gradient."""
    given = parameters.tolist()
    # √5 times the distance in lengths, and its share by feature, squared.
    squared = 5 * ((features[:, None] - features[None]) / np.exp(np.asarray(given[2:]))) ** 2
    away = np.sqrt(squared.sum(axis=-1))
    amplitude, noise = math.exp(2 * given[0]), math.exp(2 * given[1])
    decay = np.exp(-away)
    covariance = amplitude * (1 + away + away**2 / 3) * decay
    factor = cho_factor(_with_noise(covariance, given))
    weights = cho_solve(factor, logarithms)
    inverse = cho_solve(factor, np.eye(logarithms.size))
    off = (parameters - expected_parameters(features.shape[1])) / _SPREAD
    value = logarithms @ weights / 2 + np.log(np.diag(factor[0])).sum() + (off**2).sum() / 2
    slope = inverse - np.outer(weights, weights)
    by_length = np.einsum("ij,ijk->k", slope * amplitude * (1 + away) * decay / 3, squared)
    gradient = np.array([(slope * covariance).sum(), noise * np.trace(slope), *(by_length / 2)])
    return float(value), gradient + off / _SPREAD

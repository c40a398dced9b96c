"""Generalised least squares: the inputs of a model that agree best with a measurement and with what was known of them before.

Minimised is rᵀ C⁻¹ r + Σ (Δ/u)², with r measured less modelled, C the covariance of the values and u the standard uncertainties of the
inputs. Common errors are not estimated one by one: C holds them, which is the same as fitting each with a prior of one standard
uncertainty.

References
----------
JCGM 100:2008 (GUM); Rodgers 2000, Inverse Methods for Atmospheric Sounding, ch. 5 (Gauss–Newton with a prior); Deuflhard 2004, Newton
Methods for Nonlinear Problems (the natural monotonicity test); Birge 1932 (Phys. Rev. 40, 207)
for the enlarged uncertainties of data that scatter more than they say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np

from brdfpipe.comparison.measurement import Covariance, Measurement
from brdfpipe.geometry import Array

_TOLERANCES = (0.3, 0.1, 0.03, 0.0)
"""Relative uncertainties of the model to start with: where it is far off, small weights on bright cells lead to the valley."""
_FAR_OFF = 100.0
"""χ² over the degrees of freedom above which they are needed."""
_STEPS = 20
_HALVINGS = 5
_CONVERGED = 1e-2
"""Gain in χ², over that of a degree of freedom, below which no further step is taken: a step of 0.1 standard uncertainties."""
_LONGEST = 3.0
"""Of a step, in prior standard uncertainties: farther out the tangent tells nothing."""


class Model(Protocol):
    """What a model with some inputs says of the cells; fields are (incidence, wavelength, cell)."""

    @property
    def values(self) -> Array:
        """BRDF [sr-1]."""

    @property
    def own_u(self) -> Array:
        """Standard uncertainty that each value has for itself [sr-1]."""

    @property
    def common(self) -> Array:
        """Changes (error, …) of the values by errors that many of them share, of one standard uncertainty each [sr-1]."""

    def slopes(self) -> Array:
        """Change of the values (input, …) as each input changes by one prior standard uncertainty."""


AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Adjusted(Generic[AnyModel]):
    """The outcome; changes are in prior standard uncertainties."""

    change: Array
    """(input,)"""
    model: AnyModel
    """With the changes in it."""
    spread: Array
    """(input, input) covariance of the changes, enlarged where the data scatter more than they say."""
    enlarged: float
    """By how much the uncertainties of the data were enlarged for it; 1 or more."""
    covariance: Covariance
    """Of the values."""
    converged: bool


class _State(Generic[AnyModel]):
    """Changes, the model with them, and how it fits."""

    def __init__(self, measurement: Measurement, change: Array, model: AnyModel, tolerance: float) -> None:
        self.change, self.model = change, model
        off = tolerance * np.maximum(np.abs(measurement.value), model.values)
        self.covariance = measurement.covariance(model.values, np.hypot(model.own_u, off), model.common)
        self.residual = measurement.value - model.values

    @cached_property
    def chi_squared(self) -> float:
        return self.covariance.chi_squared(self.residual)

    def objective(self, other: _State[AnyModel]) -> float:
        """Sum of squares, that of the prior included, of another state under the covariance of this one."""
        return self.covariance.chi_squared(other.residual) + float(other.change @ other.change)

    @cached_property
    def normal_equations(self) -> tuple[Array, Array]:
        """The data's part of the matrix (input, input), and how steeply the objective falls (input,)."""
        slopes, residual = self.covariance.whitened(self.model.slopes()), self.covariance.whitened(self.residual[None])
        both = self.covariance.products(slopes, np.concatenate([slopes, residual]))
        return both[:, :-1], both[:, -1] - self.change

    @cached_property
    def step(self) -> Array:
        """From here to the least of the objective, as the tangent has it."""
        hessian, gradient = self.normal_equations
        return np.asarray(np.linalg.solve(hessian + np.eye(gradient.size), gradient))

    @property
    def gain(self) -> float:
        """By how much the step lowers the objective, as the tangent has it: the square of its length in standard uncertainties."""
        return float(self.step @ self.normal_equations[1])


def adjust(
    measurement: Measurement, model: Callable[[Array], AnyModel], inputs: int, start: AnyModel
) -> Adjusted[AnyModel]:
    """Change inputs until model and measurement agree best.

    Parameters
    ----------
    measurement : the values
    model : of the changes (input,) of its inputs, in prior standard uncertainties
    inputs : how many there are
    start : the model without a change

    Notes
    -----
    Gauss–Newton. The covariance is that of a right model and is taken anew at each step, so that there is no one sum of squares that must
    fall: a step is good if it lowers the present one, or if the next step is shorter.
    """
    freedom = max(int(measurement.used.sum()) - inputs, 1)
    state = _State(measurement, np.zeros(inputs), start, 0.0)
    for tolerance in _TOLERANCES if state.chi_squared > _FAR_OFF * freedom else _TOLERANCES[-1:]:
        state = _State(measurement, state.change, state.model, tolerance)
        enough = _CONVERGED if tolerance == 0 else 1.0
        for _ in range(_STEPS):
            converged = state.gain < enough * max(1.0, state.chi_squared / freedom)
            following = None if converged else _nearer(measurement, model, state, tolerance)
            if following is None:
                break
            state = following
    scatter = max(1.0, state.chi_squared / freedom)
    spread = np.asarray(np.linalg.inv(state.normal_equations[0] / scatter + np.eye(inputs)))
    return Adjusted(state.change, state.model, spread, float(np.sqrt(scatter)), state.covariance, converged)


def _nearer(
    measurement: Measurement, model: Callable[[Array], AnyModel], state: _State[AnyModel], tolerance: float
) -> _State[AnyModel] | None:
    """After the first of ever shorter steps that is a good one; None where none is."""
    step = state.step * min(1.0, _LONGEST / float(np.abs(state.step).max()))
    for halving in range(_HALVINGS):
        change = state.change + step / 2**halving
        tried = _State(measurement, change, model(change), tolerance)
        if state.objective(tried) < state.objective(state) or tried.gain < state.gain:
            return tried
    return None

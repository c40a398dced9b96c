"""Generalised least squares (JCGM 100:2008): the inputs of a model that agree best with a measurement and with their priors.

Minimises rᵀ C⁻¹ r + Σ (Δ/u)², with r measured less modelled, C the covariance of the values and u the standard uncertainties of the inputs.
C includes common errors, which is the same as fitting each with a prior of one standard uncertainty.
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
"""Successive relative uncertainties of a model far from the data: small weights of bright cells make the steps reach the minimum."""
_FAR_OFF = 100.0  # χ² over the degrees of freedom above which these are needed
_STEPS = 20
_HALVINGS = 5
_CONVERGED = 1e-2  # gain in χ², over χ² per degree of freedom, that ends the search: 0.1 standard uncertainties
_LONGEST_STEP = 3.0  # in prior standard uncertainties: the tangent is not valid farther out


class Model(Protocol):
    """A model at the cells; fields are (incidence, wavelength, cell)."""

    @property
    def values(self) -> Array:
        """BRDF [sr-1]."""

    @property
    def own_u(self) -> Array:
        """Standard uncertainty independent from value to value [sr-1]."""

    @property
    def common(self) -> Array:
        """Changes (error, …) of the values by common errors of one standard uncertainty each [sr-1]."""

    def slopes(self) -> Array:
        """Change of the values (input, …) as each input changes by one prior standard uncertainty."""


AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Adjusted(Generic[AnyModel]):
    """The result of a fit; changes are in prior standard uncertainties."""

    change: Array  # (input,)
    model: AnyModel  # the model with the changes
    spread: Array
    """(input, input) covariance of the changes, enlarged if the data scatter more than their uncertainties."""
    enlarged: float
    """Factor by which the uncertainties of the data were enlarged for it; 1 or more (Birge 1932, Phys. Rev. 40, 207)."""
    covariance: Covariance  # of the values
    converged: bool


class _State(Generic[AnyModel]):
    """Changes, the model with these, and its agreement with the measurement."""

    def __init__(self, measurement: Measurement, change: Array, model: AnyModel, tolerance: float) -> None:
        self.change, self.model = change, model
        off = tolerance * np.maximum(np.abs(measurement.value), model.values)
        self.covariance = measurement.covariance(model.values, np.hypot(model.own_u, off), model.common)
        self.residual = measurement.value - model.values

    @cached_property
    def chi_squared(self) -> float:
        return self.covariance.chi_squared(self.residual)

    def objective(self, other: _State[AnyModel]) -> float:
        """Sum of squares, with that of the prior, of another state under the covariance of this one."""
        return self.covariance.chi_squared(other.residual) + float(other.change @ other.change)

    @cached_property
    def normal_equations(self) -> tuple[Array, Array]:
        """The data's part of the Hessian (input, input), and the negative gradient of the objective (input,)."""
        slopes, residual = self.covariance.whitened(self.model.slopes()), self.covariance.whitened(self.residual[None])
        both = self.covariance.products(slopes, np.concatenate([slopes, residual]))
        return both[:, :-1], both[:, -1] - self.change

    @cached_property
    def step(self) -> Array:
        """Gauss–Newton step to the minimum."""
        hessian, gradient = self.normal_equations
        return np.asarray(np.linalg.solve(hessian + np.eye(gradient.size), gradient))

    @property
    def gain(self) -> float:
        """Expected decrease of the objective by the step: its squared length in standard uncertainties."""
        return float(self.step @ self.normal_equations[1])


def adjust(
    measurement: Measurement, model: Callable[[Array], AnyModel], inputs: int, start: AnyModel
) -> Adjusted[AnyModel]:
    """Change inputs until model and measurement agree best.

    Parameters
    ----------
    measurement : the values
    model : function of the changes (input,) of its inputs, in prior standard uncertainties
    inputs : their number
    start : the model without a change

    Notes
    -----
    Gauss–Newton with a prior (Rodgers 2000, Inverse Methods for Atmospheric Sounding, ch. 5). The covariance is that of a correct model and
    computed anew at each step, so no single sum of squares must decrease: a step is accepted if it lowers the present one, or if the next
    step is shorter (natural monotonicity test: Deuflhard 2004, Newton Methods for Nonlinear Problems).
    """
    freedom = max(int(measurement.used.sum()) - inputs, 1)
    state = _State(measurement, np.zeros(inputs), start, 0.0)
    for tolerance in _TOLERANCES if state.chi_squared > _FAR_OFF * freedom else _TOLERANCES[-1:]:
        state = _State(measurement, state.change, state.model, tolerance)
        enough = _CONVERGED if tolerance == 0 else 1.0
        for _ in range(_STEPS):
            converged = state.gain < enough * max(1.0, state.chi_squared / freedom)
            better = None if converged else _better_state(measurement, model, state, tolerance)
            if better is None:
                break
            state = better
    scatter = max(1.0, state.chi_squared / freedom)
    spread = np.asarray(np.linalg.inv(state.normal_equations[0] / scatter + np.eye(inputs)))
    return Adjusted(state.change, state.model, spread, float(np.sqrt(scatter)), state.covariance, converged)


def _better_state(
    measurement: Measurement, model: Callable[[Array], AnyModel], state: _State[AnyModel], tolerance: float
) -> _State[AnyModel] | None:
    """The state after the first accepted of successively halved steps; None if none is."""
    step = state.step * min(1.0, _LONGEST_STEP / float(np.abs(state.step).max()))
    for halving in range(_HALVINGS):
        change = state.change + step / 2**halving
        trial = _State(measurement, change, model(change), tolerance)
        if state.objective(trial) < state.objective(state) or trial.gain < state.gain:
            return trial
    return None

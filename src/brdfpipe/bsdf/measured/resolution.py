"""The error of a smoothed BSDF between cells, and knots, that do not resolve it: of a lobe's edge, or of a lobe narrower than the cells."""

from __future__ import annotations

import numpy as np

from brdfpipe.bsdf.measured.least_squares import Decomposition, StandardForm
from brdfpipe.geometry import Array

RESOLUTION = "resolution"
"""Name of this component of the uncertainty."""

_SIGNIFICANT = 2.0  # standard deviations beyond which errors of predicted cells are not those of noise
_MISSED = 1.5  # size of the error between cells over that at cells: where the change is 0, the error need not be
_LARGEST_LEVERAGE = 0.95  # of a cell: of larger ones the error of a prediction without it is all noise


def unresolved(
    coarser: StandardForm, fit: Decomposition, weight: Array, response: Array, strength: float, factor: Array
) -> Array:
    """Change of the coefficients (wavelength, terms of the basis) by one standard uncertainty of the error of the fit between the cells.

    Where it errs, and to which side, shows its change with every second knot. By how much shows the error with which the fit predicts a cell
    that is left out, as far as it exceeds the noise: nothing, where the BSDF is resolved.

    Parameters
    ----------
    coarser : the functions with every second knot, at the cells
    fit : of all knots
    weight, response : of the cells, (wavelength, cell); weights of unused cells are 0
    strength : of the penalty
    factor : of the covariance of the coefficients in standard form, (wavelength, coefficients, any)
    """
    other = Decomposition.of(coarser, weight, response)
    coefficients, changed = fit.solution(strength), other.solution(strength)
    fitted = coefficients @ fit.form.rows.T
    residual = (response - fitted) * weight
    leverage = np.minimum(((fit.form.rows @ factor) ** 2).sum(axis=-1) * weight**2, _LARGEST_LEVERAGE)
    expected = (weight > 0) / (1 - leverage)
    # Noise that was stated too small enlarges the uncertainty otherwise.
    left = np.maximum(fit.counts - fit.effective_parameters(np.array([strength]))[:, 0], 1.0)
    variance = expected * np.maximum((residual**2).sum(axis=1) / left, 1.0)[:, None]
    excess = ((residual * expected) ** 2).sum() - variance.sum() - _SIGNIFICANT * np.sqrt(2 * (variance**2).sum())
    change = (((changed @ coarser.rows.T - fitted) * weight) ** 2).sum()
    size = _MISSED * np.sqrt(np.clip(excess / max(change, 1e-300), 0.0, 1.0))
    return np.asarray(size * (changed @ coarser.to_basis.T - coefficients @ fit.form.to_basis.T))

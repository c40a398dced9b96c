"""The error of a smoothed BSDF by what its cells do not tell: how another basis, or another prior, would change it.

The cells themselves cannot tell: the fit meets every ring of them, and errs between two rings; few of them see light leave near the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from brdfpipe.bsdf.measured.basis import RESOLUTION, TOWARDS_GRAZING
from brdfpipe.bsdf.measured.least_squares import Decomposition, StandardForm
from brdfpipe.geometry import Array

SHARES: Mapping[str, float] = {RESOLUTION: 0.25, TOWARDS_GRAZING: float(1 / np.sqrt(3))}
"""Error of the fit over its change: with every second knot, and with harmonics of the functions of cos θ_o that are resisted no more than these functions.
At the edge of a lobe 1.5° wide it is 0.3 to 0.6 of that with every second knot, at wider ones less than 0.1. Of the two resistances neither is more
likely: the truth may be anywhere from one fit to the other, a rectangular distribution from 0 to 1."""


def unresolved(
    name: str, other: StandardForm, fit: Decomposition, weight: Array, response: Array, strength: float
) -> Array:
    """Change of the coefficients (wavelength, terms of the basis) by one standard uncertainty of a component of :data:`SHARES`.

    It is a share of the change of the fit with another form. That is next to nothing where the BSDF is smooth, and where many cells determine it.

    Parameters
    ----------
    other : the functions with every second knot, or of less resistance, at the cells
    fit : of all knots
    weight, response : of the cells, (wavelength, cell); weights of unused cells are 0
    strength : of the penalty
    """
    changed = Decomposition.of(other, weight, response).solution(strength)
    return np.asarray(SHARES[name] * (changed @ other.to_basis.T - fit.solution(strength) @ fit.form.to_basis.T))

"""The error of a smoothed BSDF between cells, and knots, that do not resolve it: of a lobe's edge, or of a lobe narrower than the cells.

The cells themselves cannot tell: the fit meets every ring of them, and errs between two rings.
"""

from __future__ import annotations

import numpy as np

from brdfpipe.bsdf.measured.least_squares import Decomposition, StandardForm
from brdfpipe.geometry import Array

_SHARE = 0.25
"""Error of the fit over its change with every second knot. At the edge of a lobe 1.5° wide it is 0.3 to 0.6, at wider ones less than 0.1."""


def unresolved(coarser: StandardForm, fit: Decomposition, weight: Array, response: Array, strength: float) -> Array:
    """Change of the coefficients (wavelength, terms of the basis) by one standard uncertainty of the error of the fit between the cells.

    It is a share of the change of the fit with every second knot. That is next to nothing where the BSDF is smooth.

    Parameters
    ----------
    coarser : the functions with every second knot, at the cells
    fit : of all knots
    weight, response : of the cells, (wavelength, cell); weights of unused cells are 0
    strength : of the penalty
    """
    changed = Decomposition.of(coarser, weight, response).solution(strength)
    return np.asarray(_SHARE * (changed @ coarser.to_basis.T - fit.solution(strength) @ fit.form.to_basis.T))

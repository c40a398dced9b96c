"""How a ``bsdf`` dataset stores the changes by its uncertain inputs: names, and nodes of the incidence."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from brdfpipe.geometry import Array

DIMENSION, SOURCE = "uncertain_change", "uncertainty_source"
"""Dimension of the changes, and the variable that names the input of each."""
MODEL = "model"
"""Source of the error of the model itself."""
NOT_STATED = "uncertainty_not_stated"
"""Attribute: sources without a stated uncertainty, separated by commas."""


def between_incidences(nodes: Array, changes: Array, theta: Array) -> Array:
    """Changes of an albedo (nodes, …) at other incidences, (theta, …)."""
    return np.asarray(CubicSpline(nodes, changes)(theta))

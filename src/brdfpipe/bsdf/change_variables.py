"""How a ``bsdf`` dataset stores the changes by its uncertain inputs: names, and nodes of the incidence."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from brdfpipe.geometry import Array

DIMENSION, SOURCE = "uncertain_change", "uncertainty_source"
"""Dimension of the changes, and the variable that names the input of each."""
MODEL = "model"
"""Source of the error of the model itself."""
MODEL_INCIDENCES = np.array([0.0, 20.0, 40.0, 60.0, 75.0, 85.0])
"""Angles of incidence at which the light of a model is compared [degree]; gloss at those of gloss meters among them."""
MODEL_REGIONS = {"peak": 0.3, "shoulder": 0.03, "rest": 0.0}
"""Regions of its error by the smallest share of the predicted peak [1]."""
OF_MAP = ("facets", "psd")
"""Sources of the chance that a finite map is not the mean of its surface."""
NOT_STATED = "uncertainty_not_stated"
"""Attribute: sources without a stated uncertainty, separated by commas."""


def between_phases(nodes: Array, changes: Array, phase_variance: Array) -> Array:
    """Changes of a halo (nodes, frequency) at other phase variances (phase variance, frequency), linear in the logarithm."""
    log_nodes, log_phase = np.log(nodes), np.log(phase_variance)
    node = np.clip(np.searchsorted(log_nodes, log_phase, side="right") - 1, 0, nodes.size - 2)
    slope = np.diff(changes, axis=0) / np.diff(log_nodes)[:, None]
    return np.asarray(slope[node] * (log_phase - log_nodes[node])[:, None] + changes[node])


def between_incidences(nodes: Array, changes: Array, theta: Array) -> Array:
    """Changes of an albedo (nodes, …) at other incidences, (theta, …)."""
    return np.asarray(CubicSpline(nodes, changes)(theta))

"""Slope densities from Beckmann's to GGX: Student's t of two variables, whose tail is a parameter.

P22(s) = (1 + t s²/a²)^(−1 − 1/t) / (π a²), with the width a and the tail t. t = 1 is GGX, t → 0 is Beckmann's Gaussian. Slopes of real finishes lie between
them.

References
----------
Ribardière et al. 2017 (EGSR), *STD: Student's t-distribution of slopes for microfacet based BSDFs*; their γ is 1 + 1/t.
"""

from __future__ import annotations

import math

import numpy as np

from brdfpipe.geometry import Array

_LEAST_LOG = -690.0
"""Logarithm of the smallest density over the largest: it stays a positive number."""

_GAUSSIAN = 1e-9
"""Tails below this are Beckmann's."""


def density(slope: Array, a: float, tail: float) -> Array:
    """P22 at slopes [1] of any shape.

    Parameters
    ----------
    slope : magnitude
    a : width, above 0 [1]
    tail : 0 for Beckmann, 1 for GGX [1]
    """
    square = (np.asarray(slope, dtype=float) / a) ** 2
    falls = -square if tail < _GAUSSIAN else -(1 + 1 / tail) * np.log1p(tail * square)
    return np.asarray(np.exp(np.maximum(falls, _LEAST_LOG)) / (np.pi * a**2))


def median_over_width(tail: float) -> float:
    """Slope that half of the facets exceed, over the width a: 1 for GGX, √ln 2 for Beckmann."""
    return math.sqrt(math.log(2) if tail < _GAUSSIAN else (2**tail - 1) / tail)

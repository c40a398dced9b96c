"""Smith's Λ of named slope densities; G1 = 1/(1 + Λ)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx

from brdfpipe.geometry import Array


def beckmann_lambda(theta: ArrayLike, width: float) -> Array:
    """Λ(θ) of Beckmann facets of a width [1], θ in degree (Heitz 2014, eq. 73)."""
    nu = 1 / (width * np.tan(np.radians(np.clip(theta, 1e-9, 90 - 1e-9))))
    return np.asarray(np.exp(-(nu**2)) * (1 / (nu * np.sqrt(np.pi)) - erfcx(nu)) / 2)


def ggx_lambda(theta: ArrayLike, width: float) -> Array:
    """Λ(θ) of GGX facets of a width [1], θ in degree (Walter 2007, eq. 34)."""
    square = (width * np.tan(np.radians(theta))) ** 2
    # The root less 1, over 2, would cancel for smooth surfaces.
    return np.asarray(square / (1 + np.sqrt(1 + square)) / 2)

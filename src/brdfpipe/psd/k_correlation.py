"""The K-correlation (ABC) spectrum of a rough surface, as a plane spectrum and as that of a line.

References
----------
Church, Takacs & Leonard 1989, Proc. SPIE 1165, 136; Dittman 2006, Proc. SPIE 6291, 62910R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array


class PsdError(BrdfpipeError):
    """A surface does not yield a roughness spectrum, or a spectrum is impossible."""


class KCorrelation(NamedTuple):
    """S(f) = A′ / (1 + (B f)²)^(slope/2), whose integral over the plane is σ².

    A′ = σ²B²(slope − 2)/2π and B = 2πℓ. Of slope 3 the autocovariance is σ² exp(−r/ℓ).
    """

    sigma: float
    """Rms height over all frequencies [um]."""
    length: float
    """ℓ = B/2π [um]."""
    slope: float
    """Exponent of the decay at high frequencies, above 2: C + 1 in the notation of Church."""

    def areal(self, frequency: Array) -> Array:
        """Two-sided spectrum of the plane [um4] at frequencies [um-1]."""
        b = 2 * np.pi * self.length
        peak = self.sigma**2 * b**2 * (self.slope - 2) / (2 * np.pi)
        return np.asarray(peak * (1 + (b * frequency) ** 2) ** (-self.slope / 2))

    def variance_beyond(self, frequency: float) -> float:
        """∬ S over all frequencies above one [um2]."""
        return float(self.sigma**2 * (1 + (2 * np.pi * self.length * frequency) ** 2) ** (1 - self.slope / 2))

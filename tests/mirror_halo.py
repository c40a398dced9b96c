"""The halo of a perfect mirror by numpy, one direction after the other: what compiled sums over a lobe are compared with."""

from __future__ import annotations

import numpy as np

from brdfpipe.bsdf.wave.two_scale import Angles, RoughSurface, tilted_share
from brdfpipe.geometry import half_vector


def halo_of_mirrors(surface: RoughSurface, angles: Angles, wavelength: np.ndarray) -> np.ndarray:
    """BRDF of the halo before it is matched [sr-1], (directions, wavelength, 3), of directions above the surface.

    What reflects as waves, what reflects as tilted facets, and the first order without its loss to higher ones.
    """
    halo, relief = surface.halo, surface.relief
    assert halo is not None
    assert relief is not None
    pair, azimuths = half_vector(*angles), (angles[1], angles[3])
    tilted = tilted_share(pair, relief.surface.visibility(pair, *azimuths, relief.masking))
    low, high = halo.by_order(pair, azimuths, wavelength, tilted)
    return np.stack([low, high, halo.first_strength(pair, azimuths, wavelength)], axis=-1)

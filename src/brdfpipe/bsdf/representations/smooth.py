"""The representation ``smooth``: a perfectly smooth interface over a diffuse base, or over a transparent body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from brdfpipe.bsdf.representations.microfacet import INTERFACE_KIND, Interface
from brdfpipe.geometry import Array

_UNRESOLVED_SLOPE = 1e-6
"""A slope that no instrument resolves."""


class Smooth(Interface):
    """A mirror: its image is no density, but a share of the light (:meth:`specular`)."""

    name = "smooth"
    kind = INTERFACE_KIND

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        """What the surface mirrors, and refracts, into one single direction each."""
        model = self._model(wavelength)
        bare = replace(model, diffuse=np.zeros(1))
        return bare.directional_albedo(theta_i, phi_i), model.transmittance(theta_i, phi_i)

    @property
    def lobe_slope(self) -> float:
        return _UNRESOLVED_SLOPE

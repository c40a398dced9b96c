"""A BSDF that defines nothing but its values: what works on it works for every representation."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import REPRESENTATIONS
from brdfpipe.geometry import unit_vector


def register(monkeypatch, brdf, *, transmission="none", **members) -> xr.Dataset:
    """A dataset whose BSDF is ``brdf(w_i, w_o)`` of unit vectors (…, 3), in sr-1; ``members`` replace those of the class."""

    def evaluate(self, theta_i, phi_i, theta_o, phi_o, wavelength):
        return np.asarray(brdf(unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)))[..., None]

    def nonspectral(self, weight):
        return self.dataset

    monkeypatch.setitem(vocabulary.REPRESENTATIONS, "synthetic", vocabulary.Kind({}))
    own = {"name": "synthetic", "kind": vocabulary.Kind({}), "evaluate": evaluate, "nonspectral": nonspectral}
    monkeypatch.setitem(REPRESENTATIONS, "synthetic", type("Synthetic", (Representation,), own | members))
    return xr.Dataset(attrs={"kind": "bsdf", "representation": "synthetic", "transmission": transmission})


def cap_lobe(theta, phi, kappa):
    """A von Mises–Fisher lobe about a fixed direction, normalised so that ∫ f |cos θ_o| dω_o = 1 over all directions of its side."""
    axis = unit_vector(theta, phi)

    def brdf(_w_i, w_o):
        cosine = w_o @ axis
        density = kappa / (2 * np.pi * (1 - np.exp(-2 * kappa))) * np.exp(kappa * (cosine - 1))
        return density / np.abs(w_o[..., 2])

    return brdf

"""A BSDF that tells nothing but its values: what works on it works for every representation."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace
from typing import cast

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import representations
from brdfpipe.geometry import unit_vector


def register(monkeypatch, brdf, *, transmission="none", **functions) -> xr.Dataset:
    """A dataset whose BSDF is ``brdf(w_i, w_o)`` of unit vectors (…, 3), in sr-1."""

    def evaluate(_bsdf, theta_i, phi_i, theta_o, phi_o, _wavelength):
        return np.asarray(brdf(unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)))[..., None]

    module = SimpleNamespace(evaluate=evaluate, nonspectral=lambda bsdf, _weight: bsdf, **functions)
    monkeypatch.setitem(representations._MODULES, "synthetic", cast(ModuleType, module))
    monkeypatch.setitem(vocabulary.REPRESENTATIONS, "synthetic", vocabulary.Kind({}))
    return xr.Dataset(attrs={"kind": "bsdf", "representation": "synthetic", "transmission": transmission})


def cap_lobe(theta, phi, kappa):
    """A von Mises–Fisher lobe about a fixed direction, normalised so that ∫ f |cos θ_o| dω_o = 1 over all directions of its side."""
    axis = unit_vector(theta, phi)

    def brdf(_w_i, w_o):
        cosine = w_o @ axis
        density = kappa / (2 * np.pi * (1 - np.exp(-2 * kappa))) * np.exp(kappa * (cosine - 1))
        return density / np.abs(w_o[..., 2])

    return brdf

"""Light that coherent part and halo miss of Fresnel's reflectance: from when on that matters, and what to do then."""

from __future__ import annotations

import xarray as xr

LIMITS = 0.01, 0.05
"""Shares of the incident light above which there is a warning, and above which the prediction fails."""


def advice(bsdf: xr.Dataset) -> str:
    """What to do about missed light of a ``bsdf`` dataset, representation ``wave``; keys of descriptions in backticks."""
    if bsdf.attrs["optics"] == "wave":
        return "Set `model.optics: auto`"
    return "Measure a larger area with fewer missing heights, or set `model.truth: use`"

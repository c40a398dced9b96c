"""Luminous reflectance and transmittance of a material: total shares of the light, weighted with V(λ) and D65."""

from __future__ import annotations

import math

from brdfpipe.appearance.origin import Datasets, is_measured
from brdfpipe.appearance.transmission import luminous_transmittance as transmittance_of_bsdf
from brdfpipe.bsdf.registry import representation
from brdfpipe.spectra.colorimetry import reflectance_to_xyz


def luminous_reflectance(datasets: Datasets) -> float:
    """Total reflectance at 8° [1]; NaN where it is not known."""
    if "appearance" in datasets and "luminous_reflectance" in datasets["appearance"]:
        return float(datasets["appearance"]["luminous_reflectance"])
    # The BSDF first: a spectrum measured with the specular component excluded is not the total.
    stages = ("bsdf",) if is_measured(datasets) else ("bsdf", "spectrum")
    source = next((datasets[s] for s in stages if s in datasets and "total_reflectance" in datasets[s]), None)
    if source is None or source.attrs.get("geometry") == "sce":
        return math.nan
    reflectance = source["total_reflectance"]
    if "wavelength" not in reflectance.dims:
        return float(reflectance)
    # V(λ) is the y function of the 2° observer, whichever observer the colours are for.
    xyz = reflectance_to_xyz(reflectance["wavelength"].values, reflectance.values, "D65", 2)
    return float(xyz[1]) / 100


def luminous_transmittance(datasets: Datasets) -> float:
    """Total transmittance at normal incidence [1]; NaN where nothing is transmitted."""
    if "appearance" in datasets and "luminous_transmittance" in datasets["appearance"]:
        return float(datasets["appearance"]["luminous_transmittance"])
    bsdf = datasets.get("bsdf")
    return transmittance_of_bsdf(bsdf) if bsdf is not None and representation(bsdf).transmits else math.nan

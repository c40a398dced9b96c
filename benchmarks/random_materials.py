"""Random materials, on which the candidates of the planner are tried: maps, lines and named densities, plastics and metals."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.optics.index import refractive_index
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.scenes.model_inputs import ModelInputs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

SIZE = 256
"""Heights along each axis of a random map."""
POINTS = 4096
"""Heights of a random line."""
KINDS = {
    "normal": 0.18,
    "polished": 0.2,
    "two scales": 0.08,
    "GGX": 0.1,
    "cells": 0.1,
    "cells upside down": 0.1,
    "ridges": 0.1,
    "line": 0.08,
    "named density": 0.06,
}
"""Kind of a random surface → its share."""
FURTHER = range(10_000, 10_040)
"""Seeds of further materials of a named density, which are cheap to measure."""
METALS = 0.15
"""Share of random materials that are metals."""


def random_material(seed: int) -> tuple[str, ModelInputs]:
    """A random material of one of :data:`KINDS`, and its kind."""
    rng = np.random.default_rng([seed, 77])
    kind = "named density" if seed in FURTHER else str(rng.choice(list(KINDS), p=list(KINDS.values())))
    surface, facets = random_surface(kind, rng)
    index: Any = float(rng.uniform(1.35, 1.7))
    spectrum = None
    if rng.random() < METALS:
        index = {"n": float(rng.uniform(0.2, 3)), "k": float(rng.uniform(2, 7))}
    else:
        wavelength = np.arange(380.0, 781.0, 10.0)
        edge = np.tanh((wavelength - rng.uniform(450, 650)) / rng.uniform(20, 80))
        reflectance = np.clip(rng.uniform(0.05, 0.85) * (1 + rng.uniform(-0.35, 0.35) * edge), 0.05, 0.95)
        grey = samples.spectrum(0.3).interp(wavelength=wavelength)
        spectrum = grey.assign(total_reflectance=grey["total_reflectance"].copy(data=reflectance))
    psd = None if surface is None else roughness_spectrum(surface)
    return kind, ModelInputs(refractive_index(index), spectrum, facets, psd, surface)


def random_surface(kind: str, rng: np.random.Generator) -> tuple[xr.Dataset | None, xr.Dataset]:
    """Heights of a kind, None of a named density, and their facets."""

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    seed, pitch = int(rng.integers(1 << 30)), 1.0
    if kind == "named density":
        return None, analytic(str(rng.choice(["beckmann", "ggx"])), spread(0.03, 0.6))
    if kind == "line":
        fine = rng.standard_normal(POINTS)
        height = np.fft.irfft(np.fft.rfft(fine) * np.exp(-((np.pi * np.fft.rfftfreq(POINTS) * spread(6, 20)) ** 2) / 2))
        height *= spread(0.02, 0.4) / np.diff(height).std()
    elif kind == "normal":
        height = relief_maps.gaussian(spread(0.02, 0.6), SIZE, seed, length=spread(6, 20))
    elif kind == "polished":
        height = relief_maps.gaussian(0.1, SIZE, seed, length=spread(4, 20))
        height, pitch = height / height.std() * spread(0.003, 0.4), 0.5
    elif kind == "two scales":
        height = relief_maps.two_scales(SIZE, seed) * spread(0.1, 2)
    elif kind == "GGX":
        height = relief_maps.ggx_like(SIZE, seed, width=spread(0.03, 0.3))
    elif kind == "ridges":
        height = relief_maps.ridges(SIZE, seed, slope=spread(0.05, 0.4))
    else:
        height = relief_maps.cells(SIZE, seed) * spread(0.15, 1.3) * (1 if kind == "cells" else -1)
    surface = samples.surface(height, (pitch, pitch))
    return surface, estimate(surface, isotropic=True if height.ndim == 1 else None)

"""Beckmann and GGX densities of the same rms or median slope as a facet distribution."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import numpy as np
import xarray as xr

from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.report.plots.svg import (
    Array,
)

if TYPE_CHECKING:
    from brdfpipe.facets.planar_density import PlanarDensity


Pattern = Literal["line", "dash", "dots"]

Model = Callable[[Array], Array]

# Medians of |slope| towards one azimuth over the width a, of Beckmann (a Gaussian of σ = a/√2) and of GGX.
_BECKMANN_MEDIAN = 0.6744897501960817 / math.sqrt(2)

_GGX_MEDIAN = 1 / math.sqrt(3)

GGX_LABEL = "GGX of the same median slope"


def radial_equivalents(facets: xr.Dataset) -> list[tuple[Model, str, Pattern]]:
    a, label = beckmann_width(facets)
    b = median_slope(facets)
    return [
        (lambda s: np.exp(-np.minimum((s / a) ** 2, 690.0)) / (np.pi * a**2), f"{label}, {a:.3g}", "dash"),
        (lambda s: 1 / (np.pi * b**2 * (1 + (s / b) ** 2) ** 2), f"{GGX_LABEL}, {b:.3g}", "dots"),
    ]


def beckmann_width(facets: xr.Dataset) -> tuple[float, str]:
    """Width a of the Beckmann shown beside a radial density; a heavy tail may have no finite slope rms."""
    slope_rms = scalar_or_nan(facets, "slope_rms")
    if math.isfinite(slope_rms) and slope_rms > 0:
        return slope_rms, "Beckmann of the same rms slope"
    return median_slope(facets) / math.sqrt(math.log(2)), "Beckmann of the same median slope"


def median_slope(facets: xr.Dataset) -> float:
    """The median slope, which of a GGX is its width."""
    return RadialDensity.of(facets).median_slope


def planar_equivalents(facets: xr.Dataset, density: PlanarDensity) -> list[tuple[tuple[Model, Model], str, Pattern]]:
    """Beckmann and GGX, each as its sections (along, across)."""
    azimuths = np.array([density.azimuth, density.azimuth + 90])
    medians = np.array([median_slope_towards(density, azimuth) for azimuth in azimuths.tolist()])
    if math.isfinite(scalar_or_nan(facets, "slope_rms")):
        wide, rule = rms_slope_towards(density, azimuths) * math.sqrt(2), "rms slopes"
    else:
        wide, rule = medians / _BECKMANN_MEDIAN, "median slopes"
    narrow = medians / _GGX_MEDIAN

    def beckmann(a: float) -> Model:
        return lambda s: np.exp(-np.minimum((s / a) ** 2, 690.0)) / (np.pi * np.prod(wide))

    def ggx(a: float) -> Model:
        return lambda s: 1 / (np.pi * np.prod(narrow) * (1 + (s / a) ** 2) ** 2)

    return [
        ((beckmann(wide[0]), beckmann(wide[1])), f"Beckmann of the same {rule}", "dash"),
        ((ggx(narrow[0]), ggx(narrow[1])), "GGX of the same median slopes", "dots"),
    ]


def rms_slope_towards(density: PlanarDensity, azimuth: Array) -> Array:
    """Slope rms about zero towards azimuths."""
    _, mean, covariance = density.moments
    towards = np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
    second = covariance + np.outer(mean, mean)
    return np.asarray(np.sqrt(np.einsum("ik,ij,jk->k", towards, second, towards)))


def median_slope_towards(density: PlanarDensity, azimuth: float) -> float:
    """Median |slope| towards an azimuth."""
    slope, values = density.marginal(azimuth)
    below = np.r_[0.0, np.cumsum(np.diff(slope) * (values[1:] + values[:-1]) / 2)]
    positive = slope[slope > 0]
    within = np.interp(positive, slope, below) - np.interp(-positive, slope, below)
    return float(np.interp(0.5 * below[-1], within, positive))


def scalar_or_nan(dataset: xr.Dataset, name: str) -> float:
    return float(dataset[name]) if name in dataset else math.nan

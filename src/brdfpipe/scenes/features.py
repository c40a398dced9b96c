"""Numbers from which the error of a model for a material can be expected, before any BSDF is built."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from brdfpipe.bsdf.wave.builder import LARGEST_INCIDENCE, Relief
from brdfpipe.bsdf.wave.roughness import roughness
from brdfpipe.facets.facet_dataset import radial_average
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.masking.visibility_choice import THRESHOLD, smith_errors
from brdfpipe.optics.fresnel_equations import fresnel
from brdfpipe.optics.index import interpolate_index
from brdfpipe.scenes.model_inputs import ONE_WAVELENGTH, ModelInputs

FEATURES = {
    "log_slope": 1.5,
    "tail": 0.1,
    "log_height": 1.8,
    "facets_at_grazing": 0.4,
    "heights_known": 0.3,
    "masking_in_peak": 0.1,
    "masking": 0.1,
    "masking_over_limit": 0.1,
    "slope_lowness": 0.15,
    "height_skewness": 0.3,
    "log_anisotropy": 0.4,
    "log_mirror": 1.0,
    "diffuse": 0.25,
}
"""Feature → its usual spread over materials."""

STEEP = 0.95
"""Share of the facets that are less steep than the slope that shows the tail."""

GRAZING = 75.0
"""Angle of incidence at which the masking of the heights is compared with Smith's [degree]."""

TRACED = 4096
"""Facets that are traced for it."""

_LARGEST_HEIGHT = 3.0
"""Rms height over the wavelength beyond which coherent light is nothing at any angle, [1]."""


def features(inputs: ModelInputs) -> dict[str, float]:
    """The features of a material with slopes.

    - ``log_slope``: ln of the median slope of the facets
    - ``tail``: ln of the slope that 5 % of the facets exceed over the median slope
    - ``log_height``: ln of the rms height over 555 nm, which is at most 3; that of 3 without a roughness spectrum
    - ``facets_at_grazing``: share of the light at 85° that the fullest model reflects as by facets, the rest as by waves; 1 without a
      roughness spectrum. What the facets leave out is an error of this share alone
    - ``heights_known``: 1 with a scan, 0 without
    - ``masking_in_peak``, ``masking``: ln of the light that facets reflect at 75° after Smith over that which is traced on the heights, in the
      peak and in all; 0 where none is traced
    - ``masking_over_limit``: 1 where one of these ratios differs from 1 by more than the limit above which ``masking: auto`` traces masking
      on the heights, else 0: models with Smith's masking have no error by it below the limit, and one above
    - ``slope_lowness``: correlation of height and squared slope on the map: negative, where steep facets lie in valleys; 0 without a map
    - ``height_skewness``: Ssk of the map, -2 to 2
    - ``log_anisotropy``: ln of the ratio of the slopes along two axes; 0 without a lay
    - ``log_mirror``: ln of Fresnel's reflectance at the normal
    - ``diffuse``: luminous reflectance; 0 without a spectrum
    """
    facets, index = inputs.facets, inputs.index
    if facets is None:
        raise ValueError("features need facets")
    lay = facets["slope_density"].ndim == 2
    density = radial_average(PlanarDensity.of(facets)) if lay else RadialDensity.of(facets)
    slope = density.median_slope
    n, k = (float(value[0]) for value in interpolate_index(index, np.array([ONE_WAVELENGTH])))
    result = dict.fromkeys(FEATURES, 0.0)
    result["log_slope"] = math.log(slope)
    result["tail"] = math.log(density.slope_quantile(STEEP) / slope)
    result["log_height"], result["facets_at_grazing"] = math.log(_LARGEST_HEIGHT), 1.0
    if inputs.psd is not None:
        relief = Relief.of(*roughness(inputs.psd), inputs.psd, "auto", None, facets)
        share = relief.share(np.array([LARGEST_INCIDENCE]), np.array([ONE_WAVELENGTH]))
        result["facets_at_grazing"] = float(share[0, 0])
        height = max(float(inputs.psd["sigma_heights"]), 1e-4) / (1e-3 * ONE_WAVELENGTH)
        result["log_height"] = math.log(min(height, _LARGEST_HEIGHT))
    if inputs.surface is not None:
        result["heights_known"] = 1.0
        errors = smith_errors(inputs.surface, facets, GRAZING, TRACED)
        result["masking_in_peak"], result["masking"] = (math.log1p(errors[region]) for region in ("peak", "all"))
        result["masking_over_limit"] = float(max(map(abs, errors.values())) > THRESHOLD)
        heights = inputs.surface["height"].values
        result["slope_lowness"] = slope_lowness(heights)
        centred = heights - np.nanmean(heights)
        squared = centred * centred  # a power of 3 takes many times as long as the product
        deviation = math.sqrt(np.nanmean(squared))
        result["height_skewness"] = float(np.clip(np.nanmean(squared * centred) / max(deviation, 1e-12) ** 3, -2, 2))
    if lay:
        result["log_anisotropy"] = math.log(float(facets["anisotropy"]))
    result["log_mirror"] = math.log(float(fresnel(1.0, n, k)[2]))
    result["diffuse"] = inputs.luminous_reflectance
    return result


def slope_lowness(heights: Array) -> float:
    """Correlation of the height of a place with its squared slope: negative, where steep places lie low; 0 of a plane."""
    if heights.ndim == 1:
        middle, squared = heights[1:-1], (heights[2:] - heights[:-2]) ** 2
    else:
        middle = heights[1:-1, 1:-1]
        squared = (heights[2:, 1:-1] - heights[:-2, 1:-1]) ** 2 + (heights[1:-1, 2:] - heights[1:-1, :-2]) ** 2
    known = np.isfinite(middle) & np.isfinite(squared)
    a, b = middle[known], squared[known]
    if a.size < 9 or a.std() == 0 or b.std() == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def in_spreads(features: Mapping[str, float]) -> Array:
    """The features in units of their spread, in the order of :data:`FEATURES`."""
    return np.array([features[name] / spread for name, spread in FEATURES.items()])

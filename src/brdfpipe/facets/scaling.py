"""Scale all slopes of a facet distribution by one factor, as if the heights were stretched."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.geometry import Array

_SLOPES = ("slope", "slope_along", "slope_across")


def scaled(facets: xr.Dataset, factor: float) -> xr.Dataset:
    """The facet distribution of a surface whose slopes are all ``factor`` times as steep.

    Parameters
    ----------
    facets : kind ``facets``: isotropic, with a lay, or perfectly flat
    factor : above 0 [1]

    Returns
    -------
    Dataset of kind ``facets``, with the same counts

    Raises
    ------
    FacetError : the factor is not a finite number above 0.

    Notes
    -----
    P22(p) becomes P22(p/s)/s², and the mean excess slope g(μ) becomes s g(μ/s), so that Λ keeps its value where cot θ is s times as
    large. Every node keeps its value and moves: nothing is interpolated.
    """
    vocabulary.validate(facets, "facets")
    if not (np.isfinite(factor) and factor > 0):
        raise FacetError(f"slopes cannot be scaled by {factor:g}; accepted: a factor above 0")
    tilt = facets["alpha"].values
    steeper = _scaled_tilt(tilt, factor)
    # D = P22 / cos⁴α, with the tilts before and after.
    onto_sphere = (np.cos(np.radians(tilt)) / np.cos(np.radians(steeper))) ** 4 / factor**2
    ratios: dict[str, float | xr.DataArray] = {
        "slope_density": factor**-2,
        "slope_density_u": factor**-2,
        "slope_density_change": factor**-2,
        "slope_rms": factor,
        "slope_rms_scale": factor,
        "tail_slope": factor,
    }
    ratios |= dict.fromkeys(("D", "D_u"), xr.DataArray(onto_sphere, dims="alpha"))
    fields = {name: facets[name] * ratio for name, ratio in ratios.items() if name in facets}
    coordinates = {name: _scaled_axis(facets[name], factor) for name in _SLOPES if name in facets.coords}
    coordinates |= {
        "alpha": ("alpha", steeper, {}),
        "theta": ("theta", _scaled_tilt(facets["theta"].values, 1 / factor), {}),
    }
    return vocabulary.label(facets.assign(fields).assign_coords(coordinates), "facets")


def scaled_surface(facets: xr.Dataset, factor: float) -> xr.Dataset:
    """Slope density and masking alone of isotropic facets scaled by a factor, which take a fraction of the time of :func:`scaled`."""
    return xr.Dataset(
        {
            "slope_density": ("slope", facets["slope_density"].values * factor**-2),
            "lambda_smith": ("theta", facets["lambda_smith"].values),
        },
        {
            "slope": facets["slope"].values * factor,
            "theta": _scaled_tilt(facets["theta"].values, 1 / factor),
        },
    )


def _scaled_axis(slope: xr.DataArray, factor: float) -> tuple[str, Array, dict[str, float]]:
    """Scaled slopes of an axis, with its ``scale`` if it has one."""
    scale = {"scale": float(slope.attrs["scale"]) * factor} if "scale" in slope.attrs else {}
    return str(slope.name), slope.values * factor, scale


def _scaled_tilt(angles: Array, factor: float) -> Array:
    """Angles [degree] whose tangent is ``factor`` times as large; 90 degree stays 90."""
    radians = np.radians(angles)
    return np.asarray(np.degrees(np.arctan2(factor * np.sin(radians), np.cos(radians))))

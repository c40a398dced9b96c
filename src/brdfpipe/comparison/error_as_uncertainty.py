"""The error of a model as a standard uncertainty."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import xarray as xr

LARGEST_ERROR = 10.0
"""Largest relative error that is stated: a prediction of less than a tenth of the light is no base for a ratio."""


def relative_light_error(result: xr.Dataset) -> xr.Dataset:
    """Reference over predicted light less 1, as a standard uncertainty of the prediction, and the uncertainty of the reference that it shares.

    Parameters
    ----------
    result : kind ``model_error``

    Returns
    -------
    Dataset over ``theta_i`` [degree] and ``region``, of traced rays where they hold, else of diffraction, else NaN; the largest of the planes of
    incidence. ``relative_error`` [1], at most :data:`LARGEST_ERROR`, is √(error² + u²) where rays are the reference, because the error is not corrected
    and the noise is that of the rays alone; where diffraction is the reference it is the error. ``reference_light_u`` [1] is then the relative uncertainty of
    diffraction by the finite map, from which the prediction was made too; 0 for rays. Regions are those of the predicted BRDF at the incidence: above 0.3 of its peak, above 0.03, and the
    rest. A region without light has the values of its neighbour towards the peak, or else of the one outside
    """
    compared = (result["valid"] > 0) & (result["light"] > 0) & (result["reference_light"] > 0)
    ratio = (result["reference_light"] / result["light"]).where(compared)
    # The relative uncertainty of a ratio is that of its inverse.
    u = ratio * result["light_error_u"] / (1 + result["light_error"])
    of_rays = u["reference"] == "traced"
    size = ((ratio - 1) ** 2 + u.where(of_rays, 0.0) ** 2) ** 0.5
    by_name = {"relative_error": size, "reference_light_u": u.where(~of_rays, 0.0).where(ratio.notnull())}
    return xr.Dataset(
        {name: _in_all_regions(values.clip(max=LARGEST_ERROR).max("plane")) for name, values in by_name.items()}
    )


def _in_all_regions(by_reference: xr.DataArray) -> xr.DataArray:
    """Values of the best reference over ``theta_i`` and ``region``; a region without one has that of a neighbour."""
    by_region = _of_best_reference(by_reference).transpose("theta_i", "region")
    values = by_region.values.T.copy()
    for outwards in (values, values[::-1]):
        for inner, outer in pairwise(outwards):
            outer[np.isnan(outer)] = inner[np.isnan(outer)]
    return by_region.copy(data=values.T)


def gloss_error(result: xr.Dataset) -> xr.Dataset:
    """Predicted less reference gloss as a standard uncertainty, and the uncertainty of the reference that the prediction shares.

    Parameters
    ----------
    result : kind ``model_error``

    Returns
    -------
    Dataset over ``gloss_angle`` [degree], of traced rays where they hold, else of diffraction, else NaN; of the plane of incidence with the largest
    error. ``model_gloss_error`` [gloss units] has the sign of the error: of rays √(error² + u²), because their noise is theirs alone, and of
    diffraction the error. ``reference_gloss_u`` [gloss units] is 0 of rays, and of diffraction its uncertainty, because the map is finite from
    which the prediction was made too
    """
    error, u = result["gloss_error"].where(result["gloss_valid"] > 0), result["gloss_error_u"]
    of_rays = u["reference"] == "traced"
    signed = xr.DataArray(np.copysign(np.hypot(error, u.where(of_rays, 0.0)), error))
    largest, least = signed.max("plane"), signed.min("plane")
    of_map = u.where(~of_rays, 0.0).where(error.notnull()).max("plane")
    by_name = {"model_gloss_error": largest.where(largest >= -least, least), "reference_gloss_u": of_map}
    return xr.Dataset({name: _of_best_reference(values) for name, values in by_name.items()})


def _of_best_reference(values: xr.DataArray) -> xr.DataArray:
    """Values of traced rays at each incidence where any is known, else of diffraction."""
    traced, diffracted = (values.sel(reference=name, drop=True) for name in ("traced", "kirchhoff"))
    known = traced.notnull()
    return traced.where(known.any("region") if "region" in known.dims else known, diffracted)

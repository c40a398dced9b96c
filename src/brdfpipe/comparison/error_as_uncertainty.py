"""The error of a model as a standard uncertainty."""

from __future__ import annotations

import xarray as xr


def relative_error(result: xr.Dataset) -> xr.DataArray:
    """Relative error of the model as a standard uncertainty: √(error² + u²), because the error is not corrected.

    Parameters
    ----------
    result : kind ``model_error``

    Returns
    -------
    DataArray [1] over ``theta_i`` [degree] and ``region``, of traced rays where they hold, else of diffraction, else NaN; the largest of the
    planes of incidence. Regions are those of the predicted BRDF at the incidence: above 0.3 of its peak, above 0.03, and the rest
    """
    size = ((result["light_error"] ** 2 + result["light_error_u"] ** 2) ** 0.5).where(result["valid"] > 0).max("plane")
    traced_rays, diffraction = (size.sel(reference=name, drop=True) for name in ("traced", "kirchhoff"))
    return traced_rays.fillna(diffraction).transpose("theta_i", "region").rename("relative_error")

"""Scale all heights behind a roughness spectrum by one factor."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.psd.k_correlation import PsdError

_HEIGHTS = (
    "sigma",
    "sigma_heights",
    "noise_sigma",
    "fit_sigma",
    "unresolved_sigma",
    "long_sigma",
    "long_slope",
    "coherent_sigma",
)
"""In proportion to the heights, with their uncertainties."""
_SQUARES = ("psd", "psd_uncertainty", "psd_planar", "psd_noise_change", "apparent_psd", "noise_psd")
"""In proportion to their square."""


def scaled(psd: xr.Dataset, factor: float) -> xr.Dataset:
    """The roughness spectrum of a surface whose heights are all ``factor`` times as large.

    Parameters
    ----------
    psd : kind ``psd``
    factor : above 0 [1]

    Returns
    -------
    Dataset of kind ``psd``, at the same frequencies

    Raises
    ------
    PsdError : the factor is not a finite number above 0.
    """
    vocabulary.validate(psd, "psd")
    if not (np.isfinite(factor) and factor > 0):
        raise PsdError(f"heights cannot be scaled by {factor:g}; accepted: a factor above 0")
    powers = {f"{name}{u}": 1 for name in _HEIGHTS for u in ("", "_u")} | dict.fromkeys(_SQUARES, 2)
    result = psd.assign(
        {
            name: psd[name].copy(data=psd[name].values * factor ** powers[name])
            for name in psd.data_vars
            if name in powers
        }
    )
    if "phase_per_height" in psd.coords:
        # The heights that reflect as much light coherently, at the same phase.
        q = psd["phase_per_height"]
        result = result.assign_coords(phase_per_height=q.copy(data=q.values / factor))
    return result

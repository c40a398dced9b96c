"""The roughness by which a surface scatters waves, from its roughness spectrum."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.microsurface import ModelError
from brdfpipe.bsdf.wave.height_transform import Autocorrelation, LongWaves, gaussian, k_correlation, measured

LEAST_SLOPE = 3.0
"""Least exponent with which a measured spectrum is continued beyond its band: at 2 the heights beyond it have no end."""


def roughness(psd: xr.Dataset) -> tuple[Autocorrelation, float]:
    """Autocorrelation of the heights, and their rms [um].

    Parameters
    ----------
    psd : kind ``psd``; a measured one is continued above its band by its fitted form, and below it by the long waves of the heights

    Raises
    ------
    ModelError : a spectrum that was not measured has no ``fit_length``.
    """
    form, length, slope = psd.attrs["form"], float(psd["fit_length"]), float(psd["fit_slope"])
    fitted: Autocorrelation | None = None
    if np.isfinite(length) and length > 0:
        by_slope = np.isfinite(slope) and slope > 2
        fitted = k_correlation(length, slope) if by_slope else gaussian(length)
    if form != "measured":
        if fitted is None:
            raise ModelError(
                f"a roughness spectrum of the form {form!r} has no `fit_length`; give one, or measured values"
            )
        return fitted, float(psd["fit_sigma"])
    if not psd["psd"].values.any():
        return gaussian(1.0), 0.0
    if fitted is not None and np.isfinite(slope) and slope < LEAST_SLOPE:
        fitted = k_correlation(length, LEAST_SLOPE)
    long_waves = None
    if "long_sigma" in psd:
        long_waves = LongWaves(*(float(psd[name]) for name in ("long_sigma", "long_slope", "band_low")))
    return measured(psd["frequency"].values, psd["psd"].values, fitted, long_waves)

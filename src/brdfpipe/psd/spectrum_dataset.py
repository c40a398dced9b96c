"""Datasets of kind ``psd`` from spectra in rings."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.psd.k_correlation import KFit
from brdfpipe.psd.periodograms import Rings


def spectrum_dataset(
    spectrum: Rings, fitted: KFit, quality: NDArray[np.int8], *, form: str, method: str, common_u: float = 0.0
) -> xr.Dataset:
    """The dataset, but for the rms of heights and noise, and labels; ``common_u`` as for :func:`rms_height`."""
    (sigma, sigma_u), edges = rms_height(spectrum, common_u), _edges(spectrum.frequency)
    return xr.Dataset(
        {
            "psd": ("frequency", spectrum.density),
            "psd_uncertainty": ("frequency", spectrum.uncertainty),
            "psd_quality": ("frequency", quality),
            "sigma": sigma,
            "sigma_u": sigma_u,
            "band_low": edges[0],
            "band_high": edges[-1],
            **{f"fit_{name}": value for name, value in fitted.model._asdict().items()},
            **{f"fit_{name}_u": value for name, value in fitted.uncertainty._asdict().items()},
            "fit_residual_log": fitted.residual,
        },
        coords={"frequency": spectrum.frequency},
        attrs={"form": form, "method": method},
    )


def rms_height(spectrum: Rings, common_u: float = 0.0) -> tuple[float, float]:
    """√∬S over the rings and its standard uncertainty [um]; f² S is even over the logarithm of f in each ring.

    The rings are independent but for a part of their uncertainty, ``common_u`` [um4], that all have in common: that of the noise.
    """
    weight = 2 * np.pi * spectrum.frequency**2 * np.diff(np.log(_edges(spectrum.frequency)))
    sigma = np.sqrt(max(float(weight @ spectrum.density), 0.0))
    own = np.maximum(spectrum.uncertainty**2 - common_u**2, 0.0)
    variance = float(weight**2 @ own) + (common_u * weight.sum()) ** 2
    return float(sigma), float(np.sqrt(variance) / (2 * sigma)) if sigma else 0.0


def _edges(frequency: Array) -> Array:
    """Edges of rings: amid their frequencies, in the logarithm, and as far beyond the outer ones."""
    inner = np.sqrt(frequency[1:] * frequency[:-1])
    return np.concatenate([[frequency[0] ** 2 / inner[0]], inner, [frequency[-1] ** 2 / inner[-1]]])

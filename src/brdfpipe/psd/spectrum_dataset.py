"""Datasets of kind ``psd`` from spectra in rings."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import Array
from brdfpipe.psd.k_correlation import FittedForm
from brdfpipe.psd.periodograms import Rings

NOISE_CHANGES = "psd_noise_change"
"""Variable of a spectrum: its change as each independent noise grows by its standard uncertainty."""


def spectrum_dataset(
    spectrum: Rings,
    fitted: FittedForm,
    quality: NDArray[np.int8],
    *,
    form: str,
    method: str,
    noise_changes: Array | None = None,
) -> xr.Dataset:
    """The dataset, but for the rms of heights and noise, and labels; ``noise_changes`` as for :func:`rms_height`."""
    (sigma, sigma_u), edges = rms_height(spectrum, noise_changes), _edges(spectrum.frequency)
    result = xr.Dataset(
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
    if noise_changes is None or not noise_changes.any():
        return result
    return result.assign({NOISE_CHANGES: (("uncertain_noise", "frequency"), noise_changes)})


def rms_height(spectrum: Rings, noise_changes: Array | None = None) -> tuple[float, float]:
    """√∬S over the rings and its standard uncertainty [um]; f² S is even over the logarithm of f in each ring.

    The rings are independent but for parts of their uncertainty, ``noise_changes`` (noises, rings) [um4], that all have in common.
    """
    weight = 2 * np.pi * spectrum.frequency**2 * np.diff(np.log(_edges(spectrum.frequency)))
    sigma = np.sqrt(max(float(weight @ spectrum.density), 0.0))
    variance = float(weight**2 @ own_variance(spectrum.uncertainty, noise_changes))
    if noise_changes is not None:
        variance += float(np.square(noise_changes @ weight).sum())
    return float(sigma), float(np.sqrt(variance) / (2 * sigma)) if sigma else 0.0


def own_variance(uncertainty: Array, noise_changes: Array | None) -> Array:
    """Variance of each ring (rings,) besides that of the noise, ``noise_changes`` (noises, rings) as for :func:`rms_height`."""
    common = 0.0 if noise_changes is None else np.square(noise_changes).sum(axis=0)
    return np.asarray(np.maximum(uncertainty**2 - common, 0.0))


def _edges(frequency: Array) -> Array:
    """Edges of rings: amid their frequencies, in the logarithm, and as far beyond the outer ones."""
    inner = np.sqrt(frequency[1:] * frequency[:-1])
    return np.concatenate([[frequency[0] ** 2 / inner[0]], inner, [frequency[-1] ** 2 / inner[-1]]])

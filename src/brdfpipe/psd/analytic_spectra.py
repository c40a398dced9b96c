"""Roughness spectra of given rms height and correlation length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.geometry import Array
from brdfpipe.psd.k_correlation import Gaussian, KCorrelation, PsdError

FORMS = ("gaussian", "k-correlation")

_SIZES = (0.0, 1e6)
_LENGTHS = (1e-6, 1e9)
_SLOPES = (2.0, 12.0)
_LOWEST = 1e-4
_HIGHEST = {"gaussian": 3.0, "k-correlation": 1e4}
"""Last frequency times ℓ: the Gaussian has fallen to 1e-38 there."""
_PER_DECADE = 128


def analytic(form: str, *, sigma: float, length: float, slope: float = 3.0) -> xr.Dataset:
    """Roughness spectrum of a named form, on a logarithmic grid of frequencies.

    Parameters
    ----------
    form : ``gaussian``: autocovariance σ² exp(−r²/ℓ²), S = πℓ²σ² exp(−π²ℓ²f²);
        ``k-correlation``: S = A′/(1 + (Bf)²)^(slope/2), B = 2πℓ, A′ = σ²B²(slope − 2)/2π
    sigma : rms height over all frequencies [um], 0 to 1e6
    length : ℓ [um], 1e-6 to 1e9. The autocovariance of the Gaussian falls to 1/e at ℓ, and so does that of a K-correlation of
        slope 3, which is σ² exp(−r/ℓ)
    slope : exponent of the decay of a K-correlation, above 2 to 12; a Gaussian has none, and ignores it

    Returns
    -------
    Dataset of kind ``psd``; ``sigma`` and ``fit_sigma`` are the given one, ``band_low`` and ``band_high`` the ends of the grid.
    ``fit_slope`` of a Gaussian is missing

    Raises
    ------
    PsdError : the form is unknown or a parameter is out of range.

    References
    ----------
    Stover, Optical Scattering, 3rd ed., ch. 2; Dittman 2006, Proc. SPIE 6291, 62910R.
    """
    if form not in FORMS:
        raise PsdError(f"unknown form of a roughness spectrum {form!r}; accepted: {', '.join(FORMS)}")
    _check("rms height `sigma`", sigma, _SIZES, " um")
    _check("length", length, _LENGTHS, " um")
    decades = np.log10(_HIGHEST[form] / _LOWEST)
    frequency = np.geomspace(_LOWEST, _HIGHEST[form], round(decades * _PER_DECADE) + 1) / length
    if form == "gaussian":
        slope = np.nan
        density = Gaussian(sigma, length).areal(frequency)
        method = f"analytic gaussian, sigma = {sigma:g} um, length = {length:g} um"
    else:
        _check("slope", slope, _SLOPES, "", above=True)
        density = KCorrelation(sigma, length, slope).areal(frequency)
        method = f"analytic k-correlation, sigma = {sigma:g} um, length = {length:g} um, slope = {slope:g}"
    spectrum = xr.Dataset(
        {
            "psd": ("frequency", density),
            "psd_uncertainty": ("frequency", np.zeros_like(density)),
            "sigma": sigma,
            "sigma_heights": sigma,
            "noise_sigma": 0.0,
            "band_low": frequency[0],
            "band_high": frequency[-1],
            "fit_sigma": sigma,
            "fit_length": length,
            "fit_slope": slope,
            **dict.fromkeys(("fit_sigma_u", "fit_length_u", "fit_slope_u"), 0.0),
        },
        coords={"frequency": frequency},
        attrs={"form": form, "method": method},
    )
    return vocabulary.label(spectrum, "psd")


def spectrum_of(psd: xr.Dataset) -> Callable[[Array], Array]:
    """The form of a spectrum, or the one fitted to it, at any frequency [um-1]: S [um4]."""
    sigma, length, slope = (float(psd[f"fit_{name}"]) for name in ("sigma", "length", "slope"))
    return (Gaussian(sigma, length) if np.isnan(slope) else KCorrelation(sigma, length, slope)).areal


def _check(name: str, value: float, accepted: tuple[float, float], unit: str, above: bool = False) -> None:
    low, high = accepted
    if not (low < value <= high if above else low <= value <= high):
        start = f"above {low:g}" if above else f"{low:g}"
        raise PsdError(f"the {name} of a roughness spectrum is {value:g}{unit}; accepted: {start} to {high:g}{unit}")

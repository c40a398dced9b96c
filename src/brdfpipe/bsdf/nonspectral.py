"""Spectral averages of a BSDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import averaged
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array


def nonspectral(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> xr.Dataset:
    """The BSDF averaged over wavelength; the same dataset if it does not depend on wavelength.

    ``weight`` is the spectral response on the dataset's wavelengths, any scale; by default V(λ) times the illuminant D65. See
    :func:`normalised_response` for the errors raised.
    """
    response = normalised_response(bsdf, weight)
    return bsdf if response is None else averaged(representation(bsdf).nonspectral(response), bsdf, response)


def normalised_response(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> Array | None:
    """Spectral response on the wavelengths of a BSDF, of sum 1; None if the BSDF does not depend on wavelength.

    Raises VocabularyError: the weight is not one finite number >= 0 per wavelength, or 0 everywhere.
    """
    if "wavelength" not in bsdf.coords:
        return None
    wavelength = bsdf["wavelength"].values
    if weight is None:
        from brdfpipe.spectra import colorimetry

        weight = colorimetry.luminous_weight(wavelength)
    response = np.asarray(weight, dtype=float)
    if response.shape != wavelength.shape or not (response.min() >= 0 and 0 < response.sum() < np.inf):
        raise VocabularyError(
            f"the weight needs {wavelength.size} finite values >= 0, not all 0; found shape {response.shape}"
        )
    return np.asarray(response / response.sum())

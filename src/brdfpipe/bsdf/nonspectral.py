"""Spectral averages of a BSDF."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import averaged
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array

_LUMINOUS: WeakKeyDictionary[Representation, xr.Dataset] = WeakKeyDictionary()
"""Averages for the eye, which several quantities of one BSDF need, as long as its representation lives."""


def nonspectral(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> xr.Dataset:
    """The BSDF averaged over wavelength; the same dataset if it does not depend on wavelength.

    ``weight`` is the spectral response on the dataset's wavelengths, any scale; by default V(λ) times the illuminant D65. See
    :func:`normalised_response` for the errors raised. The same BSDF gives the same dataset again if the weight is the default.
    """
    response = normalised_response(bsdf, weight)
    if response is None:
        return bsdf
    model = representation(bsdf)
    if weight is not None:
        return averaged(model.nonspectral(response), bsdf, response)
    if model not in _LUMINOUS:
        _LUMINOUS[model] = averaged(model.nonspectral(response), bsdf, response)
    return _LUMINOUS[model]


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

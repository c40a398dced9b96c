"""Spectra that depend linearly on colours and are never negative, for tables of many colours."""

from __future__ import annotations

from functools import cache

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import srgb_from_xyz, weights

_WEIGHT_OF_CONDITIONS = 1e5
"""Of the conditions beside the slopes, in least squares: they hold within 1e-9."""


@cache
def spectra_of_primaries() -> Array:
    """Smooth reflectances of red, green and blue.

    Returns
    -------
    (wavelengths of :data:`brdfpipe.spectra.colorimetry.GRID`, 3): not negative, together 1 at every wavelength. Times the linear sRGB of a colour under
    D65 for the 2 degree observer, (1, 1, 1) for the perfect white diffuser, they are a reflectance of this colour: from 0 to 1 for every
    colour of a screen, and constant for a neutral one

    References
    ----------
    Mallett and Yuksel, "Spectral primary decomposition for rendering with sRGB reflectance", EGSR 2019: least squared slope of the three under these
    conditions.
    """
    from scipy.optimize import nnls

    by_wavelength = weights("D65", 2).weights / 100
    count, three = len(by_wavelength), np.eye(3)
    slopes = np.kron(three, np.diff(np.eye(count), axis=0))
    conditions = np.vstack([np.kron(three, by_wavelength.T), np.kron(np.ones((1, 3)), np.eye(count))])
    wanted = np.concatenate([np.linalg.inv(_to_rgb()).T.ravel(), np.ones(count)])
    found, _ = nnls(
        np.vstack([slopes, _WEIGHT_OF_CONDITIONS * conditions]),
        np.concatenate([np.zeros(len(slopes)), _WEIGHT_OF_CONDITIONS * wanted]),
    )
    spectra = np.asarray(found).reshape(3, count).T
    spectra.setflags(write=False)
    return spectra


def amounts(xyz: Array) -> Array:
    """Amounts (..., 3) of :func:`spectra_of_primaries`, never negative, for tristimulus values (..., 3) under D65 for the 2 degree observer.

    Colours outside sRGB lose their negative amounts, and the rest is reduced so that Y is kept.
    """
    to_rgb = _to_rgb()
    luminance = np.linalg.inv(to_rgb)[1]
    kept = np.maximum(xyz @ to_rgb.T, 0.0)
    own = kept @ luminance
    return np.asarray(
        kept * np.divide(np.maximum(xyz[..., 1], 0.0), own, out=np.zeros_like(own), where=own > 0)[..., None]
    )


def _to_rgb() -> Array:
    """Linear sRGB of X, Y and Z, with Y = 1 for the perfect white diffuser."""
    return np.asarray(srgb_from_xyz(weights("D65", 2).white) * 100)

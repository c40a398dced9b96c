"""Spectra that depend linearly on their tristimulus values, for tables of many colours."""

from __future__ import annotations

from functools import cache

import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import weights


@cache
def spectra_of_tristimulus(illuminant: str = "D65", observer: int = 2) -> Array:
    """The reflectance of least squared slope for each unit of X, Y and Z.

    Parameters
    ----------
    illuminant, observer : of the tristimulus values, see :func:`brdfpipe.spectra.colorimetry.weights`

    Returns
    -------
    (wavelengths of :data:`brdfpipe.spectra.colorimetry.GRID`, 3): times (X, Y, Z), with Y = 1 for the perfect white diffuser, it is a reflectance of these
    values. A neutral one is constant. Saturated colours have reflectances below 0 or above 1 at some wavelengths: the price of linearity

    References
    ----------
    Burns, "Numerical methods for smoothest reflectance reconstruction", Color Res. Appl. 45 (2020) 8: least slope squared.
    """
    by_wavelength = weights(illuminant, observer).weights / 100
    count = len(by_wavelength)
    steps = np.diff(np.eye(count), axis=0)
    # Least squared slope with three conditions, by Lagrange's multipliers.
    system = np.block([[steps.T @ steps, by_wavelength], [by_wavelength.T, np.zeros((3, 3))]])
    found = np.linalg.solve(system, np.concatenate([np.zeros((count, 3)), np.eye(3)]))[:count]
    found.setflags(write=False)
    return np.asarray(found)

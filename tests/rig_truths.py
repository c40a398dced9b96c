"""Samples of an emulated rig whose BSDF is a formula, and a rig with many fibres."""

from __future__ import annotations

import dataclasses

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.rig.description import Fibre, Rig

WAVELENGTHS = np.arange(380.0, 781.0, 10.0)


def lobe(reflectance, peak=0.0, fwhm=1.0) -> xr.Dataset:
    """A Lambertian of a reflectance, one number or one at each of :data:`WAVELENGTHS`, and a Gaussian lobe [1/sr, degree]."""
    spectral = np.ndim(reflectance) > 0
    fields = {"gauss_peak": peak, "gauss_fwhm_parallel": fwhm, "gauss_fwhm_perpendicular": fwhm}
    return vocabulary.label(
        xr.Dataset(
            {"lambert": ("wavelength", np.asarray(reflectance, dtype=float)) if spectral else float(reflectance)}
            | {name: ("theta_i", np.full(2, float(value))) for name, value in fields.items()},
            coords={"theta_i": [0.0, 90.0]} | ({"wavelength": WAVELENGTHS} if spectral else {}),
            attrs={"representation": "lambert_gauss"},
        ),
        "bsdf",
    )


def with_fibres(rig: Rig, count: int = 60) -> Rig:
    """A rig with more fibres, on a spiral over the hemisphere, in columns beside the disc."""
    k = np.arange(count)
    theta, phi = 12 + 75 * (k + 0.5) / count, (137.508 * k + 180) % 360 - 180
    column, row = np.resize([-48.0, -43.0, -38.0, -33.0, 33.0, 38.0], count), 4.5 * (k // 6) - 30
    fibres = tuple(Fibre(f"F{i}", *map(float, at)) for i, at in enumerate(zip(theta, phi, column, row, strict=True)))
    return dataclasses.replace(rig, fibres=fibres)

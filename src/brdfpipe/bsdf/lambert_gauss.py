"""The perfectly diffuse BSDF of a material of which only the reflectance is known."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.representations.lambert_gauss import LambertGauss


def lambertian(spectrum: xr.Dataset, *, gloss_matters: bool = True) -> xr.Dataset:
    """A perfectly diffuse BSDF, representation ``lambert_gauss``, of a ``spectrum``; where gloss matters, with a warning that none is modelled."""
    vocabulary.validate(spectrum, "spectrum")
    no_lobe = ("theta_i", np.zeros(2))
    bsdf = xr.Dataset(
        {
            "lambert": ("wavelength", spectrum["total_reflectance"].values),
            "gauss_peak": no_lobe,
            "gauss_fwhm_parallel": no_lobe,
            "gauss_fwhm_perpendicular": no_lobe,
            "total_reflectance": ("wavelength", spectrum["total_reflectance"].values),
            "theta_m": float(spectrum.attrs["theta_i"]),
        },
        coords={"wavelength": spectrum["wavelength"].values, "theta_i": [0.0, 90.0]},
        attrs={"representation": LambertGauss.name},
    )
    no_surface = (
        "No surface is given, so the material is modelled as perfectly diffuse: gloss and haze are those of a matt sheet of this "
        "colour. Add a `surface` to material.yaml (a scan, or an assumed finish) to model its gloss."
    )
    warnings = [no_surface] if gloss_matters else []
    if spectrum.attrs["geometry"] == "sce":
        warnings.insert(
            0,
            "The reflectance was measured with the specular excluded (`sce`) and is used as the total reflectance: the light in the gloss "
            "trap is missing. Add a `surface` and an `index` to material.yaml to have it added.",
        )
    return vocabulary.label(vocabulary.add_warning(bsdf, *warnings), "bsdf")

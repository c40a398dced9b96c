"""Lambert + Gaussian: the approximate form that illumination programs take, and the form of a purely diffuse material.

f = ρ/π + G0 exp[−δ∥²/(2σ∥²) − δ⊥²/(2σ⊥²)] with δ∥, δ⊥ the angles from the mirror direction along and across the plane of
incidence (longitude and latitude about it), and FWHM = 2.3548 σ.

References
----------
Patent US 9,395,299 (CRF), approximate forms.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.geometry import Array, unit_vector

FWHM = 2 * np.sqrt(2 * np.log(2))
"""Full width at half maximum of a Gaussian over its σ."""


def lambertian(spectrum: xr.Dataset) -> xr.Dataset:
    """The BSDF of a material of which only the reflectance is known: perfectly diffuse.

    Parameters
    ----------
    spectrum : kind ``spectrum``

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``lambert_gauss``, with a warning that no gloss is modelled
    """
    vocabulary.validate(spectrum, "spectrum")
    nothing = ("theta_i", np.zeros(2))
    bsdf = xr.Dataset(
        {
            "lambert": ("wavelength", spectrum["total_reflectance"].values),
            "gauss_peak": nothing,
            "gauss_fwhm_parallel": nothing,
            "gauss_fwhm_perpendicular": nothing,
            "total_reflectance": ("wavelength", spectrum["total_reflectance"].values),
            "theta_m": float(spectrum.attrs["theta_i"]),
        },
        coords={"wavelength": spectrum["wavelength"].values, "theta_i": [0.0, 90.0]},
        attrs={"representation": "lambert_gauss"},
    )
    if spectrum.attrs["geometry"] == "sce":
        bsdf = vocabulary.add_warning(
            bsdf,
            "the reflectance was measured with the specular excluded and is taken for the total: what the gloss trap swallowed is "
            "missing; add a `surface` and an `index` to material.yaml to have it added",
        )
    return vocabulary.label(
        vocabulary.add_warning(
            bsdf,
            "no surface is given, so the material is modelled as perfectly diffuse: gloss and haze are those of a matt sheet of this "
            "colour; add a `surface` to material.yaml (a scan, or an assumed finish) to model its gloss",
        ),
        "bsdf",
    )


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF in sr⁻¹, (directions…, wavelength); parameters are interpolated between incidences."""
    lambert = bsdf["lambert"]
    if "wavelength" in lambert.dims:
        own = bsdf["wavelength"].values
        base = lambert.values if wavelength is None else np.interp(wavelength, own, lambert.values)
        diffuse = np.broadcast_to(base / np.pi, (*theta_i.shape, base.size))
    else:
        flat = np.interp(theta_i, bsdf["theta_i"].values, np.broadcast_to(lambert.values, bsdf["theta_i"].shape))
        diffuse = flat[..., None] / np.pi
    peak, parallel, perpendicular = (
        np.interp(theta_i, bsdf["theta_i"].values, bsdf[name].values)
        for name in ("gauss_peak", "gauss_fwhm_parallel", "gauss_fwhm_perpendicular")
    )
    along, across = about_mirror(theta_i, theta_o, phi_o - phi_i)
    lobe = gaussian(along, across, peak, parallel / FWHM, perpendicular / FWHM)
    above = (theta_i < 90) & (theta_o < 90)
    return np.where(above[..., None], diffuse + lobe[..., None], 0.0)


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The dataset averaged over wavelength with normalised weights; the Gaussian part is already neutral."""
    if "wavelength" not in bsdf.coords:
        return bsdf
    spectral = {
        str(name): ((), float(weight @ field.values))
        for name, field in bsdf.data_vars.items()
        if field.dims == ("wavelength",)
    }
    return vocabulary.label(bsdf.drop_dims("wavelength").assign(spectral), "bsdf")


def gaussian(
    along: Array, across: Array, peak: Array | float, sigma_parallel: Array | float, sigma_perpendicular: Array | float
) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = (along / sigma_parallel) ** 2 / 2 + (across / sigma_perpendicular) ** 2 / 2
    return np.where(np.asarray(peak) > 0, peak * np.exp(-np.nan_to_num(exponent, nan=0.0, posinf=np.inf)), 0.0)


def about_mirror(theta_i: ArrayLike, theta_o: Array, phi: Array) -> tuple[Array, Array]:
    """Longitude in the plane of incidence and latitude across it, in degree, from the mirror direction of (theta_i, 0)."""
    x, y, z = np.moveaxis(unit_vector(theta_o, phi), -1, 0)
    along = np.degrees(np.arctan2(-x, z)) - theta_i
    return along, np.degrees(np.arcsin(np.clip(y, -1.0, 1.0)))

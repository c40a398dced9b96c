"""The representation ``lambert_gauss``: the approximate form for illumination programs, and the form of a diffuse material.

f = ρ/π + G0 exp[−δ∥²/(2σ∥²) − δ⊥²/(2σ⊥²)] with δ∥, δ⊥ the angles from the mirror direction along and across the plane of
incidence (longitude and latitude about it), and FWHM = 2.3548 σ.

References
----------
Patent US 9,395,299 (CRF), approximate forms.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.geometry import Array, unit_vector

FWHM = 2 * np.sqrt(2 * np.log(2))
"""Full width at half maximum of a Gaussian over its σ."""

FIT_RESULTS = ("gauss_reflectance", "fit_residual", "fit_error_max", "reflectance_error")
"""Further variables of a fit."""


class LambertGauss(Representation):
    """Lambertian plus Gaussian; parameters are interpolated between incidences."""

    name = "lambert_gauss"
    kind = vocabulary.Kind(
        required={
            "lambert": [("theta_i",), ("wavelength",), ()],
            "gauss_peak": [("theta_i",)],
            "gauss_fwhm_parallel": [("theta_i",)],
            "gauss_fwhm_perpendicular": [("theta_i",)],
        },
        optional={
            **{name: [("theta_i",)] for name in FIT_RESULTS},
            "total_reflectance": vocabulary.SPECTRAL,
            "theta_m": vocabulary.SCALAR,
        },
    )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        above, brdf = (theta_i < 90) & (theta_o < 90), self._diffuse(theta_i, wavelength) / np.pi
        if self._has_lobe:
            theta, _, lobe_parameters = self._fields
            peak, parallel, perpendicular = (np.interp(theta_i, theta, values) for values in lobe_parameters)
            along, across = about_mirror(theta_i, theta_o, phi_o - phi_i)
            brdf = brdf + gaussian(along, across, peak, parallel / FWHM, perpendicular / FWHM)[..., None]
        return np.where(above[..., None], brdf, 0.0)

    def _diffuse(self, theta_i: Array, wavelength: Array | None) -> Array:
        """Reflectance of the Lambertian part, (incidences…, wavelength or 1)."""
        theta, lambert, _ = self._fields
        if "wavelength" not in lambert.dims:
            return np.interp(theta_i, theta, np.broadcast_to(lambert.values, theta.shape))[..., None]
        base = lambert.values
        if wavelength is not None:
            base = np.interp(wavelength, self.dataset["wavelength"].values, base)
        return np.broadcast_to(base, (*theta_i.shape, base.size))

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        if self._has_lobe:
            return super().albedo(theta_i, phi_i, wavelength)
        return np.where((theta_i < 90)[..., None], self._diffuse(theta_i, wavelength), 0.0)

    @property
    def albedo_needs_quadrature(self) -> bool:
        return self._has_lobe

    @property
    def _has_lobe(self) -> bool:
        return bool(self._fields[2][0].any())

    @cached_property
    def _fields(self) -> tuple[Array, xr.Variable, list[Array]]:
        """Incidences, the Lambertian part, and peak and widths of the Gaussian."""
        names = ("gauss_peak", "gauss_fwhm_parallel", "gauss_fwhm_perpendicular")
        bsdf = self.dataset
        return bsdf["theta_i"].values, bsdf["lambert"].variable, [bsdf[name].values for name in names]

    @property
    def mirror_symmetric(self) -> bool:
        return True

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The dataset averaged over wavelength; the Gaussian part is neutral."""
        spectral = {
            str(name): ((), float(weight @ field.values))
            for name, field in self.dataset.data_vars.items()
            if field.dims == ("wavelength",)
        }
        return vocabulary.label(self.dataset.drop_dims("wavelength").assign(spectral), "bsdf")

    def without_diffuse(self) -> xr.Dataset:
        return self.dataset.assign(lambert=xr.zeros_like(self.dataset["lambert"]))


def gaussian(
    along: Array, across: Array, peak: Array | float, sigma_parallel: Array | float, sigma_perpendicular: Array | float
) -> Array:
    """Gaussian of angles from the mirror direction [degree], by its peak and widths σ [degree]; 0 if the peak is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = (along / sigma_parallel) ** 2 / 2 + (across / sigma_perpendicular) ** 2 / 2
    # 0/0 at the centre of a lobe of no width.
    lobe = np.exp(-np.where(np.isnan(exponent), 0.0, exponent))
    return np.where(np.asarray(peak) > 0, peak * lobe, 0.0)


def about_mirror(theta_i: ArrayLike, theta_o: Array, phi: Array) -> tuple[Array, Array]:
    """Longitude in the plane of incidence and latitude across it [degree], relative to the mirror direction of (theta_i, 0)."""
    x, y, z = np.moveaxis(unit_vector(theta_o, phi), -1, 0)
    along = np.degrees(np.arctan2(-x, z)) - theta_i
    return along, np.degrees(np.arcsin(np.clip(y, -1.0, 1.0)))

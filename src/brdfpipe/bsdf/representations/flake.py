"""The representation ``flake``: paints with effect pigments, see :mod:`brdfpipe.bsdf.flake`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.spectral import per_wavelength
from brdfpipe.flakes.forms import FORMS, curve
from brdfpipe.flakes.refraction import flake_angle, inner_cosine
from brdfpipe.geometry import Array, frame_rotation, half_vector
from brdfpipe.masking.analytic_smith import beckmann_lambda
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

_FEWEST_HALVINGS = 5
"""To the step of the azimuth of a quadrature."""

PHYSICAL = "flake-physical"
"""Model whose flakes lie below the interface of the clear coat."""


@dataclass(frozen=True)
class ClearCoat:
    """The clear coat above the flakes, which converts the reflection ρ of a flake angle to a BRDF."""

    index: float
    """Refractive index"""
    physical: bool
    """Whether losses and refraction at the interface are modelled"""
    slope: float | None
    """Root mean square slope of a rough coat; None for a smooth one"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> ClearCoat:
        rough = bsdf.attrs["clear_coat"] == "rough"
        slope = float(bsdf["clear_coat_slope"]) if rough else None
        return cls(float(bsdf["clear_coat_index"]), bsdf.attrs["model"] == PHYSICAL, slope)

    def share(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """N(i, o)/N(0, 0) [1], for unpolarised light; 1 without the physical model.

        The coat polarises the light that enters, and a flake, which mirrors s and p alike, passes that on to where it leaves: with
        T = 1 − F and D = (T_s − T_p)/2 both passages let through T_i T_o + D_i D_o cos 2(ψ_i + ψ_o). The angle is between the planes of
        incidence and of exit, as the flake carries the first to the second (:func:`brdfpipe.geometry.frame_rotation`).

        Source: Germer & Marx 2004 (Appl. Opt. 43, 1266).
        """
        if not self.physical:
            return np.ones(np.broadcast(theta_i, phi_i, theta_o, phi_o).shape)
        (mean_i, half_i), (mean_o, half_o) = self._transmittance(theta_i), self._transmittance(theta_o)
        cos_i, cos_o = inner_cosine(theta_i, self.index), inner_cosine(theta_o, self.index)
        below_i, below_o = (np.degrees(np.arccos(cosine)) for cosine in (cos_i, cos_o))
        psi_i, psi_o = frame_rotation(below_i, phi_i, below_o, phi_o)
        passed = mean_i * mean_o + half_i * half_o * np.cos(2 * (psi_i + psi_o))
        return np.asarray(passed / (cos_i * cos_o * self.normal_transmittance**2))

    def gloss(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF of a rough clear coat [sr-1]: Beckmann, height-correlated Smith; 0 for a smooth coat or none."""
        if self.slope is None:
            return np.zeros(np.broadcast(theta_i, phi_i, theta_o, phi_o).shape)
        half = half_vector(theta_i, phi_i, theta_o, phi_o)
        squared = self.slope**2
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            density = np.exp(-half.slope_squared / squared) / (np.pi * squared * half.cos_alpha**4)
            masked = 1 + beckmann_lambda(theta_i, self.slope) + beckmann_lambda(theta_o, self.slope)
            fresnel = fresnel_reflectance(half.cos_zeta, self.index).mean
            lobe = fresnel * density / (4 * half.cos_i * half.cos_o * masked)
        return np.where((half.cos_i > 1e-12) & (half.cos_o > 1e-12), np.nan_to_num(lobe), 0.0)

    @cached_property
    def normal_transmittance(self) -> float:
        return float(self._transmittance(np.zeros(1))[0][0])

    def _transmittance(self, theta: Array) -> tuple[Array, Array]:
        """Transmittance of the interface, the mean of s and p, and half their difference."""
        reflectance = fresnel_reflectance(np.abs(np.cos(np.radians(theta))), self.index)
        return 1 - reflectance.mean, (reflectance.p - reflectance.s) / 2


_CURVES = [("term", "channel"), ("term", "wavelength"), ("term",)]


class Flake(Representation):
    """Reflection as a function of the flake angle, in each channel or at each wavelength."""

    name = "flake"
    kind = vocabulary.Kind(
        required={
            "clear_coat_index": vocabulary.SCALAR,
            "flake_amplitude": _CURVES,
            "flake_decay": _CURVES,
            "flake_constant": [("channel",), ("wavelength",), ()],
            "theta_f_measured": [("geometry",)],
        },
        optional={
            "clear_coat_slope": vocabulary.SCALAR,
            "flake_spectrum": [("theta_f", "wavelength"), ("theta_f",)],
            "flake_covariance": [("channel", "parameter", "parameter_2"), ("wavelength", "parameter", "parameter_2")],
            "misfit": [("geometry", "channel"), ("geometry", "wavelength")],
            "leave_one_out_misfit": [("geometry", "channel"), ("geometry", "wavelength")],
            "delta_e_00": [("geometry",)],
            "leave_one_out": [("geometry",)],
            "reduced_chi_squared": [("channel",), ("wavelength",)],
        },
        attributes=("model", "form", "clear_coat"),
    )
    states_quality = True

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._coat = ClearCoat.of(dataset)
        self._chromaticity_spectrum = per_wavelength(lambda wavelength: _spectrum_of_chromaticity(dataset, wavelength))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        coat, angles = self._coat, np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        above = (angles[0] < 90) & (angles[2] < 90)
        theta_i, phi_i, theta_o, phi_o = (np.where(above, angle, 0.0) for angle in angles)
        factor = self._factor(flake_angle(theta_i, phi_i, theta_o, phi_o, coat.index), wavelength)
        share = coat.share(theta_i, phi_i, theta_o, phi_o) / np.pi
        brdf = factor * share[..., None] + coat.gloss(theta_i, phi_i, theta_o, phi_o)[..., None]
        return np.where(above[..., None], brdf, 0.0)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        """Mirror reflectance of a smooth clear coat, and no transmittance."""
        zero = np.zeros((*np.shape(theta_i), 1))
        if self.dataset.attrs["clear_coat"] != "smooth":
            return zero, zero
        reflectance = fresnel_reflectance(np.abs(np.cos(np.radians(theta_i))), self._coat.index).mean
        return np.where(np.asarray(theta_i) <= 90, reflectance, 0.0)[..., None], zero

    def quality(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.int8]:
        """Measured, interpolated or extrapolated, by the measured flake angles."""
        theta_f = flake_angle(theta_i, phi_i, theta_o, phi_o, self._coat.index)
        measured = self.dataset["theta_f_measured"].values
        inside = (theta_f >= measured.min()) & (theta_f <= measured.max())
        quality = np.where(inside, vocabulary.quality("interpolated"), vocabulary.quality("extrapolated"))
        at_measured = (np.abs(theta_f[..., None] - measured) < 1e-6).any(axis=-1)
        return np.where(at_measured, vocabulary.quality("measured"), quality).astype(np.int8)

    def tristimulus(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, illuminant: str, observer: int
    ) -> Array | None:
        """Of a paint given by colours, under their illuminant and observer; independent of the recovered spectrum."""
        bsdf, coat = self.dataset, self._coat
        if "channel" not in bsdf.dims or (bsdf.attrs["illuminant"], bsdf.attrs["observer"]) != (illuminant, observer):
            return None
        from brdfpipe.spectra import colorimetry

        rho = self._curves(flake_angle(theta_i, phi_i, theta_o, phi_o, coat.index))
        white = colorimetry.weights(illuminant, observer).white
        gloss = np.pi * coat.gloss(theta_i, phi_i, theta_o, phi_o)
        return np.asarray(rho * coat.share(theta_i, phi_i, theta_o, phi_o)[..., None] + gloss[..., None] * white)

    @property
    def mirror_symmetric(self) -> bool:
        return True

    @property
    def lobe_slope(self) -> float:
        """Slope of a rough clear coat, else the slope that corresponds to the narrowest decay, seen from outside."""
        if self._coat.slope is not None:
            return self._coat.slope
        decay = self.dataset["flake_decay"].values[self.dataset["flake_amplitude"].values > 0]
        narrowest = float(decay.min()) if decay.size else 45.0
        return self._coat.index * float(np.tan(np.radians(min(narrowest, 45.0))))

    @property
    def halvings(self) -> int:
        """Cells of a quarter of the width of the narrowest lobe: the form of the model has no narrower one."""
        width = np.degrees(np.arctan(self.lobe_slope))
        return int(np.clip(np.ceil(np.log2(90 / (width / 4))), _FEWEST_HALVINGS, super().halvings))

    @property
    def gloss_caveat(self) -> str:
        if self.dataset.attrs["clear_coat"] != "none":
            return ""
        model = self.dataset.attrs["model"]
        option = "clear_coat: smooth" if self._coat.physical else f"model: {PHYSICAL}"
        return (
            "Gloss and haze are those of the flakes alone, without the clear coat that a gloss meter measures. "
            f"The model `{model}` without a clear coat has no gloss lobe. Set `multiangle.{option}` to model the clear coat."
        )

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The dataset averaged over wavelength, exactly: each wavelength of a spectral fit becomes a term."""
        bsdf = self.dataset
        if "flake_spectrum" in bsdf:
            mean = bsdf["flake_spectrum"].values @ weight
            return vocabulary.label(bsdf.drop_dims("wavelength").assign(flake_spectrum=("theta_f", mean)), "bsdf")
        terms = {
            "flake_amplitude": ("term", (bsdf["flake_amplitude"].values * weight).ravel()),
            "flake_decay": ("term", bsdf["flake_decay"].values.ravel()),
            "flake_constant": ((), float(bsdf["flake_constant"].values @ weight)),
        }
        return vocabulary.label(bsdf.drop_dims(["wavelength", "term"]).assign(terms), "bsdf")

    def _curves(self, theta_f: Array) -> Array:
        """A exp(−θf/B) + C, or another form, on the scale of the fit, (…, channel or wavelength)."""
        return curve(theta_f, *self._parameters)

    @cached_property
    def _parameters(self) -> tuple[Array, Array, Array, int]:
        constant = np.atleast_1d(self.dataset["flake_constant"].values)
        amplitude, decay = (
            self.dataset[name].values.reshape(-1, constant.size) for name in ("flake_amplitude", "flake_decay")
        )
        return amplitude, decay, constant, FORMS[self.dataset.attrs["form"]].power

    @cached_property
    def _luminance_channel(self) -> int:
        return list(self.dataset["channel"].values).index("Y")

    def _factor(self, theta_f: Array, wavelength: Array | None) -> Array:
        """ρ as a fraction, (…, wavelength or 1)."""
        curves = self._curves(theta_f)
        if "flake_spectrum" not in self.dataset:
            if wavelength is None or "wavelength" not in self.dataset.coords:
                return curves
            return np.asarray(curves @ _interpolation_matrix(self.dataset["wavelength"].values, wavelength))
        shape = np.maximum(self._chromaticity_spectrum(wavelength)(theta_f), 0.0)
        luminance = curves[..., self._luminance_channel]
        return np.asarray(shape * (luminance[..., None] / 100))


def _spectrum_of_chromaticity(bsdf: xr.Dataset, wavelength: Array | None) -> CubicSpline:
    """Spectrum of Y = 1 over the flake angle."""
    spectrum = bsdf["flake_spectrum"].values
    if "wavelength" not in bsdf.coords:
        spectrum = spectrum[:, None]
    elif wavelength is not None:
        spectrum = spectrum @ _interpolation_matrix(bsdf["wavelength"].values, wavelength)
    # A spline is linear in its nodes, so Y is 1 between the nodes too.
    return CubicSpline(bsdf["theta_f"].values, spectrum)


def _interpolation_matrix(own: Array, wavelength: Array) -> Array:
    """Matrix (own, wavelength) of linear interpolation."""
    return np.stack([np.interp(wavelength, own, row) for row in np.eye(own.size)])

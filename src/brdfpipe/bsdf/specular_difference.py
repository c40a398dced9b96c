"""The light that a surface mirrors, as two spectra with the specular component included and excluded show it, beside that of its BSDF."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.microfacet.gloss_trap import trap_of
from brdfpipe.bsdf.registry import representation

_RANGE = (400.0, 700.0)
_U = 0.003
"""Standard uncertainty of a reflectance of which none is stated: that of sphere instruments of different make."""
_TRAP_TOLERANCE = 1.0
"""Standard uncertainty of the half angle of the gloss trap [degree]: rims are not sharp, and makers differ."""
_TYPICAL_SLOPE = 0.1
SIGNIFICANT = 2.0
"""Standard uncertainties beyond which a difference is a warning."""
FAR = 0.01
"""Share of the light beyond which a significant difference is a failure: a quarter of what a smooth plastic mirrors."""


class SpecularDifference(NamedTuple):
    """Shares of the light, means over 400 to 700 nm."""

    measured: float
    """SCI − SCE"""
    predicted: float
    """Reflected by the BSDF into the gloss trap"""
    u: float
    """Standard uncertainty of their difference, without that of the BSDF"""
    trap: float
    """Half angle of the gloss trap [degree]"""


def compare(bsdf: xr.Dataset, spectrum: xr.Dataset) -> SpecularDifference | None:
    """Compare the light that the trap of an instrument takes away with what a BSDF reflects there.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    spectrum : kind ``spectrum``; None is returned without ``specular_excluded_reflectance``
    """
    if "specular_excluded_reflectance" not in spectrum:
        return None
    visible = spectrum.sel(wavelength=slice(*_RANGE))
    measured = float((visible["total_reflectance"] - visible["specular_excluded_reflectance"]).mean())
    model, theta_i, trap = representation(bsdf), float(spectrum.attrs["theta_i"]), trap_of(spectrum)
    predicted, wider, narrower = (
        _into_trap(model, theta_i, half_angle)
        for half_angle in (trap, min(trap + _TRAP_TOLERANCE, 90.0), max(trap - _TRAP_TOLERANCE, trap / 2))
    )
    of_spectra = [
        float(visible[f"{name}_u"].mean()) if f"{name}_u" in visible else _U
        for name in ("total_reflectance", "specular_excluded_reflectance")
    ]
    return SpecularDifference(measured, predicted, math.hypot(*of_spectra, (wider - narrower) / 2), trap)


def verdict(found: SpecularDifference) -> tuple[str, str]:
    """Verdict of a comparison, and what it says."""
    off = abs(found.measured - found.predicted)
    text = (
        f"SCI − SCE is {found.measured:.2%} of the light; the BRDF reflects {found.predicted:.2%} within {found.trap:g}° of the mirror "
        f"direction (standard uncertainty of the difference {found.u:.2%}, without that of the BRDF)"
    )
    if off <= SIGNIFICANT * found.u:
        return "pass", text
    less = "smoother" if found.measured > found.predicted else "rougher"
    text += f"; the sample is {less} than the surface, its index is another, or a file is of another sample"
    return "fail" if off > FAR else "warn", text


def _into_trap(model: Representation, theta_i: float, half_angle: float) -> float:
    """Share of the light within a cone about the mirror direction, the mean over visible wavelengths and azimuths."""
    phi = hemisphere.azimuths(model.isotropic)
    own = model.dataset["wavelength"].values if "wavelength" in model.dataset.coords else None
    wavelength = None if own is None else own[(own >= _RANGE[0]) & (own <= _RANGE[1])]
    mirrored = model.specular(np.full(phi.size, theta_i), phi, wavelength)[0].mean()
    theta_o, turn, weight = hemisphere.around_mirror(theta_i, model.lobe_slope or _TYPICAL_SLOPE, half_angle)
    scattered = [
        float(
            (
                weight
                @ model.evaluate(
                    np.full_like(theta_o, theta_i), np.full_like(theta_o, azimuth), theta_o, turn + azimuth, wavelength
                )
            ).mean()
        )
        for azimuth in phi
    ]
    return float(mirrored) + float(np.mean(scattered))

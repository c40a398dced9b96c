"""What each representation of a BSDF can do, by name."""

from __future__ import annotations

from types import ModuleType
from typing import Protocol, cast

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import hemisphere
from brdfpipe.bsdf import lambert_gauss, microfacet, table
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array


class Representation(Protocol):
    """The functions a representation's module offers, on plain arrays in degree and nm."""

    def evaluate(
        self, bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """BRDF in sr⁻¹, (directions…, wavelength or 1)."""

    def nonspectral(self, bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
        """The dataset averaged over wavelength with normalised weights."""


_FINE_SLOPE = 2e-3
"""Scale of the narrowest lobe that is expected of a representation that does not know its own."""

_MODULES: dict[str, ModuleType] = {"microfacet": microfacet, "lambert_gauss": lambert_gauss, "table": table}


def representation(bsdf: xr.Dataset) -> Representation:
    """The module that evaluates a dataset.

    Raises
    ------
    VocabularyError : it is no ``bsdf``, or of an unknown representation.
    """
    name = bsdf.attrs.get("representation")
    if name not in _MODULES:
        raise VocabularyError(f"not an evaluable bsdf: representation {name!r}; known: {', '.join(_MODULES)}")
    return cast(Representation, _MODULES[name])


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Directional reflectance [1], (incidences…, wavelength or 1): the representation's own, else by quadrature.

    The quadrature is graded towards the mirror direction and assumes a lobe that is even about the plane of incidence.
    """
    module = representation(bsdf)
    if hasattr(module, "albedo"):
        return np.asarray(module.albedo(bsdf, theta_i, phi_i, wavelength))
    values = []
    for theta, phi in zip(theta_i.ravel(), phi_i.ravel(), strict=True):
        rule = hemisphere.around_mirror(float(theta), _FINE_SLOPE)
        brdf = module.evaluate(
            bsdf, np.full_like(rule.theta, theta), np.full_like(rule.phi, phi), rule.theta, rule.phi + phi, wavelength
        )
        values.append(rule.weight @ brdf)
    return np.stack(values).reshape(*theta_i.shape, -1)


def lobe_slope(bsdf: xr.Dataset) -> float | None:
    """A typical slope of the facets behind the specular lobe [1]; None where the representation does not know it."""
    module = representation(bsdf)
    return float(module.lobe_slope(bsdf)) if hasattr(module, "lobe_slope") else None


def nonspectral(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> xr.Dataset:
    """The BSDF seen by a detector of spectral response ``weight``; see :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.nonspectral`."""
    if "wavelength" not in bsdf.coords:
        return bsdf
    wavelength = bsdf["wavelength"].values
    if weight is None:
        from brdfpipe.spectra import colorimetry

        weight = colorimetry.luminous_weight(wavelength)
    response = np.asarray(weight, dtype=float)
    if (
        response.shape != wavelength.shape
        or not np.isfinite(response).all()
        or response.min() < 0
        or not response.any()
    ):
        raise VocabularyError(
            f"the weight needs {wavelength.size} finite values >= 0, not all 0; found shape {response.shape}"
        )
    return representation(bsdf).nonspectral(bsdf, response / response.sum())


def total_reflectance(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Wavelengths and the total reflectance at 8°, integrated from the BSDF; a neutral one on two wavelengths."""
    values = albedo(bsdf, np.array([8.0]), np.zeros(1), None)[0]
    if "wavelength" in bsdf.coords:
        return bsdf["wavelength"].values, np.broadcast_to(values, bsdf["wavelength"].shape)
    return np.array([360.0, 780.0]), np.repeat(values, 2)

"""What representations share whose surface has a table of its directional albedo, over a coupled diffuse base."""

from __future__ import annotations

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.coupled_base import CoupledBase
from brdfpipe.bsdf.spectral import per_wavelength
from brdfpipe.geometry import Array

COUPLED_SURFACE = {
    **dict.fromkeys(("mean_albedo", "diffuse"), vocabulary.SPECTRAL),
    "directional_albedo": [("theta_i", "wavelength"), ("theta_i",)],
    "theta_m": vocabulary.SCALAR,
}
"""Variables of the table and of the base; ``total_reflectance`` is optional."""

_TABLES = ("directional_albedo", "mean_albedo", "diffuse", "total_reflectance")


class CoupledSurface(Representation):
    """A surface over a diffuse base. ``_base`` is the base at wavelengths; subclasses evaluate the surface."""

    states_uncertainty = True
    uses_index = True

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._base = per_wavelength(lambda wavelength: CoupledBase.of(dataset, wavelength))

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._base(wavelength).total_albedo(theta_i)

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def albedo_accuracy(self) -> float:
        return self.accuracy

    def without_diffuse(self) -> xr.Dataset:
        return self.dataset.assign(diffuse=xr.zeros_like(self.dataset["diffuse"]))

    def _without_wavelength(self, weight: Array) -> xr.Dataset:
        """The dataset with the mean over wavelength of albedo and base; what else depends on wavelength is left out."""
        bsdf = self.dataset
        means = {
            name: (bsdf[name].dims[:-1], bsdf[name].values @ weight)
            for name in _TABLES
            if name in bsdf and "wavelength" in bsdf[name].dims
        }
        return bsdf.drop_dims("wavelength", errors="ignore").assign(means)

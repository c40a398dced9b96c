"""The representation of a measured BSDF, see :mod:`brdfpipe.bsdf.measured`."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.measured import basis, evaluation
from brdfpipe.bsdf.spectral import per_wavelength
from brdfpipe.geometry import Array

_WAVELENGTHS = ("wavelength", "mixed")


class Measured(Representation):
    """A BSDF smoothed at measured incidences, interpolated between them and completed beyond them.

    Its attribute ``representation`` is ``rig``: stored datasets and exported files have it.
    """

    name = evaluation.REPRESENTATION
    kind = vocabulary.Kind(
        required={
            "coefficient": [("node", spectral, "term") for spectral in _WAVELENGTHS],
            "coefficient_factor": [("node", spectral, "term", "factor") for spectral in _WAVELENGTHS],
            "lowest": [("node", spectral) for spectral in _WAVELENGTHS],
            "highest": [("node", spectral) for spectral in _WAVELENGTHS],
            "coefficient_quality": [("node", spectral) for spectral in _WAVELENGTHS],
            "incidence": [("node",)],
            "transmitted": [("node",)],
            "horizon": [("node",)],
            "cell_quality": [("node", "cell")],
            "theta_s": [("cell",)],
            "phi_s": [("cell",)],
            "solid_angle": [("cell",)],
        },
        optional={
            "coefficient_common": [("component", "node", spectral, "term") for spectral in _WAVELENGTHS],
            "incidence_error": [("theta_i", "error_angle", "error_azimuth")],
            "mixture": [("mixed",)],
        },
        attributes=("link", "about", "basis", "reciprocity", "transmission"),
    )
    accuracy = evaluation.ACCURACY
    states_uncertainty = True
    states_quality = True

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._prepared = per_wavelength(lambda wavelength: evaluation.Prepared(dataset, wavelength))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._prepared(wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)

    def uncertainty(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        return self._prepared(wavelength).uncertainty(theta_i, phi_i, theta_o, phi_o)

    def quality(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.int8]:
        return evaluation.quality(self.dataset, theta_i, phi_i, theta_o, phi_o)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        if self.albedo_needs_quadrature:
            return super().albedo(theta_i, phi_i, wavelength)
        return evaluation.albedo(self.dataset, theta_i, phi_i, wavelength)

    def albedo_uncertainty(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return evaluation.albedo_uncertainty(self.dataset, theta_i, phi_i, wavelength)

    @property
    def albedo_needs_quadrature(self) -> bool:
        """The rule about the mirror direction covers one side of the plane of incidence."""
        return not basis.from_json(self.dataset.attrs["basis"]).symmetric

    @property
    def mirror_symmetric(self) -> bool:
        return not self.albedo_needs_quadrature

    @property
    def lobe_slope(self) -> float:
        return evaluation.lobe_slope(self.dataset)

    def nonspectral(self, weight: Array) -> xr.Dataset:
        return evaluation.nonspectral(self.dataset, weight)

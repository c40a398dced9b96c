"""The representation ``slab``: a plane-parallel sheet in air, see :mod:`brdfpipe.bsdf.slab`."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.slab.body import Mixture
from brdfpipe.bsdf.slab.model import SIDES, SlabModel, share, surface_of
from brdfpipe.bsdf.spectral import per_wavelength
from brdfpipe.geometry import Array

_UNRESOLVED_SLOPE = 1e-6
"""A slope that no instrument resolves."""

_BALANCE = [("theta_i", "wavelength"), ("theta_i",)]

_TABLE_DIMS = ("path", "theta_low", "span", "turn", "node")


class Slab(Representation):
    """Faces evaluated by their facets, light that has been inside by a table; shares of the light by their own tables."""

    name = "slab"
    kind = vocabulary.Kind(
        required={
            "n": vocabulary.SPECTRAL,
            "internal_transmittance": vocabulary.SPECTRAL,
            "reflectance": _BALANCE,
            "transmittance": _BALANCE,
            "absorptance": _BALANCE,
            "specular_reflectance": _BALANCE,
            "specular_transmittance": _BALANCE,
            "front_diffuse": [("theta",), ("theta", "wavelength")],
            "back_diffuse": [("theta",), ("theta", "wavelength")],
            "log_scattered": [_TABLE_DIMS],
            "lobe_scale": vocabulary.SCALAR,
            "interpolation_error": vocabulary.SCALAR,
            "quadrature_error": vocabulary.SCALAR,
        },
        optional={
            "front_slope_density": [("front_slope",)],
            "front_lambda_smith": [("front_theta",)],
            "back_slope_density": [("back_slope",)],
            "back_lambda_smith": [("back_theta",)],
        },
        attributes=("masking", "transmission"),
    )
    uses_index = True
    transmittance_needs_quadrature = False

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        front, back = (surface_of(dataset, side) for side in SIDES)
        self._surfaces = (front, back)
        self._model = per_wavelength(lambda wavelength: SlabModel.of(dataset, wavelength, (front, back)))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return share(self.dataset, "reflectance", theta_i, wavelength)

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return share(self.dataset, "transmittance", theta_i, wavelength)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        names = ("specular_reflectance", "specular_transmittance")
        mirrored, straight = (share(self.dataset, name, theta_i, wavelength) for name in names)
        return mirrored, straight

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def lobe_slope(self) -> float:
        """The slope that half of the facets of the smoother of the rough faces exceed."""
        return min(
            (surface.median_slope for surface in self._surfaces if surface is not None), default=_UNRESOLVED_SLOPE
        )

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The slab with the light that has been inside averaged with the weight, and the average index.

        What a face reflects at once is exact to second order in the spread of the index.
        """
        bsdf = self.dataset
        by_wavelength = bsdf["log_scattered"].values @ Mixture.of(bsdf, None).weights.T
        mean = np.maximum(np.exp(by_wavelength) @ weight, 1e-300)
        reduced = bsdf.drop_dims(["wavelength", "node", "index_node", "depth_node"]).assign(
            {
                name: (field.dims[:-1], field.values @ weight)
                for name, field in bsdf.data_vars.items()
                if "wavelength" in field.dims
            }
        )
        reduced = reduced.assign_coords(index_node=[float(reduced["n"])], depth_node=[0.0])
        table = np.log(mean)[..., None].astype(np.float32)
        return vocabulary.label(reduced.assign(log_scattered=(_TABLE_DIMS, table)), "bsdf")

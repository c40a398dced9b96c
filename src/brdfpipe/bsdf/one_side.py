"""One side of a BSDF that transmits, as a BSDF that reflects alone: for files that hold one side each.

Transmitted light is folded over the surface: the value at (θ_o, φ_o) is that at (180 − θ_o, φ_o), so light that goes straight on has the place of mirrored light.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.registry import REPRESENTATIONS, representation
from brdfpipe.geometry import Array

Side = Literal["reflection", "transmission"]


def one_side(bsdf: xr.Dataset, side: Side) -> xr.Dataset:
    """The light that a BSDF reflects, or transmits, from above; the BSDF itself if it reflects alone and that side is asked for."""
    if side == "reflection" and not representation(bsdf).transmits:
        return bsdf
    whole = bsdf.attrs["representation"], bsdf.attrs.get("transmission", "none")
    return bsdf.assign_attrs(
        representation=OneSide.name,
        transmission="none",
        one_side=side,
        whole_representation=whole[0],
        whole_transmission=whole[1],
    )


class OneSide(Representation):
    """The dataset of a BSDF of which one side is seen."""

    name = "one_side"
    kind = vocabulary.Kind(required={}, attributes=("one_side", "whole_representation", "whole_transmission"))

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._side: Side = dataset.attrs["one_side"]
        # The representation is cached as long as the dataset lives.
        self._dataset_of_whole = _whole(dataset)
        self._whole = representation(self._dataset_of_whole)

    def _folded(self, theta_o: Array) -> Array:
        return 180 - np.asarray(theta_o) if self._side == "transmission" else np.asarray(theta_o)

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        values = self._whole.evaluate(theta_i, phi_i, self._folded(theta_o), phi_o, wavelength)
        above = np.broadcast_to((np.asarray(theta_i) < 90) & (np.asarray(theta_o) < 90), values.shape[:-1])
        return np.where(above[..., None], values, 0.0)

    def tristimulus(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, illuminant: str, observer: int
    ) -> Array | None:
        return self._whole.tristimulus(theta_i, phi_i, self._folded(theta_o), phi_o, illuminant, observer)

    def nonspectral(self, weight: Array) -> xr.Dataset:
        return one_side(self._whole.nonspectral(weight), self._side)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        whole = self._whole.transmittance if self._side == "transmission" else self._whole.albedo
        return whole(theta_i, phi_i, wavelength)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        share = self._whole.specular(theta_i, phi_i, wavelength)[self._side == "transmission"]
        return share, np.zeros_like(share)

    @property
    def albedo_needs_quadrature(self) -> bool:
        if self._side == "transmission":
            return self._whole.transmittance_needs_quadrature
        return self._whole.albedo_needs_quadrature

    @property
    def isotropic(self) -> bool:
        return self._whole.isotropic

    @property
    def mirror_symmetric(self) -> bool:
        return self._whole.mirror_symmetric

    @property
    def lay(self) -> float | None:
        return self._whole.lay

    @property
    def lobe_slope(self) -> float | None:
        return self._whole.lobe_slope

    def lobe_slope_at(self, theta_i: float) -> float | None:
        return self._whole.lobe_slope_at(theta_i)

    @property
    def non_smooth_angles(self) -> tuple[Array, Array]:
        polar, azimuths = self._whole.non_smooth_angles
        folded = self._folded(polar)
        return np.sort(folded[folded < 90]), azimuths

    def stored_incidences(self) -> tuple[Array, Array]:
        return self._whole.stored_incidences()


def _whole(dataset: xr.Dataset) -> xr.Dataset:
    kept = {name: value for name, value in dataset.attrs.items() if name not in OneSide.kind.attributes}
    whole = dataset.copy()
    whole.attrs = {
        **kept,
        "representation": dataset.attrs["whole_representation"],
        "transmission": dataset.attrs["whole_transmission"],
    }
    return whole


REPRESENTATIONS[OneSide.name] = OneSide

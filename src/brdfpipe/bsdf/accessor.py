"""``dataset.bsdf``: evaluate, integrate, tabulate and check any BSDF, whatever its representation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import vocabulary
from brdfpipe.bsdf import checks, representations, tabulation
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, broadcast, checked_angles


@xr.register_dataset_accessor("bsdf")  # type: ignore[no-untyped-call]
class BSDFAccessor:
    """A ``bsdf`` dataset as a function of directions and wavelength."""

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    def evaluate(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: ArrayLike | None = None,
    ) -> xr.DataArray:
        """BRDF or BTDF at any directions.

        Parameters
        ----------
        theta_i, phi_i, theta_o, phi_o : degree; 0 <= θ <= 180, θ_o > 90 is transmission. Plain arrays broadcast as in numpy
            (they are paired, not crossed) into the dimension ``direction``; DataArrays broadcast by dimension name
        wavelength : nm; by default the dataset's own. A BSDF that does not depend on wavelength accepts any

        Returns
        -------
        DataArray ``brdf`` [sr-1], with the dimension ``wavelength`` last where there is one. Directions at or below the
        horizon of a side the BSDF does not describe give 0

        Raises
        ------
        VocabularyError : an angle is out of range or labelled as radians, or a wavelength lies outside the data.
        """
        angles = broadcast(
            theta_i=checked_angles("theta_i", theta_i, 0, 180),
            phi_i=checked_angles("phi_i", phi_i, -720, 720),
            theta_o=checked_angles("theta_o", theta_o, 0, 180),
            phi_o=checked_angles("phi_o", phi_o, -720, 720),
        )
        asked = self._wavelengths(wavelength)
        plain = [angle.values for angle in angles]
        module = representations.representation(self._dataset)
        values = module.evaluate(self._dataset, plain[0], plain[1], plain[2], plain[3], asked)
        return self._labelled(
            values, angles[0], asked, "brdf", "bidirectional reflectance distribution function", "sr-1"
        )

    def albedo(self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: ArrayLike | None = None) -> xr.DataArray:
        """Directional reflectance: the share of the light from one direction that is reflected into the hemisphere.

        Parameters
        ----------
        theta_i, phi_i : degree, broadcast as in :meth:`evaluate`; 0 <= theta_i <= 90
        wavelength : nm; by default the dataset's own

        Returns
        -------
        DataArray ``albedo`` [1]
        """
        angles = broadcast(
            theta_i=checked_angles("theta_i", theta_i, 0, 90), phi_i=checked_angles("phi_i", phi_i, -720, 720)
        )
        asked = self._wavelengths(wavelength)
        values = representations.albedo(self._dataset, angles[0].values, angles[1].values, asked)
        return self._labelled(values, angles[0], asked, "albedo", "directional reflectance", "1")

    def tabulate(self, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
        """The BSDF on a grid, as representation ``table``; see :func:`brdfpipe.bsdf.tabulation.tabulate`."""
        return tabulation.tabulate(self._dataset, grid)

    def check(self) -> xr.Dataset:
        """Reciprocity, energy, positivity and closure; see :func:`brdfpipe.bsdf.checks.check`."""
        return checks.check(self._dataset)

    def nonspectral(self, weight: ArrayLike | None = None) -> xr.Dataset:
        """The BSDF seen by a detector of one spectral response.

        Parameters
        ----------
        weight : response on the dataset's wavelengths, any scale; by default V(λ) times the illuminant D65

        References
        ----------
        ASTM E1392 "integrated" data; CIE 015, V(λ) and D65.
        """
        return representations.nonspectral(self._dataset, weight)

    def _wavelengths(self, wavelength: ArrayLike | None) -> Array | None:
        if wavelength is None:
            return None
        asked = np.atleast_1d(np.asarray(wavelength, dtype=float))
        if asked.ndim != 1 or not np.isfinite(asked).all():
            raise VocabularyError(f"wavelength must be finite and one-dimensional; found shape {asked.shape}")
        if "wavelength" in self._dataset.coords:
            own = self._dataset["wavelength"].values
            if asked.size and (asked.min() < own[0] or asked.max() > own[-1]):
                raise VocabularyError(
                    f"wavelength spans {asked.min():g} to {asked.max():g} nm; the data cover {own[0]:g} to {own[-1]:g} nm"
                )
        return asked

    def _labelled(
        self, values: Array, like: xr.DataArray, asked: Array | None, name: str, long_name: str, units: str
    ) -> xr.DataArray:
        own = self._dataset["wavelength"].values if "wavelength" in self._dataset.coords else None
        wavelength = asked if asked is not None else own
        attrs = {"units": units, "long_name": long_name}
        if wavelength is None:
            return xr.DataArray(values[..., 0], like.coords, like.dims, name, attrs)
        values = np.broadcast_to(values, (*values.shape[:-1], wavelength.size))
        spectral = (
            "wavelength",
            wavelength,
            {"units": "nm", "long_name": vocabulary.QUANTITIES["wavelength"].long_name},
        )
        coords = {**dict(like.coords), "wavelength": spectral}
        return xr.DataArray(values, coords, (*like.dims, "wavelength"), name, attrs)

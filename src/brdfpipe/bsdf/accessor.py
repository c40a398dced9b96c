"""``dataset.bsdf``: evaluate, integrate, tabulate and check any BSDF, of any representation."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import store, vocabulary
from brdfpipe.bsdf import approximation_error, checks, tabulation
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import REPRESENTATIONS, representation
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, broadcast, check_angles, checked_angles


class BSDFAccessor:
    """A ``bsdf`` dataset as a function of directions and wavelength."""

    def __init__(self, dataset: xr.Dataset) -> None:
        representation(dataset)  # refuses what is no BSDF
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
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        wavelengths = self._wavelengths(wavelength)
        values = self._representation.evaluate(*_values(angles), wavelengths)
        return self._labelled(
            values, angles[0], wavelengths, "brdf", "bidirectional reflectance distribution function", "sr-1"
        )

    def uncertainty(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: ArrayLike | None = None,
    ) -> xr.DataArray:
        """Standard uncertainty (k = 1) of :meth:`evaluate`; arguments as there.

        Returns
        -------
        DataArray ``brdf_u`` [sr-1]

        Raises
        ------
        VocabularyError : as :meth:`evaluate`, or the representation states no uncertainty.
        """
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        wavelengths = self._wavelengths(wavelength)
        if not self._representation.states_uncertainty:
            stating = ", ".join(name for name, each in REPRESENTATIONS.items() if each.states_uncertainty)
            raise VocabularyError(
                f"the representation {self._representation.name!r} states no uncertainty; those that do: {stating}"
            )
        values = self._representation.uncertainty(*_values(angles), wavelengths)
        return self._labelled(values, angles[0], wavelengths, "brdf_u", "standard uncertainty of the BSDF", "sr-1")

    def albedo(self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: ArrayLike | None = None) -> xr.DataArray:
        """Directional reflectance: the share of the light that leaves on the side it comes from, mirror reflection included.

        Parameters
        ----------
        theta_i, phi_i : degree, broadcast as in :meth:`evaluate`; above 90 for light from within the body
        wavelength : nm; by default the dataset's own

        Returns
        -------
        DataArray ``albedo`` [1]; the representation's own, or an adaptive quadrature to 1e-6, see
        :meth:`brdfpipe.bsdf.base.Representation.integrate`
        """
        return self._share(self._representation.albedo, theta_i, phi_i, wavelength, "albedo", "directional reflectance")

    def transmittance(
        self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: ArrayLike | None = None
    ) -> xr.DataArray:
        """Directional transmittance: the share of the light that leaves on the other side; arguments as for :meth:`albedo`.

        Returns
        -------
        DataArray ``transmittance`` [1]; 0 where the material does not transmit
        """
        return self._share(
            self._representation.transmittance, theta_i, phi_i, wavelength, "transmittance", "directional transmittance"
        )

    def specular(
        self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: ArrayLike | None = None
    ) -> tuple[xr.DataArray, xr.DataArray]:
        """Reflectance and transmittance of perfectly smooth surfaces, which :meth:`evaluate` cannot show; arguments as for :meth:`albedo`."""
        names = (("specular_reflectance", "mirror reflectance"), ("specular_transmittance", "regular transmittance"))
        return tuple(  # type: ignore[return-value]
            self._share(lambda *at, k=k: self._representation.specular(*at)[k], theta_i, phi_i, wavelength, *words)
            for k, words in enumerate(names)
        )

    def sample(
        self, n: int, seed: int, theta_i: float, phi_i: float = 0.0, wavelength: ArrayLike | None = None
    ) -> xr.Dataset:
        """Draw outgoing directions as the BSDF sends its light.

        Parameters
        ----------
        n : number of directions
        seed : of numpy's default generator; the same seed gives the same directions
        theta_i, phi_i : degree, one incidence; theta_i above 90 for light from within the body
        wavelength : nm; by default the dataset's own. The density follows the mean over these

        Returns
        -------
        Dataset of kind ``samples``: ``theta_o`` and ``phi_o``, ``pdf`` [sr-1], ``weight`` = f |cos θ_o| / pdf per wavelength, whose mean is
        the reflectance plus the transmittance, and ``weight_variance``. ``specular`` marks rays of a perfectly smooth surface: their
        ``pdf`` is missing, and their weight is the reflectance (or transmittance) over the probability that they were drawn with

        Raises
        ------
        VocabularyError : n is no positive integer, or an angle or a wavelength is out of range.
        """
        theta, phi = self._incidence(theta_i, phi_i)
        return self._representation.sample(n, seed, theta, phi, self._wavelengths(wavelength))

    def pdf(
        self,
        theta_i: float,
        phi_i: float,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: ArrayLike | None = None,
    ) -> xr.DataArray:
        """Density with which :meth:`sample` draws outgoing directions.

        Parameters
        ----------
        theta_i, phi_i : degree, one incidence
        theta_o, phi_o : degree, broadcast as in :meth:`evaluate`
        wavelength : the one(s) given to :meth:`sample`

        Returns
        -------
        DataArray ``pdf`` [sr-1]; its integral over the sphere is 1 less the probability of specular rays
        """
        theta, phi = self._incidence(theta_i, phi_i)
        outgoing = broadcast(
            theta_o=checked_angles("theta_o", theta_o, 0, 180), phi_o=checked_angles("phi_o", phi_o, -720, 720)
        )
        values = self._representation.pdf(
            theta, phi, outgoing[0].values, outgoing[1].values, self._wavelengths(wavelength)
        )
        attrs = {"units": "sr-1", "long_name": vocabulary.QUANTITIES["pdf"].long_name}
        return xr.DataArray(values, outgoing[0].coords, outgoing[0].dims, "pdf", attrs)

    def tabulate(self, grid: Mapping[str, ArrayLike]) -> xr.Dataset:
        """The BSDF on a grid, as representation ``table``; see :func:`brdfpipe.bsdf.tabulation.tabulate`."""
        return tabulation.tabulate(self._dataset, grid)

    def check(self) -> xr.Dataset:
        """Reciprocity, energy, positivity and closure; see :func:`brdfpipe.bsdf.checks.check`."""
        return checks.check(self._dataset)

    def mueller(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: ArrayLike | None = None,
    ) -> xr.DataArray:
        """Mueller matrix of the BRDF, for light polarised in any way.

        Parameters
        ----------
        theta_i, phi_i, theta_o, phi_o, wavelength : as in :meth:`evaluate`

        Returns
        -------
        DataArray ``mueller`` [sr-1], with the dimensions ``stokes_out`` and ``stokes_in`` last: what comes out, of what comes in,
        as Stokes vectors I, Q, U, V in the s–p frames of both directions (:mod:`brdfpipe.bsdf.microfacet.polarised`). Its first element
        is the BRDF; a representation that knows nothing of polarisation depolarises. NaN where light passes a transparent
        interface, or meets it from within

        Raises
        ------
        VocabularyError : as :meth:`evaluate`
        """
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        wavelengths = self._wavelengths(wavelength)
        values = self._representation.mueller(*_values(angles), wavelengths)
        first = self._labelled(
            values[..., 0, 0], angles[0], wavelengths, "mueller", "Mueller matrix of the BRDF", "sr-1"
        )
        stokes = ["I", "Q", "U", "V"]
        return xr.DataArray(
            np.broadcast_to(values, (*first.shape, 4, 4)) if "wavelength" in first.dims else values[..., 0, :, :],
            {**dict(first.coords), "stokes_out": stokes, "stokes_in": stokes},
            (*first.dims, "stokes_out", "stokes_in"),
            "mueller",
            first.attrs,
        )

    def nonspectral(self, weight: ArrayLike | None = None) -> xr.Dataset:
        """The BSDF seen by a detector of one spectral response.

        Parameters
        ----------
        weight : response on the dataset's wavelengths, any scale; by default V(λ) times the illuminant D65

        References
        ----------
        ASTM E1392 "integrated" data; CIE 015, V(λ) and D65.
        """
        return nonspectral(self._dataset, weight)

    def nonspectral_error(
        self, weight: ArrayLike | None = None, theta_i: ArrayLike = (8.0, 30.0, 60.0, 80.0)
    ) -> xr.Dataset:
        """What :meth:`nonspectral` costs; see :func:`brdfpipe.bsdf.approximation_error.nonspectral_error`."""
        return approximation_error.nonspectral_error(self._dataset, weight, theta_i)

    @property
    def _representation(self) -> Representation:
        return representation(self._dataset)

    def _share(
        self,
        share: Callable[[Array, Array, Array | None], Array],
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        wavelength: ArrayLike | None,
        name: str,
        long_name: str,
    ) -> xr.DataArray:
        highest = 180 if self._representation.transmits else 90
        angles = broadcast(
            theta_i=checked_angles("theta_i", theta_i, 0, highest), phi_i=checked_angles("phi_i", phi_i, -720, 720)
        )
        wavelengths = self._wavelengths(wavelength)
        values = share(angles[0].values, angles[1].values, wavelengths)
        return self._labelled(values, angles[0], wavelengths, name, long_name, "1")

    def _incidence(self, theta_i: ArrayLike, phi_i: ArrayLike) -> tuple[float, float]:
        highest = 180 if self._representation.transmits else 90
        angles = check_angles("theta_i", theta_i, 0, highest), check_angles("phi_i", phi_i, -720, 720)
        if any(angle.size != 1 for angle in angles):
            raise VocabularyError("directions are drawn for one incidence at a time: give theta_i and phi_i as numbers")
        return float(angles[0].item()), float(angles[1].item())

    def _wavelengths(self, wavelength: ArrayLike | None) -> Array | None:
        if wavelength is None:
            return None
        units = getattr(wavelength, "attrs", {}).get("units", "nm")
        if units != "nm":
            raise VocabularyError(f"wavelength is in {units!r}; wavelengths are in nm")
        wavelengths = np.atleast_1d(np.asarray(wavelength, dtype=float))
        if wavelengths.ndim != 1 or not np.isfinite(wavelengths).all():
            raise VocabularyError(f"wavelength must be finite and one-dimensional; found shape {wavelengths.shape}")
        if "wavelength" in self._dataset.coords:
            own = self._dataset["wavelength"].values
            if wavelengths.size and (wavelengths.min() < own[0] or wavelengths.max() > own[-1]):
                raise VocabularyError(
                    f"wavelength spans {wavelengths.min():g} to {wavelengths.max():g} nm; the data cover {own[0]:g} to {own[-1]:g} nm"
                )
        return wavelengths

    def _labelled(
        self, values: Array, like: xr.DataArray, wavelengths: Array | None, name: str, long_name: str, units: str
    ) -> xr.DataArray:
        own = self._dataset["wavelength"].values if "wavelength" in self._dataset.coords else None
        wavelength = own if wavelengths is None else wavelengths
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


def open_dataset(path: str | os.PathLike[str], kind: str | None = None) -> xr.Dataset:
    """Read a stored dataset; one of kind ``bsdf`` has the accessor ``.bsdf``.

    Raises
    ------
    StoreError, VocabularyError : as :func:`brdfpipe.store.open_dataset`, or the representation of a BSDF is unknown.
    """
    dataset = store.open_dataset(path, kind)
    if dataset.attrs.get("kind") == "bsdf":
        representation(dataset)
    return dataset


def _directions(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> tuple[xr.DataArray, ...]:
    return broadcast(
        theta_i=checked_angles("theta_i", theta_i, 0, 180),
        phi_i=checked_angles("phi_i", phi_i, -720, 720),
        theta_o=checked_angles("theta_o", theta_o, 0, 180),
        phi_o=checked_angles("phi_o", phi_o, -720, 720),
    )


def _values(angles: tuple[xr.DataArray, ...]) -> tuple[Array, Array, Array, Array]:
    theta_i, phi_i, theta_o, phi_o = (angle.values for angle in angles)
    return theta_i, phi_i, theta_o, phi_o

"""``dataset.bsdf``: evaluate, integrate, tabulate and check a BSDF of any representation."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Hashable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import store, vocabulary
from brdfpipe.bsdf import approximation_error, checks, summary, tabulation
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import REPRESENTATIONS, representation
from brdfpipe.bsdf.source_changes import SourceChanges, in_quadrature
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, broadcast, check_angles, checked_angles

Wavelengths: TypeAlias = ArrayLike | None
"""nm; None for those of the dataset."""


class BSDFAccessor:
    """A ``bsdf`` dataset as a function of directions and wavelength."""

    def __init__(self, dataset: xr.Dataset) -> None:
        representation(dataset)  # refuses a dataset that is not a BSDF
        self._dataset = dataset
        self._of_one_direction: dict[tuple[str, bytes | None], _Template] = {}
        self._wavelength_variable: xr.Variable | None = None
        self._wavelength_values: Array | None = None

    def __repr__(self) -> str:
        return summary.text(self._dataset)

    def _repr_html_(self) -> str:
        return summary.html(self._dataset)

    @property
    def plot(self) -> Any:
        """Figures, which need ``pip install 'brdfpipe[plot]'``: ``.plot.polar()``, ``.cartesian()``, ``.lobe()``, ``.map()`` and ``.preview()``.

        See :class:`brdfpipe.figures.bsdf_plots.BSDFPlots`.
        """
        # Figures belong to a higher layer, which the public package loads at first use; no stage asks an accessor for one.
        return sys.modules["brdfpipe"].figures.BSDFPlots(self._dataset)

    def textured(self, texture: xr.Dataset, rest: xr.Dataset | None = None) -> Any:
        """The BRDF with its visible structure: ``.textured(texture, rest).evaluate(theta_i, phi_i, theta_o, phi_o, x, y)``.

        See :class:`brdfpipe.texture.textured.Textured`, which takes ``texture.nc`` and ``unresolved.nc``, or ``picture_texture.nc`` alone.
        """
        # Of a higher layer, as figures are.
        return sys.modules["brdfpipe"].texture.Textured(self._dataset, texture, rest)

    def evaluate(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: Wavelengths = None,
        *,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        texture: xr.Dataset | None = None,
        rest: xr.Dataset | None = None,
    ) -> xr.DataArray:
        """BRDF or BTDF.

        Parameters
        ----------
        theta_i, phi_i, theta_o, phi_o : degree; 0 <= θ <= 180, θ_o > 90 is transmission. Plain arrays broadcast as in numpy
            (they are paired, not crossed) into the dimension ``direction``; DataArrays broadcast by dimension name
        wavelength : nm; by default the dataset's own. A BSDF that does not depend on wavelength accepts any
        x, y : places of the surface [um], in pairs that broadcast with the directions, on the visible structure of ``texture`` and ``rest``
            (:meth:`textured`); by default the mean over the surface

        Returns
        -------
        DataArray ``brdf`` [sr-1], with ``wavelength`` as the last dimension if it depends on wavelength. At the horizon, and on a
        side that the BSDF does not describe, it is 0. Of places it has the dimension ``place``

        Raises
        ------
        VocabularyError : an angle is out of range or in radians, or a wavelength is outside the data; or only some of x, y and texture are given.
        """
        if x is not None and y is not None and texture is not None:
            return self.textured(texture, rest).evaluate(theta_i, phi_i, theta_o, phi_o, x, y, wavelength)
        missing = [name for name, one in (("x", x), ("y", y), ("texture", texture)) if one is None]
        if len(missing) < 3:
            raise VocabularyError(f"places need x, y and texture; missing: {', '.join(missing)}")
        text = "bidirectional reflectance distribution function"
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        return self._labelled(self._representation.evaluate, angles, wavelength, "brdf", text, "sr-1")

    def uncertainty(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_o: ArrayLike,
        phi_o: ArrayLike,
        wavelength: Wavelengths = None,
        *,
        source: str | None = None,
    ) -> xr.DataArray:
        """Standard uncertainty (k = 1) of :meth:`evaluate`, with the same parameters.

        Parameters
        ----------
        source : one of :attr:`uncertainty_sources`, for its part alone; by default all together

        Returns
        -------
        DataArray ``brdf_u`` [sr-1]. That of a prediction is of the inputs whose uncertainty is known; the attribute
        ``uncertainty_not_stated`` of the dataset names the others

        Raises
        ------
        VocabularyError : as :meth:`evaluate`; the representation states no uncertainty; or an unknown source.
        """
        text = "standard uncertainty of the BSDF"
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        method = self._uncertainty_of(self._representation.uncertainty, self._changes.of_brdf, source)
        return self._labelled(method, angles, wavelength, "brdf_u", text, "sr-1")

    def albedo_uncertainty(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike = 0.0,
        wavelength: Wavelengths = None,
        *,
        source: str | None = None,
    ) -> xr.DataArray:
        """Standard uncertainty (k = 1) of :meth:`albedo`, with the same parameters; ``source`` and errors as for :meth:`uncertainty`.

        Returns
        -------
        DataArray ``albedo_u`` [1]. The error of the model is not part of it: it moves light from one direction to another
        """
        text = "standard uncertainty of the directional reflectance"
        angles = self._incidences(theta_i, phi_i)
        method = self._uncertainty_of(self._representation.albedo_uncertainty, self._changes.of_albedo, source)
        return self._labelled(method, angles, wavelength, "albedo_u", text, "1")

    @property
    def uncertainty_sources(self) -> tuple[str, ...]:
        """Inputs of a prediction whose uncertainty is known; empty for a measurement, whose uncertainty is not stated by source."""
        return tuple(dict.fromkeys(self._changes.sources))

    @cached_property
    def _changes(self) -> SourceChanges:
        return SourceChanges.of(self._dataset)

    def _uncertainty_of(
        self, of_representation: Callable[..., Array], of_changes: Callable[..., Array], source: str | None
    ) -> Callable[..., Array]:
        """The uncertainty from all sources, or one, as a function of angles and wavelength."""
        known = self.uncertainty_sources
        if source is not None and source not in known:
            raise VocabularyError(f"no uncertainty from the source {source!r}; known: {', '.join(known) or 'none'}")
        if known:
            return lambda *at: self._combined(of_changes(*at), source)
        if self._representation.states_uncertainty:
            return of_representation
        accepted = ", ".join(name for name, kind in REPRESENTATIONS.items() if kind.states_uncertainty)
        missing = self._dataset.attrs.get(NOT_STATED, "")
        inputs = f"; not known of this one: {missing}" if missing else ""
        raise VocabularyError(
            f"the representation {self._representation.name!r} states no uncertainty; those that do: {accepted}, and predictions from inputs of "
            f"known uncertainty{inputs}"
        )

    def _combined(self, changes: Array, source: str | None) -> Array:
        parts = self._changes.by_source(changes)
        return in_quadrature(parts if source is None else {source: parts[source]})

    def albedo(self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: Wavelengths = None) -> xr.DataArray:
        """Directional reflectance, mirror reflection included.

        Parameters
        ----------
        theta_i, phi_i : degree, broadcast as in :meth:`evaluate`; above 90 for light from within the body
        wavelength : nm; by default the dataset's own

        Returns
        -------
        DataArray ``albedo`` [1]; from the representation, or by an adaptive quadrature to 1e-6
        (:meth:`brdfpipe.bsdf.base.Representation.integrate`)
        """
        angles = self._incidences(theta_i, phi_i)
        return self._labelled(self._representation.albedo, angles, wavelength, "albedo", "directional reflectance", "1")

    def transmittance(self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: Wavelengths = None) -> xr.DataArray:
        """Directional transmittance, regular transmission included; parameters as for :meth:`albedo`.

        Returns
        -------
        DataArray ``transmittance`` [1]; 0 if the material does not transmit
        """
        method, text = self._representation.transmittance, "directional transmittance"
        return self._labelled(method, self._incidences(theta_i, phi_i), wavelength, "transmittance", text, "1")

    def specular(
        self, theta_i: ArrayLike, phi_i: ArrayLike = 0.0, wavelength: Wavelengths = None
    ) -> tuple[xr.DataArray, xr.DataArray]:
        """Mirror reflectance and regular transmittance, which are not part of :meth:`evaluate`; parameters as for :meth:`albedo`."""
        at, method = (self._incidences(theta_i, phi_i), wavelength), self._representation.specular
        return (
            self._labelled(lambda *a: method(*a)[0], *at, "specular_reflectance", "mirror reflectance", "1"),
            self._labelled(lambda *a: method(*a)[1], *at, "specular_transmittance", "regular transmittance", "1"),
        )

    def sample(
        self, n: int, seed: int, theta_i: float, phi_i: float = 0.0, wavelength: Wavelengths = None
    ) -> xr.Dataset:
        """Draw random outgoing directions, about in proportion to the BSDF times |cos θ_o|.

        Parameters
        ----------
        n : number of directions
        seed : of numpy's default generator; the same seed gives the same directions
        theta_i, phi_i : degree, one incidence; theta_i above 90 for light from within the body
        wavelength : nm; by default the dataset's own. The density follows the mean over these

        Returns
        -------
        Dataset of kind ``samples``: ``theta_o``, ``phi_o``, ``pdf`` [sr-1], ``weight`` = f |cos θ_o| / pdf per wavelength, whose mean is
        the reflectance plus the transmittance, and ``weight_variance``. ``specular`` marks mirrored and regularly transmitted rays:
        their ``pdf`` is missing, and their weight is the reflectance (or transmittance) over the probability of drawing them

        Raises
        ------
        VocabularyError : n is not a positive integer, or an angle or a wavelength is out of range.
        """
        theta, phi = self._incidence(theta_i, phi_i)
        return self._representation.sample(n, seed, theta, phi, self._wavelengths(wavelength))

    def pdf(
        self, theta_i: float, phi_i: float, theta_o: ArrayLike, phi_o: ArrayLike, wavelength: Wavelengths = None
    ) -> xr.DataArray:
        """Density with which :meth:`sample` draws outgoing directions.

        Parameters
        ----------
        theta_i, phi_i : degree, one incidence
        theta_o, phi_o : degree, broadcast as in :meth:`evaluate`
        wavelength : as given to :meth:`sample`

        Returns
        -------
        DataArray ``pdf`` [sr-1]; its integral over the sphere is 1 minus the probability of specular rays
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
        self, theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike, wavelength: Wavelengths = None
    ) -> xr.DataArray:
        """Mueller matrix of the BRDF, with the parameters and the errors of :meth:`evaluate`.

        Returns
        -------
        DataArray ``mueller`` [sr-1], with the last dimensions ``stokes_out`` and ``stokes_in``: Stokes parameters I, Q, U, V in the s–p
        frames of both directions (:mod:`brdfpipe.bsdf.microfacet.polarised`). The first element is the BRDF; representations other
        than ``microfacet`` and ``smooth`` depolarise. NaN for light through a transparent interface, or from within it
        """
        text, stokes = "Mueller matrix of the BRDF", ["I", "Q", "U", "V"]
        angles = _directions(theta_i, phi_i, theta_o, phi_o)
        frames: dict[Hashable, list[str]] = {"stokes_out": stokes, "stokes_in": stokes}
        return self._labelled(self._representation.mueller, angles, wavelength, "mueller", text, "sr-1", frames)

    def nonspectral(self, weight: ArrayLike | None = None) -> xr.Dataset:
        """The BSDF averaged over wavelength (ASTM E1392 "integrated" data).

        Parameters
        ----------
        weight : spectral response on the dataset's wavelengths, any scale; by default V(λ) times the illuminant D65 (CIE 015)
        """
        return nonspectral(self._dataset, weight).copy()

    def nonspectral_error(
        self, weight: ArrayLike | None = None, theta_i: ArrayLike = (8.0, 30.0, 60.0, 80.0)
    ) -> xr.Dataset:
        """Error of :meth:`nonspectral`; see :func:`brdfpipe.bsdf.approximation_error.nonspectral_error`."""
        return approximation_error.nonspectral_error(self._dataset, weight, theta_i)

    @property
    def _representation(self) -> Representation:
        return representation(self._dataset)

    @property
    def _own_wavelengths(self) -> Array | None:
        """Wavelengths of the dataset; their values are converted once for each variable, which takes longer than a simple BSDF."""
        variable = self._dataset.variables.get("wavelength")
        if variable is not self._wavelength_variable:
            self._wavelength_variable = variable
            self._wavelength_values = None if variable is None else np.asarray(variable.values)
        return self._wavelength_values

    def _incidences(self, theta_i: ArrayLike, phi_i: ArrayLike) -> _Angles:
        highest = 180 if self._representation.transmits else 90
        return _Angles.of(
            theta_i=checked_angles("theta_i", theta_i, 0, highest), phi_i=checked_angles("phi_i", phi_i, -720, 720)
        )

    def _incidence(self, theta_i: ArrayLike, phi_i: ArrayLike) -> tuple[float, float]:
        highest = 180 if self._representation.transmits else 90
        angles = check_angles("theta_i", theta_i, 0, highest), check_angles("phi_i", phi_i, -720, 720)
        if any(angle.size != 1 for angle in angles):
            raise VocabularyError("samples are drawn for one incidence at a time: give theta_i and phi_i as numbers")
        return float(angles[0].item()), float(angles[1].item())

    def _wavelengths(self, wavelength: Wavelengths) -> Array | None:
        if wavelength is None:
            return None
        units = getattr(wavelength, "attrs", {}).get("units", "nm")
        if units != "nm":
            raise VocabularyError(f"wavelength is in {units!r}; accepted: nm")
        wavelengths = np.atleast_1d(np.asarray(wavelength, dtype=float))
        if wavelengths.ndim != 1 or not np.isfinite(wavelengths).all():
            raise VocabularyError(
                f"wavelength has shape {wavelengths.shape}; accepted: finite numbers in one dimension"
            )
        own = self._own_wavelengths
        if own is not None and wavelengths.size and (wavelengths.min() < own[0] or wavelengths.max() > own[-1]):
            raise VocabularyError(
                f"wavelength spans {wavelengths.min():g} to {wavelengths.max():g} nm; the data cover {own[0]:g} to {own[-1]:g} nm"
            )
        return wavelengths

    def _labelled(
        self,
        quantity: Callable[..., Array],
        angles: _Angles,
        wavelength: Wavelengths,
        name: str,
        long_name: str,
        units: str,
        frames: Mapping[Hashable, list[str]] = MappingProxyType({}),
    ) -> xr.DataArray:
        """A method of the representation at labelled angles; ``frames`` are the dimensions after the wavelength."""
        wavelengths = self._wavelengths(wavelength)
        values, shape = quantity(*angles.values, wavelengths), angles.values[0].shape
        if wavelengths is None:
            wavelengths = self._own_wavelengths
        if wavelengths is None:
            values = values[(slice(None),) * len(shape) + (0,)]
        elif values.shape[len(shape)] != wavelengths.size:
            values = np.broadcast_to(values, (*shape, wavelengths.size, *values.shape[len(shape) + 1 :]))
        if shape or angles.coords:
            return _array(values, angles, wavelengths, name, long_name, units, frames)
        key = name, None if wavelengths is None else wavelengths.tobytes()
        template = self._of_one_direction.get(key)
        if template is None:
            if len(self._of_one_direction) >= _MOST_TEMPLATES:
                self._of_one_direction.clear()
            template = _Template.of(_array(values, angles, wavelengths, name, long_name, units, frames))
            self._of_one_direction[key] = template
        return template.filled(values)


_MOST_TEMPLATES = 16


class _Template(NamedTuple):
    """Labels of a result for one direction; to make new ones takes much longer than to evaluate a BSDF."""

    name: Hashable
    dims: tuple[Hashable, ...]
    coords: Mapping[Hashable, xr.Variable]
    indexes: Mapping[Hashable, xr.Index]
    attrs: Mapping[str, str]

    @classmethod
    def of(cls, array: xr.DataArray) -> _Template:
        coords = {name: coordinate.variable for name, coordinate in array.coords.items()}
        return cls(array.name, array.dims, coords, dict(array.xindexes), dict(array.attrs))

    def filled(self, values: Array) -> xr.DataArray:
        """A result with these values, whose labels can be changed without a change of others."""
        variable = xr.Variable(self.dims, values, self.attrs, fastpath=True)
        coords = {name: coordinate.copy(deep=False) for name, coordinate in self.coords.items()}
        return xr.DataArray(variable, coords, name=self.name, indexes=dict(self.indexes), fastpath=True)


class _Angles(NamedTuple):
    """Angles of one shape, with the coordinates and dimensions of the result."""

    values: tuple[Array, ...]
    coords: Mapping[Hashable, object]
    dims: tuple[Hashable, ...]

    @classmethod
    def of(cls, **angles: xr.DataArray | Array) -> _Angles:
        """Of checked angles, which broadcast as in :func:`brdfpipe.geometry.broadcast`."""
        plain = [angle for angle in angles.values() if not isinstance(angle, xr.DataArray)]
        shapes = {angle.shape for angle in plain if angle.shape}
        if len(plain) < len(angles) or len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
            labelled = broadcast(**angles)
            return cls(tuple(angle.values for angle in labelled), labelled[0].coords, labelled[0].dims)
        if not shapes:
            return cls(tuple(plain), {}, ())
        (shape,) = shapes
        return cls(tuple(np.broadcast_to(angle, shape) for angle in plain), {}, ("direction",))


def _array(
    values: Array,
    angles: _Angles,
    wavelengths: Array | None,
    name: str,
    long_name: str,
    units: str,
    frames: Mapping[Hashable, list[str]],
) -> xr.DataArray:
    coords: dict[Hashable, object] = {**angles.coords, **frames}
    attrs = {"units": units, "long_name": long_name}
    if wavelengths is None:
        return xr.DataArray(values, coords, (*angles.dims, *frames), name, attrs)
    nm = {"units": "nm", "long_name": vocabulary.QUANTITIES["wavelength"].long_name}
    coords["wavelength"] = ("wavelength", wavelengths, nm)
    return xr.DataArray(values, coords, (*angles.dims, "wavelength", *frames), name, attrs)


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


def _directions(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> _Angles:
    return _Angles.of(
        theta_i=checked_angles("theta_i", theta_i, 0, 180),
        phi_i=checked_angles("phi_i", phi_i, -720, 720),
        theta_o=checked_angles("theta_o", theta_o, 0, 180),
        phi_o=checked_angles("phi_o", phi_o, -720, 720),
    )

"""The values a rig measured and their covariance (JCGM 100:2008, 5.2 and F.1.2): errors of cells, of pictures, and of the whole measurement.

A relative component is stated over the measured value, but taken over the model's: otherwise common errors would pull every fit below the data
(Peelle's pertinent puzzle; Frühwirth, Neudecker & Leeb 2012, EPJ Web of Conferences 27, 00008).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.specular_directions import cos_view, outgoing

DIMS = ("incidence", "wavelength", "cell")

_USED = ("measured", "below_noise")  # a value below the noise is valid within its uncertainty
_CHAIN_STEPS = 2  # number of errors into which the errors of chained frames are divided
_NEAR = 3.0  # standard uncertainties from the data within which relative uncertainties refer to the model


class ComparisonError(BrdfpipeError):
    """A measurement and a prediction that cannot be compared."""


class _ErrorModel(NamedTuple):
    """The correlation of an error, and its scale."""

    independent_over: tuple[str, ...]  # dimensions; along the others the errors are the same
    relative: bool  # proportional to the BRDF
    chained: bool = False  # common to all cells that are at least as uncertain


_ERROR_MODELS = {
    "noise": _ErrorModel(DIMS, relative=False),
    "geometry": _ErrorModel(DIMS, relative=False),
    "calibration": _ErrorModel(("wavelength", "cell"), relative=True),
    "repeat": _ErrorModel(("incidence", "wavelength"), relative=True),
    "nd": _ErrorModel(("incidence", "wavelength"), relative=True, chained=True),
    "reference": _ErrorModel(("incidence",), relative=True, chained=True),
    "glare": _ErrorModel(("incidence",), relative=False),
    "certificate": _ErrorModel((), relative=True),
    "path": _ErrorModel(("incidence",), relative=True),
}
"""The geometry enters twice: as an independent error of each cell, and as a displacement of the whole picture, which moves the lobe.

Frames of a bracket form a chain: each is scaled by the light it shares with a brighter one, so it has the brighter one's error and its own
(``chained``). The variance that two cells share is that of the better known one.
"""
_BY_CORRELATION = {
    "independent": _ErrorModel(DIMS, relative=False),
    "common": _ErrorModel(("incidence", "wavelength"), relative=True),
}


class _Component(NamedTuple):
    name: str
    error_model: _ErrorModel
    u: Array  # (incidence, wavelength, cell) [sr-1]


@dataclass(frozen=True)
class Measurement:
    """The cells of a rig; fields are (incidence, wavelength, cell)."""

    incidence: Array  # (incidence,) degree
    wavelength: Array  # (wavelength,) nm
    theta_s: Array  # (cell,) degree
    phi_s: Array
    solid_angle: Array  # (cell,) of the cells of the disc [sr]; NaN for the others
    value: Array  # BRDF [sr-1]; 0 where it is not used
    u: Array  # combined standard uncertainty [sr-1]; 0 where the value is not used
    used: NDArray[np.bool_]
    components: tuple[_Component, ...]
    scale_u: float = 0.0  # relative standard uncertainty of all angles on the disc

    @classmethod
    def of(cls, primary: xr.Dataset, wavelengths: NDArray[np.int64]) -> Measurement:
        """Some wavelengths of a dataset of kind ``primary``.

        Raises ComparisonError: no cell has a value, or one has no uncertainty above 0.
        """
        primary = primary.isel(wavelength=wavelengths).transpose(*DIMS, ...)
        value, u = primary["brdf"].values, primary["brdf_u"].values
        incidence, theta_s, phi_s = (primary[name].values.astype(float) for name in ("incidence", "theta_s", "phi_s"))
        used = np.isfinite(value) & (cos_view(incidence[:, None], theta_s, phi_s) > 0)[:, None, :]
        if "brdf_quality" in primary:
            used &= np.isin(primary["brdf_quality"].values, [vocabulary.quality(name) for name in _USED])
        if not used.any():
            raise ComparisonError("no cell of the rig has a measured value: check the quality flags in `primary`")
        solid_angle = primary["solid_angle"].values if "solid_angle" in primary else np.full(theta_s.size, np.nan)
        components = tuple(
            _Component(name, error_model, np.where(used, np.nan_to_num(u_of_component), 0.0))
            for name, error_model, u_of_component in _components(primary)
        )
        measurement = cls(
            incidence,
            primary["wavelength"].values.astype(float),
            theta_s,
            phi_s,
            solid_angle.astype(float),
            np.where(used, value, 0.0),
            np.where(used, np.nan_to_num(u), 0.0),
            used,
            components,
            float(primary.attrs.get("disc_scale_u", 0.0)),
        )
        for at, wavelength, cell in np.argwhere(used & ~(measurement.own_variance(measurement.value) > 0)):
            raise ComparisonError(
                f"no independent uncertainty above 0 is stated where a value was measured (incidence {incidence[at]:g}°, "
                f"{measurement.wavelength[wavelength]:g} nm, cell {cell}); every value needs one, or is missing (NaN)"
            )
        return measurement

    @cached_property
    def directions(self) -> tuple[Array, Array, Array]:
        """θ_i, θ_o and φ_o [degree] of every cell, (incidence, cell); light comes from azimuth 0."""
        return self.directions_of(self.theta_s, self.phi_s)

    def directions_of(self, theta_s: Array, phi_s: Array) -> tuple[Array, Array, Array]:
        """θ_i, θ_o and φ_o [degree] of directions about the mirror direction, (incidence, …)."""
        incidence = self.incidence.reshape(-1, *(1,) * theta_s.ndim)
        theta_o, phi_o = outgoing(incidence, theta_s, phi_s)
        return np.broadcast_to(incidence, theta_o.shape), theta_o, phi_o

    @property
    def cosine(self) -> Array:
        """cos θ_o of every cell, (incidence, cell); negative below the horizon."""
        return cos_view(self.incidence[:, None], self.theta_s, self.phi_s)

    def correlated(self, *, among_cells: bool) -> Array:
        """Combined uncertainty of the components that are common to the cells of a picture, or of those that are not [sr-1]."""
        parts = [part.u for part in self.components if ("cell" not in part.error_model.independent_over) == among_cells]
        return np.sqrt(np.sum(np.square(parts), axis=0)) if parts else np.zeros_like(self.value)

    def sum_u(self, weight: Array) -> Array:
        """Standard uncertainty of Σ weight · value over the cells of each picture, (incidence, wavelength)."""
        independent = np.sum((weight * self.correlated(among_cells=False)) ** 2, axis=-1)
        common = [
            np.sum(weight * part.u, axis=-1)
            for part in self.components
            if "cell" not in part.error_model.independent_over
        ]
        return np.sqrt(independent + np.sum(np.square(common), axis=0)) if common else np.sqrt(independent)

    def own_variance(self, model: Array) -> Array:
        """Variance of the errors that are independent from value to value."""
        parts = [
            self._cell_u(part, model) ** 2 for part in self.components if part.error_model.independent_over == DIMS
        ]
        return np.asarray(np.sum(parts, axis=0)) if parts else np.zeros_like(model)

    def covariance(self, model: Array, own_u: Array, common: Array) -> Covariance:
        """Covariance of values less those of a model, if the model is correct.

        Parameters
        ----------
        model : BRDF of the model [sr-1]
        own_u : its standard uncertainty independent from value to value [sr-1]
        common : (error, …) its changes by common errors of one standard uncertainty each [sr-1]
        """
        own = np.where(self.used, self.own_variance(model) + own_u**2, 1.0)
        between = np.einsum("iwc,ij->wcij", own, np.eye(self.incidence.size))
        columns = [np.where(self.used, common, 0.0)]
        for component in self.components:
            if "cell" not in component.error_model.independent_over:
                # Relative to the model's values: an error proportional to noisy data would absorb the noise.
                columns += self._picture_errors(component, model)
            elif component.error_model.independent_over != DIMS:
                u = self._cell_u(component, model)
                between = between + np.einsum("iwc,jwc->wcij", u, u)
            if component.name == "geometry":
                columns += self._displacement_errors(component.u)
        shared = np.concatenate(columns)
        return Covariance(np.linalg.inv(np.linalg.cholesky(between)), shared[shared.any(axis=(1, 2, 3))], self.used)

    def _picture_errors(self, component: _Component, model: Array) -> list[Array]:
        """Errors common to the cells of a picture."""
        u, own = self._u_referred_to(component, model), component.error_model.independent_over
        if not component.error_model.chained:
            return [_columns(u, own)]
        known = self.used & (self.value != 0)
        relative = np.divide(component.u, np.abs(self.value), out=np.full_like(u, np.nan), where=known)
        most = np.where(known, relative, 0.0).max(axis=-1, keepdims=True)
        least = np.minimum(np.where(known, relative, np.inf).min(axis=-1, keepdims=True), most)
        steps = [least + (most - least) * link / _CHAIN_STEPS for link in range(_CHAIN_STEPS + 1)]
        squares = [np.clip(np.nan_to_num(relative), low, high) ** 2 - low**2 for low, high in pairwise(steps)]
        links = [_columns(np.sqrt(square) * np.abs(model), DIMS[:2]) for square in squares]
        return [_columns(np.where(known, np.minimum(u, steps[0] * np.abs(model)), u), own), *links]

    def _displacement_errors(self, u: Array) -> list[Array]:
        """Errors of the disc's cells by a shift of the picture along either axis, one for each incidence."""
        azimuth = np.radians(self.phi_s)
        return [_columns(u * (self.of_disc * part), ("incidence",)) for part in (np.cos(azimuth), np.sin(azimuth))]

    @cached_property
    def of_disc(self) -> NDArray[np.bool_]:
        """(cell,) whether a cell is a piece of the disc."""
        return np.nan_to_num(self.solid_angle) > 0

    def _cell_u(self, component: _Component, model: Array) -> Array:
        """Standard uncertainty of errors of single cells; relative ones refer to the model, limited to a few uncertainties from the data."""
        return self._u_referred_to(component, np.clip(model, self.value - _NEAR * self.u, self.value + _NEAR * self.u))

    def _u_referred_to(self, component: _Component, values: Array) -> Array:
        """Standard uncertainty of a component; a relative one refers to the given values instead of the measured ones."""
        if not component.error_model.relative:
            return component.u
        ones = np.ones_like(values)
        return component.u * np.divide(np.abs(values), np.abs(self.value), out=ones, where=self.value != 0)


@dataclass(frozen=True)
class Covariance:
    """A covariance as a sum: blocks between incidences, and common errors of one standard uncertainty each."""

    whitening: Array  # (wavelength, cell, incidence, incidence)
    common: Array  # (error, incidence, wavelength, cell) [sr-1]
    used: NDArray[np.bool_]

    def whitened(self, fields: Array) -> Array:
        """Fields (any, incidence, wavelength, cell) as (any, values) in units in which independent errors are 1."""
        white = np.einsum("wcij,kjwc->kiwc", self.whitening, np.where(self.used, fields, 0.0))
        return white[:, self.used]

    @cached_property
    def nuisances(self) -> Array:
        """The common errors, whitened (error, values)."""
        return self.whitened(self.common)

    def products(self, first: Array, second: Array) -> Array:
        """a C⁻¹ bᵀ of whitened fields (any, values), the common errors included (Woodbury)."""
        inner = self.nuisances @ self.nuisances.T + np.eye(len(self.nuisances))
        solved = np.linalg.solve(inner, self.nuisances @ second.T)
        return np.asarray(first @ second.T - (first @ self.nuisances.T) @ solved)

    def chi_squared(self, residual: Array) -> float:
        """χ² of a residual (incidence, wavelength, cell)."""
        white = self.whitened(residual[None])
        return float(self.products(white, white)[0, 0])


def _components(primary: xr.Dataset) -> Iterator[tuple[str, _ErrorModel, Array]]:
    """The components of the uncertainty; without any, the combined uncertainty counts as independent."""
    whole = primary["brdf_u"]
    names = sorted(name for name in map(str, primary.data_vars) if name.startswith("brdf_u_"))
    if not names:
        yield "", _BY_CORRELATION["independent"], whole.values
    for name in names:
        stated = str(primary[name].attrs.get("correlation", "common"))
        if stated not in _BY_CORRELATION:
            raise ComparisonError(f"{name!r} has the correlation {stated!r}; accepted: {', '.join(_BY_CORRELATION)}")
        component = name.removeprefix("brdf_u_")
        known = _ERROR_MODELS.get(component)
        # The stated correlation has precedence over the known component.
        error_model = (
            known
            if known and ("cell" in known.independent_over) == (stated == "independent")
            else _BY_CORRELATION[stated]
        )
        yield component, error_model, primary[name].broadcast_like(whole).transpose(*DIMS).values


def _columns(u: Array, own: tuple[str, ...]) -> Array:
    """One field for each error of a component, (error, incidence, wavelength, cell)."""
    shape = [u.shape[axis] if dim in own else 1 for axis, dim in enumerate(DIMS)]
    number = np.arange(np.prod(shape)).reshape(shape)
    return np.asarray(np.where(number == number.reshape(-1, 1, 1, 1), u, 0.0))

"""What uncertain inputs make of a BSDF: the BSDF after each independent change of an input by one standard uncertainty.

A ``bsdf`` dataset with uncertain inputs holds, beside a variable, its changes: ``slope_density_change(uncertain_change, slope)``, with the
input of each change in ``uncertainty_source(uncertain_change)``. All variables of one change go together, and so do all directions and
wavelengths of the BSDF that follows from them. Changes are independent of each other: the variance of anything that is
computed from the BSDF is the sum of the squares of what the changes make of it. The error of the model is one more such change, of the
light that the surface reflects: ``relative_error`` by incidence and by share of the peak. With it, a sheet has ``transmitted_loss``, less of the light
that passes straight on.

References
----------
JCGM 102:2011, 6.2 and 6.3 (covariance from common inputs).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Protocol

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.change_variables import DIMENSION, MODEL, SOURCE, between_incidences, between_phases
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.spectral import at_wavelengths
from brdfpipe.geometry import Array

_SUFFIX = "_change"
_OF_MODEL = "relative_error", "transmitted_loss", "finer_roughness_loss", "model_gloss_error", "reference_gloss_u"
_DIRECTIONS_AT_ONCE = 2**14
_HELD = 2.0
"""Degrees beyond the last known incidence up to which its error is that of a model: the light of a gloss meter is so wide."""
_PEAK_INCIDENCES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 88.0])
_PEAK_VIEWS = np.arange(0.0, 89.9, 0.5)
_REGION_MIDDLES = np.log([0.55, 0.1, 0.01])
"""Logarithm of the share of the peak in the middle of the regions of a model error: peak, shoulder, rest."""


class Reflector(Protocol):
    """What an integral over a BSDF needs of it; arguments and results as those of :class:`brdfpipe.bsdf.base.Representation`."""

    def evaluate(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array: ...

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]: ...

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array: ...

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array: ...


class SourceChanges:
    """A BSDF, and the same after each change of an uncertain input.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one without uncertain inputs has no changes
    """

    def __init__(self, bsdf: xr.Dataset, given: Representation | None = None) -> None:
        self._bsdf = bsdf
        self.given: Representation = representation(bsdf) if given is None else given

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> SourceChanges:
        """Those of a BSDF, the same for all who ask as long as its representation lives."""
        given = representation(bsdf)
        found = given.derived.get(__name__)
        if not isinstance(found, cls):
            # Of the representation's own dataset: another one would be kept alive by its own representation.
            found = given.derived[__name__] = cls(given.dataset, given)
        return found

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """Source of each change."""
        named = map(str, self._bsdf[SOURCE].values) if SOURCE in self._bsdf.variables else ()
        return (*named, MODEL) if "relative_error" in self._bsdf else tuple(named)

    @cached_property
    def changed(self) -> tuple[Reflector, ...]:
        """The BSDF after each change."""
        return self.of_inputs if self._error is None else (*self.of_inputs, self._error)

    @cached_property
    def _error(self) -> _WithModelError | None:
        return _WithModelError(self.given) if "relative_error" in self._bsdf else None

    @cached_property
    def of_inputs(self) -> tuple[Representation, ...]:
        """The BSDF after each change of its variables."""
        bsdf, names, plain = self._bsdf, changing(self._bsdf), without_changes(self._bsdf)
        made = []
        for row in range(bsdf.sizes.get(DIMENSION, 0)):
            variables = {name: after for name in names if (after := _after(bsdf, name, row)) is not None}
            made.append(self.given.with_changed(_with_variables(plain, variables), variables.keys()))
        return tuple(made)

    def evaluate_each(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> list[Array]:
        """The BSDF [sr-1], and the same after each change, (directions…, wavelength) each."""
        at, error = (theta_i, phi_i, theta_o, phi_o, wavelength), self._error
        if error is None:
            return self.given.evaluate_each(self.of_inputs, *at)
        *values, bare = self.given.evaluate_each([*self.of_inputs, error.bare], *at)
        return [*values, error.changed(values[0], bare, theta_i, theta_o)]

    def variance(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Variance of the BSDF [sr-2], (directions…, wavelength), of directions of one shape; a change that is not known counts as none."""
        angles = [np.asarray(angle, dtype=float) for angle in np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)]
        flat = [angle.reshape(-1) for angle in angles]
        parts = []
        # All directions together may not fit into the memory.
        for start in range(0, max(flat[0].size, 1), _DIRECTIONS_AT_ONCE):
            block = [angle[start : start + _DIRECTIONS_AT_ONCE] for angle in flat]
            given, *changed = self.evaluate_each(block[0], block[1], block[2], block[3], wavelength)
            parts.append(sum((np.square(np.nan_to_num(one - given)) for one in changed), np.zeros_like(given)))
        values = np.concatenate(parts)
        return np.asarray(values.reshape(*angles[0].shape, values.shape[-1]))

    def of_brdf(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Changes of the BSDF [sr-1], (changes, directions…, wavelength)."""
        given, *changed = self.evaluate_each(theta_i, phi_i, theta_o, phi_o, wavelength)
        return self._differences(given, changed)

    def of_albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Changes of the directional reflectance [1], (changes, incidences…, wavelength)."""
        at = theta_i, phi_i, wavelength
        return self._differences(self.given.albedo(*at), [one.albedo(*at) for one in self.changed])

    @staticmethod
    def _differences(given: Array, changed: list[Array]) -> Array:
        return np.array([one - given for one in changed]).reshape(len(changed), *given.shape)

    def by_source(self, changes: Array) -> dict[str, Array]:
        """Standard uncertainty from each source: root of the sum of squares of its changes (changes, …)."""
        names, sources = dict.fromkeys(self.sources), np.array(self.sources, dtype=object)
        return {name: np.asarray(np.sqrt(np.square(changes[sources == name]).sum(axis=0))) for name in names}


def uncertain(bsdf: xr.Dataset) -> bool:
    """Whether a ``bsdf`` dataset has uncertain inputs."""
    return DIMENSION in bsdf.dims or "relative_error" in bsdf


def changing(bsdf: xr.Dataset) -> list[str]:
    """Variables of a dataset that have changes."""
    of_changes = (str(name) for name, variable in bsdf.data_vars.items() if DIMENSION in variable.dims)
    return [name.removesuffix(_SUFFIX) for name in of_changes if name.endswith(_SUFFIX)]


def without_changes(bsdf: xr.Dataset) -> xr.Dataset:
    """The dataset as if its inputs were exact."""
    return bsdf.drop_dims(DIMENSION, errors="ignore").drop_vars([*_OF_MODEL, SOURCE], errors="ignore")


def averaged(reduced: xr.Dataset, bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """A BSDF averaged over wavelength, with the changes of the spectral one averaged by the same weights."""
    if not uncertain(bsdf):
        return reduced
    reduced = without_changes(reduced)
    fields = {}
    given = representation(bsdf)
    for name in changing(bsdf):
        own = given.averaged_change(name, bsdf[name + _SUFFIX].values, weight)
        if own is not None:
            fields[name + _SUFFIX] = own
        elif name in reduced:
            change = bsdf[name + _SUFFIX]
            if "mixed" in reduced[name].dims:
                values = at_wavelengths(change, reduced[_wavelengths_of_mixture(reduced, name)].values)
                change = xr.DataArray(values, dims=(DIMENSION, "mixed"))
            elif _is_flattened(change, reduced[name]):
                after = np.stack([one.nonspectral(weight)[name].values for one in SourceChanges.of(bsdf).of_inputs])
                change = xr.DataArray(after - reduced[name].values, dims=(DIMENSION, *reduced[name].dims))
            elif "wavelength" in change.dims:
                change = change @ xr.DataArray(weight, dims="wavelength")
            fields[name + _SUFFIX] = change.variable
    kept = {name: bsdf[name].variable for name in (SOURCE, *_OF_MODEL) if name in bsdf.variables}
    coordinates = {
        name: bsdf[name].variable
        for name in ("change_theta", "change_phase", "shift_low", "error_theta", "error_gloss_angle", "region")
        if name in bsdf.coords
    }
    return vocabulary.label(reduced.assign(fields | kept).assign_coords(coordinates), "bsdf")


def _wavelengths_of_mixture(mean: xr.Dataset, name: str) -> str:
    """The variable with the wavelengths of a mean over wavelength; that of a face of a sheet has the prefix of the face."""
    suffix = "mixed_wavelength"
    prefixes = (str(other).removesuffix(suffix) for other in mean.variables if str(other).endswith(suffix))
    return max((prefix for prefix in prefixes if name.startswith(prefix)), key=len) + suffix


def _is_flattened(change: xr.DataArray, mean: xr.DataArray) -> bool:
    """Whether a mean over wavelength keeps the wavelengths as entries of another dimension."""
    return any(change.sizes[dim] != mean.sizes[dim] for dim in set(change.dims) & set(mean.dims))


def _with_variables(dataset: xr.Dataset, variables: Mapping[str, xr.Variable]) -> xr.Dataset:
    """The dataset with other values of some variables; those that it has keep their dimensions and attributes."""
    # The values of its own variables are replaced one by one: `assign` would compare all coordinates, which takes ten times as long.
    own = {name: variable for name, variable in variables.items() if name in dataset.data_vars}
    changed = dataset.copy()
    for name, variable in own.items():
        changed.variables[name].data = variable.data
    return changed if len(own) == len(variables) else changed.assign(variables)


def _after(bsdf: xr.Dataset, name: str, row: int) -> xr.Variable | None:
    """A variable after one of its changes, within the range of its quantity; None if it does not change."""
    # Plain variables: xarray would align the coordinates of each.
    changes = bsdf.variables[name + _SUFFIX]
    of_row = changes.values.take(row, axis=changes.dims.index(DIMENSION))
    if not of_row.any():
        return None
    change = xr.Variable([dim for dim in changes.dims if dim != DIMENSION], of_row)
    given = bsdf.variables[name] if name in bsdf.variables else xr.zeros_like(change)
    if "change_theta" in change.dims:
        change = change.transpose("change_theta", ...)
        values = between_incidences(
            bsdf.variables["change_theta"].values, change.values, bsdf.variables["theta_i"].values
        )
        change = xr.Variable(("theta_i", *change.dims[1:]), values)
    if "change_phase" in change.dims:
        values = between_phases(bsdf["change_phase"].values, change.values, bsdf["phase_variance"].values)
        change = xr.Variable(given.dims, values)
    quantity = vocabulary.quantity(name)
    assert quantity is not None
    values = (given + change).transpose(*given.dims).values
    return xr.Variable(given.dims, np.clip(values, quantity.low, quantity.high), given.attrs)


class _WithModelError:
    """A BSDF whose surface reflects more light, by the relative error of its model, and lets less of it straight through."""

    def __init__(self, given: Representation) -> None:
        bsdf, self._given = given.dataset, given
        bare = self._given.without_diffuse()
        self._bare_dataset = bsdf if bare is None else bare
        of_same = bare is not None and bare.attrs.get("representation") == given.name
        self.bare: Representation = (
            given.with_changed(self._bare_dataset, ["diffuse"]) if of_same else representation(self._bare_dataset)
        )
        """Its light from the surface alone"""
        self._error, self._loss = bsdf["relative_error"], bsdf.get("transmitted_loss")
        self._known_peaks: dict[tuple[bool, bool], Array] = {}

    def _log_peaks(self, behind: bool, through: bool) -> Array:
        """Logarithm of the largest BSDF of the surface in the plane of incidence [sr-1], mean over wavelength, at some incidences of a side."""
        if (behind, through) not in self._known_peaks:
            incidence, view = np.meshgrid(_PEAK_INCIDENCES, _PEAK_VIEWS, indexing="ij")
            lit, seen = (
                180 - each if below else each for each, below in ((incidence, behind), (view, behind != through))
            )
            along = self.bare.lay or 0.0
            bsdf = self.bare.evaluate(lit, np.full_like(view, along), seen, np.full_like(view, along + 180), None)
            self._known_peaks[behind, through] = np.log(np.maximum(bsdf.mean(axis=-1).max(axis=1), 1e-300))
        return self._known_peaks[behind, through]

    @staticmethod
    def _relative(error: xr.DataArray, theta_i: Array, log_share: Array) -> Array:
        """Relative error at incidences, and logarithms of shares of the peak there, of one shape; NaN where it is not known."""
        angles, values = error["error_theta"].values, error.transpose("error_theta", "region").values
        if angles[-1] <= 90:
            theta_i = np.minimum(theta_i, 180 - np.asarray(theta_i))
        known = np.isfinite(values).all(axis=1)
        end = angles[known][-1] + _HELD if angles[known][-1] < angles[-1] else np.inf
        by_region = [np.where(theta_i > end, np.nan, np.interp(theta_i, angles[known], one)) for one in values[known].T]
        peak, shoulder, rest = _REGION_MIDDLES
        inner = np.clip((peak - log_share) / (peak - shoulder), 0.0, 1.0)
        outer = np.clip((shoulder - log_share) / (shoulder - rest), 0.0, 1.0)
        return by_region[0] + inner * (by_region[1] - by_region[0]) + outer * (by_region[2] - by_region[1])

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        bare = self.bare.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
        given = self._given.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
        return self.changed(given, bare, theta_i, theta_o)

    def changed(self, given: Array, bare: Array, theta_i: Array, theta_o: Array) -> Array:
        """:meth:`evaluate` of the known values of the BSDF and of :attr:`bare`."""
        incidence = np.broadcast_to(theta_i, given.shape[:-1])
        log_light = np.log(np.maximum(bare.mean(axis=-1), 1e-300))

        behind = incidence > 90
        through = behind != (np.broadcast_to(theta_o, incidence.shape) > 90)
        change = np.zeros(incidence.shape)
        for side in (False, True):
            for passed, error, sign in ((False, self._error, 1.0), (True, self._loss, -1.0)):
                at = (behind == side) & (through == passed)
                if error is None or not at.any():
                    continue
                polar = np.minimum(incidence[at], 180 - incidence[at])
                log_peak = np.interp(polar, _PEAK_INCIDENCES, self._log_peaks(side, passed))
                change[at] = sign * self._relative(error, incidence[at], log_light[at] - log_peak)
        return given + bare * change[..., None]

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        mirrored, passed = self._given.specular(theta_i, phi_i, wavelength)
        at = np.asarray(theta_i, dtype=float), np.zeros(np.shape(theta_i))
        mirrored = mirrored * (1 + self._relative(self._error, *at)[..., None])
        return mirrored, passed if self._loss is None else passed * (1 - self._relative(self._loss, *at)[..., None])

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Unchanged: light that the surface reflects elsewhere stays part of a total that was measured."""
        return self._given.albedo(theta_i, phi_i, wavelength)

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Unchanged: light that passes in other directions stays part of it."""
        return self._given.transmittance(theta_i, phi_i, wavelength)


def in_quadrature(parts: Mapping[str, Array]) -> Array:
    """Root of the sum of squares of independent parts; one that is not known (NaN) counts as exact, as those of other sources do."""
    return np.asarray(np.sqrt(sum(np.square(np.nan_to_num(part)) for part in parts.values())))

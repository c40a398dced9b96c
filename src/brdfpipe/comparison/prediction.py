"""The BRDF at the cells of a rig predicted from facets, index and reflectance, and its change with the uncertain inputs.

``index``    the refractive index, with the same shift at all wavelengths: n + Δ
``slope``    the slopes of all facets, times a factor
``diffuse``  the diffuse reflectance below the facets, times a factor
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.microfacet.builder import interreflection_of
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import Model
from brdfpipe.bsdf.registry import representation
from brdfpipe.comparison import scan_uncertainty as scan
from brdfpipe.comparison.measurement import Measurement
from brdfpipe.facets import scaling
from brdfpipe.facets.facet_dataset import azimuthal_average
from brdfpipe.geometry import Array, angles_of, half_vector, slope_towards, unit_vector
from brdfpipe.optics.index import refractive_index
from brdfpipe.rig.reduction.curvature import CURVATURE_U

INPUTS = ("index", "slope", "diffuse")

NOMINAL: Mapping[str, float] = {"index": 0.0, "slope": 1.0, "diffuse": 1.0}
"""Inputs of the original prediction."""

_STEP = 0.1  # step of an input for a derivative, in prior standard uncertainties
_FAR = 3.0  # prior standard uncertainties within which the derivatives of the base count as the same
_LEAST_INDEX = 1.001  # smallest index of a body without absorption
_ORDER = 4  # quadrature points along a side of a cell
_EDGE_STEP = 0.01  # step across the edge of a cell for a derivative, in sides of the cell
_STRETCH = 1e-3  # relative step of the angles on the disc for a derivative


@dataclass(frozen=True)
class PredictionInputs:
    """The inputs of a prediction."""

    facets: xr.Dataset
    index: xr.Dataset
    spectrum: xr.Dataset | None
    choices: Mapping[str, str]  # modes of the model
    visibility: xr.Dataset | None = None
    interreflection: xr.Dataset | None = None
    """Traced on the map of the facets, of masking ``measured``; it scales with their slopes"""

    @classmethod
    def of(
        cls,
        predicted: xr.Dataset,
        facets: xr.Dataset,
        index: xr.Dataset | float | str,
        spectrum: xr.Dataset | None,
        wavelength: Array | None = None,
    ) -> PredictionInputs:
        """The inputs of a microfacet ``bsdf``, at some of its wavelengths [nm]."""
        choices = {name: str(predicted.attrs[name]) for name in ("masking", "diffuse_mode", "multiple_scattering")}
        if representation(predicted).isotropic:
            facets = azimuthal_average(facets)
        index = refractive_index(index)
        if wavelength is not None and "wavelength" in predicted.coords:
            if spectrum is not None:
                spectrum = _at(spectrum[["total_reflectance"]], wavelength)
            elif predicted["n"].ndim:
                index = _at(index, wavelength)
        visibility = None
        if "visibility_ratio" in predicted:
            visibility = vocabulary.label(xr.Dataset({"visibility_ratio": predicted["visibility_ratio"]}), "visibility")
        return cls(facets, index, spectrum, choices, visibility, interreflection_of(predicted))

    def bsdf(self, inputs: Mapping[str, float]) -> xr.Dataset:
        """The BSDF built with other inputs."""
        built = build_microfacet(
            scaling.scaled(self.facets, inputs["slope"]),
            index=self.index.assign(n=self.shifted(self.index["n"], inputs["index"])),
            spectrum=self.spectrum,
            visibility=self.visibility,
            interreflection=self.interreflection,
            masking=self.choices["masking"],
            diffuse=self.choices["diffuse_mode"],
            multiple_scattering=self.choices["multiple_scattering"],
        )
        return with_base(built, inputs["diffuse"])

    def shifted(self, n: xr.DataArray, by: float) -> xr.DataArray:
        """The real part of the index, shifted; without absorption not below that of air."""
        least = 0.0 if self.index["k"].values.any() else _LEAST_INDEX
        return n.copy(data=np.maximum(n.values + by, least))


def _at(dataset: xr.Dataset, wavelength: Array) -> xr.Dataset:
    return vocabulary.label(dataset.interp(wavelength=wavelength), dataset.attrs["kind"])


def with_base(bsdf: xr.Dataset, factor: float) -> xr.Dataset:
    """A BSDF with the diffuse reflectance below the facets times a factor."""
    if factor == 1 or not bsdf["diffuse"].values.any():
        return bsdf
    azimuth = hemisphere.azimuths(representation(bsdf).isotropic)
    incidence = np.full(azimuth.size, float(bsdf["theta_m"]))
    facets = representation(bsdf.assign(diffuse=0.0)).albedo(incidence, azimuth, None).mean(axis=0)
    diffuse, total = bsdf["diffuse"], bsdf["total_reflectance"]
    below = np.where(diffuse.values > 0, total.values - facets, 0.0)
    return bsdf.assign(
        # Below a perfectly white base, by the error of the table of the albedo.
        diffuse=diffuse.copy(data=np.minimum(diffuse.values * factor, 1 - 2e-8)),
        total_reflectance=total.copy(data=total.values + (factor - 1) * below),
    )


@dataclass(frozen=True)
class Predicted:
    """A BSDF at the cells of a rig; fields are (incidence, wavelength, cell)."""

    bsdf: xr.Dataset
    measurement: Measurement

    @cached_property
    def values(self) -> Array:
        """BRDF in the middle of each cell [sr-1]."""
        return np.moveaxis(self._evaluate(*self.measurement.directions), -1, 1)

    @property
    def own_u(self) -> Array:
        """Standard uncertainty independent from value to value [sr-1]."""
        return np.asarray(np.sqrt(0.5) * np.abs(self._cell_effects[0]))

    @property
    def common(self) -> Array:
        """Changes (error, …) of the values by common errors of one standard uncertainty each [sr-1]."""
        remainder, curvature = self._cell_effects
        return np.stack([np.sqrt(0.5) * remainder, CURVATURE_U * curvature, self._scale_error])

    @property
    def u(self) -> Array:
        """Combined standard uncertainty [sr-1]."""
        return np.sqrt(self.own_u**2 + np.sum(self.common**2, axis=0))

    @cached_property
    def _cell_effects(self) -> tuple[Array, Array]:
        """Mean over each cell of the disc less the value in its middle and the curvature correction, and that correction [sr-1].

        The reduction subtracts the mean curvature from the mean over a cell of area A, f = mean − A/24 ∇²f. The remainder is of fourth order in
        the side of the cell over the width of the lobe: half of its square counts as common to all cells, which are alike, and half as
        independent, because they are not square. The reduction finds no curvature in a lobe narrower than a cell, and keeps the mean.
        """
        remainder, curvature = np.zeros((2, *self.measurement.value.shape))
        disc = np.flatnonzero(self.measurement.of_disc)
        if disc.size:
            remainder[..., disc], curvature[..., disc] = self._square_cells(disc)
        return remainder, curvature

    def _square_cells(self, cells: NDArray[np.int64]) -> tuple[Array, Array]:
        """The effects on some cells, taken as squares, (incidence, wavelength, cell)."""
        side = np.sqrt(self.measurement.solid_angle)[cells, None]
        nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
        square = np.stack([np.repeat(nodes, _ORDER), np.tile(nodes, _ORDER)]) / 2
        # The mean curvature follows from the slopes across the edges.
        edge = np.array([[0.5 + step, node / 2] for step in (_EDGE_STEP, -_EDGE_STEP) for node in nodes]).T
        edges = np.stack([edge, -edge, edge[::-1], -edge[::-1]], axis=1).reshape(2, -1)
        away, around = np.concatenate([square, edges, np.zeros((2, 1))], axis=1)
        brdf = self._evaluate_smooth(
            *self.measurement.directions_of(*self._directions_near(cells, side * away, side * around))
        )
        mean = brdf[:, :, : _ORDER**2].swapaxes(2, 3) @ np.outer(weights, weights).ravel() / 4
        across = np.tile(np.concatenate([weights, -weights]), 4) / (4 * _EDGE_STEP)
        curvature = brdf[:, :, _ORDER**2 : -1].swapaxes(2, 3) @ across / 24
        whole = mean - brdf[:, :, -1]
        remainder = np.where(np.abs(whole - curvature) < np.abs(whole), whole - curvature, whole)
        return np.moveaxis(remainder, -1, 1), np.moveaxis(curvature, -1, 1)

    @cached_property
    def _scale_error(self) -> Array:
        """Change of the values if angles on the disc are one standard uncertainty larger than described [sr-1]."""
        theta, u = self.measurement.theta_s, self.measurement.scale_u
        if not u:
            return np.zeros_like(self.measurement.value)
        stretched = np.where(self.measurement.of_disc, theta * (1 + _STRETCH), theta)
        changed = np.moveaxis(
            self._evaluate_smooth(*self.measurement.directions_of(stretched, self.measurement.phi_s)), -1, 1
        )
        described = np.moveaxis(self._evaluate_smooth(*self.measurement.directions), -1, 1)
        return np.asarray((changed - described) * u / _STRETCH)

    def _directions_near(self, cells: NDArray[np.int64], away: Array, around: Array) -> tuple[Array, Array]:
        """θ_s and φ_s [degree] of directions beside cells, by small angles [rad] away from the mirror direction and around it."""
        theta, phi = self.measurement.theta_s[cells, None], self.measurement.phi_s[cells, None]
        outwards, turned = unit_vector(theta + 90, phi), unit_vector(np.full_like(theta, 90.0), phi + 90)
        return angles_of(unit_vector(theta, phi) + away[..., None] * outwards + around[..., None] * turned)

    def _evaluate_smooth(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """Values (…, wavelength) for derivatives over directions; a subclass may smooth the noise of a measured facet density."""
        return self._evaluate(theta_i, theta_o, phi_o)

    def _evaluate(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        wavelength = self.measurement.wavelength
        evaluate = representation(self.bsdf).evaluate
        brdf = evaluate(theta_i, np.zeros_like(theta_i), np.minimum(theta_o, 90.0), phi_o, wavelength)
        return np.broadcast_to(np.asarray(brdf), (*theta_o.shape, wavelength.size))


@dataclass(frozen=True)
class PredictionModel:
    """The prediction as a function of the uncertain inputs.

    Parameters
    ----------
    given : the inputs of the prediction
    measurement : its cells are those of the predictions
    prior_u : standard uncertainty of each uncertain input: absolute for the index, relative for a factor
    """

    given: PredictionInputs
    measurement: Measurement
    prior_u: Mapping[str, float]
    _known_base_slopes: list[tuple[Array, Array]] = field(default_factory=list, init=False, repr=False, compare=False)
    """Changes at which the base's slopes were computed, and these slopes: each takes two BSDFs."""

    def inputs(self, change: Array) -> dict[str, float]:
        """Inputs after changes in prior standard uncertainties; factors change exponentially, so that none becomes negative."""
        by = dict(zip(self.prior_u, change * np.array([*self.prior_u.values()]), strict=True))
        return {name: float(by.get(name, 0.0) if name == "index" else np.exp(by.get(name, 0.0))) for name in INPUTS}

    def at(self, change: Array) -> PredictionAt:
        """The prediction after changes in prior standard uncertainties."""
        return PredictionAt(self.given.bsdf(self.inputs(change)), self.measurement, self, change)

    @cached_property
    def start(self) -> PredictionAt:
        """The original prediction."""
        return self.at(np.zeros(len(self.prior_u)))

    @cached_property
    def smooth_facets(self) -> xr.Dataset:
        return scan.smooth(self.given.facets)

    def base_slopes(self, prediction: PredictionAt) -> Array:
        """Change of the base (input, …) as the facets above it reflect more or less; the same within a few prior uncertainties."""
        for change, known in self._known_base_slopes:
            if np.abs(change - prediction.change).max() < _FAR:
                return known
        slopes = np.zeros((len(self.prior_u), *self.measurement.value.shape))
        for row, name in enumerate(self.prior_u):
            if name != "diffuse":
                changed = self.at(prediction.change + _STEP * np.eye(len(self.prior_u))[row])
                lobe_slope = prediction.lobe_slope(name, self.given.facets)
                slopes[row] = (changed.values - prediction.values) / _STEP - lobe_slope
        self._known_base_slopes.append((prediction.change, slopes))
        return slopes


@dataclass(frozen=True)
class PredictionAt(Predicted):
    """The prediction of a model after changes of its inputs, in prior standard uncertainties."""

    model: PredictionModel
    change: Array

    def slopes(self) -> Array:
        """Change of the values (input, …) per prior standard uncertainty of each input."""
        lobe = np.array([self.lobe_slope(name, self.model.smooth_facets) for name in self.model.prior_u])
        return lobe + self.model.base_slopes(self)

    def lobe_slope(self, name: str, facets: xr.Dataset) -> Array:
        """The same for one input and some facets, with the base and its coupling to them fixed."""
        u = self.model.prior_u[name]
        if name == "diffuse":
            return u * (self.values - self._values_with(diffuse=np.zeros(1)))
        if name == "index":
            n = self.model.given.shifted(self.bsdf["n"], _STEP * u).values
            return (self._values_with(n=np.atleast_1d(n)) - self.values) / _STEP
        unscaled, steeper = (
            self._values_with(surface=self._surface(facets, np.exp(step * u))) for step in (0.0, _STEP)
        )
        return (steeper - unscaled) / _STEP

    @cached_property
    def own_u(self) -> Array:
        """Independent uncertainty of the facet density between its values, and of the mean over a cell [sr-1]."""
        return np.hypot(super().own_u, scan.BETWEEN * self._lobe_u)

    @cached_property
    def common(self) -> Array:
        """Common errors of the cells and of the scan."""
        of_scan = scan.errors(self.model.given.facets, *self._facet_slopes)[:, :, None] * self._lobe_u
        return np.concatenate([super().common, of_scan])

    @cached_property
    def _lobe_u(self) -> Array:
        """Standard uncertainty of the facets' reflected light from the scan [sr-1]."""
        relative = scan.relative_u(self.model.given.facets, *self._facet_slopes)[:, None]
        return relative * (self.values - self._values_with(surface=None))

    @cached_property
    def _facet_slopes(self) -> tuple[Array, Array]:
        """Slopes along x and y, on the scan, of the facets that mirror light into each cell, (incidence, cell)."""
        theta_i, theta_o, phi_o = self.measurement.directions
        phi_i = np.zeros_like(theta_i)
        p, q = slope_towards(half_vector(theta_i, phi_i, np.minimum(theta_o, 90.0), phi_o), phi_i, phi_o)
        factor = self.model.inputs(self.change)["slope"]
        return p / factor, q / factor

    def _surface(self, facets: xr.Dataset, factor: float = 1.0) -> Microsurface:
        """Facets of the scan with the slopes of this prediction, times a further factor."""
        return Microsurface.of(scaling.scaled(facets, self.model.inputs(self.change)["slope"] * factor))

    def _evaluate_smooth(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        return self._modelled(theta_i, theta_o, phi_o, surface=self._surface(self.model.smooth_facets))

    def _values_with(self, **parts: Any) -> Array:
        """Values at the cells with other parts of the :class:`brdfpipe.bsdf.microfacet.model.Model`, (incidence, wavelength, cell)."""
        return np.moveaxis(self._modelled(*self.measurement.directions, **parts), -1, 1)

    def _modelled(self, theta_i: Array, theta_o: Array, phi_o: Array, **parts: Any) -> Array:
        model = replace(Model.of(self.bsdf, None), **parts)
        brdf = model.evaluate(theta_i, np.zeros_like(theta_i), np.minimum(theta_o, 90.0), phi_o)
        return np.broadcast_to(brdf, (*theta_o.shape, self.measurement.wavelength.size))

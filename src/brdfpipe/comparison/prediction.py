"""What a surface's facets, index and reflectance predict at the cells of a rig, and how it changes with the inputs that are in doubt.

``index``    the refractive index, shifted alike at all wavelengths: n + Δ
``slope``    the slopes of all facets, times a factor
``diffuse``  the diffuse reflectance below the facets, times a factor
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
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
"""Inputs as they were given."""

_STEP = 0.1
"""Of an input for a difference, in its prior standard uncertainty."""

_FAR = 3.0
"""Prior standard uncertainties within which the derivatives of the base are taken for the same."""

_LEAST_INDEX = 1.001
"""To which the index of a body that does not absorb is bounded."""

_ORDER = 4
"""Points of a quadrature along a side of a cell."""

_BESIDE = 0.01
"""Sides of a cell from its edge to where slopes across it are taken."""

_STRETCH = 1e-3
"""Of the angles on the disc, for a difference."""


# --- BSDFs


@dataclass(frozen=True)
class Given:
    """What a prediction was made from."""

    facets: xr.Dataset
    index: xr.Dataset
    spectrum: xr.Dataset | None
    choices: Mapping[str, str]
    """Modes of the model."""

    @classmethod
    def to(
        cls,
        predicted: xr.Dataset,
        facets: xr.Dataset,
        index: xr.Dataset | float | str,
        spectrum: xr.Dataset | None,
        wavelength: Array | None = None,
    ) -> Given:
        """What led to a microfacet ``bsdf``, at some of its wavelengths [nm]."""
        choices = {name: str(predicted.attrs[name]) for name in ("masking", "diffuse_mode", "multiple_scattering")}
        if representation(predicted).isotropic:
            facets = azimuthal_average(facets)
        index = refractive_index(index)
        if wavelength is not None and "wavelength" in predicted.coords:
            if spectrum is not None:
                spectrum = _at(spectrum[["total_reflectance"]], wavelength)
            elif predicted["n"].ndim:
                index = _at(index, wavelength)
        return cls(facets, index, spectrum, choices)

    def bsdf(self, inputs: Mapping[str, float]) -> xr.Dataset:
        """The BSDF with other inputs, built anew."""
        built = build_microfacet(
            scaling.scaled(self.facets, inputs["slope"]),
            index=self.index.assign(n=self.shifted(self.index["n"], inputs["index"])),
            spectrum=self.spectrum,
            masking=self.choices["masking"],
            diffuse=self.choices["diffuse_mode"],
            multiple_scattering=self.choices["multiple_scattering"],
        )
        return _with_base(built, inputs["diffuse"])

    def shifted(self, n: xr.DataArray, by: float) -> xr.DataArray:
        """The real part of the index, shifted; no body without absorption falls below air."""
        least = 0.0 if self.index["k"].values.any() else _LEAST_INDEX
        return n.copy(data=np.maximum(n.values + by, least))


def _at(dataset: xr.Dataset, wavelength: Array) -> xr.Dataset:
    return vocabulary.label(dataset.interp(wavelength=wavelength), dataset.attrs["kind"])


def _with_base(bsdf: xr.Dataset, factor: float) -> xr.Dataset:
    """A BSDF as a spectrum would have made it that is so much brighter below the facets."""
    if factor == 1 or not bsdf["diffuse"].values.any():
        return bsdf
    azimuth = hemisphere.azimuths(representation(bsdf).isotropic)
    incidence = np.full(azimuth.size, float(bsdf["theta_m"]))
    facets = representation(bsdf.assign(diffuse=0.0)).albedo(incidence, azimuth, None).mean(axis=0)
    diffuse, total = bsdf["diffuse"], bsdf["total_reflectance"]
    below = np.where(diffuse.values > 0, total.values - facets, 0.0)
    return bsdf.assign(
        # A perfectly white base keeps back what the table of the albedo may err by.
        diffuse=diffuse.copy(data=np.minimum(diffuse.values * factor, 1 - 2e-8)),
        total_reflectance=total.copy(data=total.values + (factor - 1) * below),
    )


# --- BSDFs at the cells


@dataclass(frozen=True)
class Predicted:
    """A BSDF at the cells of a rig; fields are (incidence, wavelength, cell)."""

    bsdf: xr.Dataset
    measurement: Measurement

    @cached_property
    def values(self) -> Array:
        """BRDF in the middle of each cell [sr-1]."""
        return np.moveaxis(self._evaluated(*self.measurement.directions), -1, 1)

    @cached_property
    def own_u(self) -> Array:
        """Standard uncertainty that each value has for itself [sr-1]."""
        return self._own_of_cells

    @cached_property
    def common(self) -> Array:
        """Changes (error, …) of the values by errors that many of them share, of one standard uncertainty each [sr-1]."""
        return self._common_to_cells

    @property
    def u(self) -> Array:
        """Combined standard uncertainty [sr-1]."""
        return np.sqrt(self.own_u**2 + np.sum(self.common**2, axis=0))

    @property
    def _own_of_cells(self) -> Array:
        return np.asarray(np.sqrt(0.5) * np.abs(self._cells[0]))

    @cached_property
    def _common_to_cells(self) -> Array:
        left, curvature = self._cells
        return np.stack([np.sqrt(0.5) * left, CURVATURE_U * curvature, self._wider])

    @cached_property
    def _cells(self) -> tuple[Array, Array]:
        """What the light of each cell of the disc tells beside the value in its middle, curvature taken out, and the curvature [sr-1].

        Notes
        -----
        The reduction takes the mean curvature out of the mean over a cell of area A, f = mean − A/24 ∇²f. What it leaves is of fourth order
        in the side of the cell over the width of the lobe: half of its square is taken for common to all cells, which are alike, and
        half for each one's own, for they are not square. Of a lobe narrower than the cell it sees no curvature, and leaves the mean.
        """
        left, curvature = np.zeros((2, *self.measurement.value.shape))
        side = np.sqrt(self.measurement.solid_angle)
        disc = np.flatnonzero(self.measurement.of_disc)
        if disc.size:
            left[..., disc], curvature[..., disc] = self._of_means(disc, side[disc, None])
        return left, curvature

    def _of_means(self, cells: NDArray[np.int64], side: Array) -> tuple[Array, Array]:
        """The same of square cells, (incidence, wavelength, cell)."""
        nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
        square = np.stack([np.repeat(nodes, _ORDER), np.tile(nodes, _ORDER)]) / 2
        # The mean curvature follows from the slopes across the edges.
        edge = np.array([[0.5 + by, node / 2] for by in (_BESIDE, -_BESIDE) for node in nodes]).T
        edges = np.stack([edge, -edge, edge[::-1], -edge[::-1]], axis=1).reshape(2, -1)
        away, around = np.concatenate([square, edges, np.zeros((2, 1))], axis=1)
        brdf = self._smooth(*self.measurement.seen(*self._beside(cells, side * away, side * around)))
        mean = brdf[:, :, : _ORDER**2].swapaxes(2, 3) @ np.outer(weights, weights).ravel() / 4
        across = np.tile(np.concatenate([weights, -weights]), 4) / (4 * _BESIDE)
        curvature = brdf[:, :, _ORDER**2 : -1].swapaxes(2, 3) @ across / 24
        whole = mean - brdf[:, :, -1]
        left = np.where(np.abs(whole - curvature) < np.abs(whole), whole - curvature, whole)
        return np.moveaxis(left, -1, 1), np.moveaxis(curvature, -1, 1)

    @cached_property
    def _wider(self) -> Array:
        """Change of the values if angles on the disc are one standard uncertainty larger than they were taken for [sr-1]."""
        theta, u = self.measurement.theta_s, self.measurement.scale_u
        if not u:
            return np.zeros_like(self.measurement.value)
        stretched = np.where(self.measurement.of_disc, theta * (1 + _STRETCH), theta)
        beside = np.moveaxis(self._smooth(*self.measurement.seen(stretched, self.measurement.phi_s)), -1, 1)
        here = np.moveaxis(self._smooth(*self.measurement.directions), -1, 1)
        return np.asarray((beside - here) * u / _STRETCH)

    def _beside(self, cells: NDArray[np.int64], away: Array, around: Array) -> tuple[Array, Array]:
        """θ_s and φ_s [degree] of directions beside cells, by small angles [rad] away from the mirror direction and around it."""
        theta, phi = self.measurement.theta_s[cells, None], self.measurement.phi_s[cells, None]
        outwards, turned = unit_vector(theta + 90, phi), unit_vector(np.full_like(theta, 90.0), phi + 90)
        return angles_of(unit_vector(theta, phi) + away[..., None] * outwards + around[..., None] * turned)

    def _smooth(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """Values without bends that are chance, (…, wavelength)."""
        return self._evaluated(theta_i, theta_o, phi_o)

    def _evaluated(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        wavelength = self.measurement.wavelength
        evaluate = representation(self.bsdf).evaluate
        brdf = evaluate(theta_i, np.zeros_like(theta_i), np.minimum(theta_o, 90.0), phi_o, wavelength)
        return np.broadcast_to(np.asarray(brdf), (*theta_o.shape, wavelength.size))


@dataclass(frozen=True)
class Family:
    """The predictions that inputs in doubt make possible.

    Parameters
    ----------
    given : what is known
    measurement : at whose cells
    prior_u : standard uncertainty of each input in doubt: of the index itself, of a factor relative
    """

    given: Given
    measurement: Measurement
    prior_u: Mapping[str, float]

    def inputs(self, change: Array) -> dict[str, float]:
        """Inputs after changes in prior standard uncertainties; factors change exponentially, so that none is ever negative."""
        by = dict(zip(self.prior_u, change * np.array([*self.prior_u.values()]), strict=True))
        return {name: float(by.get(name, 0.0) if name == "index" else np.exp(by.get(name, 0.0))) for name in INPUTS}

    def at(self, change: Array) -> Member:
        """The prediction after changes in prior standard uncertainties."""
        return Member(self.given.bsdf(self.inputs(change)), self.measurement, self, change)

    @cached_property
    def start(self) -> Member:
        """The prediction as it was made."""
        return self.at(np.zeros(len(self.prior_u)))

    @cached_property
    def smooth(self) -> xr.Dataset:
        """The facets without bends that are chance."""
        return scan.smooth(self.given.facets)

    def base_slopes(self, member: Member) -> Array:
        """Change of the base (input, …) as the facets above it reflect more or less; the same within a few prior uncertainties."""
        for change, known in self._base_slopes:
            if np.abs(change - member.change).max() < _FAR:
                return known
        slopes = np.zeros((len(self.prior_u), *self.measurement.value.shape))
        for row, name in enumerate(self.prior_u):
            if name != "diffuse":
                beside = self.at(member.change + _STEP * np.eye(len(self.prior_u))[row])
                slopes[row] = (beside.values - member.values) / _STEP - member.lobe_slope(name, self.given.facets)
        self._base_slopes.append((member.change, slopes))
        return slopes

    @cached_property
    def _base_slopes(self) -> list[tuple[Array, Array]]:
        """Where they were asked for, and what was found: each takes two BSDFs."""
        return []


@dataclass(frozen=True)
class Member(Predicted):
    """One of a family of predictions."""

    family: Family
    change: Array

    def slopes(self) -> Array:
        """Change of the values (input, …) with each input, in prior standard uncertainties."""
        lobe = np.array([self.lobe_slope(name, self.family.smooth) for name in self.family.prior_u])
        return lobe + self.family.base_slopes(self)

    def lobe_slope(self, name: str, facets: xr.Dataset) -> Array:
        """The same for one input and some facets, the base and its coupling to them held."""
        u = self.family.prior_u[name]
        if name == "diffuse":
            return u * (self.values - self._with(diffuse=np.zeros(1)))
        if name == "index":
            n = self.family.given.shifted(self.bsdf["n"], _STEP * u).values
            return (self._with(n=np.atleast_1d(n)) - self.values) / _STEP
        here, steeper = (self._with(surface=self._surface(facets, np.exp(by * u))) for by in (0.0, _STEP))
        return (steeper - here) / _STEP

    @cached_property
    def own_u(self) -> Array:
        """Of what is between the values of the density, and of what cells do not resolve."""
        return np.hypot(self._own_of_cells, scan.BETWEEN * self._lobe_u)

    @cached_property
    def common(self) -> Array:
        """Errors of the cells, and of the scan."""
        of_scan = scan.errors(self.family.given.facets, *self._facet)[:, :, None] * self._lobe_u
        return np.concatenate([self._common_to_cells, of_scan])

    @cached_property
    def _lobe_u(self) -> Array:
        """Standard uncertainty of what the facets mirror, as the scan knows them [sr-1]."""
        return scan.relative_u(self.family.given.facets, *self._facet)[:, None] * (
            self.values - self._with(surface=None)
        )

    @cached_property
    def _facet(self) -> tuple[Array, Array]:
        """Slopes along x and y, on the scan, of the facets that mirror the light into each cell, (incidence, cell)."""
        theta_i, theta_o, phi_o = self.measurement.directions
        phi_i = np.zeros_like(theta_i)
        p, q = slope_towards(half_vector(theta_i, phi_i, np.minimum(theta_o, 90.0), phi_o), phi_i, phi_o)
        factor = self.family.inputs(self.change)["slope"]
        return p / factor, q / factor

    def _surface(self, facets: xr.Dataset, factor: float = 1.0) -> Microsurface:
        """Facets of the scan, as steep as they are here, or by a further factor."""
        scaled = scaling.scaled(facets, self.family.inputs(self.change)["slope"] * factor)
        return Microsurface.of(scaled)

    def _smooth(self, theta_i: Array, theta_o: Array, phi_o: Array) -> Array:
        return self._modelled(theta_i, theta_o, phi_o, surface=self._surface(self.family.smooth))

    def _with(self, **parts: Any) -> Array:
        """Values at the cells with other parts of the model (:class:`brdfpipe.bsdf.microfacet.model.Model`), (incidence, wavelength, cell)."""
        return np.moveaxis(self._modelled(*self.measurement.directions, **parts), -1, 1)

    def _modelled(self, theta_i: Array, theta_o: Array, phi_o: Array, **parts: Any) -> Array:
        model = replace(Model.of(self.bsdf, None), **parts)
        brdf = model.evaluate(theta_i, np.zeros_like(theta_i), np.minimum(theta_o, 90.0), phi_o)
        return np.broadcast_to(brdf, (*theta_o.shape, self.measurement.wavelength.size))

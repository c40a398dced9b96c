"""The representation ``table``: a BSDF on a grid of directions, interpolated linearly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.grids import AZIMUTHS, GRIDS, Grid, kind_of
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

AXES = GRIDS["uniform"].axes
"""Dimensions of a uniform table of an isotropic BSDF; phi_o is taken from the azimuth of incidence."""

_SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Signs of cos θ_i and cos θ_o."""


class Table(Representation):
    """A BSDF on a grid of directions."""

    name = "table"
    kind = vocabulary.Kind(
        required={
            "brdf": [
                (*grid.named(lay), *spectral)
                for grid in GRIDS.values()
                for lay in (False, True)
                for spectral in ((), ("wavelength",))
            ]
        },
        optional={"total_reflectance": vocabulary.SPECTRAL, "theta_m": vocabulary.SCALAR},
    )
    accuracy = 1e-3
    """A quadrature over more digits would resolve the bends at the nodes, which are no lines of θ_o and φ_o in all layouts."""

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        brdf = dataset["brdf"]
        grid = GRIDS[kind_of(tuple(map(str, brdf.dims)))]
        self._grid = grid
        self._names = names = grid.named(grid.azimuth in brdf.dims)
        self._axes = axes = {name: dataset[name].values for name in names}
        brdf = brdf.transpose(*names, ...)
        self._values = per_wavelength(lambda wavelength: _spectral_values(brdf, wavelength))
        self._interpolators = per_wavelength(
            lambda wavelength: _interpolators_by_side(grid, axes, _spectral_values(brdf, wavelength))
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength), linear between the nodes and constant beyond the outermost.

        The two sides of the surface are interpolated apart. A side of which the table holds fewer than two nodes gives 0.
        """
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        shape = angles[0].shape
        theta_i, phi_i, theta_o, phi_o = (np.asarray(angle, dtype=float).ravel() for angle in angles)
        coordinates = self._folded(self._names, self._grid.coordinates(theta_i, phi_i, theta_o, phi_o))
        interpolators = self._interpolators(wavelength)
        result = np.zeros((theta_i.size, self._values(wavelength).shape[-1]))
        for sides in _SIDES:
            inside = (sides[0] * (90 - theta_i) > 0) & (sides[1] * (90 - theta_o) > 0)
            if inside.any() and sides in interpolators:
                result[inside] = interpolators[sides]([coordinates[name][inside] for name in self._names])
        return result.reshape(*shape, -1)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Directional reflectance [1], (incidences…, wavelength), exactly that of the interpolated table where it is uniform.

        Notes
        -----
        Each node's share is the integral of its own hat function, and the sum is linear between the incidences as the table is.
        """
        if self.albedo_needs_quadrature:
            return super().albedo(theta_i, phi_i, wavelength)
        weights = _polar_weights(self._axes["theta_o"]), _azimuth_weights(self._axes["phi_o"])
        sums = np.einsum("...opw,o,p->...w", self._values(wavelength), *weights)
        incidence = {"theta_i": theta_i.ravel(), "phi_i": np.broadcast_to(phi_i, theta_i.shape).ravel()}
        names = self._names[:-2]
        coordinates = self._folded(names, incidence)
        interpolate = _linear([self._axes[name] for name in names], sums)
        albedo = interpolate([coordinates[name] for name in names])
        return np.where(theta_i[..., None] < 90, albedo.reshape(*theta_i.shape, -1), 0.0)

    @property
    def albedo_needs_quadrature(self) -> bool:
        """A layout that is not uniform, or reaches below the horizon, has no exact integral."""
        return self._grid is not GRIDS["uniform"] or max(self._axes["theta_i"][-1], self._axes["theta_o"][-1]) > 90

    @property
    def isotropic(self) -> bool:
        return self._grid.azimuth not in self._names

    @property
    def kinks(self) -> tuple[Array, Array]:
        """The nodes of a uniform table; none for the others, whose nodes are no lines of θ_o and φ_o − φ_i."""
        if self._grid is not GRIDS["uniform"]:
            return super().kinks
        azimuth = self._axes["phi_o"]
        return self._axes["theta_o"], np.unique(np.concatenate([azimuth, 360 - azimuth]) % 360)

    def stored_values(self) -> Array:
        values = self._values(None)
        return values.reshape(-1, values.shape[-1])

    def stored_incidences(self) -> tuple[Array, Array]:
        if "theta_i" not in self._names:
            return super().stored_incidences()
        azimuths = self._axes.get("phi_i", np.zeros(1))
        theta_i, phi_i = np.meshgrid(self._axes["theta_i"], azimuths, indexing="ij")
        return theta_i.ravel(), phi_i.ravel()

    def nonspectral(self, weight: Array) -> xr.Dataset:
        response = xr.DataArray(weight, dims="wavelength")
        fields = {
            name: field @ response for name, field in self.dataset.data_vars.items() if "wavelength" in field.dims
        }
        return vocabulary.label(self.dataset.drop_dims("wavelength").assign(fields), "bsdf")

    def _folded(self, names: Sequence[str], coordinates: Mapping[str, Array]) -> dict[str, Array]:
        """Coordinates with their azimuths brought into the range of the table."""
        folded = {}
        for name in names:
            axis = self._axes[name]
            if name in AZIMUTHS:
                folded[name] = _fold(coordinates[name], axis)
            elif name == self._grid.azimuth:
                # A lay that half a turn leaves as it was needs half a circle.
                period = 180 if axis[-1] - axis[0] <= 180 else 360
                folded[name] = (coordinates[name] - axis[0]) % period + axis[0]
            else:
                folded[name] = coordinates[name]
        return folded


Interpolate = Callable[[Sequence[Array]], Array]
"""From coordinates, (points,) each, to values, (points, wavelength)."""


def _spectral_values(brdf: xr.DataArray, wavelength: Array | None) -> Array:
    values = at_wavelengths(brdf, wavelength)
    return values if "wavelength" in brdf.dims else values[..., None]


def _interpolators_by_side(grid: Grid, axes: Mapping[str, Array], values: Array) -> dict[tuple[int, int], Interpolate]:
    """Interpolators of the combinations of sides of which the table holds two nodes or more on each axis."""
    interpolators = {}
    for sides in _SIDES:
        nodes = [_on_side(name, axis, sides) for name, axis in axes.items()]
        if _holds(grid, sides) and min(chosen.sum() for chosen in nodes) >= 2:
            part = values[np.ix_(*(np.flatnonzero(chosen) for chosen in nodes))]
            held = [axis[chosen] for axis, chosen in zip(axes.values(), nodes, strict=True)]
            interpolators[sides] = _linear(held, part)
    return interpolators


def _holds(grid: Grid, sides: tuple[int, int]) -> bool:
    if grid is GRIDS["uniform"]:
        return True
    return sides == (1, 1) or (grid is GRIDS["specular"] and sides[0] == sides[1])


def _on_side(name: str, axis: Array, sides: tuple[int, int]) -> np.ndarray:
    """The nodes that light on these sides may use; the horizon belongs to both."""
    if name not in ("theta_i", "theta_o"):
        return np.ones(axis.size, dtype=bool)
    side = sides[0] if name == "theta_i" else sides[1]
    return side * (90 - axis) >= 0


def _fold(phi: Array, axis: Array) -> Array:
    """Azimuth brought into the range of the table: modulo 360, and by mirror symmetry where the table holds a half circle."""
    turned = (phi - axis[0]) % 360 + axis[0]
    return np.where(turned > axis[-1], 360 - turned, turned) if axis[-1] - axis[0] < 360 else turned


def _linear(axes: Sequence[Array], values: Array) -> Interpolate:
    """Multilinear interpolation, constant beyond the outermost nodes."""
    from scipy.interpolate import RegularGridInterpolator

    interpolate = RegularGridInterpolator(tuple(axes), values)

    def at(coordinates: Sequence[Array]) -> Array:
        points = [np.clip(each, axis[0], axis[-1]) for each, axis in zip(coordinates, axes, strict=True)]
        return np.asarray(interpolate(np.stack(points, axis=-1)))

    return at


def _polar_weights(axis: Array) -> Array:
    """∫ hat(θ) sin θ cos θ dθ of each node, over 0 to 90 degree."""
    edges = np.concatenate([[0.0], axis, [90.0]])
    theta, weight = panel_rule(np.unique(np.clip(edges, 0.0, 90.0)), 8)
    return _hat_integrals(axis, theta, np.radians(weight) * np.sin(np.radians(theta)) * np.cos(np.radians(theta)))


def _azimuth_weights(axis: Array) -> Array:
    """∫ hat(φ) dφ of each node, over a full turn."""
    edges = np.concatenate([axis, 360 - axis])
    edges = np.unique(np.concatenate([(edges - axis[0]) % 360, [0.0, 360.0]])) + axis[0]
    phi, weight = panel_rule(edges, 2)
    return _hat_integrals(axis, np.clip(_fold(phi, axis), axis[0], axis[-1]), np.radians(weight))


def _hat_integrals(axis: Array, points: Array, weight: Array) -> Array:
    place = np.interp(points, axis, np.arange(axis.size))
    before = np.minimum(place.astype(int), axis.size - 2)
    integrals = np.zeros(axis.size)
    np.add.at(integrals, before, weight * (1 - (place - before)))
    np.add.at(integrals, before + 1, weight * (place - before))
    return integrals

"""The representation ``table``: a BSDF on a grid of directions, interpolated linearly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.grids import AZIMUTHS, GRIDS, Grid, layout_of
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array, as_numbers
from brdfpipe.hemisphere import panel_rule
from brdfpipe.spectra.linear_recovery import amounts

AXES = GRIDS["uniform"].axes
"""Dimensions of a uniform table of an isotropic BSDF; phi_o is relative to the azimuth of incidence."""

_SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Signs of cos θ_i and cos θ_o."""


_NODES = [
    (*grid.named(lay), *spectral)
    for grid in GRIDS.values()
    for lay in (False, True)
    for spectral in ((), ("wavelength",))
]


class Table(Representation):
    """A BSDF on a grid of directions."""

    name = "table"
    kind = vocabulary.Kind(
        required={"brdf": _NODES},
        optional={
            "brdf_u": _NODES,
            "brdf_quality": [nodes for nodes in _NODES if "wavelength" not in nodes],
            "brdf_xyz": [(*nodes, "component") for nodes in _NODES if "wavelength" not in nodes],
            "spectrum_of_rgb": [("wavelength", "channel")],
            "total_reflectance": vocabulary.SPECTRAL,
            "theta_m": vocabulary.SCALAR,
        },
    )
    accuracy = 1e-3
    """A more accurate quadrature would resolve the kinks at the nodes, which are not lines of θ_o and φ_o in every layout."""

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        brdf = dataset["brdf"]
        self._grid = grid = layout_of(brdf.dims)
        self._folded_over = dataset.attrs.get("side") == "transmission"
        self._names = names = grid.named(grid.azimuth in brdf.dims)
        self._axes = axes = {name: dataset[name].values for name in names}
        self._has_colours = "spectrum_of_rgb" in dataset
        stored = (
            brdf.transpose(*names, ...)
            if not self._has_colours
            else xr.DataArray(amounts(dataset["brdf_xyz"].transpose(*names, ...).values), dims=(*names, "channel"))
        )
        self._values = per_wavelength(lambda wavelength: _stored_values(stored, wavelength))
        self._interpolators = per_wavelength(
            lambda wavelength: _interpolators_by_side(grid, axes, _stored_values(stored, wavelength))
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength), linear between the nodes and constant beyond the outermost.

        The two sides of the surface are interpolated separately; a side with fewer than two nodes gives 0. In a table with the attribute
        ``side="transmission"`` the polar angles of the outgoing light are those of the other side, from the normal there.
        """
        return self._by_wavelength(self._interpolated(theta_i, phi_i, theta_o, phi_o, wavelength), wavelength)

    def _interpolated(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """As :meth:`evaluate`, or the amounts of red, green and blue of a table of colours, (directions…, 3)."""
        wavelength = None if self._has_colours else wavelength
        return self._between(
            self._interpolators(wavelength), self._values(wavelength).shape[-1], theta_i, phi_i, theta_o, phi_o
        )

    def _between(
        self,
        interpolators: Mapping[tuple[int, int], Interpolate],
        width: int,
        theta_i: Array,
        phi_i: Array,
        theta_o: Array,
        phi_o: Array,
    ) -> Array:
        """Interpolated values (directions…, width)."""
        if self._folded_over:
            theta_o = 180 - theta_o
        one = as_numbers(theta_i, phi_i, theta_o, phi_o)
        if one is not None:
            side = interpolators.get((int(np.sign(90 - one[0])), int(np.sign(90 - one[2]))))
            if side is None:
                return np.zeros(width)
            found = self._folded(self._names, self._grid.coordinates(*one))
            return side([found[name] for name in self._names])[0]
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        shape = angles[0].shape
        theta_i, phi_i, theta_o, phi_o = (np.asarray(angle, dtype=float).ravel() for angle in angles)
        coordinates = self._folded(self._names, self._grid.coordinates(theta_i, phi_i, theta_o, phi_o))
        result = np.zeros((theta_i.size, width))
        for sides in _SIDES:
            selected = (sides[0] * (90 - theta_i) > 0) & (sides[1] * (90 - theta_o) > 0)
            if selected.any() and sides in interpolators:
                result[selected] = interpolators[sides]([coordinates[name][selected] for name in self._names])
        return result.reshape(*shape, width)

    def tristimulus(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, illuminant: str, observer: int
    ) -> Array | None:
        given = self.dataset.attrs.get("illuminant"), self.dataset.attrs.get("observer")
        if not self._has_colours or given != (illuminant, observer):
            return None
        return self._between(self._tristimulus_interpolators, 3, theta_i, phi_i, theta_o, phi_o) * 100 * np.pi

    @cached_property
    def _tristimulus_interpolators(self) -> dict[tuple[int, int], Interpolate]:
        values = self.dataset["brdf_xyz"].transpose(*self._names, ...).values
        return _interpolators_by_side(self._grid, self._axes, values)

    def _by_wavelength(self, values: Array, wavelength: Array | None) -> Array:
        """Amounts (…, 3) of a table of colours as a recovered spectrum (…, wavelength); values of other tables as they are."""
        if not self._has_colours:
            return values
        return np.asarray(
            values @ at_wavelengths(self.dataset["spectrum_of_rgb"].transpose("channel", "wavelength"), wavelength)
        )

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Directional reflectance [1], (incidences…, wavelength); for a uniform table the exact integral of its interpolation.

        The weight of a node is the integral of its hat function; the sum is linear between the incidences, as the table is.
        """
        if self.albedo_needs_quadrature:
            return super().albedo(theta_i, phi_i, wavelength)
        weights = _polar_weights(self._axes["theta_o"]), _azimuth_weights(self._axes["phi_o"])
        values = self._values(None if self._has_colours else wavelength)
        sums = np.einsum("...opw,o,p->...w", values, *weights)
        incidence = {"theta_i": theta_i.ravel(), "phi_i": np.broadcast_to(phi_i, theta_i.shape).ravel()}
        names = self._names[:-2]
        coordinates = self._folded(names, incidence)
        interpolate = _linear([self._axes[name] for name in names], sums)
        albedo = self._by_wavelength(interpolate([coordinates[name] for name in names]), wavelength)
        return np.where(theta_i[..., None] < 90, albedo.reshape(*theta_i.shape, albedo.shape[-1]), 0.0)

    @property
    def albedo_needs_quadrature(self) -> bool:
        """Whether the layout is not uniform or reaches below the horizon, so that there is no exact integral."""
        if self._folded_over or self._grid is not GRIDS["uniform"]:
            return True
        return bool(max(self._axes["theta_i"][-1], self._axes["theta_o"][-1]) > 90)

    @property
    def isotropic(self) -> bool:
        return self._grid.azimuth not in self._names

    @property
    def non_smooth_angles(self) -> tuple[Array, Array]:
        """The nodes of a uniform table; none for others, whose nodes are not lines of θ_o and φ_o − φ_i."""
        if self._grid is not GRIDS["uniform"]:
            return super().non_smooth_angles
        azimuth = self._axes["phi_o"]
        polar = self._axes["theta_o"]
        return 180 - polar[::-1] if self._folded_over else polar, np.unique(
            np.concatenate([azimuth, 360 - azimuth]) % 360
        )

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
        if self._has_colours:
            return vocabulary.label(self.dataset.drop_dims(["wavelength", "component", "channel"]), "bsdf")
        response = xr.DataArray(weight, dims="wavelength")
        fields = {name: data @ response for name, data in self.dataset.data_vars.items() if "wavelength" in data.dims}
        return vocabulary.label(self.dataset.drop_dims("wavelength").assign(fields), "bsdf")

    def _folded(self, names: Sequence[str], coordinates: Mapping[str, Array]) -> dict[str, Array]:
        """Coordinates with azimuths in the range of the table."""
        folded = {name: coordinates[name] for name in names}
        for name in names:
            axis = self._axes[name]
            if name in AZIMUTHS:
                folded[name] = _fold(coordinates[name], axis)
            elif name == self._grid.azimuth:
                # Half a circle is enough for a surface that half a turn does not change.
                period = 180 if axis[-1] - axis[0] <= 180 else 360
                folded[name] = (coordinates[name] - axis[0]) % period + axis[0]
        return folded


Interpolate = Callable[[Sequence[Array]], Array]
"""From coordinates, (points,) each, to values, (points, wavelength)."""


def _stored_values(field: xr.DataArray, wavelength: Array | None) -> Array:
    """(nodes…, wavelength), or (nodes…, 3) of amounts of red, green and blue."""
    values = at_wavelengths(field, wavelength)
    return values if {"wavelength", "channel"} & set(field.dims) else values[..., None]


def _interpolators_by_side(grid: Grid, axes: Mapping[str, Array], values: Array) -> dict[tuple[int, int], Interpolate]:
    """Interpolators of the combinations of sides for which the table has at least two nodes on each axis."""
    possible: dict[str, Sequence[tuple[int, int]]] = {
        "uniform": _SIDES,
        "specular": ((1, 1), (-1, -1)),
        "half": ((1, 1),),
    }
    interpolators = {}
    for sides in next(possible[name] for name, layout in GRIDS.items() if layout is grid):
        side_of = {"theta_i": sides[0], "theta_o": sides[1]}
        # The horizon belongs to both sides.
        nodes = [np.flatnonzero(side_of.get(name, 0) * (90 - axis) >= 0) for name, axis in axes.items()]
        if min(chosen.size for chosen in nodes) >= 2:
            side_axes = [axis[chosen] for axis, chosen in zip(axes.values(), nodes, strict=True)]
            interpolators[sides] = _linear(side_axes, values[np.ix_(*nodes)])
    return interpolators


def _fold(phi: Array, axis: Array) -> Array:
    """Azimuth in the range of the table: modulo 360, and by mirror symmetry if the table holds half a circle."""
    phi = (phi - axis[0]) % 360 + axis[0]
    return np.where(phi > axis[-1], 360 - phi, phi) if axis[-1] - axis[0] < 360 else phi


def _linear(axes: Sequence[Array], values: Array) -> Interpolate:
    """Multilinear interpolation, constant beyond the outermost nodes."""
    from scipy.interpolate import RegularGridInterpolator

    interpolate = RegularGridInterpolator(tuple(axes), values)
    ends = [(axis[0], axis[-1]) for axis in axes]

    def at(coordinates: Sequence[Array]) -> Array:
        points = [
            np.minimum(np.maximum(values, low), high) for values, (low, high) in zip(coordinates, ends, strict=True)
        ]
        return np.asarray(interpolate(np.array(points).T))

    return at


def _polar_weights(axis: Array) -> Array:
    """∫ hat(θ) sin θ cos θ dθ of the hat function of each node, over 0 to 90 degree."""
    edges = np.concatenate([[0.0], axis, [90.0]])
    theta, weight = panel_rule(np.unique(np.clip(edges, 0.0, 90.0)), 8)
    return _hat_integrals(axis, theta, np.radians(weight) * np.sin(np.radians(theta)) * np.cos(np.radians(theta)))


def _azimuth_weights(axis: Array) -> Array:
    """∫ hat(φ) dφ of the hat function of each node, over a full turn."""
    edges = np.concatenate([axis, 360 - axis])
    edges = np.unique(np.concatenate([(edges - axis[0]) % 360, [0.0, 360.0]])) + axis[0]
    phi, weight = panel_rule(edges, 2)
    return _hat_integrals(axis, np.clip(_fold(phi, axis), axis[0], axis[-1]), np.radians(weight))


def _hat_integrals(axis: Array, points: Array, weight: Array) -> Array:
    position = np.interp(points, axis, np.arange(axis.size))
    before = np.minimum(position.astype(int), axis.size - 2)
    integrals = np.zeros(axis.size)
    np.add.at(integrals, before, weight * (1 - (position - before)))
    np.add.at(integrals, before + 1, weight * (position - before))
    return integrals

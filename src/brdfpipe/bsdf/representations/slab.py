"""The representation ``slab``: a plane-parallel sheet in air, see :mod:`brdfpipe.bsdf.slab`.

Light reflected by the facets of a face is evaluated directly; light that has been inside is interpolated in a table over the index
and the internal transmittance, on which alone it depends, and smoothly. So it is computed at a few nodes of both for all wavelengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import UNRESOLVED_SLOPE, Representation
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.representations.wave import Wave
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric, grazing_factor
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array, as_numbers, half_vector
from brdfpipe.optics.fresnel_equations import plate, reflectance_of

SIDES = ("front", "back")

TABLE_DIMS = ("path", "theta_low", "span", "turn", "node")

SHIFT_DIMS = ("path", "shift_low", "shift_span", "shift_turn", "node")
"""Dimensions of what an uncertain input adds to the logarithm of the scattered light, on a coarser grid"""

BALANCE = ("reflectance", "transmittance", "absorptance", "specular_reflectance", "specular_transmittance")
"""Fluxes of the light from each incidence."""


def _of_waves(side: str, name: str) -> str:
    """Name of a variable of the ``wave`` dataset of a face in the dataset of a slab; they share their wavelengths."""
    return name if name == "wavelength" else f"{side}_wave_{name}"


_OF_A_FACE = tuple(dict.fromkeys(("representation", *Wave.kind.attributes, *Microfacet.kind.attributes)))
"""Attributes of the ``wave`` dataset of a face, or of the ``microfacet`` one of a face that reflects as its facets do."""

_BLOCK = 2**14
_BLACK = 1e-300
_LEAST_COSINE = 1e-12


_OUTER_REFLECTION = {**Microfacet.kind.required, **Microfacet.kind.optional, **Wave.kind.required, **Wave.kind.optional}


class Slab(Representation):
    """Two faces and the light between them; reflectance and transmittance have tables of their own."""

    name = "slab"
    kind = vocabulary.Kind(
        required={
            "n": vocabulary.SPECTRAL,
            "internal_transmittance": vocabulary.SPECTRAL,
            **{name: [("theta_i", "wavelength"), ("theta_i",)] for name in BALANCE},
            **{f"{side}_diffuse": [("theta",), ("theta", "wavelength")] for side in SIDES},
            "log_scattered": [TABLE_DIMS],
            **dict.fromkeys(("lobe_scale", "interpolation_error", "quadrature_error"), vocabulary.SCALAR),
        },
        optional={"log_shift": [SHIFT_DIMS]}
        | {f"{side}_slope_density": [(f"{side}_slope",)] for side in SIDES}
        | {f"{side}_lambda_smith": [(f"{side}_theta",)] for side in SIDES}
        | {
            _of_waves(side, name): [tuple(_of_waves(side, dim) for dim in dims) for dims in accepted]
            for side in SIDES
            for name, accepted in _OUTER_REFLECTION.items()
        },
        attributes=("masking", "transmission"),
    )
    uses_index = True
    transmittance_needs_quadrature = False

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._surfaces = surfaces = (_surface(dataset, "front"), _surface(dataset, "back"))
        self._model = per_wavelength(lambda wavelength: SlabModel.of(dataset, wavelength, surfaces))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._flux("reflectance", theta_i, wavelength)

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._flux("transmittance", theta_i, wavelength)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        reflectance = self._flux("specular_reflectance", theta_i, wavelength)
        return reflectance, self._flux("specular_transmittance", theta_i, wavelength)

    def _flux(self, name: str, theta_i: Array, wavelength: Array | None) -> Array:
        """A reflectance or transmittance between its nodes, (incidences…, wavelength or 1); 0 at 90 degree."""
        bsdf = self.dataset
        values = at_wavelengths(bsdf[name], wavelength).reshape(bsdf.sizes["theta_i"], -1)
        theta, nodes = np.asarray(theta_i, dtype=float).reshape(-1), bsdf["theta"].values
        polar = np.where(theta > 90, 180 - theta, theta)
        matrix = barycentric(nodes, polar)
        front, back = values[: nodes.size], values[nodes.size :][::-1]
        if self._surfaces == (None, None):
            # Near grazing no polynomial follows the flux of a plate that hardly absorbs: interpolated is what it differs by from a
            # plate of this index and transmittance, which is nothing but for means over wavelength.
            alike, at_nodes = (self._plate(name, angle, wavelength) for angle in (polar, nodes))
            front, back = (matrix @ (side - at_nodes) + alike for side in (front, back))
        else:
            front, back = matrix @ front, matrix @ back
        flux = np.clip(np.where((theta > 90)[:, None], back, front), 0.0, 1.0)
        return np.where((theta == 90)[:, None], 0.0, flux).reshape(*np.shape(theta_i), flux.shape[-1])

    def _plate(self, name: str, theta: Array, wavelength: Array | None) -> Array:
        """The same flux of a plate with two smooth faces, (angles, wavelength or 1)."""
        n, inside = (at_wavelengths(self.dataset[key], wavelength) for key in ("n", "internal_transmittance"))
        cos = np.maximum(np.cos(np.radians(theta)), _LEAST_COSINE)[:, None]
        return plate(cos, np.atleast_1d(n), inside)[name.endswith("transmittance")]

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def mirror_symmetric(self) -> bool:
        return True

    @property
    def lobe_slope(self) -> float:
        """Median slope of the smoother of the rough faces, or that at which its halo has half its peak."""
        slopes = [
            surface.typical_slope if isinstance(surface, Microsurface) else surface.lobe_slope
            for surface in self._surfaces
            if surface is not None
        ]
        return min(slopes, default=UNRESOLVED_SLOPE)

    def regime(self, side: str, theta_i: Array, wavelength: Array) -> tuple[Array, Array] | None:
        """Shares of the outer mirror reflection of a face that are coherent, and as of facets [1]; None for a face without waves."""
        surface = self._surfaces[SIDES.index(side)]
        return surface.regime(theta_i, wavelength) if isinstance(surface, Wave) else None

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The slab with the mean index; the light that has been inside is averaged with the weight.

        The light reflected by the facets is exact to second order in the spread of the index.
        """
        bsdf = self.dataset
        by_wavelength = bsdf["log_scattered"].values @ node_weights(bsdf, None)[1].T
        mean = np.maximum(np.exp(by_wavelength) @ weight, _BLACK)
        own = bsdf.drop_vars(
            [str(name) for name in bsdf.variables if str(name).startswith(tuple(vocabulary.WAVES_AT_FACES))]
        )
        spectral = {name: field for name, field in own.data_vars.items() if "wavelength" in field.dims}
        averaged = {name: (field.dims[:-1], field.values @ weight) for name, field in spectral.items()}
        nodes = ["wavelength", "node", "index_node", "wavelength_node", "depth_node"]
        reduced = own.drop_dims([name for name in nodes if name in own.dims]).assign(averaged)
        reduced = reduced.assign_coords(index_node=[float(reduced["n"])], depth_node=[0.0])
        for side, surface in zip(SIDES, self._surfaces, strict=True):
            if isinstance(surface, Wave | Microfacet):
                spectral_face = "wavelength" in surface.dataset.coords
                outside = surface.nonspectral(weight) if spectral_face else surface.dataset
                reduced = with_waves(reduced, side, outside)
        table = np.log(mean)[..., None].astype(np.float32)
        return vocabulary.label(reduced.assign(log_scattered=(TABLE_DIMS, table)), "bsdf")

    def averaged_change(self, name: str, change: Array, weight: Array) -> xr.Variable | None:
        """Of the shift of a logarithm, (changes, *SHIFT_DIMS): the mean over wavelength, weighted by the light too."""
        if name != "log_shift":
            return None
        by_wavelength = node_weights(self.dataset, None)[1].T
        table = self.dataset["log_scattered"].values
        light = np.exp(table[:, LobeGrid.coarser_nodes(table.shape[1]), ::3, ::3] @ by_wavelength) * weight
        mean = ((change @ by_wavelength) * light).sum(axis=-1, keepdims=True)
        mean /= np.maximum(light.sum(axis=-1, keepdims=True), _BLACK)
        return xr.Variable(("uncertain_change", *SHIFT_DIMS), mean.astype(np.float32))

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        return (float(weight @ self.dataset["n"].values), 0.0) if self.dataset["n"].ndim else None


@dataclass(frozen=True)
class SlabModel:
    """The slab at given wavelengths."""

    surfaces: tuple[Microsurface | Wave | Microfacet | None, Microsurface | Wave | Microfacet | None]
    """Facets or waves of the front and the back face; None for a smooth face"""
    wavelength: Array | None
    """(wavelength,) [nm] at which waves are evaluated; None for those of the dataset, or their mean"""
    masking: str
    n: Array
    """(wavelength or 1,) index"""
    weights: Array
    """(wavelength or 1, nodes) of the table's nodes of index and transmittance"""
    grid: LobeGrid
    table: Array
    """(paths, X, T, V, nodes) logarithm of the light that has been inside"""
    theta: Array
    """(N,) polar angles of ``diffuse`` [degree]"""
    shift: Array | None
    """(paths, X', T', V', nodes) what is added to the logarithm, on a coarser grid; None for nothing"""
    diffuse: tuple[Array, Array]
    """(N, wavelength or 1) factors of either angle in the diffuse reflection of each face"""

    @classmethod
    def of(
        cls,
        bsdf: xr.Dataset,
        wavelength: Array | None,
        surfaces: tuple[Microsurface | Wave | Microfacet | None, Microsurface | Wave | Microfacet | None],
    ) -> SlabModel:
        """The model of a ``bsdf`` dataset, representation ``slab``, at its own or other wavelengths [nm]."""
        front, back = (
            at_wavelengths(bsdf[f"{name}_diffuse"], wavelength).reshape(bsdf.sizes["theta"], -1) for name in SIDES
        )
        return cls(
            surfaces,
            wavelength,
            str(bsdf.attrs["masking"]),
            *node_weights(bsdf, wavelength),
            LobeGrid(bsdf["theta_low"].values, bsdf.sizes["span"], bsdf.sizes["turn"], float(bsdf["lobe_scale"])),
            bsdf["log_scattered"].values,
            bsdf["theta"].values,
            bsdf["log_shift"].values if "log_shift" in bsdf else None,
            (front, back),
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength or 1)."""
        one = as_numbers(theta_i, phi_i, theta_o, phi_o)
        if one is not None:
            return self._block(one[0], one[2], np.abs(one[3] - one[1]))
        azimuth = np.abs(np.asarray(phi_o, dtype=float) - phi_i)
        angles = np.broadcast_arrays(np.asarray(theta_i, dtype=float), np.asarray(theta_o, dtype=float), azimuth)
        flat = [angle.reshape(-1) for angle in angles]
        result = np.zeros((flat[0].size, self.weights.shape[0]))
        for start in range(0, flat[0].size, _BLOCK):
            block = slice(start, start + _BLOCK)
            result[block] = self._block(*(angle[block] for angle in flat))
        return result.reshape(*angles[0].shape, result.shape[-1])

    def _block(self, theta_i: Array, theta_o: Array, azimuth: Array) -> Array:
        """BSDF of some directions, (directions, wavelength or 1), or of one, (wavelength or 1,)."""
        behind_i, behind_o = theta_i > 90, theta_o > 90
        polar_i, polar_o = np.minimum(theta_i, 180 - theta_i), np.minimum(theta_o, 180 - theta_o)
        # From here on the order of the two directions is unknown, so the result is exactly reciprocal.
        low, high = np.minimum(polar_i, polar_o), np.maximum(polar_i, polar_o)
        at_front = np.where(behind_i, polar_o, polar_i)
        crossing = np.where(at_front <= low, 2, 3)
        path = np.where(behind_i != behind_o, crossing, np.where(behind_i, 1, 0))[()]
        values = self.grid.interpolate(self.table, path, low, high, azimuth)
        if self.shift is not None:
            values = values + self.grid.coarser().interpolate(self.shift, path, low, high, azimuth)
        logarithm = values @ self.weights.T
        smooth = (self.surfaces[0] is None, self.surfaces[1] is None)
        result = np.exp(logarithm) * grazing_factor(smooth, path, low, high)[..., None]
        if np.ndim(low) == 0:
            surface = self.surfaces[path] if path < 2 else None
            if surface is not None:
                result += self._outer_reflection(surface, self.diffuse[path], low, high, azimuth)
            return np.asarray(result if high < 90 else np.zeros_like(result))
        for side, surface in enumerate(self.surfaces):
            of_side = path == side
            if surface is not None and of_side.any():
                at = low[of_side], high[of_side], azimuth[of_side]
                result[of_side] += self._outer_reflection(surface, self.diffuse[side], *at)
        result[high == 90] = 0.0
        return np.asarray(result)

    def _outer_reflection(
        self, surface: Microsurface | Wave | Microfacet, diffuse: Array, low: Array, high: Array, azimuth: Array
    ) -> Array:
        """Light that a face reflects on the outside: by its facets or waves, and diffusely what these lose."""
        first, second = np.maximum(barycentric(self.theta, np.array([low, high])) @ diffuse, 0.0)
        if isinstance(surface, Wave | Microfacet):
            low, high, azimuth, none = np.asarray(low), np.asarray(high), np.asarray(azimuth), np.zeros(np.shape(low))
            return np.asarray(surface.evaluate(low, none, high, azimuth, self.wavelength) + first * second)
        pair = half_vector(low, 0.0, high, azimuth)
        facets = surface.reflected(pair, 0.0, azimuth, self.masking)[..., None]
        return np.asarray(facets * self._reflectance(pair.cos_zeta[..., None]) + first * second)

    @cached_property
    def _reflectance(self) -> Callable[[Array], Array]:
        """Fresnel's reflectance of cosines, (…, 1), as (…, wavelength)."""
        return reflectance_of(self.n, np.zeros(1))


def with_waves(bsdf: xr.Dataset, side: str, waves: xr.Dataset) -> xr.Dataset:
    """The dataset of a slab with the ``wave`` dataset of a face."""
    attributes = {_of_waves(side, name): value for name, value in waves.attrs.items() if name in _OF_A_FACE}
    renamed = waves.rename({name: _of_waves(side, str(name)) for name in waves.variables})
    result = bsdf.assign_coords(renamed.coords).assign(renamed.data_vars)
    return result.assign_attrs(attributes)


def _surface(bsdf: xr.Dataset, side: str) -> Microsurface | Wave | Microfacet | None:
    """The facets or waves of a face; None for a smooth face."""
    prefix = _of_waves(side, "")
    names = {str(name): str(name).removeprefix(prefix) for name in bsdf.variables if str(name).startswith(prefix)}
    if names:
        waves = bsdf[[name for name in names if name not in bsdf.coords]].rename(names)
        attributes = {name: bsdf.attrs.get(_of_waves(side, name)) for name in _OF_A_FACE}
        waves.attrs = {name: value for name, value in attributes.items() if value is not None}
        return Microfacet(waves) if waves.attrs["representation"] == Microfacet.name else Wave(waves)
    if f"{side}_slope_density" not in bsdf:
        return None
    members = ("slope_density", "lambda_smith")
    own = bsdf[[f"{side}_{name}" for name in members]]
    return Microsurface.of(own.rename({f"{side}_{name}": name for name in (*members, "slope", "theta")}))


# --- interpolation over index and internal transmittance


def node_weights(bsdf: xr.Dataset, wavelength: Array | None) -> tuple[Array, Array]:
    """Index (wavelength or 1,), and weights (wavelength or 1, nodes) of the nodes of index or wavelength, and transmittance."""
    n, inside = (np.atleast_1d(at_wavelengths(bsdf[name], wavelength)) for name in ("n", "internal_transmittance"))
    by_depth = depth_weights(bsdf["depth_node"].values, inside)
    weights = first_weights(bsdf, n, wavelength)[:, :, None] * by_depth[:, None, :]
    return n, weights.reshape(weights.shape[0], -1)


def first_weights(bsdf: xr.Dataset, n: Array, wavelength: Array | None) -> Array:
    """Weights (wavelength or 1, nodes) of the nodes of the index n, or of the wavelength [nm] where faces have waves."""
    if "wavelength_node" not in bsdf.coords:
        return lagrange(bsdf["index_node"].values, n)
    at = bsdf["wavelength"].values if wavelength is None else wavelength
    # The phase variance goes with the inverse square of the wavelength.
    return lagrange(bsdf["wavelength_node"].values ** -2.0, at**-2.0)


def lagrange(nodes: Array, x: Array) -> Array:
    """Weights, (x, nodes), of the polynomial through values at the nodes."""
    others = ~np.eye(nodes.size, dtype=bool)
    factors = np.where(others, (x[:, None, None] - nodes) / np.where(others, nodes[:, None] - nodes, 1.0), 1.0)
    return np.asarray(factors.prod(axis=-1))


def root_depth(transmittance: Array) -> Array:
    """√(−ln τ) of an internal transmittance."""
    return np.sqrt(-np.log(np.clip(transmittance, _BLACK, 1.0)))


def depth_weights(nodes: Array, transmittance: Array) -> Array:
    depth = root_depth(transmittance)
    if nodes.size == 1:
        return np.ones((depth.size, 1))
    weights = lagrange(nodes, np.minimum(depth, nodes[-1]))
    # Beyond the darkest node the light with the fewest crossings dominates: its logarithm is linear in ln τ.
    line = np.zeros_like(weights)
    line[:, -2:] = lagrange(nodes[-2:] ** 2, depth**2)
    return np.where((depth > nodes[-1])[:, None], line, weights)

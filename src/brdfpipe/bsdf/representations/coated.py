"""The representation ``coated``: an opaque body with a clear coat, see :mod:`brdfpipe.bsdf.slab.coated`.

f = facets of the coat + light reflected between the faces, from a table + A(θ_i) A(θ_o) G / 2π of light that has been in the body.
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
from brdfpipe.bsdf.representations.slab import TABLE_DIMS
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric, grazing_factor
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array, half_vector
from brdfpipe.optics.fresnel_equations import reflectance_of

_BLOCK = 2**14
_BLACK = 1e-300


class Coated(Representation):
    """Two faces, the light between them, and a diffuse body below; the reflectance has a table of its own."""

    name = "coated"
    kind = vocabulary.Kind(
        required={
            "n": vocabulary.SPECTRAL,
            "log_scattered": [TABLE_DIMS],
            "node_weight": [("wavelength", "node"), ("node",)],
            **{
                name: [("theta", "wavelength"), ("theta",)]
                for name in ("faces_reflectance", "faces_specular", "body_share")
            },
            "front_diffuse": [("theta", "wavelength"), ("theta",)],
            "body_weight": vocabulary.SPECTRAL,
            **dict.fromkeys(("lobe_scale", "interpolation_error", "quadrature_error"), vocabulary.SCALAR),
        },
        optional={
            "front_slope_density": [("front_slope",)],
            "front_lambda_smith": [("front_theta",)],
            "theta_m": vocabulary.SCALAR,
            "total_reflectance": [("wavelength",)],
            "diffuse_quality": [("wavelength",)],
        },
        attributes=("masking", "transmission"),
    )
    uses_index = True

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._surface = _surface(dataset)
        self._model = per_wavelength(lambda wavelength: CoatedModel.of(dataset, wavelength, self._surface))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        faces, share = (
            self._over_angles("faces_reflectance", theta_i, wavelength),
            self._model(wavelength).reflected_by_body,
        )
        above = np.asarray(theta_i) < 90
        body = self._over_angles("body_share", theta_i, wavelength) * share
        return np.where(above[..., None], np.clip(faces + body, 0.0, 1.0), 0.0)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        mirrored = np.clip(self._over_angles("faces_specular", theta_i, wavelength), 0.0, 1.0)
        mirrored = np.where((np.asarray(theta_i) < 90)[..., None], mirrored, 0.0)
        return mirrored, np.zeros_like(mirrored)

    def _over_angles(self, name: str, theta_i: Array, wavelength: Array | None) -> Array:
        values = at_wavelengths(self.dataset[name], wavelength).reshape(self.dataset.sizes["theta"], -1)
        theta = np.clip(np.asarray(theta_i, dtype=float), 0.0, 90.0)
        return np.asarray(barycentric(self.dataset["theta"].values, theta) @ values)

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def mirror_symmetric(self) -> bool:
        return True

    @property
    def lobe_slope(self) -> float:
        """Median slope of the facets of the coat."""
        return UNRESOLVED_SLOPE if self._surface is None else self._surface.typical_slope

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The coated body with the mean index of the coat; what has been inside is averaged with the weight."""
        bsdf = self.dataset
        model = self._model(None)
        mean = np.exp(bsdf["log_scattered"].values @ model.weights.T) @ weight
        shares = bsdf["body_share"].transpose("theta", ...).values.reshape(bsdf.sizes["theta"], -1)
        # Rank one at each wavelength: the mean has the geometric mean of both ends, exact where A does not depend on wavelength.
        strength = np.broadcast_to(model.body, weight.shape)
        total = float(weight @ strength)
        share = np.sqrt(np.maximum((shares**2 * strength) @ weight, 0.0) / total) if total > 0 else shares.mean(axis=1)
        averaged = {
            name: (
                "theta",
                np.broadcast_to(
                    bsdf[name].transpose("theta", ...).values.reshape(share.size, -1), (share.size, weight.size)
                )
                @ weight,
            )
            for name in ("faces_reflectance", "faces_specular", "front_diffuse")
        }
        reduced = bsdf.drop_dims("wavelength").assign(averaged)
        reduced = reduced.assign(
            n=float(weight @ np.broadcast_to(bsdf["n"].values, weight.shape)),
            body_share=("theta", share),
            body_weight=total,
        )
        reduced = reduced.drop_dims("node").assign(
            log_scattered=(TABLE_DIMS, np.log(np.maximum(mean, _BLACK))[..., None].astype(np.float32)),
            node_weight=("node", np.ones(1)),
        )
        return vocabulary.label(reduced, "bsdf")

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        return (float(weight @ self.dataset["n"].values), 0.0) if self.dataset["n"].ndim else None


@dataclass(frozen=True)
class CoatedModel:
    """The coated body at given wavelengths."""

    surface: Microsurface | None
    """Facets of the coat; None for a smooth one"""
    masking: str
    n: Array
    """(wavelength or 1,) index of the coat"""
    weights: Array
    """(wavelength or 1, nodes) of the table's nodes"""
    grid: LobeGrid
    table: Array
    """(1, X, T, V, nodes) logarithm of the light reflected between the faces"""
    theta: Array
    """(N,) polar angles of the fields below [degree]"""
    share: Array
    """(N, wavelength or 1) A"""
    body: Array
    """(wavelength or 1,) G"""
    diffuse: Array
    """(N, wavelength or 1) factor of either angle in the outer diffuse reflection"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None, surface: Microsurface | None) -> CoatedModel:
        """The model of a ``bsdf`` dataset, representation ``coated``, at its own or other wavelengths [nm]."""
        share, diffuse = (
            at_wavelengths(bsdf[name], wavelength).reshape(bsdf.sizes["theta"], -1)
            for name in ("body_share", "front_diffuse")
        )
        weights = at_wavelengths(bsdf["node_weight"], wavelength)
        return cls(
            surface,
            str(bsdf.attrs["masking"]),
            np.atleast_1d(at_wavelengths(bsdf["n"], wavelength)),
            weights.reshape(bsdf.sizes["node"], -1).T,
            LobeGrid(bsdf["theta_low"].values, bsdf.sizes["span"], bsdf.sizes["turn"], float(bsdf["lobe_scale"])),
            bsdf["log_scattered"].values,
            bsdf["theta"].values,
            share,
            np.atleast_1d(at_wavelengths(bsdf["body_weight"], wavelength)),
            diffuse,
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF in sr⁻¹, (directions…, wavelength or 1)."""
        azimuth = np.abs(np.asarray(phi_o, dtype=float) - phi_i)
        angles = np.broadcast_arrays(np.asarray(theta_i, dtype=float), np.asarray(theta_o, dtype=float), azimuth)
        flat = [angle.reshape(-1) for angle in angles]
        width = max(self.weights.shape[0], self.n.size, self.share.shape[1], self.body.size)
        result = np.zeros((flat[0].size, width))
        for start in range(0, flat[0].size, _BLOCK):
            block = slice(start, start + _BLOCK)
            # From here on the order of the two directions is unknown, so the result is exactly reciprocal.
            low, high = np.minimum(flat[0][block], flat[1][block]), np.maximum(flat[0][block], flat[1][block])
            above = high < 90
            part = result[block]
            part[above] = self._above(low[above], high[above], flat[2][block][above])
        return result.reshape(*angles[0].shape, width)

    def _above(self, low: Array, high: Array, azimuth: Array) -> Array:
        path = np.zeros(low.size, dtype=int)
        logarithm = self.grid.interpolate(self.table, path, low, high, azimuth) @ self.weights.T
        result = np.exp(logarithm) * grazing_factor((self.surface is None, True), path, low, high)[..., None]
        first, second = (np.maximum(barycentric(self.theta, angle) @ self.share, 0.0) for angle in (low, high))
        result = result + first * second * self.body / (2 * np.pi)
        if self.surface is None:
            return np.asarray(result)
        first, second = (np.maximum(barycentric(self.theta, angle) @ self.diffuse, 0.0) for angle in (low, high))
        pair = half_vector(low, 0.0, high, azimuth)
        facets = self.surface.reflected(pair, 0.0, azimuth, self.masking)[..., None]
        return np.asarray(result + facets * self._reflectance(pair.cos_zeta[..., None]) + first * second)

    @cached_property
    def _reflectance(self) -> Callable[[Array], Array]:
        """Fresnel's reflectance of cosines, (…, 1), as (…, wavelength)."""
        return reflectance_of(self.n, np.zeros(1))

    @cached_property
    def reflected_by_body(self) -> Array:
        """G ∫ A dE, (wavelength or 1,): the directional reflectance of the body is A times it, with E the étendue over 2π."""
        # The nodes are those of Gauss and Legendre in the angle.
        unit, weight = np.polynomial.legendre.leggauss(self.theta.size)
        theta = np.pi / 4 * (unit + 1)
        return np.asarray(self.body * ((np.pi / 4 * weight * np.sin(theta) * np.cos(theta)) @ self.share))


def _surface(bsdf: xr.Dataset) -> Microsurface | None:
    """The facets of the coat; None for a smooth one."""
    if "front_slope_density" not in bsdf:
        return None
    members = ("slope_density", "lambda_smith")
    own = bsdf[[f"front_{name}" for name in members]]
    return Microsurface.of(own.rename({f"front_{name}": name for name in (*members, "slope", "theta")}))

"""The representation ``traced``: light followed over a measured height map by rays, as a table."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.ndimage import map_coordinates
from scipy.special import erfc

from brdfpipe import vocabulary
from brdfpipe.bsdf.coupled_base import above_surface
from brdfpipe.bsdf.microfacet.model import mean_index
from brdfpipe.bsdf.representations.coupled_surface import COUPLED_SURFACE, CoupledSurface
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array, HalfVector, half_vector, slope_towards
from brdfpipe.optics.fresnel_equations import mean_fresnel, reflectance_of

_NODES = ("traced_incidence", "half_slope_across", "half_slope_along")
_DENSITY = [_NODES]
_BY_ORDER = [("order", "traced_incidence")]


class Traced(CoupledSurface):
    """A table of traced light over incidence and slope of the half vector, over a diffuse base.

    The table holds the density T of f = T F G / (4 cos θ_i cos θ_o cos⁴α), with Fresnel's reflectance F of the half vector, and G
    Smith's masking of a Gaussian surface of slope ``smith_slope``: factors that take the steep part of the dependence on the directions,
    so that T can be interpolated linearly. The mean of both directions of light is returned, so the BSDF is reciprocal.
    """

    name = "traced"
    kind = vocabulary.Kind(
        required={
            **dict.fromkeys(("single_density", "single_density_u", "multiple_density", "multiple_density_u"), _DENSITY),
            **COUPLED_SURFACE,
            **dict.fromkeys(("n", "k"), vocabulary.SPECTRAL),
            **dict.fromkeys(("smith_slope", "slope_scale", "traced_reflectance"), vocabulary.SCALAR),
            **dict.fromkeys(("reflected", "reflected_u", "refracted"), _BY_ORDER),
            "lost": [("traced_incidence",)],
        },
        optional={"total_reflectance": vocabulary.SPECTRAL},
        attributes=("rays", "seed", "edges", "band"),
    )
    accuracy = 1e-3
    """The table has kinks at its nodes."""

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        table = TracedTable.of(dataset)

        def colour_at(wavelength: Array | None) -> Colour:
            # A function of the dataset, not of this object, which would keep itself alive.
            n, k = (np.atleast_1d(at_wavelengths(dataset[name], wavelength)) for name in ("n", "k"))
            return table.colour(n, k)

        self._table, self._colour = table, per_wavelength(colour_at)

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        colour, base = self._colour(wavelength), self._base(wavelength)
        return above_surface(
            lambda i, azimuth_i, o, azimuth_o: self._table.brdf(i, azimuth_i, o, azimuth_o, colour) + base.brdf(i, o),
            *(theta_i, phi_i, theta_o, phi_o),
            max(colour.width, base.diffuse.size),
        )

    def uncertainty(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """Of the number of rays and of the finite map, as if the errors of neighbouring nodes were common."""
        colour = self._colour(wavelength)
        return above_surface(
            lambda i, azimuth_i, o, azimuth_o: self._table.uncertainty(i, azimuth_i, o, azimuth_o, colour),
            *(theta_i, phi_i, theta_o, phi_o),
            colour.width,
        )

    def albedo_uncertainty(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Of the number of rays and of the finite map; the diffuse part returns a share of what the surface misses."""
        node, total_u = self.dataset["traced_incidence"].values, self.dataset["reflected_u"].sum("order").values
        return np.interp(theta_i, node, total_u)[..., None] * (1 - self._base(wavelength).diffuse)

    @property
    def lobe_slope(self) -> float:
        return float(self.dataset["smith_slope"])

    def stored_values(self) -> Array:
        return self.dataset["single_density"].values.reshape(-1, 1)

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The weighted mean of the reflectance, and one index: as of the representation ``microfacet``."""
        bsdf, reduced = self.dataset, self._without_wavelength(weight)
        if "wavelength" in bsdf["n"].dims:
            n, k = mean_index(bsdf, weight)
            reduced = reduced.assign(n=n, k=k)
        return vocabulary.label(reduced, "bsdf")

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        return mean_index(self.dataset, weight) if self.dataset["n"].ndim else None

    def single_reflection(self) -> xr.Dataset:
        facets = self.without_diffuse()
        return facets.assign(multiple_density=xr.zeros_like(facets["multiple_density"]))


class Colour(NamedTuple):
    """What depends on the index of refraction, at some wavelengths."""

    reflectance: Callable[[Array], Array]
    """Fresnel's reflectance of cosines, (…, 1), as (…, wavelength)"""
    multiple: Array
    """(wavelength,) mean reflectance over that with which the light reflected more than once was traced"""
    width: int
    """Number of wavelengths"""


class TracedTable(NamedTuple):
    """Densities over incidence and slope of the half vector, and the factors that they are multiplied with."""

    incidence: Array
    """(incidences,) degree"""
    width: float
    step: float
    """Nodes are evenly spaced by ``step`` in asinh(slope/width)"""
    first: tuple[float, float]
    """asinh(slope/width) of the first node across and along"""
    density: Array
    """(2, incidences, across, along): reflected once, and more often"""
    density_u: Array
    smith_slope: float
    traced_reflectance: float
    """Mean reflectance of the facets with which the light reflected more than once was traced"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> TracedTable:
        across, along = (bsdf[name].values for name in _NODES[1:])
        width, slope = float(bsdf["slope_scale"]), float(bsdf["smith_slope"])
        return cls(
            bsdf["traced_incidence"].values,
            width,
            float(np.diff(np.arcsinh(along[:2] / width))[0]),
            (float(np.arcsinh(across[0] / width)), float(np.arcsinh(along[0] / width))),
            np.stack([bsdf[f"{name}_density"].values for name in ("single", "multiple")]),
            np.stack([bsdf[f"{name}_density_u"].values for name in ("single", "multiple")]),
            slope,
            float(bsdf["traced_reflectance"]),
        )

    def colour(self, n: Array, k: Array) -> Colour:
        """What :meth:`brdf` needs of an index n + ik, (wavelength,) each."""
        return Colour(reflectance_of(n, k), mean_fresnel(n, k) / self.traced_reflectance, n.size)

    def brdf(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, colour: Colour) -> Array:
        """Of the surface [sr-1], (directions…, wavelength); both directions above it."""
        return self._scaled(self.density, theta_i, phi_i, theta_o, phi_o, colour)

    def uncertainty(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, colour: Colour) -> Array:
        """Standard uncertainty of :meth:`brdf`."""
        return self._scaled(self.density_u, theta_i, phi_i, theta_o, phi_o, colour)

    def _scaled(
        self, density: Array, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, colour: Colour
    ) -> Array:
        """The mean of a density over both directions of light, times the factors of :class:`Traced`."""
        pair = half_vector(theta_i, phi_i, theta_o, phi_o)
        p, q = slope_towards(pair, phi_i, phi_o)
        turn = np.radians(np.array([phi_i, phi_o]))
        cos, sin = np.cos(turn), np.sin(turn)
        place = np.empty((3, *turn.shape))
        place[0] = np.interp(np.array([theta_i, theta_o]), self.incidence, np.arange(self.incidence.size))
        place[1], place[2] = (
            (np.arcsinh(slope / self.width) - first) / self.step
            for slope, first in zip((np.abs(q * cos - p * sin), p * cos + q * sin), self.first, strict=True)
        )
        single, multiple = (
            forward / 2 + backward / 2
            for forward, backward in (map_coordinates(part, place, order=1, mode="nearest") for part in density)
        )
        return np.asarray(
            colour.reflectance(pair.cos_zeta[..., None])
            * masking_over_cosines(pair, self.smith_slope)[..., None]
            * (single[..., None] + multiple[..., None] * colour.multiple)
        )


def masking_over_cosines(pair: HalfVector, slope: float) -> Array:
    """G / (4 cos θ_i cos θ_o cos⁴α), finite at the horizon; G is Smith's height-correlated masking of Gaussian slopes."""
    over = [
        cosine + _cosine_lambda(cosine, sine, slope)
        for cosine, sine in ((pair.cos_i, pair.sin_i), (pair.cos_o, pair.sin_o))
    ]
    # cos_i cos_o (1 + Λ_i + Λ_o)
    both = over[0] * pair.cos_o + pair.cos_i * over[1] - pair.cos_i * pair.cos_o
    mirrored: Array = (1 + pair.slope_squared) ** 2 / (4 * np.maximum(both, 1e-300))
    return mirrored


def _cosine_lambda(cosine: Array, sine: Array, slope: float) -> Array:
    """Λ(θ) cos θ of a Gaussian surface of slope rms ``slope`` along one axis (Heitz 2014, eq. 68)."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        v = cosine / (np.sqrt(2) * slope * sine)
        lifted = sine * slope / np.sqrt(2 * np.pi) * np.exp(-v * v)
    return np.asarray(np.maximum(lifted - cosine * erfc(np.minimum(v, 40.0)) / 2, 0.0))

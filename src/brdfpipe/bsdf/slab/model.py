"""A slab made ready to evaluate in bulk: its faces by their facets, what has been inside by its table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.slab.body import Mixture
from brdfpipe.bsdf.slab.lobe_table import LobeGrid, barycentric, grazing_factor
from brdfpipe.bsdf.spectral import at_wavelengths
from brdfpipe.geometry import Array, half_vector
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

SIDES = ("front", "back")

_BLOCK = 2**14


@dataclass(frozen=True)
class SlabModel:
    """The slab at its own or other wavelengths.

    Parameters
    ----------
    surfaces : facets of the front and the back face; None where it is smooth
    masking : of both
    mixture : of the nodes of index and transmittance
    grid, table : what has been inside, (paths, X, T, V, nodes)
    nodes : (N,) polar angles of ``diffuse`` [degree]
    diffuse : factors of either angle in the diffuse reflection of each face, (N, wavelength or 1)
    """

    surfaces: tuple[Microsurface | None, Microsurface | None]
    masking: str
    mixture: Mixture
    grid: LobeGrid
    table: Array
    nodes: Array
    diffuse: tuple[Array, Array]

    @classmethod
    def of(
        cls,
        bsdf: xr.Dataset,
        wavelength: Array | None,
        surfaces: tuple[Microsurface | None, Microsurface | None] | None = None,
    ) -> SlabModel:
        """The model of a ``bsdf`` dataset, representation ``slab``, at its own or other wavelengths [nm]; faces may be given prepared."""
        front, back = (
            at_wavelengths(bsdf[f"{name}_diffuse"], wavelength).reshape(bsdf.sizes["theta"], -1) for name in SIDES
        )
        return cls(
            surfaces or (surface_of(bsdf, "front"), surface_of(bsdf, "back")),
            str(bsdf.attrs["masking"]),
            Mixture.of(bsdf, wavelength),
            LobeGrid(bsdf["theta_low"].values, bsdf.sizes["span"], bsdf.sizes["turn"], float(bsdf["lobe_scale"])),
            bsdf["log_scattered"].values,
            bsdf["theta"].values,
            (front, back),
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength or 1)."""
        turned = np.abs(np.asarray(phi_o, dtype=float) - phi_i)
        angles = np.broadcast_arrays(np.asarray(theta_i, dtype=float), np.asarray(theta_o, dtype=float), turned)
        flat = [each.reshape(-1) for each in angles]
        result = np.zeros((flat[0].size, self.mixture.size))
        for start in range(0, flat[0].size, _BLOCK):
            block = slice(start, start + _BLOCK)
            result[block] = self._block(*(each[block] for each in flat))
        return result.reshape(*angles[0].shape, result.shape[-1])

    def _block(self, theta_i: Array, theta_o: Array, phi: Array) -> Array:
        behind_i, behind_o = theta_i > 90, theta_o > 90
        polar_i, polar_o = (np.where(each > 90, 180 - each, each) for each in (theta_i, theta_o))
        # Which direction came first is forgotten here: the rest cannot but be reciprocal.
        low, high = np.minimum(polar_i, polar_o), np.maximum(polar_i, polar_o)
        at_front = np.where(behind_i, polar_o, polar_i)
        crossing = np.where(at_front <= low, 2, 3)
        path = np.where(behind_i != behind_o, crossing, np.where(behind_i, 1, 0))
        logarithm = self.grid.interpolate(self.table, path, low, high, phi) @ self.mixture.weights.T
        smooth = (self.surfaces[0] is None, self.surfaces[1] is None)
        result = np.exp(logarithm) * grazing_factor(smooth, path, low, high)[:, None]
        for side, surface in enumerate(self.surfaces):
            here = path == side
            if surface is not None and here.any():
                result[here] += self._reflected(surface, self.diffuse[side], low[here], high[here], phi[here])
        result[high == 90] = 0.0
        return np.asarray(result)

    def _reflected(self, surface: Microsurface, diffuse: Array, low: Array, high: Array, phi: Array) -> Array:
        """What a face reflects without letting it in: once, by its facets, and diffusely, what they lose."""
        pair = half_vector(low, 0.0, high, phi)
        once = surface.reflected(pair, 0.0, phi, self.masking)[:, None]
        fresnel = fresnel_reflectance(pair.cos_zeta[:, None], self.mixture.n).mean
        first, second = (np.maximum(barycentric(self.nodes, each) @ diffuse, 0.0) for each in (low, high))
        return np.asarray(once * fresnel + first * second)


def share(bsdf: xr.Dataset, name: str, theta_i: Array, wavelength: Array | None) -> Array:
    """A share of the light between its nodes, (incidences…, wavelength or 1); none at 90 degree."""
    values = at_wavelengths(bsdf[name], wavelength).reshape(bsdf.sizes["theta_i"], -1)
    theta, nodes = np.asarray(theta_i, dtype=float).reshape(-1), bsdf["theta"].values
    matrix = barycentric(nodes, np.where(theta > 90, 180 - theta, theta))
    front, back = matrix @ values[: nodes.size], matrix @ values[nodes.size :][::-1]
    found = np.clip(np.where((theta > 90)[:, None], back, front), 0.0, 1.0)
    return np.where((theta == 90)[:, None], 0.0, found).reshape(*np.shape(theta_i), -1)


def surface_of(bsdf: xr.Dataset, name: str) -> Microsurface | None:
    """The facets of a face; None where it is smooth."""
    if f"{name}_slope_density" not in bsdf:
        return None
    members = ("slope_density", "lambda_smith")
    own = bsdf[[f"{name}_{each}" for each in members]]
    return Microsurface.of(own.rename({f"{name}_{each}": each for each in (*members, "slope", "theta")}))

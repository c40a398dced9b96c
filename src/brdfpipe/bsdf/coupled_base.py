"""The diffuse base below a surface whose directional albedo is a table, coupled so that the total reflectance is the measured one.

References
----------
Kelemen & Szirmay-Kalos 2001 (Eurographics short papers).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.spectral import spectral_values
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import Array, as_numbers

OfDirections: TypeAlias = Callable[[Array, Array, Array, Array], Array]
"""θ_i, φ_i, θ_o, φ_o [degree], (directions,) each or one number, to values (directions…, wavelength)"""

_WIDTH = 0.1  # of the slopes of a surface without facets, whose reflectance hardly depends on it
_VALUES_AT_ONCE = 2**17  # that are computed together, to limit memory


class CoupledBase(NamedTuple):
    """A surface's directional albedo and the diffuse reflectance below it, at some wavelengths."""

    albedo: AlbedoTable
    mean_albedo: Array
    diffuse: Array

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None) -> CoupledBase:
        """From ``directional_albedo``, ``mean_albedo`` and ``diffuse`` of a ``bsdf`` dataset."""
        lay = "phi_i" in bsdf.variables["directional_albedo"].dims
        around = (bsdf["phi_i"].values, ellipse_of(bsdf)) if lay else (None, None)
        names = ("directional_albedo", "mean_albedo", "diffuse")
        albedo, mean_albedo, diffuse = (spectral_values(bsdf, name, wavelength) for name in names)
        return cls(AlbedoTable(bsdf.variables["theta_i"].values, albedo, *around), mean_albedo, diffuse)

    def brdf(self, theta_i: Array, theta_o: Array, phi_i: Array | float = 0.0, phi_o: Array | float = 0.0) -> Array:
        """Of the light from the base [sr-1], (directions…, wavelength); both directions above the surface, azimuths for one with a lay."""
        if not self.diffuse.any():
            return np.zeros((1,) * (np.ndim(theta_i) + 1))
        azimuths = 0.0 if self.albedo.phi is None else np.array([phi_i, phi_o])
        entering, leaving = 1 - self.albedo(np.array([theta_i, theta_o]), azimuths)
        return np.asarray(self.diffuse / (np.pi * (1 - self.mean_albedo)) * (entering * leaving))

    def total_albedo(self, theta_i: Array, phi_i: Array | float = 0.0) -> Array:
        """Directional reflectance of surface and base [1], (incidences…, wavelength); 0 from below the surface."""
        surface = self.albedo(np.minimum(theta_i, 90.0), phi_i)
        return np.where((np.asarray(theta_i) < 90)[..., None], surface + self.diffuse * (1 - surface), 0.0)


def ellipse_of(bsdf: xr.Dataset) -> Ellipse:
    """The widths that scale the albedo of a surface with a lay: of its facets, else of its roughness spectrum."""
    if "slope_along" in bsdf.coords:
        return Ellipse.of(bsdf)
    ratio = float(bsdf["halo_stretch"])
    return Ellipse(_WIDTH / ratio, _WIDTH * ratio, float(bsdf["halo_lay"]))


def above_surface(
    values: OfDirections, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, width: int
) -> Array:
    """Values of pairs of directions above the surface, in blocks, and 0 of others, (directions…, wavelength); ``width`` wavelengths."""
    one = as_numbers(theta_i, phi_i, theta_o, phi_o)
    if one is not None:
        return np.broadcast_to(values(*one) if one[0] < 90 and one[2] < 90 else 0.0, width)
    angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
    flat = [np.asarray(angle, dtype=float).reshape(-1) for angle in angles]
    result = np.zeros((flat[0].size, width))
    above = np.flatnonzero((flat[0] < 90) & (flat[2] < 90))
    step = max(_VALUES_AT_ONCE // width, 64)
    for start in range(0, above.size, step):
        at = above[start : start + step]
        result[at] = values(flat[0][at], flat[1][at], flat[2][at], flat[3][at])
    return result.reshape(*angles[0].shape, width)

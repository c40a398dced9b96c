"""A microfacet dataset made ready to evaluate in bulk.

Directions are taken in blocks that stay in the processor's cache: a block's arrays are read and written there many times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.bsdf.microfacet import polarised, transmission
from brdfpipe.bsdf.microfacet.energy import AlbedoTable, directional_albedo
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.spectral import at_wavelengths
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import Array, half_vector
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

CRF_DIFFUSE_SHARE = 4 * (np.log(2) - 0.5)
"""Albedo of the patent's masked Lambertian lobe over that of the unmasked one: 4 ∫ μ²/(1 + μ) dμ = 0.7726."""

_BLOCK = 2**14


@dataclass(frozen=True)
class Model:
    """The interface and the base below it; spectral fields are (wavelength,) or of length 1."""

    surface: Microsurface | None
    """None where it is perfectly smooth."""
    masking: str
    n: Array
    k: Array
    diffuse_mode: str
    diffuse: Array
    albedo: AlbedoTable
    """Of all that the facets send back, after one reflection or several."""
    mean_albedo: Array
    furnace: AlbedoTable | None
    """Albedo of the same facets as perfect mirrors, where what they lose is compensated."""
    mean_furnace: float
    compensation: Array
    transparent: bool

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None, surface: Microsurface | None = None) -> Model:
        """The model of a ``bsdf`` dataset, representation ``microfacet`` or ``smooth``, at its own or other wavelengths [nm].

        The ``surface`` of the dataset may be given prepared.
        """

        def on(field: xr.DataArray) -> Array:
            values = at_wavelengths(field, wavelength)
            return values if "wavelength" in field.dims else values[..., None]

        theta = bsdf["theta_i"].values
        phi = bsdf["phi_i"].values if "phi_i" in bsdf["directional_albedo"].dims else None
        ellipse = None if phi is None else Ellipse.of(bsdf)
        furnace = bsdf.get("furnace_albedo")
        if surface is None and "slope_density" in bsdf:
            surface = Microsurface.of(bsdf)
        return cls(
            surface,
            str(bsdf.attrs["masking"]),
            on(bsdf["n"]),
            on(bsdf["k"]),
            str(bsdf.attrs["diffuse_mode"]),
            on(bsdf["diffuse"]),
            AlbedoTable(theta, on(bsdf["directional_albedo"]), phi, ellipse),
            on(bsdf["mean_albedo"]),
            None if furnace is None else AlbedoTable(theta, furnace.values[..., None], phi, ellipse),
            float(bsdf.get("mean_furnace_albedo", 1.0)),
            on(bsdf["compensation"]) if furnace is not None else np.zeros(1),
            bsdf.attrs["transmission"] == "interface",
        )

    @property
    def isotropic(self) -> bool:
        return self.albedo.phi is None

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength)."""
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        shape = angles[0].shape
        flat = [angle.reshape(-1) for angle in angles]
        width = max(each.shape[-1] for each in (self.n, self.diffuse, self.compensation))
        in_above, out_above = flat[0] < 90, flat[2] < 90
        above = in_above & out_above
        result = np.empty((flat[0].size, width)) if above.all() else np.zeros((flat[0].size, width))
        self._fill(result, above, self._reflected, flat)
        if self.transparent:
            in_below, out_below = flat[0] > 90, flat[2] > 90
            self._fill(result, in_below & out_below, self._reflected_below, flat)
            self._fill(result, (in_above & out_below) | (in_below & out_above), self._transmitted, flat)
        return result.reshape(*shape, width)

    @staticmethod
    def _fill(result: Array, where: NDArray[np.bool_], part: Callable[..., Array], angles: list[Array]) -> None:
        everywhere = bool(where.all())
        chosen = angles if everywhere else [angle[where] for angle in angles]
        target = result if everywhere else np.empty((chosen[0].size, result.shape[1]))
        step = max(_BLOCK // result.shape[1], 256)
        for start in range(0, chosen[0].size, step):
            block = slice(start, start + step)
            target[block] = part(*(angle[block] for angle in chosen))
        if not everywhere:
            result[where] = target

    def _reflected(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        brdf = np.zeros((1, 1))
        cos_o: Array | None = None
        if self.surface is not None:
            pair = half_vector(theta_i, phi_i, theta_o, phi_o)
            cos_o = pair.cos_o
            fresnel = fresnel_reflectance(pair.cos_zeta[:, None], self.n, self.k).mean
            brdf = self.surface.reflected(pair, phi_i, phi_o, self.masking)[:, None] * fresnel
        if self.furnace is not None:
            missed = (1 - self.furnace(theta_i, phi_i)) * (1 - self.furnace(theta_o, phi_o))
            brdf = brdf + self.compensation * missed / (np.pi * max(1 - self.mean_furnace, 1e-300))
        if not self.diffuse.any():
            return brdf
        if self.diffuse_mode == "crf":
            cos_o = np.cos(np.radians(theta_o)) if cos_o is None else cos_o
            return np.asarray(brdf + self.diffuse / np.pi * (2 * cos_o / (1 + cos_o))[:, None])
        let_in, let_out = 1 - self.albedo(theta_i, phi_i), 1 - self.albedo(theta_o, phi_o)
        return np.asarray(brdf + self.diffuse / (np.pi * (1 - self.mean_albedo)) * (let_in * let_out))

    def mueller(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """Mueller matrix of the BRDF, (directions…, wavelength, 4, 4): facets polarise, what comes from below them does not.

        NaN where light passes a transparent interface or meets it from within, which is not modelled for polarised light.
        """
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        shape = angles[0].shape
        flat = [angle.reshape(-1).astype(float) for angle in angles]
        width = max(each.shape[-1] for each in (self.n, self.diffuse, self.compensation))
        result = np.full((flat[0].size, width, 4, 4), np.nan if self.transparent else 0.0)
        above = (flat[0] < 90) & (flat[2] < 90)
        directions = [angle[above] for angle in flat]
        base = replace(self, surface=None)._reflected(*directions)
        if self.surface is None:
            facets = np.zeros(directions[0].size)
        else:
            facets = self.surface.reflected(half_vector(*directions), directions[1], directions[3], self.masking)
        theta_i, phi_i, theta_o, phi_o = directions
        result[above] = polarised.mueller(facets, theta_i, phi_i, theta_o, phi_o, self.n, self.k, base)
        return result.reshape(*shape, width, 4, 4)

    def _reflected_below(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        if self.surface is None:
            return np.zeros((1, 1))
        # From below the surface is seen upside down: slopes change sign, as if turned by half a circle.
        phi_i, phi_o = phi_i + 180, phi_o + 180
        pair = half_vector(180 - theta_i, phi_i, 180 - theta_o, phi_o)
        fresnel = fresnel_reflectance(pair.cos_zeta[:, None], 1 / self.n).mean
        return np.asarray(self.surface.reflected(pair, phi_i, phi_o, self.masking)[:, None] * fresnel)

    def _transmitted(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        if self.surface is None:
            return np.zeros((1, 1))
        values = [
            transmission.transmitted(self.surface, self.masking, float(n), theta_i, phi_i, theta_o, phi_o)
            for n in self.n
        ]
        return np.stack(values, axis=-1)

    def directional_albedo(self, theta_i: Array, phi_i: Array) -> Array:
        """Directional reflectance, (incidences…, wavelength): that of the facets, integrated anew, plus the other parts."""
        shape = theta_i.shape
        theta, phi = theta_i.reshape(-1), np.broadcast_to(phi_i, shape).reshape(-1)
        below = theta > 90
        total = np.zeros((theta.size, 1))
        if not below.all():
            total = total + np.where(below[:, None], 0.0, self._albedo_above(np.minimum(theta, 90.0), phi))
        if self.transparent and below.any():
            inside = self.specular(180 - theta, phi + 180, 1 / self.n)
            total = total + np.where(below[:, None], inside, 0.0)
        return np.where((theta == 90)[:, None], 0.0, total).reshape(*shape, -1)

    def _albedo_above(self, theta: Array, phi: Array) -> Array:
        total = self.specular(theta, phi, self.n)
        if self.furnace is not None:
            # ∫ (1 − E(θ_o)) cos θ_o dω_o = π (1 − Ē): the lobe keeps its share exactly.
            total = total + self.compensation * (1 - self.furnace(theta, phi))
        if self.diffuse_mode == "crf":
            return total + self.diffuse * CRF_DIFFUSE_SHARE
        return total + self.diffuse * (1 - self.albedo(theta, phi))

    def specular(self, theta: Array, phi: Array, n: Array) -> Array:
        """Single reflection by the facets, or by the smooth surface, (incidences, wavelength)."""
        if self.surface is None:
            cos = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
            return np.asarray(fresnel_reflectance(cos[:, None], n, self.k).mean)
        return directional_albedo(self.surface, self.masking, n, self.k, theta, phi)

    def transmittance(self, theta_i: Array, phi_i: Array) -> Array:
        """Share of the light that passes the interface, (incidences…, wavelength)."""
        theta, phi = theta_i.reshape(-1), np.broadcast_to(phi_i, theta_i.shape).reshape(-1)
        if not self.transparent:
            return np.zeros((*theta_i.shape, 1))
        if self.surface is None:
            below = (theta > 90)[:, None]
            cos = np.abs(np.where(theta == 90, 0.0, np.cos(np.radians(theta))))[:, None]
            passed = 1 - fresnel_reflectance(cos, np.where(below, 1 / self.n, self.n)).mean
        else:
            passed = transmission.directional_transmittance(self.surface, self.masking, self.n, theta, phi)
        return np.where((theta == 90)[:, None], 0.0, passed).reshape(*theta_i.shape, -1)

"""The microfacet model: BSDF, directional reflectance and transmittance, and the diffuse base that closes the total reflectance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from brdfpipe import hemisphere
from brdfpipe.bsdf.microfacet import energy, polarised, transmission
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.microfacet.energy import directional_albedo
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.second_reflection import SecondReflection, second_reflection, with_second_reflection
from brdfpipe.bsdf.spectral import OnlyOnce, each_time, spectral_values
from brdfpipe.facets.facet_dataset import radial_average
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, as_numbers, half_vector, tan_half
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking.modes import PHYSICAL_MASKINGS
from brdfpipe.masking.smith import Smith, smith_lambda
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance
from brdfpipe.optics.fresnel_equations import mean_fresnel as mean_fresnel_reflectance
from brdfpipe.optics.fresnel_equations import reflectance_of

CRF_DIFFUSE_SHARE = 4 * (np.log(2) - 0.5)
"""Albedo of the patent's masked Lambertian lobe over that of the unmasked one: 4 ∫ μ²/(1 + μ) dμ = 0.7726."""

_LAY_AZIMUTHS = 24
"""Azimuths at which the light reflected more than once by a surface with a lay is sampled."""

_FAR_BELOW = 0.5
"""Traced light over the light that the single reflection leaves, below which no limit applies between the angles that are compared."""

_BLOCK = 2**14
"""Directions that are evaluated together, so that their arrays stay in the processor's cache."""

_CLOSEST_TO_METAL = 1e70
"""Larger indices are perfect mirrors."""

MANY_VALUES = 2**19
"""From so many values on, the compiled kernel is used: to load it takes as long as numpy needs for a few times as many."""


@dataclass(frozen=True)
class Model:
    """The interface and the diffuse base below it; spectral fields are (wavelength,) or of length 1."""

    surface: Microsurface | None
    """None if perfectly smooth"""
    masking: str
    n: Array
    k: Array
    diffuse_mode: str
    diffuse: Array
    albedo: AlbedoTable
    """Of the facets, after one or several reflections"""
    mean_albedo: Array
    furnace: AlbedoTable | None
    """Albedo of the same facets as perfect mirrors, if their loss is compensated"""
    mean_furnace: float
    compensation: Array
    second: SecondReflection | None
    transparent: bool

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None, surface: Microsurface | None = None) -> Model:
        """The model of a ``bsdf`` dataset, representation ``microfacet`` or ``smooth``, at its own or other wavelengths [nm].

        ``surface`` is that of the dataset, if it is prepared already.
        """

        def spectral(name: str) -> Array:
            return spectral_values(bsdf, name, wavelength)

        theta = bsdf.variables["theta_i"].values
        phi = bsdf["phi_i"].values if "phi_i" in bsdf.variables["directional_albedo"].dims else None
        ellipse = None if phi is None else Ellipse.of(bsdf)
        furnace = bsdf.get("furnace_albedo")
        if surface is None and "slope_density" in bsdf:
            surface = Microsurface.of(bsdf)
        compensation = spectral("compensation") if furnace is not None else np.zeros(1)
        second = SecondReflection.of(bsdf, spectral("second_reflection")) if "second_reflection" in bsdf else None
        return cls(
            surface,
            str(bsdf.attrs["masking"]),
            spectral("n"),
            spectral("k"),
            str(bsdf.attrs["diffuse_mode"]),
            spectral("diffuse") if "diffuse" in bsdf.variables else np.zeros(1),
            AlbedoTable(theta, spectral("directional_albedo"), phi, ellipse, _pieces(second, phi)),
            spectral("mean_albedo"),
            None if furnace is None else AlbedoTable(theta, furnace.values[..., None], phi, ellipse),
            float(bsdf.get("mean_furnace_albedo", 1.0)),
            compensation,
            second,
            bsdf.attrs["transmission"] == "interface",
        )

    @property
    def isotropic(self) -> bool:
        return self.albedo.phi is None

    @cached_property
    def _width(self) -> int:
        return max(field.shape[-1] for field in (self.n, self.diffuse, self.compensation))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength)."""
        one = as_numbers(theta_i, phi_i, theta_o, phi_o)
        if one is not None and one[0] < 90 and one[2] < 90:
            brdf = self._reflected(*one)
            return brdf if brdf.shape == (self._width,) else np.full(self._width, brdf)
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        shape = angles[0].shape
        flat = [angle.reshape(-1) for angle in angles]
        if flat[0].size * self._width >= MANY_VALUES and self._has_kernel:
            return self._compiled(flat).reshape(*shape, self._width)
        in_above, out_above = flat[0] < 90, flat[2] < 90
        above = in_above & out_above
        result = (np.empty if above.all() else np.zeros)((flat[0].size, self._width))
        self._fill(result, above, self._reflected, flat)
        if self.transparent:
            in_below, out_below = flat[0] > 90, flat[2] > 90
            self._fill(result, in_below & out_below, self._reflected_below, flat)
            self._fill(result, (in_above & out_below) | (in_below & out_above), self._transmitted, flat)
        return result.reshape(*shape, self._width)

    @property
    def _has_kernel(self) -> bool:
        """Whether the compiled kernel evaluates this model: opaque, denser than air, and with the modes that conserve energy."""
        return (
            self.surface is not None
            and not self.transparent
            and self.masking in PHYSICAL_MASKINGS
            and (self.diffuse_mode != "crf" or not self.diffuse.any())
            and bool(np.all((self.n < _CLOSEST_TO_METAL) & ((self.n >= 1) | (self.k > 0))))
        )

    @cached_property
    def _compiled(self) -> Callable[[Sequence[Array]], Array]:
        """The kernel with the fields of this model, from θ_i, φ_i, θ_o and φ_o, (directions,) each."""
        from brdfpipe.bsdf.microfacet import evaluation_kernel as kernel

        assert self.surface is not None
        n, k = np.broadcast_arrays(self.n, self.k)
        of_index = n.size if n.size == 1 else self._width
        base = self._base_brdf if self._has_base else np.zeros(1)
        returned = self.compensation / (np.pi * max(1 - self.mean_furnace, 1e-300))
        shading = kernel.Shading(
            np.full(of_index, n),
            np.full(of_index, k),
            np.full(self._width, base),
            np.full(self._width, returned),
            absorbs=bool(k.any()),
            has_base=self._has_base,
            has_returned=self.furnace is not None,
        )
        further = kernel.NO_FURTHER_LIGHT if self.second is None else self.second.for_kernel
        tables = kernel.tables_of(self.surface, self.masking, self.albedo, self.furnace, further)
        return lambda angles: kernel.evaluate(tables, shading, angles, self._width)

    @staticmethod
    def _fill(result: Array, where: NDArray[np.bool_], evaluate: Callable[..., Array], angles: list[Array]) -> None:
        """Evaluate the directions of a mask in blocks."""
        everywhere = bool(where.all())
        selected = angles if everywhere else [angle[where] for angle in angles]
        target = result if everywhere else np.empty((selected[0].size, result.shape[1]))
        step = max(_BLOCK // result.shape[1], 256)
        for start in range(0, selected[0].size, step):
            block = slice(start, start + step)
            target[block] = evaluate(*(angle[block] for angle in selected))
        if not everywhere:
            result[where] = target

    def _reflected(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF of directions above the surface, (directions…, wavelength or 1)."""
        if self.surface is None:
            return self._with_further_light(np.zeros((1,) * (np.ndim(theta_i) + 1)), theta_i, phi_i, theta_o, phi_o)
        pair = half_vector(theta_i, phi_i, theta_o, phi_o)
        visible = self.surface.visibility(pair, phi_i, phi_o, self.masking)
        return self.reflected_by(pair, visible, theta_i, phi_i, theta_o, phi_o)

    def reflected_by(
        self,
        pair: HalfVector,
        visible: Array,
        theta_i: Array,
        phi_i: Array,
        theta_o: Array,
        phi_o: Array,
        once: OnlyOnce = each_time,
    ) -> Array:
        """The same of known half vectors, whose facets have a known :meth:`Microsurface.visibility`."""
        assert self.surface is not None
        mirrors = self.surface.mirrors(pair, visible, phi_i, phi_o)
        reflectance = once(
            ("facets' reflectance", id(self.n), id(self.k)), lambda: self._reflectance(pair.cos_zeta[..., None])
        )
        return self._with_further_light(mirrors[..., None] * reflectance, theta_i, phi_i, theta_o, phi_o, once)

    def further_light(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array | None:
        """BRDF of directions above the surface without the single reflection, (directions…, wavelength or 1); None if there is no such light."""
        if self.second is None and self.furnace is None and not self._has_base:
            return None
        nothing = np.zeros((1,) * (np.ndim(theta_i) + 1))
        return self._with_further_light(nothing, theta_i, phi_i, theta_o, phi_o)

    def _with_further_light(
        self, brdf: Array, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, once: OnlyOnce = each_time
    ) -> Array:
        """A BRDF with the light that facets reflect more than once, and that of the base."""
        if self.second is not None:
            second = self.second
            further = once(("further light", id(second)), lambda: second(theta_i, phi_i, theta_o, phi_o))
            brdf = brdf + (further if np.ndim(theta_i) else further[0])
        if self.furnace is not None:
            lost = (1 - self.furnace(theta_i, phi_i)) * (1 - self.furnace(theta_o, phi_o))
            brdf = brdf + self.compensation * lost / (np.pi * max(1 - self.mean_furnace, 1e-300))
        if not self._has_base:
            return brdf
        if self.diffuse_mode == "crf":
            cos_o = 2 / (1 + tan_half(theta_o) ** 2) - 1
            return np.asarray(brdf + self.diffuse / np.pi * (2 * cos_o / (1 + cos_o))[..., None])
        both = self.albedo(np.array([theta_i, theta_o]).reshape(-1), np.array([phi_i, phi_o]).reshape(-1))
        entering, leaving = (1 - both).reshape(2, *np.shape(theta_i), both.shape[-1])
        return np.asarray(brdf + self._base_brdf * (entering * leaving))

    @cached_property
    def _has_base(self) -> bool:
        return bool(self.diffuse.any())

    @cached_property
    def _base_brdf(self) -> Array:
        """BRDF of the coupled base where all light enters and leaves [sr-1]."""
        return np.asarray(self.diffuse / (np.pi * (1 - self.mean_albedo)))

    @cached_property
    def _reflectance(self) -> Callable[[Array], Array]:
        """Fresnel's reflectance of cosines, (…, 1), as (…, wavelength)."""
        return reflectance_of(self.n, self.k)

    def mueller(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """Mueller matrix of the BRDF, (directions…, wavelength, 4, 4): facets polarise, light from below them is unpolarised.

        NaN for light through a transparent interface or from within it, which is not modelled for polarised light.
        """
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        above = (angles[0] < 90) & (angles[2] < 90)
        theta_i, phi_i, theta_o, phi_o = (angle[above].astype(float) for angle in angles)
        result = np.full((*above.shape, self._width, 4, 4), np.nan if self.transparent else 0.0)
        base = replace(self, surface=None)._reflected(theta_i, phi_i, theta_o, phi_o)
        facets = np.zeros(theta_i.size)
        if self.surface is not None:
            pair = half_vector(theta_i, phi_i, theta_o, phi_o)
            facets = self.surface.reflected(pair, phi_i, phi_o, self.masking)
        result[above] = polarised.mueller(facets, theta_i, phi_i, theta_o, phi_o, self.n, self.k, base)
        return result

    def _reflected_below(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        if self.surface is None:
            return np.zeros((1, 1))
        # Seen from below the slopes change sign, as if the surface were turned by 180 degree.
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
        """Directional reflectance, (incidences…, wavelength): of the facets, by quadrature, and of the other parts."""
        shape = theta_i.shape
        theta, phi = theta_i.reshape(-1), np.broadcast_to(phi_i, shape).reshape(-1)
        below = theta > 90
        total = np.zeros((theta.size, 1))
        if not below.all():
            total = total + np.where(below[:, None], 0.0, self._albedo_above(np.minimum(theta, 90.0), phi))
        if self.transparent and below.any():
            inside = self.specular(180 - theta, phi + 180, 1 / self.n)
            total = total + np.where(below[:, None], inside, 0.0)
        return np.where((theta == 90)[:, None], 0.0, total).reshape(*shape, total.shape[-1])

    def _albedo_above(self, theta: Array, phi: Array) -> Array:
        total = self.specular(theta, phi, self.n)
        if self.second is not None:
            total = total + self.second.albedo(theta, phi)
        if self.furnace is not None:
            # ∫ (1 − E(θ_o)) cos θ_o dω_o = π (1 − Ē): exact.
            total = total + self.compensation * (1 - self.furnace(theta, phi))
        if self.diffuse_mode == "crf":
            return total + self.diffuse * CRF_DIFFUSE_SHARE
        return total + self.diffuse * (1 - self.albedo(theta, phi))

    def specular(self, theta: Array, phi: Array, n: Array) -> Array:
        """Single reflection by the facets, or by the smooth surface, (incidences, wavelength)."""
        if self.surface is None:
            return _smooth_reflectance(theta, n, self.k)
        return directional_albedo(self.surface, self.masking, n, self.k, theta, phi)

    def transmittance(self, theta_i: Array, phi_i: Array) -> Array:
        """Directional transmittance of the interface, (incidences…, wavelength)."""
        theta, phi = theta_i.reshape(-1), np.broadcast_to(phi_i, theta_i.shape).reshape(-1)
        if not self.transparent:
            return np.zeros((*theta_i.shape, 1))
        if self.surface is None:
            below = (theta > 90)[:, None]
            cos = np.abs(np.where(theta == 90, 0.0, np.cos(np.radians(theta))))[:, None]
            passed = 1 - fresnel_reflectance(cos, np.where(below, 1 / self.n, self.n)).mean
        else:
            passed = transmission.directional_transmittance(self.surface, self.masking, self.n, theta, phi)
        return np.where((theta == 90)[:, None], 0.0, passed).reshape(*theta_i.shape, passed.shape[-1])


# --- albedo and diffuse base of a dataset


def with_albedo(bsdf: xr.Dataset, theta_m: float) -> xr.Dataset:
    """Add the directional albedo of the interface, its mean, and the fields that compensate multiple scattering."""
    spectral, exact = bsdf["n"].dims, np.array([0.0, theta_m, 90.0])
    n, k = np.atleast_1d(bsdf["n"].values), np.atleast_1d(bsdf["k"].values)
    multiple = bsdf.attrs["multiple_scattering"] if "slope_density" in bsdf else "none"
    furnace: AlbedoTable | None = None
    mean_furnace = 1.0
    if "slope_density" not in bsdf:
        # The reflectance varies within 1/|N| of grazing, and for a small contrast within √(2 (n − 1)).
        table = energy.refined(lambda theta: _smooth_reflectance(theta, n, k), 0.01, exact)
    else:
        surface, masking = Microsurface.of(bsdf), str(bsdf.attrs["masking"])

        # Of a surface without a lay, perfect mirrors would need more nodes than the material.
        with_mirrors = multiple == "compensated" or (multiple == "directional" and not surface.isotropic)

        def albedos(theta: Array, phi: Array) -> Array:
            # Masking modes that do not conserve energy may exceed 1: no light is left for the base.
            single = directional_albedo(surface, masking, n, k, theta, phi, mirrors=with_mirrors)
            single[:, : n.size] = np.minimum(single[:, : n.size], 1.0)
            return single

        table = energy.tabulated(surface, albedos, exact)
        furnace = replace(table, values=table.values[..., n.size :]) if with_mirrors else None
        mean_furnace = _mean_mirror_albedo(surface, masking) if furnace is None else float(furnace.mean()[0])
    dims = ("theta_i",) if table.phi is None else ("theta_i", "phi_i")
    bsdf = bsdf.assign_coords({"theta_i": table.theta} | ({} if table.phi is None else {"phi_i": table.phi}))
    albedo = replace(table, values=table.values[..., : n.size])
    if multiple == "compensated":
        assert furnace is not None
        fresnel = mean_fresnel_reflectance(n, k)
        # F_ms of all further reflections, each with the mean reflectance of a facet.
        factor = np.asarray(fresnel**2 * mean_furnace / (1 - fresnel * (1 - mean_furnace)))
        albedo = replace(albedo, values=albedo.values + factor * (1 - furnace.values))
        compensation = (spectral, factor if spectral else factor[0])
        bsdf = bsdf.assign(furnace_albedo=(dims, furnace.values[..., 0]), compensation=compensation)
    if multiple == "directional":
        second = _directional(surface, masking, n, k, furnace)
        albedo, bsdf = _with_further_light(albedo, second), with_second_reflection(bsdf, second)
    if multiple == "measured":
        second = _measured(bsdf)
        second = second.within(albedo.theta, 1 - albedo.values.reshape(albedo.theta.size, -1, n.size).max(axis=1))
        albedo, bsdf = _with_further_light(albedo, second), with_second_reflection(bsdf, second)
    values, mean = albedo.values, albedo.mean()
    return bsdf.assign(
        directional_albedo=((*dims, *spectral), values if spectral else values[..., 0]),
        mean_albedo=(spectral, mean if spectral else mean[0]),
        mean_furnace_albedo=mean_furnace,
    )


def with_reflections(bsdf: xr.Dataset, theta_m: float) -> xr.Dataset:
    """Add the light that facets reflect more than once, as :func:`with_albedo` does, but no table of the albedo where that can be left out.

    Traced light is limited to what the single reflection leaves. It is far below that, so that a few angles of incidence show that no
    limit applies; else the table is made.
    """
    multiple, lay = bsdf.attrs["multiple_scattering"], bsdf["slope_density"].ndim == 2
    if multiple == "none":
        return bsdf
    n, k = np.atleast_1d(bsdf["n"].values), np.atleast_1d(bsdf["k"].values)
    surface, masking = Microsurface.of(bsdf), str(bsdf.attrs["masking"])
    if multiple == "directional" and not lay:
        return with_second_reflection(bsdf, _directional(surface, masking, n, k, None))
    if multiple == "measured" and not lay:
        second = _measured(bsdf)
        theta = second.theta[second.theta < 90]
        left = 1 - directional_albedo(surface, masking, n, k, theta)
        if (second.albedo(theta) < _FAR_BELOW * left).all():
            return with_second_reflection(bsdf, second)
    return with_albedo(bsdf, theta_m)


def _directional(
    surface: Microsurface, masking: str, n: Array, k: Array, furnace: AlbedoTable | None
) -> SecondReflection:
    """The light that Smith's surface reflects more than once; ``furnace`` is the albedo of perfect mirrors with a lay."""

    def missing(theta: Array, phi: Array) -> Array:
        if furnace is None:
            return 1 - energy.mirror_albedo(surface, masking, theta)
        return 1 - furnace(theta, phi)[:, 0]

    return second_reflection(without_lay(surface), n, k, missing, 1 if furnace is None else _LAY_AZIMUTHS)


def _measured(bsdf: xr.Dataset) -> SecondReflection:
    """The light that a height map reflects more than once, as it was traced."""
    values = bsdf["second_reflection"].values
    return SecondReflection.of(bsdf, values if bsdf["n"].dims else values[..., None])


def _with_further_light(single: AlbedoTable, second: SecondReflection) -> AlbedoTable:
    """A table of the albedo with the light that is reflected more than once."""
    polar, around = np.meshgrid(single.theta, np.zeros(1) if single.phi is None else single.phi, indexing="ij")
    several = second.albedo(polar.ravel(), around.ravel()).reshape(single.values.shape)
    return replace(single, values=single.values + several, second=_pieces(second, single.phi))


def _pieces(second: SecondReflection | None, phi: Array | None) -> Callable[[], PPoly] | None:
    """The part of an isotropic albedo that is not smooth: it is integrated when it is needed."""
    return None if second is None or phi is not None else lambda: second.albedo_pieces


def without_lay(surface: Microsurface) -> Microsurface:
    """The surface with its slopes averaged over azimuth, and Smith's masking."""
    if isinstance(surface.density, RadialDensity):
        return replace(surface, ratio=None)
    density = radial_average(surface.density)
    return Microsurface(density, Smith.of(xr.Dataset({"lambda_smith": smith_lambda(density)})))


def _smooth_reflectance(theta: Array, n: Array, k: Array) -> Array:
    cos = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
    return np.asarray(fresnel_reflectance(cos[:, None], n, k).mean)


def _mean_mirror_albedo(surface: Microsurface, masking: str) -> float:
    """Ē₁ to 1e-5, the mean albedo of perfect mirrors at their first reflection."""
    theta, weight = panel_rule(np.linspace(0, np.pi / 2, 3), 6)
    azimuths = hemisphere.azimuths(surface.isotropic)
    albedos = [energy.mirror_albedo(surface, masking, np.degrees(theta), azimuth) for azimuth in azimuths]
    return float((weight * np.sin(2 * theta)) @ np.mean(albedos, axis=0))


def total_reflectance_at(model: Model, theta: float) -> Array:
    """Total reflectance at an incidence [degree], mean over azimuth, (wavelength or 1,)."""
    phi = hemisphere.azimuths(model.isotropic)
    return np.asarray(model.directional_albedo(np.full(phi.size, theta), phi).mean(axis=0))


def diffuse_for(model: Model, total: Array, theta_m: float) -> Array:
    """Diffuse reflectance with which a model of ``diffuse`` 0 reflects ``total`` at an incidence; negative if that is impossible."""
    base = total - total_reflectance_at(model, theta_m)
    if model.diffuse_mode == "crf":
        return np.asarray(base)
    phi = hemisphere.azimuths(model.isotropic)
    entering = 1 - model.albedo(np.full(phi.size, theta_m), phi).mean(axis=0)
    # Below 1 by the error of the albedo's table, so that a white base does not violate energy conservation.
    return np.asarray(np.minimum(base / np.maximum(entering, 1e-12), 1 - 2e-8))


def mean_index(bsdf: xr.Dataset, weight: Array) -> tuple[float, float]:
    """n and k averaged over wavelength with weights of sum 1; of a dielectric, the n of the mean reflectance at normal incidence."""
    n, k = (np.broadcast_to(bsdf[name].values, weight.shape) for name in ("n", "k"))
    if k.any():
        return float(weight @ n), float(weight @ k)
    amplitude = np.sqrt(weight @ ((n - 1) / (n + 1)) ** 2)
    return float((1 + amplitude) / (1 - amplitude)), 0.0


def with_mean_index(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """A dataset averaged over wavelength with weights of sum 1: the mean index, and the diffuse reflectance that keeps the total."""
    mean_n, mean_k = mean_index(bsdf, weight)
    theta_m = float(bsdf["theta_m"])
    reduced = bsdf.drop_dims(["wavelength", "theta_i", "phi_i"], errors="ignore").assign(n=mean_n, k=mean_k)
    if bsdf.attrs["multiple_scattering"] == "measured" and "second_reflection" in bsdf:
        reduced = reduced.assign(
            second_reflection=bsdf["second_reflection"].dot(xr.DataArray(weight, dims="wavelength"))
        )
    reduced = with_albedo(reduced, theta_m).assign(diffuse=0.0)
    if not bsdf["diffuse"].values.any():
        return reduced
    spectrum = total_reflectance_at(Model.of(bsdf, None), theta_m)
    total = np.array([weight @ np.broadcast_to(spectrum, weight.shape)])
    diffuse = diffuse_for(Model.of(reduced, None), total, theta_m)
    return reduced.assign(diffuse=float(diffuse.clip(0.0)[0]))

"""Facets upon which finer roughness scatters, and the share of the light for which a surface is one of facets.

Of independent heights the characteristic functions multiply. The coarse relief is a surface of facets; roughness finer than a cut, of
phase variance g_f, dims their reflection by e^(−g_f) and spreads it:

    f_r = e^(−g_f) f_facets + [e^(−g_f) Q 4γ_iγ_o/q² + (1 − e^(−g_f)) F G2 q²/(4γ_iγ_o cos⁴α)] K′/λ²

f_facets is the microfacet model, with the masking and the further reflections it has. q = γ_i + γ_o, α the tilt of the facet that mirrors one direction into the other, and K′ the transform of the fine halo convolved with
the slopes of the coarse relief. Light scattered once by the fine roughness has the polarisation of waves; what it scatters more often
has that of facets.

Waves of the whole roughness pass to these facets with the phase variance. What they scatter more often than once reflects as tilted facets too
(:meth:`brdfpipe.bsdf.wave.halo.Halo.by_order`), so that both agree where the passage is.

References
----------
Holzschuch & Pacanowski 2017, ACM Trans. Graph. 36(4) 66 (two scales); Voronovich 1994, Wave Scattering from Rough Surfaces, ch. 6;
Elfouhaily & Guérin 2004, Waves Random Media 14, R1 (first order that passes to facets).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.fft import fhtoffset
from scipy.ndimage import map_coordinates

from brdfpipe.bsdf.coupled_base import ellipse_of
from brdfpipe.bsdf.microfacet import polarised
from brdfpipe.bsdf.microfacet.anisotropic_quadrature import azimuth_to_arc
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import MANY_VALUES
from brdfpipe.bsdf.representations.microfacet import OF_FACETS, Microfacet
from brdfpipe.bsdf.spectral import OnlyOnce, each_time, only_once
from brdfpipe.bsdf.wave.halo import Azimuths, Halo, amplitudes, polarisation_factor
from brdfpipe.bsdf.wave.height_transform import hankel_transform
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, half_vector
from brdfpipe.masking.modes import PHYSICAL_MASKINGS
from brdfpipe.optics.fresnel_equations import reflectance_of

if TYPE_CHECKING:
    from brdfpipe.bsdf.microfacet.evaluation_kernel import FacetTables, LayFacetTables
    from brdfpipe.bsdf.wave.halo_kernel import Body, OrderTable, Pairs, Passage

Angles = tuple[Array, Array, Array, Array]
"""θ_i, φ_i, θ_o and φ_o [degree], (directions,) each"""

Corners = tuple[NDArray[np.int64], Array]
"""Nodes of the closure about each direction, numbered by incidence and arc, and their shares of it, (directions…, corners) both"""

PASSAGE_PHASE = 600.0**0.5
"""Phase variance at which half of the light of a surface of low slopes is reflected as by facets, if its slopes are normally distributed."""

LEAST_PASSAGE_PHASE = 4.0
"""The same, at least: facets miss a share 1/g of the light at the peak, and all of the coherent light."""

PASSAGE_WIDTH = 6.0**0.5
"""Factor of the phase variance either way within which a surface passes from waves to facets."""

SLOPES, STEEP_PHASES = (0.2, 0.4), (1.0, 10.0)
"""Rms slopes at scales above the wavelength between which a surface passes from waves to facets earlier, and phase variances over which it does."""

FACETS_ALONE = 0.99
"""Share of the light reflected as by facets from which a surface counts as one of facets alone."""

_OF_HALO, _OF_CLOSURE = frozenset({"sigma", "log_halo"}), frozenset({"halo_closure", "coherent_loss"})
"""Variables of the halo alone, and of its closure."""

MANY_HALO_VALUES = 2**13
"""Values of a call from which on they are computed by compiled code: loading it takes as long as a dozen such calls save, and whoever asks for
so many values seldom makes one call."""
_BLOCK = 2**15
"""Values that are computed together, so that their arrays stay in the processor's cache."""
_NODES, _DECADES = 8192, 20
_ARCS_AROUND = 8
"""Arcs of the closure that are repeated on either side of half a turn, for a cubic spline."""


def facet_share(phase_variance: Array, slope: float, passage: float = PASSAGE_PHASE) -> Array:
    """Share of the light [1] for which the surface is one of facets.

    Parameters
    ----------
    phase_variance : g of the facets' relief [1]
    slope : rms slope at scales above the wavelength [1]
    passage : phase variance at which half of the light is
    """
    by_phase = rising_step(phase_variance, (passage / PASSAGE_WIDTH, passage * PASSAGE_WIDTH))
    if slope <= SLOPES[0]:
        return np.asarray(1 - (1 - by_phase))
    by_slope = rising_step(np.array(slope), SLOPES) * rising_step(phase_variance, STEEP_PHASES)
    return np.asarray(1 - (1 - by_phase) * (1 - by_slope))


def passage_phase(normality: float) -> float:
    """Phase variance at which a surface passes from waves to facets.

    Facets miss a share 1/g of the light at the peak; waves take slopes as normally distributed, and miss what these are not.

    Parameters
    ----------
    normality : density of the small slopes over that of normally distributed ones of the roughness spectrum [1]
    """
    return float(np.clip(1 / max(abs(normality - 1), 1e-12), LEAST_PASSAGE_PHASE, PASSAGE_PHASE))


def facet_share_at(sigma: float, slope: float, passage: float, cosines: Array, wavelength: Array) -> Array:
    """The same, (…, wavelength), for relief of an rms height [um] and slope, of γ_i + γ_o (…) at wavelengths [nm]."""
    return facet_share((2e3 * np.pi * sigma * cosines[..., None] / wavelength) ** 2, slope, passage)


def rising_step(value: Array, limits: tuple[float, float]) -> Array:
    """A smooth step from 0 to 1 in the logarithm, between two limits."""
    with np.errstate(divide="ignore"):
        x = np.minimum(np.maximum(np.log(value / limits[0]) / np.log(limits[1] / limits[0]), 0.0), 1.0)
    return np.asarray(x * x * (3 - 2 * x))


def characteristic_function(density: RadialDensity) -> Callable[[Array], Array]:
    """⟨exp(i t·p)⟩ of isotropic slopes, as a function of |t| [1]."""
    step = _DECADES * np.log(10) / _NODES
    offset = fhtoffset(step, mu=0.0, bias=0.0)
    index = np.arange(_NODES) - (_NODES - 1) / 2
    slope = density.median_slope * np.exp(index * step)
    values = density(slope**2)
    t = np.exp(index * step + offset) / density.median_slope
    transformed = 2 * np.pi * hankel_transform(values * slope, step, offset) / t
    log_t, limited = np.log(t), np.clip(transformed / density.mass, -1.0, 1.0)
    return lambda at: np.interp(np.log(np.maximum(at, 1e-300)), log_t, limited, left=1.0, right=0.0)


def facet_bsdf(bsdf: xr.Dataset) -> xr.Dataset:
    """The BSDF of the facets that a ``bsdf`` dataset of representation ``wave`` holds, without a diffuse part."""
    names = [name for name in (*Microfacet.kind.required, *Microfacet.kind.optional) if name in bsdf]
    facets = bsdf[names].drop_vars("diffuse", errors="ignore")
    if "mixture" in bsdf:
        facets = facets.rename(mixed="wavelength").assign_coords(wavelength=bsdf["mixed_wavelength"].values)
    if "directional_albedo" not in facets:
        # Facets without a base need none of its values.
        around = {name: bsdf[name].values for name in ("theta_i", "phi_i") if name in bsdf.coords}
        nothing = tuple(around), np.zeros([values.size for values in around.values()])
        facets = facets.assign_coords(around).assign(directional_albedo=nothing, mean_albedo=0.0)
    attributes = {name: bsdf.attrs[name] for name in ("masking", "multiple_scattering", "transmission")}
    facets.attrs = {"representation": Microfacet.name, "diffuse_mode": "none", **attributes}
    return facets


def _with_values(dataset: xr.Dataset, other: xr.Dataset, names: Collection[str]) -> xr.Dataset:
    """A dataset with the values that some of its variables have in another one, of the same dimensions."""
    return dataset.copy(
        data={name: (other if name in names else dataset).variables[name].data for name in dataset.data_vars}
    )


@dataclass(frozen=True)
class Relief:
    """Facets, perhaps with finer roughness upon them, prepared for evaluation."""

    facets: Microfacet
    fine: Halo | None
    """Of the roughness upon the facets: ``spline`` holds ln(K′/g); None without any"""
    masking: str

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> Relief:
        """The relief of a ``bsdf`` dataset, representation ``wave``, with facets."""
        return cls(Microfacet(facet_bsdf(bsdf)), _fine_halo(bsdf), str(bsdf.attrs["masking"]))

    @property
    def surface(self) -> Microsurface:
        assert self.facets.surface is not None
        return self.facets.surface

    def compiled_facets(self, pair: HalfVector, angles: Angles) -> tuple[Array, Array]:
        """(1 + s²)² G2 / (4 cos θ_i cos θ_o) and P22 of the facets of pairs, (directions,) each, by compiled code where it covers their masking."""
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        if self._facet_tables is not None:
            return evaluation_kernel.facets(self._facet_tables, angles)
        azimuths, spread = (angles[1], angles[3]), 1 + pair.slope_squared
        visible = spread * spread * self.surface.visibility(pair, *azimuths, self.masking) / 4
        return np.asarray(visible), self.surface.p22(pair, *azimuths)

    @cached_property
    def _facet_tables(self) -> FacetTables | LayFacetTables | None:
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        if self.masking not in PHYSICAL_MASKINGS:
            return None
        tables = evaluation_kernel.FacetTables if self.surface.isotropic else evaluation_kernel.LayFacetTables
        return tables.of(self.surface, self.masking)

    def undimmed(self, cosines: Array, wavelength: Array) -> Array:
        """Share e^(−g_f) of the facets' reflection that the finer roughness leaves, (…, wavelength)."""
        if self.fine is None:
            return np.ones((*cosines.shape, wavelength.size))
        return np.exp(-self.fine.phase_variance(cosines, wavelength))


def tilted_share(pair: HalfVector, visible: Array) -> Array:
    """The same of facets of a known visibility G2/(γ_iγ_o), (directions,)."""
    share: Array = ((1 + pair.slope_squared) * (pair.cos_i + pair.cos_o)) ** 2 * visible / 4
    return share


def mirror_lobe(surface: Microsurface, fine: Halo, angles: Angles, wavelength: float) -> Array:
    """BRDF [sr-1], (directions,), of perfectly mirroring facets with finer roughness, of one reflection, at a wavelength [nm]."""
    pair, azimuths, nm = half_vector(*angles), (angles[1], angles[3]), np.array([wavelength])
    cosines = pair.cos_i + pair.cos_o
    undimmed = np.exp(-fine.phase_variance(cosines, nm))[:, 0]
    once, transform = (part[:, 0] for part in fine.strength_and_transform(pair, azimuths, nm))
    tilted = (1 + pair.slope_squared) ** 2 * surface.visibility(pair, *azimuths, "height-correlated") / 4
    spread = (1 - undimmed) * tilted * cosines**2 * transform
    return np.asarray(undimmed * (surface.reflected(pair, *azimuths, "height-correlated") + once) + spread)


def _fine_halo(bsdf: xr.Dataset) -> Halo | None:
    if "log_fine_halo" not in bsdf:
        return None
    names = ("log_fine_halo", "fine_phase_variance", "fine_frequency", "fine_scale", "fine_sigma")
    values, phase, frequency, scale, sigma = (bsdf.variables[name].values for name in names)
    return Halo.of_table(values, phase, frequency, scale, sigma, form="ssa1")


class EnergyClosure(NamedTuple):
    """What makes the coherent light and the halo of a perfect mirror all light; incidences are :func:`closure_nodes`."""

    factor: Array
    """Of either direction of the halo [1], (incidences, wavelengths), or (incidences, arcs, wavelengths) with a lay"""
    loss: Array
    """−λ² ln(coherent share)/cos θ [um2], of the same; the arcs are continued around half a turn by :data:`_ARCS_AROUND`"""
    wavelength: Array
    """[nm]"""
    ellipse: Ellipse | None = None
    """Of a lay: its arcs are :func:`closure_arcs`"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> EnergyClosure:
        """Of a ``bsdf`` dataset, representation ``wave``."""
        factor, loss, wavelength = (
            bsdf[name].values for name in ("halo_closure", "coherent_loss", "closure_wavelength")
        )
        if factor.ndim == 2:
            return cls(factor, loss, wavelength)
        around = ((0, 0), (_ARCS_AROUND, _ARCS_AROUND), (0, 0))
        return cls(factor, np.pad(loss, around, "wrap"), wavelength, ellipse_of(bsdf))

    def of_halo(self, cosine: Array, azimuth: Array, wavelength: Array) -> Array:
        """The factor [1], (directions…, wavelength), of cosines and azimuths [degree] (directions…) at wavelengths [nm]."""
        factor, (node, share) = self.factor_at(wavelength), self.corners(cosine, azimuth)
        return sum(
            (factor[node[..., corner]] * share[..., corner, None] for corner in range(node.shape[-1])), np.zeros(1)
        )

    def factor_at(self, wavelength: Array) -> Array:
        """The factor [1] at the nodes, numbered by incidence and arc, (nodes, wavelength), between its wavelengths linear."""
        column = np.interp(wavelength, self.wavelength, np.arange(self.wavelength.size))
        before = np.minimum(column.astype(int), max(self.wavelength.size - 2, 0))
        part, after = column - before, np.minimum(before + 1, self.wavelength.size - 1)
        factor = self.factor.reshape(-1, self.wavelength.size)
        return np.ascontiguousarray(factor[:, before] * (1 - part) + factor[:, after] * part)

    def corners(self, cosine: Array, azimuth: Array, *, compiled: bool = False) -> Corners:
        """The nodes about directions of cosines and azimuths [degree]."""
        arcs = 1 if self.ellipse is None else self.factor.shape[1]
        return closure_corners(cosine, azimuth, self.factor.shape[0], arcs, self.ellipse, compiled=compiled)

    def coherent_share(self, cosine: Array, azimuth: Array, wavelength: Array) -> Array:
        """Share of the mirror reflection that is coherent [1], of the same."""
        place = np.empty((self.loss.ndim, *cosine.shape, wavelength.size))
        place[0] = closure_place(cosine, self.loss.shape[0])[..., None]
        if self.ellipse is not None:
            count = self.loss.shape[1] - 2 * _ARCS_AROUND
            place[1] = _ARCS_AROUND + closure_arc_place(self.ellipse, azimuth, count)[..., None]
        place[-1] = np.interp(wavelength, self.wavelength, np.arange(self.wavelength.size))
        loss = map_coordinates(self.loss, place, order=3, mode="nearest")
        return np.exp(-loss * cosine[..., None] / (wavelength * 1e-3) ** 2)


def closure_nodes(count: int) -> Array:
    """Angles of incidence [degree] from 0 to 90, evenly spaced in √cos θ: dense towards grazing, where light passes from scattered to coherent."""
    return np.asarray(np.degrees(np.arccos(np.linspace(1.0, 0.0, count) ** 2)))


def closure_place(cosine: Array, count: int) -> Array:
    """Place [1] of cosines of incidence among the numbers of as many nodes."""
    return np.asarray((1 - np.sqrt(np.minimum(np.maximum(cosine, 0.0), 1.0))) * (count - 1))


def closure_arcs(count: int) -> Array:
    """Arcs [degree] of half a turn, in the sense of :func:`brdfpipe.bsdf.microfacet.anisotropic_quadrature.azimuth_to_arc`.

    The halo is the same after the other half.
    """
    return np.arange(count) * 180.0 / count


def closure_corners(
    cosine: Array, azimuth: Array, incidences: int, arcs: int, ellipse: Ellipse | None, *, compiled: bool = False
) -> Corners:
    """The nodes of a closure of so many incidences and arcs about directions of cosines and azimuths [degree] (directions…).

    ``ellipse`` is that of the lay; without one there is one arc. ``compiled``: by compiled code, of (directions,).
    """
    place = np.minimum(closure_place(cosine, incidences), incidences - 1)
    row = np.minimum(place.astype(int), incidences - 2)
    node, share = np.stack([row, row + 1], axis=-1), np.stack([1 - place + row, place - row], axis=-1)
    if ellipse is None:
        return node, share
    around = closure_arc_place(ellipse, azimuth, arcs, compiled=compiled)
    before = np.floor(around).astype(int)
    column = np.stack([before % arcs, (before + 1) % arcs], axis=-1)
    part = np.stack([1 - around + before, around - before], axis=-1)
    four = (*place.shape, 4)
    return (node[..., None] * arcs + column[..., None, :]).reshape(four), (
        share[..., None] * part[..., None, :]
    ).reshape(four)


def closure_arc_place(ellipse: Ellipse, azimuth: Array, count: int, *, compiled: bool = False) -> Array:
    """Place [1], from 0 to ``count``, of azimuths [degree] among the numbers of as many arcs; ``compiled``: of (directions,)."""
    if compiled:
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        arc = evaluation_kernel.arcs(ellipse, azimuth)
    else:
        arc = azimuth_to_arc(ellipse, azimuth)
    return np.asarray(arc % 180 * (count / 180))


@dataclass(frozen=True)
class RoughSurface:
    """A surface that reflects as waves, as facets with finer roughness, or as both in turn."""

    halo: Halo | None
    """None for facets alone"""
    relief: Relief | None
    """None for waves alone"""
    facet_sigma: float
    """Rms height of the relief that is one of facets [um]"""
    slope: float
    """Its rms slope at scales above the wavelength [1]"""
    passage: float = PASSAGE_PHASE
    """Phase variance at which half of the light is reflected as by facets [1]"""
    closure: EnergyClosure | None = None
    """Of the halo; None for 1"""
    compiled: bool = False
    """Whether few values, too, are computed by compiled code"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> RoughSurface:
        """The surface of a ``bsdf`` dataset, representation ``wave``."""
        # Higher orders need the masking of facets.
        by_order = "slope_density" in bsdf and bsdf.attrs["form"] != "rayleigh-rice"
        halo = Halo.of(bsdf, by_order=by_order) if "log_halo" in bsdf else None
        if "slope_density" not in bsdf:
            return cls(halo, None, 0.0, 0.0)
        sigma, slope, passage = (float(bsdf[name]) for name in ("facet_sigma", "resolved_slope", "passage_phase"))
        closure = EnergyClosure.of(bsdf) if "halo_closure" in bsdf else None
        return cls(halo, Relief.of(bsdf), sigma, slope, passage, closure)

    def facet_share(self, cosines: Array, wavelength: Array) -> Array:
        """Share of the light [1], (…, wavelength), that is reflected as by facets, of γ_i + γ_o (…) at wavelengths [nm]."""
        if self.relief is None or self.halo is None:
            return np.full((*np.shape(cosines), wavelength.size), float(self.halo is None))
        return facet_share_at(self.facet_sigma, self.slope, self.passage, cosines, wavelength)

    @cached_property
    def passage_of_pairs(self) -> Passage:
        """What compiled code computes :meth:`facet_share` from, of a surface of waves and facets."""
        from brdfpipe.bsdf.wave.halo_kernel import Passage

        steep = float(rising_step(np.array(self.slope), SLOPES)) if self.slope > SLOPES[0] else 0.0
        phases = self.passage / PASSAGE_WIDTH, self.passage * PASSAGE_WIDTH
        return Passage(self.facet_sigma, phases, steep, STEEP_PHASES)

    def coherent_share(self, theta_i: Array, phi_i: Array, wavelength: Array) -> Array:
        """Share of Fresnel's reflectance that is reflected coherently, (incidences…, wavelength), of θ_i and φ_i [degree]."""
        theta_i, phi_i = np.broadcast_arrays(theta_i, phi_i)
        cosine = np.cos(np.radians(theta_i))
        waves = 1 - self.facet_share(2 * cosine, wavelength)
        if self.closure is not None:
            return waves * self.closure.coherent_share(np.maximum(cosine, 0.0), phi_i, wavelength)
        return waves * self.halo.coherent_share(theta_i, wavelength) if self.halo is not None else waves

    def evaluate(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """BRDF without diffuse light [sr-1], (directions, wavelength); 0 unless both directions are above the surface.

        Angles are θ_i, φ_i, θ_o and φ_o, (directions,) degree; wavelength [nm], n and k are (wavelength,).
        """
        compiled = self.compiled or angles[0].size * wavelength.size >= MANY_HALO_VALUES
        if compiled and self._is_compiled:
            return self._compiled_light(angles, wavelength, n, k)
        surface = self._with_compiled_halos if compiled else self

        def of_block(pair: HalfVector, block: Angles) -> Array:
            return surface.of_pairs(block, wavelength, n, k, pair=pair, compiled=compiled)

        return _in_blocks(angles, (wavelength.size,), of_block, compiled)

    @property
    def _is_compiled(self) -> bool:
        """Whether one compiled pass evaluates the surface: of facets, perhaps with waves of all orders."""
        return self.relief is not None and (self.halo is None or self.halo.first_order is not None)

    def _compiled_light(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """:meth:`evaluate` in one compiled pass."""
        from brdfpipe.bsdf.wave import halo_kernel

        factor = None if self.closure is None else self.closure.factor_at(wavelength)

        def of_block(pair: HalfVector, block: Angles) -> Array:
            closure = None
            if self.closure is not None and factor is not None:
                around = ((pair.cos_i, block[1]), (pair.cos_o, block[3]))
                corners = tuple(self.closure.corners(*of_one, compiled=True) for of_one in around)
                closure = halo_kernel.Closure(factor, corners)
            return halo_kernel.surface_light(
                self.compiled_pairs(pair, block),
                *self.order_tables,
                wavelength,
                self.compiled_body(pair, block, wavelength, n, k),
                closure,
                generalised=self.halo is not None and self.halo.form == "ghs",
            )

        return _in_blocks(angles, (wavelength.size,), of_block, compiled=True)

    def compiled_pairs(self, pair: HalfVector, angles: Angles) -> Pairs:
        """Pairs of directions of a surface with facets for compiled code."""
        from brdfpipe.bsdf.wave.halo_kernel import Pairs

        facet_slope, cosines = np.sqrt(pair.slope_squared), pair.cos_i + pair.cos_o
        assert self.relief is not None
        visible, density = self.relief.compiled_facets(pair, angles)
        slope, column = facet_slope, np.empty(0)
        if self.halo is not None:
            slope, column = self.halo.slope_and_azimuth(pair, (angles[1], angles[3]))
        return Pairs(
            slope,
            facet_slope,
            column if column.size else np.zeros_like(slope),
            cosines,
            pair.cos_i * pair.cos_o,
            visible * cosines**2,
            density * visible,
        )

    def compiled_body(self, pair: HalfVector, angles: Angles, wavelength: Array, n: Array, k: Array) -> Body:
        """What a body with this surface does to the light of pairs, for compiled code."""
        from brdfpipe.bsdf.microfacet import evaluation_kernel
        from brdfpipe.bsdf.wave import halo_kernel

        relief, cosines, further = self.relief, pair.cos_i + pair.cos_o, None
        assert relief is not None
        if self.halo is None:
            share = self.facet_share(cosines, wavelength)
        else:
            share = halo_kernel.facet_share(self.passage_of_pairs, cosines, wavelength)
        if share.any():
            further = relief.facets.further_light(*angles, wavelength)
        has_waves = relief.fine is not None or bool((share < 1).any())
        return halo_kernel.Body(
            share,
            halo_kernel.polarisation_factor(pair, angles[3] - angles[1], n, k) if has_waves else np.empty((0, 0)),
            evaluation_kernel.reflectances(pair.cos_zeta, n, k),
            np.empty((0, 0)) if further is None else np.array(np.broadcast_to(further, share.shape)),
        )

    @cached_property
    def order_tables(self) -> tuple[OrderTable, OrderTable]:
        """Tables of the halo and of the roughness upon the facets, as compiled code reads them."""
        from brdfpipe.bsdf.wave.halo_kernel import NO_TABLE

        fine = None if self.relief is None else self.relief.fine
        halo, upon = (NO_TABLE if one is None else one.by_order_table for one in (self.halo, fine))
        return halo, upon

    @staticmethod
    def evaluate_each(
        surfaces: Sequence[RoughSurface], angles: Angles, wavelength: Array, n: Array, k: Array
    ) -> list[Array]:
        """:meth:`evaluate` of several surfaces of one body, which compute once what they share."""
        count = len(surfaces) * angles[0].size * wavelength.size
        compiled = count >= MANY_HALO_VALUES
        used = [surface._with_compiled_halos if compiled else surface for surface in surfaces]
        reflectance = reflectance_of(n, k)

        def of_block(pair: HalfVector, block: Angles) -> Array:
            shared: dict[str, Any] = {
                "pair": pair,
                "compiled": compiled,
                "reflectance": reflectance,
                "once": only_once(),
            }
            return np.stack([surface.of_pairs(block, wavelength, n, k, **shared) for surface in used], axis=-1)

        values = _in_blocks(angles, (wavelength.size, len(used)), of_block, compiled, block=_BLOCK * len(used))
        return list(np.moveaxis(values, -1, 0))

    def of_pairs(
        self,
        angles: Angles,
        wavelength: Array,
        n: Array,
        k: Array,
        *,
        pair: HalfVector | None = None,
        compiled: bool = False,
        reflectance: Callable[[Array], Array] | None = None,
        once: OnlyOnce = each_time,
    ) -> Array:
        """The same of directions above the surface, together, (directions…, wavelength).

        Parameters
        ----------
        angles : (directions,) each, or numbers, which take a fraction of the time of arrays
        pair : of these directions, if it is known
        compiled : whether the polarisation factor is computed by compiled code
        reflectance : Fresnel's reflectance of n and k as a function of cosines, (…, 1), if it is known
        once : for several surfaces of one body in the same directions
        """
        pair, azimuths = half_vector(*angles) if pair is None else pair, (angles[1], angles[3])
        relief, visible = self.relief, np.empty(0)
        if relief is not None:
            surface, masking = relief.surface, relief.masking
            visible = once(("visible", id(surface)), lambda: surface.visibility(pair, *azimuths, masking))
        parts = self._parts(pair, azimuths, wavelength, visible, once)
        values = np.zeros((*np.shape(angles[0]), wavelength.size))
        if parts.facets is not None:
            assert relief is not None
            values += parts.facets * relief.facets.reflected_by(pair, visible, *angles, wavelength, once)
        if parts.spread is not None:
            of_facet = reflectance or reflectance_of(n, k)
            values += parts.spread * once(("reflectance",), lambda: of_facet(pair.cos_zeta[..., None]))
        if parts.waves is not None:
            turned = angles[3] - angles[1]
            values += parts.waves * once(("polarisation",), lambda: polarisation_factor(pair, turned, n, k, compiled))
        return values

    def mueller(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """Mueller matrices of the same [sr-1], (directions, wavelength, 4, 4), in the frames of the microfacet model."""

        def of_block(pair: HalfVector, block: Angles) -> Array:
            azimuths, relief = (block[1], block[3]), self.relief
            visible = np.empty(0) if relief is None else relief.surface.visibility(pair, *azimuths, relief.masking)
            parts = self._parts(pair, azimuths, wavelength, visible)
            values = np.zeros((block[0].size, wavelength.size, 4, 4))
            if parts.facets is not None:
                assert relief is not None
                values += parts.facets[..., None, None] * relief.facets.mueller(*block, wavelength)
            if parts.spread is not None:
                values += parts.spread[..., None, None] * polarised.mueller(np.ones(block[0].size), *block, n, k)
            if parts.waves is not None:
                values += parts.waves[..., None, None] * amplitudes(pair, block[3] - block[1], n, k).mueller()
            return values

        return _in_blocks(angles, (wavelength.size, 4, 4), of_block)

    def prepared_for(self, values: int) -> RoughSurface:
        """The same surface, computed by compiled code if a number of values, in several calls, is worth loading it."""
        return replace(self, compiled=self.compiled or values >= MANY_VALUES)

    @cached_property
    def _with_compiled_halos(self) -> RoughSurface:
        """The same surface, with halos that are looked up by compiled code."""
        relief, halo = self.relief, self.halo
        if relief is not None and relief.fine is not None:
            relief = replace(relief, fine=relief.fine.by_compiled_code)
        return replace(self, halo=None if halo is None else halo.by_compiled_code, relief=relief)

    def with_changed(self, bsdf: xr.Dataset, names: Collection[str]) -> RoughSurface:
        """The surface of a ``bsdf`` dataset that differs from that of this one in some variables; what does not follow from these is shared."""
        if not set(names) <= OF_FACETS | _OF_HALO | _OF_CLOSURE or self.relief is None or self.halo is None:
            return RoughSurface.of(bsdf)
        halo, relief, closure = self.halo, self.relief, self.closure
        if _OF_HALO & set(names):
            halo = Halo.of(bsdf, by_order=bsdf.attrs["form"] != "rayleigh-rice")
        if OF_FACETS & set(names):
            relief = replace(
                relief, facets=relief.facets.with_changed(_with_values(relief.facets.dataset, bsdf, names), names)
            )
        if closure is not None and _OF_CLOSURE & set(names):
            closure = EnergyClosure.of(bsdf)
        return replace(self, halo=halo, relief=relief, closure=closure)

    def _parts(
        self,
        pair: HalfVector,
        azimuths: Azimuths,
        wavelength: Array,
        visible: Array,
        once: OnlyOnce = each_time,
    ) -> _Parts:
        """Of pairs of directions; ``visible`` is the visibility of their facets, if there are any."""
        cosines, relief = pair.cos_i + pair.cos_o, self.relief
        if relief is None:
            assert self.halo is not None
            return _Parts(None, None, self.halo.strength(pair, azimuths, wavelength))
        passage = self.halo is None, self.facet_sigma, self.slope, self.passage
        share = once(("share", *passage), lambda: self.facet_share(cosines, wavelength))
        tilted = once(("tilted", id(visible)), lambda: tilted_share(pair, visible))
        facets, spread, waves = None, np.zeros(share.shape), np.zeros(share.shape)
        if self.halo is not None and not (share == 1).all():
            low, high = self.halo.by_order(pair, azimuths, wavelength, tilted, once)
            of_waves = 1 - share
            if self.closure is not None:
                closure, both = self.closure, np.array([pair.cos_i, pair.cos_o])
                of_i, of_o = once(
                    ("closure", id(closure)), lambda: closure.of_halo(both, np.array(azimuths), wavelength)
                )
                of_waves = of_waves * of_i * of_o
            waves, spread = of_waves * low, of_waves * high
        if share.any():
            undimmed = relief.undimmed(cosines, wavelength)
            facets = share * undimmed
            if relief.fine is not None:
                fine = relief.fine
                of_fine, transform = once(
                    ("fine", id(fine)), lambda: fine.strength_and_transform(pair, azimuths, wavelength)
                )
                waves, spread = (
                    waves + facets * of_fine,
                    spread + share * (1 - undimmed) * tilted[..., None] * transform,
                )
        return _Parts(facets, spread, waves)


class _Parts(NamedTuple):
    """Factors of the parts of a BRDF, (directions, wavelength) each; None where there is no such light."""

    facets: Array | None
    """Of the facets' BRDF [1]"""
    spread: Array | None
    """Of Fresnel's reflectance by the facet that mirrors one direction into the other [sr-1]"""
    waves: Array | None
    """Of the polarisation factor of waves [sr-1]"""


def _in_blocks(
    angles: Angles,
    shape: tuple[int, ...],
    of_block: Callable[[HalfVector, Angles], Array],
    compiled: bool = False,
    block: int = _BLOCK,
) -> Array:
    """Values of pairs of directions above the surface, in blocks that fit the processor's cache; 0 for others.

    ``of_block`` is given the pairs of a block and their angles. ``compiled`` is whether the pairs are computed by compiled code.
    """
    theta_i, _, theta_o, _ = angles
    above = (theta_i < 90) & (theta_o < 90)
    everywhere = bool(above.all())
    selected = angles if everywhere else tuple(angle[above] for angle in angles)
    values = np.empty((selected[0].size, *shape))
    step = max(block // int(np.prod(shape)), 64)
    pairs: Callable[..., HalfVector] = half_vector
    if compiled:
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        pairs = evaluation_kernel.half_vectors
    for start in range(0, len(values), step):
        one, two, three, four = (angle[start : start + step] for angle in selected)
        values[start : start + step] = of_block(pairs(one, two, three, four), (one, two, three, four))
    if everywhere:
        return values
    result = np.zeros((theta_i.size, *shape))
    result[above] = values
    return result

"""Facets upon which finer roughness scatters, and the share of the light for which a surface is one of facets.

Of independent heights the characteristic functions multiply. The coarse relief is a surface of facets; roughness finer than a cut, of
phase variance g_f, dims their reflection by e^(−g_f) and spreads it:

    f_r = e^(−g_f) f_facets + [e^(−g_f) Q 4γ_iγ_o/q² + (1 − e^(−g_f)) F G2 q²/(4γ_iγ_o cos⁴α)] K′/λ²

f_facets is the microfacet model, with the masking and the further reflections it has. q = γ_i + γ_o, α the tilt of the facet that mirrors one direction into the other, and K′ the transform of the fine halo convolved with
the slopes of the coarse relief. Light scattered once by the fine roughness has the polarisation of waves; what it scatters more often
has that of facets.

References
----------
Holzschuch & Pacanowski 2017, ACM Trans. Graph. 36(4) 66 (two scales); Voronovich 1994, Wave Scattering from Rough Surfaces, ch. 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.fft import fht, fhtoffset

from brdfpipe.bsdf.microfacet import polarised
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.model import MANY_VALUES
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.wave.halo import Azimuths, Halo, amplitudes, polarisation_factor
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, half_vector
from brdfpipe.optics.fresnel_equations import fresnel

Angles = tuple[Array, Array, Array, Array]
"""θ_i, φ_i, θ_o and φ_o [degree], (directions,) each"""

PHASES = (10.0, 60.0)
"""Phase variances between which a surface of low slopes passes from waves to facets."""

SLOPES = (0.2, 0.4)
"""Rms slopes at scales above the wavelength between which a surface passes from waves to facets at any phase variance."""

MASKED_SLOPES, MASKED_PHASES = (1.0, 2.0), (1.0, 10.0)
"""The same of slopes over the mean cosine of both directions, near grazing, where waves lack masking; and phase variances from which it acts."""

FACETS_ALONE = 0.99
"""Share of the light reflected as by facets from which a surface counts as one of facets alone."""

_BLOCK = 2**15
"""Values that are computed together, so that their arrays stay in the processor's cache."""
_NODES, _DECADES = 8192, 20


def facet_share(phase_variance: Array, cosine: Array, slope: float) -> Array:
    """Share of the light [1] for which the surface is one of facets.

    Parameters
    ----------
    phase_variance : g of the facets' relief [1]
    cosine : mean of cos θ_i and cos θ_o, broadcastable to it
    slope : rms slope at scales above the wavelength [1]
    """
    slope = max(slope, 1e-300)
    by_masking = _step(slope / np.maximum(cosine, 1e-300), MASKED_SLOPES) * _step(phase_variance, MASKED_PHASES)
    by_slope = _step(np.array(slope), SLOPES)
    return np.asarray(1 - (1 - _step(phase_variance, PHASES)) * (1 - by_slope) * (1 - by_masking))


def facet_share_at(sigma: float, slope: float, cosines: Array, wavelength: Array) -> Array:
    """The same, (…, wavelength), for relief of an rms height [um] and slope, of γ_i + γ_o (…) at wavelengths [nm]."""
    phase = (2e3 * np.pi * sigma * cosines[..., None] / wavelength) ** 2
    return facet_share(phase, cosines[..., None] / 2, slope)


def _step(value: Array, limits: tuple[float, float]) -> Array:
    """A smooth step from 0 to 1 in the logarithm."""
    with np.errstate(divide="ignore"):
        x = np.clip(np.log(value / limits[0]) / np.log(limits[1] / limits[0]), 0.0, 1.0)
    return np.asarray(x * x * (3 - 2 * x))


def characteristic_function(density: RadialDensity) -> Callable[[Array], Array]:
    """⟨exp(i t·p)⟩ of isotropic slopes, as a function of |t| [1]."""
    step = _DECADES * np.log(10) / _NODES
    offset = fhtoffset(step, mu=0.0, bias=0.0)
    index = np.arange(_NODES) - (_NODES - 1) / 2
    slope = density.median_slope * np.exp(index * step)
    values = density(slope**2)
    t = np.exp(index * step + offset) / density.median_slope
    transformed = 2 * np.pi * np.asarray(fht(values * slope, step, 0.0, offset=offset)) / t
    log_t, limited = np.log(t), np.clip(transformed / density.mass, -1.0, 1.0)
    return lambda at: np.interp(np.log(np.maximum(at, 1e-300)), log_t, limited, left=1.0, right=0.0)


def facet_bsdf(bsdf: xr.Dataset) -> xr.Dataset:
    """The BSDF of the facets that a ``bsdf`` dataset of representation ``wave`` holds, without a diffuse part."""
    names = [name for name in (*Microfacet.kind.required, *Microfacet.kind.optional) if name in bsdf]
    facets = bsdf[names]
    if "mixture" in bsdf:
        facets = facets.rename(mixed="wavelength").assign_coords(wavelength=bsdf["mixed_wavelength"].values)
    attributes = {name: bsdf.attrs[name] for name in ("masking", "multiple_scattering", "transmission")}
    facets.attrs = {"representation": Microfacet.name, "diffuse_mode": "none", **attributes}
    return facets.assign(diffuse=0.0)


@dataclass(frozen=True)
class Relief:
    """Facets, perhaps with finer roughness upon them, prepared for evaluation."""

    facets: Microfacet
    fine: Halo | None
    """Of the roughness upon the facets: ``spline`` holds ln(K′/g); None without any"""
    surface: Microsurface
    masking: str

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> Relief:
        """The relief of a ``bsdf`` dataset, representation ``wave``, with facets."""
        return cls(Microfacet(facet_bsdf(bsdf)), _fine_halo(bsdf), Microsurface.of(bsdf), str(bsdf.attrs["masking"]))

    def undimmed(self, cosines: Array, wavelength: Array) -> Array:
        """Share e^(−g_f) of the facets' reflection that the finer roughness leaves, (…, wavelength)."""
        if self.fine is None:
            return np.ones((*cosines.shape, wavelength.size))
        return np.exp(-self.fine.phase_variance(cosines, wavelength))

    def spread(self, pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> tuple[Array, Array] | None:
        """What the finer roughness spreads: BRDF over the reflectance of facets, and over the polarisation factor of waves.

        (directions, wavelength) each [sr-1]; None without finer roughness.
        """
        if self.fine is None:
            return None
        cosines = pair.cos_i + pair.cos_o
        undimmed = np.exp(-self.fine.phase_variance(cosines, wavelength))
        tilted = (1 + pair.slope_squared) ** 2 * self.surface.visibility(pair, *azimuths, self.masking) / 4
        once, transform = self.fine.strength_and_transform(pair, azimuths, wavelength)
        # q²K′/λ² is the slope density of the light that the fine roughness spreads.
        return (1 - undimmed) * (tilted * cosines**2)[:, None] * transform, undimmed * once


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
    names = {"log_fine_halo": "log_halo", "fine_phase_variance": "phase_variance", "fine_frequency": "halo_frequency"}
    fine = bsdf[["log_fine_halo"]].rename(names).assign(frequency_scale=bsdf["fine_scale"], sigma=bsdf["fine_sigma"])
    fine.attrs = {"form": "ssa1", "spectrum": "measured"}
    return Halo.of(fine)


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

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> RoughSurface:
        """The surface of a ``bsdf`` dataset, representation ``wave``."""
        halo = Halo.of(bsdf) if "log_halo" in bsdf else None
        if "slope_density" not in bsdf:
            return cls(halo, None, 0.0, 0.0)
        return cls(halo, Relief.of(bsdf), float(bsdf["facet_sigma"]), float(bsdf["resolved_slope"]))

    def facet_share(self, cosines: Array, wavelength: Array) -> Array:
        """Share of the light [1], (…, wavelength), that is reflected as by facets, of γ_i + γ_o (…) at wavelengths [nm]."""
        if self.relief is None or self.halo is None:
            return np.full((*np.shape(cosines), wavelength.size), float(self.halo is None))
        return facet_share_at(self.facet_sigma, self.slope, cosines, wavelength)

    def coherent_share(self, theta_i: Array, wavelength: Array) -> Array:
        """Share of Fresnel's reflectance that is reflected coherently, (incidences…, wavelength)."""
        share = self.facet_share(2 * np.cos(np.radians(theta_i)), wavelength)
        return (1 - share) * self.halo.coherent_share(theta_i, wavelength) if self.halo is not None else 1 - share

    def evaluate(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """BRDF without diffuse light [sr-1], (directions, wavelength); 0 unless both directions are above the surface.

        Angles are θ_i, φ_i, θ_o and φ_o, (directions,) degree; wavelength [nm], n and k are (wavelength,).
        """
        many = angles[0].size * wavelength.size >= MANY_VALUES
        surface = self._compiled if many else self
        of_all_facets = cache(lambda: surface.of_facets(angles, wavelength))

        def of_block(pair: HalfVector, block: Angles, at: NDArray[np.int64]) -> Array:
            parts, values = (
                surface._parts(pair, (block[1], block[3]), wavelength),
                np.zeros((block[0].size, wavelength.size)),
            )
            if parts.facets is not None:
                # The compiled kernel of the facets needs many directions at once.
                values += parts.facets * (of_all_facets()[at] if many else surface.of_facets(block, wavelength))
            if parts.spread is not None:
                values += parts.spread * fresnel(pair.cos_zeta[:, None], n, k).mean
            if parts.waves is not None:
                values += parts.waves * polarisation_factor(pair, block[3] - block[1], n, k, many)
            return values

        return _in_blocks(angles, (wavelength.size,), of_block, many)

    def mueller(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """Mueller matrices of the same [sr-1], (directions, wavelength, 4, 4), in the frames of the microfacet model."""

        def of_block(pair: HalfVector, block: Angles, at: NDArray[np.int64]) -> Array:
            parts = self._parts(pair, (block[1], block[3]), wavelength)
            values = np.zeros((block[0].size, wavelength.size, 4, 4))
            if parts.facets is not None:
                assert self.relief is not None
                values += parts.facets[..., None, None] * self.relief.facets.mueller(*block, wavelength)
            if parts.spread is not None:
                values += parts.spread[..., None, None] * polarised.mueller(np.ones(block[0].size), *block, n, k)
            if parts.waves is not None:
                values += parts.waves[..., None, None] * amplitudes(pair, block[3] - block[1], n, k).mueller()
            return values

        return _in_blocks(angles, (wavelength.size, 4, 4), of_block)

    def of_facets(self, angles: Angles, wavelength: Array) -> Array:
        """BRDF of the facets [sr-1], (directions, wavelength or 1)."""
        assert self.relief is not None
        return self.relief.facets.evaluate(*angles, wavelength)

    @cached_property
    def _compiled(self) -> RoughSurface:
        """The same surface, with halos that are looked up by compiled code."""
        relief, halo = self.relief, self.halo
        if relief is not None and relief.fine is not None:
            relief = replace(relief, fine=replace(relief.fine, compiled=True))
        return replace(self, halo=None if halo is None else replace(halo, compiled=True), relief=relief)

    def _parts(self, pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> _Parts:
        share = self.facet_share(pair.cos_i + pair.cos_o, wavelength)
        facets: Array | None = None
        spread: Array | None = None
        waves: Array | None = None
        if self.halo is not None and not (share == 1).all():
            waves = (1 - share) * self.halo.strength(pair, azimuths, wavelength)
        if self.relief is not None and share.any():
            facets = share * self.relief.undimmed(pair.cos_i + pair.cos_o, wavelength)
            if (fine := self.relief.spread(pair, azimuths, wavelength)) is not None:
                spread, once = share * fine[0], share * fine[1]
                waves = once if waves is None else waves + once
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
    of_block: Callable[[HalfVector, Angles, NDArray[np.int64]], Array],
    compiled: bool = False,
) -> Array:
    """Values of pairs of directions above the surface, in blocks that fit the processor's cache; 0 for others.

    ``of_block`` is given the pairs of a block, their angles, and their places among all directions. ``compiled`` is whether the pairs
    are computed by compiled code.
    """
    theta_i, phi_i, theta_o, phi_o = angles
    result = np.zeros((theta_i.size, *shape))
    above = np.flatnonzero((theta_i < 90) & (theta_o < 90))
    step = max(_BLOCK // int(np.prod(shape)), 64)
    pairs: Callable[..., HalfVector] = half_vector
    if compiled:
        from brdfpipe.bsdf.microfacet import evaluation_kernel

        pairs = evaluation_kernel.half_vectors
    for start in range(0, above.size, step):
        at = above[start : start + step]
        block = theta_i[at], phi_i[at], theta_o[at], phi_o[at]
        result[at] = of_block(pairs(*block), block, at)
    return result

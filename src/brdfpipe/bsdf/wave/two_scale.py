"""Facets upon which finer roughness scatters, and the share of the light for which a surface is one of facets.

Of independent heights the characteristic functions multiply. The coarse relief is a surface of facets; roughness finer than a cut, of
phase variance g_f, dims their reflection by e^(−g_f) and spreads it:

    f_r = e^(−g_f) F D G2/(4γ_iγ_o) + [e^(−g_f) Q 4γ_iγ_o/q² + (1 − e^(−g_f)) F G2 q²/(4γ_iγ_o cos⁴α)] K′/λ²

q = γ_i + γ_o, α the tilt of the facet that mirrors one direction into the other, and K′ the transform of the fine halo convolved with
the slopes of the coarse relief. Light scattered once by the fine roughness has the polarisation of waves; what it scatters more often
has that of facets.

References
----------
Holzschuch & Pacanowski 2017, ACM Trans. Graph. 36(4) 66 (two scales); Voronovich 1994, Wave Scattering from Rough Surfaces, ch. 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.fft import fht, fhtoffset

from brdfpipe.bsdf.microfacet import polarised
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.wave.halo import Halo, amplitudes
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, half_vector
from brdfpipe.optics.fresnel_equations import fresnel

Angles = tuple[Array, Array, Array, Array]

MASKING = "height-correlated"

PHASES = (10.0, 60.0)
"""Phase variances between which a surface of low slopes passes from waves to facets."""

SLOPES = (0.2, 0.4)
"""Rms slopes at scales above the wavelength between which a surface passes from waves to facets at any phase variance."""

MASKED_SLOPES, MASKED_PHASES = (1.0, 2.0), (1.0, 10.0)
"""The same of slopes over the mean cosine of both directions, near grazing, where waves lack masking; and phase variances from which it acts."""

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


@dataclass(frozen=True)
class TwoScaleRelief:
    """Facets with finer roughness, prepared for evaluation."""

    facets: Microsurface
    fine: Halo
    """Of the fine roughness upon the facets: ``spline`` holds ln(K′/g)"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> TwoScaleRelief:
        """The relief of a ``bsdf`` dataset, representation ``wave``, with facets."""
        names = {
            "log_fine_halo": "log_halo",
            "fine_phase_variance": "phase_variance",
            "fine_frequency": "halo_frequency",
        }
        fine = (
            bsdf[["log_fine_halo"]].rename(names).assign(frequency_scale=bsdf["fine_scale"], sigma=bsdf["fine_sigma"])
        )
        fine.attrs = {"form": "ssa1", "spectrum": "measured"}
        return cls(Microsurface.of(bsdf), Halo.of(fine))

    def strengths(self, pair: HalfVector, phi_i: Array, phi_o: Array, wavelength: Array) -> tuple[Array, Array]:
        """BRDF over the reflectance of facets, and over the polarisation factor of waves [sr-1], (directions, wavelength) each."""
        cosines = pair.cos_i + pair.cos_o
        undimmed = np.exp(-self.fine.phase_variance(cosines, wavelength))
        tilted = (1 + pair.slope_squared) ** 2 * self.facets.visibility(pair, phi_i, phi_o, MASKING) / 4
        once, transform = self.fine.strength_and_transform(pair, wavelength)
        # q²K′/λ² is the slope density of the light that the fine roughness spreads.
        density = undimmed * self.facets.p22(pair, phi_i, phi_o)[:, None]
        density = density + (1 - undimmed) * cosines[:, None] ** 2 * transform
        return tilted[:, None] * density, undimmed * once


@dataclass(frozen=True)
class RoughSurface:
    """A surface that reflects as waves, as facets with finer roughness, or as both in turn."""

    halo: Halo
    relief: TwoScaleRelief | None
    """None for waves alone"""
    facet_sigma: float
    """Rms height of the relief that is one of facets [um]"""
    slope: float
    """Its rms slope at scales above the wavelength [1]"""
    always_facets: bool
    """Whether the relief is one of facets at any phase variance"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> RoughSurface:
        """The surface of a ``bsdf`` dataset, representation ``wave``."""
        halo = Halo.of(bsdf)
        if "slope_density" not in bsdf:
            return cls(halo, None, 0.0, 0.0, False)
        always = bsdf.attrs["optics"] == "composite"
        return cls(halo, TwoScaleRelief.of(bsdf), float(bsdf["facet_sigma"]), float(bsdf["resolved_slope"]), always)

    def facet_share(self, cosines: Array, wavelength: Array) -> Array:
        """Share of the light [1], (…, wavelength), that is reflected as by facets, of γ_i + γ_o (…) at wavelengths [nm]."""
        if self.relief is None:
            return np.zeros((*np.shape(cosines), wavelength.size))
        if self.always_facets:
            return np.ones((*np.shape(cosines), wavelength.size))
        phase = (2e3 * np.pi * self.facet_sigma * cosines[..., None] / wavelength) ** 2
        return facet_share(phase, cosines[..., None] / 2, self.slope)

    def coherent_share(self, theta_i: Array, wavelength: Array) -> Array:
        """Share of Fresnel's reflectance that is reflected coherently, (incidences…, wavelength)."""
        share = self.facet_share(2 * np.cos(np.radians(theta_i)), wavelength)
        return (1 - share) * self.halo.coherent_share(theta_i, wavelength)

    def evaluate(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """BRDF without diffuse light [sr-1], (directions, wavelength); 0 unless both directions are above the surface.

        Angles are θ_i, φ_i, θ_o and φ_o, (directions,) degree; wavelength [nm], n and k are (wavelength,).
        """

        def of_block(pair: HalfVector, phi_i: Array, phi_o: Array) -> Array:
            of_facets, of_waves = self._strengths(pair, phi_i, phi_o, wavelength)
            values = np.zeros((phi_i.size, wavelength.size))
            if of_waves is not None:
                values += of_waves * amplitudes(pair, phi_o - phi_i, n, k).mean
            if of_facets is not None:
                values += of_facets * fresnel(pair.cos_zeta[:, None], n, k).mean
            return values

        return _in_blocks(angles, (wavelength.size,), of_block)

    def mueller(self, angles: Angles, wavelength: Array, n: Array, k: Array) -> Array:
        """Mueller matrices of the same [sr-1], (directions, wavelength, 4, 4), in the frames of the microfacet model."""

        def of_block(pair: HalfVector, phi_i: Array, phi_o: Array) -> Array:
            of_facets, of_waves = self._strengths(pair, phi_i, phi_o, wavelength)
            values = np.zeros((phi_i.size, wavelength.size, 4, 4))
            if of_waves is not None:
                values += of_waves[..., None, None] * amplitudes(pair, phi_o - phi_i, n, k).mueller()
            if of_facets is not None:
                theta_i, theta_o = (
                    np.degrees(np.arctan2(*part)) for part in ((pair.sin_i, pair.cos_i), (pair.sin_o, pair.cos_o))
                )
                facet = polarised.mueller(np.ones(phi_i.size), theta_i, phi_i, theta_o, phi_o, n, k)
                values += of_facets[..., None, None] * facet
            return values

        return _in_blocks(angles, (wavelength.size, 4, 4), of_block)

    def _strengths(
        self, pair: HalfVector, phi_i: Array, phi_o: Array, wavelength: Array
    ) -> tuple[Array | None, Array | None]:
        """BRDF over the reflectance of facets, and over the polarisation factor of waves; None where there is no such light."""
        share = self.facet_share(pair.cos_i + pair.cos_o, wavelength)
        of_facets: Array | None = None
        of_waves: Array | None = None
        if not (share == 1).all():
            of_waves = (1 - share) * self.halo.strength(pair, wavelength)
        if self.relief is not None and share.any():
            of_facets, once = self.relief.strengths(pair, phi_i, phi_o, wavelength)
            of_facets, once = share * of_facets, share * once
            of_waves = once if of_waves is None else of_waves + once
        return of_facets, of_waves


def _in_blocks(angles: Angles, shape: tuple[int, ...], of_block: Callable[[HalfVector, Array, Array], Array]) -> Array:
    """Values of pairs of directions above the surface, in blocks that fit the processor's cache; 0 for others."""
    theta_i, phi_i, theta_o, phi_o = angles
    result = np.zeros((theta_i.size, *shape))
    above = np.flatnonzero((theta_i < 90) & (theta_o < 90))
    step = max(_BLOCK // int(np.prod(shape)), 64)
    for start in range(0, above.size, step):
        at = above[start : start + step]
        result[at] = of_block(half_vector(theta_i[at], phi_i[at], theta_o[at], phi_o[at]), phi_i[at], phi_o[at])
    return result

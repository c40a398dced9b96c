"""Shading models of renderers: a lobe of facets over a diffuse base, as the program evaluates them from its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from brdfpipe.geometry import Array, half_vector
from brdfpipe.optics.fresnel_equations import fresnel

_FACETS_RULE = np.polynomial.legendre.leggauss(32)
"""Gauss–Legendre nodes and weights of the distribution of facets, and of half a turn about the normal."""
_KEPT_LOBES = 16
_STORED_ALBEDOS = 48
_BASE_RULE = np.polynomial.legendre.leggauss(24)
"""Of the directions of view, and of half a turn about the normal."""


@dataclass(frozen=True)
class Lobe:
    """Reflection by facets, as a renderer evaluates it: D·F·G/(4 cos θ_i cos θ_o) with height-correlated masking."""

    distribution: str
    """``ggx`` or ``beckmann``"""
    alpha: float
    """Width: √2 times the slope rms of one axis, of Beckmann's distribution [1]"""
    fresnel: Callable[[Array], Array]
    """Cosine of the incidence on a facet → reflectance, (…, channels)"""
    compensated: bool = False
    """Whether light that facets reflect more than once is added, as 1 + F·(1 − E)/E with E the reflectance of white facets from the direction of
    view (Turquin 2019, eq. 14 and 16, as in MaterialX); false: light that is reflected once"""

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF (directions, channels) [sr-1] of directions above the surface [degree]."""
        half = half_vector(theta_i, phi_i, theta_o, phi_o)
        shape = (
            self._density(half.slope_squared) * self._masking(half.cos_i, half.cos_o) / (4 * half.cos_i * half.cos_o)
        )
        return np.asarray(shape[..., None] * self._reflected(half.cos_zeta, half.cos_o))

    def albedo(self, theta_i: Array) -> Array:
        """Directional reflectance (incidences, channels), by an integral over the facets."""
        theta_i = np.asarray(theta_i, dtype=float)[:, None, None]
        nodes, weights = _FACETS_RULE
        share, around = (nodes + 1) / 2, np.pi * (nodes + 1) / 2
        squared = share / (1 - share) if self.distribution == "ggx" else -np.log1p(-share)
        theta_h = np.arctan(self.alpha * np.sqrt(squared))[:, None]
        cos_h = np.cos(theta_h)
        cos_i, sin_i = np.cos(np.radians(theta_i)), np.sin(np.radians(theta_i))
        on_facet = cos_i * cos_h + sin_i * np.sin(theta_h) * np.cos(around)
        cos_o = 2 * on_facet * cos_h - cos_i
        lit = (on_facet > 0) & (cos_o > 0)
        masked = np.where(lit, self._masking(cos_i, np.where(lit, cos_o, 1.0)) * on_facet / (cos_i * cos_h), 0.0)
        reflected = masked[..., None] * self._reflected(np.clip(on_facet, 0, 1), np.clip(cos_o, 0, 1))
        return np.asarray(np.einsum("iuac,u,a->ic", reflected, weights / 2, weights / 2))

    @cached_property
    def layered(self) -> tuple[Array, Array]:
        """Increasing angles [degree], and the directional reflectance of the first channel, between which what lies below the lobe is interpolated."""
        angles = np.linspace(0.0, 89.9, _STORED_ALBEDOS)
        return angles, self.albedo(angles)[:, 0]

    def _reflected(self, on_facet: Array, cos_o: Array) -> Array:
        """Reflectance of a facet, and of those that its light meets, (…, channels)."""
        once = self.fresnel(on_facet)
        if not self.compensated:
            return once
        cosines, lost = _lost(self.distribution, self.alpha)
        return np.asarray(once * (1 + once * np.interp(cos_o, cosines, lost)[..., None]))

    def _density(self, slope_squared: Array) -> Array:
        """Facets by solid angle of their normals [sr-1]."""
        width, fourth = self.alpha**2, (1 + slope_squared) ** 2
        if self.distribution == "ggx":
            return np.asarray(width * fourth / (np.pi * (width + slope_squared) ** 2))
        return np.asarray(np.exp(-slope_squared / width) * fourth / (np.pi * width))

    def _masking(self, cos_i: Array, cos_o: Array) -> Array:
        return np.asarray(1 / (1 + self._hidden(cos_i) + self._hidden(cos_o)))

    def _hidden(self, cosine: Array) -> Array:
        """Smith's Λ."""
        tangent = np.sqrt(np.maximum(1 / np.maximum(cosine, 1e-12) ** 2 - 1, 0.0))
        if self.distribution == "ggx":
            return np.asarray((np.sqrt(1 + (self.alpha * tangent) ** 2) - 1) / 2)
        from scipy.special import erf

        ratio = 1 / np.maximum(self.alpha * tangent, 1e-12)
        return np.asarray((erf(ratio) - 1) / 2 + np.exp(-(ratio**2)) / (2 * ratio * np.sqrt(np.pi)))


@lru_cache(maxsize=_KEPT_LOBES)
def _lost(distribution: str, alpha: float) -> tuple[Array, Array]:
    """Increasing cosines, and what white facets reflect more than once over what they reflect once (1 − E)/E."""
    angles = np.linspace(89.9, 0.0, _STORED_ALBEDOS)
    once = Lobe(distribution, alpha, lambda cosine: np.ones((*cosine.shape, 1))).albedo(angles)[:, 0]
    return np.cos(np.radians(angles)), np.maximum(1 / once - 1, 0.0)


@dataclass(frozen=True)
class Material:
    """A lobe over a diffuse base, in linear red, green and blue."""

    lobe: Lobe
    base: Array
    """(3,) reflectance of the base"""
    under_lobe: Callable[[Lobe, Array, Array, Array, Array], Array]
    """Share of the base's light that the program lets through the lobe, (directions, 1)"""

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        """BRDF (directions, 3) [sr-1]."""
        at = theta_i, phi_i, theta_o, phi_o
        return np.asarray(self.lobe.evaluate(*at) + self.under_lobe(self.lobe, *at) * self.base / np.pi)

    def albedo(self, theta_i: Array) -> Array:
        """Directional reflectance (incidences, 3)."""
        return np.asarray(self.lobe.albedo(theta_i) + base_share(self.lobe, self.under_lobe, theta_i) * self.base)


def base_share(lobe: Lobe, under_lobe: Callable[[Lobe, Array, Array, Array, Array], Array], theta_i: Array) -> Array:
    """Directional reflectance (incidences, 1) of a white base below the lobe."""
    nodes, weights = _BASE_RULE
    theta_o = np.degrees(np.arcsin(np.sqrt((nodes + 1) / 2)))
    polar, around, incident = np.meshgrid(theta_o, 90 * (nodes + 1), np.asarray(theta_i, dtype=float), indexing="ij")
    values = under_lobe(lobe, incident.ravel(), np.zeros(incident.size), polar.ravel(), around.ravel())
    return np.asarray(np.einsum("oai,o,a->i", values.reshape(incident.shape), weights / 2, weights / 2))[:, None]


def by_albedo(lobe: Lobe, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """1 − the lobe's reflectance from the direction of view: layering of OpenPBR and MaterialX."""
    return np.asarray(1 - np.interp(theta_o, *lobe.layered))[:, None]


def by_fresnel(lobe: Lobe, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """1 − Fresnel's reflectance of the facet between both directions: mixture of glTF."""
    return np.asarray(1 - lobe.fresnel(half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta)[..., :1])


def nothing(lobe: Lobe, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """No light returns from below a metal."""
    return np.zeros((np.size(theta_i), 1))


def dielectric(index: float) -> Callable[[Array], Array]:
    """Fresnel's reflectance of unpolarised light on an index n, alike in all channels."""
    return lambda cosine: np.repeat(fresnel(cosine, index).mean[..., None], 3, axis=-1)


def schlick(normal: Array) -> Callable[[Array], Array]:
    """Schlick's approximation of a reflectance (3,) at normal incidence."""
    return lambda cosine: normal + (1 - normal) * (1 - cosine[..., None]) ** 5

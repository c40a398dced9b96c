"""The radial slope density P22(s) of an isotropic surface, as a function.

P22 is the probability density of facet slopes (p, q) per unit of slope plane, s = √(p² + q²) = tan α, so that
2π ∫ P22 s ds = 1 and D(m) = P22 / cos⁴α.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from brdfpipe.content_cache import cached_by_content
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.piecewise import PiecewiseCubic

PANELS = 96
"""Panels that resolve any density to rounding."""


@dataclass(frozen=True)
class RadialDensity:
    """Slope density tabulated at nodes, evaluated between them.

    Parameters
    ----------
    slope : (n,) increasing, from 0 [1]
    density : (n,) positive [1]; zero beyond the last node

    Notes
    -----
    log P22 is interpolated against u = s², where a Gaussian is a straight line and every isotropic density is smooth at
    s = 0. The derivatives at the nodes are a cubic spline's, limited after Hyman (1983): fourth-order on smooth densities,
    no overshoot on counted ones.
    """

    slope: Array
    density: Array

    @classmethod
    def of(cls, dataset: xr.Dataset) -> RadialDensity:
        """The density of a ``facets`` or microfacet ``bsdf`` dataset."""
        return _prepared(dataset["slope"].values.astype(float), dataset["slope_density"].values.astype(float))

    def __call__(self, slope_squared: ArrayLike) -> Array:
        """P22 at s², of any shape."""
        u = np.asarray(slope_squared, dtype=float)
        last = self.log_density.last
        if u.size and u.max() <= last:
            return np.asarray(np.exp(self.log_density(u)))
        values = np.asarray(np.exp(self.log_density(np.minimum(u, last))))
        values[u > last] = 0.0
        return values

    @cached_property
    def log_density(self) -> PiecewiseCubic:
        return PiecewiseCubic.of(log_spline(self.slope**2, np.log(self.density)))

    def panels(self, most: int = PANELS) -> Array:
        """Edges, on nodes, of at most ``most`` panels that resolve the density."""
        picked = np.unique(np.linspace(0, self.slope.size - 1, min(most + 1, self.slope.size)).round().astype(int))
        return self.slope[picked]

    def rule(self, order: int = 4, most: int = 10**6) -> tuple[Array, Array]:
        """Nodes s and probability weights of a quadrature over the slope magnitude: Σ w h(s) = E[h(s)]."""
        s, ds = panel_rule(self.panels(most), order)
        return s, 2 * np.pi * s * self(s**2) * ds

    @cached_property
    def mass(self) -> float:
        """∫ P22 dp dq, which is 1 for a normalised density."""
        return float(self.rule()[1].sum())

    def normalised(self) -> RadialDensity:
        """The same density with a mass of 1."""
        return RadialDensity(self.slope, self.density / self.mass)

    @cached_property
    def median_slope(self) -> float:
        """The slope magnitude that half of the facets exceed: a width that exists for every density."""
        return self.slope_quantile(0.5)

    def slope_quantile(self, share: float) -> float:
        """The slope magnitude that a share of the facets, 0 to 1, does not exceed."""
        s, weight = self.rule()
        return float(np.interp(share * weight.sum(), np.cumsum(weight), s))


@cached_by_content(16)
def _prepared(slope: Array, density: Array) -> RadialDensity:
    """The same object for the same density, so that its spline and its width are computed once."""
    return RadialDensity(slope, density)


def log_spline(slope_squared: Array, log_density: Array) -> CubicHermiteSpline:
    """The interpolant of :class:`RadialDensity`, of one density or several (…, nodes)."""
    return CubicHermiteSpline(slope_squared, log_density, _limited_derivatives(slope_squared, log_density), axis=-1)


def masses(slope: Array, densities: Array) -> Array:
    """∫ P22 dp dq of several densities (…, nodes) on the same nodes, as :attr:`RadialDensity.mass`."""
    s, ds = panel_rule(slope, 4)
    return np.asarray(np.exp(log_spline(slope**2, np.log(densities))(s**2)) @ (2 * np.pi * s * ds))


def _limited_derivatives(x: Array, y: Array) -> Array:
    if x.size < 4:
        return np.gradient(y, x, axis=-1)
    secant = np.diff(y) / np.diff(x)
    derivative = CubicSpline(x, y, axis=-1)(x, 1)
    before = np.concatenate([secant[..., :1], secant], axis=-1)
    after = np.concatenate([secant, secant[..., -1:]], axis=-1)
    bound = 3 * np.minimum(np.abs(before), np.abs(after))
    limited = np.sign(derivative) * np.minimum(np.abs(derivative), bound)
    wrong_way = (before * after > 0) & (limited * before < 0)
    return np.where(wrong_way, 0.0, limited)

"""Smith's masking from the mean excess slope of a slope density, g(μ) = E[(p̃ − μ)⁺], p̃ the slope towards the direction, μ = cot θ.

Λ = g/μ and G1 = 1/(1 + Λ). The form cos θ (1 + Λ) = cos θ + g sin θ stays exact up to grazing, where Λ itself diverges.

References
----------
Smith 1967; Ashikhmin 2000; Heitz 2014 (JCGT 3(2)), eqs. 72 and 99; patent US 9,395,299, claim 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RectBivariateSpline

from brdfpipe.content_cache import cached_by_content
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule
from brdfpipe.piecewise import PiecewiseCubic

_NODES = 384
_TOGETHER = 32
"""Directions that are integrated together: what they need stays in the cache."""


def excess_slope(density: RadialDensity, mu: ArrayLike) -> Array:
    """Mean excess g(μ) = E[(p̃ − μ)⁺] of a radial slope density.

    Parameters
    ----------
    density : the slope density
    mu : cot θ, (m,), >= 0 [1]

    Notes
    -----
    Over the azimuth the mean is known in closed form, g = 2 ∫_μ^∞ P22 s [√(s² − μ²) − μ arccos(μ/s)] ds; the rest is
    a Gauss–Legendre rule on the density's own panels, split at μ.
    """
    mu, panels = np.asarray(mu, dtype=float), density.panels(128)
    split = np.clip(np.searchsorted(panels, mu, side="right") - 1, 0, panels.size - 2)
    s, ds = panel_rule(np.stack([mu, np.maximum(panels[split + 1], mu)], axis=-1), 4)
    excess = np.asarray(
        2 * (density(s**2) * s**2 * _excess_over_slope(mu[:, None] / np.where(s > 0, s, 1.0)) * ds).sum(axis=-1)
    )
    # Above the panel that is split, the density is the same for all directions.
    s, ds = panel_rule(panels, 4)
    share, panel = 2 * density(s**2) * s**2 * ds, np.repeat(np.arange(panels.size - 1), 4)
    for start in range(0, mu.size, _TOGETHER):
        few = slice(start, start + _TOGETHER)
        above = slice(4 * (int(split[few].min()) + 1), None)
        ratio = np.where(panel[above] > split[few, None], mu[few, None] / s[above], 1.0)
        excess[few] += (share[above] * _excess_over_slope(ratio)).sum(axis=-1)
    return excess


def _excess_over_slope(ratio: Array) -> Array:
    """√(1 − r²) − r arccos r of a ratio r = μ/s >= 0; 0 where it is 1 or more."""
    ratio = np.minimum(ratio, 1.0)
    return np.asarray(np.sqrt(1 - ratio**2) - ratio * np.arccos(ratio))


def smith_lambda(density: RadialDensity) -> xr.DataArray:
    """Table of Λ(θ) of a radial density, dense enough to be evaluated anywhere through :class:`Smith`."""
    scale, reach = density.median_slope, density.slope[-1]
    # Not closer to grazing: a polar angle in degree resolves cot θ to 2e-16 only, and there Λ = g/μ would lose digits.
    mu = scale * np.sinh(np.linspace(0, np.arcsinh(reach / scale), _NODES))[-2:0:-1]
    lambda_smith = excess_slope(density, mu) / mu
    return xr.DataArray(lambda_smith, dims="theta", coords={"theta": np.degrees(np.arctan2(1.0, mu))})


@dataclass(frozen=True)
class Smith:
    """The mean excess slope g(μ), from a table of Λ(θ)."""

    spline: PiecewiseCubic

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Smith:
        """The masking of a ``facets`` or microfacet ``bsdf`` dataset."""
        return cls(_excess_spline(dataset["theta"].values, dataset["lambda_smith"].values))

    def excess(self, mu: ArrayLike, phi: ArrayLike = 0.0) -> Array:
        """g(μ), of any shape and in any azimuth; μ = inf (normal incidence) gives 0."""
        # At the last node g is zero but for rounding.
        excess = self.spline(np.minimum(np.asarray(mu, dtype=float), self.spline.last))
        return np.maximum(excess, 0.0)


@cached_by_content(16)
def _excess_spline(theta: Array, lambda_smith: Array) -> PiecewiseCubic:
    """g over μ from a table of Λ over θ [degree]."""
    mu = 1 / np.tan(np.radians(theta[::-1]))
    excess = lambda_smith[::-1] * mu
    # Slopes are symmetric about zero, so g + μ/2 is even in μ: its value at grazing follows from the first three nodes.
    even = np.linalg.solve(np.vander((mu[:3] / mu[2]) ** 2, increasing=True), excess[:3] + mu[:3] / 2)
    mu, excess = np.concatenate([[0.0], mu]), np.concatenate([even[:1], excess])
    # Beyond the steepest facet g vanishes with its derivative.
    return PiecewiseCubic.of(CubicSpline(mu, excess, bc_type=((1, np.array(-0.5)), (1, np.array(0.0)))))


def cotangent(cos: ArrayLike, sin: ArrayLike) -> Array:
    """cot θ from the cosine and sine of θ; infinite at normal incidence."""
    cos, sin = np.asarray(cos, dtype=float), np.asarray(sin, dtype=float)
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(cos / sin)


@dataclass(frozen=True)
class PlanarSmith:
    """The mean excess slope g(μ, φ) of a surface with a lay, from a table of Λ(θ, φ).

    Over the width w of the slopes towards φ, g depends on μ/w alone if the density is elliptic, and little on the azimuth if it
    is not: g/w is interpolated over asinh(μ/w) and the turn ω (:class:`~brdfpipe.facets.planar_density.Ellipse`).
    """

    spline: RectBivariateSpline
    _ellipse: Ellipse
    last: float

    @classmethod
    def of(cls, dataset: xr.Dataset) -> PlanarSmith:
        """The masking of an anisotropic ``facets`` dataset."""
        ellipse = Ellipse.of(dataset)
        mu = 1 / np.tan(np.radians(dataset["theta"].values[::-1]))
        width, turn = ellipse.towards(dataset["phi"].values)
        excess = dataset["lambda_smith"].transpose("theta", "phi").values[::-1] * mu[:, None]
        last = float(mu[-1] / width.max())
        t = np.linspace(0, np.arcsinh(last), mu.size)
        opposite = np.roll(excess, turn.size // 2, axis=1)
        columns = zip(width, excess.T, opposite.T, strict=True)
        table = np.stack([_over_width(mu / w, g / w, opposite_g / w)(t) for w, g, opposite_g in columns], axis=1)
        order = np.argsort(turn)
        around = np.concatenate([order[-4:], order, order[:4]])
        turns = np.unwrap(turn[around] - 360, period=360)
        return cls(RectBivariateSpline(t, turns, table[:, around]), ellipse, last)

    def excess(self, mu: ArrayLike, phi: ArrayLike) -> Array:
        """g(μ, φ), broadcast; φ in degree, μ = inf (normal incidence) gives 0."""
        mu, phi = np.asarray(mu, dtype=float), np.asarray(phi, dtype=float)
        if mu.shape == phi.shape and mu.size > 1 and (mu == mu.flat[0]).all() and (phi == phi.flat[0]).all():
            # Of one incidence and many views.
            return np.full(mu.shape, self.excess(mu.flat[0], phi.flat[0]))
        width, turn = self._ellipse.towards(phi)
        slope = mu / width
        inside = slope < self.last
        values = width * self.spline.ev(np.arcsinh(np.where(inside, slope, 0.0)), turn)
        return np.where(inside, np.maximum(values, 0.0), 0.0)


def _over_width(slope: Array, excess: Array, opposite: Array) -> CubicSpline:
    """g over asinh(μ), both over the width, from μ = 0: of a mean slope of zero, g(−μ, φ) = μ + g(μ, φ + 180°)."""
    both = np.concatenate([-slope[3::-1], slope])
    return CubicSpline(np.arcsinh(both), np.concatenate([(slope + opposite)[3::-1], excess]))

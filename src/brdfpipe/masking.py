"""Masking and shadowing of facets by their neighbours (Smith).

Everything follows from one function of the density, the mean excess slope g(μ) = E[(p̃ − μ)⁺] with p̃ the slope towards the
direction and μ = cot θ: Λ = g/μ and G1 = 1/(1 + Λ). With it, cos θ (1 + Λ) = cos θ + g sin θ stays exact up to grazing,
where Λ itself diverges.

References
----------
Smith 1967; Ashikhmin 2000; Heitz 2014 (JCGT 3(2)), eqs. 72 and 99; patent US 9,395,299, claim 2.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RectBivariateSpline

from brdfpipe import vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array, HalfVector, broadcast, check_angles, checked_angles, half_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.piecewise import PiecewiseCubic
from brdfpipe.planar import Ellipse

_NODES = 384


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
    mu = np.asarray(mu, dtype=float)
    edges = np.maximum(density.panels(128), mu[:, None])
    s, ds = panel_rule(edges, 4)
    ratio = np.clip(mu[:, None] / np.where(s > 0, s, 1.0), 0.0, 1.0)
    kernel = np.sqrt(1 - ratio**2) - ratio * np.arccos(ratio)
    return 2 * np.sum(density(s**2) * s**2 * kernel * ds, axis=1)


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

    _spline: PiecewiseCubic

    @classmethod
    def of(cls, dataset: xr.Dataset) -> Smith:
        """The masking that a ``facets`` or microfacet ``bsdf`` dataset carries."""
        mu = 1 / np.tan(np.radians(dataset["theta"].values[::-1]))
        excess = dataset["lambda_smith"].values[::-1] * mu
        # Slopes are symmetric about zero, so g + μ/2 is even in μ: its value at grazing follows from the first three nodes.
        even = np.linalg.solve(np.vander((mu[:3] / mu[2]) ** 2, increasing=True), excess[:3] + mu[:3] / 2)
        mu, excess = np.concatenate([[0.0], mu]), np.concatenate([even[:1], excess])
        # Beyond the steepest facet g vanishes with its derivative.
        return cls(PiecewiseCubic.of(CubicSpline(mu, excess, bc_type=((1, np.array(-0.5)), (1, np.array(0.0))))))

    def excess(self, mu: ArrayLike) -> Array:
        """g(μ), of any shape; μ = inf (normal incidence) gives 0."""
        # At the last node g is zero but for rounding.
        excess = self._spline(np.minimum(np.asarray(mu, dtype=float), self._spline.last))
        return np.maximum(excess, 0.0)

    def excess_towards(self, cos: ArrayLike, sin: ArrayLike) -> Array:
        """g(cot θ) from the cosine and sine of θ."""
        return self.excess(cotangent(cos, sin))


def cotangent(cos: ArrayLike, sin: ArrayLike) -> Array:
    """cot θ from the cosine and sine of θ; infinite at normal incidence."""
    cos, sin = np.asarray(cos, dtype=float), np.asarray(sin, dtype=float)
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(cos / sin)


@dataclass(frozen=True)
class PlanarSmith:
    """The mean excess slope g(μ, φ) of a surface with a lay, from a table of Λ(θ, φ).

    Over the width w of the slopes towards φ, g depends on μ/w alone if the density is elliptic, and little on the azimuth if it
    is not: g/w is interpolated over asinh(μ/w) and the turn ω of the ellipse drawn round.
    """

    _spline: RectBivariateSpline
    _ellipse: Ellipse
    _last: float

    @classmethod
    def of(cls, dataset: xr.Dataset) -> PlanarSmith:
        """The masking that an anisotropic ``facets`` dataset carries."""
        ellipse = Ellipse.of(dataset)
        mu = 1 / np.tan(np.radians(dataset["theta"].values[::-1]))
        width, turn = ellipse.towards(dataset["phi"].values)
        excess = dataset["lambda_smith"].transpose("theta", "phi").values[::-1] * mu[:, None]
        last = float(mu[-1] / width.max())
        t = np.linspace(0, np.arcsinh(last), mu.size)
        opposite = np.roll(excess, turn.size // 2, axis=1)
        columns = zip(width, excess.T, opposite.T, strict=True)
        table = np.stack([_over_width(mu / w, g / w, back / w)(t) for w, g, back in columns], axis=1)
        order = np.argsort(turn)
        around = np.concatenate([order[-4:], order, order[:4]])
        turns = np.unwrap(turn[around] - 360, period=360)
        return cls(RectBivariateSpline(t, turns, table[:, around]), ellipse, last)

    def excess(self, mu: ArrayLike, phi: ArrayLike) -> Array:
        """g(μ, φ), broadcast; φ in degree, μ = inf (normal incidence) gives 0."""
        width, turn = self._ellipse.towards(phi)
        slope = np.asarray(mu, dtype=float) / width
        inside = slope < self._last
        values = width * self._spline.ev(np.arcsinh(np.where(inside, slope, 0.0)), turn)
        return np.where(inside, np.maximum(values, 0.0), 0.0)


def _over_width(slope: Array, excess: Array, opposite: Array) -> CubicSpline:
    """g over asinh(μ), both over the width, from μ = 0: of a mean slope of zero, g(−μ, φ) = μ + g(μ, φ + 180°)."""
    both = np.concatenate([-slope[3::-1], slope])
    return CubicSpline(np.arcsinh(both), np.concatenate([(slope + opposite)[3::-1], excess]))


def g1(facets: xr.Dataset, theta: ArrayLike, phi: ArrayLike = 0.0) -> xr.DataArray:
    """Smith masking of a facet distribution: the visible fraction of facets that face a direction.

    Parameters
    ----------
    facets : kind ``facets``; its mean slope is zero
    theta, phi : degree, broadcastable; 0 <= theta <= 90

    Returns
    -------
    DataArray [1], in [0, 1], named ``g1``; plain angles give the dimension ``direction``

    Raises
    ------
    VocabularyError : the dataset is not of kind ``facets``, or an angle is out of range.

    Notes
    -----
    G1 = 1 / (1 + Λ), Λ(θ) = E[(p̃ − cot θ)⁺] / cot θ. Exact for the tabulated density; no Gaussian assumption.

    References
    ----------
    Heitz 2014, eq. 72; Ashikhmin 2000; patent US 9,395,299, claim 2.
    """
    vocabulary.validate(facets, "facets")
    polar, azimuth = broadcast(theta=checked_angles("theta", theta, 0, 90), phi=checked_angles("phi", phi, -720, 720))
    cos, sin, excess = _seen_from(facets, polar.values, azimuth.values)
    result = polar.copy(data=cos / (cos + excess * sin))
    return result.rename("g1").assign_attrs(units="1", long_name="Smith masking G1")


def g2(
    facets: xr.Dataset,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    mode: str = "height-correlated",
) -> xr.DataArray:
    """Masking and shadowing together: the fraction of facets that both directions see.

    Parameters
    ----------
    facets : kind ``facets``; its mean slope is zero
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; 0 <= θ < 90
    mode : a key of :data:`VISIBILITY`, or ``liu`` (:mod:`brdfpipe.bsdf.liu`)

    Returns
    -------
    DataArray [1], in [0, 1], named ``g2``

    Raises
    ------
    VocabularyError : the dataset is not of kind ``facets``, an angle is out of range, or the mode is unknown.
    """
    vocabulary.validate(facets, "facets")
    if mode not in (*VISIBILITY, "liu"):
        raise VocabularyError(f"unknown masking mode {mode!r}; accepted: {', '.join(VISIBILITY)}, liu")
    angles = broadcast(
        theta_i=checked_angles("theta_i", theta_i, 0, _BELOW_GRAZING),
        phi_i=checked_angles("phi_i", phi_i, -720, 720),
        theta_o=checked_angles("theta_o", theta_o, 0, _BELOW_GRAZING),
        phi_o=checked_angles("phi_o", phi_o, -720, 720),
    )
    plain = [angle.values for angle in angles]
    half = half_vector(plain[0], plain[1], plain[2], plain[3])
    values = _liu(facets, plain) if mode == "liu" else _by_lambda(facets, plain, half, mode)
    result = angles[0].copy(data=np.broadcast_to(values, plain[0].shape))
    return result.rename("g2").assign_attrs(units="1", long_name=f"masking and shadowing G2, {mode}")


def _liu(facets: xr.Dataset, angles: list[Array]) -> Array:
    if facets["slope_density"].ndim == 2:
        raise VocabularyError("masking mode 'liu' knows isotropic surfaces alone; this one has a lay")
    liu = importlib.import_module("brdfpipe.bsdf.liu")
    table = liu.LiuMasking.of(liu.Marginal.of(RadialDensity.of(facets)))
    return np.asarray(liu.attenuation(angles[0], angles[1], angles[2], angles[3], table))


def _by_lambda(facets: xr.Dataset, plain: list[Array], half: HalfVector, mode: str) -> Array:
    excess_i, excess_o = (_seen_from(facets, *each)[2] for each in ((plain[0], plain[1]), (plain[2], plain[3])))
    return np.minimum(VISIBILITY[mode](half, excess_i, excess_o) * (half.cos_i * half.cos_o), 1.0)


def g1_along(slopes: ArrayLike, theta: ArrayLike) -> Array:
    """Smith masking straight from the slopes along a line, without a density in between.

    Parameters
    ----------
    slopes : (n,) slopes towards the viewer [1], of mean zero; missing ones are left out
    theta : (m,) degree, 0 to 90

    Returns
    -------
    (m,) G1 in [0, 1]

    Raises
    ------
    VocabularyError : no slope is there, their mean is not zero, or an angle is out of range.

    Notes
    -----
    One sort and its cumulative sums give E[(p − μ)⁺] for every angle at once.
    """
    p = np.sort(np.asarray(slopes, dtype=float).ravel())
    p = p[np.isfinite(p)]
    if p.size == 0 or abs(p.mean()) > 1e-6 * max(float(np.abs(p).max()), 1e-300):
        raise VocabularyError(
            f"masking needs slopes of mean zero; found {p.size} of mean {p.mean() if p.size else np.nan:g}: level first"
        )
    angles = np.radians(np.atleast_1d(check_angles("theta", theta, 0, 90)))
    cos, sin = np.where(angles >= np.pi / 2, 0.0, np.cos(angles)), np.sin(angles)
    mu = cotangent(cos, sin)
    beyond = np.concatenate([np.cumsum(p[::-1])[::-1], [0.0]])
    first = np.searchsorted(p, mu)
    count = p.size - first
    excess = np.where(count > 0, (beyond[first] - np.where(count > 0, mu, 0.0) * count) / p.size, 0.0)
    return np.divide(cos, cos + excess * sin, out=np.zeros_like(cos), where=cos > 0)


def raycast(surface: xr.Dataset, theta: ArrayLike, phi: ArrayLike = 0.0, *, lines: int | None = None) -> xr.Dataset:
    """The ground truth of G1 on the heights themselves; see :func:`brdfpipe.raycast.raycast`."""
    return importlib.import_module("brdfpipe.raycast").raycast(surface, theta, phi, lines=lines)


_BELOW_GRAZING = 90 - 1e-9


def _seen_from(facets: xr.Dataset, theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """cos θ, sin θ and the mean excess slope towards directions in degree."""
    angles = np.radians(theta)
    cos, sin = np.where(theta >= 90, 0.0, np.cos(angles)), np.sin(angles)
    if "phi" in facets["lambda_smith"].dims:
        return cos, sin, PlanarSmith.of(facets).excess(cotangent(cos, sin), phi)
    return cos, sin, Smith.of(facets).excess_towards(cos, sin)


Visibility = Callable[[HalfVector, Array, Array], Array]


def _height_correlated(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    cos_i, cos_o = pair.cos_i, pair.cos_o
    return 1 / (cos_i * cos_o + (excess_i * pair.sin_i * cos_o + excess_o * pair.sin_o * cos_i))


def _separable(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    return 1 / ((pair.cos_i + excess_i * pair.sin_i) * (pair.cos_o + excess_o * pair.sin_o))


def _crf(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    return 1 / (pair.cos_i * (pair.cos_o + excess_o * pair.sin_o))


def _blinn(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    grooved = 2 * pair.cos_alpha / (pair.cos_zeta * np.maximum(pair.cos_i, pair.cos_o))
    return np.minimum(1 / (pair.cos_i * pair.cos_o), grooved)


def _unmasked(pair: HalfVector, excess_i: Array, excess_o: Array) -> Array:
    return 1 / (pair.cos_i * pair.cos_o)


VISIBILITY: dict[str, Visibility] = {
    "height-correlated": _height_correlated,
    "separable": _separable,
    "crf": _crf,
    "blinn": _blinn,
    "none": _unmasked,
}
"""G2 / (cos θ_i cos θ_o) by mode, from the pair of directions and the mean excess slopes g = Λ cot θ towards them.

``height-correlated``: 1/(1 + Λ_i + Λ_o), Heitz 2014 eq. 99, the default · ``separable``: G1(i) G1(o) · ``crf``: G1(o) alone, the
patent's, which is neither reciprocal nor keeps energy · ``blinn``: V-grooves, min(1, 2 cos α cos θ / cos ζ), Blinn 1977 ·
``none``: 1. The first two are finite as long as one of the directions is above the horizon.
"""

"""Liu's geometrical attenuation: masking and shadowing by one neighbouring facet of random slope.

It violates energy conservation near grazing (:func:`energy_limit`): use it to reproduce the source, not above 70°.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, HalfVector, tan_half
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking.smith import cotangent

TRUSTED = 70.0
"""Largest polar angle at which the attenuation can be trusted on any surface [degree]."""

_TABLE_CELLS = 1024
_PANELS = 512
_SMALLEST = 1e-300
# Below this ratio of a slope interval to the width of q, the table loses digits, and q is constant to 1e-4.
_NARROW = 1e-4
# κ (t − μ) bends on the scale of 1 for a density of any width.
_BENDS = 0.25 * 2.0 ** np.arange(8)


@dataclass(frozen=True)
class Marginal:
    """Density q(t) of the slopes along a line, even in t.

    Parameters
    ----------
    density : q(t) at t >= 0, of any shape; need not be normalised
    edges : (panels + 1,) from 0, increasing; q is smooth between them and 0 beyond the last
    scale : typical |t|
    """

    density: Callable[[Array], Array]
    edges: Array
    scale: float

    @classmethod
    def of(cls, radial: RadialDensity) -> Marginal:
        """The marginal q(t) = 2 ∫_0^∞ P22(√(t² + w²)) dw of an isotropic slope density, from a spline through its values.

        Between the density's nodes it is as good as they are: 1e-6 of its value for the named densities.
        """
        panels = radial.panels(_PANELS)
        parts = -(-_TABLE_CELLS // panels.size)
        nodes = np.append((panels[:-1, None] + np.diff(panels)[:, None] * np.arange(parts) / parts).ravel(), panels[-1])
        u = nodes[:, None] ** 2
        w, dw = panel_rule(np.sqrt(np.maximum(panels**2 - u, 0.0)), 4)
        values = 2 * np.sum(radial(u + w * w) * dw, axis=1)
        # q is even: its derivative vanishes at 0.
        spline = CubicSpline(nodes, values, bc_type=("clamped", "not-a-knot"))
        return cls(lambda t: np.maximum(spline(t), 0.0), panels, radial.median_slope)

    def panels(self) -> Array:
        """Edges between which q and the kernels 1/√(1 + t²) are smooth."""
        return np.union1d(self.edges, _BENDS[self.edges[-1] > _BENDS])


@dataclass(frozen=True)
class LiuMasking:
    """Share S(θ, α) of a facet that its neighbour leaves visible, from a table of one slope density; accurate to 1e-6.

    With μ = cot θ, a = tan α and the slope t of the neighbour, of density q(t), S = 1 − E[min(1, κ (t − μ)⁺ / √(1 + t²))],
    κ = √(1 + a²) / (μ + a). Three tails of the density are tabulated, Q(t) = ∫_t^∞ q, A(t) = ∫_t^∞ q t/√(1 + t²) and
    B(t) = ∫_t^∞ q/√(1 + t²): S = 1 − Q(t_u) − κ [A(μ) − A(t_u) − μ (B(μ) − B(t_u))], t_u = tan(π − 2θ + α). Where a facet is seen
    nearly edge-on, the bracket loses its digits; there t_u ≈ μ and q is constant, so half of the facets between them are hidden.

    S does not vanish at grazing, where it stays above ½: the BRDF diverges as 1/cos θ.

    Source: Liu, Zhu & Wang 2015 (Opt. Express 23(17), 22788), with these misprints corrected: the upper limit is printed as
    π/2 − 2θ + α, which makes S negative; lower limits are −π/2; the local angle of incidence is ζ, in plane half of
    |θ_i + θ_r|. Blinn 1977; Torrance & Sparrow 1967 for the groove.
    """

    _tails: CubicHermiteSpline
    _scale: float

    @classmethod
    def of(cls, marginal: Marginal) -> LiuMasking:
        """The table of a density."""
        reach, scale = float(marginal.edges[-1]), min(marginal.scale, 1.0)
        even = scale * np.sinh(np.linspace(0, np.arcsinh(reach / scale), _TABLE_CELLS + 1))
        nodes = np.union1d(np.append(even[:-1], reach), marginal.panels())
        # Nodes closer than rounding would distort the spline and hold no probability.
        nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-9 * nodes[1:]])]
        t, dt = panel_rule(nodes, 4)
        cells = (_kernels(t) * marginal.density(t) * dt).reshape(3, -1, 4).sum(axis=-1)
        tails = np.concatenate([np.cumsum(cells[:, ::-1], axis=1)[:, ::-1], np.zeros((3, 1))], axis=1)
        slopes = -_kernels(nodes) * marginal.density(nodes)
        total = 2 * tails[0, 0]
        return cls(CubicHermiteSpline(nodes, tails.T / total, slopes.T / total), scale)

    def __call__(self, mu: ArrayLike, tilt: ArrayLike) -> Array:
        """S in [0, 1] at μ = cot θ >= 0 (infinite at the normal) and tan α of the tilt towards the direction, not checked.

        It is 0 where the facet faces away.
        """
        last = self._tails.x[-1]
        mu, tilt = np.broadcast_arrays(np.asarray(mu, dtype=float), np.asarray(tilt, dtype=float))
        near = np.minimum(mu, last)
        closing = np.clip(_closing_slope(near, tilt), near, last)
        at_closing = self._tails(closing)
        between = self._tails(near) - at_closing
        kappa = 1 / np.maximum((near + tilt) / np.sqrt(1 + tilt * tilt), _SMALLEST)
        partly = kappa * (between[..., 1] - near * between[..., 2])
        narrow = closing - near < _NARROW * (self._scale + near)
        partly = np.where(narrow & (closing < last), between[..., 0] / 2, partly)
        visible = 1 - at_closing[..., 0] - partly
        visible = np.where(mu < last, np.clip(visible, 0.0, 1.0), 1.0)
        return np.where(mu + tilt > 0, visible, 0.0)


def _closing_slope(mu: Array, tilt: Array) -> Array:
    """Slope t_u = tan(π − 2θ + α) of the neighbour that hides all of the facet; infinite if none does."""
    below = 1 - mu * mu - 2 * tilt * mu
    above = 2 * mu + tilt * (1 - mu * mu)
    return np.where(below > 0, above / np.where(below > 0, below, 1.0), np.inf)


def _kernels(t: Array) -> Array:
    """1, t/√(1 + t²) and 1/√(1 + t²), (3, …)."""
    secant = np.sqrt(1 + t * t)
    return np.stack([np.ones_like(t), t / secant, 1 / secant])


def tilts_towards(pair: HalfVector, phi_i: ArrayLike, phi_o: ArrayLike) -> tuple[Array, Array]:
    """tan α_w of the facet that mirrors ``i`` into ``o``, in the vertical planes of ``i`` and of ``o`` [1].

    Out of the plane of incidence a groove is cut by the vertical plane that holds the direction w. There a facet of normal m has
    the profile of tilt tan α_w = (m · e_w) / m_z, e_w the horizontal unit vector towards the direction; positive where the
    facet leans towards it. The facet faces the direction, w · m > 0, exactly where cos(θ − α_w) > 0, and in the plane of
    incidence α_w = ±α: the published formula.

    Parameters
    ----------
    pair : the directions, not both at the horizon
    phi_i, phi_o : their azimuths [degree]

    Notes
    -----
    tan α_i = (sin θ_i + sin θ_o cos Δφ) / (cos θ_i + cos θ_o), written as sin θ_i − sin θ_o + 2 sin θ_o cos²(Δφ/2), which does not
    cancel near the mirror direction.
    """
    turn = tan_half(np.asarray(phi_i, dtype=float) - phi_o)
    across, normal = 2 / (1 + turn * turn), pair.cos_i + pair.cos_o
    tilt_i = (pair.sin_i - pair.sin_o + pair.sin_o * across) / normal
    tilt_o = (pair.sin_o - pair.sin_i + pair.sin_i * across) / normal
    return tilt_i, tilt_o


def attenuation(pair: HalfVector, phi_i: ArrayLike, phi_o: ArrayLike, masking: LiuMasking) -> Array:
    """Geometrical attenuation g = min(S(θ_o, α_o), S(θ_i, α_i)) of the facet that mirrors ``i`` into ``o``, in [0, 1].

    Parameters
    ----------
    pair : the directions, above the horizon
    phi_i, phi_o : their azimuths [degree]
    masking : of the surface's slope density
    """
    tilt_i, tilt_o = tilts_towards(pair, phi_i, phi_o)
    mu_i, mu_o = cotangent(pair.cos_i, pair.sin_i), cotangent(pair.cos_o, pair.sin_o)
    return np.minimum(masking(mu_i, tilt_i), masking(mu_o, tilt_o))


class EnergyLimit(NamedTuple):
    """Incidence from which perfect mirrors with Liu's attenuation reflect more than they receive."""

    angle: float
    """Smallest incidence, to half a degree, with an albedo above 1.001; 90 if there is none [degree]."""
    albedo: float
    """Albedo of perfect mirrors at 85 degree [1]."""

    def __str__(self) -> str:
        excess = f"the albedo of perfect mirrors exceeds 1 from {self.angle:g}° on ({self.albedo:.2f} at 85°); "
        return (
            f"Liu's attenuation violates energy conservation at grazing: {excess if self.angle < 90 else ''}do not use this "
            f"model above {min(self.angle, TRUSTED):g}°, or set `model.masking: height-correlated`"
        )


def energy_limit(density: RadialDensity, masking: LiuMasking) -> EnergyLimit:
    """Smallest incidence at which the attenuation violates energy conservation."""
    theta = np.append(np.arange(0.5, 89.75, 0.5), 85.0)
    albedo = directional_albedo(density, masking, theta)
    beyond = np.flatnonzero(albedo[:-1] > 1.001)
    return EnergyLimit(float(theta[beyond[0]]) if beyond.size else 90.0, float(albedo[-1]))


def directional_albedo(density: RadialDensity, masking: LiuMasking, theta_i: Array) -> Array:
    """Albedo of perfect mirrors (R = 1) under Liu's attenuation [1], (incidences,).

    Parameters
    ----------
    density : isotropic slope density
    masking : of the same slopes
    theta_i : (incidences,) degree, above 0 and below 90

    Notes
    -----
    Over facets of slope (s, β from the direction of incidence on) that mirror upwards,
    E = ∫∫ P22 g (cos θ_i − s cos β sin θ_i) / cos θ_i s ds dβ; the horizon is s cos β = (1 − s²) cot θ_i / 2. The bends of
    g = min(…) limit the accuracy to 1e-4, enough to locate where E exceeds 1.
    """
    angle = np.radians(theta_i)
    cos_i, sin_i = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    enters = np.stack([np.tan(np.pi / 4 - angle / 2), np.tan(np.pi / 4 + angle / 2)], axis=1)
    panels = np.broadcast_to(density.panels(24), (angle.size, density.panels(24).size))
    edges = np.concatenate([panels, np.minimum(enters, density.slope[-1])], axis=1)
    s, ds = panel_rule(np.sort(edges, axis=1), 4)
    with np.errstate(divide="ignore"):
        horizon = np.arccos(np.clip((1 - s * s) / (2 * s * np.tan(angle)[:, None]), -1.0, 1.0))
    beta, d_beta = panel_rule(np.stack([horizon, np.full_like(horizon, np.pi)], axis=-1), 12)
    s = s[..., None]
    rise = s * np.cos(beta)
    towards = np.maximum(cos_i - rise * sin_i, 0.0)
    # w_o = 2 (w_i · m) m − w_i, and its horizontal part.
    scale = 2 * towards / (1 + s * s)
    cos_o = np.clip(scale - cos_i, _SMALLEST, 1.0)
    along, across = -scale * rise - sin_i, -scale * s * np.sin(beta)
    sin_o = np.maximum(np.hypot(along, across), _SMALLEST)
    tilt_o = -(rise * along + s * np.sin(beta) * across) / sin_o
    g = np.minimum(masking(cos_i / sin_i, -rise), masking(cos_o / sin_o, tilt_o))
    weight = 2 * density(s * s) * s * ds[..., None] * d_beta
    return np.asarray(np.sum(weight * g * towards / cos_i, axis=(1, 2)))

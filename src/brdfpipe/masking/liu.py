"""Liu's polarised geometrical attenuation: masking and shadowing by one neighbouring facet of random slope.

A facet of tilt α is one side of a groove; the other side has the slope t = tan γ, drawn from the density q(t) of slopes along the
line of sight, and its length. Seen at θ it hides |cos(γ + θ)| / cos(θ − α) of the facet, at most all of it. With μ = cot θ and
a = tan α the published factor,

    S = ∫_{−∞}^{μ} q dt + ∫_{μ}^{t_u} q [1 + cos(γ + θ) / cos(θ − α)] dt,    t_u = tan min(π − 2θ + α, π/2),

becomes S = 1 − E[min(1, κ (t − μ)⁺ / √(1 + t²))], κ = √(1 + a²) / (μ + a): the bracket vanishes exactly at t_u.

Out of the plane of incidence the groove is cut by the vertical plane that holds the direction. There a facet of normal m has the
profile of tilt tan α_w = (m · e_w) / m_z, e_w the horizontal unit vector towards the direction: positive where the facet leans
towards it. The facet faces the direction, w · m > 0, exactly where cos(θ − α_w) > 0, and in the plane of incidence α_w = ±α:
the published formula. Each direction has its own α_w, and g = min(S(θ_o, α_o), S(θ_i, α_i)).

**Known defect.** S does not vanish at grazing, where it stays above ½: the BRDF diverges as 1/cos θ and reflects more than it
receives (:func:`energy_limit`), 2.1 times as much at 85° for a slope rms of 0.5 per axis (2.2 if α enters for both directions
with its magnitude, as the source prints it, and q is that of the isotropic Gaussian). Use it to reproduce the source, not
above 70°.

References
----------
Liu, Zhu & Wang 2015 (Opt. Express 23(17), 22788), with these misprints corrected: the upper limit is printed as π/2 − 2θ + α, which makes
S negative; lower limits are −π/2; R for unpolarised light is ½(R_s + R_p); the local angle of incidence is ζ, in plane half of
|θ_i + θ_r|; |·|² for a complex index. Blinn 1977; Torrance & Sparrow 1967 for the groove.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import Array, check_angles, half_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking.smith import cotangent
from brdfpipe.optics.fresnel_equations import fresnel as fresnel_reflectance

TRUSTED = 70.0
"""Largest polar angle at which the attenuation can be trusted on any surface [degree]."""

_ORDER = 8
_CELLS = 1024
_PANELS = 512
_SMALLEST = 1e-300
# Below this ratio of a slope interval to the width of q, the table loses digits, and q is constant to 1e-4.
_NARROW = 1e-4
# κ (t − μ) bends on the scale of 1 for a density of any width.
_BENDS = 0.25 * 2.0 ** np.arange(8)


class Polarised(NamedTuple):
    """A quantity for light polarised across (s) and along (p) the plane of incidence of the facet, and for none."""

    s: Array
    p: Array
    unpolarised: Array


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
    def liu(cls, sigma: float) -> Marginal:
        """The density of the source, p(γ) = exp(−tan²γ / 2σ²) / (C cos³γ), hence q(t) = exp(−t² / 2σ²) √(1 + t²) / N.

        Parameters
        ----------
        sigma : slope rms σ, 1e-6 to 1e3 [1]

        Raises
        ------
        BrdfpipeError : σ out of range.

        Notes
        -----
        N = ½ e^z [K0(z) + K1(z)], z = 1 / 4σ², with Bessel functions scaled by e^z, which alone would overflow below σ = 0.02.
        """
        if not 1e-6 <= sigma <= 1e3:
            raise BrdfpipeError(f"the slope rms σ is {sigma:g}; accepted: 1e-6 to 1e3")
        norm = liu_norm(sigma)
        # Less than 1e-18 of the facets are beyond 9 σ.
        edges = sigma * np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0, 9.0])
        return cls(lambda t: np.exp(-0.5 * (t / sigma) ** 2) * np.sqrt(1 + t * t) / norm, edges, sigma)

    @classmethod
    def of(cls, radial: RadialDensity) -> Marginal:
        """The marginal q(t) = 2 ∫_0^∞ P22(√(t² + w²)) dw of an isotropic slope density, from a spline through its values.

        Between the density's nodes it is as good as they are: 1e-6 of its value for the named densities.
        """
        panels = radial.panels(_PANELS)
        parts = -(-_CELLS // panels.size)
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


def liu_norm(sigma: float) -> float:
    """N = ∫ exp(−t² / 2σ²) √(1 + t²) dt of the source's density; its constant is C = 2πσ² / N."""
    from scipy.special import k0e, k1e

    z = 1 / (4 * sigma * sigma)
    return float(k0e(z) + k1e(z)) / 2


def masking_factor(theta: ArrayLike, alpha: ArrayLike, marginal: Marginal) -> Array:
    """Share of a facet that its neighbour leaves visible, S(θ, α), by quadrature.

    Parameters
    ----------
    theta : polar angle of the direction, 0 to 90 [degree]
    alpha : tilt of the facet's normal towards the direction, −90 to 90 [degree], broadcastable
    marginal : density of slopes along the line of sight

    Returns
    -------
    [1], in [0, 1], of the broadcast shape; 0 where the facet faces away, θ − α >= 90

    Raises
    ------
    VocabularyError : an angle is out of range.

    Notes
    -----
    Gauss–Legendre between the marginal's own edges (±½σ … ±9σ for the source's density), μ and t_u: exact to 1e-12 for the
    source's density. For more than a few hundred directions take :class:`LiuMasking`.
    """
    theta, alpha = np.broadcast_arrays(check_angles("theta", theta, 0, 90), check_angles("alpha", alpha, -90, 90))
    mu, tilt = _slopes(theta, alpha)
    edges = marginal.panels()
    total = 2 * _integral(marginal, edges)
    mu = np.minimum(mu, edges[-1])[..., None]
    tilt = tilt[..., None]
    closing = np.minimum(_closing_slope(mu, tilt), edges[-1])
    split = np.concatenate([np.maximum(edges, mu), np.maximum(closing, mu)], axis=-1)
    t, dt = panel_rule(np.sort(split, axis=-1), _ORDER)
    hidden = np.minimum(_kappa(mu, tilt) * ((t - mu) / np.sqrt(1 + t * t)), 1.0)
    visible = 1 - np.sum(marginal.density(t) * hidden * dt, axis=-1) / total
    return np.where(theta - alpha < 90, np.clip(visible, 0.0, 1.0), 0.0)


def _slopes(theta: Array, alpha: Array) -> tuple[Array, Array]:
    """cot θ and tan α of angles in degree."""
    angle = np.radians(theta)
    cos = np.where(theta >= 90, 0.0, np.cos(angle))
    return cotangent(cos, np.sin(angle)), np.tan(np.radians(alpha))


def _kappa(mu: Array, tilt: Array) -> Array:
    """√(1 + a²) / (μ + a) = sin θ / cos(θ − α); a large finite value if the facet faces away."""
    return 1 / np.maximum((mu + tilt) / np.sqrt(1 + tilt * tilt), _SMALLEST)


def _closing_slope(mu: Array, tilt: Array) -> Array:
    """Slope t_u = tan(π − 2θ + α) of the neighbour that hides all of the facet; infinite if none does."""
    below = 1 - mu * mu - 2 * tilt * mu
    above = 2 * mu + tilt * (1 - mu * mu)
    return np.where(below > 0, above / np.where(below > 0, below, 1.0), np.inf)


def _integral(marginal: Marginal, edges: Array) -> float:
    t, dt = panel_rule(edges, _ORDER)
    return float(marginal.density(t) @ dt)


@dataclass(frozen=True)
class LiuMasking:
    """S(θ, α) of one slope density from a table, fast for many directions.

    Notes
    -----
    Between μ and t_u the factor is linear in three tails of the density, Q(t) = ∫_t^∞ q, A(t) = ∫_t^∞ q t/√(1 + t²) and
    B(t) = ∫_t^∞ q/√(1 + t²):

        S = 1 − Q(t_u) − κ [A(μ) − A(t_u) − μ (B(μ) − B(t_u))],

    so that one table over t serves every pair (θ, α). Their derivatives are known: the table is a cubic Hermite spline. Where the
    facet is seen nearly edge-on, κ grows without limit and the bracket loses its digits; there t_u is close to μ, q does not
    change in between, and what is hidden is half of the facets between them.
    """

    _tails: CubicHermiteSpline
    _scale: float

    @classmethod
    def of(cls, marginal: Marginal) -> LiuMasking:
        """The table of a density; S from it is that of :func:`masking_factor` to 1e-6."""
        reach, scale = float(marginal.edges[-1]), min(marginal.scale, 1.0)
        even = scale * np.sinh(np.linspace(0, np.arcsinh(reach / scale), _CELLS + 1))
        nodes = np.union1d(np.append(even[:-1], reach), marginal.panels())
        # Nodes closer than rounding would distort the spline and hold no probability.
        nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-9 * nodes[1:]])]
        t, dt = panel_rule(nodes, 4)
        cells = (_kernels(t) * marginal.density(t) * dt).reshape(3, -1, 4).sum(axis=-1)
        tails = np.concatenate([np.cumsum(cells[:, ::-1], axis=1)[:, ::-1], np.zeros((3, 1))], axis=1)
        slopes = -_kernels(nodes) * marginal.density(nodes)
        total = 2 * tails[0, 0]
        return cls(CubicHermiteSpline(nodes, tails.T / total, slopes.T / total), scale)

    def factor(self, theta: ArrayLike, alpha: ArrayLike) -> Array:
        """S(θ, α) as :func:`masking_factor`, from the table."""
        theta, alpha = check_angles("theta", theta, 0, 90), check_angles("alpha", alpha, -90, 90)
        return np.where(theta - alpha < 90, self(*_slopes(theta, alpha)), 0.0)

    def __call__(self, mu: ArrayLike, tilt: ArrayLike) -> Array:
        """S from μ = cot θ >= 0 (infinite at the normal) and the tangent of the tilt towards the direction, not checked."""
        last = self._tails.x[-1]
        mu, tilt = np.broadcast_arrays(np.asarray(mu, dtype=float), np.asarray(tilt, dtype=float))
        near = np.minimum(mu, last)
        closing = np.clip(_closing_slope(near, tilt), near, last)
        at_closing = self._tails(closing)
        between = self._tails(near) - at_closing
        partly = _kappa(near, tilt) * (between[..., 1] - near * between[..., 2])
        narrow = closing - near < _NARROW * (self._scale + near)
        partly = np.where(narrow & (closing < last), between[..., 0] / 2, partly)
        visible = 1 - at_closing[..., 0] - partly
        visible = np.where(mu < last, np.clip(visible, 0.0, 1.0), 1.0)
        return np.where(mu + tilt > 0, visible, 0.0)


def _kernels(t: Array) -> Array:
    """1, t/√(1 + t²) and 1/√(1 + t²), (3, …)."""
    secant = np.sqrt(1 + t * t)
    return np.stack([np.ones_like(t), t / secant, 1 / secant])


def tilts_towards(theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike) -> tuple[Array, Array]:
    """tan α_w of the facet that mirrors ``i`` into ``o``, in the vertical planes of ``i`` and of ``o`` [1].

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; 0 <= θ <= 90, not both 90

    Returns
    -------
    tan α_i = (sin θ_i + sin θ_o cos Δφ) / (cos θ_i + cos θ_o), positive where the facet leans towards ``i``, and tan α_o

    Notes
    -----
    Written as sin θ_i − sin θ_o + 2 sin θ_o cos²(Δφ/2), which does not cancel near the mirror direction.
    """
    theta_i, theta_o = np.radians(theta_i), np.radians(theta_o)
    half_difference = np.radians(np.asarray(phi_i, dtype=float) - phi_o) / 2
    normal = np.cos(theta_i) + np.cos(theta_o)
    difference = 2 * np.cos((theta_i + theta_o) / 2) * np.sin((theta_i - theta_o) / 2)
    turned = 2 * np.cos(half_difference) ** 2
    return (difference + np.sin(theta_o) * turned) / normal, (-difference + np.sin(theta_i) * turned) / normal


def attenuation(
    theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike, masking: LiuMasking
) -> Array:
    """Geometrical attenuation g = min(g_M(θ_o), g_S(θ_i)) of the facet that mirrors ``i`` into ``o``.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable; 0 <= θ < 90
    masking : of the surface's slope density

    Returns
    -------
    [1], in [0, 1]; the same with ``i`` and ``o`` exchanged. It does **not** vanish at grazing (module)

    Raises
    ------
    VocabularyError : an angle is out of range.

    References
    ----------
    Liu 2015, corrected; the projection of the tilt into the plane of each direction is the module's.
    """
    theta_i, theta_o = (
        check_angles(name, angle, 0, 90) for name, angle in (("theta_i", theta_i), ("theta_o", theta_o))
    )
    phi_i, phi_o = (check_angles(name, angle, -720, 720) for name, angle in (("phi_i", phi_i), ("phi_o", phi_o)))
    tilt_i, tilt_o = tilts_towards(theta_i, phi_i, theta_o, phi_o)
    mu_i, mu_o = _slopes(theta_i, np.zeros(()))[0], _slopes(theta_o, np.zeros(()))[0]
    return np.minimum(masking(mu_i, tilt_i), masking(mu_o, tilt_o))


def polarised_attenuation(
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    masking: LiuMasking,
    n: ArrayLike,
    k: ArrayLike = 0.0,
) -> Polarised:
    """Liu's polarised attenuation G_x = g R_x: the Fresnel reflectance is inside.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : (…) degree, broadcastable; 0 <= θ < 90
    masking : of the surface's slope density
    n, k : (wavelength,) or scalars; refractive index n + ik

    Returns
    -------
    G_s, G_p, G : (…, wavelength) [1], in [0, 1]; a scalar index counts as one wavelength

    Raises
    ------
    VocabularyError : an angle is out of range. BrdfpipeError : n <= 0, k < 0.
    """
    g = attenuation(theta_i, phi_i, theta_o, phi_o, masking)[..., None]
    cos_zeta = half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta
    fresnel = fresnel_reflectance(cos_zeta[..., None], np.atleast_1d(n), np.atleast_1d(k))
    return Polarised(g * fresnel.s, g * fresnel.p, g * fresnel.mean)


def brdf(
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    slope_density: Callable[[Array], Array],
    masking: LiuMasking,
    n: ArrayLike,
    k: ArrayLike = 0.0,
) -> Polarised:
    """Liu's polarised BRDF f_x = P22(tan α) G_x / (4 cos⁴α cos θ_i cos θ_o).

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : (…) degree, broadcastable; 0 <= θ < 90
    slope_density : P22 against s², a :class:`~brdfpipe.facets.radial_density.RadialDensity` or :func:`gaussian_slopes`
    masking : of the same slopes
    n, k : (wavelength,) or scalars; refractive index n + ik

    Returns
    -------
    f_s, f_p, f : (…, wavelength) [sr⁻¹]. With Gaussian slopes the factor is the source's (1/2π)(1/4σ²) exp(−tan²α / 2σ²)

    Raises
    ------
    VocabularyError : an angle is out of range. BrdfpipeError : n <= 0, k < 0.
    """
    half = half_vector(theta_i, phi_i, theta_o, phi_o)
    cosines = np.cos(np.radians(theta_i)) * np.cos(np.radians(theta_o))
    u = np.atleast_1d(half.slope_squared)
    shape_factor = (slope_density(u) * (1 + u) ** 2).reshape(half.slope_squared.shape) / (4 * cosines)
    attenuated = polarised_attenuation(theta_i, phi_i, theta_o, phi_o, masking, n, k)
    return Polarised(*(shape_factor[..., None] * component for component in attenuated))


def gaussian_slopes(sigma: float) -> Callable[[Array], Array]:
    """P22 = exp(−s² / 2σ²) / (2πσ²) against s², for a slope rms σ per axis."""
    return lambda slope_squared: np.exp(-0.5 * slope_squared / sigma**2) / (2 * np.pi * sigma**2)


class EnergyLimit(NamedTuple):
    """Incidence from which perfect mirrors with Liu's attenuation reflect more than they receive."""

    angle: float
    """Smallest incidence, to half a degree, with an albedo above 1.001; 90 if there is none [degree]."""
    albedo: float
    """Albedo of perfect mirrors at 85 degree [1]."""

    def __str__(self) -> str:
        excess = (
            f"the albedo of perfect mirrors exceeds 1 from {self.angle:g}° on ({self.albedo:.2f} at 85°); "
            if self.angle < 90
            else ""
        )
        return (
            f"Liu's attenuation violates energy conservation at grazing: {excess}do not use this model above {min(self.angle, TRUSTED):g}°, "
            "or set `model.masking: height-correlated`"
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
    enters = np.minimum(
        np.stack([np.tan(np.pi / 4 - angle / 2), np.tan(np.pi / 4 + angle / 2)], axis=1), density.slope[-1]
    )
    panels = np.broadcast_to(density.panels(24), (angle.size, density.panels(24).size))
    s, ds = panel_rule(np.sort(np.concatenate([panels, enters], axis=1), axis=1), 4)
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

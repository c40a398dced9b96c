"""Liu's attenuation: the printed values, arbitrary precision, the table against the quadrature, its known defect."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import samples
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import k0e, k1e

from brdfpipe import facets, hemisphere, masking, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import half_vector, unit_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking import liu
from brdfpipe.masking.smith import cotangent


def liu_norm(sigma: float) -> float:
    """N = ∫ exp(−t² / 2σ²) √(1 + t²) dt = ½ e^z [K0(z) + K1(z)], z = 1 / 4σ²; the source's constant is C = 2πσ² / N."""
    z = 1 / (4 * sigma * sigma)
    return (k0e(z) + k1e(z)) / 2


def liu_density(sigma: float) -> liu.Marginal:
    """The source's density p(γ) = exp(−tan²γ / 2σ²) / (C cos³γ), hence q(t) = exp(−t² / 2σ²) √(1 + t²) / N."""
    # Less than 1e-18 of the facets are beyond 9 σ.
    edges = sigma * np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0, 9.0])
    norm = liu_norm(sigma)
    return liu.Marginal(lambda t: np.exp(-0.5 * (t / sigma) ** 2) * np.sqrt(1 + t * t) / norm, edges, sigma)


def slopes_of(theta, alpha):
    """cot θ and tan α of angles in degree."""
    theta, alpha = np.broadcast_arrays(np.asarray(theta, dtype=float), np.asarray(alpha, dtype=float))
    cos = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
    return cotangent(cos, np.sin(np.radians(theta))), np.tan(np.radians(alpha))


def factor(table: liu.LiuMasking, theta, alpha):
    """S(θ, α) from the table."""
    return np.where(np.subtract(theta, alpha) < 90, table(*slopes_of(theta, alpha)), 0.0)


def masking_factor(theta, alpha, marginal: liu.Marginal):
    """S(θ, α) by Gauss–Legendre quadrature between the edges of the density, μ and t_u; 1e-12 for the source's density."""
    mu, tilt = slopes_of(theta, alpha)
    edges = marginal.panels()
    whole, weight = panel_rule(edges, 8)
    total = 2 * marginal.density(whole) @ weight
    mu, tilt = np.minimum(mu, edges[-1])[..., None], tilt[..., None]
    below = 1 - mu * mu - 2 * tilt * mu
    closing = np.where(below > 0, (2 * mu + tilt * (1 - mu * mu)) / np.where(below > 0, below, 1.0), edges[-1])
    closing = np.minimum(closing, edges[-1])
    split = np.concatenate([np.maximum(edges, mu), np.maximum(closing, mu)], axis=-1)
    t, dt = panel_rule(np.sort(split, axis=-1), 8)
    kappa = 1 / np.maximum((mu + tilt) / np.sqrt(1 + tilt * tilt), 1e-300)
    hidden = np.minimum(kappa * ((t - mu) / np.sqrt(1 + t * t)), 1.0)
    visible = 1 - np.sum(marginal.density(t) * hidden * dt, axis=-1) / total
    return np.where(np.subtract(theta, alpha) < 90, np.clip(visible, 0.0, 1.0), 0.0)


def gaussian_marginal(sigma: float) -> liu.Marginal:
    return liu.Marginal.of(RadialDensity.of(facets.analytic("beckmann", sigma * np.sqrt(2))))


def attenuation(theta_i, phi_i, theta_o, phi_o, table: liu.LiuMasking):
    return liu.attenuation(half_vector(theta_i, phi_i, theta_o, phi_o), phi_i, phi_o, table)


def ragged() -> RadialDensity:
    """A density as counted from few facets: noise of a third from node to node, a step and a hole."""
    slope = np.linspace(0.0, 0.6, 200)
    density = np.exp(-(slope**2) / 0.08 + 0.3 * np.random.default_rng(3).normal(size=slope.size))
    density[66:69] *= 20
    density[100:104] *= 1e-4
    return RadialDensity(slope, density)


DENSITIES = {
    "liu 1e-6": liu_density(1e-6),
    "liu 0.1": liu_density(0.1),
    "liu 0.5": liu_density(0.5),
    "liu 30": liu_density(30.0),
    "beckmann 1e-3": liu.Marginal.of(RadialDensity.of(facets.analytic("beckmann", 1e-3))),
    "beckmann 0.7": liu.Marginal.of(RadialDensity.of(facets.analytic("beckmann", 0.7))),
    "ggx 0.2": liu.Marginal.of(RadialDensity.of(facets.analytic("ggx", 0.2))),
    "ggx 10": liu.Marginal.of(RadialDensity.of(facets.analytic("ggx", 10.0))),
    "counted": liu.Marginal.of(ragged()),
}
TABLES = {name: liu.LiuMasking.of(marginal) for name, marginal in DENSITIES.items()}


def published(sigma: float, theta: float, alpha: float) -> float:
    """The printed integrals over γ with corrected limits, in 30 digits."""
    with mpmath.workdps(30):
        sigma, theta, alpha = mpmath.mpf(sigma), mpmath.radians(theta), mpmath.radians(alpha)
        if theta - alpha >= mpmath.pi / 2:
            return 0.0
        upper = min(mpmath.pi - 2 * theta + alpha, mpmath.pi / 2)
        first = mpmath.pi / 2 - theta
        marks = sorted({mpmath.atan(m * sigma) for m in (-12, -4, -1, 1, 4, 12)})

        def density(gamma):
            return mpmath.exp(-(mpmath.tan(gamma) ** 2) / (2 * sigma**2)) / mpmath.cos(gamma) ** 3

        def over(low, high, f):
            return mpmath.quad(f, [low, *(m for m in marks if low < m < high), high])

        end = mpmath.pi / 2 - mpmath.mpf("1e-25")
        total = over(-end, end, density)
        seen = over(-end, min(first, end), density)
        part = over(
            first,
            min(upper, end),
            lambda g: density(g) * (1 + mpmath.cos(g + theta) / mpmath.cos(theta - alpha)),
        )
        return float((seen + part) / total)


@pytest.mark.parametrize(("sigma", "printed"), [(0.1, 0.2494248), (0.25, 0.6084237), (0.5, 1.1298187)])
def test_the_constant_of_the_density_is_the_printed_one(sigma, printed):
    assert 2 * np.pi * sigma**2 / liu_norm(sigma) == pytest.approx(printed, abs=5.1e-8)


@pytest.mark.parametrize(
    ("sigma", "theta", "alpha", "printed"),
    [(0.25, 45, 0, 0.99999827), (0.25, 60, 0, 0.99850248), (0.25, 75, 0, 0.93704897), (0.5, 60, 15, 0.96604013)],
)
def test_the_factor_is_the_printed_one(sigma, theta, alpha, printed):
    marginal = liu_density(sigma)
    assert masking_factor(theta, alpha, marginal) == pytest.approx(printed, abs=5.1e-9)
    assert factor(liu.LiuMasking.of(marginal), theta, alpha) == pytest.approx(printed, abs=6e-9)


@pytest.mark.parametrize(
    ("sigma", "theta", "alpha"),
    [
        (0.25, 75, 0),
        (0.25, 80, -9),
        (0.5, 60, 15),
        (0.5, 89, 40),
        (0.5, 85, -4.9),
        (0.5, 30, -59),
        (2, 50, 30),
        (2, 20, -60),
        (0.05, 87, 2),
        (0.01, 89.5, -0.3),
        (1, 90, 20),
        (1, 45, 45),
    ],
)
def test_the_quadrature_has_the_digits_of_the_published_integrals(sigma, theta, alpha):
    # Panels of at most a slope rms with eight points each: 1e-12.
    factor = masking_factor(theta, alpha, liu_density(sigma))
    assert factor == pytest.approx(published(sigma, theta, alpha), abs=1e-11)


@given(theta=st.floats(0, 90), alpha=st.floats(-90, 90), name=st.sampled_from(sorted(DENSITIES)))
@settings(max_examples=300, deadline=None)
def test_the_table_agrees_with_the_quadrature(theta, alpha, name):
    exact = float(masking_factor(theta, alpha, DENSITIES[name]))
    assert 0 <= exact <= 1
    assert factor(TABLES[name], theta, alpha) == pytest.approx(exact, abs=1e-6)


@given(
    reach=st.floats(0.01, 6), lean=st.floats(-3, 3), edge_on=st.floats(-12, 1), name=st.sampled_from(sorted(DENSITIES))
)
@settings(max_examples=200, deadline=None)
def test_the_table_agrees_with_the_quadrature_at_typical_slopes_and_edge_on(reach, lean, edge_on, name):
    scale = DENSITIES[name].scale
    theta = np.degrees(np.arctan2(1.0, scale * reach))
    for alpha in (np.degrees(np.arctan(scale * lean)), max(theta - 90 + 10**edge_on, -90.0)):
        exact = float(masking_factor(theta, min(alpha, 90.0), DENSITIES[name]))
        assert factor(TABLES[name], theta, min(alpha, 90.0)) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize(("distribution", "a"), [("beckmann", 0.3), ("ggx", 0.3)])
def test_the_marginal_of_a_radial_density_is_its_closed_form(distribution, a):
    t = a * np.array([0.0, 0.1, 0.5, 1.0, 2.0, 4.0])
    closed = (
        np.exp(-((t / a) ** 2)) / (np.sqrt(np.pi) * a)
        if distribution == "beckmann"
        else a**2 / 2 / (a**2 + t**2) ** 1.5
    )
    density = liu.Marginal.of(RadialDensity.of(facets.analytic(distribution, a))).density(t)
    # The tabulated density is itself good to 1e-6 of its value.
    assert density == pytest.approx(closed, rel=2e-6)


def test_a_density_need_not_be_normalised():
    one = DENSITIES["liu 0.5"]
    twice = liu.Marginal(lambda t: 2 * one.density(t), one.edges, one.scale)
    expected = pytest.approx(masking_factor(75.0, 5.0, one), abs=1e-14)
    assert masking_factor(75.0, 5.0, twice) == expected
    assert factor(liu.LiuMasking.of(twice), 75.0, 5.0) == pytest.approx(factor(TABLES["liu 0.5"], 75.0, 5.0), abs=1e-14)


def test_a_facet_that_faces_away_is_not_seen():
    theta, alpha = [80.0, 60.0, 90.0], [-10.1, -45.0, -0.1]
    assert TABLES["liu 0.5"](*slopes_of(theta, alpha)) == pytest.approx(np.zeros(3), abs=0)


def test_no_facet_is_masked_at_normal_incidence():
    for name in DENSITIES:
        assert factor(TABLES[name], 0.0, [-89.0, -20.0, 0.0, 70.0]) == pytest.approx(np.ones(4), abs=0)
        assert masking_factor(0.0, [-89.0, 0.0, 70.0], DENSITIES[name]) == pytest.approx(np.ones(3), abs=1e-15)


def test_a_nearly_flat_surface_masks_nothing_and_a_steep_one_has_a_finite_factor():
    assert factor(TABLES["liu 1e-6"], 89.9, 0.0) == 1.0
    steep = masking_factor([10.0, 60.0, 89.0], [0.0, 30.0, -0.5], liu_density(1e3))
    # Half of the neighbours lean away; of the rest nearly all stand upright.
    assert (steep >= 0.5).all()
    assert steep[0] == pytest.approx(1 - np.tan(np.radians(10)) / 2, abs=1e-3)


@given(theta_i=st.floats(0, 89.9), theta_o=st.floats(0, 89.9), turn=st.floats(-300, 300))
@settings(max_examples=60, deadline=None)
def test_in_the_plane_of_incidence_the_attenuation_is_the_published_one(theta_i, theta_o, turn):
    table = TABLES["liu 0.5"]
    alpha = (theta_i - theta_o) / 2  # the mirror between both leans towards the one that is closer to grazing
    expected = min(factor(table, theta_i, alpha), factor(table, theta_o, -alpha))
    # Near edge-on facets rounding of the angles is amplified by the width of the table's narrow band, 1e4.
    assert attenuation(theta_i, turn, theta_o, turn + 180, table) == pytest.approx(expected, abs=1e-9)


@given(theta_i=st.floats(0, 89), theta_o=st.floats(0, 89), phi_i=st.floats(-180, 180), phi_o=st.floats(-180, 180))
@settings(max_examples=60, deadline=None)
def test_the_tilt_towards_a_direction_is_that_of_the_profile_in_its_vertical_plane(theta_i, phi_i, theta_o, phi_o):
    middle = unit_vector(theta_i, phi_i) + unit_vector(theta_o, phi_o)
    tilts = liu.tilts_towards(half_vector(theta_i, phi_i, theta_o, phi_o), phi_i, phi_o)
    for tilt, theta, phi in zip(tilts, (theta_i, theta_o), (phi_i, phi_o), strict=True):
        assert tilt == pytest.approx(middle @ unit_vector(90.0, phi) / middle[2], abs=1e-12)
        # The profile faces the direction just as the facet does: both cosines have one sign.
        across = middle @ unit_vector(90.0, phi + 90)
        cos_zeta = half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta
        profile = np.cos(np.radians(theta) - np.arctan(tilt)) * np.sqrt(middle @ middle - across**2)
        assert profile == pytest.approx(cos_zeta * np.linalg.norm(middle), abs=1e-12)


@given(theta_i=st.floats(0, 89.99), theta_o=st.floats(0, 89.99), phi=st.floats(-360, 360))
@settings(max_examples=100, deadline=None)
def test_the_attenuation_is_reciprocal_and_a_share(theta_i, theta_o, phi):
    forward = attenuation(theta_i, 0.0, theta_o, phi, TABLES["ggx 0.2"])
    assert 0 <= forward <= 1
    assert attenuation(theta_o, phi, theta_i, 0.0, TABLES["ggx 0.2"]) == pytest.approx(forward, abs=1e-12)


def liu_bsdf(sigma: float, n) -> xr.Dataset:
    """Microfacet BSDF under Liu's attenuation; built with another masking, whose energy balance is faster."""
    bsdf = microfacet.build(
        samples.beckmann(sigma * np.sqrt(2)), index=optics.refractive_index(n), multiple_scattering="none"
    )
    return bsdf.assign_attrs(masking="liu")


def in_plane(sigma: float, n, theta_i: float, theta_o: float):
    """f_s, f_p and f of the microfacet BRDF under Liu's attenuation, in the plane of incidence, at one wavelength."""
    bsdf = liu_bsdf(sigma, n)
    matrix = bsdf.bsdf.mueller(theta_i, 10.0, theta_o, 190.0).values.reshape(-1, 4, 4)[0]
    return matrix[0, 0] + matrix[0, 1], matrix[0, 0] - matrix[0, 1], matrix[0, 0]


def mirrors(sigma: float, theta_i, phi_i, theta_o, phi_o):
    """The source's BRDF without g and R: (1/2π)(1/4σ²) exp(−tan²α / 2σ²) / (cos⁴α cos θ_i cos θ_o)."""
    u = half_vector(theta_i, phi_i, theta_o, phi_o).slope_squared
    cosines = np.cos(np.radians(theta_i)) * np.cos(np.radians(theta_o))
    return np.exp(-u / (2 * sigma**2)) * (1 + u) ** 2 / (8 * np.pi * sigma**2 * cosines)


def test_the_brdf_of_polarised_light_has_the_reflectances_of_the_source():
    reflectance = np.array(in_plane(0.1, 1.8, 60.0, 60.0)) / mirrors(0.1, 60.0, 10.0, 60.0, 190.0)
    # R_s, R_p and their mean at 60°, n = 1.8; at σ = 0.1 the mirror facet is whole to 1e-9.
    assert reflectance == pytest.approx([0.26911389, 0.00017270, 0.13464330], abs=5.1e-9)


def test_a_metal_is_attenuated_by_the_modulus_of_its_amplitudes():
    metal = {"n": 0.2, "k": 3.4}
    bsdf, pair = liu_bsdf(0.5, metal), half_vector(50.0, 10.0, 70.0, 190.0)
    surface, u = Microsurface.of(bsdf), pair.slope_squared
    g = attenuation(50.0, 10.0, 70.0, 190.0, surface.liu)
    mirror = surface.density(u) * (1 + u) ** 2 / (4 * pair.cos_i * pair.cos_o)
    reflected = in_plane(0.5, metal, 50.0, 70.0)
    q = np.sqrt((0.2 + 3.4j) ** 2 - 1 + pair.cos_zeta**2)
    sin2 = 1 - pair.cos_zeta**2
    r_s = (pair.cos_zeta - q) / (pair.cos_zeta + q)
    r_p = r_s * (pair.cos_zeta * q - sin2) / (pair.cos_zeta * q + sin2)
    assert reflected[:2] == pytest.approx([mirror * g * abs(r_s) ** 2, mirror * g * abs(r_p) ** 2], rel=1e-13)
    unpolarised = bsdf.bsdf.evaluate(50.0, 10.0, 70.0, 190.0).values.ravel()[0]
    assert unpolarised == pytest.approx((reflected[0] + reflected[1]) / 2, rel=1e-14)
    # The tabulated density is good to 1e-6 of its value.
    assert mirror == pytest.approx(mirrors(0.5, 50.0, 10.0, 70.0, 190.0), rel=1e-6)


def test_the_attenuation_is_the_smaller_of_the_published_factors():
    g = min(published(0.25, 50, -7), published(0.25, 64, 7))
    assert attenuation(50.0, 10.0, 64.0, 190.0, liu.LiuMasking.of(liu_density(0.25))) == pytest.approx(g, abs=1e-7)


def test_the_brdf_has_the_constants_of_the_source():
    alpha, zeta = (64 - 50) / 2, np.radians(50 + 64) / 2
    marginal = gaussian_marginal(0.25)
    g = min(masking_factor(50.0, -alpha, marginal), masking_factor(64.0, alpha, marginal))
    fresnel = optics.fresnel(np.cos(zeta), 1.55)
    expected = mirrors(0.25, 50.0, 10.0, 64.0, 190.0) * g * np.array([fresnel.s, fresnel.p, fresnel.mean])
    assert in_plane(0.25, 1.55, 50.0, 64.0) == pytest.approx(expected, rel=1e-7)  # the tables of density and masking


def test_the_factor_does_not_vanish_at_grazing():
    # The known defect: half of the neighbours lean away, and hide nothing.
    for name in DENSITIES:
        assert factor(TABLES[name], 90.0, [0.01, 1.0, 30.0]).min() >= 0.5 - 1e-9


@pytest.mark.parametrize(("sigma", "theta"), [(0.5, 85.0), (0.3, 70.0), (0.1, 85.0)])
def test_the_albedo_of_mirrors_is_the_integral_over_outgoing_directions(sigma, theta):
    table, beckmann = liu.LiuMasking.of(liu_density(sigma)), facets.analytic("beckmann", sigma * np.sqrt(2))
    rule = hemisphere.around_mirror(theta, sigma, order=8, turns=40)
    f = mirrors(sigma, theta, 0.0, rule.theta, rule.phi) * attenuation(theta, 0.0, rule.theta, rule.phi, table)
    albedo = liu.directional_albedo(RadialDensity.of(beckmann), table, np.array([theta]))
    # Both rules meet the bends of min(…).
    assert albedo == pytest.approx(rule.weight @ f, rel=3e-4)


def test_the_angle_from_which_energy_is_not_conserved_is_named():
    limits = {}
    for sigma in (0.02, 0.1, 0.3, 0.5):
        density = RadialDensity.of(facets.analytic("beckmann", sigma * np.sqrt(2)))
        limits[sigma] = liu.energy_limit(density, liu.LiuMasking.of(liu.Marginal.of(density)))
    # 2.2 if α enters unsigned for both directions; 2.13 with the tilt towards each.
    assert limits[0.5].albedo == pytest.approx(2.127, abs=2e-3)
    assert limits[0.02].angle > limits[0.1].angle > limits[0.3].angle > limits[0.5].angle
    assert limits[0.5].angle == pytest.approx(69, abs=0.5)
    assert "2.13" in str(limits[0.5])
    assert "above 69°" in str(limits[0.5])
    assert "above 70°" in str(limits[0.1])
    assert "mirrors" not in str(liu.EnergyLimit(90.0, 1.0))


def test_directions_and_wavelengths_broadcast():
    theta_o = np.linspace(0, 80, 5)
    ggx = facets.analytic("ggx", 0.2)
    visible = masking.g2(ggx, 30.0, 0.0, theta_o, 170.0, mode="liu")
    assert visible.shape == (5,)
    assert float(masking.g2(ggx, 30.0, 0.0, theta_o[3], 170.0, mode="liu")) == pytest.approx(
        float(visible[3]), rel=1e-13
    )
    n, k = ("wavelength", [1.5, 1.6, 0.3]), ("wavelength", [0.0, 0.0, 2.0])
    metal = liu_bsdf(0.2, 1.6).assign_coords(wavelength=[400.0, 500.0, 700.0]).assign(n=n, k=k)
    values = metal.bsdf.evaluate(30.0, 0.0, theta_o, 170.0)
    assert values.sizes == {"direction": 5, "wavelength": 3}
    alone = liu_bsdf(0.2, 1.6).bsdf.evaluate(30.0, 0.0, theta_o[3], 170.0).values.ravel()
    assert alone == pytest.approx(values.values[3, 1:2], rel=1e-13)


@pytest.mark.parametrize("angle", ["theta_i", "theta_o"])
@pytest.mark.parametrize("theta", [-1.0, 91.0, 100.0, np.nan])
def test_polar_angles_out_of_range_are_refused(angle, theta):
    angles = {"theta_i": 10.0, "phi_i": 0.0, "theta_o": 10.0, "phi_o": 0.0, angle: theta}
    with pytest.raises(VocabularyError, match=angle):
        masking.g2(facets.analytic("beckmann", 0.3), **angles, mode="liu")

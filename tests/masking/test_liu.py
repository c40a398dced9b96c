"""Liu's polarised attenuation: the printed values, arbitrary precision, the table against the quadrature, its known defect."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, hemisphere, optics
from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.geometry import half_vector, unit_vector
from brdfpipe.masking import liu


def ragged() -> RadialDensity:
    """A density as counted from few facets: noise of a third from node to node, a step and a hole."""
    slope = np.linspace(0.0, 0.6, 200)
    density = np.exp(-(slope**2) / 0.08 + 0.3 * np.random.default_rng(3).normal(size=slope.size))
    density[66:69] *= 20
    density[100:104] *= 1e-4
    return RadialDensity(slope, density)


DENSITIES = {
    "liu 1e-6": liu.Marginal.liu(1e-6),
    "liu 0.1": liu.Marginal.liu(0.1),
    "liu 0.5": liu.Marginal.liu(0.5),
    "liu 30": liu.Marginal.liu(30.0),
    "beckmann 1e-3": liu.Marginal.of(RadialDensity.of(facets.analytic("beckmann", 1e-3))),
    "beckmann 0.7": liu.Marginal.of(RadialDensity.of(facets.analytic("beckmann", 0.7))),
    "ggx 0.2": liu.Marginal.of(RadialDensity.of(facets.analytic("ggx", 0.2))),
    "ggx 10": liu.Marginal.of(RadialDensity.of(facets.analytic("ggx", 10.0))),
    "counted": liu.Marginal.of(ragged()),
}
TABLES = {name: liu.LiuMasking.of(marginal) for name, marginal in DENSITIES.items()}


def published(sigma: float, theta: float, alpha: float) -> float:
    """The printed integrals over γ with the mended limits (PHYSICS §5), in 30 digits."""
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
    assert 2 * np.pi * sigma**2 / liu.liu_norm(sigma) == pytest.approx(printed, abs=5.1e-8)


@pytest.mark.parametrize(
    ("sigma", "theta", "alpha", "printed"),
    [(0.25, 45, 0, 0.99999827), (0.25, 60, 0, 0.99850248), (0.25, 75, 0, 0.93704897), (0.5, 60, 15, 0.96604013)],
)
def test_the_factor_is_the_printed_one(sigma, theta, alpha, printed):
    marginal = liu.Marginal.liu(sigma)
    assert liu.masking_factor(theta, alpha, marginal) == pytest.approx(printed, abs=5.1e-9)
    assert liu.LiuMasking.of(marginal).factor(theta, alpha) == pytest.approx(printed, abs=6e-9)


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
    found = liu.masking_factor(theta, alpha, liu.Marginal.liu(sigma))
    assert found == pytest.approx(published(sigma, theta, alpha), abs=1e-11)


@given(theta=st.floats(0, 90), alpha=st.floats(-90, 90), name=st.sampled_from(sorted(DENSITIES)))
@settings(max_examples=300, deadline=None)
def test_the_table_is_the_quadrature_and_a_share(theta, alpha, name):
    exact = float(liu.masking_factor(theta, alpha, DENSITIES[name]))
    assert 0 <= exact <= 1
    assert TABLES[name].factor(theta, alpha) == pytest.approx(exact, abs=1e-6)


@given(
    reach=st.floats(0.01, 6), lean=st.floats(-3, 3), edge_on=st.floats(-12, 1), name=st.sampled_from(sorted(DENSITIES))
)
@settings(max_examples=200, deadline=None)
def test_the_table_is_the_quadrature_where_the_density_lies_and_for_facets_seen_edge_on(reach, lean, edge_on, name):
    scale = DENSITIES[name].scale
    theta = np.degrees(np.arctan2(1.0, scale * reach))
    for alpha in (np.degrees(np.arctan(scale * lean)), max(theta - 90 + 10**edge_on, -90.0)):
        exact = float(liu.masking_factor(theta, min(alpha, 90.0), DENSITIES[name]))
        assert TABLES[name].factor(theta, min(alpha, 90.0)) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize(("distribution", "a"), [("beckmann", 0.3), ("ggx", 0.3)])
def test_the_marginal_of_a_radial_density_is_its_closed_form(distribution, a):
    t = a * np.array([0.0, 0.1, 0.5, 1.0, 2.0, 4.0])
    closed = (
        np.exp(-((t / a) ** 2)) / (np.sqrt(np.pi) * a)
        if distribution == "beckmann"
        else a**2 / 2 / (a**2 + t**2) ** 1.5
    )
    found = liu.Marginal.of(RadialDensity.of(facets.analytic(distribution, a))).density(t)
    # The tabulated density is itself good to 1e-6 of its value.
    assert found == pytest.approx(closed, rel=2e-6)


def test_a_density_need_not_be_normalised():
    one = DENSITIES["liu 0.5"]
    twice = liu.Marginal(lambda t: 2 * one.density(t), one.edges, one.scale)
    expected = pytest.approx(liu.masking_factor(75.0, 5.0, one), abs=1e-14)
    assert liu.masking_factor(75.0, 5.0, twice) == expected
    assert liu.LiuMasking.of(twice).factor(75.0, 5.0) == pytest.approx(TABLES["liu 0.5"].factor(75.0, 5.0), abs=1e-14)


def test_a_facet_that_faces_away_is_not_seen():
    for factor in (TABLES["liu 0.5"].factor, lambda *angles: liu.masking_factor(*angles, DENSITIES["liu 0.5"])):
        assert factor([80.0, 60.0, 90.0], [-10.1, -45.0, -0.1]) == pytest.approx(np.zeros(3), abs=0)


def test_seen_from_above_every_facet_is_whole():
    for name in DENSITIES:
        assert TABLES[name].factor(0.0, [-89.0, -20.0, 0.0, 70.0]) == pytest.approx(np.ones(4), abs=0)
        assert liu.masking_factor(0.0, [-89.0, 0.0, 70.0], DENSITIES[name]) == pytest.approx(np.ones(3), abs=1e-15)


def test_a_nearly_flat_surface_hides_nothing_and_a_steep_one_still_has_a_factor():
    assert TABLES["liu 1e-6"].factor(89.9, 0.0) == 1.0
    steep = liu.masking_factor([10.0, 60.0, 89.0], [0.0, 30.0, -0.5], liu.Marginal.liu(1e3))
    # Half of the neighbours lean away; of the rest nearly all stand upright.
    assert (steep >= 0.5).all()
    assert steep[0] == pytest.approx(1 - np.tan(np.radians(10)) / 2, abs=1e-3)


@given(theta_i=st.floats(0, 89.9), theta_o=st.floats(0, 89.9), turn=st.floats(-300, 300))
@settings(max_examples=60, deadline=None)
def test_in_the_plane_of_incidence_the_attenuation_is_the_published_one(theta_i, theta_o, turn):
    table = TABLES["liu 0.5"]
    alpha = (theta_i - theta_o) / 2  # the mirror between both leans towards the one that is closer to grazing
    expected = min(table.factor(theta_i, alpha), table.factor(theta_o, -alpha))
    # Near edge-on facets rounding of the angles is amplified by the width of the table's narrow band, 1e4.
    assert liu.attenuation(theta_i, turn, theta_o, turn + 180, table) == pytest.approx(expected, abs=1e-9)


@given(theta_i=st.floats(0, 89), theta_o=st.floats(0, 89), phi_i=st.floats(-180, 180), phi_o=st.floats(-180, 180))
@settings(max_examples=60, deadline=None)
def test_the_tilt_towards_a_direction_is_that_of_the_facets_profile_in_its_vertical_plane(
    theta_i, phi_i, theta_o, phi_o
):
    middle = unit_vector(theta_i, phi_i) + unit_vector(theta_o, phi_o)
    found = liu.tilts_towards(theta_i, phi_i, theta_o, phi_o)
    for tilt, theta, phi in zip(found, (theta_i, theta_o), (phi_i, phi_o), strict=True):
        assert tilt == pytest.approx(middle @ unit_vector(90.0, phi) / middle[2], abs=1e-12)
        # The profile faces the direction just as the facet does: both cosines have one sign.
        across = middle @ unit_vector(90.0, phi + 90)
        cos_zeta = half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta
        profile = np.cos(np.radians(theta) - np.arctan(tilt)) * np.sqrt(middle @ middle - across**2)
        assert profile == pytest.approx(cos_zeta * np.linalg.norm(middle), abs=1e-12)


@given(theta_i=st.floats(0, 89.99), theta_o=st.floats(0, 89.99), phi=st.floats(-360, 360))
@settings(max_examples=100, deadline=None)
def test_the_attenuation_is_reciprocal_and_a_share(theta_i, theta_o, phi):
    forward = liu.attenuation(theta_i, 0.0, theta_o, phi, TABLES["ggx 0.2"])
    assert 0 <= forward <= 1
    assert liu.attenuation(theta_o, phi, theta_i, 0.0, TABLES["ggx 0.2"]) == pytest.approx(forward, abs=1e-12)


def test_the_polarised_attenuation_holds_the_reflectances_of_the_source():
    found = liu.polarised_attenuation(60.0, 0.0, 60.0, 180.0, TABLES["liu 0.1"], 1.8)
    # PHYSICS §5: R at 60°, n = 1.8; at σ = 0.1 the mirror facet is whole to 1e-9.
    assert found.s[0] == pytest.approx(0.26911389, abs=5.1e-9)
    assert found.p[0] == pytest.approx(0.00017270, abs=5.1e-9)
    assert found.unpolarised[0] == pytest.approx(0.13464330, abs=5.1e-9)


def test_a_metal_is_attenuated_by_the_modulus_of_its_amplitudes():
    g = liu.attenuation(50.0, 0.0, 70.0, 160.0, TABLES["liu 0.5"])
    cos_zeta = half_vector(50.0, 0.0, 70.0, 160.0).cos_zeta
    found = liu.polarised_attenuation(50.0, 0.0, 70.0, 160.0, TABLES["liu 0.5"], 0.2, 3.4)
    q = np.sqrt((0.2 + 3.4j) ** 2 - 1 + cos_zeta**2)
    assert found.s[0] == pytest.approx(g * abs((cos_zeta - q) / (cos_zeta + q)) ** 2, rel=1e-13)


def test_the_brdf_has_the_constants_of_the_source():
    sigma, theta_i, theta_o = 0.25, np.radians(50), np.radians(64)
    alpha, zeta = (theta_o - theta_i) / 2, (theta_i + theta_o) / 2
    masking = liu.LiuMasking.of(liu.Marginal.liu(sigma))
    g = min(published(sigma, 50, -7), published(sigma, 64, 7))
    constant = 1 / (2 * np.pi) / (4 * sigma**2) / np.cos(alpha) ** 4 / (np.cos(theta_i) * np.cos(theta_o))
    expected = constant * np.exp(-(np.tan(alpha) ** 2) / (2 * sigma**2)) * g * optics.fresnel(np.cos(zeta), 1.55).s
    for density in (liu.gaussian_slopes(sigma), RadialDensity.of(facets.analytic("beckmann", sigma * np.sqrt(2)))):
        found = liu.brdf(50.0, 10.0, 64.0, 190.0, density, masking, 1.55)
        assert found.s[0] == pytest.approx(expected, rel=1e-7)  # the tables of density and masking
        assert found.unpolarised == pytest.approx((found.s + found.p) / 2, rel=1e-14)


def test_directions_and_wavelengths_broadcast():
    theta_o = np.linspace(0, 80, 5)
    density = RadialDensity.of(facets.analytic("ggx", 0.2))
    found = liu.brdf(30.0, 0.0, theta_o, 170.0, density, TABLES["ggx 0.2"], [1.5, 1.6, 0.3], [0.0, 0.0, 2.0])
    assert found.p.shape == (5, 3)
    alone = liu.brdf(30.0, 0.0, theta_o[3], 170.0, density, TABLES["ggx 0.2"], 1.6)
    assert alone.p == pytest.approx(found.p[3, 1:2], rel=1e-13)


def test_the_factor_does_not_vanish_at_grazing():
    # The known defect: half of the neighbours lean away, and hide nothing.
    for name in DENSITIES:
        assert TABLES[name].factor(90.0, [0.01, 1.0, 30.0]).min() >= 0.5 - 1e-9


@pytest.mark.parametrize(("sigma", "theta"), [(0.5, 85.0), (0.3, 70.0), (0.1, 85.0)])
def test_the_albedo_of_mirrors_is_the_integral_over_outgoing_directions(sigma, theta):
    masking, beckmann = liu.LiuMasking.of(liu.Marginal.liu(sigma)), facets.analytic("beckmann", sigma * np.sqrt(2))
    rule = hemisphere.around_mirror(theta, sigma, order=8, turns=40)
    f = liu.brdf(theta, 0.0, rule.theta, rule.phi, liu.gaussian_slopes(sigma), masking, np.inf).unpolarised[:, 0]
    found = liu.directional_albedo(RadialDensity.of(beckmann), masking, np.array([theta]))
    # Both rules meet the bends of min(…).
    assert found == pytest.approx(rule.weight @ f, rel=3e-4)


def test_the_loss_of_energy_conservation_is_named_with_its_angle():
    found = {}
    for sigma in (0.02, 0.1, 0.3, 0.5):
        density = RadialDensity.of(facets.analytic("beckmann", sigma * np.sqrt(2)))
        found[sigma] = liu.energy_limit(density, liu.LiuMasking.of(liu.Marginal.of(density)))
    # 2.2 in PHYSICS §5, where α enters unsigned for both directions; 2.13 with the tilt towards each.
    assert found[0.5].albedo == pytest.approx(2.127, abs=2e-3)
    assert found[0.02].angle > found[0.1].angle > found[0.3].angle > found[0.5].angle
    assert found[0.5].angle == pytest.approx(69, abs=0.5)
    assert "2.13" in str(found[0.5])
    assert "above 69°" in str(found[0.5])
    assert "above 70°" in str(found[0.1])
    assert "mirrors" not in str(liu.EnergyLimit(90.0, 1.0))


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf, 1e4])
def test_a_slope_rms_out_of_range_is_refused(sigma):
    with pytest.raises(BrdfpipeError, match="slope rms"):
        liu.Marginal.liu(sigma)


def test_angles_out_of_range_are_refused():
    with pytest.raises(VocabularyError, match="theta"):
        liu.masking_factor(91.0, 0.0, DENSITIES["liu 0.5"])
    with pytest.raises(VocabularyError, match="alpha"):
        TABLES["liu 0.5"].factor(10.0, 95.0)
    with pytest.raises(VocabularyError, match="theta_o"):
        liu.attenuation(10.0, 0.0, 100.0, 0.0, TABLES["liu 0.5"])

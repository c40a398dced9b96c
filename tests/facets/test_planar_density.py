"""The slope density of a surface with a lay: the same whichever way it is turned, however narrow its ellipse."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from brdfpipe import facets, masking
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity, SlopeAxis, smith_lambda

ratios = st.floats(0.01, 100)
azimuths = st.floats(-360, 360)
THETA = np.array([30.0, 60.0, 80.0, 89.0, 89.9])[:, None]


def exact(distribution, a_x, a_y, azimuth, p, q):
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    u = ((p * cos + q * sin) / a_x) ** 2 + ((q * cos - p * sin) / a_y) ** 2
    return (np.exp(-u) if distribution == "beckmann" else 1 / (1 + u) ** 2) / (np.pi * a_x * a_y)


@pytest.mark.cases(1)
@pytest.mark.parametrize(("distribution", "limit"), [("beckmann", 1e-6), ("ggx", 1e-5)])
@given(a_y=st.floats(1e-4, 0.1), ratio=ratios, azimuth=azimuths)
@settings(max_examples=8, deadline=None)
def test_any_ellipse_is_normalised_positive_and_has_its_azimuth(distribution, limit, a_y, ratio, azimuth):
    table = facets.analytic(distribution, a_x=ratio * a_y, a_y=a_y, azimuth=azimuth)
    density = PlanarDensity.of(table)
    weight = density.rule()[2]
    assert weight.sum() == pytest.approx(1, abs=limit)
    assert (weight > 0).all()
    assert (table["lambda_smith"] >= 0).all()
    assert float(table["anisotropy"]) == pytest.approx(max(ratio, 1 / ratio))
    assert 0 <= density.azimuth < 180
    smaller = azimuth + (90 if ratio > 1 else 0)
    assert np.sin(np.radians(density.azimuth - smaller)) == pytest.approx(0, abs=1e-9)


@given(ratio=ratios, azimuth=azimuths)
@settings(max_examples=10, deadline=None)
def test_turning_a_surface_turns_its_masking(ratio, azimuth):
    phi = np.linspace(0, 360, 37) + 0.7
    still = facets.analytic("beckmann", a_x=0.3 * ratio**0.5, a_y=0.3 / ratio**0.5)
    turned = facets.analytic("beckmann", a_x=0.3 * ratio**0.5, a_y=0.3 / ratio**0.5, azimuth=azimuth)
    expected = masking.g1(still, THETA, phi).values
    visible = masking.g1(turned, THETA, (phi + azimuth) % 360).values
    assert visible == pytest.approx(expected, abs=1e-6)


@pytest.mark.cases(4)
@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
@pytest.mark.parametrize("azimuth", [0.0, 20.0, 45.0, 110.0])
def test_a_narrow_ellipse_is_exact_between_its_nodes(distribution, azimuth):
    density = PlanarDensity.of(facets.analytic(distribution, a_x=0.01, a_y=0.5, azimuth=azimuth))
    rng = np.random.default_rng(5)
    x, y = rng.normal(size=(2, 500))
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    p, q = 0.01 * x * cos - 0.5 * y * sin, 0.01 * x * sin + 0.5 * y * cos
    # A cubic spline of log P22 whose nodes are a tenth of a width apart.
    assert density(p, q) == pytest.approx(exact(distribution, 0.01, 0.5, azimuth, p, q), rel=1e-5)


def test_there_is_no_facet_beyond_the_grid():
    density = PlanarDensity.of(facets.analytic("beckmann", a_x=0.1, a_y=0.2, azimuth=10))
    assert density(2.0, [0.0, 2.0]).tolist() == [0.0, 0.0]
    assert density(0.0, 0.0).shape == ()


def test_moments_are_those_along_x_and_y():
    density = PlanarDensity.of(facets.analytic("beckmann", a_x=0.4, a_y=0.1, azimuth=30))
    mass, mean, covariance = density.moments
    # Variances a²/2 along the axes; the rule holds to 1e-8.
    along, across = np.array([0.4, 0.1]) ** 2 / 2
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turned = [
        [along * c * c + across * s * s, (along - across) * c * s],
        [(along - across) * c * s, along * s * s + across * c * c],
    ]
    assert covariance == pytest.approx(np.array(turned), abs=1e-7)
    assert np.abs(mean).max() < 1e-12
    assert mass == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("azimuth", [0.0, 17.0, 120.0])
def test_the_marginal_of_a_gaussian_is_a_gaussian(azimuth):
    density = PlanarDensity.of(facets.analytic("beckmann", a_x=0.02, a_y=0.4, azimuth=50))
    slope, values = density.marginal(azimuth)
    angle = np.radians(azimuth - 50)
    sigma = np.hypot(0.02 * np.cos(angle), 0.4 * np.sin(angle)) / np.sqrt(2)
    assert values == pytest.approx(norm.pdf(slope, scale=sigma), abs=1e-6 / sigma)


# --- neither elliptic nor symmetric


WEIGHT, SHIFT, SIGMA = np.array([0.25, 0.75]), np.array([1.2, -0.4]), np.array([0.05, 0.3])


@pytest.fixture(scope="module")
def lopsided() -> xr.Dataset:
    """Two Gaussians, apart along the lay at 35 degree, whose mean slope is zero."""
    # Shifts are in units of the width along the lay: spread 0.05 √(1 + Σ w m²).
    width = SIGMA[0] * np.sqrt(1 + WEIGHT @ SHIFT**2), SIGMA[1]
    axes = [SlopeAxis(scale, 9 * scale, 257) for scale in width]
    along = norm.pdf(axes[0].nodes[:, None], SHIFT * SIGMA[0], SIGMA[0]) @ WEIGHT
    density = PlanarDensity(*axes, norm.pdf(axes[1].nodes, scale=SIGMA[1])[:, None] * along, 35.0)
    assert density.moments[0] == pytest.approx(1, abs=1e-6)
    return facets.facet_dataset.planar_dataset(density, float(np.hypot(*width)))


def test_masking_of_any_density_is_the_closed_form_between_its_azimuths(lopsided):
    mu, phi = np.array([0.0, 0.01, 0.05, 0.2, 0.5])[:, None], np.linspace(-180, 180, 251)
    cos, sin = np.cos(np.radians(phi - 35)), np.sin(np.radians(phi - 35))
    sigma = np.hypot(SIGMA[0] * cos, SIGMA[1] * sin)
    excess = 0.0
    for weight, shift in zip(WEIGHT, SHIFT, strict=True):
        z = (mu - shift * SIGMA[0] * cos) / sigma
        excess = excess + weight * sigma * (norm.pdf(z) - z * norm.sf(z))
    tabulated = masking.PlanarSmith.of(lopsided).excess(mu, phi)
    # Not elliptic: azimuths five degrees of turn apart hold it to a few parts in 1e5 of the excess at grazing.
    assert np.abs(tabulated - excess).max() < 5e-5 * excess.max()
    assert (np.abs(tabulated - excess) / excess[0]).max() < 1e-4


def test_the_density_has_the_sign_of_its_slopes(lopsided):
    # The gentler, likelier slopes are negative along the lay, and the tail positive.
    density = PlanarDensity.of(lopsided)
    cos, sin = np.cos(np.radians(35)), np.sin(np.radians(35))
    assert density(0.15 * cos, 0.15 * sin) > 2 * density(-0.15 * cos, -0.15 * sin)


@pytest.mark.parametrize("ratio", [1.0, 20.0])
def test_masking_of_a_lay_falls_with_the_angle_and_closes_around_the_azimuth(ratio):
    table = facets.analytic("ggx", a_x=0.5 / ratio, a_y=0.5, azimuth=20)
    phi = np.array([3.0, 20.0, 21.3, 77.0])
    g1 = masking.g1(table, np.linspace(0, 90, 901)[:, None], phi).values
    # To the rounding of the spline.
    assert (np.diff(g1, axis=0) <= 1e-9).all()
    assert ((g1 >= 0) & (g1 <= 1)).all()
    around = masking.g1(table, 85.0, [-1e-9, 0.0, 360.0, 1e-9, 180.0]).values
    assert around == pytest.approx(around[0], abs=1e-9)


def test_the_table_of_masking_is_dense_about_the_lay():
    phi = smith_lambda(PlanarDensity.of(facets.analytic("beckmann", a_x=0.01, a_y=0.2, azimuth=40)))["phi"].values
    assert np.diff(phi).min() == pytest.approx(np.degrees(np.arctan(np.tan(np.radians(5)) / 20)))
    assert np.abs(phi - 40).min() < 1e-8
    assert (np.diff(phi) > 0).all()


# --- what a dataset must carry


def test_a_density_without_its_lay_is_refused():
    table = facets.analytic("beckmann", a_x=0.1, a_y=0.2)
    for broken in (table.drop_vars("lay"), table.assign(lay=np.nan)):
        with pytest.raises(VocabularyError, match="needs the variable 'lay'"):
            PlanarDensity.of(broken)


@given(along=st.floats(1e-4, 1), ratio=ratios, lay=st.floats(-90, 89.99), azimuth=azimuths)
def test_turns_and_azimuths_are_inverse(along, ratio, lay, azimuth):
    ellipse = Ellipse(along, along * ratio, lay)
    turn = ellipse.towards(azimuth)[1]
    # Azimuths are rounded to 1e-9 degree.
    assert np.cos(np.radians(ellipse.azimuths([turn])[0] - azimuth)) == pytest.approx(1, abs=1e-12)


def test_the_rms_and_mean_slopes_of_a_beckmann_finish_follow_from_its_widths():
    density = PlanarDensity.of(facets.analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0))
    widths, azimuths = np.array([0.2, 0.5]), np.array([30.0, 120.0])
    # The density is a spline between nodes: its moments hold to 1e-4.
    np.testing.assert_allclose(density.rms_slope(azimuths), widths / np.sqrt(2), rtol=1e-3)
    np.testing.assert_allclose(density.mean_slope(azimuths), widths / np.sqrt(np.pi), rtol=1e-3)

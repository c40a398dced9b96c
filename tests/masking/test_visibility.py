"""Smith masking, against closed forms and the reference table."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr
from scipy.special import erfc

from brdfpipe import facets, masking
from brdfpipe.errors import VocabularyError
from brdfpipe.facets.radial_density import RadialDensity

ANGLES = np.array([0.0, 1.0, 10.0, 45.0, 60.0, 75.0, 85.0, 89.0, 89.9])


def closed_form(distribution: str, a: float, theta):
    """Heitz 2014, Λ of Beckmann (eq. 66 exact) and GGX (eq. 72)."""
    with np.errstate(divide="ignore"):
        x = 1 / (a * np.tan(np.radians(theta)))
    if distribution == "ggx":
        return 2 / (1 + np.sqrt(1 + 1 / x**2))
    lambda_smith = np.where(np.isfinite(x), (np.exp(-(x**2)) / (x * np.sqrt(np.pi)) - erfc(x)) / 2, 0.0)
    return 1 / (1 + lambda_smith)


@pytest.mark.parametrize(
    ("a", "theta", "printed"),
    [
        (0.3, 60, 0.99963733),
        (0.3, 75, 0.96249761),
        (0.3, 85, 0.64581632),
        (0.5, 75, 0.85416826),
        (1.0, 85, 0.26673731),
    ],
)
def test_g1_of_beckmann_is_the_printed_one(a, theta, printed):
    assert float(masking.g1(facets.analytic("beckmann", a), theta)) == pytest.approx(printed, abs=5e-9)


@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
@pytest.mark.parametrize("a", [1e-4, 0.1, 0.3, 1.0, 10.0])
def test_g1_is_the_closed_form_up_to_grazing(distribution, a):
    visible = masking.g1(facets.analytic(distribution, a), ANGLES).values
    # The table and its spline, not the formula, limit the agreement; GGX ends at 1e7 a.
    assert visible == pytest.approx(closed_form(distribution, a, ANGLES), rel=1e-6)


def test_g1_is_1_at_normal_and_0_at_grazing():
    assert masking.g1(facets.analytic("beckmann", 0.4), [0.0, 90.0]).values.tolist() == [1.0, 0.0]


def test_g1_falls_with_the_angle():
    g1 = masking.g1(facets.analytic("ggx", 0.4), np.linspace(0, 90, 2001)).values
    assert (np.diff(g1) <= 1e-12).all()


def test_g1_keeps_the_labels_of_its_angles():
    theta = xr.DataArray([[10.0, 20.0]], dims=("row", "column"), coords={"column": ["a", "b"]})
    visible = masking.g1(facets.analytic("beckmann", 0.4), theta)
    assert visible.dims == ("row", "column")
    assert visible["column"].values.tolist() == ["a", "b"]


@pytest.mark.parametrize("theta", [-1.0, 90.1])
def test_angles_beyond_the_horizon_are_refused(theta):
    with pytest.raises(VocabularyError, match="theta spans"):
        masking.g1(facets.analytic("beckmann", 0.4), theta)


def test_the_mean_excess_at_zero_is_half_the_mean_absolute_slope():
    density = RadialDensity.of(facets.analytic("beckmann", 0.2))
    # A Gaussian of σ = a/√2 along any line: E|p| = σ √(2/π).
    assert masking.excess_slope(density, [0.0])[0] == pytest.approx(0.2 / np.sqrt(np.pi) / 2, rel=1e-10)


def test_masking_conserves_the_projected_area():
    # ∫ G1 D max(0, o·m) dω = cos θ (Heitz 2014, eq. 20): masking conserves the projected area.
    table = facets.analytic("beckmann", 0.4)
    s, weight = RadialDensity.of(table).rule()
    beta = 2 * np.pi * (np.arange(2048) + 0.5) / 2048
    for theta in (30.0, 70.0, 85.0):
        cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
        towards = np.maximum(cos - s[:, None] * np.cos(beta) * sin, 0.0).mean(axis=1)
        assert float(masking.g1(table, theta)) * (weight @ towards) == pytest.approx(cos, rel=1e-5)


@pytest.mark.cases(6)
@pytest.mark.parametrize("azimuth", [0.0, 20.0, 45.0, 110.0])
@pytest.mark.parametrize("ratio", [0.4, 5.0, 20.0, 0.01])
@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
def test_masking_of_a_lay_is_that_of_the_width_towards_each_azimuth(distribution, ratio, azimuth):
    # Heitz 2014: a_φ² = a_x² cos² φ + a_y² sin² φ about the axes of the ellipse.
    a_x, a_y = 0.5 * min(ratio, 1), 0.5 * min(1 / ratio, 1)
    table = facets.analytic(distribution, a_x=a_x, a_y=a_y, azimuth=azimuth)
    theta, phi = ANGLES[2:, None], np.linspace(-180, 180, 411)
    width = np.hypot(a_x * np.cos(np.radians(phi - azimuth)), a_y * np.sin(np.radians(phi - azimuth)))
    visible = masking.g1(table, theta, phi).values
    # The masking of each grid and its spline, not the formula, limit the agreement; GGX ends at 1e6 a.
    assert visible == pytest.approx(closed_form(distribution, width, theta), rel=1e-5)


def test_directions_of_a_lay_broadcast_by_name():
    table = facets.analytic("beckmann", a_x=0.2, a_y=0.5)
    theta = xr.DataArray([60.0, 80.0], dims="theta")
    phi = xr.DataArray([0.0, 45.0, 90.0], dims="phi")
    visible = masking.g1(table, theta, phi)
    assert visible.sizes == {"theta": 2, "phi": 3}
    assert (visible.diff("phi") < 0).all()


def pair(table, mode, theta_i, theta_o, phi=180.0):
    return float(masking.g2(table, theta_i, 0, theta_o, phi, mode=mode))


def test_the_patents_masking_is_not_reciprocal_by_the_printed_ratio():
    # Reference: f(30→75)/f(75→30) = 0.7413888795 at σ = 0.5.
    table = facets.analytic("beckmann", 0.5 * np.sqrt(2))
    # The table of Λ is good to 1e-9.
    assert pair(table, "crf", 30, 75) / pair(table, "crf", 75, 30) == pytest.approx(0.7413888795, abs=2e-9)


@pytest.mark.parametrize("mode", ["height-correlated", "separable", "blinn", "none"])
def test_every_other_mode_is_reciprocal_and_between_0_and_1(mode):
    table = facets.analytic("ggx", 0.4)
    rng = np.random.default_rng(3)
    theta_i, theta_o, phi = rng.uniform(0, 89.9, (2, 200)), None, rng.uniform(0, 360, 200)
    theta_i, theta_o = theta_i
    forward = masking.g2(table, theta_i, 0.0, theta_o, phi, mode=mode).values
    backward = masking.g2(table, theta_o, phi, theta_i, 0.0, mode=mode).values
    assert forward == pytest.approx(backward, rel=1e-12)
    assert ((forward >= 0) & (forward <= 1)).all()


def test_the_masking_modes_are_ordered():
    table = facets.analytic("beckmann", 0.6)
    none, correlated, separable = (pair(table, mode, 80, 75) for mode in ("none", "height-correlated", "separable"))
    assert none == pytest.approx(1, rel=1e-15)
    assert 1 > correlated > separable
    g1 = masking.g1(table, [80.0, 75.0]).values
    assert separable == pytest.approx(g1.prod(), rel=1e-12)
    assert pair(table, "crf", 80, 75) == pytest.approx(g1[1], rel=1e-12)


def test_grooves_mask_by_the_closed_form():
    # Blinn 1977 at θ_i = θ_o = 60, φ = 180: the facet is the mean plane, so 2 · cos 60 / cos 60 is cut at 1; retro at 60 gives 1.
    table = facets.analytic("beckmann", 0.3)
    assert pair(table, "blinn", 60, 60) == 1.0
    cos_alpha, cos_zeta = np.cos(np.radians(35)), np.cos(np.radians(45))
    assert pair(table, "blinn", 10, 80) == pytest.approx(2 * cos_alpha * np.cos(np.radians(80)) / cos_zeta, rel=1e-12)


def test_an_unknown_mode_is_refused():
    with pytest.raises(VocabularyError, match="accepted: height-correlated, separable, crf, blinn, none, liu"):
        masking.g2(facets.analytic("beckmann", 0.3), 0, 0, 0, 0, mode="v-groove")


def test_g1_along_a_line_is_smith_masking_of_its_slopes():
    slopes = np.random.default_rng(2).normal(scale=0.3, size=200_000)
    slopes -= slopes.mean()
    expected = masking.g1(facets.analytic("beckmann", 0.3 * np.sqrt(2)), ANGLES).values
    # 200 000 slopes: a few parts in a thousand at grazing.
    assert masking.g1_along(slopes, ANGLES) == pytest.approx(expected, rel=5e-3)
    assert masking.g1_along(slopes, [0.0, 90.0]).tolist() == [1.0, 0.0]


def test_slopes_that_are_not_levelled_are_refused():
    with pytest.raises(VocabularyError, match="Level the surface first"):
        masking.g1_along([0.1, 0.2], [45.0])
    with pytest.raises(VocabularyError, match="found 0"):
        masking.g1_along([np.nan], [45.0])


def test_ray_casting_is_a_public_name_of_masking():
    cast = masking.raycast(samples.gaussian_surface(128, sigma=0.3, correlation=4), [60.0, 80.0])
    assert cast["g1"].values == pytest.approx(1 / (1 + cast["lambda_empirical"].values), abs=1e-10)

"""From surfaces to facet distributions: known densities are recovered, and what cannot be known is refused."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, masking, surfaces, vocabulary
from brdfpipe.facets import slopes
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.masking import ray_casting as raycast


def gaussian(slope, sigma):
    return np.exp(-(slope**2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)


@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
@given(a=st.floats(1e-6, 10))
@settings(max_examples=20, deadline=None)
def test_an_analytic_density_is_normalised(distribution, a):
    assert RadialDensity.of(facets.analytic(distribution, a)).mass == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("a", [0.02, 0.3, 1.5])
def test_an_analytic_density_is_exact_between_its_nodes(a):
    slope = np.linspace(0, 5 * a, 333)
    beckmann, ggx = (RadialDensity.of(facets.analytic(name, a))(slope**2) for name in facets.DISTRIBUTIONS)
    assert beckmann == pytest.approx(gaussian(slope, a / np.sqrt(2)), rel=1e-10)
    assert ggx == pytest.approx(a**2 / (np.pi * (a**2 + slope**2) ** 2), rel=1e-6)


def test_d_is_the_slope_density_over_the_fourth_power_of_the_cosine():
    table = facets.analytic("beckmann", 0.3)
    expected = table["slope_density"].values / np.cos(np.radians(table["alpha"].values)) ** 4
    assert table["D"].values == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("name", "a"), [("phong", 0.2), ("ggx", 0.0), ("ggx", np.nan), ("beckmann", 11)])
def test_an_unknown_density_is_refused(name, a):
    with pytest.raises(facets.FacetError, match="accepted"):
        facets.analytic(name, a)


@pytest.fixture(scope="module")
def gaussian_map():
    return samples.gaussian_surface(1024, sigma=0.15, correlation=8)


@pytest.fixture(scope="module")
def of_gaussian_map(gaussian_map):
    return facets.estimate(gaussian_map)


def test_the_density_of_a_gaussian_map_is_recovered_within_its_uncertainty(of_gaussian_map):
    slope = of_gaussian_map["slope"].values
    measured = (of_gaussian_map["slope_density_quality"].values == vocabulary.quality("measured")) & (slope > 0)
    sigma = float(of_gaussian_map["slope_rms"]) / np.sqrt(2)
    deviation = of_gaussian_map["slope_density"].values / gaussian(slope, sigma) - 1
    relative_u = (of_gaussian_map["D_u"] / of_gaussian_map["D"]).values
    z = (deviation / relative_u)[measured]
    # Neither optimistic nor pessimistic; bins are correlated, so no χ² test.
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(deviation[measured & (slope < 2 * sigma)]).max() < 0.1


def test_a_counted_density_keeps_the_mass_and_the_mean_square_slope(of_gaussian_map):
    density = RadialDensity.of(of_gaussian_map)
    s, weight = density.rule()
    assert density.mass == pytest.approx(1, abs=1e-12)
    assert np.sqrt(weight @ s**2) == pytest.approx(float(of_gaussian_map["slope_rms"]), rel=0.01)


def test_every_facet_is_counted_once(gaussian_map, of_gaussian_map):
    quads = (gaussian_map.sizes["x"] - 1) * (gaussian_map.sizes["y"] - 1)
    assert float(of_gaussian_map["facet_count"]) == 4 * quads
    assert float(of_gaussian_map["count"].sum()) == 4 * quads


def test_independent_facets_are_fewer_than_facets(of_gaussian_map):
    # The four triangles of a quad alone are one or two independent facets.
    assert float(of_gaussian_map["facet_count"] / of_gaussian_map["effective_count"]) > 3


def test_the_correlation_length_is_that_of_the_surface(of_gaussian_map):
    assert float(of_gaussian_map["correlation_length"]) == pytest.approx(8, rel=0.1)


def test_white_noise_has_no_lay():
    # One diagonal a quad would give correlated slopes and an anisotropy of √3.
    height = np.random.default_rng(3).normal(scale=0.05, size=(512, 512))
    noise = facets.estimate(samples.surface(height))
    assert float(noise["anisotropy"]) == pytest.approx(1, abs=0.02)
    assert "limited by noise" in vocabulary.warnings(noise)[0]


def test_the_slopes_of_white_noise_are_not_correlated():
    # A single diagonal gives a correlation of 0.5.
    height = np.random.default_rng(9).normal(scale=0.05, size=(512, 512))
    covariance = slopes.count_maps([slopes.HeightMap.of(samples.surface(height))])[1].covariance
    assert abs(covariance[0, 1]) / np.sqrt(covariance[0, 0] * covariance[1, 1]) < 0.01


def test_the_block_borders_neither_lose_nor_double_a_facet():
    height = np.random.default_rng(4).normal(scale=0.05, size=(67, 101))
    p, q = np.diff(height, axis=1), np.diff(height, axis=0)
    counted = slopes.count_maps([slopes.HeightMap.of(samples.surface(height))])[1]
    triangles = [(a, b) for a in (p[:-1], p[1:]) for b in (q[:, :-1], q[:, 1:])]
    assert counted.facets == sum(a.size for a, _ in triangles)
    # Slopes are counted in single precision.
    exact = np.sqrt(np.var([a for a, _ in triangles]) + np.var([b for _, b in triangles]))
    assert counted.slope_rms == pytest.approx(exact, rel=1e-6)


def test_a_missing_height_removes_its_triangles_alone():
    height = samples.gaussian_surface(128, correlation=3)["height"].values
    height[40, 50] = np.nan
    # A height inside the map belongs to 12 of the triangles of its four quads.
    assert slopes.count_maps([slopes.HeightMap.of(samples.surface(height))])[1].facets == 4 * 127**2 - 12


def test_a_lay_is_detected_and_removed_by_averaging_alone():
    height = samples.gaussian_surface(512, sigma=0.1, correlation=6)
    lay = samples.surface(height["height"].values, pitch=(1.0, 2.0))
    table = facets.estimate(lay)
    assert float(table["anisotropy"]) == pytest.approx(2, rel=0.05)
    # Slopes are smaller along y, so the lay runs along y.
    assert abs(float(table["lay"])) == pytest.approx(90, abs=3)
    assert table["slope_density"].dims == ("slope_across", "slope_along")
    assert "has a lay" in vocabulary.warnings(facets.azimuthal_average(table))[0]


def test_a_surface_declared_isotropic_is_averaged_which_its_history_says():
    height = samples.gaussian_surface(512, sigma=0.1, correlation=6)["height"].values
    table = facets.estimate(samples.surface(height, pitch=(1.0, 2.0)), isotropic=True)
    assert table["slope_density"].dims == ("slope",)
    assert "declared isotropic" in table.attrs["history"]


def test_a_tilted_map_is_warned_about():
    height = samples.gaussian_surface(256, correlation=4)["height"].values + 0.2 * np.arange(256)
    assert any("level the surface" in w for w in vocabulary.warnings(facets.estimate(samples.surface(height))))


@pytest.mark.parametrize("height", [np.zeros((64, 64)), np.full((64, 64), np.nan)])
def test_a_flat_or_empty_map_is_refused(height):
    with pytest.raises(facets.FacetError, match="perfectly flat or has no complete facet"):
        facets.estimate(samples.surface(height))


def test_too_small_a_map_is_refused():
    with pytest.raises(facets.FacetError, match="too few independent facets"):
        facets.estimate(samples.gaussian_surface(32, correlation=8))


def test_a_scan_of_rubber_has_its_slope_rms_and_anisotropy(shared_data):
    rubber = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p"))
    table = facets.estimate(rubber)
    assert float(table["slope_rms"]) == pytest.approx(0.136, rel=0.02)
    assert float(table["anisotropy"]) == pytest.approx(1.03, rel=0.02)
    assert RadialDensity.of(table).mass == pytest.approx(1, abs=1e-9)


# --- surfaces with a lay


def test_d_of_a_lay_faces_where_its_slopes_fall():
    table = facets.analytic("beckmann", a_x=0.5, a_y=0.1, azimuth=20)
    at = table["D"].sel(alpha=20, method="nearest")
    assert float(at["beta"][int(at.argmax("beta"))]) % 180 == pytest.approx(20)


@pytest.fixture(scope="module")
def grooved():
    return facets.estimate(
        samples.surface(samples.gaussian_surface(1024, sigma=0.1)["height"].values, pitch=(1.0, 2.0))
    )


def test_the_density_of_a_surface_with_a_lay_is_recovered(grooved):
    density = PlanarDensity.of(grooved)
    mass, mean, covariance = density.moments
    assert mass == pytest.approx(1, abs=1e-9)
    assert np.abs(mean).max() < 1e-3
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.1, 0.05], rel=0.02)
    for p, q in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.05), (-0.1, 0.05), (0.2, 0.0)):
        exact = np.exp(-((p / 0.1) ** 2 + (q / 0.05) ** 2) / 2) / (2 * np.pi * 0.1 * 0.05)
        assert float(density(p, q)) == pytest.approx(exact, rel=0.05)


def test_a_skewed_surface_masks_as_its_slopes_do():
    rng = np.random.default_rng(3)
    teeth = np.cumsum(np.where(rng.random((300, 300)) < 0.2, 0.24, -0.06), axis=1)
    teeth -= teeth[:, -1:] * np.arange(300) / 299
    scan = samples.surface(teeth + 2 * samples.gaussian_surface(300, sigma=0.05, correlation=3)["height"].values)
    table, azimuths = facets.estimate(scan), [0.0, 180.0]
    cast = raycast.raycast(scan, [75.0, 85.0, 88.0], azimuths)
    smith = 1 / (1 + cast["lambda_empirical"].values)
    counted = [[float(masking.g1(table, theta, azimuth)) for azimuth in azimuths] for theta in (75.0, 85.0, 88.0)]
    # The two directions differ by several per cent; cells that had to show it against their prior were off by 3 %.
    assert abs(smith[1, 0] / smith[1, 1] - 1) > 0.03
    assert np.asarray(counted) == pytest.approx(smith, rel=0.01)


def brushed_map(size, azimuth, seed=1):
    """A Gaussian map whose slopes are σ = 0.02 towards the azimuth and 0.1 across it."""
    fx, fy = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size))
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    along, across = fx * cos + fy * sin, fy * cos - fx * sin
    # The slope of a Gaussian correlation of length l has the rms √2 h / l.
    shape = np.exp(-((np.pi * np.hypot(40 * along, 8 * across)) ** 2) / 2)
    height = np.fft.ifft2(np.fft.fft2(np.random.default_rng(seed).normal(size=(size, size))) * shape).real
    return samples.surface(height * 0.1 / (np.sqrt(2) / 8 * height.std()))


def test_an_oblique_lay_keeps_its_ellipse():
    table = facets.estimate(brushed_map(1024, 30))
    assert float(table["lay"]) == pytest.approx(30, abs=0.5)
    density = PlanarDensity.of(table)
    # The two edges of a facet are half a pixel apart, which widens the ellipse along an oblique lay by a few per cent.
    assert np.sqrt(np.linalg.eigvalsh(density.moments[2])) == pytest.approx([0.02, 0.1], rel=0.08)
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    for a, b in ((0.0, 0.0), (0.02, 0.0), (0.0, 0.1), (-0.02, 0.1), (0.0, 0.2)):
        exact = np.exp(-((a / 0.02) ** 2 + (b / 0.1) ** 2) / 2) / (2 * np.pi * 0.02 * 0.1)
        # Three thousand grains of 8 by 40 pixels; a cell trusts its own counts, whose scatter over seeds is 5 %.
        assert float(density(a * cos - b * sin, a * sin + b * cos)) == pytest.approx(exact, rel=0.15)


def test_every_facet_of_a_surface_with_a_lay_is_counted_once(grooved):
    assert float(grooved["count"].sum()) == float(grooved["facet_count"])


def test_the_average_over_azimuth_keeps_mass_and_roughness(grooved):
    average = facets.azimuthal_average(grooved)
    s, weight = RadialDensity.of(average).rule()
    assert weight.sum() == pytest.approx(1, abs=1e-9)
    assert np.sqrt(weight @ s**2) == pytest.approx(float(grooved["slope_rms"]), rel=0.02)


def test_an_isotropic_distribution_has_no_azimuth_to_average():
    table = facets.analytic("ggx", 0.2)
    assert facets.azimuthal_average(table) is table


def test_several_scans_count_together():
    one, two = samples.gaussian_surface(256, seed=1), samples.gaussian_surface(256, seed=2)
    together = facets.estimate([one, two])
    assert float(together["facet_count"]) == 2 * 4 * 255**2
    assert "2 scans" in together.attrs["method"]
    assert float(together["effective_count"]) > float(facets.estimate(one)["effective_count"])


def test_a_map_and_a_line_are_refused_together():
    with pytest.raises(facets.FacetError, match="all maps or all lines"):
        facets.estimate([samples.gaussian_surface(128), samples.surface(np.arange(200.0))])


@pytest.mark.parametrize("widths", [{}, {"a": 0.1, "a_x": 0.1, "a_y": 0.2}, {"a_x": 0.1}, {"a_x": 1e-3, "a_y": 1.0}])
def test_contradictory_widths_of_a_lay_are_refused(widths):
    with pytest.raises(facets.FacetError, match=r"either a, or a_x and a_y|accepted"):
        facets.analytic("ggx", **widths)


def test_a_grooved_scan_has_its_known_lay(shared_data):
    grooves = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "x3p-2.x3p"))
    table = facets.estimate(grooves)
    assert float(table["anisotropy"]) == pytest.approx(2.0, rel=0.02)
    assert float(table["slope_rms"]) == pytest.approx(0.062, rel=0.02)


@pytest.mark.parametrize("azimuth", [0.0, 45.0])
@pytest.mark.parametrize("narrow", [0.2, 0.05, 0.005])
def test_the_average_over_azimuth_keeps_the_roughness_of_the_rough_axis(narrow, azimuth):
    table = facets.analytic("beckmann", a_x=0.5, a_y=narrow, azimuth=azimuth)
    s, weight = RadialDensity.of(facets.azimuthal_average(table)).rule()
    assert np.sqrt(weight @ s**2) == pytest.approx(float(table["slope_rms"]), rel=1e-3)


@pytest.mark.parametrize("arguments", [{"a": 0.3, "a_x": 0.2}, {"a_x": 0.2, "a_y": 0.3, "azimuth": np.nan}])
def test_contradictory_or_missing_widths_are_refused(arguments):
    with pytest.raises(facets.FacetError):
        facets.analytic("beckmann", **arguments)


@pytest.mark.parametrize("height", [np.zeros(100), np.zeros((40, 40))])
def test_an_unknown_method_is_refused_for_every_scan(height):
    with pytest.raises(facets.FacetError, match=r"unknown method 'xx'.*accepted: mixture, abel, crf"):
        facets.estimate(samples.surface(height), method="xx", isotropic=True)


def test_a_method_for_lines_causes_a_warning_on_a_map(gaussian_map, of_gaussian_map):
    asked = facets.estimate(gaussian_map, method="abel")
    (warning,) = [text for text in vocabulary.warnings(asked) if text not in vocabulary.warnings(of_gaussian_map)]
    assert warning.startswith("surface.method abel is for line profiles and was ignored")
    assert asked["slope_density"].identical(of_gaussian_map["slope_density"])


def test_no_scan_at_all_is_refused():
    with pytest.raises(facets.FacetError, match="no scan of a surface given"):
        facets.estimate([])


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (8, 8), (9, 9)])
def test_a_map_of_few_facets_is_refused(shape):
    heights = np.random.default_rng(0).normal(size=shape)
    with pytest.raises(facets.FacetError, match="too few independent facets"):
        facets.estimate(samples.surface(heights))


@pytest.mark.parametrize("shape", [(1, 1), (1, 64), (64, 1)])
def test_a_map_without_a_facet_is_refused(shape):
    with pytest.raises(facets.FacetError, match="no complete facet"):
        facets.estimate(samples.surface(np.random.default_rng(0).normal(size=shape)))

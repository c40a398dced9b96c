"""From line profiles to densities: known ones are recovered by each way, and a lone line is not trusted."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, masking, surfaces, vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.planar import PlanarDensity


def gaussian(slope, sigma):
    return np.exp(-(slope**2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)


def ggx(slope, a):
    return a**2 / (np.pi * (a**2 + slope**2) ** 2)


def line(slopes, azimuth=0.0):
    return samples.surface(np.cumsum(slopes)).assign_attrs(azimuth=azimuth)


def ggx_line(points=100_000, a=0.1, seed=5):
    rng = np.random.default_rng(seed)
    u = rng.random(points)
    return line(a * np.sqrt(u / (1 - u)) * np.cos(2 * np.pi * rng.random(points)))


def gaussian_line(points=100_000, sigma=0.1, correlation=0.7, seed=5):
    kernel = np.exp(-((np.arange(-20, 21) / correlation) ** 2))
    slope = np.convolve(np.random.default_rng(seed).normal(size=points), kernel, "same")
    return samples.surface(np.cumsum(slope * sigma / slope.std()))


def test_a_lone_line_is_refused_unless_declared_isotropic():
    with pytest.raises(facets.FacetError, match=r"surface\.isotropic: true"):
        facets.estimate(gaussian_line(1000))


def test_the_density_of_a_gaussian_line_is_recovered():
    table = facets.estimate(gaussian_line(), isotropic=True)
    density = RadialDensity.of(table)
    slope = 0.1 * np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    deviation = np.abs(density(slope**2) / gaussian(slope, 0.1) - 1)
    assert deviation[0] < 0.06
    assert deviation[1:].max() < 0.03
    assert density.mass == pytest.approx(1, abs=1e-6)


def test_an_isotropic_surface_is_twice_as_rough_as_a_line_on_it():
    table = facets.estimate(gaussian_line(), isotropic=True)
    assert float(table["slope_rms"]) == pytest.approx(0.1 * np.sqrt(2), rel=0.01)


def test_a_grooved_line_is_no_mixture_of_gaussians():
    sawtooth = np.cumsum(np.where(np.arange(20_000) % 40 < 20, 0.1, -0.1))
    jitter = np.random.default_rng(6).normal(scale=0.002, size=20_000)
    table = facets.estimate(samples.surface(sawtooth + jitter), isotropic=True)
    assert any("no mixture of Gaussians" in warning for warning in vocabulary.warnings(table))


def test_a_short_or_flat_line_is_refused():
    for height in (np.random.default_rng(0).normal(size=50), np.zeros(500)):
        with pytest.raises(facets.FacetError, match="at least 128 are needed"):
            facets.estimate(samples.surface(height), isotropic=True)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_density_of_a_ggx_line_is_recovered(seed):
    density = RadialDensity.of(facets.estimate(ggx_line(seed=seed), isotropic=True))
    slope = 0.1 * np.array([0.0, 0.5, 1.0, 2.0])
    deviation = np.abs(density(slope**2) / ggx(slope, 0.1) - 1)
    assert deviation[0] < 0.06
    assert deviation[1:].max() < 0.03


def gaussian_quantiles(points=2_000_000, sigma=0.2):
    """Slopes that are a Gaussian sample without noise, in an order that does not matter."""
    from scipy.special import ndtri

    slopes = sigma * ndtri((np.arange(points) + 0.5) / points)
    return line(np.random.default_rng(0).permutation(slopes))


def test_the_patents_histogram_is_off_by_k_cos_squared():
    # K = 1/⟨1/(1 + s²)⟩ = 1.07476 at σ = 0.2 (PHYSICS, line profile).
    table = facets.estimate(gaussian_quantiles(), isotropic=True, method="crf")
    alpha = np.radians(np.array([1.0, 5.0, 10.0, 20.0, 30.0]))
    slope = np.tan(alpha)
    ratio = RadialDensity.of(table)(slope**2) / gaussian(slope, 0.2)
    assert ratio == pytest.approx(1.07476 * np.cos(alpha) ** 2, rel=0.005)
    assert "cos²α" in vocabulary.warnings(table)[0]


def test_the_patents_histogram_is_far_off_on_a_ggx_surface():
    # Peak × 0.583 and 30° × 2.55 at a = 0.1.
    share = (np.arange(2_000_000) + 0.5) / 1_000_000 - 1
    quantiles = np.random.default_rng(0).permutation(0.1 * share / np.sqrt(1 - share**2))
    density = RadialDensity.of(facets.estimate(line(quantiles), isotropic=True, method="crf"))
    slope = np.tan(np.radians([0.5, 30.0]))
    assert density(slope**2) / ggx(slope, 0.1) == pytest.approx([0.583, 2.55], rel=0.02)


@pytest.mark.parametrize("make", [gaussian_line, ggx_line])
def test_rings_recover_what_a_mixture_does(make):
    mixture, rings = (RadialDensity.of(facets.estimate(make(), isotropic=True, method=m)) for m in ("mixture", "abel"))
    slope = np.array([0.05, 0.1, 0.15])
    assert rings(slope**2) == pytest.approx(mixture(slope**2), rel=0.1)
    assert rings.mass == pytest.approx(1, abs=1e-9)


def test_rings_find_a_ring():
    # Cones of one slope: the line sees the arcsine law, which no Gaussian mixture makes.
    slopes = 0.2 * np.cos(2 * np.pi * np.random.default_rng(8).random(50_000))
    table = facets.estimate(line(slopes + np.random.default_rng(9).normal(scale=0.005, size=50_000)), isotropic=True)
    assert "abel" in table.attrs["method"]
    s, weight = RadialDensity.of(table).rule()
    near = (s > 0.17) & (s < 0.23)
    assert weight[near].sum() > 0.8


def test_several_lines_of_an_isotropic_surface_count_together():
    one, two = gaussian_line(20_000, seed=1), gaussian_line(20_000, seed=2)
    together = facets.estimate([one, two], isotropic=True)
    assert float(together["facet_count"]) == 2 * 19_999


def test_two_perpendicular_lines_make_a_surface_with_a_lay():
    rng = np.random.default_rng(4)
    rough, smooth = line(rng.normal(scale=0.2, size=50_000)), line(rng.normal(scale=0.05, size=50_000), azimuth=90.0)
    table = facets.estimate([rough, smooth])
    assert float(table["anisotropy"]) == pytest.approx(4, rel=0.03)
    assert abs(float(table["lay"])) == pytest.approx(90)
    density = PlanarDensity.of(table)
    for p, q in ((0.0, 0.0), (0.2, 0.0), (0.0, 0.05), (0.1, 0.05)):
        exact = np.exp(-((p / 0.2) ** 2 + (q / 0.05) ** 2) / 2) / (2 * np.pi * 0.2 * 0.05)
        assert float(density(p, q)) == pytest.approx(exact, rel=0.08)


def test_masking_along_two_perpendicular_lines_is_that_of_each():
    rng = np.random.default_rng(4)
    table = facets.estimate([line(rng.normal(scale=s, size=50_000), azimuth=z) for s, z in ((0.2, 0.0), (0.05, 90.0))])
    for azimuth, sigma in ((0.0, 0.2), (90.0, 0.05)):
        alone = masking.g1(facets.analytic("beckmann", sigma * np.sqrt(2)), [75.0, 85.0]).values
        assert masking.g1(table, [75.0, 85.0], azimuth).values == pytest.approx(alone, abs=0.01)


def test_lines_that_are_not_perpendicular_are_refused():
    with pytest.raises(facets.FacetError, match="perpendicular"):
        facets.estimate([gaussian_line(1000), gaussian_line(1000).assign_attrs(azimuth=40.0)])


def test_an_unknown_method_is_refused():
    with pytest.raises(facets.FacetError, match="accepted: mixture, abel, crf"):
        facets.estimate(gaussian_line(1000), isotropic=True, method="guess")


def test_slopes_of_few_distinct_values_keep_their_mean_square():
    heights = np.round(np.cumsum(np.random.default_rng(3).normal(scale=0.04, size=20_000)), 2)
    table = facets.estimate(samples.surface(heights), isotropic=True)
    rms = np.sqrt(np.mean(np.diff(heights) ** 2))
    assert float(table["slope_rms"]) == pytest.approx(np.sqrt(2) * rms, rel=0.06)


def test_two_directions_take_a_mixture_alone_and_add_their_slopes_by_scale():
    rng = np.random.default_rng(4)
    lines = [line(rng.normal(scale=s, size=20_000), azimuth=z) for s, z in ((0.2, 0.0), (0.02, 90.0))]
    with pytest.raises(facets.FacetError, match="accepted for two directions: mixture"):
        facets.estimate(lines, method="crf")
    table = facets.estimate(lines)
    assert float(table["slope_rms_scale"][0]) == pytest.approx(float(table["slope_rms"]), rel=1e-3)


def test_a_real_profile_of_coarse_heights_keeps_its_slope(shared_data):
    profile = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "hfm-1.hfm"))
    table = facets.estimate(profile, isotropic=True)
    assert float(table["slope_rms"]) == pytest.approx(0.0224, rel=0.02)

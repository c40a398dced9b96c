"""From line profiles to densities: every method recovers known ones, and a single line must be declared isotropic."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, masking, surfaces, vocabulary
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.surfaces.heights import LINE_MIN


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


def test_a_single_line_is_refused_unless_declared_isotropic():
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


def test_a_mixture_of_gaussians_does_not_fit_a_grooved_line():
    sawtooth = np.cumsum(np.where(np.arange(20_000) % 40 < 20, 0.1, -0.1))
    jitter = np.random.default_rng(6).normal(scale=0.002, size=20_000)
    table = facets.estimate(samples.surface(sawtooth + jitter), isotropic=True)
    assert any("a mixture of Gaussians does not fit" in warning for warning in vocabulary.warnings(table))


def test_a_short_line_is_refused():
    with pytest.raises(facets.FacetError, match="has 49 slopes between neighbouring heights; at least 63 are needed"):
        facets.estimate(samples.surface(np.random.default_rng(0).normal(size=50)), isotropic=True)


@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_a_flat_line_is_refused(tilt):
    with pytest.raises(facets.FacetError, match="is flat: all its slopes are equal"):
        facets.estimate(samples.surface(tilt * np.arange(1000)), isotropic=True)


@pytest.mark.parametrize("factor", [1e-200, 1e-12, 1e12, 1e60, 1e200])
def test_heights_in_an_impossible_unit_are_refused(factor):
    line = gaussian_line(1000)
    line["height"] = line["height"] * factor
    with pytest.raises(facets.FacetError, match=r"impossible slope rms .*; check the unit.*`surface\.unit`"):
        facets.estimate(line, isotropic=True)


@pytest.mark.parametrize("azimuth", [float("nan"), float("inf")])
def test_an_azimuth_that_is_not_finite_is_refused(azimuth):
    with pytest.raises(facets.FacetError, match="azimuth of a line is not a finite number"):
        facets.estimate(lines_at(0.0, azimuth))


def test_the_shortest_accepted_line_has_a_density_of_large_uncertainty():
    table = facets.estimate(gaussian_line(LINE_MIN), isotropic=True)
    assert float(table["facet_count"]) == LINE_MIN - 1
    # The peak of 63 Gaussian slopes deviates by 33 % (median of 20 lines).
    assert float(table["D_u"][0] / table["D"][0]) > 0.25
    assert any("independent slopes along the line" in warning for warning in vocabulary.warnings(table))


@pytest.mark.parametrize(("points", "warned"), [(200, True), (20_000, False)])
def test_few_slopes_cause_a_warning(points, warned):
    table = facets.estimate(gaussian_line(points), isotropic=True)
    assert any("surface.scans" in warning for warning in vocabulary.warnings(table)) == warned
    rough, smooth = lines_at(0.0, 90.0, points=points)
    assert (
        any("surface.scans" in warning for warning in vocabulary.warnings(facets.estimate([rough, smooth]))) == warned
    )


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
    # K = 1/⟨1/(1 + s²)⟩ = 1.07476 at σ = 0.2.
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


def test_rings_recover_a_ring():
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


def lines_at(*azimuths, points=2000):
    return [
        gaussian_line(points, sigma=0.2 if n % 2 else 0.1, seed=n).assign_attrs(azimuth=azimuth)
        for n, azimuth in enumerate(azimuths)
    ]


@pytest.mark.parametrize(
    ("azimuths", "found"), [((0, 40.0), "2, at 0°, 40°"), ((0, 45.0, 90.4), "3, at 0°, 45°, 90.4°")]
)
def test_directions_that_are_not_two_and_perpendicular_are_refused_with_their_azimuths(azimuths, found):
    with pytest.raises(facets.FacetError, match=rf"two perpendicular directions \(within 1°\).*found {found}"):
        facets.estimate(lines_at(*azimuths))


@pytest.mark.parametrize("azimuths", [(0.3,), (0.0, 0.6), (179.8, 0.1), (90.0, 270.5)])
def test_lines_within_a_degree_run_in_a_single_direction(azimuths):
    with pytest.raises(facets.FacetError, match="all lines run in one direction"):
        facets.estimate(lines_at(*azimuths))


@pytest.mark.parametrize(
    ("azimuths", "lay"), [((0.0, 90.0, 0.4), 0.2), ((179.8, 90.0, 0.2), 0.0), ((30.0, 120.5), 30.0)]
)
def test_lines_within_a_degree_count_together(azimuths, lay):
    table = facets.estimate(lines_at(*azimuths))
    assert float(table["lay"]) == pytest.approx(lay, abs=1e-6)
    assert float(table["facet_count"]) == len(azimuths) * 1999


def test_lines_of_different_pitch_are_refused_but_for_a_per_cent():
    one, two = lines_at(0.0, 0.0)
    facets.estimate([one, two.assign_attrs(pitch_x=1.009)], isotropic=True)
    with pytest.raises(facets.FacetError, match=r"pitch_x is 1 um and 1\.2 um"):
        facets.estimate([one, two.assign_attrs(pitch_x=1.2)], isotropic=True)


def test_lines_of_another_magnification_do_not_count_as_facets():
    one, two = lines_at(0.0, 0.0)
    table = facets.estimate([one, two.assign_attrs(pitch_x=2.0)], isotropic=True)
    assert float(table["facet_count"]) == 1999
    assert "extend the roughness spectrum alone" in table.attrs["history"]


def test_slopes_by_scale_are_about_the_mean_of_each_line():
    height = gaussian_line(5000)["height"].values
    table = facets.estimate(samples.surface(height + 0.5 * np.arange(5000)), isotropic=True)
    assert float(table["slope_rms_scale"][0]) == pytest.approx(float(table["slope_rms"]), rel=1e-3)


def test_an_unknown_method_is_refused():
    with pytest.raises(facets.FacetError, match="accepted: mixture, abel, crf"):
        facets.estimate(gaussian_line(1000), isotropic=True, method="guess")


def test_slopes_of_few_distinct_values_keep_their_mean_square():
    heights = np.round(np.cumsum(np.random.default_rng(3).normal(scale=0.04, size=20_000)), 2)
    table = facets.estimate(samples.surface(heights), isotropic=True)
    rms = np.sqrt(np.mean(np.diff(heights) ** 2))
    assert float(table["slope_rms"]) == pytest.approx(np.sqrt(2) * rms, rel=0.06)


def test_two_directions_accept_the_mixture_alone_and_add_their_slopes_by_scale():
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
    assert "counted in whole multiples" in table.attrs["history"]
    # The instrument's stage vibrated during the measurement: the shoulder is too steep for a mixture, and rings now keep the mean.
    assert table.attrs["method"] == "line profile, abel"
    assert not any("do not reproduce" in warning for warning in vocabulary.warnings(table))


def test_coarse_steps_cause_a_warning():
    quantum = 0.07
    table = facets.estimate(samples.surface(quantum * np.round(gaussian_line()["height"] / quantum)), isotropic=True)
    assert any("finer height resolution" in warning for warning in vocabulary.warnings(table))


@pytest.mark.parametrize("share", [2.0, 3.0, 4.0])
def test_steps_far_coarser_than_the_slopes_determine_the_width_alone(share):
    # Of steps of four rms, a fifth of the slopes is not zero.
    quantum = 0.1 * share
    table = facets.estimate(samples.surface(quantum * np.round(gaussian_line()["height"] / quantum)), isotropic=True)
    assert any("coarse height steps" in warning for warning in vocabulary.warnings(table))
    slope = 0.1 * np.array([0.0, 0.5, 1.0, 1.5])
    assert RadialDensity.of(table)(slope**2) == pytest.approx(gaussian(slope, 0.1), rel=0.1)
    assert (table["D_u"] / table["D"]).values.min() > 0.6


def test_a_density_that_no_method_fits_has_an_uncertainty_of_1():
    # Nine in ten slopes are zero and the others any: a plateau, whose peak neither way can give.
    rng = np.random.default_rng(7)
    slopes = np.where(rng.random(50_000) < 0.9, 0.0, rng.normal(scale=0.1, size=50_000))
    table = facets.estimate(line(slopes), isotropic=True)
    assert any("a mixture of Gaussians does not fit" in warning for warning in vocabulary.warnings(table))
    assert (table["D_u"] / table["D"]).values[0] > 0.5


@pytest.mark.parametrize("share", [1.0, 2.0, 3.0])
def test_coarse_steps_increase_the_uncertainty_of_the_shape(share):
    # Steps in units of the width of GGX: neither a mixture nor rings can know its peak.
    height = 0.1 * share * np.round(ggx_line()["height"] / (0.1 * share))
    table = facets.estimate(samples.surface(height), isotropic=True)
    slope = 0.1 * np.array([0.0, 0.5, 1.0, 2.0])
    deviation = RadialDensity.of(table)(slope**2) / ggx(slope, 0.1) - 1
    relative_u = np.interp(slope, table["slope"], (table["D_u"] / table["D"]).values)
    assert np.abs(deviation / relative_u).max() < 2


def test_lines_of_different_quanta_give_the_density_of_each():
    lines = [
        samples.surface(quantum * np.round(gaussian_line(seed=seed)["height"] / quantum))
        for seed, quantum in ((1, 0.025), (2, 0.01), (3, 0.08))
    ]
    lines.append(gaussian_line(seed=4))
    slope = 0.1 * np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    for method, limit in (("mixture", 0.02), ("abel", 0.03)):
        table = facets.estimate(lines, isotropic=True, method=method)
        assert RadialDensity.of(table)(slope**2) == pytest.approx(gaussian(slope, 0.1), rel=limit)
        assert not any("mixture of Gaussians does not fit" in warning for warning in vocabulary.warnings(table))
        # Of 400 000 slopes, few are correlated.
        assert float(table["effective_count"]) > 200_000


def test_the_patents_histogram_of_lines_of_different_quanta_is_that_of_one():
    fine, coarse = gaussian_line(seed=1), gaussian_line(seed=2)
    mixed = [fine, samples.surface(0.03 * np.round(coarse["height"] / 0.03))]
    slope = 0.1 * np.array([0.3, 0.6, 1.0, 1.5])
    rounded, expected = (
        RadialDensity.of(facets.estimate(lines, isotropic=True, method="crf"))(slope**2)
        for lines in (mixed, [fine, coarse])
    )
    # Bins of a few thousand slopes each, whose borders differ, and 1.5 % more mean square by rounding.
    assert rounded == pytest.approx(expected, rel=0.06)


def with_spikes(surface, rise=8.0):
    """Every 6000th height moved: 0.03 % of the slopes are steep."""
    height = surface["height"].values.copy()
    height[3::6000] += rise
    return surface.assign(height=surface["height"].copy(data=height))


@pytest.mark.parametrize("method", ["mixture", "abel", "crf"])
def test_spikes_of_a_line_do_not_decide_its_slope(method):
    clean = gaussian_line()
    table = facets.estimate(with_spikes(clean), isotropic=True, method=method)
    reference = facets.estimate(clean, isotropic=True, method=method)
    assert float(table["slope_rms"]) == pytest.approx(float(reference["slope_rms"]), rel=0.01)
    assert float(table["noise_ratio"]) == pytest.approx(float(reference["noise_ratio"]), rel=0.01)
    # The spikes are in the tail, and stated.
    assert float(table["tail_contribution"]) > 3 * float(reference["tail_contribution"])
    (warning,) = [text for text in vocabulary.warnings(table) if "of the slopes along a line, steeper than" in text]
    assert "the slope rms is without them" in warning


def test_spikes_of_one_of_two_perpendicular_lines_show_no_lay():
    first, second = gaussian_line(seed=1), gaussian_line(seed=2).assign_attrs(azimuth=90.0)
    table = facets.estimate([first, with_spikes(second)])
    assert float(table["anisotropy"]) == pytest.approx(1, abs=0.02)
    assert 0 < float(table["tail_share"]) < 0.01


def test_the_tail_of_a_gaussian_line_holds_the_facets_beyond_its_slopes():
    table = facets.estimate(gaussian_line(), isotropic=True)
    half = float(table["tail_slope"]) ** 2 / (2 * 0.1**2)
    # The slope rms of a line of 10⁵ is known to 0.5 %, and at 2.5 rms the share changes by six times as much.
    assert float(table["tail_share"]) == pytest.approx(np.exp(-half), rel=0.1)
    assert float(table["tail_contribution"]) == pytest.approx((1 + half) * np.exp(-half), rel=0.1)


@pytest.mark.parametrize("method", ["mixture", "abel"])
@pytest.mark.parametrize("make", [gaussian_line, ggx_line])
def test_the_density_of_a_line_falls_through_where_extrapolation_begins(make, method):
    table = facets.estimate(make(), isotropic=True, method=method)
    near = np.abs(np.log(table["slope"].values[1:] / float(table["tail_slope"]))) < np.log(2)
    # The outermost ring is even.
    assert (np.diff(table["slope_density"].values)[near] <= 0).all()

"""Scans that are tilted, do not belong together or are in a wrong unit."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, surfaces, vocabulary
from brdfpipe.facets import slopes
from brdfpipe.facets.radial_density import RadialDensity

STATISTICS = ["slope_rms", "anisotropy", "noise_ratio", "facet_count"]


@pytest.fixture(scope="module")
def scan():
    return samples.gaussian_surface(256, correlation=6)


@pytest.fixture(scope="module")
def other():
    return samples.gaussian_surface(256, correlation=6, seed=2)


def tilted(scan, slope):
    return scan.assign(height=scan["height"] + slope * scan["x"] - 2 * slope * scan["y"])


@pytest.mark.parametrize("isotropic", [True, False])
def test_a_tilt_is_removed_and_causes_a_warning(scan, isotropic):
    level, tilt = (facets.estimate(surface, isotropic=isotropic) for surface in (scan, tilted(scan, 0.1)))
    for name in STATISTICS:
        assert float(tilt[name]) == pytest.approx(float(level[name]), rel=1e-5)
    # Slopes of single precision may move a fine bin's border into the next bin: less than half of the uncertainty, 5 % or more.
    measured = level["slope_density_quality"].values == vocabulary.quality("measured")
    assert tilt["slope_density"].values[measured] == pytest.approx(level["slope_density"].values[measured], rel=0.025)
    assert any("level the surface" in warning for warning in vocabulary.warnings(tilt))
    assert not any("mean slope" in warning for warning in vocabulary.warnings(level))


def test_scans_tilted_against_each_other_show_no_lay(scan, other):
    level, tilt = facets.estimate([scan, other]), facets.estimate([tilted(scan, 0.1), tilted(other, -0.1)])
    assert tilt["slope_density"].dims == ("slope",)
    for name in STATISTICS:
        assert float(tilt[name]) == pytest.approx(float(level[name]), rel=1e-5)


def test_the_slope_rms_is_about_the_mean_of_the_present_slopes(scan):
    height = scan["height"].values.copy()
    height[0, 3], height[50:120, 20:200] = np.nan, np.nan
    gaps = scan.assign(height=scan["height"].copy(data=height))
    level, tilt = facets.estimate(gaps, isotropic=True), facets.estimate(tilted(gaps, 0.2), isotropic=True)
    assert float(tilt["slope_rms"]) == pytest.approx(float(level["slope_rms"]), rel=1e-6)
    # Counted about zero, a tilt of twice the slope rms would empty the middle.
    assert tilt["slope_density"].values[0] == pytest.approx(level["slope_density"].values[0], rel=1e-2)


def test_the_mean_slope_of_a_whole_map_is_known_from_its_border():
    height = np.random.default_rng(5).normal(size=(37, 53)) + 0.4 * np.arange(53)
    p, q = np.diff(height, axis=1), np.diff(height, axis=0)
    exact = [(p[:-1] + p[1:]).mean() / 2, (q[:, :-1] + q[:, 1:]).mean() / 2]
    assert slopes.mean_slope(slopes.HeightMap.of(samples.surface(height))) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize(
    ("attributes", "named"),
    [
        ({"pitch_x": 1.02}, "pitch_x is 1 um and 1.02 um"),
        ({"pitch_y": 0.5}, "pitch_y is 1 um and 0.5 um"),
        ({"lambda_s": 5.0}, "lambda_s is not set and 5 um"),
        ({"lambda_c": 80.0}, "lambda_c is not set and 80 um"),
    ],
)
def test_scans_of_different_bandwidth_are_refused(scan, other, attributes, named):
    with pytest.raises(facets.FacetError, match=f"scans 1 and 3 .* {named}; accepted"):
        facets.estimate([scan, other, other.assign_attrs(attributes)])


def test_pitches_may_differ_a_little_or_below_one_filter(scan, other):
    facets.estimate([scan, other.assign_attrs(pitch_x=1.005)])
    facets.estimate(
        [surface.assign_attrs(lambda_s=16.0, pitch_x=pitch) for surface, pitch in ((scan, 1.0), (other, 2.0))]
    )


def test_a_repeated_scan_is_refused(scan, other):
    height = scan["height"].values.copy()
    height[3, 4] = np.nan
    gap = samples.surface(height)
    with pytest.raises(facets.FacetError, match="scans 1 and 3 of the surface have identical heights"):
        facets.estimate([gap, other, gap.copy(deep=True)])


def test_one_line_may_be_given_for_two_directions_but_not_twice_for_one():
    height = np.cumsum(np.random.default_rng(1).normal(scale=0.1, size=5000))
    line = samples.surface(height, pitch=(1.0,))
    facets.estimate([line, line.assign_attrs(azimuth=90.0)])
    with pytest.raises(facets.FacetError, match="have identical heights"):
        facets.estimate([line, line], isotropic=True)


def test_scans_of_clearly_different_roughness_are_warned_about(scan, other):
    rough = [
        text
        for text in vocabulary.warnings(facets.estimate([other, scan * 1.5]))
        if "slope rms differs between scans" in text
    ]
    assert len(rough) == 1
    assert "0.211 in scan 1, 0.319 in scan 2" in rough[0]
    assert not any("slope rms differs" in text for text in vocabulary.warnings(facets.estimate([scan, other])))


def with_spikes(scan, rise):
    """The map with steps along x: 0.03 % of its facets are steep, in one direction."""
    height = scan["height"].values.copy()
    height[8::64, 8::64] += rise
    height[9::64, 8::64] += rise
    return scan.assign(height=scan["height"].copy(data=height))


@pytest.mark.parametrize("rise", [10.0, 1e3])
def test_spikes_change_neither_the_slope_nor_the_lay_decision_and_are_warned_about(scan, rise):
    clean, spiked = facets.estimate(scan), facets.estimate(with_spikes(scan, rise))
    assert "slope" in spiked.dims
    for name in ("slope_rms", "anisotropy"):
        assert float(spiked[name]) == pytest.approx(float(clean[name]), rel=5e-3)
    assert float(spiked["slope_rms_scale"][0]) == pytest.approx(float(clean["slope_rms_scale"][0]), rel=5e-3)
    assert float(spiked["tail_contribution"]) > 0.7 > 0.2 > float(clean["tail_contribution"])
    assert [text for text in vocabulary.warnings(spiked) if "mark the spikes as missing" in text]
    # The density that makes the BRDF is that of the other facets, but for its tail; the edges of the bins, known to 5 %, differ.
    half = slice(0, clean["slope"].size // 2)
    density = np.interp(clean["slope"][half], spiked["slope"], spiked["slope_density"])
    assert density == pytest.approx(clean["slope_density"].values[half], rel=0.1)


def test_a_lay_with_spikes_across_it_stays_the_lay(scan):
    brushed = scan.assign_attrs(pitch_y=3.0)
    clean, spiked = (facets.estimate(surface, isotropic=False) for surface in (brushed, with_spikes(brushed, 100.0)))
    assert float(spiked["anisotropy"]) == pytest.approx(float(clean["anisotropy"]), rel=0.01)
    assert float(spiked["lay"]) == pytest.approx(float(clean["lay"]), abs=0.5)
    assert float(spiked["tail_contribution"]) > 0.9


@pytest.mark.parametrize("name", ["plu-1.plu", "sur-2.sur", "nms-2.nms", "frt-1.frt"])
def test_real_densities_of_spiky_scans_fall_where_extrapolation_begins(shared_data, name):
    table = facets.estimate(surfaces.level(surfaces.read_surface(shared_data / "surfaces" / name)), isotropic=True)
    density, start = RadialDensity.of(table), float(table["tail_slope"])
    slope = start * np.linspace(0.8, 1.5, 200)
    logarithm = np.log(density(slope**2))
    decay = -np.diff(logarithm) / np.diff(slope) * start
    assert decay.min() >= 0
    # A step of half a decade, as a tail of its own would begin with, would be a decay of 200.
    assert decay.max() < 40
    assert float(table["tail_contribution"]) > 0.1


@pytest.mark.parametrize("isotropic", [True, False])
def test_a_plateau_is_named_in_the_message(scan, isotropic):
    height = scan["height"].values.copy()
    height[13:] = 0
    with pytest.raises(facets.FacetError, match=r"9[45]% of them .* a plateau"):
        facets.estimate(samples.surface(height), isotropic=isotropic)


def test_independent_facets_are_no_more_than_heights():
    noise = samples.surface(np.random.default_rng(2).normal(scale=0.1, size=(256, 256)))
    for isotropic in (True, False):
        assert 0.9 < float(facets.estimate(noise, isotropic=isotropic)["effective_count"]) / 256**2 <= 1


def test_independent_facets_do_not_depend_on_how_the_density_is_made(scan):
    one, two = (float(facets.estimate(scan, isotropic=isotropic)["effective_count"]) for isotropic in (True, False))
    assert one == two


def test_lines_of_different_bandwidth_are_refused():
    height = np.cumsum(np.random.default_rng(1).normal(scale=0.1, size=2000))
    lines = [samples.surface(height, pitch=(pitch,)) for pitch in (1.0, 1.2)]
    with pytest.raises(facets.FacetError, match="have different bandwidths"):
        facets.estimate(lines, isotropic=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("factor", [1e25, 1e40, 1e150, 1e-25, 1e-40])
def test_heights_in_an_impossible_unit_are_refused(scan, factor):
    with pytest.raises(facets.FacetError, match="check the unit of the heights"):
        facets.estimate(scan.assign(height=scan["height"] * factor))


def test_an_unknown_correlation_length_says_what_to_do(scan):
    wave = 3 * np.sin(2 * np.pi * scan["x"] / 1000)
    table = facets.estimate(scan.assign(height=scan["height"] + wave), isotropic=True)
    assert np.isnan(table["correlation_length"])
    assert any("surface.lambda_c" in warning for warning in vocabulary.warnings(table))


def test_a_map_of_few_correlation_lengths_warns_of_an_understated_uncertainty():
    narrow, wide = (facets.estimate(samples.gaussian_surface(size, correlation=10)) for size in (128, 256))
    (warning,) = (text for text in vocabulary.warnings(narrow) if "correlation lengths wide" in text)
    needed = 16 * float(narrow["correlation_length"])
    assert "fewer than 16, and the uncertainty" in warning
    assert f"at least {needed:.3g} µm wide" in warning
    assert not any("correlation lengths wide" in warning for warning in vocabulary.warnings(wide))


def test_a_real_scan_of_spikes_and_gaps_is_counted_without_its_spikes(shared_data):
    gaps = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "frt-1.frt"))
    table = facets.estimate(gaps)
    assert any("mark the spikes as missing" in warning for warning in vocabulary.warnings(table))
    # With its spikes the rms slope is 0.0126; three quarters of the facets are below 0.002.
    assert 0.0015 < float(table["slope_rms"]) < 0.0025
    assert float(table["tail_contribution"]) > 0.9
    # The blocks' own slope rms spans 0.0015 to 0.09; no bin beyond the middle is known to 10 %.
    assert float((table["D_u"] / table["D"]).max()) > 0.15


@pytest.mark.parametrize("rounding", [0.0, 1e-12])
@pytest.mark.parametrize(("amplitude", "along"), [(1.0, "x"), (1.0, "y"), (0.05, "x")])
def test_grooves_without_slopes_along_them_are_refused_in_words(amplitude, along, rounding):
    profile = amplitude * np.sin(2 * np.pi * np.arange(64) / 20)
    height = np.tile(profile, (64, 1)) + rounding * np.random.default_rng(1).normal(size=(64, 1))
    surface = samples.surface(height.T if along == "x" else height, (0.5, 0.5))
    with pytest.raises(facets.FacetError, match="no slopes along the lay"):
        facets.estimate(surface, noise=0.0)


def test_grooves_with_hardly_any_slopes_along_them_have_both_slopes():
    # Rows shifted at random by 1 nm: a slope of √2 nm over 0.5 µm along the grooves, without the mean of the two edges of a quad.
    rows = 1e-3 * np.random.default_rng(1).normal(size=(128, 1))
    height = np.sin(2 * np.pi * np.arange(128) / 20) + rows
    found = facets.estimate(samples.surface(height, (0.5, 0.5)), noise=0.0)
    across = np.sqrt(np.mean(np.diff(height, axis=1) ** 2))
    along = np.diff(rows[:, 0]).std()
    assert float(found["anisotropy"]) == pytest.approx(across / along, rel=0.02)
    assert abs(float(found["lay"])) == pytest.approx(90, abs=0.1)

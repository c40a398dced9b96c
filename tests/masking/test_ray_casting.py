"""Rays cast over heights, against the identity of the mean G1, closed forms and Smith."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import facets, masking, vocabulary
from brdfpipe.errors import VocabularyError
from brdfpipe.masking import ray_casting as raycast
from brdfpipe.masking.ray_casting import RaycastError

THETA = np.array([0.0, 10.0, 30.0, 60.0, 75.0, 85.0, 89.0, 89.9])


def rough_line(kind: str, sigma: float, seed: int = 3, points: int = 20_001):
    """Heights of a line whose slopes are Gaussian or GGX (both integrated), or whose heights are white noise."""
    rng = np.random.default_rng(seed)
    if kind == "white noise":
        return sigma / np.sqrt(2) * rng.normal(size=points)
    if kind == "gaussian":
        return np.cumsum(sigma * rng.normal(size=points))
    # The slopes of GGX along a line, P1 = a² / [2 (a² + p²)^(3/2)], inverted.
    u = rng.uniform(-1, 1, points)
    return np.cumsum(sigma * u / np.sqrt(1 - u * u))


def identity_error(dataset) -> float:
    return float(np.abs(dataset["g1"] * (1 + dataset["lambda_empirical"]) - 1).max())


def with_gaps(height, fraction: float, seed: int = 4):
    """Patches of missing heights, five samples wide."""
    rng = np.random.default_rng(seed)
    start = rng.random(height.shape) < fraction / 5
    gap = start.copy()
    for shift in range(1, 5):
        gap |= np.roll(start, shift, axis=-1)
    return np.where(gap, np.nan, height)


def by_slope(rough, theta: float, edges=None):
    """(edges, G1 and count by slope) of facets by their slope towards the viewer, azimuth 0; 24 bins over three times the rms."""
    blocks = list(raycast._AzimuthLines.of(rough, 0.0).blocks(None))
    if edges is None:
        segments = sum(block.segments for block in blocks)
        edges = 3 * np.sqrt(sum(np.sum(block.slope**2) for block in blocks) / segments) * np.linspace(-1, 1, 25)
    visible, count = np.zeros((2, edges.size - 1))
    for block in blocks:
        fraction, facing = block.fraction(theta)
        facing = facing & block.inside
        count += np.histogram(block.slope[facing], edges)[0]
        visible += np.histogram(block.slope[facing], edges, weights=fraction[facing])[0]
    with np.errstate(invalid="ignore"):
        return edges, visible / count, count


# --- the identity: masking conserves the projected area


@pytest.mark.parametrize("kind", ["gaussian", "ggx", "white noise"])
@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_the_mean_g1_of_a_line_is_smith_of_its_own_slopes(kind, sigma):
    line = samples.surface(rough_line(kind, sigma))
    assert identity_error(raycast.raycast(line, THETA, [0.0, 180.0])) < 1e-10


@given(
    heights=st.lists(st.floats(-100, 100), min_size=32, max_size=80),
    theta=st.floats(0, raycast.THETA_MAX),
    phi=st.sampled_from([0.0, 180.0, -180.0, 360.0]),
)
@settings(max_examples=100, deadline=None)
def test_the_identity_holds_for_any_heights(heights, theta, phi):
    assert identity_error(raycast.raycast(samples.surface(heights), theta, phi)) < 1e-10


@pytest.mark.parametrize("gaps", [0.0, 0.05, 0.3])
def test_the_identity_holds_on_a_map_with_gaps_at_every_azimuth(gaps):
    height = with_gaps(samples.gaussian_surface(160, sigma=0.4, correlation=4)["height"].values, gaps)
    cast = raycast.raycast(samples.surface(height, pitch=(1.0, 2.0)), THETA, [-160.0, 0.0, 27.0, 90.0, 135.0, 270.0])
    assert identity_error(cast) < 1e-10


# --- closed forms


@pytest.mark.parametrize("height", [np.zeros(100), 0.3 * np.arange(100), np.zeros((40, 50))])
def test_a_flat_or_tilted_surface_is_not_masked(height):
    # The mean slope is form, not texture, and is taken away.
    assert raycast.raycast(samples.surface(height), THETA)["g1"].values == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("phi", [0.0, 180.0])
@pytest.mark.parametrize("slope", [0.1, 0.5])
def test_a_symmetric_sawtooth_has_its_closed_form(slope, phi):
    # Equal flanks of slope ±s: Λ = (s − μ)⁺ / 2μ.
    teeth = slope * np.abs((np.arange(401) + 20) % 40 - 20.0)
    mu = 1 / np.tan(np.radians(THETA[1:]))
    expected = 1 / (1 + np.maximum(slope - mu, 0) / (2 * mu))
    assert raycast.raycast(samples.surface(teeth), THETA[1:], phi)["g1"].values == pytest.approx(expected, rel=1e-10)


def test_an_asymmetric_sawtooth_masks_differently_from_each_side():
    # Up 3 samples at 0.6, down 9 at 0.2: towards +x the steep flank faces away, Λ = ¼ (0.6 − μ)⁺ / μ; back ¾ (0.2 − μ)⁺
    # / μ.
    tooth = np.cumsum(np.where(np.arange(600) % 12 < 3, 0.6, -0.2))
    line = samples.surface(np.concatenate([[0.0], tooth]))
    mu = 1 / np.tan(np.radians(80.0))
    expected = [1 / (1 + (0.6 - mu) / (4 * mu)), 1 / (1 + 3 * (0.2 - mu) / (4 * mu))]
    assert raycast.raycast(line, 80.0, [0.0, 180.0])["g1"].values == pytest.approx(expected, rel=1e-10)


def test_the_lit_part_of_a_sawtooth_ends_where_the_next_ridge_shades_it():
    # Flanks of slope ±½, 20 long; μ = ¼. The ray over the next ridge, 10 high, falls by 5 to the valley and meets the
    # facing flank u samples behind it where 5 − ¼u = ½u: at a third of the flank.
    teeth = 0.5 * np.abs((np.arange(401) + 20) % 40 - 20.0)
    theta = np.degrees(np.arctan(4.0))
    both = raycast.bistatic(samples.surface(teeth), theta, 0.0, theta, 180.0)
    # No flank faces both: each is steeper than the rays.
    assert np.isnan(both["g2"])
    one = raycast.bistatic(samples.surface(teeth), theta, 0.0, theta, 0.0)
    assert float(one["g2"]) == pytest.approx(2 / 3, rel=1e-12)


@pytest.mark.parametrize(("floor", "lost"), [(20, (4.4, 9.5)), (3, (1.3, 1.2)), (3, (1.7, 1.6))])
def test_the_floor_of_a_groove_is_lit_and_seen_where_the_shadows_of_its_walls_leave_it(floor, lost):
    # Grooves 2 deep, ridges 8 wide, walls one sample: a wall hides 2/μ − 1 of the floor. With a floor of three samples both
    # shadows end inside the middle one.
    groove = np.concatenate([np.zeros(9), np.full(floor + 1, -2.0)])
    line = samples.surface(np.append(np.tile(groove, 10), 0.0))
    theta_i, theta_o = np.degrees(np.arctan2(1 + np.array(lost), 2.0))
    traced = raycast.bistatic(line, theta_i, 0.0, theta_o, 180.0)
    assert float(traced["g2"]) == pytest.approx((8 + max(floor - sum(lost), 0)) / (8 + floor), rel=1e-10)


def test_lines_run_along_the_rows_for_azimuth_0_and_the_columns_for_90():
    ridges = np.tile(0.5 * np.abs((np.arange(81) + 20) % 40 - 20.0), (50, 1))
    g1 = raycast.raycast(samples.surface(ridges), 80.0, [0.0, 90.0, 180.0, 270.0])["g1"].values
    mu = 1 / np.tan(np.radians(80.0))
    across = 1 / (1 + (0.5 - mu) / (2 * mu))
    assert g1 == pytest.approx([across, 1, across, 1], rel=1e-10)


def test_an_oblique_azimuth_sees_the_slope_projected_onto_it():
    # Straight ridges stay straight under linear interpolation: slope s cos φ. The ends of the lines, cut anywhere in a
    # tooth, cost 2 %.
    ridges = np.tile(0.5 * np.abs((np.arange(1201) + 20) % 40 - 20.0), (1201, 1))
    mu = 1 / np.tan(np.radians(80.0))
    for phi in (30.0, 150.0, -30.0):
        slope = 0.5 * np.cos(np.radians(30))
        visible = float(raycast.raycast(samples.surface(ridges), 80.0, phi)["g1"])
        assert visible == pytest.approx(1 / (1 + (slope - mu) / (2 * mu)), rel=0.02)


def test_a_diagonal_line_has_the_smaller_slopes_between_its_samples():
    # White noise: differences of one rms over √2 pitches along the diagonal, over one pitch along the rows, where facets of
    # every azimuth keep the latter.
    noise = samples.surface(np.random.default_rng(2).normal(scale=0.3, size=(300, 300)))
    rows, diagonal = (float(raycast.raycast(noise, 80.0, phi)["lambda_empirical"]) for phi in (0.0, 45.0))
    expected = [
        float(masking.g1(facets.analytic("beckmann", 2 * 0.3 / step), 80.0)) ** -1 - 1 for step in (1.0, np.sqrt(2))
    ]
    # 90 000 slopes know Λ to a percent.
    assert [rows, diagonal] == pytest.approx(expected, rel=0.03)


def test_a_map_rotated_by_90_degree_has_its_masking_rotated():
    height = samples.gaussian_surface(96, sigma=0.4, correlation=4)["height"].values
    # Columns become rows: what lay towards +x lies towards +y, at 33 degree from there.
    here = raycast.raycast(samples.surface(height, pitch=(1.0, 1.5)), 80.0, 33.0)["g1"]
    there = raycast.raycast(samples.surface(height.T, pitch=(1.5, 1.0)), 80.0, 57.0)["g1"]
    assert float(here) == pytest.approx(float(there), rel=1e-12)


def test_a_mirrored_map_has_its_masking_mirrored():
    height = samples.gaussian_surface(96, sigma=0.4, correlation=4)["height"].values[:70]
    here, there = samples.surface(height), samples.surface(height[::-1])
    for phi in (25.0, 70.0):
        one, other = raycast.raycast(here, 80.0, phi)["g1"], raycast.raycast(there, 80.0, -phi)["g1"]
        # Lines across the columns begin at the other end, which is another choice of lines.
        assert float(one) == pytest.approx(float(other), rel=1e-12 if phi < 45 else 0.01)


def test_a_turned_or_mirrored_map_has_the_same_bistatic_masking_out_of_plane():
    height = samples.gaussian_surface(128, sigma=0.4, correlation=8)["height"].values[:100]

    def g2(heights, phi_i, phi_o):
        return float(raycast.bistatic(samples.surface(heights), 75.0, phi_i, 80.0, phi_o)["g2"])

    assert g2(height.T, 70.0, -55.0) == pytest.approx(g2(height, 20.0, 145.0), rel=1e-12)
    assert g2(height[::-1], -20.0, -145.0) == pytest.approx(g2(height, 20.0, 145.0), rel=1e-12)
    # Seen from its back a map keeps its surface, not its lines.
    assert g2(height[::-1, ::-1], 200.0, 325.0) == pytest.approx(g2(height, 20.0, 145.0), abs=0.01)


def test_the_unit_of_length_does_not_matter():
    height = rough_line("gaussian", 0.3, points=500)
    small = samples.surface(height * 1e-3, pitch=(1e-3, 1e-3))
    expected = raycast.raycast(samples.surface(height), THETA)["g1"].values
    assert raycast.raycast(small, THETA)["g1"].values == pytest.approx(expected, rel=1e-12)


# --- what any masking obeys


@pytest.mark.parametrize("kind", ["gaussian", "ggx", "white noise"])
def test_g1_falls_towards_grazing(kind):
    g1 = raycast.raycast(samples.surface(rough_line(kind, 0.4, points=2001)), np.linspace(0, 89.9, 100))["g1"].values
    assert g1[0] == pytest.approx(1, abs=1e-12)
    assert (np.diff(g1) <= 1e-12).all()


@pytest.mark.parametrize("gaps", [0.0, 0.02])
def test_the_bistatic_fraction_is_the_same_with_light_and_viewer_exchanged(gaps):
    rough = samples.surface(with_gaps(samples.gaussian_surface(128, sigma=0.4, correlation=6)["height"].values, gaps))
    for phi in (180.0, 0.0, 70.0):
        there, back = raycast.bistatic(rough, 60.0, 0.0, 80.0, phi), raycast.bistatic(rough, 80.0, phi, 60.0, 0.0)
        assert float(there["g2"]) == pytest.approx(float(back["g2"]), rel=1e-12)


def test_two_equal_directions_are_masked_like_one():
    # G2 of a direction with itself is the fraction of the facets it sees; at normal incidence it sees all.
    line = samples.surface(rough_line("gaussian", 0.4))
    for phi in (0.0, 180.0):
        one = raycast.bistatic(line, 75.0, 0.0, 75.0, 0.0)["g2"]
        with_normal = raycast.bistatic(line, 75.0, 0.0, 0.0, phi)["g2"]
        assert float(with_normal) == pytest.approx(float(one), rel=1e-12)


def test_g2_given_all_slopes_is_the_mean_of_g1_by_slope():
    line = samples.surface(rough_line("gaussian", 0.3))
    _, g1, count = by_slope(line, 80.0, np.linspace(-3, 3, 41))
    assert float(raycast.bistatic(line, 80.0, 0.0, 80.0, 0.0)["g2"]) == pytest.approx(
        np.nansum(count * g1) / count.sum(), rel=1e-10
    )


def test_the_result_does_not_depend_on_the_blocks(monkeypatch):
    height = with_gaps(samples.gaussian_surface(128, sigma=0.4, correlation=4)["height"].values, 0.05)
    whole = raycast.raycast(samples.surface(height), THETA, 30.0)
    monkeypatch.setattr(raycast, "_BLOCK_SAMPLES", 1000)
    in_blocks = raycast.raycast(samples.surface(height), THETA, 30.0)
    for name in whole:
        assert in_blocks[name].values == pytest.approx(whole[name].values, rel=1e-11)


def test_the_result_is_the_same_every_time():
    rough = samples.gaussian_surface(96, sigma=0.4, correlation=4)
    assert raycast.raycast(rough, THETA, [0.0, 40.0]).identical(raycast.raycast(rough, THETA, [0.0, 40.0]))


def test_single_precision_heights_are_cast_in_double():
    rough = samples.gaussian_surface(96, sigma=0.4, correlation=4)
    assert identity_error(raycast.raycast(rough.astype("float32"), THETA)) < 1e-10


def test_the_uncertainty_covers_the_scatter_between_maps():
    # Parts of one map, because the samples are scaled to the slope rms asked for, which takes most of the scatter away.
    whole = samples.gaussian_surface(1024, sigma=0.4, correlation=3)["height"].values
    maps = [samples.surface(part) for strip in np.split(whole, 4) for part in np.split(strip, 4, axis=1)]
    cast = [raycast.raycast(rough, 80.0) for rough in maps]
    stated = np.mean([float(one["g1_u"]) for one in cast])
    scatter = np.std([float(one["g1"]) for one in cast], ddof=1)
    # Sixteen parts know their scatter to 18 %; neighbouring groups of eight lines are not quite independent.
    assert 0.6 < stated / scatter < 1.6


# --- Smith


@pytest.fixture(scope="module")
def gaussian_map():
    return samples.gaussian_surface(1024, sigma=0.4, correlation=16)


def test_smith_of_the_counted_facets_is_the_ray_cast_g1(gaussian_map):
    theta, azimuths = [0.0, 30.0, 60.0, 75.0, 80.0, 88.0], [0.0, 90.0, 180.0, 270.0]
    cast = raycast.raycast(gaussian_map, theta, azimuths)["g1"].mean("phi").values
    difference = np.abs(cast / masking.g1(facets.estimate(gaussian_map, isotropic=True), theta).values - 1)
    assert difference[:4].max() < 0.01
    assert difference.max() < 0.03


def test_smith_of_the_density_drawn_from_is_the_ray_cast_g1(gaussian_map):
    theta = [45.0, 60.0, 75.0, 85.0]
    smith = masking.g1(facets.analytic("beckmann", 0.4 * np.sqrt(2)), theta).values
    cast = raycast.raycast(gaussian_map, theta)
    assert (np.abs(cast["g1"].values - smith) < 4 * cast["g1_u"].values).all()


def test_the_bistatic_masking_lies_between_separable_and_height_correlated():
    # Reference: 0.234 at 85 degree and slope rms 0.4 per axis, against 0.178 and 0.268. Three maps of 64 x 64
    # correlation lengths (16 samples) give 0.228 with a scatter of 0.005; finer sampling and fewer grains of 2048² maps
    # 0.234 ± 0.009.
    maps = [samples.gaussian_surface(1024, sigma=0.4, correlation=16, seed=seed) for seed in (1, 2, 3)]
    cast = [raycast.bistatic(rough, 85.0, axis, 85.0, axis + 180) for rough in maps for axis in (0.0, 90.0)]
    separable, correlated, g2 = (
        np.mean([float(one[name]) for one in cast]) for name in ("g2_separable", "g2_height_correlated", "g2")
    )
    assert separable == pytest.approx(0.178, abs=0.003)
    assert correlated == pytest.approx(0.268, abs=0.003)
    assert g2 == pytest.approx(0.234, abs=0.012)
    assert separable + 0.03 < g2 < correlated - 0.02


def test_out_of_plane_agrees_with_in_plane_where_they_meet(gaussian_map):
    theta = [60.0, 75.0, 85.0]
    exact = raycast.bistatic(gaussian_map, theta, 0.0, theta, 180.0)["g2"]
    on_cells = raycast.bistatic(gaussian_map, theta, 0.0, theta, 179.99)["g2"]
    # A shadow's edge is blurred over one sample of sixteen.
    assert on_cells.values == pytest.approx(exact.values, abs=0.02)


def test_facets_turned_towards_the_viewer_are_seen_more_often_than_smith_says(gaussian_map):
    edges, g1, _ = by_slope(gaussian_map, 75.0)
    slope = (edges[1:] + edges[:-1]) / 2
    # Smith says 0.82 for every facet. On a smooth surface one that the ray barely grazes ends at a crest that hides it.
    assert g1[np.abs(slope + 0.6).argmin()] > g1[np.abs(slope).argmin()] > g1[np.abs(slope - 0.2).argmin()]
    assert np.isnan(g1[slope > 0.35]).all()


def test_g1_along_a_line_is_smiths_of_its_counted_slopes():
    line = samples.surface(rough_line("gaussian", 0.2, points=50_000))
    theta = [0.0, 60.0, 80.0, 85.0]
    cast = raycast.raycast(line, theta, [0.0, 180.0])["g1"].mean("phi").values
    assert cast == pytest.approx(masking.g1(facets.estimate(line, isotropic=True), theta).values, rel=0.02)


# --- labels and refusals


def test_numbers_give_no_dimension_and_the_kind_is_valid():
    line = samples.surface(rough_line("gaussian", 0.2, points=500))
    cast = raycast.raycast(line, 70.0)
    assert cast["g1"].dims == ()
    assert float(cast["theta"]) == 70
    assert raycast.raycast(line, [60.0, 70.0])["g1"].dims == ("theta",)
    assert raycast.raycast(line, 70.0, [0.0, 180.0])["g1"].dims == ("phi",)
    for dataset in (cast, raycast.bistatic(line, [60.0, 70.0], 0.0, 50.0, 180.0)):
        vocabulary.validate(dataset, "raycast")


def test_fewer_lines_are_evenly_spaced_lines():
    rough = samples.gaussian_surface(128, sigma=0.4, correlation=4)
    first_and_last = samples.surface(rough["height"].values[[0, 127]])
    chosen = raycast.raycast(rough, 80.0, lines=2)["g1"]
    assert float(chosen) == pytest.approx(float(raycast.raycast(first_and_last, 80.0)["g1"]), rel=1e-12)


def test_pieces_too_short_are_left_out():
    height = rough_line("gaussian", 0.4, points=400)
    gapped = height.copy()
    gapped[[300, 331]] = np.nan
    pieces = raycast.raycast(samples.surface(gapped), 80.0)["lambda_empirical"]
    alone = [raycast.raycast(samples.surface(part), 80.0)["lambda_empirical"] for part in (height[:300], height[332:])]
    # 30 heights stand between the gaps; the other two pieces have 299 and 67 segments.
    assert float(pieces) == pytest.approx((299 * float(alone[0]) + 67 * float(alone[1])) / 366, rel=1e-12)


@pytest.mark.parametrize("height", [np.full((40, 40), np.nan), np.zeros((40, 20)), np.zeros(31)])
def test_a_surface_without_a_line_is_refused(height):
    with pytest.raises(RaycastError, match="no line has 32 heights without a gap"):
        raycast.raycast(samples.surface(height), 60.0)


def test_a_line_profile_accepts_azimuths_0_and_180_alone():
    with pytest.raises(RaycastError, match="accepted: 0 and 180"):
        raycast.raycast(samples.surface(np.zeros(100)), 60.0, 90.0)


@pytest.mark.parametrize("theta", [-1.0, 90.0, [60.0, 50.0], [60.0, 60.0], [], [[10.0]]])
def test_angles_out_of_range_or_order_are_refused(theta):
    with pytest.raises(VocabularyError, match="theta"):
        raycast.raycast(samples.surface(np.zeros(100)), theta)


def test_directions_of_two_dimensions_are_refused():
    with pytest.raises(VocabularyError, match="accepted: none or one"):
        raycast.bistatic(samples.surface(np.zeros(100)), [[60.0]], 0.0, 60.0, 180.0)


def test_a_scan_of_rubber_is_masked_like_its_facets(shared_data):
    from brdfpipe import surfaces

    rubber = surfaces.level(surfaces.read_surface(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p"))
    theta, azimuths = [45.0, 60.0, 75.0, 85.0], [0.0, 90.0, 180.0, 270.0]
    cast = raycast.raycast(rubber, theta, azimuths, lines=1024)["g1"].mean("phi").values
    smith = np.mean([masking.g1(facets.estimate(rubber), theta, azimuth).values for azimuth in azimuths], axis=0)
    assert cast == pytest.approx(smith, abs=0.02)

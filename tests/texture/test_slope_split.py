"""The facets that a map does not resolve: against counted facets, densities that are convolved, and known answers."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.texture import slope_split


def gaussian_map(rms: float, size: int = 256, seed: int = 1):
    """Slopes of independent pixels, normally distributed: (2, size, size), rms of each."""
    return np.random.default_rng(seed).normal(scale=rms, size=(2, size, size))


def test_two_gaussians_add_their_mean_squares_where_slopes_are_gentle():
    """Known without the model: the rest of a Gaussian of variance 0.05² under a map of 0.03² has 0.04²."""
    full = facets.analytic("beckmann", 0.05 * np.sqrt(2))
    found = slope_split.split(full, *gaussian_map(0.03), "nearest")
    assert float(found.facets["slope_rms"]) == pytest.approx(0.04 * np.sqrt(2), rel=0.01)
    slope = np.array([0.0, 0.04, 0.08])
    expected = np.exp(-((slope / 0.04) ** 2) / 2) / (2 * np.pi * 0.04**2)
    assert RadialDensity.of(found.facets)(slope**2) == pytest.approx(expected, rel=0.03)
    assert found.unresolved == pytest.approx(0.64, abs=0.01)
    assert found.difference < 0.01


@pytest.mark.parametrize("lay", [0.0, 30.0])
def test_a_lay_keeps_its_azimuth_and_both_mean_squares(lay):
    full = facets.analytic("beckmann", a_x=0.05, a_y=0.1, azimuth=lay)
    along, across = gaussian_map(1.0) * np.array([0.02, 0.05])[:, None, None]
    cos, sin = np.cos(np.radians(lay)), np.sin(np.radians(lay))
    found = slope_split.split(full, along * cos - across * sin, along * sin + across * cos, "nearest")
    assert float(found.facets["lay"]) == pytest.approx(lay)
    expected = np.sqrt(0.05**2 / 2 - 0.02**2 + 0.1**2 / 2 - 0.05**2)
    assert float(found.facets["slope_rms"]) == pytest.approx(expected, rel=0.02)
    assert found.difference < 0.01
    x, y = found.map_slopes.slopes
    # The bins are in the axes of the map, not in those of the lay.
    assert np.sum(found.map_slopes.share * x * y) == pytest.approx((0.02**2 - 0.05**2) * cos * sin, abs=3e-5)


@pytest.mark.parametrize(
    ("finish", "share", "exists"), [("beckmann", 0.5, True), ("uneven", 0.1, True), ("uneven", 0.5, False)]
)
def test_the_map_with_the_rest_has_the_slopes_of_all_facets_or_says_how_many_not(finish, share, exists):
    """Facets are drawn, turned by normals of the map and counted: neither the matrix nor the iteration is used.

    Under a normal map that is wider than the middle of a density, no density of the rest is right.
    """
    rng = np.random.default_rng(3)
    full = facets.analytic("beckmann", 0.14)
    if finish == "uneven":
        height = samples.gaussian_surface(512, sigma=0.1, correlation=5.0)["height"].values
        amplitude = (
            0.5 + samples.gaussian_surface(512, sigma=1.0, correlation=50.0, seed=2)["height"].values ** 2 / 1500
        )
        full = facets.estimate(samples.surface(height * amplitude))
    rms = float(full["slope_rms"]) * share
    p, q = gaussian_map(rms, 512)
    found = slope_split.split(full, p, q, "nearest")
    rest = RadialDensity.of(found.facets)
    count, (steep, weights) = p.size, rest.rule()
    slope = np.interp(rng.random(count), np.cumsum(weights) / weights.sum(), steep)
    turn = rng.random(count) * 2 * np.pi
    local = np.stack([-slope * np.cos(turn), -slope * np.sin(turn), np.ones(count)])
    # Axes of each point: its normal, and two across it.
    normal = np.stack([-p.ravel(), -q.ravel(), np.ones(count)]) / np.sqrt(1 + p.ravel() ** 2 + q.ravel() ** 2)
    first = np.array([[1.0], [0], [0]]) - normal * normal[0]
    first /= np.linalg.norm(first, axis=0)
    second = np.cross(normal, first, axis=0)
    facet = first * local[0] + second * local[1] + normal * local[2]
    # Areas: of the facet in the mean plane, per area of its point there.
    weight = np.maximum(facet[2], 0) / normal[2]
    seen = np.hypot(facet[0], facet[1]) / np.maximum(facet[2], 1e-9)
    edges = np.linspace(0, 4, 13) * float(full["slope_rms"]) / 1.4
    counted = np.histogram(seen, edges, weights=weight)[0] / weight.sum()
    wanted = RadialDensity.of(full)
    fine, weights = wanted.rule()
    wanted_share = np.diff(np.interp(edges, fine, np.cumsum(weights) / weights.sum()))
    difference = 0.5 * np.abs(counted - wanted_share).sum()
    assert (difference < 0.02) == exists
    # Where no density is right, the stated share is a low estimate.
    assert found.difference == pytest.approx(difference, abs=0.02 if exists else 0.05)


def test_normals_between_pixels_are_gentler_than_those_of_pixels():
    p, q = gaussian_map(0.1, 64)
    places = list(slope_split.interpolated_slopes(p, q))
    assert sum(share * x.size for share, x, _ in places) == pytest.approx(1)
    # The mean square of a linear interpolation of independent values is 2/3 of theirs, along each axis.
    mean_square = sum(share * np.sum(x**2 + y**2) for share, x, y in places)
    assert mean_square == pytest.approx(4 / 9 * np.mean(p**2 + q**2), rel=0.1)
    ((share, x, y),) = slope_split.interpolated_slopes(p, q, "nearest")
    assert share == 1 / p.size
    assert np.array_equal((x, y), (p.ravel(), q.ravel()))


def test_slopes_of_a_large_map_are_taken_some_rows_at_a_time(monkeypatch):
    """Of gentle slopes the normals are linear: between pixels they are those of the rows and columns, those across the border included."""
    p, q = 1e-5 * gaussian_map(1.0, 12)
    whole = list(slope_split.interpolated_slopes(p, q))
    monkeypatch.setattr(slope_split, "_PIXELS_AT_ONCE", 60)
    parts = list(slope_split.interpolated_slopes(p, q))
    assert [x.size for _, x, _ in parts] == 16 * [60] + 16 * [60] + 16 * [24]
    for number, (share, x, _) in enumerate(whole):
        assert np.concatenate([parts[number + 16 * k][1] for k in range(3)]) == pytest.approx(x, abs=1e-12)
        assert parts[number][0] == share
    up, right = 0.375, 0.625
    below, above = ((1 - right) * one + right * np.roll(one, -1, axis=1) for one in (p, np.roll(p, -1, axis=0)))
    assert whole[4 * 1 + 2][1] == pytest.approx(((1 - up) * below + up * above).ravel(), abs=1e-12)


def test_bins_keep_shares_and_means_of_slopes():
    places = [(0.25, np.array([0.0, 0.3, 0.6]), np.zeros(3)), (0.05, np.array([0.02, 0.62]), np.array([0.0, 0.4]))]
    found = slope_split.binned_slopes(places, 0.3)
    assert found.share.sum() == pytest.approx(1)
    assert found.slopes @ found.share == pytest.approx([(0.25 * 0.9 + 0.05 * 0.64) / 0.85, 0.05 * 0.4 / 0.85])
    assert found.share.size == 4
    assert slope_split.binned_slopes(places, 0.3, most=2).share.size <= 2


def test_what_cannot_be_split_is_refused():
    full = facets.analytic("beckmann", 0.1)
    with pytest.raises(BrdfpipeError, match="leaves"):
        slope_split.split(full, *gaussian_map(0.2), "nearest")
    with pytest.raises(BrdfpipeError, match="flat"):
        slope_split.split(facets.flat(), *gaussian_map(0.1))
    with pytest.raises(BrdfpipeError, match="interpolation"):
        slope_split.split(full, *gaussian_map(0.01), "cubic")

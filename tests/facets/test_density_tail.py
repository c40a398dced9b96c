"""The tail of a slope density."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.facets.density_tail import Junction, tail
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.hemisphere import panel_rule


def tail_moments(slope, density):
    """Share and mean excess of a tail."""
    s, ds = panel_rule(slope, 6)
    weight = 2 * np.pi * s * RadialDensity(slope, density)(s**2) * ds
    return weight.sum(), weight @ (s - slope[0]) / weight.sum()


def test_a_gaussian_density_goes_on_as_it_was():
    sigma, start = 0.1, 0.3
    edges = np.linspace(0, start, 30)
    share = np.exp(-(edges[:-1] ** 2) / (2 * sigma**2)) - np.exp(-(edges[1:] ** 2) / (2 * sigma**2))
    junction = Junction.of(edges, np.log(share / (np.pi * np.diff(edges**2))))
    # The mean over a bin is above the density in its middle, by 1/24 of the square of its fall.
    assert junction.density == pytest.approx(np.exp(-4.5) / (2 * np.pi * sigma**2), rel=1e-2)
    assert junction.decay == pytest.approx(start / sigma**2, rel=1e-2)
    x = np.linspace(0, 1, 100_001)
    weight = np.exp(-((start + x) ** 2 - start**2) / (2 * sigma**2)) * (start + x)
    slope, density = tail(junction, np.exp(-4.5), weight @ x / weight.sum())
    near = slope < start + 1.5 * sigma
    truth = np.exp(-(slope[near] ** 2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)
    assert density[near] == pytest.approx(truth, rel=0.1)


@pytest.mark.parametrize(
    ("share", "excess", "decay"), [(1e-2, 0.05, 40.0), (1e-2, 0.5, 40.0), (3e-3, 0.2, 60.0), (5e-2, 0.1, 20.0)]
)
def test_a_tail_carries_its_share_and_mean_slope_on_from_the_density_and_decay_before_it(share, excess, decay):
    start = 0.2
    plain = share / (2 * np.pi * 0.05 * (start + 0.05))
    slope, density = tail(Junction(start, 2 * plain, decay), share, excess)
    assert tail_moments(slope, density) == pytest.approx((share, excess), rel=2e-3)
    assert density[0] == pytest.approx(2 * plain)
    assert -np.log(density[1] / density[0]) / (slope[1] - slope[0]) == pytest.approx(decay, rel=0.2)
    assert (np.diff(density) < 0).all()


def test_a_tail_above_the_end_of_the_bins_is_a_plain_exponential():
    slope, density = tail(Junction(0.2, 1e-6, 40.0), 1e-2, 0.05)
    assert np.ptp(np.diff(np.log(density)) / np.diff(slope)) < 1e-9
    assert tail_moments(slope, density) == pytest.approx((1e-2, 0.05), rel=2e-3)


def test_without_facets_beyond_the_bins_the_density_ends():
    slope, density = tail(Junction(0.2, 1.0, 40.0), 0.0, 0.0)
    assert slope == pytest.approx([0.2])
    assert density == pytest.approx([0.0])

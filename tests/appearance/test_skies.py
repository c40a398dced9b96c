"""Luminance of the sky against properties that its standard states."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.appearance.skies import SKIES, sky_luminance
from brdfpipe.geometry import unit_vector


@pytest.mark.parametrize("kind", SKIES)
@pytest.mark.parametrize("elevation", [5.0, 45.0, 88.0])
def test_the_sky_gives_its_illuminance_on_the_horizontal_plane(kind, elevation):
    """A sum over 800 000 directions of equal projected solid angle, π sr together."""
    u, v = ((np.arange(n) + 0.5) / n for n in (400, 2000))
    theta, phi = np.meshgrid(np.degrees(np.arcsin(np.sqrt(u))), 360 * v, indexing="ij")
    luminance = sky_luminance(kind, 10_000.0, (elevation, 30.0), unit_vector(theta, phi))
    assert luminance.min() > 0
    assert np.pi * luminance.mean() == pytest.approx(10_000, rel=1e-3)


def test_an_overcast_sky_is_three_times_as_bright_overhead_as_at_the_horizon():
    at = unit_vector([0, 60, 89.999], 0)
    zenith, between, horizon = sky_luminance("overcast", 1.0, (45, 0), at)
    assert zenith / horizon == pytest.approx(1 + 4 * np.exp(-0.70), rel=1e-6)  # Moon and Spencer's sky has 3
    assert between / zenith == pytest.approx((1 + 4 * np.exp(-1.4)) / (1 + 4 * np.exp(-0.7)))


def test_a_clear_sky_is_brightest_at_the_sun_and_darkest_about_a_right_angle_from_it():
    theta = np.arange(0.0, 89.0, 1.0)
    in_the_plane = sky_luminance(
        "clear", 1.0, (40, 0), unit_vector(np.concatenate([theta, theta]), np.repeat([0.0, 180.0], theta.size))
    )
    assert in_the_plane.argmax() == 50
    darkest = in_the_plane.argmin() - theta.size  # beyond the zenith
    assert 15 < darkest < 50


def test_nothing_comes_from_below_the_horizon_and_a_uniform_sky_is_its_illuminance_over_pi():
    assert sky_luminance("uniform", 100.0, (45, 0), unit_vector([120, 10], 0)).tolist() == pytest.approx(
        [0, 100 / np.pi]
    )

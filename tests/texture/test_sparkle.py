"""Sparkle and graininess of synthetic paints whose flakes are known."""

from __future__ import annotations

import numpy as np
import pytest
from flake_pictures import flakes

from brdfpipe.texture.illumination import without_gradient
from brdfpipe.texture.sparkle import graininess, sparkle

PIXEL = 20.0


def measures(**paint):
    flat, _ = without_gradient(flakes(**paint))
    found = sparkle(flat, PIXEL)
    return {**found._asdict(), "visibility": found.visibility, "graininess": graininess(flat, PIXEL)}


def rise(name, key, *settings):
    found = [measures(**{key: value})[name] for value in settings]
    assert found == sorted(found), (name, key, found)
    assert found[-1] > 1.2 * found[0], (name, key, found)


def test_the_density_of_sparkles_rises_with_the_density_of_flakes():
    rise("density", "density", 0.002, 0.004, 0.008)
    # Twice the flakes: twice the sparkles, less those that overlap.
    assert measures(density=0.004)["density"] == pytest.approx(2 * measures(density=0.002)["density"], rel=0.15)


def test_the_area_of_sparkles_rises_with_the_size_of_flakes_and_their_number_does_not():
    rise("area", "radius", 1.5, 2.0, 3.0)
    rise("graininess", "radius", 1.5, 2.0, 3.0)
    assert measures(radius=3.0)["density"] == pytest.approx(measures(radius=1.5)["density"], rel=0.15)


def test_sparkles_fall_as_the_tilts_spread_and_beside_the_mirror_direction():
    for name in ("density", "contrast", "visibility", "graininess"):
        rise(name, "spread", 8.0, 4.0, 2.0)
    for name in ("density", "visibility", "graininess"):
        rise(name, "at", 8.0, 4.0, 0.0)


def test_graininess_rises_with_the_density_of_flakes():
    rise("graininess", "density", 0.002, 0.004, 0.008)


def test_the_number_is_that_of_the_flakes_that_mirror_the_light():
    """Few flakes that do not touch: their number is known, that of discs whose light passes the threshold."""
    rng = np.random.default_rng(2)
    values, count = np.full((300, 300), 0.1), 40
    places = rng.permutation(29**2)[:count]
    for place in places:
        row, column = 10 + 10 * (place // 29), 10 + 10 * (place % 29)
        values[row - 1 : row + 2, column - 1 : column + 2] = 0.5
    found = sparkle(values, PIXEL)
    assert found.density == pytest.approx(count / (300 * PIXEL / 1000) ** 2)
    assert found.area == pytest.approx(9 * PIXEL**2)
    assert found.contrast == pytest.approx(4.0)


@pytest.mark.parametrize("exposure", [1e-3, 1.0, 40.0])
def test_measures_do_not_depend_on_the_exposure(exposure):
    values = flakes(256)
    once, again = (without_gradient(factor * values)[0] for factor in (1.0, exposure))
    assert sparkle(again, PIXEL) == pytest.approx(sparkle(once, PIXEL), rel=1e-9)
    assert graininess(again, PIXEL) == pytest.approx(graininess(once, PIXEL), rel=1e-9)


def test_measures_do_not_depend_on_the_size_of_the_picture():
    large, small = measures(size=768), measures(size=384)
    for name, tolerance in (("density", 0.1), ("area", 0.05), ("contrast", 0.1), ("graininess", 0.1)):
        assert small[name] == pytest.approx(large[name], rel=tolerance), name


def test_vignetting_and_a_gradient_are_found_and_removed():
    even = flakes(512)
    x = np.linspace(-1, 1, 512)
    illumination = 1 - 0.3 * (x**2 + x[:, None] ** 2) / 2 + 0.1 * x
    (plain, none), (flat, found) = without_gradient(even), without_gradient(even * illumination)
    assert none < 0.02
    assert found == pytest.approx(illumination.max() / illumination.min() - 1, rel=0.1)
    assert sparkle(flat, PIXEL) == pytest.approx(sparkle(plain, PIXEL), rel=0.02)
    assert graininess(flat, PIXEL) == pytest.approx(graininess(plain, PIXEL), rel=0.01)
    assert flat.mean() == pytest.approx(1.0)

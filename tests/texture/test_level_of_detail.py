"""The level of detail that a viewing distance needs."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets
from brdfpipe.texture import height_pixels
from brdfpipe.texture.eye import eye_blur
from brdfpipe.texture.height_pixels import central_slopes, pixel_heights
from brdfpipe.texture.level_of_detail import NOTICEABLE, levels_of_detail


@pytest.fixture(scope="module")
def grain():
    """Grain of a correlation length of 12 µm under finer roughness."""
    height = relief_maps.gaussian(0.1, 512, 1, 12.0) + relief_maps.gaussian(0.08, 512, 2, 2.5)
    surface = samples.surface(height)
    return surface, facets.estimate(surface)


def test_only_the_chosen_pixel_has_the_contrast(grain):
    tried = levels_of_detail(*grain, finest=2.0, distance=0.5)
    pixels = [one.pixel for one in tried]
    assert pixels == sorted(pixels, reverse=True)
    assert tried[-1].difference <= NOTICEABLE
    assert all(one.difference > NOTICEABLE for one in tried[:-1])
    assert len(tried) > 2


def test_missing_heights_are_filled_once_for_all_pixels(grain, monkeypatch):
    surface, every = grain
    spoilt = surface.copy(deep=True)
    spoilt["height"].values[100:110, 100:110] = np.nan
    filled = []
    fill = height_pixels._filled
    monkeypatch.setattr(height_pixels, "_filled", lambda *given: filled.append(1) or fill(*given))
    tried = levels_of_detail(spoilt, every, finest=2.0, distance=0.5)
    assert len(tried) > 2
    assert len(filled) == 1
    assert np.isnan(spoilt["height"].values).sum() == 100


def test_the_pixel_grows_with_the_distance(grain):
    pixels = [levels_of_detail(*grain, finest=2.0, distance=one)[-1].pixel for one in (0.001, 0.1, 0.5, 1.0)]
    assert pixels == sorted(pixels)
    assert pixels[0] < pixels[-1]


def test_the_pixel_grows_with_the_grain():
    pixels = []
    for length in (6.0, 30.0):
        surface = samples.surface(relief_maps.gaussian(0.1, 512, 1, length) + relief_maps.gaussian(0.06, 512, 2, 2.5))
        pixels.append(levels_of_detail(surface, facets.estimate(surface), finest=2.0, distance=0.3)[-1].pixel)
    assert pixels[1] > 1.3 * pixels[0]


def test_counted_facets_within_a_cone_have_the_contrasts(grain):
    """Facets drawn about the slopes of each map and counted about the normal, of which the contrast differs most: no formula of the module but the blur."""
    surface, every = grain
    distance, rng = 0.1, np.random.default_rng(3)
    tried = {
        round(one.pixel, 3): one
        for one in levels_of_detail(surface, every, finest=2.0, distance=distance, interpolation="nearest")
    }
    contrast = {}
    for pixel in (2.0, min(one for one in tried if one > 2.5), max(tried)):
        slopes = central_slopes(pixel_heights(surface, min(pixel, 16.0))[0], pixel)
        left = np.sqrt(float(every["slope_rms"]) ** 2 / 2 - np.mean([one.var() for one in slopes]))
        at = (np.arange(256) * 2.0 / pixel).astype(int).clip(0, len(slopes[0]) - 1)
        count = np.zeros((256, 256))
        for _ in range(200):
            p, q = (one[np.ix_(at, at)] + left * rng.standard_normal((256, 256)) for one in slopes)
            count += p**2 + q**2 < 0.03**2
        seen = eye_blur(count, 2.0, distance)
        contrast[pixel] = float(seen.std() / seen.mean())
    fine = contrast.pop(2.0)
    for pixel, value in contrast.items():
        assert abs(value - fine) / max(fine, 0.2) == pytest.approx(tried[pixel].difference, abs=0.15), pixel

"""The whole grain of a scan, its pixels, and its files."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets
from brdfpipe.errors import BrdfpipeError
from brdfpipe.texture.grain import grain
from brdfpipe.texture.height_pixels import central_slopes, pixel_heights


@pytest.fixture(scope="module")
def found():
    surface = samples.surface(relief_maps.two_scales(512, 1) * 0.4)
    return grain(surface, facets.estimate(surface), 4.0, size=96, seed=1)


def test_a_grain_has_a_map_and_the_facets_that_it_does_not_resolve(found):
    assert found.height.shape == (96, 96)
    assert found.normals.shape == (96, 96, 3)
    assert np.linalg.norm(found.normals, axis=-1) == pytest.approx(np.ones((96, 96)))
    assert found.facets.attrs["kind"] == "facets"
    assert 0.1 < found.unresolved < 0.9
    assert found.split_difference < 0.05
    assert found.warnings == ()


def test_a_pixel_holds_the_mean_height_over_its_area():
    height = np.random.default_rng(1).normal(size=(90, 120))
    means, missing = pixel_heights(samples.surface(height, (1.0, 1.0)), 2.0)
    blocks = height.reshape(45, 2, 60, 2).mean(axis=(1, 3))
    assert missing == 0
    assert means == pytest.approx(blocks - blocks.mean())
    # Cut pitches: five halves of a height make a pixel.
    profile = np.random.default_rng(2).normal(size=120)
    cut, _ = pixel_heights(samples.surface(np.tile(profile, (90, 1))), 2.5)
    expected = np.repeat(profile, 2).reshape(48, 5).mean(axis=1)
    assert cut == pytest.approx(np.tile(expected - expected.mean(), (36, 1)))


def test_slopes_are_those_of_a_wave():
    x = np.arange(64) * 2 * np.pi / 64
    p, q = central_slopes(np.tile(np.sin(x), (64, 1)), 1.0)
    assert p == pytest.approx(np.tile(np.cos(x) * 2 * np.pi / 64, (64, 1)), abs=2e-4)
    assert q == pytest.approx(np.zeros((64, 64)))


def test_missing_heights_are_filled_from_their_neighbours_and_warned_of():
    height = relief_maps.two_scales(512, 1) * 0.4
    spoilt = height.copy()
    spoilt[100:230, 100:230] = np.nan
    surface = samples.surface(spoilt)
    found = grain(surface, facets.estimate(surface), 4.0, size=64)
    assert np.isfinite(found.height).all()
    assert any("missing" in text for text in found.warnings)
    spoilt[:300] = np.nan
    with pytest.raises(BrdfpipeError, match="missing"):
        pixel_heights(samples.surface(spoilt), 4.0)


def test_a_pixel_out_of_range_and_a_line_are_refused():
    surface = samples.surface(np.random.default_rng(1).normal(size=(64, 64)))
    for pixel in (0.5, 3.0):
        with pytest.raises(BrdfpipeError, match=r"set `texture\.pixel`"):
            pixel_heights(surface, pixel)
    with pytest.raises(BrdfpipeError, match="line profile"):
        pixel_heights(samples.surface(np.zeros(64)), 1.0)


def test_fine_roughness_that_depends_on_the_place_is_warned_of():
    """Flat cells with steep valleys and nothing else: no one density is that of all pixels."""
    surface = samples.surface(relief_maps.cells(512, 1))
    found = grain(surface, facets.estimate(surface), 4.0, size=128, method="structure")
    assert found.split_difference > 0.05
    assert any("depends on the place" in text for text in found.warnings)


def test_the_rubber_scan_has_a_grain(shared_data):
    from brdfpipe.surfaces.reading import ingest

    surface = ingest(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p", {})
    pixel = 3 * float(surface.attrs["pitch_x"])
    found = grain(surface, facets.estimate(surface), pixel, size=128)
    assert found.likeness.spectrum < 0.05
    assert 0 < found.unresolved < 1

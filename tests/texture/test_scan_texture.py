"""The texture of a scan as a dataset."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.texture.grain import grain
from brdfpipe.texture.level_of_detail import NOTICEABLE
from brdfpipe.texture.scan_texture import facets_of, map_slopes, of_scan


@pytest.fixture(scope="module")
def scan():
    surface = samples.surface(relief_maps.gaussian(0.1, 512, 1, 8.0))
    return surface, facets.estimate(surface)


@pytest.fixture(scope="module")
def texture(scan):
    return of_scan(*scan, pixel=4.0, size=96, seed=1)


def test_it_is_the_grain_with_the_facets_that_its_pixels_do_not_resolve(scan, texture):
    found = grain(*scan, 4.0, size=96, seed=1)
    assert vocabulary.validate(texture, "texture") is texture
    assert np.array_equal(texture["height"], found.height)
    xr.testing.assert_equal(facets_of(texture).drop_attrs(), found.facets.drop_attrs())
    assert texture["x"].values[[0, -1]].tolist() == [2.0, 382.0]


def test_of_a_surface_with_a_lay_too():
    surface = samples.surface(relief_maps.ridges(256, 1, 0.12) + relief_maps.gaussian(0.08, 256, 1, 4.0))
    texture = of_scan(surface, facets.estimate(surface), pixel=4.0, size=64)
    rest = vocabulary.validate(facets_of(texture), "facets")
    assert rest["slope_density"].dims == ("slope_across", "slope_along")


def test_the_mean_squares_of_its_spectrum_are_those_of_its_heights(texture):
    """Parseval, up to the long waves that the rings leave out and the corners beyond the Nyquist frequency along an axis."""
    frequency, power = texture["texture_frequency"].values, texture["tile_psd"].values
    variance = np.trapezoid(2 * np.pi * frequency * power, frequency)
    assert variance == pytest.approx(float(texture["height"].var()), rel=0.15)


def test_a_larger_distance_moves_slopes_from_the_map_to_the_brdf(scan):
    shares, sizes = [], []
    for distance in (0.002, 0.6, 2.0):
        texture = of_scan(*scan, pixel=2.0, size=64, distance=distance)
        vocabulary.validate(texture, "texture")
        sizes.append(texture.sizes["level_pixel"])
        assert texture.attrs["pixel"] == float(texture["level_pixel"][0])
        assert float(texture["level_difference"][0]) <= NOTICEABLE
        shares.append(float(texture["unresolved_share"]))
    assert shares == sorted(shares)
    assert shares[-1] > shares[0] + 0.1
    assert max(sizes) > 2


def test_a_distance_from_which_no_pixel_is_seen_is_warned_of(scan):
    texture = of_scan(*scan, pixel=2.0, size=64, distance=5.0)
    assert texture.attrs["pixel"] == pytest.approx(16.0)
    assert any("may need no map" in text for text in vocabulary.warnings(texture))


def test_bins_keep_the_covariance_of_the_slopes(texture):
    coarse, fine = (map_slopes(texture, width, most).covariance for width, most in ((3.0, 6000), (20.0, 60_000)))
    assert coarse == pytest.approx(fine, abs=0.02 * np.trace(fine))

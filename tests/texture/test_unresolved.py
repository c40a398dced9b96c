"""The BSDF that goes with the map of a scan."""

from __future__ import annotations

import pytest
import relief_maps
import samples

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.texture.scan_texture import of_scan
from brdfpipe.texture.unresolved import mean_difference, unresolved_bsdf


def made(height, **options):
    surface = samples.surface(height)
    every, index, spectrum = facets.estimate(surface), optics.refractive_index(1.5), samples.spectrum(0.3)
    full = microfacet.build(every, index=index, spectrum=spectrum)
    texture = of_scan(surface, every, pixel=4.0, size=64, seed=1, **options)
    return texture, full, unresolved_bsdf(texture, index, full, spectrum)


@pytest.mark.parametrize(
    "height",
    [
        lambda: relief_maps.gaussian(0.1, 256, 1, 8.0),
        lambda: relief_maps.ridges(256, 1, 0.12) + relief_maps.gaussian(0.08, 256, 1, 4.0),
    ],
    ids=["gaussian", "ridges"],
)
def test_the_map_with_the_rest_is_the_brdf_and_the_double_count_is_not(height):
    texture, full, rest = made(height())
    # Half of it is the scatter of the facets that so small a map counts.
    assert rest.attrs["mean_difference"] < 0.03
    assert vocabulary.warnings(rest) == []
    assert mean_difference(texture, full, full) > max(0.05, 3 * rest.attrs["mean_difference"])


def test_the_total_reflectance_is_that_of_the_material():
    _, full, rest = made(relief_maps.gaussian(0.1, 256, 1, 8.0))
    totals = [one.bsdf.albedo(8.0).values for one in (full, rest)]
    assert totals[1] == pytest.approx(totals[0], rel=1e-3)


def test_fine_roughness_that_depends_on_the_place_is_warned_of():
    *_, rest = made(relief_maps.cells(512, 1), method="structure")
    assert rest.attrs["mean_difference"] > 0.1
    assert any("seen from afar" in text for text in vocabulary.warnings(rest))

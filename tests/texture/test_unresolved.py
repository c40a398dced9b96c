"""The BSDF that goes with the map of a scan."""

from __future__ import annotations

import pytest
import relief_maps
import samples

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.surfaces.reading import ingest
from brdfpipe.texture.scan_texture import of_scan
from brdfpipe.texture.unresolved import differences, unresolved_bsdf

INDEX = optics.refractive_index(1.5)


def made(height, isotropic=None, **options):
    surface = samples.surface(height)
    every, index, spectrum = facets.estimate(surface, isotropic=isotropic), INDEX, samples.spectrum(0.3)
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
    assert differences(texture, full, full).mean > max(0.05, 3 * rest.attrs["mean_difference"])


def test_the_total_reflectance_is_that_of_the_material():
    _, full, rest = made(relief_maps.gaussian(0.1, 256, 1, 8.0))
    totals = [one.bsdf.albedo(8.0).values for one in (full, rest)]
    assert totals[1] == pytest.approx(totals[0], rel=1e-3)


def test_fine_roughness_that_depends_on_the_place_is_warned_of():
    *_, rest = made(relief_maps.cells(512, 1), method="structure")
    assert rest.attrs["mean_difference"] > 0.1
    assert any("seen from afar" in text for text in vocabulary.warnings(rest))


def test_a_lay_of_the_map_that_the_brdf_has_not_shows_at_single_azimuths_and_is_warned_of():
    *_, rest = made(relief_maps.ridges(256, 1, 0.12) + relief_maps.gaussian(0.08, 256, 1, 4.0), isotropic=True)
    assert rest.attrs["lay_difference"] > 0.02
    assert rest.attrs["mean_difference"] < rest.attrs["lay_difference"]
    (text,) = vocabulary.warnings(rest)
    assert "surface.isotropic: false" in text


@pytest.mark.slow
def test_the_map_of_a_rubber_with_the_rest_is_its_brdf_where_both_have_its_weak_lay(shared_data):
    """Its slopes along the lay are 3 % larger than across, those of the coarse structure more: at single azimuths a BRDF without a lay is 4 % off."""
    surface = ingest(shared_data / "surfaces" / "KautschukInfiniteFocus.x3p", {})
    pixel = 5 * float(surface.attrs["pitch_x"])
    found = {}
    for isotropic in (None, False):
        every = facets.estimate(surface, isotropic=isotropic)
        texture = of_scan(surface, every, pixel=pixel, size=512, method="structure", seed=1)
        full = microfacet.build(every, index=INDEX)
        found[isotropic] = unresolved_bsdf(texture, INDEX, full).attrs
    assert found[None]["mean_difference"] < 0.02
    assert 0.03 < found[None]["lay_difference"] < 0.06
    assert found[False]["mean_difference"] < 0.02
    assert found[False]["lay_difference"] == 0

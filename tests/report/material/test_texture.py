"""The section of a page on the visible structure."""

from __future__ import annotations

import pytest
import relief_maps
import samples
from flake_pictures import flakes

from brdfpipe import facets
from brdfpipe.bsdf import lambert_gauss
from brdfpipe.report.material.page import material_page
from brdfpipe.report.material.texture import texture_section
from brdfpipe.texture.distant_view import structure_previews
from brdfpipe.texture.picture_texture import of_pictures
from brdfpipe.texture.scan_texture import of_scan


@pytest.fixture(scope="module")
def grain():
    surface = samples.surface(relief_maps.gaussian(0.1, 256, 1, 8.0))
    return of_scan(surface, facets.estimate(surface), pixel=4.0, size=64, seed=1)


@pytest.fixture(scope="module")
def paint():
    return of_pictures({"45as15": flakes(128), "diffuse": flakes(128) + 1}, pixel=20.0, size=64)


def test_there_is_no_section_without_a_texture():
    assert not texture_section({})


def test_a_grain_has_its_tile_its_spectrum_and_its_figures(grain):
    rest = samples.beckmann_bsdf(0.1).assign_attrs(mean_difference=0.0123, lay_difference=0.0345)
    section = texture_section({"texture": grain, "unresolved": rest})
    assert [figure.title for figure in section.figures] == [
        "Grain of the tile, shaded",
        "Height map, tileable",
        "Spectrum of the texture",
    ]
    rows = {row[0]: row[1] for row in section.tables[0].rows}
    assert rows["Pixel"] == "4.00 µm"
    assert rows["Slopes left to the BRDF"] == f"{100 * float(grain['unresolved_share']):.2g} %"
    assert rows["Map with the rest, from afar"] == "1.2 %"
    assert rows["at single azimuths"] == "3.5 %"
    of_lay = texture_section({"texture": grain, "unresolved": rest.assign_attrs(lay_difference=0.0)})
    assert "at single azimuths" not in {row[0] for row in of_lay.tables[0].rows}


def test_a_viewing_distance_has_the_pixels_that_were_tried():
    surface = samples.surface(relief_maps.gaussian(0.1, 256, 1, 8.0))
    texture = of_scan(surface, facets.estimate(surface), pixel=2.0, size=64, distance=0.7)
    table = texture_section({"texture": texture}).tables[1]
    assert table.title == "Level of detail at 0.7 m"
    assert [row[2] for row in table.rows] == ["too coarse"] * (len(table.rows) - 1) + ["chosen"]
    assert len(table.rows) == texture.sizes["level_pixel"]


def test_a_paint_has_a_tile_and_a_spectrum_of_each_geometry_and_its_sparkles(paint):
    section = texture_section({"picture_texture": paint})
    assert len(section.figures) == 4
    table = section.tables[0]
    assert [row[0] for row in table.rows] == ["45as15", "diffuse"]
    assert "unpublished" in table.note


def test_the_structure_is_shown_from_a_distance_in_each_light(grain, paint):
    preview = structure_previews(lambert_gauss.lambertian(samples.spectrum(0.5)), paint, distance=0.7)
    for datasets in ({"picture_texture": paint}, {"texture": grain}):
        titles = [one.title for one in texture_section({**datasets, "texture_preview": preview}).figures]
        assert titles[:2] == ["Under a spot at 45as15, from 0.7 m", "In diffuse light, from 0.7 m"]
    note = texture_section({"texture": grain, "texture_preview": preview}).figures[1].note
    assert f"Contrast: {100 * preview.attrs['contrast'][1]:.2g} % rms" in note
    assert "26.1 mm" in note


def test_the_page_lists_the_files(grain, paint):
    page = material_page({"texture": grain.assign_attrs(material="panel"), "unresolved": samples.beckmann_bsdf(0.1)})
    assert "panel.normal.exr" in page
    page = material_page({"picture_texture": paint.assign_attrs(material="paint")})
    assert "paint.texture-2.exr" in page
    assert "paint.texture-3.exr" not in page

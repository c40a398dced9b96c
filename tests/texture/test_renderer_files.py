"""Materials of renderers that use the maps of a scan, and the BSDF that goes with them."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.texture.map_files import write_maps
from brdfpipe.texture.renderer_files import with_renderer_files
from brdfpipe.texture.scan_texture import normals_of, of_scan
from brdfpipe.texture.unresolved import unresolved_bsdf

INDEX = optics.refractive_index(1.5)


def made(height):
    surface = samples.surface(height)
    every = facets.estimate(surface)
    texture = of_scan(surface, every, pixel=4.0, size=64, seed=1)
    spectrum = samples.spectrum(0.3)
    full = microfacet.build(every, index=INDEX, spectrum=spectrum)
    return texture, unresolved_bsdf(texture, INDEX, full, spectrum)


@pytest.fixture(scope="module")
def gaussian():
    return made(relief_maps.gaussian(0.1, 256, 1, 8.0))


@pytest.fixture(scope="module")
def written(gaussian, tmp_path_factory):
    folder = tmp_path_factory.mktemp("renderers")
    texture, rest = gaussian
    write_maps(texture, folder, "panel--1")
    listed = with_renderer_files(texture, rest, folder, "panel--1", ("gltf", "openpbr", "rgl"))
    return folder, listed


def test_every_material_names_the_map(written):
    folder, listed = written
    assert set(json.loads(listed.attrs["files"])) == {
        "panel--1.textured.gltf",
        "panel--1.textured.mtlx",
        "panel--1.textured.xml",
        "panel--1.unresolved.rgb.bsdf",
        "panel--1.unresolved.rgb.bsdf.json",
    }
    gltf = json.loads((folder / "panel--1.textured.gltf").read_text())
    named = gltf["images"][gltf["textures"][gltf["materials"][0]["normalTexture"]["index"]]["source"]]["uri"]
    assert (folder / named).is_file()
    mtlx = ElementTree.parse(folder / "panel--1.textured.mtlx").getroot()
    nodes = {node.get("name"): node for node in mtlx}
    normal = nodes[mtlx.find("open_pbr_surface/input[@name='geometry_normal']").get("nodename")]
    image = nodes[normal.find("input[@name='in']").get("nodename")]
    file = image.find("input[@name='file']")
    assert (folder / file.get("value")).is_file()
    # Normals are no colours.
    assert file.get("colorspace") == "none"


@pytest.mark.parametrize(
    ("interpolation", "gltf", "materialx"), [("bilinear", 9729, "linear"), ("nearest", 9728, "closest")]
)
def test_renderers_interpolate_between_pixels_as_the_split_assumes(gaussian, tmp_path, interpolation, gltf, materialx):
    texture, rest = gaussian
    texture = texture.assign_attrs(interpolation=interpolation)
    with_renderer_files(texture, rest, tmp_path, "panel", ("gltf", "openpbr"))
    (sampler,) = json.loads((tmp_path / "panel.textured.gltf").read_text())["samplers"]
    # Means of normals, as of levels of detail, have smaller slopes than the map.
    assert (sampler["magFilter"], sampler["minFilter"]) == (gltf, gltf)
    image = ElementTree.parse(tmp_path / "panel.textured.mtlx").getroot().find("tiledimage")
    assert image.find("input[@name='filtertype']").get("value") == materialx


def test_mitsuba_loads_the_scene(written):
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    before = mitsuba.variant()
    # That of the other renderings of these tests: it fails after a scalar one has rendered in the same process.
    mitsuba.set_variant("llvm_ad_rgb")
    try:
        scene = mitsuba.load_file(str(written[0] / "panel--1.textured.xml"))
        film = scene.sensors()[0].film()
        mitsuba.traverse(film)["size"] = [24, 24]
        picture = np.array(mitsuba.render(scene, spp=4))
        assert np.isfinite(picture).all()
        assert picture.mean() > 0
    finally:
        if before is not None:
            mitsuba.set_variant(before)


def test_the_scene_of_mitsuba_has_the_places_of_the_map_where_its_axes_say(gaussian, written):
    """A diffuser with the normals of the map is as bright as their cosine to the lamp, place by place; a mirrored map is not."""
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    before = mitsuba.variant()
    mitsuba.set_variant("llvm_ad_rgb")
    try:
        root = ElementTree.parse(written[0] / "panel--1.textured.xml").getroot()
        mapped = root.find(".//bsdf[@type='normalmap']")
        mapped.remove(mapped.find("bsdf"))
        ElementTree.SubElement(mapped, "bsdf", type="diffuse")
        path = written[0] / "diffuser.xml"
        path.write_text(ElementTree.tostring(root, encoding="unicode"))
        scene = mitsuba.load_file(str(path))
        picture = np.array(mitsuba.render(scene, spp=16))[..., 0]
    finally:
        if before is not None:
            mitsuba.set_variant(before)
    # The picture is 1.2 times as wide as the panel, whose lower left corner is that of a tile; rows go downwards.
    size, tiles, pixels = len(picture), 4, 64
    at = ((np.arange(size) + 0.5) / size - 0.5) * 1.2 * tiles + tiles / 2
    inside = np.flatnonzero((at > 0.1) & (at < tiles - 0.1))
    number = (at[inside] * pixels).astype(int) % pixels
    shown = picture[::-1][np.ix_(inside, inside)]
    normals = normals_of(gaussian[0])[np.ix_(number, number)]
    bright = (normals[..., 0] + normals[..., 2]).clip(0)

    def correlation(values):
        return np.corrcoef(shown.ravel(), values.ravel())[0, 1]

    assert correlation(bright) > 0.9
    assert abs(correlation(bright[::-1])) < 0.5
    assert abs(correlation(bright[:, ::-1])) < 0.5


def test_formats_that_are_not_exported_are_not_written(gaussian, tmp_path):
    texture, rest = gaussian
    (tmp_path / "panel.textured.gltf").write_text("of an earlier run")
    listed = with_renderer_files(texture, rest, tmp_path, "panel", ())
    assert json.loads(listed.attrs["files"]) == {}
    assert list(tmp_path.iterdir()) == []


def test_a_format_without_a_lay_says_why_it_is_not_written(tmp_path):
    texture, rest = made(relief_maps.ridges(256, 1, 0.12) + relief_maps.gaussian(0.08, 256, 1, 4.0))
    listed = with_renderer_files(texture, rest, tmp_path, "panel", ("gltf",))
    assert json.loads(listed.attrs["files"]) == {}
    assert any("lay" in text for text in vocabulary.warnings(listed))

"""Materials of renderers that have the texture of a paint."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
import samples
from flake_pictures import flakes
from PIL import Image
from scipy.ndimage import map_coordinates

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.exchange import gltf, openpbr
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.texture.paint_files import chosen_picture, with_paint_files
from brdfpipe.texture.picture_files import write_pictures
from brdfpipe.texture.picture_texture import of_pictures

NAME = "paint--1"


@pytest.fixture(scope="module")
def texture():
    pictures = {"diffuse": flakes(128, seed=2) + 2, "45as15": flakes(128) + 0.05}
    return of_pictures(pictures, pixel=20.0, size=64, seed=1)


@pytest.fixture(scope="module")
def bsdf():
    return samples.beckmann_bsdf(0.3, reflectance=0.1)


@pytest.fixture(scope="module")
def written(texture, bsdf, tmp_path_factory):
    folder = tmp_path_factory.mktemp("paint")
    write_pictures(texture, folder, NAME)
    return folder, with_paint_files(texture, bsdf, folder, NAME, ("gltf", "openpbr"))


def linear(path):
    """Values of a picture that is encoded as sRGB (IEC 61966-2-1), the upper row first."""
    with Image.open(path) as picture:
        encoded = np.asarray(picture)[..., 0] / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_the_picture_is_the_first_in_light_from_one_direction(texture):
    picture = chosen_picture(texture)
    assert (picture.number, picture.geometry) == (2, "45as15")
    assert picture.light[::-1] == pytest.approx(texture["relative_light"].values[1])
    assert chosen_picture(texture.isel(geometry=[0])).geometry == "diffuse"


def test_every_material_names_files_that_are_there(written):
    folder, listed = written
    assert set(json.loads(listed.attrs["files"])) == {f"{NAME}.textured{end}" for end in (".gltf", ".png", ".mtlx")}
    document = json.loads((folder / f"{NAME}.textured.gltf").read_text())
    assert (folder / document["images"][0]["uri"]).is_file()
    assert document["materials"][0]["extras"]["brdfpipe"]["texture"]["geometry"] == "45as15"
    files = ElementTree.parse(folder / f"{NAME}.textured.mtlx").findall(".//input[@type='filename']")
    # Values of the picture are no colours.
    assert [(file.get("value"), file.get("colorspace")) for file in files] == [(f"{NAME}.texture-2.exr", "none")]
    assert "45as15" in (folder / f"{NAME}.textured.mtlx").read_text()


def test_the_mean_of_gltf_over_a_tile_is_that_of_the_material_without_a_texture(written, bsdf, tmp_path):
    """Base and lobe by the formulas of glTF 2.0, appendix B, and of KHR_materials_specular, at any angle on the facet."""
    gltf.write(bsdf, tmp_path / "plain.gltf", **FORMATS["gltf"].options)
    (plain,) = json.loads((tmp_path / "plain.gltf").read_text())["materials"]
    (textured,) = json.loads((written[0] / f"{NAME}.textured.gltf").read_text())["materials"]
    light = linear(written[0] / f"{NAME}.textured.png")
    normal = (
        (plain["extensions"]["KHR_materials_ior"]["ior"] - 1) / (plain["extensions"]["KHR_materials_ior"]["ior"] + 1)
    ) ** 2

    def parts(material, base, lobe, angle):
        reflected = (f0 := np.minimum(normal * lobe, 1)) + (1 - f0) * (1 - np.cos(np.radians(angle))) ** 5
        return np.mean((1 - reflected) * base) * material["pbrMetallicRoughness"]["baseColorFactor"][
            0
        ], reflected.mean()

    specular = textured["extensions"]["KHR_materials_specular"]["specularColorFactor"][0]
    for angle in (0.0, 45.0, 75.0):
        wanted = parts(plain, np.ones(1), np.ones(1), angle)
        assert parts(textured, light, specular * light, angle) == pytest.approx(wanted, rel=5e-4)
    assert max(textured["pbrMetallicRoughness"]["baseColorFactor"]) <= 1


def test_the_picture_of_gltf_is_the_light_over_its_largest_value(written, texture):
    light = linear(written[0] / f"{NAME}.textured.png")
    wanted = texture["relative_light"].values[1, ::-1]
    assert light == pytest.approx(wanted / wanted.max(), abs=0.007)
    assert light.mean() == pytest.approx(wanted.mean() / wanted.max(), rel=0.005)


def test_materialx_multiplies_base_and_lobe(written, bsdf, tmp_path):
    openpbr.write(bsdf, tmp_path / "plain.mtlx", **FORMATS["openpbr"].options)
    plain = ElementTree.parse(tmp_path / "plain.mtlx").find("open_pbr_surface")
    root = ElementTree.parse(written[0] / f"{NAME}.textured.mtlx").getroot()
    shader, nodes = root.find("open_pbr_surface"), {node.get("name"): node for node in root}
    order = list(nodes)
    for name, value in (
        ("base_color", plain.find("input[@name='base_color']").get("value")),
        ("specular_color", "1, 1, 1"),
    ):
        given = shader.find(f"input[@name='{name}']")
        assert given.get("value") is None
        product = nodes[given.get("nodename")]
        assert product.tag == "multiply"
        assert product.find("input[@name='in1']").get("value") == value
        image = nodes[product.find("input[@name='in2']").get("nodename")]
        assert (image.tag, image.get("type")) == ("tiledimage", "float")
        assert order.index(image.get("name")) < order.index(product.get("name")) < order.index(shader.get("name"))
    # A weight of the lobe changes its index, and would not multiply it.
    assert shader.find("input[@name='specular_weight']").get("value") == "1.0"


def test_the_texture_of_a_metal_is_on_its_lobe(texture, tmp_path):
    index = optics.refractive_index({"n": 0.4, "k": 2.8})
    gold = microfacet.build(facets.analytic("ggx", 0.3), index=index, multiple_scattering="none")
    with_paint_files(texture, gold.assign_attrs(material="gold"), tmp_path, NAME, ("openpbr",))
    root = ElementTree.parse(tmp_path / f"{NAME}.textured.mtlx").getroot()
    given = root.find("open_pbr_surface/input[@name='specular_weight']")
    assert given.get("value") is None
    assert given.get("nodename") == root.find("tiledimage").get("name")
    assert root.find("multiply") is None


def test_the_mirror_image_of_a_smooth_surface_has_no_texture(texture, tmp_path):
    spectrum = samples.spectrum(0.1)
    index = optics.refractive_index(1.5)
    smooth = microfacet.build(facets.flat(), index=index, spectrum=spectrum)
    with_paint_files(texture, smooth, tmp_path, NAME, ("gltf", "openpbr"))
    shader = ElementTree.parse(tmp_path / f"{NAME}.textured.mtlx").find("open_pbr_surface")
    assert [given.get("name") for given in shader.findall("input[@nodename]")] == ["base_color"]
    document = json.loads((tmp_path / f"{NAME}.textured.gltf").read_text())
    assert "KHR_materials_specular" not in document["materials"][0]["extensions"]


def test_a_bright_base_under_sparkles_says_why_gltf_is_not_written(texture, tmp_path):
    bright = samples.beckmann_bsdf(0.3, reflectance=0.8)
    listed = with_paint_files(texture, bright, tmp_path, NAME, ("gltf", "openpbr"))
    assert set(json.loads(listed.attrs["files"])) == {f"{NAME}.textured.mtlx"}
    assert any("factors of glTF are at most 1" in text for text in vocabulary.warnings(listed))


def test_formats_that_are_not_exported_are_not_written(texture, bsdf, tmp_path):
    (tmp_path / f"{NAME}.textured.png").write_text("of an earlier run")
    listed = with_paint_files(texture, bsdf, tmp_path, NAME, ())
    assert json.loads(listed.attrs["files"]) == {}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_mitsuba_shows_the_brdf_on_average_and_sparkles_where_they_are(texture, bsdf, tmp_path):
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    write_pictures(texture, tmp_path, NAME)
    listed = with_paint_files(texture, bsdf, tmp_path, NAME, ("rgl",))
    assert {f"{NAME}.textured.xml", f"{NAME}.textured.rgb.bsdf"} < set(json.loads(listed.attrs["files"]))
    path = tmp_path / f"{NAME}.textured.xml"
    assert "45as15" in path.read_text()
    before = mitsuba.variant()
    mitsuba.set_variant("llvm_ad_rgb")
    try:
        root = ElementTree.parse(path)
        # A pixel of the picture is the mean over its own area.
        ElementTree.SubElement(root.find(".//film"), "rfilter", type="box")
        root.write(path, encoding="unicode")
        picture = np.array(mitsuba.render(mitsuba.load_file(str(path)), spp=64))[..., 1]
    finally:
        if before is not None:
            mitsuba.set_variant(before)
    # The picture is 1.2 times as wide as the panel, whose lower left corner is that of a tile; rows go downwards.
    size, tiles, pixels, parts = len(picture), 4, 64, 4
    at = ((np.arange(size * parts) + 0.5) / (size * parts) - 0.5) * 1.2 * tiles + tiles / 2
    inside = slice(size // 6, size - size // 6)
    shown = picture[::-1][inside, inside]
    # Irradiance of the lamp, 3 across its rays, from 45 degree; the camera is along the normal.
    wanted = float(bsdf.bsdf.nonspectral().bsdf.evaluate(45.0, 180.0, 0.0, 0.0)) * 3 * np.cos(np.radians(45))
    assert shown.mean() == pytest.approx(wanted, rel=0.01)

    def seen(tile):
        """Bilinear between the middles of its pixels, and the mean over a pixel of the picture."""
        places = np.meshgrid(at * pixels - 0.5, at * pixels - 0.5, indexing="ij")
        fine = map_coordinates(tile.astype(float), places, order=1, mode="grid-wrap")
        return fine.reshape(size, parts, size, parts).mean(axis=(1, 3))[inside, inside]

    tile = texture["relative_light"].values[1]
    light = seen(tile)
    assert np.corrcoef(shown.ravel(), light.ravel())[0, 1] > 0.99
    for mirrored in (tile[::-1], tile[:, ::-1]):
        assert abs(np.corrcoef(shown.ravel(), seen(mirrored).ravel())[0, 1]) < 0.5
    bright = light > 0.7 * light.max()
    assert bright.sum() > 50
    assert np.median(shown[bright] / light[bright]) == pytest.approx(wanted, rel=0.01)

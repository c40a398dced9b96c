"""MaterialX files of OpenPBR, and materials of glTF: structure, parameters, stated error and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_models

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.errors import InputError
from brdfpipe.exchange import openpbr
from brdfpipe.exchange.fits.forms import Lobe, Material, by_albedo, dielectric
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write


@pytest.fixture(scope="module")
def red():
    return samples.beckmann_bsdf(0.2, reflectance=np.linspace(0.05, 0.6, 85)).assign_attrs(material="red -- <grain>")


def inputs(path: Path) -> dict[str, str]:
    root = ElementTree.parse(path).getroot()
    return {node.get("name"): node.get("value") for node in root.findall("open_pbr_surface/input")}


def test_the_file_has_one_surface_and_its_parameters(red, tmp_path: Path) -> None:
    path = tmp_path / "red.mtlx"
    write(red, path)
    root = ElementTree.parse(path).getroot()
    assert (root.tag, root.get("version"), root.get("colorspace")) == ("materialx", "1.39", "lin_rec709")
    surface, material = root.find("open_pbr_surface"), root.find("surfacematerial")
    assert material.find("input").get("nodename") == surface.get("name")
    assert surface.get("name").replace("_", "").isalnum()
    values, record = inputs(path), json.loads(Path(f"{path}.json").read_text())
    # The square of the roughness is the width.
    assert float(values["specular_roughness"]) ** 2 == pytest.approx(0.2 * np.sqrt(2), rel=0.25)
    assert float(values["specular_ior"]) == pytest.approx(1.55)
    assert values["base_metalness"] == "0.0"
    base = [float(value) for value in values["base_color"].split(",")]
    assert base == record["parameters"]["base_colour"]
    assert base[0] > base[2]


def test_the_file_states_its_error_and_what_it_leaves_out(red, tmp_path: Path) -> None:
    write(red, tmp_path / "red.mtlx")
    text = (tmp_path / "red.mtlx").read_text()
    record = json.loads((tmp_path / "red.mtlx.json").read_text())
    assert f"CIEDE2000 of {record['error']['delta_e_00']:.1f}" in text
    assert 0 < record["error"]["median"] < record["error"]["percentile_95"]
    assert "NOT in this file: polarisation" in text


def test_a_metal_has_its_reflectance_as_colour(tmp_path: Path) -> None:
    gold = microfacet.build(
        facets.analytic("ggx", 0.3), index=optics.refractive_index({"n": 0.4, "k": 2.8}), multiple_scattering="none"
    )
    write(gold, tmp_path / "gold.mtlx")
    values = inputs(tmp_path / "gold.mtlx")
    assert values["base_metalness"] == "1.0"
    assert "specular_ior" not in values
    expected = ((0.4 - 1) ** 2 + 2.8**2) / ((0.4 + 1) ** 2 + 2.8**2)
    assert [float(value) for value in values["base_color"].split(",")] == pytest.approx([expected] * 3, abs=2e-3)


def test_a_smooth_surface_mirrors(tmp_path: Path) -> None:
    smooth = microfacet.build(facets.flat(), index=optics.refractive_index(1.5), spectrum=samples.spectrum(0.3))
    write(smooth, tmp_path / "smooth.mtlx")
    assert float(inputs(tmp_path / "smooth.mtlx")["specular_roughness"]) == 0
    assert "specular" not in json.loads((tmp_path / "smooth.mtlx.json").read_text())["left_out"]


def test_a_material_that_the_model_does_not_describe_is_refused(red, tmp_path: Path) -> None:
    with pytest.raises(ExchangeError, match="OpenPBR does not describe this material"):
        write(red, tmp_path / "red.mtlx", largest_error=0.001)
    with pytest.raises(ExchangeError, match="lay"):
        write(samples.brushed_bsdf(0.3, 0.1), tmp_path / "red.mtlx")
    assert not list(tmp_path.iterdir())


PAINT = """<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <open_pbr_surface name="paint" type="surfaceshader">
    <input name="base_color" type="color3" value="0.5, 0.2, 0.1" />
    <input name="specular_roughness" type="float" value="0.5" />
    <input name="specular_ior" type="float" value="1.6" />
  </open_pbr_surface>
  <surfacematerial name="m" type="material"><input name="surfaceshader" type="surfaceshader" nodename="paint" /></surfacematerial>
</materialx>
"""


def test_a_surface_of_another_program_is_read_as_its_microfacet_model(tmp_path: Path) -> None:
    (tmp_path / "x.mtlx").write_text(PAINT)
    found = read(tmp_path / "x.mtlx")
    model = Material(Lobe("ggx", 0.25, dielectric(1.6), True), np.array([0.5, 0.2, 0.1]), by_albedo)
    at = np.array([[20.0, 0, 25, 170], [60, 0, 58, 181], [45, 0, 0, 0], [75, 0, 70, 120]]).T
    luminous = model.evaluate(*at) @ np.array([0.2126, 0.7152, 0.0722])
    assert np.ravel(found.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(luminous, rel=0.02)
    assert "microfacet model of OpenPBR" in found.attrs["history"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="1.6"', 'value="0.6"', "index of refraction is out of range.*0.6"),
        ('value="0.5, 0.2, 0.1"', 'value="0.5, 0.2"', "wrong number of values of base_color"),
        ('value="0.5"', 'value="nan"', "not a number"),
        ('value="0.5"', 'value="rough"', "specular_roughness is not a number.*rough"),
        ('value="0.5, 0.2, 0.1"', 'nodename="picture"', "base_color has no value"),
        ("lin_rec709", "srgb_texture", "unknown colour space"),
        ("open_pbr_surface", "standard_surface", "not one OpenPBR surface"),
        ('name="specular_ior"', 'name="specular_weight"', "specular_weight is not read"),
        ("<materialx", '<!DOCTYPE x [<!ENTITY e "value">]><materialx', "document type or entities"),
        ("</materialx>", "", "damaged XML"),
    ],
)
def test_a_surface_that_is_no_single_appearance_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in PAINT
    (tmp_path / "x.mtlx").write_text(PAINT.replace(old, new))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "x.mtlx")


def test_entities_are_not_expanded(tmp_path: Path) -> None:
    levels = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 10))
    (tmp_path / "x.mtlx").write_text(f'<!DOCTYPE x [<!ENTITY a0 "lol">{levels}]>{PAINT[22:].replace("0.6", "&a9;")}')
    with pytest.raises(InputError, match="entities"):
        read(tmp_path / "x.mtlx")


def test_inputs_that_are_not_evaluated_are_named(tmp_path: Path) -> None:
    coat = '<input name="coat_weight" type="float" value="1" />\n  </open_pbr_surface>'
    (tmp_path / "x.mtlx").write_text(PAINT.replace("</open_pbr_surface>", coat))
    assert any("coat_weight was not evaluated" in text for text in openpbr.read(tmp_path / "x.mtlx").warnings)


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    check_garbled_models(monkeypatch, PAINT.encode(), tmp_path / "x.mtlx", "openpbr", count)

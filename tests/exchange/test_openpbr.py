"""MaterialX files of OpenPBR, and materials of glTF: structure, parameters, stated error and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
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

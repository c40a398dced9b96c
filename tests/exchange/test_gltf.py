"""Materials of glTF 2.0."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.exchange.registry import ExchangeError, write


def test_the_material_has_its_parameters_and_its_error(tmp_path: Path) -> None:
    red = samples.beckmann_bsdf(0.2, reflectance=np.linspace(0.05, 0.6, 85))
    write(red, tmp_path / "red.gltf")
    document = json.loads((tmp_path / "red.gltf").read_text())
    assert document["asset"]["version"] == "2.0"
    (material,) = document["materials"]
    parameters = material["pbrMetallicRoughness"]
    assert parameters["metallicFactor"] == 0
    assert parameters["roughnessFactor"] ** 2 == pytest.approx(0.2 * np.sqrt(2), rel=0.3)
    assert parameters["baseColorFactor"][3] == 1
    assert all(0 <= value <= 1 for value in parameters["baseColorFactor"])
    assert material["extensions"]["KHR_materials_ior"]["ior"] == pytest.approx(1.55)
    assert set(material["extensions"]) == set(document["extensionsUsed"])
    record = json.loads((tmp_path / "red.gltf.json").read_text())
    assert material["extras"]["brdfpipe"]["error"] == record["error"]


def test_a_metal_has_no_index(tmp_path: Path) -> None:
    gold = microfacet.build(
        facets.analytic("ggx", 0.3), index=optics.refractive_index({"n": 0.4, "k": 2.8}), multiple_scattering="none"
    )
    write(gold, tmp_path / "gold.gltf")
    document = json.loads((tmp_path / "gold.gltf").read_text())
    assert document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 1
    assert "extensionsUsed" not in document


def test_a_lay_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExchangeError, match="lay"):
        write(samples.brushed_bsdf(0.3, 0.1), tmp_path / "x.gltf")
    assert not list(tmp_path.iterdir())

"""Materials of glTF 2.0."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_models

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.errors import InputError
from brdfpipe.exchange import gltf
from brdfpipe.exchange.fits.forms import Lobe, Material, by_fresnel, nothing, schlick
from brdfpipe.exchange.reading import read
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


def _document(**values: object) -> dict[str, object]:
    metallic = {"baseColorFactor": [0.5, 0.2, 0.1, 1], "metallicFactor": 0, "roughnessFactor": 0.5, **values}
    return {
        "asset": {"version": "2.0", "generator": "another program", "copyright": "of its user"},
        "materials": [{"pbrMetallicRoughness": metallic, "extensions": {"KHR_materials_ior": {"ior": 1.5}}}],
    }


def _material(metal: float) -> tuple[Material, Material, float]:
    colour = np.array([0.5, 0.2, 0.1])
    body = Material(Lobe("ggx", 0.25, schlick(np.full(3, 0.04))), colour, by_fresnel)
    return body, Material(Lobe("ggx", 0.25, schlick(colour)), np.zeros(3), nothing), metal


@pytest.mark.parametrize("metal", [0.0, 0.4, 1.0])
def test_a_material_of_another_program_is_read_as_its_microfacet_model(tmp_path: Path, metal: float) -> None:
    (tmp_path / "x.gltf").write_text(json.dumps(_document(metallicFactor=metal)))
    found = read(tmp_path / "x.gltf")
    body, conductor, share = _material(metal)
    at = np.array([[20.0, 0, 25, 170], [60, 0, 58, 181], [45, 0, 0, 0], [75, 0, 70, 120]]).T
    expected = (1 - share) * body.evaluate(*at) + share * conductor.evaluate(*at)
    luminous = expected @ np.array([0.2126, 0.7152, 0.0722])
    assert np.ravel(found.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(luminous, rel=0.02)
    assert "microfacet model of glTF 2.0" in found.attrs["history"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roughnessFactor": 1.5}, "roughness is out of range.*1.5"),
        ({"metallicFactor": "1"}, "metallicFactor is not a number"),
        ({"roughnessFactor": True}, "not a number"),
        ({"baseColorFactor": [1, 1]}, "four numbers"),
        ({"baseColorFactor": [2, 0, 0, 1]}, "colour R is out of range"),
        ({"baseColorTexture": {"index": 0}}, "textures"),
    ],
)
def test_a_material_that_is_no_single_appearance_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    (tmp_path / "x.gltf").write_text(json.dumps(_document(**change)))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "x.gltf")


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        '{"materials": []}',
        '{"materials": [3]}',
        "[" * 100_000,
        "{" * 9,
        '{"materials": [{"pbrMetallicRoughness": 1}]}',
    ],
)
def test_a_file_without_a_material_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.gltf").write_text(text)
    with pytest.raises(InputError):
        read(tmp_path / "x.gltf")


def test_what_is_not_evaluated_is_named(tmp_path: Path) -> None:
    document = _document()
    document["materials"][0]["extensions"]["KHR_materials_clearcoat"] = {"clearcoatFactor": 1}
    document["materials"].append({})
    (tmp_path / "x.gltf").write_text(json.dumps(document))
    warnings = gltf.read(tmp_path / "x.gltf").warnings
    assert any("KHR_materials_clearcoat" in text for text in warnings)
    assert any("2 materials" in text for text in warnings)


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    check_garbled_models(monkeypatch, json.dumps(_document(), indent=1).encode(), tmp_path / "x.gltf", "gltf", count)

"""The catalogue: which materials it finds, what it refuses of them, and what each stage is told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from brdfpipe import catalogue
from brdfpipe.errors import InputError

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"


def write(folder: Path, name: str, text: str = COLOUR, **files: str) -> Path:
    material = folder / name
    material.mkdir(parents=True)
    (material / "material.yaml").write_text(text)
    for file, content in files.items():
        (material / file.replace("_", ".")).write_text(content)
    return material


def test_every_folder_with_a_description_is_a_material(tmp_path: Path) -> None:
    write(tmp_path, "b")
    write(tmp_path, "a")
    (tmp_path / "notes").mkdir()
    (tmp_path / "readme.txt").touch()
    loaded = catalogue.load(tmp_path)
    assert [material.name for material in loaded.materials] == ["a", "b"]
    assert loaded.failures == {}


def test_one_bad_material_stops_no_other(tmp_path: Path) -> None:
    write(tmp_path, "good")
    write(tmp_path, "bad", "spectrum: [")
    loaded = catalogue.load(tmp_path)
    assert [material.name for material in loaded.materials] == ["good"]
    assert "line 1" in loaded.failures["bad"]


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("spectrm: {}", r"unknown key 'spectrm'; did you mean 'spectrum'\?"),
        ("description: nothing", "at least one of `surface`, `spectrum`"),
        ("surface: {distribution: beckmann, slope_rms: 0.1}", "the key 'index' is missing"),
        ("surface: {distribution: ggx, slope_rms: 0.1}\nindex: 1.5", "unknown key 'slope_rms'|'a' is missing"),
        ("surface: {distribution: beckman, slope_rms: 0.1}\nindex: 1.5", "did you mean 'beckmann'"),
        ("surface: {distribution: beckmann, slope_rms: 0}\nindex: 1.5", "slope_rms: not an accepted value; found 0"),
        ("surface: {file: a.txt, unit: inch}\nindex: 1.5", "found 'inch'; accepted: nm, um, mm, m"),
        ("surface: {file: a.txt, pitch: [1, 2, 3]}\nindex: 1.5", "surface.pitch"),
        ("surface: {file: a.txt, pitch: -1}\nindex: 1.5", "surface.pitch: not an accepted value; found -1"),
        ("surface: {file: a.txt}\nindex: 0.5", "index: not an accepted value; found 0.5"),
        ("spectrum: {file: a.txt}", "the key 'geometry' is missing; accepted: sci, sce"),
        ("spectrum: {lab: [50, 0], illuminant: D65, observer: 10, geometry: sci}", "spectrum.lab"),
        ("spectrum: {file: a.txt, geometry: sci, incidence: 90}", "incidence: not an accepted value; found 90"),
        (COLOUR + "exports: [zemax]", "exports.0"),
        (COLOUR + "name: a b", "name"),
        (COLOUR + "name: ''", "name"),
    ],
)
def test_a_wrong_key_is_refused_by_name(tmp_path: Path, text: str, pattern: str) -> None:
    write(tmp_path, "m", text, a_txt="1 2")
    assert re.search(pattern, catalogue.load(tmp_path).failures["m"])


@pytest.mark.parametrize("name", ["logs", "Failures", "exports", "catalogue.nc", "index.html"])
def test_names_with_a_meaning_in_the_results_are_refused(tmp_path: Path, name: str) -> None:
    write(tmp_path, "m", COLOUR + f"name: {name}")
    assert "a reserved name" in catalogue.load(tmp_path).failures["m"]


def test_a_folder_name_that_is_no_name_asks_for_one(tmp_path: Path) -> None:
    write(tmp_path, "PC ABS (black)")
    assert "set `name`" in catalogue.load(tmp_path).failures["PC ABS (black)"]


def test_two_materials_of_one_name_are_both_refused(tmp_path: Path) -> None:
    write(tmp_path, "a", COLOUR + "name: same")
    write(tmp_path, "b", COLOUR + "name: Same")
    write(tmp_path, "c")
    loaded = catalogue.load(tmp_path)
    assert [material.name for material in loaded.materials] == ["c"]
    assert all("found a, b" in loaded.failures[folder] for folder in ("a", "b"))


def test_the_name_of_another_folder_is_refused(tmp_path: Path) -> None:
    write(tmp_path, "a", "spectrum: [")
    write(tmp_path, "b", COLOUR + "name: a")
    assert set(catalogue.load(tmp_path).failures) == {"a", "b"}


def test_a_missing_file_names_the_nearest(tmp_path: Path) -> None:
    write(tmp_path, "m", "spectrum: {file: reflectanse.txt, geometry: sci}", reflectance_txt="1 2")
    failure = catalogue.load(tmp_path).failures["m"]
    assert "spectrum.file: no such file; did you mean 'reflectance.txt'?; found 'reflectanse.txt'" in failure


@pytest.mark.parametrize(
    "file", ["../secret.txt", "/etc/passwd", "link.txt", "linked/secret.txt", "a/../../secret.txt"]
)
def test_a_file_outside_the_materials_folder_is_refused(tmp_path: Path, file: str) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.txt").write_text("secret")
    folder = tmp_path / "catalogue"
    material = write(folder, "m", f"spectrum: {{file: {file}, geometry: sci}}")
    (folder / "secret.txt").write_text("secret")
    (material / "link.txt").symlink_to(outside / "secret.txt")
    (material / "linked").symlink_to(outside)
    assert "outside the material's folder" in catalogue.load(folder).failures["m"]


def test_a_brace_in_a_path_is_refused_before_the_workflow_takes_it_for_a_wildcard(tmp_path: Path) -> None:
    material = write(tmp_path, "m", "spectrum: {file: '{x}.txt', geometry: sci}")
    (material / "{x}.txt").write_text("1 2")
    assert "a brace or a line break" in catalogue.load(tmp_path).failures["m"]


def test_a_file_in_a_folder_below_is_accepted(tmp_path: Path) -> None:
    material = write(tmp_path, "m", "spectrum: {file: raw/a.txt, geometry: sci}")
    (material / "raw").mkdir()
    (material / "raw" / "a.txt").write_text("1 2")
    assert catalogue.load(tmp_path)["m"].files["spectrum"] == (material / "raw" / "a.txt").resolve()


@pytest.mark.parametrize(
    ("make", "pattern"),
    [
        (lambda folder: folder / "none", "no such folder"),
        (lambda folder: folder, "holds no material; `brdfpipe new NAME"),
        (lambda folder: write(folder, "m"), "is one material"),
    ],
)
def test_a_folder_that_is_no_catalogue_is_refused(tmp_path: Path, make: Any, pattern: str) -> None:
    with pytest.raises(catalogue.CatalogueError, match=pattern):
        catalogue.load(make(tmp_path))


def test_asking_for_an_unknown_material_names_the_nearest(tmp_path: Path) -> None:
    write(tmp_path, "abs-grain")
    with pytest.raises(catalogue.CatalogueError, match="did you mean 'abs-grain'"):
        catalogue.load(tmp_path)["abs-grian"]


def test_each_stage_is_told_its_own_part_and_no_more(tmp_path: Path) -> None:
    text = "description: d\nsurface: {file: a.txt, unit: um, isotropic: true}\nindex: PP\n"
    write(tmp_path, "m", text + "spectrum: {file: a.txt, geometry: sci}", a_txt="1 2")
    loaded = catalogue.load(tmp_path)
    told = {
        stage: loaded.spec("m", stage) for stage in ("surface", "facets", "index", "spectrum", "predicted", "report")
    }
    assert told == {
        "surface": {"file": "a.txt", "unit": "um", "form": "plane"},
        "facets": {"isotropic": True},
        "index": {"index": "PP"},
        "spectrum": {"file": "a.txt", "geometry": "sci", "incidence": 8, "allow_fluorescent": False},
        "predicted": {"masking": "height-correlated", "diffuse": "coupled"},
        "report": {"description": "d", "exports": ["astm"]},
    }


def test_a_configuration_may_say_only_what_differs(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("illuminant: A\n")
    config = catalogue.load_config(own)
    assert config == {**catalogue.load_config(), "illuminant": "A"}


def test_a_wrong_configuration_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("gloss_angle: [20]\n")
    with pytest.raises(InputError, match="did you mean 'gloss_angles'"):
        catalogue.load_config(own)


def test_the_schemas_are_valid_and_document_every_key() -> None:
    for path in (catalogue.project_folder() / "config" / "schemas").glob("*.yaml"):
        schema = yaml.safe_load(path.read_text())
        jsonschema.Draft202012Validator.check_schema(schema)
        definitions = schema["$defs"]
        for block in [schema, *definitions.values()]:
            for key, part in block.get("properties", {}).items():
                described = (
                    definitions[part["$ref"].rpartition("/")[2]]
                    if "$ref" in part and "description" not in part
                    else part
                )
                assert described.get("description"), f"{path.name}: {key}"


def test_the_schema_and_the_catalogue_agree_on_names() -> None:
    path = catalogue.project_folder() / "config" / "schemas" / "material.schema.yaml"
    assert yaml.safe_load(path.read_text())["properties"]["name"]["pattern"] == f"^{catalogue.NAME}$"


def test_formats_are_checked_without_reading(tmp_path: Path) -> None:
    write(tmp_path, "a", "surface: {file: a.sur}\nindex: PP", a_sur="x")
    write(tmp_path, "b", "surface: {file: a.txt, unit: um, pitch: 1}\nindex: PPP", a_txt="x")
    write(tmp_path, "c", "spectrum: {file: a.txt, geometry: sci}", a_txt="")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    for name, pattern in (("a", "found .sur"), ("b", "PPP"), ("c", "empty")):
        with pytest.raises(InputError, match=pattern):
            catalogue.check_formats(loaded[name])


def test_a_started_material_is_valid_and_so_is_each_alternative_in_its_comments(tmp_path: Path) -> None:
    path = catalogue.start_material(tmp_path, "fresh")
    assert catalogue.load(tmp_path).failures == {}
    text = path.read_text()
    for file in ("reflectance.txt", "surface.x3p", "profile.txt", "index.txt"):
        (path.parent / file).touch()
    blocks = re.findall(r"(?m)^# (?:surface|index|spectrum|exports):.*\n(?:#   .*\n)*", text)
    assert len(blocks) == 8
    for block in blocks:
        key, plain = block[2:].partition(":")[0], re.sub(r"(?m)^# ", "", block)
        rest = "" if key == "spectrum" else COLOUR
        path.write_text(rest + plain + ("index: PP\n" if key == "surface" else ""))
        assert catalogue.load(tmp_path).failures == {}, block


def test_a_material_is_never_started_twice(tmp_path: Path) -> None:
    catalogue.start_material(tmp_path, "m")
    with pytest.raises(catalogue.CatalogueError, match="exists already"):
        catalogue.start_material(tmp_path, "m")

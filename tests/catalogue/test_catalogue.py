"""The catalogue: its materials, refusals, and the parameters of stages."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
from pathlib import Path
from typing import Any

import pytest

from brdfpipe import catalogue
from brdfpipe.catalogue import material_keys
from brdfpipe.catalogue.config_keys import Config
from brdfpipe.catalogue.material import unused_keys
from brdfpipe.catalogue.raw_reading import describe_files
from brdfpipe.comparison.measured_predicted import PRIOR_U
from brdfpipe.descriptions import reading
from brdfpipe.descriptions.keys import Keys, case_folded
from brdfpipe.errors import InputError
from brdfpipe.stages import STAGES, Subject

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"

SCAN = "surface: {file: a.txt, unit: um, pitch: 1}\nindex: 1.5\n"
CROSSED = "surface: {file: a.txt, layout: line, scans: [{file: a.txt, azimuth: 90}]}\nindex: 1.5\n"
"""Two lines, along a lay and across it."""
FRONT = "surface: {distribution: flat}\nindex: PP\n"
ROUGH = "surface: {distribution: beckmann, slope_rms: 0.02, length: 5}\nindex: 1.5\n"


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
        ("spectrum: {geometry: sci}", "the key 'file' is missing"),
        ("spectrum: {lab: [50, 0], illuminant: D65, observer: 10, geometry: sci}", "spectrum.lab"),
        ("spectrum: {file: a.txt, geometry: sci, incidence: 90}", "incidence: not an accepted value; found 90"),
        (
            "surface: {file: a.txt, layout: line, unit: um}\nindex: 1.5",
            "the key 'isotropic' is missing; accepted: true",
        ),
        (
            "surface: {file: a.txt, layout: line, isotropic: false}\nindex: 1.5",
            "isotropic: not an accepted value; found False",
        ),
        (
            "surface: {file: a.txt, layout: line, scans: [{file: a.txt, azimuth: 180}]}\nindex: 1.5",
            "the key 'isotropic' is missing; accepted: true",
        ),
        (CROSSED.replace("line,", "line, method: abel,"), "surface.method: lines in two directions are counted"),
        (CROSSED + "model: {masking: measured}", "model.masking: this masking is for a surface without a lay"),
        (
            "surface: {file: a.txt, isotropic: false}\nindex: 1.5\nmodel: {masking: liu}",
            "model.masking: this masking is for a surface without a lay; found 'liu'",
        ),
        (
            CROSSED + "model: {multiple_scattering: measured}",
            "model.multiple_scattering: rays are traced on a height map",
        ),
        (
            "surface: {file: a.txt, layout: line, isotropic: true}\nindex: 1.5\nmodel: {truth: use}",
            "model.truth: rays are traced on a height map",
        ),
        ("surface: {file: a.txt, distribution: ggx, a: 1}\nindex: 1.5", "either `file` or `distribution`$"),
        ("surface: {file: a.txt}\nindex: 1,5", "found '1,5'.*decimal point"),
        ("spectrum: {file: a.txt, lab: [50, 0, 0], geometry: sci}", "either `file` or `lab`$"),
        (
            COLOUR.replace("50,", "100.5,"),
            r"spectrum.lab.0: not an accepted value; found 100.5; accepted: L\* from 0 to 100",
        ),
        (COLOUR.replace("50,", "-1,"), "spectrum.lab.0"),
        (COLOUR + "exports: astm", r"accepted: a list: \[astm\]"),
        (
            FRONT + "slab: {}",
            "slab: the key 'thickness' is missing; accepted: thickness of the body or of the coat \\[mm\\], above 0 and at most 1000",
        ),
        (FRONT + "slab: {thickness: 0}", "slab.thickness: not an accepted value; found 0"),
        (
            FRONT + "slab: {thickness: 1, back: rough}",
            "slab.back: not an accepted value; found 'rough'; accepted: same, flat",
        ),
        (FRONT + "slab: {thickness: 1, back: {distribution: ggx}}", "slab.back: the key 'a' is missing"),
        (FRONT + "slab: {thickness: 1, back: {file: a.txt, scans: [{file: a.txt}]}}", "slab.back.scans: further scans"),
        (FRONT + "slab: {thickness: 1, back: {file: b.txt}}", "slab.back.file: no such file"),
        (FRONT + "slab: {thickness: 1, internal_transmittance: 1.5}", "found 1.5; accepted: a number from 0 to 1, or"),
        (
            FRONT + "slab: {thickness: 1, internal_transmittance: {file: b.txt}}",
            "slab.internal_transmittance.file: no such",
        ),
        (FRONT + "slab: {thickness: 1, absorption: -1}", "slab.absorption: not an accepted value; found -1"),
        (
            FRONT + "slab: {thickness: 1, absorption: {file: a.txt, unit: 1/km}}",
            "found '1/km'; accepted: 1/mm, 1/cm, 1/m",
        ),
        (
            FRONT + "slab: {thickness: 1, absorption: 1, internal_transmittance: 1}",
            "either `internal_transmittance` or `absorption`$",
        ),
        (COLOUR + "slab: {thickness: 1}", "the key 'surface' is missing"),
        (
            FRONT + COLOUR + "slab: {thickness: 1}",
            "`slab` and `spectrum` exclude each other: a clear body has no diffuse base",
        ),
        (
            FRONT + "slab: {thickness: 1}\nmodel: {masking: blinn}",
            "model.masking: a slab needs one of Smith's maskings",
        ),
        (FRONT + "slab: {thickness: 1}\nmodel: {recipe: crf}", "found 'crf'; accepted: height-correlated, separable"),
        (FRONT + "slab: {thickness: 1}\nmodel: {diffuse: coupled}", "model.diffuse: a clear body has no diffuse base"),
        (
            FRONT.replace("PP", "{n: 1.5, k: 0.1}") + "slab: {thickness: 1}",
            "index.k: the body of a slab would be opaque",
        ),
        (FRONT + "model: {truth: use}", "model.truth: a reference solution needs a height map"),
        (
            SCAN + "slab: {thickness: 1}\nmodel: {truth: use}",
            "model.truth: a clear or coated body has no reference solution",
        ),
        (SCAN + "model: {truth: use, recipe: crf}", "model.truth: a reference solution couples its diffuse base"),
        (SCAN + "model: {truth: use, optics: wave}", "model.optics: `truth: use` takes the reference solution"),
        (SCAN + "model: {truth: use, masking: measured}", "model.masking: `truth: use` takes the reference solution"),
        (
            SCAN + "model: {masking: crf, multiple_scattering: auto}",
            "`multiple_scattering: auto` is defined for Smith's",
        ),
        (
            SCAN + "model: {diffuse: crf, multiple_scattering: auto}",
            "model.multiple_scattering: `diffuse: crf` follows its source",
        ),
        (FRONT + "model: {optics: wave}", "model.optics: `model.optics: wave` needs a roughness spectrum"),
        (
            ROUGH + "slab: {thickness: 1}\nmodel: {optics: composite}",
            "`model.optics: composite` is for a body with one face",
        ),
        (ROUGH + "slab: {thickness: 1}\nmodel: {optics: auto, halo: ghs}", "a clear body has no `halo: ghs`"),
        (FRONT + "slab: {thickness: 1}\nmodel: {optics: wave}", "`model.optics: wave` needs a roughness spectrum"),
        (ROUGH + "model: {optics: wave, masking: blinn}", "model.masking: `optics: wave` has no facets"),
        (ROUGH + "model: {optics: wave, diffuse: crf}", "model.diffuse: `optics: wave` couples its base"),
        (ROUGH + "model: {optics: facets, halo: ghs}", "model.halo: a halo belongs to waves"),
        (ROUGH + "model: {optics: wave, recipe: crf}", "recipe"),
        (FRONT.replace("PP", "{n: 1.5}"), "index: the key 'k' is missing"),
        (FRONT.replace("PP", "{n: 1.5, k: 30}"), "index.k: not an accepted value; found 30"),
        (FRONT.replace("flat", "flat, slope_rms: 0.1"), "unknown key 'slope_rms'; accepted: distribution"),
        (COLOUR + "transparent: true", "unknown key 'transparent'"),
        (
            COLOUR + "model: {masking: smith}",
            "found 'smith'; accepted: auto, height-correlated, separable, measured, blinn, liu, crf, none",
        ),
        (COLOUR + "model: {recipe: crf, masking: crf}", "either `recipe` or `masking`$"),
        (
            COLOUR + "model: {multiple_scattering: compensated, masking: blinn}",
            "model.masking: `multiple_scattering: compensated` is defined for Smith's masking; found 'blinn'",
        ),
        (COLOUR + "exports: [photoshop]", "exports.0"),
        (COLOUR + "name: a b", "name"),
        (COLOUR + "name: ''", "name"),
    ],
)
def test_a_wrong_key_is_refused_by_name(tmp_path: Path, text: str, pattern: str) -> None:
    write(tmp_path, "m", text, a_txt="1 2")
    assert re.search(pattern, catalogue.load(tmp_path).failures["m"])


def test_waves_have_a_stage_and_a_roughness_spectrum(tmp_path: Path) -> None:
    write(tmp_path, "m", ROUGH + "model: {optics: auto}")
    loaded = catalogue.load(tmp_path)
    assert loaded.spec("m", "wave") == {"optics": "auto", "diffuse": "coupled", "halo": "ssa1"}
    assert {"slope_rms": 0.02, "length": 5}.items() <= loaded.spec("m", "psd").items()


def test_the_faces_of_a_slab_have_waves_by_default(tmp_path: Path) -> None:
    write(tmp_path, "m", ROUGH + "slab: {thickness: 2}")
    write(tmp_path, "n", ROUGH + "slab: {thickness: 2}\nmodel: {optics: facets}")
    loaded = catalogue.load(tmp_path)
    assert loaded.spec("m", "sheet") == {"masking": "height-correlated", "optics": "auto"}
    assert loaded.spec("n", "sheet") == {"masking": "height-correlated", "optics": "facets"}
    assert {"slope_rms": 0.02, "length": 5}.items() <= loaded.spec("m", "psd").items()


def test_each_stage_of_a_slab_has_the_parameters_of_its_face(tmp_path: Path) -> None:
    text = "surface: {distribution: ggx, a: 0.1}\nindex: PC\nmodel: {masking: Separable}\n"
    slab = "slab: {thickness: 2, absorption: {file: a.txt, unit: 1/cm}, back: {file: b.txt, unit: nm, isotropic: true}}"
    write(tmp_path, "m", text + slab, a_txt="1 2", b_txt="1 2")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    stages = ("facets", "back_surface", "back_facets", "back_psd", "interior", "sheet")
    assert {stage: loaded.spec("m", stage) for stage in stages} == {
        "facets": {"distribution": "ggx", "a": 0.1},
        "back_surface": {"file": "b.txt", "unit": "nm", "form": "plane"},
        "back_facets": {"isotropic": True},
        "back_psd": {},
        "interior": {"thickness": 2, "absorption": {"file": "a.txt", "unit": "1/cm"}},
        "sheet": {"masking": "separable", "optics": "facets"},
    }
    assert {part: path.name for part, path in loaded["m"].files.items()} == {
        "back_surface": "b.txt",
        "interior": "a.txt",
    }


@pytest.mark.parametrize(("back", "own"), [("", False), (", back: same", False), (", back: Flat", True)])
def test_a_slab_has_a_back_of_its_own_where_it_differs(tmp_path: Path, back: str, own: bool) -> None:
    write(tmp_path, "m", FRONT + f"slab: {{thickness: 1{back}}}")
    loaded = catalogue.load(tmp_path)
    assert loaded["m"].has("slab")
    assert loaded["m"].has("back") == own
    if own:
        assert loaded.spec("m", "back_facets") == {"distribution": "flat"}


@pytest.mark.parametrize(
    ("text", "written"),
    [
        (COLOUR, "model: {masking: height-correlated, diffuse: coupled, multiple_scattering: auto}"),
        (FRONT + "slab: {thickness: 1}\n", "model: {masking: height-correlated}"),
        (FRONT + "slab: {thickness: 1", ", internal_transmittance: 1, back: same}"),
        (FRONT + "slab: {thickness: 1, absorption: {file: a.txt", ", unit: 1/mm}}"),
    ],
)
def test_writing_a_default_changes_no_parameter_of_a_stage(tmp_path: Path, text: str, written: str) -> None:
    closed = text + "}" * (text.count("{") - text.count("}"))
    write(tmp_path / "a", "m", closed, a_txt="1 2")
    write(tmp_path / "b", "m", text + written, a_txt="1 2")
    first, second = (catalogue.load(tmp_path / folder) for folder in ("a", "b"))
    stages = ["sheet", "interior"] if first["m"].has("slab") else ["predicted"]
    assert [first.spec("m", stage) for stage in stages] == [second.spec("m", stage) for stage in stages]


@pytest.mark.parametrize(
    ("model", "mode"),
    [
        ("masking: measured", "auto"),
        ("optics: facets", "auto"),
        ("multiple_scattering: none", "none"),
        ("masking: separable", "none"),
        ("masking: blinn", "none"),
        ("diffuse: crf", "none"),
        ("optics: wave", "none"),
    ],
)
def test_light_reflected_more_than_once_is_added_by_default_where_the_model_has_it(
    tmp_path: Path, model: str, mode: str
) -> None:
    write(tmp_path, "m", f"{SCAN}model: {{{model}}}", a_txt="1 2")
    loaded = catalogue.load(tmp_path)
    assert loaded.spec("m", "predicted")["multiple_scattering"] == mode
    assert bool(STAGES["interreflection"].jobs(Subject(loaded["m"], loaded.config))) == (mode == "auto")


def test_a_recipe_is_the_only_parameter_of_the_model(tmp_path: Path) -> None:
    write(tmp_path, "m", COLOUR + "model: {recipe: crf}")
    assert catalogue.load(tmp_path).spec("m", "predicted") == {"recipe": "crf"}


def choices(model: type[Keys], key: str) -> set[str | int]:
    return set(reading.declared(model, [key]).choices)


def test_the_keys_offer_what_the_model_has() -> None:
    from brdfpipe.bsdf.microfacet import transmission
    from brdfpipe.masking import modes
    from brdfpipe.masking.visibility import VISIBILITY

    offered = {key: choices(material_keys.Model, key) for key in material_keys.Model.declared_keys()}
    assert offered == {
        "masking": {"auto", *VISIBILITY, "liu", "measured"},
        "diffuse": set(modes.MODES["diffuse"]),
        "multiple_scattering": set(modes.MODES["multiple_scattering"]),
        "recipe": set(modes.RECIPES),
        "optics": set(modes.OPTICS),
        "halo": set(modes.HALOS),
        "truth": set(modes.TRUTHS),
    }
    assert set(modes.SMITH_MASKINGS) < set(transmission.MASKING)
    assert all(recipe[key] in modes.MODES[key] for recipe in modes.RECIPES.values() for key in modes.MODES)


def test_the_keys_offer_the_words_of_their_stages() -> None:
    from brdfpipe.appearance.gloss_of_finishes import TAILS
    from brdfpipe.bsdf import flake
    from brdfpipe.bsdf.measured import smoothing
    from brdfpipe.facets import line_profiles
    from brdfpipe.flakes.forms import FORMS as FLAKE_FORMS
    from brdfpipe.optics.interior import PER_MM
    from brdfpipe.spectra import recovery
    from brdfpipe.spectra.recovery_methods import random_search
    from brdfpipe.surfaces import levelling, text, units

    for model, key, words in (
        (material_keys.MeasuredSurface, "layout", text.LAYOUTS),
        (material_keys.MeasuredSurface, "form", levelling.FORMS),
        (material_keys.MeasuredSurface, "method", line_profiles.METHODS),
        (material_keys.AbsorptionFile, "unit", PER_MM),
        (material_keys.Colour, "method", recovery.METHODS),
        (material_keys.MultiangleFile, "form", FLAKE_FORMS),
        (material_keys.MultiangleFile, "model", flake.MODELS),
        (material_keys.Smoothing, "mode", smoothing.MODES),
        (material_keys.GlossSurface, "slopes", TAILS),
    ):
        assert tuple(reading.declared(model, [key]).choices) == tuple(words), key
    assert {case_folded(unit) for unit in units.UNITS} == set(material_keys.UNITS)
    assert material_keys.SEARCHES == random_search.SEARCHES
    assert material_keys.MeasuredSurface.default_of("form") == levelling.FORMS[0]
    assert material_keys.MultiangleFile.default_of("model") == flake.MODELS[0]
    assert material_keys.Smoothing.default_of("mode") == smoothing.MODES[0]


def test_an_unknown_illuminant_is_refused_before_a_build(tmp_path: Path) -> None:
    write(tmp_path, "m", COLOUR.replace("D65", "D56"))
    with pytest.raises(InputError, match=r"spectrum.illuminant: unknown illuminant 'D56' \(nearest is D65\)"):
        catalogue.check_formats(catalogue.load(tmp_path)["m"])
    own = tmp_path / "own.yaml"
    own.write_text("illuminant: D56\n")
    with pytest.raises(InputError, match=r"own.yaml, illuminant: unknown illuminant"):
        catalogue.load_config(own)


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
    assert "a brace, an angle bracket or a line break" in catalogue.load(tmp_path).failures["m"]


def test_an_angle_bracket_in_a_path_is_refused_before_the_workflow_takes_it_for_a_variable(tmp_path: Path) -> None:
    material = write(tmp_path, "m", "spectrum: {file: 'a<word>.txt', geometry: sci}")
    (material / "a<word>.txt").write_text("1 2")
    assert "an angle bracket" in catalogue.load(tmp_path).failures["m"]


@pytest.mark.parametrize("name", [b"c<word>", b"c{word}", b"c\xff"])
def test_a_catalogue_that_the_workflow_cannot_name_is_refused_at_once(tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    try:
        write(folder, "m")
    except OSError:
        pytest.skip("this file system takes no such name")
    with pytest.raises(catalogue.CatalogueError, match="rename or move the catalogue") as refusal:
        catalogue.load(folder)
    assert str(refusal.value).encode("utf-8")


def test_a_loop_of_links_stops_no_other_material(tmp_path: Path) -> None:
    write(tmp_path, "good")
    (write(tmp_path, "raw", SCAN) / "a.txt").symlink_to("a.txt")
    (tmp_path / "description").mkdir()
    (tmp_path / "description" / "material.yaml").symlink_to("material.yaml")
    (tmp_path / "folder").symlink_to("folder")
    loaded = catalogue.load(tmp_path)
    assert [item.name for item in loaded.materials] == ["good"]
    assert "symbolic links form a loop" in loaded.failures["raw"]


def test_a_description_that_links_outside_is_refused_and_not_quoted(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("password: swordfish\n")
    write(tmp_path / "catalogue", "good")
    (tmp_path / "catalogue" / "bad").mkdir()
    (tmp_path / "catalogue" / "bad" / "material.yaml").symlink_to(tmp_path / "secret")
    reason = catalogue.load(tmp_path / "catalogue").failures["bad"]
    assert "symbolic link to another folder" in reason
    assert "password" not in reason


def test_a_folder_without_permission_stops_no_other_material(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(tmp_path, "good")
    write(tmp_path, "locked")
    is_file = Path.is_file

    def refused(path: Path) -> bool:  # permissions do not bind the superuser, who may run the tests
        if path.parent.name == "locked":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return is_file(path)

    monkeypatch.setattr(Path, "is_file", refused)
    loaded = catalogue.load(tmp_path)
    assert [item.name for item in loaded.materials] == ["good"]
    assert loaded.failures["locked"] == "material.yaml: its folder cannot be read (Permission denied); allow reading it"
    assert catalogue.ignored(tmp_path)["locked"] == "cannot be read (Permission denied)"


@pytest.mark.parametrize("name", ["s" + "0" * 20, "x" + "ab" * 20])
def test_a_name_that_the_workflow_takes_for_an_endless_rule_is_refused(tmp_path: Path, name: str) -> None:
    write(tmp_path, name)
    write(tmp_path, name[:-2])
    loaded = catalogue.load(tmp_path)
    assert [item.name for item in loaded.materials] == [name[:-2]]
    assert "20 repetitions" in loaded.failures[name]


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
        (lambda folder: write(folder, "m"), "is a material, not a catalogue"),
    ],
)
def test_a_folder_that_is_no_catalogue_is_refused(tmp_path: Path, make: Any, pattern: str) -> None:
    with pytest.raises(catalogue.CatalogueError, match=pattern):
        catalogue.load(make(tmp_path))


def test_asking_for_an_unknown_material_names_the_nearest(tmp_path: Path) -> None:
    write(tmp_path, "abs-grain")
    with pytest.raises(catalogue.CatalogueError, match="did you mean 'abs-grain'"):
        catalogue.load(tmp_path)["abs-grian"]


@pytest.mark.parametrize("unit", ["um", "\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"])
def test_parameters_of_stages_have_one_spelling(tmp_path: Path, unit: str) -> None:
    text = f"surface: {{file: a.txt, unit: {unit}, lateral_unit: {unit}, layout: Line, isotropic: true}}\nindex: PP\n"
    write(tmp_path, "m", text + "spectrum: {file: a.txt, geometry: SCI, scale: Percent}", a_txt="1 2")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    parameters = loaded.spec("m", "surface") | loaded.spec("m", "spectrum")
    assert [parameters[key] for key in ("unit", "lateral_unit", "layout", "geometry", "scale")] == [
        "um",
        "um",
        "line",
        "sci",
        "percent",
    ]


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        (["material.yaml/notes.txt"], "material.yaml is no file; put the description there"),
        (["material.yml"], "material.yml is not read; rename it to material.yaml"),
        (["Material.YAML"], "Material.YAML is not read; rename it to material.yaml"),
        (["material.yaml.txt"], "material.yaml.txt is not read; rename it to material.yaml"),
        (["scan.x3p"], "scan.x3p but no material.yaml; `brdfpipe new`"),
        (["raw/material.yaml"], "material.yaml is one folder too deep, in raw"),
    ],
)
def test_a_folder_that_looks_like_a_material_and_is_none_is_reported(
    tmp_path: Path, files: list[str], reason: str
) -> None:
    write(tmp_path, "good")
    for file in files:
        (tmp_path / "odd" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "odd" / file).touch()
    ((name, message),) = catalogue.ignored(tmp_path).items()
    assert name == "odd"
    assert reason in message
    assert catalogue.load(tmp_path).failures == {}


@pytest.mark.parametrize("name", ["catalogue.yml", "Catalogue.yaml", "catalog.yaml", "catalogue.yaml.txt"])
def test_misnamed_defaults_are_reported(tmp_path: Path, name: str) -> None:
    write(tmp_path, "good")
    (tmp_path / name).write_text("index: ABS\n")
    assert catalogue.ignored(tmp_path) == {
        name: "is not read; rename it to catalogue.yaml, whose keys all materials inherit"
    }
    (tmp_path / name).rename(tmp_path / "catalogue.yaml")
    assert catalogue.ignored(tmp_path) == {}


def test_other_folders_and_results_are_no_materials(tmp_path: Path) -> None:
    write(tmp_path, "good", a_csv="1 2")
    for file in ("notes/read.pdf", ".git/a.txt", "results/catalogue.csv", "results/catalogue.nc"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    assert catalogue.ignored(tmp_path) == {}


def test_a_catalogue_of_misnamed_descriptions_names_them(tmp_path: Path) -> None:
    (write(tmp_path, "m") / "material.yaml").rename(tmp_path / "m" / "material.yml")
    with pytest.raises(catalogue.CatalogueError, match=r"holds no material.*m: material.yml is not read; rename it"):
        catalogue.load(tmp_path)


def test_each_stage_has_its_part_of_the_description_as_parameters(tmp_path: Path) -> None:
    text = "description: d\nsurface: {file: a.txt, unit: um, isotropic: true}\nindex: PP\n"
    write(tmp_path, "m", text + "spectrum: {file: a.txt, geometry: sci}", a_txt="1 2")
    loaded = catalogue.load(tmp_path)
    parameters = {
        stage: loaded.spec("m", stage) for stage in ("surface", "facets", "index", "spectrum", "predicted", "report")
    }
    origins = {key: origin for key, _, origin in parameters["report"].pop("origins")}
    assert (origins["index"], origins["surface.form"]) == ("material.yaml", "the default")
    assert parameters == {
        "surface": {"file": "a.txt", "unit": "um", "form": "plane"},
        "facets": {"isotropic": True},
        "index": {"index": "PP"},
        "spectrum": {"file": "a.txt", "geometry": "sci", "allow_fluorescent": False},
        "predicted": {"masking": "auto", "diffuse": "coupled", "multiple_scattering": "auto"},
        "report": {"description": "d"},
    }


def test_colours_at_several_geometries_are_a_material_and_their_own_route(tmp_path: Path) -> None:
    colours = ", ".join(
        f"{{geometry: '{name}', lab: [{20 - k}, 0, 0]}}" for k, name in enumerate(("45as15", "45as45", "45as75"))
    )
    write(tmp_path, "m", f"multiangle: {{colours: [{colours}], illuminant: D65, observer: 10, form: gaussian}}\n")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    assert not loaded["m"].has("predicted")
    assert loaded.spec("m", "bsdf") == {"route": "flake"}
    assert loaded.spec("m", "flake") == {"form": "gaussian", "index": 1.5, "model": "flake"}
    assert set(loaded.spec("m", "multiangle")) == {"colours", "illuminant", "observer"}
    assert catalogue.summary_words(loaded["m"]) == ["multiangle 3 colours"]
    catalogue.check_formats(loaded["m"])


@pytest.mark.parametrize(
    ("text", "unused"),
    [
        (f"{COLOUR}surface: {{distribution: ggx, a: 0.1}}\nindex: 1.5\nmodel: {{optics: facets}}\n", []),
        (COLOUR + "index: 1.5\n", []),
        (COLOUR + "model: {optics: facets}\n", ["model"]),
        ("multiangle: {file: c.csv, illuminant: D65, observer: 10}\nindex: 1.5\n", ["index"]),
        (COLOUR + "multiangle: {file: c.csv, illuminant: D65, observer: 10}\n", ["spectrum"]),
    ],
)
def test_a_key_that_nothing_uses_is_named(tmp_path: Path, text: str, unused: list[str]) -> None:
    write(tmp_path, "m", text, c_csv="x")
    loaded = catalogue.load(tmp_path)
    found = unused_keys(loaded["m"].content)
    assert list(found) == unused
    assert loaded.spec("m", "report").get("unused", {}) == found


def test_a_file_of_colours_at_several_geometries_is_a_raw_file(tmp_path: Path) -> None:
    write(tmp_path, "m", "multiangle: {file: a.csv, illuminant: D65, observer: 10}\n" + COLOUR, a_csv="geometry,L,a,b")
    loaded = catalogue.load(tmp_path)
    assert loaded["m"].files["multiangle"].name == "a.csv"
    assert not loaded["m"].has("predicted")
    assert loaded.spec("m", "bsdf") == {"route": "flake"}


def test_a_table_of_another_program_is_a_material_and_its_own_route(tmp_path: Path) -> None:
    write(tmp_path, "m", "table: {file: a.bsdf, format: zemax, quantity: brdf_cos}\n", a_bsdf="Source  Measured\n")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    assert not loaded["m"].has("predicted")
    assert loaded.spec("m", "bsdf") == {"route": "imported"}
    assert loaded.spec("m", "imported") == {"format": "zemax", "quantity": "brdf_cos"}
    assert loaded["m"].files["table"].name == "a.bsdf"
    assert catalogue.summary_words(loaded["m"]) == ["table a.bsdf"]
    catalogue.check_formats(loaded["m"])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("table: {file: a.bsdf, format: word}\n", "table.format: .*'word'.*zemax"),
        ("table: {file: ../a.bsdf}\n", "table.file"),
        (f"table: {{file: a.bsdf}}\n{COLOUR}", "table.*spectrum"),
        (f"table: {{file: a.bsdf}}\n{FRONT}", "table.*surface"),
    ],
)
def test_a_wrong_table_is_refused_by_its_key(tmp_path: Path, text: str, problem: str) -> None:
    write(tmp_path, "m", text, a_bsdf="Source  Measured\n")
    assert re.search(problem, catalogue.load(tmp_path).failures["m"])


def test_a_table_in_no_known_format_is_found_by_the_check(tmp_path: Path) -> None:
    write(tmp_path, "m", "table: {file: a.bsdf}\n", a_bsdf="anything\n")
    with pytest.raises(InputError, match=r"no format has such files.*table\.format"):
        catalogue.check_formats(catalogue.load(tmp_path)["m"])


def test_a_wrong_geometry_in_the_description_is_found_by_the_check(tmp_path: Path) -> None:
    colours = ", ".join(f"{{geometry: '{name}', lab: [20, 0, 0]}}" for name in ("45as15", "45as45", "45az75"))
    write(tmp_path, "m", f"multiangle: {{colours: [{colours}], illuminant: D65, observer: 10}}\n")
    with pytest.raises(InputError, match="entry 3: geometry '45az75': unknown geometry"):
        catalogue.check_formats(catalogue.load(tmp_path)["m"])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("measured: {gloss: {60: many}}", r"measured\.gloss\.60: not an accepted value; found 'many'"),
        ("measured: {gloss: {45: 10}}", r"measured\.gloss: unknown key '45'.*; accepted: 20, 60, 85"),
        ("measured: {gloss: {}}", "no gloss reading; accepted: at least one of `20`, `60`, `85`"),
        (
            "surface: {distribution: measured-gloss}\nindex: 1.5",
            r"surface\.distribution: the gloss readings are missing",
        ),
        (
            "surface: {distribution: measured-gloss}\nindex: 1.5\nmeasured: {gloss: {60: 1}}",
            r"one gloss reading alone; found 'measured-gloss'; accepted: `measured\.gloss` at two or three",
        ),
        (
            "surface: {distribution: measured-gloss}\nindex: 1.5\nmeasured: {gloss: {20: 1, 60: 1}}\nmodel: {optics: wave}",
            "needs a roughness spectrum",
        ),
        ("surface: {distribution: measured-gloss, slopes: phong}\nindex: 1.5", r"surface\.slopes: .*found 'phong'"),
        ("measured: {instrument: x}", "no reading; accepted: at least one of `gloss`"),
        ("measured: {gloss: {60: 1}, uncertainty: {gloss: 0}}", "found 0; accepted: .* above 0"),
        ("measured: {gloss: {60: 1}, date: May}", r"measured\.date: not an accepted value"),
        ("measured: {lab: [{geometry: '45az75', lab: [1, 1, 1]}]}", r"measured\.lab\.0\.geometry: .*unknown geometry"),
        (
            "measured: {lab: [{geometry: 'd:8', lab: [1, 1, 1]}]}",
            r"measured\.lab\.0\.geometry: .*of spheres: 8:total \(specular included\), 8:sce \(excluded\)",
        ),
        ("measured: {lab: [{geometry: '45:0', lab: [1, 1, 1], illuminant: D56}]}", "unknown illuminant 'D56'"),
        (
            "measured: {lab: [{geometry: '8:sce', lab: [101, 1, 1]}]}",
            r"measured\.lab\.0\.lab: invalid colour.*L\* <= 100",
        ),
        (
            "measured: {lab: [{geometry: '8:total', lab: [101, 1, 1]}]}",
            r"measured\.lab\.0\.lab: invalid colour.*L\* <= 100",
        ),
    ],
)
def test_a_wrong_reading_is_refused_by_its_key(tmp_path: Path, text: str, problem: str) -> None:
    folder = write(tmp_path, "m", COLOUR + text)
    with pytest.raises(InputError, match=problem):
        catalogue.check_formats(catalogue.load_material(folder, catalogue.load_config()))


def test_a_colour_without_the_specular_is_a_reading_and_a_highlight_may_be_brighter_than_white(tmp_path: Path) -> None:
    lab = "{geometry: '8:sce', lab: [26, 0, 0]}, {geometry: '45as15', lab: [130, 0, 0]}"
    folder = write(tmp_path, "m", f"{COLOUR}measured: {{lab: [{lab}]}}")
    catalogue.check_formats(catalogue.load_material(folder, catalogue.load_config()))


@pytest.mark.parametrize(
    ("front", "body", "problem"),
    [
        ("measured-gloss", "slab: {thickness: 2}", "has gloss from both faces"),
        ("flat", "slab: {thickness: 2, back: {distribution: measured-gloss}}", "back.distribution: the other face"),
        ("measured-gloss", "coat: {thickness: 2, base: {index: 1.5}}", "has gloss from both faces"),
        (
            "flat",
            "coat: {thickness: 2, base: {index: 1.5, surface: {distribution: measured-gloss}}}",
            "coat.base.surface.distribution: the other face",
        ),
    ],
)
def test_a_body_with_two_faces_is_not_known_by_its_gloss(tmp_path: Path, front: str, body: str, problem: str) -> None:
    text = f"surface: {{distribution: {front}}}\nindex: 1.5\n{body}\nmeasured: {{gloss: {{20: 1, 60: 1}}}}\n"
    with pytest.raises(InputError, match=problem):
        catalogue.load_material(write(tmp_path, "m", text), catalogue.load_config())


def test_a_finish_known_by_gloss_has_facets_of_its_own_and_all_reflections(tmp_path: Path) -> None:
    write(
        tmp_path,
        "m",
        FRONT.replace("flat", "measured-gloss")
        + COLOUR
        + "measured: {gloss: {20: 3, 60: 22.4}, uncertainty: {gloss: 2}}\n",
    )
    loaded = catalogue.load(tmp_path)
    subject = Subject(loaded["m"], loaded.config)
    assert (STAGES["facets"].jobs(subject), STAGES["gloss_facets"].jobs(subject)) == ([], [{}])
    assert loaded.spec("m", "gloss_facets") == {"gloss": {"20": 3, "60": 22.4}, "gloss_u": 2, "slopes": "any"}
    assert loaded.spec("m", "predicted")["multiple_scattering"] == "directional"
    assert loaded.spec("m", "readings")["fitted"] == ["gloss 20°", "gloss 60°"]


def test_a_reading_has_a_geometry_a_day_and_default_uncertainties(tmp_path: Path) -> None:
    text = "measured: {gloss: {20: 3, 60: 22.4}, lab: [{geometry: '45:0', lab: [1, 2, 3]}], date: 2026-01-31}\n"
    content = catalogue.load_material(write(tmp_path, "m", COLOUR + text), catalogue.load_config()).content["measured"]
    assert content["gloss"] == {"20": 3, "60": 22.4}
    assert content["date"] == "2026-01-31"
    assert content["lab"] == [{"geometry": "45:0", "lab": [1, 2, 3], "illuminant": "D65", "observer": 10}]
    assert content["uncertainty"] == {"reflectance_haze": 1.0, "lab": 0.5, "transmittance": 0.005}


def test_a_configuration_may_say_only_what_differs(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("illuminant: A\n")
    config = catalogue.load_config(own)
    assert config == {**catalogue.load_config(), "illuminant": "A"}


@pytest.mark.parametrize(
    ("text", "part", "said"),
    [
        ("table: {refine: false}", "table", {"refine": False}),
        ("appearance: {geometries: [MA-T6]}", "appearance", {"geometries": ["MA-T6"]}),
        ("appearance: {haze: []}", "appearance", {"haze": []}),
        ("table: {phi_i: [0, 90]}", "table", {"phi_i": [0, 90]}),
        ("lambert_gauss: {}", "lambert_gauss", {}),
        ("comparison: {index_u: 0}", "comparison", {"index_u": 0}),
    ],
)
def test_a_configuration_may_say_only_what_differs_within_a_part(
    tmp_path: Path, text: str, part: str, said: dict[str, Any]
) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(text)
    common = catalogue.load_config()
    assert catalogue.load_config(own) == {**common, part: {**common[part], **said}}


def test_the_projects_own_configuration_states_every_key() -> None:
    config = catalogue.load_config()
    assert set(config) == set(Config.declared_keys())
    for key, value in config.items():
        if isinstance(value, dict):
            assert set(value) == set(reading.keys_of(Config.declared_keys()[key].annotation)), key


def test_a_comparison_has_the_uncertainties_of_its_inputs_as_parameters(tmp_path: Path) -> None:
    write(tmp_path / "of", "m")
    own = tmp_path / "own.yaml"
    own.write_text("comparison: {slope_u: 0.3}\n")
    parameters = catalogue.load(tmp_path / "of", catalogue.load_config(own)).spec("m", "comparison")
    assert parameters == {**{f"{name}_u": u for name, u in PRIOR_U.items()}, "slope_u": 0.3}


@pytest.mark.parametrize("u", ["-0.1", "2", "wide"])
def test_an_uncertainty_of_an_input_that_is_none_is_refused(tmp_path: Path, u: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(f"comparison: {{diffuse_u: {u}}}\n")
    with pytest.raises(InputError, match=r"comparison\.diffuse_u"):
        catalogue.load_config(own)


@pytest.mark.parametrize(
    ("window", "problem"),
    [
        ("{angle: 20, offset: 0.5, aperture: [1.8, 3.6]}", "covers part of the source's image"),
        ("{angle: 85, offset: 5, aperture: [1.8, 3.6]}", "extends below the surface"),
    ],
)
def test_a_haze_window_that_cannot_be_is_refused_by_file_and_key(tmp_path: Path, window: str, problem: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(f"appearance: {{haze: [{{angle: 20, offset: 1.9, aperture: [1.8, 3.6]}}, {window}]}}\n")
    with pytest.raises(InputError, match=rf"own\.yaml, appearance\.haze\.1: .*{problem}"):
        catalogue.load_config(own)


@pytest.mark.parametrize(
    ("route", "predicted"), [("", True), ("multiangle", False), ("surface", True), ("multiangle surface", True)]
)
def test_a_spectrum_beside_another_route_is_no_perfect_diffuser(tmp_path: Path, route: str, predicted: bool) -> None:
    colours = ", ".join(f"{{geometry: '{name}', lab: [20, 0, 0]}}" for name in ("45as15", "45as45", "45as110"))
    texts = {"multiangle": f"multiangle: {{colours: [{colours}], illuminant: D65, observer: 10}}\n", "surface": FRONT}
    write(tmp_path, "m", COLOUR + "".join(texts[part] for part in route.split()))
    assert catalogue.load(tmp_path)["m"].has("predicted") is predicted


@pytest.mark.parametrize(
    ("index", "accepted"),
    [("{n: 1.2}", "accepted: `index: 1.2` of"), ("{n: 0.2}", "accepted: `index: {n: 0.2, k: …}` of a metal")],
)
def test_an_index_without_k_is_answered_with_its_own_number(tmp_path: Path, index: str, accepted: str) -> None:
    write(tmp_path, "m", FRONT.replace("PP", index))
    assert accepted in catalogue.load(tmp_path).failures["m"]


@pytest.mark.parametrize("said", ["seed: 3", "method: basis4, seed: 3", "method: lhtss, threshold: 1"])
def test_what_a_search_alone_needs_is_refused_elsewhere(tmp_path: Path, said: str) -> None:
    write(tmp_path, "m", COLOUR.replace("geometry", f"{said}, geometry"))
    key = said.split(", ")[-1].split(":")[0]
    assert f"line 1, spectrum.{key}: no effect, because `method: " in (why := catalogue.load(tmp_path).failures["m"])
    assert f"accepted: `{key}` with `method: random4` or `adaptive4`" in why


def test_a_search_has_its_seed_and_threshold(tmp_path: Path) -> None:
    write(tmp_path, "m", COLOUR.replace("geometry", "method: random4, seed: 3, threshold: 2, geometry"))
    assert catalogue.load(tmp_path).failures == {}


def test_a_wrong_configuration_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("gloss_angle: [20]\n")
    with pytest.raises(InputError, match="did you mean 'gloss_angles'"):
        catalogue.load_config(own)


def test_formats_are_checked_without_reading(tmp_path: Path) -> None:
    write(tmp_path, "a", "surface: {file: a.abc}\nindex: PP", a_abc="x")
    write(tmp_path, "b", "surface: {file: a.txt, unit: um, pitch: 1}\nindex: PPP", a_txt="x")
    write(tmp_path, "c", "spectrum: {file: a.txt, geometry: sci}", a_txt="")
    loaded = catalogue.load(tmp_path)
    assert loaded.failures == {}
    for name, pattern in (("a", "found .abc"), ("b", "PPP"), ("c", "empty")):
        with pytest.raises(InputError, match=pattern):
            catalogue.check_formats(loaded[name])


def test_a_new_material_asks_to_be_filled_in_and_each_alternative_in_its_comments_is_valid(tmp_path: Path) -> None:
    path = catalogue.start_material(tmp_path, "fresh")
    assert "at least one of `surface`, `spectrum`" in catalogue.load(tmp_path).failures["fresh"]
    text = path.read_text()
    for file in ("reflectance.txt", "surface.x3p", "surface-2.x3p", "profile.txt", "index.txt", "absorption.txt"):
        (path.parent / file).touch()
    blocks = re.findall(r"(?m)^# (?:surface|index|spectrum|slab|measured|model|exports):.*\n(?:#   .*\n)*", text)
    assert len(blocks) == 19
    front = "surface: {distribution: flat}\nindex: PP\n"
    gloss = "measured: {gloss: {20: 3.1, 60: 22.4}}\n"
    rest = {"spectrum": "", "surface": COLOUR + gloss + "index: PP\n", "slab": front}
    for block in blocks:
        key, plain = block[2:].partition(":")[0], re.sub(r"(?m)^# ", "", block)
        path.write_text(rest.get(key, COLOUR) + plain)
        assert catalogue.load(tmp_path).failures == {}, block


def test_a_material_is_never_started_twice(tmp_path: Path) -> None:
    catalogue.start_material(tmp_path, "m")
    with pytest.raises(catalogue.CatalogueError, match="already exists"):
        catalogue.start_material(tmp_path, "m")


def test_a_material_is_started_beside_raw_files(tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "scan.x3p").touch()
    assert catalogue.start_material(tmp_path, "m") == tmp_path / "m" / "material.yaml"


def test_a_folder_with_an_undecodable_name_stops_no_material(tmp_path: Path) -> None:
    bad = Path(os.fsdecode(os.fsencode(tmp_path) + b"/b\xffd"))
    try:
        bad.mkdir()
    except OSError:
        pytest.skip("this file system takes no such name")
    (bad / "material.yaml").write_text("surprise: 1\n")
    loaded = catalogue.load(tmp_path)
    (name,) = loaded.failures
    assert name.encode("utf-8")
    assert loaded.failures[name].encode("utf-8")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("lambert_gauss: {theta_i: [30, 10]}", "lambert_gauss.theta_i"),
        ("table: {theta_i: [10, 0], theta_o: [0, 80], phi_o: [0, 180], refine: true}", "table.theta_i"),
        ("table: {theta_i: [0, 10], theta_o: [0, 80], phi_o: [0, 90], refine: true}", "table.phi_o"),
    ],
)
def test_angles_that_would_fail_every_material_are_refused_once(tmp_path: Path, text: str, where: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(text + "\n")
    with pytest.raises(InputError, match=re.escape(where)):
        catalogue.load_config(own)


def test_every_key_of_a_scan_names_the_stage_that_reads_it() -> None:
    surface = material_keys.MeasuredSurface
    assert {*surface.read_by("surface"), *surface.read_by("facets"), "scans"} == set(surface.declared_keys())


def test_a_missing_further_scan_is_named(tmp_path: Path) -> None:
    write(tmp_path, "m", "surface: {file: a.x3p, scans: [{file: b.x3p}]}\nindex: PP\n", a_x3p="x")
    assert "surface.scans" in catalogue.load(tmp_path).failures["m"]


COATED = "surface: {distribution: flat}\nindex: 1.5\n"
RED = "spectrum: {lab: [48, 34, 22], illuminant: D65, observer: 10, geometry: sci}\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("index: 1.5\ncoat: {thickness: 1, base: {index: 1.5}}\n" + RED, "the key 'surface' is missing"),
        (COATED + "coat: {thickness: 1}\n" + RED, "coat: the key 'base' is missing"),
        (COATED + "coat: {base: {index: 1.5}}\n" + RED, "coat: the key 'thickness' is missing"),
        (COATED + "coat: {thickness: 1, base: {index: {n: 1.2}}}\n", "coat.base.index: the key 'k' is missing"),
        (
            COATED + "coat: {thickness: 1, base: {index: {n: 1.2, k: 7}}}\n" + RED,
            "spectrum: a metal sends back no light",
        ),
        (COATED + "coat: {thickness: 1, base: {index: 1.5}}\nslab: {thickness: 1}\n", "exclude each other"),
        (COATED + "coat: {thickness: 1, base: {index: 1.5}}\nmodel: {optics: wave}\n" + RED, "model.optics"),
        (
            COATED + "coat: {thickness: 1, base: {index: 1.5}}\nmodel: {masking: liu}\n" + RED,
            "a coat needs one of Smith's",
        ),
        (
            COATED + "coat: {thickness: 1, base: {index: 1.5}}\nmodel: {diffuse: none}\n" + RED,
            "a diffuse part of its own",
        ),
        (
            COATED + "coat: {thickness: 1, absorption: 1, internal_transmittance: 1, base: {index: 1.5}}\n",
            "exclude each other",
        ),
        (
            "surface: {distribution: flat}\nindex: {n: 1.2, k: 7}\ncoat: {thickness: 1, base: {index: 1.5}}\n",
            "the coat would be opaque",
        ),
    ],
)
def test_what_contradicts_a_coat_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        catalogue.load_material(write(tmp_path, "m", text), catalogue.load_config())


def test_files_of_a_coat_are_checked_and_named_by_their_keys(tmp_path: Path) -> None:
    base = "base: {index: {file: n.txt}, surface: {file: b.txt, unit: um, pitch: 1}}"
    folder = write(tmp_path, "m", COATED + f"coat: {{thickness: 0.1, absorption: {{file: a.txt}}, {base}}}\n" + RED)
    for name in ("n.txt", "b.txt", "a.txt"):
        (folder / name).write_text("400 1.5\n500 1.5\n")
    loaded = catalogue.load(tmp_path)
    assert {part: path.name for part, path in loaded["m"].files.items()} == {
        "base_surface": "b.txt",
        "base_index": "n.txt",
        "interior": "a.txt",
    }
    for part, key in (("base_index", "coat.base.index.file"), ("interior", "coat.absorption.file")):
        kept = dataclasses.replace(loaded["m"], files={part: loaded["m"].files[part]})
        with pytest.raises(InputError, match=f"set `{key}`"):
            describe_files(loaded, kept)
    kept = dataclasses.replace(loaded["m"], files={"base_surface": folder / "b.txt"})
    with pytest.raises(InputError, match=r"set `coat\.base\.surface"):
        describe_files(loaded, kept)


@pytest.mark.parametrize(("former", "instead"), [("true", "`isotropic: true`"), ("false", "`isotropic: false`")])
def test_the_former_key_of_symmetry_is_refused_with_what_to_write_instead(
    tmp_path: Path, former: str, instead: str
) -> None:
    smoothing = f"smoothing: {{symmetric: {former}}}"
    folder = write(tmp_path, "m", f"rig: {{run: run, calibration: bench, {smoothing}}}\n")
    with pytest.raises(InputError, match=rf"rig\.smoothing\.symmetric: `symmetric` was split.*{instead}"):
        catalogue.load_material(folder, catalogue.load_config())


RECOVERED = "spectrum: {{lab: {lab}, illuminant: D65, observer: 10, geometry: {geometry}{more}}}\n"
FLAKES = "multiangle: {{colours: [{colours}], illuminant: D65, observer: 10, form: {form}}}\n"


def flakes_of(form: str = "exponential", **lightness: float) -> str:
    colours = ", ".join(f"{{geometry: {name}, lab: [{value}, 0, 0]}}" for name, value in lightness.items())
    return FLAKES.format(colours=colours, form=form)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (RECOVERED.format(lab=[90, 100, 100], geometry="sce", more=""), "impossible colour: no reflectance has it"),
        (
            "surface: {distribution: flat}\nindex: 1.5\n" + RECOVERED.format(lab=[3, 0, 0], geometry="sci", more=""),
            r"every spectrum of this colour falls below 0\.0400",
        ),
        (RECOVERED.format(lab=[60, 80, 60], geometry="sce", more=", method: random4"), "no mixture of the four"),
        (RECOVERED.format(lab=[60, 0, 0], geometry="sci", more=", specular_trap: 5"), "a gloss trap needs"),
        (flakes_of(as15=30, as45=20, as110=5, form="double-exponential"), "too few different flake angles"),
        (flakes_of(as15=5, as45=20, as110=30), "A of the fit is out of range"),
    ],
)
def test_check_refuses_what_the_build_refuses_for_its_description(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "material.yaml").write_text(text)
    with pytest.raises(InputError, match=problem):
        catalogue.check_formats(catalogue.load(tmp_path)["m"])


@pytest.mark.parametrize("method", ["lhtss", "basis4", "random4"])
def test_check_accepts_a_colour_that_the_build_accepts(tmp_path: Path, method: str) -> None:
    (tmp_path / "m").mkdir()
    more = f", method: {method}, reflectance_uncertainty: 0.01, incidence: 8"
    more += ", seed: 3, threshold: 2" if method == "random4" else ""
    (tmp_path / "m" / "material.yaml").write_text(RECOVERED.format(lab=[50, 5, 5], geometry="sci", more=more))
    catalogue.check_formats(catalogue.load(tmp_path)["m"])

"""Textures in a build: which materials and scenes have them, and the examples."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from brdfpipe import store
from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.format_checks import check_formats
from brdfpipe.catalogue.raw_reading import describe_files
from brdfpipe.errors import InputError
from brdfpipe.jobs.build import build
from brdfpipe.scenes.scene import Scene, load_scene
from brdfpipe.stages import STAGES, Subject

EXAMPLES = Path(__file__).parents[2] / "examples"
STAGES_OF_TEXTURES = {"texture", "unresolved", "picture_texture", "texture_preview"}


@pytest.fixture(scope="module")
def catalogue():
    return load(EXAMPLES)


def stages_of(catalogue, name, scene):
    subject = Subject(catalogue[name], catalogue.config, (), scene)
    return {name for name in STAGES_OF_TEXTURES if STAGES[name].jobs(subject)}


def test_a_texture_is_computed_where_a_material_has_the_key_and_the_scene_asks_for_it(catalogue):
    for name in ("catalogue", "metrology-full"):
        assert stages_of(catalogue, "leather-texture", load_scene(name)) == {"texture", "unresolved", "texture_preview"}
        assert stages_of(catalogue, "sparkling-texture", load_scene(name)) == {"picture_texture", "texture_preview"}
        assert stages_of(catalogue, "abs-grain", load_scene(name)) == set()
    for name in ("gloss-sheet", "render-preview", "luminaire-raytrace"):
        assert stages_of(catalogue, "leather-texture", load_scene(name)) == set()
        assert stages_of(catalogue, "sparkling-texture", load_scene(name)) == set()


def test_the_distance_of_a_scene_is_a_parameter_of_the_texture(catalogue):
    content = {**load_scene("catalogue").content, "viewing_distance": 0.7}
    subject = Subject(catalogue["leather-texture"], catalogue.config, (), Scene("mine", content))
    assert STAGES["texture"].parameters(subject)["distance"] == 0.7
    assert STAGES["texture_preview"].parameters(subject)["distance"] == 0.7
    assert STAGES["unresolved"].parameters(subject) == {"formats": []}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("surface: {distribution: beckmann, slope_rms: 0.1}\nindex: 1.5\ntexture: {pixel: 4}", "no `surface.file`"),
        ("spectrum: {lab: [50, 0, 0], geometry: sci}\ntexture: {pixel: 4}", "no `surface.file`"),
        ("spectrum: {lab: [50, 0, 0], geometry: sci}\ntexture: {size: 64}", "pixel"),
        (
            "spectrum: {lab: [50, 0, 0], geometry: sci}\ntexture: {pictures: [{file: a.png, geometry: 45as15}, {file: a.png, geometry: 45as15}], pixel: 4}",
            "two pictures",
        ),
        ("spectrum: {lab: [50, 0, 0], geometry: sci}\ntexture: {file: a.png, pixel: 4}", "accepted: pictures, pixel"),
    ],
)
def test_a_texture_without_what_it_is_made_of_is_refused(tmp_path, keys, words):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "material.yaml").write_text(
        keys.replace("lab: [50, 0, 0],", "lab: [50, 0, 0], illuminant: D65, observer: 10,")
    )
    (tmp_path / "a" / "a.png").write_bytes((EXAMPLES / "sparkling-texture" / "diffuse.png").read_bytes())
    assert words in load(tmp_path).failures["a"]


def test_check_reads_the_pictures(catalogue):
    lines = describe_files(catalogue, catalogue["sparkling-texture"])
    assert [line.partition(", light")[0] for line in lines] == [
        f"{name}.png: picture of 192 × 192 pixels, 3.84 × 3.84 mm of the sample, grey of 16 bits, linear"
        for name in ("45as15", "45as45", "diffuse")
    ]


@pytest.mark.parametrize(
    ("geometry", "words"),
    [("45a15", "accepted: diffuse, or as 45as15"), ("diffuze", "accepted: diffuse"), ("45as140", "not above")],
)
def test_a_geometry_that_is_misspelt_is_refused_without_reading_the_picture(tmp_path, geometry, words):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "material.yaml").write_text(
        f"spectrum: {{lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}}\ntexture: {{pictures: [{{file: a.png, geometry: '{geometry}'}}], pixel: 4}}"
    )
    (tmp_path / "a" / "a.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=words):
        check_formats(load(tmp_path)["a"])


@pytest.mark.parametrize("pixel", [0.5, 100])
def test_check_refuses_a_pixel_that_the_scan_cannot_have(tmp_path, pixel):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "material.yaml").write_text(
        f"surface: {{file: a.npy, unit: um, pitch: 1}}\nindex: 1.5\ntexture: {{pixel: {pixel}}}"
    )
    np.save(tmp_path / "a" / "a.npy", np.random.default_rng(1).normal(scale=0.1, size=(64, 64)))
    catalogue = load(tmp_path)
    with pytest.raises(InputError, match=r"set `texture\.pixel`"):
        describe_files(catalogue, catalogue["a"])


@pytest.mark.slow
def test_the_examples_are_built_with_their_textures(tmp_path):
    for name in ("leather-texture", "sparkling-texture"):
        shutil.copytree(EXAMPLES / name, tmp_path / "catalogue" / name)
    summary = build(tmp_path / "catalogue", tmp_path / "results", cores=1)
    assert summary.failures == {}
    grain = store.open_dataset(tmp_path / "results" / "leather-texture" / "unresolved.nc", "bsdf")
    assert grain.attrs["mean_difference"] < 0.05
    paint = store.open_dataset(tmp_path / "results" / "sparkling-texture" / "picture_texture.nc", "texture")
    assert paint["spectrum_difference"].max() < 0.05
    for name in ("leather-texture", "sparkling-texture"):
        page = (tmp_path / "results" / name / "report.html").read_text(encoding="utf-8")
        assert "Visible structure" in page
        assert "Under a spot at 45as15, from 0.5 m" in page
        assert "In diffuse light, from 0.5 m" in page

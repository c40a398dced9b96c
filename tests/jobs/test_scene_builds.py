"""Builds for scenes: what each computes, shares and marks; with stages of a few lines."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe.jobs import failures
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.cleanup import STALE
from brdfpipe.jobs.summary import Summary
from brdfpipe.scenes.scene import load_scene

Write = Callable[..., Path]

SCENE = """\
purpose: a test
domain: {hemisphere: {}}
results: [checks]
metric: rendering
tolerance: 1
"""


@pytest.fixture
def results(tmp_path: Path, project: Path) -> Path:
    return tmp_path / "results"


def build(folder: Path, results: Path, scene: str | None = None, dry_run: bool = False) -> Summary:
    return build_catalogue(folder, results, cores=2, scene=scene, dry_run=dry_run)


def files(folder: Path) -> set[str]:
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file()
        and path.relative_to(folder).parts[0] not in ("logs", ".snakemake", ".build.lock", ".index.jsonl", "scenes")
    }


def of_catalogue(results: Path) -> dict[str, object]:
    """The parameters that the fake catalogue stage received."""
    return dict(json.loads((results / "catalogue.csv").read_text()))


def test_a_scene_computes_only_what_it_asks_for(folder: Path, results: Path) -> None:
    summary = build(folder, results, "gloss-sheet")
    assert (summary.built, summary.failures) == (("first", "second"), {})
    assert summary.page == results / "scenes" / "gloss-sheet" / "index.html"
    of_scene = files(results / "scenes" / "gloss-sheet")
    pages = {"catalogue.nc", "catalogue.csv", "catalogue.lock.json", "index.html"}
    assert of_scene == pages | {
        f"{name}/{part}.nc" for name in ("first", "second") for part in ("appearance", "summary")
    }
    shared = {Path(name).stem for name in files(results)}
    assert {"surface", "predicted", "wave", "nominal_bsdf"} <= shared
    assert not {"bsdf", "model_error", "uncertainty", "checks", "table", "index.html"} & shared
    assert (results / "logs" / "scenes" / "gloss-sheet" / "first" / "appearance.log").exists()
    assert (results / "logs" / "first" / "surface.log").exists()
    assert build(folder, results, "gloss-sheet").jobs == 0


def test_a_second_scene_computes_nothing_that_is_shared_again(folder: Path, results: Path) -> None:
    build(folder, results, "gloss-sheet")
    before = {path: path.stat().st_mtime_ns for path in results.glob("*/*.nc")}
    summary = build(folder, results, "render-preview")
    assert summary.jobs == 5  # picture and row of two materials, and the catalogue
    assert {path: path.stat().st_mtime_ns for path in results.glob("*/*.nc")} == before
    assert of_catalogue(results / "scenes" / "render-preview")["others"] == [
        ["gloss-sheet", "../../scenes/gloss-sheet/index.html"]
    ]


def test_the_default_scene_is_the_same_after_another_one(folder: Path, results: Path, tmp_path: Path) -> None:
    build(folder, results)
    before = {name: (results / name).read_bytes() for name in files(results)}
    build(folder, results, "gloss-sheet")
    assert build(folder, results).jobs == 1  # the catalogue: its page names the other scene
    after = {name: (results / name).read_bytes() for name in files(results)}
    changed = {name for name in before if after[name] != before[name]}
    assert changed == {"catalogue.nc", "catalogue.csv", "catalogue.lock.json", "index.html"}  # of fake stages
    assert after.keys() - before.keys() == {"first/nominal_bsdf.nc", "second/nominal_bsdf.nc"}
    assert of_catalogue(results)["others"] == [["gloss-sheet", "scenes/gloss-sheet/index.html"]]
    assert build(folder, results).jobs == 0


def test_a_model_is_planned_unless_the_material_has_keys_of_the_model(
    folder: Path, results: Path, project: Path
) -> None:
    experience = project / "config" / "scenes" / "experience" / "gloss-sheet.json"
    experience.parent.mkdir()
    head = json.dumps({"scene": load_scene("gloss-sheet").errors_of})[:-1] + ', "parameters": {\n'
    experience.write_text(f"{head}errors")
    with (folder / "second" / "material.yaml").open("a") as description:
        description.write("model: {optics: facets}\n")
    build(folder, results, "gloss-sheet")
    place = results / "scenes" / "gloss-sheet"
    assert {path.name for path in (place / "first").iterdir()} == {
        "plan.nc",
        "planned.nc",
        "appearance.nc",
        "summary.nc",
    }
    assert {path.name for path in (place / "second").iterdir()} == {"appearance.nc", "summary.nc"}
    assert {"second/predicted.nc", "second/nominal_bsdf.nc"} <= files(results)
    assert not {"first/predicted.nc", "first/wave.nc", "first/nominal_bsdf.nc"} & files(results)
    assert build(folder, results, "gloss-sheet").jobs == 0
    mine = results.parent / "mine.yaml"
    mine.write_text(SCENE.replace("[checks]", "[gloss]").replace("metric: rendering", "metric: gloss"))
    build(folder, results, str(mine))
    assert (results / "scenes" / "mine" / "first" / "plan.nc").exists(), "a scene of one's own has the same errors"
    experience.write_text(f"{head}other errors")
    assert build(folder, results, "gloss-sheet").jobs > 0


def test_a_scene_of_a_file_is_used_and_its_edit_reruns_what_it_changes(
    folder: Path, results: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text(SCENE)
    build(folder, results, str(scene))
    place = results / "scenes" / "mine"
    assert (place / "first" / "checks.nc").exists()
    assert not (place / "first" / "report.html").exists()
    scene.write_text(SCENE.replace("[checks]", "[checks, page]"))
    assert build(folder, results, str(scene)).jobs == 3  # two pages, and the catalogue that links to them
    assert (place / "first" / "report.html").exists()


def test_a_material_of_its_own_scene_is_in_the_catalogue_of_that_scene(folder: Path, results: Path) -> None:
    build(folder, results)
    with (folder / "second" / "material.yaml").open("a") as description:
        description.write("scene: gloss-sheet\n")
    summary = build(folder, results)
    assert summary.failures == {}
    assert (results / "scenes" / "gloss-sheet" / "second" / "summary.nc").exists()
    assert not (results / "scenes" / "gloss-sheet" / "first").exists()
    assert of_catalogue(results)["others"] == [["gloss-sheet", "scenes/gloss-sheet/index.html"]]
    assert "its scene is gloss-sheet now" in (results / "second" / STALE).read_text()
    assert build(folder, results).jobs == 0


def test_failures_are_listed_in_the_catalogue_of_their_scene(folder: Path, results: Path, write: Write) -> None:
    write(folder, "bad", raw="refuse")
    with (folder / "bad" / "material.yaml").open("a") as description:
        description.write("scene: gloss-sheet\n")
    summary = build(folder, results)
    assert summary.failures == {"bad": "surface: raw.txt: not fit to use; found refuse"}
    assert of_catalogue(results)["failures"] == {}
    assert list(of_catalogue(results / "scenes" / "gloss-sheet")["failures"]) == ["bad"]  # type: ignore[call-overload]


def test_a_file_of_a_scene_that_cannot_be_replaced_is_named_with_its_scene() -> None:
    errors = ["[Errno 13] Permission denied: '/r/scenes/gloss-sheet/first/appearance.nc'"]
    (message,) = (entry["message"] for entry in failures.of_unwritable_files(errors, {"first"}).values())
    assert message.startswith("scenes/gloss-sheet/first/appearance.nc: cannot be replaced")


def test_results_of_a_scene_that_is_not_built_are_left_alone_unless_the_material_left(
    folder: Path, results: Path, write: Write
) -> None:
    build(folder, results)
    build(folder, results, "metrology-full")
    write(folder, "first", raw="refuse")
    build(folder, results, "metrology-full")
    place = results / "scenes" / "metrology-full" / "first"
    assert "cannot be built now" in (place / STALE).read_text()
    assert not (results / "first" / STALE).exists()
    for path in (folder / "first").iterdir():
        path.unlink()
    (folder / "first").rmdir()
    build(folder, results)
    assert "no material of this name" in (place / STALE).read_text()
    assert "no material of this name" in (results / "first" / STALE).read_text()

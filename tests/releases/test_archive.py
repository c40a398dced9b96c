"""A release holds all that it names, is the same whenever it is written, and every damage to it is found."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from brdfpipe.catalogue.catalogue import load
from brdfpipe.descriptions import reading
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.jobs.cleanup import STALE
from brdfpipe.releases.archive import write_archive
from brdfpipe.releases.metadata import METADATA
from brdfpipe.releases.release_keys import Release
from brdfpipe.releases.verification import verify_archive
from brdfpipe.scenes.scene import shipped_scenes

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"

STATED: dict[str, Any] = {
    "title": "Plastics",
    "description": "One black plastic.",
    "creators": [{"name": "Doe, Jane", "orcid": "https://orcid.org/0000-0002-1825-0097"}, {"name": "A laboratory"}],
    "publisher": "A laboratory",
    "date": "2026-01-31",
    "license": "https://creativecommons.org/licenses/by/4.0/",
    "keywords": ["BRDF", "gloss"],
}

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path, release: Callable[..., Path], plastic: Callable[..., dict[str, xr.Dataset]]) -> Write:
    """Writes the release of a catalogue of one material with a raw file."""
    (tmp_path / "catalogue" / "black").mkdir(parents=True)
    (tmp_path / "catalogue" / "black" / "material.yaml").write_text(f"description: black\n{COLOUR}")
    (tmp_path / "catalogue" / "black" / "grün.txt").write_text("1 2")
    results = release("results", {"black": plastic()})
    (results / "index.html").write_text("<html>")
    for hidden in (".snakemake/log", "logs/build.log", ".build.lock"):
        (results / hidden).parent.mkdir(exist_ok=True)
        (results / hidden).write_text("not of the release")

    def written(name: str) -> Path:
        write_archive(load(tmp_path / "catalogue"), results, STATED, None, tmp_path / name)
        return tmp_path / name

    return written


def changed(source: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """A copy of an archive with other entries."""
    with zipfile.ZipFile(source) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    change(entries)
    target = source.with_name("changed.zip")
    with zipfile.ZipFile(target, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return target


def test_a_release_is_whole_and_has_the_same_bytes_at_another_time(write: Write, tmp_path: Path) -> None:
    first = write("one.zip")
    os.utime(tmp_path / "catalogue" / "black" / "material.yaml", (0, 1e9))
    assert write("two.zip").read_bytes() == first.read_bytes()
    assert verify_archive(first) == []


def test_inputs_results_configuration_and_versions_are_in_it_and_nothing_else(write: Write) -> None:
    with zipfile.ZipFile(write("one.zip")) as archive:
        names = set(archive.namelist())
    assert {"inputs/black/grün.txt", "inputs/black/material.yaml", "results/black/bsdf.nc"} <= names
    assert {"results/catalogue.lock.json", "software/config.yaml", "README.txt", METADATA} <= names
    assert not [name for name in names if "log" in name.split("/") or "/." in name or "lock" in name.split("/")]


def test_the_metadata_follow_ro_crate_and_name_every_file_once(write: Write) -> None:
    with zipfile.ZipFile(write("one.zip")) as archive:
        graph = {entity["@id"]: entity for entity in json.loads(archive.read(METADATA))["@graph"]}
        files = {name for name in archive.namelist() if name not in (METADATA, "README.txt")}
    assert graph[METADATA]["about"] == {"@id": "./"}
    root, black = graph["./"], graph["#material-black"]
    assert {"name", "description", "datePublished", "license", "creator", "publisher"} <= root.keys()
    assert black["description"] == "black"
    listed = [part["@id"] for part in (*root["hasPart"], *black["hasPart"]) if part["@id"] != "#material-black"]
    assert len(listed) == len(set(listed)) == len(files)
    references = [root["license"], root["publisher"], *root["creator"], *root["hasPart"], *black["hasPart"]]
    assert all(reference["@id"] in graph for reference in references)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda entries: entries.update({"results/index.html": b"<htmk>"}), "does not match its sha256"),
        (lambda entries: entries.update({"results/index.html": b"<html"}), "less than the 6 bytes"),
        (lambda entries: entries.update({"results/index.html": b"<html>" * 9}), "more than the 6 bytes"),
        (lambda entries: entries.pop("results/index.html"), "results/index.html: is missing"),
        (lambda entries: entries.update({"results/other.nc": b"1"}), "results/other.nc: is not in the metadata"),
    ],
)
def test_each_change_of_a_file_is_named(write: Write, change: Callable[[dict[str, bytes]], None], problem: str) -> None:
    (line,) = verify_archive(changed(write("one.zip"), change))
    assert problem in line
    assert line.startswith("results/")


@pytest.mark.parametrize("position", [0.1, 0.5, 0.9])
def test_a_flipped_byte_is_found(write: Write, position: float) -> None:
    path = write("one.zip")
    data = bytearray(path.read_bytes())
    data[int(position * len(data))] ^= 0x55
    path.write_bytes(data)
    try:
        found = bool(verify_archive(path))
    except BrdfpipeError:  # the directory of the archive itself is damaged
        found = True
    assert found


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"text"])
def test_what_is_no_release_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "one.zip").write_bytes(content)
    with pytest.raises(BrdfpipeError, match="no zip archive"):
        verify_archive(tmp_path / "one.zip")


def test_an_archive_without_metadata_is_refused(write: Write) -> None:
    with pytest.raises(BrdfpipeError, match="no release"):
        verify_archive(changed(write("one.zip"), lambda entries: entries.pop(METADATA)))


@pytest.mark.parametrize(
    "entity", [{}, {"contentSize": "1"}, {"contentSize": "one", "sha256": ""}, {"contentSize": None, "sha256": ""}]
)
def test_an_archive_with_damaged_metadata_is_refused(write: Write, entity: dict[str, Any]) -> None:
    graph = json.dumps({"@graph": [{"@id": "results/index.html", "@type": "File"} | entity]}).encode()
    with pytest.raises(BrdfpipeError, match="no release"):
        verify_archive(changed(write("one.zip"), lambda entries: entries.update({METADATA: graph})))


def test_nothing_is_written_where_a_material_fails_or_results_are_missing(write: Write, tmp_path: Path) -> None:
    (tmp_path / "catalogue" / "bad").mkdir()
    (tmp_path / "catalogue" / "bad" / "material.yaml").write_text("spectrum: [")
    with pytest.raises(BrdfpipeError, match="cannot be built: bad"):
        write("one.zip")
    shutil.rmtree(tmp_path / "results")
    with pytest.raises(BrdfpipeError, match="run `brdfpipe build` first"):
        write("one.zip")
    assert not (tmp_path / "one.zip").exists()


def test_links_are_not_followed(write: Write, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("swordfish")
    (tmp_path / "catalogue" / "black" / "link.txt").symlink_to(tmp_path / "secret")
    with zipfile.ZipFile(write("one.zip")) as archive:
        assert "inputs/black/link.txt" not in archive.namelist()


def test_scenes_of_ones_own_are_in_it(write: Write, tmp_path: Path) -> None:
    catalogue = tmp_path / "catalogue"
    shutil.copy(shipped_scenes()["gloss-sheet"], catalogue / "mine.yaml")
    with (catalogue / "black" / "material.yaml").open("a") as file:
        file.write("scene: ../mine.yaml\n")
    assert load(catalogue).failures == {}
    (tmp_path / "results" / "scenes" / "mine").mkdir(parents=True)
    for name in ("catalogue.csv", "catalogue.nc"):
        shutil.copy(tmp_path / "results" / name, tmp_path / "results" / "scenes" / "mine" / name)
    with zipfile.ZipFile(write("one.zip")) as archive:
        archive.extractall(tmp_path / "rebuilt")
    assert load(tmp_path / "rebuilt" / "inputs")["black"].scene == load(catalogue)["black"].scene


def test_a_raw_file_that_would_be_left_out_is_named(write: Write, tmp_path: Path) -> None:
    black = tmp_path / "catalogue" / "black"
    (black / "reflectance.txt").write_text("400 0.1\n700 0.1\n")
    (black / "link.txt").symlink_to("reflectance.txt")
    (black / "material.yaml").write_text("spectrum: {file: link.txt, geometry: sci}\n")
    with pytest.raises(BrdfpipeError, match=r"black/link\.txt: is a symbolic link"):
        write("one.zip")


def test_a_material_whose_stage_failed_is_named(write: Write, tmp_path: Path) -> None:
    (tmp_path / "catalogue" / "white").mkdir()
    (tmp_path / "catalogue" / "white" / "material.yaml").write_text(COLOUR)
    with pytest.raises(BrdfpipeError, match="cannot be built: white"):
        write("one.zip")


def test_results_of_an_earlier_state_are_left_out(write: Write, tmp_path: Path) -> None:
    for name in ("bsdf.nc", "exports/a.astm", STALE):
        path = tmp_path / "results" / "left" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    with zipfile.ZipFile(write("one.zip")) as archive:
        assert not [name for name in archive.namelist() if "left" in name]


def test_results_of_a_scene_that_the_catalogue_does_not_name_are_left_out(write: Write, tmp_path: Path) -> None:
    other = tmp_path / "results" / "scenes" / "gloss-sheet"
    other.mkdir(parents=True)
    (other / "catalogue.csv").touch()
    with zipfile.ZipFile(write("one.zip")) as archive:
        assert not [name for name in archive.namelist() if "gloss-sheet" in name]


def test_a_file_belongs_to_the_material_of_its_folder_alone(write: Write, tmp_path: Path) -> None:
    place = tmp_path / "results" / "other" / "black"
    place.mkdir(parents=True)
    (place / "x.txt").touch()
    (tmp_path / "catalogue" / "black").rename(tmp_path / "catalogue" / "folder")
    with (tmp_path / "catalogue" / "folder" / "material.yaml").open("a") as file:
        file.write("name: black\n")
    with zipfile.ZipFile(write("one.zip")) as archive:
        graph = {entity["@id"]: entity for entity in json.loads(archive.read(METADATA))["@graph"]}
    own = {part["@id"] for part in graph["#material-black"]["hasPart"]}
    assert {"inputs/folder/material.yaml", "results/black/bsdf.nc"} <= own
    assert "results/other/black/x.txt" not in own


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("license: CC-BY", "license"),
        ("date: 2026-01-31", "date"),
        ("creators: []", "creators"),
        ("surprise: 1", "surprise"),
    ],
)
def test_wrong_metadata_are_refused_by_key(tmp_path: Path, text: str, where: str) -> None:
    stated = {**STATED, "license": STATED["license"]}
    path = tmp_path / "release.yaml"
    lines = [f"{key}: {json.dumps(value)}" for key, value in stated.items() if key != text.partition(":")[0]]
    path.write_text("\n".join([*lines, text]))
    with pytest.raises(InputError, match=where):
        reading.read(path, Release)


def test_a_file_whose_name_is_not_utf8_is_named(write: Write, tmp_path: Path) -> None:
    (tmp_path / "catalogue" / "black" / os.fsdecode(b"gr\xfcn.txt")).touch()
    with pytest.raises(BrdfpipeError, match=r"gr\\xfcn\.txt: the name is not UTF-8"):
        write("one.zip")

"""What a build depends on beside its files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.jobs.fingerprint import fingerprint

CHANGES: dict[str, Callable[[Path, Path, Path], object]] = {
    "a key": lambda folder, project, results: (folder / "first" / "material.yaml").write_text("index: 1.6\n"),
    "a material less": lambda folder, project, results: shutil.rmtree(folder / "second"),
    "a description that is refused": lambda folder, project, results: (folder / "first" / "material.yaml").write_text(
        "["
    ),
    "a script": lambda folder, project, results: os.utime(project / "workflow" / "scripts" / "facets.py", (1e9, 1e9)),
    "a rule": lambda folder, project, results: (project / "workflow" / "rules" / "more.smk").touch(),
    "the Snakefile": lambda folder, project, results: os.utime(project / "Snakefile", (1e9, 1e9)),
    "another scene in the results": lambda folder, project, results: _touch(results / "scenes" / "x" / "index.html"),
}


def _touch(path: Path) -> None:
    path.parent.mkdir(parents=True)
    path.touch()


def of(folder: Path, results: Path, **config: object) -> str:
    return fingerprint(load(folder, {**load_config(), **config}), results)


@pytest.mark.parametrize("change", CHANGES)
def test_it_changes_with(change: str, folder: Path, project: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    before = of(folder, results)
    assert of(folder, results) == before
    CHANGES[change](folder, project, results)
    assert of(folder, results) != before


def test_it_changes_with_the_configuration_the_scene_and_the_place(folder: Path, project: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    copied = tmp_path / "copied"
    shutil.copytree(folder, copied)
    prints = [
        of(folder, results),
        of(folder, results, preview=False),
        of(folder, results, scene="gloss-sheet"),
        of(copied, results),
    ]
    assert len(set(prints)) == len(prints)


def test_it_changes_with_the_version_of_a_library(
    folder: Path, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    libraries = tmp_path / "libraries"
    (libraries / "numpy-1.0.dist-info").mkdir(parents=True)
    monkeypatch.syspath_prepend(str(libraries))
    before = of(folder, tmp_path)
    (libraries / "numpy-1.0.dist-info").rename(libraries / "numpy-1.1.dist-info")
    assert of(folder, tmp_path) != before


def test_a_link_to_nowhere_among_the_sources_has_no_effect(folder: Path, project: Path, tmp_path: Path) -> None:
    before = of(folder, tmp_path)
    (project / "workflow" / "scripts" / ".#facets.py").symlink_to("someone@host.123")
    assert of(folder, tmp_path) == before

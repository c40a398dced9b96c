"""A snapshot is what the results were, takes the space of what changed, and no foreign folder is ever deleted."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.index import INDEX, Index
from brdfpipe.releases.snapshots import MARK, snapshots, take_snapshot
from brdfpipe.releases.verification import verify_results

FIRST = datetime(2026, 1, 31, 2, 15, tzinfo=UTC)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    for name in ("a/bsdf.nc", "b/bsdf.nc", "catalogue.nc"):
        write(folder, name, f"first {name}")
    (folder / "logs").mkdir()
    (folder / "logs" / "build.log").write_text("not a result")
    return folder


def write(results: Path, name: str, text: str) -> None:
    """What a job does: a new file takes the place of the old one."""
    path = results / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".part").write_text(text)
    path.with_suffix(".part").replace(path)
    Index(results).finish("parameters", "code", (), [name])


def nights(results: Path, folder: Path, count: int, **options: int) -> None:
    for night in range(count):
        take_snapshot(results, folder, now=FIRST + timedelta(days=night), **options)


def test_a_snapshot_keeps_results_that_change_later(results: Path, tmp_path: Path) -> None:
    taken = take_snapshot(results, tmp_path / "nights", now=FIRST)
    write(results, "a/bsdf.nc", "second")
    assert taken.path == tmp_path / "nights" / "2026-01-31T021500Z"
    assert (taken.path / "a/bsdf.nc").read_text() == "first a/bsdf.nc"
    assert (taken.copied, taken.linked) == (3, 0)
    assert not (taken.path / "logs").exists()
    assert verify_results(taken.path) == []


def test_what_did_not_change_is_stored_once(results: Path, tmp_path: Path) -> None:
    first = take_snapshot(results, tmp_path / "nights", now=FIRST)
    write(results, "a/bsdf.nc", "second")
    second = take_snapshot(results, tmp_path / "nights", now=FIRST + timedelta(days=1))
    assert (second.copied, second.linked) == (1, 2)
    assert (first.path / "b/bsdf.nc").samefile(second.path / "b/bsdf.nc")
    assert not (second.path / "b/bsdf.nc").samefile(results / "b/bsdf.nc")
    assert (second.path / "a/bsdf.nc").read_text() == "second"
    assert verify_results(second.path) == []


def test_the_results_stay_known_to_builds(results: Path, tmp_path: Path) -> None:
    before = {path: path.stat() for path in results.rglob("*.nc")}
    nights(results, tmp_path / "nights", 2)
    assert {path: (path.stat().st_ctime_ns, path.stat().st_ino) for path in before} == {
        path: (status.st_ctime_ns, status.st_ino) for path, status in before.items()
    }


def test_the_last_snapshots_stay_and_other_folders_are_not_deleted(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / "nights"
    for other in ("2020-01-01T000000Z", "mine"):
        (folder / other).mkdir(parents=True)
        (folder / other / INDEX).touch()
    nights(results, folder, 5, keep=2)
    assert [path.name for path in snapshots(folder)] == ["2026-02-03T021500Z", "2026-02-04T021500Z"]
    assert {path.name for path in folder.iterdir()} - {path.name for path in snapshots(folder)} == {
        "2020-01-01T000000Z",
        "mine",
    }
    assert (snapshots(folder)[0] / "b/bsdf.nc").read_text() == "first b/bsdf.nc"


def test_without_hard_links_files_are_copied(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: object) -> None:
        raise OSError("no hard links")

    monkeypatch.setattr(os, "link", refuse)
    nights(results, tmp_path / "nights", 2)
    assert [verify_results(path) for path in snapshots(tmp_path / "nights")] == [[], []]


def test_a_path_out_of_the_folder_is_left_out(results: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x")
    Index(results).finish("parameters", "code", (), ["../secret"])
    taken = take_snapshot(results, tmp_path / "nights", now=FIRST)
    assert taken.copied == 3


@pytest.mark.parametrize(
    ("name", "words"), [("../x", "accepted are letters"), (".x", "accepted are letters"), ("there", "exists")]
)
def test_names_that_are_not_accepted(results: Path, tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "nights" / "there").mkdir(parents=True)
    with pytest.raises(BrdfpipeError, match=words):
        take_snapshot(results, tmp_path / "nights", name=name)


def test_a_folder_without_results_and_one_within_them_are_refused(results: Path, tmp_path: Path) -> None:
    with pytest.raises(BrdfpipeError, match="run `brdfpipe build` first"):
        take_snapshot(tmp_path, tmp_path / "nights")
    with pytest.raises(BrdfpipeError, match="lies in the results"):
        take_snapshot(results, results / "nights")


def test_an_interrupted_snapshot_leaves_nothing(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*given: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("shutil.copy2", full)
    with pytest.raises(OSError, match="No space left"):
        take_snapshot(results, tmp_path / "nights")
    assert list((tmp_path / "nights").iterdir()) == []


def test_what_a_killed_snapshot_left_goes_with_the_next(results: Path, tmp_path: Path) -> None:
    (tmp_path / "nights" / ".unfinished-x" / "a").mkdir(parents=True)
    taken = take_snapshot(results, tmp_path / "nights", now=FIRST)
    assert list((tmp_path / "nights").iterdir()) == [taken.path]


def test_a_damaged_mark_is_no_snapshot(results: Path, tmp_path: Path) -> None:
    nights(results, tmp_path / "nights", 1)
    (tmp_path / "nights" / "odd").mkdir()
    (tmp_path / "nights" / "odd" / MARK).write_text("yesterday")
    assert [path.name for path in snapshots(tmp_path / "nights")] == ["2026-01-31T021500Z"]

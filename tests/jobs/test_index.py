"""The index: contents of files, and jobs that were stopped."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pytest

from brdfpipe.jobs import index as indexes
from brdfpipe.jobs.index import INDEX, Index


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Results with one dataset, written a minute ago."""
    (tmp_path / "m").mkdir()
    write(tmp_path / "m" / "a.nc", "one")
    return tmp_path


def write(path: Path, text: str, age: float = 60.0) -> None:
    path.write_text(text)
    os.utime(path, (time.time() - age,) * 2)


def let_settle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trust the stamps of files that have just changed: no program can give a file an older time of its last change."""
    monkeypatch.setattr(indexes, "SETTLED_NS", -(10**9))


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The files that are read from now on."""
    read: list[Path] = []
    original = indexes.file_digest

    def noted(path: Path) -> str:
        read.append(path)
        return original(path)

    monkeypatch.setattr(indexes, "file_digest", noted)
    return read


def test_an_unchanged_file_is_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_settle(monkeypatch)
    read = count_reads(monkeypatch)
    first = Index(folder).digest("m/a.nc")
    assert Index(folder).digest("m/a.nc") == first
    assert len(read) == 1
    write(folder / "m" / "a.nc", "two")
    assert Index(folder).digest("m/a.nc") != first


def test_a_file_that_has_just_changed_is_read_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may change once more without another time, because the clock of a file system has coarse steps."""
    monkeypatch.setattr(indexes, "SETTLED_NS", 10**12)
    read = count_reads(monkeypatch)
    index = Index(folder)
    assert index.digest("m/a.nc") == index.digest("m/a.nc")
    assert len(read) == 2


def test_a_missing_file_has_no_digest(folder: Path) -> None:
    assert Index(folder).digest("m/absent.nc") is None


def test_a_job_is_known_until_it_starts_again(folder: Path) -> None:
    index = Index(folder)
    index.start(["m/a.nc"])
    index.finish("p", "c", (("/raw.txt", "d"),), ["m/a.nc"])
    known = Index(folder).jobs["m/a.nc"]
    assert (known.parameters, known.code, known.inputs) == ("p", "c", (("/raw.txt", "d"),))
    assert known.outputs == {"m/a.nc": Index(folder).digest("m/a.nc")}
    index.start(["m/a.nc"])
    assert Index(folder).jobs == {}


def test_a_result_is_intact_while_it_is_what_its_job_wrote(folder: Path) -> None:
    index = Index(folder)
    assert index.damaged(["m/a.nc"]) == []  # unknown
    index.finish("p", "c", (), ["m/a.nc"])
    assert index.damaged(["m/a.nc"]) == []
    write(folder / "m" / "a.nc", "two")
    assert index.damaged(["m/a.nc"]) == ["m/a.nc"]


def test_a_build_is_complete_until_a_file_or_the_fingerprint_changes_or_a_job_starts(folder: Path) -> None:
    index = Index(folder)
    index.finish("p", "c", (), ["m/a.nc"])
    assert not index.is_complete("f")
    index.complete("f", dict.fromkeys(["m/a.nc", "m/absent.nc"]))
    assert Index(folder).is_complete("f")
    assert not Index(folder).is_complete("g")
    write(folder / "m" / "a.nc", "two")
    assert not Index(folder).is_complete("f")
    assert not Index(folder).is_complete("f")  # nor after the new content has been noted
    write(folder / "m" / "a.nc", "one")
    assert Index(folder).is_complete("f")
    Index(folder).start(["m/b.nc"])
    assert not Index(folder).is_complete("f")


def test_a_build_is_not_complete_where_a_result_has_no_job_or_a_raw_file_changed(folder: Path, tmp_path: Path) -> None:
    index, raw = Index(folder), tmp_path / "raw.txt"
    raw.write_text("1")
    planned = {str(raw): index.digest(str(raw))}
    index.complete("f", {**planned, "m/a.nc": None})
    assert not index.is_complete("f")
    index.finish("p", "c", (), ["m/a.nc"])
    raw.write_text("2")
    index.complete("f", {**planned, "m/a.nc": None})
    assert not index.is_complete("f")
    raw.write_text("1")
    index.complete("f", {**planned, "m/a.nc": None})
    assert index.is_complete("f")


@pytest.mark.parametrize("damage", [b'{"job":"m/a', b"\xff\xfe", b"[1]\n", b'{"file":"m/a.nc","is":[1]}\n', b"\n"])
def test_lines_that_cannot_be_read_are_ignored(folder: Path, damage: bytes) -> None:
    Index(folder).finish("p", "c", (), ["m/a.nc"])
    with (folder / INDEX).open("ab") as file:
        file.write(damage)
    index = Index(folder)
    index.finish("p", "c", (), ["m/b.nc"])
    assert Index(folder).jobs.keys() == {"m/a.nc", "m/b.nc"}


def test_superseded_lines_are_dropped(folder: Path) -> None:
    index = Index(folder)
    for number in range(50):
        index.finish(str(number), "c", (), ["m/a.nc"])
    known = Index(folder)
    assert known.jobs["m/a.nc"].parameters == "49"
    assert len((folder / INDEX).read_text().splitlines()) == 1
    assert Index(folder).jobs == known.jobs


def test_what_nodes_of_a_cluster_recorded_is_taken_over(folder: Path) -> None:
    whole, node = Index(folder), Index(folder, apart=True)
    write(folder / "m" / "b.nc", "two")
    whole.finish("p", "c", (), ["m/a.nc"])
    node.start(["m/b.nc"])
    assert not node.jobs  # it has read nothing
    node.finish("p", "c", whole.inputs(["m/a.nc"]), ["m/b.nc"])
    assert len(list(folder.glob(".index*"))) == 2
    for _ in range(2):  # from the files, then from the one that replaced them
        assert set(Index(folder).jobs) == {"m/a.nc", "m/b.nc"}
        assert [path.name for path in folder.glob(".index*")] == [INDEX]


def test_a_node_never_writes_the_index_anew(folder: Path) -> None:
    Index(folder).finish("p", "c", (), ["m/a.nc"])
    with (folder / INDEX).open("a") as file:
        file.write('{"job": "m/b')  # what another process is about to write
    before = (folder / INDEX).read_bytes()
    Index(folder, apart=True).finish("p", "c", (), ["m/a.nc"])
    assert (folder / INDEX).read_bytes() == before


def test_an_index_that_cannot_be_written_anew_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Index(folder).finish("p", "c", (), ["m/a.nc"])
    with (folder / INDEX).open("a") as file:
        file.write('{"job":"m/b')
    full = shutil.disk_usage(folder)._replace(free=0)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    assert Index(folder).jobs.keys() == {"m/a.nc"}


def test_a_changed_bit_makes_the_index_forget_and_never_believe_something_else(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    index = Index(folder)
    for name in ("a.nc", "b.nc"):
        (folder / name).write_text(name)
        index.finish("p", "c", (("raw", "0"),), [name])
    content, jobs = (folder / INDEX).read_bytes(), dict(index.jobs)
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 1
        (folder / INDEX).write_bytes(damaged)
        found = Index(folder)
        assert found.jobs.items() <= jobs.items()
        assert found.damaged(["a.nc", "b.nc"]) == []

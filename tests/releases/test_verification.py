"""Every damage to a folder of results is found, whatever the times of the files say."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.index import INDEX, Index
from brdfpipe.releases.verification import verify_results

FILES = ("a/bsdf.nc", "a/report.html", "a/exports/a.astm", "catalogue.csv")


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder of results with its index."""
    index = Index(tmp_path)
    for number, name in enumerate(FILES):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(bytes([number]) * 100)
        index.finish("p", "c", (), [name])
    for name in ("logs/a/bsdf.log", ".snakemake/x", ".build.lock", "a/STALE.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


def with_old_time(change: Callable[[Path], None], path: Path) -> None:
    """Change a file and give it its former time."""
    status = path.stat()
    change(path)
    if path.exists():
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_untouched_results_have_no_problem(results: Path) -> None:
    assert verify_results(results) == []


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            lambda path: path.write_bytes(path.read_bytes()[:50] + b"\xff" + path.read_bytes()[51:]),
            "is not what the build wrote",
        ),
        (lambda path: path.write_bytes(path.read_bytes()[:-1]), "is not what the build wrote"),
        (lambda path: path.write_bytes(b""), "is not what the build wrote"),
        (lambda path: path.unlink(), "is missing"),
    ],
    ids=["flipped", "truncated", "emptied", "deleted"],
)
def test_each_damage_to_each_kind_of_file_is_named(
    results: Path, name: str, change: Callable[[Path], None], problem: str
) -> None:
    with_old_time(change, results / name)
    assert verify_results(results) == [f"{name}: {problem}"]


def test_swapped_files_are_both_named(results: Path) -> None:
    first, second = results / FILES[0], results / FILES[1]
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])
    assert len(verify_results(results)) == 2


def test_files_that_no_build_wrote_are_named(results: Path) -> None:
    (results / "a" / "extra.txt").touch()
    (results / "changes.html").touch()  # of `brdfpipe diff`: a note about builds
    assert verify_results(results) == ["a/extra.txt: was written by no build"]


def test_a_damaged_index_hides_nothing(results: Path) -> None:
    lines = (results / INDEX).read_text().splitlines(keepends=True)
    (results / INDEX).write_text("".join(["damaged" + lines[0][3:], *lines[1:]]))
    assert verify_results(results) == [
        f"{INDEX}: 1 of its lines damaged; their jobs run again",
        f"{FILES[0]}: was written by no build",
    ]


def test_a_folder_without_an_index_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BrdfpipeError, match="run `brdfpipe build` first"):
        verify_results(tmp_path)

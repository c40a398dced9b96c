"""What runs again: what changed by its content, whatever the times of files and snakemake's own notes say."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.index import INDEX
from brdfpipe.jobs.pool import Pool
from brdfpipe.jobs.snakemake_run import SnakemakeRun
from brdfpipe.jobs.stage import Job, Outcome
from brdfpipe.jobs.summary import Summary

Write = Callable[..., Path]

OF_SURFACE = {
    "surface",
    "facets",
    "psd",
    "visibility",
    "interreflection",
    "predicted",
    "wave",
    "model_error",
    "uncertainty",
}
"""Stages of a prediction that depend on the scan."""

BEFORE = 10**9
"""The first second of 1970, ns: earlier than any result."""


@pytest.fixture
def results(tmp_path: Path, project: Path, folder: Path) -> Path:
    """Results of the catalogue, up to date."""
    made = tmp_path / "results"
    build(folder, made)
    return made


def build(folder: Path, results: Path, **options: bool) -> Summary:
    return build_catalogue(folder, results, cores=2, **options)


def contents(results: Path) -> dict[str, bytes]:
    """Every result, by its path."""
    paths = [path for path in results.rglob("*") if path.is_file()]
    names = {path: path.relative_to(results) for path in paths}
    hidden = ("logs", ".snakemake", ".build.lock", INDEX)
    return {str(name): path.read_bytes() for path, name in names.items() if name.parts[0] not in hidden}


def changes(results: Path) -> dict[str, int]:
    """When each result was last written or changed; no program sets this time."""
    return {name: (results / name).stat().st_ctime_ns for name in contents(results)}


def written_anew(before: dict[str, int], results: Path) -> set[str]:
    return {name for name, number in changes(results).items() if before.get(name) != number}


def test_other_content_with_an_older_date_runs_the_stages_that_read_it(folder: Path, results: Path) -> None:
    raw, before = folder / "first" / "raw.txt", changes(results)
    raw.write_text("3 2 1")
    os.utime(raw, ns=(BEFORE, BEFORE))
    assert build(folder, results).built == ("first",)
    anew = written_anew(before, results)
    assert {f"first/{stage}.nc" for stage in OF_SURFACE} | {"first/report.html"} <= anew
    assert not anew & {"first/index.nc", "first/spectrum.nc"}
    assert not any(name.startswith("second/") for name in anew)


def test_other_content_of_the_same_size_and_time_is_noticed(folder: Path, results: Path) -> None:
    raw = folder / "first" / "raw.txt"
    status = raw.stat()
    raw.write_text("3 2 1")
    os.utime(raw, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert build(folder, results).built == ("first",)


def test_other_content_is_noticed_where_results_carry_later_times(folder: Path, results: Path) -> None:
    for name in contents(results):
        os.utime(results / name, (4e9, 4e9))
    (folder / "first" / "raw.txt").write_text("3 2 1")
    assert build(folder, results).built == ("first",)


def test_a_raw_file_of_the_future_is_built(folder: Path, results: Path) -> None:
    raw = folder / "first" / "raw.txt"
    raw.write_text("3 2 1")
    os.utime(raw, (4e9, 4e9))
    assert build(folder, results).built == ("first",)
    assert build(folder, results).jobs == 0


def test_a_raw_file_copied_again_runs_nothing(folder: Path, results: Path) -> None:
    raw = folder / "first" / "raw.txt"
    text = raw.read_text()
    raw.unlink()
    raw.write_text(text)
    os.utime(raw, (4e9, 4e9))
    assert build(folder, results).jobs == 0


def test_without_the_notes_of_snakemake_nothing_runs_and_an_edited_key_is_noticed(folder: Path, results: Path) -> None:
    shutil.rmtree(results / ".snakemake")
    assert build(folder, results).jobs == 0
    description = folder / "first" / "material.yaml"
    description.write_text(description.read_text().replace("index: 1.5", "index: 1.6"))
    os.utime(description, ns=(BEFORE, BEFORE))
    before = changes(results)
    assert build(folder, results).built == ("first",)
    anew = written_anew(before, results)
    assert "first/index.nc" in anew
    assert "first/surface.nc" not in anew


def test_copied_results_of_a_moved_catalogue_are_current(folder: Path, results: Path, tmp_path: Path) -> None:
    elsewhere, copied = tmp_path / "elsewhere", tmp_path / "copied"
    folder.rename(elsewhere)
    shutil.copytree(results, copied, copy_function=shutil.copyfile)  # with the times of the copy, in any order
    for number, name in enumerate(sorted(contents(copied), reverse=True)):
        os.utime(copied / name, (1e9 + number, 1e9 + number))
    summary = build(elsewhere, copied)
    assert (summary.jobs, summary.notices) == (0, ())
    (elsewhere / "second" / "raw.txt").write_text("3 2 1")
    assert build(elsewhere, copied).built == ("second",)


def test_a_copy_of_a_catalogue_with_another_raw_file_is_not_taken_for_the_first(
    folder: Path, results: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    (other / "first" / "raw.txt").write_text("3 2 1")
    assert build(other, results).built == ("first",)


def test_results_swapped_between_materials_are_made_anew(folder: Path, results: Path) -> None:
    made = contents(results)
    first, second, aside = (results / name for name in ("first/bsdf.nc", "second/bsdf.nc", "aside"))
    first.rename(aside)
    second.rename(first)
    aside.rename(second)
    summary = build(folder, results)
    assert contents(results) == made
    assert summary.notices == (
        "2 results changed since the build wrote them, and made anew: first/bsdf.nc, second/bsdf.nc",
    )
    assert build(folder, results).jobs == 0


def test_a_changed_page_is_made_anew_alone(folder: Path, results: Path) -> None:
    before = changes(results)
    (results / "first" / "report.html").write_text("edited")
    build(folder, results)
    assert {name for name in written_anew(before, results) if "/" in name} == {"first/report.html"}


def test_a_lost_or_damaged_index_costs_a_build_and_no_change_is_hidden(folder: Path, results: Path) -> None:
    made, index = contents(results), results / INDEX
    lines = index.read_text().splitlines(keepends=True)
    index.write_text("".join(line for line in lines if "first/bsdf.nc" not in line)[:-20] + "\0broken")
    assert build(folder, results).built == ("first",)
    index.unlink()
    assert build(folder, results).built == ("first", "second")
    assert contents(results) == made


def test_a_dry_run_says_what_would_run_and_leaves_it_to_be_run(folder: Path, results: Path) -> None:
    (folder / "first" / "raw.txt").write_text("3 2 1")
    planned = build(folder, results, dry_run=True)
    assert (planned.built, planned.current) == (("first",), ("second",))
    assert build(folder, results).jobs == planned.jobs
    assert build(folder, results, dry_run=True).jobs == 0


def test_a_material_that_failed_runs_again_after_its_old_content_returns(
    folder: Path, results: Path, write: Write
) -> None:
    made = contents(results)
    write(folder, "first", raw="refuse")
    assert set(build(folder, results).failures) == {"first"}
    write(folder, "first")
    assert build(folder, results).failures == {}
    assert contents(results) == made


def test_an_unchanged_catalogue_is_not_planned(folder: Path, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise AssertionError("snakemake must not start")

    monkeypatch.setattr("brdfpipe.jobs.snakemake_run.SnakemakeRun.start", refuse)
    assert build(folder, results).current == ("first", "second")
    (folder / "first" / "raw.txt").write_text("3 2 1")
    with pytest.raises(AssertionError, match="must not start"):
        build(folder, results)
    with pytest.raises(AssertionError, match="must not start"):
        build(folder, results)


@pytest.mark.parametrize("dry", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["planned", "run"])
def test_snakemake_by_itself_runs_what_changed_by_its_content(
    folder: Path, results: Path, project: Path, dry: bool
) -> None:
    raw = folder / "first" / "raw.txt"
    raw.write_text("3 2 1")
    os.utime(raw, ns=(BEFORE, BEFORE))
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(project / "Snakefile"), "--profile", "none"]
    command += ["--workflow-profile", str(project / "workflow" / "profiles" / "default"), "--directory", str(results)]
    command += ["--cores", "1", "--config", f"catalogue={folder}", *(["--dry-run"] if dry else [])]
    before = changes(results)
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    planned = set(re.findall(r"^Job \d+: (.+)$", done.stdout + done.stderr, re.MULTILINE))
    assert {f"{stage} of first" for stage in OF_SURFACE} <= planned
    assert not any(job.endswith("of second") or job == "index of first" for job in planned)
    assert ("first/report.html" in written_anew(before, results)) is not dry
    if not dry:
        assert build(folder, results).jobs == 0


@pytest.mark.parametrize("moment", ["during the job", "after the job"])
def test_a_raw_file_that_changes_during_the_build_is_read_by_the_next_one(
    project: Path, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    raw, results = folder / "first" / "raw.txt", tmp_path / "results"
    perform, start = Pool.perform, SnakemakeRun.start

    def perform_and_change(pool: Pool, job: Job) -> Outcome:
        outcome = perform(pool, job)
        if (job.material, job.title) == ("first", "surface"):
            raw.write_text("3 2 1")
        return outcome

    def start_and_change(run: SnakemakeRun, *arguments: Any) -> bool:
        succeeded = start(run, *arguments)
        raw.write_text("3 2 1")
        return succeeded

    with monkeypatch.context() as changed:
        if moment == "during the job":
            changed.setattr(Pool, "perform", perform_and_change)
        else:
            changed.setattr(SnakemakeRun, "start", start_and_change)
        build(folder, results)
    assert build(folder, results).built == ("first",)
    assert build(folder, results).jobs == 0


def test_an_edited_key_plans_the_jobs_that_depend_on_it_and_no_others(
    folder: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    description = folder / "first" / "material.yaml"
    description.write_text(description.read_text().replace("index: 1.5", "index: 1.6"))
    from snakemake.dag import DAG

    sizes, update_ready = [], DAG.update_ready

    def noted(dag: DAG, jobs: Any = None) -> bool:
        sizes.append(len(dag))
        return bool(update_ready(dag, jobs))

    monkeypatch.setattr(DAG, "update_ready", noted)
    summary = build(folder, results)
    assert summary.built == ("first",)
    assert max(sizes) == summary.jobs + 1  # and the rule of all results

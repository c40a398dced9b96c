"""The build: what is built and what is not, its messages, and its state after it was killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from filelock import FileLock
from killed_build import contents, start_build

from brdfpipe.catalogue.names import CatalogueError
from brdfpipe.jobs import cleanup, failures
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.build import refuse_outdated
from brdfpipe.jobs.lock import BuildError
from brdfpipe.jobs.summary import Summary

Write = Callable[..., Path]

PATIENCE = 600.0
"""Seconds to wait for what must happen, on however slow a machine."""


@pytest.fixture
def results(tmp_path: Path, project: Path) -> Path:
    return tmp_path / "results"


def build(folder: Path, results: Path) -> Summary:
    return build_catalogue(folder, results, cores=2)


def times(results: Path) -> dict[str, int]:
    """When each result was written."""
    return {name: (results / name).stat().st_mtime_ns for name in contents(results)}


def rewritten(before: dict[str, int], after: dict[str, int]) -> set[str]:
    return {name for name in after if after[name] != before.get(name)}


def listed_failures(results: Path) -> dict[str, dict[str, str]]:
    """The failures that the fake catalogue stage received."""
    return dict(json.loads((results / "catalogue.csv").read_text())["failures"])


def test_a_build_makes_every_material_and_the_catalogue(folder: Path, results: Path) -> None:
    summary = build(folder, results)
    assert (summary.built, summary.current, summary.failures) == (("first", "second"), (), {})
    made = contents(results)
    for name in ("first", "second"):
        assert {f"{name}/{part}" for part in ("surface.nc", "bsdf.nc", "report.html", f"exports/{name}.astm")} <= set(
            made
        )
    assert {"catalogue.nc", "catalogue.csv", "index.html", "catalogue.lock.json"} <= set(made)
    times = json.loads((results / "logs" / "first" / "surface.json").read_text())
    assert times["stage"] == "surface"
    assert times["peak_mb"] > 1


def test_an_unchanged_catalogue_runs_no_job(folder: Path, results: Path) -> None:
    build(folder, results)
    before = times(results)
    summary = build(folder, results)
    assert (summary.jobs, summary.current) == (0, ("first", "second"))
    assert times(results) == before


def test_the_verdict_of_a_named_material_is_that_of_its_own_row(folder: Path, project: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (project / "workflow" / "scripts" / "summary.py").write_text(
        "import xarray as xr\n"
        "def main(input, output, params):\n"
        "    row = {'verdict': 'fail', 'verdict_text': 'too bright', 'refused_exports': ''}\n"
        "    row = {name: ('material', [text]) for name, text in row.items()}\n"
        "    xr.Dataset(row).to_netcdf(output['summary'])\n"
    )
    results.mkdir()
    (results / "catalogue.csv").write_text("material,verdict,verdict_text\nfirst,pass,\n")  # of an earlier build
    (results / ".snakemake").mkdir()
    summary = build_catalogue(folder, results, cores=2, names=["first"])
    assert (summary.verdicts, summary.fail_reasons) == ({"first": "fail"}, {"first": "too bright"})


def test_only_named_materials_are_built_and_the_rest_follows_later(folder: Path, results: Path, write: Write) -> None:
    write(folder, "bad", raw="refuse")
    summary = build_catalogue(folder, results, cores=2, names=["fir*"])
    assert (summary.built, summary.current, summary.failures) == (("first",), (), {})
    assert summary.page == results / "first" / "report.html"
    assert not (results / "second").exists()
    assert not (results / "index.html").exists()
    again = build_catalogue(folder, results, cores=2, names=["first"])
    assert (again.jobs, again.current) == (0, ("first",))
    whole = build(folder, results)
    assert (whole.built, whole.current, set(whole.failures)) == (("second",), ("first",), {"bad"})
    assert (results / "index.html").exists()
    assert set(build_catalogue(folder, results, cores=2, names=["b?d"]).failures) == {"bad"}


def test_a_name_that_no_material_has_is_refused_with_the_nearest(folder: Path, results: Path) -> None:
    with pytest.raises(CatalogueError, match="no material 'frist'; did you mean 'first'"):
        build_catalogue(folder, results, cores=2, names=["frist"])
    assert not results.exists()


def test_a_refused_material_stops_no_other_and_is_listed(folder: Path, results: Path, write: Write) -> None:
    write(folder, "bad", raw="refuse")
    summary = build(folder, results)
    assert summary.built == ("first", "second")
    assert summary.failures == {"bad": "surface: raw.txt: not fit to use; found refuse"}
    assert listed_failures(results) == {"bad": {"stage": "surface", "message": "raw.txt: not fit to use; found refuse"}}
    before = times(results)
    assert build(folder, results).jobs == 0
    assert rewritten(before, times(results)) <= {"failures/bad.json"}


def test_a_corrected_material_is_built_again(folder: Path, results: Path, write: Write) -> None:
    write(folder, "bad", raw="refuse")
    build(folder, results)
    write(folder, "bad", raw="4 5 6")
    summary = build(folder, results)
    assert (summary.built, summary.failures) == (("bad",), {})
    assert listed_failures(results) == {}


def test_an_invalid_description_is_listed_and_stops_no_other_material(
    folder: Path, results: Path, write: Write
) -> None:
    (write(folder, "typo") / "material.yaml").write_text("spectrm: {}\n")
    summary = build(folder, results)
    assert summary.built == ("first", "second")
    assert "did you mean 'spectrum'?" in summary.failures["typo"]
    assert set(listed_failures(results)) == {"typo"}


def test_the_page_appears_when_every_material_fails(folder: Path, results: Path, write: Write) -> None:
    write(folder, "first", raw="refuse")
    (folder / "second" / "material.yaml").write_text("[")
    summary = build(folder, results)
    assert set(summary.failures) == {"first", "second"} == set(listed_failures(results))
    assert summary.page.is_file()


def test_a_bug_in_a_stage_points_to_its_traceback(folder: Path, results: Path, write: Write) -> None:
    write(folder, "first", raw="crash")
    message = build(folder, results).failures["first"]
    assert message == "surface: unexpected KeyError: 'a bug' (see logs/first/surface.log)"
    assert "Traceback" in (results / "logs" / "first" / "surface.log").read_text()


def test_a_stage_whose_worker_is_killed_fails_by_name_and_alone(folder: Path, results: Path, write: Write) -> None:
    write(folder, "first", raw="die")
    summary = build(folder, results)
    assert summary.built == ("second",)
    assert summary.failures["first"].startswith("surface: the process was killed 2 times (SIGKILL)")


def test_a_result_that_vanishes_during_the_build_is_made_again(folder: Path, results: Path, write: Write) -> None:
    build(folder, results)
    write(folder, "first", raw="lose first/index.nc")
    write(folder, "second", raw="4 5 6")
    summary = build(folder, results)
    assert (summary.built, summary.failures) == (("first", "second"), {})
    assert (results / "first" / "index.nc").exists()
    assert build(folder, results).jobs == 0


def test_a_raw_file_that_vanishes_during_the_build_fails_its_material_alone(
    folder: Path, results: Path, write: Write
) -> None:
    write(folder, "first", raw=f"lose {folder / 'second' / 'raw.txt'}")
    summary = build(folder, results)
    assert summary.built == ("first",)
    assert summary.failures.keys() == {"second"}
    assert "raw.txt: vanished during the build" in summary.failures["second"]


def test_a_stage_that_a_library_crashes_is_not_taken_for_a_shortage_of_memory(
    folder: Path, results: Path, write: Write
) -> None:
    write(folder, "first", raw="abort")
    summary = build(folder, results)
    assert summary.built == ("second",)
    assert summary.failures["first"] == (
        "surface: a library crashed the process 2 times (SIGABRT); its inputs from other stages are undamaged; "
        "check raw.txt (see logs/first/surface.log)"
    )


def test_a_damaged_result_that_crashes_its_reader_is_made_again(folder: Path, results: Path, write: Write) -> None:
    """A file whose content changed although the file system says nothing, as by a failing disk, and of which a library dies."""
    build(folder, results)
    made = contents(results)
    write(folder, "first", raw="damage first/index.nc")
    summary = build(folder, results)
    assert (summary.failures, summary.notices) == ({}, ("1 damaged or lost file made anew: first/index.nc",))
    write(folder, "first")
    assert build(folder, results).failures == {}
    (results / "damaged").unlink()  # the mark of the stage that it has done its damage
    assert contents(results) == made


def test_deleting_an_intermediate_rebuilds_it_and_what_depends_on_it(folder: Path, results: Path) -> None:
    build(folder, results)
    before, made = times(results), contents(results)
    (results / "first" / "bsdf.nc").unlink()
    build(folder, results)
    after = rewritten(before, times(results))
    stages = (
        "surface",
        "facets",
        "psd",
        "visibility",
        "index",
        "spectrum",
        "interreflection",
        "predicted",
        "wave",
        "model_error",
        "uncertainty",
    )
    upstream = {f"first/{stage}.nc" for stage in stages}
    assert after == {name for name in made if name.startswith("first/")} - upstream | {
        "catalogue.nc",
        "catalogue.csv",
        "index.html",
        "catalogue.lock.json",
    }
    assert contents(results) == made


def test_editing_one_material_rebuilds_that_one_alone(folder: Path, results: Path) -> None:
    build(folder, results)
    before = times(results)
    description = folder / "first" / "material.yaml"
    description.write_text(description.read_text().replace("index: 1.5", "index: 1.6"))
    assert build(folder, results).built == ("first",)
    after = rewritten(before, times(results))
    assert not any(name.startswith("second/") for name in after)
    assert "first/index.nc" in after
    assert "first/surface.nc" not in after


def test_editing_the_description_rebuilds_the_report_alone(folder: Path, results: Path, write: Write) -> None:
    build(folder, results)
    before = times(results)
    (folder / "first" / "material.yaml").write_text(
        (folder / "first" / "material.yaml").read_text().replace("a test", "another")
    )
    build(folder, results)
    of_first = {name for name in rewritten(before, times(results)) if name.startswith("first/")}
    assert of_first == {"first/report.html", "first/summary.nc"}


def test_writing_out_a_default_computes_no_dataset(folder: Path, results: Path) -> None:
    """The page alone is written again, which says that the value is now from material.yaml, and the catalogue."""
    build(folder, results)
    before = {path: path.stat().st_mtime_ns for path in (results / "first").glob("*.nc")}
    with (folder / "first" / "material.yaml").open("a") as description:
        description.write("model: {masking: auto, multiple_scattering: auto}\n")
    assert build(folder, results).jobs == 2
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert build(folder, results).jobs == 0


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            lambda folder, results: (folder / "first" / "raw.txt").write_text("9 9 9"),
            "the results of first are not those",
        ),
        (
            lambda folder, results: (folder / "second" / "material.yaml").write_text("["),
            "materials that cannot be built: second; mend or remove them",
        ),
        (
            lambda folder, results: (results / "second" / "bsdf.nc").write_text("edited"),
            "the results of second are not",
        ),
        (lambda folder, results: (results / "index.html").unlink(), "the results of the catalogue are not those"),
    ],
    ids=["raw file", "description", "result", "page"],
)
def test_results_of_other_inputs_are_refused_by_name_and_nothing_is_built(
    folder: Path, results: Path, change: Callable[[Path, Path], object], problem: str
) -> None:
    build(folder, results)
    refuse_outdated(folder, results)
    change(folder, results)
    before = times(results)
    with pytest.raises(BuildError, match=problem):
        refuse_outdated(folder, results)
    assert times(results) == before


def test_a_new_time_on_an_unchanged_raw_file_rebuilds_nothing(folder: Path, results: Path) -> None:
    build(folder, results)
    (folder / "first" / "raw.txt").touch()
    assert build(folder, results).jobs == 0


def test_changing_a_stages_code_reruns_that_stage(folder: Path, results: Path, project: Path) -> None:
    build(folder, results)
    before = times(results)
    script = project / "workflow" / "scripts" / "export.py"
    script.write_text(script.read_text() + "\nCHANGED = 1\n")
    build(folder, results)
    assert {name for name in rewritten(before, times(results)) if "/" in name} == {
        f"{name}/{file}"
        for name in ("first", "second")
        for file in (
            "export_astm.nc",
            *(f"exports/{name}.{kind}" for kind in ("astm", "astm.json", "total_reflectance.csv")),
            *("report.html", "summary.nc"),  # which state the error of the files, and refusals
        )
    }


def test_a_second_build_into_the_same_folder_is_refused(folder: Path, results: Path) -> None:
    results.mkdir()
    with (
        FileLock(results / ".build.lock"),
        pytest.raises(BuildError, match="another build is running there"),
    ):
        build(folder, results)


@pytest.mark.parametrize("place", [".", "first", "first/results"])
def test_results_among_the_raw_files_are_refused(folder: Path, project: Path, place: str) -> None:
    with pytest.raises(BuildError, match="choose a separate folder for the results"):
        build(folder, folder / place)


def test_a_folder_of_other_files_is_refused(folder: Path, results: Path) -> None:
    results.mkdir()
    (results / "thesis.txt").touch()
    with pytest.raises(BuildError, match=r"holds other files \(thesis.txt\) and no results"):
        build(folder, results)
    assert [path.name for path in results.iterdir()] == ["thesis.txt"]


def test_an_empty_folder_takes_results(folder: Path, results: Path) -> None:
    results.mkdir()
    (results / ".hidden").touch()
    assert build_catalogue(folder, results, cores=1, dry_run=True).jobs == 39


def unwritable(monkeypatch: pytest.MonkeyPatch, *paths: Path) -> None:
    """Make ``os.access`` report these paths as not writable: root, who may run the tests, could write anything."""
    access, blocked = os.access, {str(path.resolve()) for path in paths}

    def answer(path: str | Path, mode: int, **named: bool) -> bool:
        return access(path, mode, **named) and not (mode & os.W_OK and str(Path(path).resolve()) in blocked)

    monkeypatch.setattr(os, "access", answer)


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("first", "results: first: the folder cannot be written; make it writable or delete it"),
        ("first/exports", "results: first/exports: the folder cannot be written; make it writable or delete it"),
        ("first/index.nc", "results: first/index.nc: cannot be replaced (write-protected); make it writable or delete it"),
    ],
)  # fmt: skip
def test_results_that_cannot_be_written_fail_their_material_alone(
    folder: Path, results: Path, monkeypatch: pytest.MonkeyPatch, place: str, message: str
) -> None:
    build(folder, results)
    for name in ("first", "second"):
        description = folder / name / "material.yaml"
        description.write_text(description.read_text().replace("index: 1.5", "index: 1.6"))
    with monkeypatch.context() as patched:
        unwritable(patched, results / place)
        summary = build(folder, results)
    assert summary.built == ("second",)
    assert summary.failures == {"first": message}
    assert listed_failures(results)["first"]["message"] == message.removeprefix("results: ")
    assert build(folder, results).built == ("first",)


def test_an_output_that_cannot_be_removed_is_reported_for_its_material() -> None:
    errors = ["PermissionError: [Errno 13] Permission denied: '/somewhere/results/first/index.nc' Traceback"]
    assert failures.of_unwritable_files(errors, {"first", "second"}) == {
        "first": {
            "stage": "results",
            "message": "first/index.nc: cannot be replaced (Permission denied); make it writable or delete it",
        }
    }


def test_results_of_a_material_that_fails_now_are_marked_until_it_is_corrected(
    folder: Path, results: Path, write: Write
) -> None:
    build(folder, results)
    mark = results / "first" / "STALE.txt"
    write(folder, "first", raw="refuse")
    summary = build(folder, results)
    assert "it cannot be built now: raw.txt: not fit to use; found refuse" in mark.read_text()
    assert (results / "first" / "report.html").exists()
    assert summary.notices == ()
    write(folder, "first")
    build(folder, results)
    assert not mark.exists()


def test_results_of_a_removed_material_are_marked_and_reported(folder: Path, results: Path) -> None:
    build(folder, results)
    (folder / "first").rename(folder.parent / "elsewhere")
    (notice,) = build(folder, results).notices
    assert notice == "1 folder of materials that are no longer in the catalogue, marked by STALE.txt: first"
    assert "no material of this name is in the catalogue" in (results / "first" / "STALE.txt").read_text()
    (folder.parent / "elsewhere").rename(folder / "first")
    assert build(folder, results).notices == ()
    assert not (results / "first" / "STALE.txt").exists()


def test_a_folder_that_is_no_material_is_reported_and_no_failure(folder: Path, results: Path) -> None:
    (folder / "odd").mkdir()
    (folder / "odd" / "material.yml").touch()
    summary = build_catalogue(folder, results, cores=1, dry_run=True)
    assert summary.failures == {}
    assert summary.notices == ("odd: ignored: material.yml is not read; rename it to material.yaml",)


def test_only_results_inside_the_folder_are_ever_deleted_as_damaged(tmp_path: Path) -> None:
    results = tmp_path / "results"
    (results / "failures").mkdir(parents=True)
    for file in (tmp_path / "raw.nc", results / "good.nc", results / "bad.nc"):
        file.touch()
    record = {"damaged": ["../raw.nc", str(tmp_path / "raw.nc"), "bad.nc", "absent.nc"]}
    (results / "failures" / "m.json").write_text(json.dumps(record))
    assert cleanup.delete_damaged(results, []) == ["absent.nc", "bad.nc"]
    assert {path.name for path in tmp_path.rglob("*.nc")} == {"raw.nc", "good.nc"}


def test_a_dry_run_changes_nothing(folder: Path, results: Path) -> None:
    summary = build_catalogue(folder, results, cores=1, dry_run=True)
    assert summary.jobs == 39  # nineteen stages of two materials, and the catalogue
    assert contents(results) == {}


def test_a_dry_run_plans_the_corrected_material_of_a_failed_build(folder: Path, results: Path, write: Write) -> None:
    write(folder, "first", raw="refuse")
    build(folder, results)
    write(folder, "first")
    summary = build_catalogue(folder, results, cores=1, dry_run=True)
    assert (summary.built, summary.current, summary.failures) == (("first",), ("second",), {})


def test_no_result_knows_where_it_was_made(folder: Path, results: Path, write: Write) -> None:
    write(folder, "bad", raw="refuse")
    build(folder, results)
    assert not [name for name, data in contents(results).items() if str(folder.parent).encode() in data]


def test_odd_text_in_paths_descriptions_and_messages_is_only_text(tmp_path: Path, results: Path, write: Write) -> None:
    folder = tmp_path / "ödd 'folder' $HOME"
    write(folder, "first", description="'{wildcards.material} <b> \U0001f600 %s'")
    (write(folder, "second") / "raw.txt").rename(folder / "second" / "$x \U0001f600.txt")
    description = folder / "second" / "material.yaml"
    description.write_text(description.read_text().replace("raw.txt", "'$x \U0001f600.txt'"))
    odd = write(folder, "third")
    (odd / "material.yaml").write_text("surface: {file: '{no} \U0001f600.txt'}\nindex: 1.5\n")
    write(folder, "fourth", raw="refuse")
    summary = build(folder, results)
    assert summary.built == ("first", "second")
    assert "{no} \U0001f600.txt" in listed_failures(results)["third"]["message"]
    assert "{wildcards.material} <b>" in (results / "first" / "summary.nc").read_text()
    assert build(folder, results).jobs == 0


@pytest.fixture
def stuck(project: Path, folder: Path, results: Path, write: Write) -> Iterator[subprocess.Popen[str]]:
    """A build in a process of its own, of which two workers wait for a gate to open."""
    for name in ("first", "second"):
        write(folder, name, raw="wait")
    process = start_build(project, folder, results)
    logs = [results / "logs" / name / "surface.log" for name in ("first", "second")]
    try:
        wait_until("both jobs have a log", lambda: all(log.exists() for log in logs))
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_until(condition: str, holds: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, f"not within {PATIENCE} s: {condition}"
        time.sleep(0.05)


def test_a_killed_build_leaves_no_process_and_resumes(
    stuck: subprocess.Popen[str], folder: Path, results: Path, tmp_path: Path
) -> None:
    children = psutil.Process(stuck.pid).children(recursive=True)
    assert len(children) >= 2
    stuck.kill()
    wait_until(
        "all processes of the build have ended",
        lambda: not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children),
    )
    (results / "gate").touch()
    assert build(folder, results).built == ("first", "second")
    undisturbed = tmp_path / "undisturbed"
    undisturbed.mkdir()
    for file in ("gate", ".build.lock"):
        (undisturbed / file).touch()
    build(folder, undisturbed)
    assert contents(results) == contents(undisturbed)


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_an_interrupted_build_ends_its_workers_and_prints_a_message(
    stuck: subprocess.Popen[str], results: Path, number: int, code: int, word: str
) -> None:
    children = psutil.Process(stuck.pid).children(recursive=True)
    stuck.send_signal(number)
    output, _ = stuck.communicate(timeout=PATIENCE)
    assert stuck.returncode == code
    assert output.splitlines()[-1] == f"brdfpipe: {word}; the same command resumes"
    wait_until(
        "all processes of the build have ended",
        lambda: not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children),
    )
    assert not list((results / "failures").glob("*"))


def test_only_what_a_build_left_is_cleaned_up(folder: Path, results: Path) -> None:
    build_catalogue(folder, results, cores=1)
    own = [results / "failures" / "notes.txt", results / "first" / ".draft.tmp"]
    left = results / "first" / ".facets.nc.4711.tmp"
    for path in (*own, left):
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    build_catalogue(folder, results, cores=1)
    assert all(path.exists() for path in own)
    assert not left.exists()

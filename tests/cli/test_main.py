"""The command line: its output and its exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import pytest
import xarray as xr
from click.testing import CliRunner, Result

from brdfpipe.cli import main as cli
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.jobs.index import Index
from brdfpipe.jobs.summary import Summary
from brdfpipe.releases.causes import Cause
from brdfpipe.releases.differences import Difference
from brdfpipe.releases.metadata import METADATA

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli.main, [str(argument) for argument in arguments])


def write(folder: Path, name: str, text: str = COLOUR) -> None:
    (folder / name).mkdir(parents=True)
    (folder / name / "material.yaml").write_text(text)


def test_the_version_is_that_of_the_package() -> None:
    assert version("brdfpipe") in run("--version").output


def test_check_prints_a_line_for_each_material(tmp_path: Path) -> None:
    write(tmp_path, "good")
    write(tmp_path, "bad", "spectrm: 1\n")
    done = run("check", tmp_path)
    assert done.exit_code == 1
    bad, good, count = done.output.splitlines()
    assert bad.startswith("bad: material.yaml, line 1: unknown key 'spectrm'; did you mean 'spectrum'?")
    assert good == "good: ok (spectrum L*a*b*)"
    assert count == "1 ok, 1 wrong"


def test_check_names_exports_that_a_build_will_refuse(tmp_path: Path) -> None:
    lay = "surface: {file: scan.csv, unit: um, pitch: 1, isotropic: false}\nindex: 1.5\n"
    write(tmp_path, "brushed", lay + "exports: [klems, gltf]\n")
    (tmp_path / "brushed" / "scan.csv").write_text("0,1\n1,0\n")
    done, as_json = run("check", tmp_path), run("check", tmp_path, "--json")
    assert done.exit_code == as_json.exit_code == 1
    (reason,) = json.loads(as_json.stdout)["refused_exports"]["brushed"].values()
    assert f"  export gltf will not be written: {reason}; change `exports`" in done.output.splitlines()
    assert done.output.endswith("1 ok, 0 wrong, 1 export refused\n")


def test_the_shipped_scenes_are_listed() -> None:
    lines = run("scenes").output.splitlines()
    assert lines[0].startswith("catalogue: ")
    assert any(line.startswith("gloss-sheet: ") and line.endswith("(gloss, haze)") for line in lines)
    assert Path(lines[-1].removeprefix("Their files are in ").partition(";")[0], "gloss-sheet.yaml").is_file()


def test_check_verify_scenes_and_formats_print_json_for_scripts(tmp_path: Path) -> None:
    write(tmp_path / "catalogue", "good")
    write(tmp_path / "catalogue", "bad", "spectrm: 1\n")
    done = run("check", tmp_path / "catalogue", "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 1
    assert found["ok"] == {"good": "ok (spectrum L*a*b*)"}
    assert found["wrong"]["bad"][0].startswith("material.yaml, line 1: unknown key 'spectrm'")
    assert json.loads(run("scenes", "--json").stdout)["gloss-sheet"]["results"] == ["gloss", "haze"]
    formats = json.loads(run("formats", "--json").stdout)
    assert formats.keys() == set(FORMATS)
    assert all(one["description"] for one in formats.values())
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(METADATA, '{"@graph": []}')
        archive.writestr("a\x1b[2J\u202e", "")
    damaged = run("verify", tmp_path / "a.zip", "--json")
    assert damaged.exit_code == 1
    assert json.loads(damaged.stdout)["problems"] == ["a\x1b[2J\u202e: is not in the metadata"]
    assert damaged.stdout.isascii()


def test_check_refuses_a_scene_that_cannot_be_used(tmp_path: Path) -> None:
    write(tmp_path, "m")
    assert run("check", tmp_path, "--scene", "gloss-sheet").exit_code == 0
    done = run("check", tmp_path, "--scene", "glosssheet")
    assert done.exit_code == 2
    (tmp_path / "mine.yaml").write_text("purpose: a test\n")
    done = run("check", tmp_path, "--scene", tmp_path / "mine.yaml")
    assert done.exit_code == 2
    assert "mine.yaml" in done.output


def test_check_lists_every_mistake_of_a_scene(tmp_path: Path) -> None:
    write(tmp_path, "plain")
    write(tmp_path, "own", f"{COLOUR}scene: mine.yaml\n")
    scene = tmp_path / "own" / "mine.yaml"
    scene.write_text("purpose: a test\nresults: [glos]\nmetric: gloss\ntolerance: 0\n")
    given = run("check", tmp_path, "--scene", scene)
    assert given.exit_code == 2
    first, *others = given.stderr.splitlines()
    assert first.startswith("brdfpipe: mine.yaml")
    assert len(others) == 2
    assert all(line.startswith("  also mine.yaml") for line in others)
    named = run("check", tmp_path)
    assert named.exit_code == 1
    for mistake in ("domain", "glos", "tolerance"):
        assert mistake in given.stderr
        assert mistake in named.output


def test_check_covers_formats(tmp_path: Path) -> None:
    write(tmp_path, "m", "surface: {file: a.abc}\nindex: PP\n")
    (tmp_path / "m" / "a.abc").write_text("x")
    done = run("check", tmp_path)
    assert done.exit_code == 1
    assert "unknown file extension; found .abc" in done.output


def test_check_names_each_material_whose_reader_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    write(tmp_path, "plain", "surface: {file: a.x3p}\nindex: PP\n")
    write(tmp_path, "scanned", "surface: {file: a.opd, scans: [{file: b.opd}]}\nindex: PP\n")
    for path in ("plain/a.x3p", "scanned/a.opd", "scanned/b.opd"):
        (tmp_path / path).write_text("x")
    done = run("check", tmp_path)
    assert done.exit_code == 1
    plain, scanned, count = done.output.splitlines()
    assert plain.startswith("plain: ok")
    assert scanned.startswith("scanned: a.opd: this format is read by SurfaceTopography, which is not installed")
    assert "pip install 'brdfpipe[instruments]'" in scanned
    assert count == "1 ok, 1 wrong"


def test_check_of_a_good_catalogue_exits_with_0_whatever_it_ignores(tmp_path: Path) -> None:
    write(tmp_path, "good")
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "material.yml").touch()
    done = run("check", tmp_path)
    assert done.exit_code == 0
    assert done.output.splitlines()[1:] == [
        "odd: ignored: material.yml is not read; rename it to material.yaml",
        "1 ok, 0 wrong",
    ]


@pytest.mark.parametrize("command", ["check", "build"])
def test_a_missing_catalogue_is_one_line_and_exit_2(tmp_path: Path, command: str) -> None:
    done = run(command, tmp_path / "none")
    assert done.exit_code == 2
    assert done.stderr == f"brdfpipe: {tmp_path / 'none'}: no such folder\n"


def test_a_wrong_configuration_is_one_line_and_exit_2(tmp_path: Path) -> None:
    write(tmp_path / "catalogue", "good")
    (tmp_path / "own.yaml").write_text("observer: 5\n")
    done = run("build", tmp_path / "catalogue", "--config", tmp_path / "own.yaml", "--results", tmp_path / "results")
    assert done.exit_code == 2
    assert done.stderr == "brdfpipe: own.yaml, line 1, observer: not an accepted value; found 5; accepted: 10, 2\n"
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("arguments", [["build"], ["build", ".", "--cores", "0"], ["rebuild"]])
def test_wrong_usage_exits_with_2(arguments: list[str]) -> None:
    assert run(*arguments).exit_code == 2


def test_new_starts_a_material_that_check_asks_to_fill_in(tmp_path: Path) -> None:
    done = run("new", "fresh", "--folder", tmp_path)
    assert done.exit_code == 0
    assert "fresh/material.yaml" in done.output
    checked = run("check", tmp_path)
    assert checked.exit_code == 1
    assert "nothing to build from; accepted: at least one of `surface`, `spectrum`" in checked.output


def test_new_starts_a_material_in_the_present_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("new", "fresh").exit_code == 0
    assert (tmp_path / "fresh" / "material.yaml").is_file()


def test_new_refuses_an_existing_material(tmp_path: Path) -> None:
    run("new", "fresh", "--folder", tmp_path)
    before = (tmp_path / "fresh" / "material.yaml").read_text()
    done = run("new", "fresh", "--folder", tmp_path)
    assert (done.exit_code, "already exists" in done.stderr) == (2, True)
    assert (tmp_path / "fresh" / "material.yaml").read_text() == before


@pytest.mark.parametrize("name", ["a b", "../up", "logs", ""])
def test_new_refuses_an_invalid_name(tmp_path: Path, name: str) -> None:
    done = run("new", name, "--folder", tmp_path)
    assert done.exit_code == 2
    assert done.stderr.startswith(f"brdfpipe: the name {name!r}: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("failures", "code"), [({}, 0), ({"m": "surface: no"}, 1)])
def test_build_prints_a_summary_and_fails_if_a_material_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failures: Mapping[str, str], code: int
) -> None:
    summary = Summary(("a",), ("b",), failures, 12, tmp_path / "index.html", 3.2)
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    done = run("build", tmp_path)
    assert done.exit_code == code
    assert done.output.splitlines()[0].startswith(
        f"{2 + len(failures)} materials: 1 built, 1 up to date, {len(failures)} not built"
    )
    assert done.output.splitlines()[-1] == f"Open {tmp_path / 'index.html'}"


def test_a_verdict_is_printed_with_its_material_and_does_not_change_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    verdicts, faults = {"a": "fail", "b": "warn", "c": "pass"}, {"a": "energy: reflects at most 1.039 of the light"}
    page = tmp_path / "index.html"
    pages = {"a": tmp_path / "a" / "report.html"}
    summary = Summary(
        ("a", "b"), ("c",), {}, 3, page, 3.2, verdicts=verdicts, fail_reasons=faults, pages=pages, notices=("note",)
    )
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    done = run("build", tmp_path)
    assert done.exit_code == 0
    assert done.output.splitlines()[1:] == [
        "Verdicts of the checks: 1 fail, 1 warn; the reports say why",
        f"  a: verdict fail: energy: reflects at most 1.039 of the light ({tmp_path / 'a' / 'report.html'})",
        "note",
        f"Open {page}",
    ]


def test_an_error_of_the_operating_system_is_one_line_and_exit_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*given: object, **named: object) -> None:
        raise PermissionError(13, "Permission denied", "results/logs")

    monkeypatch.setattr("brdfpipe.jobs.build.build", refused)
    done = run("build", tmp_path)
    assert (done.exit_code, done.stderr) == (2, "brdfpipe: results/logs: Permission denied\n")


def test_a_profile_is_refused_with_the_command_for_clusters(tmp_path: Path) -> None:
    done = run("build", tmp_path, "--profile", "workflow/profiles/slurm")
    assert done.exit_code == 2
    assert "`snakemake --profile workflow/profiles/slurm --config catalogue=" in done.stderr


def test_an_interrupt_exits_with_130(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*given: object, **named: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("brdfpipe.jobs.build.build", interrupted)
    done = run("build", tmp_path)
    assert (done.exit_code, done.stderr) == (130, "brdfpipe: interrupted; the same command resumes\n")


def test_diff_prints_lines_or_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [Difference("black", "", "added")]
    monkeypatch.setattr("brdfpipe.releases.differences.read_releases", lambda folder: {})
    monkeypatch.setattr("brdfpipe.releases.differences.differences", lambda old, new: found)
    assert run("diff", tmp_path, tmp_path).output.splitlines()[1] == "  black: added"
    (entry,) = json.loads(run("diff", "--json", tmp_path, tmp_path).output)
    assert entry["material"] == "black"


def test_texts_of_files_show_their_hidden_characters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hidden, shown = "a\x9b2J\u202e", r"a\x9b2J\u202e"
    found = [Difference("black", "", "changed", causes=(Cause("key", "bsdf", hidden),))]
    monkeypatch.setattr("brdfpipe.releases.differences.read_releases", lambda folder: {})
    monkeypatch.setattr("brdfpipe.releases.differences.differences", lambda old, new: found)
    assert run("diff", tmp_path, tmp_path).output.splitlines()[-1].endswith(shown)
    summary = Summary(
        ("a",), (), {}, 3, tmp_path / "index.html", 3.2, verdicts={"a": "fail"}, fail_reasons={"a": hidden}
    )
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    assert f"  a: verdict fail: {shown}" in run("build", tmp_path).output.splitlines()
    assert (
        run("build", tmp_path, "--notify", f"/{hidden}").output.splitlines()[-1].endswith("No such file or directory")
    )
    assert shown in run("build", tmp_path, "--notify", f"/{hidden}").output.splitlines()[-1]


def test_diff_of_a_folder_without_results_is_one_line_and_exit_2(tmp_path: Path) -> None:
    done = run("diff", tmp_path, tmp_path)
    assert done.exit_code == 2
    assert "no results of a catalogue" in done.output


@pytest.mark.parametrize(
    ("verdicts", "fail_on", "code"),
    [
        ({"a": "warn"}, None, 0),
        ({"a": "fail"}, None, 0),
        ({"a": "pass"}, "warn", 0),
        ({"a": "warn"}, "warn", 1),
        ({"a": "warn"}, "fail", 0),
        ({"a": "fail", "b": "pass"}, "fail", 1),
        ({"a": "fail"}, "warn", 1),
        ({}, "warn", 0),
        ({"a": "warn"}, "budget", 0),
    ],
)
def test_verdicts_change_the_exit_code_on_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verdicts: dict[str, str], fail_on: str | None, code: int
) -> None:
    summary = Summary(("a",), (), {}, 3, tmp_path / "index.html", 3.2, verdicts=verdicts)
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    assert run("build", tmp_path, *(["--fail-on", fail_on] if fail_on else [])).exit_code == code


@pytest.mark.parametrize(("fail_on", "code"), [((), 0), (("fail",), 0), (("budget",), 1), (("fail", "budget"), 1)])
def test_a_material_over_its_budget_changes_the_exit_code_on_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fail_on: tuple[str, ...], code: int
) -> None:
    over = (("a", "took 9.0 s; the budget of the scene mine is 2 s"),)
    summary = Summary(("a",), (), {}, 3, tmp_path / "index.html", 3.2, verdicts={"a": "pass"}, over_budget=over)
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    done = run("build", tmp_path, *(word for condition in fail_on for word in ("--fail-on", condition)))
    assert done.exit_code == code
    assert "a: took 9.0 s" in done.output


def test_the_summary_is_printed_as_json_and_given_to_the_notification(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = Summary(("a",), (), {"b": "no file"}, 3, tmp_path / "index.html", 3.2, verdicts={"a": "pass"})
    monkeypatch.setattr("brdfpipe.jobs.build.build", lambda *given, **named: summary)
    given: list[tuple[str, str]] = []
    monkeypatch.setattr("brdfpipe.jobs.notification.notify", lambda command, text: given.append((command, text)))
    done = run("build", tmp_path, "--json", "--notify", "mail lab")
    plain = json.loads(done.output)
    assert (plain["built"], plain["failures"], plain["page"]) == (["a"], {"b": "no file"}, str(tmp_path / "index.html"))
    assert done.exit_code == 1
    ((command, text),) = given
    assert command == "mail lab"
    assert json.loads(text) == plain


def test_prune_lists_and_deletes_what_left(tmp_path: Path) -> None:
    write(tmp_path / "catalogue", "a")
    (tmp_path / "results" / ".snakemake").mkdir(parents=True)
    for name in ("a", "left"):
        (tmp_path / "results" / name).mkdir()
        xr.Dataset(attrs={"material": name}).to_netcdf(tmp_path / "results" / name / "bsdf.nc")
    assert run("prune", tmp_path / "catalogue", "--results", tmp_path / "mistyped").exit_code == 2
    assert not (tmp_path / "mistyped").exists()
    listed = run("prune", tmp_path / "catalogue", "--results", tmp_path / "results", "--dry-run")
    assert listed.output.splitlines() == ["left", "1 folders and files would be deleted, 0.0 MB"]
    assert (tmp_path / "results" / "left").exists()
    run("prune", tmp_path / "catalogue", "--results", tmp_path / "results")
    assert [path.name for path in (tmp_path / "results").glob("[!.]*")] == ["a"]


def test_verify_shows_hidden_characters(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(METADATA, '{"@graph": []}')
        archive.writestr("a\x1b[2J", "")
    assert run("verify", tmp_path / "a.zip").output.splitlines()[0] == r"a\x1b[2J: is not in the metadata"


def test_verify_exits_with_1_where_a_file_changed(tmp_path: Path) -> None:
    index = Index(tmp_path)
    (tmp_path / "a.nc").write_text("1")
    index.finish("p", "c", (), ["a.nc"])
    assert run("verify", tmp_path).exit_code == 0
    (tmp_path / "a.nc").write_text("2")
    done = run("verify", tmp_path)
    assert done.exit_code == 1
    assert done.output.splitlines()[-1] == f"{tmp_path}: 1 problem"
    assert run("verify", tmp_path / "a.nc").exit_code == 2


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["show", "/nope"], "invalid value for 'PATH': Path '/nope' does not exist; see `"),
        (["nonsense"], "no such command 'nonsense'; see `"),
        (["build", "--cores", "0", "x"], "invalid value for '--cores': 0 is not in the range x>=1; see `"),
        (["rig", "scan"], "missing argument"),
    ],
)
def test_errors_of_usage_have_the_voice_of_all_others(words: list[str], found: str) -> None:
    done = run(*words)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"brdfpipe: {found}")
    assert done.stderr.count("\n") == 1


def test_a_group_without_a_command_lists_its_commands() -> None:
    done = run("rig")
    assert done.exit_code == 2
    assert "emulate" in done.stderr


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "brdfpipe", "--version"], capture_output=True, text=True, check=True)
    assert version("brdfpipe") in done.stdout

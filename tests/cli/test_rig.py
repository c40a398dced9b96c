"""The commands of a rig: output, exit codes, and an emulated rig in its own process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import small_rig
from click.testing import CliRunner

import brdfpipe
from brdfpipe.cli import main as cli
from brdfpipe.cli import rig as commands
from brdfpipe.rig.acquisition.devices.errors import DeviceLost
from brdfpipe.rig.description import Rig
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Plan
from brdfpipe.store import save_dataset

TEXT = small_rig.PLAN.replace("[500, 550]", "[500]") + "runs: [sample]\nbad_frames: accept\n"


def run(*arguments, **options):
    return CliRunner().invoke(cli.main, ["rig", *map(str, arguments)], **options)


@pytest.fixture
def plan(tmp_path):
    return small_rig.write(tmp_path / "bench", TEXT)


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    """The folder of results of a material: a matt white tile."""
    folder = tmp_path_factory.mktemp("tile")
    save_dataset(small_rig.truth(), folder / "bsdf.nc", stage="truth", material="tile")
    return folder


@pytest.fixture
def bench(monkeypatch):
    """Devices without serial lines, for any ports."""
    parts = small_rig.fake_bench(), []
    monkeypatch.setattr(
        "brdfpipe.rig.acquisition.devices.connection.connect", lambda rig: parts[1].append(rig) or nullcontext(parts[0])
    )
    return parts


def test_help_loads_no_device_and_no_dataset():
    result = subprocess.run(
        [sys.executable, "-c", "import sys, brdfpipe.cli.main; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "brdfpipe.cli.rig" in result.stdout.split()
    assert not {"numpy", "xarray", "serial", "astropy", "pydantic"} & set(result.stdout.split())


def test_new_starts_a_rig_and_names_the_next_steps(tmp_path):
    result = run("new", tmp_path / "bench", "--fibres", 20)
    assert result.exit_code == 0
    for words in ("rig doctor", "rig scan", "--dry-run", "rig.yaml", "plan.yaml"):
        assert words in result.output
    assert len(Plan.load(tmp_path / "bench" / "plan.yaml").rig.fibres) == 20
    again = run("new", tmp_path / "bench")
    assert again.exit_code == 2
    assert "the file exists already" in again.output


def test_a_dry_run_estimates_the_scan_and_changes_nothing(plan, monkeypatch):
    monkeypatch.setattr("brdfpipe.rig.acquisition.devices.connection.connect", lambda *arguments, **options: 1 / 0)
    before = sorted(plan.parent.iterdir())
    result = run("scan", plan, "--dry-run")
    assert result.exit_code == 0
    assert result.output.startswith("tile on small: 14 frames, ")
    assert "warning: the bracket covers" in result.output
    assert sorted(plan.parent.iterdir()) == before


@pytest.mark.parametrize("suffix", ["", "bsdf.nc"])
def test_a_scan_of_an_emulated_rig_is_a_run(plan, tile, suffix):
    result = run("scan", plan, "--emulate", tile / suffix)
    assert result.exit_code == 0, result.output
    folder = plan.parent / "runs" / "tile"
    assert result.output.splitlines()[-1] == f"14 frames in {folder}, 14 of them taken now"
    frames = read_run(folder)
    assert frames.sizes["frame"] == 14
    assert frames.attrs["camera"].startswith("emulated camera")


def test_seed_and_session_determine_the_noise(plan, tile, tmp_path):
    for name, seed, day in [("a", 1, 0), ("b", 1, 0), ("c", 2, 0), ("d", 1, 1)]:
        result = run("scan", plan, "--emulate", tile, "--seed", seed, "--session", day, "--out", tmp_path / name)
        assert result.exit_code == 0
    one, same, other, next_day = (small_rig.contents(tmp_path / name) for name in "abcd")
    assert one == same
    assert all(one[name] != other[name] and one[name] != next_day[name] for name in one)


def test_a_run_does_not_continue_with_another_emulated_rig(plan, tile, tmp_path):
    arguments = ("scan", plan, "--emulate", tile, "--out", tmp_path / "run", "--resume")
    assert run(*arguments).exit_code == 0
    next((tmp_path / "run" / "frames").glob("*.fits")).unlink()
    result = run(*arguments, "--seed", 4)
    assert result.exit_code == 2
    assert "holds a run of another rig; found emulator, seed 0, session 0; accepted: emulator, seed 4" in result.output
    assert run(*arguments).exit_code == 0


def test_a_run_continues_with_resume(plan, tile, tmp_path):
    arguments = ("scan", plan, "--emulate", tile, "--out", tmp_path / "run")
    assert run(*arguments).exit_code == 0
    whole = small_rig.contents(tmp_path / "run")
    for path in sorted((tmp_path / "run" / "frames").iterdir())[9:]:
        path.unlink()
    refused = run(*arguments)
    assert refused.exit_code == 2
    assert "holds a run of this plan already; found 9 of 14 frames; accepted: --resume" in refused.output
    resumed = run(*arguments, "--resume")
    assert resumed.exit_code == 0
    assert "5 of them taken now" in resumed.output
    assert small_rig.contents(tmp_path / "run") == whole


def test_a_material_that_is_not_built_is_refused_as_truth(plan, tmp_path):
    (tmp_path / "material.yaml").write_text("spectrum: {lab: [50, 0, 0]}")
    result = run("scan", plan, "--emulate", tmp_path)
    assert result.exit_code == 2
    assert "a folder without a built material" in result.output
    assert "brdfpipe build" in result.output


def test_a_file_that_is_not_a_bsdf_is_refused_as_truth(plan, tmp_path):
    (tmp_path / "x.nc").write_text("x")
    result = run("scan", plan, "--emulate", tmp_path / "x.nc")
    assert result.exit_code == 2
    assert "x.nc" in result.output


def test_a_wrong_plan_is_refused_in_one_line(plan):
    plan.write_text(TEXT.replace("[20]", "[21]"))
    result = run("scan", plan)
    assert result.exit_code == 2
    assert result.output == "brdfpipe: plan.yaml, line 3, incidences: the rig has no such entrance; found 21; accepted: 0, 10, 20, 45 (`entrances` of the rig)\n"  # fmt: skip


def test_missing_devices_are_reported(plan):
    result = run("scan", plan, "--yes")
    assert result.exit_code == 2
    assert "monochromator on /dev/ttyUSB0: the port does not exist" in result.output
    assert not (plan.parent / "runs").exists()


def test_the_operator_is_asked_and_may_refuse(plan, bench):
    result = run("scan", plan, input="n\n")
    assert result.exit_code == 1
    assert "tile in the holder, at 20 degree, for reflection. Done? [Y/n]" in result.output
    assert "not confirmed" in result.output
    assert "--resume" in result.output
    assert run("scan", plan, "--resume", input="\n").exit_code == 0


def test_yes_asks_nothing(plan, bench):
    result = run("scan", plan, "--yes", input="")
    assert result.exit_code == 0
    assert "Done?" not in result.output


def test_the_folder_of_a_camera_is_relative_to_the_description(plan, bench, monkeypatch):
    monkeypatch.chdir("/")
    assert run("scan", plan, "--yes").exit_code == 0
    assert bench[1][0].camera.folder == str(plan.parent.resolve() / "camera")


def test_a_stopped_scan_exits_with_1_and_says_how_to_continue(plan, bench):
    bench[0].camera.before = small_rig.failing({4}, DeviceLost("camera", "gone"))
    result = run("scan", plan, "--yes")
    assert result.exit_code == 1
    assert result.output.startswith("brdfpipe: scan stopped before frame 4 of 14: camera: gone; 3 frames are safe in ")
    assert run("scan", plan, "--yes", "--resume").exit_code == 0


def test_an_interrupted_scan_exits_with_130_and_says_how_to_continue(plan, bench):
    bench[0].camera.before = small_rig.failing({4}, KeyboardInterrupt())
    result = run("scan", plan, "--yes")
    assert result.exit_code == 130
    assert "interrupted; finished frames are safe in" in result.output
    assert "--resume" in result.output


def test_warnings_of_a_scan_are_printed(tmp_path, monkeypatch, tile):
    text = TEXT.replace("[{exposure: 1, position: 2}, {exposure: 1, position: 1}]", "[{exposure: 3, position: 2}, {exposure: 3, position: 1}]")  # fmt: skip
    plan = small_rig.write(tmp_path / "bench", text)
    from brdfpipe.rig.emulator.emulated_rig import EmulatedRig

    def elsewhere(rig, *arguments, **options):
        return EmulatedRig(replace(rig, nd_location="reference"), *arguments, **options)

    monkeypatch.setattr("brdfpipe.rig.emulator.emulated_scan.EmulatedRig", elsewhere)
    result = run("scan", plan, "--emulate", tile)
    assert result.exit_code == 0
    assert "warning: wrong `nd_location: sample`" in result.output


def test_the_doctor_exits_with_1_if_a_device_fails(plan):
    result = run("doctor", plan.with_name("rig.yaml"))
    assert result.exit_code == 1
    assert "FAIL" in result.output
    assert "the port does not exist" in result.output


# --- an emulated rig in its own process


PATIENCE = 600.0
"""Seconds to wait for another process: only a broken program needs as long, on however busy a machine."""

MAIN = """
import signal
# A test run started in the background ignores SIGINT, and so would every process it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
from brdfpipe.cli.main import main
main()
"""


@pytest.fixture
def emulated_process(plan, tile):
    """``brdfpipe rig emulate`` in its own process, and the description it wrote."""
    description = plan.with_name("rig.yaml")
    paths = [str(Path(brdfpipe.__file__).parents[1])]
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "rig", "emulate", str(description), "--truth", str(tile)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONUNBUFFERED": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    description = plan.with_name("emulated.yaml")
    assert "Emulated rig ready: " in process.stdout.readline()
    assert "Type each arrangement" in process.stdout.readline()
    yield process, description
    if process.poll() is None:
        process.kill()
    process.communicate()


def typed(process, line):
    process.stdin.write(line + "\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


def test_an_emulated_rig_is_scanned_like_a_real_one(emulated_process, plan):
    process, description = emulated_process
    rig = Rig.load(description)
    assert rig.digest == Rig.load(plan.with_name("rig.yaml")).digest
    examined = run("doctor", description)
    assert examined.exit_code == 0, examined.output
    assert typed(process, "20") == "20 degree, sample, reflection"
    plan.write_text(plan.read_text().replace("rig: rig.yaml", "rig: emulated.yaml"))
    result = run("scan", plan, "--yes")
    assert result.exit_code == 0, result.output
    frames = read_run(plan.parent / "runs" / "tile")
    assert frames.sizes["frame"] == 14
    lights = frames.isel(frame=frames["purpose"].values == "sample")
    darks = frames.isel(frame=frames["purpose"].values == "dark")
    assert lights["counts"].mean() > darks["counts"].mean() + 10
    process.send_signal(signal.SIGINT)
    assert "Emulated rig stopped" in process.communicate(timeout=PATIENCE)[0]
    assert process.returncode == 0
    assert not description.exists()


def test_impossible_arrangements_are_refused(emulated_process):
    process, _ = emulated_process
    assert "no entrance at 33 degree; accepted: 0, 10, 20, 45" in typed(process, "33")
    assert "unknown object 'cat' in the holder" in typed(process, "20 cat")
    assert "not an angle of incidence; found 'etalon'" in typed(process, "etalon")
    assert typed(process, "10 etalon") == "10 degree, etalon, reflection"
    assert typed(process, "20 sample transmission") == "20 degree, sample, transmission"


def test_the_emulated_rig_runs_without_a_keyboard(emulated_process):
    process, description = emulated_process
    process.stdin.close()
    time.sleep(0.2)
    assert process.poll() is None
    assert description.exists()
    process.stdin = None
    process.send_signal(signal.SIGINT)
    assert "Emulated rig stopped" in process.communicate(timeout=PATIENCE)[0]
    assert not description.exists()


def test_a_foreign_description_is_not_overwritten(plan, tile):
    plan.with_name("emulated.yaml").write_text("name: mine\n")
    result = run("emulate", plan.with_name("rig.yaml"), "--truth", tile)
    assert result.exit_code == 2
    assert "exists already and does not belong to an emulated rig" in result.output
    assert plan.with_name("emulated.yaml").read_text() == "name: mine\n"


def test_an_emulated_rig_in_another_folder_copies_its_fibres(plan, tile, tmp_path, monkeypatch):
    descriptions = []

    def hands(stand):
        descriptions.append(Rig.load(tmp_path / "stand" / "emulated.yaml"))
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "_apply_typed_arrangements", hands)
    result = run("emulate", plan.with_name("rig.yaml"), "--truth", tile, "--out", tmp_path / "stand")
    assert result.exit_code == 0, result.output
    assert [fibre.name for fibre in descriptions[0].fibres] == ["A", "B", "C", "D"]
    assert descriptions[0].camera.folder == str(tmp_path / "stand" / "emulated-camera")
    assert sorted(path.name for path in (tmp_path / "stand").iterdir()) == ["emulated-camera", "fibres.csv"]


def test_an_interrupt_at_the_question_interrupts_the_scan(plan, bench):
    result = run("scan", plan, input="")  # the prompt takes the end of the input for an interrupt
    assert result.exit_code == 130
    assert "continue with --resume" in result.output

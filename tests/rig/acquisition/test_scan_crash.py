"""kill −9 at random moments of a scan, then --resume: the finished run equals an undisturbed one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import small_rig

import brdfpipe
from brdfpipe.bsdf.registry import representation
from brdfpipe.rig.acquisition import journal
from brdfpipe.rig.emulator.emulated_scan import scan_emulated
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Plan
from brdfpipe.store import open_dataset, save_dataset

PLAN = small_rig.PLAN.replace("[500, 550]", "[480, 500, 520, 540, 560]").replace("every: 4", "every: 7")

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked and killed")


def environment(folder):
    """Environment of a subprocess; its temporary files are in a folder of the test."""
    (folder / "temporary").mkdir(exist_ok=True)
    paths = [str(Path(small_rig.__file__).parent), str(Path(brdfpipe.__file__).parents[1])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(folder / "temporary")}


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return Plan.load(small_rig.write(tmp_path_factory.mktemp("bench"), PLAN))


@pytest.fixture(scope="module")
def undisturbed(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    with small_rig.emulated(plan) as (stand, witness):
        small_rig.take_emulated(plan, folder, stand, witness)
    return small_rig.contents(folder)


def check(plan, folder, undisturbed):
    assert small_rig.contents(folder) == undisturbed
    assert not list(folder.glob("**/.*.tmp"))
    events = journal.read(folder / "journal.jsonl")
    recorded = Counter(event["shot"] for event in events if event["event"] in ("frame", "adopted"))
    assert recorded == Counter(shot.ordinal for shot in plan.shots)
    assert not any(event["event"] in ("damaged", "retry") for event in events)
    assert events[-1]["event"] == "finished"
    assert read_run(folder).sizes["frame"] == len(plan.shots)


def killed(plan, folder, kills, seed, undisturbed):
    """Result of killed_scan.py: frames at each kill, and folders of the finished runs, which are checked."""
    program = Path(small_rig.__file__).with_name("killed_scan.py")
    arguments = [sys.executable, str(program), str(plan.path), str(folder), str(kills), str(seed)]
    done = subprocess.run(arguments, env=environment(folder), capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert len(result["moments"]) == kills
    for run in result["finished"]:
        check(plan, Path(run), undisturbed)
    return result


def test_a_scan_killed_at_random_moments_and_resumed_is_the_undisturbed_one(plan, undisturbed, tmp_path):
    killed(plan, tmp_path, 3, 1, undisturbed)


@pytest.mark.slow
def test_a_scan_killed_at_a_hundred_random_moments_and_resumed_is_the_undisturbed_one(plan, undisturbed, tmp_path):
    result = killed(plan, tmp_path, 100, 2, undisturbed)
    assert len(set(result["moments"])) > 20


BLOCKED = """
import signal
from brdfpipe.cli.main import main
from brdfpipe.rig.emulator.emulated_rig import EmulatedCamera

expose = EmulatedCamera.expose

def expose_or_wait(camera, *arguments, **options):
    if camera.frames == 14:
        print("blocked", flush=True)
        signal.pause()
    return expose(camera, *arguments, **options)

EmulatedCamera.expose = expose_or_wait
main()
"""
"""The command line, with an emulated camera that never returns its 15th exposure."""


def test_the_command_killed_and_called_again_finishes_the_run(tmp_path):
    plan = Plan.load(small_rig.write(tmp_path / "bench"))
    save_dataset(small_rig.truth(), tmp_path / "truth.nc", stage="truth", material="tile")
    run, undisturbed = tmp_path / "run", tmp_path / "undisturbed"
    arguments = [
        "rig",
        "scan",
        str(plan.path),
        "--emulate",
        str(tmp_path / "truth.nc"),
        "--seed",
        "3",
        "--out",
        str(run),
    ]
    options = {"env": environment(tmp_path), "text": True}
    command = [sys.executable, "-c", BLOCKED, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, **options) as first:
        assert first.stdout.readline() == "blocked\n"
        first.send_signal(signal.SIGKILL)
    assert len(list((run / "frames").glob("*.fits"))) == 14
    command = [sys.executable, "-m", "brdfpipe.cli", *arguments, "--resume"]
    second = subprocess.run(command, capture_output=True, timeout=1800, **options)
    assert second.returncode == 0, second.stderr
    assert "Traceback" not in second.stderr
    scan_emulated(plan, undisturbed, representation(open_dataset(tmp_path / "truth.nc")), seed=3)
    check(plan, run, small_rig.contents(undisturbed))

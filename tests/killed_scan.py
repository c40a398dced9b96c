"""A program that kills scans of the emulated rig at random moments and resumes them: ``killed_scan.py PLAN FOLDER KILLS SEED``.

It is a program of its own because it forks: each scan is a process that has everything imported already.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import small_rig

from brdfpipe.rig.acquisition.devices import serial_line
from brdfpipe.rig.frame_file import read_frame
from brdfpipe.rig.plan import Plan


def scan(plan: Plan, folder: Path) -> None:
    with small_rig.emulated(plan, folder=folder) as (rig, camera):
        small_rig.take_emulated(plan, folder, rig, camera, resume=True)


def start_scan(plan: Plan, folder: Path) -> int:
    """Start a scan in a process of its own, which continues where the one before was killed; return its process ID."""
    sys.stdout.flush()
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        # A test run in the background ignores SIGINT, and so would this process.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        scan(plan, folder)
        code = 0
    finally:
        os._exit(code)


def wait(process: int, folder: Path, generator: random.Random) -> bool:
    """Wait for a random moment of a scan: while it opens its devices and reads the folder, or soon after a frame; whether it still runs."""
    frames = generator.randint(1, 3) + count(folder)
    end = time.monotonic() + (generator.uniform(0, 0.6) if generator.random() < 0.3 else 60.0)
    while time.monotonic() < end and count(folder) < frames:
        if os.waitpid(process, os.WNOHANG)[0]:
            return False
        time.sleep(0.0003)
    time.sleep(generator.uniform(0, 0.015))
    return not os.waitpid(process, os.WNOHANG)[0]


def count(folder: Path) -> int:
    try:
        return sum(not name.startswith(".") for name in os.listdir(folder / "frames"))  # noqa: PTH208 - as quick as can be
    except FileNotFoundError:
        return 0


def check(plan: Plan, folder: Path) -> int:
    """Read every file with the name of a frame: each must be complete; return their number."""
    shots = [shot for shot in plan.shots if (folder / "frames" / shot.name).exists()]
    for shot in shots:
        read_frame(folder / "frames" / shot.name, shot, plan)
    assert len(shots) == count(folder)
    return len(shots)


def main(plan_file: str, folder: str, kills: int, seed: int) -> None:
    plan, generator = Plan.load(plan_file), random.Random(seed)
    serial_line.QUIET, serial_line.POLL = 0.02, 0.01
    os.fsync = lambda file: None  # a killed process loses nothing it has written
    undisturbed = Path(folder, "undisturbed")
    scan(plan, undisturbed)  # imports all that a scan needs, once for all processes
    run, moments, finished = 0, [], [str(undisturbed)]
    while len(moments) < kills or count(Path(folder, str(run))):
        run_folder = Path(folder, str(run))
        process = start_scan(plan, run_folder)
        running = wait(process, run_folder, generator) if len(moments) < kills else True
        if len(moments) < kills and running:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            moments.append(check(plan, run_folder))
        else:
            if running:
                assert os.waitpid(process, 0)[1] == 0
            finished.append(str(run_folder))
            run += 1
    print(json.dumps({"moments": moments, "finished": finished}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))

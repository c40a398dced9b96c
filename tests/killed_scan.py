"""A program that has scans of the emulated rig killed at random moments, and resumes them: ``killed_scan.py PLAN FOLDER KILLS SEED``.

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


def scan(plan: Plan, folder: Path) -> int:
    """A scan in a process of its own, which goes on where the one before was killed; its number."""
    sys.stdout.flush()
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        serial_line.QUIET, serial_line.POLL = 0.02, 0.01
        os.fsync = lambda file: None  # a killed process loses nothing it has written
        with small_rig.emulated(plan, folder=folder) as (stand, witness):
            small_rig.take_emulated(plan, folder, stand, witness, resume=True)
        code = 0
    finally:
        os._exit(code)


def wait(process: int, folder: Path, generator: random.Random) -> bool:
    """Wait for a random moment of a scan: as it opens its devices and looks for what is there, or soon after a frame; whether it still runs."""
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
    """Read every file that stands under the name of a frame: each must be whole; how many they are."""
    found = [shot for shot in plan.shots if (folder / "frames" / shot.name).exists()]
    for shot in found:
        read_frame(folder / "frames" / shot.name, shot, plan)
    assert len(found) == count(folder)
    return len(found)


def main(plan_file: str, folder: str, kills: int, seed: int) -> None:
    plan, generator = Plan.load(plan_file), random.Random(seed)
    run, moments, finished = 0, [], []
    while len(moments) < kills or count(Path(folder, str(run))):
        place = Path(folder, str(run))
        process = scan(plan, place)
        running = wait(process, place, generator) if len(moments) < kills else True
        if len(moments) < kills and running:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            moments.append(check(plan, place))
        else:
            if running:
                assert os.waitpid(process, 0)[1] == 0
            finished.append(str(place))
            run += 1
    print(json.dumps({"moments": moments, "finished": finished}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))

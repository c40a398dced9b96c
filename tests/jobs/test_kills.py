"""A build that is killed again and again at random times ends with the results of one that was left alone."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from brdfpipe.jobs.build import build
from brdfpipe.releases.verification import verify_results

BUILD = """
import sys
from pathlib import Path
from brdfpipe import installation
installation.project_folder = lambda: Path(sys.argv[1])
from brdfpipe.cli.main import main
main(["build", sys.argv[2], "--results", sys.argv[3], "--cores", "2"])
"""

MATERIALS = 6
MOST_KILLS = 200
"""A build that has not ended after so many kills does not resume."""


def digests(results: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file()
        and not path.name.startswith(".")
        and path.relative_to(results).parts[0] not in ("logs", ".snakemake")
    }


def build_and_kill(project: Path, folder: Path, results: Path, seconds: float) -> bool:
    """Build in another process, which is killed after some time; return whether it had ended."""
    command = [sys.executable, "-c", BUILD, str(project), str(folder), str(results)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        return process.wait(timeout=seconds) == 0
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return False


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_kills_at_random_times_leave_the_results_of_an_undisturbed_build(
    project: Path, tmp_path: Path, write: Callable[..., Path], seed: int
) -> None:
    folder = tmp_path / "catalogue"
    for number in range(MATERIALS):
        write(folder, f"m{number}", raw=str(number))
    expected, killed = tmp_path / "undisturbed", tmp_path / "killed"
    build(folder, expected, cores=2)
    times = random.Random(seed)
    kills = 0
    while not build_and_kill(project, folder, killed, times.uniform(0.5, 6)):
        kills += 1
        assert kills < MOST_KILLS
    print(f"{kills} kills")
    assert digests(killed) == digests(expected)
    assert verify_results(killed) == []
    assert build(folder, killed, cores=2).jobs == 0

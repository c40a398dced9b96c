"""A build that is killed again and again at random times ends with the results of one that was left alone.

``python benchmarks/kills.py`` does the same with real materials.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from killed_build import contents, kill_until_complete, start_build

from brdfpipe.jobs.build import build
from brdfpipe.releases.verification import verify_results

MATERIALS = 6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_kills_at_random_times_leave_the_results_of_an_undisturbed_build(
    project: Path, tmp_path: Path, write: Callable[..., Path], seed: int
) -> None:
    folder = tmp_path / "catalogue"
    for number in range(MATERIALS):
        write(folder, f"m{number}", raw=str(number))
    expected, killed = tmp_path / "undisturbed", tmp_path / "killed"
    start = time.monotonic()
    with start_build(project, folder, expected) as undisturbed:
        output, _ = undisturbed.communicate()
    elapsed = time.monotonic() - start
    assert undisturbed.returncode == 0, output
    times = random.Random(seed)
    # Within a build; on a machine with other work, where none would get to its first job in a few seconds, later.
    kills = kill_until_complete(lambda: start_build(project, folder, killed), lambda: times.uniform(0.1, 0.9) * elapsed)
    print(f"{kills} kills, {elapsed:.1f} s undisturbed")
    assert contents(killed) == contents(expected)
    assert verify_results(killed) == []
    assert build(folder, killed, cores=2).jobs == 0

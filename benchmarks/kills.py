"""Kill builds of real materials at random times until each sequence of kills has ended, and compare with an undisturbed build.

``python benchmarks/kills.py`` builds 50 varied materials (:mod:`varied_materials`) of the scene ``gloss-sheet`` on two cores, and kills 100 times in
all, by SIGKILL. Wanted: the same files, nothing damaged, and nothing left to run. Half an hour on two idle cores.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from pathlib import Path

import click

from brdfpipe.jobs.build import build
from brdfpipe.releases.verification import verify_results

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from killed_build import contents, kill_until_complete, start_build
from varied_materials import PROJECT, write_varied


@click.command()
@click.option("--materials", default=50, show_default=True)
@click.option("--kills", "wanted", default=100, show_default=True, help="In all; each sequence of kills is ended.")
@click.option("--scene", default="gloss-sheet", show_default=True)
@click.option("--longest", default=0.25, show_default=True, help="Until a kill, in times of the undisturbed build.")
@click.option("--seed", default=1, show_default=True)
def main(materials: int, wanted: int, scene: str, longest: float, seed: int) -> None:
    """Kill builds at random times and compare what they leave."""
    times, total, sequences = random.Random(seed), 0, 0
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        write_varied(work / "catalogue", materials)
        started = time.perf_counter()
        build(work / "catalogue", work / "undisturbed", cores=2, scene=scene)
        undisturbed = time.perf_counter() - started
        expected = contents(work / "undisturbed")
        print(f"{materials} materials, undisturbed {undisturbed:.0f} s, {len(expected)} files", flush=True)
        while total < wanted:
            results = work / f"killed-{sequences}"
            kills = kill_until_complete(
                lambda results=results: start_build(PROJECT, work / "catalogue", results, "--scene", scene),  # type: ignore[misc]
                lambda: times.uniform(0.01, longest) * undisturbed,
            )
            found = contents(results)
            different = [
                name for name in sorted(found.keys() | expected.keys()) if found.get(name) != expected.get(name)
            ]
            problems = verify_results(results)
            jobs = build(work / "catalogue", results, cores=2, scene=scene).jobs
            total, sequences = total + kills, sequences + 1
            print(
                f"sequence {sequences}: {kills} kills ({total} in all), {len(different)} files differ, "
                f"{len(problems)} problems, {jobs} jobs left",
                flush=True,
            )
            if different or problems or jobs:
                sys.exit("\n".join([*different, *problems]))


if __name__ == "__main__":
    main()

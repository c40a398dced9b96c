"""Time the evaluation of a run, from its files to a BSDF: a whole sample of 875 frames and its etalon.

``python benchmarks/rig_reduction.py`` writes ``benchmarks/results/rig_reduction.json``. The rig and the plan are those of ``brdfpipe rig
new``: 150 fibres, 35 wavelengths × 5 incidences × 5 frames of a bracket, dark frames and monitor readings of the lamp; the frames are the emulated
rig's, with all effects. Two requirements are judged:

* reduction of 60 frames a second and more of processor time, on one core, from frames in memory to the light of each cell;
* at most 60 s on two cores from the files to the completed BSDF. An arrangement is a job of its own, as in the workflow.
"""

from __future__ import annotations

import json
import platform
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import profiling
import rig_accuracy as accuracy
import xarray as xr

from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.rig import frames
from brdfpipe.rig.frame_file import DeviceState, write_frame
from brdfpipe.rig.plan import FRAMES, Plan
from brdfpipe.rig.raw_frame import RawFrame
from brdfpipe.rig.reduction.arrangements import join_arrangements
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile
from brdfpipe.rig.reduction.relative_light import reduce
from brdfpipe.rig.templates import start

PROJECT = Path(__file__).resolve().parents[1]
FRAMES_A_SECOND = 60.0
SECONDS_LIMIT = 60.0
CORES = 2
REPEATS = 3

Record = dict[str, Any]


class Job(NamedTuple):
    """One arrangement."""

    folder: str
    load: str
    incidence: float


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "rig_reduction.json"
)
def main(out: Path) -> None:
    """Time reading, reduction, calibration, smoothing and completion, and profile the reduction."""
    with tempfile.TemporaryDirectory() as folder:
        plan = write_run(Path(folder))
        summary: Record = {
            "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}"
        }
        summary |= reduction(Path(folder), plan)
        summary |= whole(folder, plan)
    summary["frames_met"] = summary["reduced_a_second"] >= FRAMES_A_SECOND
    summary["seconds_met"] = summary["busy_s"] <= SECONDS_LIMIT
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not (summary["frames_met"] and summary["seconds_met"]):
        sys.exit("a requirement is not met")


def write_run(folder: Path) -> Plan:
    """Write the folder of a finished run."""
    plan = Plan.load(start(folder))
    taken = accuracy.frames_of(plan, accuracy.TRUTHS["plastic, 10 sr⁻¹, 3°"]())
    (folder / FRAMES).mkdir()
    for counts, elapsed, shot in zip(taken["counts"].values, taken["elapsed"].values, plan.shots, strict=True):
        picture = RawFrame(counts, float(elapsed), shot.exposure, 20.0)
        state = DeviceState(shot.wavelength, shot.position)
        write_frame(
            folder / FRAMES / shot.name, picture, shot, plan, state=state, run_start=0.0, camera="emulated camera"
        )
    return plan


def reduction(folder: Path, plan: Plan) -> Record:
    """Processor time of one arrangement, frames read before."""
    incidence = plan.incidences[2]
    begin = time.process_time()
    run = frames.read_run(folder, incidence)
    read = time.process_time() - begin
    count = int((run["purpose"].values == "sample").sum())
    spent = []
    for _ in range(REPEATS):
        begin = time.process_time()
        reduce(run, plan.rig, incidence=incidence)
        spent.append(time.process_time() - begin)
    return {
        "frames": count,
        "read_a_second": round(run.sizes["frame"] / read, 1),
        "reduced_a_second": round(count / min(spent), 1),
        "goes_to": profiling.profile(lambda: reduce(run, plan.rig, incidence=incidence), 0.02)[: profiling.MOST],
    }


def arrangement(job: Job) -> tuple[xr.Dataset, float]:
    """One arrangement from its files, and the processor time it took."""
    begin = time.process_time()
    run = frames.read_run(job.folder, job.incidence)
    rig = Plan.load(Path(job.folder) / "plan.yaml").rig
    return reduce(run, rig, load=job.load, incidence=job.incidence), time.process_time() - begin


def whole(folder: str, plan: Plan) -> Record:
    """From the files to the completed BSDF on two cores: wall time, and processor time over the cores."""
    jobs = [Job(folder, "etalon", entrance) for entrance in plan.etalon_entrances]
    jobs += [Job(folder, "sample", incidence) for incidence in plan.incidences]
    begin, own = time.perf_counter(), time.process_time()
    with ProcessPoolExecutor(CORES) as pool:
        reduced = list(pool.map(arrangement, jobs))
    by_load = {
        load: join_arrangements([dataset for dataset, _ in reduced if dataset.attrs["load"] == load])
        for load in ("etalon", "sample")
    }
    primary = apply_profile(by_load["sample"], calibrate(by_load["etalon"], accuracy.certificate()))
    completion.complete(smoothing.smooth(primary))
    wall, own = time.perf_counter() - begin, time.process_time() - own
    arranged = sum(spent for _, spent in reduced)
    # The single steps, from calibration to completion, have one core.
    return {"wall_s": round(wall, 1), "busy_s": round(arranged / CORES + own, 1), "once_s": round(own, 1)}


def as_text(summary: Record) -> str:
    """The printed summary."""
    met = {True: "met", False: "NOT met"}
    lines = profiling.lines(summary["goes_to"])
    lines.append(
        f"{summary['frames']} frames of an arrangement: {summary['read_a_second']:.0f} read and {summary['reduced_a_second']:.0f} reduced a "
        f"second, at least {FRAMES_A_SECOND:.0f}: {met[summary['frames_met']]}"
    )
    lines.append(
        f"a whole sample and its etalon on {CORES} cores: {summary['busy_s']:.1f} s of processor time ({summary['once_s']:.1f} s of them on one "
        f"core), at most {SECONDS_LIMIT:.0f}: {met[summary['seconds_met']]}; wall {summary['wall_s']:.1f} s"
    )
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()

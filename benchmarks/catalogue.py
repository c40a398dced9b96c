"""Measure a catalogue: 100 varied copies of the examples, built from nothing, then again unchanged.

``make benchmark`` runs it on two cores and writes ``benchmarks/results/catalogue.json``. ``--growth`` measures how time and memory grow with the
number of materials instead, on varied small materials of all routes (:mod:`varied_materials`). Two requirements are judged:

* wall time at most 1.5 times the sum of the stages' times over the cores, so that the machinery stays out of the way;
* a second run of an unchanged catalogue takes at most 3 s.

``--growth`` judges the exponents of the wall time and of the unchanged run in the number of materials: at most 1.05, over all numbers and between
the last two, where imports and other constants count least.
"""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import click
from varied_materials import write_varied

PROJECT = Path(__file__).resolve().parents[1]
RATIO_LIMIT = 1.5
SECOND_RUN_LIMIT = 3.0
EXPONENT_LIMIT = 1.05
JUDGED_GROWTH = {"first_s": "wall time of a build from nothing", "unchanged_s": "wall time of an unchanged run"}
"""Figures of a row whose exponents are judged."""

EMPTY_STAGE = '''
"""A stage that writes its parameters and the digests of its inputs."""
import hashlib, json
from pathlib import Path

def main(input, output, params):
    given = [file for value in input.values() for file in ([value] if isinstance(value, str) else value)]
    digests = [hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in given]
    content = json.dumps([Path(__file__).stem, params["material"], params["spec"], digests])
    for value in output.values():
        for file in [value] if isinstance(value, str) else value:
            Path(file).write_text(content)
'''

IN_PROJECT = """\
import sys
from pathlib import Path
from brdfpipe import installation
project = Path(sys.argv.pop(1))
installation.project_folder = lambda: project
from brdfpipe.cli.main import main
main(prog_name="brdfpipe")
"""
"""Runs the command line with the workflow of another folder."""

Record = dict[str, Any]


@click.command()
@click.option("--materials", default=100, show_default=True)
@click.option("--cores", default=2, show_default=True)
@click.option(
    "--scene",
    default=None,
    help="The scene that is built.  [default: catalogue; multiangle-qc, the cheapest, for --growth]",
)
@click.option("--growth", is_flag=True, help="Build catalogues of growing numbers of varied small materials.")
@click.option(
    "--empty-stages", is_flag=True, help="For --growth: stages that compute nothing, so that the machinery is measured."
)
@click.option("--numbers", default="100,1000,10000", show_default=True, help="Of materials, for --growth.")
@click.option(
    "--folder", type=click.Path(path_type=Path), default=None, help="Where to work; default a temporary folder."
)
@click.option("--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "catalogue.json")
def main(
    materials: int,
    cores: int,
    scene: str | None,
    growth: bool,
    empty_stages: bool,
    numbers: str,
    folder: Path | None,
    out: Path,
) -> None:
    """Build many materials and measure the time of each stage."""
    if growth:
        counts = [int(number) for number in numbers.split(",")]
        measure_growth(counts, cores, scene or "multiangle-qc", folder, out, empty_stages)
        return
    scene = scene or "catalogue"
    with tempfile.TemporaryDirectory() as temporary:
        work = folder or Path(temporary)
        catalogue, results = work / "catalogue", work / "results"
        write_catalogue(catalogue, materials)
        shutil.rmtree(results, ignore_errors=True)
        first = timed_build(catalogue, results, cores, scene)
        records = stage_records(results)
        second = timed_build(catalogue, results, cores, scene)
        rerun = sum((results / record["log"]).stat().st_mtime > second["started"] for record in records)
    summary = summarise(records, first, second, rerun, cores)
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not (summary["ratio_met"] and summary["second_run_met"]):
        sys.exit("a requirement is not met")


def measure_growth(
    numbers: list[int], cores: int, scene: str, folder: Path | None, out: Path, empty_stages: bool = False
) -> None:
    """Build, build unchanged, and build with one changed material, for each number of materials; print the table and the exponents."""
    rows: list[Record] = []
    for number in numbers:
        with tempfile.TemporaryDirectory() as temporary:
            work = folder or Path(temporary)
            catalogue, results = work / f"catalogue-{number}", work / f"results-{number}"
            for path in (catalogue, results):
                shutil.rmtree(path, ignore_errors=True)
            first_material, *_ = write_varied(catalogue, number)
            project = write_project(work / "project") if empty_stages else None
            first = timed_build(catalogue, results, cores, scene, project)
            stages = sum(record["cpu_s"] for record in stage_records(results))
            unchanged = timed_build(catalogue, results, cores, scene, project)
            with (first_material / "material.yaml").open("a") as description:
                description.write("description: changed\n")
            edited = timed_build(catalogue, results, cores, scene, project)
            rows.append(
                {
                    "materials": number,
                    "first_s": round(first["wall_s"], 2),
                    "first_front_cpu_s": round(first["front_cpu_s"], 2),
                    "stages_cpu_s": round(stages, 2),
                    "unchanged_s": round(unchanged["wall_s"], 2),
                    "unchanged_cpu_s": round(unchanged["front_cpu_s"], 2),
                    "edited_s": round(edited["wall_s"], 2),
                    "edited_cpu_s": round(edited["front_cpu_s"], 2),
                    "first_peak_mb": round(first["front_peak_mb"]),
                    "unchanged_peak_mb": round(unchanged["front_peak_mb"]),
                }
            )
            print(growth_as_text(rows[-1:], header=len(rows) == 1), flush=True)
    exponents, last = fitted_exponents(rows), fitted_exponents(rows[-2:])
    print(exponents_as_text(exponents, last, [row["materials"] for row in rows]))
    target = out.with_name(f"catalogue-growth{'-empty-stages' if empty_stages else ''}.json")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(
        json.dumps(
            {"cores": cores, "scene": scene, "rows": rows, "exponents": exponents, "exponents_of_the_last_two": last},
            indent=1,
        )
        + "\n",
        encoding="utf-8",
    )
    if any(max(exponents[name], last[name]) > EXPONENT_LIMIT for name in JUDGED_GROWTH if exponents):
        sys.exit("a requirement is not met")


def fitted_exponents(rows: list[Record]) -> dict[str, float]:
    """The slope of log figure by log number of materials, by least squares; none with a single number."""
    import numpy as np

    if len(rows) < 2:
        return {}
    logs = np.log([row["materials"] for row in rows])
    return {
        name: round(float(np.polyfit(logs, np.log([max(row[name], 1e-3) for row in rows]), 1)[0]), 3)
        for name in rows[0]
        if name != "materials"
    }


def exponents_as_text(exponents: Record, last: Record, numbers: list[int]) -> str:
    """The exponents that a person reads, those that are judged first."""
    if not exponents:
        return "exponents need two numbers of materials"
    lines = [f"exponents of the number of materials, over all of {numbers} and between the last two:"]
    for name in (*JUDGED_GROWTH, *(name for name in exponents if name not in JUDGED_GROWTH)):
        line = f"{exponents[name]:6.2f}{last[name]:6.2f}  {JUDGED_GROWTH.get(name, name)}"
        if name in JUDGED_GROWTH:
            met = max(exponents[name], last[name]) <= EXPONENT_LIMIT
            line += f", at most {EXPONENT_LIMIT}: {'met' if met else 'NOT met'}"
        lines.append(line)
    return "\n".join(lines)


def growth_as_text(rows: list[Record], header: bool) -> str:
    """The table a person reads."""
    names = list(rows[0])
    lines = ["  ".join(names)] if header else []
    return "\n".join([*lines, *("  ".join(f"{row[name]:>{len(name)}}" for name in names) for row in rows)])


def write_catalogue(folder: Path, count: int) -> None:
    """Varied copies of the examples, ``count`` in all."""
    specification = importlib.util.spec_from_file_location("generate", PROJECT / "examples" / "generate.py")
    assert specification is not None
    assert specification.loader is not None
    generate = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(generate)
    shutil.rmtree(folder, ignore_errors=True)
    written: list[Path] = []
    while len(written) < count:
        written += generate.write_materials(folder, len(written) // 3 + 1)
    for surplus in written[count:]:
        shutil.rmtree(surplus)


def write_project(folder: Path) -> Path:
    """The project's own rules and configuration, with stages that compute nothing."""
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("config", "workflow"):
        shutil.copytree(PROJECT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(PROJECT / "Snakefile", folder)
    for script in (folder / "workflow" / "scripts").glob("*.py"):
        script.write_text(EMPTY_STAGE, encoding="utf-8")
    return folder


def timed_build(catalogue: Path, results: Path, cores: int, scene: str, project: Path | None = None) -> Record:
    """Build on the command line, in a separate process; ``front``: of this process alone, without the workers that run the stages.

    The workflow is that of ``project``, if given.
    """
    program = ["-c", IN_PROJECT, project] if project else ["-m", "brdfpipe.cli"]
    command = [sys.executable, *map(str, program), "build", catalogue, "--results", results]
    command += ["--cores", str(cores), "--scene", scene]
    started, begin = time.time(), time.perf_counter()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, text=True)
        _, status, used = os.wait4(
            process.pid, 0
        )  # its own use: the workers are children of the server that forks them
        wall = time.perf_counter() - begin
        output.seek(0)
        text = output.read()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(text)
    summary = next(line for line in text.splitlines() if " up to date, " in line)
    return {
        "wall_s": wall,
        "started": started,
        "front_cpu_s": used.ru_utime + used.ru_stime,
        "front_peak_mb": used.ru_maxrss / 1024,
        "output": summary,
    }


def stage_records(results: Path) -> list[Record]:
    """Every job's times, as its worker wrote them."""
    paths = sorted((results / "logs").rglob("*/*.json"))
    return [json.loads(path.read_text()) | {"log": str(path.relative_to(results))} for path in paths]


def summarise(records: list[Record], first: Record, second: Record, rerun: int, cores: int) -> Record:
    """The numbers of the table, and the two requirements."""
    stages: dict[str, list[Record]] = defaultdict(list)
    for record in records:
        stages[record["stage"]].append(record)
    total = sum(record["wall_s"] for record in records)
    return {
        "materials": len({record["material"] for record in records} - {"catalogue"}),
        "cores": cores,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "stages": {
            stage: {
                "jobs": len(group),
                "total_wall_s": round(sum(item["wall_s"] for item in group), 3),
                "median_wall_s": round(statistics.median(item["wall_s"] for item in group), 4),
                "total_cpu_s": round(sum(item["cpu_s"] for item in group), 3),
                "peak_mb": max(item["peak_mb"] for item in group),
            }
            for stage, group in sorted(stages.items(), key=lambda pair: -sum(item["wall_s"] for item in pair[1]))
        },
        "jobs": len(records),
        "wall_s": round(first["wall_s"], 2),
        "stages_s": round(total, 2),
        "ideal_s": round(total / cores, 2),
        "ratio": round(first["wall_s"] * cores / total, 3),
        "not_stages": round(1 - total / (first["wall_s"] * cores), 3),
        "second_run_s": round(second["wall_s"], 2),
        "second_run_jobs": rerun,
        "output": [first["output"], second["output"]],
        "ratio_met": first["wall_s"] <= RATIO_LIMIT * total / cores,
        "second_run_met": second["wall_s"] <= SECOND_RUN_LIMIT and rerun == 0,
    }


def as_text(summary: Record) -> str:
    """The table a person reads."""
    lines = [f"{'stage':16}{'jobs':>6}{'total s':>10}{'median ms':>11}{'cpu s':>9}{'peak MB':>9}"]
    lines += [
        f"{stage:16}{row['jobs']:6}{row['total_wall_s']:10.2f}{1000 * row['median_wall_s']:11.1f}"
        f"{row['total_cpu_s']:9.2f}{row['peak_mb']:9.0f}"
        for stage, row in summary["stages"].items()
    ]
    met = {True: "met", False: "NOT met"}
    return "\n".join(
        [
            *lines,
            f"{summary['materials']} materials, {summary['jobs']} jobs, {summary['cores']} cores ({summary['machine']})",
            f"wall {summary['wall_s']:.1f} s; stages {summary['stages_s']:.1f} s, over the cores {summary['ideal_s']:.1f} s; "
            f"{summary['not_stages']:.0%} of the cores' time is not stage computation",
            f"wall / (stages / cores) = {summary['ratio']:.2f}, at most {RATIO_LIMIT}: {met[summary['ratio_met']]}",
            f"second run {summary['second_run_s']:.1f} s, {summary['second_run_jobs']} jobs, at most {SECOND_RUN_LIMIT:.0f} s: "
            f"{met[summary['second_run_met']]}",
        ]
    )


if __name__ == "__main__":
    main()

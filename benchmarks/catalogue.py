"""Measure a catalogue: 100 varied copies of the examples, built from nothing, then again unchanged.

``make benchmark`` runs it on two cores and writes ``benchmarks/results/catalogue.json``. Two requirements are judged:

* wall time at most 1.5 times the sum of the stages' times over the cores, so that the machinery stays out of the way;
* a second run of an unchanged catalogue takes at most 5 s.
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

PROJECT = Path(__file__).resolve().parents[1]
RATIO_LIMIT = 1.5
SECOND_RUN_LIMIT = 3.0

Record = dict[str, Any]


@click.command()
@click.option("--materials", default=100, show_default=True)
@click.option("--cores", default=2, show_default=True)
@click.option("--scene", default="catalogue", show_default=True, help="The scene that is built.")
@click.option(
    "--folder", type=click.Path(path_type=Path), default=None, help="Where to work; default a temporary folder."
)
@click.option("--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "catalogue.json")
def main(materials: int, cores: int, scene: str, folder: Path | None, out: Path) -> None:
    """Build many materials and measure the time of each stage."""
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


def timed_build(catalogue: Path, results: Path, cores: int, scene: str) -> Record:
    """Build on the command line, in a separate process."""
    command = [sys.executable, "-m", "brdfpipe.cli", "build", catalogue, "--results", results]
    command += ["--cores", str(cores), "--scene", scene]
    before, started, begin = os.times(), time.time(), time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - begin, os.times()
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    main_cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return {"wall_s": wall, "started": started, "cpu_s": main_cpu, "output": done.stdout.splitlines()[0]}


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

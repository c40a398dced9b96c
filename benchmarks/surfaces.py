"""Measure surfaces: from a map of 4096² heights, and from a line of ten million, to the facet distribution; ray casting.

``python benchmarks/surfaces.py`` writes ``benchmarks/results/surfaces.json``. Every case runs in a process of its own, on one
thread. Three requirements are judged:

* the map to its distribution at most 20 times as long as one ``np.sum`` over the map in the same process;
* its extra peak memory, by ``tracemalloc`` in a run apart (tracing slows), at most a third of the map;
* the line at most 20 times as long as one ``np.sum`` over the line.
"""

from __future__ import annotations

import cProfile
import json
import os
import platform
import pstats
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.masking import ray_casting as raycast

PROJECT = Path(__file__).resolve().parents[1]
TIME_LIMIT = 20.0
MEMORY_LIMIT = 0.33
PITCH = 1.0
SLOPE_RMS = 0.15

Record = dict[str, Any]


@click.command()
@click.option("--size", default=4096, show_default=True, help="Heights along one side of the map.")
@click.option("--points", default=10_000_000, show_default=True, help="Heights of the line.")
@click.option("--repeats", default=3, show_default=True, help="The best of so many runs counts.")
@click.option("--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "surfaces.json")
@click.option("--case", type=click.Choice(["time", "memory", "raycast"]), hidden=True)
@click.option("--layout", type=click.Choice(["map", "line"]), default="map", hidden=True)
def main(size: int, points: int, repeats: int, out: Path, case: str | None, layout: str) -> None:
    """Time the facet distribution and the ray casting, and say where the time goes."""
    if case is not None:
        surface = rough_map(size) if layout == "map" else rough_line(points)
        print(json.dumps(CASES[case](surface, repeats)))
        return
    options = ["--size", str(size), "--points", str(points), "--repeats", str(repeats)]
    summary: Record = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}",
        "map": {"heights": size**2} | in_own_process("time", "map", options) | in_own_process("memory", "map", options),
        "line": {"heights": points}
        | in_own_process("time", "line", options)
        | in_own_process("memory", "line", options),
        "raycast": in_own_process("raycast", "map", ["--size", "1024", "--repeats", str(repeats)]),
    }
    summary["map_time_met"] = summary["map"]["sums"] <= TIME_LIMIT
    summary["map_memory_met"] = summary["map"]["extra_share"] <= MEMORY_LIMIT
    summary["line_time_met"] = summary["line"]["sums"] <= TIME_LIMIT
    print(as_text(summary))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if not (summary["map_time_met"] and summary["map_memory_met"] and summary["line_time_met"]):
        sys.exit("a requirement is not met")


def in_own_process(case: str, layout: str, options: list[str]) -> Record:
    """One case, alone in a fresh process, so that no case pays for another's memory."""
    command = [sys.executable, __file__, "--case", case, "--layout", layout, *options]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **threads})
    if done.returncode:
        sys.exit(done.stderr)
    record: Record = json.loads(done.stdout)
    return record


# --- what is measured


def rough_map(size: int) -> xr.Dataset:
    """A Gaussian map of slope rms 0.15 per axis and a correlation length of about 8 samples, from box averages of noise."""
    height = np.random.default_rng(1).normal(size=(size, size))
    for axis in (0, 1):
        for _ in range(3):
            height = sum(np.roll(height, shift, axis) for shift in range(-3, 4)) / 7
    return as_surface(height * (SLOPE_RMS / np.diff(height, axis=1).std()))


def rough_line(points: int) -> xr.Dataset:
    """A line of which the slopes are Gaussian and correlated over a few samples."""
    slope = np.convolve(np.random.default_rng(1).normal(size=points), np.ones(5), "same")
    return as_surface(np.cumsum(slope * (SLOPE_RMS / slope.std())))


def as_surface(height: np.ndarray) -> xr.Dataset:
    dims = ("y", "x")[2 - height.ndim :]
    pitches = {f"pitch_{dim}": PITCH for dim in dims}
    surface = xr.Dataset(
        {"height": (dims, height)},
        coords={dim: PITCH * np.arange(count) for dim, count in zip(dims, height.shape, strict=True)},
        attrs={**pitches, "levelling": "none", "band": "synthetic"},
    )
    return vocabulary.label(surface, "surface")


def facet_time(surface: xr.Dataset, repeats: int) -> Record:
    """Time to the distribution over the time of one sum, and where it goes."""
    height = surface["height"].values
    sum_s = best(lambda: np.sum(height), max(repeats, 5))
    estimate_s = best(lambda: estimate(surface), repeats)
    return {
        "sum_s": round(sum_s, 5),
        "estimate_s": round(estimate_s, 4),
        "sums": round(estimate_s / sum_s, 1),
        "goes_to": profile(lambda: estimate(surface)),
    }


def facet_memory(surface: xr.Dataset, repeats: int) -> Record:
    """Extra peak memory of the distribution over the memory of the heights."""
    # Imports and caches are paid once; they are no part of a surface's memory.
    estimate(surface.isel({dim: slice(0, 1024) for dim in surface["height"].dims}))
    peak = traced(lambda: estimate(surface))
    return {"extra_mb": round(peak / 1e6, 1), "extra_share": round(peak / surface["height"].nbytes, 3)}


def raycast_time(surface: xr.Dataset, repeats: int) -> Record:
    """Twenty angles over every line of a map, towards x, towards y, and obliquely."""
    theta = np.linspace(0, 89.9, 20)
    return {
        "heights": surface["height"].size,
        "angles": theta.size,
        "along_x_s": round(best(lambda: raycast.raycast(surface, theta, 0.0), repeats), 3),
        "along_y_s": round(best(lambda: raycast.raycast(surface, theta, 90.0), repeats), 3),
        "oblique_s": round(best(lambda: raycast.raycast(surface, theta, 30.0), repeats), 3),
        "extra_mb": round(traced(lambda: raycast.raycast(surface, theta, 90.0)) / 1e6, 1),
    }


CASES: dict[str, Callable[[xr.Dataset, int], Record]] = {
    "time": facet_time,
    "memory": facet_memory,
    "raycast": raycast_time,
}


def estimate(surface: xr.Dataset) -> xr.Dataset:
    return facets.estimate(surface, isotropic=True)


def best(action: Callable[[], Any], repeats: int) -> float:
    """Least processor time of several runs: the others were disturbed."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)


def traced(action: Callable[[], Any]) -> int:
    """Extra peak memory [byte] of what Python and numpy allocate."""
    tracemalloc.start()
    action()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def profile(action: Callable[[], Any]) -> list[Record]:
    """The functions that take the most time, and how much of it themselves.

    Element-wise numpy counts as the own time of the function it stands in.
    """
    profiler = cProfile.Profile()
    profiler.runcall(action)
    stats: Any = pstats.Stats(profiler)
    rows = [
        {
            "function": f"{Path(file).stem}.{name}" if Path(file).is_file() else name,
            "own_s": round(own, 4),
            "with_callees_s": round(cumulative, 4),
        }
        for (file, _, name), (_, _, own, cumulative, _) in stats.stats.items()
        if own > 0.01 * stats.total_tt or Path(file).stem == "facets"
    ]
    return sorted(rows, key=lambda row: -float(row["with_callees_s"]))[:16]


# --- what a person reads


def as_text(summary: Record) -> str:
    """The table a person reads."""
    met = {True: "met", False: "NOT met"}
    lines = [f"{'own s':>8}{'all s':>8}  function"]
    for layout in ("map", "line"):
        row = summary[layout]
        lines.append(f"--- {layout} of {row['heights']} heights")
        lines += [f"{item['own_s']:8.3f}{item['with_callees_s']:8.3f}  {item['function']}" for item in row["goes_to"]]
        lines.append(
            f"{layout}: distribution {row['estimate_s']:.3f} s, one sum {1000 * row['sum_s']:.2f} ms; {row['sums']:.0f} sums, "
            f"at most {TIME_LIMIT:.0f}: {met[summary[f'{layout}_time_met']]}"
        )
        memory = f"{layout}: extra memory {row['extra_mb']:.0f} MB, {row['extra_share']:.2f} of the heights"
        if layout == "map":
            memory += f", at most {MEMORY_LIMIT}: {met[summary['map_memory_met']]}"
        lines.append(memory)
    cast = summary["raycast"]
    lines.append(
        f"ray cast, {cast['heights']} heights x {cast['angles']} angles: towards x {cast['along_x_s']:.2f} s, "
        f"towards y {cast['along_y_s']:.2f} s, obliquely {cast['oblique_s']:.2f} s, extra memory {cast['extra_mb']:.0f} MB"
    )
    return "\n".join([*lines, summary["machine"]])


if __name__ == "__main__":
    main()

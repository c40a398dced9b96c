"""Measure the ways from L*a*b* to a spectrum: time, colour difference reached, share of colours reached, metamerism.

``python benchmarks/colour_recovery.py`` writes ``benchmarks/results/colour_recovery.json``. The colours are those of reflectances
straight between seven random knots, under D65 for the 10-degree observer, so that each one is reachable. One core. Metamerism is
ΔE00 to the reflectance the colour came from, under light A, FL2 and LED-B3, over the colours reached. Two requirements are
judged: `lhtss` within 1e-5 of all of them, and at least 2000 colours a second.
"""

from __future__ import annotations

import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from brdfpipe.spectra import colorimetry, mixing, recovery

PROJECT = Path(__file__).resolve().parents[1]
VIEW: dict[str, Any] = {"illuminant": "D65", "observer": 10}
WANTED_SPEED = 2000
WANTED_DELTA_E = 1e-5

Record = dict[str, Any]


@click.command()
@click.option("--colours", default=1000, show_default=True, help="Colours of lhtss and basis4.")
@click.option("--searched", default=200, show_default=True, help="Colours of each random search, the first of those.")
@click.option("--threshold", default=1.0, show_default=True, help="ΔE*ab at which a search ends.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "colour_recovery.json"
)
def main(colours: int, searched: int, threshold: float, out: Path) -> None:
    """Measure the four methods side by side."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    table = colorimetry.weights(**VIEW)
    truth = random_reflectances(colours)
    labs = colorimetry.xyz_to_lab(truth @ table.weights, table.white)
    records = [batch(method, labs, truth) for method in ("lhtss", "basis4")]
    records += [each(method, labs[:searched], truth[:searched], threshold) for method in mixing.SEARCHES]
    summary: Record = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        "threshold": threshold,
        "methods": {record["method"]: record for record in records},
    }
    summary["speed_met"] = records[0]["per_second"] >= WANTED_SPEED
    summary["delta_e_met"] = records[0]["share_reached"] == 1 and records[0]["delta_e_max"] <= WANTED_DELTA_E
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print_table(records)
    print(
        f"lhtss: {WANTED_SPEED}/s {'met' if summary['speed_met'] else 'not met'}, ΔE {WANTED_DELTA_E} {'met' if summary['delta_e_met'] else 'not met'}"
    )


def random_reflectances(count: int) -> np.ndarray:
    """Reflectances (count, 85), straight between seven knots."""
    knots = np.random.default_rng(11).beta(0.7, 0.7, (count, 7)).clip(0.003, 0.997)
    grid = colorimetry.weights(**VIEW).wavelength
    return np.stack([np.interp(grid, np.linspace(360, 780, 7), row) for row in knots])


def batch(method: str, labs: np.ndarray, truth: np.ndarray) -> Record:
    """An exact method, all colours in one call; the best of three runs."""
    exact = recovery.lhtss if method == "lhtss" else mixing.closed_form
    best = np.inf
    for _ in range(3):
        started = time.process_time()
        found = exact(colorimetry.lab_to_xyz(labs, colorimetry.weights(**VIEW).white), **VIEW)
        best = min(best, time.process_time() - started)
    return record(method, best, labs, truth, found.reflectance, found.reached)


def each(method: str, labs: np.ndarray, truth: np.ndarray, threshold: float) -> Record:
    """A search, colour by colour; those that no mixture has are not searched for, as in the pipeline."""
    table = colorimetry.weights(**VIEW)
    mixable = mixing.closed_form(colorimetry.lab_to_xyz(labs, table.white), **VIEW).reached
    started = time.process_time()
    found = [
        mixing.search(lab, **VIEW, method=method, threshold=threshold) if can else None
        for lab, can in zip(labs, mixable, strict=True)
    ]
    seconds = time.process_time() - started
    weights = np.stack([np.full(4, np.nan) if each is None else each.weights for each in found])
    reached = np.array([each is not None and each.ended == "threshold" for each in found])
    tried = [each.tried for each in found if each is not None]
    return {
        **record(method, seconds, labs, truth, weights @ colorimetry.basis()[1], reached),
        "tried_median": float(np.median(tried)),
    }


def record(
    method: str, seconds: float, labs: np.ndarray, truth: np.ndarray, spectra: np.ndarray, reached: np.ndarray
) -> Record:
    """What is kept of a method."""
    table = colorimetry.weights(**VIEW)
    apart = colorimetry.delta_e_ab(colorimetry.xyz_to_lab(spectra[reached] @ table.weights, table.white), labs[reached])
    metamerism = {
        light: float(np.median(recovery._difference(spectra[reached], truth[reached], light, VIEW["observer"])))
        for light in recovery.LIGHTS
    }
    return {
        "method": method,
        "colours": len(labs),
        "seconds_per_colour": seconds / len(labs),
        "per_second": len(labs) / seconds,
        "share_reached": float(reached.mean()),
        "delta_e_median": float(np.median(apart)),
        "delta_e_max": float(apart.max()),
        "metamerism_median": metamerism,
    }


def print_table(records: list[Record]) -> None:
    """The table of docs/benchmarks.md."""
    print("| | ms a colour | ΔE*ab median | largest | reached | ΔE00 under A | FL2 | LED-B3 |")
    print("|---|---|---|---|---|---|---|---|")
    for each in records:
        light = " | ".join(f"{value:.2f}" for value in each["metamerism_median"].values())
        print(
            f"| `{each['method']}` | {1000 * each['seconds_per_colour']:.3g} | {each['delta_e_median']:.1e} | "
            f"{each['delta_e_max']:.1e} | {100 * each['share_reached']:.0f} % | {light} |"
        )


if __name__ == "__main__":
    main()

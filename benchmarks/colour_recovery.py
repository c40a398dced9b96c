"""Measure the ways from L*a*b* to a spectrum: time, colour difference reached, share of colours reached, metamerism.

``python benchmarks/colour_recovery.py`` writes ``benchmarks/results/colour_recovery.json``. The colours are those of reflectances
straight between seven random knots, under D65 for the 10-degree observer, so that each one is reachable. One core. Metamerism is
the median ΔE00 under light A, FL2 and LED-B3, over the colours that all four methods reach: to the reflectance the colour came
from, and between each two methods. Judged are: `lhtss` within 1e-5 of all colours; at least 2000 colours a second, of these and of
those near the limit of all reflectances; and the latter no less than a third as fast, on whatever machine.
"""

from __future__ import annotations

import json
import os
import platform
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import click
import numpy as np

from brdfpipe.spectra import colorimetry, recovery
from brdfpipe.spectra.recovery_methods import basis4, random_search
from brdfpipe.spectra.recovery_methods.lhtss import lhtss

PROJECT = Path(__file__).resolve().parents[1]
VIEW = colorimetry.weights("D65", 10)
WANTED_SPEED = 2000
WANTED_RATIO = 1 / 3
WANTED_DELTA_E = 1e-5
SINGLE = 50
EXACT: dict[str, Any] = {"lhtss": lhtss, "basis4": basis4.closed_form}

Record = dict[str, Any]
Measured = tuple[str, Record, np.ndarray]


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
    table = VIEW
    truth = random_reflectances(colours)
    labs = colorimetry.xyz_to_lab(truth @ table.weights, table.white)
    measured = [batch(method, labs) for method in EXACT]
    measured += [one_by_one(method, labs[:searched], threshold) for method in random_search.SEARCHES]
    hard = colorimetry.xyz_to_lab(bands(colours) @ table.weights, table.white)
    summary: Record = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        "threshold": threshold,
        "methods": {method: record for method, record, _ in measured},
        "lhtss_near_limit": batch("lhtss", hard)[1],
        **metamerism({method: spectra[:searched] for method, _, spectra in measured}, truth[:searched]),
    }
    ordinary, near_limit = summary["methods"]["lhtss"], summary["lhtss_near_limit"]
    summary["near_limit_speed_ratio"] = near_limit["per_second"] / ordinary["per_second"]
    summary["speed_met"] = min(ordinary["per_second"], near_limit["per_second"]) >= WANTED_SPEED
    summary["ratio_met"] = summary["near_limit_speed_ratio"] >= WANTED_RATIO
    summary["delta_e_met"] = all(
        one["share_reached"] == 1 and one["delta_e_max"] <= WANTED_DELTA_E for one in (ordinary, near_limit)
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print_tables(summary)


def random_reflectances(count: int) -> np.ndarray:
    """Reflectances (count, 85), straight between seven knots."""
    knots = np.random.default_rng(11).beta(0.7, 0.7, (count, 7)).clip(0.003, 0.997)
    grid = VIEW.wavelength
    return np.stack([np.interp(grid, np.linspace(360, 780, 7), row) for row in knots])


def bands(count: int) -> np.ndarray:
    """Reflectances (count, 85) of 0.99 in a band and 0.01 beside it, or the reverse: near the limit of all object colours."""
    rng, grid = np.random.default_rng(5), VIEW.wavelength
    first, width = rng.uniform(380, 600, (count, 1)), rng.uniform(30, 150, (count, 1))
    inside = (grid >= first) & (grid <= first + width)
    return 0.01 + 0.98 * (inside ^ (rng.random((count, 1)) < 0.5))


def batch(method: str, labs: np.ndarray) -> Measured:
    """An exact method, all colours in one call, the best of three runs; and the first colours one a call."""
    exact = EXACT[method]
    xyz = colorimetry.lab_to_xyz(labs, VIEW.white)
    seconds = np.inf
    for _ in range(3):
        started = time.process_time()
        recovered = exact(xyz, VIEW)
        seconds = min(seconds, time.process_time() - started)
    started = time.process_time()
    for one in xyz[:SINGLE]:
        exact(one, VIEW)
    alone = (time.process_time() - started) / len(xyz[:SINGLE])
    record = described(labs, recovered.reflectance, seconds, len(labs)) | {"seconds_per_single_call": alone}
    return method, record, recovered.reflectance


def one_by_one(method: str, labs: np.ndarray, threshold: float) -> Measured:
    """A search, colour by colour; where the nearest mixture is not within the threshold it is not begun, nor is its time counted."""
    near = [basis4.nearest(lab, VIEW) for lab in labs]
    xyz = colorimetry.lab_to_xyz(labs, VIEW.white)
    begun = basis4.closed_form(xyz, VIEW).reached | (colorimetry.delta_e_ab(np.stack(near), labs) < threshold)
    spectra, tried = np.full((len(labs), basis4.basis().shape[1]), np.nan), []
    started = time.process_time()
    for i in np.flatnonzero(begun):
        result = random_search.search(labs[i], VIEW, method=method, threshold=threshold)
        tried.append(result.tried)
        if result.ended == "threshold":
            spectra[i] = result.weights @ basis4.basis()
    seconds = time.process_time() - started
    return method, described(labs, spectra, seconds, len(tried)) | {"tried_median": float(np.median(tried))}, spectra


def described(labs: np.ndarray, spectra: np.ndarray, seconds: float, begun: int) -> Record:
    """What is kept of a method; spectra are NaN where the colour was not reached."""
    table = VIEW
    reached = np.isfinite(spectra).all(axis=1)
    apart = colorimetry.delta_e_ab(colorimetry.xyz_to_lab(spectra[reached] @ table.weights, table.white), labs[reached])
    return {
        "colours": len(labs),
        "begun": begun,
        "seconds_per_colour_begun": seconds / begun,
        "per_second": begun / seconds,
        "share_reached": float(reached.mean()),
        "delta_e_median": float(np.median(apart)),
        "delta_e_max": float(apart.max()),
    }


def metamerism(spectra: dict[str, np.ndarray], truth: np.ndarray) -> Record:
    """Median ΔE00 to the source and between methods, over the colours all methods reach."""
    common = np.all([np.isfinite(rows).all(axis=1) for rows in spectra.values()], axis=0)

    def apart(first: np.ndarray, second: np.ndarray) -> Record:
        return {
            light: float(np.median(recovery._difference(first[common], second[common], light, VIEW.observer)))
            for light in recovery.LIGHTS
        }

    return {
        "common_colours": int(common.sum()),
        "metamerism_to_source": {method: apart(rows, truth) for method, rows in spectra.items()},
        "metamerism_between": {f"{a}, {b}": apart(spectra[a], spectra[b]) for a, b in combinations(spectra, 2)},
    }


def print_tables(summary: Record) -> None:
    """The tables of docs/benchmarks.md."""
    print("| | ms a colour | ΔE*ab median | largest | reached |\n|---|---|---|---|---|")
    for method, one in {**summary["methods"], "lhtss, near the limit": summary["lhtss_near_limit"]}.items():
        print(
            f"| `{method}` | {1000 * one['seconds_per_colour_begun']:.2g} | {one['delta_e_median']:.1e} | "
            f"{one['delta_e_max']:.1e} | {100 * one['share_reached']:.0f} % |"
        )
    print(f"\n{summary['common_colours']} common colours\n\n| median ΔE00 | A | FL2 | LED-B3 |\n|---|---|---|---|")
    for pair, lights in {**summary["metamerism_to_source"], **summary["metamerism_between"]}.items():
        print(f"| {pair} | " + " | ".join(f"{value:.2f}" for value in lights.values()) + " |")
    for method in EXACT:
        print(f"{method}, a call a colour: {1000 * summary['methods'][method]['seconds_per_single_call']:.2g} ms")
    print(f"near the limit {summary['near_limit_speed_ratio']:.2f} of the speed")
    for key in ("speed_met", "ratio_met", "delta_e_met"):
        print(f"{key}: {summary[key]}")


if __name__ == "__main__":
    main()

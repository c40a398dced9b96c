"""Measure what colour-science costs: its import, and its arithmetic beside the same formulas in plain numpy.

``python benchmarks/colour_science.py`` writes ``benchmarks/results/colour_science.json``. Times are of the processor. The import is measured in new
processes that have loaded numpy, scipy and xarray, as a worker of a build has; its memory is read from /proc.
"""

from __future__ import annotations

import json
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

PROJECT = Path(__file__).resolve().parents[1]
WHITE = colorimetry.weights("D65", 10).white
IMPORTS, REPEATS = 7, 7

IMPORT = """
import json, os, time
import netCDF4, numpy, pandas, scipy.interpolate, scipy.optimize, scipy.special, xarray

def state():
    with open("/proc/self/statm") as pages:
        return time.process_time(), int(pages.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

before = state()
import brdfpipe.spectra.colour_science
print(json.dumps([after - start for start, after in zip(before, state())]))
"""

Record = dict[str, Any]


@click.command()
@click.option("--pairs", default=100_000, show_default=True, help="Number of colours.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "colour_science.json"
)
def main(pairs: int, out: Path) -> None:
    """Measure import, Lab to XYZ and ΔE00."""
    random = np.random.default_rng(5)
    lab = random.uniform([0, -80, -80], [100, 80, 80], (pairs, 3))
    other = lab + random.normal(0, 3, lab.shape)
    one = lab[0]
    summary: Record = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        "pairs": pairs,
        "import": imported(),
        "lab_to_xyz_one": compared(lambda: colorimetry.lab_to_xyz(one, WHITE), lambda: lab_to_xyz(one, WHITE)),
        "lab_to_xyz": compared(lambda: colorimetry.lab_to_xyz(lab, WHITE), lambda: lab_to_xyz(lab, WHITE)),
        "delta_e_00": compared(lambda: colorimetry.delta_e_00(lab, other), lambda: delta_e_00(lab, other)),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary, indent=1))


def imported() -> Record:
    """Processor time and memory of the import, medians of new processes."""
    runs = [json.loads(subprocess.check_output([sys.executable, "-c", IMPORT])) for _ in range(IMPORTS)]
    seconds, megabytes = (statistics.median(values) for values in zip(*runs, strict=True))
    return {"seconds": round(seconds, 2), "megabytes": round(megabytes, 1)}


def compared(library: Callable[[], Array], plain: Callable[[], Array]) -> Record:
    """Times of a call of colour-science and of plain numpy, and the largest difference of their results."""
    difference = float(np.abs(library() - plain()).max())
    own, floor = fastest(library), fastest(plain)
    return {"ms": round(1e3 * own, 3), "numpy_ms": round(1e3 * floor, 3), "difference": float(f"{difference:.1e}")}


def fastest(call: Callable[[], Array]) -> float:
    """Processor time of one call [s]: the least of several, each of calls that take 20 ms together."""
    calls, spent = 1, 0.0
    while spent < 0.02:
        calls *= 2
        spent = timed(call, calls)
    return min(timed(call, calls) for _ in range(REPEATS)) / calls


def timed(call: Callable[[], Array], calls: int) -> float:
    begin = time.process_time()
    for _ in range(calls):
        call()
    return time.process_time() - begin


# --- the same formulas in plain numpy


def lab_to_xyz(lab: Array, white: Array) -> Array:
    """CIE 15, from L*, a*, b* (..., 3) to XYZ."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], axis=-1)
    return np.asarray(white * np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)))


def delta_e_00(first: Array, second: Array) -> Array:
    """CIEDE2000 of two arrays of L*, a*, b* (..., 3), kL = kC = kH = 1 (Sharma, Wu and Dalal 2005)."""
    chroma = (np.hypot(first[..., 1], first[..., 2]) + np.hypot(second[..., 1], second[..., 2])) / 2
    grey = 1.5 - 0.5 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    a_1, a_2 = grey * first[..., 1], grey * second[..., 1]
    c_1, c_2 = np.hypot(a_1, first[..., 2]), np.hypot(a_2, second[..., 2])
    h_1, h_2 = np.degrees(np.arctan2(first[..., 2], a_1)) % 360, np.degrees(np.arctan2(second[..., 2], a_2)) % 360
    turn = (h_2 - h_1 + 180) % 360 - 180
    lightness, c = (first[..., 0] + second[..., 0]) / 2, (c_1 + c_2) / 2
    h = np.radians((h_1 + turn / 2) % 360)
    t = (
        1
        - 0.17 * np.cos(h - np.radians(30))
        + 0.24 * np.cos(2 * h)
        + 0.32 * np.cos(3 * h + np.radians(6))
        - 0.20 * np.cos(4 * h - np.radians(63))
    )
    rotation = np.radians(60 * np.exp(-(((np.degrees(h) - 275) / 25) ** 2)))
    r_t = -2 * np.sqrt(c**7 / (c**7 + 25.0**7)) * np.sin(rotation)
    d_l = (second[..., 0] - first[..., 0]) / (1 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2))
    d_c = (c_2 - c_1) / (1 + 0.045 * c)
    d_h = 2 * np.sqrt(c_1 * c_2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * c * t)
    return np.asarray(np.sqrt(d_l**2 + d_c**2 + d_h**2 + r_t * d_c * d_h))


if __name__ == "__main__":
    main()

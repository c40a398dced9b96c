"""Measure the writing of large tables for other programs: samples a second, and the memory beyond that of the table's values.

``python benchmarks/export_writing.py`` writes ``benchmarks/results/export_writing.json``. Every format of rows of numbers on a grid writes the same number of samples, which are given, so that
neither the BSDF nor the choice of nodes counts. Times are of the processor, and stand beside a floor in the same process: the conversion of the numbers alone. Each format is measured in a
process of its own, because memory is a peak.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from brdfpipe import facets
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.table_error import TableError
from brdfpipe.exchange import gridded, number_text
from brdfpipe.exchange.registry import FORMATS, GRID_OPTIONS
from brdfpipe.geometry import Array

PROJECT = Path(__file__).resolve().parents[1]
OTHERS = ("rgl", "mdl", "tensor-tree", "openmaterial", "bird")
"""Formats on a grid that are binary, trees, or JSON."""
WANTED_SPEED, WANTED_MEMORY = 1e6, 200.0
"""Samples a second, and MB."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Given(gridded.Gridded):
    """A table whose values cost nothing."""

    values: Array | None = None

    def block(self, row: int) -> Array:
        assert self.values is not None
        values = np.roll(self.values, row, axis=0)
        circle = self.layout == "uniform" and self.axes["phi_o"][-1] > 180
        return np.concatenate([values, values[:, -2::-1]], axis=1) if circle else values

    def integral(self, theta_i: float, values: Array) -> Array:
        return np.full(self.channel_count, 0.5)


@click.command()
@click.option("--samples", default=10_000_000, show_default=True)
@click.option("--only", default="", help="Measure this format in this process.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=PROJECT / "benchmarks" / "results" / "export_writing.json"
)
def main(samples: int, only: str, out: Path) -> None:
    """Measure every text format on a grid."""
    if only:
        print(json.dumps(measured(only, samples)))
        return
    formats = [name for name, format in FORMATS.items() if format.takes == "grid" and name not in OTHERS]
    command = [sys.executable, __file__, "--samples", str(samples), "--only"]
    rows = {name: json.loads(subprocess.check_output([*command, name])) for name in formats}
    summary: Record = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        "samples": samples,
        "formats": rows,
        "met": all(
            row["samples_per_s"] >= WANTED_SPEED and row["extra_megabytes"] <= WANTED_MEMORY for row in rows.values()
        ),
    }
    out.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary, indent=1))


def measured(name: str, samples: int) -> Record:
    """Writing of one format."""
    bsdf, format = microfacet.build(facets.analytic("beckmann", 0.2), index=1.5), FORMATS[name]
    layout = "specular" if name in ("zemax", "integra", "ssdd") else "uniform"
    table = given(bsdf, layout, samples)
    gridded.gridded = lambda *_, **__: table  # type: ignore[assignment]
    writer, suffixes = next(iter(format.files["reflection"].items()))
    write, options = format.function(writer), {**GRID_OPTIONS, **format.options}
    # What is compiled or kept once is not part of a file.
    with tempfile.TemporaryDirectory() as folder:
        small = given(bsdf, layout, 100_000)
        gridded.gridded = lambda *_, **__: small  # type: ignore[assignment]
        write(bsdf, Path(folder, f"small{suffixes[0]}"), **options)
        gridded.gridded = lambda *_, **__: table  # type: ignore[assignment]
        path, before, begin = Path(folder, f"x{suffixes[0]}"), present_memory(), time.process_time()
        record = write(bsdf, path, **options)
        seconds, size = time.process_time() - begin, path.stat().st_size
    written = record["values"]
    return {
        "values": written,
        "samples_per_s": round(written / seconds),
        "of_the_numbers_alone": round(floor() * written / seconds, 2),
        "extra_megabytes": round(peak_memory() - before),
        "file_megabytes": round(size / 1e6),
    }


def given(bsdf: Any, layout: str, samples: int) -> Given:
    """A table of about so many values: 100 incidences, and four times as many azimuths as polar angles."""
    polar = round((samples / 400) ** 0.5)
    names = ("theta_o", "phi_o") if layout == "uniform" else ("theta_s", "phi_s")
    axes = {
        "theta_i": np.linspace(0, 85, 100),
        names[0]: np.linspace(0, 89.5 if layout == "uniform" else 179, polar),
        names[1]: np.linspace(0, 180, 4 * polar),
    }
    values = np.random.default_rng(0).lognormal(size=(polar, 4 * polar, 1))
    error = TableError(0.01, 0.01, 0.001, 3000)
    return Given(bsdf, layout, axes, gridded.photopic(bsdf), np.ones((1, 1, 1, 1)), error, True, values)


def floor() -> float:
    """Seconds for the text of one number."""
    values = np.random.default_rng(0).lognormal(size=(1000, 1000))
    times = []
    for _ in range(3):
        begin = time.process_time()
        number_text.rows(values)
        times.append(time.process_time() - begin)
    return min(times) / values.size


def present_memory() -> float:
    """Memory of this process now [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def peak_memory() -> float:
    """Most memory that this process has had [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    main()

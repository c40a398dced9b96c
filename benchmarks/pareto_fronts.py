"""Error, time and bytes of every model of the example materials, for every scene: the fronts of the trade of speed for accuracy.

``python benchmarks/pareto_fronts.py`` builds the examples, then every rung of every ladder of those whose BRDF is predicted, and writes
the tables of docs/tradeoff.md, a figure for each scene, and benchmarks/results/pareto_fronts.json. It names what became slower or less
accurate than that file said. Times are of the processor, of one thread, after compilation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
from previous import compare
from tradeoff import measure

from brdfpipe import store
from brdfpipe.catalogue.catalogue import load
from brdfpipe.descriptions.rendering import with_section
from brdfpipe.report.plots.svg import Axis, Line, Points, chart
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.experience import candidate_of
from brdfpipe.scenes.ladders import FULLEST, LADDERS, SPECTRAL_LADDERS, Candidate
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.scene import Scene, load_scene, shipped_scenes

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "tradeoff.md"
FIGURES = PROJECT / "docs" / "tradeoff"
RECORD = PROJECT / "benchmarks" / "results" / "pareto_fronts.json"
SECTION = "pareto fronts"

INPUTS = ("index", "spectrum", "facets", "psd", "surface")
COLUMNS = ("Slopes", "Optics", "Masking", "Reflections", "Other")
_RUNGS = [[rung.name for rung in ladder] for ladder in LADDERS.values()]
NEGLIGIBLE = 0.01
"""Change of an error over the tolerance of the scene that says nothing."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""By material: Okabe and Ito's, which colour-blind readers tell apart."""
STYLE = (
    ".fig{background:#fff}text{font:12px sans-serif;fill:#555}.t{fill:#111}.g{fill:none;stroke:#e4e4e4}.a{fill:none;stroke:#888}"
    ".l{fill:none;stroke-width:2}.p{stroke-linecap:round;stroke-width:6}.d{stroke-dasharray:5 4;stroke-width:1.5}"
)


def candidates(inputs: ModelInputs) -> list[Candidate]:
    """Every treatment of the surface, and one step down of each ladder of base, index and bands."""
    steps = [{"bands": "one"}, {"bands": "three"}, {"bands": "every 40 nm"}] if inputs.spectrum is not None else []
    if inputs.spectrum is not None:
        steps.append({"diffuse": "none"})
    if np.ptp(inputs.index["n"].values) > 0:
        steps.append({"index": "constant"})
    return [*inputs.structures, *(replace(FULLEST, **step) for step in steps)]


def example_inputs(results: Path) -> Iterator[tuple[str, ModelInputs]]:
    """Name and inputs of the examples whose BRDF is predicted from a surface; their datasets are built in a folder."""
    command = [sys.executable, "-m", "brdfpipe.cli", "build", PROJECT / "examples", "--results", results]
    subprocess.run([*command, "--scene", "luminaire-raytrace"], check=True, capture_output=True)
    for material in load(PROJECT / "examples").materials:
        folder = results / material.name
        if material.has("surface") and material.has("index") and not material.has("slab") and not material.has("rig"):
            files = {name: folder / f"{name}.nc" for name in INPUTS}
            yield (
                material.name,
                ModelInputs(**{name: store.open_dataset(path, name) for name, path in files.items() if path.exists()}),
            )


def measured(inputs: ModelInputs, scenes: Sequence[Scene]) -> dict[str, Any]:
    """Rows of :func:`tradeoff.measure`, with the time over that of the fullest."""
    fullest = build(FULLEST, inputs)
    rows = measure(inputs, candidates(inputs), scenes, fullest)
    reference = rows[FULLEST.key]["cost"]
    return {key: {**row, "relative_time": row["cost"] / reference} for key, row in rows.items() if "cost" in row}


# --- fronts


def front(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Names of the points (error, cost) than which none is both more accurate and cheaper, the cheapest first."""
    found: list[str] = []
    least = np.inf
    for name in sorted(points, key=lambda name: (points[name][1], points[name][0])):
        if points[name][0] < least:
            found.append(name)
            least = points[name][0]
    return found


def points_of(rows: Mapping[str, Any], scene: str) -> dict[str, tuple[float, float]]:
    """Error and cost by candidate, of those that were compared for the scene."""
    return {key: (row["errors"][scene], row["cost"]) for key, row in rows.items() if scene in row["errors"]}


def record(materials: Mapping[str, Mapping[str, Any]], scenes: Sequence[Scene]) -> list[dict[str, Any]]:
    """One row for each scene, material and candidate, as :func:`previous.compare` reads them."""
    rows = []
    for scene in scenes:
        negligible = NEGLIGIBLE * scene.content["tolerance"]
        for name, of_material in materials.items():
            points = {
                key: (_rounded(error), _rounded(cost))
                for key, (error, cost) in points_of(of_material, scene.name).items()
            }
            on_front = set(front(points))
            for key, (error, cost) in points.items():
                rows.append(
                    {
                        "choice": f"{scene.name}, {name}",
                        "option": str(candidate_of(key)),
                        "errors": {scene.content["metric"]: {"value": error, "negligible": negligible}},
                        "relative_time": {"build": _rounded(of_material[key]["relative_time"])},
                        "seconds": cost,
                        "bytes": of_material[key]["bytes"],
                        "on_front": key in on_front,
                    }
                )
    return rows


def recorded(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What :func:`section` needs of each material, by candidate, from the rows of a record."""
    keys = {str(one): one.key for one in (Candidate(*rungs) for rungs in product(*_RUNGS))}
    materials: dict[str, dict[str, Any]] = {}
    for row in rows:
        scene, name = row["choice"].split(", ")
        found = materials.setdefault(name, {}).setdefault(keys[row["option"]], {"errors": {}})
        found["errors"][scene] = next(iter(row["errors"].values()))["value"]
        found |= {"cost": row["seconds"], "bytes": row["bytes"]}
    return materials


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


# --- page


def section(materials: Mapping[str, Mapping[str, Any]], scenes: Sequence[Scene]) -> str:
    """The tables and figures of all scenes as Markdown."""
    lines: list[str] = []
    for scene in scenes:
        metric, unit, tolerance = (scene.accepted_error[name] for name in ("metric", "unit", "tolerance"))
        lines += [f"### `{scene.name}`", "", f"Metric {metric}, accepted {tolerance:g} {unit}.", ""]
        lines += [f"![Error against time of the models for {scene.name}](tradeoff/{scene.name}.svg)", ""]
        lines += [f"| Material | {' | '.join(COLUMNS)} | Error | Time, s | Bytes |", "|---" * (len(COLUMNS) + 4) + "|"]
        for name, rows in materials.items():
            points = points_of(rows, scene.name)
            for key in front(points):
                error, cost = points[key]
                accepted = "**" if error <= tolerance else ""
                model = " | ".join(_columns(candidate_of(key)))
                size = _size(rows[key]["bytes"])
                lines.append(f"| {name} | {model} | {accepted}{error:.2g}{accepted} | {cost:.2g} | {size} |")
        lines.append("")
    return "\n".join(lines).rstrip()


def _columns(candidate: Candidate) -> list[str]:
    """The cells of :data:`COLUMNS`: the rungs of the surface, and what of base, index and bands is not the fullest."""
    rungs = candidate.rungs
    other = [f"{name} {rungs[name]}" for name in SPECTRAL_LADDERS if rungs[name] != FULLEST.rungs[name]]
    if candidate.distribution == "lambert":
        return ["lambert", "", "", "", ""]
    return [*(rung for name, rung in rungs.items() if name not in SPECTRAL_LADDERS), ", ".join(other)]


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"


def figure(materials: Mapping[str, Mapping[str, Any]], scene: Scene) -> str:
    """All models as points of error against time, the front of each material as a line, and the tolerance."""
    of_scene = {name: points_of(rows, scene.name) for name, rows in materials.items()}
    costs = [cost for points in of_scene.values() for _, cost in points.values()]
    tolerance = scene.content["tolerance"]
    least = tolerance / 1000
    errors = [max(error, least) for points in of_scene.values() for error, _ in points.values()]
    x = Axis("processor time of the build [s]", min(costs) / 1.5, max(costs) * 1.5, log=True)
    unit = scene.accepted_error["unit"]
    y = Axis(f"error, metric {scene.content['metric']} [{unit}]", least / 1.5, max(*errors, tolerance) * 2, log=True)
    marks: list[Any] = [Line([x.low, x.high], [tolerance, tolerance], "tolerance", pattern="dash")]
    for number, points in enumerate(of_scene.values()):
        along = front(points)
        marks.append(
            Line([points[key][1] for key in along], [max(points[key][0], least) for key in along], f"c{number}")
        )
        shown = [(cost, max(error, least)) for error, cost in points.values()]
        marks.append(Points(*zip(*shown, strict=True), style=f"c{number}"))
    words = (
        f"Error against processor time for {scene.name}; dashed: what the scene accepts; at the lowest line: no error"
    )
    colours = "".join(
        f".l.c{number}{{stroke:{colour}}}.p.c{number},.s.c{number}{{stroke:{colour};fill:{colour}}}"
        for number, colour in enumerate(COLOURS)
    )
    names = "".join(
        f'<text x="66" y="{246 + 16 * number}" style="fill:{COLOURS[number]}">{name}</text>'
        for number, name in enumerate(of_scene)
    )
    drawn = str(chart(words, x, y, marks, height=340))
    head = drawn.index(">") + 1
    return f"{drawn[:head]}<style>{STYLE}{colours}.tolerance{{stroke:#888}}</style>{drawn[head:-6]}{names}</svg>\n"


def with_tables(page: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The page with the tables of a record."""
    return with_section(page, SECTION, section(recorded(rows), [load_scene(name) for name in shipped_scenes()]))


@click.command(help=__doc__)
def main() -> None:
    scenes = [load_scene(name) for name in shipped_scenes()]
    with tempfile.TemporaryDirectory() as folder:
        found = list(example_inputs(Path(folder)))
        build(FULLEST, found[0][1])
        with click.progressbar(found, label="examples") as bar:
            materials = {name: measured(inputs, scenes) for name, inputs in bar}
    rows = record(materials, scenes)
    materials = recorded(rows)
    for sentence in compare(json.loads(RECORD.read_text()), rows) if RECORD.exists() else ():
        click.echo(sentence)
    lines = ",\n".join(json.dumps(row) for row in rows)
    store.write_text(RECORD, f"[\n{lines}\n]\n")
    FIGURES.mkdir(exist_ok=True)
    for scene in scenes:
        store.write_text(FIGURES / f"{scene.name}.svg", figure(materials, scene))
    store.write_text(PAGE, with_tables(PAGE.read_text(), rows))


if __name__ == "__main__":
    main()

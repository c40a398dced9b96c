"""What fewer rays, facets and nodes (:mod:`brdfpipe.scenes.numerics`) err by and save: random materials, and the table of docs/scenes.md.

``python benchmarks/quick_numerics.py`` takes some minutes on one core.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import xarray as xr
from random_materials import random_material

from brdfpipe.descriptions.rendering import with_section
from brdfpipe.errors import BrdfpipeError
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.numerics import FINE, USES
from brdfpipe.scenes.scene import load_scene
from brdfpipe.scenes.scene_keys import METRIC_UNITS

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "scenes.md"
RECORD = PROJECT / "benchmarks" / "results" / "quick_numerics.json"
FIRST_SEED = 20_000
"""Others than those of the materials on which the planner's errors are measured."""
MODELS = {"fullest": FULLEST, "Smith's masking": Candidate(masking="height-correlated")}
"""Models that are computed both ways: with traced masking, and with traced reflections alone."""
SCENES = {
    "gloss": ["gloss-sheet"],
    "colour": ["multiangle-qc"],
    "glare": ["dashboard-veiling-glare", "luminaire-raytrace"],
}
"""By metric the scenes whose domain an error is of; the largest counts."""


class Trial(NamedTuple):
    """One model of one material, computed both ways."""

    seed: int
    kind: str
    lay: str
    """A key of :data:`brdfpipe.scenes.numerics.USES`"""
    model: str
    metric: str
    error: float
    """In the unit of the metric"""
    fine: float
    """Processor time [s]"""
    quick: float


@click.command()
@click.option("--materials", default=20, show_default=True)
def main(materials: int) -> None:
    """Measure, print, and write the table."""
    tried(FIRST_SEED + 1)  # the first build loads libraries and compiled code
    trials: list[Trial] = []
    for seed in range(FIRST_SEED, FIRST_SEED + materials):
        found = tried(seed)
        print(seed, *found, sep="\n", flush=True)
        trials += found
    RECORD.write_text(json.dumps([trial._asdict() for trial in trials], indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(with_section(PAGE.read_text(encoding="utf-8"), "numerics", table(trials)), encoding="utf-8")


def tried(seed: int) -> list[Trial]:
    """A random material with each model that it does not refuse, for each metric that may have fewer numbers."""
    kind, inputs = random_material(seed)
    lay = "lay" if inputs.lay else "no lay"
    trials: list[Trial] = []
    for name, candidate in MODELS.items():
        try:
            built = {
                numerics: timed(candidate, inputs, numerics)
                for numerics in (FINE, *{use.numerics for use in USES[lay].values()})
            }
        except BrdfpipeError:
            continue
        fine, fine_time = built[FINE]
        for metric, use in USES[lay].items():
            quick, quick_time = built[use.numerics]
            error = max(METRICS[metric].error(quick, fine, load_scene(one).domain).value for one in SCENES[metric])
            trials.append(Trial(seed, kind, lay, name, metric, float(f"{error:.3g}"), fine_time, quick_time))
    return trials


def timed(candidate: Candidate, inputs: ModelInputs, numerics: str) -> tuple[xr.Dataset, float]:
    """The BSDF of a candidate, and the processor time of its build [s]."""
    begin = time.process_time()
    bsdf = build(candidate, inputs, numerics)
    return bsdf, round(time.process_time() - begin, 3)


def table(trials: list[Trial]) -> str:
    """The rows of the page, by metric and kind of surface."""
    rows = [
        "| Metric | Surface | Materials | Error, median | 95 % | largest | Processor time, fine → fewer |",
        "|---|---|---|---|---|---|---|",
    ]
    statements = []
    for lay, uses in USES.items():
        for metric, use in uses.items():
            of_metric = [trial for trial in trials if (trial.lay, trial.metric) == (lay, metric)]
            if not of_metric:
                continue
            unit = METRIC_UNITS[metric]
            kinds = sorted({trial.kind for trial in of_metric})
            groups = {kind: [trial for trial in of_metric if trial.kind == kind] for kind in kinds}
            if len(groups) > 1:
                groups["all"] = of_metric
            rows += [row(metric, unit, kind, group) for kind, group in groups.items()]
            within = np.mean([trial.error <= use.error for trial in of_metric])
            statements.append(f"{metric}, {lay}: {within:.0%} err by at most {use.error:g} {unit}".rstrip())
    return "\n".join([*rows, "", f"The planner takes the error off the tolerance. {'; '.join(statements)}."])


def row(metric: str, unit: str, kind: str, group: list[Trial]) -> str:
    """Of a kind of surface."""
    errors = np.array([trial.error for trial in group])
    fine, quick = (float(np.mean([getattr(trial, name) for trial in group])) for name in ("fine", "quick"))
    median, most, largest = (
        f"{value:.2g} {unit}".rstrip() for value in (np.median(errors), np.quantile(errors, 0.95), errors.max())
    )
    materials = len({trial.seed for trial in group})
    return f"| {metric} | {kind} | {materials} | {median} | {most} | {largest} | {fine:.2f} → {quick:.2f} s |"


if __name__ == "__main__":
    main()

"""What quick numerics (:mod:`brdfpipe.scenes.numerics`) err by and save: random materials without a lay, and the table of docs/scenes.md.

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
from brdfpipe.scenes.numerics import FINE, NUMERICAL_ERROR, QUICK
from brdfpipe.scenes.scene import load_scene

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "scenes.md"
RECORD = PROJECT / "benchmarks" / "results" / "quick_numerics.json"
FIRST_SEED = 20_000
"""Others than those of the materials on which the planner's errors are measured."""
MODELS = {"fullest": FULLEST, "Smith's masking": Candidate(masking="height-correlated")}
"""Models that are computed both ways: with traced masking, and with traced reflections alone."""


class Trial(NamedTuple):
    """One model of one material, computed both ways."""

    seed: int
    kind: str
    model: str
    error: float
    """Largest difference of gloss at 20, 60 and 85° [GU]"""
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
    """A random material with each model; none of a material with a lay, which has fine numerics, or one that the model refuses."""
    kind, inputs, domain = *random_material(seed), load_scene("gloss-sheet").domain
    trials: list[Trial] = []
    if inputs.lay:
        return trials
    for name, candidate in MODELS.items():
        try:
            (fine, fine_time), (quick, quick_time) = (timed(candidate, inputs, numerics) for numerics in (FINE, QUICK))
        except BrdfpipeError:
            continue
        error = METRICS["gloss"].error(quick, fine, domain).value
        trials.append(Trial(seed, kind, name, float(f"{error:.3g}"), fine_time, quick_time))
    return trials


def timed(candidate: Candidate, inputs: ModelInputs, numerics: str) -> tuple[xr.Dataset, float]:
    """The BSDF of a candidate, and the processor time of its build [s]."""
    begin = time.process_time()
    bsdf = build(candidate, inputs, numerics)
    return bsdf, round(time.process_time() - begin, 3)


def table(trials: list[Trial]) -> str:
    """The rows of the page, by kind of surface."""
    rows = [
        "| Surface | Materials | Error, median | 95 % | largest | Processor time, fine → quick |",
        "|---|---|---|---|---|---|",
    ]
    groups = {kind: [trial for trial in trials if trial.kind == kind] for kind in sorted({one.kind for one in trials})}
    for kind, group in [*groups.items(), ("all", trials)]:
        errors = np.array([trial.error for trial in group])
        fine, quick = (float(np.mean([getattr(trial, name) for trial in group])) for name in ("fine", "quick"))
        rows.append(
            f"| {kind} | {len({trial.seed for trial in group})} | {np.median(errors):.2g} GU | {np.quantile(errors, 0.95):.2g} GU | "
            f"{errors.max():.2g} GU | {fine:.2f} → {quick:.2f} s |"
        )
    within = np.mean([trial.error <= NUMERICAL_ERROR["gloss"] for trial in trials])
    return "\n".join(
        [
            *rows,
            "",
            f"{within:.0%} err by at most {NUMERICAL_ERROR['gloss']:g} GU, which the planner takes off the tolerance.",
        ]
    )


if __name__ == "__main__":
    main()

"""The trade of speed for accuracy: error and cost of every candidate model, for every scene with the cheapest model.

``python benchmarks/tradeoff.py`` builds the candidates of random materials, measures the error of each against the fullest
one by the metric and in the domain of each scene, and writes what the planner of scenes looks up (``config/scenes/experience``). Times are of the
processor, of one thread, after compilation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from brdfpipe import store
from brdfpipe.comparison.model_error import model_error
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.estimation import estimate
from brdfpipe.optics.index import refractive_index
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.experience import Experience, Known, Trial, candidate_of
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.planning import chosen, judge
from brdfpipe.scenes.scene import Scene, experience_file, load_scene, shipped_scenes

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

SIZE = 256
"""Heights along each axis of a random map."""
MATERIALS = 160
KINDS = {
    "normal": 0.22,
    "polished": 0.22,
    "two scales": 0.1,
    "GGX": 0.1,
    "cells": 0.12,
    "cells upside down": 0.12,
    "ridges": 0.12,
}
"""Kind of a random map → its share."""
METALS = 0.15
"""Share of random materials that are metals."""
OPTIONS: Mapping[str, Mapping[str, Any]] = {"glare": {"n": 2048}, "rendering": {"n": 256, "side": 32}}
RENDERED = 3
"""One in so many random materials is rendered: pictures cost more than all other metrics together."""


def planned_scenes() -> list[Scene]:
    """The shipped scenes that accept the cheapest model."""
    scenes = (load_scene(name) for name in shipped_scenes())
    return [scene for scene in scenes if scene.accepts_cheapest]


# --- materials


def random_material(seed: int) -> tuple[str, ModelInputs]:
    """A random material of one of :data:`KINDS`, and its kind."""
    rng = np.random.default_rng([seed, 77])

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    of_map, pitch = int(rng.integers(1 << 30)), 1.0
    if kind == "normal":
        height = relief_maps.gaussian(spread(0.02, 0.6), SIZE, of_map, length=spread(6, 20))
    elif kind == "polished":
        height = relief_maps.gaussian(0.1, SIZE, of_map, length=spread(4, 20))
        height, pitch = height / height.std() * spread(0.003, 0.4), 0.5
    elif kind == "two scales":
        height = relief_maps.two_scales(SIZE, of_map) * spread(0.1, 2)
    elif kind == "GGX":
        height = relief_maps.ggx_like(SIZE, of_map, width=spread(0.03, 0.3))
    elif kind == "ridges":
        height = relief_maps.ridges(SIZE, of_map, slope=spread(0.05, 0.4))
    else:
        height = relief_maps.cells(SIZE, of_map) * spread(0.15, 1.3) * (1 if kind == "cells" else -1)
    surface = samples.surface(height, (pitch, pitch))
    index: Any = float(rng.uniform(1.35, 1.7))
    spectrum = None
    if rng.random() < METALS:
        index = {"n": spread(0.2, 3), "k": spread(2, 7)}
    else:
        wavelength = np.arange(380.0, 781.0, 10.0)
        edge = np.tanh((wavelength - rng.uniform(450, 650)) / rng.uniform(20, 80))
        reflectance = np.clip(rng.uniform(0.05, 0.85) * (1 + rng.uniform(-0.35, 0.35) * edge), 0.05, 0.95)
        grey = samples.spectrum(0.3).interp(wavelength=wavelength)
        spectrum = grey.assign(total_reflectance=grey["total_reflectance"].copy(data=reflectance))
    return kind, ModelInputs(refractive_index(index), spectrum, estimate(surface), roughness_spectrum(surface), surface)


# --- measurements


def measure(inputs: ModelInputs, scenes: list[Scene]) -> dict[str, Any]:
    """Cost, size and error of every candidate, by its key; the error by scene, against the fullest."""
    fullest = build(FULLEST, inputs)
    rows: dict[str, Any] = {}
    for candidate in _candidates(inputs):
        start = time.process_time()
        try:
            bsdf = build(candidate, inputs)
        except BrdfpipeError as error:
            rows[candidate.key] = {"refused": str(error)}
            continue
        rows[candidate.key] = {"cost": time.process_time() - start, "bytes": bsdf.nbytes, "errors": {}}
        for scene in scenes:
            options = OPTIONS.get(scene.content["metric"], {})
            try:
                figure = METRICS[scene.content["metric"]].error(bsdf, fullest, scene.domain, **options)
            except BrdfpipeError as error:
                rows[candidate.key].setdefault("not compared", {})[scene.name] = str(error)
                continue
            rows[candidate.key]["errors"][scene.name] = figure.value
    return rows


def _candidates(inputs: ModelInputs) -> list[Candidate]:
    """The candidates of a planner, and one step down of each ladder of base, index and bands."""
    steps = [{"bands": "one"}, {"bands": "three"}, {"bands": "every 40 nm"}]
    if inputs.spectrum is not None:
        steps.append({"diffuse": "none"})
    if np.ptp(inputs.index["n"].values) > 0:
        steps.append({"index": "constant"})
    return [*inputs.structures, *(replace(FULLEST, **step) for step in steps)]


def _gloss_error(inputs: ModelInputs) -> float | None:
    """Largest error of the gloss of the fullest model against rays or diffraction on the map; None where none of them holds."""
    if inputs.surface is None:
        return None
    try:
        found = model_error(inputs.surface, build(FULLEST, inputs), inputs.facets)
    except BrdfpipeError:
        return None
    errors = np.abs(found["gloss_error"].where(found["gloss_valid"] > 0)).values
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else None


def measured_material(seed: int, folder: Path) -> Path:
    """Measure a random material; again only if the scenes changed since."""
    file = folder / f"{seed}.json"
    scenes = [one for one in planned_scenes() if one.content["metric"] != "rendering" or seed % RENDERED == 0]
    measured_for = {scene.name: scene.errors_of for scene in scenes}
    if not file.exists() or json.loads(file.read_text()).get("measured_for") != measured_for:
        kind, inputs = random_material(seed)
        row = {"name": f"{kind} {seed}", "features": features(inputs), "model_error": _gloss_error(inputs)}
        row |= {"candidates": measure(inputs, scenes), "measured_for": measured_for}
        store.write_text(file, json.dumps(row))
    return file


def experience_of(scene: Scene, rows: list[dict[str, Any]]) -> Experience:
    """What the planner looks up for a scene."""
    known = []
    for row in rows:
        trials = {
            candidate_of(key): Trial(one["errors"][scene.name], one["cost"])
            for key, one in row["candidates"].items()
            if scene.name in one.get("errors", {})
        }
        if not trials:
            continue
        of_metric = row["model_error"] if scene.content["metric"] == "gloss" else None
        known.append(Known(row["name"], row["features"], trials, of_metric))
    return Experience(scene.content["metric"], scene.errors_of, tuple(known))


def left_out(scene: Scene, experience: Experience) -> dict[str, float]:
    """The planner on each material by what was measured on the others: how often the tolerance held, and the cost of its choices."""
    held, costs, cheapest, fullest, decided = [], [], [], [], 0
    tolerance = scene.content["tolerance"]
    for number, known in enumerate(experience.materials):
        others = replace(experience, materials=experience.materials[:number] + experience.materials[number + 1 :])
        candidates = [one for one in known.trials if one.structure == one]
        choice = chosen(judge(candidates, known.features, others), tolerance).candidate
        decided += choice != FULLEST
        held.append(known.trials[choice].error <= tolerance)
        costs.append(known.trials[choice].cost)
        cheapest.append(min(known.trials[one].cost for one in candidates if known.trials[one].error <= tolerance))
        fullest.append(known.trials[FULLEST].cost)
    return {
        "materials": len(held),
        "held": float(np.mean(held)),
        "cheaper_than_fullest": decided / len(held),
        "cost_over_cheapest": float(np.sum(costs) / np.sum(cheapest)),
        "within_1.3": float(np.mean(np.array(costs) <= 1.3 * np.array(cheapest))),
        "saved": 1 - float(np.sum(costs) / np.sum(fullest)),
    }


@click.command(help=__doc__)
@click.option("--materials", default=MATERIALS, show_default=True, help="Random materials.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("tradeoff"),
    show_default=True,
    help="Where measurements are kept; those there are not repeated.",
)
@click.option("--processes", default=2, show_default=True)
def main(materials: int, folder: Path, processes: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    build(FULLEST, random_material(0)[1])
    with get_context("spawn").Pool(processes) as pool:
        work = pool.imap_unordered(partial(measured_material, folder=folder), range(materials))
        with click.progressbar(work, length=materials, label="materials") as bar:
            for _ in bar:
                pass
    rows = [json.loads((folder / f"{seed}.json").read_text()) for seed in range(materials)]
    for scene in planned_scenes():
        experience = experience_of(scene, rows)
        path = experience_file(scene.name)
        path.parent.mkdir(exist_ok=True)
        experience.write(path)
        click.echo(f"{scene.name}: {left_out(scene, experience)}")


if __name__ == "__main__":
    main()

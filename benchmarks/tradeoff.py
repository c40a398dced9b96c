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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.appearance.validity import SIGNIFICANT
from brdfpipe.comparison.model_error import model_error
from brdfpipe.descriptions.rendering import with_section
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets.analytic_distributions import analytic
from brdfpipe.facets.estimation import estimate
from brdfpipe.optics.index import refractive_index
from brdfpipe.psd.estimation import estimate as roughness_spectrum
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.error_regression import Prediction, Regression
from brdfpipe.scenes.experience import CERTAINTY, NEGLIGIBLE, Experience, Known, Trial, candidate_of
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.planning import chosen, judgement
from brdfpipe.scenes.scene import Scene, experience_file, load_scene, shipped_scenes

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import relief_maps
import samples

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tradeoff.md"
SIZE = 256
"""Heights along each axis of a random map."""
POINTS = 4096
"""Heights of a random line."""
MATERIALS = 160
KINDS = {
    "normal": 0.18,
    "polished": 0.2,
    "two scales": 0.08,
    "GGX": 0.1,
    "cells": 0.1,
    "cells upside down": 0.1,
    "ridges": 0.1,
    "line": 0.08,
    "named density": 0.06,
}
"""Kind of a random surface → its share."""
FURTHER = range(10_000, 10_040)
"""Seeds of further materials of a named density, which are cheap to measure."""
METALS = 0.15
"""Share of random materials that are metals."""
OPTIONS: Mapping[str, Mapping[str, Any]] = {"glare": {"n": 2048}, "rendering": {"n": 256, "side": 32}}
"""Options of metrics where errors are measured."""
FRESH: Mapping[str, Mapping[str, Any]] = {"glare": {"n": 10_240, "seed": 1}}
"""Options of metrics of directions where the choice is tested: at others, and more of them."""
FAR_OFF = 3.0
"""Error over the tolerance from which more directions do not change that a model is not accepted."""
ENOUGH_HELD = 0.99
"""Share of the materials whose choice has to err by less than the tolerance."""
DEVIATIONS = (CERTAINTY, 2.7, 3.1, 3.6, 4.2, 5.0)
"""Standard deviations above the expected error, at which its bound may be."""
REPEATS, ENOUGH = 2, 0.4
"""Most builds of a candidate, and the time [s] after which no other one follows."""
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
    kind = "named density" if seed in FURTHER else str(rng.choice(list(KINDS), p=list(KINDS.values())))
    surface, facets = random_surface(kind, rng)
    index: Any = float(rng.uniform(1.35, 1.7))
    spectrum = None
    if rng.random() < METALS:
        index = {"n": float(rng.uniform(0.2, 3)), "k": float(rng.uniform(2, 7))}
    else:
        wavelength = np.arange(380.0, 781.0, 10.0)
        edge = np.tanh((wavelength - rng.uniform(450, 650)) / rng.uniform(20, 80))
        reflectance = np.clip(rng.uniform(0.05, 0.85) * (1 + rng.uniform(-0.35, 0.35) * edge), 0.05, 0.95)
        grey = samples.spectrum(0.3).interp(wavelength=wavelength)
        spectrum = grey.assign(total_reflectance=grey["total_reflectance"].copy(data=reflectance))
    psd = None if surface is None else roughness_spectrum(surface)
    return kind, ModelInputs(refractive_index(index), spectrum, facets, psd, surface)


def random_surface(kind: str, rng: np.random.Generator) -> tuple[xr.Dataset | None, xr.Dataset]:
    """Heights of a kind, None of a named density, and their facets."""

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    seed, pitch = int(rng.integers(1 << 30)), 1.0
    if kind == "named density":
        return None, analytic(str(rng.choice(["beckmann", "ggx"])), spread(0.03, 0.6))
    if kind == "line":
        fine = rng.standard_normal(POINTS)
        height = np.fft.irfft(np.fft.rfft(fine) * np.exp(-((np.pi * np.fft.rfftfreq(POINTS) * spread(6, 20)) ** 2) / 2))
        height *= spread(0.02, 0.4) / np.diff(height).std()
    elif kind == "normal":
        height = relief_maps.gaussian(spread(0.02, 0.6), SIZE, seed, length=spread(6, 20))
    elif kind == "polished":
        height = relief_maps.gaussian(0.1, SIZE, seed, length=spread(4, 20))
        height, pitch = height / height.std() * spread(0.003, 0.4), 0.5
    elif kind == "two scales":
        height = relief_maps.two_scales(SIZE, seed) * spread(0.1, 2)
    elif kind == "GGX":
        height = relief_maps.ggx_like(SIZE, seed, width=spread(0.03, 0.3))
    elif kind == "ridges":
        height = relief_maps.ridges(SIZE, seed, slope=spread(0.05, 0.4))
    else:
        height = relief_maps.cells(SIZE, seed) * spread(0.15, 1.3) * (1 if kind == "cells" else -1)
    surface = samples.surface(height, (pitch, pitch))
    return surface, estimate(surface, isotropic=True if height.ndim == 1 else None)


# --- measurements


def measure(
    inputs: ModelInputs, candidates: Sequence[Candidate], scenes: Sequence[Scene], fullest: xr.Dataset
) -> dict[str, Any]:
    """Cost, size and error of candidates, by their keys; the error by scene, against the fullest, and that at fresh directions."""
    rows: dict[str, Any] = {}
    for candidate in candidates:
        try:
            bsdf, cost = timed(candidate, inputs)
        except BrdfpipeError as error:
            rows[candidate.key] = {"refused": str(error)}
            continue
        row: dict[str, Any] = {
            "cost": cost,
            "bytes": bsdf.nbytes,
            "errors": {},
            "fresh_errors": {},
        }
        rows[candidate.key] = row
        for scene in scenes:
            metric, tolerance = scene.content["metric"], scene.content["tolerance"]
            try:
                error = row["errors"][scene.name] = _error(metric, bsdf, fullest, scene, OPTIONS)
                if metric in FRESH and scene.domain.parts and 0 < error < FAR_OFF * tolerance:
                    row["fresh_errors"][scene.name] = _error(metric, bsdf, fullest, scene, FRESH)
            except BrdfpipeError as problem:
                row.setdefault("not compared", {})[scene.name] = str(problem)
    return rows


def timed(candidate: Candidate, inputs: ModelInputs) -> tuple[xr.Dataset, float]:
    """The BSDF of a candidate and the processor time of its build [s], the shortest of some where it is short."""
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < ENOUGH:
        start = time.process_time()
        bsdf = build(candidate, inputs)
        times.append(time.process_time() - start)
    return bsdf, min(times)


def _error(metric: str, bsdf: xr.Dataset, fullest: xr.Dataset, scene: Scene, options: Mapping[str, Any]) -> float:
    return METRICS[metric].error(bsdf, fullest, scene.domain, **options.get(metric, {})).value


def gloss_error(inputs: ModelInputs, fullest: xr.Dataset) -> float | None:
    """What the gloss of the fullest model errs by at least against rays or diffraction on the map; None where none of them holds.

    The largest error less twice the uncertainty of its reference: a tolerance is refused only where it is shown to be missed.
    """
    if inputs.surface is None:
        return None
    try:
        found = model_error(inputs.surface, fullest, inputs.facets)
    except BrdfpipeError:
        return None
    shown = np.abs(found["gloss_error"]) - SIGNIFICANT * found["gloss_error_u"]
    errors = shown.where(found["gloss_valid"] > 0).values
    return max(float(np.nanmax(errors)), 0.0) if np.isfinite(errors).any() else None


def measured_material(seed: int, folder: Path) -> Path:
    """Measure a random material; again only if the scenes changed since."""
    file = folder / f"{seed}.json"
    scenes = [one for one in planned_scenes() if one.content["metric"] != "rendering" or seed % RENDERED == 0]
    measured_for = {scene.name: scene.errors_of for scene in scenes}
    if not file.exists() or json.loads(file.read_text()).get("measured_for") != measured_for:
        kind, inputs = random_material(seed)
        fullest = build(FULLEST, inputs)
        row = {"name": f"{kind} {seed}", "features": features(inputs), "model_error": gloss_error(inputs, fullest)}
        row |= {"candidates": measure(inputs, inputs.structures, scenes, fullest), "measured_for": measured_for}
        store.write_text(file, json.dumps(row))
    return file


def experience_of(scene: Scene, rows: list[dict[str, Any]]) -> Experience:
    """What the planner needs to know for a scene."""
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
    least = NEGLIGIBLE * scene.content["tolerance"]
    return calibrated(scene, Experience(scene.content["metric"], scene.errors_of, tuple(known), least).fitted(), rows)


def calibrated(scene: Scene, experience: Experience, rows: Sequence[Mapping[str, Any]]) -> Experience:
    """With the smallest bounds for which enough materials that are left out hold the tolerance; the largest where none is enough."""
    for deviations in DEVIATIONS:
        experience = replace(experience, deviations=deviations)
        if left_out(scene, experience, rows)["held"] >= ENOUGH_HELD:
            break
    return experience


def left_out(scene: Scene, experience: Experience, rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The planner on each material by what was measured on the others: how often the tolerance held, and the cost of its choices.

    The parameters of the regressions are those of all materials: some ten numbers for each candidate.
    """
    fresh = {row["name"]: row["candidates"] for row in rows}
    candidates = dict.fromkeys(candidate for known in experience.materials for candidate in known.trials)
    errors = {one: _left_out(experience.error(one), experience.tried(one)) for one in candidates}
    expected_costs = {one: _left_out(experience.cost(one), experience.tried(one)) for one in candidates}
    held, costs, cheapest, fullest, decided = [], [], [], [], 0
    tolerance = scene.content["tolerance"]
    for known in experience.materials:
        judged = [
            judgement(one, errors[one].get(known.name), expected_costs[one].get(known.name), experience.deviations)
            for one in known.trials
        ]
        choice = chosen(judged, tolerance).candidate
        decided += choice != FULLEST
        error = fresh[known.name][choice.key]["fresh_errors"].get(scene.name, known.trials[choice].error)
        held.append(error <= tolerance)
        costs.append(known.trials[choice].cost)
        cheapest.append(min(trial.cost for trial in known.trials.values() if trial.error <= tolerance))
        fullest.append(known.trials[FULLEST].cost)
    return {
        "materials": len(held),
        "held": float(np.mean(held)),
        "cheaper": decided / len(held),
        "cost": float(np.sum(costs) / np.sum(cheapest)),
        "within 1.3": float(np.mean(np.array(costs) <= 1.3 * np.array(cheapest))),
        "saved": 1 - float(np.sum(costs) / np.sum(fullest)),
        "possible": 1 - float(np.sum(cheapest) / np.sum(fullest)),
    }


def _left_out(regression: Regression | None, tried: Sequence[Known]) -> dict[str, Prediction]:
    """Prediction for each material from the others, by its name."""
    predictions = [] if regression is None else regression.left_out()
    return {known.name: prediction for known, prediction in zip(tried, predictions, strict=regression is not None)}


def planner_table(figures: Mapping[str, Mapping[str, float]]) -> str:
    """The table of docs/tradeoff.md of what :func:`left_out` found for each scene."""
    lines = ["| Scene | Materials | Held | Cheaper | Cost | Within 1.3 | Saved | Possible |", "|---" * 8 + "|"]
    for name, one in figures.items():
        lines.append(
            f"| `{name}` | {one['materials']} | {one['held']:.1%} | {one['cheaper']:.0%} | {one['cost']:.2f} | "
            f"{one['within 1.3']:.0%} | {one['saved']:.0%} | {one['possible']:.0%} |"
        )
    return "\n".join(lines)


@click.command(help=__doc__)
@click.option("--materials", default=MATERIALS, show_default=True, help="Random materials of all kinds.")
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
        seeds = [*FURTHER, *range(materials)]
        work = pool.imap_unordered(partial(measured_material, folder=folder), seeds)
        with click.progressbar(work, length=len(seeds), label="materials") as bar:
            for _ in bar:
                pass
    rows = [json.loads((folder / f"{seed}.json").read_text()) for seed in seeds]
    figures = {}
    for scene in planned_scenes():
        experience = experience_of(scene, rows)
        path = experience_file(scene.name)
        path.parent.mkdir(exist_ok=True)
        experience.write(path)
        figures[scene.name] = left_out(scene, experience, rows)
    store.write_text(PAGE, with_section(PAGE.read_text(), "planner", planner_table(figures)))
    click.echo(planner_table(figures))


if __name__ == "__main__":
    main()

"""The trade of speed for accuracy: error and cost of every candidate model, for every scene with the cheapest model.

``python benchmarks/tradeoff.py`` builds the candidates of random materials, measures the error of each against the fullest
one by the metric and in the domain of each scene, and writes what the planner of scenes looks up (``config/scenes/experience``).
``python benchmarks/tradeoff.py --new`` then tries the planner on further random materials, which set nothing of it. Times are of the processor, of
one thread, after compilation.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import time
from collections.abc import Mapping, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np
import xarray as xr
from planner_figures import WidthError, calibrated, of_new_materials, shortest
from planner_record import LEFT_OUT, NEW_MATERIALS, SceneOutcomes, renewed
from random_materials import FURTHER, random_material

from brdfpipe import store
from brdfpipe.appearance.validity import SIGNIFICANT
from brdfpipe.bsdf import traced
from brdfpipe.bsdf.reference_solution import facet_smoothness, holds, phase_variance
from brdfpipe.comparison.model_error import model_error
from brdfpipe.errors import BrdfpipeError
from brdfpipe.references.height_mesh import HeightMesh
from brdfpipe.scenes import experience
from brdfpipe.scenes.candidate_model import build
from brdfpipe.scenes.experience import NEGLIGIBLE, Experience, Known, Trial, candidate_of
from brdfpipe.scenes.features import features
from brdfpipe.scenes.ladders import FULLEST, Candidate
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.numerics import FINE, numerics_for
from brdfpipe.scenes.scene import Scene, load_scene, measured_errors_file, shipped_scenes

MATERIALS = 160
NEW = 20_000
"""First seed of new materials, from which no parameter of the planner follows."""
OPTIONS: Mapping[str, Mapping[str, Any]] = {"glare": {"n": 2048}, "rendering": {"n": 256, "side": 32}}
"""Options of metrics where errors are measured."""
FRESH: Mapping[str, Mapping[str, Any]] = {"glare": {"n": 10_240, "seed": 1}}
"""Options of metrics of directions where the choice is tested: at others, and more of them."""
FAR_OFF = 3.0
"""Error over the tolerance from which more directions do not change that a model is not accepted."""
INCIDENCES = np.linspace(0.0, 85.0, 18)
"""Angles of incidence at which rays have to hold on the map of a reference [degree]."""
TRACED_RAYS = 200_000
"""Rays of each incidence of a reference."""
RENDERED = 3
"""One in so many random materials is rendered: pictures cost more than all other metrics together."""


def planned_scenes() -> list[Scene]:
    """The shipped scenes that accept the cheapest model."""
    scenes = (load_scene(name) for name in shipped_scenes())
    return [scene for scene in scenes if scene.accepts_cheapest]


# --- measurements


def measure(
    inputs: ModelInputs, candidates: Sequence[Candidate], scenes: Sequence[Scene], fullest: xr.Dataset
) -> dict[str, Any]:
    """Cost, size and error of candidates, by their keys; the error by scene, against the fullest, and that at fresh directions.

    They are of fine numerics. ``costs`` by scene are of those with which a model is planned for it.
    """
    rows: dict[str, Any] = {}
    numerics = {
        one.name: numerics_for(one.content["metric"], one.content["tolerance"], inputs.lay)[0] for one in scenes
    }
    for candidate in candidates:
        try:
            bsdf, cost = shortest(partial(build, candidate, inputs))
            costs = {FINE: cost}
            for name in set(numerics.values()) - {FINE}:
                _, costs[name] = shortest(partial(build, candidate, inputs, name))
        except BrdfpipeError as error:
            rows[candidate.key] = {"refused": str(error)}
            continue
        row: dict[str, Any] = {
            "cost": cost,
            "costs": {scene: costs[name] for scene, name in numerics.items()},
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


def model_errors(inputs: ModelInputs, fullest: xr.Dataset, scenes: Sequence[Scene]) -> dict[str, float | None]:
    """What the fullest model errs by at least, by scene; None where no reference holds on the map, or there is none.

    Gloss: :func:`gloss_error`. Other metrics: the error against the BSDF of rays that are traced over the map, less the error between two
    of these from different rays, which is more than the noise of one: metrics are distances.
    """
    metrics = {scene.content["metric"] for scene in scenes}
    found: dict[str, float | None] = {}
    if "gloss" in metrics:
        found |= {scene.name: gloss_error(inputs, fullest) for scene in scenes if scene.content["metric"] == "gloss"}
    references = _traced(inputs) if metrics - {"gloss"} else None
    for scene in scenes:
        if scene.name in found:
            continue
        found[scene.name] = None
        if references is not None:
            first, second = references
            metric = scene.content["metric"]
            try:
                error, noise = (_error(metric, one, first, scene, OPTIONS) for one in (fullest, second))
            except BrdfpipeError:
                continue
            found[scene.name] = max(error - noise, 0.0)
    return found


def _traced(inputs: ModelInputs) -> tuple[xr.Dataset, xr.Dataset] | None:
    """Two BSDFs of rays traced over the map, from different rays; None without a map, or where rays do not hold at all incidences."""
    surface = inputs.surface
    if (
        surface is None
        or surface["height"].ndim == 1
        or (inputs.facets is not None and inputs.facets["slope_density"].ndim == 2)
    ):
        return None
    slope = HeightMesh.of(surface).typical_slope
    variance, smoothness = (one(surface, INCIDENCES) for one in (phase_variance, facet_smoothness))
    if not holds(variance, slope, INCIDENCES, smoothness).traced.all():
        return None
    given = {"index": inputs.index, "spectrum": inputs.spectrum, "rays": TRACED_RAYS}
    return traced.build(surface, seed=1, **given), traced.build(surface, seed=2, **given)


def measured_material(seed: int, folder: Path) -> Path:
    """Measure a random material; again only if the scenes changed since."""
    file = folder / f"{seed}.json"
    scenes = [one for one in planned_scenes() if one.content["metric"] != "rendering" or seed % RENDERED == 0]
    measured_for = {scene.name: scene.errors_of for scene in scenes}
    if not file.exists() or json.loads(file.read_text()).get("measured_for") != measured_for:
        kind, inputs = random_material(seed)
        fullest = build(FULLEST, inputs)
        row: dict[str, Any] = {"name": f"{kind} {seed}"}
        row["features"], row["features_cost"] = shortest(partial(features, inputs))
        row["model_errors"] = model_errors(inputs, fullest, scenes)
        row |= {"candidates": measure(inputs, inputs.structures, scenes, fullest), "measured_for": measured_for}
        store.write_text(file, json.dumps(row))
    return file


def experience_of(scene: Scene, rows: list[dict[str, Any]]) -> Experience:
    """What the planner needs to know for a scene."""
    known = []
    for row in rows:
        trials = {
            candidate_of(key): Trial(one["errors"][scene.name], one["costs"][scene.name])
            for key, one in row["candidates"].items()
            if scene.name in one.get("errors", {})
        }
        if not trials:
            continue
        known.append(Known(row["name"], row["features"], trials, row["model_errors"].get(scene.name)))
    least = NEGLIGIBLE * scene.content["tolerance"]
    return Experience(scene.content["metric"], scene.errors_of, tuple(known), least).fitted()


# --- results


def measured_rows(seeds: Sequence[int], folder: Path, processes: int) -> list[dict[str, Any]]:
    """What was measured of random materials, of which those in the folder are not measured again."""
    folder.mkdir(parents=True, exist_ok=True)
    build(FULLEST, random_material(0)[1])
    with get_context("spawn").Pool(processes) as pool:
        work = pool.imap_unordered(partial(measured_material, folder=folder), seeds)
        with click.progressbar(work, length=len(seeds), label="materials") as bar:
            for _ in bar:
                pass
    return [json.loads((folder / f"{seed}.json").read_text()) for seed in seeds]


def write_experience(rows: list[dict[str, Any]]) -> list[str]:
    """Write the experience of every scene from its materials, and the table of the planner on each of these by the others.

    Returns
    -------
    Why a scene has no experience, which then takes the fullest model
    """
    refusals, found = [], {}
    for scene in planned_scenes():
        path = measured_errors_file(scene.name)
        try:
            tried, outcomes = calibrated(scene, experience_of(scene, rows), rows)
        except WidthError as refusal:
            path.unlink(missing_ok=True)
            refusals.append(f"{refusal}. {path} was removed: the scene takes the fullest model")
            continue
        path.parent.mkdir(exist_ok=True)
        tried.write(path)
        found[scene.name] = SceneOutcomes(scene.content["tolerance"], outcomes)
    renewed(LEFT_OUT, found)
    return refusals


def write_new_materials(rows: list[dict[str, Any]]) -> None:
    """Write the table of the planner with the shipped experience on materials that set nothing of it."""
    found = {}
    for scene in planned_scenes():
        if scene.experience_file is not None:
            start = time.process_time()
            known = experience.read(scene.experience_file)
            outcomes = of_new_materials(scene, known, time.process_time() - start, rows)
            found[scene.name] = SceneOutcomes(scene.content["tolerance"], outcomes)
    renewed(NEW_MATERIALS, found)


@click.command(help=__doc__)
@click.option("--materials", default=MATERIALS, show_default=True, help="Random materials of all kinds.")
@click.option(
    "--new",
    is_flag=True,
    help="Plan materials that set nothing, by the experience in config/scenes, and write their table alone.",
)
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("tradeoff"),
    show_default=True,
    help="Where measurements are kept; those there are not repeated.",
)
@click.option("--processes", default=2, show_default=True)
def main(materials: int, new: bool, folder: Path, processes: int) -> None:
    if new:
        write_new_materials(measured_rows(range(NEW, NEW + materials), folder, processes))
    elif refusals := write_experience(measured_rows([*FURTHER, *range(materials)], folder, processes)):
        raise click.ClickException("\n".join(refusals))


if __name__ == "__main__":
    main()

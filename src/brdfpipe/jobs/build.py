"""Build a catalogue or resume its build; materials that fail are listed on its page with their reasons.

Snakemake runs in this process, so no snakemake process remains when the build is killed. A second, short run without the materials
that failed makes the page of the catalogue. Damaged results that a stage could not read are deleted and computed again.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from brdfpipe.catalogue.catalogue import Catalogue, load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.names import DESCRIPTION, RESULT_MARKS
from brdfpipe.errors import abbreviated
from brdfpipe.jobs import budgets, cleanup, failures, pool, summary
from brdfpipe.jobs.failures import Failures
from brdfpipe.jobs.fingerprint import fingerprint
from brdfpipe.jobs.index import shared_index
from brdfpipe.jobs.interrupts import Interrupts, interruptible
from brdfpipe.jobs.lock import BuildError, locked
from brdfpipe.jobs.scene_notices import scene_notices
from brdfpipe.jobs.snakemake_run import LOG, SnakemakeRun
from brdfpipe.jobs.summary import Summary
from brdfpipe.scenes.scene import is_file

_REPETITIONS = 3
"""Of a run that ended early because a result vanished."""


def build(
    folder: Path,
    results: Path,
    *,
    cores: int,
    config: Path | None = None,
    scene: str | None = None,
    names: Sequence[str] = (),
    dry_run: bool = False,
) -> Summary:
    """Build a catalogue; results that are up to date are left alone.

    Parameters
    ----------
    folder : the catalogue
    results : folder of the results; made if missing
    cores : how many stages run at once
    config : a configuration instead of the project's own
    scene : of all materials, a name or a path, instead of those that the configuration and the materials name
    names : of the materials to build, with ``*`` and ``?`` as in the names of files; by default all. The page and the table of the
        catalogue stay as they are if names are given
    dry_run : only list what would run

    Raises
    ------
    CatalogueError, InputError, SceneError : the catalogue, the configuration or the scene cannot be used.
    BuildError : another build runs there, or snakemake itself failed.
    KeyboardInterrupt : stopped by the user, or Terminated, by SIGTERM; the next build resumes.
    """
    started = time.perf_counter()
    catalogue = load(folder, load_config(config), scene)
    _check_results_folder(results, catalogue)
    snakemake_config: dict[str, Any] = {"catalogue": str(catalogue.folder)}
    if config is not None:
        snakemake_config["settings"] = str(config.resolve())
    if scene is not None:
        snakemake_config["scene"] = str(Path(scene).resolve()) if is_file(scene) else scene
    selected = catalogue.selected(names)
    if names:
        snakemake_config["names"] = sorted(selected)
    with locked(results), interruptible(pool.close) as interrupts:
        if not dry_run:
            cleanup.remove_leftovers(results, LOG)
        failed_materials = failures.of_unwritable_folders(results, catalogue) | failures.of_plans(catalogue)
        run, index = SnakemakeRun(results, dry_run, interrupts.install), shared_index(results, fresh=True)
        mark, deleted = fingerprint(catalogue, results), list[str]()
        if failed_materials or not index.is_complete(mark):
            if not dry_run:
                cleanup.remove_unreadable_links(results, index.written)
            deleted = _run_until_complete(run, catalogue, snakemake_config, cores, failed_materials, interrupts)
            if not (dry_run or failed_materials or names):
                index.complete(mark, index.examined)
        stale = [] if dry_run else cleanup.mark_stale(results, catalogue, failed_materials)
        replaced = [] if dry_run else sorted(index.replaced)
    touched = {material for _, material in run.done}
    if dry_run:
        # Of what would run alone, so that a catalogue without changes costs nothing.
        failed_materials |= failures.of_formats(catalogue, touched & catalogue.by_name.keys() - failed_materials.keys())
    built_materials = [name for name in catalogue.by_name if name in selected and name not in failed_materials]
    folders = {name: results / catalogue.scene_of(name).folder / name for name in built_materials}
    if names and not dry_run:
        rows = summary.read_own_rows({name: path / "summary.nc" for name, path in folders.items()})
    else:
        tables = [] if dry_run else [results / one.folder for one in catalogue.scenes]
        rows = summary.read_rows(tables, built_materials)
    pages = {name: folders[name] / "report.html" for name in rows}
    notices = summary.notices(catalogue.folder, deleted, replaced, stale)
    of_scenes = scene_notices(catalogue.scenes, catalogue.config)
    over_budget = () if dry_run else tuple(budgets.exceeded(results, catalogue, built_materials))
    reasons = {name: f"{entry['stage']}: {entry['message']}" for name, entry in failed_materials.items()}
    page = results / catalogue.scene.folder / "index.html"
    if names:
        first = min(selected)
        page = results / catalogue.scene_of(first).folder / first / "report.html"
    return Summary(
        built=tuple(name for name in built_materials if name in touched),
        current=tuple(name for name in built_materials if name not in touched),
        failures={name: reason for name, reason in {**catalogue.failures, **reasons}.items() if name in selected},
        jobs=sum(rule != "all" for rule, _ in run.done),
        page=page if dry_run or page.exists() else None,
        seconds=time.perf_counter() - started,
        dry_run=dry_run,
        verdicts={name: row.verdict for name, row in rows.items() if row.verdict},
        fail_reasons={name: row.reasons for name, row in rows.items() if row.verdict == "fail"},
        refused_exports={name: row.refused_exports for name, row in rows.items() if row.refused_exports},
        pages={name: page for name, page in pages.items() if page.exists()},
        over_budget=over_budget,
        notices=(*of_scenes, *notices),
    )


def refuse_outdated(folder: Path, results: Path, config: Path | None = None) -> None:
    """Refuse results that are not those of the present inputs, keys, code and libraries; nothing is built.

    Raises
    ------
    BuildError : a build would compute something, or a material cannot be built; it names the materials and the command to run.
    CatalogueError, InputError, SceneError : as in :func:`build`.
    """
    summary = build(folder, results, cores=1, config=config, dry_run=True)
    if summary.failures:
        raise BuildError(
            f"materials that cannot be built: {abbreviated(sorted(summary.failures), 5)}; mend or remove them before a release"
        )
    if summary.jobs:
        named = f"of {abbreviated(list(summary.built), 5)}" if summary.built else "of the catalogue"
        options = f" --config {config}" if config else ""
        raise BuildError(
            f"{results}: the results {named} are not those of the present inputs ({summary.jobs} jobs would run); "
            f"run `brdfpipe build {folder} --results {results}{options}` first"
        )


def _run_until_complete(
    run: SnakemakeRun,
    catalogue: Catalogue,
    snakemake_config: Mapping[str, Any],
    cores: int,
    failed_materials: Failures,
    interrupts: Interrupts,
) -> list[str]:
    """Run snakemake, again after deleting damaged files, and again without the materials that failed (added to ``failed_materials``).

    The loop ends: each iteration deletes a file for the first time in this build, leaves out one more material, or is one of a few
    repetitions after a result vanished. Returns the deleted files.
    """
    deleted: list[str] = []
    repetitions = 0
    dependents = failures.dependents(catalogue)
    while True:
        succeeded = run.start({**snakemake_config, "failures": failed_materials}, cores)
        interrupts.check()
        names = {material.name for material in catalogue.materials} - failed_materials.keys()
        new: Failures = {}
        if not run.dry_run:  # the records of a dry run are of the previous build
            new = failures.of_jobs(run.results, run.failed, names, dependents, LOG)
            new |= failures.of_vanished_files(catalogue, names)
            damaged = cleanup.delete_damaged(run.results, deleted)
            deleted += damaged
            if damaged:
                continue
        if not succeeded and not new:
            new = failures.of_unwritable_files(run.errors, names)
        if succeeded and not new:
            return deleted
        if not new and run.missed_files and repetitions < _REPETITIONS:
            repetitions += 1
            pool.close()  # snakemake stops all materials where an input is missing; what still runs must not meet the next run
            continue
        if not new:
            raise BuildError(_reason(run))
        failed_materials |= new


def _reason(run: SnakemakeRun) -> str:
    """Why a run ended early although no material failed."""
    if record := failures.recorded(run.results).get("catalogue"):
        return f"the catalogue page could not be made: {record['message']}"
    reason = run.errors[0].partition(" File ")[0] if run.errors else "stopped before its end; run it again to resume"
    return f"{run.results}: {reason} (see {run.results / LOG})"


def _check_results_folder(results: Path, catalogue: Catalogue) -> None:
    """Refuse a file, a folder of raw files, and a folder of other files."""
    target = results.resolve()
    if target == catalogue.folder or any((folder / DESCRIPTION).is_file() for folder in (target, *target.parents)):
        raise BuildError(f"{results}: is a folder of the catalogue; choose a separate folder for the results")
    if target.exists() and not target.is_dir():
        raise BuildError(f"{results}: is a file; results need a folder")
    if target.is_dir() and not any((target / mark).exists() for mark in RESULT_MARKS):
        unexpected_files = sorted(item.name for item in target.iterdir() if not item.name.startswith("."))
        if unexpected_files:
            raise BuildError(
                f"{results}: holds other files ({unexpected_files[0]}) and no results; choose a new or an empty folder"
            )

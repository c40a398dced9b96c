"""Which materials could not be built, at which stage and why: from failed jobs, unusable runs and folders that cannot be written."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.format_checks import check_formats
from brdfpipe.catalogue.names import CALIBRATIONS
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.runs import planned_runs
from brdfpipe.scenes.scene import FOLDER

Failures = dict[str, dict[str, str]]
"""Material → ``stage`` and ``message``."""


def recorded(results: Path) -> Failures:
    """Failures that jobs recorded, those of calibrations and of the catalogue included."""
    records = [json.loads(path.read_text(encoding="utf-8")) for path in (results / "failures").glob("*.json")]
    return {record["material"]: {"stage": record["stage"], "message": record["message"]} for record in records}


def of_jobs(
    results: Path,
    failed_jobs: Iterable[tuple[str, str]],
    names: Collection[str],
    dependents: Mapping[str, tuple[str, ...]],
    log: str,
) -> Failures:
    """Materials with a failed stage, and materials that need what failed.

    Parameters
    ----------
    failed_jobs : (rule, material) of jobs that snakemake reports as failed
    names : the materials of the build
    dependents : see :func:`dependents`
    log : the log of the build, for jobs that recorded no failure
    """
    records = recorded(results)
    for rule, material in failed_jobs:
        if material in names:
            records.setdefault(material, {"stage": rule, "message": f"failed and recorded no reason (see {log})"})
    failures = {name: record for name, record in records.items() if name in names}
    for owner, record in records.items():
        for name in set(names).intersection(dependents.get(owner, ())):
            failures.setdefault(name, _needs(owner, record))
    return failures


def dependents(catalogue: Catalogue) -> dict[str, tuple[str, ...]]:
    """Calibration or material → materials that need it."""
    measured = [material for material in catalogue.materials if material.has("rig")]
    needs = [
        (f"{CALIBRATIONS}.{calibration}", material.name)
        for material in measured
        for calibration in catalogue.calibrations_of(material)
    ]
    emulated = [material for material in measured if "emulate" in material.content["rig"]]
    needs += [(material.content["rig"]["emulate"]["truth"], material.name) for material in emulated]
    return {owner: tuple(name for other, name in needs if other == owner) for owner, _ in needs}


def of_plans(catalogue: Catalogue) -> Failures:
    """Materials whose run of a rig has an unusable plan, and materials that need such a run."""
    failures = {name: {"stage": "check", "message": reason} for name, reason in planned_runs(catalogue)[1].items()}
    for owner, names in dependents(catalogue).items():
        if owner in failures:
            failures |= {name: _needs(owner, failures[owner]) for name in names if name not in failures}
    return failures


def of_formats(catalogue: Catalogue, names: Collection[str]) -> Failures:
    """Materials whose description ``check`` refuses without reading their raw files; a build refuses them in a stage."""
    refused: Failures = {}
    for name in sorted(names):
        try:
            check_formats(catalogue[name])
        except BrdfpipeError as error:
            refused[name] = {"stage": "check", "message": str(error)}
    return refused


def of_vanished_files(catalogue: Catalogue, names: Collection[str]) -> Failures:
    """Materials of which a raw file has vanished since the catalogue was read."""
    lost = {name: [file.name for file in catalogue[name].files.values() if not file.exists()] for name in sorted(names)}
    return {
        name: {"stage": "check", "message": f"{files[0]}: vanished during the build"}
        for name, files in lost.items()
        if files
    }


def of_unwritable_folders(results: Path, catalogue: Catalogue) -> Failures:
    """Materials whose folder of results cannot be written: one of them would stop snakemake for all materials."""
    folders = [
        (material.name, Path(folder, material.name, part))
        for material in catalogue.materials
        for folder in dict.fromkeys(("", material.scene.folder))
        for part in (".", "exports")
    ]
    return {
        name: _blocked(str(folder), "the folder cannot be written")
        for name, folder in folders
        if (results / folder).exists() and not os.access(results / folder, os.W_OK | os.X_OK)
    }


def of_unwritable_files(errors: Iterable[str], names: Collection[str]) -> Failures:
    """Materials with an old result that snakemake could not replace, from its error messages."""
    failures = {}
    for error in errors:
        blocked = [(file, reason) for reason, file in re.findall(r"\[Errno \d+\] ([^:]+): '([^']+)'", error)]
        protected = re.findall(r"Write-protected output .* affected files: (\S+)", error)
        for file, reason in blocked + [(file, "write-protected") for file in protected]:
            parts = Path(file).parts
            start = next((position for position, part in enumerate(parts) if part in names), None)
            if start is not None:
                of_scene = start >= 2 and parts[start - 2] == FOLDER
                shown = "/".join(parts[start - 2 if of_scene else start :])
                failures[parts[start]] = _blocked(shown, f"cannot be replaced ({reason})")
    return failures


def _needs(owner: str, record: Mapping[str, str]) -> dict[str, str]:
    return {"stage": record["stage"], "message": f"it needs {owner}, which could not be made: {record['message']}"}


def _blocked(path: str, problem: str) -> dict[str, str]:
    return {"stage": "results", "message": f"{path}: {problem}; make it writable or delete it"}

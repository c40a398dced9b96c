"""Old files in a folder of results: leftovers of a killed build, damaged results, results of removed materials."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.names import CHANGES, RESERVED
from brdfpipe.scenes.scene import FOLDER

TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
"""Names of files that the store has not finished."""

STALE = "STALE.txt"
"""File that marks the results of a material as older than the catalogue."""


NOTES = ("logs", "failures", CHANGES)
"""Folders and files of results that are notes about builds, not their results."""


def remove_leftovers(results: Path, log: str) -> None:
    """Remove unfinished files, failures and the log of an earlier build."""
    forget_failures(results)
    (results / log).unlink(missing_ok=True)
    of_scene = (".*.tmp", "*/.*.tmp", "*/exports/.*.tmp")
    for pattern in (*of_scene, *(f"{FOLDER}/*/{one}" for one in of_scene)):
        for leftover in results.glob(pattern):
            if TEMPORARY.fullmatch(leftover.name):
                with suppress(OSError):  # a folder that cannot be written is reported as a failure
                    leftover.unlink()


def remove_unreadable_links(results: Path, written: Iterable[str]) -> None:
    """Remove links that lead nowhere or in a circle from the places of results: snakemake would end the whole build."""
    for name in written:
        path = results / name
        if path.is_symlink() and not path.exists():
            with suppress(OSError):  # a folder that cannot be written is reported as a failure
                path.unlink()


def forget_failures(results: Path) -> None:
    """Delete the records of failed stages."""
    for record in (results / "failures").glob("*.json"):
        with suppress(OSError):
            record.unlink()


def delete_damaged(results: Path, deleted_before: Collection[str]) -> list[str]:
    """Delete the results that a stage could not read, and the failures that they caused; return the files, those that vanished included.

    A file is deleted once in a build: ``deleted_before`` are left alone.
    """
    folder = results.resolve()
    names = {
        name
        for path in (results / "failures").glob("*.json")
        for name in json.loads(path.read_text(encoding="utf-8")).get("damaged", [])
    }
    damaged = sorted(
        name
        for name in names - set(deleted_before)
        if not (folder / name).is_dir() and (folder / name).resolve().is_relative_to(folder)
    )
    for name in damaged:
        (folder / name).unlink(missing_ok=True)
    if damaged:
        forget_failures(results)
    return damaged


def mark_stale(results: Path, catalogue: Catalogue, failed: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Mark reports and exports of materials that fail, left the catalogue or have another scene now; return the names of those that left.

    Results for a scene that is not built now stay as they are, unless the material left.
    """
    reasons = {**catalogue.failures, **{name: entry["message"] for name, entry in failed.items()}}
    built = {scene.folder for scene in catalogue.scenes}
    removed = []
    for place, folder in folders_of_materials(results):
        name, mark = folder.name, folder / STALE
        known = name in catalogue.by_name or name in reasons
        if not (folder / "report.html").exists() and not any(folder.glob("exports/*")):
            continue
        if known and place not in built:
            continue
        scene = catalogue.scene_of(name)
        if name not in reasons and known and scene.folder == place:
            mark.unlink(missing_ok=True)
            continue
        if name in reasons:
            reason = f"it cannot be built now: {reasons[name]}"
        elif known:
            reason = f"its scene is {scene.name} now."
        else:
            removed.append(name)
            reason = "no material of this name is in the catalogue."
        with suppress(OSError):  # a folder that cannot be written is reported as a failure
            mark.write_text(
                f"The results in this folder are of an earlier state of the material; {reason}\n"
                "The build that computes them again removes this file.\n",
                encoding="utf-8",
            )
    return sorted(set(removed))


def folders_of_materials(results: Path) -> Iterator[tuple[str, Path]]:
    """The folder of each material for each scene, with that of the scene in the results."""
    places = ["", *(f"{FOLDER}/{path.name}/" for path in sorted((results / FOLDER).glob("*")) if path.is_dir())]
    for place in places:
        for path in sorted(path for path in (results / place).iterdir() if path.is_dir() and path.name not in RESERVED):
            yield place, path

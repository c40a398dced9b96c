"""Delete results of materials and calibrations that are no longer in the catalogue, and old logs."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.names import CALIBRATIONS, LOCK, RESULT_MARKS
from brdfpipe.descriptions.keys import NAME
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.cleanup import folders_of_materials
from brdfpipe.jobs.index import Index
from brdfpipe.scenes.scene import FOLDER

KEPT = 10
"""Logs of snakemake that stay."""


@dataclass(frozen=True)
class Pruned:
    """Results without a material, and old logs."""

    paths: tuple[str, ...]
    """In relation to the folder of results."""
    size: int
    """Of all their files [byte]."""


def prune(results: Path, catalogue: Catalogue, *, keep: int = KEPT, dry_run: bool = False) -> Pruned:
    """Delete the results of materials and calibrations that left the catalogue, in all scenes, and their logs; and snakemake's old logs.

    Results of materials that cannot be built now stay, and so do those of other scenes and copies under other names. Links are not
    followed and not deleted.

    Parameters
    ----------
    results : folder of the results, under the lock of a build
    catalogue : what was built there
    keep : how many of snakemake's logs stay, the last ones; each run of it writes one
    dry_run : only list what would be deleted

    Raises
    ------
    BrdfpipeError : it is no folder of results, or no material of the catalogue has results there: it is probably another catalogue.
    OSError : a folder cannot be deleted.
    """
    if not any((results / mark).exists() for mark in RESULT_MARKS if mark != LOCK):
        raise BrdfpipeError(f"{results}: no build wrote results there; give the folder of the results")
    known = catalogue.by_name.keys() | catalogue.failures.keys()
    present = [path for _, path in folders_of_materials(results) if _is_result(path)]
    if present and not any(path.name in known for path in present):
        raise BrdfpipeError(
            f"{results}: holds results of {present[0].name} and others, and none of a material of {catalogue.folder}; "
            "give the catalogue that was built there"
        )
    paths = [path for path in present if path.name not in known]
    logs = [
        path
        for name in {path.name for path in paths}
        for path in (results / "logs" / name, *(results / "logs" / FOLDER).glob(f"*/{name}"))
        if path.is_dir()
    ]
    calibrations = [path for path in (results / CALIBRATIONS).glob("*") if _has_left(path, catalogue)]
    old = sorted((results / ".snakemake" / "log").glob("*.snakemake.log"))  # their names begin with the time
    old = old[: max(len(old) - keep, 0)]
    unused = [path for path in (*paths, *logs, *calibrations, *old) if not path.is_symlink()]
    size = sum(map(_size, unused))
    if not dry_run:
        for path in unused:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        _forget(results, unused)
    return Pruned(tuple(sorted(str(path.relative_to(results)) for path in unused)), size)


def _forget(results: Path, deleted: Sequence[Path]) -> None:
    """Forget the jobs that wrote what was deleted: nothing of it is missing."""
    index = Index(results)
    for job in list(index.jobs):
        if not {results / job, *(results / job).parents}.isdisjoint(deleted):
            index.forget(job)


def _is_result(folder: Path) -> bool:
    """Whether a folder has a name of a material and holds a dataset of it."""
    return bool(re.fullmatch(NAME, folder.name)) and any(_material(path) == folder.name for path in folder.glob("*.nc"))


def _material(path: Path) -> str | None:
    """The material of a stored dataset; None of another file."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as stored:
            return str(stored.getncattr("material"))
    except (OSError, RuntimeError, AttributeError):
        return None


def _has_left(path: Path, catalogue: Catalogue) -> bool:
    """Whether a file or folder of results is of a calibration that has no folder in the catalogue."""
    name = path.name.removesuffix(".nc")
    return bool(re.fullmatch(NAME, name)) and not (catalogue.folder / CALIBRATIONS / name).is_dir()


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if not file.is_dir())

"""Copies of results as they were on a night; what did not change since the copy before is stored once."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.index import INDEX, Index
from brdfpipe.jobs.lock import locked

MARK = ".snapshot"
"""File of a snapshot, with the time at which it was taken; only folders with it are ever deleted."""

_UNFINISHED = ".unfinished-"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True)
class Snapshot:
    """A copy of results, and what became of older ones."""

    path: Path
    copied: int
    """Files that are new or changed since the snapshot before."""
    linked: int
    """Files that are those of the snapshot before (hard links)."""
    deleted: tuple[str, ...]
    """Names of the snapshots that were deleted, the oldest first."""


def take_snapshot(
    results: Path, folder: Path, *, name: str | None = None, keep: int | None = None, now: datetime | None = None
) -> Snapshot:
    """Copy the files that builds wrote into a folder of their own, which appears whole or not at all.

    The results themselves are not touched. A file with the content of the snapshot before becomes a hard link to it, where the file system
    has these, so that a snapshot takes the space of what changed.

    Parameters
    ----------
    results : folder of results
    folder : of the snapshots; made if missing
    name : of the snapshot; by default its time in UTC, 2026-01-31T021500Z
    keep : how many snapshots stay, this one included, the last ones; by default all
    now : time of the snapshot, with its time zone; by default that of the clock

    Raises
    ------
    BrdfpipeError : there are no results with an index, the name is not accepted or exists, or the folder lies in the results.
    OSError : a file cannot be copied, or a folder not be deleted.
    """
    from tqdm import tqdm

    if not (results / INDEX).is_file():
        raise BrdfpipeError(f"{results}: no results with an index; run `brdfpipe build` first")
    if folder.resolve().is_relative_to(results.resolve()):
        raise BrdfpipeError(f"{folder}: lies in the results; choose a folder beside them")
    taken = (now or datetime.now(UTC)).astimezone(UTC)
    name = name or taken.strftime("%Y-%m-%dT%H%M%SZ")
    if not _NAME.fullmatch(name):
        raise BrdfpipeError(f"the name {name!r}: accepted are letters, digits, dots, hyphens and underscores")
    if (folder / name).exists():
        raise BrdfpipeError(f"{folder / name}: exists; give another --name")
    folder.mkdir(parents=True, exist_ok=True)
    earlier = snapshots(folder)
    known = _written(earlier[-1]) if earlier else {}
    counts = [0, 0]
    for leftover in folder.glob(f"{_UNFINISHED}*"):  # of a snapshot that was killed
        shutil.rmtree(leftover)
    with locked(results), tempfile.TemporaryDirectory(dir=folder, prefix=_UNFINISHED) as temporary:
        whole = Path(temporary, name)
        for path, digest in tqdm(sorted(_written(results).items()), unit="file", delay=2.0, disable=None, leave=False):
            source = results / path
            if not source.is_file():  # `brdfpipe verify` names it
                continue
            (whole / path).parent.mkdir(parents=True, exist_ok=True)
            same = bool(known.get(path) == digest) and _link(earlier[-1] / path, source, whole / path)
            if not same:
                shutil.copy2(source, whole / path)
            counts[same] += 1
        shutil.copy2(results / INDEX, whole / INDEX)
        (whole / MARK).write_text(taken.isoformat() + "\n", encoding="ascii")
        whole.rename(folder / name)
    surplus = snapshots(folder)[:-keep] if keep else []
    for old in surplus:
        shutil.rmtree(old)
    copied, linked = counts
    return Snapshot(folder / name, copied, linked, tuple(old.name for old in surplus))


def snapshots(folder: Path) -> Sequence[Path]:
    """The snapshots in a folder, the oldest first; other folders and links are left out."""
    times: dict[Path, datetime] = {}
    for mark in folder.glob(f"*/{MARK}"):
        if mark.parent.is_symlink():
            continue
        try:
            times[mark.parent] = datetime.fromisoformat(mark.read_text(encoding="ascii").strip())
        except (OSError, ValueError):  # not ours, or damaged: never deleted
            continue
    return sorted(times, key=lambda path: (times[path].timestamp(), path.name))


def _written(results: Path) -> dict[str, str]:
    """Path of each file that a job wrote → digest of its content; paths that lead out of the folder are left out."""
    written = {path: digest for record in Index(results).jobs.values() for path, digest in record.outputs.items()}
    return {
        path: digest for path, digest in written.items() if not (Path(path).is_absolute() or ".." in Path(path).parts)
    }


def _link(earlier: Path, source: Path, target: Path) -> bool:
    """Whether the file of the snapshot before could stand for a result."""
    try:
        if earlier.is_symlink() or earlier.stat().st_size != source.stat().st_size:
            return False
        os.link(earlier, target)
    except OSError:  # a file system without hard links, or with too many to this file
        return False
    return True

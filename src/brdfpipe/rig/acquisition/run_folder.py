"""The folder of a run: locked during a scan, and accepted only for a run of the same plan and rig."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from brdfpipe import store
from brdfpipe.errors import InputError
from brdfpipe.rig.plan import FRAMES, JOURNAL, LOCK, PLAN, Plan, sources


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create the folder if necessary and hold its lock. Raises InputError: another scan holds the lock, or the folder cannot be written."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, timeout=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        advice = "wait for it, or choose another --out"
        raise InputError(folder, "another scan is running in this folder", accepted=advice) from None
    except OSError as error:
        raise InputError(folder, f"cannot be written ({error.strerror})", accepted="another --out") from error
    try:
        yield
    finally:
        lock.release()


def prepare(plan: Plan, folder: Path, resume: bool) -> None:
    """Make the folder that of a run of this plan.

    Raises InputError: it holds other files, a run of another plan or rig, or a started run without ``resume``.
    """
    for leftover in [*folder.glob(".*.tmp"), *(folder / FRAMES).glob(".*.tmp")]:
        leftover.unlink(missing_ok=True)
    if not (folder / PLAN).exists():
        _copy_sources(plan, folder)
        return
    if differences := plan.differences(Plan.load(folder / PLAN)):
        found = "; ".join(differences) + " (this plan, and the existing run)"
        accepted = "the plan the run was started with, or another --out"
        raise InputError(folder, "holds a run of another plan or rig", found=found, accepted=accepted)
    finished = len(list((folder / FRAMES).glob("*.fits")))
    if not resume and (finished or (folder / JOURNAL).exists()):
        found, accepted = f"{finished} of {len(plan.shots)} frames", "--resume, or another --out"
        raise InputError(folder, "holds a run of this plan already", found=found, accepted=accepted)
    (folder / FRAMES).mkdir(exist_ok=True)


def _copy_sources(plan: Plan, folder: Path) -> None:
    files = sources(plan.path)
    expected = {FRAMES, LOCK, *(name.split("/")[0] for name in files)}
    if unexpected := sorted({item.name for item in folder.iterdir()} - expected):
        raise InputError(folder, "holds other files", found=unexpected[0], accepted="a new or empty folder")
    (folder / FRAMES).mkdir(exist_ok=True)
    # The plan comes last: a folder that holds it holds the other files too.
    for name in sorted(files, key=PLAN.__eq__):
        store.write_bytes(folder / name, files[name].read_bytes())

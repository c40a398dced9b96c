"""Run one stage: ``main`` of its script, with its log, its times and the record of its failure."""

from __future__ import annotations

import argparse
import json
import os
import runpy
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from brdfpipe import store
from brdfpipe.catalogue.names import CALIBRATIONS
from brdfpipe.errors import BrdfpipeError, naming_origin
from brdfpipe.scenes.scene import parts_within_scene

Files = Mapping[str, Any]
"""Name → path, or list of paths."""

Main = Callable[[Files, Files, Mapping[str, Any]], None]


@dataclass(frozen=True)
class Job:
    """One job: a stage of a material, a calibration or the catalogue."""

    title: str
    """Name of the stage with the wildcards of the job, as ``surface-2``."""
    material: str
    script: str
    folder: str
    """The results folder; all paths but those of raw files are relative to it."""
    input: Files
    output: Files
    spec: Mapping[str, Any]
    inherited: Mapping[str, str] = field(default_factory=dict)
    """Keys of the description that stand in another file → its name and line, for messages alone: a moved line changes no result."""
    scene: str = ""
    """Folder of a scene in the results, with a slash at its end; empty for the default scene and for what all scenes share."""
    most_seconds: float | None = None
    """Wall time after which the job is ended; None: no limit."""
    most_memory: float | None = None
    """Memory of the process, MB; None: no limit."""

    @property
    def description(self) -> str:
        return f"{self.title} of {self.material}"

    @property
    def log(self) -> Path:
        return Path(self.folder, self.log_name)

    @property
    def log_name(self) -> str:
        """Path of the log in the results folder."""
        return f"logs/{self.scene}{self.material}/{self.title}.log"

    @property
    def params(self) -> dict[str, Any]:
        return {"material": self.material, "spec": dict(self.spec)}


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    error: str | None
    """One line that says what is wrong and what to change; None of a job that succeeded."""
    wall: float = 0.0
    cpu: float = 0.0
    peak: float = 0.0
    """Largest memory of the process while the stage ran, MB."""
    damaged: tuple[str, ...] = ()
    """Results that the stage could not read, relative to the results folder: they can be computed again."""


def perform(job: Job) -> Outcome:
    """Run a job in this process; errors of the stage are in the outcome and in the log."""
    os.chdir(job.folder)
    job.log.parent.mkdir(parents=True, exist_ok=True)
    error: str | None = None
    damaged: tuple[str, ...] = ()
    with job.log.open("w", encoding="utf-8") as log, _output_to(log):
        print(job.description, file=log)
        _reset_peak_memory()
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                for path in _paths(job.output):
                    Path(path).parent.mkdir(parents=True, exist_ok=True)
                with (
                    store.owners_checked(_owner),
                    store.remembering(),
                    _limited_memory(job.most_memory),
                    naming_origin(job.inherited),
                ):
                    main_of(job.script)(job.input, job.output, job.params)
        except BrdfpipeError as refusal:
            error, damaged = " ".join(str(refusal).split()), _damaged(refusal, job)
            print(f"refused: {error}", file=log)
        except MemoryError:
            error = (
                f"needs more memory than the limit of {job.most_memory:g} MB; raise `job_limits.memory` of the configuration, "
                "or give a smaller raw file"
                if job.most_memory
                else "the memory is exhausted; free some, or build with fewer cores (--cores)"
            )
            traceback.print_exc(file=log)
        except Exception as fault:
            error = f"unexpected {type(fault).__name__}: {_without_folders(' '.join(str(fault).split()), job)}"
            error += f" (see {job.log_name})"
            traceback.print_exc(file=log)
        outcome = Outcome(error, time.perf_counter() - wall, time.process_time() - cpu, _peak_memory(), damaged)
        for warning in caught:
            place = f"{Path(warning.filename).name}:{warning.lineno}"
            print(f"{warning.category.__name__}: {warning.message} ({place})", file=log)
        print(f"{outcome.wall:.3f} s, {outcome.cpu:.3f} s of processor, at most {outcome.peak:.0f} MB", file=log)
    _record_time(job, outcome)
    return outcome


@contextmanager
def _limited_memory(most: float | None) -> Iterator[None]:
    """Let allocations beyond a limit [MB] raise MemoryError. Of shared and mapped memory nothing counts; without effect where the
    system knows no such limit."""
    try:
        import resource
    except ImportError:  # not on Windows
        most = None
    if most is None:
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_DATA, (int(most * 2**20), before[1]))
    try:
        yield
    finally:
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_DATA, before)


def _damaged(refusal: BrdfpipeError, job: Job) -> tuple[str, ...]:
    """Inputs that cannot be opened, if the stage refused a stored dataset; raw files, whose paths are absolute, do not count."""
    if not isinstance(refusal, store.StoreError):
        return ()
    damaged = []
    for path in _paths(job.input):
        try:
            if not Path(path).is_absolute():
                with store.owners_checked(_owner):
                    store.open_dataset(path)
        except store.StoreError:
            damaged.append(path)
        except BrdfpipeError:
            continue  # whole, but of another kind
    return tuple(damaged)


def _owner(path: Path) -> str | None:
    """The material or calibration whose result a path in the results is; None for a raw file."""
    if path.is_absolute():
        return None
    parts = parts_within_scene(path)
    if parts[0] == CALIBRATIONS and len(parts) > 1:
        return f"{CALIBRATIONS}.{parts[1].removesuffix('.nc')}"
    return parts[0] if len(parts) > 1 else None


def _paths(files: Files) -> list[str]:
    return [path for value in files.values() for path in ([value] if isinstance(value, str) else value)]


def _without_folders(message: str, job: Job) -> str:
    """The message without paths of folders: the catalogue's page shows it, and must not depend on where it was built."""
    for path in map(str, job.input.values()):
        message = message.replace(path, Path(path).name) if Path(path).is_absolute() else message
    return message.replace(f"{job.folder}/", "")


def _failure_record(job: Job) -> Path:
    return Path(job.folder, "failures", f"{job.material}.json")


def forget_failure(job: Job) -> None:
    """Delete the record of a job that failed before and has succeeded now, as on a cluster that tries a job again."""
    path = _failure_record(job)
    if path.is_file() and json.loads(path.read_text(encoding="utf-8"))["stage"] == job.title:
        path.unlink()


def record_failure(job: Job, message: str, damaged: tuple[str, ...] = ()) -> None:
    """Record a failed job for the build and the catalogue; if several jobs of a material fail, the alphabetically first one."""
    path = _failure_record(job)
    if path.is_file() and json.loads(path.read_text(encoding="utf-8"))["stage"] < job.title:
        return
    record: dict[str, Any] = {"material": job.material, "stage": job.title, "message": message}
    if damaged:
        record["damaged"] = list(damaged)
    store.write_text(path, json.dumps(record, ensure_ascii=False) + "\n")


def run_as_script(main: Main) -> None:
    """Run a stage's script as a plain program; ``--help`` says how."""
    parser = argparse.ArgumentParser(description=main.__doc__, epilog="Paths are relative to the current folder.")
    parser.add_argument("--material", required=True, help="name of the material")
    parser.add_argument("--spec", type=json.loads, default={}, help="the stage's part of the description, as JSON")
    parser.add_argument("--input", nargs="*", type=_pair, default=[], metavar="NAME=PATH")
    parser.add_argument("--output", nargs="+", type=_pair, required=True, metavar="NAME=PATH")
    options = parser.parse_args()
    try:
        main(dict(options.input), dict(options.output), {"material": options.material, "spec": options.spec})
    except BrdfpipeError as refusal:
        sys.exit(f"{options.material}: {refusal}")


def _pair(text: str) -> tuple[str, str]:
    name, mark, path = text.partition("=")
    if not mark:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=PATH")
    return name, path


@cache
def main_of(script: str) -> Main:
    """The function ``main`` of a stage's script."""
    main: Main = runpy.run_path(script)["main"]
    return main


@contextmanager
def _output_to(log: Any) -> Iterator[None]:
    """Send the output of libraries, C libraries included, to the log; in a worker alone."""
    import multiprocessing

    if multiprocessing.parent_process() is None:
        yield
        return
    terminal = os.dup(1), os.dup(2)
    log.flush()
    os.dup2(log.fileno(), 1)
    os.dup2(log.fileno(), 2)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        log.flush()
        for number, file in zip((1, 2), terminal, strict=True):
            os.dup2(file, number)
            os.close(file)


def _record_time(job: Job, outcome: Outcome) -> None:
    record = {
        "material": job.material,
        "stage": job.title,
        "wall_s": round(outcome.wall, 4),
        "cpu_s": round(outcome.cpu, 4),
        "peak_mb": round(outcome.peak, 1),
        "refused": outcome.error is not None,
    }
    # A sidecar, not a result: no need to wait for the disk.
    job.log.with_suffix(".json").write_text(json.dumps(record) + "\n", encoding="utf-8")


def _reset_peak_memory() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return  # not Linux: the peak is that of the whole process


def _peak_memory() -> float:
    try:
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) / 1024
    except (OSError, IndexError):
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / 1024 if sys.platform != "darwin" else peak / 2**20

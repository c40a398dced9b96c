"""The build front: one command that builds a catalogue, resumes, reports, and leaves a page whatever failed.

Snakemake decides what to run; it runs in this process, so that nothing outlives it. Materials that a stage refused are left
out of a second, short run that makes the catalogue page, on which they are listed with their reasons.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from brdfpipe import catalogue
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs import pool

PROGRESS_AFTER = 2.0
"""Seconds before a progress bar is worth showing."""

LOG = "logs/build.log"


class BuildError(BrdfpipeError):
    """The build as a whole could not be done."""


@dataclass(frozen=True)
class Summary:
    """What a build did."""

    built: tuple[str, ...]
    """Materials for which something was computed, and which are complete."""
    current: tuple[str, ...]
    """Materials that were up to date."""
    failures: Mapping[str, str]
    """Material → reason, in one line."""
    jobs: int
    page: Path
    seconds: float
    dry_run: bool = False

    @property
    def text(self) -> str:
        if self.dry_run:
            lines = [
                f"{self.jobs} jobs would run, for {len(self.built)} of {len(self.built) + len(self.current)} materials"
            ]
            return "\n".join([*lines, *(f"  {name}" for name in self.built), *self._failed])
        total = len(self.built) + len(self.current) + len(self.failures)
        lines = [
            f"{total} material{'s' if total != 1 else ''}: {len(self.built)} built, {len(self.current)} up to date, "
            f"{len(self.failures)} failed ({self.jobs} jobs in {self.seconds:.1f} s)"
        ]
        return "\n".join([*lines, *self._failed, f"Open {self.page}"])

    @property
    def _failed(self) -> list[str]:
        return [f"  {name}: {message}" for name, message in sorted(self.failures.items())]


def build(folder: Path, results: Path, *, cores: int, config: Path | None = None, dry_run: bool = False) -> Summary:
    """Build a catalogue; what is up to date stays as it is.

    Parameters
    ----------
    folder : the catalogue
    results : where everything goes; made if missing
    cores : how many stages run at once
    config : a configuration instead of the project's own
    dry_run : only say what would run

    Raises
    ------
    CatalogueError, InputError : the catalogue or the configuration cannot be used.
    BuildError : another build runs there, or snakemake itself failed.
    KeyboardInterrupt : stopped by the user; the next build resumes.
    """
    started = time.perf_counter()
    settings = catalogue.load_config(config)
    loaded = catalogue.load(folder, settings)
    _check_results(results, loaded)
    told: dict[str, Any] = {"catalogue": str(loaded.folder)}
    if config is not None:
        told["settings"] = str(config.resolve())
    with _only_build(results), _interruptible() as interrupted:
        if not dry_run:
            _clean_up(results)
        first = _Run(results, dry_run)
        complete = first.snakemake(told, cores)
        if interrupted:
            raise KeyboardInterrupt
        failed = _failures(results, first, {material.name for material in loaded.materials})
        if failed and not dry_run:
            second = _Run(results)
            complete = second.snakemake({**told, "failures": failed}, cores)
            first.done += second.done
            first.errors += second.errors
        if interrupted:
            raise KeyboardInterrupt
        if not complete:
            raise BuildError(_why(first, results))
    touched = {material for _, material in first.done}
    names = [material.name for material in loaded.materials if material.name not in failed]
    return Summary(
        built=tuple(name for name in names if name in touched),
        current=tuple(name for name in names if name not in touched),
        failures={
            **loaded.failures,
            **{name: f"{entry['stage']}: {entry['message']}" for name, entry in failed.items()},
        },
        jobs=sum(rule != "all" for rule, _ in first.done),
        page=results / "index.html",
        seconds=time.perf_counter() - started,
        dry_run=dry_run,
    )


@dataclass
class _Run(logging.Handler):
    """One run of snakemake, followed through its log events."""

    results: Path
    dry_run: bool = False
    done: list[tuple[str, str]] = field(default_factory=list)
    """(rule, material) of every job that ran to its end (or would, in a dry run)."""
    failed: list[tuple[str, str]] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(logging.INFO)
        self._jobs: dict[int, tuple[str, str]] = {}
        self._bar: Any = None
        self._file: Any = None

    __hash__ = logging.Handler.__hash__

    def snakemake(self, told: Mapping[str, Any], cores: int) -> bool:
        """Run snakemake in this process; return whether everything it was asked for is there."""
        from snakemake.cli import args_to_api, parse_args  # type: ignore[import-untyped]
        from snakemake.logging import DefaultFormatter  # type: ignore[import-untyped]

        self.setFormatter(DefaultFormatter())
        root, log = catalogue.project_folder(), self.results / LOG
        arguments = [
            *("--snakefile", str(root / "Snakefile"), "--directory", str(self.results), "--cores", str(cores)),
            *("--profile", "none", "--workflow-profile", str(root / "workflow" / "profiles" / "default")),
            *("--quiet", "all", "--nocolor", "--nolock", *(["--dry-run"] if self.dry_run else [])),
            *("--configfile", str(log.with_suffix(".json").resolve())),
        ]
        log.parent.mkdir(parents=True, exist_ok=True)
        log.with_suffix(".json").write_text(json.dumps(told), encoding="utf-8")
        logger = logging.getLogger("snakemake")
        logger.addHandler(self)
        try:
            with (
                log.open("a", encoding="utf-8") as self._file,
                Path(os.devnull).open("w") as nowhere,
                redirect_stdout(nowhere),
                redirect_stderr(nowhere),  # what matters comes as log events
            ):
                parser, parsed = parse_args(arguments)
                # The default, 100 jobs a second, costs more than it holds back: a timer thread and a new choice of jobs for
                # each. No value of the option switches it off.
                parsed.max_jobs_per_timespan = None
                return bool(args_to_api(parsed, parser))
        finally:
            logger.removeHandler(self)
            if self._bar is not None:
                self._bar.close()

    def emit(self, record: logging.LogRecord) -> None:
        event = getattr(getattr(record, "event", None), "name", None)
        if event == "JOB_INFO":
            job = (record.rule_name, dict(record.wildcards).get("material", ""))  # type: ignore[attr-defined]
            self._jobs[record.jobid] = job  # type: ignore[attr-defined]
            if self.dry_run:
                self.done.append(job)
        elif event == "JOB_FINISHED":
            self.done.append(self._jobs[record.job_id])  # type: ignore[attr-defined]
        elif event == "JOB_ERROR":
            self.failed.append(self._jobs[record.jobid])  # type: ignore[attr-defined]
        elif event == "PROGRESS":
            self._show(record.done, record.total)  # type: ignore[attr-defined]
        text = self.format(record)
        if event in (None, "ERROR") and record.levelno >= logging.ERROR:
            self.errors.append(" ".join(text.split()))
        if text and text != "None":
            print(text, file=self._file)

    def _show(self, done: int, total: int) -> None:
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                total=total, unit="job", delay=PROGRESS_AFTER, disable=None, file=sys.__stderr__, leave=False
            )
        self._bar.update(done - self._bar.n)


def _check_results(results: Path, loaded: catalogue.Catalogue) -> None:
    target = results.resolve()
    inside = [target, *target.parents]
    if target == loaded.folder or any((place / catalogue.DESCRIPTION).is_file() for place in inside):
        raise BuildError(f"{results}: results go to a folder of their own, not among the raw files of the catalogue")
    if target.exists() and not target.is_dir():
        raise BuildError(f"{results}: is a file; results need a folder")


@contextmanager
def _only_build(results: Path) -> Iterator[None]:
    from filelock import FileLock, Timeout

    try:
        results.mkdir(parents=True, exist_ok=True)
        lock = FileLock(results / ".build.lock", timeout=0)
        lock.acquire()
    except Timeout:
        raise BuildError(
            f"{results}: another build is running there; wait for it or choose another --results"
        ) from None
    except OSError as error:
        raise BuildError(f"{results}: cannot be written ({error.strerror})") from error
    try:
        yield
    finally:
        lock.release()


@contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Ctrl-C kills the workers at once; the jobs they had are done again by the next build.

    Yields the signals received, because snakemake turns an interrupt into a failed run.
    """
    interrupted: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        interrupted.append(number)
        pool.close()
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        signal.signal(signal.SIGINT, stop)
    except ValueError:  # not the main thread: whoever runs us there deals with signals
        before = {}
    try:
        yield interrupted
    finally:
        pool.close()
        for number, handler in before.items():
            signal.signal(number, handler)


def _clean_up(results: Path) -> None:
    """Remove what a killed build left: half-written files and the failures of the build before."""
    shutil.rmtree(results / "failures", ignore_errors=True)
    (results / LOG).unlink(missing_ok=True)
    for pattern in (".*.tmp", "*/.*.tmp", "*/exports/.*.tmp"):
        for leftover in results.glob(pattern):
            leftover.unlink(missing_ok=True)


def _failures(results: Path, run: _Run, names: set[str]) -> dict[str, dict[str, str]]:
    """Material → stage and message, of the materials of which a stage failed."""
    found: dict[str, dict[str, str]] = {}
    for path in (results / "failures").glob("*.json"):
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["material"] in names:
            found[record["material"]] = {"stage": record["stage"], "message": record["message"]}
    for rule, material in run.failed:
        if material in names:
            found.setdefault(material, {"stage": rule, "message": f"failed without a word (see {LOG})"})
    return found


def _why(run: _Run, results: Path) -> str:
    record = results / "failures" / "catalogue.json"
    if record.is_file():
        return "the catalogue page could not be made: " + json.loads(record.read_text(encoding="utf-8"))["message"]
    reason = run.errors[0] if run.errors else "stopped before its end; run it again to resume"
    return f"{results}: {reason} (see {results / LOG})"

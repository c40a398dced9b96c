"""The build front: one command that builds a catalogue, resumes, reports, and leaves a page whatever failed.

Snakemake decides what to run; it runs in this process, so that nothing outlives it. Materials that a stage refused are left
out of a second, short run that makes the catalogue page, on which they are listed with their reasons. Damaged results that a
stage could not read are deleted and made anew.
"""

from __future__ import annotations

import csv
import json
import logging
import os
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from brdfpipe import installation
from brdfpipe.catalogue.catalogue import Catalogue, load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.ignored_folders import ignored
from brdfpipe.catalogue.names import CALIBRATIONS, DESCRIPTION, RESERVED, RESULT_MARKS
from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs import pool, runs

PROGRESS_AFTER = 2.0
"""Seconds before a progress bar is worth showing."""

LOG = "logs/build.log"

TEMPORARY = re.compile(r"\..+\.\d+\.tmp")
"""Names under which the store writes what is not whole yet."""

STALE = "STALE.txt"
"""In a material's folder: its results are older than the catalogue."""


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
    """Material that could not be built → reason, in one line."""
    jobs: int
    page: Path
    seconds: float
    dry_run: bool = False
    verdicts: Mapping[str, str] = field(default_factory=dict)
    """Built material → worst verdict of its checks: pass, warn or fail."""
    faults: Mapping[str, str] = field(default_factory=dict)
    """Built material whose verdict is fail → what the checks found, in one line."""
    notices: tuple[str, ...] = ()
    """What else the user should know; none of it is a failure."""

    @property
    def text(self) -> str:
        if self.dry_run:
            lines = [
                f"{self.jobs} jobs would run, for {len(self.built)} of {len(self.built) + len(self.current)} materials"
            ]
            return "\n".join([*lines, *(f"  {name}" for name in self.built), *self._failed, *self.notices])
        total = len(self.built) + len(self.current) + len(self.failures)
        lines = [
            f"{total} material{'s' if total != 1 else ''}: {len(self.built)} built, {len(self.current)} up to date, "
            f"{len(self.failures)} not built ({self.jobs} job{'s' if self.jobs != 1 else ''} in {self.seconds:.1f} s)"
        ]
        return "\n".join([*lines, *self._failed, *self._judged, *self.notices, f"Open {self.page}"])

    @property
    def _failed(self) -> list[str]:
        return [f"  {name}: not built: {message}" for name, message in sorted(self.failures.items())]

    @property
    def _judged(self) -> list[str]:
        counts = Counter(self.verdicts.values())
        if not (counts["fail"] or counts["warn"]):
            return []
        page = self.page.parent
        return [
            f"Verdicts of the checks: {counts['fail']} fail, {counts['warn']} warn; the reports say why",
            *(
                f"  {name}: verdict fail{f': {why}' if why else ''} ({page / name / 'report.html'})"
                for name, why in sorted(self.faults.items())
            ),
        ]


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
    settings = load_config(config)
    loaded = load(folder, settings)
    _check_results(results, loaded)
    told: dict[str, Any] = {"catalogue": str(loaded.folder)}
    if config is not None:
        told["settings"] = str(config.resolve())
    with _only_build(results), _interruptible() as interrupted:
        if not dry_run:
            _clean_up(results)
        failed = _unwritable(results, loaded) | _unplanned(loaded)
        names = {material.name for material in loaded.materials}
        done = _build(results, told, names, _dependents(loaded), failed, interrupted, cores, dry_run)
        stale = [] if dry_run else _mark_stale(results, loaded, failed)
    touched = {material for _, material in done.jobs}
    good = [material.name for material in loaded.materials if material.name not in failed]
    verdicts = {} if dry_run else _verdicts(results, good)
    return Summary(
        built=tuple(name for name in good if name in touched),
        current=tuple(name for name in good if name not in touched),
        failures={
            **loaded.failures,
            **{name: f"{entry['stage']}: {entry['message']}" for name, entry in failed.items()},
        },
        jobs=sum(rule != "all" for rule, _ in done.jobs),
        page=results / "index.html",
        seconds=time.perf_counter() - started,
        dry_run=dry_run,
        verdicts=verdicts,
        faults={name: _fault(results, name) for name, verdict in verdicts.items() if verdict == "fail"},
        notices=tuple(_notices(loaded.folder, done.healed, stale)),
    )


@dataclass
class _Done:
    """What the runs of snakemake did together."""

    jobs: list[tuple[str, str]] = field(default_factory=list)
    """(rule, material)"""
    healed: list[str] = field(default_factory=list)
    """Damaged files that were deleted."""


def _build(
    results: Path,
    told: Mapping[str, Any],
    names: set[str],
    dependents: Mapping[str, tuple[str, ...]],
    failed: dict[str, dict[str, str]],
    interrupted: list[int],
    cores: int,
    dry_run: bool,
) -> _Done:
    """Run snakemake as often as it takes: again where a damaged file was deleted, again without the materials that failed.

    Those are added to ``failed``. Each turn deletes a file for the first time in this build or leaves out one more material,
    so that there is an end.
    """
    done = _Done()
    while True:
        run = _Run(results, dry_run)
        complete = run.snakemake({**told, "failures": failed}, cores)
        done.jobs += run.done
        if interrupted:
            raise KeyboardInterrupt
        # A dry run fails nowhere; the records that lie there are those of the build before.
        found = {} if dry_run else _failures(results, run, names - failed.keys(), dependents)
        damaged = [] if dry_run else _delete_damaged(results, done.healed)
        if damaged:
            done.healed += damaged
            continue
        if not complete and not found:
            found = _stuck(run, names - failed.keys())
        if complete and not found:
            return done
        if not found:
            raise BuildError(_why(run, results))
        failed |= found


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
        root, log = installation.project_folder(), self.results / LOG
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


def _check_results(results: Path, loaded: Catalogue) -> None:
    target = results.resolve()
    inside = [target, *target.parents]
    if target == loaded.folder or any((place / DESCRIPTION).is_file() for place in inside):
        raise BuildError(f"{results}: results go to a folder of their own, not among the raw files of the catalogue")
    if target.exists() and not target.is_dir():
        raise BuildError(f"{results}: is a file; results need a folder")
    if target.is_dir() and not any((target / mark).exists() for mark in RESULT_MARKS):
        others = sorted(item.name for item in target.iterdir() if not item.name.startswith("."))
        if others:
            raise BuildError(
                f"{results}: holds other files ({others[0]}) and no results; choose a new or an empty folder"
            )


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
    _forget_failures(results)
    (results / LOG).unlink(missing_ok=True)
    for pattern in (".*.tmp", "*/.*.tmp", "*/exports/.*.tmp"):
        for leftover in results.glob(pattern):
            if not TEMPORARY.fullmatch(leftover.name):
                continue
            with suppress(OSError):  # in a folder that cannot be written, which is told of by itself
                leftover.unlink()


def _failures(
    results: Path, run: _Run, names: set[str], dependents: Mapping[str, tuple[str, ...]]
) -> dict[str, dict[str, str]]:
    """Material → stage and message, of the materials of which a stage failed, and of those that need what failed."""
    records: dict[str, dict[str, str]] = {}
    for path in (results / "failures").glob("*.json"):
        record = json.loads(path.read_text(encoding="utf-8"))
        records[record["material"]] = {"stage": record["stage"], "message": record["message"]}
    for rule, material in run.failed:
        if material in names:
            records.setdefault(material, {"stage": rule, "message": f"failed without a word (see {LOG})"})
    found = {name: record for name, record in records.items() if name in names}
    for owner, record in records.items():
        needing = {
            "stage": record["stage"],
            "message": f"it needs {owner}, which could not be made: {record['message']}",
        }
        for name in names.intersection(dependents.get(owner, ())):
            found.setdefault(name, needing)
    return found


def _dependents(loaded: Catalogue) -> dict[str, tuple[str, ...]]:
    """Calibration or material → materials that cannot be made without it."""
    measured = [material for material in loaded.materials if material.has("rig")]
    rigs = {material.name: material.content["rig"] for material in measured}
    needs = [
        (f"{CALIBRATIONS}.{calibration}", material.name)
        for material in measured
        for calibration in loaded.calibrations_of(material)
    ]
    needs += [(rig["emulate"]["truth"], name) for name, rig in rigs.items() if "emulate" in rig]
    return {owner: tuple(name for other, name in needs if other == owner) for owner, _ in needs}


def _unplanned(loaded: Catalogue) -> dict[str, dict[str, str]]:
    """Materials whose run of a rig cannot be used as it was planned, or that need one whose run cannot."""
    found = {name: {"stage": "check", "message": why} for name, why in runs.of(loaded)[1].items()}
    for owner, needing in _dependents(loaded).items():
        if owner in found:
            message = f"it needs {owner}, which could not be made: {found[owner]['message']}"
            found |= {name: {"stage": "check", "message": message} for name in needing if name not in found}
    return found


def _unwritable(results: Path, loaded: Catalogue) -> dict[str, dict[str, str]]:
    """Materials whose folder of results is there and cannot be written: snakemake would stop for all over it."""
    folders = [(material.name, part) for material in loaded.materials for part in (".", "exports")]
    return {
        name: _blocked(str(Path(name, part)), "the folder cannot be written")
        for name, part in folders
        if (results / name / part).exists() and not os.access(results / name / part, os.W_OK | os.X_OK)
    }


def _stuck(run: _Run, names: set[str]) -> dict[str, dict[str, str]]:
    """Materials one of whose old results snakemake could not remove or write."""
    found = {}
    for error in run.errors:
        told = [(file, reason) for reason, file in re.findall(r"\[Errno \d+\] ([^:]+): '([^']+)'", error)]
        told += [
            (file, "write-protected") for file in re.findall(r"Write-protected output .* affected files: (\S+)", error)
        ]
        for file, reason in told:
            parts = Path(file).parts
            place = next((place for place, part in enumerate(parts) if part in names), None)
            if place is not None:
                found[parts[place]] = _blocked("/".join(parts[place:]), f"cannot be replaced ({reason})")
    return found


def _blocked(place: str, problem: str) -> dict[str, str]:
    return {"stage": "results", "message": f"{place}: {problem}; make it writable or delete it"}


def _delete_damaged(results: Path, before: list[str]) -> list[str]:
    """Delete the results that a stage could not read, each once in a build, with the failures they caused; return them."""
    inside = results.resolve()
    damaged = set()
    for path in (results / "failures").glob("*.json"):
        damaged |= set(json.loads(path.read_text(encoding="utf-8")).get("damaged", []))
    found = sorted(
        name
        for name in damaged - set(before)
        if (inside / name).is_file() and (inside / name).resolve().is_relative_to(inside)
    )
    for name in found:
        (inside / name).unlink()
    if found:
        _forget_failures(results)
    return found


def _forget_failures(results: Path) -> None:
    for record in (results / "failures").glob("*.json"):
        with suppress(OSError):
            record.unlink()


def _mark_stale(results: Path, loaded: Catalogue, failed: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Mark reports and exports that no material of the catalogue stands behind now; return those of materials that are gone."""
    reasons = {**loaded.failures, **{name: entry["message"] for name, entry in failed.items()}}
    gone = []
    for folder in sorted(path for path in results.iterdir() if path.is_dir() and path.name not in RESERVED):
        mark = folder / STALE
        if not (folder / "report.html").exists() and not any(folder.glob("exports/*")):
            continue
        if folder.name in loaded.by_name and folder.name not in failed:
            mark.unlink(missing_ok=True)
            continue
        if folder.name in reasons:
            reason = f"it cannot be built now: {reasons[folder.name]}"
        else:
            gone.append(folder.name)
            reason = "no material of this name is in the catalogue."
        with suppress(OSError):  # a folder that cannot be written has been named already
            mark.write_text(
                f"The results in this folder are of an earlier state of the material; {reason}\n"
                "The build that makes them anew removes this file.\n",
                encoding="utf-8",
            )
    return gone


def _verdicts(results: Path, names: Iterable[str]) -> dict[str, str]:
    """Material → verdict, from the catalogue's table."""
    with suppress(OSError), (results / "catalogue.csv").open(encoding="utf-8", newline="") as table:
        told = {row.get("material"): row.get("verdict") or "" for row in csv.DictReader(table)}
        return {name: told[name] for name in names if told.get(name)}
    return {}


def _fault(results: Path, name: str) -> str:
    """What the checks of a material failed on, in one line."""
    from brdfpipe.store import open_dataset

    try:
        verdicts = json.loads(open_dataset(results / name / "checks.nc", "checks").attrs["verdicts"])
    except (BrdfpipeError, KeyError):
        return ""
    return "; ".join(f"{check}: {entry['text']}" for check, entry in verdicts.items() if entry["verdict"] == "fail")


def _notices(folder: Path, healed: list[str], stale: list[str]) -> Iterator[str]:
    if healed:
        yield f"{_count(healed, 'damaged file')} deleted and made anew: {', '.join(healed)}"
    if stale:
        yield (
            f"{_count(stale, 'folder')} of materials that are no longer in the catalogue, marked by {STALE}: "
            f"{', '.join(stale[:5])}{', …' if len(stale) > 5 else ''}"
        )
    for name, why in ignored(folder).items():
        yield f"{name}: ignored: {why}"


def _count(items: list[str], word: str) -> str:
    return f"{len(items)} {word}{'s' if len(items) != 1 else ''}"


def _why(run: _Run, results: Path) -> str:
    record = results / "failures" / "catalogue.json"
    if record.is_file():
        return "the catalogue page could not be made: " + json.loads(record.read_text(encoding="utf-8"))["message"]
    reason = run.errors[0].partition(" File ")[0] if run.errors else "stopped before its end; run it again to resume"
    return f"{results}: {reason} (see {results / LOG})"

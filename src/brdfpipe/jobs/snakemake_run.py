"""Run snakemake in this process and follow its log events."""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from brdfpipe import installation

PROGRESS_AFTER = 2.0
"""Seconds before progress is worth showing."""
PROGRESS_EVERY = 30.0
"""Seconds after which a line of progress is printed where there is no terminal, also if no material was finished."""
_LAST_RULE = "summary"
"""The rule that finishes a material."""

LOG = "logs/build.log"
"""In the folder of results."""


class SnakemakeRun(logging.Handler):
    """Runs of the workflow in a folder of results, followed by their log events.

    Attributes
    ----------
    done : (rule, material) of the jobs of all runs that succeeded (or would run, in a dry run)
    failed : (rule, material) of the failed jobs of the last run
    errors : messages of level error of the last run, each in one line
    """

    def __init__(self, results: Path, dry_run: bool = False, on_event: Callable[[], None] = lambda: None) -> None:
        """``on_event`` is called before each event is handled."""
        super().__init__(logging.INFO)
        self.results, self.dry_run, self._on_event = results, dry_run, on_event
        self.done: list[tuple[str, str]] = []
        self.failed: list[tuple[str, str]] = []
        self.errors: list[str] = []
        self._file: Any = None
        self._started = self._shown = time.monotonic()

    def start(self, config: Mapping[str, Any], cores: int) -> bool:
        """Run snakemake and wait; return whether all results exist now."""
        from snakemake.cli import args_to_api, parse_args  # type: ignore[import-untyped]
        from snakemake.logging import DefaultFormatter  # type: ignore[import-untyped]

        self.setFormatter(DefaultFormatter())
        self.failed, self.errors = [], []
        self._jobs: dict[int, tuple[str, str]] = {}
        self._bar: Any = None
        root, log = installation.project_folder(), self.results.absolute() / LOG
        settings = log.with_suffix(".json")
        arguments = [
            *("--snakefile", str(root / "Snakefile"), "--directory", str(self.results), "--cores", str(cores)),
            *("--profile", "none", "--workflow-profile", str(root / "workflow" / "profiles" / "default")),
            *("--quiet", "all", "--nocolor", "--nolock", *(["--dry-run"] if self.dry_run else [])),
            *("--configfile", str(settings)),
        ]
        log.parent.mkdir(parents=True, exist_ok=True)
        settings.unlink(missing_ok=True)  # it may be a link that leads nowhere
        settings.write_text(json.dumps(config), encoding="utf-8")
        logger = logging.getLogger("snakemake")
        logger.addHandler(self)
        try:
            with (
                log.open("a", encoding="utf-8") as self._file,
                Path(os.devnull).open("w") as null,
                redirect_stdout(null),
                redirect_stderr(null),  # messages come as log events
            ):
                parser, parsed = parse_args(arguments)
                # The default limit, 100 jobs a second, is slow: it starts a timer and schedules anew for each job.
                # No value of the option switches it off.
                parsed.max_jobs_per_timespan = None
                return bool(args_to_api(parsed, parser))
        finally:
            logger.removeHandler(self)
            if self._bar is not None:
                self._bar.close()

    @property
    def missed_files(self) -> bool:
        """Whether the last run ended early because an input was missing."""
        return any("Missing files after" in error or "Missing input files" in error for error in self.errors)

    def emit(self, record: logging.LogRecord) -> None:
        self._on_event()
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
            self._show_progress(record.done, record.total)  # type: ignore[attr-defined]
        text = self.format(record)
        if event in (None, "ERROR") and record.levelno >= logging.ERROR:
            self.errors.append(" ".join(text.split()))
        if text and text != "None":
            print(text, file=self._file)

    def _show_progress(self, done: int, total: int) -> None:
        if not (sys.__stderr__ and sys.__stderr__.isatty()):
            self._print_progress(done, total)
            return
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                total=total, unit="job", delay=PROGRESS_AFTER, disable=None, file=sys.__stderr__, leave=False
            )
        self._bar.update(done - self._bar.n)
        self._bar.set_postfix_str(self._last_job)

    def _print_progress(self, done: int, total: int) -> None:
        """A line for each finished material, and at least every 30 seconds in which a job ended."""
        now = time.monotonic()
        finished = bool(self.done) and self.done[-1][0] == _LAST_RULE and now - self._started > PROGRESS_AFTER
        if sys.__stderr__ and (finished or now - self._shown > PROGRESS_EVERY):
            print(f"{done} of {total} jobs: {self._last_job}", file=sys.__stderr__, flush=True)
            self._shown = now

    @property
    def _last_job(self) -> str:
        """Material and stage of the last job that ended."""
        rule, material = self.done[-1] if self.done else ("", "")
        return " ".join(filter(None, (material, "finished" if rule == _LAST_RULE else rule)))

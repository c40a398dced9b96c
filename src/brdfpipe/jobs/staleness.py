"""Which jobs have to run: the index decides, not the times of files and not snakemake's own notes.

A job is current if its stage has the recorded parameters and code, its inputs have the recorded contents, and its outputs are what
it wrote. All others run, and all jobs that read their results.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from brdfpipe.jobs.index import Index, Record, shared_index
from brdfpipe.jobs.rules import Pipeline, PlannedJob


@dataclass
class Examination:
    """What the index says about the jobs of a build."""

    stale: list[str] = field(default_factory=list)
    """Outputs of the jobs that have to run."""
    current: list[str] = field(default_factory=list)
    """Outputs of the other jobs that exist."""
    replaced: list[str] = field(default_factory=list)
    """Results that are not what their jobs wrote."""
    older: dict[str, int] = field(default_factory=dict)
    """Results that are current, and older than those they were made from → time of the newest of these, ns."""
    files: list[str] = field(default_factory=list)
    """All results and raw files of the build."""


def examine(pipeline: Pipeline, index: Index) -> Examination:
    """Find the jobs that have to run."""
    return _Examiner(pipeline, index).examination


def force_stale(pipeline: Pipeline, workflow: Any) -> None:
    """Let snakemake run the jobs that have to run, as ``--forcerun`` does, and plan no others; call it while it plans.

    On the node of a cluster, it would also run a job with an input newer than its output. So a result that is current is made as new as
    those it was made from.
    """
    if not workflow.is_main_process:
        return
    index = shared_index(Path.cwd())
    examination = examine(pipeline, index)
    if not workflow.dryrun:
        for path, time_ns in examination.older.items():
            with suppress(OSError):  # write-protected: its job runs again
                index.touch(path, time_ns)
    workflow.dag.forcefiles.update(examination.stale)
    folder = str(Path.cwd())
    pipeline.current = {path: f"{folder}/{path}" for path in examination.current}
    workflow.dag.check_output_mtime = _accept_any_time
    index.examined = {path: index.digest(path) for path in examination.files}
    index.replaced.update(examination.replaced)


async def _accept_any_time(*job_and_outputs: Any) -> None:
    """Instead of a check that ends the whole build where an input carries a time of the future, as of a clock set wrongly."""


class _Examiner:
    def __init__(self, pipeline: Pipeline, index: Index) -> None:
        self.pipeline, self.index = pipeline, index
        self.jobs = pipeline.jobs()
        self.needed = frozenset(pipeline.files())
        self.examination = Examination()
        self._verdicts: dict[str, bool] = {}
        for path in sorted(self.needed):
            self._is_stale(self.jobs[path])

    def _is_stale(self, job: PlannedJob) -> bool:
        name = job.outputs[0]
        if name not in self._verdicts:
            inputs = self.pipeline.inputs_of(job)
            made = {self.jobs[path].outputs[0]: self.jobs[path] for path in inputs if path in self.jobs}
            upstream = [self._is_stale(one) for one in made.values()]
            record = self.index.jobs.get(name)
            stale = record is None or not self._are_outputs_intact(job, record) or any(upstream)
            self._verdicts[name] = stale or record is None or not self._is_current(job, record, inputs)
            self.examination.files += [*job.outputs, *(path for path in inputs if path not in self.jobs)]
            if self._verdicts[name]:
                self.examination.stale += job.outputs
            else:
                self.examination.current += [path for path in job.outputs if self.index.digest(path)]
                newest = max((self._time(path) for path in inputs if path in self.jobs), default=0)
                self.examination.older |= {path: newest for path in job.outputs if 0 < self._time(path) < newest}
        return self._verdicts[name]

    def _are_outputs_intact(self, job: PlannedJob, record: Record) -> bool:
        """Whether the outputs, and what the job wrote beside them, are what it wrote; those that only other jobs need may be absent, all together."""
        paths = [*job.outputs, *(record.outputs.keys() - set(job.outputs))]
        found = {path: self.index.digest(path) for path in paths}
        absent = {path for path in paths if found[path] is None}
        other = sorted(path for path in paths if path not in absent and found[path] != record.outputs.get(path))
        self.examination.replaced += other
        return not other and (not absent or (absent == set(paths) and not absent & self.needed))

    def _is_current(self, job: PlannedJob, record: Record, inputs: list[str]) -> bool:
        if (record.parameters, record.code) != (self.pipeline.parameters_of(job), self.pipeline.code_of(job)):
            return False
        return record.inputs == self.index.inputs(inputs, absent=self._written)

    def _time(self, path: str) -> int:
        return self.examination.older.get(path) or self.index.time(path)

    def _written(self, path: str) -> str:
        """Digest of an absent result, as its job wrote it."""
        record = self.index.jobs.get(self.jobs[path].outputs[0]) if path in self.jobs else None
        return record.outputs.get(path, "") if record else ""

"""Which ready job runs next: one of a material that is under way, so that its stages follow each other in one worker.

A worker keeps the datasets of its last materials and what it prepared from them. Snakemake would choose among all ready jobs of the catalogue,
and looks at every job again for each that ends.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Collection, Iterable
from functools import cache
from typing import Any, Generic, TypeVar

from brdfpipe.stages import STAGES

Job = TypeVar("Job")

_RANKS = {name: rank for rank, name in enumerate(STAGES)}


class Queue(Generic[Job]):
    """Ready jobs by owner: a material, a calibration or a catalogue."""

    def __init__(self) -> None:
        self.known: set[Job] = set()
        """The jobs that were added and not taken."""
        self._waiting: defaultdict[str, list[Job]] = defaultdict(list)
        self._begun: set[str] = set()
        self._under_way: dict[str, None] = {}
        """Owners of which a job was taken and another waits, in the order in which that was added."""
        self._new: list[str] = []
        """Owners of which no job was taken, a heap."""

    def add(self, jobs: Iterable[tuple[str, Job]]) -> None:
        """Add ready jobs, each with its owner; of one owner they are taken in the order given."""
        for owner, job in jobs:
            if owner in self._begun:
                self._under_way[owner] = None
            elif owner not in self._waiting:
                heapq.heappush(self._new, owner)
            self._waiting[owner].append(job)
            self.known.add(job)

    def take(self, count: int, busy: Collection[str]) -> list[Job]:
        """Take jobs: of owners under way of which none runs (``busy``), then of new owners by their names, then of any under way."""
        taken: list[Job] = []
        running = set(busy)
        while len(taken) < count and self.known:
            owner = next((owner for owner in self._under_way if owner not in running), None)
            if owner is None:
                owner = heapq.heappop(self._new) if self._new else next(iter(self._under_way))
            job = self._waiting[owner].pop(0)
            self._begun.add(owner)
            self._under_way[owner] = None
            if not self._waiting[owner]:
                del self._waiting[owner], self._under_way[owner]
            running.add(owner)
            self.known.discard(job)
            taken.append(job)
        return taken


@cache
def _scheduler() -> type[Any]:
    """Snakemake's scheduler, which sees of the ready jobs only as many as there are free cores."""
    from snakemake.scheduling.job_scheduler import JobScheduler  # type: ignore[import-untyped]

    class OneMaterialAfterTheOther(JobScheduler):  # type: ignore[misc]
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self._queue: Queue[Any] = Queue()

        @property
        def open_jobs(self) -> list[Any]:
            if self.dryrun or not self.workflow.local_exec:
                return list(super().open_jobs)
            new = self.workflow.dag.ready_jobs - self._queue.known
            self._queue.add([(_owner(job), job) for job in sorted(new, key=_rank)])
            return self._queue.take(self.resources["_cores"], [_owner(job) for job in self.running])

        @property
        def remaining_jobs(self) -> list[Any]:
            """Only a scheduler that looks ahead needs them."""
            return []

    return OneMaterialAfterTheOther


def by_material() -> None:
    """Let snakemake start jobs in this order, in a time that grows with their number; call it before it runs them."""
    from snakemake import jobs, workflow  # type: ignore[import-untyped]

    workflow.JobScheduler = _scheduler()
    # The workflow has neither pipes nor services. The search for them among the inputs of the catalogue, each of another job, takes
    # the square of their number: half of the time of a build of 10 000 materials.
    jobs.Job.is_pipe_or_service_input = lambda job, path: False


def _rank(job: Any) -> tuple[int, int]:
    return _RANKS.get(job.rule.name, len(_RANKS)), job.jobid


def _owner(job: Any) -> str:
    """The material, else the calibration, else the rule of a job."""
    return str(job.wildcards_dict.get("material") or job.wildcards_dict.get("calibration") or job.rule.name)

"""Worker processes that run stages. They start on demand, are replaced when they are killed, and end with the main process.

The imports of a stage alone take a second. So workers are forked from a server that has imported the libraries; each job thread of
snakemake uses one worker at a time, and each worker one thread for linear algebra.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.index import shared_index
from brdfpipe.jobs.stage import Job, Outcome, forget_failure, perform, record_failure

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Stages run in parallel already, and the number of threads changes the last bits of sums."""

PRELOADED = [
    "numpy",
    "xarray",
    "netCDF4",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.special",
    "tqdm",
    "brdfpipe.jobs.stage",
    "brdfpipe.bsdf",
]

PRELOADED_WHERE_USED = ("brdfpipe.facets.slope_kernels", "brdfpipe.spectra.colour_science")
"""Slow to import: preloaded if a stage of the run uses them, see :func:`preload`."""

ATTEMPTS = 2
"""Memory may have been short for a moment: a job whose worker was killed is tried once more."""


class StageError(BrdfpipeError):
    """A stage failed; its log and its failure record say why."""


CRASHES = frozenset({signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGSEGV})
"""Signals by which a process ends itself: a library met what it cannot handle, as a damaged file. Others come from outside."""


class TookTooLong(Exception):
    """A job reached its limit of time."""


class WorkerDied(Exception):
    """The worker process ended while it had a job."""

    def __init__(self, exitcode: int | None) -> None:
        super().__init__(_cause(exitcode))
        self.is_crash = exitcode is not None and -exitcode in CRASHES


class Pool:
    """Workers: a job starts a new one if all others are busy."""

    def __init__(self) -> None:
        self._idle: list[_Worker] = []
        self._workers: set[_Worker] = set()
        self._lock = threading.RLock()  # a signal may close the pool inside any of its functions
        self._closed = False

    def perform(self, job: Job) -> Outcome:
        """Run a job in a worker and wait for it; in a new worker if the first is killed."""
        died = WorkerDied(None)
        for _ in range(ATTEMPTS):
            worker = self._take(job.material)
            try:
                outcome = worker.perform(job)
            except TookTooLong:
                self._end(worker)
                outcome = _too_long(job)
                break
            except WorkerDied as death:
                died = death
                self._end(worker)
                continue
            with self._lock:
                self._idle.append(worker)
            break
        else:
            outcome = _crashed(job, died) if died.is_crash else _killed(died)
        if not self._closed:
            with self._lock:
                if outcome.error:
                    record_failure(job, outcome.error, outcome.damaged)
                else:
                    forget_failure(job)
        return outcome

    def close(self) -> None:
        """Kill all workers, busy ones too; their jobs fail and leave no record."""
        self._closed = True
        with self._lock:
            workers = list(self._workers)
            self._idle.clear()
        for worker in workers:
            worker.process.kill()

    def _end(self, worker: _Worker) -> None:
        with self._lock:
            self._workers.discard(worker)
        worker.process.kill()

    def _take(self, material: str) -> _Worker:
        """An idle worker, that which had the last job of the material if it is idle: it holds the datasets of the material."""
        with self._lock:
            if self._closed:
                raise StageError("interrupted")
            worker = next((one for one in self._idle if one.material == material), None)
            if worker is not None:
                self._idle.remove(worker)
            elif self._idle:
                worker = self._idle.pop()
            else:
                worker = _Worker()
                self._workers.add(worker)
            worker.material = material
            return worker


class _Worker:
    """One process and the connection to it."""

    def __init__(self) -> None:
        self.material = ""
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([*PRELOADED, *sorted(_also_preloaded)])
        resource_tracker.ensure_running()  # started later, the tracker would unblock SIGINT again
        with _environment(ONE_THREAD), sigint_blocked():
            forkserver.ensure_running()
        self._connection, worker_end = context.Pipe()
        self.process = context.Process(target=_serve, args=(worker_end,), daemon=True, name="brdfpipe-worker")
        self.process.start()
        worker_end.close()

    def perform(self, job: Job) -> Outcome:
        try:
            self._connection.send(job)
            if not self._connection.poll(job.most_seconds):
                raise TookTooLong
            outcome: Outcome = self._connection.recv()
        except (EOFError, OSError) as error:
            self.process.join(timeout=10)
            raise WorkerDied(self.process.exitcode) from error
        return outcome


def _too_long(job: Job) -> Outcome:
    return Outcome(
        f"took more than the limit of {job.most_seconds:g} s; raise `job_limits.seconds` of the configuration, or give a smaller raw file"
    )


def _killed(died: WorkerDied) -> Outcome:
    return Outcome(
        f"the process was killed {ATTEMPTS} times ({died}); free memory, or build with fewer cores (--cores)"
    )


def _crashed(job: Job, died: WorkerDied) -> Outcome:
    """A library ended the process. Inputs that are not what their jobs wrote are the cause, and can be computed again."""
    paths = [path for value in job.input.values() for path in ([value] if isinstance(value, str) else value)]
    damaged = shared_index(Path(job.folder)).damaged(paths)
    raw = ", ".join(Path(path).name for path in paths if Path(path).is_absolute())
    found = f"damaged: {', '.join(damaged)}" if damaged else "its inputs from other stages are undamaged"
    advice = f"; check {raw}" if raw and not damaged else ""
    return Outcome(
        f"a library crashed the process {ATTEMPTS} times ({died}); {found}{advice} (see {job.log_name})",
        damaged=tuple(damaged),
    )


_also_preloaded: set[str] = set()
_pools: dict[int, Pool] = {}
"""By process id: a forked process must not use the workers of its parent."""
_pools_lock = threading.RLock()


def shared_pool() -> Pool:
    """The pool that all threads of this process share."""
    with _pools_lock:
        return _pools.setdefault(os.getpid(), Pool())


def preload(modules: Iterable[str]) -> None:
    """Let the server of the workers import the slow ones of some modules (:data:`PRELOADED_WHERE_USED`); call it before the first job."""
    _also_preloaded.update(set(PRELOADED_WHERE_USED).intersection(modules))


def close() -> None:
    """Kill the workers of this process; the next job starts new ones."""
    with _pools_lock:
        closed = _pools.pop(os.getpid(), None)
    if closed:
        closed.close()


def _serve(connection: Connection) -> None:
    """Main loop of a worker: run jobs until the main process closes the connection."""
    from tqdm import tqdm

    tqdm.set_lock(threading.RLock())  # the default is a semaphore of the system, which a killed worker would leak
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the main process handles it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # the imported libraries: a search for garbage among their objects takes a tenth of a second
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        try:
            outcome = perform(job)
        except Exception as fault:  # for example, the log cannot be written; the worker can go on
            outcome = Outcome(f"unexpected {type(fault).__name__}: {fault}")
        connection.send(outcome)


def _end_with_parent() -> None:
    """End this worker when the main process ends, even in the middle of a job."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def sigint_blocked() -> Iterator[None]:
    """Block Ctrl-C for processes that are started here, from their first moment: the server ignores it only after its start."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _cause(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"exit code {exitcode}"
    try:
        return signal.Signals(-exitcode).name
    except ValueError:  # a real-time signal has no name
        return f"signal {-exitcode}"

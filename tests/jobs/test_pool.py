"""The pool: warm workers, killed workers, orphaned workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from brdfpipe.jobs import pool
from brdfpipe.jobs.stage import Job

SCRIPT = """
import json, os, signal, sys, time, warnings
from pathlib import Path
from brdfpipe.errors import BrdfpipeError

def main(input, output, params):
    spec = params["spec"]
    if spec.get("die"):
        os.kill(os.getpid(), signal.SIGKILL)
    if spec.get("stumble") and not Path("stumbled").exists():
        Path("stumbled").touch()
        os._exit(3)
    if spec.get("refuse"):
        raise BrdfpipeError("two\\nlines")
    if spec.get("sleep"):
        time.sleep(spec["sleep"])
    warnings.warn("odd but fine")
    print("to the log", flush=True)
    if spec.get("memory"):
        occupied = bytearray(spec["memory"])
    threads = os.environ["OMP_NUM_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]
    Path(output["out"]).write_text(json.dumps([os.getpid(), "xarray" in sys.modules, threads]))
"""


@pytest.fixture
def workers() -> Iterator[pool.Pool]:
    made = pool.Pool()
    yield made
    made.close()


def job(folder: Path, material: str = "m", **spec: object) -> Job:
    script = folder / "stage.py"
    script.write_text(SCRIPT)
    return Job("stage", material, str(script), str(folder), {}, {"out": f"{material}/out.json"}, spec)


def result(folder: Path, material: str = "m") -> list[object]:
    return list(json.loads((folder / material / "out.json").read_text()))


def test_jobs_one_after_the_other_share_one_warm_worker_of_one_thread(tmp_path: Path, workers: pool.Pool) -> None:
    assert workers.perform(job(tmp_path)).error is None
    first = result(tmp_path)
    assert workers.perform(job(tmp_path)).error is None
    assert result(tmp_path) == first
    assert first[1:] == [True, ["1", "1"]]
    assert first[0] != os.getpid()


def test_jobs_at_once_have_a_worker_each(tmp_path: Path, workers: pool.Pool) -> None:
    jobs = [job(tmp_path, name, sleep=0.5) for name in ("a", "b")]
    with ThreadPoolExecutor(2) as threads:
        assert [outcome.error for outcome in threads.map(workers.perform, jobs)] == [None, None]
    assert result(tmp_path, "a")[0] != result(tmp_path, "b")[0]


def test_jobs_of_a_material_go_to_the_worker_that_holds_its_datasets(tmp_path: Path, workers: pool.Pool) -> None:
    def processes(wait: float) -> list[object]:
        jobs = [job(tmp_path, name, sleep=wait) for name in ("a", "b")]
        with ThreadPoolExecutor(2) as threads:
            list(threads.map(workers.perform, jobs))
        return [result(tmp_path, name)[0] for name in ("a", "b")]

    first = processes(0.5)
    for name, process in zip(("a", "b", "a"), (*first, first[0]), strict=True):
        workers.perform(job(tmp_path, name))
        assert result(tmp_path, name)[0] == process


def test_a_killed_worker_fails_its_own_job_by_name_and_no_other(tmp_path: Path, workers: pool.Pool) -> None:
    jobs = [job(tmp_path, "good", sleep=0.3), job(tmp_path, "bad", die=True), job(tmp_path, "other")]
    with ThreadPoolExecutor(3) as threads:
        good, bad, other = threads.map(workers.perform, jobs)
    assert (good.error, other.error) == (None, None)
    assert bad.error == "the process was killed 2 times (SIGKILL); free memory, or build with fewer cores (--cores)"
    record = json.loads((tmp_path / "failures" / "bad.json").read_text())
    assert record == {"material": "bad", "stage": "stage", "message": bad.error}
    assert workers.perform(job(tmp_path)).error is None


def test_a_worker_killed_once_is_replaced_and_its_job_done(tmp_path: Path, workers: pool.Pool) -> None:
    assert workers.perform(job(tmp_path, stumble=True)).error is None
    assert not (tmp_path / "failures").exists()


def test_a_refusal_is_one_line_and_the_job_is_not_repeated(tmp_path: Path, workers: pool.Pool) -> None:
    outcome = workers.perform(job(tmp_path, refuse=True))
    assert outcome.error == "two lines"
    assert (tmp_path / "logs" / "m" / "stage.log").read_text().count("refused: two lines") == 1


def test_of_several_failures_of_a_material_the_first_stage_by_name_is_recorded(
    tmp_path: Path, workers: pool.Pool
) -> None:
    refused = job(tmp_path, refuse=True)
    for stage in ("b", "a", "c"):
        workers.perform(replace(refused, title=stage))
    assert json.loads((tmp_path / "failures" / "m.json").read_text())["stage"] == "a"


def test_a_job_that_succeeds_later_takes_back_its_own_failure_alone(tmp_path: Path, workers: pool.Pool) -> None:
    record = tmp_path / "failures" / "m.json"
    workers.perform(job(tmp_path, refuse=True))
    workers.perform(replace(job(tmp_path), title="another"))
    assert record.is_file()
    workers.perform(job(tmp_path))
    assert not record.exists()


def test_the_log_has_warnings_prints_and_times(tmp_path: Path, workers: pool.Pool) -> None:
    workers.perform(job(tmp_path))
    log = (tmp_path / "logs" / "m" / "stage.log").read_text()
    assert "stage of m" in log
    assert "UserWarning: odd but fine (stage.py:" in log
    assert "to the log" in log
    assert "s of processor" in log


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak can be reset on Linux alone")
def test_the_peak_of_memory_is_that_of_the_job(tmp_path: Path, workers: pool.Pool) -> None:
    large = workers.perform(job(tmp_path, memory=200_000_000))
    small = workers.perform(job(tmp_path))
    assert large.peak - small.peak > 150


def test_a_closed_pool_takes_no_job(tmp_path: Path, workers: pool.Pool) -> None:
    workers.close()
    with pytest.raises(pool.StageError, match="interrupted"):
        workers.perform(job(tmp_path))


def test_closing_ends_busy_workers_and_leaves_no_failure(tmp_path: Path, workers: pool.Pool) -> None:
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(workers.perform, job(tmp_path, sleep=60))
        while not (tmp_path / "logs" / "m" / "stage.log").exists():
            time.sleep(0.01)
        workers.close()
        assert isinstance(waiting.exception(), pool.StageError)
    assert not (tmp_path / "failures").exists()


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the signals that a process blocks are known on Linux alone"
)
def test_the_server_of_workers_ignores_ctrl_c_and_the_main_process_does_not(workers: pool.Pool, tmp_path: Path) -> None:
    workers.perform(job(tmp_path))
    server = psutil.Process(int(str(result(tmp_path)[0]))).ppid()
    blocked = Path(f"/proc/{server}/status").read_text().partition("SigBlk:")[2].split()[0]
    assert int(blocked, 16) >> (signal.SIGINT - 1) & 1
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, set())


def test_a_stage_that_cannot_open_a_result_names_it_and_no_raw_file(tmp_path: Path, workers: pool.Pool) -> None:
    script = tmp_path / "reader.py"
    script.write_text(
        "from brdfpipe import store\ndef main(input, output, params):\n    store.open_dataset(input['surface'])\n"
    )
    (tmp_path / "raw.txt").write_text("raw")
    (tmp_path / "surface.nc").write_bytes(b"\x89HDF damaged")
    files = {"raw": str(tmp_path / "raw.txt"), "surface": "surface.nc", "more": ["surface.nc"]}
    outcome = workers.perform(Job("facets", "m", str(script), str(tmp_path), files, {"out": "m/out.nc"}, {}))
    assert set(outcome.damaged) == {"surface.nc"}
    record = json.loads((tmp_path / "failures" / "m.json").read_text())
    assert set(record["damaged"]) == {"surface.nc"}


def test_workers_end_when_the_main_process_is_gone(tmp_path: Path) -> None:
    job(tmp_path)
    program = (
        "import sys, threading, time; from brdfpipe.jobs.pool import Pool; from brdfpipe.jobs.stage import Job; pool = Pool();"
        f"jobs = [Job('stage', name, {str(tmp_path / 'stage.py')!r}, {str(tmp_path)!r}, {{}}, {{'out': name}}, {{'sleep': 3600}})"
        " for name in 'ab'];"
        "[threading.Thread(target=pool.perform, args=(job,)).start() for job in jobs]"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    while not all((tmp_path / "logs" / name / "stage.log").exists() for name in "ab"):
        assert process.poll() is None
        time.sleep(0.02)
    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    _, alive = psutil.wait_procs(children, timeout=600)
    assert len(children) >= 3  # the server and two workers
    assert not [child for child in alive if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]


def test_a_progress_bar_in_a_killed_worker_leaves_no_semaphore(tmp_path: Path) -> None:
    job(tmp_path)
    script = tmp_path / "stage.py"
    script.write_text("from tqdm import tqdm\n" + SCRIPT + "    list(tqdm([1], disable=True))\n")
    program = (
        "from brdfpipe.jobs.pool import Pool; from brdfpipe.jobs.stage import Job; pool = Pool();"
        f"outcome = pool.perform(Job('stage', 'm', {str(script)!r}, {str(tmp_path)!r}, {{}}, {{'out': 'm/out.json'}}, {{}}));"
        "assert not outcome.error, outcome.error; pool.close()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("exitcode", "cause"), [(-9, "SIGKILL"), (-35, "signal 35"), (3, "exit code 3"), (None, "exit code None")]
)
def test_the_cause_of_death_is_a_signal_or_an_exit_code(exitcode: int | None, cause: str) -> None:
    assert pool._cause(exitcode) == cause


def test_a_job_beyond_its_time_is_ended_once_and_the_pool_goes_on(tmp_path: Path, workers: pool.Pool) -> None:
    started = time.monotonic()
    error = workers.perform(replace(job(tmp_path, sleep=60), most_seconds=0.2)).error
    assert "took more than the limit of 0.2 s; raise `job_limits.seconds`" in str(error)
    assert time.monotonic() - started < 50
    assert workers.perform(replace(job(tmp_path), most_seconds=60.0)).error is None


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit the memory of data")
def test_a_job_beyond_its_memory_fails_and_the_next_one_has_all(tmp_path: Path, workers: pool.Pool) -> None:
    large = job(tmp_path, memory=3 * 2**30)
    error = workers.perform(replace(large, most_memory=1500.0)).error
    assert "needs more memory than the limit of 1500 MB; raise `job_limits.memory`" in str(error)
    assert workers.perform(replace(job(tmp_path, memory=2**28), most_memory=1500.0)).error is None
    assert workers.perform(replace(job(tmp_path, memory=1700 * 2**20))).error is None


def test_a_signal_that_closes_the_pool_inside_its_own_functions_does_not_hang() -> None:
    code = "from brdfpipe.jobs import pool; one = pool.shared_pool()\nwith pool._pools_lock, one._lock: pool.close()"
    subprocess.run([sys.executable, "-c", code], timeout=60, check=True)

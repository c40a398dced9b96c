"""A catalogue through a real scheduler: the same results as on one machine, also where the scheduler kills a job or a material is bad."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import local_slurm
import pytest

from brdfpipe.jobs.build import build
from brdfpipe.stages import STAGES

PROJECT = Path(__file__).parents[2]
MATERIALS = ("paint-1", "paint-2", "paint-3", "paint-4")

SETTINGS = """\
preview: false
gloss_angles: [60]
appearance: {haze: []}
table: {theta_i: [0, 45], theta_o: [0, 30, 45, 60], phi_o: [0, 90, 180], refine: false}
lambert_gauss: {theta_i: [0, 45]}
"""

PLUGINS = ("snakemake_executor_plugin_slurm", "snakemake_executor_plugin_cluster_generic")
LITTLE = 100
"""MB of memory, less than a worker takes that has imported its libraries."""

ABSENT = [name for name in PLUGINS if importlib.util.find_spec(name) is None]

# Status of each job at once, on a single node without accounting; two materials a job, so that there are several.
HERE = (
    "--group-components",
    "materials=2",
    "--latency-wait",
    "10",
    "--cores",
    "1",
    "--seconds-between-status-checks",
    "1",
)
SLURM = (
    "--slurm-keep-successful-logs",
    "--slurm-no-account",
    "--slurm-status-command",
    "squeue",
    "--slurm-init-seconds-before-status-checks",
    "1",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(local_slurm.missing()), reason=local_slurm.INSTALL),
    pytest.mark.skipif(bool(ABSENT), reason="executor plugins are not installed: make cluster"),
]


@pytest.fixture(scope="module")
def slurm() -> Iterator[dict[str, str]]:
    with local_slurm.local_slurm(cpus=2, memory=16000) as environment:
        yield environment


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cluster") / "catalogue"
    for number, name in enumerate(MATERIALS):
        _write_paint(folder, name, lightness=40 + number)
    (folder.parent / "settings.yaml").write_text(SETTINGS)
    return folder


@pytest.fixture(scope="module")
def local(catalogue: Path) -> dict[str, bytes]:
    """The results of a build on this machine."""
    results = catalogue.parent / "local"
    assert build(catalogue, results, cores=2, config=_settings(catalogue)).failures == {}
    return _files(results)


@pytest.mark.parametrize(("profile", "options"), [("slurm", SLURM), ("generic", ())])
def test_a_cluster_gives_the_same_files(
    slurm: dict[str, str],
    catalogue: Path,
    local: dict[str, bytes],
    tmp_path: Path,
    profile: str,
    options: Sequence[str],
) -> None:
    before = _jobs(slurm)
    with _snakemake(slurm, profile, catalogue, tmp_path, options) as run:
        output, _ = run.communicate(timeout=600)
    assert run.returncode == 0, output
    jobs = {name: job for name, job in _jobs(slurm).items() if name not in before}
    assert [job["state"] for job in jobs.values()] == ["COMPLETED"] * 3  # two of materials, one of the catalogue
    logs = [log.read_text() for log in tmp_path.glob(".snakemake/slurm_logs/group_*/**/*.log")]
    assert len(logs) == (2 if profile == "slurm" else 0)
    for log in logs:  # all stages of its materials in one run, with one pool of workers
        assert log.count("Provided cores: ") == 1
    assert _files(tmp_path) == local
    summary = build(catalogue, tmp_path, cores=1, config=_settings(catalogue))
    assert (summary.jobs, summary.failures) == (0, {})


def test_a_job_that_the_scheduler_cancels_runs_again_with_more_memory(
    slurm: dict[str, str], catalogue: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    before = _jobs(slurm)
    with _snakemake(slurm, "slurm", catalogue, tmp_path, SLURM) as run:
        end = time.monotonic() + 300
        while not any(tmp_path.glob("paint-*/bsdf.nc")):
            assert time.monotonic() < end, "no job has written results"
            assert run.poll() is None, run.communicate()[0]
            time.sleep(0.1)
        running = [name for name, job in _jobs(slurm).items() if job["state"] == "RUNNING" and name not in before]
        subprocess.run(["scancel", *running], env=slurm, check=True)
        output, _ = run.communicate(timeout=600)
    assert run.returncode == 0, output
    jobs = {name: job for name, job in _jobs(slurm).items() if name not in before}
    cancelled = [jobs.pop(name) for name in running]
    assert cancelled
    assert {job["state"] for job in cancelled} == {"CANCELLED"}
    assert {job["state"] for job in jobs.values()} == {"COMPLETED"}
    memory = [int(job["memory"].removesuffix("M")) for job in jobs.values()]
    for first in (int(job["memory"].removesuffix("M")) for job in cancelled):
        memory.remove(2 * first)  # its retry; ValueError if there was none
    assert len(memory) == 1  # the job of the catalogue
    assert not any((tmp_path / "failures").glob("*"))
    # A stage that is killed as it writes leaves an unfinished file, which the next build removes.
    summary = build(catalogue, tmp_path, cores=1, config=_settings(catalogue))
    assert (summary.jobs, summary.failures) == (0, {})
    assert _files(tmp_path) == local


def test_a_job_that_exceeds_its_memory_is_killed_and_runs_again_with_more(
    slurm: dict[str, str], catalogue: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    before = _jobs(slurm)
    little = [f"{name}:mem_mb={LITTLE} if attempt == 1 else 1500" for name in STAGES]
    with _snakemake(slurm, "slurm", catalogue, tmp_path, (*SLURM, "--set-resources", *little)) as run:
        output, _ = run.communicate(timeout=600)
    assert run.returncode == 0, output
    jobs = [job for name, job in _jobs(slurm).items() if name not in before]
    killed = [job for job in jobs if job["memory"] == f"{LITTLE}M"]
    assert killed, jobs
    assert "COMPLETED" not in {job["state"] for job in killed}
    assert {job["state"] for job in jobs if job not in killed} == {"COMPLETED"}
    assert _files(tmp_path) == local


def test_a_bad_material_leaves_the_others_of_its_job_and_a_build_finishes_the_catalogue(
    slurm: dict[str, str], catalogue: Path, tmp_path: Path
) -> None:
    folder, results = tmp_path / "catalogue", tmp_path / "results"
    _write_paint(folder, "good", lightness=40)
    (_write_paint(folder, "bad", lightness=40) / "material.yaml").write_text(
        "spectrum: {file: reflectance.txt, geometry: sci}\n"
    )
    (folder / "bad" / "reflectance.txt").write_text("no numbers\n")
    (tmp_path / "settings.yaml").write_text(SETTINGS)
    with _snakemake(slurm, "slurm", folder, results, SLURM) as run:
        output, _ = run.communicate(timeout=600)
    assert run.returncode == 1, output
    assert (results / "good" / "summary.nc").exists()
    assert not (results / "catalogue.nc").exists()
    summary = build(folder, results, cores=1, config=tmp_path / "settings.yaml")
    assert list(summary.failures) == ["bad"]
    assert summary.current == ("good",)
    assert (results / "catalogue.nc").exists()


def _write_paint(catalogue: Path, name: str, lightness: float) -> Path:
    """A material of a few light stages."""
    folder = catalogue / name
    folder.mkdir(parents=True)
    description = f"spectrum: {{lab: [{lightness}, 34, 22], illuminant: D65, observer: 10, geometry: sci}}\n"
    (folder / "material.yaml").write_text(description)
    return folder


def _settings(catalogue: Path) -> Path:
    return catalogue.parent / "settings.yaml"


def _snakemake(
    slurm: dict[str, str], profile: str, catalogue: Path, results: Path, options: Sequence[str]
) -> subprocess.Popen[str]:
    config = (f"catalogue={catalogue}", f"settings={_settings(catalogue)}")
    profile = str(PROJECT / "workflow" / "profiles" / profile)
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile"), "--profile", profile]
    command += ["--directory", str(results), *HERE, *options, "--config", *config]
    return subprocess.Popen(
        command,
        env=slurm | {"OPENBLAS_NUM_THREADS": "1"},
        cwd=os.sep,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def _jobs(slurm: dict[str, str]) -> dict[str, dict[str, str]]:
    """State and memory of each job since the scheduler started."""
    command = ["squeue", "--noheader", "--states=all", "--format=%i %T %m"]
    lines = subprocess.run(command, env=slurm, check=True, capture_output=True, text=True).stdout.splitlines()
    return {name: {"state": state, "memory": memory} for name, state, memory in map(str.split, lines)}


def _files(results: Path) -> dict[str, bytes]:
    """All results by name, without logs and what only the run itself needs."""
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file()
        and path.relative_to(results).parts[0] != "logs"
        and not str(path.relative_to(results)).startswith(".")
    }

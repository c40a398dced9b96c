"""What starts fast stays fast: an import and the command line load no heavy library. The wheel holds what a build needs."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from brdfpipe import installation

PROJECT = Path(__file__).parents[1]
HEAVY = ("numpy", "scipy", "pandas", "xarray", "numba", "snakemake", "astropy", "matplotlib", "pydantic")


@pytest.mark.parametrize("module", ["brdfpipe", "brdfpipe.cli.main"])
def test_a_start_loads_no_heavy_library(module: str) -> None:
    code = f"import sys, {module}; print(*sorted(set({HEAVY}) & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == []


def test_the_project_folder_has_the_workflow_and_the_examples() -> None:
    folder = installation.project_folder()
    for name in (
        "Snakefile",
        "config/config.yaml",
        "workflow/rules",
        "workflow/scripts",
        "examples/abs-grain/material.yaml",
    ):
        assert (folder / name).exists(), name


@pytest.mark.slow
def test_the_wheel_builds_the_tutorial_without_the_checkout(tmp_path: Path) -> None:
    """The wheel in a folder of its own, with the libraries of this environment: nothing of the checkout is imported."""
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        tmp_path,
        PROJECT,
    ]
    subprocess.run(build, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    names = zipfile.ZipFile(wheel).namelist()
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests/")]

    def run(*words: str) -> str:
        code = f"import sys; sys.path.insert(0, {str(tmp_path / 'installed')!r}); from brdfpipe.cli.main import main; main()"
        environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(tmp_path / "installed"), "HOME": str(tmp_path)}
        command = [sys.executable, "-c", code, *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout

    run("examples", "materials")
    run("check", "materials")
    run("build", "materials", "abs-grain", "--results", "results")
    assert "abs-grain" in run("show", "results/abs-grain")

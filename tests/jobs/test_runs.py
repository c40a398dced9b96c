"""Runs of rigs whose plan does not measure what a material needs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe import catalogue
from brdfpipe.cli import main as cli
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.runs import planned_runs

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A glass whose plan measures no sample, and a sheet that is measured properly."""
    for name in ("milk-glass", "opal-glass", "calibrations"):
        shutil.copytree(EXAMPLES / name, tmp_path / "catalogue" / name)
    plan = tmp_path / "catalogue" / "milk-glass" / "plan.yaml"
    text = plan.read_text()
    assert "runs: [target, sample]" in text
    plan.write_text(text.replace("runs: [target, sample]", "runs: [target]"))
    return tmp_path / "catalogue"


def test_a_run_without_the_sample_is_a_problem_of_its_material_alone(folder: Path) -> None:
    planned, problems = planned_runs(catalogue.load(folder))
    assert list(problems) == ["milk-glass"]
    assert "runs: the sample is not measured; accepted: a list with sample in it" in problems["milk-glass"]
    assert "calibrations/bench-1" in planned


def test_a_dry_run_and_a_check_report_a_run_without_the_sample(folder: Path, tmp_path: Path) -> None:
    summary = build_catalogue(folder, tmp_path / "results", cores=1, dry_run=True)
    assert list(summary.failures) == ["milk-glass"]
    assert summary.built == ("opal-glass",)
    checked = CliRunner().invoke(cli.main, ["check", str(folder)])
    assert checked.exit_code == 1
    assert "milk-glass: plan.yaml, runs: the sample is not measured" in checked.output
    assert "1 ok, 1 wrong" in checked.output

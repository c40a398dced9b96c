"""How much code each stage depends on, and the page of the documentation that lists it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import stages as benchmark
from source_tree import SOURCE, modules

from brdfpipe.jobs import code
from brdfpipe.stages import STAGES

OWN = {name: stage for name, stage in STAGES.items() if stage.script in (name, "export")}
"""Stages with a script of their own."""


def test_the_page_of_stages_is_up_to_date() -> None:
    written, expected = benchmark.PAGE.read_text(encoding="utf-8").splitlines(), benchmark.page().splitlines()
    assert written == expected, "run `python benchmarks/stages.py`"


@pytest.mark.parametrize(("stage", "most"), {"predicted": 50, "flake": 30, "measured": 21, "smoothed": 20}.items())
def test_a_stage_depends_on_few_modules(stage: str, most: int) -> None:
    assert benchmark.LIMITS[stage] == most
    assert len(benchmark.modules(STAGES[stage])) <= most


def test_an_edit_of_a_report_module_reruns_the_report_and_the_catalogue_alone(tmp_path: Path) -> None:
    package = shutil.copytree(SOURCE / "brdfpipe", tmp_path / "brdfpipe", ignore=shutil.ignore_patterns("__pycache__"))
    before = digests(tmp_path)
    for file, users in {
        "report/material/page.py": {"report"},
        "report/catalogue/page.py": {"catalogue"},
        "report/catalogue/rows.py": {"summary", "catalogue"},
        "report/rendering.py": {"report", "summary", "catalogue"},
    }.items():
        text = (package / file).read_text(encoding="utf-8")
        (package / file).write_text(f"{text}\nEDITED = True\n", encoding="utf-8")
        after = digests(tmp_path)
        (package / file).write_text(text, encoding="utf-8")
        assert {name for name in OWN if after[name] != before[name]} == users, file


def digests(root: Path) -> dict[str, str]:
    return {name: code.digest(benchmark.script(stage), root, stage.modules) for name, stage in OWN.items()}


def test_no_other_stage_depends_on_the_report() -> None:
    report = {name for name in modules() if name.startswith("brdfpipe.report.")}
    users = {name for name, stage in OWN.items() if report.intersection(benchmark.modules(stage))}
    assert users == {"report", "summary", "catalogue"}

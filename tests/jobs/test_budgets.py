"""A build names the materials that cost more than the budget of their scene."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe.catalogue.catalogue import load
from brdfpipe.jobs.budgets import _cost, _without
from brdfpipe.jobs.build import build
from brdfpipe.scenes.scene import load_scene
from brdfpipe.stages import Subject

SCENE = """\
purpose: a test
domain: {hemisphere: {}}
results: [checks]
metric: rendering
tolerance: 1
model: fullest
"""


def test_a_build_names_the_materials_that_exceed_the_budget(folder: Path, project: Path, tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text(f"{SCENE}budget: {{bytes: 10, seconds: 1e-9}}\n")
    summary = build(folder, tmp_path / "results", cores=2, scene=str(scene))
    assert [name for name, _ in summary.over_budget] == ["first", "first", "second", "second"]
    sentences = [sentence for _, sentence in summary.over_budget]
    assert all("the budget of the scene mine is" in sentence for sentence in sentences)
    assert [("raise `budget.seconds`" in sentence, "largest: " in sentence) for sentence in sentences[:2]] == [
        (True, False),
        (False, True),
    ]
    assert f"first: {sentences[0]}" in summary.text.splitlines()
    scene.write_text(f"{SCENE}budget: {{bytes: 1e9, seconds: 1e9}}\n")
    assert build(folder, tmp_path / "results", cores=2, scene=str(scene)).over_budget == ()
    for damaged in ("", "[1]", "{}"):
        (tmp_path / "results" / "logs" / "first" / "spectrum.json").write_text(damaged)
        assert build(folder, tmp_path / "results", cores=2, scene=str(scene)).over_budget == ()


@pytest.mark.parametrize(
    ("budget", "words"),
    [
        (4.0, "without `table` it would take 3.5 s"),
        (2.0, "without `table`, `checks` it would take 1.5 s"),
        (1.0, "without `table`, `checks` it would take 1.5 s, still too long: raise `budget.seconds`"),
    ],
)
def test_results_that_save_most_are_given_up_first(folder: Path, tmp_path: Path, budget: float, words: str) -> None:
    (tmp_path / "mine.yaml").write_text(SCENE.replace("[checks]", "[checks, table]"))
    catalogue = load(folder)
    subject = Subject(catalogue["first"], catalogue.config, (), load_scene(tmp_path / "mine.yaml"))
    costs = {"checks": 2.0, "table": 3.0, "spectrum": 1.5}
    assert _without(subject, costs, budget) == words


def test_results_of_one_job_are_given_up_together(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(SCENE.replace("[checks]", "[checks, gloss, colour]"))
    catalogue = load(folder)
    subject = Subject(catalogue["first"], catalogue.config, (), load_scene(tmp_path / "mine.yaml"))
    words = _without(subject, {"checks": 2.0, "appearance": 5.0}, 3.0)
    assert words in [f"without {both} it would take 2 s" for both in ("`gloss`, `colour`", "`colour`, `gloss`")]


def test_jobs_of_other_scenes_do_not_count(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(SCENE)
    catalogue = load(folder)
    subject = Subject(catalogue["first"], catalogue.config, (), load_scene(tmp_path / "mine.yaml"))
    # Jobs of a camera rig follow from its run, not from the scene.
    assert _cost(subject, {"checks": 2.0, "table": 4.0, "spectrum": 1.0, "reduced-0-front-10": 8.0}) == 11.0

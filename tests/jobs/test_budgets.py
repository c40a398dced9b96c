"""A build names the materials that cost more than the budget of their scene."""

from __future__ import annotations

from pathlib import Path

from brdfpipe.jobs.build import build

SCENE = """\
purpose: a test
domain: {hemisphere: {}}
results: [checks]
metric: rendering
tolerance: 1
"""


def test_a_build_names_the_materials_that_exceed_the_budget(folder: Path, project: Path, tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text(f"{SCENE}budget: {{bytes: 10, seconds: 1e-9}}\n")
    notices = build(folder, tmp_path / "results", cores=2, scene=str(scene)).notices
    assert [notice.split(":")[0] for notice in notices] == ["first", "first", "second", "second"]
    assert all("the budget of the scene mine is" in notice for notice in notices)
    scene.write_text(f"{SCENE}budget: {{bytes: 1e9, seconds: 1e9}}\n")
    assert build(folder, tmp_path / "results", cores=2, scene=str(scene)).notices == ()

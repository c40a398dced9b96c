"""A stage refuses results of another material than its inputs should be of."""

from __future__ import annotations

from pathlib import Path

import pytest
import samples

from brdfpipe import store
from brdfpipe.jobs.stage import Job, Outcome, perform

SCRIPT = """
from brdfpipe import store

def main(input, output, params):
    store.open_dataset(input["spectrum"])
"""

PLACES = {
    "grey/spectrum.nc": "grey",
    "scenes/gloss-sheet/grey/spectrum.nc": "grey",
    "calibrations/bench-1.nc": "calibrations.bench-1",
    "calibrations/bench-1/spectrum.nc": "calibrations.bench-1",
}
"""Result → the material that it must be of."""


def read(folder: Path, path: str, material: str) -> Outcome:
    """The outcome of a stage that reads a dataset of a material at a place."""
    store.save_dataset(samples.spectrum(), folder / path, stage="spectrum", material=material)
    (folder / "stage.py").write_text(SCRIPT)
    return perform(Job("stage", "any", str(folder / "stage.py"), str(folder), {"spectrum": path}, {}, {}))


@pytest.mark.parametrize("path", PLACES)
def test_a_result_is_of_the_material_of_its_folder(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a stage changes it
    assert read(tmp_path, path, PLACES[path]).error is None
    outcome = read(tmp_path, path, "red")
    assert f"is a dataset of the material red, not of {PLACES[path]}" in str(outcome.error)
    assert outcome.damaged == (path,)


def test_a_raw_dataset_may_be_of_any_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = read(tmp_path, str(tmp_path / "raw" / "spectrum.nc"), "red")
    assert outcome == Outcome(None, outcome.wall, outcome.cpu, outcome.peak)

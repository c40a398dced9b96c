"""Which materials get a comparison of what a rig measured with what their surface predicts; and one through the real workflow."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe import installation, store
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.rules import Pipeline
from brdfpipe.rig import templates as starting
from brdfpipe.stages import STAGES

CERTIFICATE = """\
id: C1
valid_until: "2099-01-01"
reflectance_factor: 0.9
angles: [[0, 1], [30, 0.9875], [60, 0.95], [90, 0.8875]]
"""
BODY = "index: 1.5\nspectrum: {lab: [60, 20, 10], illuminant: D65, observer: 10, geometry: sci}\n"
ROUGH, FLAT = "surface: {distribution: beckmann, slope_rms: 0.1}\n", "surface: {distribution: flat}\n"
RIG = "rig: {plan: plan.yaml, emulate: {truth: truth}, calibration: c1}\n"


def plan(folder: Path, runs: str, side: str = "[reflection]") -> None:
    path = starting.start(folder)
    text = path.read_text()
    for old, new in (
        ("[10, 20, 30, 45, 60]", "[10, 45]"),
        ("{from: 390, to: 730, step: 10}", "[500, 600]"),
        ("[target, etalon, sample]", runs),
        ("[reflection]", side),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A material that others are measured as, and its calibration."""
    root = tmp_path / "catalogue"
    calibration = root / "calibrations" / "c1"
    plan(calibration, "[etalon]")
    (calibration / "certificate.yaml").write_text(CERTIFICATE)
    (calibration / "calibration.yaml").write_text("plan: plan.yaml\nemulate: {}\ncertificate: certificate.yaml\n")
    (root / "truth").mkdir()
    (root / "truth" / "material.yaml").write_text(ROUGH.replace("0.1}", "0.11}") + BODY)
    return root


def material(root: Path, name: str, text: str, side: str = "[reflection]") -> None:
    plan(root / name, "[sample]", side)
    (root / name / "material.yaml").write_text(text)


def test_materials_with_a_rough_surface_and_reflected_light_are_compared(folder: Path) -> None:
    material(folder, "both", ROUGH + BODY + RIG)
    material(folder, "flat", FLAT + BODY + RIG)
    material(folder, "through", ROUGH + BODY + RIG, "[transmission]")
    material(folder, "rig-alone", RIG)
    pipeline = Pipeline({"catalogue": str(folder)}, installation.project_folder() / "workflow" / "scripts")
    assert pipeline.failures == {}
    subjects = {name: pipeline.subject(pipeline.catalogue[name]) for name in pipeline.names}
    assert [name for name, subject in subjects.items() if STAGES["comparison"].jobs(subject)] == ["both"]


@pytest.mark.slow
def test_the_workflow_compares_what_the_emulated_rig_measured(folder: Path, tmp_path: Path) -> None:
    material(folder, "both", ROUGH + BODY + RIG)
    summary = build_catalogue(folder, tmp_path / "results", cores=2)
    assert summary.failures == {}
    comparison = store.open_dataset(tmp_path / "results" / "both" / "comparison.nc", "comparison")
    assert set(comparison.attrs["inputs"].split('"')[1::4]) == {"facets", "index", "predicted", "primary", "spectrum"}
    # The truth is 10 % rougher; frames, reduction and calibration lie between.
    assert float(comparison["posterior"].sel(input="slope")) == pytest.approx(1.1, abs=0.01)
    assert float(comparison["chi_squared_dof"].sel(model="adjusted")) < 1.5

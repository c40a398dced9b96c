"""A run of the camera rig in the workflow: scanned by the emulator, calibrated, reduced, smoothed and completed."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import brdfpipe
from brdfpipe import catalogue, installation, vocabulary
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.jobs.rules import Pipeline
from brdfpipe.jobs.summary import Summary

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = ("milk-glass", "opal-glass")


def copied(folder: Path) -> Path:
    """The measured glass, its truth, and the calibration of the rig, at three wavelengths."""
    for name in (*NAMES, "calibrations"):
        shutil.copytree(EXAMPLES / name, folder / name)
    for plan in folder.rglob("plan.yaml"):
        text = plan.read_text()
        assert "{from: 400, to: 700, step: 60}" in text
        plan.write_text(text.replace("{from: 400, to: 700, step: 60}", "[460, 550, 640]"))
    return folder


def add_calibration(folder: Path, name: str, previous: str) -> None:
    """Add a calibration of the rig on another day, after a previous one."""
    shutil.copytree(folder / "calibrations" / "bench-1", folder / "calibrations" / name)
    path = folder / "calibrations" / name / "calibration.yaml"
    text = path.read_text()
    assert "emulate: {seed: 1}" in text
    path.write_text(text.replace("emulate: {seed: 1}", "emulate: {seed: 1, session: 2}") + f"previous: {previous}\n")


def use_calibration(folder: Path, calibration: str) -> None:
    """Use another calibration for the measured glass."""
    path = folder / "milk-glass" / "material.yaml"
    path.write_text(path.read_text().replace("calibration: bench-1", f"calibration: {calibration}"))


def build(folder: Path, results: Path, **options: bool) -> Summary:
    """Build with coarse tables, gloss at one angle, and without haze and pictures: no test reads them."""
    settings = folder.parent / "settings.yaml"
    settings.write_text(
        "preview: false\nlambert_gauss: {theta_i: [0, 45]}\ngloss_angles: [60]\nappearance: {haze: []}\n"
        "table: {theta_i: [0, 45], theta_o: [0, 30, 45, 60], phi_o: [0, 90, 180], refine: false}\n"
    )
    return build_catalogue(folder, results, cores=2, config=settings, **options)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    base = tmp_path_factory.mktemp("rig")
    folder, results = copied(base / "catalogue"), base / "results"
    add_calibration(folder, "bench-2", "bench-1")
    use_calibration(folder, "bench-2")
    summary = build(folder, results)
    assert summary.failures == {}
    assert summary.built == NAMES
    return folder, results


def test_the_measured_bsdf_is_that_of_the_material(built: tuple[Path, Path]) -> None:
    _, results = built
    bsdf = brdfpipe.open_dataset(results / "milk-glass" / "bsdf.nc")
    assert bsdf.attrs["route"] == "measured"
    assert bsdf.attrs["representation"] == "rig"


def test_the_measured_bsdf_agrees_with_the_truth_within_its_uncertainty(built: tuple[Path, Path]) -> None:
    _, results = built
    truth, measured = (brdfpipe.open_dataset(results / name / "bsdf.nc") for name in ("opal-glass", "milk-glass"))
    theta_o = np.linspace(0, 70, 15)
    for incidence in (10, 30, 60):
        directions = (incidence, 0, theta_o, 180)
        wavelength = measured["wavelength"].values
        expected = truth.bsdf.evaluate(*directions, wavelength=wavelength).values
        deviation = measured.bsdf.evaluate(*directions, wavelength=wavelength).values / expected - 1
        assert np.median(np.abs(deviation)) < 0.02
        u = measured.bsdf.uncertainty(*directions, wavelength=wavelength).values / expected
        assert np.sqrt(np.mean((deviation / u) ** 2)) < 2


def test_nothing_is_rebuilt(built: tuple[Path, Path]) -> None:
    folder, results = built
    assert build(folder, results, dry_run=True).jobs == 0


@pytest.mark.slow
def test_the_same_run_gives_the_same_bytes(built: tuple[Path, Path]) -> None:
    folder, results = built
    run = results / "milk-glass" / "run"
    before = {path.name: path.read_bytes() for path in sorted((run / "frames").iterdir())}
    digest = brdfpipe.open_dataset(results / "milk-glass" / "bsdf.nc").attrs["digest"]
    shutil.rmtree(results / "milk-glass")
    assert build(folder, results).failures == {}
    assert {path.name: path.read_bytes() for path in sorted((run / "frames").iterdir())} == before
    assert brdfpipe.open_dataset(results / "milk-glass" / "bsdf.nc").attrs["digest"] == digest


def test_the_control_chart_shows_the_profile_in_use_and_earlier_ones(built: tuple[Path, Path]) -> None:
    """The etalon of a day differs from its certificate by 0.5 %: two days differ by no more than chance."""
    _, results = built
    profile = brdfpipe.open_dataset(results / "calibrations" / "bench-2.nc", "calibration")
    assert profile["profile"].values.tolist() == ["bench-1", "bench-2"]
    level = profile.sel(watched="level")["change"].values[-1]
    assert 0 < abs(level) < 4 * np.sqrt(2) * 0.005
    assert not profile["violation"].values.any()
    assert "From 1, bench-1 of " in (results / "milk-glass" / "report.html").read_text()


def test_a_failed_calibration_is_reported_for_each_material_that_depends_on_it(
    built: tuple[Path, Path],
) -> None:
    folder, results = built
    certificate = folder / "calibrations" / "bench-1" / "certificate.yaml"
    text = certificate.read_text()
    try:
        certificate.write_text(text.replace("2030-01-01", "1969-12-31"))
        failures = build(folder, results).failures
    finally:
        certificate.write_text(text)
    assert list(failures) == ["milk-glass"]
    assert "calibrations.bench-1" in failures["milk-glass"]
    assert "valid until 1969-12-31" in failures["milk-glass"]


def test_an_emulated_material_has_a_warning(built: tuple[Path, Path]) -> None:
    _, results = built
    assert any(
        "come from the rig emulator" in text
        for text in vocabulary.warnings(brdfpipe.open_dataset(results / "milk-glass" / "bsdf.nc"))
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("calibration: bench-1", "calibration: bench-2", ["rig.calibration", "'bench-2'", "bench-1"]),
        ("truth: opal-glass", "truth: opal-gals", ["rig.emulate.truth", "opal-glass"]),
        ("truth: opal-glass", "truth: milk-glass", ["rig.emulate.truth", "milk-glass"]),
        ("plan: plan.yaml", "plan: ../plan.yaml", ["rig.plan", "outside"]),
        ("emulate: {truth: opal-glass, seed: 1, session: 1}", "run: run", ["rig", "plan"]),
    ],
)
def test_an_invalid_rig_block_of_a_material_is_refused_with_its_key(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    folder = copied(tmp_path / "catalogue")
    path = folder / "milk-glass" / "material.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    failure = catalogue.load(folder).failures["milk-glass"]
    for word in words:
        assert word in failure


@pytest.mark.parametrize(
    ("previous", "words"),
    [
        (
            {"bench-2": "bench-0"},
            ["no such calibration; did you mean 'bench-1'?", "found 'bench-0'", "accepted: bench-1"],
        ),
        ({"bench-2": "bench-2"}, ["the previous calibrations form a loop: bench-2 → bench-2"]),
        (
            {"bench-2": "bench-3", "bench-3": "bench-2"},
            ["the previous calibrations form a loop: bench-2 → bench-3 → bench-2"],
        ),
        ({"bench-2": "bench-3", "bench-3": "bench-9"}, ["cannot be used; found 'bench-3'", "found 'bench-9'"]),
        ({"bench-2": "'../x'"}, ["no such calibration; found '../x'"]),
        ({"bench-2": "[bench-1]"}, ['found ["bench-1"]; accepted: the calibration of the same rig before this one']),
    ],
)
def test_an_invalid_previous_calibration_is_refused_with_its_key(
    tmp_path: Path, previous: dict[str, str], words: list[str]
) -> None:
    folder = copied(tmp_path / "catalogue")
    for name, before in previous.items():
        add_calibration(folder, name, before)
    use_calibration(folder, "bench-2")
    loaded = catalogue.load(folder)
    assert list(loaded.failures) == ["milk-glass"]
    for word in ["rig.calibration: the calibration cannot be used", "calibration.yaml, ", "previous", *words]:
        assert word in loaded.failures["milk-glass"]


def test_a_wrong_plan_of_a_previous_calibration_is_a_failure_of_the_material(tmp_path: Path) -> None:
    folder = copied(tmp_path / "catalogue")
    add_calibration(folder, "bench-2", "bench-1")
    use_calibration(folder, "bench-2")
    plan = folder / "calibrations" / "bench-1" / "plan.yaml"
    plan.write_text(plan.read_text().replace("etalon_entrances: [10, 30, 60]", "etalon_entrances: [10, 33]"))
    pipeline = Pipeline({"catalogue": str(folder)}, installation.project_folder() / "workflow" / "scripts")
    assert list(pipeline.failures) == ["milk-glass"]
    assert "etalon_entrances" in pipeline.failures["milk-glass"]["message"]


def test_a_wrong_plan_is_a_failure_of_its_material_alone(tmp_path: Path) -> None:
    folder = copied(tmp_path / "catalogue")
    plan = folder / "milk-glass" / "plan.yaml"
    plan.write_text(plan.read_text().replace("incidences: [10, 30, 60]", "incidences: [10, 33]"))
    summary = build_catalogue(folder, tmp_path / "results", cores=2, dry_run=True)
    assert summary.built == ("opal-glass",)


def test_the_catalogue_lists_the_measured_route(built: tuple[Path, Path]) -> None:
    _, results = built
    assert "measured" in (results / "catalogue.csv").read_text()

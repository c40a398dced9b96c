"""The examples in the real workflow: results, reproducibility of their bytes, and what a change rebuilds."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import samples
from built_examples import EXAMPLES, build_examples
from killed_build import contents, start_build
from random_surfaces import heights
from varied_materials import ROUTES, write_varied

from brdfpipe import installation, store
from brdfpipe.appearance.quantities import quantities
from brdfpipe.jobs.build import build as build_catalogue
from brdfpipe.psd.k_correlation import KCorrelation
from brdfpipe.scenes.scene import load_scene

PROJECT = Path(__file__).parents[1]

Lock = dict[str, dict[str, str]]
MadeOnce = Callable[[str, Callable[[Path], None]], Path]


COARSE = """\
preview: false
gloss_angles: [60]
appearance: {haze: []}
table: {theta_i: [0, 45], theta_o: [0, 30, 45, 60], phi_o: [0, 90, 180], refine: false}
lambert_gauss: {theta_i: [0, 45]}
"""
"""Settings of builds whose tables, pictures, gloss and haze no test reads."""


@pytest.fixture(scope="session")
def built(made_once: MadeOnce) -> tuple[Path, Path]:
    """A copy of the examples and its results, for reading."""
    base = made_once("workflow", build_examples)
    return base / "catalogue", base / "results"


@pytest.fixture
def results(built: tuple[Path, Path], tmp_path: Path) -> Path:
    """The results in a place where a test may change them; they belong to the same catalogue."""
    return shutil.copytree(built[1], tmp_path / "results", symlinks=True)


def lock(results: Path) -> Lock:
    return dict(json.loads((results / "catalogue.lock.json").read_text()))


def test_every_dataset_has_its_material_stage_and_digest(built: tuple[Path, Path]) -> None:
    _, results = built
    paths = [path for name in EXAMPLES for path in sorted((results / name).glob("*.nc"))]
    for path in paths:
        dataset = store.verify_digest(store.open_dataset(path), path.name)
        assert dataset.attrs["material"] == path.parent.name
        assert dataset.attrs["stage"] == path.stem
    assert len(paths) == 17 + 9 + 10 + 17


def test_the_lock_lists_every_dataset(built: tuple[Path, Path]) -> None:
    _, results = built
    locked = lock(results)
    assert sorted(locked) == list(EXAMPLES)
    for name in EXAMPLES:
        made = {path.stem for path in (results / name).glob("*.nc")} - {"summary"}
        assert set(locked[name]) == made


def test_every_material_has_its_page_and_exports(built: tuple[Path, Path]) -> None:
    _, results = built
    for name in EXAMPLES:
        assert (results / name / "report.html").stat().st_size > 10_000
        exports = {path.name for path in (results / name / "exports").iterdir()}
        named = ("astm", "astm.json", "total_reflectance.csv") if name == "paint-lab" else ()
        assert exports == {f"{name}.{kind}" for kind in (*named, "lambert_gauss.csv")}
        assert name in (results / "index.html").read_text()


def test_every_uncertainty_is_stated_or_what_is_missing_is_named(built: tuple[Path, Path]) -> None:
    _, results = built
    table = pd.read_csv(results / "catalogue.csv", index_col="material", keep_default_na=False)
    of_total = {"L", "a", "b", "luminous_reflectance"}
    without = dict.fromkeys(EXAMPLES, of_total) | {"metallic-blue": set()}
    # A perfect diffuser is as uncertain everywhere as its spectrum.
    without["paint-lab"] = of_total | {"L_45_0", "a_45_0", "b_45_0"}
    for name, row in table.iterrows():
        known = [quantity for quantity in quantities() if quantity.u and row[quantity.name] != ""]
        assert {one.name for one in known if row[one.u_name] == ""} <= without[str(name)]
        assert all(float(row[one.u_name]) > 0 for one in known if row[one.u_name] != "")
        page = (results / str(name) / "report.html").read_text()
        if without[str(name)]:
            assert "spectrum" in row["uncertainty_not_stated"]
            assert "uncertainty of the reflectance spectrum is not known" in page or "BRDF is not included" in page


def test_no_result_contains_the_folder_where_it_was_made(built: tuple[Path, Path]) -> None:
    folder, results = built
    assert not [name for name, content in contents(results).items() if str(folder.parent).encode() in content]


@pytest.mark.parametrize("names", [("pp-moulding",), pytest.param(EXAMPLES, marks=pytest.mark.slow)])
def test_a_build_elsewhere_gives_the_same_bytes(
    built: tuple[Path, Path], tmp_path: Path, names: tuple[str, ...]
) -> None:
    folder, results = built
    for name in names:
        shutil.copytree(folder / name, tmp_path / "elsewhere" / name)
    build_catalogue(tmp_path / "elsewhere", tmp_path / "made", cores=1)
    before, after = contents(results), contents(tmp_path / "made")
    if names != EXAMPLES:  # the catalogue is of other materials
        before, after = ({file: made[file] for file in made if file.split("/")[0] in names} for made in (before, after))
    assert len(after) > 15
    assert after == before


@pytest.mark.slow
def test_every_route_gives_the_same_bytes_in_another_place_time_zone_and_locale_for_another_user(
    tmp_path: Path,
) -> None:
    """A rig included, whose frames carry times; on one core, so that the jobs run in another order."""
    for place in ("here", "elsewhere with spaces"):
        write_varied(tmp_path / place / "catalogue", len(ROUTES))
    environments = {
        "here": {"TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "1"},
        "elsewhere with spaces": {
            **{"TZ": "Asia/Kathmandu", "LC_ALL": "de_DE.UTF-8", "PYTHONHASHSEED": "2"},
            **dict.fromkeys(("USER", "LOGNAME", "USERNAME"), "somebody-else"),
        },
    }
    made = []
    for (place, environment), cores in zip(environments.items(), ("2", "1"), strict=True):
        folder = tmp_path / place
        options = ("--scene", "gloss-sheet", "--cores", cores)
        process = start_build(PROJECT, folder / "catalogue", folder / "results", *options, environment=environment)
        output, _ = process.communicate()
        assert process.returncode == 0, output
        made.append(contents(folder / "results"))
    first, second = made
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
    assert any(name.endswith(".fits") for name in first)


def test_an_edit_changes_the_digests_of_that_material_alone(built: tuple[Path, Path], tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text(COARSE)
    catalogue, results = tmp_path / "catalogue", tmp_path / "results"
    for name in ("paint-lab", "the-same-paint"):
        shutil.copytree(built[0] / "paint-lab", catalogue / name)
    build_catalogue(catalogue, results, cores=2, config=settings)
    before = lock(results)
    description = catalogue / "paint-lab" / "material.yaml"
    description.write_text(description.read_text().replace("48.0", "52.0"))
    assert build_catalogue(catalogue, results, cores=2, config=settings).built == ("paint-lab",)
    after = lock(results)
    assert {name for name in before if before[name] != after[name]} == {"paint-lab"}


def test_a_scene_computes_its_part_beside_the_default_one(built: tuple[Path, Path], results: Path) -> None:
    folder, undamaged = built
    summary = build_catalogue(folder, results, cores=2, scene="gloss-sheet")
    assert summary.failures == {}
    place = results / "scenes" / "gloss-sheet"
    planned = {path.parent.name for path in place.glob("*/planned.nc")}
    assert planned == {"abs-grain", "pp-moulding"}
    # BSDF without uncertainties, gloss and row of each, a plan where there is a choice, and the catalogue.
    assert summary.jobs == 3 * len(EXAMPLES) + len(planned) + 1
    table = pd.read_csv(place / "catalogue.csv", index_col="material")
    for name in EXAMPLES:
        gloss, whole = (store.open_dataset(path / name / "appearance.nc") for path in (place, results))
        # The catalogue has the fullest model; a planned one errs by less than the scene accepts.
        accepted = load_scene("gloss-sheet").content["tolerance"] if name in planned else 0.0
        assert float(abs(gloss["gloss"] - whole["gloss"]).max()) <= accepted
        assert not {"lab", "srgb", "luminous_reflectance"} & set(gloss.variables)
        assert "gloss_u_source" not in gloss
        if name in planned:
            assert table.loc[name, "gloss_60"] == pytest.approx(float(gloss["gloss"].sel(gloss_angle=60)), rel=1e-5)
    page = (place / "index.html").read_text()
    assert '<a href="../../index.html">catalogue</a>' in page
    assert "report.html" not in page
    before, after = contents(undamaged), contents(results)
    assert {name: after[name] for name in before} == before


def test_damaged_results_are_computed_again_to_the_same_bytes(built: tuple[Path, Path], results: Path) -> None:
    folder, undamaged = built
    for name, size in (("bsdf.nc", 5000), ("summary.nc", 0)):
        os.truncate(results / "paint-lab" / name, size)
    summary = build_catalogue(folder, results, cores=2)
    assert summary.failures == {}
    assert summary.notices == (
        "2 results changed since the build wrote them, and made anew: paint-lab/bsdf.nc, paint-lab/summary.nc",
    )
    assert contents(results) == contents(undamaged)
    assert set(summary.verdicts) == set(EXAMPLES)  # of those that were not built, too


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(("place", "set_up"), [("here", False), ("elsewhere", True), (None, True)])
def test_an_environment_of_another_folder_is_set_up_again(tmp_path: Path, place: str | None, set_up: bool) -> None:
    for file in ("Makefile", "pyproject.toml", *(path.name for path in PROJECT.glob("requirements*.lock"))):
        shutil.copy(PROJECT / file, tmp_path)
    stamps = [tmp_path / ".venv" / name for name in ("bin/python", ".runtime", ".dev")]
    for stamp in stamps:
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.touch()
    if place:
        (tmp_path / ".venv" / ".place").write_text(f"{tmp_path.resolve() if place == 'here' else '/elsewhere'}\n")
    done = subprocess.run(["make", "-n", "catalogue", "lint"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ("venv --clear" in done.stdout) == set_up
    assert ("requirements-dev.lock" in done.stdout) == set_up


def test_a_stage_runs_as_a_plain_program(built: tuple[Path, Path], tmp_path: Path) -> None:
    _, results = built
    script = installation.project_folder() / "workflow" / "scripts" / "facets.py"
    command = [sys.executable, script, "--material", "abs-grain", "--input", "surface=abs-grain/surface.nc"]
    subprocess.run([*command, "--output", f"facets={tmp_path / 'facets.nc'}"], cwd=results, check=True)
    assert (tmp_path / "facets.nc").read_bytes() == (results / "abs-grain" / "facets.nc").read_bytes()


def test_a_stage_run_by_hand_refuses_in_one_line(built: tuple[Path, Path], tmp_path: Path) -> None:
    script = installation.project_folder() / "workflow" / "scripts" / "facets.py"
    command = [sys.executable, script, "--material", "m", "--input", "surface=none.nc", "--output", "facets=f.nc"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "m: none.nc: no such dataset; run `brdfpipe build` to build it\n"


def test_snakemake_runs_the_workflow_without_the_command_line(built: tuple[Path, Path]) -> None:
    folder, results = built
    root = installation.project_folder()
    command = [sys.executable, "-m", "snakemake", "--snakefile", root / "Snakefile", "--directory", results]
    command += ["--workflow-profile", root / "workflow" / "profiles" / "default", "--cores", "1", "--dry-run"]
    done = subprocess.run([*command, "--config", f"catalogue={folder}"], capture_output=True, text=True, check=False)
    assert "Nothing to be done" in done.stdout + done.stderr


def test_the_scripts_only_read_call_and_write() -> None:
    for path in (PROJECT / "workflow" / "scripts").glob("*.py"):
        body = path.read_text().partition("def main")[2].partition("\n\n\n")[0]
        assert len(body.splitlines()) <= 18, path.name  # fifteen lines and what the formatter unfolds


@pytest.mark.parametrize(
    ("name", "deleted"),
    [
        ("abs-grain", ("report.html", "exports/abs-grain.lambert_gauss.csv")),
        ("paint-lab", ("exports/paint-lab.total_reflectance.csv", "exports/paint-lab.astm.json")),
        ("paint-lab", ("exports/paint-lab.astm", "lambert_gauss.nc")),
    ],
)
def test_every_deleted_file_is_made_again_as_it_was(
    built: tuple[Path, Path], results: Path, name: str, deleted: tuple[str, ...]
) -> None:
    """One file of each stage at a time: a stage with two files notices either."""
    folder, undamaged = built
    for file in deleted:
        (results / name / file).unlink()
    summary = build_catalogue(folder, results, cores=2)
    assert summary.built == (name,)
    assert contents(results) == contents(undamaged)


def test_predictions_from_a_scan_are_checked_unless_the_description_says_none(
    built: tuple[Path, Path], tmp_path: Path
) -> None:
    checked = sorted(path.parent.name for path in built[1].glob("*/model_error.nc"))
    assert checked == ["abs-grain", "pp-moulding"]
    assert "Prediction against reference solutions" in (built[1] / "abs-grain" / "report.html").read_text(
        encoding="utf-8"
    )


def test_a_reference_solution_replaces_the_prediction(tmp_path: Path) -> None:
    height = samples.gaussian_surface(96, correlation=10)["height"].values
    for name, truth in (("used", "use"), ("unchecked", "none")):
        folder = tmp_path / "catalogue" / name
        folder.mkdir(parents=True)
        np.save(folder / "a.npy", height / height.std() * 0.05)
        (folder / "material.yaml").write_text(
            f"surface: {{file: a.npy, unit: um, pitch: 0.5}}\nindex: PP\nmodel: {{truth: {truth}, optics: auto}}\n"
        )
    settings = tmp_path / "settings.yaml"
    settings.write_text(COARSE)
    summary = build_catalogue(tmp_path / "catalogue", tmp_path / "results", cores=2, config=settings)
    assert summary.failures == {}
    made = {name: {path.stem for path in (tmp_path / "results" / name).glob("*.nc")} for name in ("used", "unchecked")}
    assert made["used"] - made["unchecked"] == {"reference"}
    assert made["unchecked"] - made["used"] == {"visibility", "interreflection", "predicted", "wave", "uncertainty"}
    bsdf = store.open_dataset(tmp_path / "results" / "used" / "bsdf.nc")
    assert bsdf.attrs["representation"] == "kirchhoff"
    assert "diffraction on the map" in bsdf.attrs["history"]


@pytest.mark.slow
def test_scans_of_three_magnifications_and_a_repeat_reach_the_spectrum_and_the_page(tmp_path: Path) -> None:
    rng, folder, model = np.random.default_rng(5), tmp_path / "catalogue" / "polished", KCorrelation(0.05, 5.0, 3.5)
    folder.mkdir(parents=True)
    for name, pitch in (("interferometer", 0.2), ("microscope", 2.0), ("afm", 0.01)):
        np.save(folder / f"{name}.npy", heights(model.areal, (256, 256), (pitch, pitch), round(10 * pitch)))
    clean = np.load(folder / "interferometer.npy")
    for name in ("interferometer", "again"):
        np.save(folder / f"{name}.npy", clean + rng.normal(scale=0.001, size=clean.shape))
    (folder / "material.yaml").write_text(
        "surface:\n  {file: interferometer.npy, unit: um, pitch: 0.2, scans: [{file: again.npy, repeat: true}, "
        "{file: microscope.npy, pitch: 2.0}, {file: afm.npy, pitch: 0.01}]}\nindex: PP\nmodel: {optics: auto}\n"
    )
    settings = tmp_path / "settings.yaml"
    settings.write_text(COARSE)
    summary = build_catalogue(tmp_path / "catalogue", tmp_path / "results", cores=2, config=settings)
    assert summary.failures == {}
    results = tmp_path / "results" / "polished"
    spectrum, facets = (store.open_dataset(results / f"{name}.nc") for name in ("psd", "facets"))
    assert spectrum["scan_band_high"].values == pytest.approx([2.5, 0.25, 50], rel=0.1)
    assert float(facets["noise_sigma"]) == pytest.approx(0.001, rel=0.05)
    assert float(facets["facet_count"]) == 4 * 255**2
    assert "Band of scan 3" in (results / "report.html").read_text(encoding="utf-8")


def test_several_scans_filters_and_directions_reach_the_facets(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    lines = tmp_path / "catalogue" / "lines"
    lines.mkdir(parents=True)
    for name, sigma in (("along.txt", 0.1), ("across.txt", 0.04)):
        np.savetxt(lines / name, np.cumsum(rng.normal(scale=sigma, size=5000)), header="unit: um")
    (lines / "material.yaml").write_text(
        "surface: {file: along.txt, layout: line, pitch: 1.0, scans: [{file: across.txt, azimuth: 90}]}\nindex: PP\n"
        "model: {optics: facets, truth: none}\nexports: []\n"
    )
    maps = tmp_path / "catalogue" / "maps"
    maps.mkdir()
    for name, seed in (("a.npy", 1), ("b.npy", 2)):
        np.save(maps / name, samples.gaussian_surface(128, seed=seed, correlation=4)["height"].values)
    shared = "file: a.npy, unit: um, pitch: 1.0"
    (maps / "material.yaml").write_text(
        f"surface: {{{shared}, lambda_s: 5.0, scans: [{{file: b.npy}}]}}\nindex: PP\n"
        "model: {optics: facets, truth: none}\nexports: []\n"
    )
    settings = tmp_path / "settings.yaml"
    settings.write_text(COARSE)
    summary = build_catalogue(tmp_path / "catalogue", tmp_path / "results", cores=2, config=settings)
    assert summary.failures == {}
    of_lines, of_maps = (store.open_dataset(tmp_path / "results" / name / "facets.nc") for name in ("lines", "maps"))
    assert float(of_lines["anisotropy"]) == pytest.approx(2.5, rel=0.05)
    assert float(of_maps["facet_count"]) == 2 * 4 * 127**2
    for number in ("surface", "surface-2"):
        filtered = store.open_dataset(tmp_path / "results" / "maps" / f"{number}.nc")
        assert filtered.attrs["lambda_s"] == 5.0
    assert build_catalogue(tmp_path / "catalogue", tmp_path / "results", cores=2, config=settings).jobs == 0

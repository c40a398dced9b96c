"""Materials of every kind of finish through the real workflow: polished, with a lay, metal, clear sheets, the patent's choices."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import samples
import xarray as xr
from sheet_tracer import CoatTracer, Traced

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.tabulation import grid_for
from brdfpipe.jobs.build import build as build_catalogue

COLOUR = "spectrum: {lab: [50, 10, 10], illuminant: D65, observer: 10, geometry: sci}\n"
MATERIALS = {
    "brushed": "surface: {file: h.npy, unit: um, pitch: 1}\nindex: ABS\nspectrum: {file: r.txt, geometry: sci, scale: fraction}\n"
    "model: {truth: none, optics: OPTICS}\n",
    "compensated": "surface: {distribution: beckmann, slope_rms: 0.6}\nindex: ABS\nmodel: {multiple_scattering: compensated}\n",
    "film": "surface: {file: h.npy, unit: um, pitch: 1, isotropic: true}\nindex: PET\nspectrum: {file: r.txt, geometry: sci, scale: fraction}\n"
    "coat: {thickness: 0.1, absorption: {file: a.txt}, base: {index: ABS, surface: {distribution: beckmann, slope_rms: 0.2}}}\n",
    "frosted": "surface: {distribution: flat}\nindex: 1.49\n"
    "slab: {thickness: 2, absorption: {file: a.txt}, back: {distribution: beckmann, slope_rms: 0.2}}\n",
    "lacquer": "surface: {distribution: beckmann, slope_rms: 0.3}\nindex: 1.5\nindex_uncertainty: 0.01\n"
    "coat: {thickness: 0.04, internal_transmittance: 0.9, base: {index: 1.8}}\n"
    "spectrum: {file: r.txt, geometry: sci, scale: fraction, reflectance_uncertainty: 0.003}\n",
    "patent": "surface: {distribution: beckmann, slope_rms: 0.6}\nindex: ABS\nmodel: {recipe: crf}\n" + COLOUR,
    "polished": "surface: {distribution: flat}\nindex: 1.5\n",
    "satin": "surface: {distribution: measured-gloss}\nindex: 1.5\nmeasured: {gloss: {20: 44, 60: 79, 85: 84}}\n"
    + COLOUR,
    "steel": "surface: {distribution: ggx, a: 0.15}\nindex: {n: 2.9, k: 3.1}\n",
}


EXPORTED = ("frosted", "polished")
"""Materials whose files for other programs the fast tests read; the choice of a grid takes a third of a build."""

PHOTONS = 100_000


def lacquer_tracer() -> CoatTracer:
    """Photons in the lacquer, whose base sends back 0.6 of the light that enters it."""
    return CoatTracer(coat=0.3, base=0.0, coat_index=1.5, index=1.8, inside=0.9, reflectance=0.6, seed=3)


GRID = {"theta_i": [0, 45], "theta_o": [0, 30, 60], "phi_o": [0, 90, 180], "phi_i": [0, 180, 360]}


@pytest.fixture(scope="module")
def results(made_once: Callable[[str, Callable[[Path], None]], Path], request: pytest.FixtureRequest) -> Path:
    slow = request.config.getoption("--slow")
    return made_once("finishes", lambda base: build_finishes(base, slow)) / "results"


def build_finishes(base: Path, slow: bool) -> None:
    """With pictures, files of all materials, and waves of the lay, in the slow tests alone."""
    for name, text in MATERIALS.items():
        (base / "catalogue" / name).mkdir(parents=True)
        text = text.replace("OPTICS", "auto" if slow else "facets")
        text += "" if slow or name in EXPORTED else "exports: []\n"
        (base / "catalogue" / name / "material.yaml").write_text(text)
    np.save(base / "catalogue" / "brushed" / "h.npy", _brushed())
    np.save(base / "catalogue" / "film" / "h.npy", samples.gaussian_surface(160, correlation=6)["height"].values)
    _, at_8, _ = lacquer_tracer().trace(8.0, PHOTONS)
    np.save(base / "total_at_8.npy", at_8.sum() / PHOTONS)
    for file, value in (
        ("frosted/a.txt", 0.05),
        ("brushed/r.txt", 0.2),
        ("film/a.txt", 0.5),
        ("film/r.txt", 0.3),
        ("lacquer/r.txt", at_8.sum() / PHOTONS),
    ):
        rows = "".join(f"{nm} {value}\n" for nm in range(380, 741, 20))
        (base / "catalogue" / file).write_text(f"nm a\n{rows}")
    # Few fits and no reflectance haze: what is in them is not the question here.
    settings = base / "settings.yaml"
    settings.write_text(
        "exports: [astm]\n"
        "lambert_gauss: {theta_i: [0, 45]}\n"
        "appearance: {haze: []}\n"
        f"preview: {str(slow).lower()}\n"
    )
    summary = build_catalogue(base / "catalogue", base / "results", cores=2, config=settings)
    assert summary.failures == {}


def _brushed() -> np.ndarray:
    """Heights whose slopes are four times as steep along y as along x: the lay runs along x."""
    rough = samples.gaussian_surface(160, correlation=6)["height"].values
    spectrum = np.fft.fft2(rough)
    along = np.fft.fftfreq(160) * 160
    smoothed = np.fft.ifft2(spectrum * np.exp(-((along / 8) ** 2))).real
    return smoothed * 0.2 / np.diff(smoothed, axis=0).std()


def opened(results: Path, material: str, stage: str) -> xr.Dataset:
    return store.open_dataset(results / material / f"{stage}.nc")


def test_a_finish_known_by_gloss_has_that_gloss_within_its_uncertainty(results: Path) -> None:
    facets, bsdf, readings = (opened(results, "satin", stage) for stage in ("gloss_facets", "bsdf", "readings"))
    assert facets.attrs["kind"] == "facets"
    assert float(facets["tail"]) > 0.7
    assert "facets" in bsdf["uncertainty_source"].values
    # The readings are those of a GGX of a = 0.01 but for half a unit; two unknowns fit three of them.
    assert np.abs(readings["z"]).max() < 1
    assert json.loads(readings.attrs["fitted"]) == ["gloss 20°", "gloss 60°", "gloss 85°"]
    computed = opened(results, "satin", "appearance")
    assert 0.1 < float(computed["gloss_u_source"].sel(source="facets", gloss_angle=60)) < 2
    page = (results / "satin" / "report.html").read_text()
    assert "gloss readings + spectrum" in page
    assert "known by its gloss alone" in page


def test_a_polished_material_has_the_gloss_of_its_reflectance(results: Path) -> None:
    bsdf, computed = opened(results, "polished", "bsdf"), opened(results, "polished", "appearance")
    assert bsdf.attrs["representation"] == "smooth"
    assert computed["gloss"].values == pytest.approx((82.0454, 89.1385, 98.9730), abs=5e-5)
    listed = pd.read_csv(results / "polished" / "exports" / "polished.total_reflectance.csv", comment="#")
    assert listed["specular_reflectance"].values == pytest.approx(listed["total_reflectance"].values)


def test_a_brushed_material_keeps_its_lay_to_the_last_file(results: Path) -> None:
    computed = opened(results, "brushed", "appearance")
    # An axis: 179° is 1° from 0.
    assert abs((float(computed["lay"]) + 90) % 180 - 90) < 5
    # With waves, a good part of the gloss at 85° is coherent light (g = 2.4), which has no lay.
    assert float(computed["gloss_along"][2]) > 1.3 * float(computed["gloss_across"][2])
    assert "phi_i" in grid_for(opened(results, "brushed", "bsdf"), GRID)
    fits = pd.read_csv(results / "brushed" / "exports" / "brushed.lambert_gauss.csv", comment="#")
    assert fits["phi_i_deg"].nunique() == 4


@pytest.mark.slow
def test_the_file_of_a_brushed_material_has_a_lay(results: Path) -> None:
    """Of one that no build wrote: tests/exchange/test_astm.py."""
    assert "NOT isotropic" in (results / "brushed" / "exports" / "brushed.astm").read_text()


def test_a_metal_is_opaque_and_bright(results: Path) -> None:
    computed = opened(results, "steel", "appearance")
    # F of n = 2.9, k = 3.1 at normal incidence is 0.532; masking loses a few percent of it.
    assert 0.48 < float(computed["luminous_reflectance"]) < 0.532
    assert "luminous_transmittance" not in computed


def test_what_the_facets_lose_is_given_back_where_asked_for(results: Path) -> None:
    compensated = opened(results, "compensated", "bsdf")
    assert compensated.attrs["multiple_scattering"] == "compensated"
    assert float(compensated["compensation"]) > 0


def test_the_patents_choices_are_warned_about_by_the_checks(results: Path) -> None:
    verdicts = json.loads(opened(results, "patent", "checks").attrs["verdicts"])
    assert {name for name, check in verdicts.items() if check["verdict"] == "warn"} >= {
        "reciprocity",
        "energy",
        "closure",
    }


def test_a_clear_sheet_has_two_faces_and_two_sides(results: Path) -> None:
    folder = results / "frosted"
    assert {"facets.nc", "back_facets.nc", "interior.nc", "sheet_uncertainty.nc"} <= {
        path.name for path in folder.iterdir()
    }
    assert not (folder / "back_surface.nc").exists()
    assert float(opened(results, "frosted", "interior")["internal_transmittance"][0]) == pytest.approx(np.exp(-0.1))
    computed = vocabulary.validate(opened(results, "frosted", "appearance"), "appearance")
    assert 0 < float(computed["transmission_haze"]) < 1
    exports = {path.name for path in (folder / "exports").iterdir()}
    assert {"frosted.transmission.astm", "frosted.total_transmittance.csv"} <= exports
    assert max(grid_for(opened(results, "frosted", "bsdf"), GRID)["theta_o"]) > 90


@pytest.mark.parametrize("photons", [PHOTONS, pytest.param(10 * PHOTONS, marks=pytest.mark.slow)])
def test_a_clear_coat_over_a_colour_reflects_as_photons_do(results: Path, photons: int) -> None:
    """Only the total reflectance at 8° is given; directions and the total at 50° follow, within 1 % and the noise of the photons."""
    bsdf, theta_i = opened(results, "lacquer", "bsdf"), 50.0
    assert bsdf.attrs["representation"] == "coated"
    traced = Traced(*lacquer_tracer().trace(theta_i, photons), photons)
    mean, error = traced.share(np.ones(traced.weight.size, dtype=bool))
    assert float(bsdf.bsdf.albedo(theta_i=theta_i)[0]) == pytest.approx(mean, abs=3 * error + 0.01 * mean)
    for sector, predicted, mean, error in traced.beside(bsdf, theta_i):
        assert predicted == pytest.approx(mean, abs=3 * error + 0.01 * mean), sector


@pytest.mark.parametrize("name", ["lacquer", "film"])
def test_a_coated_body_conserves_energy_and_has_its_total_reflectance(results: Path, name: str) -> None:
    verdicts = json.loads(opened(results, name, "checks").attrs["verdicts"])
    assert {check["verdict"] for check in verdicts.values()} == {"pass"}
    bsdf, spectrum = opened(results, name, "bsdf"), opened(results, name, "spectrum")
    total = spectrum["total_reflectance"].values
    assert bsdf.bsdf.albedo(theta_i=8).values.ravel() == pytest.approx(total, abs=1e-9)


def test_a_coated_body_has_a_face_an_index_and_uncertainties_of_its_own(results: Path) -> None:
    made = {path.name for path in (results / "film").iterdir()}
    assert {"surface.nc", "base_facets.nc", "base_index.nc", "interior.nc", "coated_uncertainty.nc"} <= made
    assert not {"predicted.nc", "wave.nc", "model_error.nc", "back_facets.nc"} & made
    assert float(opened(results, "film", "interior")["internal_transmittance"][0]) == pytest.approx(np.exp(-0.05))
    # 0.01 of the index is 2 % of Fresnel's reflectance, and less of the gloss: the receptor sees light of the body too.
    computed = opened(results, "lacquer", "appearance")
    of_index = computed["gloss_u_source"].sel(source="index") / computed["gloss"]
    assert 0.004 < float(of_index.sel(gloss_angle=60)) < 0.02
    page = (results / "film" / "report.html").read_text()
    assert "Light that comes back from the body" in page
    assert "face of the body below" in page


def test_only_sheets_have_files_of_transmission(results: Path) -> None:
    assert [path.parts[-3] for path in results.glob("*/exports/*.transmission.astm")] == ["frosted"]
    assert [path.parent.name for path in results.glob("*/back_facets.nc")] == ["frosted"]


def test_the_catalogue_lists_what_passes(results: Path) -> None:
    table = pd.read_csv(results / "catalogue.csv", index_col="material")
    assert table["luminous_transmittance"].notna().tolist() == [name == "frosted" for name in table.index]
    assert 0 < table.loc["frosted", "transmission_haze"] < 1

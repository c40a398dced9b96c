"""``brdfpipe show`` and ``brdfpipe plot``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from click.testing import CliRunner, Result

from brdfpipe import store
from brdfpipe.cli import summaries, terminal_plots
from brdfpipe.cli.main import main
from brdfpipe.texture.picture_texture import of_pictures

PROJECT = Path(__file__).parents[2]


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bsdf") / "bsdf.nc"
    store.save_dataset(samples.beckmann_bsdf(0.3), path, stage="bsdf", material="grain")
    return path


def test_a_bsdf_is_shown_with_its_reflectance_and_a_cut(saved: Path) -> None:
    found = run("show", saved)
    assert found.exit_code == 0, found.output
    for words in ("grain", "microfacet", "reflectance", "at 45°", "0°, 30°, 60° incidence", "⠀"):
        assert words in found.output
    listed = json.loads(run("show", saved, "--json").output)
    expected = samples.beckmann_bsdf(0.3).bsdf.albedo(45.0)
    assert next(iter(listed["reflectance"]["at 45°"].values())) == pytest.approx(float(np.ravel(expected)[0]), abs=1e-6)


def test_a_scan_and_a_spectrum_are_shown_by_the_keys_of_a_description() -> None:
    scan = run("show", PROJECT / "examples/abs-grain/grain.x3p").output
    assert "▓" in scan
    assert "extent" in scan
    reflectance = PROJECT / "examples/abs-grain/reflectance.txt"
    refused = run("show", reflectance)
    assert refused.exit_code == 2
    assert "give --as" in refused.output
    shown = run("show", reflectance, "--as", "spectrum", "--set", "geometry=sci", "--set", "scale=percent")
    assert shown.exit_code == 0, shown.output
    assert "wavelength [nm]" in shown.output


def test_the_results_of_a_folder_without_a_build_are_refused(tmp_path: Path) -> None:
    found = run("show", tmp_path)
    assert found.exit_code == 2
    assert "no results of a build" in found.output


def test_the_results_of_a_scene_are_shown_from_its_folder_and_named_from_others(saved: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scenes" / "near"
    for folder in (tmp_path / "grain", scene / "grain"):
        folder.mkdir(parents=True)
    (tmp_path / "grain" / "bsdf.nc").write_bytes(saved.read_bytes())
    row = xr.Dataset({"verdict": ("material", ["pass"])}, {"material": ["grain"]})
    for path in (scene / "catalogue.nc", scene / "grain" / "summary.nc"):
        row.to_netcdf(path)
    assert summaries.bsdf_of(scene / "grain") == tmp_path / "grain" / "bsdf.nc"
    assert f"accepted: the results of a scene: {scene}" in run("show", tmp_path).output
    assert "those of the material in a scene" in run("show", tmp_path / "grain").output


def test_a_texture_is_shown_with_its_sparkles_and_a_tile(tmp_path: Path) -> None:
    light = np.random.default_rng(1).random((80, 80))
    texture = of_pictures({"45as15": light, "diffuse": light + 1}, pixel=20.0, size=64)
    store.save_dataset(texture, tmp_path / "t.nc", stage="picture_texture", material="paint")
    shown = run("show", tmp_path / "t.nc").output
    assert "sparkle_density [mm-2]" in shown
    assert "relative light of the tile at 45as15" in shown
    listed = json.loads(run("show", tmp_path / "t.nc", "--json").output)
    assert listed["theta_f [degree]"].keys() == {"45as15"}


def test_a_figure_is_written(saved: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = run("plot", saved, tmp_path / "grain.svg", "--kind", "cartesian", "--theta-i", "20,50")
    assert found.exit_code == 0, found.output
    assert "50°" in (tmp_path / "grain.svg").read_text() or (tmp_path / "grain.svg").stat().st_size > 5000
    assert run("plot", saved, tmp_path / "grain.bmp").exit_code == 2
    several = run("plot", saved, tmp_path / "map.png", "--kind", "map", "--theta-i", "20,50")
    assert several.exit_code == 2
    assert "one angle of incidence" in several.output


def test_a_curve_of_text_rises_where_the_values_do() -> None:
    lines = terminal_plots.curves(np.linspace(0, 1, 50), [np.linspace(0, 1, 50)], "x [1]", "y [1]")
    first, last = lines[1].split("┤")[1], lines[10].split("┤")[1]
    assert first.strip("⠀")
    assert first.startswith("⠀")
    assert not last.startswith("⠀")
    assert last.endswith("⠀")
    logarithmic = terminal_plots.curves(np.arange(3.0), [np.array([1.0, 0.0, 1e3])], "x", "y", log=True)
    assert "1e+03" in logarithmic[1]
    assert terminal_plots.curves(np.arange(3.0), [np.full(3, np.nan)], "x", "y") == ["y: no value to show"]


def test_a_relief_shows_missing_heights() -> None:
    heights = np.add.outer(np.zeros(8), np.arange(8.0))
    heights[:, 0] = np.nan
    assert terminal_plots.relief(heights)[0] == "?  ░▒▓██"
    assert terminal_plots.relief(np.full((3, 4), np.nan)) == ["no height to show"]


def test_values_by_name_have_no_curve() -> None:
    named = xr.Dataset({"share": ("sample", [1.0, 2.0, 3.0])}, {"sample": ["a", "b", "c"]})
    assert summaries.plot(named) == []
    assert len(summaries.plot(named.assign_coords(sample=[1.0, 2.0, 4.0]))) > 10


@pytest.mark.parametrize("reverse", [False, True])
def test_a_peak_between_two_columns_is_drawn_to_its_top(reverse: bool) -> None:
    x, y = np.array([0.0, 40.001, 40.002, 40.003, 90.0]), np.array([1.0, 1.0, 1e4, 1.0, 1.0])
    order = slice(None, None, -1 if reverse else 1)
    lines = terminal_plots.curves(x[order], [y[order]], "x", "y", log=True)
    rows = [line.split("┤")[1] for line in lines[1:11]]
    (column,) = [place for place, mark in enumerate(rows[0]) if mark != "⠀"]
    assert column == pytest.approx(40 / 90 * 60, abs=1)
    assert all(row[column] != "⠀" for row in rows)


def test_a_glossy_lobe_has_its_height() -> None:
    bsdf = samples.beckmann_bsdf(0.002)
    peaks = [float(bsdf.bsdf.evaluate(angle, 180, angle, 0).max()) for angle in (0.0, 30.0, 60.0)]
    top = float(summaries.plot(bsdf)[1].split("┤")[0])
    assert top == pytest.approx(max(peaks), rel=0.02)


def test_the_azimuth_of_a_lay_is_shown_as_on_the_page() -> None:
    facets = xr.Dataset({"lay": ((), -89.3, {"units": "degree"})}, attrs={"kind": "facets"})
    assert summaries.of_dataset(facets)["lay"]["value"] == pytest.approx(90.7)


def test_a_small_value_with_a_unit_stays_what_it_is() -> None:
    assert summaries._number(2e-12, 1e-13, " um4") == "2e-12 ± 1e-13"


@pytest.mark.parametrize(
    ("value", "u", "shown"),
    [
        (0.557353, 0.0331, "0.557 ± 0.033"),
        (7.27743, 0.26, "7.28 ± 0.26"),
        (123.456, 12.3, "123 ± 12"),
        (1234.5, 123.0, "1234.5 ± 1.2e+02"),
        (0.5, None, "0.5"),
        (2.8e-14, 7.9e-14, "0"),
        (0.0, 0.2, "0.00 ± 0.20"),
        (0.5, float("nan"), "0.5"),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves(value: float, u: float | None, shown: str) -> None:
    assert summaries._number(value, u) == shown

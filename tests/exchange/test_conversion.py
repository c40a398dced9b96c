"""From the files of one program to those of another."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe import store
from brdfpipe.comparison.bsdf_difference import difference
from brdfpipe.errors import InputError, VocabularyError
from brdfpipe.exchange.conversion import at_given_wavelengths, convert, open_bsdf
from brdfpipe.exchange.registry import ExchangeError


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bsdf") / "bsdf.nc"
    store.save_dataset(samples.beckmann_bsdf(0.3), path, stage="bsdf", material="grain")
    return path


def test_a_chain_of_formats_keeps_the_bsdf_within_the_sum_of_stated_errors(saved: Path, tmp_path: Path) -> None:
    first, second, third = tmp_path / "a.zemax.bsdf", tmp_path / "b.ddr", tmp_path / "c.nc"
    convert(open_bsdf(saved), first, tolerance=0.02)
    convert(open_bsdf(first), second, tolerance=0.02)
    convert(open_bsdf(second), third, inputs={second.name: second})
    errors = [json.loads(Path(f"{path}.json").read_text())["error"]["percentile_95"] for path in (first, second)]
    found = difference(open_bsdf(saved), open_bsdf(third))
    assert 0 < found.percentile_95 < 1.2 * sum(errors)
    assert found.albedo[1] == pytest.approx(found.albedo[0], rel=0.005)


def test_netcdf_names_the_file_it_comes_from(saved: Path, tmp_path: Path) -> None:
    table = tmp_path / "a.zemax.bsdf"
    convert(open_bsdf(saved), table, tolerance=0.05)
    convert(open_bsdf(table), tmp_path / "a.nc", inputs={table.name: table})
    inputs = json.loads(store.open_dataset(tmp_path / "a.nc", "bsdf").attrs["inputs"])
    assert store.file_digest(table) in str(inputs)


@pytest.mark.parametrize("wavelengths", [[450.0, 555.5, 650.0], [550.0]])
def test_a_bsdf_at_given_wavelengths_is_the_bsdf_there(wavelengths: list[float]) -> None:
    coloured = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, 85))
    few = at_given_wavelengths(coloured, wavelengths)
    at = 40.0, 0.0, [10.0, 60.0], 170.0
    assert few.bsdf.evaluate(*at).values == pytest.approx(coloured.bsdf.evaluate(*at, wavelengths).values, rel=1e-12)


def test_files_with_a_spectrum_have_the_given_wavelengths(tmp_path: Path) -> None:
    coloured = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, 85))
    for name in ("a.ddr", "a.spectral.bsdf", "a.brdf", "a.astm"):
        convert(coloured, tmp_path / name, wavelengths=[450, 550, 650], tolerance=0.1, albedo_tolerance=0.05)
        assert open_bsdf(tmp_path / name)["wavelength"].values == pytest.approx([450, 550, 650])


@pytest.mark.parametrize(
    ("name", "options", "lost"),
    [
        ("a.ddr", {"wavelengths": [450, 550, 650]}, None),
        ("a.ddr", {"colour": "rgb"}, "linear sRGB (IEC 61966-2-1) under D65"),
        ("a.ddr", {}, "weighted with V(lambda) and D65"),
        ("a.zemax.bsdf", {"colour": True}, "X, Y and Z under D65"),
        ("a.mbsdf", {}, "linear sRGB (IEC 61966-2-1) under D65"),
        ("a.samples.csv", {"wavelengths": [450, 550, 650], "incidences": 4, "views": 60}, None),
    ],
)
def test_what_is_left_of_the_spectrum_is_said(tmp_path: Path, name: str, options: dict, lost: str | None) -> None:
    """Three wavelengths are a spectrum, and three values of a colour are not."""
    coloured = samples.beckmann_bsdf(0.4, reflectance=np.linspace(0.05, 0.6, 85))
    coarse = {} if name.endswith(".csv") else {"tolerance": 0.2, "albedo_tolerance": 0.05}
    record = convert(coloured, tmp_path / name, **coarse, **options)
    assert record["left_out"].get("spectrum") == (None if lost is None else f"the spectrum: the values are {lost}")


@pytest.mark.parametrize(
    ("name", "wavelengths", "words"),
    [
        ("a.zemax.bsdf", [450, 550], "zemax: the format has no wavelengths; accepted: .*integra"),
        ("a.ddr", [550, 450], "accepted: increasing ones from 360 to 780 nm"),
        ("a.ddr", [200, 450], "accepted: increasing ones from 360 to 780 nm"),
        ("a.ddr", [float("nan")], "accepted: increasing ones from 360 to 780 nm"),
    ],
)
def test_wavelengths_that_cannot_be_written_are_refused(
    tmp_path: Path, name: str, wavelengths: list[float], words: str
) -> None:
    with pytest.raises(ExchangeError, match=words):
        convert(samples.beckmann_bsdf(0.3), tmp_path / name, wavelengths=wavelengths)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("a.nc", {"tolerance": 0.1}, "netCDF has no option 'tolerance'"),
        ("a.xyz", {}, "no format has files that end with '.xyz'; accepted: an ending such as .zemax.bsdf"),
        ("a.zemax.bsdf", {"tolerance": -1.0}, "tolerance is -1.0"),
    ],
)
def test_what_cannot_be_written_is_refused(saved: Path, tmp_path: Path, name: str, options: dict, words: str) -> None:
    with pytest.raises(ExchangeError, match=words):
        convert(open_bsdf(saved), tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_a_netcdf_file_takes_no_other_format(saved: Path) -> None:
    with pytest.raises(InputError, match="states its own format"):
        open_bsdf(saved, "zemax")


def test_a_netcdf_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "spectrum.nc"
    store.save_dataset(samples.spectrum(0.3), path, stage="spectrum", material="grain")
    with pytest.raises(VocabularyError, match=r"expected a dataset of kind .bsdf., found kind .spectrum."):
        open_bsdf(path)

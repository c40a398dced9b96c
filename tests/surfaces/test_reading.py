"""Which reader reads what, and the stage of the workflow."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from brdfpipe.catalogue.material_keys import MeasuredSurface
from brdfpipe.descriptions.reading import declared
from brdfpipe.errors import InputError
from brdfpipe.store import open_dataset, save_dataset
from brdfpipe.surfaces import high_pass, ingest, level, low_pass, read_surface, write_x3p
from brdfpipe.surfaces.levelling import FORMS
from brdfpipe.surfaces.reading import FORMATS


@pytest.fixture
def profile(tmp_path: Path, line: xr.Dataset) -> Path:
    path = tmp_path / "profile.txt"
    path.write_text("\n".join(map(str, line.height.values)))
    return path


def test_the_stage_reads_and_levels_as_the_material_says(profile: Path) -> None:
    spec = {"file": "profile.txt", "unit": "um", "pitch": 0.25}
    assert ingest(profile, spec).attrs["levelling"] == "plane"
    assert ingest(profile, {**spec, "form": "none"}).attrs["levelling"] == "none"


def test_the_stage_result_survives_the_store(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    surface = ingest(tmp_path / "map.x3p", {"file": "map.x3p"})
    save_dataset(surface, tmp_path / "surface.nc", stage="surface", material="m")
    np.testing.assert_array_equal(open_dataset(tmp_path / "surface.nc", "surface").height, surface.height)


def test_the_band_is_stated_in_words(tmp_path: Path, profile: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    assert read_surface(tmp_path / "map.x3p").attrs["band"] == "0.5 x 0.7 um pitch; no λs, no λc filter"
    assert read_surface(profile, unit="um", pitch=0.25).attrs["band"] == "0.25 um pitch; no λs, no λc filter"


def test_an_unknown_form_names_its_key(profile: Path) -> None:
    with pytest.raises(InputError, match=r"form 'sphere'; accepted: plane, polynomial-2.*`surface\.form`"):
        ingest(profile, {"unit": "um", "pitch": 0.25, "form": "sphere"})


def test_the_stage_levels_then_filters_as_the_material_says(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    surface = ingest(tmp_path / "map.x3p", {"form": "polynomial-2", "lambda_s": 3.0, "lambda_c": 12.0})
    expected = high_pass(low_pass(level(read_surface(tmp_path / "map.x3p"), "polynomial-2"), 3.0), 12.0)
    xr.testing.assert_identical(surface, expected)
    assert surface.attrs["band"] == "0.5 x 0.7 um pitch; λs 3 um, λc 12 um filter"
    assert [line.split()[0] for line in surface.attrs["history"].splitlines()] == ["Levelled", "Low-pass", "High-pass"]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"lambda_s": 1.0}, r"λs of 1 um is out of range.*`surface\.lambda_s`"),
        ({"lambda_c": 1e3}, r"λc of 1000 um is out of range.*`surface\.lambda_c`"),
        ({"lambda_s": 9.0, "lambda_c": 9.0}, r"not above λs, 9 um.*`surface\.lambda_c`"),
    ],
)
def test_an_impossible_cutoff_names_its_key(
    tmp_path: Path, asymmetric: xr.Dataset, spec: dict[str, float], message: str
) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    with pytest.raises(InputError, match=r"^map\.x3p: .*" + message):
        ingest(tmp_path / "map.x3p", spec)


def test_the_keys_of_a_material_know_the_formats_the_forms_and_every_option() -> None:
    assert set(declared(MeasuredSurface, ["format"]).choices) == set(FORMATS)
    assert set(declared(MeasuredSurface, ["form"]).choices) == set(FORMS)
    options = {option for known in FORMATS.values() for option in known.options}
    reading = {"file", "format", "missing", "region", "mask", "outliers", "form", "lambda_s", "lambda_c"} | options
    assert set(MeasuredSurface.declared_keys()) == reading | {
        "isotropic",
        "method",
        "azimuth",
        "scans",
        "noise",
        "noise_uncertainty",
    }


def test_each_extension_selects_one_format() -> None:
    suffixes = [suffix for known in FORMATS.values() for suffix in known.extensions]
    assert len(set(suffixes)) == len(suffixes)
    assert all(re.fullmatch(r"\.[a-z0-9]+", suffix) for suffix in suffixes)


def test_the_extension_is_read_in_either_case(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "MAP.X3P")
    assert read_surface(tmp_path / "MAP.X3P").height.shape == (40, 50)


@pytest.mark.parametrize("name", ["map.raw", "map", "map.x3p.bak", ".x3p"])
def test_an_unknown_extension_is_refused_with_the_known_ones(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"unknown file extension.*\.txt.*\.x3p.*`surface\.format`"):
        read_surface(tmp_path / name)


def test_an_unknown_format_is_refused(profile: Path) -> None:
    with pytest.raises(InputError, match="found 'raw'; accepted: text, hfm, x3p"):
        read_surface(profile, "raw")


def test_an_option_of_another_format_is_refused(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    write_x3p(asymmetric, tmp_path / "map.x3p")
    with pytest.raises(InputError, match=r"surface\.unit: this key does not apply"):
        read_surface(tmp_path / "map.x3p", unit="nm")


@pytest.mark.parametrize("name", ["absent.x3p", "absent.txt"])
def test_an_absent_file_is_refused_without_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"^{name}: cannot be read") as refusal:
        read_surface(tmp_path / name, **({"unit": "um"} if name.endswith("txt") else {}))
    assert str(tmp_path) not in str(refusal.value)


@pytest.mark.parametrize("name", ["folder.x3p", "folder.txt"])
def test_a_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        read_surface(tmp_path / name, **({"unit": "um"} if name.endswith("txt") else {}))

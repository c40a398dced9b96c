"""Refractive indices as users give them: numbers, names, tables."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr

from brdfpipe import optics
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.store import save_dataset
from brdfpipe.vocabulary import validate


def test_a_number_is_an_index_at_every_wavelength() -> None:
    index = optics.refractive_index(1.52)
    n, k = optics.interpolate_index(index, [300, 550, 1000])
    assert (n == 1.52).all()
    assert (k == 0).all()
    assert index.attrs["source"] == "constant from material.yaml"


@pytest.mark.parametrize(("name", "n"), [("ABS", 1.55), ("pc/abs", 1.59), (" Pp ", 1.49), ("PC / ABS", 1.59)])
def test_the_patents_plastics_are_known_in_any_case(name: str, n: float) -> None:
    index = optics.refractive_index(name)
    assert (index["n"] == n).all()
    assert "US 9,395,299" in index.attrs["source"]


def test_an_unknown_name_is_refused_with_the_names_known_and_the_nearest() -> None:
    with pytest.raises(InputError, match=r"nearest is PMMA.*'PMM'.*ABS, PC/ABS, PP, PMMA.*`index`"):
        optics.refractive_index("PMM")


@pytest.mark.parametrize(
    "spec", [0.99, 5.0, float("nan"), float("inf"), True, None, [1.5], {"files": "x.txt"}, {"file": 3}]
)
def test_other_descriptions_of_an_index_are_refused(spec: object) -> None:
    with pytest.raises(InputError, match="`index`"):
        optics.refractive_index(spec)  # type: ignore[arg-type]


def test_an_index_dataset_passes_through() -> None:
    index = optics.refractive_index("ABS")
    assert optics.refractive_index(index) is index


def write(folder: Path, text: str, name: str = "n.txt") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_table_of_wavelength_n_and_k_is_read_and_interpolated(tmp_path: Path) -> None:
    path = write(tmp_path, "wavelength (nm)\tn\tk\n400\t1.60\t0.01\n550\t1.58\t0\n700\t1.57\t0.02\n")
    index = validate(optics.refractive_index({"file": "n.txt"}, path), "index")
    n, k = optics.interpolate_index(index, [475.0, 700.0])
    assert n == pytest.approx([1.59, 1.57])
    assert k == pytest.approx([0.005, 0.02])
    assert index.attrs["source"] == "table n.txt"


@pytest.mark.parametrize("header", ["", "Wavelength (µm), n\n"])
def test_a_table_in_micrometres_is_recognised_by_its_header_or_its_values(tmp_path: Path, header: str) -> None:
    index = optics.refractive_index(write(tmp_path, f"{header}0.4,1.6\n0.5,1.59\n0.6,1.58\n0.71,1.57\n"))
    assert index["wavelength"].values.tolist() == [400.0, 500.0, 600.0, 710.0]
    assert "converted from µm to nm" in index.attrs["history"]


def test_a_table_is_not_extrapolated(tmp_path: Path) -> None:
    index = optics.refractive_index(write(tmp_path, "400 1.6\n550 1.58\n700 1.57\n"))
    with pytest.raises(BrdfpipeError, match="known from 400 to 700 nm; asked for 360 to 500 nm"):
        optics.interpolate_index(index, [360, 500])


def test_a_table_that_leaves_out_visible_wavelengths_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"400–436\.8 nm missing"):
        optics.refractive_index(write(tmp_path, "436.8 1.6\n550 1.58\n700 1.57\n"))


@pytest.mark.parametrize("row", ["550 0.9", "550 5.1", "550 -1.5"])
def test_a_table_with_an_index_out_of_range_names_the_wavelength(tmp_path: Path, row: str) -> None:
    with pytest.raises(InputError, match="550 nm: refractive index out of range"):
        optics.refractive_index(write(tmp_path, f"400 1.6\n{row}\n700 1.57\n"))


def test_a_metal_may_have_an_index_below_one(tmp_path: Path) -> None:
    index = optics.refractive_index(write(tmp_path, "400 0.6 4.7\n550 0.9 6.6\n700 1.8 8.3\n"))
    assert optics.fresnel(1.0, *optics.interpolate_index(index, 550)).mean == pytest.approx(
        ((0.9 - 1) ** 2 + 6.6**2) / ((0.9 + 1) ** 2 + 6.6**2)
    )


def test_a_table_of_another_format_is_refused_with_those_read(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"n\.json: unknown extension of an index file; found \.json; accepted: .*\.txt.*\.yml"
    ):
        optics.refractive_index(write(tmp_path, "400 1.6\n", "n.json"))


def test_an_index_is_stored_and_read_back(tmp_path: Path) -> None:
    stored = save_dataset(optics.refractive_index("PP"), tmp_path / "index.nc", stage="index", material="m")
    with xr.open_dataset(tmp_path / "index.nc") as read:
        xr.testing.assert_identical(read.load(), stored)


def test_a_metal_is_a_pair_of_numbers():
    index = optics.refractive_index({"n": 0.18, "k": 3.42})
    assert index["n"].values.tolist() == [0.18, 0.18]
    assert index["k"].values.tolist() == [3.42, 3.42]
    assert index.attrs["dispersion"] == "constant"


@pytest.mark.parametrize(
    "pair", [{"n": 0.5, "k": 0}, {"n": 1.5, "k": -1}, {"n": 6, "k": 1}, {"n": "1.5", "k": 1}, {"n": 1, "k": True}]
)
def test_an_invalid_pair_of_n_and_k_is_refused(pair):
    with pytest.raises(InputError, match="0 < n < 5 and 0 < k < 20 where the material absorbs"):
        optics.refractive_index(pair)

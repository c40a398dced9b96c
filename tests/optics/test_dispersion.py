"""Dispersion formulas and the files of refractiveindex.info, against printed indices and the database's own files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe import optics
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.optics import dispersion
from brdfpipe.optics.dispersion import Formula
from brdfpipe.store import save_dataset
from brdfpipe.vocabulary import validate

PAGE = """REFERENCES: 'A. Author. <a href="https://x.y"><i>Journal</i></a>'
DATA:
  - type: {kind}
    wavelength_range: 0.35 1.0
    coefficients: {numbers}
"""


def page(folder: Path, text: str) -> Path:
    path = folder / "page.yml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("formula", "wavelength", "n"),
    [
        # Malitson 1965 prints 1.45846 at the D line (587.56 nm) and 1.47012 at 404.66 nm; SCHOTT 1.51680 and 1.53024.
        (dispersion.NAMED["fused silica"].value, 587.56, 1.45846),
        (dispersion.NAMED["fused silica"].value, 404.66, 1.46962),
        (dispersion.NAMED["N-BK7"].value, 587.56, 1.51680),
        (dispersion.NAMED["N-BK7"].value, 404.66, 1.53024),
        # Closed forms by hand.
        (Formula(3, (2.25, 0.01, -2.0), 0.3, 1), 500.0, np.sqrt(2.29)),
        (
            Formula(4, (2.0, 0.5, 2.0, 0.2, 2.0, 0.1, 0.0, 0.1, 2.0, 0.03, -2.0), 0.3, 1),
            500.0,
            np.sqrt(2 + 0.125 / 0.21 + 0.1 / 0.24 + 0.12),
        ),
        (Formula(5, (1.5, 0.005, -2.0), 0.3, 1), 500.0, 1.52),
        # Rutile, ordinary ray (Devore 1951), whose formula 4 has one pole alone.
        (
            Formula(4, (5.913, 0.2441, 0, 0.0803, 1, 0, 0, 0, 1), 0.43, 1.53),
            589.3,
            np.sqrt(5.913 + 0.2441 / (0.5893**2 - 0.0803)),
        ),
    ],
)
def test_formulas_give_printed_indices(formula: Formula, wavelength: float, n: float) -> None:
    # Five printed decimals.
    assert dispersion.evaluate(formula, wavelength) == pytest.approx(n, abs=6e-5)


@pytest.mark.parametrize(
    ("name", "n"),
    [("PMMA", 1.4906), ("PC", 1.5848), ("PS", 1.5916), ("SAN", 1.5665), ("ABS", 1.55), ("PC/ABS", 1.59), ("PP", 1.49)],
)
def test_named_plastics_have_the_indices_of_the_input_sheet(name: str, n: float) -> None:
    # Four printed decimals.
    assert optics.NAMED_INDEX[name][0] == pytest.approx(n, abs=6e-5)


FILES = {
    "PMMA": ("PMMA_Sultanova.yml", 1e-12),
    "PC": ("PC_Sultanova.yml", 1e-12),
    "PS": ("PS_Sultanova.yml", 1e-12),
    "SAN": ("SAN_Sultanova.yml", 1e-12),
    "SMMA": ("SMMA_NAS-21_Sultanova.yml", 1e-12),
    "COP": ("COP_ZeonexE48R_Sultanova.yml", 1e-12),
    "cellulose": ("cellulose_Sultanova.yml", 1e-12),
    "PDMS": ("PDMS_Schneider-Sylgard184.yml", 1e-12),
    "N-BK7": ("N-BK7_SCHOTT.yml", 1e-12),
    "fused silica": ("SiO2_Malitson.yml", 1e-12),
    # Fits of this project: the source they name says within 0.0025.
    "PET": ("PET_Zhang.yml", 0.0025),
    "PVC": ("PVC_Zhang.yml", 0.0025),
}


def test_every_formula_that_is_named_is_compared_with_a_file_of_the_database() -> None:
    assert set(FILES) == {name for name, known in dispersion.NAMED.items() if isinstance(known.value, Formula)}


@pytest.mark.parametrize("name", FILES)
def test_named_materials_agree_with_the_files_of_the_database(shared_data: Path, name: str) -> None:
    file, tolerance = FILES[name]
    ours = optics.refractive_index(name)
    theirs = optics.refractive_index({"file": file}, shared_data / "nk" / file)
    wavelength = np.arange(400.0, 701, 5)
    n, k = optics.interpolate_index(ours, wavelength)
    assert n == pytest.approx(optics.interpolate_index(theirs, wavelength)[0], abs=tolerance)
    assert (k == 0).all()


def test_two_laboratories_agree_on_polycarbonate_within_a_percent(shared_data: Path) -> None:
    zhang = optics.refractive_index({"file": "PC_Zhang.yml"}, shared_data / "nk" / "PC_Zhang.yml")
    wavelength = np.arange(400.0, 801, 10)
    n, k = optics.interpolate_index(zhang, wavelength)
    assert n == pytest.approx(optics.interpolate_index(optics.refractive_index("PC"), wavelength)[0], rel=0.01)
    assert (k > 0).all()
    assert k.max() < 2e-5


def test_a_metal_of_the_database_reflects_like_one(shared_data: Path) -> None:
    index = validate(optics.refractive_index({"file": "Al_Rakic.yml"}, shared_data / "nk" / "Al_Rakic.yml"), "index")
    assert index["wavelength"].values[[0, -1]].tolist() == [360, 830]
    assert optics.fresnel(1.0, *optics.interpolate_index(index, 550)).mean == pytest.approx(0.915, abs=0.01)
    assert "Rakić" in index.attrs["source"]


def test_an_extinction_table_joins_its_formula_on_the_wavelengths_of_both(shared_data: Path) -> None:
    index = optics.refractive_index({"file": "N-BK7_SCHOTT.yml"}, shared_data / "nk" / "N-BK7_SCHOTT.yml")
    n, k = optics.interpolate_index(index, [405, 546])
    assert k.tolist() == [9.0558e-09, 6.9658e-09]
    # Straight lines over 5 nm: h² n″/8.
    assert n == pytest.approx(dispersion.evaluate(dispersion.NAMED["N-BK7"].value, [405, 546]), abs=2e-5)


@pytest.mark.parametrize(("file", "found"), [("PLA_Bodurov.yml", "405–635 nm"), ("TiO2_Devore-o.yml", "430–1530 nm")])
def test_files_that_leave_out_visible_wavelengths_are_refused(shared_data: Path, file: str, found: str) -> None:
    with pytest.raises(InputError, match=f"known from 400 to 700 nm; found {found}"):
        optics.refractive_index({"file": file}, shared_data / "nk" / file)


def test_a_sellmeier_formula_is_extrapolated_to_360_nm_which_its_history_says(tmp_path: Path) -> None:
    index = optics.refractive_index("PMMA")
    assert index["wavelength"].values[[0, -1]].tolist() == [360, 830]
    assert index.attrs["history"] == "the Sellmeier formula, fitted from 436.8 nm, was extrapolated to 360 nm"
    with pytest.raises(BrdfpipeError, match="known from 360 to 830 nm"):
        optics.interpolate_index(index, 350)
    save_dataset(index, tmp_path / "index.nc", stage="index", material="m")


@pytest.mark.parametrize("span", ["0.55 1.0", "0.30 0.69"])
def test_a_formula_is_not_extrapolated_further(tmp_path: Path, span: str) -> None:
    text = PAGE.format(kind="formula 2", numbers="0 1.2 0.01").replace("0.35 1.0", span)
    with pytest.raises(InputError, match="must be known from 400 to 700 nm"):
        optics.refractive_index(page(tmp_path, text))


def test_other_formulas_are_never_extrapolated(tmp_path: Path) -> None:
    text = PAGE.format(kind="formula 5", numbers="1.5 0.005 -2").replace("0.35", "0.3901")
    index = optics.refractive_index(page(tmp_path, text))
    assert index["wavelength"].values[0] == 390.1
    assert "history" not in index.attrs
    assert index.attrs["source"] == "page.yml: A. Author. Journal"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "page.yml: empty"),
        ("n: 1.5\n", "no DATA of a refractive index; accepted: the layout of refractiveindex.info"),
        ("DATA: 3\n", "the layout of refractiveindex.info"),
        ("DATA: []\n", "refractive index n is missing"),
        (PAGE.format(kind="formula 6", numbers="0 1"), "unsupported dispersion formula; found 'formula 6'"),
        (PAGE.format(kind="model nk", numbers="0 1"), "unsupported type of data"),
        (PAGE.format(kind="formula 2", numbers="0 1.2 x"), "not a number"),
        (PAGE.format(kind="formula 2", numbers="0 1.2 .inf"), "not a number"),
        (PAGE.format(kind="formula 2", numbers=""), "incomplete dispersion formula; found 0 coefficients"),
        (
            PAGE.format(kind="formula 2", numbers="0 1.2 0.01").replace("0.35 1.0", "1.0 0.35"),
            "incomplete dispersion formula",
        ),
        (
            PAGE.format(kind="formula 2", numbers="0 1.2 0.25"),
            "formula has no real value|refractive index out of range",
        ),
        (PAGE.format(kind="formula 2", numbers="0 40 0.01"), "refractive index out of range; found n = "),
        (
            "DATA:\n  - type: tabulated n\n    data: |\n        0.4 1.5\n        0.7\n",
            "DATA 1, row 2: incomplete table; found 1 columns",
        ),
        (
            "DATA:\n  - type: tabulated n\n    data: |\n        0.7 1.5\n        0.4 1.5\n",
            "wavelengths do not increase",
        ),
        (
            "DATA:\n  - type: tabulated n\n    data: |\n        0.39 1.5\n        0.8 1.5\n",
            "must be known from 400 to 700 nm",
        ),
        (
            "DATA:\n  - type: tabulated k\n    data: |\n        0.39 1.5\n        0.8 1.5\n",
            "refractive index n is missing",
        ),
        ("DATA: &a [*a]\n", "alias"),
        ("DATA: [", "page.yml"),
    ],
)
def test_a_damaged_page_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        optics.refractive_index(page(tmp_path, text))


@pytest.mark.parametrize(("first", "note"), [(0.40, "extrapolated to 400 nm"), (0.30, "extrapolated to 360 nm")])
def test_the_history_of_a_formula_joined_to_an_extinction_says_how_far_it_was_extrapolated(
    tmp_path: Path, first: float, note: str
) -> None:
    text = PAGE.format(kind="formula 2", numbers="0 1.2 0.01").replace("0.35 1.0", "0.42 1.0")
    rows = "".join(f"      {wavelength:.2f} 0.001\n" for wavelength in np.arange(first, 0.85, 0.05))
    path = page(tmp_path, f"{text}  - type: tabulated k\n    data: |\n{rows}")
    index = dispersion.read(path)
    assert f"{index['wavelength'].values[0]:g} nm" == note.removeprefix("extrapolated to ")
    assert note in index.attrs["history"]


def test_a_formula_stored_within_its_range_is_not_recorded_as_extrapolated(tmp_path: Path) -> None:
    text = PAGE.format(kind="formula 2", numbers="0 1.2 0.01").replace("0.35 1.0", "0.37 1.0")
    rows = "".join(f"      {wavelength:.2f} 0.001\n" for wavelength in np.arange(0.40, 0.85, 0.05))
    index = dispersion.read(page(tmp_path, f"{text}  - type: tabulated k\n    data: |\n{rows}"))
    assert index["wavelength"].values[0] == 400
    assert "extrapolated" not in index.attrs.get("history", "")

"""Spectra in other formats than two columns of text: the real files, every quirk in small, damage of every kind."""

from __future__ import annotations

import random
import re
import warnings as python_warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.file_formats import format_of
from brdfpipe.spectra import ingest, read_spectrum
from brdfpipe.spectra.colour_science import colour
from brdfpipe.spectra.formats.registry import FORMATS
from brdfpipe.vocabulary import validate, warnings

NM = np.arange(400, 701, 10)
RED = np.round(0.05 + 0.7 / (1 + np.exp((590 - NM) / 15)), 5)
BLUE = np.round(0.05 + 0.5 * np.exp(-(((NM - 450) / 50) ** 2)), 5)


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return path


def read(path: Path, **options) -> xr.Dataset:
    return validate(read_spectrum(path, **{"geometry": "sci", **options}), "spectrum")


REAL = [
    # file, options, number of wavelengths, first and last wavelength, reflectance there as the file prints it
    ("abs_black.qtx", {}, 31, (400, 700), (0.026449, 0.022062)),
    ("abs_black_3col.txt", {"scale": "fraction"}, 31, (400, 700), (0.0264, 0.0221)),
    ("colorchecker_cyan.ti3", {}, 41, (380, 780), (0.093, 0.214)),
    ("colorchecker_red_jcamp.jdx", {}, 81, (380, 780), (0.052, 0.664)),
    ("colorchecker_white.cxf", {}, 81, (380, 780), (0.153, 0.879)),
    ("fibreglass_green_um_sentinel.txt", {}, 205, (360.6, 828), (0.066503137, 0.49788678)),
    ("hdpe_yellow_irregular.txt", {"scale": "fraction"}, 86, (370, 789), (0.08368, 0.69329)),
    ("munsell_over_unity.csv", {"scale": "fraction"}, 36, (380, 730), (0.096144, 1.066161)),
    ("pipe_blue_ecostress_style.txt", {}, 236, (360, 830), (0.068674, 0.646123)),
    ("pvc_white_de.csv", {}, 85, (360, 780), (0.08769, 0.7083)),
    ("vinyl_red_pe.asc", {}, 401, (380, 780), (0.09531657, 0.685969)),
]


@pytest.mark.parametrize(("name", "options", "count", "ends", "values"), REAL, ids=[file[0] for file in REAL])
def test_every_real_file_is_read_right(
    shared_data: Path, name: str, options: dict, count: int, ends: tuple, values: tuple
) -> None:
    spectrum = read(shared_data / "spectra" / name, geometry="sce", **options)
    assert spectrum.sizes["wavelength"] == count
    assert tuple(spectrum["wavelength"].values[[0, -1]]) == ends
    assert spectrum["total_reflectance"].values[[0, -1]] == pytest.approx(values, rel=1e-12)


def test_the_table_of_formats_names_the_real_files_that_are_read_here() -> None:
    declared = {name: format.name for format in FORMATS.values() for name in re.findall(r"[\w.]+\.\w+", format.tried)}
    assert declared == {name: format_of(Path(name), None, FORMATS, "").name for name, *_ in REAL}


@pytest.mark.parametrize(
    ("name", "patch"),
    [
        ("colorchecker_cyan.ti3", "cyan"),
        ("colorchecker_red_jcamp.jdx", "red"),
        ("colorchecker_white.cxf", "white 9.5 (.05 D)"),
    ],
)
def test_the_patches_are_those_of_colour_science(shared_data: Path, name: str, patch: str) -> None:
    truth = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"][patch]
    spectrum = read(shared_data / "spectra" / name)
    known = dict(zip(truth.wavelengths, truth.values, strict=True))
    assert spectrum["total_reflectance"].values == pytest.approx(
        [known[nm] for nm in spectrum["wavelength"].values], abs=1e-12
    )


def test_plain_columns_are_read_as_colour_science_reads_them(shared_data: Path) -> None:
    path = shared_data / "spectra" / "munsell_over_unity.csv"
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")
        theirs = colour.read_sds_from_csv_file(str(path))["R"]
    ours = read(path, scale="fraction")
    assert ours["wavelength"].values.tolist() == theirs.wavelengths.tolist()
    assert ours["total_reflectance"].values.tolist() == theirs.values.tolist()


def test_the_specular_component_a_qtx_states_is_compared(shared_data: Path) -> None:
    path = shared_data / "spectra" / "abs_black.qtx"
    assert warnings(read(path, geometry="sci")) == []
    assert "the header says SCI" in warnings(read(path, geometry="sce"))[0]


def test_the_real_black_is_warned_about_through_its_container_too(shared_data: Path) -> None:
    spec = {"file": "abs_black.qtx", "geometry": "sci"}
    assert (
        "if the specular was excluded, set `spectrum.geometry: sce`"
        in " ".join(warnings(ingest(spec, shared_data / "spectra" / "abs_black.qtx", 1.55))).lower()
    )


# One row a sample


def wide(separator: str = ",", label: str = "{}", decimal: str = ".", percent: bool = False) -> str:
    head = separator.join(["sample", *(label.format(nm) for nm in NM)])
    rows = [
        separator.join([name, *(f"{100 * r if percent else r:.5f}".replace(".", decimal) for r in values)])
        for name, values in (("red", RED), ('"blue"', BLUE))
    ]
    return "\n".join([head, *rows]) + "\n"


@pytest.mark.parametrize("sample", [1, "red", " RED "])
def test_a_sample_in_a_row_is_chosen_by_number_or_name(tmp_path: Path, sample: int | str) -> None:
    spectrum = read(write(tmp_path, "many.csv", wide()), sample=sample, scale="fraction")
    assert spectrum["wavelength"].values.tolist() == NM.tolist()
    assert spectrum["total_reflectance"].values == pytest.approx(RED, abs=1e-12)
    assert "sample 1 of 2 was read (red)" in spectrum.attrs["history"]


@pytest.mark.parametrize(
    ("text", "scale"),
    [
        (wide(";", "R {} nm", ","), "fraction"),
        (wide("\t", "{} nm"), "fraction"),
        (wide(",", "SPEC_{}"), "fraction"),
        ("# reflectance in %\n" + wide(";", "{}", ",", percent=True), None),
    ],
)
def test_headers_and_decimals_of_rows_are_understood(tmp_path: Path, text: str, scale: str | None) -> None:
    spectrum = read(write(tmp_path, "many.csv", text), sample="blue", scale=scale)
    assert spectrum["total_reflectance"].values == pytest.approx(BLUE, abs=1e-9)


@pytest.mark.parametrize("sample", [None, 0, 3, "green", True, 1.0])
def test_a_missing_or_unknown_sample_is_refused_with_the_names_of_the_file(tmp_path: Path, sample: object) -> None:
    with pytest.raises(InputError, match=r"the file has 2 samples.*1 to 2, or one of red, blue") as refusal:
        read(write(tmp_path, "many.csv", wide()), sample=sample, scale="fraction")
    assert refusal.value.key == "spectrum.sample"


@pytest.mark.parametrize("sample", [2, "green"])
def test_another_sample_of_a_file_with_one_is_refused(tmp_path: Path, sample: object) -> None:
    alone = "\n".join(line for line in wide().splitlines() if "blue" not in line) + "\n"
    with pytest.raises(InputError, match=r"unknown sample; the file has one; found .*accepted: 1 or red, or no key"):
        read(write(tmp_path, "one.csv", alone), sample=sample, scale="fraction")


def test_two_samples_of_one_name_are_chosen_by_number(tmp_path: Path) -> None:
    path = write(tmp_path, "many.csv", wide().replace('"blue"', "red"))
    with pytest.raises(InputError, match="ambiguous sample name"):
        read(path, sample="red", scale="fraction")
    assert read(path, sample=2, scale="fraction")["total_reflectance"].values == pytest.approx(BLUE)


def labelled(title: str, included: str, excluded: str, separator: str = ",") -> str:
    """The red sample with the specular included (RED) and excluded (BLUE), and the cells of a column that says which."""
    head, red, blue = wide(separator).replace('"blue"', "red").splitlines()
    rows = zip((head, red, blue), (title, included, excluded), strict=True)
    return "".join(
        f"{row.partition(separator)[0]}{separator}{cell}{separator}{row.partition(separator)[2]}\n"
        for row, cell in rows
    )


@pytest.mark.parametrize(
    ("title", "included", "excluded"),
    [
        ("Mode", "SCI", "SCE"),
        ("Specular", "Included", "Excluded"),
        ("SCI/SCE", "I", "E"),
        ("Specular", "yes", "no"),
        ("Glanz", "mit", "ohne"),
        ("Glanz", "ja", "nein"),
        ("SCE", "no", "yes"),
        ("Geometry", "di:8", "de:8"),
        ("Measurement", "RSIN", "RSEX"),
    ],
)
def test_a_row_labelled_sce_is_never_read_as_sci(tmp_path: Path, title: str, included: str, excluded: str) -> None:
    path = write(tmp_path, "many.csv", labelled(title, included, excluded))
    for geometry, values in (("sci", RED), ("sce", BLUE)):
        for sample in (None, "red"):
            spectrum = read(path, geometry=geometry, sample=sample, scale="fraction")
            assert spectrum["total_reflectance"].values == pytest.approx(values)
            assert spectrum.attrs["geometry"] == geometry
    with pytest.raises(
        InputError, match=r"sample 2: the sample is labelled SCE, and the description says SCI; .*red"
    ) as refusal:
        read(path, geometry="sci", sample=2, scale="fraction")
    assert refusal.value.key == "spectrum.sample"
    # Without a geometry in the description, the label states it.
    assert read(path, geometry=None, sample=2, scale="fraction").attrs["geometry"] == "sce"


@pytest.mark.parametrize(
    "titles",
    ["nm;SCE;SCI;", "nm;SCE;SCI", "nm;SCE;SCI;;", "λ;SCE;SCI;\nnm;%;%;", "Report;;;\n;;;\nλ;SCE;SCI;\n[nm];[%];[%];"],
)
def test_titles_above_rows_that_end_in_empty_cells_name_the_columns(tmp_path: Path, titles: str) -> None:
    rows = "".join(f"{nm};30,1;34,2;\n" for nm in range(400, 701, 10))
    path = write(tmp_path, "two.csv", f"{titles}\n{rows}")
    for geometry, value in (("sci", 0.342), ("sce", 0.301)):
        spectrum = read(path, geometry=geometry, scale="percent")
        assert spectrum["total_reflectance"].values == pytest.approx(value)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_titles_filled_up_with_empty_cells_are_no_rows(tmp_path: Path, mark: str) -> None:
    table = labelled("Mode", "SCI", "SCE")
    separator = next(sign for sign in ";\t," if sign in table)
    empty = mark * table.splitlines()[0].count(separator)
    text = f"Report of a spectrophotometer{empty}\n{empty}\n{table.replace(separator, mark)}"
    path = write(tmp_path, "many.csv", text)
    assert read(path, sample="red", geometry="sce", scale="fraction")["total_reflectance"].values == pytest.approx(BLUE)


def test_samples_of_one_name_are_told_apart_by_the_cells_that_differ(tmp_path: Path) -> None:
    path = write(tmp_path, "many.csv", labelled("date", "2024-03-01", "2024-05-07"))
    with pytest.raises(InputError, match=r"ambiguous sample name.*one of red, 2024-03-01, red, 2024-05-07"):
        read(path, sample="red", scale="fraction")
    spectrum = read(path, sample="Red, 2024-05-07", scale="fraction")
    assert spectrum["total_reflectance"].values == pytest.approx(BLUE)


@pytest.mark.parametrize("label", ["{}", "R{}", "{} nm"])
def test_blank_separated_files_hold_one_row_a_sample_too(tmp_path: Path, label: str) -> None:
    text = wide(" ", label).replace('"blue"', "deep sea blue")
    spectrum = read(write(tmp_path, "many.txt", text), sample="deep sea blue", scale="fraction")
    assert spectrum["wavelength"].values.tolist() == NM.tolist()
    assert spectrum["total_reflectance"].values == pytest.approx(BLUE)
    several = labelled("Mode", "SCI", "SCE", " ")
    spectrum = read(write(tmp_path, "many.txt", several), geometry="sce", scale="fraction")
    assert spectrum["total_reflectance"].values == pytest.approx(BLUE)
    with pytest.raises(InputError, match="line 3: rows of unequal length"):
        read(write(tmp_path, "many.txt", several.replace("SCE", "SCE of May")), sample=1, scale="fraction")


def test_long_lists_of_samples_are_shortened(tmp_path: Path) -> None:
    head, row, _ = wide().splitlines()
    text = "\n".join([head, *(row.replace("red", f"plaque {k}") for k in range(300))]) + "\n"
    with pytest.raises(InputError, match="plaque 9, …") as refusal:
        read(write(tmp_path, "many.csv", text), scale="fraction")
    assert len(str(refusal.value)) < 400


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [("red,0.05", "red,x", "line 2: not a number; found 'x"), ("red,", "red,1,", "line 2: rows of unequal")],
)
def test_a_damaged_row_is_refused_by_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "many.csv", wide().replace(old, new, 1)), sample=1, scale="fraction")


def test_columns_have_no_samples(tmp_path: Path) -> None:
    text = "nm,R\n" + "".join(f"{nm},0.5\n" for nm in NM)
    with pytest.raises(InputError, match="columns, not samples"):
        read(write(tmp_path, "one.csv", text), sample=1, scale="fraction")


# Spreadsheets


def workbook(folder: Path, rows: list[list], form: str | None = None) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    if form:
        for row in book.active.iter_rows():
            for cell in row[1:]:
                cell.number_format = form
    book.create_sheet("notes")
    path = folder / "book.xlsx"
    book.save(path)
    return path


def test_an_excel_sheet_of_columns_is_read(tmp_path: Path) -> None:
    path = workbook(
        tmp_path, [["nm", "R [%]", "std"], *([int(nm), float(100 * r), 0.1] for nm, r in zip(NM, RED, strict=True))]
    )
    spectrum = read(path)
    assert spectrum["total_reflectance"].values == pytest.approx(RED, rel=1e-12)
    assert spectrum["total_reflectance_u"].values == pytest.approx(np.full(31, 0.001))
    assert "the first of 2 sheets was read" in spectrum.attrs["history"]


def test_an_excel_sheet_with_a_row_a_sample_is_read(tmp_path: Path) -> None:
    path = workbook(tmp_path, [["name", *map(int, NM)], ["red", *map(float, RED)], ["blue", *map(float, BLUE)]])
    assert read(path, sample="blue", scale="fraction")["total_reflectance"].values == pytest.approx(BLUE)


def test_excel_cells_formatted_as_percentages_are_read_as_percent(tmp_path: Path) -> None:
    path = workbook(
        tmp_path, [["nm", "R"], *([int(nm), float(r) / 20] for nm, r in zip(NM, RED, strict=True))], "0.00%"
    )
    assert read(path)["total_reflectance"].values == pytest.approx(RED / 20, rel=1e-9)


@pytest.fixture
def cells_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts the rows and cells that openpyxl makes of a sheet, one number a row."""
    sheets = pytest.importorskip("openpyxl.worksheet._read_only")
    counts: list[int] = []
    original = sheets.ReadOnlyWorksheet._cells_by_row

    def counted(*args, **options):
        for row in original(*args, **options):
            counts.append(len(row))
            yield row

    monkeypatch.setattr(sheets.ReadOnlyWorksheet, "_cells_by_row", counted)
    return counts


def resized(path: Path, dimension: str, more_rows: str = "") -> Path:
    """The workbook with another stated dimension (none if empty), and more rows at the end of its first sheet."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    sheet = entries["xl/worksheets/sheet1.xml"].decode()
    stated = f'<dimension ref="{dimension}" />' if dimension else ""
    sheet = re.sub(r"<dimension [^>]*/>", stated, sheet).replace("</sheetData>", f"{more_rows}</sheetData>")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (entries | {"xl/worksheets/sheet1.xml": sheet.encode()}).items():
            archive.writestr(name, content)
    return path


COLUMNS = [["nm", "R [%]"], *([int(nm), float(100 * r)] for nm, r in zip(NM, RED, strict=True))]


def test_a_sheet_that_states_millions_of_cells_is_refused_before_any_is_read(
    tmp_path: Path, cells_read: list[int]
) -> None:
    path = resized(workbook(tmp_path, COLUMNS), "A1:XFD1048576")
    with pytest.raises(InputError, match=r"too large for spectra; found 1048576 rows, 16384 columns; accepted: up to"):
        read(path)
    assert cells_read == []


@pytest.mark.parametrize("dimension", ["", "A1:B32"])
@pytest.mark.parametrize(
    ("rows", "most"),
    [
        ("".join(f'<row r="{i}"><c r="A{i}"><v>{i}</v></c></row>' for i in range(33, 20000)), 2**14 + 1),
        ('<row r="1048576"><c r="A1048576"><v>1</v></c></row>', 2**14 + 1),
        ('<row r="33"><c r="XFD33"><v>1</v></c></row>', 33),
        ("".join(f'<row r="{i}"><c r="AAA{i}"><v>{i}</v></c></row>' for i in range(33, 2000)), 2**20 // 703 + 40),
    ],
    ids=["rows", "last row", "last column", "cells"],
)
def test_a_sheet_that_holds_too_many_cells_is_refused_after_the_limit(
    tmp_path: Path, cells_read: list[int], dimension: str, rows: str, most: int
) -> None:
    path = resized(workbook(tmp_path, COLUMNS), dimension, rows)
    with pytest.raises(InputError, match=r"too large for spectra; .*delete what lies beyond the spectra"):
        read(path)
    assert 0 < len(cells_read) <= most
    assert sum(cells_read) <= 2**20 + 2**14


def test_a_workbook_that_is_compressed_too_much_is_refused_before_it_is_opened(
    tmp_path: Path, cells_read: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = resized(workbook(tmp_path, COLUMNS), "", "<row/>" * 3_000_000)
    assert path.stat().st_size < 200_000
    monkeypatch.setattr("openpyxl.load_workbook", lambda *args, **options: pytest.fail("the workbook was opened"))
    with pytest.raises(InputError, match=r"suspiciously large.*up to 64 MiB, compressed at most 200 times"):
        read(path)


def test_rows_beyond_the_stated_dimension_are_read(tmp_path: Path) -> None:
    path = resized(workbook(tmp_path, COLUMNS), "A1:B5")
    assert read(path)["total_reflectance"].values == pytest.approx(RED)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"nm;R\n"])
def test_a_damaged_workbook_is_refused(tmp_path: Path, content: bytes) -> None:
    pytest.importorskip("openpyxl")
    with pytest.raises(InputError, match="not an Excel workbook"):
        read(write(tmp_path, "book.xlsx", content))


# Instruments and the colour trade


def pe(unit: str = "%R", count: int = 31, x: str = "nm", factor: str = "1.000000") -> str:
    head = ["PE UV       SUBTECH     SPECTRUM    ASCII       PEDS        4.00", "-1", "red.sp", "", "#HDR", "-1", "#GR"]
    graph = [x, unit, factor, "0.000000", "700.0", "-10.0", str(count), "4", "100.0", "0.0", "#DATA"]
    return "\r\n".join(
        [*head, *graph, *(f"{nm}.000000\t{100 * r:.6f}" for nm, r in zip(NM[::-1], RED[::-1], strict=True))]
    )


def test_perkinelmer_ascii_is_read_from_its_data_on(tmp_path: Path) -> None:
    spectrum = read(write(tmp_path, "red.asc", pe()))
    assert spectrum["total_reflectance"].values == pytest.approx(RED, abs=1e-9)
    assert "rows were sorted by wavelength" in spectrum.attrs["history"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (pe("%T"), "not a reflectance over nm"),
        (pe("A"), "not a reflectance over nm"),
        (pe(x="cm-1"), "not a reflectance over nm"),
        (pe(count=32), "truncated or damaged; found 31 values; accepted: 32"),
        (pe(factor="2.0"), "unsupported factor or offset"),
        (pe(count=31).replace("#DATA", "#DAT"), "not a PerkinElmer ASCII"),
        (pe().replace("650.000000\t", "650.000000 x"), r"line \d+: not a number"),
    ],
)
def test_perkinelmer_ascii_of_another_quantity_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "red.asc", text))


def qtx(prefix: str, name: str, values: np.ndarray) -> str:
    section = "STANDARD_DATA" if prefix == "STD" else "BATCH_DATA"
    cells = ",".join(f"{100 * r:.4f}" for r in values)
    return f"[{section} 0]\n{prefix}_NAME={name}\n{prefix}_REFLPOINTS=31,\n{prefix}_REFLINTERVAL=10,\n{prefix}_REFLLOW=400,\n{prefix}_R={cells[:100]}\n{cells[100:]},\n"


def test_a_qtx_holds_standards_and_batches_whose_lines_may_break(tmp_path: Path) -> None:
    path = write(tmp_path, "a.qtx", qtx("STD", "std white", BLUE) + qtx("BAT", "batch", RED))
    assert read(path, sample="std white")["total_reflectance"].values == pytest.approx(BLUE, abs=1e-6)
    assert read(path, sample=2)["total_reflectance"].values == pytest.approx(RED, abs=1e-6)


CXF = """<?xml version="1.0" encoding="UTF-8"?>
<CxF xmlns="http://colorexchangeformat.com/CxF3-core"><Resources><ObjectCollection>
<Object Name="a" Id="1"><ColorValues><ReflectanceSpectrum ColorSpecification="s">{a}</ReflectanceSpectrum></ColorValues></Object>
<Object Name="b" Id="2"><ColorValues><ReflectanceSpectrum ColorSpecification="s" StartWL="400">{b}</ReflectanceSpectrum></ColorValues></Object>
</ObjectCollection><ColorSpecificationCollection><ColorSpecification Id="s"><MeasurementSpec>
<WavelengthRange StartWL="400" Increment="10"/></MeasurementSpec></ColorSpecification></ColorSpecificationCollection></Resources></CxF>
""".format(a=" ".join(map(str, RED)), b=" ".join(map(str, BLUE)))


def test_cxf_objects_take_their_grid_from_their_specification(tmp_path: Path) -> None:
    path = write(tmp_path, "a.cxf", CXF)
    assert read(path, sample="a")["total_reflectance"].values == pytest.approx(RED)
    assert read(path, sample="b")["total_reflectance"].values == pytest.approx(BLUE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CXF.replace("<CxF", '<!DOCTYPE x [<!ENTITY a "b">]><CxF', 1), "document type or entities"),
        (CXF.replace("<CxF", '<!DOCTYPE x SYSTEM "file:///etc/passwd"><CxF', 1), "document type or entities"),
        (CXF[:600], "damaged XML"),
        (CXF.replace(str(RED[0]), f"{RED[0]} " * 30, 1), "wavelengths beyond the range of colour instruments"),
        (CXF.replace("Reflectance", "Emissive"), "no reflectance spectrum in the file"),
        (CXF.replace('Increment="10"', ""), "does not state its Increment of a"),
    ],
)
def test_cxf_with_entities_or_without_required_elements_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "a.cxf", text), sample=1)


def ti3(norm: str = "100", device: str = "OUTPUT", sets: int = 2) -> str:
    fields = " ".join(f"SPEC_{nm}" for nm in NM)
    rows = "\n".join(
        f'{i} "{name}" ' + " ".join(f"{v * float(norm or 100):.5f}" for v in values)
        for i, name, values in ((1, "my red", RED), (2, "blue", BLUE))
    )
    norm_line = f'SPECTRAL_NORM "{norm}"\n' if norm else ""
    return (
        f'CTI3\n\nDEVICE_CLASS "{device}"\nSPECTRAL_BANDS "31"\nSPECTRAL_START_NM "400"\nSPECTRAL_END_NM "700"\n{norm_line}'
        f"NUMBER_OF_FIELDS 33\nBEGIN_DATA_FORMAT\nSAMPLE_ID SAMPLE_NAME {fields}\nEND_DATA_FORMAT\nNUMBER_OF_SETS {sets}\nBEGIN_DATA\n{rows}\nEND_DATA\n"
    )


@pytest.mark.parametrize("norm", ["100", "1", ""])
def test_the_scale_of_cgats_is_its_norm_or_follows_from_its_values(tmp_path: Path, norm: str) -> None:
    spectrum = read(write(tmp_path, "a.ti3", ti3(norm)), sample="my red")
    assert spectrum["total_reflectance"].values == pytest.approx(RED, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ti3(device="DISPLAY"), "not a reflectance; found DEVICE_CLASS DISPLAY"),
        (ti3(sets=3), "truncated or damaged"),
        (ti3().replace("END_DATA\n", ""), "a block does not end|truncated"),
        (ti3().replace('NM "700"', 'NM "730"'), "the bands contradict the header"),
        ("CTI3\n", "no reflectance spectrum in the file"),
    ],
)
def test_cgats_of_another_quantity_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "a.ti3", text), sample=1)


def test_a_format_may_be_named_where_the_extension_says_another(tmp_path: Path) -> None:
    path = write(tmp_path, "cgats.txt", ti3())
    with pytest.raises(InputError):
        read(path, sample=1)
    assert read(path, sample=1, format="cgats")["total_reflectance"].values == pytest.approx(RED, abs=1e-6)
    with pytest.raises(InputError, match="unknown format; found 'cgat'"):
        read(path, format="cgat")


def test_cxf_says_whether_the_specular_component_is_included(tmp_path: Path) -> None:
    for word, geometry in (("Included", "sci"), ("Excluded", "sce")):
        choice = f"<GeometryChoice><SphereGeometry>Specular_{word}</SphereGeometry></GeometryChoice>"
        path = write(tmp_path, "a.cxf", CXF.replace("<WavelengthRange", f"{choice}<WavelengthRange"))
        silent = read(path, sample="a", geometry=None)
        assert (silent.attrs["geometry"], silent.attrs["theta_i"]) == (geometry, 8)
        assert f"geometry {geometry} was read from the file" in silent.attrs["history"]
        assert warnings(read(path, sample="a", geometry=geometry)) == []
        other = {"sci": "sce", "sce": "sci"}[geometry]
        contradicted = read(path, sample="a", geometry=other)
        assert contradicted.attrs["geometry"] == other
        assert f"the header says {geometry.upper()}; `spectrum.geometry: " in warnings(contradicted)[0]


def test_the_real_cxf_was_measured_at_45_0(shared_data: Path) -> None:
    path = shared_data / "spectra" / "colorchecker_white.cxf"
    silent = read(path, geometry=None)
    assert (silent.attrs["geometry"], silent.attrs["theta_i"]) == ("sce", 45)
    assert warnings(silent) == []
    said = read(path, geometry="sci", incidence=8.0)
    assert (said.attrs["geometry"], said.attrs["theta_i"]) == ("sci", 8)
    assert "the header says SingleAngle 45/0" in warnings(said)[0]
    assert "the header says light from 45 degree; `spectrum.incidence: " in warnings(said)[1]


def test_a_cxf_without_a_geometry_needs_it_in_the_description(tmp_path: Path) -> None:
    for choice in ("", "<GeometryChoice><UnknownGeometry>x</UnknownGeometry></GeometryChoice>"):
        path = write(tmp_path, "a.cxf", CXF.replace("<WavelengthRange", f"{choice}<WavelengthRange"))
        with pytest.raises(InputError, match="specular reflection included or excluded: not stated") as refusal:
            read(path, sample="a", geometry=None)
        assert refusal.value.key == "spectrum.geometry"


LONG = CXF.replace(f" {RED[-1]}<", f" {RED[-1]}" + " 0.75" * 8 + "<")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LONG.replace(f"{RED[3]} ", "", 1), "38 values from 400 nm by 10 nm end at 770 nm, an unusual end"),
        (CXF.replace(f"{RED[3]} ", f"{RED[3]} " * 4, 1), "it has 34 values, others of the file 31"),
        (CXF.replace('Increment="10"', 'Increment="11"'), "31 values from 400 nm by 11 nm end at 730 nm"),
        (LONG.replace('StartWL="400"', 'StartWL="330"'), "StartWL is 330 nm; CxF3 allows 360 to 400"),
        (CXF.replace("<WavelengthRange", "<MultiAngle/><WavelengthRange"), "Use `multiangle`"),
    ],
)
def test_a_cxf_that_may_have_lost_values_is_warned_about(tmp_path: Path, text: str, message: str) -> None:
    # Its schema knows neither the number of values nor the end.
    messages = warnings(read(write(tmp_path, "a.cxf", text), sample="a"))
    assert any(message in warning for warning in messages), messages


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('Increment="10"/>', 'Increment="10"/><MeasurementType>Spectrum_Transmittance</MeasurementType>', "not a reflectance"),
        ('StartWL="400">', 'StartWL="390">', "two values of StartWL"),
        ('StartWL="400">', 'StartWL="400" Increment="20">', "two values of Increment"),
    ],
)  # fmt: skip
def test_cxf_that_contradicts_itself_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "a.cxf", CXF.replace(old, new, 1)), sample=1)


def test_a_cxf_may_hold_transmittances_beside_reflectances(tmp_path: Path) -> None:
    other = '<ColorSpecification Id="t"><MeasurementType>Spectrum_Transmittance</MeasurementType></ColorSpecification>'
    path = write(
        tmp_path, "a.cxf", CXF.replace("</ColorSpecificationCollection>", f"{other}</ColorSpecificationCollection>")
    )
    assert read(path, sample="a")["total_reflectance"].values == pytest.approx(RED)


def test_perkinelmer_wavelengths_that_are_not_those_of_the_header_are_warned_about(tmp_path: Path) -> None:
    assert warnings(read(write(tmp_path, "red.asc", pe()))) == []
    messages = warnings(read(write(tmp_path, "red.asc", pe().replace("\n700.0\r", "\n690.0\r"))))
    assert "the header states wavelengths from 690 nm by -10 nm" in messages[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (qtx("STD", "a", BLUE).partition("STD_R=")[0], "truncated or damaged; found 0 values; accepted: 31"),
        (qtx("STD", "a", BLUE).replace("STD_REFLLOW", "STD_R"), "duplicate key R in a section"),
        (qtx("STD", "a", BLUE) + "[BATCH_DATA 0]\n1.2,3.4\n", "neither a section nor a key"),
    ],
)
def test_a_damaged_qtx_section_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, "a.qtx", text))


def test_an_unusual_wavelength_grid_is_warned_about(tmp_path: Path) -> None:
    text = qtx("STD", "a", BLUE).replace("INTERVAL=10", "INTERVAL=12")
    assert "31 values from 400 nm by 12 nm end at 760 nm" in warnings(read(write(tmp_path, "a.qtx", text)))[0]


def test_a_cgats_norm_other_than_1_and_100_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"SPECTRAL_NORM: unknown scale; found '10'; accepted: 1 or 100"):
        read(write(tmp_path, "a.ti3", ti3("10")), sample=1)


def test_values_above_the_header_of_wavelengths_are_not_skipped(tmp_path: Path) -> None:
    head, red, blue = wide().splitlines()
    with pytest.raises(InputError):
        read(write(tmp_path, "many.csv", "\n".join([red, head, blue])), sample="blue", scale="fraction")


def test_a_cut_number_in_a_container_is_warned_about(tmp_path: Path) -> None:
    cells = qtx("STD", "a", BLUE).rstrip(",\n")
    path = write(tmp_path, "a.qtx", cells[:-2])
    assert "at 700 nm has another number of decimals than the others" in warnings(read(path))[0]


# Damage


STRUCTURE = ("truncate", "delete", "duplicate", "swap", "lose lines", "repeat lines", "lose values", "repeat values")
BYTES = ("flip", "digit", "decimal")
MUTATIONS = 66
NUMBERS = rb"[\d.,]+(?:e[+-]\d+)?[ \t,;\r\n]+"


def mutate(data: bytes, rng: random.Random, kind: str) -> bytes:
    place, length, count = rng.randrange(len(data)), rng.randint(1, 400), rng.choice([1, 1, 1, 2, 5])
    if kind == "truncate":
        return data[:place]
    if kind == "delete":
        return data[:place] + data[place + length :]
    if kind == "duplicate":
        return data[: place + length] + data[place:]
    if kind.endswith(("lines", "swap")):
        lines = data.splitlines(keepends=True)
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        if kind == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        return b"".join(lines[:i] + lines[i + count :] if kind == "lose lines" else lines[: i + count] + lines[i:])
    if kind.endswith("values"):
        numbers = [match.start() for match in re.finditer(NUMBERS, data)] + [len(data)]
        i = rng.randrange(len(numbers) - 1)
        start, end = numbers[i], numbers[min(i + count, len(numbers) - 1)]
        return data[:start] + data[end:] if kind == "lose values" else data[:end] + data[start:]
    return mutate_bytes(bytearray(data), rng, kind)


def mutate_bytes(data: bytearray, rng: random.Random, kind: str) -> bytes:
    if kind == "flip":
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif kind == "digit":
        data[rng.choice([i for i, byte in enumerate(data) if 48 <= byte < 58])] = rng.choice(b"0123456789")
    else:
        i = rng.choice([i for i, byte in enumerate(data) if byte in b".,"])
        data[i] = ord("," if data[i] == ord(".") else ".") if rng.random() < 0.5 else rng.choice(b"0123456789 ")
    return bytes(data)


def unseen(original: Path, damaged: Path, options: dict) -> float:
    """How far a damaged file is read off, over the largest reflectance; 0 where it is refused or warned about."""
    truth = read(original, geometry="sce", **options)
    try:
        spectrum = read(damaged, geometry="sce", **options)
    except BrdfpipeError:
        return 0.0
    if set(warnings(spectrum)) - set(warnings(truth)):
        return 0.0
    # What was read must be right; that rows are missing from an irregular grid nothing tells.
    at = spectrum["wavelength"].values
    off = spectrum["total_reflectance"].values - np.interp(at, truth["wavelength"], truth["total_reflectance"])
    return float(np.abs(off).max() / truth["total_reflectance"].max())


@pytest.mark.parametrize(("name", "options"), [file[:2] for file in REAL], ids=[file[0] for file in REAL])
def test_a_damaged_file_is_refused_or_warned_about_or_nearly_right(
    shared_data: Path, tmp_path: Path, name: str, options: dict
) -> None:
    original = shared_data / "spectra" / name
    data, rng = original.read_bytes(), random.Random(name)
    slips = []
    for k in range(MUTATIONS):
        kind = (*STRUCTURE, *BYTES)[k % 11]
        damaged = write(tmp_path, name, mutate(data, rng, kind))
        # One digit may change unseen where the spectrum bends as much; lost or repeated text may not.
        off, allowed = unseen(original, damaged, options), 0.05 if kind in BYTES else 0.03
        if off > allowed:
            slips.append((kind, off, k))
    assert not slips


LAYOUTS = {
    "blank-separated rows": (wide(" ").replace('"blue"', "blue"), {"sample": "red"}),
    "angstrom": ("Wavelength [Å];R\n" + "".join(f"{10 * nm};{r:.5f}\n" for nm, r in zip(NM, RED, strict=True)), {}),
    "wavenumber": ("Wavenumber [cm-1];R\n" + "".join(f"{1e7 / nm:.3f};{r:.5f}\n" for nm, r in zip(NM, RED, strict=True)), {}),
    "electronvolt": ("Energy [eV];R\n" + "".join(f"{1239.84198 / nm:.6f};{r:.5f}\n" for nm, r in zip(NM, RED, strict=True)), {}),
    "rows of both geometries": (labelled("Mode", "SCI", "SCE"), {"sample": "red"}),
}  # fmt: skip


@pytest.mark.parametrize("count", [22, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_damaged_layout_is_read_as_reflectances_or_refused(tmp_path: Path, layout: str, count: int) -> None:
    (text, options), rng = LAYOUTS[layout], random.Random(layout)
    whole = read(write(tmp_path, "whole.txt", text), scale="fraction", **options)["total_reflectance"].values
    assert whole == pytest.approx(RED)
    refused = 0
    for k in range(count):
        damaged = write(tmp_path, "damaged.txt", mutate(text.encode(), rng, (*STRUCTURE, *BYTES)[k % 11]))
        try:
            values = read(damaged, scale="fraction", **options)["total_reflectance"].values
        except BrdfpipeError:
            refused += 1
            continue
        assert ((values >= 0) & (values <= 1.1)).all()
    # Most of those that lack a part, or have one twice.
    assert refused >= count / 4

"""Delimited text: every spelling of one surface reads alike, and everything doubtful is refused by its line."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.surfaces import level, parameters, read_surface, text

PRINTED = 6e-6
"""Half of the last digit the tests print, and a little for the float."""


def spell(height: np.ndarray, separator: str = ";", decimal: str = ".", missing: str = "") -> str:
    """Rows of heights as text, with five decimals."""
    cells = [[missing if np.isnan(z) else f"{z:.5f}".replace(".", decimal) for z in row] for row in height]
    return "\n".join(separator.join(row) for row in cells) + "\n"


def points(surface: xr.Dataset) -> np.ndarray:
    """Rows x, y, z."""
    x, y = np.meshgrid(surface.x, surface.y)
    return np.column_stack([x.ravel(), y.ravel(), surface.height.values.ravel()])


def put(folder: Path, content: str | bytes, name: str = "map.txt") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


GRID: dict[str, Any] = {"unit": "um", "pitch": [0.5, 0.7]}


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize(
    ("separator", "missing"), [(";", ""), ("\t", ""), ("\t", "***"), (" ", "NaN"), ("  ", "*****")]
)
def test_every_separator_and_decimal_mark_reads_the_same_grid(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str, decimal: str, missing: str
) -> None:
    path = put(tmp_path, spell(asymmetric.height.values, separator, decimal, missing))
    surface = read_surface(path, **GRID)
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)
    assert surface.height.dims == ("y", "x")
    np.testing.assert_allclose(surface.x, asymmetric.x)
    np.testing.assert_allclose(surface.y, asymmetric.y)


@pytest.mark.parametrize("indent", ["\t\t\t", "\t", "  \t ", ";;", ";", ",", ",,"])
@pytest.mark.parametrize("separator", [" ", "\t", ";", ","])
def test_separators_before_the_first_number_of_every_line_change_nothing(
    tmp_path: Path, asymmetric: xr.Dataset, indent: str, separator: str
) -> None:
    rows = spell(asymmetric.height.values, separator, missing="nan").splitlines()
    surface = read_surface(put(tmp_path, "\n".join(indent + row for row in rows) + "\n"), **GRID)
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)


MARKS = ["", "NA", "N/A", "n/a", "NaN", "null", "-", "--", "---", "BAD", "bad", "***"]


@pytest.mark.parametrize("header", ["", "Instrument X\n\n"])
@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_rows_whose_first_heights_are_missing_are_rows(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str, mark: str, header: str
) -> None:
    # Blanks cannot enclose an empty field.
    mark = mark if mark or separator != " " else "NA"
    height = asymmetric.height.values.copy() + 1
    height[:5, 0] = np.nan
    height[2, :4] = np.nan
    surface = read_surface(put(tmp_path, header + spell(height, separator, missing=mark), "map.csv"), **GRID)
    np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)
    assert ("Skipped 1 header lines" in surface.attrs.get("history", "")) == bool(header)
    assert vocabulary.warnings(surface) == []


@pytest.mark.parametrize("mark", ["#NV", "#N/A", "#VALUE!", "#DIV/0!", "#WERT!", "#REF!"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_error_values_of_a_spreadsheet_are_missing_heights_in_any_cell(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str, mark: str
) -> None:
    height = asymmetric.height.values + 1
    height[[0, 4, 9, 20, 39], [0, 0, 17, 49, 0]] = np.nan
    height[30] = np.nan
    surface = read_surface(put(tmp_path, spell(height, separator, missing=mark) + f"# {mark} is missing\n"), **GRID)
    assert surface.height.shape == (40, 50)
    np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)
    assert "comments" not in " ".join(vocabulary.warnings(surface))


@pytest.mark.parametrize("separator", [";", "\t", ",", " "])
@pytest.mark.parametrize("mark", ["#", "# ", "%", "#ERR{}"])
def test_comments_that_may_be_rows_of_heights_are_warned_of(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str, mark: str
) -> None:
    height = np.nan_to_num(asymmetric.height.values)
    rows = spell(height, separator).splitlines()
    for i in (8, 20):
        rows[i] = mark.format(separator + rows[i].partition(separator)[2]) if "{" in mark else mark + rows[i]
    surface = read_surface(put(tmp_path, "# heights\n" + "\n".join(rows) + "\n"), **GRID)
    np.testing.assert_allclose(surface.height, np.delete(height, [8, 20], axis=0), rtol=0, atol=PRINTED)
    message = "2 comments among the rows have as many fields as a row and were left out, the first in line 10: "
    assert message in " ".join(vocabulary.warnings(surface))


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_sentences_among_the_rows_are_no_heights(tmp_path: Path, separator: str) -> None:
    rows = [separator.join(f"{x} {y} {x * y / 8}".split()) for y in range(40) for x in range(40)]
    rows[7:7] = ["# line 2 begins", "# pitch: 1 1", "# slow; steady; dry", "% the stylus jumped"]
    surface = read_surface(put(tmp_path, "\n".join(rows) + "\n"), unit="um")
    assert surface.height.shape == (40, 40)
    assert "comments" not in " ".join(vocabulary.warnings(surface))


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_first_rows_of_separators_alone_are_rows_of_every_separator(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str
) -> None:
    height = asymmetric.height.values + 1
    height[[0, 1, 5]] = np.nan
    surface = read_surface(put(tmp_path, spell(height, separator)), **GRID)
    np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("mark", MARKS)
def test_a_mark_before_decimal_commas_begins_a_row(
    tmp_path: Path, asymmetric: xr.Dataset, mark: str, decimal: str
) -> None:
    height = asymmetric.height.values.copy()
    height[:3, 0] = np.nan
    surface = read_surface(put(tmp_path, spell(height, ";", decimal, mark)), **GRID)
    np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)


@pytest.mark.parametrize(
    ("mark", "header", "read"),
    [
        ("NA", "", True),
        ("---", "", True),
        ("", "", True),
        ("NA", "Instrument X\n", True),
        # Below titles, dashes are a rule, and a row of separators is the empty row of a workbook.
        ("---", "Instrument X\n", False),
        ("", "Instrument X" + 49 * ";" + "\n", False),
    ],
)
def test_first_rows_without_any_height_are_rows_or_warned_of(
    tmp_path: Path, asymmetric: xr.Dataset, mark: str, header: str, read: bool
) -> None:
    height = asymmetric.height.values.copy()
    height[:2] = np.nan
    surface = read_surface(put(tmp_path, header + spell(height, missing=mark)), **GRID)
    np.testing.assert_allclose(surface.height, height[0 if read else 2 :], rtol=0, atol=PRINTED)
    doubts = [text for text in vocabulary.warnings(surface) if "2 lines of dashes or of empty fields above" in text]
    assert len(doubts) == (not read)


def test_the_first_heights_of_a_profile_may_be_missing(tmp_path: Path, line: xr.Dataset) -> None:
    height = line.height.values.copy()
    height[:4] = np.nan
    surface = read_surface(put(tmp_path, spell(height[:, None], missing="NA")), unit="um", pitch=0.25)
    np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)


def test_a_skipped_line_of_numbers_behind_a_word_is_warned_of(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    height = asymmetric.height.values
    first, *rows = spell(height).splitlines(keepends=True)
    surface = read_surface(put(tmp_path, "bad?" + first[first.index(";") :] + "".join(rows)), **GRID)
    assert surface.height.shape == (39, 50)
    assert "skipped as header though most of their fields are numbers: 1." in vocabulary.warnings(surface)[0]
    sizes = read_surface(put(tmp_path, "Size 50 40\nOrigin 0 0 0 mm\n" + spell(height)), **GRID)
    assert sizes.height.shape == (40, 50)
    assert vocabulary.warnings(sizes) == []


def test_infinite_heights_of_a_first_row_are_refused_and_not_skipped(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    height = np.nan_to_num(asymmetric.height.values)
    height[0, 0] = np.nan
    with pytest.raises(InputError, match="infinite heights"):
        read_surface(put(tmp_path, spell(height, missing="inf")), **GRID)


@pytest.mark.parametrize("row", [",{} {} {}\n", ",{}\n"])
def test_a_comma_before_whole_numbers_is_ambiguous(tmp_path: Path, row: str) -> None:
    with pytest.raises(InputError, match="ambiguous comma: decimal mark"):
        read_surface(put(tmp_path, "".join(row.format(i, i + 1, 7) for i in range(99))), layout="grid", **GRID)


@pytest.mark.parametrize(
    "header",
    [
        "# Channel: a map\n# Width: 25.00 µm\n# Height: 28000 nm\n# Value units: m\n",
        "# Kanal: a map\n# Breite: 25,00 µm\n# Höhe: 28,00 µm\n# Value units: m\n",
    ],
)
def test_the_header_of_gwyddion_states_unit_and_pitch(tmp_path: Path, asymmetric: xr.Dataset, header: str) -> None:
    # Gwyddion counts rows from the upper edge down.
    rows = "\n".join("\t".join(f"{z * 1e-6:.9e}" for z in row) for row in asymmetric.height.values[::-1])
    surface = read_surface(put(tmp_path, header + rows + "\n"))
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=1e-8)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx((0.5, 0.7), rel=1e-12)
    read_surface(put(tmp_path, header + rows + "\n"), pitch=[0.5e-6, 0.7e-6])
    with pytest.raises(InputError, match=r"contradicts the extent along y; found 5e-07 against 7e-07.*surface\.pitch"):
        read_surface(put(tmp_path, header + rows + "\n"), pitch=0.5e-6)


def test_the_real_exports_of_gwyddion_lack_only_points(shared_data: Path) -> None:
    # They hold four rows of three heights: everything else is known.
    for language in ("english", "german"):
        with pytest.raises(InputError, match=r"too few points.*found 4 x 3"):
            read_surface(shared_data / "surfaces" / f"gwyddion-export-{language}.txt")


@pytest.mark.parametrize("separator", [",", ", "])
def test_commas_separate_where_points_are_decimal(tmp_path: Path, asymmetric: xr.Dataset, separator: str) -> None:
    surface = read_surface(put(tmp_path, spell(asymmetric.height.values, separator), "map.csv"), **GRID)
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("codec", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_every_encoding_and_line_end_reads_the_same(
    tmp_path: Path, asymmetric: xr.Dataset, codec: str, end: str
) -> None:
    text = "# Größe\n" + spell(asymmetric.height.values) + "\n   \n"
    surface = read_surface(put(tmp_path, text.replace("\n", end).encode(codec)), **GRID)
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)


@pytest.mark.parametrize(("unit", "factor"), [("nm", 1e-3), ("um", 1), ("µm", 1), ("mm", 1e3), ("m", 1e6)])
def test_heights_come_out_in_micrometres(tmp_path: Path, line: xr.Dataset, unit: str, factor: float) -> None:
    printed = "\n".join(f"{z / factor:.9e}" for z in line.height.values)
    surface = read_surface(put(tmp_path, printed), unit=unit, lateral_unit="um", pitch=0.25)
    np.testing.assert_allclose(surface.height, line.height, rtol=1e-9)
    assert surface.attrs["pitch_x"] == pytest.approx(0.25)


def test_header_lines_state_unit_lateral_unit_and_pitch(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    header = "Instrument X\n# unit: nm\n# Lateral_Unit = mm\n# pitch: 0.0005 0.0007\n"
    surface = read_surface(put(tmp_path, header + spell(asymmetric.height.values * 1e3)))
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx((0.5, 0.7))
    assert "Skipped 1 header lines" in surface.attrs["history"]


def test_the_material_file_overrides_the_header(tmp_path: Path, line: xr.Dataset) -> None:
    text = "# unit: mm\n# pitch: 9\n" + "\n".join(map(str, line.height.values))
    surface = read_surface(put(tmp_path, text), unit="um", pitch=0.25)
    np.testing.assert_allclose(surface.height, line.height)
    assert surface.attrs["pitch_x"] == 0.25


def test_comments_may_be_anywhere(tmp_path: Path, line: xr.Dataset) -> None:
    values = [f"{z}" for z in line.height.values]
    values[5] += "  # a scratch"
    values.insert(9, "% the stylus jumped")
    surface = read_surface(put(tmp_path, "\n".join(values)), unit="um", pitch=0.25)
    np.testing.assert_allclose(surface.height, line.height)


def test_a_height_file_without_a_unit_is_refused(tmp_path: Path, line: xr.Dataset) -> None:
    path = put(tmp_path, "\n".join(map(str, line.height.values)))
    with pytest.raises(InputError, match=r"map\.txt: the unit of the heights is missing.*`surface\.unit`"):
        read_surface(path, pitch=0.25)


def test_a_grid_without_a_pitch_is_refused(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    with pytest.raises(InputError, match=r"pitch is missing.*`surface\.pitch`"):
        read_surface(put(tmp_path, spell(asymmetric.height.values)), unit="um")


@pytest.mark.parametrize("pitch", [0, -1, float("nan"), [1, 2, 3], "wide", [], [0.5, None]])
def test_an_impossible_pitch_is_refused(tmp_path: Path, asymmetric: xr.Dataset, pitch: object) -> None:
    with pytest.raises(InputError, match=r"`surface\.pitch`"):
        read_surface(put(tmp_path, spell(asymmetric.height.values)), unit="um", pitch=pitch)


@pytest.mark.parametrize("separator", [";", "\t", ",", " "])
@pytest.mark.parametrize("change", [-1, 1])
def test_a_ragged_row_is_refused_by_its_line(
    tmp_path: Path, asymmetric: xr.Dataset, separator: str, change: int
) -> None:
    lines = ("# heights\n\n" + spell(np.nan_to_num(asymmetric.height.values), separator)).splitlines()
    lines[20] = lines[20].rpartition(separator)[0] if change < 0 else lines[20] + separator + "1.0"
    with pytest.raises(InputError, match=rf"line 21: rows of unequal length; found {50 + change} fields"):
        read_surface(put(tmp_path, "\n".join(lines)), **GRID)


@pytest.mark.parametrize("wrong", ["abc", "1.2.3", "0x1F", "1,2", "1 2"])
def test_a_cell_that_is_not_a_number_is_refused_by_line_and_column(
    tmp_path: Path, asymmetric: xr.Dataset, wrong: str
) -> None:
    lines = spell(asymmetric.height.values).splitlines()
    cells = lines[11].split(";")
    cells[4] = wrong
    lines[11] = ";".join(cells)
    with pytest.raises(InputError, match="line 12, column 5: not a number"):
        read_surface(put(tmp_path, "\n".join(lines)), **GRID)


@pytest.mark.parametrize(("first", "later"), [("0.1;0.2", "0,3;0,4"), ("0,1;0,2", "0.3;0.4"), ("0,1 0,2", "0.3 0.4")])
def test_two_decimal_marks_are_refused_where_they_change(tmp_path: Path, first: str, later: str) -> None:
    with pytest.raises(InputError, match="line 2, column 1: not a number"):
        read_surface(put(tmp_path, f"{first}\n{later}\n"), **GRID)


def test_rows_may_be_padded_with_blanks(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    height = np.nan_to_num(asymmetric.height.values)
    for separator in (" ", ";"):
        text = "".join(f"  {row}  \n" for row in spell(height, separator).splitlines())
        surface = read_surface(put(tmp_path, text), **GRID)
        np.testing.assert_allclose(surface.height, height, rtol=0, atol=PRINTED)


def test_an_infinite_height_is_refused(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    with pytest.raises(InputError, match="infinite heights"):
        read_surface(put(tmp_path, spell(asymmetric.height.values, missing="inf")), **GRID)


@pytest.mark.parametrize("text", ["0,15\n0,25\n0,35\n", "0,15\n" * 100, "1,5, 2,5, 3,5\n" * 40])
def test_commas_of_two_meanings_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="ambiguous comma: decimal mark"):
        read_surface(put(tmp_path, text), unit="um", pitch=1)


@pytest.mark.parametrize("content", [b"", b"\n\n", b"# unit: um\n", b"no numbers here\nat all\n"])
def test_a_file_without_numbers_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError, match=r"empty|no line of numbers"):
        read_surface(put(tmp_path, content), **GRID)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(content=st.binary(max_size=3000))
def test_random_bytes_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError):
        read_surface(put(tmp_path, content), **GRID)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(text=st.text("0123456789.,;-+eE \t\n#%*naNx", max_size=400))
def test_text_like_numbers_is_read_or_refused_with_a_message(tmp_path: Path, text: str) -> None:
    # No text this short holds enough heights: anything but a refusal in the user's words is a fault.
    with pytest.raises(InputError):
        read_surface(put(tmp_path, text), **GRID)


def test_columns_that_are_empty_at_the_end_are_left_out(tmp_path: Path, line: xr.Dataset) -> None:
    rows = "".join(f"{x:.4f},{z:.6f},,\n" for x, z in zip(line.x.values, line.height.values, strict=True))
    surface = read_surface(put(tmp_path, rows, "line.csv"), unit="um")
    np.testing.assert_allclose(surface.height, line.height, rtol=0, atol=PRINTED)


def test_one_row_is_a_line(tmp_path: Path, line: xr.Dataset) -> None:
    surface = read_surface(put(tmp_path, spell(line.height.values[None])), unit="um", pitch=0.25)
    assert surface.height.dims == ("x",)


def test_rounded_positions_give_the_pitch_of_the_end_points(tmp_path: Path) -> None:
    # 0.156 um printed to 0.1 um: the trap of stylus files, whose printed neighbours make slopes 28 % too steep.
    x = np.arange(2000) * 0.156
    text = "".join(f"{a:.1f} {b:.5f}\n" for a, b in zip(x, np.sin(x), strict=True))
    surface = read_surface(put(tmp_path, text), unit="um")
    # The end point itself is printed to 0.1 um of 312 um.
    assert surface.attrs["pitch_x"] == pytest.approx(0.156, rel=2e-4)
    # The forward difference of a sine of pitch d is cos(x) sinc(d/2).
    assert float(parameters(surface).Rdq) == pytest.approx(0.5**0.5, rel=4e-3)


TITLED = [
    ("X [mm];Y [mm];Z [µm]\n", "um", "mm"),
    ("X;Y;Z\nmm;mm;um\n", "um", "mm"),
    ("X;Y;Z\n[m];[m];[nm]\n", "nm", "m"),
    ("# x (um), y (um), height (um)\n", "um", "um"),
    ("Plaque 7\nX/mm Y/mm Z/nm\n", "nm", "mm"),
    ("Lateral x um,Lateral y um,Raw Micrometer,,\n", "um", "um"),
    ("x position (mm)  y position (mm)  height (µm)\n", "um", "mm"),
    ("x,y,height [Nanometer]\n", "nm", "nm"),
    ("x in millimetres\ty in millimetres\tz in microns\n", "um", "mm"),
]


@pytest.mark.parametrize(("titles", "unit", "lateral_unit"), TITLED)
def test_titles_of_columns_state_the_units(
    tmp_path: Path, asymmetric: xr.Dataset, titles: str, unit: str, lateral_unit: str
) -> None:
    size = {"nm": 1e3, "um": 1.0, "mm": 1e-3, "m": 1e-6}
    rows = points(asymmetric) * [size[lateral_unit], size[lateral_unit], size[unit]]
    text = titles + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
    surface = read_surface(put(tmp_path, text, "map.xyz"))
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)
    np.testing.assert_allclose(surface.y, asymmetric.y, rtol=1e-6)
    assert f"The titles of the columns state heights in {unit}" in surface.attrs["history"]
    assert vocabulary.warnings(surface) == []


def test_a_titled_lateral_unit_counts_beside_a_declared_unit_of_heights(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    text = "x [nm] y [nm] z [um]\n" + "".join(
        f"{1e3 * x:.9g} {1e3 * y:.9g} {z:.9g}\n" for x, y, z in points(asymmetric)
    )
    path = put(tmp_path, text, "map.xyz")
    np.testing.assert_allclose(read_surface(path, unit="um").x, asymmetric.x, rtol=1e-6)
    contradicted = read_surface(path, unit="mm", lateral_unit="um")
    heights, warning = vocabulary.warnings(contradicted)[:2]
    assert "state heights in um; they were read in mm. Correct `surface.unit`" in heights
    assert "state positions in nm; they were read in um. Correct `surface.lateral_unit`" in warning


@pytest.mark.parametrize(
    "header",
    ["Length 5 mm\n", "Parameter m\n", "Length;5 mm\n", "Step;2 um;Speed;1 mm\n", "x [V];z [V]\n", "Ra [um]\n"],
)
def test_words_above_the_numbers_that_are_no_titles_state_no_unit(
    tmp_path: Path, line: xr.Dataset, header: str
) -> None:
    rows = "".join(f"{x:.4f};{z:.6f}\n" for x, z in zip(line.x.values, line.height.values, strict=True))
    with pytest.raises(InputError, match="the unit of the heights is missing"):
        read_surface(put(tmp_path, header + rows))


def test_a_single_column_states_its_unit_in_brackets(tmp_path: Path, line: xr.Dataset) -> None:
    rows = "\n".join(f"{1e3 * z:.3f}" for z in line.height.values)
    surface = read_surface(put(tmp_path, "Height [nm]\n" + rows), lateral_unit="um", pitch=0.25)
    np.testing.assert_allclose(surface.height, line.height, rtol=0, atol=PRINTED)
    with pytest.raises(InputError, match="the unit of the heights is missing"):
        read_surface(put(tmp_path, "Height in mm\n" + rows), pitch=0.25)


def test_a_real_profile_states_its_units_in_the_titles(shared_data: Path) -> None:
    surface = read_surface(shared_data / "surfaces" / "dektak-1.csv")
    xr.testing.assert_equal(surface, read_surface(shared_data / "surfaces" / "dektak-1.csv", unit="um"))


def test_a_binary_file_of_the_extension_dat_may_be_one_of_metropro(tmp_path: Path) -> None:
    (tmp_path / "map.dat").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match=r"binary, not text; .*`format: metropro` for a file of Zygo MetroPro"):
        read_surface(tmp_path / "map.dat")


def test_positions_printed_to_six_digits_are_accepted(tmp_path: Path) -> None:
    x = np.arange(3000) * 0.156e-3
    text = "".join(f"{a:.6g} {b:.5f}\n" for a, b in zip(x, np.sin(x * 1e3), strict=True))
    assert read_surface(put(tmp_path, text), unit="um", lateral_unit="mm").attrs["pitch_x"] == pytest.approx(0.156)


@pytest.mark.parametrize("fault", ["gap", "stretch", "repeat"])
def test_uneven_spacing_is_refused(tmp_path: Path, fault: str) -> None:
    x = np.arange(200) * 0.5
    if fault == "gap":
        x = np.delete(x, 90)
    elif fault == "stretch":
        x = x * (1 + 0.001 * x)
    else:
        x[90] = x[89]
    text = "".join(f"{a:.4f} {np.sin(a):.5f}\n" for a in x)
    with pytest.raises(InputError, match="unevenly spaced"):
        read_surface(put(tmp_path, text), unit="um")


def test_a_line_measured_backwards_is_reversed(tmp_path: Path, line: xr.Dataset) -> None:
    pairs = zip(line.x.values[::-1], line.height.values[::-1], strict=True)
    surface = read_surface(put(tmp_path, "".join(f"{x:.3f};{z:.5f}\n" for x, z in pairs)), unit="um")
    np.testing.assert_allclose(surface.height, line.height, rtol=0, atol=PRINTED)
    assert "Reversed" in surface.attrs["history"]


def test_a_stated_pitch_that_contradicts_the_positions_is_refused(tmp_path: Path, line: xr.Dataset) -> None:
    text = "".join(f"{x:.3f};{z:.5f}\n" for x, z in zip(line.x.values, line.height.values, strict=True))
    with pytest.raises(InputError, match="contradicts"):
        read_surface(put(tmp_path, text), unit="um", pitch=0.5)


def test_points_fill_the_grid_in_any_order(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    rows = np.random.default_rng(1).permutation(points(asymmetric))
    text = "\n".join(" ".join(f"{v:.5f}" for v in row) for row in rows)
    surface = read_surface(put(tmp_path, text, "map.xyz"), unit="um")
    np.testing.assert_allclose(surface.height, asymmetric.height, rtol=0, atol=PRINTED)
    np.testing.assert_allclose(surface.y, asymmetric.y)


def test_points_left_out_of_the_grid_are_missing(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    rows = points(asymmetric)
    text = "\n".join(" ".join(f"{v:.5f}" for v in row) for row in rows[~np.isnan(rows[:, 2])])
    surface = read_surface(put(tmp_path, text, "map.xyz"), unit="um")
    np.testing.assert_array_equal(np.isnan(surface.height), np.isnan(asymmetric.height))
    assert "1 points of the grid are not in the file" in surface.attrs["history"]


def test_a_cloud_of_points_is_refused(tmp_path: Path) -> None:
    cloud = np.random.default_rng(2).uniform(0, 100, (2000, 3))
    with pytest.raises(InputError, match="do not form a regular grid"):
        read_surface(put(tmp_path, spell(cloud)), unit="um")


def test_a_repeated_point_is_refused(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    rows = np.nan_to_num(points(asymmetric))
    with pytest.raises(InputError, match="duplicate point; found x = 0, y = 0"):
        read_surface(put(tmp_path, spell(np.vstack([rows, rows[0]]))), unit="um")


@pytest.mark.parametrize(("layout", "columns"), [("xyz", 50), ("line", 50), ("pyramid", 50)])
def test_a_layout_that_does_not_fit_is_refused(
    tmp_path: Path, asymmetric: xr.Dataset, layout: str, columns: int
) -> None:
    with pytest.raises(InputError, match=r"`surface\.layout`"):
        read_surface(put(tmp_path, spell(asymmetric.height.values[:, :columns])), layout=layout, **GRID)


@pytest.mark.parametrize("end", ["", "\n"])
def test_a_file_without_a_last_line_end_gives_no_warning(tmp_path: Path, asymmetric: xr.Dataset, end: str) -> None:
    for separator, missing in ((";", ""), (" ", "NaN"), (",", "***")):
        text = spell(asymmetric.height.values, separator, missing=missing).rstrip("\n") + end
        assert not vocabulary.warnings(read_surface(put(tmp_path, text), **GRID))
    text = "".join(f"{x:.6g} {z:.6g}\n" for x, z in zip(np.arange(99) / 8, np.sin(np.arange(99) / 8), strict=True))
    assert not vocabulary.warnings(read_surface(put(tmp_path, text.rstrip("\n") + end), unit="um"))


def test_a_last_number_of_fewer_decimals_is_warned_about(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    text = spell(asymmetric.height.values, decimal=",")
    surface = read_surface(put(tmp_path, text[:-3]), **GRID)
    assert vocabulary.warnings(surface)[-1].startswith(
        "The file may be truncated. The last line has no line end, and its last number"
    )


@pytest.mark.parametrize(
    ("words", "doubted"),
    [
        ("Length,60.0 um", True),
        ("# Profile length: 0.06 mm", True),
        ("Scan Length = 60 [µm]", True),
        ("Length,50.0 um", False),
        ("Length,60", False),
        ("Cutoff length,800 um", False),
        ("Length of the stylus,20 mm", False),
    ],
)
def test_a_profile_shorter_than_its_header_says_is_warned_about(
    tmp_path: Path, line: xr.Dataset, words: str, doubted: bool
) -> None:
    rows = "".join(f"{x:.2f};{z:.5f}\n" for x, z in zip(line.x.values, line.height.values, strict=True))
    doubts = vocabulary.warnings(read_surface(put(tmp_path, f"{words}\n{rows}"), unit="um"))
    assert doubts == (
        [
            "The file may be truncated. The header states a length of 60 um, the data have 50 um; compare it with the original, or export it again."
        ]
        if doubted
        else []
    )


@pytest.mark.parametrize("order", ["rows", "columns", "downwards", "to and fro"])
def test_points_that_end_within_a_row_are_warned_about(tmp_path: Path, asymmetric: xr.Dataset, order: str) -> None:
    rows = points(asymmetric.fillna(0.0))
    if order == "columns":
        rows = rows[np.lexsort([rows[:, 1], rows[:, 0]])]
    elif order == "downwards":
        rows = rows[::-1]
    elif order == "to and fro":
        rows = rows.reshape(40, 50, 3)
        rows[1::2] = rows[1::2, ::-1]
        rows = rows.reshape(-1, 3)
    for kept, doubted in ((len(rows), False), (len(rows) - 7, True)):
        surface = read_surface(put(tmp_path, spell(rows[:kept]), "map.xyz"), unit="um")
        assert any("last row of points is incomplete" in text for text in vocabulary.warnings(surface)) == doubted


def test_points_left_out_of_an_aperture_give_no_warning(tmp_path: Path, asymmetric: xr.Dataset) -> None:
    rows = points(asymmetric.fillna(0.0))
    inside = ((rows[:, 0] - 12.25) / 12.6) ** 2 + ((rows[:, 1] - 13.65) / 14) ** 2 <= 1
    surface = read_surface(put(tmp_path, spell(rows[inside]), "map.xyz"), unit="um")
    assert not any("may be truncated" in text for text in vocabulary.warnings(surface))


def test_a_real_stylus_file_gives_the_known_roughness(shared_data: Path) -> None:
    texture = parameters(level(read_surface(shared_data / "surfaces" / "dektak-1.csv", unit="um")))
    # Reference values are given to two digits.
    assert float(texture.Rq) == pytest.approx(0.094, abs=5e-4)
    assert float(texture.Rdq) == pytest.approx(0.0095, abs=5e-5)


def test_a_real_scan_with_mixed_units_is_read_as_stated(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "nanovea_test1.txt"
    surface = read_surface(path, unit="um", lateral_unit="mm")
    assert surface.height.shape == (101, 101)
    assert surface.attrs["pitch_x"] == pytest.approx(5)
    with pytest.raises(InputError, match="rms slope"):
        read_surface(path, unit="um")


HFM = "X;Y;valid\n[mm];[um];[1/0]\n"


def hfm(folder: Path, text: str) -> Path:
    path = folder / "line.hfm"
    path.write_text(text)
    return path


def test_an_hfm_profile_brings_its_units_and_its_gaps(tmp_path: Path) -> None:
    z = np.sin(np.arange(100) / 5)
    rows = "\n".join(f"{8 + 5e-4 * i:.4f};{z[i]:.6f};{int(i != 7)}" for i in range(100))
    surface = read_surface(hfm(tmp_path, HFM + rows))
    assert surface.attrs["pitch_x"] == pytest.approx(0.5)
    np.testing.assert_allclose(np.delete(surface.height.values, 7), np.delete(z, 7), atol=1e-6)
    assert np.isnan(surface.height.values[7])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X;Y;Z\n[mm];[um];[1/0]\n1;2;1\n", "not an HFM profile.*X;Y;valid"),
        ("X;Y;valid\n[mm];[um]\n1;2;1\n", "not an HFM profile"),
        ("X;Y;valid\n[mm];[V];[1/0]\n1;2;1\n", "unknown unit; found 'V'"),
        (HFM, "not an HFM profile"),
        (HFM + "1;2\n2;3\n", "not an HFM profile; found 2 columns"),
        (HFM + "1;2;1\n2;x;1\n", "line 4, column 2: not a number"),
    ],
)
def test_other_files_called_hfm_are_refused_in_words(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_surface(hfm(tmp_path, text))


def test_the_real_hfm_profile_has_its_printed_pitch(shared_data: Path) -> None:
    surface = level(read_surface(shared_data / "surfaces" / "hfm-1.hfm"))
    assert surface.attrs["pitch_x"] == pytest.approx(0.5, rel=1e-4)
    # No published value: the deviation of the printed heights from their regression line, by numpy alone.
    x, z, _ = np.loadtxt(shared_data / "surfaces" / "hfm-1.hfm", delimiter=";", skiprows=2).T
    rest = (z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())) * 1e3
    assert float(parameters(surface).Rq) == pytest.approx(rest.std(), rel=1e-6)


def test_a_large_text_takes_a_few_times_its_own_memory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(text, "_BLOCK", 2**14)  # small beside the text, as for a large file
    path = tmp_path / "map.txt"
    row = ";".join(f"{value:.6f}" for value in np.random.default_rng(1).normal(size=1000)) + "\n"
    path.write_text("# unit: um\n# pitch: 1 1\n" + 400 * row)
    text.read_text(path)  # imports take memory too
    tracemalloc.start()
    try:
        heights = text.read_text(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert heights.height.shape == (400, 1000)
    # The text, its bytes, the numbers by column and as one array: as eight-byte numbers they take as much as the text.
    assert peak < 5 * path.stat().st_size


@pytest.mark.parametrize(
    ("index", "header", "words"),
    [(True, True, "row and the first column"), (True, False, "first column"), (False, True, "first row")],
)
def test_numbers_of_rows_and_columns_are_no_heights(tmp_path: Path, index: bool, header: bool, words: str) -> None:
    height = pd.DataFrame(np.random.default_rng(4).normal(0, 0.1, (40, 50)).round(5))
    path = tmp_path / "frame.csv"
    height.to_csv(path, index=index, header=header)
    with pytest.raises(InputError, match=f"{words} of the grid holds positions or numbers of lines"):
        read_surface(path, unit="um", pitch=1.0)
    height.to_csv(path, index=False, header=False)
    assert read_surface(path, unit="um", pitch=1.0).height.shape == (40, 50)

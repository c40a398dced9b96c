"""Tables of numbers as instruments and spreadsheets write them: encodings, separators, decimals, words and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.columns import (
    Columns,
    gaps,
    last_digit,
    merge_duplicates,
    odd_decimals,
    odd_steps,
    read_columns,
    wavelengths,
)
from brdfpipe.errors import InputError


@pytest.fixture
def read(tmp_path: Path):
    def reader(content: str | bytes) -> Columns:
        path = tmp_path / "table.txt"
        path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        return read_columns(path)

    return reader


@pytest.mark.parametrize(
    "text",
    [
        "400,0.25\n410,0.5\n",
        "400, 0.25\r\n410, 0.5\r\n",
        "400;0.25\n410;0.5\n",
        "400;0,25\n410;0,5\n",
        "400,0;0,25\r410,0;0,5\r",
        "400\t0.25\n410\t0.5\n",
        "400\t0,25\n410\t0,5",
        "  400.0   2.5E-1\n  410.0   5.0D-01\n",
        "400 0,25\n410 0,5\n",
        '"400","0,25"\n"410","0,5"\n',
        "400,0.25,\n410,0.5,\n",
        "400 0.25 # first\n! between\n\n410 0.5\n# end\n",
        "% title\n# nm R\n400 0.25\n410 0.5\n\x1a",
    ],
)
def test_every_way_to_write_two_columns_reads_alike(read, text: str) -> None:
    assert read(text).values.tolist() == [[400, 0.25], [410, 0.5]]


@pytest.mark.parametrize("codec", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_every_encoding_reads_alike(read, codec: str) -> None:
    table = read("Wellenlänge [µm];R\r\n0,4;0,25\r\n0,5;0,5\r\n".encode(codec))
    assert table.names == ("Wellenlänge [µm]", "R")
    assert table.values.tolist() == [[0.4, 0.25], [0.5, 0.5]]


@pytest.mark.parametrize(
    "cell", ["", "NaN", "n/a", "-", "inf", "-1.23e34", "-1.2300000e+34", "1e30", "-9999", "-999.0"]
)
def test_missing_cells_and_sentinels_are_nan(read, cell: str) -> None:
    values = read(f"400;1\n410;{cell}\n420;-99\n").values[:, 1]
    assert np.isnan(values).tolist() == [False, True, False]


def test_typographic_minus_and_no_break_spaces_are_understood(read) -> None:
    assert read("400\u00a0\u22120.5\n410\u00a01e\u22122\n").values[:, 1].tolist() == [-0.5, 0.01]


def test_each_row_has_its_line_of_the_file(read) -> None:
    assert read("a b\n\n400 1\n# x\n410 2\n").lines.tolist() == [3, 5]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("title\nnm,R\n400,1\n410,2.5\n", ("nm", "R")),
        ("# nm R std\n400 1 0\n", ("nm", "R", "std")),
        ("Wave length  R [%]\n400 1\n", ("Wave length", "R [%]")),
        ("one two three\n400 1\n", None),
        ("400 1\n", None),
        ("nm R\n400 1\n# looks fine\n", ("nm", "R")),
    ],
)
def test_columns_are_named_by_the_last_line_above_them(read, text: str, names: tuple[str, ...] | None) -> None:
    assert read(text).names == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("400 1\nabc def\n410 2\n", r"table\.txt, line 2: neither numbers nor a comment; found 'abc def'"),
        ("400 1\n410 2 3\n", r"line 2: rows of unequal length; found 3 columns; accepted: 2 columns, as in line 1"),
        ("400;1\n410;1 2\n", r"line 2: not a number"),
        ("400,0,5\n410,0,6\n", "commas could separate columns or mark decimals"),
        ("400,0,8,7\n410,0,9,3\n", "commas could separate columns or mark decimals"),
        ("400;1.234,5\n", "both . and , inside numbers"),
        ("360,0;8,769\n380,0;9,1\n400,0;34.864\n", "line 3: both . and , inside numbers; found '400,0;34.864'"),
        ("360.0;8.769\n380.0;9.1\n400,5;34.864\n", "line 3: both . and , inside numbers; found '400,5;34.864'"),
        ("1\n2\n3\n", "no table of numbers found"),
        ("", "no table of numbers found"),
        ("400 1_0\n", "no table of numbers found"),
        ("\u0664\u0660\u0660 1\n", "no table of numbers found"),
    ],
)
def test_ambiguous_text_is_refused_by_line(read, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(text)


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n\x00\x00\x01", b"400 1\n\x00\x00\x00", b"\xff\xfe400"])
def test_what_is_not_text_is_refused(read, data: bytes) -> None:
    with pytest.raises(InputError, match=r"table\.txt: (the file is binary, not text|no table of numbers found)"):
        read(data)


def test_a_file_too_large_for_a_table_is_refused_before_it_is_parsed(read) -> None:
    with pytest.raises(InputError, match="too large for a text file; accepted: up to 16 MiB"):
        read(b"4" * (2**24 + 1))


def test_a_missing_file_is_refused_by_its_name_alone(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refusal:
        read_columns(tmp_path / "absent.txt")
    assert str(refusal.value).startswith("absent.txt: cannot be read")
    assert str(tmp_path) not in str(refusal.value)


@given(data=st.binary(max_size=200) | st.text(alphabet="0123456789.,;\t \n-+eE#aN", max_size=200).map(str.encode))
def test_any_bytes_give_a_table_or_a_refusal(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.txt"
    path.write_bytes(data)
    try:
        table = read_columns(path)
    except InputError:
        return
    assert table.values.ndim == 2
    assert table.values.shape[1] >= 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("nm R\n400 1\n700 2\n", [400, 700]),
        ("400 1\n700 2\n", [400, 700]),
        ("X Units: Wavelength (micrometers)\n\n0.4001 1\n0.7 2\n", [400.1, 700]),
        ("Wavelength [μm];R\n0.4;1\n0.7;2\n", [400, 700]),
        ("0.4 1\n0.7 2\n", [400, 700]),
        ("measured every 10 nm\nR of a film of 5 um\n400 1\n700 2\n", [400, 700]),
    ],
)
def test_wavelengths_are_converted_to_nm(read, text: str, expected: list[float]) -> None:
    assert wavelengths(read(text), key="spectrum.file")[0].tolist() == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nm R\n0.4 1\n0.7 2\n", "not hold wavelengths in nm; found 0.4 to 0.7"),
        ("um R\n400 1\n700 2\n", "not hold wavelengths in µm; found 400 to 700"),
        ("frequency THz;R\n430;1\n750;2\n", "does not hold wavelengths; found 'frequency THz'"),
        ("20 1\n400 2\n", "not hold wavelengths in nm or µm; found 20 to 400"),
        ("wavenumber cm-1;R\n0;1\n25000;2\n", "not hold values in cm-1, as the header says; found 0 to 25000"),
        ("3800 1\n7800 2\n", "looks like wavelengths in Å.*accepted: .*`wavelength \\[Å\\]`"),
        ("13000 1\n26000 2\n", "looks like wavenumbers in cm-1.*`wavenumber \\[cm-1\\]`"),
        ("1.6 1\n3.2 2\n", "looks like photon energies in eV.*`energy \\[eV\\]`"),
        ("0 1\n1 2\n", "not hold wavelengths"),
    ],
)
def test_a_unit_that_is_unclear_or_contradicted_is_refused(read, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        wavelengths(read(text), key="spectrum.file")


@pytest.mark.parametrize(
    ("title", "values"),
    [
        ("wavelength [Å]", [4000, 7000]),
        ("Angstrom", [4000, 7000]),
        ("Wellenzahl (cm-1)", [25000, 14285.7142857]),
        ("wavenumber [1/cm]", [25000, 14285.7142857]),
        ("photon energy [eV]", [3.09960496, 1.77120283]),
    ],
)
def test_other_units_that_the_header_names_are_converted(read, title: str, values: list[float]) -> None:
    text = f"{title};R\n" + "".join(f"{value};1\n" for value in values)
    nm, note = wavelengths(read(text), key="spectrum.file")
    # hc = 1239.841984 eV nm (CODATA 2018), and the digits of the values above.
    assert nm == pytest.approx([400, 700], rel=1e-8)
    assert "was converted from" in note


def test_repeated_wavelengths_are_averaged_and_sorted() -> None:
    wavelength, values, merged = merge_duplicates(np.array([500.0, 400, 500]), np.array([[1.0], [5], [2]]))
    assert (wavelength.tolist(), values.tolist(), merged) == ([400, 500], [[5], [1.5]], 1)


@pytest.mark.parametrize(
    ("wavelength", "expected"),
    [
        ([400, 550, 700], []),
        ([300, 500, 690, 800], []),
        ([400.9, 550, 699.2], []),
        ([410, 550, 700], [(400, 410)]),
        ([400, 550, 590], [(590, 700)]),
        ([300, 650, 900], [(400, 650), (650, 700)]),
        ([400, 401, 700], [(401, 700)]),
        ([300, 350], [(400, 700)]),
        ([], [(400, 700)]),
    ],
)
def test_gaps_are_the_uncovered_intervals(wavelength: list[float], expected: list[tuple[float, float]]) -> None:
    assert gaps(np.array(wavelength, dtype=float), 400, 700, widest=200) == expected


# Signs of damage


REGULAR = [
    np.arange(360.0, 781, 10),
    np.round(np.arange(380, 731, 10 / 3)),  # as instruments of 3.3 nm print them
    np.round(np.arange(350, 1000, 1.37), 1),
    np.round(340 + np.arange(500) * 0.9 + np.arange(500) ** 2 * 1e-5, 1),  # pixels of a grating
    np.r_[np.arange(350.0, 700), np.arange(700.0, 1000, 5)],
    np.r_[np.arange(360.0, 401, 5), np.arange(410.0, 781, 10)],
    np.sort(1e7 / np.arange(12000, 27000, 64.0)),
    np.arange(400.0, 501, 20),
    np.array([]),
    np.array([550.0]),
]


@pytest.mark.parametrize("wavelength", REGULAR)
def test_grids_of_instruments_have_no_odd_steps(wavelength: np.ndarray) -> None:
    assert odd_steps(wavelength) == []


@given(st.integers(1, 29), st.sampled_from([2.0, 5.0, 10.0]))
def test_a_lost_wavelength_is_an_odd_step(place: int, step: float) -> None:
    whole = 400 + step * np.arange(31)
    assert odd_steps(np.delete(whole, place)) == [(whole[place - 1], whole[place + 1])]


@given(st.integers(1, 29), st.sampled_from([-4.0, -2.0, 2.0, 3.0]))
def test_a_mistyped_wavelength_is_between_odd_steps(place: int, off: float) -> None:
    wavelength = np.arange(400.0, 701, 10)
    wavelength[place] += off
    assert odd_steps(wavelength) == [tuple(wavelength[place - 1 : place + 1]), tuple(wavelength[place : place + 2])]


@pytest.mark.parametrize(
    ("cells", "odd"),
    [
        (["0.10", *["0.11"] * 10, "0.1"], ["0.1 at 11"]),
        (["0,10", *["0,11"] * 10, "0,112"], ["0,112 at 11"]),
        (["1.0e-2", *["1.1e-2"] * 10, "1.12e-2"], ["1.12e-2 at 11"]),
        (["0.1", *["0.11"] * 11], []),  # no zero is kept at the end
        (["10", *["11"] * 11], []),
        (["0.10", *["0.11"] * 5, "0.1"], []),  # too few to tell
        (["0.10", *["0.11"] * 12, "0.1", "0.2", "0.3"], []),  # too many to be mistakes
        (["0.10", *["0.11"] * 12, "nan", ""], []),
        ([], []),
    ],
)
def test_a_number_with_other_decimals_than_the_rest_raises_a_doubt(cells: list[str], odd: list[str]) -> None:
    doubts = odd_decimals(cells, lambda i: f"at {i}")
    assert [doubt.partition(" has another")[0] for doubt in doubts] == odd


@pytest.mark.parametrize(
    ("values", "digit"), [([400, 410], 1), ([0.5, 0.53], 0.01), ([26.0, 26.25], 0.01), ([], 1), ([1 / 3], 0)]
)
def test_the_last_digit_is_that_of_the_longest_number(values: list[float], digit: float) -> None:
    assert last_digit(np.array(values)) == pytest.approx(digit)

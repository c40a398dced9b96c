"""Tables of JCAMP-DX in each form of the standard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.spectra import read_spectrum
from brdfpipe.spectra.formats import jcamp

# The same ordinates in the five forms (McDonald & Wilks 1988, table III shows how each is built).
ORDINATES = [1, 2, 3, 3, 2, 1, 0, -1, -2, -3]
FORMS = {
    "fix": "400 1 2 3 3 2 1 0 -1 -2 -3",
    "packed": "400+1+2+3+3+2+1+0-1-2-3",
    "squeezed": "400ABCCBA@abc",
    "differences": "400AJJ%jjjjjj",
    "duplicates": "400AJT%jX",
}


def document(
    table: str, points: int = 10, first: float = 400, last: float = 409, factor: str = "1", head: str = ""
) -> str:
    return (
        f"##TITLE=sample\n##JCAMP-DX=4.24 $$ a comment\n##XUNITS=NANOMETERS\n##YUNITS=REFLECTANCE\n##XFACTOR=1\n##YFACTOR={factor}\n"
        f"##FIRSTX={first}\n##LASTX={last}\n##NPOINTS={points}\n{head}##XYDATA=(X++(Y..Y))\n{table}\n##END=\n"
    )


@pytest.mark.parametrize("form", FORMS)
def test_each_form_of_the_standard_gives_the_same_table(form: str) -> None:
    ((title, x_unit, y_unit, x, y, _doubts),) = jcamp.blocks(Path("a.jdx"), document(FORMS[form], factor="0.5"))
    assert (title, x_unit, y_unit) == ("sample", "NANOMETERS", "REFLECTANCE")
    assert x.tolist() == list(range(400, 410))
    assert y.tolist() == [value / 2 for value in ORDINATES]


def test_a_line_after_differences_repeats_the_last_ordinate_as_a_check() -> None:
    ((*_, y, _),) = jcamp.blocks(Path("a.jdx"), document("400AJJ%\n403Cjjjjjj"))
    assert y.tolist() == ORDINATES
    with pytest.raises(InputError, match="wrong check value; found 4; accepted: 3"):
        jcamp.blocks(Path("a.jdx"), document("400AJJ%\n403Djjjjjj"))


def test_numbers_of_unpacked_tables_may_have_exponents() -> None:
    ((*_, y, _),) = jcamp.blocks(Path("a.jdx"), document("400 1.5E-1 2e0", 2, last=401))
    assert y.tolist() == [0.15, 2]


@pytest.mark.parametrize(
    ("label", "stated", "found"), [("FIRSTY", 3, 1), ("MAXY", 4, 3), ("MINY", 0, -3), ("DELTAX", 2, 1)]
)
def test_labels_that_contradict_the_table_raise_a_doubt(label: str, stated: float, found: float) -> None:
    for value, doubts in ((found, 0), (stated, 1)):
        ((*_, warnings),) = jcamp.blocks(Path("a.jdx"), document(FORMS["fix"], head=f"##{label}={value}\n"))
        assert len(warnings) == doubts
    assert f"##{label} states {stated}, the table has {found}" in warnings[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document("400 1 2 3", 4), "the table contradicts its header"),
        (document("400 1 2\n408 3 4", 4, last=403), "missing or misplaced lines"),
        (document("400 1 2 3", 3, last=402).replace("##END=", ""), "##END= is missing"),
        (document("400 1 x3", 2), "not a line of numbers"),
        (document("400S3 1", 2), "not a line of numbers"),
        (document("400 S3", 2), "not a line of numbers"),
        (document("400AZ99999999Z99999999", 2), "too many points"),
        (document("", 0), "the table is empty"),
        (document("400 1 2", 2, last=401, factor="0"), "XFACTOR or YFACTOR not above 0"),
        (document("400 1 2", 2).replace("##NPOINTS=2", "##NPOINTS=two"), "##NPOINTS: not a number"),
        (document("400 1 2", 2).replace("XYDATA=(X++(Y..Y))", "XYDATA=(X++(R..R))"), "unsupported form of table"),
        ("##TITLE=x\n##END=\n", "no JCAMP-DX table"),
        ("", "no JCAMP-DX table"),
    ],
)
def test_a_truncated_or_damaged_table_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        jcamp.blocks(Path("a.jdx"), text)


@pytest.mark.parametrize(
    ("old", "new"),
    [("NANOMETERS", "1/CM"), ("=REFLECTANCE", "=TRANSMITTANCE"), ("=REFLECTANCE", "=LOG(1/REFLECTANCE)")],
)
def test_other_quantities_are_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "a.jdx"
    table = "400 " + " ".join(["0.5"] * 31)
    path.write_text(document(table, 31, 400, 700).replace(old, new), encoding="ascii")
    with pytest.raises(InputError, match="not a reflectance over wavelength"):
        read_spectrum(path, geometry="sci")


def test_several_blocks_are_samples(tmp_path: Path) -> None:
    path = tmp_path / "two.dx"
    blocks = [
        document("400 " + " ".join([value] * 31), 31, 400, 700).replace("sample", name)
        for value, name in (("0.5", "one"), ("0.25", "two"))
    ]
    path.write_text("".join(blocks), encoding="ascii")
    assert (read_spectrum(path, geometry="sci", sample="two")["total_reflectance"] == 0.25).all()
    np.testing.assert_array_equal(read_spectrum(path, geometry="sci", sample=1)["wavelength"], np.arange(400, 701, 10))


def test_a_file_of_another_format_is_refused_with_the_key_of_the_format(tmp_path: Path) -> None:
    path = tmp_path / "a.qtx"
    path.write_text("[STANDARD_DATA 0]\nSTD_NAME=a\n", encoding="ascii")
    with pytest.raises(InputError, match="no JCAMP-DX table in the file") as refusal:
        read_spectrum(path, geometry="sci", format="jcamp")
    assert refusal.value.key == "spectrum.format"

"""The specular component that titles, cells and header lines state: no spectrum without it is read as one with it, or the other way round."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from brdfpipe.errors import InputError
from brdfpipe.spectra import read_spectrum
from brdfpipe.vocabulary import validate, warnings

NM = np.arange(400, 701, 10)

EXCLUDED = [
    "SCE", "S.C.E.", "RSCE", "R_SCE [%]", "SCE1", "SCE_Avg", "SCEmean", "SPEX", "SPEXC", "SpEx 1", "RSEX", "Specular Excl", "R% (spec. excl.)",
    "specular_excluded", "SpecularExcluded", "Specular component excl.", "excl. specular", "Specular, excluded", "specular not included", "R w/o specular",
    "d/8e", "d8e", "de:8", "8°:de", "8/de", "gloss excluded", "with gloss trap", "Glanz ausgeschlossen", "ohne Glanz", "spéculaire exclu(e)", "sans brillant",
    "Specular: no", "SCI/SCE: E", "Gloss: Ex", "SPEC: -", "SCI: no",
    "Glanzanteil: ohne", "Glanzanteil: nein", "Glanzkomponente: nein", "Spekulare Komponente: nein", "Glanzeinschluss: nein", "Composante spéculaire: non",
    "Composante spéculaire: non comprise", "Sans composante spéculaire", "sans la composante spéculaire", "hors spéculaire", "no specular", "Glanzfalle: offen",
    "Glanzfalle offen", "gloss trap open", "Gloss trap: in", "Specular port: open", "Specular port open", "Glanzausschluss", "ohne Glanzeinschluss", "o. Glanz",
    "ohne die Glanzkomponente", "specular removed", "Specular component: removed", "Specular component exclusion", "Glanzausschluss: ja",
    "composante spéculaire non comprise", "without specular inclusion",
]  # fmt: skip
INCLUDED = [
    "SCI", "S.C.I.", "RSCI", "R_SCI [%]", "SCI1", "SCI_Avg", "SCImean", "SPIN", "SPINC", "SpIn 1", "RSIN", "Specular Incl", "R% (spec. incl.)",
    "specular_included", "SpecularIncluded", "Specular component incl.", "incl. specular", "Specular, included", "specular not excluded", "R with specular",
    "d/8i", "d8i", "di:8", "8°:di", "8/di", "gloss included", "without gloss trap", "Glanz eingeschlossen", "mit Glanz", "spéculaire inclus(e)", "avec brillant",
    "Specular: yes", "SCI/SCE: I", "Gloss: In", "SPEC: +", "SCE: no",
    "Glanzanteil: mit", "Glanzanteil: ja", "Glanzkomponente: ja", "Spekulare Komponente: ja", "Glanzeinschluss: ja", "Composante spéculaire: oui",
    "Composante spéculaire: comprise", "Avec composante spéculaire", "avec la composante spéculaire", "y compris spéculaire", "Glanzfalle: geschlossen",
    "Glanzfalle geschlossen", "gloss trap closed", "no gloss trap", "Gloss trap: out", "Specular port: closed", "Specular port closed", "Glanzeinschluss",
    "ohne Glanzausschluss", "m. Glanz", "mit der Glanzkomponente", "specular not removed", "Specular component: not removed", "Specular component inclusion",
    "Glanzausschluss: nein", "composante spéculaire comprise", "without specular exclusion",
]  # fmt: skip
NEITHER = [
    "R", "Sample excluded", "UV excluded", "Scene 1", "SCIENCE", "by SciPy 1.11", "Rev. Sci. Instrum. 80", "luminance", "spin coated", "sin θ", "Example 2", "Ex 1",
    "high gloss ex. 3", "Gloss in GU", "Glanz in %", "Specular in percent", "species", "specimen excl. 3", "inclusion", "Index", "In", "pas de 8 nm", "d/8 i.e. sphere",
    "Comment: excluded", "Gloss: 1", "Gloss: -", "spectral range excluded", "exit slit",
    "dE8", "dE: 8", "Sci-Fi blue", "Spin", "spin 3", "Specular No. 3", "high gloss, no UV", "Component: no", "exclusion", "Glanzgrad: nein", "Gloss not measured",
    "Cover open", "Sensor port open", "coating removed", "gloss at 60° minus gloss at 20°",
]  # fmt: skip
LABELS = [*((words, "sce") for words in EXCLUDED), *((words, "sci") for words in INCLUDED)]


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path, **options) -> xr.Dataset:
    return validate(read_spectrum(path, **{"geometry": "sci", "scale": "percent", **options}), "spectrum")


def labelled(title: str, cell: str, name: str = "red") -> str:
    """A sample of 40 % in a row with a cell below a title, and another one without."""
    head = ";".join(["sample", title, *map(str, NM)])
    return "\n".join([head, *(";".join([name, label, *["40"] * NM.size]) for label in (cell, ""))]) + "\n"


def titled(*titles: str, above: str = "") -> str:
    """Columns of 24 to 27, 34 to 37 % … below titles."""
    rows = (";".join([str(nm), *(f"{20 + 10 * k + nm / 100:g}" for k in range(len(titles)))]) for nm in NM)
    return "\n".join([*([above] if above else []), ";".join(["nm", *titles]), *rows]) + "\n"


@pytest.mark.parametrize(("words", "kind"), LABELS)
def test_words_for_the_specular_component_are_understood_wherever_they_stand(
    tmp_path: Path, words: str, kind: str
) -> None:
    other = {"sci": "sce", "sce": "sci"}[kind]
    options = {"geometry": other}
    # The title of a column: the other one is read, and alone it is refused.
    two = read(write(tmp_path, "two.csv", titled(words, "R")), **options)
    assert float(two["total_reflectance"][0]) == pytest.approx(0.34)
    with pytest.raises(InputError, match=f"labelled {kind.upper()}, and the description says {other.upper()}"):
        read(write(tmp_path, "one.csv", titled(words)), **options)
    # A cell of a row of values.
    title, _, cell = words.rpartition(": ")
    path = write(tmp_path, "rows.csv", labelled(title or "Mode", cell))
    with pytest.raises(InputError, match=f"labelled {kind.upper()}, and the description says {other.upper()}"):
        read(path, **options, sample=1)
    # A header line speaks of the file: the description counts, with a warning.
    spectrum = read(write(tmp_path, "line.csv", titled("R", above=words)), **options)
    assert f"the header says {kind.upper()}; `spectrum.geometry: {other}`" in " ".join(warnings(spectrum))
    assert read(write(tmp_path, "line.csv", titled("R", above=words)), geometry=None).attrs["geometry"] == kind


@pytest.mark.parametrize("words", NEITHER)
@pytest.mark.parametrize("geometry", ["sci", "sce"])
def test_words_that_only_resemble_those_for_the_specular_component_are_none(
    tmp_path: Path, words: str, geometry: str
) -> None:
    for text in (titled(words), titled("R", above=words)):
        assert warnings(read(write(tmp_path, "one.csv", text), geometry=geometry)) == []
    title, _, cell = words.rpartition(": ")
    path = write(tmp_path, "rows.csv", labelled(title or "Note", cell))
    assert warnings(read(path, geometry=geometry, sample=1)) == []


@pytest.mark.parametrize("title", ["Excluded", "R excl. [%]", "Excl"])
def test_the_bare_word_is_a_label_of_a_column_and_not_of_a_comment(tmp_path: Path, title: str) -> None:
    with pytest.raises(InputError, match="labelled SCE, and the description says SCI"):
        read(write(tmp_path, "one.csv", titled(title)))
    assert warnings(read(write(tmp_path, "one.csv", titled("R", above=f"Outliers: {title}")))) == []


@pytest.mark.parametrize(
    "above",
    [
        "Mode;SCE;SCI", ";SCE;SCI", ";specular excl.;specular incl.", "SCI/SCE;E;I", "Specular;no;yes", "# Mode;SCE;SCI", "Mode;SCE;SCI;;",
        "Mode;SCE;SCI\nDate;3 May;4 May", ";Specular;Specular\n;Ex;In", "Report\nMode;SCE;SCI",
    ],
)  # fmt: skip
def test_labels_stand_in_any_row_above_the_numbers(tmp_path: Path, above: str) -> None:
    for separator in (";", "\t"):
        text = titled("first", "second", above=above).replace(";", separator)
        path = write(tmp_path, "two.csv", text)
        for geometry, value in (("sci", 0.34), ("sce", 0.24)):
            spectrum = read(path, geometry=geometry)
            assert float(spectrum["total_reflectance"][0]) == pytest.approx(value)
            assert warnings(spectrum) == []
        with pytest.raises(InputError, match="labelled SCE, and the description says SCI"):
            read(path, column="first")


def test_labels_of_joined_cells_are_those_of_the_columns_below_them(tmp_path: Path) -> None:
    above = "Mode;SCE;;SCI;"
    path = write(tmp_path, "four.csv", titled("red", "blue", "red", "blue", above=above))
    assert float(read(path)["total_reflectance"][0]) == pytest.approx(0.44)
    with pytest.raises(InputError, match="labelled SCE"):
        read(path, column=3)


@pytest.mark.parametrize("above", ["Mode;SCE;SCE", "Specular;no;no", "SCI/SCE;E;", "Specular Component;Excluded;;"])
def test_a_row_that_says_the_same_of_all_columns_is_a_header_line(tmp_path: Path, above: str) -> None:
    path = write(tmp_path, "two.csv", titled("red", "blue", above=above))
    assert "the header says SCE" in " ".join(warnings(read(path, column="blue")))


@pytest.mark.parametrize(
    "above", ["Outliers;Excluded", "Mode;specular\nFilter;excl.", "Outliers;Excluded;\nMean of;3 places;"]
)
def test_cells_of_different_rows_make_no_label(tmp_path: Path, above: str) -> None:
    assert warnings(read(write(tmp_path, "one.csv", titled("R", above=above)))) == []


def test_a_sentence_above_blank_separated_columns_is_no_row_of_labels(tmp_path: Path) -> None:
    text = titled("R", "S", above="Specular excluded measurement").replace(";", " ")
    assert "the header says SCE" in " ".join(warnings(read(write(tmp_path, "two.txt", text))))


UNCLEAR = "'{}' may say whether the specular component is included, and was not understood. Compare `spectrum.geometry`"


@pytest.mark.parametrize(
    "words", ["specular corrected, gloss partly excl", "SCI/SCE", "spec. data partly excl.", "specular was nearly excluded"]
)  # fmt: skip
def test_words_that_are_not_understood_are_warned_about(tmp_path: Path, words: str) -> None:
    messages = warnings(read(write(tmp_path, "one.csv", titled(words))))
    assert UNCLEAR.format(words) in messages[0]
    path = write(tmp_path, "rows.csv", labelled("Mode", words.replace(",", " ")))
    assert "and was not understood" in warnings(read(path, sample=1))[0]


@pytest.mark.parametrize("words", ["Excluded", "excl.", "exclu", "ausgeschl.", "# Excluded", "Included"])
def test_a_header_line_of_the_bare_word_is_warned_about(tmp_path: Path, words: str) -> None:
    path = write(tmp_path, "line.csv", titled("R", above=words))
    assert UNCLEAR.format(words.lstrip("# ")) in " ".join(warnings(read(path)))
    with pytest.raises(InputError, match="geometry"):
        read(path, geometry=None)


@pytest.mark.parametrize(
    "words", ["non-specular", "no gloss", "specular: off-axis", "Specular incl/excl", "specular trap removed"]
)
def test_a_component_beside_a_negation_is_warned_about_where_it_is_not_understood(tmp_path: Path, words: str) -> None:
    for geometry in ("sci", "sce"):
        for text in (titled(words), titled("R", above=words)):
            messages = warnings(read(write(tmp_path, "one.csv", text), geometry=geometry))
            assert UNCLEAR.format(words) in " ".join(messages)


@pytest.mark.parametrize(("first", "second"), [("zu", "auf"), ("on", "off"), ("+", "-"), ("Ja", "Nein")])
def test_rows_of_one_name_with_opposite_words_that_are_not_understood_are_warned_about(
    tmp_path: Path, first: str, second: str
) -> None:
    text = labelled("Klappe", first, "red").replace("\nred;;", f"\nred;{second};")
    for number, word in enumerate((first, second), 1):
        assert UNCLEAR.format(f"Klappe: {word}") in " ".join(
            warnings(read(write(tmp_path, "rows.csv", text), sample=number))
        )
    for plain in (
        text.replace("Klappe", "UV"),
        text.replace("\nred", "\nblue", 1),
        text.replace(f";{second};", ";3 May;"),
    ):
        assert warnings(read(write(tmp_path, "rows.csv", plain), sample=1)) == []


def test_french_titles_of_both_kinds_are_told_apart(tmp_path: Path) -> None:
    path = write(tmp_path, "two.csv", titled("Sans composante spéculaire", "Avec composante spéculaire"))
    for geometry, value in (("sci", 0.34), ("sce", 0.24)):
        spectrum = read(path, geometry=geometry)
        assert float(spectrum["total_reflectance"][0]) == pytest.approx(value)
        assert warnings(spectrum) == []


def test_labels_that_contradict_each_other_are_warned_about(tmp_path: Path) -> None:
    path = write(tmp_path, "rows.csv", labelled("Mode", "SCE", "red SCI"))
    assert "'red SCI, Mode: SCE' may say" in warnings(read(path, sample=1))[0]


VALUES = [f"{20 + nm / 100:g}" for nm in NM]
CGATS = (
    f"CTI3\n{{line}}\nNUMBER_OF_FIELDS 32\nBEGIN_DATA_FORMAT\nSAMPLE_ID {' '.join(f'SPEC_{nm}' for nm in NM)}\nEND_DATA_FORMAT\n"
    f"NUMBER_OF_SETS 1\nBEGIN_DATA\n1 {' '.join(VALUES)}\nEND_DATA\n"
)
JCAMP = f"##TITLE=red\n{{line}}\n##XUNITS=NANOMETERS\n##YUNITS=% REFLECTANCE\n##XYPOINTS=(XY..XY)\n{' '.join(f'{nm},{value}' for nm, value in zip(NM, VALUES, strict=True))}\n##END=\n"
PERKINELMER = "\n".join(
    ["PE UV SUBTECH SPECTRUM ASCII", "-1", "red.sp", "{line}", "#HDR", "-1", "#GR", "nm", "%R", "1.0", "0.0", "400.0", "10.0", "31", "4", "100.0", "0.0", "#DATA"]
    + [f"{nm} {value}" for nm, value in zip(NM, VALUES, strict=True)]
)  # fmt: skip
QTX = f"[STANDARD_DATA 0]\nSTD_NAME=red\n{{line}}\nSTD_REFLPOINTS=31,\nSTD_REFLINTERVAL=10,\nSTD_REFLLOW=400,\nSTD_R={','.join(VALUES)},\n"


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.ti3", CGATS, 'MEASUREMENT_GEOMETRY "de:8"'),
        ("a.jdx", JCAMP, "##SPECULAR COMPONENT=excluded"),
        ("a.asc", PERKINELMER, "sphere, spec. excl."),
        ("a.qtx", QTX, "STD_VIEWING=Specular Excl"),
    ],
)
def test_header_lines_of_containers_are_compared(tmp_path: Path, name: str, text: str, line: str) -> None:
    path = write(tmp_path, name, text.format(line=line))
    assert "the header says SCE; `spectrum.geometry: sci`" in " ".join(warnings(read(path)))
    assert read(path, geometry=None).attrs["geometry"] == "sce"

"""YAML documents: what is read, what is refused, and in which words."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Annotated

import pytest
from annotated_types import MaxLen
from pydantic import Strict

from brdfpipe import documents
from brdfpipe.catalogue.material_keys import Material
from brdfpipe.descriptions import reading
from brdfpipe.descriptions.keys import Keys, OneOf, key
from brdfpipe.errors import InputError


class Part(Keys):
    size: float = key("", default=3)


class Description(Keys):
    not_together = (("units", "pair"),)

    count: float = key("a number", required=True, ge=1, le=9)
    colour: Annotated[str, OneOf(("red", "green"))] = key("red or green")
    title: str = key("a text")
    part: Part = key("", default=Part())
    units: Annotated[list[Annotated[str, OneOf(("nm", "um", "mm"))]], MaxLen(3)] = key("units")
    pair: Annotated[tuple[float, float], Strict(False)] = key("two numbers")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.yaml"


def read(path: Path, text: str | bytes) -> dict[str, object]:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return reading.read(path, Description)


def test_absent_keys_get_their_declared_defaults_in_depth(path: Path) -> None:
    assert read(path, "count: 1") == {"count": 1, "part": {"size": 3}}


def test_a_number_in_scientific_notation_needs_no_dot(path: Path) -> None:
    assert read(path, "count: 5e0")["count"] == 5.0


def test_a_byte_order_mark_is_no_error(path: Path) -> None:
    assert read(path, b"\xef\xbb\xbfcount: 2")["count"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("count: 1\ncolor: red", "a.yaml, line 2: unknown key 'color'; did you mean 'colour'?; accepted: count, colour, title, part, units, pair"),
        ("count: many", "a.yaml, line 1, count: not an accepted value; found 'many'; accepted: a number from 1 to 9"),
        ("count: 0", "a.yaml, line 1, count: not an accepted value; found 0; accepted: a number from 1 to 9"),
        ("count: 1\ncolour: gren", "a.yaml, line 2, colour: not an accepted value; did you mean 'green'?; found 'gren'; accepted: red, green"),
        ("title: x", "a.yaml, line 1: the key 'count' is missing; accepted: a number from 1 to 9"),
        ("count: 1\ncount: 2", "a.yaml, line 2: duplicate key 'count'; accepted: each key once"),
        ("count: 1\npart: {size: big}", "a.yaml, line 2, part.size: not an accepted value; found 'big'; accepted: a number"),
        ("count: .inf", "a.yaml, line 1: not a finite number; found .inf; accepted: a number"),
        ("count: 1\nunits: um", "a.yaml, line 2, units: not an accepted value; found 'um'; accepted: a list: [um]"),
        ("count: 1\nunits: {}", "a.yaml, line 2, units: not an accepted value; found {}; accepted: a list, units"),
        ("count: 1\nunits: [cm]", "a.yaml, line 2, units.0: not an accepted value; found 'cm'; accepted: nm, um, mm"),
        ("- 1", "a.yaml, line 1: not an accepted value; found [1]; accepted: a mapping of keys: count, colour, title, part, units, pair"),
        ("count: 1\npair: []\nunits: []", "a.yaml, line 1: `units` and `pair` exclude each other; accepted: either `units` or `pair`"),
        ("# count: 1", "a.yaml: the key 'count' is missing; accepted: a number from 1 to 9"),
        ("", "a.yaml: empty; accepted: keys and values"),
        ("1.5: 2", "a.yaml, line 1: a key is not plain text; accepted: a word before the colon"),
        ("count: 1\n60: 2", "a.yaml, line 2: unknown key '60'; accepted: count, colour, title, part, units, pair"),
    ],
)  # fmt: skip
def test_a_wrong_document_is_refused_in_one_line(path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(path, text)
    assert str(refusal.value) == message


FINISH = "surface: {distribution: flat}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FINISH + "index: {n=1.2}", "line 2, index: unknown key 'n=1.2'; write `n: 1.2`; accepted: file; or n, k"),
        (FINISH + "index: {}", "line 2, index: an empty mapping; accepted: file; or n, k"),
        (FINISH + "index: {flie: a}", "line 2, index: unknown key 'flie'; did you mean 'file'?; accepted: file; or n, k"),
        (FINISH + "index: {file: a, unit: nm}", "line 2, index: unknown key 'unit'; accepted: file"),
        ("surface: {slope_rms: 0.1}\nindex: PP", "line 1, surface: unknown key 'slope_rms'; .*; or distribution, a, slopes, slope_rms"),
        (FINISH + "index: PP\nrecipe: crf", "line 3: unknown key 'recipe'; it belongs to `model`: `model: {recipe: …}`; accepted"),
        (FINISH + "index: PP\nlab: [30, 1, 1]", "line 3: unknown key 'lab'; it belongs to `spectrum`, `measured`; accepted"),
        (FINISH + "index: PP\nform: plane", "line 3: unknown key 'form'; it belongs to `surface`, `multiangle`; accepted"),
        (FINISH + "index: PP\nspectrun: {}", "line 3: unknown key 'spectrun'; did you mean 'spectrum'?; accepted"),
    ],
)  # fmt: skip
def test_a_key_at_the_wrong_place_is_refused_with_the_right_place(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "material.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        reading.read(path, Material)
    start, _, end = message.partition(".*")
    assert str(refusal.value).startswith(f"material.yaml, {start}")
    assert end in str(refusal.value)


@pytest.mark.parametrize("text", ["count: 0,1", "count: 1\npair: [0,5, 0,5]", "{part: {}, count: 0,1}"])
def test_a_decimal_comma_is_distinguished_from_other_mistakes(path: Path, text: str) -> None:
    with pytest.raises(InputError, match="numbers take a decimal point, not a comma"):
        read(path, text)


@pytest.mark.parametrize("text", ["title: 0,1", "count: many", "pair: [1, 2, 3]"])
def test_other_mistakes_are_not_taken_for_a_decimal_comma(path: Path, text: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(path, text)
    assert "decimal" not in str(refusal.value)


def test_every_problem_is_listed(path: Path) -> None:
    with pytest.raises(InputError) as refusal:
        read(path, "count: 0\ncolour: blue\nunits: [parsec]")
    assert "line 1, count" in str(refusal.value)
    assert [" ".join(text.split()[1:3]) for text in refusal.value.others] == ["line 2,", "line 3,"]
    assert pickle.loads(pickle.dumps(refusal.value)).others == refusal.value.others


def test_a_yes_where_a_word_is_expected_is_explained(path: Path) -> None:
    with pytest.raises(InputError, match="YAML reads yes"):
        read(path, "count: 1\nunits: [yes]")


@pytest.mark.parametrize("unit", ["um", "UM", "\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"])
def test_a_listed_word_is_taken_in_any_case_and_with_either_letter_mu(path: Path, unit: str) -> None:
    assert read(path, f"count: 1\nunits: [{unit}]")["units"] == ["um"]


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("count: 1\ntitle: [", "line 2"),
        ("count: 1\ntitle: no", "needs quotes"),
        ("count: 1\ntitle: 2024-01-01", "needs quotes"),
        ("count: 1\ntitle: 2024-13-45", "cannot be read"),
        ("count: 0\ncolour: blue", r"\(and 1 more problem\)"),
        ("count: &a 1\npart: {size: *a}", "alias"),
        ("a: &a [1]\nb: &b [*a, *a]\nc: &c [*b, *b]", "alias"),
        ("count: !!python/object/apply:os.system [ls]", "not valid YAML"),
        ("count: 1\n---\ncount: 2", "not valid YAML"),
        ("{a: 1, <<: {b: 2}}", "a key is not plain text"),
        ("? [1]\n: 2", "a key is not plain text"),
        ("- 1", "not an accepted value"),
        (b"count: 1\x00", "not valid YAML"),
        (b"title: \xff\xfe", "not UTF-8"),
        ("[" * 5000, "YAML|deeply"),
    ],
)
def test_unsafe_yaml_is_refused(path: Path, text: str | bytes, pattern: str) -> None:
    with pytest.raises(InputError, match=pattern) as refusal:
        read(path, text)
    assert "\n" not in str(refusal.value)


def test_a_large_document_is_refused_unread(path: Path) -> None:
    with pytest.raises(InputError, match="too large"):
        read(path, "#" * (documents.MAX_BYTES + 1))


def test_a_missing_document_is_refused(path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        reading.read(path, Description)


def test_a_deeply_nested_document_is_refused_without_a_crash(path: Path) -> None:
    with pytest.raises(InputError, match="nested too deeply"):
        read(path, "description: " + "[" * 40_000 + "]" * 40_000)


@pytest.mark.parametrize(
    "text",
    ["surface:\n\tfile: a.x3p\n", "a: 1\nsurface:\n  file: a.x3p\n\tunit: um\n", "a:\n - 1\n -\t\tb: 2\n\tc: 3\n"],
)
def test_a_tab_is_called_a_tab(tmp_path: Path, text: str) -> None:
    path = tmp_path / "material.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"line \d+: a tab in the indentation; YAML takes spaces alone"):
        documents.read_yaml(path)

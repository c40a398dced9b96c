"""YAML documents: what is read, what is refused, and in which words."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe import documents
from brdfpipe.errors import InputError

SCHEMA = """
type: object
additionalProperties: false
required: [count]
properties:
  count: {description: a number from 1 to 9, type: number, minimum: 1, maximum: 9}
  colour: {description: red or green, enum: [red, green]}
  title: {description: a text, type: string}
  part: {$ref: "#/$defs/part"}
  units: {description: units, type: array, maxItems: 3, items: {enum: [nm, um, mm]}}
  pair: {description: two numbers, type: array, maxItems: 2, items: {type: number}}
not: {required: [units, pair]}
$defs:
  part:
    type: object
    additionalProperties: false
    default: {}
    properties:
      size: {type: number, default: 3}
"""


@pytest.fixture
def schema(tmp_path: Path) -> Path:
    path = tmp_path / "a.schema.yaml"
    path.write_text(SCHEMA)
    return path


def read(schema: Path, text: str | bytes) -> dict[str, object]:
    path = schema.with_name("a.yaml")
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return documents.read(path, schema)


def test_absent_keys_get_the_schemas_defaults_in_depth(schema: Path) -> None:
    assert read(schema, "count: 1") == {"count": 1, "part": {"size": 3}}


def test_a_number_in_scientific_notation_needs_no_dot(schema: Path) -> None:
    assert read(schema, "count: 5e0")["count"] == 5.0


def test_a_byte_order_mark_is_no_error(schema: Path) -> None:
    assert read(schema, b"\xef\xbb\xbfcount: 2")["count"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("count: 1\ncolor: red", "a.yaml, line 2: unknown key 'color'; did you mean 'colour'?; accepted: count, colour, title, part, units, pair"),
        ("count: many", "a.yaml, line 1, count: not an accepted value; found 'many'; accepted: a number from 1 to 9"),
        ("count: 0", "a.yaml, line 1, count: not an accepted value; found 0; accepted: a number from 1 to 9"),
        ("count: 1\ncolour: gren", "a.yaml, line 2, colour: not an accepted value; did you mean 'green'?; found 'gren'; accepted: red, green"),
        ("title: x", "a.yaml, line 1: the key 'count' is missing; accepted: a number from 1 to 9"),
        ("count: 1\ncount: 2", "a.yaml, line 2: the key 'count' stands twice; accepted: each key once"),
        ("count: 1\npart: {size: big}", "a.yaml, line 2, part.size: not an accepted value; found 'big'; accepted: number"),
        ("count: .inf", "a.yaml, line 1: not a finite number; found .inf; accepted: a number"),
        ("count: 1\nunits: um", "a.yaml, line 2, units: not an accepted value; found 'um'; accepted: a list: [um]"),
        ("count: 1\nunits: {}", "a.yaml, line 2, units: not an accepted value; found {}; accepted: a list, units"),
        ("count: 1\nunits: [cm]", "a.yaml, line 2, units.0: not an accepted value; found 'cm'; accepted: nm, um, mm"),
        ("- 1", "a.yaml, line 1: not an accepted value; found [1]; accepted: a mapping of keys: count, colour, title, part, units, pair"),
        ("count: 1\npair: []\nunits: []", "a.yaml, line 1: `units` and `pair` stand together; accepted: either `units` or `pair`"),
        ("# count: 1", "a.yaml: the key 'count' is missing; accepted: a number from 1 to 9"),
        ("", "a.yaml: empty; accepted: keys and values"),
        ("1: 2", "a.yaml, line 1: a key is not plain text; accepted: a word before the colon"),
    ],
)  # fmt: skip
def test_a_wrong_document_is_refused_in_one_line(schema: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(schema, text)
    assert str(refusal.value) == message


MATERIAL = Path(__file__).parents[1] / "config" / "schemas" / "material.schema.yaml"
FINISH = "surface: {distribution: flat}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FINISH + "index: {n=1.2}", "line 2, index: unknown key 'n=1.2'; write `n: 1.2`; accepted: file; or n, k"),
        (FINISH + "index: {}", "line 2, index: nothing is said; accepted: file; or n, k"),
        (FINISH + "index: {flie: a}", "line 2, index: unknown key 'flie'; did you mean 'file'?; accepted: file; or n, k"),
        (FINISH + "index: {file: a, unit: nm}", "line 2, index: unknown key 'unit'; accepted: file"),
        ("surface: {slope_rms: 0.1}\nindex: PP", "line 1, surface: unknown key 'slope_rms'; .*; or distribution, a, slope_rms"),
        (FINISH + "index: PP\nrecipe: crf", "line 3: unknown key 'recipe'; it stands in `model`: `model: {recipe: …}`; accepted"),
        (FINISH + "index: PP\nlab: [30, 1, 1]", "line 3: unknown key 'lab'; it stands in `spectrum`: `spectrum: {lab: …}`"),
        (FINISH + "index: PP\nform: plane", "line 3: unknown key 'form'; it stands in `surface`, `multiangle`; accepted"),
        (FINISH + "index: PP\nspectrun: {}", "line 3: unknown key 'spectrun'; did you mean 'spectrum'?; accepted"),
    ],
)  # fmt: skip
def test_a_key_at_the_wrong_place_is_told_the_right_one(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "material.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        documents.read(path, MATERIAL)
    start, _, end = message.partition(".*")
    assert str(refusal.value).startswith(f"material.yaml, {start}")
    assert end in str(refusal.value)


@pytest.mark.parametrize("text", ["count: 0,1", "count: 1\npair: [0,5, 0,5]", "{part: {}, count: 0,1}"])
def test_a_decimal_comma_is_told_from_other_mistakes(schema: Path, text: str) -> None:
    with pytest.raises(InputError, match="numbers take a decimal point, not a comma"):
        read(schema, text)


@pytest.mark.parametrize("text", ["title: 0,1", "count: many", "pair: [1, 2, 3]"])
def test_other_mistakes_are_not_taken_for_a_decimal_comma(schema: Path, text: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(schema, text)
    assert "decimal" not in str(refusal.value)


@pytest.mark.parametrize("unit", ["um", "UM", "\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"])
def test_a_listed_word_is_taken_in_any_case_and_with_either_letter_mu(schema: Path, unit: str) -> None:
    assert read(schema, f"count: 1\nunits: [{unit}]")["units"] == ["um"]


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
def test_what_cannot_be_trusted_is_refused(schema: Path, text: str | bytes, pattern: str) -> None:
    with pytest.raises(InputError, match=pattern) as refusal:
        read(schema, text)
    assert "\n" not in str(refusal.value)


def test_a_large_document_is_refused_unread(schema: Path) -> None:
    with pytest.raises(InputError, match="too large"):
        read(schema, "#" * (documents.MAX_BYTES + 1))


def test_a_missing_document_is_refused(schema: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        documents.read(schema.with_name("none.yaml"), schema)


def test_a_bottomless_document_is_refused_and_not_a_crash(schema: Path) -> None:
    with pytest.raises(InputError, match="nested too deeply"):
        read(schema, "description: " + "[" * 40_000 + "]" * 40_000)

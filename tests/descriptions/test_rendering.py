"""A key is declared in one place; validation, messages, template, editor schema and documentation follow."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import pytest
import yaml

from brdfpipe.catalogue.material_keys import MeasuredSurface
from brdfpipe.descriptions import reading, rendering
from brdfpipe.descriptions.keys import Keys, OneOf, key
from brdfpipe.errors import InputError


class Toy(Keys):
    """A block with one key."""

    stiffness: float = key(
        "stiffness of the toy; stiff toys ring",
        default=2.5,
        unit="N/m",
        gt=0,
        le=10,
        details="See [toys](#toys).",
        stage="toy",
    )
    colour: Annotated[str, OneOf(lambda: ("red", "green"))] = key("red or green", required=True, example="red")


def test_a_key_declared_once_is_validated(tmp_path: Path) -> None:
    path = tmp_path / "toy.yaml"
    path.write_text("colour: Green\n")
    assert reading.read(path, Toy) == {"stiffness": 2.5, "colour": "green"}
    for text, message in {
        "colour: red\nstiffness: 11": "toy.yaml, line 2, stiffness: not an accepted value; found 11; "
        "accepted: stiffness of the toy; stiff toys ring [N/m], above 0 and at most 10",
        "colour: red\nstifness: 1": "toy.yaml, line 2: unknown key 'stifness'; did you mean 'stiffness'?; accepted: stiffness, colour",
    }.items():
        path.write_text(text)
        with pytest.raises(InputError) as refusal:
            reading.read(path, Toy)
        assert str(refusal.value) == message


def test_a_key_declared_once_is_in_the_template(tmp_path: Path) -> None:
    text = rendering.template(Toy, "A toy.")
    assert text.splitlines() == [
        "# A toy.",
        "",
        "stiffness: 2.5                # stiffness of the toy [N/m]",
        "",
        "colour: red                   # red or green",
    ]
    path = tmp_path / "toy.yaml"
    path.write_text(text)
    assert reading.read(path, Toy) == {"stiffness": 2.5, "colour": "red"}


def test_a_key_declared_once_is_in_the_editor_schema() -> None:
    schema = json.loads(rendering.editor_schema(Toy))
    assert schema["properties"]["stiffness"] == {
        "type": "number",
        "exclusiveMinimum": 0,
        "maximum": 10,
        "default": 2.5,
        "description": "stiffness of the toy; stiff toys ring",
    }
    assert schema["properties"]["colour"] == {"enum": ["red", "green"], "description": "red or green"}
    assert (schema["required"], schema["additionalProperties"]) == (["colour"], False)


def test_a_key_declared_once_is_in_the_documentation() -> None:
    page = rendering.with_tables(
        "Toys\n<!-- keys: toy -->\nold\n<!-- end -->\nend", {"toy": rendering.table(Toy, "toy.")}
    )
    assert "old" not in page
    assert (
        "| `toy.stiffness` | a number above 0 and at most 10 [N/m] | `2.5` | Stiffness of the toy; stiff toys ring. See [toys](#toys). |"
        in page.splitlines()
    )
    assert "| `toy.colour` | `red` `green` | needed | red or green. |" in page.splitlines()


def test_a_key_declared_once_belongs_to_its_stage() -> None:
    assert Toy.read_by("toy") == ("stiffness",)


def test_a_page_without_the_place_of_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="0 places for the table 'toy'"):
        rendering.with_tables("Toys", {"toy": ""})


@pytest.mark.parametrize(
    "value", ["plain", "a: b", "", "45as15", "# no", 0.5, [1, [2, "x"]], {"file": "a.txt", "unit": "1/mm"}, True]
)
def test_a_value_in_one_line_is_yaml_for_that_value(value: object) -> None:
    assert yaml.safe_load(f"key: {rendering.flow(value)}") == {"key": value}


def test_registries_are_listed_in_the_editor_schema() -> None:
    from brdfpipe.surfaces.reading import FORMATS

    assert json.loads(rendering.editor_schema(MeasuredSurface))["properties"]["format"]["enum"] == list(FORMATS)

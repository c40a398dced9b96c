"""Templates, editor schemas and key tables follow from the declared keys; `make keys` writes them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from brdfpipe.catalogue import generated_files
from brdfpipe.descriptions.keys import Keys
from brdfpipe.descriptions.reading import declared
from brdfpipe.descriptions.rendering import _blocks

PROJECT = Path(__file__).parents[2]
FILES = generated_files.files(PROJECT)


@pytest.mark.parametrize("path", FILES)
def test_a_generated_file_is_up_to_date(path: str) -> None:
    assert (PROJECT / path).read_text("utf-8").splitlines() == FILES[path].splitlines(), "run `make keys`"


def test_no_other_schema_is_shipped() -> None:
    shipped = {f"config/schemas/{file.name}" for file in (PROJECT / "config" / "schemas").iterdir()}
    assert shipped == set(generated_files.editor_schemas())


def blocks(model: Any) -> Iterator[type[Keys]]:
    for block in _blocks(model):
        yield block
        for field in block.declared_keys().values():
            yield from blocks(field.annotation)


@pytest.mark.parametrize("name", generated_files.DESCRIPTIONS)
def test_every_key_has_a_help_of_one_line(name: str) -> None:
    for block in blocks(generated_files.DESCRIPTIONS[name]):
        for key, field in block.declared_keys().items():
            assert field.description, f"{block.__name__}.{key}"
            assert "\n" not in field.description
            assert not field.description.endswith(".")


def test_every_description_of_the_examples_fits_its_editor_schema() -> None:
    validated = 0
    for name in generated_files.DESCRIPTIONS:
        schema = json.loads(FILES[f"config/schemas/{name}.schema.json"])
        jsonschema.Draft202012Validator.check_schema(schema)
        files = [*(PROJECT / "examples").rglob(f"{name}.yaml"), *(PROJECT / "config").glob(f"{name}.yaml")]
        for file in files:
            jsonschema.validate(yaml.safe_load(file.read_text("utf-8")), schema)
        validated += len(files)
    assert validated > 10


def test_values_of_registries_are_those_of_the_registries() -> None:
    from brdfpipe.spectra.formats.registry import FORMATS

    assert declared(generated_files.material_keys.MeasuredSpectrum, ["format"]).choices == tuple(FORMATS)


def test_the_configuration_of_the_project_has_a_value_for_every_declared_key_and_no_other() -> None:
    configuration = yaml.safe_load((PROJECT / "config" / "config.yaml").read_text("utf-8"))
    assert dotted_keys(configuration) == declared_keys(generated_files.Config)


def dotted_keys(content: dict[str, Any]) -> set[str]:
    blocks = {name: value for name, value in content.items() if isinstance(value, dict)}
    inner = {f"{name}.{key}" for name, value in blocks.items() for key in dotted_keys(value)}
    return inner | (content.keys() - blocks.keys())


def declared_keys(model: type[Keys]) -> set[str]:
    fields = {name: field.annotation for name, field in model.declared_keys().items()}
    blocks = {name: block for name, block in fields.items() if isinstance(block, type) and issubclass(block, Keys)}
    inner = {f"{name}.{key}" for name, block in blocks.items() for key in declared_keys(block)}
    return inner | (fields.keys() - blocks.keys())

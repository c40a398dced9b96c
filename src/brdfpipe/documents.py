"""YAML documents people write: read strictly, validated against a JSON schema, refused in their own words.

Untrusted text: only plain values are built, aliases (which can expand without end), repeated keys and large files are refused.
"""

from __future__ import annotations

import difflib
import json
import re
import unicodedata
from collections.abc import Iterable, Mapping
from datetime import date
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from brdfpipe.errors import InputError

MAX_BYTES = 1_000_000

Lines = dict[tuple[str | int, ...], int]
"""Key path → line of the document, for messages."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Plain values only; ``1e-3`` is a number, as everywhere outside YAML 1.1."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read(path: Path, schema: Path) -> dict[str, Any]:
    """Read a YAML document and validate it; return it with the schema's defaults filled in.

    Raises
    ------
    InputError : naming the file, the line, the key, what stands there and what could.
    """
    content, lines = _parse(path)
    validator = _validator(schema)
    content = _spelled(content, validator.schema, validator)
    errors = sorted(validator.iter_errors(content), key=lambda error: lines.get(tuple(error.absolute_path), 0))
    if errors:
        more = [error for error in errors[1:] if not _follows(error, errors[0])]
        raise _refusal(path, errors[0], lines, validator, more=len(more))
    return dict(_with_defaults(content, validator.schema, validator))


def plain(path: Path) -> Any:
    """Read a YAML document that has no schema, as strictly: plain values, no aliases, no repeated keys, no large files.

    Raises
    ------
    InputError : naming the file and the line.
    """
    return _parse(path)[0]


def file_beside(description: Path, value: str, where: str, folder: str = "the description's folder") -> Path:
    """The file a description names, which must lie in the description's own folder.

    Parameters
    ----------
    description : the YAML document
    value : what it says, a path relative to its folder
    where : the key that says it, for messages
    folder : what the folder is called in messages

    Raises
    ------
    InputError : the path leads outside the folder, cannot stand in a workflow, or there is no such file.
    """
    home = description.parent
    inside = f"the name of a file in {folder}"
    relative = PurePosixPath(value)
    if "\0" in value or relative.is_absolute() or ".." in relative.parts:
        raise InputError(description, f"points outside {folder}", where=where, found=repr(value), accepted=inside)
    target = (home / value).resolve()
    if not target.is_relative_to(home.resolve()):
        raise InputError(description, f"leads outside {folder}", where=where, found=repr(value), accepted=inside)
    if set("{}\n") & set(str(target)):  # they mean something else in the workflow's paths
        problem = "a brace or a line break in the file's name or in a folder above it"
        raise InputError(description, problem, where=where, found=repr(value), accepted="a plain path")
    if not target.is_file():
        present = sorted(item.name for item in home.iterdir() if item.is_file() and item.name != description.name)
        close, listed = nearest(value, present), ", ".join(present[:10]) or f"none is there yet; put it into {folder}"
        raise InputError(description, f"no such file{close}", where=where, found=repr(value), accepted=listed)
    return target


def nearest(word: str, known: Iterable[str]) -> str:
    """``"; did you mean 'x'?"`` if a known word is close to this one, else nothing."""
    # Two letters are near to far too much: "cm" to "m".
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6) if len(word) > 2 else []
    return f"; did you mean {close[0]!r}?" if close else ""


def _parse(path: Path) -> tuple[Any, Lines]:
    try:
        if not path.is_file():
            raise InputError(path, "no such file")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(path, "too large", found=f"{path.stat().st_size} bytes", accepted=f"at most {MAX_BYTES}")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "not UTF-8 text", where=f"byte {error.start}", accepted="text saved as UTF-8") from error
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    lines: Lines = {}
    try:
        _refuse_depth(path, text)
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None and text.strip():
                return {}, {}  # comments alone: nothing is said, and the schema tells what is missing
            if node is None:
                raise InputError(path, "empty", accepted="keys and values")
            _refuse_tricks(path, node, (), lines, set())
            return loader.construct_document(node), lines
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise _syntax_refusal(path, error, last=len(text.splitlines())) from error
    except RecursionError as error:
        raise InputError(path, "nested too deeply") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            path, f"a value cannot be read ({error})", accepted="plain text, numbers, true and false"
        ) from error


MAX_DEPTH = 40


def _refuse_depth(path: Path, text: str) -> None:
    """Refuse what is nested deeper than any description is, before it is composed: that recurses in C, and would crash."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise InputError(path, "nested too deeply", where=f"line {line}", accepted=f"at most {MAX_DEPTH} levels")


def _refuse_tricks(path: Path, node: yaml.Node, where: tuple[str | int, ...], lines: Lines, seen: set[int]) -> None:
    line = node.start_mark.line + 1
    lines[where] = line
    if id(node) in seen:
        raise InputError(
            path, "an alias (*) refers to another value", where=f"line {line}", accepted="the value itself"
        )
    seen.add(id(node))
    if isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:float" and "n" in node.value.lower():
        raise InputError(path, "not a finite number", where=f"line {line}", found=node.value, accepted="a number")
    if isinstance(node, yaml.SequenceNode):
        for place, item in enumerate(node.value):
            _refuse_tricks(path, item, (*where, place), lines, seen)
    elif isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, value in node.value:
            at = f"line {key.start_mark.line + 1}"
            if key.tag != "tag:yaml.org,2002:str":
                number = key.tag == "tag:yaml.org,2002:int" and not value.value
                accepted = f"a word before the colon{_DECIMAL_POINT if number else ''}"
                raise InputError(path, "a key is not plain text", where=at, accepted=accepted)
            if key.value in keys:
                raise InputError(path, f"the key {key.value!r} stands twice", where=at, accepted="each key once")
            keys.add(key.value)
            _refuse_tricks(path, value, (*where, key.value), lines, seen)
            lines[(*where, key.value)] = key.start_mark.line + 1


def _syntax_refusal(path: Path, error: yaml.YAMLError, last: int) -> InputError:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "cannot be read"
    return InputError(
        path,
        f"not valid YAML ({problem})",
        where=f"line {min(mark.line + 1, last)}" if mark else None,
        accepted="`key: value` lines, indented by spaces",
    )


@cache
def _validator(schema: Path) -> Any:
    import jsonschema

    return jsonschema.Draft202012Validator(yaml.load(schema.read_text(encoding="utf-8"), Loader=_Loader))


def _spelled(content: Any, schema: Any, validator: Any) -> Any:
    """The same content with listed words spelled as the schema does: SCI is sci, and both letters µ are u."""
    schema = _resolved(schema, validator)
    if isinstance(content, str):
        listed = [
            *schema.get("enum", []),
            *schema.get("then", {}).get("enum", []),
            *schema.get("else", {}).get("enum", []),
        ]
        return {_folded(word): word for word in map(str, listed)}.get(_folded(content), content)
    if isinstance(content, list):
        return [_spelled(item, schema.get("items", {}), validator) for item in content]
    if not isinstance(content, Mapping):
        return content
    spelled = {
        key: _spelled(value, schema.get("properties", {}).get(key, {}), validator) for key, value in content.items()
    }
    if "if" in schema:
        for branch in ("then", "else"):  # which one applies may hang on the spelling
            spelled = _spelled(spelled, schema.get(branch, {}), validator)
    return spelled


def _folded(word: str) -> str:
    return unicodedata.normalize("NFKC", word).casefold().replace("\N{GREEK SMALL LETTER MU}", "u")


def _with_defaults(content: Any, schema: Any, validator: Any) -> Any:
    """The same content with each absent key that has a default, in every branch of the schema that applies."""
    schema = _resolved(schema, validator)
    if not isinstance(content, Mapping):
        return content
    if "if" in schema:
        branch = "then" if validator.evolve(schema=schema["if"]).is_valid(content) else "else"
        content = _with_defaults(content, schema.get(branch, {}), validator)
    filled = dict(content)
    for key, part in schema.get("properties", {}).items():
        default = _resolved(part, validator).get("default")
        if key in filled or default is not None:
            filled[key] = _with_defaults(filled.get(key, default), part, validator)
    return filled


def _resolved(schema: Mapping[str, Any], validator: Any) -> Mapping[str, Any]:
    # Only references into the document's own $defs are used.
    definitions: Mapping[str, Mapping[str, Any]] = validator.schema.get("$defs", {})
    if "$ref" not in schema:
        return schema
    own = {key: value for key, value in schema.items() if key != "$ref"}
    return {**definitions[schema["$ref"].removeprefix("#/$defs/")], **own}


def _follows(error: Any, first: Any) -> bool:
    """Whether an error only follows from the first: where the type is wrong, or keys stand together, no branch of the schema fits."""
    return first.validator in ("not", "type") and list(error.absolute_path) == list(first.absolute_path)


def _refusal(path: Path, error: Any, lines: Lines, validator: Any, more: int) -> InputError:
    keys = tuple(error.absolute_path)
    where = ".".join(map(str, keys))
    problem, found, accepted = _WORDS.get(error.validator, _otherwise)(error, validator)
    if error.validator == "additionalProperties":
        keys = (*keys, _first_unknown(error))
    line = lines.get(keys) or lines.get(tuple(error.absolute_path))
    place = ", ".join([*([f"line {line}"] if line else []), *([where] if where else [])]) or None
    if more:
        accepted += f" (and {more} more problem{'s' if more > 1 else ''})"
    return InputError(path, problem, where=place, found=found, accepted=accepted)


def _first_unknown(error: Any) -> str:
    known = error.schema.get("properties", {})
    return str(next(key for key in error.instance if key not in known))


def _unknown_key(error: Any, validator: Any) -> tuple[str, str | None, str]:
    unknown, known = _first_unknown(error), error.schema.get("properties", {})
    key, equals, value = (part.strip() for part in unknown.partition("="))
    if equals and key:
        return f"unknown key {unknown!r}; write `{key}: {value}`", None, _accepted_keys(error, validator)
    # A key of this very name one level deeper is likelier meant than one of nearly this name.
    deeper = [] if error.absolute_path else _holders(unknown, validator)
    if len(deeper) == 1:
        hint = f"; it stands in `{deeper[0]}`: `{deeper[0]}: {{{unknown}: …}}`"
    else:
        hint = f"; it stands in {', '.join(f'`{part}`' for part in deeper)}" if deeper else nearest(unknown, known)
    return f"unknown key {unknown!r}{hint}", None, _accepted_keys(error, validator)


def _missing_key(error: Any, validator: Any) -> tuple[str, str | None, str]:
    missing = next(key for key in error.validator_value if key not in error.instance)
    if not error.instance and _alternatives(error, validator):
        return "nothing is said", None, _accepted_keys(error, validator)
    part = _resolved(error.schema.get("properties", {}).get(missing, {}), validator)
    accepted = ", ".join(map(str, part.get("enum", []))) or part.get("description") or f"`{missing}:` with a value"
    return f"the key {missing!r} is missing", None, accepted


def _accepted_keys(error: Any, validator: Any) -> str:
    """The keys of a mapping; where it has none of them, those of the other mappings that may stand in its place too."""
    known = list(error.schema.get("properties", {}))
    others = [] if any(key in known for key in error.instance) else _alternatives(error, validator)
    return "; or ".join(", ".join(keys) for keys in [known, *others])


def _alternatives(error: Any, validator: Any) -> list[list[str]]:
    """Keys of the branches of the schema that were not taken on the way to an error."""
    found: list[list[str]] = []
    schema: Any = validator.schema
    for step in list(error.absolute_schema_path)[:-1]:
        if isinstance(schema, Mapping):
            schema = _resolved(schema, validator)
            other = {"then": "else", "else": "then"}.get(step)
            found = [*found, _keys(schema.get(other, {}), validator)] if other else []
            schema = schema.get(step, {})
        else:
            found, schema = [], schema[step]
    return [keys for keys in found if keys]


def _keys(schema: Any, validator: Any) -> list[str]:
    """Keys of a schema and of all its branches."""
    schema = _resolved(schema, validator)
    branches = [_keys(schema[branch], validator) for branch in ("then", "else") if branch in schema]
    return list(dict.fromkeys([*schema.get("properties", {}), *(key for keys in branches for key in keys)]))


def _holders(key: str, validator: Any) -> list[str]:
    """Keys of the document whose mapping has a key of this name."""
    parts = validator.schema.get("properties", {})
    return [name for name, part in parts.items() if key in _keys(part, validator)]


def _not_listed(error: Any, validator: Any) -> tuple[str, str | None, str]:
    choices = list(map(str, error.validator_value))
    close = nearest(error.instance, choices) if isinstance(error.instance, str) else ""
    return f"not an accepted value{close}", _show(error.instance), ", ".join(choices)


def _nothing_said(error: Any, validator: Any) -> tuple[str, str | None, str]:
    keys = [key for choice in error.validator_value for key in choice.get("required", [])]
    listed = ", ".join(f"`{key}`" for key in keys)
    return "nothing to build from", None, f"at least one of {listed} (what stands behind a # does not count)"


def _not_together(error: Any, validator: Any) -> tuple[str, str | None, str]:
    keys = [f"`{key}`" for key in error.validator_value["required"]]
    return f"{' and '.join(keys)} stand together", None, f"either {' or '.join(keys)}"


def _wrong_type(error: Any, validator: Any) -> tuple[str, str | None, str]:
    kinds = [error.validator_value] if isinstance(error.validator_value, str) else error.validator_value
    description, shown = error.schema.get("description"), _show(error.instance)
    if kinds == ["object"]:
        keys = ", ".join(error.schema.get("properties", {}))
        accepted = "a mapping of keys" + (f": {keys}" if keys else f": {description}" if description else "")
    elif kinds == ["array"]:
        item = _resolved(error.schema.get("items", {}), validator)
        single = not isinstance(error.instance, Mapping) and validator.evolve(schema=item).is_valid(error.instance)
        accepted = (
            f"a list: [{error.instance}]" if single and item else f"a list, {description}" if description else "a list"
        )
    else:
        accepted = description or " or ".join(kinds)
    if "string" in kinds and isinstance(error.instance, bool | int | float | date):
        accepted += " (text that YAML takes for a number, a date or a yes/no needs quotes)"
    return "not an accepted value", shown, accepted + _decimal_comma(error)


def _otherwise(error: Any, validator: Any) -> tuple[str, str | None, str]:
    accepted = error.schema.get("description") or error.message
    return "not an accepted value", _show(error.instance), accepted + _decimal_comma(error)


def _decimal_comma(error: Any) -> str:
    """A hint where a number has a decimal comma: YAML reads 0,1 as text and [0,1] as two numbers."""
    value = error.instance
    text = (
        isinstance(value, str) and error.schema.get("type") != "string" and re.fullmatch(r"[-+]?\d+,\d+", value.strip())
    )
    # Of [45,5, 50, 25] one number alone is torn apart.
    torn = error.validator == "maxItems" and error.validator_value < len(value) <= 2 * error.validator_value
    return _DECIMAL_POINT if text or torn else ""


_DECIMAL_POINT = " (numbers take a decimal point, not a comma)"

_WORDS = {
    "additionalProperties": _unknown_key,
    "required": _missing_key,
    "enum": _not_listed,
    "type": _wrong_type,
    "anyOf": _nothing_said,
    "not": _not_together,
}


def _show(value: Any) -> str:
    shown = repr(value) if isinstance(value, str | bool | int | float) else json.dumps(value, default=str)
    return shown if len(shown) <= 60 else shown[:57] + "…"

"""Render declared keys: the template of a description, the schema for editors, and the tables of the documentation."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any, get_args, get_origin

import yaml
from pydantic import TypeAdapter
from pydantic.fields import FieldInfo

from brdfpipe.descriptions.keys import Keys, notes_of
from brdfpipe.descriptions.reading import TYPE_WORDS, Declared, declared

COMMENT_COLUMN, LINE_LENGTH = 30, 120
"""Column at which comments of a template start, and the longest line that has one."""


# --- the schema for editors


def editor_schema(model: Any) -> str:
    """The JSON schema of a description, which editors use for completion, help and checks while typing."""
    schema = _without_notes(TypeAdapter(model).json_schema(by_alias=True))
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _without_notes(schema: Any) -> Any:
    """A schema without titles and without the default None of absent keys, which editors need not show."""
    if isinstance(schema, list):
        return [_without_notes(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    parts = {key: _without_notes(value) for key, value in schema.items() if key not in ("notes", "title", "properties")}
    if "properties" in schema:
        parts["properties"] = {key: _without_notes(value) for key, value in schema["properties"].items()}
    if parts.get("default", 0) is None:
        del parts["default"]
    return parts


# --- the template


def template(model: type[Keys], introduction: str, included: Collection[str] = ()) -> str:
    """A description to start from: every key that has an example or a default, with its help as a comment.

    Keys without a default that are not required are commented out, except those ``included``.
    """
    return f"{_comment(introduction)}\n" + "\n".join(_template_lines(model, "", included)) + "\n"


def _template_lines(model: type[Keys], indent: str, included: Collection[str] = ()) -> Iterator[str]:
    for name, field in model.declared_keys().items():
        notes = notes_of(field)
        value = notes.example
        if value is None and not (field.is_required() or isinstance(field.default, Keys)):
            value = field.default
        block = declared(field.annotation).annotation
        if value is None and not (isinstance(block, type) and issubclass(block, Keys)):
            continue
        if not indent:
            yield ""
        optional = not indent and not field.is_required() and field.default is None and name not in included
        yield from (_commented(line) if optional else line for line in _key_lines(name, field, value, block, indent))


def _key_lines(name: str, field: FieldInfo, value: Any, block: Any, indent: str) -> Iterator[str]:
    is_block = isinstance(block, type) and issubclass(block, Keys)
    if is_block:
        yield from _line(f"{indent}{name}:", _short_help(field))
        if value is None:
            yield from _template_lines(block, indent + "  ")
        else:
            fields = block.declared_keys()
            for key, item in value.items():
                yield from _line(f"{indent}  {key}: {flow(item)}", _short_help(fields[key]))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        yield from _line(f"{indent}{name}:", _short_help(field))
        yield from (f"{indent}  - {flow(item)}" for item in value)
    else:
        yield from _line(f"{indent}{name}: {flow(value)}", _short_help(field))


def alternatives(model: type[Keys], introduction: str, blocks: str) -> str:
    """A template of alternatives, all of them commented out.

    Parameters
    ----------
    model : the keys of the description
    introduction : the comment at the start
    blocks : YAML, a key in one line after comment lines, separated by blank lines; the help of its inner keys is added
    """
    parts = [_comment(introduction)]
    for block in blocks.split("\n\n"):
        *comments, line = block.splitlines()
        ((name, value),) = yaml.safe_load(line).items()
        lines = [line]
        if isinstance(value, dict):
            forms = (form.declared_keys() for form in _blocks(model.declared_keys()[name].annotation))
            keys = next(form for form in forms if value.keys() <= form.keys())
            inner = (_line(f"  {key}: {flow(item)}", _short_help(keys[key])) for key, item in value.items())
            lines = [f"{name}:", *(text for texts in inner for text in texts)]
        parts.append("\n".join([*comments, *map(_commented, lines)]))
    return "\n\n".join(parts).replace("…\n\n", "…\n") + "\n"


def _comment(text: str) -> str:
    return "\n".join(f"# {line}".rstrip() for line in text.splitlines())


def _commented(line: str) -> str:
    """A line as a comment; a comment above an unindented key stays one."""
    return line if line.startswith("# ") or not line else f"# {line}"


def _line(text: str, comment: str) -> Iterator[str]:
    """A line with its comment behind it, or above it where the line would be too long."""
    line = f"{text:<{COMMENT_COLUMN - 1}} # {comment}"
    if comment and len(line) > LINE_LENGTH:
        yield f"{text[: len(text) - len(text.lstrip())]}# {comment}"
    yield line if comment and len(line) <= LINE_LENGTH else text


def _short_help(field: FieldInfo) -> str:
    """The help of a key up to the first semicolon that is not in parentheses, with its unit."""
    unit, help = notes_of(field).unit, ""
    for part in (field.description or "").split(";"):
        help += f";{part}" if help else part
        if help.count("(") == help.count(")"):
            break
    return help + (f" [{unit}]" if unit else "")


def flow(value: Any) -> str:
    """A value as YAML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(flow, value))}]"
    if isinstance(value, str) and (not value or re.search(r"[:#{}\[\],&*?|>'\"%@`]|^[-\d.]", value)):
        return json.dumps(value, ensure_ascii=False)
    return {True: "true", False: "false"}.get(value, str(value)) if isinstance(value, bool) else str(value)


# --- the tables of the documentation


def table(model: Any, prefix: str = "", title: str = "Key", nested: bool = True) -> str:
    """A Markdown table of the keys of a description.

    Parameters
    ----------
    model : a block of keys, or a union of several
    prefix : keys above it, as ``rig.``
    title : of the first column
    nested : whether the keys of blocks inside it are listed too
    """
    rows = [f"| {title} | Accepted | Default | Meaning |", "|---|---|---|---|"]
    return "\n".join([*rows, *_rows(model, prefix, nested)])


def _rows(model: Any, prefix: str, nested: bool) -> Iterator[str]:
    blocks = _blocks(model)
    fields = {name: field for block in reversed(blocks) for name, field in block.declared_keys().items()}
    order = list(dict.fromkeys(name for block in blocks for name in block.declared_keys()))
    if len(blocks) > 1:
        order.sort(key=lambda name: not fields[name].is_required())
    for name in order:
        inner = list(_rows(fields[name].annotation, f"{prefix}{name}.", nested)) if nested else []
        # The keys of a block say all about it; a value of another form or a list has a row of its own.
        if not inner or len(_blocks(fields[name].annotation)) != 1 or get_args(fields[name].annotation):
            yield _row(f"{prefix}{name}", fields[name])
        yield from inner


def _blocks(annotation: Any) -> list[type[Keys]]:
    """The blocks of keys that a value may have: its own, those of a union, or those of the items of a list."""
    place = declared(annotation)
    if isinstance(place.annotation, type) and issubclass(place.annotation, Keys):
        return [place.annotation]
    return [block for member in get_args(place.annotation) for block in _blocks(member)]


def _row(key: str, field: FieldInfo) -> str:
    notes = notes_of(field)
    default = notes.default_words or ("needed" if field.is_required() else "")
    if not default and field.default is not None and not isinstance(field.default, Keys):
        default = f"`{flow(field.default)}`"
    help = (field.description or "").replace("|", "\\|")
    word = re.split(r"\W", help, maxsplit=1)[0]
    is_value = word in declared(field.annotation, field=field).choices or help.startswith(word + "-")
    sentence = help if is_value else help[:1].upper() + help[1:]
    return f"| `{key}` | {_accepted(field)} | {default} | {sentence}.{f' {notes.details}' if notes.details else ''} |"


def _accepted(field: FieldInfo) -> str:
    """Type, range and unit of a key, in words."""
    place, unit = declared(field.annotation, field=field), notes_of(field).unit
    words = _form(place)
    if get_origin(place.annotation) in (list, tuple):
        item = declared(get_args(place.annotation)[0])
        words += f" of {_form(item)}" if item.choices else f", {place.limits}" if place.limits else ""
    elif place.annotation in TYPE_WORDS and not place.choices:
        words += f" {place.limits}" if place.limits else ""
    return words + (f" [{unit}]" if unit else "")


def _form(place: Declared) -> str:
    """Type of a value in words, or the listed values."""
    if place.choices:
        return " ".join(f"`{choice}`" for choice in place.choices)
    if place.annotation in TYPE_WORDS:
        return TYPE_WORDS[place.annotation]
    if get_origin(place.annotation) in (list, tuple):
        return "a list"
    if isinstance(place.annotation, type) and issubclass(place.annotation, Keys):
        return "keys"
    return " or ".join(dict.fromkeys(_form(declared(member)) for member in get_args(place.annotation)))


def with_tables(text: str, tables: Mapping[str, str]) -> str:
    """A page with its tables of keys renewed, each between ``<!-- keys: NAME -->`` and ``<!-- end -->``."""
    for name, rows in tables.items():
        text = with_section(text, f"keys: {name}", rows)
    return text


def with_section(text: str, name: str, content: str) -> str:
    """A page whose section between ``<!-- NAME -->`` and ``<!-- end -->`` is replaced.

    Raises ValueError: the page does not have one such section.
    """
    pattern = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    text, count = pattern.subn(lambda match: f"{match[1]}{content}\n{match[2]}", text)
    if count != 1:
        raise ValueError(f"the page has {count} places for the table {name.removeprefix('keys: ')!r}, not one")
    return text

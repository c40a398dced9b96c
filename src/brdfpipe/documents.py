"""YAML documents, read strictly, and the files that they name.

The text is untrusted: only plain values are built; aliases (which can expand without end), repeated keys and large files are refused.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from brdfpipe.errors import InputError, printable

MAX_BYTES = 1_000_000
MAX_DEPTH = 40

DECIMAL_POINT = " (numbers take a decimal point, not a comma)"
"""Hint for messages."""

_WHOLE = re.compile("[1-9][0-9]*")

Lines = dict[tuple[str | int, ...], int]
"""Key path → line of the document, for messages."""


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Plain values only; ``1e-3`` is a number, as everywhere outside YAML 1.1."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_yaml(path: Path) -> Any:
    """Read a YAML document without declared keys. Raises InputError: naming the file and the line."""
    return parse(path)[0]


def file_beside(description: Path, value: str, where: str, folder: str = "the description's folder") -> Path:
    """The file that a description names, which must be in the description's own folder.

    Parameters
    ----------
    description : the YAML document
    value : the path it names, relative to its folder
    where : its key, for messages
    folder : name of the folder in messages

    Raises
    ------
    InputError : the path leads outside the folder or cannot be followed, cannot be used in a workflow, or no such file exists.
    """
    home = description.parent
    inside = f"the name of a file in {folder}"
    relative = PurePosixPath(value)
    if "\0" in value or relative.is_absolute() or ".." in relative.parts:
        raise InputError(description, f"points outside {folder}", where=where, found=repr(value), accepted=inside)
    target = resolved(home / value)
    if target is None:
        problem = "symbolic links form a loop"
        raise InputError(description, problem, where=where, found=repr(value), accepted=inside)
    if not target.is_relative_to(home.resolve()):
        raise InputError(description, f"leads outside {folder}", where=where, found=repr(value), accepted=inside)
    if unusable := problem_in_workflow(target):
        accepted = "a path without these characters"
        raise InputError(description, unusable, where=where, found=repr(value), accepted=accepted)
    if not target.is_file():
        present = sorted(item.name for item in home.iterdir() if item.is_file() and item.name != description.name)
        listed = ", ".join(present[:10]) or f"none; {folder} holds no other file, put it there"
        problem = f"no such file{nearest(value, present)}"
        raise InputError(description, problem, where=where, found=repr(value), accepted=listed)
    return target


def refuse_link_outside(description: Path, folder: str) -> None:
    """Refuse a description that is a symbolic link out of its own folder: messages would quote another file. Raises InputError."""
    target = resolved(description)
    if target is None or not target.is_relative_to(description.parent.resolve()):
        problem = "is a symbolic link to another folder, or one of a loop"
        raise InputError(description, problem, accepted=f"a file in {folder}")


def resolved(path: Path) -> Path | None:
    """The path without symbolic links; None if they form a loop, or if it holds a null character."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # RuntimeError: a loop, until Python 3.13
        return None


def problem_in_workflow(path: Path) -> str | None:
    """Why the workflow cannot use a path, or None: it takes braces and angle brackets for names of its own, and wants UTF-8."""
    if set("{}<>\n") & set(str(path)):
        return "a brace, an angle bracket or a line break in the name of the file or of a folder above it"
    if printable(str(path)) != str(path):
        return "the name of the file or of a folder above it is not UTF-8"
    return None


def nearest(word: str, known: Iterable[str]) -> str:
    """``"; did you mean 'x'?"`` if a known word is close to this one, else nothing."""
    # Short words resemble too many others: "cm" and "m".
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6) if len(word) > 2 else []
    return f"; did you mean {close[0]!r}?" if close else ""


def parse(path: Path) -> tuple[Any, Lines]:
    """Plain content of a YAML document, and the line of each of its keys. Raises InputError: naming the file and the line."""
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
                return {}, {}  # comments alone; the validation names the missing keys
            if node is None:
                raise InputError(path, "empty", accepted="keys and values")
            _refuse_unsafe(path, node, (), lines, set())
            return loader.construct_document(node), lines
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise _syntax_refusal(path, error, text) from error
    except RecursionError as error:
        raise InputError(path, "nested too deeply") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            path, f"a value cannot be read ({error})", accepted="plain text, numbers, true and false"
        ) from error


def _refuse_depth(path: Path, text: str) -> None:
    """Refuse deep nesting before the document is composed: composing recurses in C, and would crash."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise InputError(path, "nested too deeply", where=f"line {line}", accepted=f"at most {MAX_DEPTH} levels")


def _refuse_unsafe(path: Path, node: yaml.Node, keys: tuple[str | int, ...], lines: Lines, seen: set[int]) -> None:
    line = node.start_mark.line + 1
    lines[keys] = line
    if id(node) in seen:
        raise InputError(
            path, "an alias (*) refers to another value", where=f"line {line}", accepted="the value itself"
        )
    seen.add(id(node))
    if isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:float" and "n" in node.value.lower():
        raise InputError(path, "not a finite number", where=f"line {line}", found=node.value, accepted="a number")
    if isinstance(node, yaml.SequenceNode):
        for number, item in enumerate(node.value):
            _refuse_unsafe(path, item, (*keys, number), lines, seen)
    elif isinstance(node, yaml.MappingNode):
        seen_keys: set[str] = set()
        for key, value in node.value:
            at = f"line {key.start_mark.line + 1}"
            if key.tag == "tag:yaml.org,2002:int" and value.value and _WHOLE.fullmatch(key.value):
                key.tag = "tag:yaml.org,2002:str"  # the name of a geometry, as `gloss: {60: 22.4}`
            if key.tag != "tag:yaml.org,2002:str":
                is_number = key.tag == "tag:yaml.org,2002:int" and not value.value
                accepted = f"a word before the colon{DECIMAL_POINT if is_number else ''}"
                raise InputError(path, "a key is not plain text", where=at, accepted=accepted)
            if key.value in seen_keys:
                raise InputError(path, f"duplicate key {key.value!r}", where=at, accepted="each key once")
            seen_keys.add(key.value)
            _refuse_unsafe(path, value, (*keys, key.value), lines, seen)
            lines[(*keys, key.value)] = key.start_mark.line + 1


def _indenting_tab(text: str, line: int) -> int | None:
    """Number of the line at or just above a mistake (counted from 0) that is indented by a tab; None if none is."""
    lines = text.splitlines()
    for number in (line, line - 1, line + 1):
        if 0 <= number < len(lines) and re.match(r" *(?:- *)?\t", lines[number]):
            return number + 1
    return None


def _syntax_refusal(path: Path, error: yaml.YAMLError, text: str) -> InputError:
    last = len(text.splitlines())
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "cannot be read"
    tab = _indenting_tab(text, mark.line if mark else 0)
    if tab:
        accepted = "spaces in its place"
        return InputError(
            path, "a tab in the indentation; YAML takes spaces alone", where=f"line {tab}", accepted=accepted
        )
    return InputError(
        path,
        f"not valid YAML ({problem})",
        where=f"line {min(mark.line + 1, last)}" if mark else None,
        accepted="`key: value` lines, indented by spaces",
    )

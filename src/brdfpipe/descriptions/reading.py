"""Read a description: strict YAML, validated by pydantic against its declared keys.

Refusals name the line and the key, what was found and what is accepted, in the words of the declarations.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from brdfpipe import documents
from brdfpipe.descriptions.keys import Keys, OneOf, notes_of
from brdfpipe.errors import InputError

TYPE_WORDS = {float: "a number", int: "an integer", str: "text", bool: "true or false"}


KeyPath = tuple[str | int, ...]
"""Keys from the outermost on."""


class Inherited(NamedTuple):
    """Values that a description has from another file."""

    path: Path
    values: Mapping[KeyPath, Any]
    lines: Mapping[KeyPath, int]


class Description(NamedTuple):
    """A validated description."""

    path: Path
    content: dict[str, Any]
    """As :func:`read` returns it."""
    written: Any
    """Without defaults, values as in the file."""
    lines: documents.Lines
    inherited: Inherited | None = None

    def refusal(self, where: str, problem: str, found: object = None, accepted: str | None = None) -> InputError:
        """Error about a value that contradicts another one, with the line of its key; ``where``: the key, as ``drift.step``."""
        steps = tuple(int(step) if step.isdigit() else step for step in where.split("."))
        place = _place(_line(self.lines, steps), where)
        return InputError(self.path, problem, where=place, found=found, accepted=accepted)


def read(path: Path, model: Any) -> dict[str, Any]:
    """Read a YAML description; return its content with declared defaults filled in and listed words in their declared spelling.

    Parameters
    ----------
    path : the file
    model : a block of :class:`~brdfpipe.descriptions.keys.Keys`, or a union of several with a :class:`~brdfpipe.descriptions.keys.Choice`

    Raises
    ------
    InputError : naming the file, the line, the key, what was found and what is accepted.
    """
    return read_with_lines(path, model).content


def read_with_lines(
    path: Path, model: Any, inherit: Callable[[Mapping[str, Any]], Inherited] | None = None
) -> Description:
    """Read a YAML description as :func:`read`; also return its lines, for checks of values against each other.

    ``inherit`` gives the values that a description, as it was written, has from another file; an error about one of them names that file.
    """
    written, lines = documents.parse(path)
    inherited = inherit(written) if inherit is not None and isinstance(written, Mapping) else None
    return _validated(path, written, lines, model, inherited)


def check(written: Mapping[str, Any], model: Any, name: str) -> dict[str, Any]:
    """Validate keys that are not in a file as :func:`read` validates those of a file; ``name`` stands for the file in messages."""
    return _validated(Path(name), dict(written), {}, model).content


def _validated(
    path: Path, written: Any, lines: documents.Lines, model: Any, inherited: Inherited | None = None
) -> Description:
    given = written if inherited is None else _with_values(written, inherited.values)
    try:
        validated = _validator(model).validate_python(given)
    except ValidationError as error:
        document = _Document(given, lines, model, inherited)
        raise _refusal(path, error.errors(include_url=False), document) from None
    return Description(path, dict(_plain(validated, given)), written, lines, inherited)


def _with_values(written: Mapping[str, Any], values: Mapping[KeyPath, Any]) -> dict[str, Any]:
    """A document with further values; mappings in which they stand are copied."""
    result = dict(written)
    for path, value in values.items():
        holder: Any = result
        for step in path[:-1]:
            holder[step] = dict(holder[step])
            holder = holder[step]
        holder[path[-1]] = value
    return result


@cache
def _validator(model: Any) -> TypeAdapter[Any]:
    with _without_plugins():
        adapter = TypeAdapter(model)
        adapter.rebuild()
        return adapter


@contextmanager
def _without_plugins() -> Iterator[None]:
    """Keep pydantic from searching the metadata of all installed packages for plugins, a third of the time of a check."""
    variable = "PYDANTIC_DISABLE_PLUGINS"
    before = os.environ.get(variable)
    os.environ[variable] = "1"
    try:
        yield
    finally:
        del os.environ[variable]
        if before is not None:
            os.environ[variable] = before


def _plain(value: Any, written: Any) -> Any:
    """Validated values as plain dictionaries and lists; whole numbers stay as they were written."""
    if isinstance(value, Keys):
        given = written if isinstance(written, Mapping) else {}
        fields = type(value).model_fields
        values = {field.alias or attribute: getattr(value, attribute) for attribute, field in fields.items()}
        return {name: _plain(item, given.get(name)) for name, item in values.items() if item is not None}
    if isinstance(value, list | tuple):
        items = written if isinstance(written, list) else [None] * len(value)
        return [_plain(item, given) for item, given in zip(value, items, strict=True)]
    return written if isinstance(value, float) and isinstance(written, int) else value


# --- declarations at a place of a description


class Declared(NamedTuple):
    """The declaration of one value."""

    annotation: Any
    metadata: tuple[Any, ...]
    help: str
    unit: str
    alternatives: tuple[tuple[str, ...], ...]
    """Keys of the other mappings that are accepted in its place."""

    @property
    def choices(self) -> tuple[str | int, ...]:
        """The accepted values, where they are listed."""
        return next((item.listed for item in self.metadata if isinstance(item, OneOf)), ())

    @property
    def limits(self) -> str:
        """Range of a number or length of a list, in words."""
        bounds = {}
        for limit in self.metadata:
            for kind, name in ((Ge, "ge"), (Gt, "gt"), (Le, "le"), (Lt, "lt")):
                if isinstance(limit, kind):
                    bounds[name] = figure(getattr(limit, name))
        high = f"at most {bounds['le']}" if "le" in bounds else f"below {bounds['lt']}" if "lt" in bounds else ""
        if "gt" in bounds:
            return f"above {bounds['gt']}" + (f" and {high}" if high else "")
        if "ge" in bounds:
            return f"from {bounds['ge']} to {high.removeprefix('at most ')}" if high else f"at least {bounds['ge']}"
        if high:
            return high
        shortest = next((item.min_length for item in self.metadata if isinstance(item, MinLen)), 0)
        if get_origin(self.annotation) is list and shortest > 1:
            return f"{shortest} or more"
        return ""

    @property
    def accepted(self) -> str:
        """What is accepted, in words."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        words = self.help or TYPE_WORDS.get(self.annotation, "")
        unit = f" [{self.unit}]" if self.unit else ""
        comma = "," if unit or len(words.split()) > 3 else ""
        return words + unit + (f"{comma} {self.limits}" if self.limits else "")


def figure(number: Any) -> str:
    """A number without an exponent or trailing zeros."""
    return str(int(number)) if float(number).is_integer() else f"{number:.10f}".rstrip("0")


def declared(annotation: Any, steps: Sequence[str | int] = (), field: FieldInfo | None = None) -> Declared:
    """The declaration of a value, or of a value inside it.

    Parameters
    ----------
    annotation : a model, or the type of a key
    steps : keys, numbers of items, and tags of a :class:`~brdfpipe.descriptions.keys.Choice`, as in the path of a pydantic error
    field : the key whose type it is
    """
    place = _declared(annotation, field, ())
    for step in steps:
        members = get_args(place.annotation)
        if _is_tag(step):
            number = int(str(step)[1:-1])
            others = tuple(keys for i, other in enumerate(members) if i != number and (keys := keys_of(other)))
            inner = _declared(members[number], None, (*place.alternatives, *others))
            place = inner._replace(help=inner.help or place.help, unit=inner.unit or place.unit)
        elif isinstance(step, int):
            place = _declared(members[step if get_origin(place.annotation) is tuple else 0], None, ())
        else:
            inner_field = place.annotation.declared_keys()[step]
            place = _declared(inner_field.annotation, inner_field, ())
    return place


def _declared(annotation: Any, field: FieldInfo | None, alternatives: tuple[tuple[str, ...], ...]) -> Declared:
    metadata: list[Any] = list(field.metadata) if field else []
    help, unit = (field.description or "", notes_of(field).unit) if field else ("", "")
    while get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        for item in more:
            if isinstance(item, FieldInfo):
                metadata += item.metadata
                help = help or item.description or ""
            else:
                metadata.append(item)
    return Declared(annotation, tuple(metadata), help, unit, alternatives)


def keys_of(annotation: Any) -> tuple[str, ...]:
    """The keys of a mapping, or of all mappings that a union accepts."""
    annotation = declared(annotation).annotation
    if isinstance(annotation, type) and issubclass(annotation, Keys):
        return tuple(annotation.declared_keys())
    if get_origin(annotation) in (list, tuple):
        return ()
    return tuple(dict.fromkeys(key for member in get_args(annotation) for key in keys_of(member)))


# --- refusals


class _Document(NamedTuple):
    content: Any
    lines: documents.Lines
    model: Any
    inherited: Inherited | None = None

    def located(self, path: Path, problem: _Problem) -> tuple[Path, _Problem]:
        """The file that a problem is in, and the problem with its line there."""
        steps = tuple(problem.where.split("."))
        for end in range(len(steps), 0, -1):
            if self.inherited is not None and steps[:end] in self.inherited.lines:
                return self.inherited.path, problem._replace(line=self.inherited.lines[steps[:end]])
        return path, problem

    def line(self, path: tuple[str | int, ...]) -> int:
        """Line of a key, or of the nearest mapping around it."""
        return _line(self.lines, path)

    def at(self, path: tuple[str | int, ...]) -> Any:
        """The value at a path."""
        value = self.content
        for step in path:
            value = value[step]
        return value


def _line(lines: documents.Lines, path: tuple[str | int, ...]) -> int:
    return next((lines[path[:n]] for n in range(len(path), -1, -1) if path[:n] in lines), 0)


def _place(line: int, where: str) -> str | None:
    return ", ".join(filter(None, (f"line {line}" if line else "", where))) or None


class _Problem(NamedTuple):
    line: int
    where: str
    problem: str
    found: object
    accepted: str | None

    def refusal(self, path: Path, more: str = "", others: Sequence[str] = ()) -> InputError:
        accepted, place = (self.accepted or "") + more, _place(self.line, self.where)
        return InputError(path, self.problem, where=place, found=self.found, accepted=accepted or None, others=others)


def _refusal(path: Path, errors: Sequence[ErrorDetails], document: _Document) -> InputError:
    """The first problem of a description, how many more there are, and those."""
    # A misspelled key is also a missing one; the misspelling explains both.
    ordered = sorted(errors, key=lambda error: error["type"] != "extra_forbidden")
    problems = sorted((_problem(error, document) for error in ordered), key=lambda problem: problem.line)
    (file, first), *others = (document.located(path, problem) for problem in problems)
    more = f" (and {len(others)} more problem{'s' if len(others) > 1 else ''})" if others else ""
    return first.refusal(file, more, others=tuple(str(problem.refusal(other)) for other, problem in others))


def _problem(error: ErrorDetails, document: _Document) -> _Problem:
    steps = error["loc"]
    path = tuple(step for step in steps if not _is_tag(step))
    parent = path[:-1]
    if error["type"] == "extra_forbidden":
        problem, accepted = _unknown_key(str(path[-1]), declared(document.model, steps[:-1]), document, parent)
        return _Problem(document.line(path), _dotted(parent), problem, None, accepted)
    if error["type"] == "missing" and isinstance(path[-1], str):
        holder, accepted = declared(document.model, steps[:-1]), declared(document.model, steps).accepted
        problem = f"the key {path[-1]!r} is missing"
        if not document.at(parent) and holder.alternatives:
            problem, accepted = "an empty mapping", _accepted_keys(holder, {})
        return _Problem(
            document.line(parent), _dotted(parent), problem, None, accepted or f"`{path[-1]}:` with a value"
        )
    if error["type"] == "value_error":
        cause = error["ctx"]["error"]
        if not isinstance(cause, InputError):
            return _Problem(document.line(path), _dotted(path), str(cause), None, None)
        path = (*path, *(cause.where or "").split(".")) if cause.where else path
        written = document.at(path) if cause.found is not None and not cause.where else cause.found
        found = written if written == cause.found else cause.found  # 550, where the model has 550.0
        return _Problem(document.line(path), _dotted(path), cause.problem, found, cause.accepted)
    if error["type"] == "missing":  # too few items of a pair or triple
        steps, path = steps[:-1], parent
    value = document.at(path)
    problem, accepted = _wrong_value(error, value, declared(document.model, steps))
    return _Problem(document.line(path), _dotted(path), problem, _show(value), accepted)


def _is_tag(step: str | int) -> bool:
    return isinstance(step, str) and re.fullmatch(r"<\d+>", step) is not None


def _dotted(path: tuple[str | int, ...]) -> str:
    return ".".join(map(str, path))


def _unknown_key(unknown: str, holder: Declared, document: _Document, parent: tuple[str | int, ...]) -> tuple[str, str]:
    known, accepted = keys_of(holder.annotation), _accepted_keys(holder, document.at(parent))
    name, equals, value = (part.strip() for part in unknown.partition("="))
    if equals and name:
        return f"unknown key {unknown!r}; write `{name}: {value}`", accepted
    # The same key one level deeper is more likely meant than another of nearly this name.
    fields = {} if parent else holder.annotation.declared_keys()
    deeper = [other for other, field in fields.items() if unknown in keys_of(field.annotation)]
    if len(deeper) == 1:
        hint = f"; it belongs to `{deeper[0]}`: `{deeper[0]}: {{{unknown}: …}}`"
    else:
        hint = (
            f"; it belongs to {', '.join(f'`{other}`' for other in deeper)}"
            if deeper
            else documents.nearest(unknown, known)
        )
    return f"unknown key {unknown!r}{hint}", accepted


def _accepted_keys(holder: Declared, given: Mapping[str, Any]) -> str:
    """The keys of a mapping; if it has none of them, those of the other mappings that are accepted in its place too."""
    known = keys_of(holder.annotation)
    others = () if any(name in known for name in given) else holder.alternatives
    return "; or ".join(", ".join(keys) for keys in (known, *others))


def _wrong_value(error: ErrorDetails, value: Any, place: Declared) -> tuple[str, str]:
    problem, accepted = "not an accepted value", place.accepted
    if error["type"] == "one_of" and isinstance(value, str):
        problem += documents.nearest(value, map(str, place.choices))
    if error["type"] == "model_type":
        accepted = f"a mapping of keys: {_accepted_keys(place, {})}"
    if error["type"] == "one_of" and isinstance(value, bool):
        accepted += " (YAML reads yes, no, on and off as true and false)"
    if error["type"] in ("list_type", "tuple_type"):
        single = get_origin(place.annotation) is list and _fits(get_args(place.annotation)[0], value)
        accepted = f"a list: [{value}]" if single else f"a list, {accepted}" if accepted else "a list"
    if error["type"] == "string_type" and isinstance(value, bool | int | float | date):
        accepted += " (text that YAML takes for a number, a date or a yes/no needs quotes)"
    return problem, accepted + _decimal_comma(error, value, place)


def _fits(annotation: Any, value: Any) -> bool:
    try:
        _validator(annotation).validate_python(value, strict=True)
    except ValidationError:
        return False
    return not isinstance(value, Mapping)


def _decimal_comma(error: ErrorDetails, value: Any, place: Declared) -> str:
    """A hint where a number has a decimal comma: YAML reads 0,1 as text and [0,1] as two numbers."""
    hint = isinstance(value, str) and place.annotation is not str and re.fullmatch(r"[-+]?\d+,\d+", value.strip())
    if error["type"] == "too_long":
        # Of [45,5, 50, 25] one number alone is torn apart.
        most = error["ctx"]["max_length"]
        hint = most < len(value) <= 2 * most
    return documents.DECIMAL_POINT if hint else ""


def _show(value: Any) -> str:
    shown = (
        repr(value)
        if isinstance(value, str | bool | int | float)
        else json.dumps(value, default=str, ensure_ascii=False)
    )
    return shown if len(shown) <= 60 else shown[:57] + "…"

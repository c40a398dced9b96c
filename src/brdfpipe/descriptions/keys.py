"""Declarations of the keys of a description: type, range, unit, default, help and example of each in one place.

A block of keys is a pydantic model that derives from :class:`Keys`, and each key is an attribute made by :func:`key`.
:mod:`brdfpipe.descriptions.reading` validates YAML against it, :mod:`brdfpipe.descriptions.rendering` writes the template, the
editor schema and the tables of the documentation from it.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from inspect import get_annotations
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError, core_schema

from brdfpipe.errors import InputError

NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""Names that become file names: of materials, calibrations, samples, rigs."""

NAME_WORDS = "letters, digits, dots, dashes and underscores, at most 64, starting with a letter or a digit"


class Notes(NamedTuple):
    """Declarations of a key beside its type and range."""

    unit: str
    example: Any
    default_words: str
    """The default in words, if it is not a fixed value."""
    details: str
    """Further explanation, for the documentation alone. Markdown."""
    stage: str
    """The stages that read the key, where a block has keys of several stages; separated by blanks."""


def key(
    help: str,
    *,
    required: bool = False,
    default: Any = None,
    default_words: str = "",
    unit: str = "",
    example: Any = None,
    details: str = "",
    stage: str = "",
    **limits: Any,
) -> Any:
    """Declare one key.

    Parameters
    ----------
    help : one line; messages, template, editor and documentation quote it. The template shows it up to the first semicolon
    required : whether the key must be given
    default : value of an absent key; ``None`` leaves it absent
    default_words : the default in words, if it is not a fixed value
    unit : of the number, as ``nm`` or ``degree``
    example : value that the template shows where there is no default
    details : further sentences for the documentation alone
    stage : the stages that read the key, where a block has keys of several stages; separated by blanks
    limits : of pydantic: ``ge``, ``gt``, ``le``, ``lt``, ``min_length``, ``max_length``, ``pattern``, ``alias``
    """
    notes = Notes(unit, example, default_words, details, stage)
    return Field(... if required else default, description=help, json_schema_extra={"notes": notes}, **limits)  # type: ignore[dict-item]


def notes_of(field: FieldInfo) -> Notes:
    """The notes that :func:`key` attached to a field."""
    extra = field.json_schema_extra
    return extra["notes"] if isinstance(extra, dict) else Notes("", None, "", "", "")  # type: ignore[return-value]


class Keys(BaseModel):
    """A block of keys. Unknown keys are refused, and values are never converted: ``yes`` is not accepted as a number, nor 1 as text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)

    not_together: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Pairs of keys that exclude each other."""
    at_least_one: ClassVar[tuple[str, ...]] = ()
    """Keys of which one must be given."""
    none_given: ClassVar[str] = "nothing to build from"
    """What is wrong if none of them is given."""
    requires: ClassVar[Mapping[str, str]] = {}
    """Key → another key that must be given with it."""

    @classmethod
    def declared_keys(cls) -> dict[str, FieldInfo]:
        """The keys as they are written, with what is declared of each; own ones before inherited ones."""
        own = get_annotations(cls)
        ordered = sorted(cls.model_fields.items(), key=lambda item: item[0] not in own)
        return {field.alias or name: field for name, field in ordered}

    @classmethod
    def default_of(cls, name: str) -> Any:
        """The declared default of a key."""
        return cls.declared_keys()[name].get_default(call_default_factory=True)

    @classmethod
    def read_by(cls, stage: str) -> tuple[str, ...]:
        """The keys that a stage reads."""
        return tuple(name for name, field in cls.declared_keys().items() if stage in notes_of(field).stage.split())

    @model_validator(mode="before")
    @classmethod
    def _check_exclusive_keys(cls, given: Any) -> Any:
        return refuse_exclusive_keys(given, cls.not_together)

    @model_validator(mode="after")
    def _check_required_keys(self) -> Keys:
        fields = type(self).model_fields
        given = {fields[name].alias or name for name in self.model_fields_set}
        if self.at_least_one and not given & set(self.at_least_one):
            listed = ", ".join(f"`{name}`" for name in self.at_least_one)
            accepted = f"at least one of {listed} (lines that start with # do not count)"
            raise InputError("", self.none_given, accepted=accepted)
        for name, other in self.requires.items():
            if name in given and other not in given:
                accepted = f"`{other}`, which `{name}` needs: {type(self).declared_keys()[other].description}"
                raise InputError("", f"the key {other!r} is missing", accepted=accepted)
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        schema = handler(core)
        block = handler.resolve_ref_schema(schema)
        if cls.not_together:
            block["allOf"] = [{"not": {"required": list(pair)}} for pair in cls.not_together]
        if cls.at_least_one:
            block["anyOf"] = [{"required": [name]} for name in cls.at_least_one]
        if cls.requires:
            block["dependentRequired"] = {name: [other] for name, other in cls.requires.items()}
        return schema


def refuse_exclusive_keys(value: Any, pairs: Iterable[tuple[str, str]]) -> Any:
    """Refuse a mapping that has both keys of a pair; return any other value."""
    for first, second in pairs:
        if isinstance(value, Mapping) and first in value and second in value:
            accepted = f"either `{first}` or `{second}`"
            raise InputError("", f"`{first}` and `{second}` exclude each other", accepted=accepted)
    return value


@dataclass(frozen=True)
class OneOf:
    """A word (or number) of a list, in any letter case and with either letter µ.

    Parameters
    ----------
    choices : the list, or a function that returns the names of a registry; it is called when a value is checked
    """

    choices: tuple[str | int, ...] | Callable[[], Iterable[str]]

    @property
    def listed(self) -> tuple[str | int, ...]:
        """The accepted values."""
        return tuple(self.choices()) if callable(self.choices) else self.choices

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(
        self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"enum": list(self.listed)}

    def _checked(self, value: Any) -> str | int:
        for choice in self.listed:
            same = case_folded(value) == case_folded(str(choice)) if isinstance(value, str) else value == choice
            if same and not isinstance(value, bool) and isinstance(value, str) == isinstance(choice, str):
                return choice
        raise PydanticCustomError("one_of", "not a listed value", {"choices": self.listed})


def case_folded(word: Any) -> str:
    """A word in lower case, with u for both letters µ."""
    return unicodedata.normalize("NFKC", str(word)).casefold().replace("\N{GREEK SMALL LETTER MU}", "u")


@dataclass(frozen=True)
class Choice:
    """A value of one of several forms, by its keys or its type. The path of an error names the form as ``<number>``.

    Parameters
    ----------
    form : the value as written → number of the member of the union
    not_together : pairs of keys that belong to different forms and exclude each other
    """

    form: Callable[[Any], int]
    not_together: tuple[tuple[str, str], ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        forms: dict[Hashable, core_schema.CoreSchema] = {
            f"<{number}>": handler.generate_schema(member) for number, member in enumerate(get_args(source))
        }
        union = core_schema.tagged_union_schema(forms, discriminator=lambda value: f"<{self.form(value)}>")
        return core_schema.no_info_before_validator_function(
            lambda value: refuse_exclusive_keys(value, self.not_together), union
        )


def by_key(*keys: str) -> Callable[[Any], int]:
    """The form whose key a mapping has; the first one if it has none of them."""

    def form(value: Any) -> int:
        given = value if isinstance(value, Mapping) else {}
        return next((number for number, name in enumerate(keys) if name in given), 0)

    return form


def by_word(name: str, *words: str) -> Callable[[Any], int]:
    """The form whose word a key of a mapping holds; the last one if it holds another."""

    def form(value: Any) -> int:
        word = case_folded(value.get(name)) if isinstance(value, Mapping) else ""
        return words.index(word) if word in words else len(words)

    return form


def mapping_or_value(value: Any) -> int:
    """Form 0 for a mapping, 1 for anything else."""
    return 0 if isinstance(value, Mapping) else 1


@dataclass(frozen=True)
class Items:
    """A list without repeated items, or a list of increasing numbers."""

    rising: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(
        self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {**handler(core), "uniqueItems": True}

    def _checked(self, items: Any) -> Any:
        if self.rising and any(second <= first for first, second in pairwise(items)):
            accepted = "a list of increasing values"
            raise InputError("", "the values do not increase", found=list(items), accepted=accepted)
        repeated = next((item for number, item in enumerate(items) if item in items[:number]), None)
        if repeated is not None:
            raise InputError("", "an item is listed twice", found=repeated, accepted="each item once")
        return items


WHOLE = BeforeValidator(lambda value: int(value) if isinstance(value, float) and value.is_integer() else value)
"""Marks an integer that may be written as 1e3."""

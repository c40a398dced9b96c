"""Errors: each says what is wrong, where, what was found, what is accepted and which key to set."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from decimal import Decimal
from functools import partial
from pathlib import PurePath
from typing import Any

_MISLEADING = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters except tabs and line breaks, and characters that reverse the direction of the text after them."""


def printable(text: str) -> str:
    """Text that can be written anywhere and shows what it holds.

    Bytes of a file name that are not UTF-8 appear as ``\\xff``, control characters and those that change the direction of text as
    ``\\x1b`` and ``\\u202e``: a terminal or a browser would obey them.
    """
    decodable = text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    return _MISLEADING.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), decodable)


def shortened(text: str, most: int) -> str:
    """Text of at most so many characters, with "…" in place of the words that exceed them."""
    if len(text) <= most:
        return text
    kept = text[: most - 1]
    return (kept.rpartition(" ")[0] or kept) + "…"


def abbreviated(items: Sequence[str], most: int, separator: str = ", ") -> str:
    """A list for a message, with "…" in place of what exceeds ``most`` items."""
    return separator.join([*items[:most], *(["…"] if len(items) > most else [])])


def plain(value: float, digits: int = 3) -> str:
    """A number to so many significant digits, without an exponent: 1470, not 1.47e+03."""
    return f"{Decimal(f'{value:.{digits}g}'):f}"


class BrdfpipeError(ValueError):
    """Base of all errors that a user can cause."""


class VocabularyError(BrdfpipeError):
    """A dataset does not have the variables, units or attributes of its kind."""


class InputError(BrdfpipeError):
    """A file or a description cannot be used.

    Parameters
    ----------
    file : only its name is shown, so that messages are the same on every machine
    problem : what is wrong, in a few words
    where : line, channel or key inside the file
    found, accepted : the value, and the accepted values
    key : the key of ``material.yaml`` to set
    option : what to give on the command line, where that is the door and not ``material.yaml``
    origin : where the value of the key stands, if not in ``material.yaml``, as ``catalogue.yaml, line 5``
    others : messages on further problems of the same file, which the message does not repeat
    """

    def __init__(
        self,
        file: str | PurePath,
        problem: str,
        *,
        where: str | None = None,
        found: object = None,
        accepted: str | None = None,
        key: str | None = None,
        option: str | None = None,
        origin: str | None = None,
        others: Sequence[str] = (),
    ) -> None:
        self.file = PurePath(file).name or str(file) or "."
        self.problem = problem
        self.where = where
        self.found = found
        self.accepted = accepted
        self.key = key
        self.option = option
        self.origin = origin
        self.others = tuple(others)
        message = f"{self.file}, {where}: {problem}" if where else f"{self.file}: {problem}"
        if found is not None:
            message += f"; found {found}"
        if accepted is not None:
            message += f"; accepted: {accepted}"
        if option is not None:
            message += f"; give {option}"
        elif key is not None:
            message += f"; set `{key}` in material.yaml"
        if option is None and origin is not None:
            message += f"; the present value is that of {origin}"
        super().__init__(printable(message))

    def __reduce__(self) -> tuple[object, ...]:
        # Workers pickle errors; by default only the message would be restored.
        return partial(InputError, **self._named()), (self.file, self.problem)

    def at_command_line(self, options: Mapping[str, str]) -> InputError:
        """The same error with an option of a command in place of the key; ``options`` is key → option, without those that have none."""
        named = self._named() | {"key": None, "option": options.get(self.key or "")}
        return InputError(self.file, self.problem, **named)

    def with_key(self, key: str, own: str) -> InputError:
        """The same error with the key ``own`` in the place of ``key``, and with the keys below it."""
        renamed = {
            name: None if text is None else re.sub(rf"^{re.escape(key)}(?=\.|$)", own, text)
            for name, text in (("key", self.key), ("where", self.where))
        }
        return InputError(self.file, self.problem, **(self._named() | renamed))

    def with_origin(self, origins: Mapping[str, str]) -> InputError:
        """The same error with the place of the value that it is about; ``origins`` is key → place, of keys that stand in another file."""
        found = (origins[key] for key in (self.key, self.where) if key is not None and key in origins)
        return InputError(self.file, self.problem, **(self._named() | {"origin": next(found, self.origin)}))

    def _named(self) -> dict[str, Any]:
        names = ("where", "found", "accepted", "key", "option", "origin", "others")
        return {name: getattr(self, name) for name in names}


@contextmanager
def naming_key(own: str, key: str) -> Iterator[None]:
    """Name the key ``own`` in errors of a function that serves several keys and names ``key``."""
    try:
        yield
    except InputError as refusal:
        raise refusal.with_key(key, own) from None


@contextmanager
def naming_origin(origins: Mapping[str, str]) -> Iterator[None]:
    """Name the file and the line of a value in errors about it; ``origins`` as of :meth:`InputError.with_origin`."""
    try:
        yield
    except InputError as refusal:
        raise (refusal.with_origin(origins) if origins else refusal) from None

"""Lines of a text file with their numbers, for readers whose messages say where a file is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

LARGEST_FILE = 512 * 2**20
"""Bytes of text that are read."""


class Lines:
    """Lines of a file, without blank lines and comments, and without a number of lines at its beginning."""

    def __init__(self, path: Path, comment: str = "#", skip: int = 0) -> None:
        if path.stat().st_size > LARGEST_FILE:
            accepted = f"at most {LARGEST_FILE >> 20} MiB"
            raise InputError(path, "the file is too large", found=f"{path.stat().st_size >> 20} MiB", accepted=accepted)
        text = path.read_bytes().decode("utf-8", "replace")
        if "\0" in text:
            raise InputError(path, "not a text file", found="a null character", accepted="text")
        self._path = path
        self.comments = [
            line.strip()[len(comment) :].strip() for line in text.splitlines() if line.lstrip().startswith(comment)
        ]
        numbered = list(enumerate(text.splitlines(), start=1))[skip:]
        self._lines = [
            (n, line.strip()) for n, line in numbered if line.strip() and not line.lstrip().startswith(comment)
        ]
        self._at = 0

    @property
    def ended(self) -> bool:
        """Whether no line is left."""
        return self._at >= len(self._lines)

    def next(self, wanted: str) -> str:
        """The next line."""
        if self.ended:
            raise InputError(self._path, "the file ends early", found="the end of the file", accepted=wanted)
        self._at += 1
        return self._lines[self._at - 1][1]

    def expect(self, word: str) -> None:
        """Go beyond a line that holds one word, upper and lower case alike."""
        found = self.next(word)
        if found.lower() != word.lower():
            raise self.error("unexpected line", found=repr(found)[:60], accepted=word)

    def numbers(self, count: int, wanted: str) -> Array:
        """The numbers of one line."""
        words = self.next(f"{count} numbers ({wanted})").replace(",", " ").split()
        if len(words) != count:
            raise self.error(f"wrong number of {wanted}", found=f"{len(words)} numbers", accepted=f"{count}")
        return self._finite(words)

    def _finite(self, words: list[str]) -> Array:
        try:
            values = np.array(words, dtype=float)
        except ValueError as error:
            raise self.error("not a number", found=str(error)[-60:], accepted="numbers") from error
        if not np.isfinite(values).all():
            raise self.error("a number is not finite", found=f"{values[~np.isfinite(values)][0]:g}")
        return values

    def gathered(self, count: int, wanted: str, begun: str = "") -> Array:
        """Numbers that may go on over several lines, after those that the present line begins with."""
        words = begun.replace(",", " ").split()
        while len(words) < count:
            words += self.next(f"{count} numbers ({wanted})").replace(",", " ").split()
        if len(words) > count:
            raise self.error(f"wrong number of {wanted}", found=f"{len(words)} numbers", accepted=f"{count}")
        return self._finite(words)

    def number(self, word: str) -> float:
        """A number of the present line."""
        try:
            value = float(word)
        except ValueError as error:
            raise self.error("not a number", found=repr(word)[:40], accepted="a number") from error
        if not np.isfinite(value):
            raise self.error("a number is not finite", found=f"{value:g}")
        return value

    def count(self, word: str, most: int) -> int:
        """A number of values, from 1 to ``most``, of the present line."""
        try:
            count = int(word)
        except ValueError as error:
            raise self.error("not a count", found=repr(word)[:40], accepted=f"an integer from 1 to {most}") from error
        if not 1 <= count <= most:
            raise self.error("count out of range", found=count, accepted=f"1 to {most}")
        return count

    def error(self, problem: str, **words: object) -> InputError:
        """An error at the present line."""
        number = self._lines[self._at - 1][0] if self._at else 1
        return InputError(self._path, problem, where=f"line {number}", **words)  # type: ignore[arg-type]

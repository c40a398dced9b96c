"""Numbers as text, many at once: every number of a table has the same width, so that whole arrays are converted by arithmetic."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

Bytes = NDArray[np.uint8]

DIGITS = 5
"""Significant digits of the values of a table: a relative error of at most 5e-5."""

_ZERO = ord("0")
_BATCH = 1 << 16
"""Numbers that are converted at a time: what is between fits into the cache, and takes a few megabytes whatever the size of the table."""
_LARGEST_EXPONENT, _MOST_DIGITS = 99, 16
_OFFSET = _LARGEST_EXPONENT


def scientific(values: Array, digits: int = DIGITS) -> Bytes:
    """Numbers >= 0 as ``d.dddde-dd``, (…, digits + 5) characters; ``digits`` from 2 to 16.

    Raises BrdfpipeError: a value is negative, not finite, or above 1e99. Values below 1e-99 become 0.
    """
    values = np.asarray(values, dtype=float)
    if values.size and not (values.min() >= 0 and values.max() < 1e99):
        raise BrdfpipeError(
            f"a table of text takes numbers from 0 to 1e99; found {values.min():g} to {values.max():g}; "
            "the BSDF has no such values where it was checked: look at its checks"
        )
    flat = values.reshape(-1)
    text = np.empty((flat.size, digits + 5), dtype=np.uint8)
    text[:, 1], text[:, digits + 1] = ord("."), ord("e")
    for start in range(0, flat.size, _BATCH):
        _convert(flat[start : start + _BATCH], digits, text[start : start + _BATCH])
    return text.reshape(*values.shape, digits + 5)


def _convert(values: Array, digits: int, text: Bytes) -> None:
    """Write the digits and the exponents of a batch into its text."""
    values = np.where(values < 1e-99, 0.0, values)
    positive = values > 0
    powers = _powers()
    exponent = np.floor(np.log10(np.where(positive, values, 1.0))).astype(np.int32)

    def rounded() -> NDArray[np.int64]:
        return np.asarray(np.rint(values * powers[digits - 1 - exponent + _OFFSET]).astype(np.int64))

    mantissa = rounded()
    # Rounding, and the logarithm of a power of ten, may cross a decade.
    low = positive & (mantissa < 10 ** (digits - 1))
    if low.any():
        exponent -= low
        mantissa = rounded()
    high = mantissa >= 10**digits
    if high.any():
        exponent += high
        mantissa = np.where(high, mantissa // 10, mantissa)
    place = digits + 1
    while place > 2:
        width = min(place - 2, 4)
        mantissa, last = mantissa // 10**width, mantissa % 10**width
        text[:, place - width : place] = _words(width)[last]
        place -= width
    text[:, 0] = _ZERO + mantissa
    text[:, digits + 2 :] = _exponents()[exponent + _LARGEST_EXPONENT]


@cache
def _powers() -> Array:
    """10 to the power of −99 to 99 + the most digits."""
    return np.power(10.0, np.arange(-_OFFSET, _LARGEST_EXPONENT + _MOST_DIGITS + 1, dtype=float))


@cache
def _words(digits: int) -> Bytes:
    """All numbers of so many digits, (10**digits, digits) characters."""
    places = 10 ** np.arange(digits - 1, -1, -1)
    return (_ZERO + np.arange(10**digits)[:, None] // places % 10).astype(np.uint8)


@cache
def _exponents() -> Bytes:
    """−99 to 99 as sign and two digits."""
    return texts([f"{exponent:+03d}" for exponent in range(-_LARGEST_EXPONENT, _LARGEST_EXPONENT + 1)])


def texts(words: list[str]) -> Bytes:
    """Words of one length as characters, (words, length); shorter ones are filled with blanks in front."""
    width = max((len(word) for word in words), default=0)
    filled = "".join(word.rjust(width) for word in words).encode("ascii")
    return np.frombuffer(filled, dtype=np.uint8).reshape(len(words), width)


def lines(columns: list[Bytes], separator: str = ",") -> bytes:
    """Lines of text from columns of characters, (lines, width) each."""
    count, parts = columns[0].shape[0], list[Bytes]()
    for number, column in enumerate(columns):
        end = "\n" if number == len(columns) - 1 else separator
        parts += [column, np.full((count, 1), ord(end), dtype=np.uint8)]
    return np.concatenate(parts, axis=1).tobytes()


def rows(values: Array, separator: str = "\t", digits: int = DIGITS) -> bytes:
    """A matrix of numbers >= 0, one line for each of its rows."""
    text = scientific(values, digits)
    count, columns, width = text.shape
    table = np.empty((count, columns, width + 1), dtype=np.uint8)
    table[..., :width], table[..., width] = text, ord(separator)
    table[:, -1, width] = ord("\n")
    return table.tobytes()

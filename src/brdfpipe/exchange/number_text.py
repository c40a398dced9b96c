"""Numbers as text, many at once: every number of a table has the same width, so that whole arrays are converted by arithmetic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array

Bytes = NDArray[np.uint8]

DIGITS = 5
"""Significant digits of the values of a table: a relative error of at most 5e-5."""

_ZERO = ord("0")


def scientific(values: Array, digits: int = DIGITS) -> Bytes:
    """Numbers >= 0 as ``d.dddde-dd``, (…, digits + 5) characters.

    Raises BrdfpipeError: a value is negative, not finite, or above 1e99. Values below 1e-99 become 0.
    """
    values = np.asarray(values, dtype=float)
    if values.size and not (values.min() >= 0 and values.max() < 1e99):
        raise BrdfpipeError(
            f"a table of text takes numbers from 0 to 1e99; found {values.min():g} to {values.max():g}; "
            "the BSDF has no such values where it was checked: look at its checks"
        )
    values = np.where(values < 1e-99, 0.0, values)
    positive = values > 0
    exponent = np.floor(np.log10(np.where(positive, values, 1.0))).astype(np.int64)
    mantissa = np.rint(values * 10.0 ** (digits - 1 - exponent)).astype(np.int64)
    # Rounding, and the logarithm of a power of ten, may cross a decade.
    low = positive & (mantissa < 10 ** (digits - 1))
    exponent -= low
    mantissa = np.where(low, np.rint(values * 10.0 ** (digits - 1 - exponent)).astype(np.int64), mantissa)
    high = mantissa >= 10**digits
    exponent += high
    mantissa = np.where(high, mantissa // 10, mantissa)
    text = np.empty((*values.shape, digits + 5), dtype=np.uint8)
    for place in range(digits, 1, -1):
        mantissa, last = np.divmod(mantissa, 10)
        text[..., place] = _ZERO + last
    text[..., 0], text[..., 1] = _ZERO + mantissa, ord(".")
    text[..., digits + 1] = ord("e")
    text[..., digits + 2] = np.where(exponent < 0, ord("-"), ord("+"))
    text[..., digits + 3], text[..., digits + 4] = (_ZERO + part for part in np.divmod(np.abs(exponent), 10))
    return text


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

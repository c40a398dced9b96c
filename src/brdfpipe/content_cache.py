"""A cache of what is computed from arrays, by their content: datasets that differ in some variables share what follows from the others."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")


def cached_by_content(results: int) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Cache a function of arrays for the last ``results`` different arguments, compared by type, shape and content.

    Everyone gets the same result: nobody may change its arrays. A comparison takes about 0.5 ns for each byte of the arguments.
    """

    def decorate(compute: Callable[..., Result]) -> Callable[..., Result]:
        of_arguments = lru_cache(results)(lambda given: compute(*given.arrays))
        return wraps(compute)(lambda *arrays: of_arguments(_Arguments(_digest(arrays), arrays)))

    return decorate


@dataclass(frozen=True)
class _Arguments:
    """Arrays that are equal if their digests are."""

    digest: bytes
    arrays: tuple[Any, ...] = field(compare=False)


def _digest(arrays: tuple[Any, ...]) -> bytes:
    content = hashlib.sha256()
    for array in map(np.asarray, arrays):
        content.update(f"{array.dtype.str}{array.shape}".encode())
        content.update(np.ascontiguousarray(array).data)
    return content.digest()

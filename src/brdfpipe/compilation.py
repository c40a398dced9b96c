"""Compilation of numerical loops to machine code.

Functions that call each other belong in one module, because the compiler's cache of a function does not see changes in other modules.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile at the first call, without the interpreter's lock; keep the machine code where there is a place to write.

    No ``fastmath`` and one thread: results are the same on every run. A division by zero gives an infinity or NaN, as in NumPy.
    """
    import numba

    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package nor the user's cache folder can be written
        return numba.njit(**options)(function)

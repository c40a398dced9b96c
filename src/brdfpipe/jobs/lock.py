"""One build at a time in a folder of results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from brdfpipe.catalogue.names import LOCK
from brdfpipe.errors import BrdfpipeError


class BuildError(BrdfpipeError):
    """The build as a whole could not be done."""


@contextmanager
def locked(results: Path) -> Iterator[None]:
    """Hold the folder of results; it is made if missing.

    Raises
    ------
    BuildError : another build runs there, or it cannot be written.
    """
    from filelock import FileLock, Timeout

    try:
        results.mkdir(parents=True, exist_ok=True)
        lock = FileLock(results / LOCK, timeout=0)
        lock.acquire()
    except Timeout:
        raise BuildError(
            f"{results}: another build is running there; wait for it or choose another --results"
        ) from None
    except OSError as error:
        raise BuildError(f"{results}: cannot be written ({error.strerror})") from error
    try:
        yield
    finally:
        lock.release()

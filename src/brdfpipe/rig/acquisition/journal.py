"""The journal of a run: what was done, one JSON object a line, on the disk before the next thing is done.

It is a record, not the truth: what is finished is told by the frames themselves. A line that a power cut tore off is removed when
the journal is opened again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from brdfpipe import store
from brdfpipe.errors import printable

_LARGEST = 256 * 2**20


class Journal:
    """An open journal, which only grows.

    Parameters
    ----------
    path : made if it is not there
    clock : seconds, noted with every event

    Raises
    ------
    StoreError : it cannot be written.
    """

    def __init__(self, path: Path, clock: Callable[[], float]) -> None:
        self._path = path
        self._clock = clock
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise self._refusal(error) from error
        torn = self._heal()
        if torn:
            self.append("healed", removed=torn)

    def append(self, event: str, **facts: Any) -> None:
        """Write one event; when this returns it is on the disk.

        Raises
        ------
        StoreError : the disk is full; no half line stays.
        """
        line = store.canonical_json({"clock": round(self._clock(), 6), "event": event, **facts}) + "\n"
        before = os.fstat(self._file).st_size
        try:
            left = memoryview(line.encode("utf-8", "backslashreplace"))
            while left:
                left = left[os.write(self._file, left) :]
            os.fsync(self._file)
        except BaseException as error:  # an interrupt must not leave half a line either
            os.ftruncate(self._file, before)
            if isinstance(error, OSError):
                raise self._refusal(error) from error
            raise

    def close(self) -> None:
        """Give the file back."""
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _heal(self) -> int:
        """Cut off what stands behind the last whole line; return how many bytes that was."""
        size = os.fstat(self._file).st_size
        whole, block = size, 4096
        while whole:
            start = max(0, whole - block)
            os.lseek(self._file, start, os.SEEK_SET)
            chunk = os.read(self._file, whole - start)
            end = chunk.rfind(b"\n")
            whole = start + end + 1 if end >= 0 else start
            if end >= 0:
                break
        if whole < size:
            os.ftruncate(self._file, whole)
            os.fsync(self._file)
        return size - whole

    def _refusal(self, error: OSError) -> store.StoreError:
        reason = error.strerror or error
        return store.StoreError(
            f"{self._path}: could not be written ({reason}); is the disk full or the folder read-only?"
        )


def read(path: Path) -> list[dict[str, Any]]:
    """The events of a journal; lines that are none are passed over, as the last one of a run that lost its power.

    Raises
    ------
    StoreError : the file is too large for a journal.
    """
    if not path.is_file():
        return []
    if path.stat().st_size > _LARGEST:
        raise store.StoreError(f"{printable(str(path))}: too large for a journal; move it away")
    events = []
    for line in path.read_bytes().splitlines():
        try:
            event = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(event, dict) and isinstance(event.get("event"), str):
            events.append(event)
    return events

"""The journal of a run: one JSON object per line for each event, on disk before the next step begins.

It is a record: only the frames themselves decide what is finished.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

from brdfpipe import store
from brdfpipe.errors import printable

_LARGEST_JOURNAL = 256 * 2**20


class Journal:
    """An open journal, created if it does not exist; events are only appended. A line left incomplete by a power failure is removed.

    The seconds of the clock are recorded with every event. Raises StoreError: the file cannot be written.
    """

    def __init__(self, path: Path, clock: Callable[[], float]) -> None:
        self._path = path
        self._clock = clock
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise self._write_error(error) from error
        if removed := self._remove_incomplete_line():
            self.append("repaired", removed=removed)

    def append(self, event: str, **facts: Any) -> None:
        """Write one event; it is on disk when this returns. Raises StoreError: the disk is full; no incomplete line remains."""
        line = store.canonical_json({"clock": round(self._clock(), 6), "event": event, **facts}) + "\n"
        before = os.fstat(self._file).st_size
        try:
            left = memoryview(line.encode("utf-8", "backslashreplace"))
            while left:
                left = left[os.write(self._file, left) :]
            os.fsync(self._file)
        except BaseException as error:  # an interrupt must not leave an incomplete line either
            os.ftruncate(self._file, before)
            if isinstance(error, OSError):
                raise self._write_error(error) from error
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._file)

    def _remove_incomplete_line(self) -> int:
        """Remove what follows the last complete line; return the number of bytes removed."""
        size = os.fstat(self._file).st_size
        complete, block = size, 4096
        while complete:
            start = max(0, complete - block)
            os.lseek(self._file, start, os.SEEK_SET)
            newline = os.read(self._file, complete - start).rfind(b"\n")
            complete = start + newline + 1
            if newline >= 0:
                break
        if complete < size:
            os.ftruncate(self._file, complete)
            os.fsync(self._file)
        return size - complete

    def _write_error(self, error: OSError) -> store.StoreError:
        problem = f"could not be written ({error.strerror or error}); is the disk full or the folder read-only?"
        return store.StoreError(f"{self._path}: {problem}")


def read(path: Path) -> list[dict[str, Any]]:
    """The events of a journal. Invalid lines are skipped, such as the last one after a power failure.

    Raises StoreError: the file is too large for a journal.
    """
    if not path.is_file():
        return []
    if path.stat().st_size > _LARGEST_JOURNAL:
        raise store.StoreError(f"{printable(str(path))}: too large for a journal; move the file away")
    events = []
    for line in path.read_bytes().splitlines():
        try:
            event = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(event, dict) and isinstance(event.get("event"), str):
            events.append(event)
    return events


def recorded_digests(events: Iterable[dict[str, Any]]) -> dict[int, str]:
    """The digest of each frame by its ordinal, of the last event that recorded it. Entries of other types are ignored."""
    return {
        event["shot"]: event["sha256"]
        for event in events
        if event["event"] in ("frame", "adopted")
        and isinstance(event.get("shot"), int)
        and isinstance(event.get("sha256"), str)
    }


def rejected_digests(events: Iterable[dict[str, Any]]) -> set[str]:
    """Digests of frames of rejected arrangements that were not accepted later. Entries of other types are ignored."""
    rejected: set[str] = set()
    for event in events:
        digests = event.get("sha256")
        if event["event"] in ("rejected", "accepted") and isinstance(digests, list):
            named = {digest for digest in digests if isinstance(digest, str)}
            rejected = rejected | named if event["event"] == "rejected" else rejected - named
    return rejected


def left_out(events: Iterable[dict[str, Any]]) -> set[int]:
    """Ordinals of frames that a scan found not to be needed, and that no later event has. Entries of other types are ignored."""
    ordinals: set[int] = set()
    for event in events:
        if event["event"] == "left out" and isinstance(event.get("shots"), list):
            ordinals |= {ordinal for ordinal in event["shots"] if isinstance(ordinal, int)}
        elif event["event"] in ("frame", "adopted") and isinstance(event.get("shot"), int):
            ordinals.discard(event["shot"])
    return ordinals

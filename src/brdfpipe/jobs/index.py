"""The index of a folder of results: what each job read and wrote, by content, so that a change is noticed whatever the times of files say.

It is a text file of one JSON object a line, followed by its checksum; a later line replaces an earlier one of the same file or job. A line
that a killed build left unfinished, or whose checksum is wrong, is ignored: its job runs again.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from brdfpipe.errors import InputError
from brdfpipe.store import StoreError, canonical_json, file_digest, write_text

INDEX = ".index.jsonl"
"""In the folder of results."""

_PART = ".index.{}.jsonl"
"""What a process on the node of a cluster recorded."""

SETTLED_NS = 50_000_000
"""A file that changed less than 50 ms ago may change again without another time: the clock of a file system has coarse steps."""

_MOST_SUPERSEDED = 0.5
"""Share of superseded lines above which the file is written anew."""

_DIGITS = 32
"""Of a digest, hexadecimal."""

Inputs = tuple[tuple[str, str], ...]
"""Name and digest of the content of each input; see :meth:`Index.inputs`."""


class Stamp(NamedTuple):
    """What the file system says of a file; while it stays the same, so does the content."""

    size: int
    mtime_ns: int
    ctime_ns: int
    inode: int


@dataclass(frozen=True)
class Record:
    """A job that succeeded."""

    parameters: str
    """Digest of the parameters of the stage."""
    code: str
    """Digest of the code of the stage."""
    inputs: Inputs
    outputs: Mapping[str, str]
    """Path → digest of the content."""


class Completed(NamedTuple):
    """The last build without failures, since when no job has run."""

    fingerprint: str
    """Of all that the build depended on beside its files."""
    files: tuple[str, ...]
    content: str
    """Digest of the digests of these files."""


class Index:
    """The files of a folder of results and the raw files of its materials, with the digests of their contents, and the jobs.

    A path is relative to the folder, or absolute for a raw file. Several threads may use one index.

    Parameters
    ----------
    folder : of the results
    apart : of a process on the node of a cluster: what it records goes to a file of its own, because processes on several machines cannot
        append to one file. It reads none. The next index of the folder takes these files over.
    """

    def __init__(self, folder: Path, apart: bool = False) -> None:
        self.folder = folder.resolve()
        self._path = self.folder / (_PART.format(f"{socket.gethostname()}-{os.getpid()}") if apart else INDEX)
        self._root = str(self.folder)
        self.jobs: dict[str, Record] = {}
        """By the first output."""
        self.examined: Mapping[str, str | None] = {}
        """Results and raw files of the build → digest of the content when it was planned; empty if nothing was planned."""
        self.replaced: set[str] = set()
        """Results of which the build found that they are not what their jobs wrote."""
        self.damaged_lines = 0
        """Of the file, when it was read; one that a killed build left unfinished does not count."""
        self._completed: Completed | None = None
        self._files: dict[str, tuple[Stamp, str]] = {}
        self._written: dict[str, str] = {}
        """Result → digest of what its job wrote."""
        self._lock = threading.Lock()
        if not apart:
            self._read()

    # --- files

    def digest(self, path: str) -> str | None:
        """Digest of the content that a file has now; it is read only if its stamp changed. None: there is no such file."""
        stamp = self._stamp(path)
        if stamp is None:
            return None
        known = self._files.get(path)
        if known and known[0] == stamp:
            return known[1]
        return self._read_content(path, stamp)

    def time(self, path: str) -> int:
        """Time of the last change of a file, ns; 0: there is no such file."""
        known = self._files.get(path)
        stamp = known[0] if known else self._stamp(path)
        return stamp.mtime_ns if stamp else 0

    def touch(self, path: str, time_ns: int) -> None:
        """Give a result a later time."""
        digest = self.digest(path)
        os.utime(self.folder / path, ns=(time_ns, time_ns))
        stamp = self._stamp(path)
        if digest and stamp:
            with self._lock:
                self._files[path] = stamp, digest
                self._append({"file": path, "is": [*stamp, digest]})

    def damaged(self, paths: Iterable[str]) -> list[str]:
        """Results that are not what their jobs wrote; each is read whole, whatever its stamp."""
        damaged = []
        for path in paths:
            stamp = self._stamp(path)
            if path in self._written and stamp and self._read_content(path, stamp) != self._written[path]:
                damaged.append(path)
        return damaged

    def inputs(self, paths: Iterable[str], absent: Callable[[str], str] = lambda path: "") -> Inputs:
        """Names and digests of input files; ``absent`` gives that of a file that does not exist.

        A raw file is named without its folder, so that a catalogue may be moved.
        """
        return tuple(sorted((_name(path), self.digest(path) or absent(path)) for path in paths))

    @property
    def written(self) -> list[str]:
        """Every result that a job wrote, what it wrote beside its outputs included."""
        return list(self._written)

    # --- jobs

    def start(self, outputs: Sequence[str]) -> None:
        """Forget a job, by its outputs, before it runs: if it is stopped, it runs again."""
        self.forget(outputs[0])

    def forget(self, job: str) -> None:
        """Forget a job, by its first output, with the digests of what it wrote."""
        with self._lock:
            self._forget(job)
            self._append({"job": job})

    def finish(self, parameters: str, code: str, inputs: Inputs, outputs: Sequence[str]) -> None:
        """Record a job that succeeded; its outputs are read, what it wrote beside them included."""
        stamps = {path: self._stamp(path) for path in outputs}
        files = {path: (stamp, _file_digest(self.folder / path)) for path, stamp in stamps.items() if stamp}
        record = Record(parameters, code, inputs, {path: digest for path, (_, digest) in files.items()})
        line = {
            "job": outputs[0],
            "parameters": parameters,
            "code": code,
            "inputs": inputs,
            "outputs": {path: [*stamp, digest] for path, (stamp, digest) in files.items()},
        }
        with self._lock:
            self._files |= files
            self._written |= record.outputs
            self.jobs[outputs[0]] = record
            self._append(line)

    def complete(self, fingerprint: str, files: Mapping[str, str | None]) -> None:
        """Record a build without failures: the fingerprint of all that it depended on, its files, and what their jobs wrote beside them.

        Nothing is recorded if a raw file is not what it was when the build was planned, ``files``, or a result not what its job wrote:
        the next build compares the jobs one by one.
        """
        beside = {path: None for job in files.keys() & self.jobs.keys() for path in sorted(self.jobs[job].outputs)}
        files = beside | dict(files)
        if any(self.digest(path) not in self._expected(path, planned) for path, planned in files.items()):
            return
        present = tuple(path for path in files if self.digest(path))
        completed = Completed(fingerprint, present, self._content(present))
        with self._lock:
            self._completed = completed
            self._append({"completed": completed})

    def is_complete(self, fingerprint: str) -> bool:
        """Whether nothing changed since the last build without failures."""
        last = self._completed
        return last is not None and last.fingerprint == fingerprint and last.content == self._content(last.files)

    def _expected(self, path: str, planned: str | None) -> tuple[str | None, ...]:
        """Contents that a file may have at the end of a build without failures; a result that only other jobs need may be absent."""
        return (planned,) if os.path.isabs(path) else (self._written.get(path), None)  # noqa: PTH117 - as in _stamp

    def _content(self, files: Sequence[str]) -> str:
        return digest_of([self.digest(path) for path in files])

    def _forget(self, job: str) -> None:
        self._completed = None
        if record := self.jobs.pop(job, None):
            for path in record.outputs:
                self._written.pop(path, None)

    # --- the file

    def _stamp(self, path: str) -> Stamp | None:
        try:
            status = os.stat(os.path.join(self._root, path))  # noqa: PTH116, PTH118 - of many files; a Path takes four times as long
        except OSError:
            return None
        return Stamp(status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)

    def _read_content(self, path: str, stamp: Stamp) -> str | None:
        now = time.time_ns()
        try:
            digest = _file_digest(self.folder / path)
        except InputError:
            return None
        settled = now - max(stamp.mtime_ns, stamp.ctime_ns) > SETTLED_NS or digest == self._written.get(path)
        if settled and stamp == self._stamp(path):
            with self._lock:
                self._files[path] = stamp, digest
                self._append({"file": path, "is": [*stamp, digest]})
        return digest

    def _append(self, line: Mapping[str, Any]) -> None:
        # Where the disk is full, the job runs again in the next build.
        with suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(with_checksum(canonical_json(line)) + "\n")

    def _read(self) -> None:
        if self._path.is_symlink() and not self._path.exists():  # nothing could be appended to it
            with suppress(OSError):
                self._path.unlink()
        parts = sorted(self.folder.glob(_PART.format("*")), key=lambda path: path.stat().st_mtime_ns)
        lines = [""]
        for path in (self._path, *parts):
            with suppress(OSError):
                lines += path.read_text(encoding="utf-8", errors="replace").split("\n")
        live: dict[tuple[str, str], str] = {}
        for line in filter(None, lines):
            try:
                subject = self._take(json.loads(_checked(line)))
            except (ValueError, KeyError, TypeError, AttributeError):
                self.damaged_lines += line is not lines[-1]
                continue
            live.pop(subject, None)  # later lines stay later
            live[subject] = line
        if parts or lines[-1] or self.damaged_lines or len(lines) * (1 - _MOST_SUPERSEDED) > len(live) + 2:
            with suppress(OSError, StoreError):  # the disk is full or the folder write-protected: nothing is lost
                write_text(self._path, "".join(f"{line}\n" for line in live.values()))
                for path in parts:
                    path.unlink()

    def _take(self, line: Mapping[str, Any]) -> tuple[str, str]:
        """Take over one line of the file; return what it is about: a later line of the same replaces it."""
        if "file" in line:
            self._files[line["file"]] = _stamp_and_digest(line["is"])
            return "file", line["file"]
        if "job" in line and "outputs" not in line:
            self._forget(line["job"])
            return "job", line["job"]
        if "job" in line:
            files = {path: _stamp_and_digest(values) for path, values in line["outputs"].items()}
            written = {path: digest for path, (_, digest) in files.items()}
            inputs = tuple((name, digest) for name, digest in line["inputs"])
            self.jobs[line["job"]] = Record(line["parameters"], line["code"], inputs, written)
            self._files |= files
            self._written |= written
            return "job", line["job"]
        fingerprint, paths, content = line["completed"]
        self._completed = Completed(fingerprint, tuple(paths), content)
        return "completed", ""


_shared: dict[Path, Index] = {}


def shared_index(folder: Path, fresh: bool = False) -> Index:
    """The index of a folder that all parts of a build share; ``fresh``: read anew, at the start of a build."""
    folder = folder.resolve()
    if fresh or folder not in _shared:
        _shared[folder] = Index(folder)
    return _shared[folder]


def record_apart(folder: Path) -> None:
    """Let this process, on the node of a cluster, record its jobs in a file of its own."""
    _shared[folder.resolve()] = Index(folder, apart=True)


def digest_of(value: Any) -> str:
    """Digest of a value that JSON can hold."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()[:_DIGITS]


def with_checksum(text: str) -> str:
    """A line of the index: a text and its checksum."""
    return f"{text} {zlib.crc32(text.encode()):08x}"


def _checked(line: str) -> str:
    """The text of a line. Raises ValueError: its checksum is wrong."""
    text = line.rpartition(" ")[0]
    if line != with_checksum(text):
        raise ValueError("damaged")
    return text


def _file_digest(path: Path) -> str:
    return file_digest(path)[:_DIGITS]


def _stamp_and_digest(values: Sequence[Any]) -> tuple[Stamp, str]:
    *stamp, digest = values
    return Stamp(*stamp), digest


def _name(path: str) -> str:
    return f"/{Path(path).name}" if Path(path).is_absolute() else path

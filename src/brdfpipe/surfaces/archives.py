"""Limits of untrusted zip archives: sizes are checked before anything is decompressed."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

from brdfpipe.errors import InputError

MAX_POINTS = 2**28
"""Most heights of a file."""
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, ValueError, KeyError)
"""Exceptions that zipfile raises on damaged, encrypted or unknown content."""

_MAX_RATIO = 200
_RATIO_FROM = 2**24


def checked_names(archive: zipfile.ZipFile, path: Path, most: int) -> list[str]:
    """Names of the entries; too many or repeated ones are refused."""
    names = archive.namelist()
    if len(names) > most or len(set(names)) < len(names):
        raise InputError(path, "too many or repeated entries in the archive", found=f"{len(names)} entries")
    return names


def check_inflated(path: Path, where: str | None, inflated: int, compressed: int, most: int) -> None:
    """Refuse content that is larger than ``most`` bytes or compressed more than measured values can be."""
    if inflated > most or inflated > max(_RATIO_FROM, _MAX_RATIO * compressed):
        found, accepted = f"{inflated} bytes", f"up to {most >> 20} MiB, compressed at most {_MAX_RATIO} times"
        raise InputError(path, "the content is suspiciously large", where=where, found=found, accepted=accepted)

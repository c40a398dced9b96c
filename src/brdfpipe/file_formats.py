"""File formats that readers register, and which of them a file has.

The extension or the description selects the format. Readers are never tried in turn: some would open damaged files, or files of
another kind, without an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from brdfpipe.errors import InputError


@dataclass(frozen=True)
class FileFormat:
    """A format of raw files."""

    name: str
    """Value of the key ``format``."""
    extensions: tuple[str, ...]
    """Extensions that select it; without any it must be named."""
    description: str
    """What a file holds, or what reading it needs, for the documentation."""


AnyFormat = TypeVar("AnyFormat", bound=FileFormat)


def extensions(formats: Mapping[str, FileFormat]) -> tuple[str, ...]:
    """Extensions of all formats, sorted."""
    return tuple(sorted(extension for known in formats.values() for extension in known.extensions))


def format_of(path: Path, name: str | None, formats: Mapping[str, AnyFormat], key: str) -> AnyFormat:
    """The format of a file: that of the name or, without a name, that of the extension.

    Raises InputError: unknown name or extension; ``key`` is the key of material.yaml to set.
    """
    if name is not None:
        if name not in formats:
            raise InputError(path, "unknown format", found=repr(name)[:40], accepted=", ".join(formats), key=key)
        return formats[name]
    for known in formats.values():
        if path.suffix.lower() in known.extensions:
            return known
    found, accepted = path.suffix or "no extension", f"{', '.join(extensions(formats))}; or set the format"
    raise InputError(path, "unknown file extension", found=found, accepted=accepted, key=key)

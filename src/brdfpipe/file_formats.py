"""File formats that readers register, and which of them a file has.

The extension or the description selects the format. Readers are never tried in turn: some would open damaged files, or files of
another kind, without an error.
"""

from __future__ import annotations

import mimetypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath
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
    read_by: str = field(default="brdfpipe", kw_only=True)
    """The program whose code reads it."""
    tried: str = field(default="", kw_only=True)
    """Files on which reading was tried, and what they are, for the documentation; empty without any but those that the tests write."""


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


def media_type(name: str) -> str:
    """The media type (RFC 6838) of a file, by its extension; ``application/octet-stream`` of an unknown one."""
    return _media_types().get(PurePosixPath(name).suffix.lower(), "application/octet-stream")


@cache
def _media_types() -> dict[str, str]:
    # Those of Python: `mimetypes.types_map` may hold those of the machine, which differ.
    return mimetypes.MimeTypes().types_map[True] | {
        ".astm": "text/plain",
        ".brdf": "text/plain",
        ".lock": "text/plain",
        ".nc": "application/x-netcdf",
        ".yaml": "application/yaml",
    }

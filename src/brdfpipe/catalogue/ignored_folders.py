"""Folders of a catalogue that look like materials and are not read as such."""

from __future__ import annotations

import re
from pathlib import Path

from brdfpipe.catalogue.names import CALIBRATIONS, DESCRIPTION, RESULT_MARKS
from brdfpipe.errors import printable


def ignored(folder: Path) -> dict[str, str]:
    """Folders that look like materials and are ignored: name → what was found and what to do, in one line."""
    reasons: dict[str, str] = {}
    for item in sorted(item for item in folder.iterdir() if item.is_dir() and not item.name.startswith((".", "_"))):
        if item.name == CALIBRATIONS or (item / DESCRIPTION).is_file():
            continue
        if not any((item / mark).exists() for mark in RESULT_MARKS) and (reason := _reason(item)):
            reasons[printable(item.name)] = reason
    return reasons


def _reason(folder: Path) -> str | None:
    try:
        names = sorted(item.name for item in folder.iterdir() if not item.name.startswith("."))
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    misnamed = [name for name in names if re.fullmatch(r"material\.ya?ml(\.txt)?", name, re.IGNORECASE)]
    if misnamed:
        return f"{misnamed[0]} is not read; rename it to {DESCRIPTION}"
    deeper = [name for name in names if (folder / name / DESCRIPTION).is_file()]
    if deeper:
        return f"{DESCRIPTION} is one folder too deep, in {deeper[0]}; move that folder into the catalogue itself"
    from brdfpipe.columns import TEXT_SUFFIXES
    from brdfpipe.surfaces.reading import FORMATS

    suffixes = {*TEXT_SUFFIXES, *(suffix for format in FORMATS.values() for suffix in format.extensions)}
    raw = [name for name in names if Path(name).suffix.lower() in suffixes and (folder / name).is_file()]
    if raw:
        return f"{raw[0]} but no {DESCRIPTION}; `brdfpipe new` with the folder's name writes one beside the raw files"
    return None

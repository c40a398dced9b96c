"""Names of a catalogue: its files and folders, and the names that materials may have."""

from __future__ import annotations

import re
from pathlib import Path

from brdfpipe.descriptions.keys import NAME, NAME_WORDS
from brdfpipe.errors import BrdfpipeError, InputError

DESCRIPTION = "material.yaml"

DEFAULTS = "catalogue.yaml"
"""File of a catalogue with what its materials inherit."""

CALIBRATIONS, CALIBRATION = "calibrations", "calibration.yaml"
"""A catalogue describes the calibrations of its rigs in this folder, each in a folder of its own with this description."""

CHANGES = "changes.html"
"""Page of ``brdfpipe diff`` in a folder of results; the page of the catalogue links to it."""

RESERVED = frozenset(
    {"logs", "failures", "exports", "calibrations", "scenes", "catalogue", "index", "index.html"}
    | {"catalogue.nc", "catalogue.csv", "catalogue.lock.json", CHANGES}
)
"""Names with another meaning in the folder of results."""

LOCK = ".build.lock"
"""File by which a command keeps others out of a folder of results."""

RESULT_MARKS = (LOCK, ".snakemake", "catalogue.nc")
"""Files that identify a folder of results."""


class CatalogueError(BrdfpipeError):
    """The catalogue or the configuration as a whole cannot be used."""


def check_name(name: str, path: Path | None = None) -> None:
    """Refuse a name given on the command line or, with ``path``, in a description or as its folder.

    Raises InputError, CatalogueError: with and without ``path``.
    """
    if not re.fullmatch(NAME, name):
        problem, key, accepted = "not an accepted name", "name", NAME_WORDS
    elif name.casefold() in RESERVED:
        problem, key, accepted = "a reserved name", None, "any other name"
    elif re.search(r"(.+)\1{19}$", name):
        # Snakemake takes it for a rule that feeds itself, and refuses the whole workflow.
        problem, key, accepted = "ends with 20 repetitions of one text", "name", "a name without them"
    else:
        return
    if path is None:
        raise CatalogueError(f"the name {name!r}: {problem}; accepted: {accepted}")
    raise InputError(path, problem, where="name", found=repr(name), accepted=accepted, key=key)

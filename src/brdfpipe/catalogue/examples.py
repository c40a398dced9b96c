"""The example catalogue, which is installed with the package."""

from __future__ import annotations

import shutil
from pathlib import Path

from brdfpipe import installation
from brdfpipe.catalogue.names import CALIBRATIONS, DESCRIPTION, CatalogueError


def copy_examples(folder: Path) -> list[str]:
    """Copy the examples to a new or an empty folder; return the names of the materials and of the folder of calibrations.

    Raises
    ------
    CatalogueError : the folder holds something, or cannot be written.
    """
    source = installation.project_folder() / "examples"
    names = [*sorted(path.parent.name for path in source.glob(f"*/{DESCRIPTION}")), CALIBRATIONS]
    if folder.exists() and any(folder.iterdir()):
        raise CatalogueError(f"{folder}: holds files already; give a new folder")
    try:
        for name in names:
            shutil.copytree(source / name, folder / name)
    except OSError as error:
        raise CatalogueError(f"{folder}: cannot be written ({error.strerror or error})") from error
    return names

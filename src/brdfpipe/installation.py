"""Location of the Snakefile, the workflow and the configuration."""

from __future__ import annotations

from pathlib import Path

from brdfpipe.errors import BrdfpipeError


def project_folder() -> Path:
    """The folder of Snakefile, workflow and config: beside the sources in a checkout, inside the package once installed.

    Raises BrdfpipeError: the workflow is not installed with the package.
    """
    package = Path(__file__).resolve().parent
    for candidate in (package / "_project", package.parents[1]):
        if (candidate / "Snakefile").is_file():
            return candidate
    raise BrdfpipeError(f"{package}: the workflow (Snakefile, workflow, config) is not installed with the package")

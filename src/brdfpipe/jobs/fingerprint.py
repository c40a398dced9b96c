"""Fingerprint of all that a build depends on beside raw files and results: descriptions, configuration, code and libraries.

Where it and all files are as after the last build without failures, nothing has to be planned: see :meth:`brdfpipe.jobs.index.Index.is_complete`.
It need not say what changed, so it may change too often: a new time of a source file changes it, and then jobs are compared one by one.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from brdfpipe import installation
from brdfpipe.catalogue.calibration import Calibration
from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.material import Material
from brdfpipe.catalogue.names import CHANGES
from brdfpipe.jobs.index import digest_of
from brdfpipe.jobs.rules import scenes_present
from brdfpipe.jobs.runs import planned_runs, results_folder


def fingerprint(catalogue: Catalogue, results: Path) -> str:
    """Fingerprint of a build of a catalogue into a folder of results."""
    owners: list[Material | Calibration] = [*catalogue.materials, *catalogue.calibrations.values()]
    runs = planned_runs(catalogue)[0]
    return digest_of(
        {
            "folder": str(catalogue.folder),
            "owners": [[results_folder(one), one.content] for one in owners],
            "scenes": {material.name: material.scene.name for material in catalogue.materials},
            "contents": {scene.name: scene.content for scene in catalogue.scenes},
            "runs": {folder: [str(run.arrangements), run.sources] for folder, run in runs.items()},
            "refused": catalogue.failures,
            "config": catalogue.config,
            "present": scenes_present(results, catalogue),
            "changes": (results / CHANGES).is_file(),
            "sources": list(_sources()),
            "libraries": sorted({name for folder in sys.path for name in _installed(folder)}),
            "python": sys.version,
        }
    )


def _sources() -> Iterator[tuple[str, int, int]]:
    """Path, size and time of each file of the package, the workflow and the configuration."""
    project, package = installation.project_folder(), Path(installation.__file__).parent
    for folder in (package, project / "workflow", project / "config"):
        for place, folders, files in os.walk(folder):
            folders[:] = sorted(name for name in folders if name != "__pycache__")
            for path in (Path(place, name) for name in sorted(files)):
                with suppress(FileNotFoundError):  # an editor marks an open file by a link to nowhere
                    status = path.stat()
                    yield str(path), status.st_size, status.st_mtime_ns
    snakefile = (project / "Snakefile").stat()
    yield "Snakefile", snakefile.st_size, snakefile.st_mtime_ns


def _installed(folder: str) -> list[str]:
    """Names of the installed distributions, with their versions, in a folder of the module search path."""
    try:
        return [item.name for item in Path(folder or ".").iterdir() if item.suffix == ".dist-info"]
    except OSError:
        return []

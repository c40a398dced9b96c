"""Builds in processes of their own, which may be killed, and the results that they leave."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

_BUILD = """
import sys
from pathlib import Path
from brdfpipe import installation
project, *arguments = sys.argv[1:]
installation.project_folder = lambda: Path(project)
from brdfpipe.cli.main import main
main(["build", *arguments])
"""

_NOTES = ("logs", "failures")
"""Folders that say how and when something was built."""

MOST_KILLS = 200
"""A build that has not ended after so many kills does not resume."""


def start_build(
    project: Path, folder: Path, results: Path, *options: str, environment: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    """Build a catalogue with the workflow of a project in another process, on two cores by default; its output goes to one pipe.

    ``environment``: variables beside those of this process.
    """
    command = [sys.executable, "-c", _BUILD, project, folder, "--results", results, "--cores", "2", *options]
    variables = {**os.environ, **(environment or {})}
    return subprocess.Popen(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=variables
    )


def kill_until_complete(start: Callable[[], subprocess.Popen[str]], seconds: Callable[[], float]) -> int:
    """Start a build again and again, and kill each after some time, until one ends by itself; return the number of kills."""
    for kills in range(MOST_KILLS):
        process = start()
        try:
            output, _ = process.communicate(timeout=seconds())
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            continue
        assert process.returncode == 0, output
        return kills
    raise AssertionError(f"the build had not ended after {MOST_KILLS} kills")


def contents(results: Path) -> dict[str, bytes]:
    """Every result by its path, without logs and what the machinery keeps for itself in hidden files."""
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file() and not _is_note(path.relative_to(results))
    }


def _is_note(place: Path) -> bool:
    return place.parts[0] in _NOTES or place.parts[0].startswith(".")

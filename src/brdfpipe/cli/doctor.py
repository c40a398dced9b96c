"""The command ``brdfpipe doctor``: whether this installation and this machine can build a catalogue."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

import click
from packaging.requirements import Requirement

from brdfpipe.cli.console import exit_on_error
from brdfpipe.errors import BrdfpipeError

EXTRAS = {
    "plot": "figures: `dataset.bsdf.plot`, `brdfpipe plot`",
    "instruments": "profilometers' own file formats",
    "excel": "spectra in spreadsheets",
    "alpaca": "cameras behind ASCOM Alpaca",
    "cluster": "jobs of a cluster's scheduler",
}
"""Optional parts of the installation, and what each adds."""

_MEMORY_OF_A_JOB = 1.0
"""GB that a stage needs at least, with its libraries."""

_DISK = 1.0
"""GB below which the disk is short: the results of a scanned material take up to some 10 MB."""


class Finding(NamedTuple):
    """One thing that was looked at."""

    name: str
    state: str
    """``ok``; ``note`` for what is missing and not needed; ``fail`` for what keeps a build from working."""
    words: str


@click.command(short_help="Check the installation and the machine.")
@click.option(
    "--results",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Folder whose disk is looked at.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@exit_on_error
def doctor(results: Path, as_json: bool) -> int:
    """Check the installation and the machine: versions, libraries, extras, cores, memory and disk.

    Exit code: 1 if something that every build needs is missing or does not work.
    """
    found = findings(results)
    if as_json:
        click.echo(json.dumps([one._asdict() for one in found], indent=1, ensure_ascii=False))
    else:
        width = max(len(one.name) for one in found) + 2
        for one in found:
            click.echo(f"{one.state:<6}{one.name:<{width}}{one.words}")
        failed = sum(one.state == "fail" for one in found)
        click.echo("ready to build" if not failed else f"{failed} to be mended before a build")
    return 1 if any(one.state == "fail" for one in found) else 0


def findings(results: Path) -> list[Finding]:
    """Everything that ``brdfpipe doctor`` reports."""
    return [
        *_installation(),
        *_libraries(),
        *_extras(),
        *_machine(results),
        _dataset_written_and_read(),
    ]


def _installation() -> Iterator[Finding]:
    from brdfpipe.installation import project_folder

    state = "ok" if sys.version_info >= (3, 11) else "fail"
    yield Finding("Python", state, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    try:
        yield Finding("brdfpipe", "ok", f"{version('brdfpipe')}, workflow in {project_folder()}")
    except (BrdfpipeError, PackageNotFoundError) as error:
        yield Finding("brdfpipe", "fail", f"{error}; install it again")


def _requirements(extra: str = "") -> list[Requirement]:
    """What the package needs on this machine, or what an extra needs beside that; empty where the distribution is missing."""
    try:
        declared = [Requirement(text) for text in requires("brdfpipe") or []]
    except PackageNotFoundError:
        return []
    return [one for one in declared if _applies(one, extra) and not (extra and _applies(one, ""))]


def _applies(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


def _problem(requirement: Requirement) -> str:
    """What is wrong with an installed library; empty if nothing is."""
    try:
        present = version(requirement.name)
    except PackageNotFoundError:
        return f"{requirement.name} is not installed"
    accepted = requirement.specifier
    return "" if accepted.contains(present, prereleases=True) else f"{requirement.name} {present} is not {accepted}"


def _libraries() -> Iterator[Finding]:
    needed = _requirements()
    problems = [problem for one in needed if (problem := _problem(one))]
    if needed:
        yield Finding("libraries", "fail" if problems else "ok", "; ".join(problems) or f"all {len(needed)} as needed")
    else:
        yield Finding("libraries", "note", "not checked: only an installed package declares them")
    shown = ("numpy", "scipy", "numba", "xarray", "netCDF4", "snakemake")
    yield Finding("versions", "ok", ", ".join(f"{name} {_version(name)}" for name in shown))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _extras() -> Iterator[Finding]:
    for extra, adds in EXTRAS.items():
        needed = _requirements(extra)
        complete = bool(needed) and not any(map(_problem, needed))
        advice = adds if complete else f"{adds}: pip install 'brdfpipe[{extra}]'"
        yield Finding(f"extra {extra}", "ok" if complete else "note", advice)


def _machine(results: Path) -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding("cores", "ok", f"{cores}: as many stages run at the same time")
    memory = _available_memory()
    if memory is None:
        yield Finding("memory", "note", "how much is free is not known on this system; 1 GB for each core is needed")
    else:
        enough = memory >= _MEMORY_OF_A_JOB
        advice = (
            ""
            if memory >= cores * _MEMORY_OF_A_JOB
            else f"; too little for {cores} cores: build with --cores {max(1, int(memory))}"
        )
        yield Finding("memory", ("ok" if not advice else "note") if enough else "fail", f"{memory:.1f} GB free{advice}")
    folder = next(place for place in (results.absolute(), *results.absolute().parents) if place.is_dir())
    free = shutil.disk_usage(folder).free / 1e9
    writable = os.access(folder, os.W_OK)
    state = "ok" if free >= _DISK and writable else "fail"
    yield Finding("disk", state, f"{free:.1f} GB free in {folder}" + ("" if writable else ", which cannot be written"))


def _available_memory() -> float | None:
    """Memory that programs can take [GB]; None where the system does not say."""
    try:
        found = re.search(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text(encoding="ascii"))
    except OSError:
        return None
    return int(found[1]) / 1e6 if found else None


def _dataset_written_and_read() -> Finding:
    """A dataset is computed, written and read again, as every stage does."""
    from brdfpipe import store
    from brdfpipe.optics.index import refractive_index

    try:
        with tempfile.TemporaryDirectory(prefix="brdfpipe-") as folder:
            path = Path(folder) / "index.nc"
            store.save_dataset(
                refractive_index("ABS"), path, stage="index", material="doctor", inputs={}, parameters={}
            )
            store.verify_digest(store.open_dataset(path, "index"), path.name)
    except (BrdfpipeError, OSError, ImportError) as error:
        return Finding("datasets", "fail", f"cannot be written and read here: {error}")
    return Finding("datasets", "ok", "written and read again")

"""One archive of a catalogue and its results, from which both can be checked and the results built again."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from brdfpipe import installation, store
from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.names import CALIBRATIONS
from brdfpipe.errors import BrdfpipeError
from brdfpipe.releases.metadata import METADATA, Part, crate

INPUTS, RESULTS, SOFTWARE = "inputs", "results", "software"
"""Folders of the archive."""

_NOT_RESULTS = ("logs", "failures")
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest time that a zip archive can hold: equal releases have equal bytes."""

_README = """\
{title}

inputs/    the materials: descriptions and raw files
results/   what was computed from them; index.html is the catalogue
software/  the configuration, and the exact versions of all libraries
{metadata}  who made it, and the size and sha256 of every file

Check that nothing is damaged:  brdfpipe verify ARCHIVE
Build the results again, with brdfpipe {version} and the libraries of software/requirements.lock:
    brdfpipe build inputs --config software/config.yaml --results rebuilt
Equal files have equal bytes; rebuilt/catalogue.lock.json has the digests of all datasets, as results/catalogue.lock.json.
"""


def write_archive(
    catalogue: Catalogue, results: Path, release: Mapping[str, Any], config: Path | None, target: Path
) -> list[Part]:
    """Write a release as a zip archive; it appears whole or not at all, with the same bytes for the same content.

    Parameters
    ----------
    catalogue : what was built
    results : folder of its results, up to date
    release : as :class:`.release_keys.Release` declares
    config : the configuration of the build, if not the project's own
    target : the file to write

    Returns
    -------
    The files of the archive, without the metadata

    Raises
    ------
    BrdfpipeError : a material could not be built, or there are no results.
    """
    if not (results / "index.html").is_file():
        raise BrdfpipeError(f"{results}: no results of a catalogue; run `brdfpipe build` first")
    if catalogue.failures:
        names = ", ".join(sorted(catalogue.failures)[:5])
        raise BrdfpipeError(f"materials that cannot be built: {names}; mend or remove them before a release")
    files = dict(_files(catalogue, results, config))
    if str(target.resolve()) in {str(path.resolve()) for path in files.values()}:
        raise BrdfpipeError(f"{target}: is one of the files to archive; choose another name or folder")
    parts = [Part(name, path.stat().st_size, store.file_digest(path)) for name, path in sorted(files.items())]
    materials = {item.name: str(item.content.get("description", "")) for item in catalogue.materials}
    metadata = json.dumps(crate(release, parts, materials), indent=1, ensure_ascii=False, sort_keys=True) + "\n"
    readme = _README.format(title=release["title"], metadata=METADATA, version=version("brdfpipe"))
    with (
        store.atomic_path(target, size_hint=sum(part.size for part in parts)) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive,
    ):
        for name, text in ((METADATA, metadata), ("README.txt", readme)):
            archive.writestr(_entry(name), text.encode("utf-8"))
        for part in parts:
            with files[part.name].open("rb") as source, archive.open(_entry(part.name), "w", force_zip64=True) as copy:
                while block := source.read(2**20):
                    copy.write(block)
    return parts


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    return entry


def _files(catalogue: Catalogue, results: Path, config: Path | None) -> Iterator[tuple[str, Path]]:
    """Name in the archive → file."""
    folders = [material.folder for material in catalogue.materials]
    folders += [catalogue.folder / CALIBRATIONS / name for name in catalogue.calibrations]
    for folder in folders:
        for path in _regular_files(folder):
            yield f"{INPUTS}/{path.relative_to(catalogue.folder).as_posix()}", path
    for path in _regular_files(results):
        place = path.relative_to(results)
        if place.parts[0] not in _NOT_RESULTS and not any(part.startswith(".") for part in place.parts):
            yield f"{RESULTS}/{place.as_posix()}", path
    project = installation.project_folder()
    yield f"{SOFTWARE}/config.yaml", config or project / "config" / "config.yaml"
    if (project / "requirements.lock").is_file():
        yield f"{SOFTWARE}/requirements.lock", project / "requirements.lock"


def _regular_files(folder: Path) -> Iterator[Path]:
    """Files below a folder in a fixed order; hidden ones and links are left out."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and not path.name.startswith("."):
            yield path

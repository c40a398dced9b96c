"""One archive of a catalogue and its results, from which both can be checked and the results built again."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from brdfpipe import installation, store
from brdfpipe.catalogue.calibration import run_file
from brdfpipe.catalogue.catalogue import Catalogue
from brdfpipe.catalogue.material import raw_files
from brdfpipe.catalogue.names import CALIBRATION, CALIBRATIONS, DEFAULTS, DESCRIPTION
from brdfpipe.errors import BrdfpipeError, abbreviated, printable
from brdfpipe.jobs.cleanup import NOTES, STALE
from brdfpipe.releases.differences import Release
from brdfpipe.releases.metadata import METADATA, README, Part, crate
from brdfpipe.scenes.scene import FOLDER, is_file, parts_within_scene

INPUTS, RESULTS, SOFTWARE = "inputs", "results", "software"
"""Folders of the archive."""

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
    BrdfpipeError : a material could not be built, there are no results, a file that a description names would be left out, or a name is
        not UTF-8.
    """
    if not (results / "index.html").is_file():
        raise BrdfpipeError(f"{results}: no results of a catalogue; run `brdfpipe build` first")
    if failed := sorted({*catalogue.failures, *_not_built(catalogue, results)}):
        raise BrdfpipeError(
            f"materials that cannot be built: {abbreviated(failed, 5)}; mend or remove them before a release"
        )
    files, owners = dict[str, Path](), dict[str, str]()
    for name, path, material in _files(catalogue, results, config):
        files[name], owners[name] = path, material
    if left_out := [str(path) for path in _named(catalogue) if f"{INPUTS}/{path.as_posix()}" not in files]:
        raise BrdfpipeError(
            f"{left_out[0]}: is a symbolic link or hidden, and would be left out; put the file itself there, without a dot before its name"
        )
    if misnamed := [printable(name) for name in files if printable(name) != name]:
        raise BrdfpipeError(f"{misnamed[0]}: the name is not UTF-8 or has hidden characters; rename or remove the file")
    if str(target.resolve()) in {str(path.resolve()) for path in files.values()}:
        raise BrdfpipeError(f"{target}: is one of the files to archive; choose another name or folder")
    parts = [
        Part(name, path.stat().st_size, store.file_digest(path), owners[name]) for name, path in sorted(files.items())
    ]
    materials = {item.name: str(item.content.get("description", "")) for item in catalogue.materials}
    metadata = json.dumps(crate(release, parts, materials), indent=1, ensure_ascii=False, sort_keys=True) + "\n"
    readme = _README.format(title=release["title"], metadata=METADATA, version=version("brdfpipe"))
    with (
        store.atomic_path(target, size_hint=sum(part.size for part in parts)) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive,
    ):
        for name, text in ((METADATA, metadata), (README, readme)):
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


def _not_built(catalogue: Catalogue, results: Path) -> set[str]:
    """Materials that the tables of the results do not have as built."""
    built = {name for scene in catalogue.scenes for name in Release(results, scene.folder).rows}
    return catalogue.by_name.keys() - built


def _named(catalogue: Catalogue) -> Iterator[Path]:
    """The files that descriptions name, and the descriptions, in relation to the catalogue."""
    if catalogue.defaults.content:
        yield Path(DEFAULTS)
    for material in catalogue.materials:
        names = [DESCRIPTION, *(name for _, _, name in raw_files(material.content))]
        names += [run_file(material.content["rig"], "rig.")[0]] if "rig" in material.content else []
        yield from (material.folder.relative_to(catalogue.folder) / name for name in names)
    for calibration in catalogue.calibrations.values():
        names = [CALIBRATION, calibration.content["certificate"], run_file(calibration.content, "")[0]]
        yield from (Path(CALIBRATIONS, calibration.name, name) for name in names)


def _files(catalogue: Catalogue, results: Path, config: Path | None) -> Iterator[tuple[str, Path, str]]:
    """Name in the archive, file, and the material that it belongs to, if any."""
    folders = [(material.folder, material.name) for material in catalogue.materials]
    folders += [(catalogue.folder / CALIBRATIONS / name, "") for name in catalogue.calibrations]
    for folder, material in folders:
        for path in _regular_files(folder):
            yield f"{INPUTS}/{path.relative_to(catalogue.folder).as_posix()}", path, material
    if catalogue.defaults.content and not (catalogue.folder / DEFAULTS).is_symlink():
        yield f"{INPUTS}/{DEFAULTS}", catalogue.folder / DEFAULTS, ""
    if is_file(scene := str(catalogue.defaults.content.get("scene", ""))):
        if not Path(scene).is_relative_to(catalogue.folder):
            raise BrdfpipeError(f"{DEFAULTS}: its scene {scene} would be left out; put it into the catalogue")
        yield f"{INPUTS}/{Path(scene).relative_to(catalogue.folder).as_posix()}", Path(scene), ""
    for one in catalogue.materials:
        if is_file(str(one.content.get("scene", ""))):
            path = (one.folder / one.content["scene"]).resolve()
            yield f"{INPUTS}/{path.relative_to(catalogue.folder).as_posix()}", path, ""
    stale = {path.parent for path in results.rglob(STALE)}
    # A build of the archive's inputs makes those of the catalogue's own scenes alone; others may be of earlier inputs.
    stale |= {path for path in (results / FOLDER).glob("*") if f"{FOLDER}/{path.name}/" not in _scenes(catalogue)}
    for path in _regular_files(results):
        place = path.relative_to(results)
        hidden = any(part.startswith(".") for part in place.parts)
        if not hidden and place.parts[0] not in NOTES and not stale.intersection(path.parents):
            yield f"{RESULTS}/{place.as_posix()}", path, _material(place, catalogue)
    project = installation.project_folder()
    config = config or project / "config" / "config.yaml"
    yield f"{SOFTWARE}/config.yaml", config, ""
    if is_file(scene := str(catalogue.config["scene"])):
        if not Path(scene).is_relative_to(config.resolve().parent):
            raise BrdfpipeError(f"{config}: its scene {scene} would be left out; put it beside the configuration")
        yield f"{SOFTWARE}/{Path(scene).relative_to(config.resolve().parent).as_posix()}", Path(scene), ""
    if (project / "requirements.lock").is_file():
        yield f"{SOFTWARE}/requirements.lock", project / "requirements.lock", ""


def _scenes(catalogue: Catalogue) -> set[str]:
    """Folders of the scenes of a catalogue in its results."""
    return {scene.folder for scene in catalogue.scenes}


def _material(place: Path, catalogue: Catalogue) -> str:
    """The material of a file in the results; empty for that of a catalogue or a calibration."""
    parts = parts_within_scene(place)
    return parts[0] if len(parts) > 1 and parts[0] in catalogue.by_name else ""


def _regular_files(folder: Path) -> Iterator[Path]:
    """Files below a folder in a fixed order; hidden ones and links are left out."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and not path.name.startswith("."):
            yield path

"""Whether the files of a release are those that were written: sizes and digests of all of them are computed again."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote

from brdfpipe.errors import BrdfpipeError
from brdfpipe.jobs.cleanup import NOTES, STALE
from brdfpipe.jobs.index import INDEX, Index
from brdfpipe.releases.metadata import METADATA, README
from brdfpipe.surfaces.archives import DAMAGE

_MOST_METADATA = 2**28
"""Bytes of metadata that are read: some 100 000 files."""


def verify_archive(path: Path) -> list[str]:
    """Problems of a release, one line for each file that is damaged, missing or unknown; none if it is whole.

    Raises
    ------
    BrdfpipeError : the file is no release: no zip archive, or without metadata.
    """
    from tqdm import tqdm

    try:
        with zipfile.ZipFile(path) as archive:
            listed = _listed(archive, path)
            names = [name for name in archive.namelist() if not name.endswith("/")]
            present = tqdm(sorted(names), unit="file", delay=2.0, disable=None, leave=False)
            problems = [problem for name in present for problem in _problems(archive, name, listed)]
            problems += [f"{name}: appears twice" for name, number in sorted(Counter(names).items()) if number > 1]
    except zipfile.BadZipFile as error:
        raise BrdfpipeError(f"{path.name}: no zip archive, or damaged ({error}); get the file again") from error
    problems += [f"{name}: is missing" for name in sorted(listed.keys() - set(names))]
    return problems


def verify_results(results: Path) -> list[str]:
    """Problems of a folder of results, one line for each file that is not what its job wrote, is missing, or was written by no job.

    Every file is read whole, also those that no stage reads. `brdfpipe build` makes damaged and missing ones again.

    Raises
    ------
    BrdfpipeError : the folder has no index of what a build wrote.
    """
    from tqdm import tqdm

    if not (results / INDEX).is_file():
        raise BrdfpipeError(f"{results}: no results with an index; run `brdfpipe build` first")
    index = Index(results)
    written = {path for record in index.jobs.values() for path in record.outputs}
    problems = (
        [f"{INDEX}: {index.damaged_lines} of its lines damaged; their jobs run again"] if index.damaged_lines else []
    )
    for path in tqdm(sorted(written), unit="file", delay=2.0, disable=None, leave=False):
        if not (results / path).is_file():
            problems.append(f"{path}: is missing")
        elif index.damaged([path]):
            problems.append(f"{path}: is not what the build wrote")
    present = {path.relative_to(results) for path in results.rglob("*") if path.is_file()}
    unknown = {
        str(path)
        for path in present
        if path.parts[0] not in NOTES
        and not path.parts[0].startswith(".")
        and path.name != STALE
        and not path.name.startswith(".")
    }
    return problems + [f"{path}: was written by no build" for path in sorted(unknown - written)]


def _listed(archive: zipfile.ZipFile, path: Path) -> dict[str, tuple[int, str]]:
    """The files of the metadata: name → size and sha256."""
    try:
        if archive.getinfo(METADATA).file_size > _MOST_METADATA:
            raise BrdfpipeError(
                f"{path.name}: {METADATA} is larger than {_MOST_METADATA >> 20} MiB; get the file again"
            )
        graph = json.loads(archive.read(METADATA))["@graph"]
        return {
            unquote(entity["@id"]): (int(entity["contentSize"]), str(entity["sha256"]))
            for entity in graph
            if entity["@type"] == "File"
        }
    except (*DAMAGE, TypeError, AttributeError) as error:
        if isinstance(error, BrdfpipeError):
            raise
        raise BrdfpipeError(
            f"{path.name}: no release ({METADATA} is missing or damaged); `brdfpipe release` writes one"
        ) from error


def _problems(archive: zipfile.ZipFile, name: str, listed: Mapping[str, tuple[int, str]]) -> Iterator[str]:
    if name in (METADATA, README):
        return
    if name not in listed:
        yield f"{name}: is not in the metadata"
        return
    stated, sha256 = listed[name]
    digest = hashlib.sha256()
    size = 0
    try:
        with archive.open(name) as file:
            while size <= stated and (block := file.read(2**20)):  # a bomb is read to its stated size alone
                size += len(block)
                digest.update(block)
    except DAMAGE as error:
        yield f"{name}: is damaged ({error})"
        return
    if size != stated:
        yield f"{name}: has {'more' if size > stated else 'less'} than the {stated} bytes of the metadata"
    elif digest.hexdigest() != sha256:
        yield f"{name}: the content does not match its sha256"

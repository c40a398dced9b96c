"""Metadata of a release in RO-Crate 1.1: the catalogue, a dataset for each material, and every file with its digest.

References
----------
RO-Crate Metadata Specification 1.1 (https://w3id.org/ro/crate/1.1). DataCite Metadata Schema 4.5, whose mandatory properties map to
``name``, ``creator``, ``publisher``, ``datePublished``, ``identifier`` and the type of the root.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import quote

from brdfpipe.file_formats import media_type

PROFILE = "https://w3id.org/ro/crate/1.1"
METADATA = "ro-crate-metadata.json"
README = "README.txt"


class Part(NamedTuple):
    """A file of a release."""

    name: str
    """Path in the archive."""
    size: int
    sha256: str
    material: str = ""
    """That it belongs to, if any."""


def crate(release: Mapping[str, Any], parts: Iterable[Part], materials: Mapping[str, str]) -> dict[str, Any]:
    """The content of ``ro-crate-metadata.json``.

    Parameters
    ----------
    release : as :class:`.release_keys.Release` declares
    parts : the files
    materials : name → description
    """
    parts = sorted(parts)
    files = {part.name: _file(part) for part in parts}
    own: dict[str, list[str]] = {name: [] for name in materials}
    for part in parts:
        if part.material:
            own[part.material].append(files[part.name]["@id"])
    folders = {name: _material(name, text, own[name]) for name, text in sorted(materials.items())}
    nested = {entity["@id"] for folder in folders.values() for entity in folder["hasPart"]}
    others = [{"@id": entity["@id"]} for entity in files.values() if entity["@id"] not in nested]
    creators = [_creator(number, creator) for number, creator in enumerate(release["creators"], start=1)]
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": release["title"],
        "description": release["description"],
        "datePublished": release["date"],
        "license": {"@id": release["license"]},
        "creator": [{"@id": creator["@id"]} for creator in creators],
        "publisher": {"@id": "#publisher"},
        **{name: release[name] for name in ("version", "identifier") if name in release},
        **({"keywords": ", ".join(release["keywords"])} if release.get("keywords") else {}),
        "hasPart": [*({"@id": folder["@id"]} for folder in folders.values()), *others],
    }
    descriptor = {
        "@id": METADATA,
        "@type": "CreativeWork",
        "conformsTo": {"@id": PROFILE},
        "about": {"@id": "./"},
    }
    entities = [
        descriptor,
        root,
        {"@id": release["license"], "@type": "CreativeWork", "name": release["license"]},
        {"@id": "#publisher", "@type": "Organization", "name": release["publisher"]},
        *creators,
        *folders.values(),
        *files.values(),
    ]
    return {"@context": f"{PROFILE}/context", "@graph": entities}


def _file(part: Part) -> dict[str, Any]:
    return {
        "@id": quote(part.name),
        "@type": "File",
        "name": PurePosixPath(part.name).name,
        "contentSize": str(part.size),
        "encodingFormat": media_type(part.name),
        "sha256": part.sha256,
    }


def _material(name: str, description: str, files: Iterable[str]) -> dict[str, Any]:
    """A material: its description, raw files and results in all scenes."""
    return {
        "@id": f"#material-{quote(name)}",
        "@type": "Dataset",
        "name": name,
        **({"description": description} if description else {}),
        "hasPart": [{"@id": file} for file in files],
    }


def _creator(number: int, creator: Mapping[str, str]) -> dict[str, Any]:
    identity = creator.get("orcid", f"#creator-{number}")
    entity = {"@id": identity, "@type": "Person" if "," in creator["name"] else "Organization", "name": creator["name"]}
    return entity | ({"affiliation": creator["affiliation"]} if "affiliation" in creator else {})

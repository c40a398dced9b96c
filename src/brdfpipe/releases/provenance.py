"""What every stored dataset of a material says about its origin."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brdfpipe.store import StoreError


@dataclass(frozen=True)
class Provenance:
    """The origin of one dataset, as :func:`brdfpipe.store.save_dataset` records it."""

    digest: str
    inputs: Mapping[str, str]
    """Name → digest of a dataset, or sha256 of a raw file."""
    parameters: Mapping[str, Any]
    software: Mapping[str, str]
    """Package → version; not part of the digest."""


def read_provenance(path: Path) -> Provenance:
    """The origin of a stored dataset, from its attributes alone.

    Raises
    ------
    StoreError : it is damaged, or has no provenance.
    """
    import netCDF4

    try:
        with netCDF4.Dataset(path) as stored:  # ten times faster than opening it with its variables
            attributes = {name: stored.getncattr(name) for name in ("digest", "inputs", "parameters", "software")}
    except (OSError, RuntimeError, AttributeError) as error:
        raise StoreError(f"{path.name}: no dataset with provenance ({error}); run `brdfpipe build`") from error
    inputs, parameters, software = (json.loads(attributes[name]) for name in ("inputs", "parameters", "software"))
    return Provenance(attributes["digest"], inputs, parameters, software)


def of_material(results: Path, scene_folder: str, material: str) -> dict[str, Provenance]:
    """Stage → origin of its dataset: those of a scene, and those that scenes share. Raises StoreError: one is damaged."""
    folders = dict.fromkeys([results / material, results / scene_folder / material])
    files = {path.relative_to(folder): path for folder in folders for path in sorted(folder.rglob("*.nc"))}
    return {str(name.with_suffix("")): read_provenance(path) for name, path in files.items()}

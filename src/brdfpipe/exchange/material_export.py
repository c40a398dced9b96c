"""The files of a material in a format of other programs, and the dataset that says what was written or why nothing was."""

from __future__ import annotations

import json
from pathlib import Path

import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.store import canonical_json


def export(bsdf: xr.Dataset, folder: Path, material: str, format: str, side: str) -> xr.Dataset:
    """Write the files of one side of a material; a refusal is a result and no error, so that the material is built without these files.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    folder : of the files; what an earlier run wrote there for this format and side is deleted
    material : begins the names of the files
    format, side : keys of :data:`brdfpipe.exchange.registry.FORMATS` and of its ``files``

    Returns
    -------
    Dataset of kind ``export`` without variables. Attributes: ``format``, ``side``; ``files``, JSON {name: sha256}, empty of a refused one; ``records``, JSON
    {name: record}, see :mod:`brdfpipe.exchange.records`; ``warnings``, the reason of a refusal

    Raises
    ------
    StoreError : the files cannot be written, or the BSDF not be read.
    """
    declared = FORMATS[format]
    paths = [folder / f"{material}{suffix}" for suffix in declared.suffixes(side)]
    folder.mkdir(parents=True, exist_ok=True)
    _delete(paths)
    records, warnings = {}, list[str]()
    try:
        records = declared.write(bsdf, folder / material, side)
    except store.StoreError:
        raise
    except BrdfpipeError as refusal:
        _delete(paths)
        warnings = [f"{refused(format, side)}: {' '.join(str(refusal).split())}"]
    attributes = {
        "format": format,
        "side": side,
        "files": canonical_json({path.name: store.file_digest(path) for path in paths if path.exists()}),
        "records": canonical_json(records),
        "warnings": json.dumps(warnings, ensure_ascii=False),
    }
    return vocabulary.label(xr.Dataset(attrs=attributes), "export")


def refused(format: str, side: str = "reflection") -> str:
    """What a refusal begins with."""
    return f"export {format}{'' if side == 'reflection' else f' of {side}'} not written"


def _delete(paths: list[Path]) -> None:
    for path in paths:
        path.unlink(missing_ok=True)

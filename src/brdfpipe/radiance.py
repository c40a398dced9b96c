"""A BSDF as a material of Radiance: the file of a tensor tree or of Klems matrices, and the primitive that uses it."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe.exchange.registry import FORMATS, RECORD, ExchangeError

_FORMATS = ("tensor-tree", "klems")


def material(
    bsdf: xr.Dataset,
    folder: str | os.PathLike[str],
    name: str | None = None,
    *,
    format: str = "tensor-tree",
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    thickness: float = 0.0,
    **options: Any,
) -> str:
    """Write the file of a BSDF for Radiance, and return the primitive ``BSDF`` that uses it.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    folder : where the file is written, with a record of its error and of what it leaves out
    name : of the file and of the modifier, by default that of the material; blanks become ``_``
    format : ``tensor-tree`` or ``klems``
    up : vector that lies, projected onto the surface, at the azimuth 90 degree of the BSDF, thus across a lay at azimuth 0 and along one at 90;
        not along the normal
    thickness : of a sheet that a pane stands for, in the unit of the scene; 0 shows the BSDF from both sides
    options : of the format

    Returns
    -------
    Lines of a scene description; comments state what Radiance does not get

    Raises
    ------
    ExchangeError : the format or an option is unknown, or the path has a blank, which no primitive can hold.
    """
    if format not in _FORMATS:
        raise ExchangeError(f"unknown format {format!r} of Radiance; accepted: {', '.join(_FORMATS)}")
    modifier = re.sub(r"\s+", "_", name or str(bsdf.attrs.get("material", "material")))
    declared = FORMATS[format]
    path = Path(folder) / f"{modifier}{declared.suffixes('reflection')[0]}"
    if re.search(r"\s", str(path)):
        raise ExchangeError(f"{path.name}: the path has a blank, at which Radiance ends a word; found {str(path)!r}")
    declared.write(bsdf, Path(folder) / modifier, **options)
    record = json.loads(Path(f"{path}{RECORD}").read_text(encoding="utf-8"))
    notes = [f"# NOT in this material: {' '.join(text.split())}" for text in record["left_out"].values()]
    vector = " ".join(f"{one:g}" for one in up)
    return "\n".join([*notes, f"void BSDF {modifier}", f"6 {thickness:g} {path} {vector} .", "0", "0", ""])

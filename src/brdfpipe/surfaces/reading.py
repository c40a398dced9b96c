"""Which reader reads a file, and the stage that turns a file into a levelled surface.

The format follows from the extension or from the material file, never from trying readers until one succeeds: corrupt files
and files of another kind would open as something.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe.errors import InputError
from brdfpipe.surfaces.heights import Heights, examine, surface_dataset
from brdfpipe.surfaces.levelling import level
from brdfpipe.surfaces.text import read_text
from brdfpipe.surfaces.x3p import read_x3p


@dataclass(frozen=True)
class Format:
    """A file format: its reader, the extensions it goes by, and the options the reader takes."""

    read: Callable[..., Heights]
    extensions: tuple[str, ...]
    options: tuple[str, ...] = ()


FORMATS: Mapping[str, Format] = {
    "text": Format(read_text, (".txt", ".csv", ".dat", ".asc", ".xyz"), ("layout", "unit", "lateral_unit", "pitch")),
    "x3p": Format(read_x3p, (".x3p",)),
}
"""To add a format, write a reader that returns :class:`~brdfpipe.surfaces.heights.Heights` and name it here."""

_INGEST_KEYS = ("file", "format", "form", "isotropic")


def read_surface(path: str | os.PathLike[str], format: str | None = None, **options: Any) -> xr.Dataset:
    """Read a measured surface and check that it can be one.

    Parameters
    ----------
    path : the file
    format : ``text`` or ``x3p``; by default from the extension
    **options : of the text format alone: ``layout`` (``line``, ``grid``, ``xyz``), ``unit`` of the heights and
        ``lateral_unit`` (nm, um, mm, m), ``pitch`` (number or pair [x, y], in ``lateral_unit``); see
        :func:`brdfpipe.surfaces.text.read_text`

    Returns
    -------
    Dataset of kind ``surface``: ``height(y, x)`` or ``height(x)`` [um], missing is NaN, not levelled; coordinates from 0
    [um]; attributes ``pitch_x``, ``pitch_y`` (areal alone) [um], ``levelling`` = "none", ``band``. float32 where the file
    carries float32, else float64. The first row and column of the file lie at y = 0 and x = 0.

    Raises
    ------
    InputError : the file cannot be read, its unit is not known, or its heights cannot be those of a surface to scatter
        light (see :func:`brdfpipe.surfaces.heights.examine`).
    """
    path = Path(path)
    chosen = FORMATS[_format_name(path, format)]
    given = {name: value for name, value in options.items() if value is not None}
    for name in given:
        if name not in chosen.options:
            raise InputError(
                path,
                "this key does not apply to this format",
                where=f"surface.{name}",
                found=given[name],
                accepted=", ".join(chosen.options) or "no reading options: the file states its own units and pitch",
            )
    return examine(surface_dataset(chosen.read(path, **given)), path)


def ingest(path: str | os.PathLike[str], spec: Mapping[str, Any]) -> xr.Dataset:
    """The stage ``surface``: read, check and level a file as a material's ``surface`` mapping says.

    Parameters
    ----------
    path : the file that ``spec["file"]`` names, resolved
    spec : ``format``, ``layout``, ``unit``, ``lateral_unit``, ``pitch``, ``form`` (default plane); what other
        stages read of the same mapping (``isotropic``) is passed over

    Returns
    -------
    Dataset of kind ``surface``, levelled.

    Raises
    ------
    InputError : as :func:`read_surface`; or the form is not known.
    """
    options = {key: value for key, value in spec.items() if key not in _INGEST_KEYS}
    surface = read_surface(path, spec.get("format"), **options)
    form = spec.get("form") or "plane"
    if form not in ("plane", "none"):
        raise InputError(Path(path), "unknown form to level by", found=form, accepted="plane, none", key="surface.form")
    return level(surface, form)


def _format_name(path: Path, name: str | None) -> str:
    if name is not None:
        if name in FORMATS:
            return name
        raise InputError(path, "unknown format", found=name, accepted=", ".join(FORMATS), key="surface.format")
    for candidate, known in FORMATS.items():
        if path.suffix.lower() in known.extensions:
            return candidate
    raise InputError(
        path,
        "the extension tells no known format",
        found=path.suffix or "none",
        accepted="; ".join(f"{key}: {' '.join(known.extensions)}" for key, known in FORMATS.items())
        + " (most instruments export X3P or text)",
        key="surface.format",
    )

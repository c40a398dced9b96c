"""Read, level and filter surface files; formats register here."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.file_formats import format_of
from brdfpipe.surfaces import arrays, instruments, placeholders, text, x3p
from brdfpipe.surfaces.filtering import high_pass, low_pass
from brdfpipe.surfaces.heights import SurfaceFormat, examine, surface_dataset
from brdfpipe.surfaces.levelling import FORMS, level

FORMATS: dict[str, SurfaceFormat] = {
    known.name: known for module in (text, x3p, arrays, instruments) for known in module.FORMATS
}
"""Formats of surface files by name. To add one, write a module with ``FORMATS`` like :mod:`.x3p` and list it above."""


def read_surface(
    path: str | os.PathLike[str], format: str | None = None, *, missing: float | None = None, **options: Any
) -> xr.Dataset:
    """Read a measured surface and check that its heights are plausible.

    Parameters
    ----------
    path : the file
    format : a key of :data:`FORMATS`; by default from the extension
    missing : a height that marks missing ones, in the unit of the file's heights; in um where the file states that unit
    **options : values that the file does not state. Text and NumPy: ``unit`` of the heights and ``lateral_unit`` (nm, um,
        mm, m), ``pitch`` (number or pair [x, y], in ``lateral_unit``); text only: ``layout`` (``line``, ``grid``,
        ``xyz``); instruments' formats: ``channel``, the name of the height channel if there are several; ``nms``:
        ``lateral_unit``

    Returns
    -------
    Dataset of kind ``surface``: ``height(y, x)`` or ``height(x)`` [um], missing is NaN, not levelled; coordinates from 0
    [um]; attributes ``pitch_x``, ``pitch_y`` (maps only) [um], ``levelling`` = "none", ``band``. float32 where the file
    carries float32, else float64. Seen from above, x runs to the right and y upwards: an image whose first row is its upper
    edge is flipped. The first row of text and arrays is at y = 0.

    Raises
    ------
    InputError : the file cannot be read, its unit is unknown, or its heights are implausible
        (see :func:`brdfpipe.surfaces.heights.examine`).
    """
    path = Path(path)
    chosen = format_of(path, format, FORMATS, "surface.format")
    given = {name: value for name, value in options.items() if value is not None}
    for name in given:
        if name not in chosen.options:
            raise InputError(
                path,
                "this key does not apply to the format of the file",
                where=f"surface.{name}",
                found=given[name],
                accepted=", ".join(chosen.options) or "none; the file states units and pitch",
            )
    heights = chosen.read(path, **given)
    if missing is not None:
        height, note = placeholders.as_missing(heights.height, missing, heights.unit)
        heights = replace(heights, height=height, history=(*heights.history, note))
    return examine(surface_dataset(heights), path, chosen.options, heights.unit)


def ingest(path: str | os.PathLike[str], spec: Mapping[str, Any]) -> xr.Dataset:
    """The stage ``surface``: read, check, level and filter a file according to a material's ``surface`` section.

    Parameters
    ----------
    path : the file that ``spec["file"]`` names, resolved
    spec : ``format`` and the reading options of :func:`read_surface`; ``form`` to level by (default plane); ``lambda_s`` and
        ``lambda_c``, cutoffs [um] of a low-pass and a high-pass filter (default none); ``azimuth`` [degree] of a line profile;
        ``repeat``, whether it is of the same place as the first scan; ``file`` has no effect

    Returns
    -------
    Dataset of kind ``surface``, levelled, then low-pass filtered (λs), then high-pass filtered (λc).

    Raises
    ------
    InputError : as :func:`read_surface`, also for an unknown key; an unknown form, or one that the heights do not determine; a cutoff
        out of range; an azimuth of a map.
    """
    path, options = Path(path), dict(spec)
    options.pop("file", None)
    azimuth, repeat = options.pop("azimuth", None), options.pop("repeat", False)
    steps: dict[str, Callable[[xr.Dataset, Any], xr.Dataset]] = {
        "form": level,
        "lambda_s": low_pass,
        "lambda_c": high_pass,
    }
    values = {key: options.pop(key, None) for key in steps}
    values["form"] = values["form"] or FORMS[0]
    surface = read_surface(path, **options)
    for key, step in steps.items():
        try:
            surface = surface if values[key] is None else step(surface, values[key])
        except BrdfpipeError as error:
            raise InputError(path, str(error), key=f"surface.{key}") from error
    if repeat:
        surface = surface.assign_attrs(repeat=1)
    if azimuth is None:
        return surface
    if surface["height"].ndim != 1:
        raise InputError(path, "`azimuth` applies to line profiles only", found="a map", key="surface.azimuth")
    return surface.assign_attrs(azimuth=float(azimuth))


def check_readable(path: str | os.PathLike[str], format: str | None = None) -> None:
    """Check that the reader of a file is known and installed; read nothing.

    Raises InputError: as :func:`read_surface`, or naming the command that installs the optional extra.
    """
    if format_of(Path(path), format, FORMATS, "surface.format") in instruments.FORMATS:
        instruments.check_installed(Path(path))

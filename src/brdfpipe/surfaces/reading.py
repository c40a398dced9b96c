"""Read, level and filter surface files; formats register here.

The extension or the material file selects the format. Readers are never tried in turn: some would open damaged files, or files
of another kind, without an error.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.surfaces import arrays, instruments, text, x3p
from brdfpipe.surfaces.filtering import high_pass, low_pass
from brdfpipe.surfaces.heights import SurfaceFormat, examine, surface_dataset
from brdfpipe.surfaces.levelling import level

FORMATS: dict[str, SurfaceFormat] = {
    known.name: known for module in (text, x3p, arrays, instruments) for known in module.FORMATS
}
"""Formats of surface files by name. To add one, write a module with ``FORMATS`` like :mod:`.x3p` and list it above."""

_STEPS: Mapping[str, Callable[[xr.Dataset, Any], xr.Dataset]] = {
    "form": level,
    "lambda_s": low_pass,
    "lambda_c": high_pass,
}
"""Processing step of each key of the material file, in order."""
_OTHER_KEYS = ("file", "format", "isotropic", "azimuth", "scans", "method")


def read_surface(path: str | os.PathLike[str], format: str | None = None, **options: Any) -> xr.Dataset:
    """Read a measured surface and check that its heights are plausible.

    Parameters
    ----------
    path : the file
    format : a key of :data:`FORMATS`; by default from the extension
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
    chosen = FORMATS[_format_name(path, format)]
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
    return examine(surface_dataset(chosen.read(path, **given)), path)


def ingest(path: str | os.PathLike[str], spec: Mapping[str, Any]) -> xr.Dataset:
    """The stage ``surface``: read, check, level and filter a file according to a material's ``surface`` section.

    Parameters
    ----------
    path : the file that ``spec["file"]`` names, resolved
    spec : ``format`` and the reading options of :func:`read_surface`; ``form`` to level by (default plane); ``lambda_s`` and
        ``lambda_c``, cutoffs [um] of a low-pass and a high-pass filter (default none); keys of other stages
        (``isotropic``) are ignored

    Returns
    -------
    Dataset of kind ``surface``, levelled, then low-pass filtered (λs), then high-pass filtered (λc).

    Raises
    ------
    InputError : as :func:`read_surface`; an unknown form, or one that the heights do not determine; a cutoff out of range.
    """
    options = {key: value for key, value in spec.items() if key not in (*_OTHER_KEYS, *_STEPS)}
    surface = read_surface(path, spec.get("format"), **options)
    parameters = {"form": "plane"} | {key: spec[key] for key in _STEPS if spec.get(key) is not None}
    for key, step in _STEPS.items():
        if key not in parameters:
            continue
        try:
            surface = step(surface, parameters[key])
        except BrdfpipeError as error:
            raise InputError(Path(path), str(error), key=f"surface.{key}") from error
    if "azimuth" not in spec:
        return surface
    if surface["height"].ndim != 1:
        raise InputError(Path(path), "`azimuth` applies to line profiles only", found="a map", key="surface.azimuth")
    return surface.assign_attrs(azimuth=float(spec["azimuth"]))


def check_readable(path: str | os.PathLike[str], format: str | None = None) -> None:
    """Check that the reader of a file is known and installed; read nothing.

    Raises
    ------
    InputError : as :func:`read_surface`, or naming the command that installs the optional extra.
    """
    if _format_name(Path(path), format) in instruments.INSTRUMENTS:
        instruments.check_installed(Path(path))


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
        "unknown file extension",
        found=path.suffix or "none",
        accepted=", ".join(suffix for known in FORMATS.values() for suffix in known.extensions),
        key="surface.format",
    )

"""Read, level and filter surface files; formats register here."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.file_formats import format_of
from brdfpipe.surfaces import arrays, instruments, placeholders, selection, spikes, text, x3p
from brdfpipe.surfaces.filtering import high_pass, low_pass
from brdfpipe.surfaces.heights import Heights, SurfaceFormat, examine, surface_dataset
from brdfpipe.surfaces.levelling import FORMS, level

FORMATS: dict[str, SurfaceFormat] = {
    known.name: known for module in (text, x3p, arrays, instruments) for known in module.FORMATS
}
"""Formats of surface files by name. To add one, write a module with ``FORMATS`` like :mod:`.x3p` and list it above."""

_OPTIONS = frozenset(option for known in FORMATS.values() for option in known.options)
"""Keys that apply to some formats."""

OUTLIERS = ("report", "remove")
"""What is done with spikes; the first one is the default."""

_SPIKE_SHARE = 0.1
"""Share of the mean square slope that spikes carry, from which on they are warned of."""


def read_surface(
    path: str | os.PathLike[str],
    format: str | None = None,
    *,
    missing: float | Sequence[float] | None = None,
    region: Mapping[str, Any] | None = None,
    mask: Mapping[str, Any] | None = None,
    picture: str | os.PathLike[str] | None = None,
    outliers: str | None = None,
    **options: Any,
) -> xr.Dataset:
    """Read a measured surface and check that its heights are plausible.

    Parameters
    ----------
    path : the file
    format : a key of :data:`FORMATS`; by default from the extension
    missing : a height that marks missing ones, or several, in the unit of the file's heights; in um where the file states that unit
    region, mask, picture : the part that counts, see :mod:`brdfpipe.surfaces.selection`; positions are those of the file, before it is cropped
    outliers : ``report`` spikes (the default) or ``remove`` them: they become missing
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
    _check_options(path, chosen, given)
    heights = chosen.read(path, **given)
    declared = () if missing is None else (missing,) if isinstance(missing, int | float) else tuple(missing)
    if declared:
        height, notes = placeholders.as_missing(heights.height, declared, heights.unit)
        heights = replace(heights, height=height, history=(*heights.history, *notes))
    if mask is not None:
        heights = selection.masked(heights, mask, None if picture is None else Path(picture), path)
    if region is not None:
        heights = selection.cropped(heights, region, path)
    heights = _without_spikes(heights, outliers or OUTLIERS[0], path)
    keys = chosen.options if region is None else (*chosen.options, "region")
    return examine(surface_dataset(heights), path, keys, heights.unit, heights.left_out, declared)


def _without_spikes(heights: Heights, outliers: str, path: Path) -> Heights:
    """The heights, with spikes reported or removed."""
    if outliers not in OUTLIERS:
        found, accepted = repr(outliers)[:40], " or ".join(OUTLIERS)
        raise InputError(path, "unknown treatment of spikes", found=found, accepted=accepted, key="surface.outliers")
    found_spikes = spikes.find(heights.height)
    count = int(np.count_nonzero(found_spikes))
    if not count:
        return heights
    cleared = np.where(found_spikes, heights.height.dtype.type(np.nan), heights.height)
    share = 1 - min(1.0, spikes.mean_square_step(cleared) / spikes.mean_square_step(heights.height))
    words = f"{count} heights ({count / found_spikes.size:.2g} of all) stand out of their neighbours like spikes"
    if outliers == "remove":
        note = (
            f"{words} and were taken as missing, as surface.outliers says; the mean square slope fell by {share:.1%}."
        )
        return replace(heights, height=cleared, history=(*heights.history, note))
    if share < _SPIKE_SHARE:
        note = f"{words}; they carry {share:.1%} of the mean square slope."
        return replace(heights, history=(*heights.history, note))
    doubt = (
        f"{words}, and carry {share:.0%} of the mean square slope. Measure again, or set `surface.outliers: remove`."
    )
    return replace(heights, warnings=(*heights.warnings, doubt))


def ingest(
    path: str | os.PathLike[str], spec: Mapping[str, Any], picture: str | os.PathLike[str] | None = None
) -> xr.Dataset:
    """The stage ``surface``: read, check, level and filter a file according to a material's ``surface`` section.

    Parameters
    ----------
    path : the file that ``spec["file"]`` names, resolved
    spec : ``format`` and the reading options of :func:`read_surface`; ``form`` to level by (default plane); ``lambda_s`` and
        ``lambda_c``, cutoffs [um] of a low-pass and a high-pass filter (default none); ``azimuth`` [degree] of a line profile;
        ``repeat``, whether it is of the same place as the first scan; ``file`` has no effect
    picture : the file that ``spec["mask"]`` names, if it does

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
    surface = read_surface(path, picture=picture, **options)
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


def check_readable(
    path: str | os.PathLike[str], format: str | None = None, options: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Check that the reader of a file is known and installed, and takes the options of :func:`read_surface` among others; read nothing.

    Raises InputError: as :func:`read_surface`, or naming the command that installs the optional extra.
    """
    chosen = format_of(Path(path), format, FORMATS, "surface.format")
    given = {name: value for name, value in options.items() if name in _OPTIONS and value is not None}
    _check_options(Path(path), chosen, given)
    if chosen in instruments.FORMATS:
        instruments.check_installed(Path(path))


def _check_options(path: Path, chosen: SurfaceFormat, given: Mapping[str, Any]) -> None:
    for name in given:
        if name not in chosen.options:
            raise InputError(
                path,
                "this key does not apply to the format of the file",
                where=f"surface.{name}",
                found=given[name],
                accepted=", ".join(chosen.options) or "none; the file states units and pitch",
            )

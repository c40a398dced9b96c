"""NumPy arrays on the disk: one array (.npy), or named arrays in a zip archive (.npz).

The header is read first: its size must match the file. Arrays of objects, which could contain code, are refused.
"""

from __future__ import annotations

import math
import os
import tokenize
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.surfaces import archives
from brdfpipe.surfaces.archives import MAX_POINTS
from brdfpipe.surfaces.heights import UNSTATED, Heights, SurfaceFormat
from brdfpipe.surfaces.units import needed_steps, pitch_steps, scales

_SETTINGS = ("pitch", "pitch_x", "pitch_y", "unit", "lateral_unit")
_MAX_ENTRIES = 100
_WHOLE = "a whole file as numpy.save or numpy.savez writes it"

_HEADER_DAMAGE = (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError, tokenize.TokenError)
"""Exceptions that numpy raises on a damaged header."""


def read_npy(path: Path, **stated: Any) -> Heights:
    """Heights [um] of one array as ``numpy.save`` writes it: a line of one dimension, or a map of two, whose rows are y.

    float32 where the file has float32, else float64; NaN is missing. ``stated`` are the options of
    :func:`brdfpipe.surfaces.reading.read_surface`.
    """
    try:
        with path.open("rb") as handle:
            array = _read_array(handle, os.fstat(handle.fileno()).st_size, path, None)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    return _heights(array, {}, path, **stated)


def read_npz(path: Path, **stated: Any) -> Heights:
    """Heights of the array ``height``, or of the only array, of an archive as ``numpy.savez`` writes it; otherwise as :func:`read_npy`.

    The archive may hold the scalars ``pitch``, or ``pitch_x`` and ``pitch_y``, and the texts ``unit`` and ``lateral_unit``;
    ``stated`` overrides them.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.removesuffix(".npy") for name in archives.checked_names(archive, path, _MAX_ENTRIES)]
            entries = dict(zip(names, archive.infolist(), strict=True))
            array = _read_entry(archive, entries[_height_name(names, path)], path)
            settings = {
                name: _setting(_read_entry(archive, entries[name], path), name, path)
                for name in _SETTINGS
                if name in entries
            }
    except InputError:
        raise
    except archives.DAMAGE as error:
        if isinstance(error, OSError) and error.strerror:
            raise InputError(path, f"cannot be read ({error.strerror})") from error
        problem = "not an NPZ archive, or damaged"
        raise InputError(path, problem, accepted=_WHOLE, key="surface.format") from error
    if "pitch" not in settings and "pitch_x" in settings:
        settings["pitch"] = f"{settings['pitch_x']} {settings.get('pitch_y', settings['pitch_x'])}"
    return _heights(array, settings, path, **stated)


def _heights(
    array: NDArray[Any],
    settings: Mapping[str, str],
    path: Path,
    unit: str | None = None,
    lateral_unit: str | None = None,
    pitch: Any = None,
) -> Heights:
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        found = f"{array.ndim} dimensions of {array.dtype}"
        accepted = "one dimension (a line) or two (a map, rows along y) of integers or floating point"
        raise InputError(path, "not an array of heights", found=found, accepted=accepted)
    height_scale, lateral_scale = scales(path, settings, unit, lateral_unit, setting="a text `unit` (npz)")
    steps = needed_steps(path, pitch_steps(path, settings, pitch), setting="a number `pitch` (npz)")
    single = array.dtype.kind == "f" and array.dtype.itemsize == 4
    height: NDArray[np.floating] = array.astype(np.float32 if single else np.float64)
    height *= height_scale
    if 1 in height.shape:
        height = height.reshape(-1)
    pitch_y = steps[-1] * lateral_scale if height.ndim == 2 else None
    return Heights(height, steps[0] * lateral_scale, pitch_y, unit=height_scale)


def _read_array(handle: IO[bytes], size: int, path: Path, where: str | None) -> NDArray[Any]:
    """The array of an open .npy file of ``size`` bytes; memory is allocated only after the header matched the size."""
    try:
        with warnings.catch_warnings():
            # Warnings about files written by Python 2, which are read correctly.
            warnings.simplefilter("ignore", UserWarning)
            version = np.lib.format.read_magic(handle)
            readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, columns_first, dtype = readers[version](handle)
    except _HEADER_DAMAGE as error:
        raise InputError(path, "not a NumPy array, or damaged", where=where, accepted=_WHOLE) from error
    if dtype.hasobject:
        raise InputError(path, "an array of objects", where=where, accepted="an array of numbers")
    points = math.prod(shape)
    if points > MAX_POINTS:
        raise InputError(path, "too many points", where=where, found=points, accepted=f"up to {MAX_POINTS}")
    expected, present = points * dtype.itemsize, size - handle.tell()
    if present != expected:
        problem, accepted = "the size of the data does not match the header", f"{expected} bytes, as the header states"
        raise InputError(path, problem, where=where, found=f"{present} bytes", accepted=accepted)
    data = handle.read(expected)
    if len(data) != expected:
        raise InputError(path, "truncated file", where=where, accepted=_WHOLE)
    array = np.frombuffer(data, dtype)
    return array.reshape(shape[::-1]).T if columns_first else array.reshape(shape)


def _height_name(names: list[str], path: Path) -> str:
    candidates = [name for name in names if name not in _SETTINGS]
    if "height" in candidates:
        return "height"
    if len(candidates) == 1:
        return candidates[0]
    problem = "several arrays, none named `height`" if candidates else "the archive has no array of heights"
    found = repr(", ".join(candidates)[:60]) if candidates else None
    raise InputError(path, problem, found=found, accepted="an array named height, or a single array")


def _read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> NDArray[Any]:
    name = entry.filename[:60]
    archives.check_inflated(path, name, entry.file_size, entry.compress_size, 16 * MAX_POINTS)
    with archive.open(entry) as handle:
        return _read_array(handle, entry.file_size, path, name)


def _setting(value: NDArray[Any], name: str, path: Path) -> str:
    """A scalar, a text, or a pair of pitches, as text."""
    text = name in ("unit", "lateral_unit")
    if value.dtype.kind not in ("US" if text else "fiu") or value.size > (2 if name == "pitch" else 1):
        accepted = "nm, um, mm, m" if text else "a number; pitch may be two, [x, y]"
        problem, found = "not a text" if text else "not a length", f"{value.size} of {value.dtype}"
        raise InputError(path, problem, where=name, found=found, accepted=accepted)
    words = [word.decode("latin-1") if isinstance(word, bytes) else str(word) for word in value.ravel().tolist()]
    return " ".join(words)


FORMATS = (
    SurfaceFormat(
        "npy", (".npy",), "unit and pitch. One dimension is a line, two are a map with rows along y", read_npy, UNSTATED
    ),
    SurfaceFormat(
        "npz",
        (".npz",),
        "the array `height`, or a single array; unit and pitch, unless the archive has `unit`, `lateral_unit`, `pitch` or `pitch_x`, `pitch_y`",
        read_npz,
        UNSTATED,
    ),
)

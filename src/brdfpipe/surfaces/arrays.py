"""NumPy arrays on the disk: one array (.npy), or named arrays in a zip archive (.npz).

The header is read first: its size must match the file. Arrays of objects, which could contain code, are refused.
"""

from __future__ import annotations

import math
import os
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.surfaces.heights import UNSTATED, Heights, SurfaceFormat
from brdfpipe.surfaces.units import needed_steps, pitch_steps, scales

MAX_POINTS = 2**28

_SETTINGS = ("pitch", "pitch_x", "pitch_y", "unit", "lateral_unit")
_MAX_ENTRIES = 100
_MAX_RATIO = 200
_RATIO_FROM = 2**24
_WHOLE = "a whole file as numpy.save or numpy.savez writes it"

_HEADER_DAMAGE = (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError, tokenize.TokenError)
"""Exceptions that numpy raises on a damaged header."""
_ARCHIVE_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, ValueError)


def read_npy(
    path: Path,
    *,
    unit: str | None = None,
    lateral_unit: str | None = None,
    pitch: float | Sequence[float] | None = None,
) -> Heights:
    """Read one array of heights: a line of one dimension, or a map of two, whose rows are y.

    Parameters
    ----------
    path : as ``numpy.save`` writes it; integers or floating point
    unit, lateral_unit : nm, um, mm, m; positions in the unit of the heights by default
    pitch : a number, or [x, y], in ``lateral_unit``

    Returns
    -------
    Heights [um], in float32 where the file has float32, else float64; NaN is missing

    Raises
    ------
    InputError : missing or truncated file; not a real array of one or two dimensions; unknown unit or pitch.
    """
    try:
        with path.open("rb") as handle:
            array = _read_array(handle, os.fstat(handle.fileno()).st_size, path, None)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    return _heights(array, {}, path, unit, lateral_unit, pitch)


def read_npz(
    path: Path,
    *,
    unit: str | None = None,
    lateral_unit: str | None = None,
    pitch: float | Sequence[float] | None = None,
) -> Heights:
    """Read the array ``height``, or the only array, of an archive, with the unit and pitch of the archive.

    Parameters
    ----------
    path : as ``numpy.savez`` or ``savez_compressed`` writes it; beside the heights it may hold the scalars ``pitch`` or
        ``pitch_x`` and ``pitch_y``, and the texts ``unit`` and ``lateral_unit``
    unit, lateral_unit, pitch : as for :func:`read_npy`; they override those of the archive

    Returns
    -------
    Heights, as from :func:`read_npy`

    Raises
    ------
    InputError : as :func:`read_npy`; not an archive; or several arrays, none of them named ``height``.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = _entries(archive, path)
            array = _read_entry(archive, entries[_height_name(entries, path)], path)
            settings = {
                name: _setting(_read_entry(archive, entries[name], path), name, path)
                for name in _SETTINGS
                if name in entries
            }
    except InputError:
        raise
    except _ARCHIVE_DAMAGE as error:
        raise _no_archive(path, error) from error
    if "pitch" not in settings and "pitch_x" in settings:
        settings["pitch"] = f"{settings['pitch_x']} {settings.get('pitch_y', settings['pitch_x'])}"
    return _heights(array, settings, path, unit, lateral_unit, pitch)


def _heights(
    array: NDArray[Any],
    settings: Mapping[str, str],
    path: Path,
    unit: str | None,
    lateral_unit: str | None,
    pitch: float | Sequence[float] | None,
) -> Heights:
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise InputError(
            path,
            "not an array of heights",
            found=f"{array.ndim} dimensions of {array.dtype}",
            accepted="one dimension (a line) or two (a map, rows along y) of integers or floating point",
        )
    height_scale, lateral_scale = scales(path, settings, unit, lateral_unit, setting="a text `unit` (npz)")
    steps = needed_steps(path, pitch_steps(path, settings, pitch), setting="a number `pitch` (npz)")
    single = array.dtype.kind == "f" and array.dtype.itemsize == 4
    height: NDArray[np.floating] = array.astype(np.float32 if single else np.float64)
    height *= height_scale
    if 1 in height.shape:
        height = height.reshape(-1)
    pitch_y = steps[-1] * lateral_scale if height.ndim == 2 else None
    return Heights(height, steps[0] * lateral_scale, pitch_y)


def _read_array(handle: IO[bytes], size: int, path: Path, where: str | None) -> NDArray[Any]:
    """The array of an open .npy file of ``size`` bytes; memory is allocated only after the header matched the size."""
    try:
        with warnings.catch_warnings():
            # Warnings about files written by Python 2, which are read correctly.
            warnings.simplefilter("ignore", UserWarning)
            version = np.lib.format.read_magic(handle)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, columns_first, dtype = read_header(handle)
    except _HEADER_DAMAGE as error:
        raise InputError(path, "not a NumPy array, or damaged", where=where, accepted=_WHOLE) from error
    if dtype.hasobject:
        raise InputError(path, "an array of objects", where=where, accepted="an array of numbers")
    points = math.prod(shape)
    if points > MAX_POINTS:
        raise InputError(path, "too many points", where=where, found=points, accepted=f"up to {MAX_POINTS}")
    expected = points * dtype.itemsize
    if size - handle.tell() != expected:
        raise InputError(
            path,
            "the size of the data does not match the header",
            where=where,
            found=f"{size - handle.tell()} bytes",
            accepted=f"{expected} bytes, as the header states",
        )
    data = handle.read(expected)
    if len(data) != expected:
        raise InputError(path, "truncated file", where=where, accepted=_WHOLE)
    array = np.frombuffer(data, dtype)
    return array.reshape(shape[::-1]).T if columns_first else array.reshape(shape)


def _entries(archive: zipfile.ZipFile, path: Path) -> dict[str, zipfile.ZipInfo]:
    members = archive.infolist()
    entries = {member.filename.removesuffix(".npy"): member for member in members}
    if len(members) > _MAX_ENTRIES or len(entries) < len(members):
        raise InputError(path, "too many or repeated entries in the archive", found=f"{len(members)} entries")
    return entries


def _height_name(entries: Mapping[str, zipfile.ZipInfo], path: Path) -> str:
    candidates = [name for name in entries if name not in _SETTINGS]
    if "height" in candidates:
        return "height"
    if len(candidates) == 1:
        return candidates[0]
    raise InputError(
        path,
        "several arrays, none named `height`" if candidates else "the archive has no array of heights",
        found=repr(", ".join(candidates)[:60]) if candidates else None,
        accepted="an array named height, or a single array",
    )


def _read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> NDArray[Any]:
    name = entry.filename[:60]
    if entry.file_size > max(_RATIO_FROM, _MAX_RATIO * entry.compress_size) or entry.file_size > 16 * MAX_POINTS:
        raise InputError(
            path,
            "an entry is suspiciously large",
            where=name,
            found=f"{entry.file_size} bytes",
            accepted=f"compressed at most {_MAX_RATIO} times",
        )
    with archive.open(entry) as handle:
        return _read_array(handle, entry.file_size, path, name)


def _setting(value: NDArray[Any], name: str, path: Path) -> str:
    """A scalar, a text, or a pair of pitches, as text."""
    text = name in ("unit", "lateral_unit")
    if value.dtype.kind not in ("US" if text else "fiu") or value.size > (2 if name == "pitch" else 1):
        raise InputError(
            path,
            "not a text" if text else "not a length",
            where=name,
            found=f"{value.size} of {value.dtype}",
            accepted="nm, um, mm, m" if text else "a number; pitch may be two, [x, y]",
        )
    words = [word.decode("latin-1") if isinstance(word, bytes) else str(word) for word in value.ravel().tolist()]
    return " ".join(words)


def _no_archive(path: Path, error: Exception) -> InputError:
    if isinstance(error, OSError) and error.strerror:
        return InputError(path, f"cannot be read ({error.strerror})")
    return InputError(path, "not an NPZ archive, or damaged", accepted=_WHOLE, key="surface.format")


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

"""File formats of instruments, read by the library SurfaceTopography (the optional extra ``instruments``).

The format is always given to the library; when it guesses, it opens even empty files, random bytes and damaged archives. Its
results are checked and converted. It is imported only when such a file is read.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.surfaces import archives
from brdfpipe.surfaces.archives import MAX_POINTS
from brdfpipe.surfaces.heights import LINES, PITCH_RANGE, UNCONFIRMED, Heights, SurfaceFormat, infinite_as_missing
from brdfpipe.surfaces.units import UNITS, scales

LIBRARY = "SurfaceTopography"

_MAX_BYTES = 2**31


@dataclass(frozen=True)
class Instrument:
    """A file format of instruments."""

    title: str
    extensions: tuple[str, ...]
    """Extensions that select the format; without any, `surface.format` must name it."""
    tried: str = ""
    """Files of real instruments that were read; empty if only files that the tests write, or none, were."""
    orientation: str = UNCONFIRMED
    """How it is known which edge of the picture comes first."""
    from_top: bool = True
    """Whether the library's first row is the upper edge of the picture, as Gwyddion shows it, and not y = 0."""
    options: tuple[str, ...] = ("channel",)
    """Options of :func:`read_instrument` that apply."""


_SECOND_READER = f"{UNCONFIRMED}; surfalize reads it so too"

INSTRUMENTS: Mapping[str, Instrument] = {
    "al3d": Instrument("Alicona AL3D", (".al3d",), "al3d-1.al3d", "confirmed: the camera's picture in the file"),
    "datx": Instrument("Zygo DATX", (".datx",)),
    "frt": Instrument("FRT MicroProf", (".frt",), "frt-1.frt"),
    "gwy": Instrument("Gwyddion GWY", (".gwy",), "", "confirmed: Gwyddion defines it"),
    # .dat is text more often than not.
    "metropro": Instrument("Zygo MetroPro DAT", (), "metropro-1.dat, not in the tests", _SECOND_READER),
    "mitutoyo": Instrument("Mitutoyo SurfTest workbook", (".xlsx",), "mitutoyo_2_mock.xlsx", LINES),
    "mnt": Instrument("Digital Surf MNT", (".mnt",), "mnt-1.mnt, mnt-2.mnt, not in the tests"),
    "nms": Instrument("NanoFocus NMS", (".nms",), "nms-2.nms", _SECOND_READER, options=("channel", "lateral_unit")),
    "opd": Instrument("Wyko OPD", (".opd",), "opd-1.opd"),
    "opdx": Instrument("Bruker OPDx", (".opdx",), "opdx-3.opdx, a line, not in the tests"),
    "os3d": Instrument("OmniSurf3D OS3D", (".os3d",)),
    "plu": Instrument("Sensofar PLU", (".plu", ".apx"), "plu-1.plu", _SECOND_READER),
    "plux": Instrument("Sensofar PLUX", (".plux",), "", _SECOND_READER),
    # The standard's coordinates are right-handed: y grows with the rows.
    "sdf": Instrument(
        "ISO 25178-71 SDF", (".sdf",), "sdf-1.sdf, refused: 7 x 4 points", "confirmed: the standard", from_top=False
    ),
    "sur": Instrument("Digital Surf SUR", (".sur",), "sur-2.sur", _SECOND_READER),
    "tmd": Instrument("TrueMap TMD", (".tmd",), "tmd-1.tmd", _SECOND_READER, options=("channel", "unit")),
    "vk": Instrument("Keyence VK", (".vk3", ".vk4", ".vk6", ".vk7")),
    "zmg": Instrument("KLA Zeta ZMG", (".zmg",), "", _SECOND_READER),
    "zon": Instrument("Keyence ZON", (".zon",)),
}
"""Formats by the library's name. Formats of scanning probes, and text, are left out."""


def read_instrument(
    path: Path,
    format: str,
    *,
    channel: str | None = None,
    unit: str | None = None,
    lateral_unit: str | None = None,
) -> Heights:
    """Read a height map or a line profile from a file of an instrument.

    Parameters
    ----------
    format : a key of :data:`INSTRUMENTS`
    channel : the name of the height channel; by default the first of the file
    unit : nm, um, mm, m; of all lengths in a format that does not state it (``tmd``)
    lateral_unit : nm, um, mm, m; of the pitch in a format that does not state it (``nms``)

    Returns
    -------
    Heights [um] in float64, ``height[y, x]``, the lower edge of the picture at y = 0; masked and infinite heights are NaN
    """
    library = _library(path)
    instrument = INSTRUMENTS[format]
    try:
        with path.open("rb") as handle, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _check_size(path)
            reader = library.lookup_reader_by_format[format](handle)
            chosen, history = _height_channel(reader.channels, channel, path)
            topography = chosen.topography()
            height = _height_array(topography.heights(), instrument.from_top)
            unit_scale = _unit_scale(topography.unit, path)
            pitches = _pitches(topography, path)
    except InputError:
        raise
    # A reader may raise any exception on a damaged file or one of another format.
    except Exception as error:
        raise _refusal(path, instrument.title, error) from error
    history = [f"Read as {instrument.title}.", *history, *infinite_as_missing(height)]
    doubts: tuple[str, ...] = ()
    pitches = [pitch * unit_scale for pitch in pitches]
    if "lateral_unit" in instrument.options:
        pitches, doubts = _of_unstated_unit(pitches, lateral_unit, path)
    if "unit" in instrument.options:
        unit_scale, doubts = _scale_of_unstated_unit(unit, unit_scale, pitches, path)
        pitches = [pitch * unit_scale / UNITS["mm"] for pitch in pitches]
    height *= unit_scale
    pitch_y = pitches[1] if height.ndim == 2 else None
    return Heights(height, pitches[0], pitch_y, tuple(history), doubts)


def check_installed(path: Path) -> None:
    """Refuse a file whose reader, the optional extra, is not installed; nothing is imported."""
    if importlib.util.find_spec(LIBRARY) is None:
        raise _not_installed(path)


def _library(path: Path) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return importlib.import_module(f"{LIBRARY}.IO")
    except ImportError as error:
        raise _not_installed(path) from error


def _not_installed(path: Path) -> InputError:
    return InputError(
        path,
        f"this format is read by {LIBRARY}, which is not installed",
        accepted="X3P, text or NumPy; or install it with `make instruments` or `pip install 'brdfpipe[instruments]'`",
    )


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise InputError(path, "the file is too large", found=f"{size >> 20} MiB", accepted=f"{_MAX_BYTES >> 20} MiB")
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            inflated = sum(entry.file_size for entry in archive.infolist())
        archives.check_inflated(path, None, inflated, size, _MAX_BYTES)


def _height_channel(channels: Sequence[Any], name: str | None, path: Path) -> tuple[Any, list[str]]:
    """The channel to read, and a note if there were several."""
    heights = [channel for channel in channels if channel.data_kind.name == "HEIGHT"]
    names = ", ".join(channel.name for channel in heights)[:200]
    chosen = heights[:1] if name is None else [channel for channel in heights if channel.name == name][:1]
    if not chosen:
        raise InputError(
            path,
            "no height channel in the file" if name is None else "unknown height channel",
            found=repr(name) if name else f"{len(channels)} channels",
            accepted=names or "a file with a height map",
            key="surface.channel" if names else None,
        )
    points = math.prod(chosen[0].nb_grid_pts or (1,))
    if points > MAX_POINTS:
        raise InputError(path, "too many points", found=points, accepted=f"up to {MAX_POINTS}")
    several = len(heights) > 1 and name is None
    return chosen[0], [f"Took the first of the height channels {names}."] if several else []


def _height_array(heights: NDArray[Any], from_top: bool) -> NDArray[np.float64]:
    """(y, x) or (x,), y upwards, NaN where masked, as a copy."""
    height = np.ma.filled(np.ma.asarray(heights).astype(np.float64), np.nan)
    # The library counts x first.
    return np.ascontiguousarray(height.reshape(-1) if 1 in height.shape else height.T[:: -1 if from_top else 1])


def _unit_scale(unit: str | None, path: Path) -> float:
    """Factor that converts the file's unit to µm."""
    conversion = importlib.import_module(f"{LIBRARY}.Support.UnitConversion")
    if not isinstance(unit, str) or not conversion.is_length_unit(unit):
        raise InputError(
            path,
            "the file does not state a unit of length",
            found=repr(unit)[:60] if unit else None,
            accepted="a file with units; or export it as X3P, or as text with surface.unit",
        )
    return float(conversion.get_unit_conversion_factor(unit, "µm"))


def _pitches(topography: Any, path: Path) -> list[float]:
    """Pitch in x and, of a map, in y, in the file's unit."""
    if not topography.is_uniform:
        raise InputError(
            path, "the positions are unevenly spaced", accepted="a constant pitch: resample, or export it as text"
        )
    if topography.physical_sizes is None:
        raise InputError(
            path,
            "the file does not state a pitch",
            accepted="a file with a lateral scale; or export it as text with surface.pitch",
        )
    sizes, counts = np.ravel(topography.physical_sizes), np.ravel(topography.nb_grid_pts)
    return [float(size) / int(count) for size, count in zip(sizes, counts, strict=True)]


def _scale_of_unstated_unit(
    unit: str | None, assumed: float, pitches: Sequence[float], path: Path
) -> tuple[float, tuple[str, ...]]:
    """Factor that converts all lengths to µm in a format without a unit, for which the library assumes mm; and warnings."""
    if unit is not None:
        return scales(path, {}, unit, None, setting="")[0], ()
    pitch = " x ".join(f"{value:.4g}" for value in pitches)
    return assumed, (
        f"The format states no unit. Lengths and heights were read in mm, which gives a pitch of {pitch} um; programs differ. Slopes are "
        "the same in any unit, waves are not: compare the pitch with the instrument's, and set `surface.unit` (mm confirms it).",
    )


def _of_unstated_unit(
    pitches: list[float], lateral_unit: str | None, path: Path
) -> tuple[list[float], tuple[str, ...]]:
    """Pitches [um] of a file without a unit, for which the library assumes mm; and warnings."""
    numbers = [pitch / UNITS["mm"] for pitch in pitches]
    if lateral_unit is not None:
        _, scale = scales(path, {}, "um", lateral_unit, setting="")
        return [number * scale for number in numbers], ()
    as_nanometres = [number * UNITS["nm"] for number in numbers]
    low, high = PITCH_RANGE
    if any(pitch <= high for pitch in pitches) or any(pitch < low for pitch in as_nanometres):
        return pitches, ()
    stated = " x ".join(f"{number:.6g}" for number in numbers)
    return as_nanometres, (
        f"The file states the pitch {stated} without a unit. It was read in nm, since in mm the area would be too large; "
        "compare the extent with the instrument's, and set `surface.lateral_unit` (nm confirms it).",
    )


def _refusal(path: Path, title: str, error: Exception) -> InputError:
    if isinstance(error, OSError) and error.strerror and error.filename:
        return InputError(path, f"cannot be read ({error.strerror})")
    # Messages of the library describe the fault; those of other packages may contain folder names.
    from_library = type(error).__module__.startswith(LIBRARY) and str(error).strip()
    # Another format helps where the file is not of this one, not where it is damaged or a part of its archive is missing.
    is_another = type(error).__name__ in ("CannotDetectFileFormat", "FileFormatMismatch") and not zipfile.is_zipfile(
        path
    )
    words = (
        str(error).strip().splitlines()[0][:120].replace(str(path), path.name) if from_library else type(error).__name__
    )
    problem = f"not a {title} file, or damaged"
    return InputError(
        path,
        problem,
        found=words,
        accepted=f"a whole {title} file, as the instrument wrote it"
        + ("; or the format that it has" if is_another else ""),
        key="surface.format" if is_another else None,
    )


FORMATS = tuple(
    SurfaceFormat(
        name,
        instrument.extensions,
        f"{instrument.title}; needs the extra `instruments`",
        partial(read_instrument, format=name),
        instrument.options,
        read_by=LIBRARY,
        tried=instrument.tried,
        orientation=instrument.orientation,
    )
    for name, instrument in INSTRUMENTS.items()
)

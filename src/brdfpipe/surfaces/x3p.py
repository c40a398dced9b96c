"""X3P, the exchange format of ISO 25178-72: a zip archive of one XML file and, usually, a binary file of heights in metres.

Archives are untrusted: nothing is unpacked to the disk, sizes are checked before decompression, and the XML must not contain a
document type or entities.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.store import atomic_path
from brdfpipe.surfaces.heights import Heights, SurfaceFormat
from brdfpipe.vocabulary import validate

DATA_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}

_MICROMETRES = 1e6
_MAX_POINTS = 2**28
_MAX_XML = 2**26
_MAX_ENTRIES = 1000
_MAX_RATIO = 200
_RATIO_FROM = 2**24
_TRUNCATED = "a whole file: export or copy it again"

_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, ValueError, KeyError)
"""Exceptions that zipfile raises on damaged, encrypted or unknown content."""


def read_x3p(path: Path) -> Heights:
    """Read an areal map or a line profile.

    Parameters
    ----------
    path : an X3P file: ``main.xml`` at the root or in one sub-folder, a matrix of one layer of heights, incremental x and y
        axes; heights as 16- or 32-bit integers, float32 or float64, in a binary file or in the XML

    Returns
    -------
    Heights [um], ``height[y, x]``; float32 where the file carries float32, else float64; invalid and infinite points are NaN.

    Raises
    ------
    InputError : not X3P, damaged, unsafe, of wrong checksum or size, or of an unsupported kind (point lists,
        absolute axes, several layers).

    References
    ----------
    ISO 25178-72:2017; schema http://www.opengps.eu/2008/ISO5436_2.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _read_archive(_Archive(archive, path))
    except InputError:
        raise
    except _DAMAGE as error:
        raise _refusal(path, error) from error


def write_x3p(surface: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a surface as X3P; the same surface gives the same bytes everywhere.

    Parameters
    ----------
    surface : kind ``surface``, with heights in float32 or float64
    path : the file to write; it appears whole or not at all

    Notes
    -----
    Entries are stored, not compressed: compressed bytes differ between zlib versions, and measured heights compress little.
    """
    validate(surface, "surface")
    height = np.atleast_2d(surface.height.values)
    code = "F" if height.dtype == np.float32 else "D"
    metres = (height * (1 / _MICROMETRES)).astype(DATA_TYPES[code], copy=False)
    points = np.ascontiguousarray(metres).tobytes()
    pitches = surface.attrs["pitch_x"], surface.attrs.get("pitch_y", surface.attrs["pitch_x"])
    feature = "PRF" if surface.height.ndim == 1 else "SUR"
    xml = _document(
        feature, code, height.shape, pitches, hashlib.md5(points, usedforsecurity=False).hexdigest()
    ).encode()
    checksum = f"{hashlib.md5(xml, usedforsecurity=False).hexdigest()} *main.xml".encode()
    entries = {"main.xml": xml, "bindata/data.bin": points, "md5checksum.hex": checksum}
    with atomic_path(path, size_hint=len(points)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, content in entries.items():
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            # The default depends on the platform.
            entry.create_system = 3
            archive.writestr(entry, content)


class _Archive:
    """Bounded access to the entries of an archive, by names relative to the folder of ``main.xml``."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self.archive, self.path = archive, path
        names = archive.namelist()
        if len(names) > _MAX_ENTRIES or len(set(names)) < len(names):
            raise InputError(path, "too many or repeated entries in the archive", found=f"{len(names)} entries")
        for name in names:
            self._check_name(name)
        mains = [name for name in names if PurePosixPath(name).name == "main.xml" and name.count("/") <= 1]
        if len(mains) != 1:
            raise InputError(
                path,
                "not an X3P archive",
                found=f"{len(mains)} files main.xml",
                accepted="one, at the root or in one sub-folder",
                key="surface.format",
            )
        self.main = mains[0]
        self.folder = PurePosixPath(self.main).parent

    def read(self, name: str, size: int | None = None, limit: int = _MAX_XML) -> bytes:
        """The content of an entry of exactly ``size`` bytes, or of at most ``limit``."""
        self._check_name(name)
        entry = str(self.folder / name)
        try:
            info = self.archive.getinfo(entry)
        except KeyError:
            raise InputError(self.path, "missing entry in the archive", where=name, accepted=_TRUNCATED) from None
        if size is not None and info.file_size != size:
            raise InputError(
                self.path,
                "the size of the data does not match the matrix",
                where=name,
                found=f"{info.file_size} bytes",
                accepted=f"{size} bytes, as main.xml says",
            )
        bomb = info.file_size > max(_RATIO_FROM, _MAX_RATIO * info.compress_size)
        if bomb or (size is None and info.file_size > limit):
            raise InputError(
                self.path,
                "an entry is suspiciously large",
                where=name,
                found=f"{info.file_size} bytes",
                accepted=f"up to {limit >> 20} MiB of XML, compressed at most {_MAX_RATIO} times",
            )
        # Reading stops at the stated size: the header of an entry may be wrong.
        with self.archive.open(info) as handle:
            content = handle.read(info.file_size)
        if len(content) != info.file_size:
            raise InputError(self.path, "the archive is truncated", where=name, accepted=_TRUNCATED)
        return content

    def _check_name(self, name: str) -> None:
        if name.startswith("/") or "\\" in name or ":" in name or ".." in name.split("/"):
            raise InputError(
                self.path,
                "unsafe entry name outside the archive",
                found=repr(name[:60]),
                accepted="names relative to main.xml",
            )


def _read_archive(archive: _Archive) -> Heights:
    path = archive.path
    xml = archive.read("main.xml")
    root = _parse(xml, path)
    feature = _text(root, "Record1/FeatureType", path)
    if feature not in ("SUR", "PRF"):
        raise InputError(path, "not a matrix of heights", where="FeatureType", found=feature, accepted="SUR, PRF")
    columns, rows = _matrix_size(root, path)
    line = feature == "PRF" or rows == 1
    if line and rows != 1:
        raise InputError(
            path, "a file of several profiles", where="SizeY", found=rows, accepted="one profile, or a SUR matrix"
        )
    pitch_x = _pitch(root, "CX", path)
    pitch_y = None if line else _pitch(root, "CY", path)
    height = _heights(root, archive, columns * rows).reshape(rows, columns)
    # Alicona and others write infinity, not NaN, for missing heights.
    infinite = np.isinf(height)
    height[infinite] = np.nan
    history = (f"{np.count_nonzero(infinite)} infinite heights taken as missing.",) if infinite.any() else ()
    warnings = _stale_checksum(root, archive, xml)
    return Heights(height[0] if line else height, pitch_x, pitch_y, history, warnings)


def _parse(xml: bytes, path: Path) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(xml, forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError(
            path, "the XML declares a document type or entities", where="main.xml", accepted="plain X3P without them"
        ) from error
    except (ParseError, ValueError, LookupError) as error:
        raise InputError(path, f"the XML is damaged ({error})", where="main.xml", accepted=_TRUNCATED) from error
    if root.tag.rpartition("}")[2] != "ISO5436_2":
        raise InputError(path, "not an X3P document", where="main.xml", found=root.tag[-60:], accepted="ISO5436_2")
    return root


def _find(root: Element, location: str) -> Element | None:
    # Some writers put every element into the namespace, most only the root.
    return root.find("/".join(f"{{*}}{tag}" for tag in location.split("/")))


def _optional(root: Element, location: str) -> str | None:
    element = _find(root, location)
    return None if element is None or not (element.text or "").strip() else (element.text or "").strip()


def _text(root: Element, location: str, path: Path) -> str:
    text = _optional(root, location)
    if text is None:
        raise InputError(path, f"{location} is missing in the XML", where="main.xml", accepted=_TRUNCATED)
    return text


def _number(root: Element, location: str, path: Path, default: float | None = None) -> float:
    if default is not None and _optional(root, location) is None:
        return default
    text = _text(root, location, path)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, "not a number", where=location, found=repr(text[:60]), accepted="a finite number")
    return value


def _matrix_size(root: Element, path: Path) -> tuple[int, int]:
    if _find(root, "Record3/MatrixDimension") is None:
        raise InputError(
            path,
            "a list of points, not a matrix",
            where="Record3",
            found="ListDimension",
            accepted="MatrixDimension: export a height map on a regular grid",
        )
    sizes = []
    for axis in "XYZ":
        text = _text(root, f"Record3/MatrixDimension/Size{axis}", path)
        if not re.fullmatch(r"[0-9]{1,9}", text) or int(text) == 0:
            raise InputError(path, "not a count of points", where=f"Size{axis}", found=repr(text[:60]))
        sizes.append(int(text))
    columns, rows, layers = sizes
    if layers != 1:
        raise InputError(path, "several heights per point", where="SizeZ", found=layers, accepted="one layer")
    if columns * rows > _MAX_POINTS:
        raise InputError(
            path,
            "too many points",
            where="MatrixDimension",
            found=f"{columns} x {rows}",
            accepted=f"up to {_MAX_POINTS}: export a smaller part",
        )
    return columns, rows


def _pitch(root: Element, axis: str, path: Path) -> float:
    kind = _text(root, f"Record1/Axes/{axis}/AxisType", path)
    if kind != "I":
        raise InputError(
            path,
            "an axis of absolute positions",
            where=f"{axis} AxisType",
            found=kind,
            accepted="I: export at constant pitch",
        )
    return _number(root, f"Record1/Axes/{axis}/Increment", path) * _MICROMETRES


def _heights(root: Element, archive: _Archive, count: int) -> NDArray[np.floating]:
    """The heights in file order, x fastest [um]."""
    path = archive.path
    code = _text(root, "Record1/Axes/CZ/DataType", path)
    if code not in DATA_TYPES:
        raise InputError(
            path,
            "unknown type of heights",
            where="CZ DataType",
            found=repr(code[:60]),
            accepted=", ".join(DATA_TYPES),
        )
    linked = _find(root, "Record3/DataLink") is not None
    raw = _binary(root, archive, np.dtype(DATA_TYPES[code]), count) if linked else _listed(root, path, count)
    # Increment and offset belong to incremental axes and to integers; absolute floats are in metres.
    scaled = code in "IL" or _optional(root, "Record1/Axes/CZ/AxisType") == "I"
    step = _number(root, "Record1/Axes/CZ/Increment", path, 1.0) if scaled else 1.0
    offset = _number(root, "Record1/Axes/CZ/Offset", path, 0.0) if scaled else 0.0
    height: NDArray[np.floating] = raw.astype(np.float32 if code == "F" else np.float64)
    # In place, to keep float32; a "largest float" that marks missing heights may overflow.
    with np.errstate(over="ignore"):
        height *= step * _MICROMETRES
        height += offset * _MICROMETRES
    valid = _valid_points(root, archive, count)
    if valid is not None:
        height[~valid] = np.nan
    return height


def _binary(root: Element, archive: _Archive, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    link = _text(root, "Record3/DataLink/PointDataLink", archive.path)
    points = archive.read(link, size=count * dtype.itemsize)
    _check_md5(root, "MD5ChecksumPointData", points, archive.path)
    return np.frombuffer(points, dtype)


def _listed(root: Element, path: Path, count: int) -> NDArray[np.float64]:
    # A point is "x;y;z", without x and y on incremental axes; an empty one is invalid.
    texts = [
        (datum.text or "").rpartition(";")[2].strip() for datum in root.iterfind("{*}Record3/{*}DataList/{*}Datum")
    ]
    if len(texts) != count:
        raise InputError(
            path,
            "the size of the data does not match the matrix",
            where="DataList",
            found=f"{len(texts)} points",
            accepted=f"{count} points, as MatrixDimension says",
        )
    try:
        return np.array([text or "nan" for text in texts], dtype=str).astype(np.float64)
    except ValueError as error:
        raise InputError(path, f"not a number ({error})", where="DataList") from error


def _valid_points(root: Element, archive: _Archive, count: int) -> NDArray[np.bool_] | None:
    link = _optional(root, "Record3/DataLink/ValidPointsLink")
    if link is None:
        return None
    mask = archive.read(link, size=(count + 7) // 8)
    _check_md5(root, "MD5ChecksumValidPoints", mask, archive.path)
    return np.unpackbits(np.frombuffer(mask, np.uint8), count=count, bitorder="little").astype(bool)


def _check_md5(root: Element, tag: str, content: bytes, path: Path) -> None:
    stated = _optional(root, f"Record3/DataLink/{tag}")
    if stated is None:
        return
    actual = hashlib.md5(content, usedforsecurity=False).hexdigest()
    if stated.lower() != actual:
        raise InputError(
            path,
            "wrong checksum of the data",
            where=tag,
            found=actual,
            accepted=f"{stated[:40].lower()}: export or copy the file again",
        )


def _stale_checksum(root: Element, archive: _Archive, xml: bytes) -> tuple[str, ...]:
    """A warning if ``main.xml`` was edited after its checksum was written."""
    name = _optional(root, "Record4/ChecksumFile")
    if name is None or str(archive.folder / name) not in archive.archive.namelist():
        return ()
    stated = archive.read(name)[:32].decode("latin-1").lower()
    if not re.fullmatch("[0-9a-f]{32}", stated) or stated == hashlib.md5(xml, usedforsecurity=False).hexdigest():
        return ()
    return ("The X3P file's main.xml was changed after it was written; compare pitch and size with the instrument's.",)


def _refusal(path: Path, error: Exception) -> InputError:
    if isinstance(error, OSError) and error.strerror:
        return InputError(path, f"cannot be read ({error.strerror})")
    if isinstance(error, zipfile.BadZipFile) and "not a zip file" in str(error):
        accepted = "a whole X3P file, which is a zip archive; or the format the file really has"
        return InputError(path, "not an X3P file, or truncated", accepted=accepted, key="surface.format")
    # Damaged entry names may be kilobytes long.
    return InputError(path, f"the archive is damaged ({str(error)[:100]})", accepted=_TRUNCATED)


def _document(feature: str, code: str, shape: tuple[int, ...], pitches: tuple[float, float], md5: str) -> str:
    axes = "".join(
        f"<{axis}><AxisType>I</AxisType><DataType>D</DataType><Increment>{pitch / _MICROMETRES!r}</Increment>"
        f"<Offset>0</Offset></{axis}>\n"
        for axis, pitch in zip(("CX", "CY"), pitches, strict=True)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1>
<Revision>ISO5436 - 2000</Revision>
<FeatureType>{feature}</FeatureType>
<Axes>
{axes}<CZ><AxisType>A</AxisType><DataType>{code}</DataType></CZ>
</Axes>
</Record1>
<Record3>
<MatrixDimension><SizeX>{shape[1]}</SizeX><SizeY>{shape[0]}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink>
<PointDataLink>bindata/data.bin</PointDataLink>
<MD5ChecksumPointData>{md5.upper()}</MD5ChecksumPointData>
</DataLink>
</Record3>
<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4>
</p:ISO5436_2>
"""


FORMATS = (SurfaceFormat("x3p", (".x3p",), "the file states unit and pitch", read_x3p),)

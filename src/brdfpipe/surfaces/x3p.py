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
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.store import atomic_path
from brdfpipe.surfaces import archives
from brdfpipe.surfaces.archives import MAX_POINTS
from brdfpipe.surfaces.heights import Heights, SurfaceFormat, infinite_as_missing
from brdfpipe.vocabulary import validate

DATA_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}

_MICROMETRES = 1e6
_ROOTS = ("ISO5436_2", "ISO5436")
"""Root elements: of the standard, and of files from before it."""
_MAX_XML = 2**26
_MAX_ENTRIES = 1000
_TRUNCATED = "a whole file: export or copy it again"


def read_x3p(path: Path) -> Heights:
    """Heights [um] of an areal map or a line profile; float32 where the file has float32, else float64; missing points are NaN.

    The file is a matrix of one layer with incremental x and y axes; heights are 16- or 32-bit integers, float32 or float64, in a
    binary file or in the XML. Point lists, absolute axes, several layers and wrong checksums are refused.

    Source: ISO 25178-72:2017; schema http://www.opengps.eu/2008/ISO5436_2.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _read_archive(_Archive(archive, path))
    except InputError:
        raise
    except archives.DAMAGE as error:
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
    xml = _document(feature, code, height.shape, pitches, _md5(points)).encode()
    checksum = f"{_md5(xml)} *main.xml".encode()
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
        names = archives.checked_names(archive, path, _MAX_ENTRIES)
        for name in names:
            self._check_name(name)
        mains = [name for name in names if PurePosixPath(name).name == "main.xml" and name.count("/") <= 1]
        if len(mains) != 1:
            found, accepted = f"{len(mains)} files main.xml", "one, at the root or in one sub-folder"
            raise InputError(path, "not an X3P archive", found=found, accepted=accepted, key="surface.format")
        self.main = mains[0]
        self.folder = PurePosixPath(self.main).parent

    def read(self, name: str, size: int | None = None) -> bytes:
        """The content of an entry: exactly ``size`` bytes, or an XML file."""
        self._check_name(name)
        try:
            info = self.archive.getinfo(str(self.folder / name))
        except KeyError:
            raise InputError(self.path, "missing entry in the archive", where=name, accepted=_TRUNCATED) from None
        if size is not None and info.file_size != size:
            problem, accepted = "the size of the data does not match the matrix", f"{size} bytes, as main.xml says"
            raise InputError(self.path, problem, where=name, found=f"{info.file_size} bytes", accepted=accepted)
        most = _MAX_XML if size is None else size
        archives.check_inflated(self.path, name, info.file_size, info.compress_size, most)
        # Reading stops at the stated size: the header of an entry may be wrong.
        with self.archive.open(info) as handle:
            content = handle.read(info.file_size)
        if len(content) != info.file_size:
            raise InputError(self.path, "the archive is truncated", where=name, accepted=_TRUNCATED)
        return content

    def _check_name(self, name: str) -> None:
        if name.startswith("/") or "\\" in name or ":" in name or ".." in name.split("/"):
            problem, accepted = "unsafe entry name outside the archive", "names relative to main.xml"
            raise InputError(self.path, problem, found=repr(name[:60]), accepted=accepted)


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
    history = infinite_as_missing(height)
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
    if root.tag.rpartition("}")[2] not in _ROOTS:
        found, accepted = root.tag[-60:], ", ".join(_ROOTS)
        raise InputError(path, "not an X3P document", where="main.xml", found=found, accepted=accepted)
    return root


def _find(root: Element, location: str) -> Element | None:
    # Some writers put every element into the namespace, most only the root.
    return root.find("/".join(f"{{*}}{tag}" for tag in location.split("/")))


def _optional(root: Element, location: str) -> str | None:
    element = _find(root, location)
    return (None if element is None else (element.text or "").strip()) or None


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
        problem, accepted = "a list of points, not a matrix", "MatrixDimension: export a height map on a regular grid"
        raise InputError(path, problem, where="Record3", found="ListDimension", accepted=accepted)
    sizes = []
    for axis in "XYZ":
        text = _text(root, f"Record3/MatrixDimension/Size{axis}", path)
        if not re.fullmatch(r"[0-9]{1,9}", text) or int(text) == 0:
            raise InputError(
                path, "not a count of points", where=f"Size{axis}", found=repr(text[:60]), accepted="1 or more"
            )
        sizes.append(int(text))
    columns, rows, layers = sizes
    if layers != 1:
        raise InputError(path, "several heights per point", where="SizeZ", found=layers, accepted="one layer")
    if columns * rows > MAX_POINTS:
        found, accepted = f"{columns} x {rows}", f"up to {MAX_POINTS}: export a smaller part"
        raise InputError(path, "too many points", where="MatrixDimension", found=found, accepted=accepted)
    return columns, rows


def _pitch(root: Element, axis: str, path: Path) -> float:
    kind = _text(root, f"Record1/Axes/{axis}/AxisType", path)
    if kind != "I":
        problem, accepted = "an axis of absolute positions", "I: export at constant pitch"
        raise InputError(path, problem, where=f"{axis} AxisType", found=kind, accepted=accepted)
    return _number(root, f"Record1/Axes/{axis}/Increment", path) * _MICROMETRES


def _heights(root: Element, archive: _Archive, count: int) -> NDArray[np.floating]:
    """The heights in file order, x fastest [um]."""
    path = archive.path
    code = _text(root, "Record1/Axes/CZ/DataType", path)
    if code not in DATA_TYPES:
        found, accepted = repr(code[:60]), ", ".join(DATA_TYPES)
        raise InputError(path, "unknown type of heights", where="CZ DataType", found=found, accepted=accepted)
    raw: NDArray[Any]
    if _find(root, "Record3/DataLink") is None:
        raw = _point_list_values(root, path, count)
    else:
        dtype, link = np.dtype(DATA_TYPES[code]), _text(root, "Record3/DataLink/PointDataLink", path)
        raw = np.frombuffer(_binary_values(root, archive, link, "MD5ChecksumPointData", count * dtype.itemsize), dtype)
    # Increment and offset belong to incremental axes and to integers; absolute floats are in metres.
    scaled = code in "IL" or _optional(root, "Record1/Axes/CZ/AxisType") == "I"
    step = _number(root, "Record1/Axes/CZ/Increment", path, 1.0) if scaled else 1.0
    offset = _number(root, "Record1/Axes/CZ/Offset", path, 0.0) if scaled else 0.0
    height: NDArray[np.floating] = raw.astype(np.float32 if code == "F" else np.float64)
    # In place, to keep float32; a "largest float" that marks missing heights may overflow.
    with np.errstate(over="ignore"):
        height *= step * _MICROMETRES
        height += offset * _MICROMETRES
    link_of_valid = _optional(root, "Record3/DataLink/ValidPointsLink")
    if link_of_valid is not None:
        mask = _binary_values(root, archive, link_of_valid, "MD5ChecksumValidPoints", (count + 7) // 8)
        valid = np.unpackbits(np.frombuffer(mask, np.uint8), count=count, bitorder="little")
        height[valid == 0] = np.nan
    return height


def _binary_values(root: Element, archive: _Archive, name: str, checksum: str, size: int) -> bytes:
    """Content of a binary entry, of the stated checksum if there is one."""
    content = archive.read(name, size)
    stated, actual = _optional(root, f"Record3/DataLink/{checksum}"), _md5(content)
    if stated is not None and stated.lower() != actual:
        accepted, path = f"{stated[:40].lower()}: export or copy the file again", archive.path
        raise InputError(path, "wrong checksum of the data", where=checksum, found=actual, accepted=accepted)
    return content


def _point_list_values(root: Element, path: Path, count: int) -> NDArray[np.float64]:
    # A point is "x;y;z", without x and y on incremental axes; an empty one is invalid.
    points = root.iterfind("{*}Record3/{*}DataList/{*}Datum")
    texts = [(point.text or "").rpartition(";")[2].strip() for point in points]
    if len(texts) != count:
        problem, accepted = "the size of the data does not match the matrix", f"{count} points, as MatrixDimension says"
        raise InputError(path, problem, where="DataList", found=f"{len(texts)} points", accepted=accepted)
    try:
        return np.array([text or "nan" for text in texts], dtype=str).astype(np.float64)
    except ValueError as error:
        raise InputError(path, f"not a number ({error})", where="DataList", accepted="numbers") from error


def _md5(content: bytes) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


def _stale_checksum(root: Element, archive: _Archive, xml: bytes) -> tuple[str, ...]:
    """A warning if ``main.xml`` was edited after its checksum was written."""
    name = _optional(root, "Record4/ChecksumFile")
    if name is None or str(archive.folder / name) not in archive.archive.namelist():
        return ()
    stated = archive.read(name)[:32].decode("latin-1").lower()
    if not re.fullmatch("[0-9a-f]{32}", stated) or stated == _md5(xml):
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


FORMATS = (
    SurfaceFormat(
        "x3p",
        (".x3p",),
        "the file states unit and pitch",
        read_x3p,
        tried="KautschukInfiniteFocus.x3p, x3p-2.x3p",
        orientation="confirmed: the standard, and as surfalize reads it",
    ),
)

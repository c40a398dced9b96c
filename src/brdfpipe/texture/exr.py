"""OpenEXR files of 32-bit floats, uncompressed scan lines (OpenEXR file layout, version 2): the one form that every reader has."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from brdfpipe.geometry import Array

_FLOAT, _INCREASING_Y, _NO_COMPRESSION = 2, 0, 0


def exr_bytes(channels: dict[str, Array], comments: str = "") -> bytes:
    """An image.

    Parameters
    ----------
    channels : name → (rows, columns) values, of one shape, the upper row first; ``R``, ``G``, ``B`` for three, ``Y`` for one
    comments : the standard attribute of this name

    Notes
    -----
    Beside a header the file is a table of offsets and, for each row, its number, its size and the channels in alphabetical order.
    """
    names = sorted(channels)
    rows, columns = np.shape(channels[names[0]])
    window = struct.pack("<4i", 0, 0, columns - 1, rows - 1)
    listed = b"".join(_text(name) + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for name in names) + b"\0"
    header = struct.pack("<iI", 20000630, 2) + b"".join(
        (
            _attribute("channels", "chlist", listed),
            _attribute("comments", "string", comments.encode("utf-8")),
            _attribute("compression", "compression", bytes([_NO_COMPRESSION])),
            _attribute("dataWindow", "box2i", window),
            _attribute("displayWindow", "box2i", window),
            _attribute("lineOrder", "lineOrder", bytes([_INCREASING_Y])),
            _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
            _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
            b"\0",
        )
    )
    lines = _lines([np.asarray(channels[name]) for name in names])
    start = len(header) + 8 * rows
    offsets = start + np.arange(rows, dtype="<u8") * lines.dtype.itemsize
    return header + offsets.tobytes() + lines.tobytes()


def _lines(values: Sequence[Array]) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Rows as they are in the file."""
    rows, columns = values[0].shape
    layout = np.dtype([("row", "<i4"), ("size", "<i4"), ("values", "<f4", (len(values), columns))])
    lines = np.zeros(rows, layout)
    lines["row"], lines["size"] = np.arange(rows), 4 * len(values) * columns
    for number, one in enumerate(values):
        lines["values"][:, number] = one
    return lines


def _text(value: str) -> bytes:
    return value.encode("ascii") + b"\0"


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return _text(name) + _text(kind) + struct.pack("<i", len(value)) + value

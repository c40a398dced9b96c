"""Small files in instruments' formats, written byte by byte from the formats' descriptions, and not by the library under test.

Each writer takes heights ``(y, x)`` in µm at the pitches of :data:`PITCH`, y upwards as brdfpipe counts it, and writes them
in the order of the format: mostly as a picture, from the upper edge down.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

PITCH = (0.5, 0.75)
"""x, y [µm]; exact in single precision."""


def al3d(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    tags = {
        "Cols": columns,
        "Rows": rows,
        "PixelSizeXMeter": PITCH[0] * 1e-6,
        "PixelSizeYMeter": PITCH[1] * 1e-6,
        "InvalidPixelValue": 1e10,
    }
    offset = 17 + 52 * (len(tags) + 3) + 256
    entries = {"Version": 1, "TagCount": len(tags) + 1, **tags, "DepthImageOffset": offset}
    head = b"AliconaImaging\0\r\n" + b"".join(
        struct.pack("20s30s2s", key.encode(), str(value).encode(), b"\r\n") for key, value in entries.items()
    )
    # Rows are padded to whole groups of 8 bytes.
    padded = np.pad(np.nan_to_num(height[::-1] * 1e-6, nan=1e10), ((0, 0), (0, columns % 2)))
    return (head + bytes(256)).ljust(offset, b"\0") + padded.astype("<f4").tobytes()


def nms(height: np.ndarray) -> bytes:
    """The pitch counts in nm. The format, as far as it is known, marks no missing height."""
    rows, columns = height.shape
    low, high = np.nanmin(height), np.nanmax(height)
    head = bytearray(3468)
    struct.pack_into("<2d", head, 16, low, high)
    struct.pack_into("<2I2d", head, 1368, columns, rows, PITCH[0] * 1e3, PITCH[1] * 1e3)
    levels = np.round((np.nan_to_num(height[::-1], nan=low) - low) / (high - low) * (2**16 - 2))
    return bytes(head) + levels.astype("<u2").tobytes()


def opd(height: np.ndarray) -> bytes:
    """Columns run fastest from the lower edge of the image up."""
    rows, columns = height.shape
    wavelength = 500.0
    raw = np.nan_to_num(height * 1e3 / wavelength, nan=2e38).T
    blocks = [
        (b"Raw", 3, struct.pack("<3H", columns, rows, 4) + raw.astype("<f4").tobytes()),
        (b"Wavelength", 7, struct.pack("<f", wavelength)),
        (b"Pixel_size", 7, struct.pack("<f", PITCH[0] * 1e-3)),
        (b"Aspect", 7, struct.pack("<f", PITCH[1] / PITCH[0])),
    ]
    directory = [(b"Directory", 1, bytes(24 * (len(blocks) + 1))), *blocks]
    head = b"".join(struct.pack("<16shlH", name, kind, len(data), 0) for name, kind, data in directory)
    return b"\x01\x00" + head + b"".join(data for _, _, data in blocks)


def plu(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    head = struct.pack("<128sI256s", b"Mon Jan 03 10:00:00 2011", 0, b"")
    calibration = struct.pack("<3I7f", rows, columns, 1, 1, *PITCH, 0, 0, 1, 0)
    settings = struct.pack("<5I", 3, 0, 0, 10, 6) + struct.pack("<2fI2fI3f4B", *[0] * 13)
    configuration = struct.pack("<8BI", 0, 1, 0, 0, 0, 0, 0, 0, 1)
    data = np.nan_to_num(height[::-1], nan=1000001).astype("<f4").tobytes()
    return head + calibration + settings + configuration + struct.pack("<2I", rows, columns) + data + bytes(8)


def sdf(height: np.ndarray) -> bytes:
    """The text variant. Its coordinates are right-handed: the first row is the lowest."""
    rows, columns = height.shape
    head = {
        "ManufacID": "none",
        "NumPoints": columns,
        "NumProfiles": rows,
        "Xscale": PITCH[0] * 1e-6,
        "Yscale": PITCH[1] * 1e-6,
        "Zscale": 1e-6,
        "Zresolution": -1,
        "Compression": 0,
        "DataType": 7,
        "CheckType": 0,
    }
    lines = ["aISO-1.0", *(f"{key} = {value}" for key, value in head.items()), "*"]
    lines += [" ".join("BAD" if np.isnan(z) else repr(float(z)) for z in row) for row in height]
    return ("\n".join(lines) + "\n*\n").encode()


def sur(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    step = 1e-4
    raw = np.round(height[::-1] / step)
    low, high = int(np.nanmin(raw)), int(np.nanmax(raw))
    units = [b"um", b"um", b"um"]
    head = b"".join(
        [
            struct.pack("<12s4H30s30s", b"DIGITAL SURF", 0, 1, 1, 2, b"map", b"none"),
            struct.pack("<5H2IH", 0, 0, 0, 1, 0, 0, 0, 32),
            struct.pack("<4iI3f", low, high, columns, rows, columns * rows, *PITCH, step),
            struct.pack("<9s7x9s7x9s7x", b"X", b"Y", b"Z"),
            b"".join(unit.ljust(16, b"\0") for unit in 2 * units),
            struct.pack("<3f3H3I", 1, 1, 1, 0, 0, 0, 0, 0, 0),
            struct.pack("<7Hf2IH2H128s3f34x", 0, 0, 10, 3, 1, 2011, 0, 0, 0, 0, 0, 0, 0, b"", 0, 0, 0),
        ]
    )
    return head + np.nan_to_num(raw, nan=low - 2).astype("<i4").tobytes()


WRITERS: dict[str, Callable[[np.ndarray], bytes]] = {
    "al3d": al3d,
    "nms": nms,
    "opd": opd,
    "plu": plu,
    "sdf": sdf,
    "sur": sur,
}
"""Extension → writer."""

MARKS_MISSING = {"al3d", "opd", "plu", "sdf", "sur"}

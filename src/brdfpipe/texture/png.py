"""PNG files of 16 bits a channel (W3C 2003): Pillow writes colours of 8 bits alone."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from brdfpipe.geometry import Array


def png_bytes(values: Array) -> bytes:
    """A linear image of 16 bits a channel.

    Parameters
    ----------
    values : (rows, columns) or (rows, columns, 3) from 0 to 65535, the upper row first
    """
    rows, columns, channels = values.reshape(*values.shape[:2], -1).shape
    lines = np.zeros((rows, 1 + 2 * columns * channels), dtype=np.uint8)
    lines[:, 1:] = np.rint(values).astype(">u2").reshape(rows, -1).view(np.uint8)
    header = struct.pack(">IIBBBBB", columns, rows, 16, 0 if channels == 1 else 2, 0, 0, 0)
    parts = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )

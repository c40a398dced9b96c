"""Height and normal maps as 16-bit PNG files, with a record of their scale and orientation."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe import store
from brdfpipe.geometry import Array
from brdfpipe.texture.grain import Grain

_LARGEST = 65535


def write_maps(grain: Grain, folder: str | os.PathLike[str], name: str) -> dict[str, Any]:
    """Write ``<name>.height.png``, ``<name>.normal.png`` and their record ``<name>.maps.json``.

    Parameters
    ----------
    grain : the map
    folder : where the files are written
    name : of the files

    Returns
    -------
    The record: the size of a pixel and of the map [um], the heights [um] of the values 0 and 65535, the axes of the normals, and what the
    maps leave to the BRDF.

    Notes
    -----
    The first row of the files is the upper edge, at the largest y. Normals are (n + 1)/2, with x to the right and y upwards, which is what OpenGL,
    glTF, MaterialX and Mitsuba expect. Both files are linear, not sRGB.
    """
    folder = Path(folder)
    low, high = float(grain.height.min()), float(grain.height.max())
    height = np.rint((grain.height - low) / max(high - low, 1e-300) * _LARGEST)
    normal = np.rint((grain.normals + 1) / 2 * _LARGEST)
    rows, columns = grain.height.shape
    record = {
        "pixel_um": grain.pixel,
        "size_um": [columns * grain.pixel, rows * grain.pixel],
        "tileable": True,
        "first_row": "upper edge, at the largest y",
        "height": {"file": f"{name}.height.png", "um_at_0": low, "um_at_65535": high},
        "normal": {"file": f"{name}.normal.png", "values": "(n + 1)/2, x to the right, y upwards"},
        "encoding": "linear, 16 bits",
        "unresolved_share_of_mean_square_slope": grain.unresolved,
        "share_of_facets_at_other_slopes": grain.split_difference,
        "warnings": list(grain.warnings),
    }
    store.write_bytes(folder / f"{name}.height.png", _png(height[::-1, :, None]))
    store.write_bytes(folder / f"{name}.normal.png", _png(normal[::-1]))
    store.write_bytes(folder / f"{name}.maps.json", (json.dumps(record, indent=2) + "\n").encode())
    return record


def _png(values: Array) -> bytes:
    """A PNG (W3C 2003) of 16 bits a channel, (rows, columns, 1 or 3): Pillow writes colours of 8 bits alone."""
    rows, columns, channels = values.shape
    lines = np.zeros((rows, 1 + 2 * columns * channels), dtype=np.uint8)
    lines[:, 1:] = values.astype(">u2").reshape(rows, -1).view(np.uint8)
    header = struct.pack(">IIBBBBB", columns, rows, 16, 0 if channels == 1 else 2, 0, 0, 0)
    parts = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )

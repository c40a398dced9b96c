"""Height and normal maps of a scan's texture as PNG and OpenEXR files, with a record of their scale and orientation."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.texture.exr import exr_bytes
from brdfpipe.texture.file_names import MAP_FILES
from brdfpipe.texture.png import png_bytes
from brdfpipe.texture.scan_texture import normals_of

_LARGEST = 65535


def write_maps(texture: xr.Dataset, folder: str | os.PathLike[str], name: str) -> dict[str, Any]:
    """Write ``<name>.height.png``, ``<name>.normal.png``, both as ``.exr``, and their record ``<name>.maps.json``.

    Parameters
    ----------
    texture : kind ``texture``, of a scan
    folder : where the files are written
    name : of the files

    Returns
    -------
    The record: the size of a pixel and of the map [um], the heights [um] of the values 0 and 65535, the axes of the normals, and what the
    maps leave to the BRDF.

    Raises
    ------
    StoreError : the files cannot be written.

    Notes
    -----
    The first row of the files is the upper edge, at the largest y. Normals of the PNG file are (n + 1)/2, with x to the right and y upwards, which is what OpenGL,
    glTF, MaterialX and Mitsuba expect; the OpenEXR files have heights in um and the components of the normals themselves. All are linear, not sRGB.
    """
    folder = Path(folder)
    # Upper row first.
    height, normals = texture["height"].values[::-1].astype(float), normals_of(texture)[::-1]
    low, high = float(height.min()), float(height.max())
    rows, columns = height.shape
    pixel = float(texture.attrs["pixel"])
    record = {
        "pixel_um": pixel,
        "size_um": [columns * pixel, rows * pixel],
        "tileable": True,
        "first_row": "upper edge, at the largest y",
        "height": {"file": f"{name}.height.png", "um_at_0": low, "um_at_65535": high},
        "height_exr": {"file": f"{name}.height.exr", "values": "um"},
        "normal": {"file": f"{name}.normal.png", "values": "(n + 1)/2, x to the right, y upwards"},
        "normal_exr": {"file": f"{name}.normal.exr", "values": "n, from -1 to 1, x to the right, y upwards"},
        "encoding": "linear; PNG: 16 bits, OpenEXR: 32-bit floats",
        "unresolved_share_of_mean_square_slope": float(texture["unresolved_share"]),
        "share_of_facets_at_other_slopes": float(texture["split_difference"]),
    }
    side = f"one pixel is {pixel:g} um"
    content = {
        ".height.png": png_bytes((height - low) / max(high - low, 1e-300) * _LARGEST),
        ".normal.png": png_bytes((normals + 1) / 2 * _LARGEST),
        ".height.exr": exr_bytes({"Y": height}, f"heights in um; {side}"),
        ".normal.exr": exr_bytes(
            dict(zip("RGB", np.moveaxis(normals, -1, 0), strict=True)), f"components of unit normals; {side}"
        ),
        ".maps.json": (json.dumps(record, indent=2) + "\n").encode(),
    }
    for end in MAP_FILES:
        store.write_bytes(folder / f"{name}{end}", content[end])
    return record

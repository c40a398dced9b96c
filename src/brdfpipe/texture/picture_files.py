"""The texture of an effect paint as PNG and OpenEXR files, with a record of their scale, orientation and geometries."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe import store
from brdfpipe.texture.exr import exr_bytes
from brdfpipe.texture.file_names import PICTURE_FILES
from brdfpipe.texture.png import png_bytes

_LARGEST = 65535


def write_pictures(texture: xr.Dataset, folder: str | os.PathLike[str], name: str) -> dict[str, Any]:
    """Write ``<name>.texture-1.png`` and ``.exr``, the same of further geometries, and their record ``<name>.texture.json``.

    Parameters
    ----------
    texture : kind ``texture``, of pictures
    folder : where the files are written; those of an earlier texture are deleted
    name : of the files

    Returns
    -------
    The record: the size of a pixel and of the texture [um]; of each geometry the files, its flake angle [degree] and the light that 65535 of the PNG file means.

    Notes
    -----
    Values of the OpenEXR files are the light over its mean: a renderer multiplies the BRDF with them. The first row is the upper edge, at the largest y.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for end in PICTURE_FILES:
        (folder / f"{name}{end}").unlink(missing_ok=True)
    pixel, listed = float(texture.attrs["pixel"]), []
    for number, geometry in enumerate(texture["geometry"].values, start=1):
        # Upper row first.
        light = texture["relative_light"].values[number - 1, ::-1].astype(float)
        largest, stem = float(light.max()), f"{name}.texture-{number}"
        store.write_bytes(folder / f"{stem}.png", png_bytes(light / largest * _LARGEST))
        comment = f"light over its mean at {geometry}; one pixel is {pixel:g} um"
        store.write_bytes(folder / f"{stem}.exr", exr_bytes({"Y": light}, comment))
        angle = float(texture["theta_f"].values[number - 1])
        listed.append(
            {
                "geometry": str(geometry),
                "flake_angle_degree": angle if angle == angle else None,
                "png": {"file": f"{stem}.png", "light_at_65535": largest},
                "exr": {"file": f"{stem}.exr"},
            }
        )
    record = {
        "pixel_um": pixel,
        "size_um": [texture.sizes["x"] * pixel, texture.sizes["y"] * pixel],
        "tileable": True,
        "first_row": "upper edge, at the largest y",
        "values": "light over its mean, by which the BRDF is multiplied; linear. PNG: 16 bits, OpenEXR: 32-bit floats",
        "textures": listed,
    }
    store.write_text(folder / f"{name}.texture.json", json.dumps(record, indent=2) + "\n")
    return record

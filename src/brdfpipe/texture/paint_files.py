"""Materials of renderers with the texture of a paint, by which its BRDF is multiplied: glTF, OpenPBR in MaterialX, and a scene of Mitsuba."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as xml

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.exchange import gltf, openpbr, records, rgl
from brdfpipe.exchange.registry import FORMATS, ExchangeError
from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import encoded_srgb, linear_srgb
from brdfpipe.texture.file_names import PAINT_FILES
from brdfpipe.texture.renderer_files import (
    TABLE_OPTIONS,
    add_bitmap,
    add_gltf_texture,
    comment,
    insert_before,
    panel_scene,
    read_document,
    surface_shader,
    tile_side,
    tiled_image,
    with_files,
    write_document,
)

_LEVELS_OF_DETAIL = 9987
"""LINEAR_MIPMAP_LINEAR (Khronos, glTF 2.0 specification, 5.26): right here, as they are means of the light, not of normals."""

LARGEST_CUT = 0.01
"""Share of the light that pixels above the largest value of a format may lose."""


class Picture(NamedTuple):
    """The one texture that the materials have."""

    number: int
    """Of its files, from 1."""
    geometry: str
    light: Array
    """(rows, columns) light over its mean, the upper row first."""


def with_paint_files(
    texture: xr.Dataset, bsdf: xr.Dataset, folder: Path, name: str, formats: Sequence[str]
) -> xr.Dataset:
    """Write ``<name>.textured.gltf`` (with ``.textured.png``), ``.textured.mtlx``, and ``.textured.xml`` (Mitsuba, with the table ``.textured.rgb.bsdf``).

    Parameters
    ----------
    texture : kind ``texture``, of pictures, which are written beside these files (:mod:`brdfpipe.texture.picture_files`)
    bsdf : kind ``bsdf``, of the paint
    folder, name : as of the pictures
    formats : those of :data:`brdfpipe.texture.file_names.TEXTURED_FORMATS` that are written; others are left out

    Returns
    -------
    The texture, as :func:`brdfpipe.texture.renderer_files.with_files` returns it.

    Notes
    -----
    A material of a renderer has one texture for all directions: that of :func:`chosen_picture`.
    """
    picture = chosen_picture(texture)
    writers: dict[str, Callable[[Path], None]] = {
        "gltf": lambda path: _write_gltf(texture, picture, bsdf, path, name),
        "openpbr": lambda path: _write_materialx(texture, picture, bsdf, path, name),
        "rgl": lambda path: _write_mitsuba(texture, picture, bsdf, path, name),
    }
    return with_files(texture, writers, PAINT_FILES, folder, name, formats)


def chosen_picture(texture: xr.Dataset) -> Picture:
    """The first picture in light from one direction, as of a lamp; in diffuse light if there is no other."""
    directional = np.flatnonzero(np.isfinite(texture["theta_f"].values))
    at = int(directional[0]) if directional.size else 0
    light = texture["relative_light"].values[at, ::-1].astype(float)
    return Picture(at + 1, str(texture["geometry"].values[at]), light)


def _write_gltf(texture: xr.Dataset, picture: Picture, bsdf: xr.Dataset, path: Path, name: str) -> None:
    """Textures of glTF are at most 1, and encoded as sRGB: that of the material is the light over its largest value, by which the factors are multiplied."""
    record = gltf.write(bsdf, path, **FORMATS["gltf"].options)
    document = json.loads(path.read_text(encoding="utf-8"))
    (material,) = document["materials"]
    values = material["pbrMetallicRoughness"]
    base = np.array(values["baseColorFactor"][:3])
    lobe = _lobe_is_textured(record)
    # Reflectance of facets along their normal, by which the lobe takes light from the base below it.
    normal = ((record["parameters"]["index"] - 1) / (record["parameters"]["index"] + 1)) ** 2
    shadow = normal if lobe and not values["metallicFactor"] else 0.0
    largest = min(float(picture.light.max()), 1 / shadow if shadow else np.inf)
    brightest = float(base.max()) * _base_gain(np.minimum(picture.light, largest), shadow)
    if brightest > 0:
        largest = min(largest, 1 / brightest)
    light = np.minimum(picture.light, largest)
    lost = 1 - float(light.mean() / picture.light.mean())
    if lost > LARGEST_CUT:
        raise ExchangeError(
            f"factors of glTF are at most 1, and the brightest pixel of the texture is {picture.light.max():.3g} times the mean, of a base of {base.max():.2g}: "
            f"cut there, the light would be {lost:.0%} lower; limit: {LARGEST_CUT:.0%}; use rgl or openpbr"
        )
    file, encoded = path.with_suffix(".png"), np.rint(255 * encoded_srgb(light / largest)).astype(np.uint8)
    store.write_bytes(file, _png_of_8_bits(encoded))
    # What is read of 8 bits has another mean.
    shown = linear_srgb(encoded / 255)
    largest *= float((light / largest).mean() / shown.mean())
    light = shown * largest
    add_gltf_texture(document, file.name, texture, smaller=_LEVELS_OF_DETAIL)
    gain = largest * _base_gain(light, shadow)
    values["baseColorFactor"] = [*np.minimum(base * gain, 1.0).tolist(), 1.0]
    values["baseColorTexture"] = {"index": 0}
    if shadow:
        document["extensionsUsed"].append("KHR_materials_specular")
        factors = {"specularColorFactor": [largest] * 3, "specularColorTexture": {"index": 0}}
        material["extensions"]["KHR_materials_specular"] = factors
    material["extras"]["brdfpipe"]["texture"] = {
        "record": f"{name}.texture.json",
        "geometry": picture.geometry,
        "tile_mm": tile_side(texture),
        "light_at_1": largest,
        "light_cut": lost,
        "multiplies": ["baseColorFactor", *(["specularColorFactor"] if shadow else [])],
    }
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def _png_of_8_bits(values: NDArray[np.uint8]) -> bytes:
    """Grey (rows, columns) as red, green and blue. Viewers of glTF read 8 bits, and cut further ones off instead of rounding."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.repeat(values[..., None], 3, axis=-1)).save(buffer, "PNG")
    return buffer.getvalue()


def _base_gain(light: Array, normal: float) -> float:
    """Factor by which the base is brighter, so that its mean over a tile is that of the material without a texture.

    Where the lobe of facets is bright it lets less light through to the base, which is bright there, too: the mean of T·(1 − F₀T) is less than 1 − F₀. Schlick's approximation has
    the same ratio at every angle.
    """
    left = 1 - normal * float((light**2).mean() / light.mean())
    return (1 - normal) / max(left, 1e-6)


def _write_materialx(texture: xr.Dataset, picture: Picture, bsdf: xr.Dataset, path: Path, name: str) -> None:
    record = openpbr.write(bsdf, path, **FORMATS["openpbr"].options)
    lobe, metal = _lobe_is_textured(record), bool(record["parameters"]["metal"])
    inputs = ("specular_weight",) if metal else ("base_color", "specular_color") if lobe else ("base_color",)
    root = read_document(path)
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    file = f"{name}.texture-{picture.number}.exr"
    sentences = (
        f"one tile of {file} is {tile_side(texture):g} mm wide; its record is {name}.texture.json",
        f"the texture is the light over its mean at {picture.geometry}, up to {picture.light.max():.3g}, and multiplies {' and '.join(inputs)}: a renderer must not cut these at 1",
    )
    for sentence in reversed(sentences):
        root.insert(0, comment(sentence))
    image = tiled_image(f"light_image_{plain}", "float", file, texture)
    shader = surface_shader(root)
    nodes = [image]
    for given in inputs:
        connected = shader.find(f"input[@name='{given}']")
        if connected is None:
            connected = xml.SubElement(shader, "input", name=given, type="color3", value="1, 1, 1")
        kind, value = connected.attrib["type"], connected.attrib.pop("value")
        if kind == "float":
            # Both weights of the file are 1.
            connected.set("nodename", image.attrib["name"])
            continue
        product = xml.Element("multiply", name=f"{given}_{plain}", type=kind)
        xml.SubElement(product, "input", name="in1", type=kind, value=value)
        xml.SubElement(product, "input", name="in2", type="float", nodename=image.attrib["name"])
        connected.set("nodename", product.attrib["name"])
        nodes.append(product)
    insert_before(root, shader, nodes)
    write_document(root, path)


def _write_mitsuba(texture: xr.Dataset, picture: Picture, bsdf: xr.Dataset, path: Path, name: str) -> None:
    """Weights of a blend are at most 1: that of a table of the BRDF times the largest value, over black, is the light over this value."""
    largest = float(picture.light.max())
    table = path.with_name(f"{name}.textured.rgb.bsdf")
    record = rgl.write(bsdf, table, scale=largest, **TABLE_OPTIONS)
    FORMATS["rgl"].write_record(table, record)
    note = f"; texture of {picture.geometry}; {table.name} is the BRDF times {largest:g}, at the largest value of the texture; on average the BRDF"
    scene, shape = panel_scene(tile_side(texture), note)
    blend = xml.SubElement(shape, "bsdf", type="blendbsdf")
    # 16 bits, linear, 65535 at the largest value.
    add_bitmap(blend, "weight", f"{name}.texture-{picture.number}.png", str(texture.attrs["interpolation"]))
    black = xml.SubElement(blend, "bsdf", type="diffuse")
    xml.SubElement(black, "rgb", name="reflectance", value="0")
    measured = xml.SubElement(blend, "bsdf", type="measured")
    xml.SubElement(measured, "string", name="filename", value=table.name)
    write_document(scene, path)


def _lobe_is_textured(record: records.Record) -> bool:
    """Whether the light of flakes is in the lobe, too: that of a smooth surface is a mirror, and not of its BRDF.

    Raises ExchangeError: a metal's mirror alone, which has no BRDF that a texture multiplies.
    """
    parameters = record["parameters"]
    smooth = parameters["roughness"] == 0
    if smooth and parameters["metal"]:
        raise ExchangeError("a smooth metal is a mirror, and a texture multiplies scattered light")
    return not smooth

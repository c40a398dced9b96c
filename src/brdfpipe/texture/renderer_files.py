"""Materials of renderers that use the maps of a scan: glTF, OpenPBR in MaterialX, and a scene of Mitsuba."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.exchange import gltf, openpbr, rgl
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.texture.file_names import RENDERER_FILES, TEXTURED_FORMATS

_GLTF_FILTERS = {"bilinear": 9729, "nearest": 9728}
"""LINEAR and NEAREST (Khronos, glTF 2.0 specification, 5.26)."""
_MATERIALX_FILTERS = {"bilinear": "linear", "nearest": "closest"}

TABLE_OPTIONS = {"tolerance": 0.01, "albedo_tolerance": 0.001, "largest": 400_000}
"""Of the table that a scene of Mitsuba reads (:data:`brdfpipe.exchange.registry.GRID_OPTIONS`)."""

TILES = 4
"""Along either side of the panel of a scene."""


def with_renderer_files(
    texture: xr.Dataset, rest: xr.Dataset, folder: Path, name: str, formats: Sequence[str]
) -> xr.Dataset:
    """Write ``<name>.textured.gltf``, ``.textured.mtlx`` and ``.textured.xml`` (Mitsuba, with the table ``<name>.unresolved.rgb.bsdf``).

    Parameters
    ----------
    texture : kind ``texture``, of a scan, whose maps are written beside these files (:mod:`brdfpipe.texture.map_files`)
    rest : kind ``bsdf``, of what the map does not resolve
    folder, name : as of the maps
    formats : those of :data:`brdfpipe.texture.file_names.TEXTURED_FORMATS` that are written; others are left out

    Returns
    -------
    The rest, as :func:`with_files` returns it.
    """
    writers: dict[str, Callable[[Path], None]] = {
        "gltf": lambda path: _write_gltf(texture, rest, path, name),
        "openpbr": lambda path: _write_materialx(texture, rest, path, name),
        "rgl": lambda path: _write_mitsuba(texture, rest, path, name),
    }
    return with_files(rest, writers, RENDERER_FILES, folder, name, formats)


def with_files(
    dataset: xr.Dataset,
    writers: Mapping[str, Callable[[Path], None]],
    ends: Sequence[str],
    folder: Path,
    name: str,
    formats: Sequence[str],
) -> xr.Dataset:
    """Write a material of each format, and state the files in a dataset.

    Parameters
    ----------
    writers : format → what writes its file; formats are those of :data:`brdfpipe.texture.file_names.TEXTURED_FORMATS`
    ends : of the names of all files that the writers may write; those of an earlier run are deleted
    folder, name, formats : as :func:`with_renderer_files` takes them

    Returns
    -------
    The dataset with the digests of the files by name, as the attribute ``files``, and a warning for each format that cannot hold the material, of which an earlier file is deleted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    warnings = []
    for end in ends:
        (folder / f"{name}{end}").unlink(missing_ok=True)
    for format, end in TEXTURED_FORMATS.items():
        if format not in formats:
            continue
        path = folder / f"{name}{end}"
        try:
            writers[format](path)
        except store.StoreError:
            raise
        except BrdfpipeError as refusal:
            path.unlink(missing_ok=True)
            warnings.append(f"{end[1:]} not written: {' '.join(str(refusal).split())}")
    written = [f"{name}{end}" for end in ends if (folder / f"{name}{end}").exists()]
    listed = {file: store.file_digest(folder / file) for file in written}
    return vocabulary.add_warning(dataset.assign_attrs(files=store.canonical_json(listed)), *warnings)


def _write_gltf(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    gltf.write(rest, path, **FORMATS["gltf"].options)
    document = json.loads(path.read_text(encoding="utf-8"))
    # Between pixels as the split assumes. No levels of detail: their mean normals lose the slopes of the map, which the BRDF of the rest lacks.
    between = _GLTF_FILTERS[texture.attrs["interpolation"]]
    add_gltf_texture(document, f"{name}.normal.png", texture, smaller=between)
    document["materials"][0]["normalTexture"] = {"index": 0}
    document["materials"][0]["extras"]["brdfpipe"]["maps"] = f"{name}.maps.json"
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def _write_materialx(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    openpbr.write(rest, path, **FORMATS["openpbr"].options)
    root = read_document(path)
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    side = tile_side(texture)
    root.insert(0, comment(f"one tile of {name}.normal.png is {side:g} mm wide; its record is {name}.maps.json"))
    image = tiled_image(f"normal_image_{plain}", "vector3", f"{name}.normal.png", texture)
    normal = xml.Element("normalmap", name=f"normal_{plain}", type="vector3")
    xml.SubElement(normal, "input", name="in", type="vector3", nodename=image.attrib["name"])
    shader = surface_shader(root)
    xml.SubElement(shader, "input", name="geometry_normal", type="vector3", nodename=normal.attrib["name"])
    insert_before(root, shader, [image, normal])
    write_document(root, path)


def add_gltf_texture(document: dict[str, Any], file: str, texture: xr.Dataset, *, smaller: int) -> None:
    """Give a document of glTF its texture 0: a PNG file, repeated along both axes. ``smaller`` is the filter of pixels that are smaller than those of the screen."""
    document["images"] = [{"uri": file, "mimeType": "image/png"}]
    between = _GLTF_FILTERS[texture.attrs["interpolation"]]
    document["samplers"] = [{"magFilter": between, "minFilter": smaller, "wrapS": 10497, "wrapT": 10497}]
    document["textures"] = [{"source": 0, "sampler": 0}]


def tiled_image(name: str, type: str, file: str, texture: xr.Dataset) -> xml.Element:
    """A node of MaterialX: a linear picture that is repeated, interpolated as a texture says."""
    node = xml.Element("tiledimage", name=name, type=type)
    xml.SubElement(node, "input", name="file", type="filename", value=file, colorspace="none")
    between = _MATERIALX_FILTERS[texture.attrs["interpolation"]]
    xml.SubElement(node, "input", name="filtertype", type="string", value=between)
    return node


def surface_shader(root: xml.Element) -> xml.Element:
    """The shader of a document of MaterialX that :mod:`brdfpipe.exchange.openpbr` wrote."""
    shader = root.find("open_pbr_surface")
    assert shader is not None
    return shader


def insert_before(root: xml.Element, shader: xml.Element, nodes: Sequence[xml.Element]) -> None:
    """Insert nodes before the shader that uses them, as MaterialX wants it."""
    at = list(root).index(shader)
    root[at:at] = nodes


def _write_mitsuba(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    """A panel of 4 x 4 tiles under a small lamp, 45 degree from the normal."""
    table = path.with_name(f"{name}.unresolved.rgb.bsdf")
    record = rgl.write(rest, table, **TABLE_OPTIONS)
    FORMATS["rgl"].write_record(table, record)
    lay = representation(rest).lay
    scene, shape = panel_scene(tile_side(texture), "" if lay is None else ", with the lay of the scan")
    mapped = xml.SubElement(shape, "bsdf", type="normalmap")
    add_bitmap(mapped, "normalmap", f"{name}.normal.png", str(texture.attrs["interpolation"]))
    measured = xml.SubElement(mapped, "bsdf", type="measured")
    _value(measured, "string", "filename", table.name)
    write_document(scene, path)


def panel_scene(side: float, note: str = "") -> tuple[xml.Element, xml.Element]:
    """A scene of Mitsuba, and its panel of 4 x 4 tiles, which has no material yet, under a small lamp, 45 degree from the normal.

    Parameters
    ----------
    side : of a tile [mm]
    note : end of the comment of the file
    """
    distance = 40.0
    scene = xml.Element("scene", version="3.0.0")
    scene.append(comment(f"{TILES} x {TILES} tiles of {side:g} mm; lengths in mm; u is x of the map{note}"))
    integrator = xml.SubElement(scene, "integrator", type="path")
    _value(integrator, "integer", "max_depth", "4")
    sensor = xml.SubElement(scene, "sensor", type="perspective")
    _value(sensor, "float", "fov", f"{1.2 * 57.3 / distance:.3f}")
    pose = xml.SubElement(sensor, "transform", name="to_world")
    xml.SubElement(pose, "lookat", origin=f"0, 0, {distance * TILES * side:g}", target="0, 0, 0", up="0, 1, 0")
    sampler = xml.SubElement(sensor, "sampler", type="independent")
    _value(sampler, "integer", "sample_count", "64")
    film = xml.SubElement(sensor, "film", type="hdrfilm")
    for axis in ("width", "height"):
        _value(film, "integer", axis, "512")
    lamp = xml.SubElement(scene, "emitter", type="directional")
    xml.SubElement(lamp, "vector", name="direction", value="-1, 0, -1")
    xml.SubElement(lamp, "rgb", name="irradiance", value="3")
    shape = xml.SubElement(scene, "shape", type="rectangle")
    placed = xml.SubElement(shape, "transform", name="to_world")
    xml.SubElement(placed, "scale", value=f"{TILES * side / 2:g}")
    return scene, shape


def add_bitmap(material: xml.Element, name: str, file: str, interpolation: str) -> None:
    """Give a material of :func:`panel_scene` a linear picture, repeated over the panel, as its input of this name."""
    bitmap = xml.SubElement(material, "texture", type="bitmap", name=name)
    _value(bitmap, "string", "filename", file)
    _value(bitmap, "boolean", "raw", "true")
    _value(bitmap, "string", "filter_type", interpolation)
    _value(bitmap, "string", "wrap_mode", "repeat")
    repeated = xml.SubElement(bitmap, "transform", name="to_uv")
    # Mitsuba has the first row of a picture, the upper edge of the map, at v = 0, where y is lowest.
    xml.SubElement(repeated, "scale", x=str(TILES), y=str(-TILES))


def write_document(root: xml.Element, path: Path) -> None:
    """Write a document of XML: a scene of Mitsuba, or MaterialX."""
    xml.indent(root)
    store.write_text(path, f'<?xml version="1.0"?>\n{xml.tostring(root, encoding="unicode")}\n')


def read_document(path: Path) -> xml.Element:
    """The root of a document of XML, with its comments."""
    parser = xml.XMLParser(target=xml.TreeBuilder(insert_comments=True))
    return xml.fromstring(path.read_text(encoding="utf-8"), parser)


def comment(sentence: str) -> xml.Element[Any]:
    """A comment of XML, which two hyphens would end."""
    return xml.Comment(f" {re.sub('-(?=-)', '- ', sentence)} ")


def _value(parent: xml.Element, kind: str, name: str, value: str) -> None:
    xml.SubElement(parent, kind, name=name, value=value)


def tile_side(texture: xr.Dataset) -> float:
    """Side of a tile [mm]."""
    return float(texture.sizes["x"] * texture.attrs["pixel"]) / 1000

"""Materials of renderers that use the maps of a scan: glTF, OpenPBR in MaterialX, and a scene of Mitsuba."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
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


def with_renderer_files(
    texture: xr.Dataset, rest: xr.Dataset, folder: Path, name: str, formats: Sequence[str]
) -> xr.Dataset:
    """Write the files of :func:`write_renderer_files`; return the rest with their names, as the attribute ``files``, and their warnings."""
    files, warnings = write_renderer_files(texture, rest, folder, name, formats)
    listed = {file: store.file_digest(folder / file) for file in files}
    return vocabulary.add_warning(rest.assign_attrs(files=store.canonical_json(listed)), *warnings)


def write_renderer_files(
    texture: xr.Dataset, rest: xr.Dataset, folder: Path, name: str, formats: Sequence[str] = tuple(TEXTURED_FORMATS)
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write ``<name>.textured.gltf``, ``.textured.mtlx`` and ``.textured.xml`` (Mitsuba, with the table ``<name>.unresolved.rgb.bsdf``).

    Parameters
    ----------
    texture : kind ``texture``, of a scan, whose maps are written beside these files (:mod:`brdfpipe.texture.map_files`)
    rest : kind ``bsdf``, of what the map does not resolve
    folder, name : as of the maps
    formats : those of :data:`brdfpipe.texture.file_names.TEXTURED_FORMATS` that are written; others are left out

    Returns
    -------
    Names of the files, and a warning for each format that cannot hold the material, of which an earlier file is deleted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    warnings = []
    writers: dict[str, Callable[[Path], None]] = {
        "gltf": lambda path: _write_gltf(texture, rest, path, name),
        "openpbr": lambda path: _write_materialx(texture, rest, path, name),
        "rgl": lambda path: _write_mitsuba(texture, rest, path, name),
    }
    for end in RENDERER_FILES:
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
    return tuple(f"{name}{end}" for end in RENDERER_FILES if (folder / f"{name}{end}").exists()), tuple(warnings)


def _write_gltf(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    gltf.write(rest, path, **FORMATS["gltf"].options)
    document = json.loads(path.read_text(encoding="utf-8"))
    document["images"] = [{"uri": f"{name}.normal.png", "mimeType": "image/png"}]
    # Between pixels as the split assumes; repeated along both axes. No levels of detail: their mean normals lose the slopes of the map, which the BRDF of the rest lacks.
    between = _GLTF_FILTERS[texture.attrs["interpolation"]]
    document["samplers"] = [{"magFilter": between, "minFilter": between, "wrapS": 10497, "wrapT": 10497}]
    document["textures"] = [{"source": 0, "sampler": 0}]
    document["materials"][0]["normalTexture"] = {"index": 0}
    document["materials"][0]["extras"]["brdfpipe"]["maps"] = f"{name}.maps.json"
    store.write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def _write_materialx(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    openpbr.write(rest, path, **FORMATS["openpbr"].options)
    root = xml.fromstring(path.read_text(encoding="utf-8"), xml.XMLParser(target=xml.TreeBuilder(insert_comments=True)))
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    side = _side(texture)
    sentence = f" one tile of {name}.normal.png is {side:g} mm wide; its record is {name}.maps.json "
    root.insert(0, xml.Comment(re.sub("-(?=-)", "- ", sentence)))
    # Nodes come before the shader that uses them.
    image = xml.Element("tiledimage", name=f"normal_image_{plain}", type="vector3")
    xml.SubElement(image, "input", name="file", type="filename", value=f"{name}.normal.png", colorspace="none")
    between = _MATERIALX_FILTERS[texture.attrs["interpolation"]]
    xml.SubElement(image, "input", name="filtertype", type="string", value=between)
    normal = xml.Element("normalmap", name=f"normal_{plain}", type="vector3")
    xml.SubElement(normal, "input", name="in", type="vector3", nodename=image.attrib["name"])
    shader = root.find("open_pbr_surface")
    assert shader is not None
    at = list(root).index(shader)
    root.insert(at, image)
    root.insert(at + 1, normal)
    xml.SubElement(shader, "input", name="geometry_normal", type="vector3", nodename=normal.attrib["name"])
    xml.indent(root)
    store.write_text(path, f'<?xml version="1.0"?>\n{xml.tostring(root, encoding="unicode")}\n')


def _write_mitsuba(texture: xr.Dataset, rest: xr.Dataset, path: Path, name: str) -> None:
    """A panel of 4 x 4 tiles under a small lamp, 45 degree from the normal."""
    table = path.with_name(f"{name}.unresolved.rgb.bsdf")
    record = rgl.write(rest, table, tolerance=0.01, albedo_tolerance=0.001, largest=400_000)
    FORMATS["rgl"].write_record(table, record)
    side = _side(texture)
    tiles, distance = 4, 40.0
    lay = representation(rest).lay
    comment = (
        f" 4 x 4 tiles of {side:g} mm; lengths in mm; u is x of the map"
        + ("" if lay is None else ", with the lay of the scan")
        + " "
    )
    scene = xml.Element("scene", version="3.0.0")
    scene.append(xml.Comment(re.sub("-(?=-)", "- ", comment)))
    integrator = xml.SubElement(scene, "integrator", type="path")
    _value(integrator, "integer", "max_depth", "4")
    sensor = xml.SubElement(scene, "sensor", type="perspective")
    _value(sensor, "float", "fov", f"{1.2 * 57.3 / distance:.3f}")
    pose = xml.SubElement(sensor, "transform", name="to_world")
    xml.SubElement(pose, "lookat", origin=f"0, 0, {distance * tiles * side:g}", target="0, 0, 0", up="0, 1, 0")
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
    xml.SubElement(placed, "scale", value=f"{tiles * side / 2:g}")
    mapped = xml.SubElement(shape, "bsdf", type="normalmap")
    bitmap = xml.SubElement(mapped, "texture", type="bitmap", name="normalmap")
    _value(bitmap, "string", "filename", f"{name}.normal.png")
    _value(bitmap, "boolean", "raw", "true")
    _value(bitmap, "string", "filter_type", str(texture.attrs["interpolation"]))
    _value(bitmap, "string", "wrap_mode", "repeat")
    repeated = xml.SubElement(bitmap, "transform", name="to_uv")
    # Mitsuba has the first row of a picture, the upper edge of the map, at v = 0, where y is lowest.
    xml.SubElement(repeated, "scale", x=str(tiles), y=str(-tiles))
    measured = xml.SubElement(mapped, "bsdf", type="measured")
    _value(measured, "string", "filename", table.name)
    xml.indent(scene)
    store.write_text(path, f'<?xml version="1.0"?>\n{xml.tostring(scene, encoding="unicode")}\n')


def _value(parent: xml.Element, kind: str, name: str, value: str) -> None:
    xml.SubElement(parent, kind, name=name, value=value)


def _side(texture: xr.Dataset) -> float:
    """Side of a tile [mm]."""
    return float(texture.sizes["x"] * texture.attrs["pixel"]) / 1000

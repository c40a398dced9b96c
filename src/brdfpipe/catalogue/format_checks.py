"""Checks of a material that need no reading of its raw files: extensions, readers and whether they are installed, names of plastics and illuminants."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brdfpipe.catalogue.configuration import check_illuminant
from brdfpipe.catalogue.material import BASE_INDEX, ROUTES, Material, at_key, raw_files
from brdfpipe.catalogue.material_keys import MultiangleColours, states_lay
from brdfpipe.catalogue.names import DESCRIPTION
from brdfpipe.errors import BrdfpipeError, InputError, naming_key
from brdfpipe.file_formats import extensions

if TYPE_CHECKING:
    import xarray as xr


def check_formats(material: Material) -> None:
    """Check the raw files without reading them, and the names of the plastic and the illuminant.

    Raises
    ------
    InputError : an empty file, an extension without a reader, an unknown plastic, illuminant or geometry of a reading, a colour that no
        spectrum has.
    """
    from brdfpipe.columns import TEXT_SUFFIXES
    from brdfpipe.exchange.reading import format_of
    from brdfpipe.optics import index
    from brdfpipe.optics.index import refractive_index
    from brdfpipe.spectra.formats.registry import FORMATS as SPECTRUM_FORMATS
    from brdfpipe.surfaces.reading import FORMATS as SURFACE_FORMATS
    from brdfpipe.surfaces.reading import check_readable
    from brdfpipe.surfaces.selection import PICTURES

    spectra = extensions(SPECTRUM_FORMATS)
    of_index = tuple(index.READERS)
    suffixes = {
        "spectrum": spectra,
        "spectrum_sce": spectra,
        "index": of_index,
        "base_index": of_index,
        "mask": PICTURES,
    }
    surface_suffixes = extensions(SURFACE_FORMATS)
    content = material.content
    for part, key, _ in raw_files(content):
        path, is_surface = material.files[part], "surface" in part
        key = key.removesuffix(".scans")
        if path.stat().st_size == 0:
            raise InputError(path, "an empty file", key=f"{key}.file")
        if part.startswith("texture-"):
            _check_picture(path, content["texture"]["pictures"][int(part.partition("-")[2]) - 1]["geometry"], key)
            continue
        if part == "table":
            format_of(path, content["table"].get("format"))
            continue
        block = at_key(content, key)
        if part.startswith("surface-"):
            scan = content["surface"]["scans"][int(part.partition("-")[2]) - 2]
            alike = path.suffix.lower() == material.files["surface"].suffix.lower()
            block = block | scan if alike else scan
        accepted = surface_suffixes if is_surface else suffixes.get(part, TEXT_SUFFIXES)
        named = "format" in block
        if path.suffix.lower() not in accepted and not named:
            raise InputError(
                path,
                "unknown file extension",
                found=path.suffix or "none",
                accepted=", ".join(sorted(accepted)),
                key=f"{key}.format" if is_surface else f"{key}.file",
            )
        if is_surface:
            check_readable(path, block.get("format"), block)
    if material.has("index") and "index" not in material.files:
        refractive_index(content["index"])
    if material.has("coat") and "base_index" not in material.files:
        with naming_key(BASE_INDEX, "index"):
            refractive_index(at_key(content, BASE_INDEX))
    if "illuminant" in content.get("spectrum", {}):
        check_illuminant(material.folder / DESCRIPTION, content["spectrum"]["illuminant"], "spectrum.illuminant")
    if "lab" in content.get("spectrum", {}):
        _check_colour(material)
    for number, colour in enumerate(content.get("measured", {}).get("lab", [])):
        _check_reading(material, number, colour)
    if "colours" in content.get("multiangle", {}):
        from brdfpipe.flakes.reading import ingest

        check_flakes(ingest(_read_by_stage(material, "multiangle")), material)


def check_flakes(colours: xr.Dataset, material: Material) -> None:
    """Refuse multi-angle colours, kind ``multiangle``, to which the declared form along the flake angle does not fit, as the build will."""
    from brdfpipe.bsdf import flake

    flake.build(colours, **_read_by_stage(material, "flake"))


def _check_picture(path: Path, geometry: str, key: str) -> None:
    from brdfpipe.texture.picture_reading import PICTURES
    from brdfpipe.texture.picture_texture import picture_angle

    if path.suffix.lower() not in PICTURES:
        found, accepted = path.suffix or "none", ", ".join(PICTURES)
        raise InputError(path, "unknown file extension", found=found, accepted=accepted, key=f"{key}.file")
    try:
        picture_angle(geometry)
    except BrdfpipeError as refusal:
        raise InputError(path, str(refusal), key=f"{key}.geometry") from None


def _read_by_stage(material: Material, stage: str) -> dict[str, Any]:
    """The keys of ``multiangle`` that a stage reads."""
    read = MultiangleColours.read_by(stage)
    return {key: value for key, value in material.content["multiangle"].items() if key in read}


def _check_colour(material: Material) -> None:
    """Refuse a colour that no spectrum has, as the build will. The index of a file is not read, and sets no least reflectance here."""
    from brdfpipe.optics.index import refractive_index
    from brdfpipe.spectra.ingestion import check_colour

    has_index = material.has("index") and "index" not in material.files
    check_colour(material.content["spectrum"], refractive_index(material.content["index"]) if has_index else None)


def refused_exports(material: Material) -> dict[str, str]:
    """Formats of other programs that the build will not write → why, as far as the description shows it."""
    from brdfpipe.exchange.registry import FORMATS

    predicted = not any(material.has(part) for part, _ in ROUTES)
    surface = material.content.get("surface", {})
    has = ["lay"] if predicted and states_lay(surface.get("isotropic"), surface.get("layout")) else []
    sides = ("reflection", "transmission") if material.has("slab") else ("reflection",)
    refusals = {
        name: "; ".join(FORMATS[name].refusals(material.name, has, sides))
        for name in material.scene.exports(material.exports)
    }
    return {name: reason for name, reason in refusals.items() if reason}


def _check_reading(material: Material, number: int, colour: Mapping[str, Any]) -> None:
    from brdfpipe.appearance.colours import TOTAL, WITHOUT_SPECULAR
    from brdfpipe.flakes.geometries import directions
    from brdfpipe.spectra.recovery import check_lab

    where = f"measured.lab.{number}"
    check_illuminant(material.folder / DESCRIPTION, colour["illuminant"], f"{where}.illuminant")
    if colour["geometry"] in (TOTAL, WITHOUT_SPECULAR):
        # Towards a single direction a paint may be brighter than white.
        with naming_key(f"{where}.lab", "spectrum.lab"):
            check_lab(colour["lab"])
        return
    try:
        directions(colour["geometry"])
    except BrdfpipeError as error:
        problem = f"{error}; of spheres: {TOTAL} (specular included), {WITHOUT_SPECULAR} (excluded)"
        raise InputError(material.folder / DESCRIPTION, problem, where=f"{where}.geometry") from None

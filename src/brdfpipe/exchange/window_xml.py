"""Files of WINDOW 6 and Radiance (``.xml``): the document around the matrices or trees of a BSDF.

Radiance names the sides in reverse of WINDOW: light from +Z that is reflected is ``Reflection Back``, and that passes is ``Transmission Back``.

References
----------
WINDOW 6 BSDF schema 1.4; Radiance (bsdf.c, 2026).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import escape

from brdfpipe.errors import InputError
from brdfpipe.exchange import records

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SIDES = {"Reflection Back": False, "Transmission Back": True}
"""Name of light from +Z → whether it passes"""
LARGEST_FILE = 128 * 2**20
"""Bytes of XML that are read."""


class Block(NamedTuple):
    """The values of one side."""

    basis: str
    """Elements that name the angles"""
    data: bytes


def document(record: records.Record, structure: str, basis: str, blocks: Mapping[str, Block]) -> Iterator[bytes]:
    """A file of one layer; ``structure`` and ``basis`` define the data, and the blocks are by the names of :data:`SIDES`."""
    notes = "".join(f"<!-- {note.replace('--', '- -')} -->\n" for note in records.sentences(record))
    yield (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<WindowElement xmlns="http://windows.lbl.gov" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        'xsi:schemaLocation="http://windows.lbl.gov/BSDF-v1.4.xsd">\n'
        f"{notes}<WindowElementType>System</WindowElementType>\n<FileType>BSDF</FileType>\n<Optical>\n<Layer>\n"
        f"<Material><Name>{escape(record['material'])}</Name><Manufacturer>unknown</Manufacturer><DeviceType>Other</DeviceType></Material>\n"
        f"<DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure>\n{basis}</DataDefinition>\n"
    ).encode("ascii", "xmlcharrefreplace")
    for name, block in blocks.items():
        kind = "BTDF" if SIDES[name] else "BRDF"
        yield (
            '<WavelengthData><LayerNumber>System</LayerNumber><Wavelength unit="Integral">Visible</Wavelength>'
            "<SourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum><DetectorSpectrum>ASTM E308 1931 Y.dsp</DetectorSpectrum>\n"
            f"<WavelengthDataBlock><WavelengthDataDirection>{name}</WavelengthDataDirection>\n{block.basis}\n"
            f"<ScatteringDataType>{kind}</ScatteringDataType>\n<ScatteringData>\n"
        ).encode()
        yield block.data
        yield b"</ScatteringData></WavelengthDataBlock></WavelengthData>\n"
    yield b"</Layer>\n</Optical>\n</WindowElement>\n"


def layer(path: Path) -> Element:
    """The one layer of a file.

    Raises InputError: the file is too large, damaged, has entities, or is of another kind.
    """
    root = parsed(path, "a WindowElement")
    layers = root.findall("{*}Optical/{*}Layer")
    if root.tag.rpartition("}")[2] != "WindowElement" or len(layers) != 1:
        found = f"{root.tag[-40:]} with {len(layers)} layers"
        raise InputError(path, "not a BSDF of one layer", found=found, accepted="a WindowElement with one Layer")
    return layers[0]


def parsed(path: Path, accepted: str) -> Element:
    """The root of a document; ``accepted`` is what it should be, for messages.

    Raises InputError: the file is too large, damaged, or has a document type or entities.
    """
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    if path.stat().st_size > LARGEST_FILE:
        found = f"{path.stat().st_size >> 20} MiB"
        raise InputError(path, "the file is too large", found=found, accepted=f"at most {LARGEST_FILE >> 20} MiB")
    content = path.read_bytes()
    try:
        # Some writers put a line of their own before the document.
        root: Element = fromstring(content[max(content.find(b"<?xml"), 0) :], forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError(path, "XML with a document type or entities", accepted=f"{accepted} without them") from error
    except (ParseError, RecursionError, ValueError, LookupError) as error:
        raise InputError(path, "damaged XML", found=str(error)[:80], accepted=accepted) from error
    return root


def text(element: Element, place: str) -> str:
    """Text of an element below another, whatever their namespace; empty if there is none."""
    found = element.findtext("/".join(f"{{*}}{tag}" for tag in place.split("/")))
    return (found or "").strip()


def visible(layer: Element) -> dict[str, list[Element]]:
    """Blocks of visible light, by the name of their direction."""
    found: dict[str, list[Element]] = {}
    for data in layer.findall("{*}WavelengthData"):
        if text(data, "Wavelength") == "Visible":
            for block in data.findall("{*}WavelengthDataBlock"):
                found.setdefault(text(block, "WavelengthDataDirection"), []).append(block)
    return found


def from_above(path: Path, layer: Element) -> tuple[dict[str, Element], tuple[str, ...]]:
    """Blocks of light from +Z by the names of :data:`SIDES`, and notes on what is passed over.

    Raises InputError: a side occurs twice, or there is no reflected light.
    """
    blocks = visible(layer)
    if twice := [name for name, listed in blocks.items() if len(listed) > 1]:
        raise InputError(path, "a direction occurs twice", found=twice[0][:40], accepted="one block for each direction")
    if "Reflection Back" not in blocks:
        found = ", ".join(blocks)[:80] or "no visible data"
        raise InputError(path, "no reflection of light from +Z", found=found, accepted="Reflection Back, Visible")
    notes = ("light from -Z was not read",) if {"Reflection Front", "Transmission Front"} & set(blocks) else ()
    return {name: blocks[name][0] for name in SIDES if name in blocks}, notes

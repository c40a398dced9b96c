"""CxF3 (ISO 17972): objects with a reflectance spectrum."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from brdfpipe import columns
from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_END = 850.0
_STARTS = (360.0, 400.0)
_SPHERES = {"Specular_Included": "specular included", "Specular_Excluded": "specular excluded"}
_DIRECTIONS = ("IlluminationAngle", "MeasurementAngle")
_GLOSS = 10.0
"""Angles of light and view that are closer [degree] may hold the mirror direction."""


def _samples(path: Path, text: str) -> list[base.Sample]:
    root = _xml(path, text)
    elements = root.findall(".//{*}ColorSpecification")
    specifications = {element.get("Id", ""): _specification(element) for element in elements}
    samples, owners = [], []
    for place, item in enumerate(root.findall(".//{*}Object"), start=1):
        name = item.get("Name", f"object {place}")
        for spectrum in item.findall(".//{*}ReflectanceSpectrum"):
            owners.append(spectrum.get("ColorSpecification", ""))
            samples.append(_sample(path, name, spectrum, specifications.get(owners[-1], _Specification())))
    counts = {owner: [s.values.size for s, o in zip(samples, owners, strict=True) if o == owner] for owner in owners}
    return [
        sample._replace(doubts=(*sample.doubts, *_unlike(sample.values.size, counts[owner])))
        for sample, owner in zip(samples, owners, strict=True)
    ]


def _xml(path: Path, text: str) -> Element:
    import defusedxml
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        # The declaration names the encoding of bytes that are decoded already.
        root: Element = fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text), forbid_dtd=True)
    except defusedxml.DefusedXmlException as error:
        raise InputError(path, "XML with a document type or entities", accepted="plain CxF3") from error
    except (ParseError, RecursionError, ValueError) as error:
        raise InputError(path, "damaged XML", found=str(error)[:80], accepted="CxF3", key="spectrum.format") from error
    return root


class _Specification(NamedTuple):
    """Parameters of a ColorSpecification for the spectra that refer to it."""

    start: str | None = None
    step: str | None = None
    quantity: str = ""
    header: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def _specification(element: Element) -> _Specification:
    quantity = (element.findtext(".//{*}MeasurementType") or "").strip()
    span = element.find(".//{*}WavelengthRange")
    start, step = (None, None) if span is None else (span.get("StartWL"), span.get("Increment"))
    sphere = (element.findtext(".//{*}SphereGeometry") or "").strip()
    single = element.find(".//{*}SingleAngle")
    if sphere in _SPHERES:
        return _Specification(start, step, quantity, (_SPHERES[sphere],))
    if single is not None:
        light, view = (columns.number(single.findtext(f"{{*}}{key}") or "") for key in _DIRECTIONS)
        if light is not None and view is not None and abs(abs(light) - abs(view)) > _GLOSS:
            angles = f"SingleAngle {abs(light):g}/{abs(view):g}: light from {abs(light):g} degree"
            return _Specification(start, step, quantity, (f"{angles}, specular excluded",))
    several = element.find(".//{*}MultiAngle") is not None
    doubts = ("it was measured at several angles, so no value is a total reflectance. Use `multiangle`",)
    return _Specification(start, step, quantity, doubts=doubts if several else ())


def _sample(path: Path, name: str, spectrum: Element, specification: _Specification) -> base.Sample:
    if "Transmittance" in specification.quantity or "Emissive" in specification.quantity:
        found, accepted = specification.quantity[:40], "Spectrum_Reflectance"
        raise InputError(
            path, "not a reflectance", where=f"MeasurementType of {name[:40]}", found=found, accepted=accepted
        )
    low, step = (
        _agreed(path, name, key, spectrum.get(key), stated)
        for key, stated in (("StartWL", specification.start), ("Increment", specification.step))
    )
    cells = (spectrum.text or "").split()
    wavelength = base.even_grid(low, step, len(cells))
    doubts = (*specification.doubts, *base.doubt_of_end(wavelength, step))
    if not _STARTS[0] <= low <= _STARTS[1]:
        doubts += (f"StartWL is {low:g} nm; CxF3 allows 360 to 400. Compare it with the instrument",)
    header = (base.FRACTION, *specification.header)
    sample = base.parsed_sample(path, name[:40], name, wavelength, cells, header, doubts=doubts)
    if low + step * (len(cells) - 1) > _END:
        raise InputError(
            path,
            "damaged: wavelengths beyond the range of colour instruments",
            where=name[:40],
            found=f"{len(cells)} values from {low:g} nm by {step:g} nm",
            accepted=f"values up to {_END:g} nm",
        )
    return sample


def _agreed(path: Path, name: str, key: str, own: str | None, shared: str | None) -> float:
    """A number that a spectrum, its specification or both of them state."""
    value = base.stated_number(path, f"{key} of {name[:40]}", own or shared or "")
    if own and shared and value != columns.number(shared):
        found = f"{value:g} and {shared[:20]} nm"
        raise InputError(path, f"damaged: two values of {key}", where=name[:40], found=found, accepted=f"one {key}")
    return value


def _unlike(size: int, sizes: Sequence[int]) -> list[str]:
    """Doubt about a spectrum whose number of values differs from the others of its specification."""
    if 2 * sizes.count(size) > len(sizes):
        return []
    others = ", ".join(str(other) for other in sorted({*sizes} - {size}))
    return [f"it has {size} values, others of the file {others}. Look for lost or added values"]


FORMAT = base.SpectrumFormat(
    "cxf",
    (".cxf",),
    "CxF3 objects with a `ReflectanceSpectrum`, fractions",
    base.from_text(_samples),
    tried="colorchecker_white.cxf, made",
)

"""Spectra in the containers of instruments and of the colour trade, each as two columns of wavelength and reflectance.

The extension or an explicit format decides how a file is read, and what a container states (unit, scale, number of points) is
checked against what it holds: a truncated or damaged file is refused, never read in part.
"""

from __future__ import annotations

import csv
import re
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from brdfpipe import columns
from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


FORMATS: Mapping[str, tuple[str, ...]] = {
    "text": columns.TEXT_SUFFIXES,
    "perkinelmer": (".asc",),
    "qtx": (".qtx",),
    "cxf": (".cxf",),
    "jcamp": (".dx", ".jcamp", ".jcm", ".jdx"),
    "cgats": (".cgats", ".ti3"),
    "excel": (".xlsm", ".xlsx"),
}
"""Formats of spectrum files and the extensions that mean them."""
SUFFIXES = tuple(sorted(suffix for suffixes in FORMATS.values() for suffix in suffixes))

PERCENT = "reflectance in percent"
FRACTION = "reflectance as a fraction"
_SILENT = "reflectance"
_UNPACKED = 2**28
_CXF_END = 850.0
_CXF_STARTS = (360.0, 400.0)
_SHOWN = 10
_USUAL_STEPS = (1.0, 2.0, 5.0, 10.0, 20.0)
_USUAL_ENDS = (700.0, 730.0, 740.0, 750.0, 780.0, 830.0, 850.0)
"""Where spectra of colour instruments end [nm]."""


class Sample(NamedTuple):
    """One spectrum of a container."""

    name: str
    wavelength: Array
    """nm, or µm where ``unit`` says so; in any order"""
    values: Array
    header: tuple[str, ...] = ()
    """What the file says about it: scale, specular component, directions."""
    unit: str = "nm"
    """nm, um, or nothing where the file is silent"""
    doubts: tuple[str, ...] = ()
    """What looks lost or damaged, in words"""


def read(path: Path, form: str | None = None, sample: int | str | None = None) -> Columns:
    """Read one spectrum from a file of any known format.

    Parameters
    ----------
    path : see :data:`FORMATS`
    form : a key of :data:`FORMATS`; by default the extension tells
    sample : number (from 1) or name, where the file holds several

    Returns
    -------
    Columns : of a table of columns all of them; else wavelength and reflectance of the one sample

    Raises
    ------
    InputError : unknown format, damaged or truncated content, several samples and none chosen.
    """
    form = _format(path, form)
    if form == "text":
        text, notes = columns.read_text(path)
        rows = _wide_rows(text)
        found: Columns | list[Sample] = columns.parse_columns(text, path, notes) if rows is None else _wide(path, *rows)
    elif form == "excel":
        found, notes = _excel(path)
    else:
        text, notes = columns.read_text(path)
        found = _READERS[form](path, text)
    if isinstance(found, Columns):
        if sample is not None:
            raise InputError(
                path,
                "holds columns, not samples",
                found=f"sample {sample!r}"[:60],
                accepted="a column by name or number",
                key="spectrum.column",
            )
        return found
    return _one(path, found, sample, notes)


def _format(path: Path, form: str | None) -> str:
    if form is not None:
        if form not in FORMATS:
            raise InputError(
                path, "unknown format", found=repr(form)[:40], accepted=", ".join(FORMATS), key="spectrum.format"
            )
        return form
    for name, suffixes in FORMATS.items():
        if path.suffix.lower() in suffixes:
            return name
    raise InputError(
        path,
        "this kind of spectrum file is not read",
        found=path.suffix or "no extension",
        accepted=f"{', '.join(SUFFIXES)}, or a format named; export the spectrum as text",
        key="spectrum.format",
    )


def _one(path: Path, samples: Sequence[Sample], sample: int | str | None, notes: Sequence[str]) -> Columns:
    names = [each.name for each in samples]
    if not samples:
        raise InputError(path, "holds no reflectance spectrum", key="spectrum.file")
    if sample is None and len(samples) == 1:
        place = 0
    elif isinstance(sample, int) and not isinstance(sample, bool) and 1 <= sample <= len(samples):
        place = sample - 1
    else:
        wanted = sample.strip().casefold() if isinstance(sample, str) else None
        matching = [i for i, name in enumerate(names) if name.strip().casefold() == wanted]
        if len(matching) != 1:
            shown = ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
            several = len(samples) > 1
            unclear = (
                f"holds {len(samples)} samples; which one is meant" if several else "holds one sample, and not this"
            )
            raise InputError(
                path,
                unclear if not matching else "the name is not unique",
                found=None if sample is None else repr(sample)[:60],
                accepted=f"1 to {len(samples)}, or one of {shown}" if several else f"1 or {shown}, or no key at all",
                key="spectrum.sample",
            )
        place = matching[0]
    chosen = samples[place]
    if len(samples) > 1:
        notes = [*notes, f"sample {place + 1} of {len(samples)} was read ({chosen.name[:60]})"]
    values = np.column_stack([chosen.wavelength, chosen.values])
    title = {"nm": "wavelength [nm]", "um": "wavelength [µm]"}.get(chosen.unit, "wavelength")
    lines = np.zeros(len(values), dtype=np.int64)
    return Columns(path.name, chosen.header, (title, _SILENT), values, lines, tuple(notes), chosen.doubts)


# Text and spreadsheets with one row a sample


_LABEL = re.compile(r"[A-Za-zλ%_\s]{0,12}[\s_(\[]?(\d{3,5}(?:\.\d+)?|\d?\.\d{2,5})\s*(?:nm|[µμu]m)?[)\]]?", re.ASCII)
_FEWEST_LABELS = 7


def _wide_rows(text: str) -> tuple[list[str], list[tuple[int, list[str]]], str] | None:
    """Words above, then header and rows of a table whose header is wavelengths; None if it is no such table."""
    lines = re.split(r"\r\n|\r|\n", text)
    for place, line in enumerate(lines):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        separator = next((mark for mark in ";\t," if mark in line), None)
        if separator is None:
            continue
        if len(_labels(next(csv.reader([line], delimiter=separator), []))) >= _FEWEST_LABELS:
            above = [re.sub(r"^[#!*;/]+\s*", "", each) for each in lines[:place] if each.strip()]
            if any(_is_row(each, separator) for each in above):
                return None
            reader = csv.reader(lines[place:], delimiter=separator)
            try:
                rows = [(place + reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
            except csv.Error:
                return None
            return above, rows, "." if separator == "," else ","
        if columns.number(re.split(r"[;\t,\s]", line.strip())[0]) is not None:
            return None
    return None


def _is_row(line: str, separator: str) -> bool:
    """Whether most cells of a line are numbers: values above the header of wavelengths, which nothing names."""
    values = [columns.number(cell, "," if separator == ";" else ".") for cell in line.split(separator)]
    return len(values) > _FEWEST_LABELS and sum(value is not None for value in values) > len(values) / 2


def _labels(cells: Sequence[str]) -> dict[int, float]:
    """Position → wavelength of the cells that name one; nothing unless they rise or fall throughout after at least one word."""
    found = {i: _LABEL.fullmatch(cell.strip()) for i, cell in enumerate(cells)}
    labels = {i: float(match.group(1)) for i, match in found.items() if match}
    if not labels or 0 in labels:
        return {}
    steps = np.diff(list(labels.values()))
    return labels if (steps > 0).all() or (steps < 0).all() else {}


def _wide(path: Path, above: Sequence[str], rows: Sequence[tuple[int, list[str]]], decimal: str) -> list[Sample]:
    header = rows[0][1]
    labels = _labels(header)
    stated = "nm" if any("nm" in header[i] for i in labels) else ""
    if decimal == "," and not any("," in row[i] for _, row in rows[1:] for i in labels if i < len(row)):
        decimal = "."
    samples = []
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(
                path,
                "rows of unequal length",
                where=f"line {line}",
                found=f"{len(row)} cells",
                accepted=f"{len(header)} cells, as in the header",
            )
        cells = [row[i] for i in labels]
        wavelength = np.array(list(labels.values()))
        values = _numbers(path, f"line {line}", cells, decimal)
        samples.append(Sample(row[0].strip(), wavelength, values, tuple(above), stated, _cut(cells, wavelength)))
    return samples


def _excel(path: Path) -> tuple[Columns | list[Sample], list[str]]:
    rows, notes = _sheet(path)
    text = "\n".join("\t".join(row) for row in rows)
    wide = _wide_rows(text)
    if wide is not None:
        return _wide(path, wide[0], wide[1], "."), notes
    return columns.parse_columns(text, path, notes), notes


def _sheet(path: Path) -> tuple[list[list[str]], list[str]]:
    """Cells of the first sheet as words and numbers with a decimal point; per cent as it is shown."""
    try:
        import openpyxl  # type: ignore[import-untyped]
    except ImportError as error:
        raise InputError(
            path, "Excel files need one more package", accepted="pip install 'brdfpipe[excel]', or export as text"
        ) from error
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > _UNPACKED:
                raise InputError(path, "too large when unpacked", accepted=f"up to {_UNPACKED >> 20} MiB")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                sheet = book.worksheets[0]
                cells = [
                    [(cell.value, getattr(cell, "number_format", "")) for cell in row] for row in sheet.iter_rows()
                ]
                titles = [each.title for each in book.worksheets]
            finally:
                book.close()
    except InputError:
        raise
    except Exception as error:  # a damaged workbook raises whatever zipfile, the XML parser or openpyxl stumbles over
        raise InputError(path, "damaged, or no Excel workbook", accepted="a workbook saved as .xlsx") from error
    notes = [] if len(titles) == 1 else [f"the first of {len(titles)} sheets was read ({titles[0][:40]})"]
    shown = any(_is_share(value, form) for row in cells for value, form in row)
    rows = [[_cell(value, form) for value, form in row] for row in cells]
    while rows and all(row and not row[-1] for row in rows):
        rows = [row[:-1] for row in rows]
    if shown:
        notes.append("cells shown as percentages were read as shown")
        rows.insert(0, [f"# {PERCENT}"])
    return rows, notes


def _is_share(value: Any, form: str) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and "%" in form


def _cell(value: Any, form: str) -> str:
    if _is_share(value, form):
        return repr(round(float(value) * 100, 12))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(value)
    return "" if value is None else " ".join(str(value).split())


# Instruments and the colour trade


def _perkinelmer(path: Path, text: str) -> list[Sample]:
    lines = [line.strip() for line in re.split(r"\r\n|\r|\n", text)]
    if "#DATA" not in lines or "#GR" not in lines or not lines[0].startswith("PE "):
        raise InputError(
            path, "no PerkinElmer ASCII file", accepted="PE … in line 1, then #GR and #DATA", key="spectrum.format"
        )
    start, graph = lines.index("#DATA") + 1, lines.index("#GR") + 1
    stated = [*lines[graph : start - 1], "", "", "", "", "", "", ""]
    x_unit, y_unit = stated[0], stated[1]
    if x_unit.casefold() != "nm" or y_unit.replace(" ", "").casefold() not in ("%r", "r"):
        raise InputError(
            path,
            "is no reflectance over nm",
            where="#GR",
            found=f"{x_unit!r}, {y_unit!r}"[:60],
            accepted="nm and %R or R",
        )
    rows = [_row(path, line, place) for place, line in enumerate(lines[start:], start=start + 1) if line]
    points = _stated_number(path, "number of points", stated[6])
    if len(rows) != points:
        raise _truncated(path, len(rows), points)
    cells = list(zip(*rows, strict=True)) or [(), ()]
    wavelength, values = (_numbers(path, "#DATA", column) for column in cells)
    scale, offset = (_stated_number(path, word, cell) for word, cell in (("factor", stated[2]), ("offset", stated[3])))
    if scale != 1 or offset != 0:
        raise InputError(path, "a factor other than 1", where="#GR", found=f"{scale:g}, {offset:g}", accepted="1 and 0")
    first, step = (_stated_number(path, what, cell) for what, cell in (("first nm", stated[4]), ("step", stated[5])))
    doubts = _cut(cells[1], wavelength)
    if wavelength.size and np.abs(wavelength - _grid(first, step, wavelength.size)).max() > 0.5 * abs(step):
        doubts += (f"the header states wavelengths from {first:g} nm by {step:g} nm. Look for mistyped or lost ones",)
    return [Sample(lines[2], wavelength, values, (PERCENT if "%" in y_unit else FRACTION,), doubts=doubts)]


_QTX_GRID = ("REFLLOW", "REFLINTERVAL", "REFLPOINTS")


def _qtx(path: Path, text: str) -> list[Sample]:
    sections: list[dict[str, str]] = []
    last = ""
    for place, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        line = line.strip()
        if line.startswith("["):
            sections.append({})
            last = ""
        elif "=" in line and sections:
            last, _, value = line.partition("=")
            last = re.sub("^(?:STD|BAT)_", "", last.strip().upper())
            if last in ("NAME", "VIEWING", "R", *_QTX_GRID) and last in sections[-1]:
                raise InputError(path, f"damaged: {last} stands twice in a section", where=f"line {place}")
            sections[-1][last] = value.strip()
        elif line and sections and last == "R":
            sections[-1][last] += line
        elif line:
            raise InputError(path, "neither a section nor a key", where=f"line {place}", found=repr(line)[:60])
    samples = []
    for place, section in enumerate(sections, start=1):
        if "R" not in section and "REFLPOINTS" not in section:
            continue
        cells = [cell for cell in re.split(r"[,\s]+", section.get("R", "")) if cell]
        low, step, points = (_stated_number(path, key, section.get(key, "").rstrip(", ")) for key in _QTX_GRID)
        if len(cells) != points:
            raise _truncated(path, len(cells), points)
        wavelength, values = _grid(low, step, len(cells)), _numbers(path, f"section {place}", cells)
        viewing = (f"viewing {section['VIEWING']}",) if "VIEWING" in section else ()
        name = section.get("NAME", f"sample {place}")
        doubts = (*_unusual_end(wavelength, step), *_cut(cells, wavelength))
        samples.append(Sample(name, wavelength, values, (PERCENT, *viewing), doubts=doubts))
    return samples


def _cgats(path: Path, text: str) -> list[Sample]:
    samples: list[Sample] = []
    keywords: dict[str, str] = {}
    fields: list[str] = []
    data: list[str] = []
    into: list[str] | None = None
    for line in re.split(r"\r\n|\r|\n", text):
        tokens = [token.strip('"') for token in re.findall(r'"[^"]*"|[^\s"]+', re.sub(r"^\s*#.*", "", line))]
        head = tokens[0].upper() if tokens else ""
        if head in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            into = fields if head == "BEGIN_DATA_FORMAT" else data
            into.clear()
        elif head in ("END_DATA_FORMAT", "END_DATA"):
            into = None
            if head == "END_DATA":
                samples += _cgats_table(path, keywords, fields, data)
        elif into is not None:
            into += tokens
        elif len(tokens) > 1:
            keywords[head] = tokens[1]
    if into is not None:
        raise InputError(path, "truncated: a block does not end", accepted="END_DATA")
    return samples


_BAND = re.compile(r"(?:SPEC|SPECTRAL|SPECTRAL_NM|NM|R)_?(\d{3,4}(?:\.\d+)?)", re.IGNORECASE)


def _cgats_table(path: Path, keywords: Mapping[str, str], fields: Sequence[str], data: Sequence[str]) -> list[Sample]:
    bands = {i: float(match.group(1)) for i, name in enumerate(fields) if (match := _BAND.fullmatch(name))}
    if not bands:
        return []
    if keywords.get("DEVICE_CLASS", "").upper() == "DISPLAY":
        raise InputError(path, "is no reflectance", found="DEVICE_CLASS DISPLAY", accepted="reflectance of a print")
    sets = _stated_number(path, "NUMBER_OF_SETS", keywords.get("NUMBER_OF_SETS", ""))
    if len(data) != sets * len(fields):
        raise _truncated(path, len(data), sets * len(fields))
    wavelength = np.array(list(bands.values()))
    if "SPECTRAL_BANDS" in keywords:
        low, high, count = (
            _stated_number(path, key, keywords.get(key, ""))
            for key in ("SPECTRAL_START_NM", "SPECTRAL_END_NM", "SPECTRAL_BANDS")
        )
        exact = np.linspace(low, high, len(bands))
        # Names are rounded to nm.
        if count != len(bands) or (np.abs(exact - wavelength) > 0.51).any():
            raise InputError(
                path,
                "the bands are not those of the header",
                found=f"{len(bands)} from {wavelength[0]:g} to {wavelength[-1]:g} nm",
                accepted=f"{count:g} from {low:g} to {high:g} nm",
            )
        wavelength = exact
    norm = keywords.get("SPECTRAL_NORM")
    stated = {100.0: PERCENT, 1.0: FRACTION}.get(_stated_number(path, "SPECTRAL_NORM", norm)) if norm else _SILENT
    if stated is None:
        raise InputError(path, "an unknown scale", where="SPECTRAL_NORM", found=repr(norm)[:40], accepted="1 or 100")
    names = [fields.index(name) for name in ("SAMPLE_NAME", "SAMPLE_ID", "SAMPLE_LOC") if name in fields]
    rows = [data[start : start + len(fields)] for start in range(0, len(data), len(fields))]
    samples = []
    for place, row in enumerate(rows, start=1):
        cells = [row[i] for i in bands]
        name, values = row[names[0]] if names else str(place), _numbers(path, f"set {place}", cells)
        samples.append(Sample(name, wavelength, values, (stated,), doubts=_cut(cells, wavelength)))
    return samples


def _cxf(path: Path, text: str) -> list[Sample]:
    root = _xml(path, text)
    found = root.findall(".//{*}ColorSpecification")
    specifications = {each.get("Id", ""): _cxf_specification(each) for each in found}
    samples, owners = [], []
    for place, item in enumerate(root.findall(".//{*}Object"), start=1):
        name = item.get("Name", f"object {place}")
        for spectrum in item.findall(".//{*}ReflectanceSpectrum"):
            owners.append(spectrum.get("ColorSpecification", ""))
            samples.append(_cxf_sample(path, name, spectrum, specifications.get(owners[-1], _Specification())))
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
    """What a ColorSpecification says of the spectra that refer to it."""

    start: str | None = None
    step: str | None = None
    quantity: str = ""
    header: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def _cxf_specification(element: Element) -> _Specification:
    quantity = (element.findtext(".//{*}MeasurementType") or "").strip()
    span = element.find(".//{*}WavelengthRange")
    start, step = (None, None) if span is None else (span.get("StartWL"), span.get("Increment"))
    sphere = (element.findtext(".//{*}SphereGeometry") or "").strip()
    single = element.find(".//{*}SingleAngle")
    if sphere in _CXF_SPHERES:
        return _Specification(start, step, quantity, (_CXF_SPHERES[sphere],))
    if single is not None:
        light, view = (columns.number(single.findtext(f"{{*}}{key}") or "") for key in _CXF_DIRECTIONS)
        if light is not None and view is not None and abs(abs(light) - abs(view)) > _CXF_GLOSS:
            angles = f"SingleAngle {abs(light):g}/{abs(view):g}"
            return _Specification(
                start, step, quantity, (f"{angles}: light from {abs(light):g} degree, specular excluded",)
            )
    several = element.find(".//{*}MultiAngle") is not None
    doubts = ("it was measured at several angles: one of them is no total reflectance. Use `multiangle`",)
    return _Specification(start, step, quantity, doubts=doubts if several else ())


_CXF_SPHERES = {"Specular_Included": "specular included", "Specular_Excluded": "specular excluded"}
_CXF_DIRECTIONS = ("IlluminationAngle", "MeasurementAngle")
_CXF_GLOSS = 10.0
"""Angles of light and view that are closer [degree] may hold the mirror direction."""


def _cxf_sample(path: Path, name: str, spectrum: Element, said: _Specification) -> Sample:
    if "Transmittance" in said.quantity or "Emissive" in said.quantity:
        found, accepted = said.quantity[:40], "Spectrum_Reflectance"
        raise InputError(
            path, "is no reflectance", where=f"MeasurementType of {name[:40]}", found=found, accepted=accepted
        )
    low, step = (
        _agreed(path, name, key, spectrum.get(key), stated)
        for key, stated in (("StartWL", said.start), ("Increment", said.step))
    )
    cells = (spectrum.text or "").split()
    values, wavelength = _numbers(path, name[:40], cells), _grid(low, step, len(cells))
    if low + step * (values.size - 1) > _CXF_END:
        raise InputError(
            path,
            "damaged: more values than a colour instrument measures",
            where=name[:40],
            found=f"{values.size} values from {low:g} nm by {step:g} nm",
            accepted=f"values up to {_CXF_END:g} nm",
        )
    doubts = (*said.doubts, *_unusual_end(wavelength, step), *_cut(cells, wavelength))
    if not _CXF_STARTS[0] <= low <= _CXF_STARTS[1]:
        doubts += (f"StartWL is {low:g} nm; CxF3 allows 360 to 400. Compare it with the instrument",)
    return Sample(name, wavelength, values, (FRACTION, *said.header), doubts=doubts)


def _agreed(path: Path, name: str, key: str, own: str | None, shared: str | None) -> float:
    """A number that a spectrum, its specification or both of them state."""
    value = _stated_number(path, f"{key} of {name[:40]}", own or shared or "")
    if own and shared and value != columns.number(shared):
        raise InputError(
            path,
            f"damaged: two values of {key}",
            where=name[:40],
            found=f"{value:g} and {shared[:20]} nm",
            accepted=f"one {key}",
        )
    return value


def _unlike(size: int, sizes: Sequence[int]) -> list[str]:
    """Where a container states no number of values, its other spectra of the same specification tell."""
    if 2 * sizes.count(size) > len(sizes):
        return []
    others = ", ".join(str(other) for other in sorted({*sizes} - {size}))
    return [f"it has {size} values, others of the file {others}. Look for lost or added values"]


def _jcamp(path: Path, text: str) -> list[Sample]:
    from brdfpipe.spectra import jcamp

    samples = []
    for title, x_unit, y_unit, wavelength, values, doubts in jcamp.blocks(path, text):
        unit = {"NANOMETERS": "nm", "NM": "nm", "MICROMETERS": "um", "MICRONS": "um", "UM": "um"}.get(x_unit)
        if unit is None or "REFL" not in y_unit or "LOG" in y_unit:
            raise InputError(
                path,
                "is no reflectance over wavelength",
                where=title[:40],
                found=f"XUNITS {x_unit[:20]}, YUNITS {y_unit[:20]}",
                accepted="NANOMETERS or MICROMETERS, REFLECTANCE",
            )
        scale = PERCENT if "%" in y_unit or "PERCENT" in y_unit else FRACTION
        samples.append(Sample(title, wavelength, values, (scale,), unit, doubts))
    return samples


_READERS: Mapping[str, Callable[[Path, str], list[Sample]]] = {
    "perkinelmer": _perkinelmer,
    "qtx": _qtx,
    "cxf": _cxf,
    "jcamp": _jcamp,
    "cgats": _cgats,
}


def _grid(low: float, step: float, count: int) -> Array:
    grid: Array = low + step * np.arange(count, dtype=float)
    return grid


def _unusual_end(wavelength: Array, step: float) -> tuple[str, ...]:
    """A doubt where a container states start and step, and the end that follows is that of no usual instrument."""
    if not wavelength.size or (step in _USUAL_STEPS and wavelength[-1] in _USUAL_ENDS):
        return ()
    return (
        f"{wavelength.size} values from {wavelength[0]:g} nm by {step:g} nm end at {wavelength[-1]:g} nm, where few "
        "instruments do, and the file states no end. Look for lost or added values, or compare step and end with the instrument",
    )


def _cut(cells: Sequence[str], wavelength: Array) -> tuple[str, ...]:
    return tuple(columns.cut_numbers(cells, lambda i: f"at {wavelength[i]:g} nm"))


def _row(path: Path, line: str, place: int) -> tuple[str, str]:
    cells = line.split()
    if len(cells) != 2:
        raise InputError(path, "not two columns", where=f"line {place}", found=repr(line)[:60])
    _numbers(path, f"line {place}", cells)
    return cells[0], cells[1]


def _numbers(path: Path, where: str, cells: Sequence[str], decimal: str = ".") -> Array:
    values = [columns.number(cell, decimal) for cell in cells]
    if None in values:
        raise InputError(path, "not a number", where=where, found=repr(cells[values.index(None)])[:60])
    return np.array(values, dtype=float)


def _stated_number(path: Path, what: str, text: str) -> float:
    value = columns.number(text) if text else None
    if value is None or not np.isfinite(value):
        raise InputError(path, f"does not state its {what}", found=repr(text)[:40], accepted="a number")
    return value


def _truncated(path: Path, found: int, stated: float) -> InputError:
    return InputError(path, "truncated or damaged", found=f"{found} values", accepted=f"{stated:g}, as the file states")

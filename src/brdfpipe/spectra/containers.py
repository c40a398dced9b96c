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
_SHOWN = 10


class Sample(NamedTuple):
    """One spectrum of a container."""

    name: str
    wavelength: Array
    """nm, or µm where ``unit`` says so; in any order"""
    values: Array
    header: tuple[str, ...] = ()
    """What the file says about it: scale, specular component."""
    unit: str = "nm"
    """nm, um, or nothing where the file is silent"""


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
            raise InputError(
                path,
                f"holds {len(samples)} samples; which one is meant" if len(matching) == 0 else "the name is not unique",
                found=None if sample is None else repr(sample)[:60],
                accepted=f"1 to {len(samples)}, or one of {shown}",
                key="spectrum.sample",
            )
        place = matching[0]
    chosen = samples[place]
    if len(samples) > 1:
        notes = [*notes, f"sample {place + 1} of {len(samples)} was read ({chosen.name[:60]})"]
    values = np.column_stack([chosen.wavelength, chosen.values])
    title = {"nm": "wavelength [nm]", "um": "wavelength [µm]"}.get(chosen.unit, "wavelength")
    return Columns(
        path.name, chosen.header, (title, _SILENT), values, np.zeros(len(values), dtype=np.int64), tuple(notes)
    )


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
            reader = csv.reader(lines[place:], delimiter=separator)
            try:
                rows = [(place + reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
            except csv.Error:
                return None
            return above, rows, "." if separator == "," else ","
        if columns.number(re.split(r"[;\t,\s]", line.strip())[0]) is not None:
            return None
    return None


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
        values = [columns.number(row[i], decimal) for i in labels]
        if None in values:
            wrong = row[list(labels)[values.index(None)]]
            raise InputError(path, "not a number", where=f"line {line}", found=repr(wrong)[:60])
        wavelength = np.array(list(labels.values()))
        samples.append(Sample(row[0].strip(), wavelength, np.array(values, dtype=float), tuple(above), stated))
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
    table = np.array(rows, dtype=float).reshape(-1, 2)
    scale, offset = (_stated_number(path, word, cell) for word, cell in (("factor", stated[2]), ("offset", stated[3])))
    if scale != 1 or offset != 0:
        raise InputError(path, "a factor other than 1", where="#GR", found=f"{scale:g}, {offset:g}", accepted="1 and 0")
    return [Sample(lines[2], table[:, 0], table[:, 1], (PERCENT if "%" in y_unit else FRACTION,))]


def _qtx(path: Path, text: str) -> list[Sample]:
    sections: list[dict[str, str]] = []
    last = ""
    for place, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        line = line.strip()
        if line.startswith("["):
            sections.append({})
        elif "=" in line and sections:
            last, _, value = line.partition("=")
            last = re.sub("^(?:STD|BAT)_", "", last.strip().upper())
            sections[-1][last] = value.strip()
        elif line and sections and last == "R":
            sections[-1][last] += line
        elif line:
            raise InputError(path, "neither a section nor a key", where=f"line {place}", found=repr(line)[:60])
    samples = []
    for place, section in enumerate(sections, start=1):
        if "R" not in section:
            continue
        cells = [cell for cell in re.split(r"[,\s]+", section["R"]) if cell]
        low, step, points = (
            _stated_number(path, key, section.get(key, "").rstrip(", "))
            for key in ("REFLLOW", "REFLINTERVAL", "REFLPOINTS")
        )
        if len(cells) != points:
            raise _truncated(path, len(cells), points)
        values = _numbers(path, f"section {place}", cells)
        viewing = (f"viewing {section['VIEWING']}",) if "VIEWING" in section else ()
        name = section.get("NAME", f"sample {place}")
        samples.append(Sample(name, _grid(low, step, len(cells)), values, (PERCENT, *viewing)))
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
    stated = (
        {100.0: PERCENT, 1.0: FRACTION}.get(_stated_number(path, "SPECTRAL_NORM", norm), _SILENT) if norm else _SILENT
    )
    names = [fields.index(name) for name in ("SAMPLE_NAME", "SAMPLE_ID", "SAMPLE_LOC") if name in fields]
    rows = [data[start : start + len(fields)] for start in range(0, len(data), len(fields))]
    return [
        Sample(
            row[names[0]] if names else str(place),
            wavelength,
            _numbers(path, f"set {place}", [row[i] for i in bands]),
            (stated,),
        )
        for place, row in enumerate(rows, start=1)
    ]


def _cxf(path: Path, text: str) -> list[Sample]:
    import defusedxml
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        # The declaration names the encoding of bytes that are decoded already.
        root: Element = fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text), forbid_dtd=True)
    except defusedxml.DefusedXmlException as error:
        raise InputError(path, "XML with a document type or entities", accepted="plain CxF3") from error
    except (ParseError, RecursionError, ValueError) as error:
        raise InputError(path, "damaged XML", found=str(error)[:80], accepted="CxF3") from error
    grids: dict[str, tuple[str | None, str | None]] = {}
    for specification in root.findall(".//{*}ColorSpecification"):
        span = specification.find(".//{*}WavelengthRange")
        if span is not None:
            grids[specification.get("Id", "")] = (span.get("StartWL"), span.get("Increment"))
    samples = []
    for place, item in enumerate(root.findall(".//{*}Object"), start=1):
        name = item.get("Name", f"object {place}")
        for spectrum in item.findall(".//{*}ReflectanceSpectrum"):
            start, step = grids.get(spectrum.get("ColorSpecification", ""), (None, None))
            low = _stated_number(path, f"StartWL of {name[:40]}", spectrum.get("StartWL") or start or "")
            width = _stated_number(path, f"Increment of {name[:40]}", spectrum.get("Increment") or step or "")
            if start is not None and low != columns.number(start):
                raise InputError(
                    path,
                    "damaged: two first wavelengths",
                    where=name[:40],
                    found=f"{low:g} and {start[:20]} nm",
                    accepted="one StartWL",
                )
            values = _numbers(path, name[:40], (spectrum.text or "").split())
            if low + width * (values.size - 1) > _CXF_END:
                # The container states no number of values: a repeated block shows by where it would end.
                raise InputError(
                    path,
                    "damaged: more values than a colour instrument measures",
                    where=name[:40],
                    found=f"{values.size} values from {low:g} nm by {width:g} nm",
                    accepted=f"values up to {_CXF_END:g} nm",
                )
            samples.append(Sample(name, _grid(low, width, values.size), values, (FRACTION,)))
    return samples


def _jcamp(path: Path, text: str) -> list[Sample]:
    from brdfpipe.spectra import jcamp

    samples = []
    for title, x_unit, y_unit, wavelength, values in jcamp.blocks(path, text):
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
        samples.append(Sample(title, wavelength, values, (scale,), unit))
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


def _row(path: Path, line: str, place: int) -> list[float]:
    cells = line.split()
    if len(cells) != 2:
        raise InputError(path, "not two columns", where=f"line {place}", found=repr(line)[:60])
    return [float(value) for value in _numbers(path, f"line {place}", cells)]


def _numbers(path: Path, where: str, cells: Sequence[str]) -> Array:
    values = [columns.number(cell) for cell in cells]
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

"""Tables of CGATS.17 (ANSI CGATS, Argyll .ti3) with spectral fields."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base
from brdfpipe.spectra.specular_words import spoken

_BAND = re.compile(r"(?:SPEC|SPECTRAL|SPECTRAL_NM|NM|R)_?(\d{3,4}(?:\.\d+)?)", re.IGNORECASE)

_VALUE = re.compile(r"(?:LAB|XYZ|RGB|CMYK|DENSITY|STDEV|LCH)_", re.IGNORECASE)
"""Fields of other values, which do not describe a sample."""


def _samples(path: Path, text: str) -> list[base.Sample]:
    samples: list[base.Sample] = []
    keywords: dict[str, str] = {}
    fields: list[str] = []
    data: list[str] = []
    block: list[str] | None = None
    for line in base.lines_of(text):
        tokens = [token.strip('"') for token in re.findall(r'"[^"]*"|[^\s"]+', re.sub(r"^\s*#.*", "", line))]
        head = tokens[0].upper() if tokens else ""
        if head in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            block = fields if head == "BEGIN_DATA_FORMAT" else data
            block.clear()
        elif head in ("END_DATA_FORMAT", "END_DATA"):
            block = None
            if head == "END_DATA":
                samples += _table_samples(path, keywords, fields, data)
        elif block is not None:
            block += tokens
        elif len(tokens) > 1:
            keywords[head] = tokens[1]
    if block is not None:
        raise InputError(path, "truncated: a block does not end", accepted="END_DATA")
    return samples


def _table_samples(
    path: Path, keywords: Mapping[str, str], fields: Sequence[str], data: Sequence[str]
) -> list[base.Sample]:
    bands = {i: float(match.group(1)) for i, name in enumerate(fields) if (match := _BAND.fullmatch(name))}
    if not bands:
        return []
    if keywords.get("DEVICE_CLASS", "").upper() == "DISPLAY":
        raise InputError(path, "not a reflectance", found="DEVICE_CLASS DISPLAY", accepted="reflectance of a print")
    sets = base.stated_number(path, "NUMBER_OF_SETS", keywords.get("NUMBER_OF_SETS", ""))
    base.check_count(path, len(data), sets * len(fields))
    if "NUMBER_OF_FIELDS" in keywords:
        base.check_count(path, len(fields), base.stated_number(path, "NUMBER_OF_FIELDS", keywords["NUMBER_OF_FIELDS"]))
    wavelength = np.array(list(bands.values()))
    if "SPECTRAL_BANDS" in keywords:
        low, high, count = (
            base.stated_number(path, key, keywords.get(key, ""))
            for key in ("SPECTRAL_START_NM", "SPECTRAL_END_NM", "SPECTRAL_BANDS")
        )
        exact = np.linspace(low, high, len(bands))
        # Names are rounded to nm.
        if count != len(bands) or (np.abs(exact - wavelength) > 0.51).any():
            raise InputError(
                path,
                "the bands contradict the header",
                found=f"{len(bands)} from {wavelength[0]:g} to {wavelength[-1]:g} nm",
                accepted=f"{count:g} from {low:g} to {high:g} nm",
            )
        wavelength = exact
    norm = keywords.get("SPECTRAL_NORM")
    largest = base.stated_number(path, "SPECTRAL_NORM", norm) if norm else None
    scale = {100.0: base.PERCENT, 1.0: base.FRACTION, None: base.UNSCALED}.get(largest)
    if scale is None:
        raise InputError(path, "unknown scale", where="SPECTRAL_NORM", found=repr(norm)[:40], accepted="1 or 100")
    header = (scale, *spoken(f"{key}: {value}" for key, value in keywords.items()))
    names = [fields.index(name) for name in ("SAMPLE_NAME", "SAMPLE_ID", "SAMPLE_LOC") if name in fields]
    samples = []
    for number, start in enumerate(range(0, len(data), len(fields)), start=1):
        row = data[start : start + len(fields)]
        name, cells = row[names[0]] if names else str(number), [row[i] for i in bands]
        labels = tuple(
            (fields[i], row[i]) for i in range(len(fields)) if i not in bands and not _VALUE.match(fields[i])
        )
        samples.append(base.parsed_sample(path, f"set {number}", name, wavelength, cells, header, labels=labels))
    return samples


FORMAT = base.SpectrumFormat(
    "cgats",
    (".cgats", ".ti3"),
    "spectral fields of CGATS tables",
    base.from_text(_samples),
    tried="colorchecker_cyan.ti3, made",
)

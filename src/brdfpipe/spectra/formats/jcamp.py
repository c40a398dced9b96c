"""JCAMP-DX: spectra and their tables, plain and in the compressed forms of the standard.

References
----------
McDonald & Wilks, "JCAMP-DX: a standard form for exchange of infrared spectra", Appl. Spectrosc. 42 (1988) 151; version 4.24.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.spectra.formats import base
from brdfpipe.spectra.specular_words import spoken

Block = tuple[str, str, str, Array, Array, tuple[str, ...]]

_SIGNED_DIGITS = [*"0123456789", *(f"-{digit}" for digit in range(1, 10))]
_SQUEEZED = dict(zip("@ABCDEFGHIabcdefghi", _SIGNED_DIGITS, strict=True))
_DIFFERENCE = dict(zip("%JKLMNOPQRjklmnopqr", _SIGNED_DIGITS, strict=True))
_DUPLICATE = {c: i + 1 for i, c in enumerate("STUVWXYZs")}

_PLAIN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_PACKED = re.compile(r"[@A-Ia-i%J-Rj-rS-Zs]\d*(?:\.\d+)?|[+-]?(?:\d+\.?\d*|\.\d+)", re.ASCII)
_MOST = 2**20


def blocks(path: Path, text: str) -> list[Block]:
    """All tables of a file: title, units of X and Y (upper case), X, Y, and doubts in words.

    Raises InputError: no table, an unsupported form, or a table that contradicts its header (number of points, first and last X) or its
    check values.
    """
    tables = [_table(path, record) for record in _records(text) if _form(record)]
    if not tables:
        accepted = "##XYDATA=(X++(Y..Y)) or ##XYPOINTS=(XY..XY)"
        raise InputError(path, "no JCAMP-DX table in the file", accepted=accepted, key="spectrum.format")
    return tables


def _records(text: str) -> Iterator[dict[str, str]]:
    """Labels and their text, block by block; labels without blanks, dashes, slashes and underscores."""
    lines = [re.sub(r"\$\$.*", "", line) for line in base.lines_of(text)]
    record: dict[str, str] = {}
    for part in re.split(r"^\s*##", "\n".join(lines), flags=re.MULTILINE)[1:]:
        label, _, value = part.partition("=")
        label = re.sub(r"[\s\-/_]", "", label).upper()
        if label == "END" or (label == "TITLE" and record):
            yield record
            record = {}
        if label != "END":
            record[label] = value.strip()
    if record:
        # The last ##END= is missing, and perhaps more.
        yield {**record, "UNENDED": ""}


def _form(record: Mapping[str, str]) -> str:
    return next((label for label in ("XYDATA", "XYPOINTS") if label in record), "")


def _table(path: Path, record: Mapping[str, str]) -> Block:
    title, label = record.get("TITLE", "")[:80], _form(record)
    head, _, body = record[label].partition("\n")
    form = re.sub(r"\s", "", head).upper()
    if "UNENDED" in record:
        raise InputError(path, "truncated: ##END= is missing", where=title[:40] or None)
    if form not in {"XYDATA": ("(X++(Y..Y))",), "XYPOINTS": ("(XY..XY)",)}[label]:
        raise InputError(path, "unsupported form of table", found=form[:40], accepted="(X++(Y..Y)) or (XY..XY)")
    factors = [_number(path, record, key, 1.0) for key in ("XFACTOR", "YFACTOR")]
    if min(factors) <= 0:
        raise InputError(path, "damaged: XFACTOR or YFACTOR not above 0", found=f"{factors}")
    points = _number(path, record, "NPOINTS", np.nan)
    if label == "XYPOINTS":
        x, y = _pairs(path, body)
        x = x * factors[0]
    else:
        x, y = _ordinates(path, record, body, factors[0])
    y = y * factors[1]
    first, last = _number(path, record, "FIRSTX", x[0]), _number(path, record, "LASTX", x[-1])
    if (np.isfinite(points) and points != y.size) or not np.allclose([x[0], x[-1]], [first, last], rtol=1e-4):
        raise InputError(
            path,
            "truncated or damaged: the table contradicts its header",
            found=f"{y.size} points from {x[0]:g} to {x[-1]:g}",
            accepted=f"{points:g} points from {first:g} to {last:g}",
        )
    x_unit, y_unit = (re.sub(r"\s", "", record.get(key, "")).upper() for key in ("XUNITS", "YUNITS"))
    return title, x_unit, y_unit, np.round(x, 9), y, tuple(_doubts(path, record, x, y))


def _doubts(path: Path, record: Mapping[str, str], x: Array, y: Array) -> Iterator[str]:
    """Doubts about labels that the standard provides as checks; some programs write them carelessly."""
    scale = float(np.abs(y).max())
    step = (x[-1] - x[0]) / max(x.size - 1, 1)
    for label, actual, tolerance in (
        ("FIRSTY", y[0], 1e-3 * scale),
        ("MINY", y.min(), 1e-3 * scale),
        ("MAXY", y.max(), 1e-3 * scale),
        ("DELTAX", step, 1e-2 * abs(step)),
    ):
        stated = _number(path, record, label, actual)
        if abs(stated - actual) > tolerance:
            yield f"##{label} states {stated:g}, the table has {actual:g}. Look for damaged or lost values"


def _number(path: Path, record: Mapping[str, str], key: str, default: float) -> float:
    text = record.get(key, "")
    if not text:
        return float(default)
    if not _PLAIN.fullmatch(text):
        raise InputError(path, "not a number", where=f"##{key}", found=repr(text)[:40])
    return float(text)


def _pairs(path: Path, body: str) -> tuple[Array, Array]:
    cells = [cell for cell in re.split(r"[\s,;]+", body) if cell]
    wrong = next((cell for cell in cells if not _PLAIN.fullmatch(cell)), None)
    if wrong is not None or not cells or len(cells) % 2:
        raise InputError(path, "not pairs of numbers", found=repr(wrong or f"{len(cells)} numbers")[:40])
    values = np.array([float(cell) for cell in cells])
    return values[::2], values[1::2]


def _ordinates(path: Path, record: Mapping[str, str], body: str, factor: float) -> tuple[Array, Array]:
    """X and Y of a table of lines with one X and many Y; the X of every line is checked."""
    packed = re.search(r"[@%A-DF-Za-df-z]", body) is not None
    values: list[float] = []
    starts: list[tuple[int, float]] = []
    check: float | None = None
    for place, line in enumerate(filter(str.strip, body.split("\n")), start=1):
        tokens = (_PACKED if packed else _PLAIN).findall(line)
        whole = re.sub(r"[\s,]", "", line) == "".join(tokens)
        if len(tokens) < 2 or not whole or {tokens[0][0], tokens[1][0]} & set(_DUPLICATE):
            raise InputError(path, "not a line of numbers", where=f"table, line {place}", found=repr(line)[:40])
        ordinates, differences = _unpacked(tokens[1:])
        if check is not None and ordinates[:1] != [check]:
            raise InputError(
                path,
                "damaged: wrong check value",
                where=f"table, line {place}",
                found=f"{ordinates[0]:g}",
                accepted=f"{check:g}",
            )
        starts.append((len(values) - (check is not None), float(_value(tokens[0]))))
        values += ordinates if check is None else ordinates[1:]
        check = values[-1] if differences else None
        if len(values) > _MOST:
            raise InputError(path, "too many points", accepted=f"up to {_MOST}")
    if not values:
        raise InputError(path, "the table is empty")
    first, last = (_number(path, record, key, np.nan) for key in ("FIRSTX", "LASTX"))
    if not np.isfinite([first, last]).all() or len(values) < 2:
        raise InputError(path, "FIRSTX or LASTX is missing", accepted="both, and at least two points")
    x = np.linspace(first, last, len(values))
    index, at = np.array(starts).T
    # The X of a line is rounded to a step at most.
    if (np.abs(at * factor - x[index.astype(int)]) > 0.51 * abs(x[1] - x[0])).any():
        raise InputError(path, "damaged: missing or misplaced lines", accepted="X in even steps from FIRSTX to LASTX")
    return x, np.array(values)


def _unpacked(tokens: list[str]) -> tuple[list[float], bool]:
    """Ordinates of a line, and whether its last one was given as a difference."""
    values: list[float] = []
    step: float | None = None
    for token in tokens:
        if len(values) > _MOST:
            break
        if token[0] in _DUPLICATE:
            for _ in range(min(int(f"{_DUPLICATE[token[0]]}{token[1:]}") - 1, _MOST)):
                values.append(values[-1] + (step or 0.0))
        elif token[0] in _DIFFERENCE and values:
            step = _value(token)
            values.append(values[-1] + step)
        else:
            step = None
            values.append(_value(token))
    return values, step is not None


def _value(token: str) -> float:
    return float({**_SQUEEZED, **_DIFFERENCE}.get(token[0], token[0]) + token[1:])


def _samples(path: Path, text: str) -> list[base.Sample]:
    samples = []
    records = [record for record in _records(text) if _form(record)]
    for block, record in zip(blocks(path, text), records, strict=True):
        title, x_unit, y_unit, wavelength, values, doubts = block
        unit = {"NANOMETERS": "nm", "NM": "nm", "MICROMETERS": "um", "MICRONS": "um", "UM": "um"}.get(x_unit)
        if unit is None or "REFL" not in y_unit or "LOG" in y_unit:
            raise InputError(
                path,
                "not a reflectance over wavelength",
                where=title[:40],
                found=f"XUNITS {x_unit[:20]}, YUNITS {y_unit[:20]}",
                accepted="NANOMETERS or MICROMETERS, REFLECTANCE",
            )
        scale = base.PERCENT if "%" in y_unit or "PERCENT" in y_unit else base.FRACTION
        words = (f"{label}: {value}" for label, value in record.items() if label not in (_form(record), "TITLE"))
        samples.append(base.Sample(title, wavelength, values, (scale, *spoken(words)), unit, doubts))
    return samples


FORMAT = base.SpectrumFormat(
    "jcamp",
    (".dx", ".jcamp", ".jcm", ".jdx"),
    "JCAMP-DX `XYDATA` or `XYPOINTS`, packed or not, over nm or µm",
    base.from_text(_samples),
    tried="colorchecker_red_jcamp.jdx, made",
)

"""Delimited text: a line of heights, a grid of heights, or points x y z; and the text format HFM.

Fixed rules determine the layout, the separator and the decimal mark, so that a damaged file is refused and not misread.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from brdfpipe import columns
from brdfpipe.errors import InputError, plain
from brdfpipe.surfaces.column_titles import TitledUnits, titled_units
from brdfpipe.surfaces.heights import GRID_MIN, LINES, UNSTATED, Heights, SurfaceFormat
from brdfpipe.surfaces.units import UNITS, needed_steps, pitch_steps, scales

LAYOUTS = ("line", "grid", "xyz")

_MAX_BYTES = 2**31
_MISSING = ["", "NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "-", "--", "---", "BAD", "bad"]
_NUMBER = re.compile(
    r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?|nan|[+-]?inf(?:inity)?|\*+", re.IGNORECASE | re.ASCII
)
_ERROR_VALUE = re.compile(
    r"(?i)(?<![^\s;,])#(?:NV|N/[AVDB]|DIV/0!|VALUE!|WERT!|VALEUR!|VALOR!|REF!|BEZUG!|NAME\?|NOM\?|NUM!|ZAHL!|NOMBRE!|NULL!|NUL!)(?![^\s;,])"
)
"""A cell of a spreadsheet that has no value: `#` begins no comment there."""
_SETTING = re.compile(r"[ \t]*[#%]+[ \t]*(unit|lateral_unit|pitch)[ \t]*[:=][ \t]*(.*)", re.IGNORECASE)
_COMMENT_LINE = re.compile(r"(?m)^[ \t]*[#%]+[ ]*(.*?)[ ]*$")
_LENGTH = re.compile(
    rf"^[ \t#%]*(?:(?:scan|profile)[ _])?length[ \t]*[:;=,\t][ \t]*(\d+\.?\d*)[ \t]*\[?({'|'.join(UNITS)})\b",
    re.IGNORECASE | re.MULTILINE,
)
_GWYDDION_EXTENT = re.compile(
    rf"[ \t]*#[ \t]*(width|breite|largeur|height|höhe|hauteur)[ \t]*:[ \t]*(\d+(?:[.,]\d*)?(?:e[+-]?\d+)?)[ \t]*({'|'.join(UNITS)})[ \t]*",
    re.IGNORECASE,
)
_GWYDDION_UNIT = re.compile(rf"[ \t]*#[ \t]*value units?[ \t]*:[ \t]*({'|'.join(UNITS)})[ \t]*", re.IGNORECASE)
_PITCH_SETTING = "a line `# pitch: 0.5 0.5`"
_NO_LAST_FIELD = re.compile(r"[;,\t]$|[;,\s]-$")
_TWO_PERCENT = 0.02
_BLOCK = 2**22
"""Bytes of text that are examined at once."""
_COMPARED = 33
_HEADER_LINES = 8
"""Lines above the numbers that are kept."""
_GRID_WORDS = 8
"""Words of a row of numbers above which it is one of a grid; x, y and z are six words with decimal commas."""


@dataclass(frozen=True)
class _Body:
    """The numbers of a file as text, with the settings of its header and comments."""

    text: str
    first_line: int
    settings: dict[str, str]
    notes: list[str]
    length: float | None = None
    """Length of the profile according to the header [um]."""
    extent: tuple[float, ...] = ()
    """Width and height of the map according to the header of Gwyddion [um]; empty without one."""
    header: tuple[str, ...] = ()
    """The lines above the numbers."""
    doubts: tuple[str, ...] = ()
    """Warnings of lines above the numbers that may be heights."""


def read_text(
    path: Path,
    *,
    layout: str | None = None,
    unit: str | None = None,
    lateral_unit: str | None = None,
    pitch: float | Sequence[float] | None = None,
) -> Heights:
    """Read a line profile or a height map from delimited text.

    Parameters
    ----------
    path : columns separated by ``;``, tab, ``,`` or white space; decimal point or comma; comments after ``#`` or ``%``; header lines
        above the first line of numbers are skipped; of Gwyddion's, ``# Width``, ``# Height`` and ``# Value units`` are used
    layout : ``line`` (x and z, or z alone), ``grid`` (a row of heights a line, the first at y = 0) or ``xyz`` (in any
        order); by default from the shape: one row, one or two columns are a line, three columns are xyz, more a grid
    unit, lateral_unit, pitch : by default from lines ``# unit: um``, ``# lateral_unit: mm``, ``# pitch: 0.5 0.5``; the units also from the
        titles of columns (``x [mm]; z [µm]``), the pitch from x and y where the file has them

    Returns
    -------
    Heights [um] in float64; NaN where the file has NaN, ***, NA, -, #N/A or nothing between two separators, or omits points of a
    regular xyz grid. Warnings if comments among the rows have as many fields as a row; if the file may be truncated: the header states a greater length, the last row of points is
    incomplete, or the last line has no line end and fewer decimals than those above; and if titles of columns state other units.

    Notes
    -----
    Printed positions are rounded: at 0.1 um printed and 0.156 um pitch, slopes from printed neighbours would be 28 % too steep. So
    the pitch is constant and comes from the end points; positions must follow it within their printed digits.
    """
    if layout is not None and layout not in LAYOUTS:
        raise InputError(path, "unknown layout", found=layout, accepted=", ".join(LAYOUTS), key="surface.layout")
    text, notes = _decoded(path)
    body = _split_header(text, path)
    del text  # it may be large; the body is a copy
    table = _table(body, path)
    chosen = layout or ("grid" if body.extent and len(table) > 1 else _default_layout(table))
    titles = None if chosen == "grid" else titled_units(body.header, table.shape[1])
    settings = _with_titles(body.settings, titles)
    height_scale, lateral_scale = scales(path, settings, unit, lateral_unit, setting="a line `# unit: um`")
    steps = pitch_steps(path, settings, pitch)
    of_gwyddion = chosen == "grid" and len(body.extent) == 2
    if of_gwyddion:
        steps = _gwyddion_steps(table.shape, body.extent, lateral_scale, steps, path)
    read = {"line": _line, "grid": _grid, "xyz": _xyz}[chosen]
    height, pitch_x, pitch_y, remarks = read(table, steps, path)
    if of_gwyddion:
        height = height[::-1]
        remarks = (*remarks, "Pitch from the width and height that Gwyddion states; its first row is the upper edge.")
    height = height * height_scale if height_scale != 1 else height
    doubt = _truncation_sign(body.text)
    extent = height.shape[-1] * pitch_x * lateral_scale
    if chosen == "line" and body.length is not None and extent < (1 - _TWO_PERCENT) * body.length:
        doubt = f"The header states a length of {plain(body.length, 5)} um, the data have {plain(extent, 5)} um"
    if chosen == "xyz" and _stops_within_a_row(table):
        doubt = "The last row of points is incomplete"
    return Heights(
        height,
        pitch_x * lateral_scale,
        None if pitch_y is None else pitch_y * lateral_scale,
        (*notes, *body.notes, *_title_note(titles), *remarks),
        (*body.doubts, *_cut_warning(doubt), *_other_units(titles, height_scale, lateral_scale)),
        height_scale,
    )


def _with_titles(settings: dict[str, str], titles: TitledUnits | None) -> dict[str, str]:
    """The settings of the file, completed by the units in the titles of columns."""
    if titles is None:
        return settings
    lateral = {} if titles.lateral is None else {"lateral_unit": titles.lateral}
    return {"unit": titles.height, **lateral, **settings}


def _title_note(titles: TitledUnits | None) -> tuple[str, ...]:
    if titles is None:
        return ()
    positions = f", positions in {titles.lateral}" if titles.lateral else ""
    return (f"The titles of the columns state heights in {titles.height}{positions}.",)


def _other_units(titles: TitledUnits | None, height_scale: float, lateral_scale: float) -> tuple[str, ...]:
    """A warning for each unit that is not the one of the titles."""
    if titles is None:
        return ()
    names = {scale: name for name, scale in UNITS.items() if name.isascii()}
    return tuple(
        f"The titles of the columns state {what} in {stated}; they were read in {names[scale]}. Correct `surface.{key}`, or the file."
        for what, stated, scale, key in (
            ("heights", titles.height, height_scale, "unit"),
            ("positions", titles.lateral, lateral_scale, "lateral_unit"),
        )
        if stated is not None and UNITS[stated] != scale
    )


def _gwyddion_steps(
    shape: tuple[int, ...], extent: tuple[float, ...], unit: float, stated: tuple[float, ...], path: Path
) -> tuple[float, ...]:
    """Pitch in x and y in units of ``unit`` um, from the extent [um] that Gwyddion's header states; a contradicting pitch is refused."""
    width, height = extent
    steps = width / shape[1] / unit, height / shape[0] / unit
    for name, given, measured in zip("xy", (*stated, *stated[-1:]), steps, strict=False):
        if abs(given - measured) > 0.01 * measured:
            problem, found = f"the stated pitch contradicts the extent along {name}", f"{given:g} against {measured:g}"
            accepted = "no pitch where the header states width and height"
            raise InputError(path, problem, found=found, accepted=accepted, key="surface.pitch")
    return steps


def read_hfm(path: Path) -> Heights:
    """Line profile in the text form HFM, x, z and validity of z, below the lines ``X;Y;valid`` and ``[mm];[mm];[1/0]`` (or other units).

    float64; NaN where the file marks a height as invalid.
    """
    text, notes = _decoded(path)
    titles, units, rows = [*text.split("\n", 2), "", ""][:3]
    named = re.fullmatch(r"\s*\[(\S+)\];\[(\S+)\];\[1/0\]\s*", units)
    if titles.strip() != "X;Y;valid" or named is None or not rows.strip():
        accepted = "rows of numbers under the lines X;Y;valid and [mm];[mm];[1/0]"
        found = repr(f"{titles.strip()} {units.strip()}"[:60])
        raise InputError(path, "not an HFM profile", found=found, accepted=accepted, key="surface.format")
    x_unit, z_unit = named.groups()
    z_scale, x_scale = scales(path, {}, z_unit, x_unit, setting="a line [mm];[mm];[1/0]")
    table = _table(_Body(rows, 3, {}, []), path)
    if table.shape[1] != 3:
        raise InputError(path, "not an HFM profile", found=f"{table.shape[1]} columns", accepted="x, z and valid")
    profile = np.column_stack([table[:, 0], np.where(table[:, 2] == 1, table[:, 1], np.nan)])
    height, pitch, _, remarks = _line(profile, (), path)
    doubts = _cut_warning(_truncation_sign(rows))
    return Heights(height * z_scale, pitch * x_scale, None, (*notes, *remarks), doubts)


def _cut_warning(doubt: str) -> tuple[str, ...]:
    return (f"The file may be truncated. {doubt}; compare it with the original, or export it again.",) if doubt else ()


def _truncation_sign(text: str) -> str:
    """Sign of truncation in a last line without line end; empty if there is none, since many files lack the last line end."""
    *above, last = text.rsplit("\n", _COMPARED)
    rows = [row.rstrip(" ") for row in above[1:] if row.strip()]
    if not rows or not last.strip():
        return ""
    if _NO_LAST_FIELD.search(last) and not any(map(_NO_LAST_FIELD.search, rows)):
        return "The last line has no line end, and its last field is empty"
    if re.search(r"[\d.,]$", last) and _decimals(last) < min(map(_decimals, rows)):
        return "The last line has no line end, and its last number has fewer decimals than those above"
    return ""


def _decimals(row: str) -> int:
    """Characters after the decimal mark of the last number of a row."""
    number = re.split(r"[;\s]", row)[-1]
    return len(number) - 1 - max(number.rfind("."), number.rfind(",")) if re.search("[.,]", number) else 0


def _stops_within_a_row(points: NDArray[np.float64]) -> bool:
    """Whether points x y z, written by rows or columns, end in a row that is shorter than all others and ends elsewhere."""
    for slow, fast in ((1, 0), (0, 1)):
        steps = np.diff(points[:, slow])
        begins = np.flatnonzero(steps) + 1
        if begins.size and (steps * steps[begins[0] - 1] >= 0).all():
            sizes = np.diff([0, *begins, len(points)])
            ends = points[np.concatenate([[0], begins, begins - 1]), fast]
            return bool(sizes[-1] < sizes[:-1].min() and points[-1, fast] not in ends)
    return False


def _decoded(path: Path) -> tuple[str, list[str]]:
    # Zygo's binary files share the extension of many text files.
    if_binary = "; or `format: metropro` for a file of Zygo MetroPro" if path.suffix.lower() == ".dat" else ""
    text, notes = columns.read_text(path, _MAX_BYTES, "surface.format", if_binary)
    return re.sub(r"\r*\n|\r", "\n", text) if "\r" in text else text, notes


def _split_header(text: str, path: Path) -> _Body:
    settings: dict[str, str] = {}
    extent: dict[str, float] = {}
    above: list[str] = []
    gaps: list[_Gap] = []
    numerous: list[tuple[int, int]] = []
    skipped, offset = 0, 0
    text = _ERROR_VALUE.sub("NaN", text) if "#" in text else text
    for number, line in enumerate(_lines(text), 1):
        if setting := _SETTING.match(line):
            settings[setting[1].lower()] = setting[2].strip()
        elif unit := _GWYDDION_UNIT.fullmatch(line.rstrip("\n")):
            settings.setdefault("unit", unit[1])
        elif size := _GWYDDION_EXTENT.fullmatch(line.rstrip("\n")):
            side = "width" if size[1].lower() in ("width", "breite", "largeur") else "height"
            extent[side] = float(size[2].replace(",", ".")) * UNITS[size[3]]
        content = re.split("[#%]", line, maxsplit=1)[0].strip(" \n")
        words = _words(content)
        numbers = sum(map(_is_number, words))
        if _is_row(words, numbers):
            # Dashes or separators alone below other header lines are those of a table or of a workbook.
            alike = _alike(gaps, content)
            of_heights = alike and (not skipped or all(re.search("[A-Za-z]", gap.content) for gap in gaps))
            first = gaps[0] if of_heights else _Gap(offset, number, content)
            skipped += 0 if of_heights else sum(bool(gap.content.strip()) for gap in gaps)
            notes = [f"Skipped {skipped} header lines above the heights."] if skipped else []
            stated = _LENGTH.search(text[: first.offset])
            length = float(stated[1]) * UNITS[stated[2].lower()] if stated else None
            sides = (extent["width"], extent["height"]) if len(extent) == 2 and min(extent.values()) > 0 else ()
            rows = _without_indent(_without_comments(text[first.offset :]))
            doubts = (
                *_skipped_heights(numerous, len(gaps) if alike and not of_heights else 0, len(words)),
                *_commented_rows(text, offset, number, content),
            )
            return _Body(rows, first.line, settings, notes, length, sides, tuple(above), doubts)
        if content and all(word in _MISSING for word in words):
            gaps.append(_Gap(offset, number, content))
        elif words:
            skipped += 1 + len(gaps)
            gaps = []
            # A word before numbers may be a damaged height.
            if 2 * numbers > len(words):
                numerous.append((number, numbers))
        offset += len(line)
        above = [*above, line][-_HEADER_LINES:] if line.strip() and not (gaps and gaps[-1].line == number) else above
    raise InputError(
        path,
        "the file is empty" if not text.strip() else "no line of numbers found",
        accepted="rows of heights, x and z, or x y z",
    )


class _Gap(NamedTuple):
    """A line of marks of missing heights, or of separators alone, above the first number."""

    offset: int
    line: int
    content: str


def _words(content: str) -> list[str]:
    """What stands between separators of any kind; a number with a decimal comma is two words."""
    return re.findall(r"[^;,\s]+", content)


def _is_number(word: str) -> bool:
    return _NUMBER.fullmatch(word) is not None


def _is_row(words: Sequence[str], numbers: int) -> bool:
    """Whether a line holds heights: it begins with a number, or holds numbers and marks of missing heights alone."""
    return numbers > 0 and (_is_number(words[0]) or all(_is_number(word) or word in _MISSING for word in words))


def _alike(gaps: Sequence[_Gap], row: str) -> bool:
    """Whether lines of marks alone may be rows of missing heights: they have the fields of the first row of numbers.

    A row of two or three fields has positions, which cannot be missing.
    """
    if not gaps:
        return False
    mark = next((mark for mark in ";\t," if mark in gaps[0].content), None)
    fields = len(row.split(mark))
    return fields not in (2, 3) and all(len(gap.content.split(mark)) == fields for gap in gaps)


def _skipped_heights(numerous: Sequence[tuple[int, int]], empty: int, words: int) -> tuple[str, ...]:
    """Warnings of skipped lines that may be heights of a grid: lines of numbers behind a word, and lines of dashes or of empty fields."""
    if words <= _GRID_WORDS:
        return ()
    lines = [str(line) for line, numbers in numerous if 2 * numbers > words]
    advice = "Write # before them if they are no heights"
    named = f"Lines of the file were skipped as header though most of their fields are numbers: {', '.join(lines[:5])}"
    unnamed = f"{empty} lines of dashes or of empty fields above the heights were skipped"
    return (
        *([f"{named}. {advice}; else correct the field that is no number."] if lines else []),
        *([f"{unnamed}. {advice}; else write NaN."] if empty else []),
    )


def _commented_rows(text: str, offset: int, line: int, row: str) -> tuple[str, ...]:
    """A warning of comments below the first row of numbers, at ``offset`` and in ``line``, that have as many fields as it."""
    mark = next((mark for mark in ";\t," if mark in row), None)
    fields = len(row.split(mark))
    alike = []
    for comment in _COMMENT_LINE.finditer(text, offset) if fields > 1 and ("#" in text or "%" in text) else ():
        words = _words(comment[1])
        numbers = sum(map(_is_number, words))
        # A sentence may have as many words, or clauses, as a row has fields.
        is_row = 2 * numbers > len(words) or (mark and (numbers or "#" in comment[1]))
        if is_row and len(comment[1].split(mark)) == fields and not _SETTING.match(comment[0]):
            alike.append(comment)
    if not alike:
        return ()
    where = line + text.count("\n", offset, alike[0].start())
    return (
        f"{len(alike)} comments among the rows have as many fields as a row and were left out, the first in line {where}: "
        f"{alike[0][0].strip()[:40]!r}. If they are rows of heights, remove the # or % and write NaN where a height is missing.",
    )


def _lines(text: str) -> Iterator[str]:
    """Lines with their ends, one at a time: the text may be large."""
    start = 0
    while start < len(text):
        end = text.find("\n", start) + 1 or len(text)
        yield text[start:end]
        start = end


def _without_comments(text: str) -> str:
    if "#" in text or "%" in text:
        text = re.sub(r"[#%].*", "", text)
    # A run of asterisks is a missing height, however long.
    return re.sub(r"\*+", "nan", text) if "*" in text else text


def _without_indent(text: str) -> str:
    """The rows without the semicolons or commas that every one begins with, where another mark, or a blank, separates the numbers.

    Where they also separate, the columns before them are empty, and left out later.
    """
    row = text.partition("\n")[0]
    indent = re.match(r" *(;+|,+)", row)
    # A comma may be the decimal mark of the first number, unless points are.
    if indent is None or indent[1][0] in row[indent.end() :] or (indent[1][0] == "," and "." not in text):
        return text
    rows, count = re.subn(rf"(?m)^ *{indent[1]}", "", text)
    return rows if count == sum(1 for _ in re.finditer(r"(?m)^[ \t]*\S", text)) else text


def _table(body: _Body, path: Path) -> NDArray[np.float64]:
    """The numbers, (rows, columns); empty columns at either end are left out."""
    separator, decimal = _marks(body, path)
    data, lines = _check_rows(body, separator, path)
    options: dict[str, Any] = {
        "header": None,
        "sep": separator or r"\s+",
        "decimal": decimal,
        "keep_default_na": False,
        "na_values": _MISSING,
        "quoting": csv.QUOTE_NONE,
        "skipinitialspace": True,
        "encoding": "utf-8",
    }
    try:
        table: NDArray[np.float64] = pd.read_csv(io.BytesIO(data), dtype=np.float64, **options).to_numpy()
    except ValueError:
        raise _not_a_number(data, options, lines, path) from None
    if len(table) != len(lines):
        raise InputError(path, "rows of unequal length", accepted="the same number of fields in every row")
    while table.shape[1] > 1 and np.isnan(table[:, -1]).all() and separator:
        table = table[:, :-1]
    while table.shape[1] > 1 and np.isnan(table[:, 0]).all() and separator:
        table = table[:, 1:]
    return table


def _marks(body: _Body, path: Path) -> tuple[str | None, str]:
    """Separator of the columns (None: white space) and decimal mark, from the first row and the marks used below it."""
    # A first row of separators alone does not tell its tabs from blanks.
    first = re.search(r"[^\n]*[^\s;,][^\n]*", body.text)
    row = (first[0] if first else "").strip(" ")
    # A tab before the first number may indent a row of blank-separated numbers.
    row = row if "\t" in row.strip() else row.strip()
    decimal = _decimal_mark(row) or _decimal_mark(body.text) or "."
    for separator in (";", "\t"):
        if separator in row:
            return separator, decimal
    row = row.strip()
    if "," not in body.text:
        return None, "."
    padded, bare = len(re.findall(r"\s,|,\s|,$", row)), len(re.findall(r"(?<!\s),(?=\S)", row))
    leading = row.startswith(",") and body.text.count(",") == len(re.findall(r"(?m)^[ \t]*,", body.text))
    if not leading and re.search(r"\s", re.sub(r"\s*,\s*", ",", row)):
        return None, decimal
    if "." in body.text or (padded and not bare) or (bare > 1 and not padded):
        return ",", "."
    where = f"line {body.first_line + body.text.count(chr(10), 0, first.start() if first else 0)}"
    accepted = "decimal points, or columns separated by `;` or a tab"
    problem = "ambiguous comma: decimal mark or column separator"
    raise InputError(path, problem, where=where, found=repr(row[:60]), accepted=accepted)


def _decimal_mark(text: str) -> str | None:
    """The decimal mark of the text; None if it contains both marks or neither."""
    point, comma = "." in text, "," in text
    return None if point == comma else "." if point else ","


def _check_rows(body: _Body, separator: str | None, path: Path) -> tuple[bytes, NDArray[np.int64]]:
    """The text in UTF-8 without blank lines, and the line number of each row in the file.

    The parser would fill short rows with missing values: fields are counted here, on the bytes of whole blocks of lines.
    """
    data = body.text.encode("utf-8")
    data = data if data.endswith(b"\n") else data + b"\n"
    counts = [_count(block, separator) for block in _blocks(data)]
    tokens, fields, sizes = (np.concatenate(arrays) for arrays in zip(*counts, strict=True))
    rows = np.flatnonzero(tokens)
    uneven = np.flatnonzero(fields[rows] != fields[rows[0]])
    if uneven.size:
        row = rows[uneven[0]]
        where, accepted = f"line {body.first_line + row}", f"{fields[rows[0]]}, as in line {body.first_line}"
        raise InputError(path, "rows of unequal length", where=where, found=f"{fields[row]} fields", accepted=accepted)
    if np.count_nonzero(sizes > 1) > rows.size:
        data = re.sub(rb"(?m)^[ \t]+$" if separator != "\t" else rb"(?m)^ +$", b"", data)
    return data, body.first_line + rows


def _blocks(data: bytes) -> Iterator[NDArray[np.uint8]]:
    """The bytes in blocks of whole lines."""
    start = 0
    while start < len(data):
        end = data.find(b"\n", start + _BLOCK) + 1 or len(data)
        yield np.frombuffer(data, np.uint8, end - start, start)
        start = end


def _count(data: NDArray[np.uint8], separator: str | None) -> tuple[NDArray[np.int64], ...]:
    """Words, fields and bytes of each line; the last byte ends a line."""
    ends = np.flatnonzero(data == ord("\n"))
    begins = np.concatenate([[0], ends[:-1] + 1])
    blank = (data == ord(" ")) | (data == ord("\n"))
    if separator != "\t":
        blank |= data == ord("\t")
    starts = ~blank
    starts[1:] &= blank[:-1]
    tokens = np.add.reduceat(starts, begins, dtype=np.int64)
    fields = tokens if separator is None else np.add.reduceat(data == ord(separator), begins, dtype=np.int64) + 1
    return tokens, fields, ends - begins + 1


def _not_a_number(data: bytes, options: dict[str, Any], lines: NDArray[np.int64], path: Path) -> InputError:
    """Find the field that the parser refused (slow, for failing files only); of several, one of the first block of rows."""
    rows = max(1, _BLOCK // max(1, len(data) // len(lines)))
    for block in pd.read_csv(io.BytesIO(data), dtype=str, chunksize=rows, **options):
        for column in block:
            numbers = block[column].str.strip().str.replace(options["decimal"], ".", regex=False)
            if options["decimal"] == ",":
                numbers = numbers.where(~block[column].str.contains(".", regex=False, na=False), "mixed marks")
            wrong = np.flatnonzero(pd.to_numeric(numbers, errors="coerce").isna() & block[column].notna())
            if wrong.size:
                line, found = lines[block.index[wrong[0]]], str(block[column].iloc[wrong[0]])
                where = f"line {line}, column {int(str(column)) + 1}"
                accepted = "numbers; comments after #; NaN, *** or an empty field where a height is missing"
                return InputError(path, "not a number", where=where, found=repr(found[:60]), accepted=accepted)
    return InputError(path, "not all fields are numbers", accepted="numbers; comments after #")


def _default_layout(table: NDArray[np.float64]) -> str:
    if len(table) == 1 or table.shape[1] <= 2:
        return "line"
    return "xyz" if table.shape[1] == 3 else "grid"


_Read = tuple[NDArray[np.float64], float, float | None, tuple[str, ...]]


def _line(table: NDArray[np.float64], steps: tuple[float, ...], path: Path) -> _Read:
    if len(table) == 1:
        table = table.T
    if table.shape[1] == 1:
        return table[:, 0], needed_steps(path, steps, setting=_PITCH_SETTING)[0], None, ()
    if table.shape[1] != 2:
        found, accepted = f"{table.shape[1]} columns", "one column z, or two: x and z"
        raise InputError(path, "not a line profile", found=found, accepted=accepted, key="surface.layout")
    x, z = table.T
    backwards = x[-1] < x[0]
    if backwards:
        x, z = x[::-1], z[::-1]
    pitch = _constant_pitch(x, "x", path)
    _check_agreement(steps[:1], (pitch,), path)
    reversal = ("Reversed, so that x increases.",) if backwards else ()
    return z.copy(), pitch, None, (*reversal, f"Pitch from the first and last of {x.size} positions x.")


def _grid(table: NDArray[np.float64], steps: tuple[float, ...], path: Path) -> _Read:
    labels = [name for name, first, second in _edges(table) if _is_even(first) and not _is_even(second)]
    if labels:
        problem = (
            f"the first {' and the first '.join(labels)} of the grid holds positions or numbers of lines, no heights"
        )
        raise InputError(path, problem, found="even steps", accepted="heights alone; remove it from the file")
    pitch = needed_steps(path, steps, setting=_PITCH_SETTING)
    return table, pitch[0], pitch[-1], ()


def _edges(table: NDArray[np.float64]) -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """The first row and the first column of a grid and their neighbours, without the corner."""
    for name, part in (("row", table[:2, 1:]), ("column", table[1:, :2].T)):
        if len(part) == 2 and part.shape[1] >= GRID_MIN:
            yield name, part[0], part[1]


def _is_even(values: NDArray[np.float64]) -> bool:
    """Whether values rise or fall in even steps."""
    steps = np.diff(values)
    return bool(steps[0]) and bool(np.all(np.abs(steps - steps.mean()) <= 1e-6 * np.abs(steps.mean())))


def _xyz(table: NDArray[np.float64], steps: tuple[float, ...], path: Path) -> _Read:
    if table.shape[1] != 3:
        raise InputError(
            path, "not a table of points x y z", found=f"{table.shape[1]} columns", accepted="3", key="surface.layout"
        )
    (columns, x), (rows, y) = (_positions(table[:, axis], name, path) for axis, name in enumerate("xy"))
    shape, count = (y.size, x.size), len(table)
    if min(shape) < 2 or x.size * y.size > 2 * count:
        raise InputError(
            path,
            "the points do not form a regular grid",
            found=f"{count} points, {x.size} different x, {y.size} different y",
            accepted="every x with every y, at constant pitch",
            key="surface.layout",
        )
    pitch = _constant_pitch(x, "x", path), _constant_pitch(y, "y", path)
    _check_agreement(steps, pitch, path)
    cells = rows * x.size + columns
    times = np.bincount(cells, minlength=x.size * y.size)
    if times.max() > 1:
        duplicate = int(np.argmax(times))
        found = f"x = {x[duplicate % x.size]:g}, y = {y[duplicate // x.size]:g}"
        raise InputError(path, "duplicate point", found=found, accepted="one height per point")
    height = np.full(x.size * y.size, np.nan)
    height[cells] = table[:, 2]
    absent = int(np.count_nonzero(times == 0))
    note = (f"{absent} points of the grid are not in the file; taken as missing.",) if absent else ()
    return height.reshape(shape), *pitch, note


def _positions(values: NDArray[np.float64], name: str, path: Path) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The rank of every position among the distinct ones, and the distinct ones, increasing."""
    if not np.isfinite(values).all():
        raise InputError(path, f"missing positions {name}", accepted="numbers in every row; only z may be missing")
    codes, distinct = pd.factorize(values, sort=True)
    return codes, np.asarray(distinct)


def _constant_pitch(positions: NDArray[np.float64], name: str, path: Path) -> float:
    """The pitch from the end points; every position must agree with it within its printed digits."""
    if positions.size < 2 or not np.isfinite(positions).all() or positions[-1] == positions[0]:
        problem, accepted = f"the positions {name} do not give a pitch", f"increasing numbers {name} in every row"
        raise InputError(path, problem, accepted=accepted, key="surface.layout")
    pitch = float(positions[-1] - positions[0]) / (positions.size - 1)
    deviation = np.abs(positions - (positions[0] + pitch * np.arange(positions.size)))
    # Each position and both ends are rounded by half a printed step; scanners jitter by little more.
    allowed = _printed_step(positions) + _TWO_PERCENT * pitch
    worst = int(np.argmax(deviation))
    if deviation[worst] > allowed:
        found = f"{deviation[worst] / pitch:.2g} pitches from its regular position"
        problem, accepted = f"the positions {name} are unevenly spaced", "a constant pitch: resample the file"
        raise InputError(path, problem, where=f"point {worst + 1}", found=found, accepted=accepted)
    return pitch


def _printed_step(positions: NDArray[np.float64]) -> float:
    """The last printed digit of the largest positions, which carry the fewest decimals."""
    largest = float(np.abs(positions).max())
    outer = np.abs(positions[np.abs(positions) >= largest / 2])
    scale = 10.0 ** math.floor(math.log10(largest))
    for digits in range(12):
        scaled = outer / scale * 10**digits
        if (np.abs(scaled - np.round(scaled)) <= 1e-9 * scaled).all():
            return float(scale / 10**digits)
    return 0.0


def _check_agreement(stated: tuple[float, ...], measured_pitches: tuple[float, ...], path: Path) -> None:
    for name, given, measured in zip("xy", (*stated, *stated[-1:]), measured_pitches, strict=False):
        if abs(given - measured) > 0.01 * measured:
            problem, found = f"the stated pitch contradicts the positions {name}", f"{given:g} against {measured:g}"
            accepted = "no pitch where the file has positions"
            raise InputError(path, problem, found=found, accepted=accepted, key="surface.pitch")


FORMATS = (
    SurfaceFormat(
        "text",
        (".txt", ".csv", ".dat", ".asc", ".xyz"),
        "unit (or a line `# unit: um`, or titles of columns with units, as `z [um]`); pitch (or `# pitch: 0.5 0.5`) where there are no positions; neither with the header of a Gwyddion export, whose first row is the upper edge",
        read_text,
        ("layout", *UNSTATED),
        tried="dektak-1.csv, nanovea_test1.txt; gwyddion-export-english.txt, refused: 4 x 3 points",
    ),
    SurfaceFormat("hfm", (".hfm",), "the file states unit and pitch", read_hfm, tried="hfm-1.hfm", orientation=LINES),
)

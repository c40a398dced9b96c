"""Excel workbooks: the first sheet, laid out like text."""

from __future__ import annotations

import warnings
import zipfile
from pathlib import Path
from typing import Any

from brdfpipe import columns
from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import base
from brdfpipe.spectra.formats.text import wide_rows, wide_samples
from brdfpipe.surfaces import archives

_UNPACKED = 2**26
_MOST_ROWS, _MOST_COLUMNS, _MOST_CELLS = 2**14, 2**12, 2**20
"""Of the sheet: 4096 columns hold wavelengths in steps of 1 nm with room to spare."""


def _read(path: Path) -> base.Content:
    rows, notes = _sheet(path)
    text = "\n".join("\t".join(row) for row in rows)
    wide = wide_rows(text)
    if wide is not None:
        return wide_samples(path, wide[0], wide[1], "."), notes
    return columns.parse_columns(text, path, notes), notes


def _sheet(path: Path) -> tuple[list[list[str]], list[str]]:
    """Cells of the first sheet as text, with decimal points; percentages as displayed."""
    try:
        import openpyxl  # type: ignore[import-untyped]
    except ImportError as error:
        raise InputError(
            path,
            "reading Excel files needs the package openpyxl",
            accepted="pip install 'brdfpipe[excel]', or export as text",
        ) from error
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            sizes = sum(entry.file_size for entry in entries), sum(entry.compress_size for entry in entries)
            archives.check_inflated(path, None, *sizes, _UNPACKED)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                cells = _cells(path, book.worksheets[0])
                titles = [worksheet.title for worksheet in book.worksheets]
            finally:
                book.close()
    except InputError:
        raise
    except Exception as error:  # zipfile, the XML parser and openpyxl raise many types on a damaged workbook
        raise InputError(path, "damaged, or not an Excel workbook", accepted="a workbook saved as .xlsx") from error
    notes = [] if len(titles) == 1 else [f"the first of {len(titles)} sheets was read ({titles[0][:40]})"]
    has_percentages = any(_is_share(value, form) for row in cells for value, form in row)
    rows = [[_cell(value, form) for value, form in row] for row in cells]
    while rows and all(row and not row[-1] for row in rows):
        rows = [row[:-1] for row in rows]
    if has_percentages:
        notes.append("cells formatted as percentages were read as percent")
        rows.insert(0, [f"# {base.PERCENT}"])
    return rows, notes


def _cells(path: Path, sheet: Any) -> list[list[tuple[Any, str]]]:
    """Value and number format of each cell of a sheet; one that states or holds too many is refused before more are read."""
    _check_size(path, sheet.max_row or 0, sheet.max_column or 0)
    # A sheet that states fewer rows than it holds would be cut.
    sheet.reset_dimensions()
    rows: list[list[tuple[Any, str]]] = []
    count = 0
    for row in sheet.iter_rows(max_row=_MOST_ROWS + 1):
        count += len(row)
        _check_size(path, len(rows) + 1, len(row), count)
        rows.append([(cell.value, getattr(cell, "number_format", "")) for cell in row])
    width = max(map(len, rows), default=0)
    return [[*row, *[(None, "")] * (width - len(row))] for row in rows]


def _check_size(path: Path, rows: int, columns: int, cells: int = 0) -> None:
    if rows <= _MOST_ROWS and columns <= _MOST_COLUMNS and cells <= _MOST_CELLS:
        return
    raise InputError(
        path,
        "the sheet is too large for spectra",
        found=f"{rows} rows, {columns} columns" + (f", {cells} cells" if cells else ""),
        accepted=f"up to {_MOST_ROWS} rows, {_MOST_COLUMNS} columns and {_MOST_CELLS} cells; delete what lies beyond the spectra, empty rows and "
        "columns too, and save it again",
        key="spectrum.file",
    )


def _is_share(value: Any, form: str) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and "%" in form


def _cell(value: Any, form: str) -> str:
    if _is_share(value, form):
        return repr(round(float(value) * 100, 12))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(value)
    return "" if value is None else " ".join(str(value).split())


FORMAT = base.SpectrumFormat(
    "excel",
    (".xlsm", ".xlsx"),
    "the first sheet, laid out like `text`; needs `pip install 'brdfpipe[excel]'`",
    _read,
    read_by="openpyxl",
)

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

_UNPACKED = 2**28


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


def _is_share(value: Any, form: str) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and "%" in form


def _cell(value: Any, form: str) -> str:
    if _is_share(value, form):
        return repr(round(float(value) * 100, 12))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(value)
    return "" if value is None else " ".join(str(value).split())


FORMAT = base.SpectrumFormat(
    "excel", (".xlsm", ".xlsx"), "the first sheet, laid out like `text`; needs `pip install 'brdfpipe[excel]'`", _read
)

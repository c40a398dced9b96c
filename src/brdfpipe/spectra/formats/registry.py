"""The formats of spectrum files, and reading one spectrum of a file.

What a file states (unit, scale, number of points) is checked against what it holds: a truncated or damaged file is refused, never read
in part.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.file_formats import format_of
from brdfpipe.spectra.formats import cgats, cxf, excel, jcamp, perkinelmer, qtx, sample_choice, text
from brdfpipe.spectra.formats.base import UNSCALED, SpectrumFormat
from brdfpipe.spectra.specular_words import NOT_KNOWN, KnownGeometry, doubt

FORMATS: dict[str, SpectrumFormat] = {
    module.FORMAT.name: module.FORMAT for module in (text, perkinelmer, qtx, cxf, jcamp, cgats, excel)
}
"""Formats of spectrum files by name. To add one, write a module like :mod:`.qtx` and list it above."""


def read(
    path: Path, format: str | None = None, sample: int | str | None = None, geometry: KnownGeometry = NOT_KNOWN
) -> Columns:
    """Read one spectrum from a file of any known format; the options are those of :func:`brdfpipe.spectra.readers.read_spectrum`.

    Returns
    -------
    Columns : all columns of a table; of other formats wavelength and reflectance of the sample
    """
    content, notes = format_of(path, format, FORMATS, "spectrum.format").read(path)
    if isinstance(content, Columns):
        if sample is None:
            return content
        found, accepted = f"sample {sample!r}"[:60], "a column by name or number"
        raise InputError(
            path, "the file has columns, not samples", found=found, accepted=accepted, key="spectrum.column"
        )
    place = sample_choice.chosen(path, content, sample, geometry)
    chosen = content[place]
    if len(content) > 1:
        notes = [*notes, f"sample {place + 1} of {len(content)} was read ({chosen.name[:60]})"]
    own = sample_choice.stated_geometry(chosen)
    name = f"{UNSCALED} {own.upper()}" if own else UNSCALED
    unclear = sample_choice.unclear_label(chosen) or sample_choice.unclear_opposite(place, content)
    doubts = (*chosen.doubts, *([doubt(unclear)] if unclear else []))
    values = np.column_stack([chosen.wavelength, chosen.values])
    title = {"nm": "wavelength [nm]", "um": "wavelength [µm]"}.get(chosen.unit, "wavelength")
    lines = np.zeros(len(values), dtype=np.int64)
    return Columns(path.name, chosen.header, (title, name), values, lines, tuple(notes), doubts)

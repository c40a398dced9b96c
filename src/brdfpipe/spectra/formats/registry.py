"""The formats of spectrum files, and reading one spectrum of a file.

What a file states (unit, scale, number of points) is checked against what it holds: a truncated or damaged file is refused, never read
in part.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from brdfpipe.columns import Columns
from brdfpipe.errors import InputError, abbreviated
from brdfpipe.file_formats import format_of
from brdfpipe.spectra.formats import cgats, cxf, excel, jcamp, perkinelmer, qtx, text
from brdfpipe.spectra.formats.base import UNSCALED, SpectrumFormat

FORMATS: dict[str, SpectrumFormat] = {
    module.FORMAT.name: module.FORMAT for module in (text, perkinelmer, qtx, cxf, jcamp, cgats, excel)
}
"""Formats of spectrum files by name. To add one, write a module like :mod:`.qtx` and list it above."""

_MOST_NAMES = 10
"""Names of samples that a message lists."""


def read(path: Path, format: str | None = None, sample: int | str | None = None) -> Columns:
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
    place = _place(path, [known.name for known in content], sample)
    chosen = content[place]
    if len(content) > 1:
        notes = [*notes, f"sample {place + 1} of {len(content)} was read ({chosen.name[:60]})"]
    values = np.column_stack([chosen.wavelength, chosen.values])
    title = {"nm": "wavelength [nm]", "um": "wavelength [µm]"}.get(chosen.unit, "wavelength")
    lines = np.zeros(len(values), dtype=np.int64)
    return Columns(path.name, chosen.header, (title, UNSCALED), values, lines, tuple(notes), chosen.doubts)


def _place(path: Path, names: Sequence[str], sample: int | str | None) -> int:
    """Position of the chosen sample, counted from 0."""
    if not names:
        raise InputError(path, "no reflectance spectrum in the file", key="spectrum.file")
    if sample is None and len(names) == 1:
        return 0
    if isinstance(sample, int) and not isinstance(sample, bool) and 1 <= sample <= len(names):
        return sample - 1
    wanted = sample.strip().casefold() if isinstance(sample, str) else None
    matches = [i for i, name in enumerate(names) if name.strip().casefold() == wanted]
    if len(matches) == 1:
        return matches[0]
    shown = abbreviated(names, _MOST_NAMES)
    problem, accepted = "unknown sample; the file has one", f"1 or {shown}, or no key"
    if len(names) > 1:
        problem = f"the file has {len(names)} samples; choose one"
        accepted = f"1 to {len(names)}, or one of {shown}"
    raise InputError(
        path,
        "ambiguous sample name" if matches else problem,
        found=None if sample is None else repr(sample)[:60],
        accepted=accepted,
        key="spectrum.sample",
    )

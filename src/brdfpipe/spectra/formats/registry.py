"""Which format a spectrum file has, and reading one spectrum of it.

The extension or an explicit format decides how a file is read, and what a file states (unit, scale, number of points) is
checked against what it holds: a truncated or damaged file is refused, never read in part.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.spectra.formats import cgats, cxf, excel, jcamp, perkinelmer, qtx, text
from brdfpipe.spectra.formats.sample import UNSCALED, Sample, SpectrumFormat

FORMATS: dict[str, SpectrumFormat] = {
    module.FORMAT.name: module.FORMAT for module in (text, perkinelmer, qtx, cxf, jcamp, cgats, excel)
}
"""Formats of spectrum files by name. To add one, write a module like :mod:`.qtx` and list it above."""

_MOST_NAMES = 10
"""Names of samples that a message lists."""


def extensions() -> tuple[str, ...]:
    """Extensions of all formats, sorted."""
    return tuple(sorted(extension for known in FORMATS.values() for extension in known.extensions))


def read(path: Path, format: str | None = None, sample: int | str | None = None) -> Columns:
    """Read one spectrum from a file of any known format.

    Parameters
    ----------
    path : see :data:`FORMATS`
    format : a key of :data:`FORMATS`; by default from the extension
    sample : number (from 1) or name, where the file holds several

    Returns
    -------
    Columns : all columns of a table; of other formats wavelength and reflectance of the sample

    Raises
    ------
    InputError : unknown format, damaged or truncated content, several samples and none chosen.
    """
    content, notes = _format_of(path, format).read(path)
    if not isinstance(content, Columns):
        return _one(path, content, sample, notes)
    if sample is not None:
        raise InputError(
            path,
            "the file has columns, not samples",
            found=f"sample {sample!r}"[:60],
            accepted="a column by name or number",
            key="spectrum.column",
        )
    return content


def _format_of(path: Path, name: str | None) -> SpectrumFormat:
    if name is not None:
        if name not in FORMATS:
            raise InputError(
                path, "unknown format", found=repr(name)[:40], accepted=", ".join(FORMATS), key="spectrum.format"
            )
        return FORMATS[name]
    for known in FORMATS.values():
        if path.suffix.lower() in known.extensions:
            return known
    raise InputError(
        path,
        "unknown file extension",
        found=path.suffix or "no extension",
        accepted=f"{', '.join(extensions())}; or set the format, or export the spectrum as text",
        key="spectrum.format",
    )


def _one(path: Path, samples: Sequence[Sample], sample: int | str | None, notes: Sequence[str]) -> Columns:
    names = [known.name for known in samples]
    if not samples:
        raise InputError(path, "no reflectance spectrum in the file", key="spectrum.file")
    if sample is None and len(samples) == 1:
        place = 0
    elif isinstance(sample, int) and not isinstance(sample, bool) and 1 <= sample <= len(samples):
        place = sample - 1
    else:
        requested = sample.strip().casefold() if isinstance(sample, str) else None
        matching = [i for i, name in enumerate(names) if name.strip().casefold() == requested]
        if len(matching) != 1:
            shown = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
            several = len(samples) > 1
            problem = (
                f"the file has {len(samples)} samples; choose one" if several else "unknown sample; the file has one"
            )
            raise InputError(
                path,
                problem if not matching else "ambiguous sample name",
                found=None if sample is None else repr(sample)[:60],
                accepted=f"1 to {len(samples)}, or one of {shown}" if several else f"1 or {shown}, or no key",
                key="spectrum.sample",
            )
        place = matching[0]
    chosen = samples[place]
    if len(samples) > 1:
        notes = [*notes, f"sample {place + 1} of {len(samples)} was read ({chosen.name[:60]})"]
    values = np.column_stack([chosen.wavelength, chosen.values])
    title = {"nm": "wavelength [nm]", "um": "wavelength [µm]"}.get(chosen.unit, "wavelength")
    lines = np.zeros(len(values), dtype=np.int64)
    return Columns(path.name, chosen.header, (title, UNSCALED), values, lines, tuple(notes), chosen.doubts)

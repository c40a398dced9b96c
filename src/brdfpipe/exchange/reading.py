"""Reading the files of other programs: the format by name, by suffix, or by the beginning of the file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import xarray as xr

from brdfpipe.errors import InputError
from brdfpipe.exchange.read_table import as_bsdf
from brdfpipe.exchange.registry import FORMATS, LISTED, QUANTITIES, Format

_ACCEPTED = f"a format that is read; {LISTED}"

_BEGINNING = 2**16
"""Bytes in which the word of a format is searched."""


def read(path: str | os.PathLike[str], format: str | None = None, *, quantity: str | None = None) -> xr.Dataset:
    """Read a table of a BSDF.

    Parameters
    ----------
    path : the file
    format : a key of :data:`brdfpipe.exchange.registry.FORMATS`; by default that of the suffix and of the beginning of the file
    quantity : what the values are, ``brdf``, ``brdf_cos`` or ``pi_brdf``; by default what the format or the file says

    Returns
    -------
    Dataset of kind ``bsdf``, see :func:`brdfpipe.exchange.read_table.as_bsdf`; attribute ``file_format``

    Raises
    ------
    InputError : the file cannot be read, or contradicts itself.
    """
    path = Path(path)
    if quantity is not None and quantity not in QUANTITIES:
        raise InputError(
            path, "unknown quantity", found=repr(quantity)[:40], accepted=", ".join(QUANTITIES), key="table.quantity"
        )
    if not path.is_file():
        raise InputError(path, "no such file", accepted="a file of a BSDF", key="table.file")
    if not path.stat().st_size:
        raise InputError(path, "the file is empty", accepted="a file of a BSDF", key="table.file")
    declared = format_of(path, format)
    found = declared.function(declared.read)(path)
    bsdf = as_bsdf(found if quantity is None else replace(found, quantity=quantity), path)
    return bsdf.assign_attrs(file_format=declared.name)


def format_of(path: Path, name: str | None = None) -> Format:
    """The format of a file that can be read.

    Raises InputError: none, or several, have such a suffix and beginning.
    """
    readable = {known.name: known for known in FORMATS.values() if known.read}
    if name is not None:
        if name not in readable:
            raise InputError(path, "unknown format", found=repr(name)[:40], accepted=_ACCEPTED, key="table.format")
        return readable[name]
    with path.open("rb") as file:
        # With a line end before the first line, a word may stand for the beginning of any line.
        beginning = b"\n" + file.read(_BEGINNING)
    file_name = path.name.lower()
    matches = []
    for known in readable.values():
        ends = any(file_name.endswith(Path(f"name{suffix}").suffix) for suffix in known.readable_suffixes)
        if ends and (not known.begins or any(word.encode() in beginning for word in known.begins)):
            matches.append(known)
    # A format with a longer suffix of its own, such as .parameters.json.
    lengths = [
        max((len(one) for one in known.readable_suffixes if file_name.endswith(one)), default=0) for known in matches
    ]
    matches = [known for known, length in zip(matches, lengths, strict=True) if length == max(lengths)]
    if len(matches) == 1:
        return matches[0]
    accepted = ", ".join(known.name for known in matches) or _ACCEPTED
    problem = "several formats have such files" if matches else "no format has such files"
    written = [
        known.name
        for known in FORMATS.values()
        if not known.read and any(file_name.endswith(suffix) for side in known.files for suffix in known.suffixes(side))
    ]
    if written and not matches:
        problem = f"files of {written[0]} are written, not read"
    raise InputError(path, problem, found=path.suffix or "no suffix", accepted=accepted, key="table.format")

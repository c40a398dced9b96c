"""Refractive indices from ``material.yaml``: numbers, names, tables, formulas."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import columns, vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.geometry import Array
from brdfpipe.optics import dispersion

SUFFIXES = (*columns.TEXT_SUFFIXES, *dispersion.SUFFIXES)
"""Extensions of the files read."""
INDEX_SPAN = (360.0, 780.0)
"""Wavelengths a constant index is stored at [nm]; it holds at every other too."""

_D_LINE = 587.56
NAMED_INDEX: Mapping[str, tuple[float, str]] = {
    name: (
        float(dispersion.evaluate(known.value, _D_LINE))
        if isinstance(known.value, dispersion.Formula)
        else known.value,
        known.source,
    )
    for name, known in dispersion.NAMED.items()
}
"""Refractive index n_d (587.56 nm) of materials by name, with its source; :data:`brdfpipe.optics.dispersion.NAMED` has their formulas."""

_KEY = "index"
_ACCEPTED_N = "1 <= n < 5"
_ACCEPTED_NK = f"{_ACCEPTED_N} where k = 0, 0 < n < 5 and 0 < k < 20 where the material absorbs"


def refractive_index(
    spec: float | str | PathLike[str] | Mapping[str, Any] | xr.Dataset, path: str | PathLike[str] | None = None
) -> xr.Dataset:
    """Refractive index of a material from ``material.yaml``.

    Parameters
    ----------
    spec : a number (1 <= n < 5); a name of :data:`NAMED_INDEX`, in any case; ``{"n": …, "k": …}``, as of a metal; ``{"file": …}``
        or a path: a text table of wavelength [nm or µm], n and, as an option, k, or a file of refractiveindex.info
        (.yml, .yaml); or an ``index`` dataset, returned as it is
    path : path of the file of ``{"file": …}``, if it differs from that name

    Returns
    -------
    Dataset of kind ``index``: ``n(wavelength)``, ``k(wavelength)`` [1]; attributes ``source`` and ``dispersion`` (constant,
    table or formula). A constant is stored at 360 and 780 nm, a formula every 5 nm of 360–830 nm, as far as it holds.

    Raises
    ------
    InputError : unknown name (with the nearest), values outside the accepted range, a table or formula that does not cover
        400–700 nm.
    """
    if isinstance(spec, xr.Dataset):
        return vocabulary.validate(spec, "index")
    if isinstance(spec, Real) and not isinstance(spec, bool):
        return _constant(float(spec), "constant from material.yaml")
    if isinstance(spec, str):
        return _named(spec)
    if isinstance(spec, PathLike):
        return _from_file(Path(spec))
    if isinstance(spec, Mapping) and set(spec) == {"file"} and isinstance(spec["file"], str):
        return _from_file(Path(path if path is not None else spec["file"]))
    if isinstance(spec, Mapping) and set(spec) == {"n", "k"}:
        return _complex(spec["n"], spec["k"])
    if isinstance(spec, Mapping) and set(spec) == {"n"}:
        raise without_k("material.yaml", spec["n"])
    raise InputError(
        "material.yaml",
        "not a refractive index",
        where=_KEY,
        found=repr(spec)[:60],
        accepted="a number, a name, {n, k} or {file: table.txt or page.yml}",
        key=_KEY,
    )


def without_k(file: str | PathLike[str], n: object) -> InputError:
    """The error for ``{n: …}`` without k: a dielectric is given as a number, a metal as n and k."""
    plain = f"`index: {n}` of a clear or coloured body, or " if isinstance(n, int | float) and 1 <= n < 5 else ""
    accepted = f"{plain}`index: {{n: {n}, k: …}}` of a metal, with k above 0"
    return InputError(Path(file), "the key 'k' is missing", where=_KEY, accepted=accepted)


def interpolate_index(index: xr.Dataset, wavelength: ArrayLike) -> tuple[Array, Array]:
    """Index at other wavelengths, linear between those stored.

    Parameters
    ----------
    index : kind ``index``
    wavelength : nm, any shape

    Returns
    -------
    n, k : arrays of the shape of ``wavelength``

    Raises
    ------
    BrdfpipeError : a wavelength is outside the table (a constant index holds everywhere).
    """
    vocabulary.validate(index, "index")
    requested = np.asarray(wavelength, dtype=float)
    known = index["wavelength"].values
    if not np.isfinite(requested).all():
        raise BrdfpipeError("the wavelength is not finite; accepted: finite nm")
    outside = (requested < known[0]) | (requested > known[-1])
    if index.attrs.get("dispersion") != "constant" and outside.any():
        raise BrdfpipeError(
            f"the refractive index ({index.attrs['source']}) is known from {known[0]:g} to {known[-1]:g} nm; "
            f"asked for {requested.min():g} to {requested.max():g} nm"
        )
    return np.interp(requested, known, index["n"].values), np.interp(requested, known, index["k"].values)


def _named(name: str) -> xr.Dataset:
    spellings = {"".join(known.split()).casefold(): known for known in NAMED_INDEX}
    spelling = "".join(name.split()).casefold()
    if spelling not in spellings:
        nearest = difflib.get_close_matches(spelling, spellings, n=1, cutoff=0.5)
        hint = f", nearest is {spellings[nearest[0]]}" if nearest else ""
        raise InputError(
            "material.yaml",
            f"unknown material name of a refractive index{hint}",
            where=_KEY,
            found=repr(name[:60]),
            accepted=f"{', '.join(NAMED_INDEX)}, a number, or {{file: table.txt}}",
            key=_KEY,
        )
    value, source = dispersion.NAMED[spellings[spelling]]
    source = f"{spellings[spelling]}: {source}"
    if isinstance(value, dispersion.Formula):
        return dispersion.sampled(value, source, "material.yaml", _KEY)
    return _constant(value, source)


def _constant(n: float, source: str) -> xr.Dataset:
    if not 1 <= n < 5:
        raise InputError(
            "material.yaml",
            "invalid refractive index of a dielectric",
            where=_KEY,
            found=f"{n:g}",
            accepted=_ACCEPTED_N,
            key=_KEY,
        )
    return _dataset(np.array(INDEX_SPAN), np.full(2, n), np.zeros(2), source, "constant")


def _complex(n: Any, k: Any) -> xr.Dataset:
    numbers = all(isinstance(value, Real) and not isinstance(value, bool) for value in (n, k))
    if not numbers or not _physical(np.array([n], dtype=float), np.array([k], dtype=float)).all():
        raise InputError(
            "material.yaml",
            "invalid refractive index",
            where=_KEY,
            found=f"n = {n}, k = {k}",
            accepted=_ACCEPTED_NK,
            key=_KEY,
        )
    constant = np.array(INDEX_SPAN)
    return _dataset(constant, np.full(2, float(n)), np.full(2, float(k)), "constant from material.yaml", "constant")


def _physical(n: Array, k: Array) -> NDArray[np.bool_]:
    # Only absorbing media such as metals have n below 1.
    return (n > 0) & (n < 5) & ((k > 0) | (n >= 1)) & (k >= 0) & (k < 20)


def _from_file(path: Path) -> xr.Dataset:
    suffix = path.suffix.lower()
    if suffix in dispersion.SUFFIXES:
        index = dispersion.read(path)
        _check_values(path, index["wavelength"].values, index["n"].values, index["k"].values)
        return index
    if suffix in columns.TEXT_SUFFIXES:
        return _from_table(path)
    raise InputError(
        path,
        "unknown extension of an index file",
        found=path.suffix or "no extension",
        accepted=f"wavelength, n and optionally k in {', '.join(columns.TEXT_SUFFIXES)}, or the layout of "
        f"refractiveindex.info in {', '.join(dispersion.SUFFIXES)}",
        key="index.file",
    )


def _from_table(path: Path) -> xr.Dataset:
    table = columns.read_columns(path)
    if table.values.shape[1] > 3:
        raise InputError(
            path,
            "too many columns in an index table",
            found=table.values.shape[1],
            accepted="wavelength, n and optionally k",
            key="index.file",
        )
    nm, note = columns.wavelengths(table, key="index.file")
    present = np.isfinite(nm) & np.isfinite(table.values).all(axis=1)
    wavelength, values, merged = columns.merge_duplicates(nm[present], table.values[present, 1:])
    n = values[:, 0]
    k = values[:, 1] if values.shape[1] == 2 else np.zeros_like(n)
    _check_table(path, wavelength, n, k)
    dropped = int((~present).sum())
    notes = [
        *table.notes,
        *([note] if note else []),
        *([f"{dropped} rows with missing values were dropped"] if dropped else []),
        *([f"{merged} rows of repeated wavelength were averaged"] if merged else []),
    ]
    dataset = vocabulary.add_history(_dataset(wavelength, n, k, f"table {path.name}", "table"), *notes)
    return vocabulary.add_warning(dataset, *table.doubts)


def _check_table(path: Path, wavelength: Array, n: Array, k: Array) -> None:
    missing = columns.gaps(wavelength, 400.0, 700.0, widest=150.0)
    if missing:
        raise InputError(
            path,
            "the refractive index must be known from 400 to 700 nm",
            found=", ".join(f"{a:g}–{b:g} nm missing" for a, b in missing),
            accepted="a table from 400 to 700 nm without gaps above 150 nm, or a number",
            key=_KEY,
        )
    _check_values(path, wavelength, n, k)


def _check_values(path: Path, wavelength: Array, n: Array, k: Array) -> None:
    bad = ~_physical(n, k)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            path,
            "refractive index out of range",
            where=f"{wavelength[first]:g} nm",
            found=f"n = {n[first]:g}, k = {k[first]:g}",
            accepted=_ACCEPTED_NK,
            key="index.file",
        )


def _dataset(wavelength: Array, n: Array, k: Array, source: str, dispersion: str) -> xr.Dataset:
    dataset = xr.Dataset(
        {"n": ("wavelength", n), "k": ("wavelength", k)},
        coords={"wavelength": wavelength},
        attrs={"source": source, "dispersion": dispersion},
    )
    return vocabulary.label(dataset, "index")

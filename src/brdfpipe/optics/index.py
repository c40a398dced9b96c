"""Refractive indices from ``material.yaml``: numbers, names, tables, formulas."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
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
from brdfpipe.optics.dispersion import index_dataset

INDEX_SPAN = (360.0, 780.0)
"""Wavelengths at which a constant index is stored [nm]; it applies at every wavelength."""

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
    spec: float | str | PathLike[str] | Mapping[str, Any] | xr.Dataset,
    path: str | PathLike[str] | None = None,
    *,
    uncertainty: float | None = None,
) -> xr.Dataset:
    """Refractive index of a material from ``material.yaml``.

    Parameters
    ----------
    spec : a number (1 <= n < 5); a name of :data:`NAMED_INDEX`, in any case; ``{"n": …, "k": …}``, as of a metal; ``{"file": …}``
        or a path: a text table of wavelength [nm or µm], n and, as an option, k, or a file of refractiveindex.info
        (.yml, .yaml); or an ``index`` dataset, returned as it is
    path : path of the file of ``{"file": …}``, if it differs from that name
    uncertainty : standard uncertainty of n, common to all wavelengths [1], from 0; by default none is stated

    Returns
    -------
    Dataset of kind ``index``: ``n(wavelength)``, ``k(wavelength)`` [1], and ``n_u(wavelength)`` if it is stated; attributes ``source`` and ``dispersion`` (constant,
    table or formula). A constant is stored at 360 and 780 nm, a formula every 5 nm of 360–830 nm, as far as it holds.

    Raises
    ------
    InputError : unknown name (with the nearest), values outside the accepted range, a table or formula that does not cover
        400–700 nm.
    """
    index = _of_specification(spec, path)
    if uncertainty is None:
        return index
    if not uncertainty >= 0:
        raise InputError(
            Path("material.yaml"),
            "not an uncertainty",
            where="index_uncertainty",
            found=uncertainty,
            accepted="from 0 on",
        )
    return vocabulary.label(index.assign(n_u=xr.full_like(index["n"], uncertainty).drop_attrs()), "index")


def _of_specification(
    spec: float | str | PathLike[str] | Mapping[str, Any] | xr.Dataset, path: str | PathLike[str] | None
) -> xr.Dataset:
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
        raise missing_k_error("material.yaml", spec["n"])
    raise _refusal(
        "not a refractive index", repr(spec)[:60], "a number, a name, {n, k} or {file: table.txt or page.yml}"
    )


def missing_k_error(file: str | PathLike[str], n: object) -> InputError:
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
        accepted = f"{', '.join(NAMED_INDEX)}, a number, or {{file: table.txt}}"
        raise _refusal(f"unknown material name of a refractive index{hint}", repr(name[:60]), accepted)
    value, source = dispersion.NAMED[spellings[spelling]]
    source = f"{spellings[spelling]}: {source}"
    if isinstance(value, dispersion.Formula):
        return dispersion.sampled(value, source)
    return _constant(value, source)


def _constant(n: float, source: str) -> xr.Dataset:
    if not 1 <= n < 5:
        raise _refusal("invalid refractive index of a dielectric", f"{n:g}", _ACCEPTED_N)
    return index_dataset(np.array(INDEX_SPAN), np.full(2, n), np.zeros(2), source, "constant")


def _complex(n: Any, k: Any) -> xr.Dataset:
    numbers = all(isinstance(value, Real) and not isinstance(value, bool) for value in (n, k))
    if not numbers or not _physical(np.array([n], dtype=float), np.array([k], dtype=float)).all():
        raise _refusal("invalid refractive index", f"n = {n}, k = {k}", _ACCEPTED_NK)
    n, k = np.full(2, float(n)), np.full(2, float(k))
    return index_dataset(np.array(INDEX_SPAN), n, k, "constant from material.yaml", "constant")


def _refusal(problem: str, found: str, accepted: str) -> InputError:
    return InputError("material.yaml", problem, where=_KEY, found=found, accepted=accepted, key=_KEY)


def _physical(n: Array, k: Array) -> NDArray[np.bool_]:
    # Only absorbing media such as metals have n below 1.
    return (n > 0) & (n < 5) & ((k > 0) | (n >= 1)) & (k >= 0) & (k < 20)


def _read_table(path: Path) -> xr.Dataset:
    """Refractive index from a text table of wavelength, n and optionally k."""
    table = columns.read_spectral_table(path, "index.file", "wavelength, n and optionally k", most=2, widest=150.0)
    n = table.values[:, 0]
    k = table.values[:, 1] if table.values.shape[1] == 2 else np.zeros_like(n)
    dataset = index_dataset(table.wavelength, n, k, f"table {path.name}", "table")
    return vocabulary.add_warning(vocabulary.add_history(dataset, *table.notes), *table.doubts)


READERS: Mapping[str, Callable[[Path], xr.Dataset]] = {
    **dict.fromkeys(columns.TEXT_SUFFIXES, _read_table),
    **dict.fromkeys(dispersion.SUFFIXES, dispersion.read),
}
"""Reader of an index file by its extension."""


def _from_file(path: Path) -> xr.Dataset:
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            path,
            "unknown extension of an index file",
            found=path.suffix or "no extension",
            accepted=f"wavelength, n and optionally k in {', '.join(columns.TEXT_SUFFIXES)}, or the layout of "
            f"refractiveindex.info in {', '.join(dispersion.SUFFIXES)}",
            key="index.file",
        )
    index = reader(path)
    wavelength, n, k = (index[name].values for name in ("wavelength", "n", "k"))
    invalid = np.flatnonzero(~_physical(n, k))
    if invalid.size:
        first = invalid[0]
        raise InputError(
            path,
            "refractive index out of range",
            where=f"{wavelength[first]:g} nm",
            found=f"n = {n[first]:g}, k = {k[first]:g}",
            accepted=_ACCEPTED_NK,
            key="index.file",
        )
    return index

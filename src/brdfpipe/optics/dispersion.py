"""Dispersion formulas, files in the layout of refractiveindex.info, and the indices of named materials."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import columns, documents, vocabulary
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array

SUFFIXES = (".yaml", ".yml")
"""Extensions read in the layout of refractiveindex.info."""
STEP = 5.0
"""Step of the wavelengths at which a formula is stored [nm]; linear interpolation between them is accurate to 2e-5 in n."""
STORED_SPAN = (360.0, 830.0)
"""Wavelengths that are stored, as far as an index is known there [nm]."""

_REQUIRED = (400.0, 700.0)
_LATEST_START = 500.0
_SELLMEIER = (1, 2)
_WIDEST_GAP = 150.0


class Formula(NamedTuple):
    """A dispersion formula with its coefficients and the range it was fitted in."""

    number: int
    """1 to 5, as refractiveindex.info numbers them."""
    coefficients: tuple[float, ...]
    low: float
    """µm"""
    high: float
    """µm"""


class Named(NamedTuple):
    """The refractive index of a named material."""

    value: float | Formula
    source: str


_CRF = "patent US 9,395,299 (CRF)"
_SULTANOVA = "Sultanova, Kasarova & Nikolov 2009, Acta Phys. Pol. A 116, 585, Sellmeier fit by M. Polyanskiy (refractiveindex.info)"
_ZHANG = "one-term Sellmeier fit within 0.0025 to Zhang et al. 2020, Appl. Opt. 59, 2337 (n of 0.40–1.05 µm)"


def _sultanova(b: float, c: float) -> Named:
    return Named(Formula(2, (0.0, b, c), 0.4368, 1.052), _SULTANOVA)


NAMED: Mapping[str, Named] = {
    "ABS": Named(1.55, _CRF),
    "PC/ABS": Named(1.59, _CRF),
    "PP": Named(1.49, _CRF),
    "PMMA": _sultanova(1.1819, 0.011313),
    "PC": _sultanova(1.4182, 0.021304),
    "PS": _sultanova(1.4435, 0.020216),
    "SAN": _sultanova(1.3787, 0.017842),
    "SMMA": _sultanova(1.3912, 0.018282),
    "COP": _sultanova(1.2969, 0.011721),
    "cellulose": _sultanova(1.1240, 0.011087),
    "PET": Named(Formula(2, (0.0, 1.3726, 0.02155), 0.40, 1.05), _ZHANG),
    "PVC": Named(Formula(2, (0.0, 1.3314, 0.01186), 0.40, 1.05), _ZHANG),
    "PDMS": Named(
        Formula(2, (0.0, 1.0093, 0.013185), 0.35, 0.70),
        "Schneider et al. 2009, Sens. Actuators A 151, 95 (Sylgard 184)",
    ),
    "N-BK7": Named(
        Formula(2, (0.0, 1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653), 0.3, 2.5),
        "SCHOTT data sheet of N-BK7, 2017",
    ),
    "fused silica": Named(
        Formula(1, (0.0, 0.6961663, 0.0684043, 0.4079426, 0.1162414, 0.8974794, 9.896161), 0.21, 3.71),
        "Malitson 1965, J. Opt. Soc. Am. 55, 1205",
    ),
}
"""Refractive index of materials by name, with its source: constants, or formulas of the wavelength."""


def evaluate(formula: Formula, wavelength: ArrayLike) -> Array:
    """Refractive index of a dispersion formula, also outside its range.

    Parameters
    ----------
    formula : 1 Sellmeier, 2 Sellmeier with squared resonances, 3 polynomial, 4 the database's own, 5 Cauchy
    wavelength : nm, any shape

    Returns
    -------
    n : of the shape of ``wavelength``; NaN where n² would be negative

    References
    ----------
    Polyanskiy 2024, Sci. Data 11, 94, and the database's "Dispersion formulas".
    """
    micrometre = np.asarray(wavelength, dtype=float) / 1000
    c = np.zeros(max(17, len(formula.coefficients)))
    c[: len(formula.coefficients)] = formula.coefficients
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        n: Array = _FORMULAS[formula.number](micrometre, c)
    return np.where(np.isfinite(n), n, np.nan)


def sampled(formula: Formula, source: str, file: str | Path = "material.yaml") -> xr.Dataset:
    """Sample a formula every 5 nm over the known part of 360–830 nm: a dataset of kind ``index``.

    Parameters
    ----------
    formula : see :func:`evaluate`
    source : where it was published
    file : for messages

    Raises
    ------
    InputError : the range does not cover 400–700 nm, or n is undefined there.

    Notes
    -----
    A Sellmeier formula fitted from 500 nm or below is extrapolated to 360 nm, which the history records: its poles are at the
    absorption of the material, so the continuation is physical. Other formulas, and the long end, are never extrapolated.
    """
    low, high = formula.low * 1000, min(formula.high * 1000, STORED_SPAN[1])
    extrapolated = formula.number in _SELLMEIER and STORED_SPAN[0] < low <= _LATEST_START
    start = STORED_SPAN[0] if extrapolated else max(low, STORED_SPAN[0])
    if start > _REQUIRED[0] or high < _REQUIRED[1]:
        raise _not_covered(file, f"{low:g}–{formula.high * 1000:g} nm")
    grid = np.arange(np.ceil(start / STEP), np.floor(high / STEP) + 1) * STEP
    wavelength = np.unique(np.concatenate([[start], grid, [high]]))
    n = evaluate(formula, wavelength)
    if not np.isfinite(n).all():
        undefined = f"{wavelength[~np.isfinite(n)][0]:g} nm"
        raise _refusal(file, "the dispersion formula has no real value", "n² >= 0 and no pole", where=undefined)
    return _record_extrapolation(index_dataset(wavelength, n, np.zeros_like(n), source, "formula"), formula)


def index_dataset(wavelength: Array, n: Array, k: Array, source: str, dispersion: str) -> xr.Dataset:
    """Dataset of kind ``index``; ``dispersion`` is constant, table or formula."""
    dataset = xr.Dataset(
        {"n": ("wavelength", n), "k": ("wavelength", k)},
        coords={"wavelength": wavelength},
        attrs={"source": source, "dispersion": dispersion},
    )
    return vocabulary.label(dataset, "index")


def _record_extrapolation(dataset: xr.Dataset, formula: Formula) -> xr.Dataset:
    """Record in the history of a formula's dataset that it was extrapolated below the formula's range."""
    low, start = formula.low * 1000, float(dataset["wavelength"][0])
    if start >= low:
        return dataset
    return vocabulary.add_history(
        dataset, f"the Sellmeier formula, fitted from {low:g} nm, was extrapolated to {start:g} nm"
    )


def _sellmeier(w: Array, c: Array, power: int) -> Array:
    return np.sqrt(1 + c[0] + sum(b * w**2 / (w**2 - r**power) for b, r in zip(c[1::2], c[2::2], strict=False)))


def _power_series(w: Array, c: Array) -> Array:
    total: Array = c[0] + sum(b * w**power for b, power in zip(c[1::2], c[2::2], strict=False))
    return total


def _database(w: Array, c: Array) -> Array:
    poles = (c[i] * w ** c[i + 1] / (w**2 - c[i + 2] ** c[i + 3]) for i in (1, 5) if c[i])
    return np.sqrt(c[0] + sum(poles) + sum(b * w**power for b, power in zip(c[9::2], c[10::2], strict=False)))


_FORMULAS: Mapping[int, Callable[[Array, Array], Array]] = {
    1: lambda w, c: _sellmeier(w, c, 2),
    2: lambda w, c: _sellmeier(w, c, 1),
    3: lambda w, c: np.sqrt(_power_series(w, c)),
    4: _database,
    5: _power_series,
}


# --- files in the layout of refractiveindex.info


def read(path: Path) -> xr.Dataset:
    """Refractive index from a YAML file in the layout of refractiveindex.info.

    Parameters
    ----------
    path : ``DATA`` with formulas 1 to 5, ``tabulated n``, ``tabulated nk`` or ``tabulated k``; wavelengths in µm

    Returns
    -------
    Dataset of kind ``index`` on 360–830 nm, as far as the file goes; attribute ``source`` is its first reference

    Raises
    ------
    InputError : damaged YAML, an unknown type of data, invalid numbers, n missing, or 400–700 nm not covered.
    """
    content = documents.read_yaml(path)
    entries = content.get("DATA") if isinstance(content, Mapping) else None
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise _refusal(path, "no DATA of a refractive index", "the layout of refractiveindex.info, with DATA")
    source = f"{path.name}: {_reference(content.get('REFERENCES'))}"
    index: xr.Dataset | None = None
    extinction: Array | None = None
    formula: Formula | None = None
    for number, entry in enumerate(entries, start=1):
        block = _Block(path, f"DATA {number}", entry)
        kind = str(entry.get("type", "")).strip().lower()
        if kind in ("tabulated nk", "tabulated n") and index is None:
            table = block.table(3 if kind == "tabulated nk" else 2)
            index = _from_table(path, table[:, 0], table[:, 1], source)
            extinction = table[:, [0, 2]] if kind == "tabulated nk" else extinction
        elif kind == "tabulated k" and extinction is None:
            extinction = block.table(2)
        elif kind.startswith("formula ") and index is None:
            formula = block.formula(kind)
            index = sampled(formula, source, path)
        else:
            accepted = "formula 1 to 5, tabulated n, tabulated k, tabulated nk, each quantity once"
            raise block.refusal("unsupported type of data", accepted, repr(kind)[:60])
    if index is None:
        raise _refusal(path, "refractive index n is missing", "a formula, tabulated n or tabulated nk")
    if extinction is None:
        return index
    joined = _with_extinction(path, index, *extinction.T)
    # The range of k may leave less of the extrapolation.
    return joined if formula is None else _record_extrapolation(joined, formula)


class _Block(NamedTuple):
    """An entry of DATA, with its location for messages."""

    path: Path
    where: str
    content: Mapping[str, Any]

    def refusal(self, problem: str, accepted: str, found: str | None = None, row: int | None = None) -> InputError:
        where = self.where if row is None else f"{self.where}, row {row}"
        return _refusal(self.path, problem, accepted, found, where)

    def numbers(self, text: Any) -> Array:
        cells = str("" if text is None else text).split()
        try:
            values = np.array([float(cell) for cell in cells])
        except ValueError:
            values = np.array([np.nan])
        if not np.isfinite(values).all():
            raise self.refusal("not a number", "numbers", repr(" ".join(cells))[:60])
        return values

    def formula(self, kind: str) -> Formula:
        number = kind.removeprefix("formula ")
        if number not in map(str, _FORMULAS):
            raise self.refusal("unsupported dispersion formula", "formula 1 to 5", repr(kind)[:60])
        coefficients = self.numbers(self.content.get("coefficients"))
        span = self.numbers(self.content.get("wavelength_range"))
        if span.size != 2 or not 0 < span[0] < span[1] or not 1 <= coefficients.size <= 17:
            found = f"{coefficients.size} coefficients, range {' '.join(f'{value:g}' for value in span)[:40]}"
            accepted = "1 to 17 coefficients and a wavelength_range of two increasing µm"
            raise self.refusal("incomplete dispersion formula", accepted, found)
        return Formula(int(number), tuple(coefficients.tolist()), float(span[0]), float(span[1]))

    def table(self, width: int) -> Array:
        """Rows of increasing wavelength [nm] and ``width`` − 1 values."""
        rows = [line.split() for line in str(self.content.get("data", "")).splitlines() if line.strip()]
        accepted = f"rows of {width} numbers"
        for number, row in enumerate(rows, start=1):
            if len(row) != width:
                raise self.refusal("incomplete table", accepted, f"{len(row)} columns", number)
        if not rows:
            raise self.refusal("incomplete table", accepted, "nothing")
        table = self.numbers(" ".join(cell for row in rows for cell in row)).reshape(-1, width)
        falls = np.flatnonzero(np.diff(table[:, 0]) <= 0)
        if falls.size:
            raise self.refusal("the wavelengths do not increase", "increasing µm", row=int(falls[0]) + 2)
        # Rounded, since 0.4368 µm becomes 436.79999999999995 nm.
        return np.column_stack([np.round(table[:, 0] * 1000, 6), table[:, 1:]])


def _from_table(path: Path, nm: Array, n: Array, source: str) -> xr.Dataset:
    _check_coverage(path, nm)
    low, high = max(nm[0], STORED_SPAN[0]), min(nm[-1], STORED_SPAN[1])
    wavelength = np.concatenate([[low], nm[(nm > low) & (nm < high)], [high]])
    return index_dataset(wavelength, np.interp(wavelength, nm, n), np.zeros(wavelength.size), source, "table")


def _with_extinction(path: Path, index: xr.Dataset, nm: Array, k: Array) -> xr.Dataset:
    """The index with k of a table, on the wavelengths of both in their common range."""
    _check_coverage(path, nm)
    known = index["wavelength"].values
    low, high = max(known[0], nm[0]), min(known[-1], nm[-1])
    wavelength = np.unique(np.concatenate([known, nm, [low, high]]))
    wavelength = wavelength[(wavelength >= low) & (wavelength <= high)]
    n = np.interp(wavelength, known, index["n"].values)
    return index_dataset(wavelength, n, np.interp(wavelength, nm, k), index.attrs["source"], index.attrs["dispersion"])


def _check_coverage(path: Path, nm: Array) -> None:
    if columns.gaps(nm, *_REQUIRED, widest=_WIDEST_GAP):
        raise _not_covered(path, f"{nm[0]:g}–{nm[-1]:g} nm in {nm.size} rows")


def _not_covered(file: str | Path, found: str) -> InputError:
    accepted = "400–700 nm; a Sellmeier formula (1 or 2) may start as late as 500 nm"
    return _refusal(file, "the refractive index must be known from 400 to 700 nm", accepted, found)


def _refusal(
    file: str | Path, problem: str, accepted: str, found: str | None = None, where: str | None = None
) -> InputError:
    return InputError(file, problem, where=where, found=found, accepted=accepted, key="index.file")


def _reference(text: Any) -> str:
    """The first reference as plain text, without the HTML tags of the database."""
    plain = re.sub(r"<[^>]*(>|$)|>", "", str(text or "no reference given")[:2000])
    return textwrap.shorten(plain, 200, placeholder=" …")

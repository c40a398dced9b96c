"""Dispersion formulas, files in the layout of refractiveindex.info, and the indices of named materials."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
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
"""Step of the wavelengths a formula is stored at [nm]; linear interpolation between them is accurate to 2e-5 in n."""
KEPT = (360.0, 830.0)
"""Wavelengths of interest [nm]."""

_REQUIRED = (400.0, 700.0)
_LATEST_START = 0.5
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


def sampled(formula: Formula, source: str, file: str, key: str) -> xr.Dataset:
    """Sample a formula every 5 nm over the known part of 360–830 nm: a dataset of kind ``index``.

    Parameters
    ----------
    formula : see :func:`evaluate`
    source : where it was published
    file, key : for messages

    Raises
    ------
    InputError : the range does not cover 400–700 nm, or n is undefined there.

    Notes
    -----
    A Sellmeier formula fitted from 500 nm or below is extrapolated to 360 nm, which the history records: its poles are at the
    absorption of the material, so the continuation is physical. Other formulas, and the long end, are never extrapolated.
    """
    low, high = formula.low * 1000, min(formula.high * 1000, KEPT[1])
    extrapolated = formula.number in _SELLMEIER and KEPT[0] < low <= _LATEST_START * 1000
    start = KEPT[0] if extrapolated else max(low, KEPT[0])
    if start > _REQUIRED[0] or high < _REQUIRED[1]:
        raise _no_coverage(file, f"{low:g}–{formula.high * 1000:g} nm", key)
    grid = np.arange(np.ceil(start / STEP), np.floor(high / STEP) + 1) * STEP
    wavelength = np.unique(np.concatenate([[start], grid, [high]]))
    n = evaluate(formula, wavelength)
    if not np.isfinite(n).all():
        bad = float(wavelength[~np.isfinite(n)][0])
        raise InputError(
            file,
            "the dispersion formula has no real value",
            where=f"{bad:g} nm",
            accepted="n² >= 0 and no pole",
            key=key,
        )
    dataset = _dataset(wavelength, n, np.zeros_like(n), source, "formula")
    return _record_extrapolation(dataset, formula)


def _record_extrapolation(dataset: xr.Dataset, formula: Formula) -> xr.Dataset:
    """Record in the history of a formula's dataset that it was extrapolated below the formula's range."""
    low, start = formula.low * 1000, float(dataset["wavelength"][0])
    if start >= low:
        return dataset
    return vocabulary.add_history(
        dataset, f"the Sellmeier formula, fitted from {low:g} nm, was extrapolated to {start:g} nm"
    )


def read(path: Path, key: str = "index.file") -> xr.Dataset:
    """Refractive index from a YAML file in the layout of refractiveindex.info.

    Parameters
    ----------
    path : ``DATA`` with formulas 1 to 5, ``tabulated n``, ``tabulated nk`` or ``tabulated k``; wavelengths in µm
    key : of material.yaml, for messages

    Returns
    -------
    Dataset of kind ``index`` on 360–830 nm, as far as the file goes; attribute ``source`` is its first reference

    Raises
    ------
    InputError : damaged YAML, an unknown type of data, invalid numbers, n missing, or 400–700 nm not covered.
    """
    content = documents.plain(path)
    blocks = content.get("DATA") if isinstance(content, Mapping) else None
    if not isinstance(blocks, list) or not all(isinstance(block, Mapping) for block in blocks):
        raise InputError(
            path, "no DATA of a refractive index", accepted="the layout of refractiveindex.info, with DATA", key=key
        )
    source = f"{path.name}: {_reference(content.get('REFERENCES'))}"
    real: xr.Dataset | None = None
    imaginary: tuple[Array, Array] | None = None
    fitted: Formula | None = None
    for place, block in enumerate(blocks, start=1):
        kind, where = str(block.get("type", "")).strip().lower(), f"DATA {place}"
        if kind in ("tabulated nk", "tabulated n") and real is None:
            real, both = _tabulated(path, where, block, kind, source, key)
            imaginary = both if kind == "tabulated nk" else imaginary
        elif kind == "tabulated k" and imaginary is None:
            table = _table(path, where, block, 2)
            imaginary = (table[:, 0], table[:, 1])
        elif kind.startswith("formula ") and real is None:
            fitted = _formula(path, where, block, kind)
            real = sampled(fitted, source, path.name, key)
        else:
            raise InputError(
                path,
                "unsupported type of data",
                where=where,
                found=repr(kind)[:60],
                accepted="formula 1 to 5, tabulated n, tabulated k, tabulated nk, each quantity once",
                key=key,
            )
    if real is None:
        raise InputError(
            path, "refractive index n is missing", accepted="a formula, tabulated n or tabulated nk", key=key
        )
    if imaginary is None:
        return real
    joined = _with_extinction(path, real, imaginary, key)
    # The range of k may leave less of the extrapolation.
    return joined if fitted is None else _record_extrapolation(joined, fitted)


def _sellmeier(w: Array, c: Array) -> Array:
    return np.sqrt(1 + c[0] + sum(b * w**2 / (w**2 - r**2) for b, r in zip(c[1::2], c[2::2], strict=False)))


def _sellmeier_squared(w: Array, c: Array) -> Array:
    return np.sqrt(1 + c[0] + sum(b * w**2 / (w**2 - r) for b, r in zip(c[1::2], c[2::2], strict=False)))


def _power_series(w: Array, c: Array) -> Array:
    total: Array = c[0] + sum(b * w**power for b, power in zip(c[1::2], c[2::2], strict=False))
    return total


def _database(w: Array, c: Array) -> Array:
    poles = (c[i] * w ** c[i + 1] / (w**2 - c[i + 2] ** c[i + 3]) for i in (1, 5) if c[i])
    return np.sqrt(c[0] + sum(poles) + sum(b * w**power for b, power in zip(c[9::2], c[10::2], strict=False)))


_FORMULAS: Mapping[int, Callable[[Array, Array], Array]] = {
    1: _sellmeier,
    2: _sellmeier_squared,
    3: lambda w, c: np.sqrt(_power_series(w, c)),
    4: _database,
    5: _power_series,
}


def _formula(path: Path, where: str, block: Mapping[str, Any], kind: str) -> Formula:
    number = kind.removeprefix("formula ")
    if number not in map(str, _FORMULAS):
        raise InputError(
            path,
            "unsupported dispersion formula",
            where=where,
            found=repr(kind)[:60],
            accepted="formula 1 to 5",
            key="index",
        )
    coefficients = _numbers(path, where, block.get("coefficients"))
    span = _numbers(path, where, block.get("wavelength_range"))
    if span.size != 2 or not 0 < span[0] < span[1] or not 1 <= coefficients.size <= 17:
        raise InputError(
            path,
            "incomplete dispersion formula",
            where=where,
            found=f"{coefficients.size} coefficients, range {' '.join(f'{value:g}' for value in span)[:40]}",
            accepted="1 to 17 coefficients and a wavelength_range of two increasing µm",
            key="index.file",
        )
    return Formula(int(number), tuple(coefficients.tolist()), float(span[0]), float(span[1]))


def _tabulated(
    path: Path, where: str, block: Mapping[str, Any], kind: str, source: str, key: str
) -> tuple[xr.Dataset, tuple[Array, Array]]:
    table = _table(path, where, block, 3 if kind == "tabulated nk" else 2)
    nm, n = table[:, 0], table[:, 1]
    _check_coverage(path, nm, key)
    low, high = max(nm[0], KEPT[0]), min(nm[-1], KEPT[1])
    wavelength = np.concatenate([[low], nm[(nm > low) & (nm < high)], [high]])
    n = np.interp(wavelength, nm, n)
    return _dataset(wavelength, n, np.zeros_like(n), source, "table"), (nm, table[:, -1])


def _with_extinction(path: Path, real: xr.Dataset, imaginary: tuple[Array, Array], key: str) -> xr.Dataset:
    nm, k = imaginary
    _check_coverage(path, nm, key)
    known = real["wavelength"].values
    low, high = max(known[0], nm[0]), min(known[-1], nm[-1])
    wavelength = np.unique(np.concatenate([known, nm, [low, high]]))
    wavelength = wavelength[(wavelength >= low) & (wavelength <= high)]
    n = np.interp(wavelength, known, real["n"].values)
    return _dataset(wavelength, n, np.interp(wavelength, nm, k), real.attrs["source"], real.attrs["dispersion"])


def _table(path: Path, where: str, block: Mapping[str, Any], width: int) -> Array:
    """Rows of increasing wavelength [nm] and ``width`` − 1 values."""
    rows = [line.split() for line in str(block.get("data", "")).splitlines() if line.strip()]
    bad = next((i for i, row in enumerate(rows, start=1) if len(row) != width), None)
    if not rows or bad is not None:
        raise InputError(
            path,
            "incomplete table",
            where=where if bad is None else f"{where}, row {bad}",
            found="nothing" if bad is None else f"{len(rows[bad - 1])} columns",
            accepted=f"rows of {width} numbers",
            key="index.file",
        )
    table = _numbers(path, where, " ".join(cell for row in rows for cell in row)).reshape(-1, width)
    if (np.diff(table[:, 0]) <= 0).any():
        row = int(np.argmax(np.diff(table[:, 0]) <= 0)) + 2
        raise InputError(
            path,
            "the wavelengths do not increase",
            where=f"{where}, row {row}",
            accepted="increasing µm",
            key="index.file",
        )
    # Rounded, since 0.4368 µm becomes 436.79999999999995 nm.
    return np.column_stack([np.round(table[:, 0] * 1000, 6), table[:, 1:]])


def _numbers(path: Path, where: str, text: Any) -> Array:
    cells: Sequence[str] = str("" if text is None else text).split()
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise InputError(
            path, "not a number", where=where, found=repr(" ".join(cells))[:60], accepted="numbers", key="index.file"
        )
    return values


def _check_coverage(path: Path, nm: Array, key: str) -> None:
    missing = columns.gaps(nm, *_REQUIRED, widest=_WIDEST_GAP)
    if missing:
        raise _no_coverage(path.name, f"{nm[0]:g}–{nm[-1]:g} nm in {nm.size} rows", key)


def _no_coverage(file: str, found: str, key: str) -> InputError:
    return InputError(
        file,
        "the refractive index must be known from 400 to 700 nm",
        found=found,
        accepted="400–700 nm; a Sellmeier formula (1 or 2) may start as late as 500 nm",
        key=key,
    )


def _reference(text: Any) -> str:
    """The first reference as plain text, without the HTML tags of the database."""
    words, inside = [], False
    for character in str(text or "no reference given")[:2000]:
        inside = character == "<" or (inside and character != ">")
        words.append("" if inside or character == ">" else character)
    return textwrap.shorten("".join(words), 200, placeholder=" …")


def _dataset(wavelength: Array, n: Array, k: Array, source: str, dispersion: str) -> xr.Dataset:
    return vocabulary.label(
        xr.Dataset(
            {"n": ("wavelength", n), "k": ("wavelength", k)},
            coords={"wavelength": wavelength},
            attrs={"source": source, "dispersion": dispersion},
        ),
        "index",
    )

"""Fresnel reflection and refractive indices."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import columns, vocabulary
from brdfpipe.errors import BrdfpipeError, InputError

Array = NDArray[np.float64]

INDEX_SPAN = (360.0, 780.0)
"""Wavelengths a constant index is stored at [nm]; it holds at every other too."""

_CRF = "patent US 9,395,299 (CRF)"
_SULTANOVA = (
    "Sultanova et al. 2009, Acta Phys. Pol. A 116, 585, n at 587.6 nm of the Sellmeier fit in refractiveindex.info"
)

NAMED_INDEX: Mapping[str, tuple[float, str]] = {
    "ABS": (1.55, _CRF),
    "PC/ABS": (1.59, _CRF),
    "PP": (1.49, _CRF),
    "PMMA": (1.4906, _SULTANOVA),
    "PC": (1.5848, _SULTANOVA),
    "PS": (1.5916, _SULTANOVA),
    "SAN": (1.5665, _SULTANOVA),
}
"""Refractive index of plastics by name, with its source."""

_KEY = "index"
_ACCEPTED_N = "1 <= n < 5"
_CLOSEST_TO_METAL = 1e70
_ROUNDING = 1e-9


class Fresnel(NamedTuple):
    """Power reflectances of a smooth interface [1]."""

    s: Array
    p: Array
    mean: Array
    """For unpolarised light, the mean of s and p."""


def fresnel(cos_zeta: ArrayLike, n: ArrayLike, k: ArrayLike = 0.0) -> Fresnel:
    """Fresnel reflectance of a smooth interface, for light polarised s, p and not at all.

    Parameters
    ----------
    cos_zeta : cosine of the angle of incidence, in [0, 1]
    n : index of the far medium relative to the near one; n > 0, infinity for a perfect mirror
    k : extinction coefficient relative to the near medium, k >= 0; N = n + ik

    Returns
    -------
    F_s, F_p, F : arrays of the broadcast shape, in [0, 1]

    Raises
    ------
    BrdfpipeError : a cosine beyond rounding outside [0, 1], n <= 0, k < 0 or infinite, or NaN anywhere.

    Notes
    -----
    With q = √(N² − sin²ζ) the amplitudes (cos ζ − q)/(cos ζ + q) and (N² cos ζ − q)/(N² cos ζ + q) are written as
    −(N² − 1)/(cos ζ + q)² and (N² − 1)[(N² + 1) cos²ζ − 1]/(N² cos ζ + q)²: the textbook form cancels as N → 1.
    Total internal reflection (n < 1 and sin ζ >= n, k = 0) gives 1, n = 1 gives 0, grazing incidence on n ≠ 1 gives 1.

    References
    ----------
    Born & Wolf, Principles of Optics, 7th ed., §1.5.2 and §14.2.
    """
    c, n, k = _checked_cosine(cos_zeta), _checked_index(n), _checked_extinction(k)
    mirror, c_zero = n > _CLOSEST_TO_METAL, c == 0
    n = np.where(mirror, 2.0, n)
    absent = (n == 1) & (k == 0)
    contrast = (n - 1) * (n + 1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if k.any():
            f_s, f_p = _absorbing(c, n, k)
            total = (k == 0) & (contrast + c * c <= 0)
        else:
            f_s, f_p = _transparent(c, n, contrast)
            total = contrast + c * c <= 0
    one = (mirror | total | c_zero) & ~absent
    f_s, f_p = (np.where(one, 1.0, np.where(absent, 0.0, np.minimum(f, 1.0))) for f in (f_s, f_p))
    return Fresnel(f_s, f_p, (f_s + f_p) / 2)


def _transparent(c: Array, n: Array, contrast: Array) -> tuple[Array, Array]:
    q = np.sqrt(np.maximum(contrast + c * c, 0.0))
    r_s = contrast / (c + q) ** 2
    into_p = n * n * c + q
    r_p = (contrast / into_p) * (((n * n + 1) * (c * c) - 1) / into_p)
    return r_s * r_s, r_p * r_p


def _absorbing(c: Array, n: Array, k: Array) -> tuple[Array, Array]:
    index = n + 1j * k
    contrast = (index - 1) * (index + 1)
    q = np.sqrt(contrast + c * c)
    r_s = contrast / (c + q) ** 2
    into_p = index * index * c + q
    r_p = (contrast / into_p) * (((index * index + 1) * (c * c) - 1) / into_p)
    f_s: Array = np.abs(r_s) ** 2
    f_p: Array = np.abs(r_p) ** 2
    return f_s, f_p


def _checked_cosine(cos_zeta: ArrayLike) -> Array:
    c = np.asarray(cos_zeta, dtype=float)
    # NaN fails the comparison, and so is refused with the rest.
    if c.size and not (c.min() >= -_ROUNDING and c.max() <= 1 + _ROUNDING):
        raise BrdfpipeError(f"cos_zeta spans {c.min():g} to {c.max():g}; accepted: cosines in [0, 1]")
    clipped: Array = np.clip(c, 0.0, 1.0)
    return clipped


def _checked_index(n: ArrayLike) -> Array:
    if np.iscomplexobj(n):
        raise BrdfpipeError("n is complex; accepted: the real part as n, the imaginary part as k")
    values = np.asarray(n, dtype=float)
    if values.size and not values.min() > 0:
        raise BrdfpipeError(f"refractive index n is {values.min():g} somewhere; accepted: n > 0")
    return values


def _checked_extinction(k: ArrayLike) -> Array:
    values = np.asarray(k, dtype=float)
    if values.size and not (values.min() >= 0 and values.max() < _CLOSEST_TO_METAL):
        raise BrdfpipeError(
            f"extinction coefficient k spans {values.min():g} to {values.max():g}; accepted: finite k >= 0"
        )
    return values


def refractive_index(
    spec: float | str | PathLike[str] | Mapping[str, Any] | xr.Dataset, path: str | PathLike[str] | None = None
) -> xr.Dataset:
    """Refractive index of a material, as ``material.yaml`` gives it.

    Parameters
    ----------
    spec : a number (1 <= n < 5); a name of :data:`NAMED_INDEX`, in any case; ``{"file": …}`` or a path: a text table of
        wavelength [nm or µm], n and, as an option, k; or an ``index`` dataset, returned as it is
    path : where the file of ``{"file": …}`` lies, if not at that name

    Returns
    -------
    Dataset of kind ``index``: ``n(wavelength)``, ``k(wavelength)`` [1]; attributes ``source`` and ``dispersion`` (constant or
    table). A constant is stored at 360 and 780 nm.

    Raises
    ------
    InputError : unknown name (with the nearest), values outside the accepted range, a table that does not cover 400–700 nm.
    """
    if isinstance(spec, xr.Dataset):
        return vocabulary.validate(spec, "index")
    if isinstance(spec, Real) and not isinstance(spec, bool):
        return _constant(float(spec), "constant from material.yaml")
    if isinstance(spec, str):
        return _named(spec)
    if isinstance(spec, PathLike):
        return _from_table(Path(spec))
    if isinstance(spec, Mapping) and set(spec) == {"file"} and isinstance(spec["file"], str):
        return _from_table(Path(path if path is not None else spec["file"]))
    raise InputError(
        "material.yaml",
        "no refractive index",
        where=_KEY,
        found=repr(spec)[:60],
        accepted="a number, a name, or {file: table.txt}",
        key=_KEY,
    )


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
    BrdfpipeError : a wavelength lies outside the table (a constant index holds everywhere).
    """
    vocabulary.validate(index, "index")
    wanted = np.asarray(wavelength, dtype=float)
    known = index["wavelength"].values
    if not np.isfinite(wanted).all():
        raise BrdfpipeError("wavelength has undefined values; accepted: finite nm")
    outside = (wanted < known[0]) | (wanted > known[-1])
    if index.attrs.get("dispersion") != "constant" and outside.any():
        raise BrdfpipeError(
            f"the refractive index ({index.attrs['source']}) is known from {known[0]:g} to {known[-1]:g} nm; "
            f"asked for {wanted.min():g} to {wanted.max():g} nm"
        )
    return np.interp(wanted, known, index["n"].values), np.interp(wanted, known, index["k"].values)


def _named(name: str) -> xr.Dataset:
    spellings = {known.casefold(): known for known in NAMED_INDEX}
    wanted = "".join(name.split()).casefold()
    if wanted not in spellings:
        nearest = difflib.get_close_matches(wanted, spellings, n=1, cutoff=0.5)
        hint = f", nearest is {spellings[nearest[0]]}" if nearest else ""
        raise InputError(
            "material.yaml",
            f"no refractive index is known under this name{hint}",
            where=_KEY,
            found=repr(name[:60]),
            accepted=f"{', '.join(NAMED_INDEX)}, a number, or {{file: table.txt}}",
            key=_KEY,
        )
    n, source = NAMED_INDEX[spellings[wanted]]
    return _constant(n, f"{spellings[wanted]}: {source}")


def _constant(n: float, source: str) -> xr.Dataset:
    if not 1 <= n < 5:
        raise InputError(
            "material.yaml",
            "no refractive index of a dielectric",
            where=_KEY,
            found=f"{n:g}",
            accepted=_ACCEPTED_N,
            key=_KEY,
        )
    return _dataset(np.array(INDEX_SPAN), np.full(2, n), np.zeros(2), source, "constant")


def _from_table(path: Path) -> xr.Dataset:
    if path.suffix.lower() not in columns.TEXT_SUFFIXES:
        raise InputError(
            path,
            "not a text table",
            found=path.suffix or "no extension",
            accepted=f"wavelength, n and optionally k in {', '.join(columns.TEXT_SUFFIXES)}",
            key="index.file",
        )
    table = columns.read_columns(path)
    if table.values.shape[1] > 3:
        raise InputError(
            path,
            "too many columns",
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
    return vocabulary.add_history(_dataset(wavelength, n, k, f"table {path.name}", "table"), *notes)


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
    # Metals have n below 1; a transparent medium in air has not.
    bad = (n <= 0) | (n >= 5) | ((k == 0) & (n < 1)) | (k < 0) | (k >= 20)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            path,
            "no refractive index",
            where=f"{wavelength[first]:g} nm",
            found=f"n = {n[first]:g}, k = {k[first]:g}",
            accepted=f"{_ACCEPTED_N} where k = 0, 0 < n < 5 and 0 < k < 20 where the material absorbs",
            key="index.file",
        )


def _dataset(wavelength: Array, n: Array, k: Array, source: str, dispersion: str) -> xr.Dataset:
    dataset = xr.Dataset(
        {"n": ("wavelength", n), "k": ("wavelength", k)},
        coords={"wavelength": wavelength},
        attrs={"source": source, "dispersion": dispersion},
    )
    return vocabulary.label(dataset, "index")

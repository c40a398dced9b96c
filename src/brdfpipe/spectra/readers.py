"""Reflectance spectra from the files that spectrophotometers and spreadsheets write."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import columns, vocabulary
from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.spectra.formats import registry

GEOMETRIES = ("sci", "sce")
"""Specular component included or excluded."""
SCALES = ("fraction", "percent")

_REQUIRED = (400.0, 700.0)
_KEPT = (360.0, 830.0)
_WIDEST_GAP = 25.0
_DARKEST_PERCENT = 2.0
_BRIGHTEST = 1.1
_NOISE = 0.01
_SPIKE, _RELATIVE_SPIKE = 0.001, 0.02
"""Tolerated deviation of a single value from its neighbours: absolute, and relative to them."""
_NEAR, _WINDOW = 3, 20
"""Neighbours on either side from which the curvature and the noise of a spectrum are estimated."""
_OUTLIER = 10.0
"""Limit over the median deviation of values from their neighbours: nearly 7 standard deviations of normal noise."""
_END = 20.0
"""Limit over the curvature of the neighbours at the first and last value, since whites fall steeply into the ultraviolet."""
_BREAK = 0.1
_STEEPER = 6.0
_REPEATABILITY = 0.02

_PERCENT_WORD = r"(?:%|percent|prozent|pour\s?cent|per\s?cento)"
# A number before the sign is a condition (45 %RH, 5 % of gloss), unless it is the white of the scale.
_PERCENT = re.compile(
    rf"(?:\b100\s?{_PERCENT_WORD}|(?<!\d)(?<!\d\s){_PERCENT_WORD})(?!\s?(?:r\.?\s?h\b|rel|hum|feucht))", re.IGNORECASE
)
_FRACTION = re.compile(r"fraction|anteil|\b0\s?(?:-|–|to|\.\.)\s?1\b", re.IGNORECASE)
_ABOUT_VALUES = re.compile(r"refl|remission|rückstr|y\s?units|scale|%\s?R\b|\bR\s?[\[(%]", re.IGNORECASE)
_NO_REFLECTANCE = re.compile(r"transmi|absorb|extinction|\bk/s\b|%\s?T\b|\bT\s?[\[(%]", re.IGNORECASE)
_DOUBT = (
    r"(?:u|u\d\d|unc|uncert|uncertainty|std|std\.?[\s_]?dev\.?|stdev|st\.?\s?dev\.?|sd|sigma|σ|err|error|var|variance"
    r"|standard[\s_-]?(?:dev|deviation|unc|uncertainty|error)\.?|(?:expanded|rel|relative)[\s_.]+(?:u|unc|uncertainty|std)"
    r"|standardabweichung|(?:mess)?unsicherheit|écart[\s-]type|incertitude)[²2]?"
)
_UNCERTAINTY = re.compile(
    rf"\s*(?:\d(?:[.,]\d+)?\s?)?{_DOUBT}(?![^\W_]).*|.*(?<=[\s_]){_DOUBT}\s*(?:[\[(,].*)?", re.IGNORECASE
)
"""Titles that begin or end with a whole word for an uncertainty: u_R, R_std, Standardabweichung; not uncoated."""
_BARE_STANDARD = re.compile(r"\s*std\s*", re.IGNORECASE)
_BATCH = re.compile(r"bat|batch|trl|trial|smp|spl|sample|probe", re.IGNORECASE)
_COVERAGE = re.compile(
    r"\bk\s?=\s?(\d+(?:[.,]\d+)?)|(?<![\d.,])(\d(?:[.,]\d+)?)\s?(?:σ|sigma\b|sd\b|std\b)", re.IGNORECASE
)
_SQUARED = re.compile(r"²|\^\s?2|\bvar(?:iance)?\b|(?:std|sd|sigma|σ)2\b", re.IGNORECASE)
_RELATIVE = re.compile(r"(?<![^\W_])rel(?:ative?)?(?![^\W_])|relativ|%\s?(?:of|von)\b|/\s?R\b|\bcv\b", re.IGNORECASE)
_EXPANDED = re.compile(r"\s*(?:U\d*|.*_U)(?![^\W_])|.*(?i:expanded|erweitert|\b9\d(?:\.\d+)?\s?%)")
_INCLUDED = re.compile(r"\bsci\b|\bspin\b|specular\s+(?:component\s+)?included", re.IGNORECASE)
_EXCLUDED = re.compile(r"\bsce\b|\bspex\b|specular\s+(?:component\s+)?excluded", re.IGNORECASE)
_LIGHT_FROM = re.compile(r"\blight from (\d+(?:\.\d+)?) degree")
_INCIDENCE = 8.0


@dataclass
class _Log:
    """Corrections of the reader (history), and doubts that the user should check (warnings)."""

    history: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def read_spectrum(
    path: str | PathLike[str],
    *,
    geometry: str | None = None,
    incidence: float | None = None,
    format: str | None = None,
    scale: str | None = None,
    sample: int | str | None = None,
    column: int | str | None = None,
    uncertainty: int | str | None = None,
    allow_fluorescent: bool = False,
) -> xr.Dataset:
    """Read a reflectance spectrum from a file.

    Parameters
    ----------
    path : columns of text (.csv .dat .prn .tab .tsv .txt), the first one wavelengths in nm or µm, or one row per sample below a
        header of wavelengths; or one of the other :data:`brdfpipe.spectra.formats.registry.FORMATS`
    geometry : ``sci`` or ``sce``, specular component included or excluded; by default from the file
    incidence : degree, 0 <= incidence < 90, of the measurement; by default from the file, or 8
    format : a key of :data:`brdfpipe.spectra.formats.registry.FORMATS`; by default from the extension
    sample : number (from 1) or name, if the file has several
    scale : ``fraction`` or ``percent``; required if the header does not state it and no value exceeds 2
    column : number (the wavelength is column 1) or name of the reflectance; by default the first that is not an uncertainty
    uncertainty : number or name of the column of standard uncertainties; by default the next column, if its name says so
    allow_fluorescent : accept reflectances above 1.1

    Returns
    -------
    Dataset of kind ``spectrum`` on the file's own wavelengths within 360–830 nm: ``total_reflectance`` [1] and, where the file
    has it, ``total_reflectance_u`` (k = 1). Every correction is in its history; its warnings name signs of damage (outliers,
    jumps, lost rows, truncated numbers) and contradictions to the parameters.

    Raises
    ------
    InputError : with the file, the value found, the accepted values and the key of material.yaml to set.
    """
    path = Path(path)
    _check_options(path, geometry, incidence, scale)
    table = registry.read(path, format, sample)
    log = _Log(list(table.notes), [f"{table.file}: {doubt}." for doubt in table.doubts])
    nm, note = columns.wavelengths(table, key="spectrum.file")
    log.history += [note] if note else []
    value, deviation = _choose(table, column, uncertainty, log)
    divisor = _divisor(table, value, nm, scale, log)
    wavelength, reflectance, u = _ordered(table, nm, value, deviation, divisor, log)
    _warn_of_spikes(table.file, wavelength, reflectance, columns.last_digit(table.values[:, value]) / divisor, log)
    _warn_of_breaks(table.file, wavelength, reflectance, log)
    reflectance = _checked_values(table.file, wavelength, reflectance, allow_fluorescent, log)
    included, angle = _geometry(table, value, geometry, log), _incidence(table, incidence, log)
    return _dataset(wavelength, reflectance, u, included, angle, log)


def _check_options(path: Path, geometry: str | None, incidence: float | None, scale: str | None) -> None:
    if geometry is not None and geometry not in GEOMETRIES:
        raise _no_geometry(path, geometry)
    if incidence is not None and not 0 <= incidence < 90:
        raise InputError(
            path,
            "invalid incidence angle",
            found=repr(incidence)[:40],
            accepted="0 <= degree < 90",
            key="spectrum.incidence",
        )
    if scale is not None and scale not in SCALES:
        raise InputError(
            path, "unknown scale", found=repr(scale)[:40], accepted=" or ".join(SCALES), key="spectrum.scale"
        )


def _choose(
    table: Columns, column: int | str | None, uncertainty: int | str | None, log: _Log
) -> tuple[int, int | None]:
    """Columns of the reflectance and of its standard uncertainty, counted from 0."""
    width, names = table.values.shape[1], table.names
    named = {i for i in range(1, width) if names and _is_uncertainty(names[i], names)}
    values = [i for i in range(1, width) if i not in named]
    if column is not None:
        value = _position(table, column, "spectrum.column")
    elif values:
        value = values[0]
    else:
        raise InputError(
            table.file,
            "every column is an uncertainty; no column of reflectances",
            found=", ".join(names or ()),
            accepted="a number or name",
            key="spectrum.column",
        )
    if uncertainty is not None:
        deviation: int | None = _position(table, uncertainty, "spectrum.uncertainty")
    else:
        deviation = value + 1 if value + 1 in named else None
    if deviation is not None and (problem := _unusable(table, value, deviation)):
        if uncertainty is not None:
            raise InputError(
                table.file,
                f"{_title(table, deviation)} is not a standard uncertainty",
                found=problem,
                accepted="absolute standard uncertainties (k = 1, or `k = …` in the title), none below 0",
                key="spectrum.uncertainty",
            )
        log.warnings.append(
            f"{table.file}: the uncertainty in {_title(table, deviation)} was ignored: {problem}. Give absolute standard "
            "uncertainties, or the coverage factor in the title, as in `U (k=2)`."
        )
        refused, deviation = deviation, None
    else:
        refused = None
    if deviation is not None:
        k = _coverage_factor(table, deviation)
        how = f", after division by k = {k:g}" if k != 1 else ""
        log.history.append(f"{_title(table, deviation)} was read as the standard uncertainty (k = 1){how}")
    unused = [_title(table, i) for i in range(1, width) if i not in (value, deviation, refused)]
    if unused:
        sentence = f"{table.file}: {_title(table, value)} was read; ignored: {', '.join(unused)}"
        log.history.append(sentence)
        if column is None:
            log.warnings.append(f"{sentence}. Name the column to read with `spectrum.column` in material.yaml.")
    return value, deviation


def _is_uncertainty(title: str, names: Sequence[str]) -> bool:
    if _BARE_STANDARD.fullmatch(title) and any(_BATCH.fullmatch(name.strip()) for name in names):
        return False  # beside a batch, STD is the standard of the comparison
    return _UNCERTAINTY.fullmatch(title) is not None


def _unusable(table: Columns, value: int, deviation: int) -> str:
    """Why a column cannot hold absolute standard uncertainties; empty if it can."""
    title = table.names[deviation] if table.names else ""
    if _SQUARED.search(title):
        return "it is squared, a variance"
    if _RELATIVE.search(title):
        return "it is relative to the reflectance"
    if _PERCENT.search(title) and table.names and not _PERCENT.search(table.names[value]):
        return "it is in percent but the title of the reflectance is not, so it may be relative"
    if _EXPANDED.match(title) and not _COVERAGE.search(title):
        return "it is expanded, and the title does not state the coverage factor k"
    if _coverage_factor(table, deviation) <= 0:
        return "its coverage factor is 0"
    column = table.values[:, deviation]
    if (column < 0).any():
        return f"{int((column < 0).sum())} values are negative, the first in line {table.lines[np.argmax(column < 0)]}"
    return ""


def _coverage_factor(table: Columns, deviation: int) -> float:
    """Coverage factor k of an uncertainty from its title; 1 by default."""
    match = _COVERAGE.search(table.names[deviation]) if table.names else None
    return float((match[1] or match[2]).replace(",", ".")) if match else 1.0


def _u_divisor(table: Columns, deviation: int, divisor: float, log: _Log) -> float:
    """Divisor that converts the file's uncertainties to standard uncertainties of a reflectance in [0, 1]."""
    title = table.names[deviation] if table.names else ""
    k = _coverage_factor(table, deviation)
    if divisor == 1 or _PERCENT.search(title) or not title:
        return k * divisor
    if _FRACTION.search(title) or re.search(r"[\[(]\s?[1-]\s?[\])]", title):
        return k
    log.warnings.append(
        f"{table.file}: {_title(table, deviation)} has no unit; percent was assumed, the unit of the reflectance. Write "
        f"`{title} [%]` or `{title} [1]` as its title."
    )
    return k * divisor


def _position(table: Columns, column: int | str, key: str) -> int:
    width = table.values.shape[1]
    if isinstance(column, int) and not isinstance(column, bool) and 2 <= column <= width:
        return column - 1
    if isinstance(column, str) and table.names:
        matches = [i for i, name in enumerate(table.names) if i and name.casefold() == column.strip().casefold()]
        if len(matches) == 1:
            return matches[0]
    accepted = f"2 to {width}" + (
        f", or one of {', '.join(table.names[1:])}" if table.names else " (the columns have no names)"
    )
    raise InputError(table.file, "unknown column", found=repr(column)[:60], accepted=accepted, key=key)


def _title(table: Columns, i: int) -> str:
    return f"column {i + 1}" + (f" ({table.names[i]})" if table.names else "")


def _divisor(table: Columns, value: int, nm: Array, scale: str | None, log: _Log) -> float:
    """Divisor that converts the file's values to a reflectance in [0, 1]."""
    present = table.values[np.isfinite(nm) & np.isfinite(table.values[:, value]), value]
    largest = float(present.max()) if present.size else 0.0
    stated = _stated_scale(table, value)
    if scale is not None and stated is not None and scale != stated:
        log.warnings.append(
            f"{table.file}: the header says {stated}; `spectrum.scale: {scale}` in material.yaml was used. "
            "Remove the key if the header is right."
        )
    if scale is None and stated is None and largest < _DARKEST_PERCENT:
        raise InputError(
            table.file,
            "ambiguous scale: fraction, or percent of a dark sample",
            found=f"values up to {largest:g}, no unit in the header",
            accepted=" or ".join(SCALES),
            key="spectrum.scale",
        )
    if (scale or stated) == "fraction" and largest >= _DARKEST_PERCENT:
        raise InputError(
            table.file,
            "the scale is `fraction`, but values exceed 1",
            found=f"up to {largest:g}",
            accepted="values up to 1 (1.1 if fluorescent), or percent",
            key="spectrum.scale",
        )
    if (scale or stated) == "fraction":
        return 1.0
    if scale is None and stated is not None and largest <= 1:
        log.warnings.append(
            f"{table.file}: the header says percent, but no value exceeds {largest:g}. If they are fractions, set `spectrum.scale: "
            "fraction`; if the sample is that dark, `percent`."
        )
    how = "" if scale or stated else f": the header states no scale, and values reach {largest:g}"
    log.history.append(f"percent was converted to a fraction{how}")
    return 100.0


def _stated_scale(table: Columns, value: int) -> str | None:
    titles = [table.names[value]] if table.names else []
    for text in [*titles, *(line for line in table.header if _ABOUT_VALUES.search(line))]:
        if _NO_REFLECTANCE.search(text) and not re.search("refl", text, re.IGNORECASE):
            raise InputError(
                table.file, "not a reflectance", found=repr(text[:60]), accepted="reflectance", key="spectrum.column"
            )
        percent, fraction = bool(_PERCENT.search(text)), bool(_FRACTION.search(text))
        if percent != fraction:
            return "percent" if percent else "fraction"
    return None


def _ordered(
    table: Columns, nm: Array, value: int, deviation: int | None, divisor: float, log: _Log
) -> tuple[Array, Array, Array | None]:
    """Sorted, unique wavelengths within the range of interest, with their reflectance and uncertainty."""
    u_divisors: list[float] = []
    unit_log = _Log()
    if deviation is not None:
        u_divisors = [_u_divisor(table, deviation, divisor, unit_log)]
    values = table.values[:, [value] if deviation is None else [value, deviation]] / np.array([divisor, *u_divisors])
    whole = nm[(nm >= _KEPT[0]) & (nm <= _KEPT[1])]
    valid = np.isfinite(nm) & np.isfinite(values[:, 0])
    if not valid.all():
        log.history.append(f"{int((~valid).sum())} rows without a value were dropped")
    nm, values = nm[valid], values[valid]
    steps = np.diff(nm)
    if (steps < 0).any():
        log.history.append("rows were sorted by wavelength")
    if (steps < 0).any() and (steps > 0).any() and np.unique(nm).size == nm.size:
        log.warnings.append(
            f"{table.file}: the wavelengths are not monotonic. Look for a mistyped one, or sort the rows."
        )
    log.warnings += [
        f"{table.file}: the step from {low:g} to {high:g} nm differs from the others. Look for a lost row or a mistyped wavelength."
        for low, high in columns.odd_steps(np.unique(whole))
    ]
    raw = values[:, 0].copy()
    # Mean squares of uncertainties: repeated readings are not assumed to be independent.
    values[:, 1:] **= 2
    wavelength, values, merged = columns.merge_duplicates(nm, values)
    if merged:
        log.history.append(f"{merged} rows of repeated wavelength were averaged")
        mean = np.interp(nm, wavelength, values[:, 0])
        apart = np.abs(raw - mean)
        if (apart > _REPEATABILITY * np.abs(mean) + _SPIKE).any():
            log.warnings.append(
                f"{table.file}: readings at {nm[np.argmax(apart)]:g} nm differ by {apart.max():.3g} from their mean. Look for a "
                "mistyped wavelength, or for two samples in one file."
            )
    _require_coverage(table.file, wavelength)
    in_range = (wavelength >= _KEPT[0]) & (wavelength <= _KEPT[1])
    if not in_range.all():
        log.history.append(f"{int((~in_range).sum())} wavelengths outside {_KEPT[0]:g}–{_KEPT[1]:g} nm were left out")
    u = np.sqrt(values[in_range, 1]) if deviation is not None else None
    if u is not None and np.isnan(u).any():
        absent = wavelength[in_range][np.isnan(u)]
        unit_log.warnings.append(
            f"{table.file}: the uncertainty is missing at {absent.size} wavelengths from {absent[0]:g} to {absent[-1]:g} nm, and "
            "stays missing in the result. Complete the column, or remove it."
        )
    largest_u = float(np.nan_to_num(u).max()) if u is not None else 0.0
    if largest_u > 0.5 * values[in_range, 0].max():
        log.warnings.append(
            f"{table.file}: the uncertainty reaches {largest_u:.3g}, more than half the largest reflectance. Is it a second "
            "sample? Rename the column in the file if it is."
        )
    log.warnings += unit_log.warnings
    return wavelength[in_range], values[in_range, 0], u


def _require_coverage(file: str, wavelength: Array) -> None:
    missing = columns.gaps(wavelength, *_REQUIRED, widest=_WIDEST_GAP)
    if not missing:
        return
    coverage = f"covers {wavelength[0]:g}–{wavelength[-1]:g} nm, " if wavelength.size else ""
    holes = " and ".join(f"{low:g}–{high:g} nm" for low, high in missing)
    raise InputError(
        file,
        "the spectrum must cover 400–700 nm",
        found=f"{coverage}{holes} {'is' if len(missing) == 1 else 'are'} missing",
        accepted=f"400–700 nm in steps of at most {_WIDEST_GAP:g} nm",
        key="spectrum.file",
    )


def _warn_of_spikes(file: str, wavelength: Array, reflectance: Array, digit: float, log: _Log) -> None:
    """Warn about outliers from the line through their neighbours: mistyped or damaged digits."""
    if wavelength.size < 5:
        return
    between = _from_neighbours(wavelength, reflectance)
    off = np.abs(reflectance - between)
    least = np.maximum(_SPIKE, _RELATIVE_SPIKE * np.abs(between)) + 2 * digit
    usual = np.maximum(_usual_bend(wavelength, reflectance), _OUTLIER * np.nanmedian(_around(off, _WINDOW), axis=1))
    # A wrong value also shifts the deviation of its neighbours, by half as much.
    farthest = off >= np.nanmax(_around(np.concatenate([[0.0], off[1:-1], [0.0]]), 1), axis=1)
    for i in np.flatnonzero(farthest & (off > np.maximum(least, usual))).tolist():
        log.warnings.append(
            f"{file}: {reflectance[i]:.4g} at {wavelength[i]:g} nm differs by {off[i]:.2g} from its neighbours. Look for a "
            "mistyped or damaged value."
        )


def _from_neighbours(wavelength: Array, reflectance: Array) -> Array:
    """Linear prediction of each value from its two neighbours; at the ends from the two nearest."""
    size = wavelength.size
    first = np.concatenate([[1], np.arange(size - 2), [size - 3]])
    second = np.concatenate([[2], np.arange(2, size), [size - 2]])
    slope = (reflectance[second] - reflectance[first]) / (wavelength[second] - wavelength[first])
    return np.asarray(reflectance[first] + slope * (wavelength - wavelength[first]))


def _usual_bend(wavelength: Array, reflectance: Array) -> Array:
    """Deviation from the neighbours that is normal at their curvature, on edges and peaks."""
    x, y = _around(wavelength, _NEAR), _around(reflectance, _NEAR)
    # One further neighbour is left out, the one that gives the smallest curvature: it may be damaged too. Not at the ends.
    fewer = np.min([_bend(np.delete(x, k, axis=1), np.delete(y, k, axis=1)) for k in range(2 * _NEAR)], axis=0)
    bend = np.where(np.isnan(y).any(axis=1), _bend(x, y), fewer)
    step = np.diff(wavelength)
    before, after = step[:-1], step[1:]
    room = np.concatenate([[_END * step[0]], 4 * before * after / (before + after), [_END * step[-1]]])
    return np.asarray(room * bend)


def _bend(x: Array, y: Array) -> Array:
    """Largest change of slope along each row; 0 if there are too few values."""
    change = np.abs(np.diff(np.diff(y, axis=1) / np.diff(x, axis=1), axis=1))
    return np.asarray(np.where(np.isnan(change), 0.0, change).max(axis=1))


def _around(values: Array, reach: int) -> Array:
    """(n, 2 reach) neighbours of each value on either side, without the value itself."""
    near = np.arange(values.size)[:, None] + np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)])
    missing = (near < 0) | (near >= values.size)
    return np.where(missing, np.nan, values[np.clip(near, 0, values.size - 1)])


def _warn_of_breaks(file: str, wavelength: Array, reflectance: Array, log: _Log) -> None:
    """Warn about a jump between two nearly level parts: lost, repeated or interchanged values."""
    rise = np.diff(reflectance)
    slope = np.abs(rise / np.diff(wavelength))
    for i in np.flatnonzero(np.abs(rise) > _BREAK).tolist():
        around = np.concatenate([slope[max(i - 2, 0) : i], slope[i + 1 : i + 3]])
        if slope[i] > _STEEPER * around.max(initial=0.0):
            log.warnings.append(
                f"{file}: the reflectance jumps by {abs(rise[i]):.3g} from {wavelength[i]:g} to {wavelength[i + 1]:g} nm. Look "
                "for missing, repeated or damaged values."
            )


def _checked_values(file: str, wavelength: Array, reflectance: Array, allow_fluorescent: bool, log: _Log) -> Array:
    lowest, highest = int(np.argmin(reflectance)), int(np.argmax(reflectance))
    if reflectance[lowest] < -_NOISE:
        raise InputError(
            file,
            "negative reflectance",
            where=f"{wavelength[lowest]:g} nm",
            found=f"{reflectance[lowest]:.4g}",
            accepted=f"noise down to -{_NOISE:g}; check zero calibration and column",
            key="spectrum.column",
        )
    if reflectance[highest] > _BRIGHTEST and not allow_fluorescent:
        raise InputError(
            file,
            "reflectance above 1",
            where=f"{wavelength[highest]:g} nm",
            found=f"{reflectance[highest]:.4g}",
            accepted=f"up to {_BRIGHTEST:g}; `allow_fluorescent: true` for fluorescent samples",
            key="spectrum.allow_fluorescent",
        )
    above = wavelength[reflectance > 1]
    if above.size:
        log.warnings.append(
            f"{file}: the reflectance exceeds 1 at {above.size} wavelengths from {above[0]:g} to {above[-1]:g} nm "
            f"(up to {reflectance[highest]:.4g}). Check the white calibration; the BRDF of a fluorescent sample is not defined by this spectrum."
        )
    if reflectance[lowest] < 0:
        log.history.append(f"{int((reflectance < 0).sum())} reflectances between -{_NOISE:g} and 0 were set to 0")
    return np.maximum(reflectance, 0.0)


def _geometry(table: Columns, value: int, geometry: str | None, log: _Log) -> str:
    """Specular component included or excluded: from material.yaml, or else from the file."""
    words = " ".join([*table.header, table.names[value] if table.names else ""])
    included, excluded = bool(_INCLUDED.search(words)), bool(_EXCLUDED.search(words))
    stated = "sci" if included and not excluded else "sce" if excluded and not included else None
    if geometry is None and stated is None:
        raise _no_geometry(table.file, None)
    if geometry is None or stated is None:
        if geometry is None:
            log.history.append(f"geometry {stated} was read from the file")
        return str(geometry or stated)
    if stated != geometry:
        statement = next((line for line in table.header if line.startswith("SingleAngle")), stated.upper()).partition(
            ":"
        )[0]
        log.warnings.append(
            f"{table.file}: the header says {statement}; `spectrum.geometry: {geometry}` in material.yaml was used. "
            "Correct the key if the header is right (SCE: specular excluded)."
        )
    return geometry


def _incidence(table: Columns, incidence: float | None, log: _Log) -> float:
    """Angle of incidence in degree: from material.yaml, or else from the file."""
    match = _LIGHT_FROM.search(" ".join(table.header))
    stated = float(match[1]) if match and float(match[1]) < 90 else None
    if incidence is None or stated is None or abs(incidence - stated) < 1:
        return next((angle for angle in (incidence, stated) if angle is not None), _INCIDENCE)
    log.warnings.append(
        f"{table.file}: the header says light from {stated:g} degree; `spectrum.incidence: {incidence:g}` in "
        f"material.yaml was used. Set the key to {stated:g} if the header is right."
    )
    return incidence


def _no_geometry(file: str | Path, geometry: str | None) -> InputError:
    return InputError(
        file,
        "specular reflection included or excluded: not stated",
        found=None if geometry is None else repr(geometry)[:40],
        accepted="sci (included) or sce (excluded)",
        key="spectrum.geometry",
    )


def _dataset(
    wavelength: Array, reflectance: Array, u: Array | None, geometry: str, incidence: float, log: _Log
) -> xr.Dataset:
    variables: Mapping[str, Any] = {"total_reflectance": ("wavelength", reflectance)}
    if u is not None:
        variables = {**variables, "total_reflectance_u": ("wavelength", u)}
    attrs = {"geometry": geometry, "theta_i": float(incidence), "method": "measured"}
    dataset = xr.Dataset(variables, coords={"wavelength": wavelength}, attrs=attrs)
    dataset = vocabulary.label(dataset, "spectrum")
    if log.history:
        dataset = vocabulary.add_history(dataset, *log.history)
    return vocabulary.add_warning(dataset, *log.warnings) if log.warnings else dataset

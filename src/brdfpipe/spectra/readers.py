"""Reflectance spectra from the files that spectrophotometers and spreadsheets write."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import columns, vocabulary
from brdfpipe.columns import Columns
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.spectra import column_choice, damage, header_words, specular_words
from brdfpipe.spectra.column_choice import in_words, title_of
from brdfpipe.spectra.formats import registry
from brdfpipe.spectra.specular_words import KnownGeometry

GEOMETRIES = ("sci", "sce")
"""Specular component included or excluded."""
SCALES = ("fraction", "percent")

_REQUIRED = (400.0, 700.0)
_RANGE = (360.0, 830.0)
"""Wavelengths that a spectrum must cover, and those that are read [nm]."""
_WIDEST_GAP = 25.0
SCALE_DOUBT = "If they are fractions, set `spectrum.scale: fraction`"
"""In warnings of values that are read as percent and may be fractions."""

_DARKEST_PERCENT = 2.0
_DARKEST_INCLUDED = 1.6
"""Reflectance with the specular included of a smooth black surface of index 1.29, the lowest of a solid plastic [percent]."""
_BRIGHTEST = 1.1
_NOISE = 0.01
_REPEATABILITY, _ABSOLUTE_REPEATABILITY = 0.02, 0.001
"""Tolerated deviation of repeated readings from their mean: relative to it, and absolute."""
_INCIDENCE = 8.0


@dataclass
class _Log:
    """Corrections of the reader (history), and doubts that the user should check (warnings)."""

    file: str
    history: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def warn(self, *sentences: str) -> None:
        self.warnings += [f"{self.file}: {sentence}" for sentence in sentences]


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
    fallbacks: Collection[str] = (),
) -> xr.Dataset:
    """Read a reflectance spectrum from a file.

    Parameters
    ----------
    path : columns of text (.csv .dat .prn .tab .tsv .txt), the first one wavelengths in nm or µm, or one row per sample below a
        header of wavelengths; or one of the other :data:`brdfpipe.spectra.formats.registry.FORMATS`
    geometry : ``sci`` or ``sce``, specular component included or excluded; by default from the file
    incidence : degree, 0 <= incidence < 90, of the measurement; by default from the file, or 8
    format : a key of :data:`brdfpipe.spectra.formats.registry.FORMATS`; by default from the extension
    sample : number (from 1) or name, if the file has several; of samples of one name with the cells that differ, as in ``Red, SCE``,
        unless the geometry tells them apart
    scale : ``fraction`` or ``percent``; required if the header does not state it and no value exceeds 2
    column : number (the wavelength is column 1) or name of the reflectance; by default the first that is not an uncertainty
    uncertainty : number or name of the column of standard uncertainties; by default the next column, if its name says so
    allow_fluorescent : accept reflectances above 1.1
    fallbacks : of ``geometry`` and ``incidence`` those that count only where the file states none

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
    if geometry is not None:
        check_geometry(path, geometry)
    check_incidence(path, incidence)
    if scale is not None and scale not in SCALES:
        found, accepted = repr(scale)[:40], " or ".join(SCALES)
        raise InputError(path, "unknown scale", found=found, accepted=accepted, key="spectrum.scale")
    known = KnownGeometry(geometry, "geometry" in fallbacks)
    table = registry.read(path, format, sample, known)
    log = _Log(table.file, list(table.notes))
    log.warn(*(f"{doubt}." for doubt in table.doubts))
    nm, note = columns.wavelengths(table, key="spectrum.file")
    log.history += [note] if note else []
    chosen = column_choice.chosen(table, column, uncertainty, known)
    value, deviation = chosen.value, chosen.deviation
    log.history += chosen.history
    log.warn(*chosen.warnings)
    stated_geometry = _geometry(table, value, known, log)
    divisor = _divisor(table, value, nm, scale, stated_geometry, log)
    wavelength, reflectance, u = _ordered(table, nm, value, deviation, divisor, log)
    log.warn(*damage.outliers(wavelength, reflectance, columns.last_digit(table.values[:, value]) / divisor))
    log.warn(*damage.jumps(wavelength, reflectance))
    variables = {"total_reflectance": ("wavelength", _checked_values(wavelength, reflectance, allow_fluorescent, log))}
    if u is not None:
        variables["total_reflectance_u"] = ("wavelength", u)
    attrs = {
        "geometry": stated_geometry,
        "theta_i": _incidence(table, incidence, "incidence" in fallbacks, log),
        "method": "measured",
    }
    dataset = vocabulary.label(xr.Dataset(variables, {"wavelength": wavelength}, attrs), "spectrum")
    return vocabulary.add_warning(vocabulary.add_history(dataset, *log.history), *log.warnings)


def check_geometry(file: str | Path, geometry: str | None) -> None:
    """Refuse a geometry other than ``sci`` and ``sce``; None is one that is not stated."""
    if geometry not in GEOMETRIES:
        raise InputError(
            file,
            "specular reflection included or excluded: not stated",
            found=None if geometry is None else repr(geometry)[:40],
            accepted="sci (included) or sce (excluded)",
            key="spectrum.geometry",
        )


def check_incidence(file: str | Path, incidence: float | None) -> None:
    """Refuse an angle of incidence outside [0, 90) degree; None is one that is not given."""
    if incidence is None or (
        type(incidence) is not bool and isinstance(incidence, int | float) and 0 <= incidence < 90
    ):
        return
    found, accepted = repr(incidence)[:40], "0 <= degree < 90"
    raise InputError(file, "invalid incidence angle", found=found, accepted=accepted, key="spectrum.incidence")


def _divisor(table: Columns, value: int, nm: Array, scale: str | None, geometry: str, log: _Log) -> float:
    """Divisor that converts the file's values to a reflectance in [0, 1]."""
    present = table.values[np.isfinite(nm) & np.isfinite(table.values[:, value]), value]
    largest = float(present.max()) if present.size else 0.0
    stated = header_words.scale(table.file, title_of(table, value), table.header)
    if scale is not None and stated is not None and scale != stated:
        log.warn(
            f"the header says {stated}; `spectrum.scale: {scale}` in material.yaml was used. Remove the key if the header is right."
        )
    if scale is None and stated is None and largest < _DARKEST_PERCENT:
        raise InputError(
            table.file,
            "ambiguous scale: fraction, or percent of a dark sample",
            found=f"values up to {largest:g}, no unit in the header",
            accepted=" or ".join(SCALES),
            key="spectrum.scale",
        )
    if (scale or stated) == "fraction":
        if largest < _DARKEST_PERCENT:
            return 1.0
        problem, accepted = (
            "the scale is `fraction`, but values exceed 1",
            "values up to 1 (1.1 if fluorescent), or percent",
        )
        raise InputError(table.file, problem, found=f"up to {largest:g}", accepted=accepted, key="spectrum.scale")
    if largest < _DARKEST_PERCENT:
        log.warn(_doubt_of_percent(table, largest, scale, geometry))
    how = "" if scale or stated else f": the header states no scale, and values reach {largest:g}"
    log.history.append(f"percent was converted to a fraction{how}")
    return 100.0


def _doubt_of_percent(table: Columns, largest: float, scale: str | None, geometry: str) -> str:
    """A doubt whether values below 2 are percent, as the description or the header says; refused where no surface reflects so little."""
    if geometry == "sci" and largest < _DARKEST_INCLUDED:
        says = "`scale: percent`" if scale else "percent in the header"
        raise InputError(
            table.file,
            f"the scale is wrong: with the specular included, even a smooth black surface reflects more than {_DARKEST_INCLUDED:g} percent",
            found=f"{says}, values up to {largest:g}",
            accepted="fraction, if the values run from 0 to 1; or `geometry: sce`, if the specular was excluded",
            key="spectrum.scale",
        )
    otherwise = (
        "if the specular was excluded, `spectrum.geometry: sce`"
        if geometry == "sci"
        else "if the sample is that dark, accept this warning"
    )
    return f"no value exceeds {largest:g} percent. {SCALE_DOUBT}; {otherwise}."


def _u_divisor(table: Columns, deviation: int, divisor: float, log: _Log) -> float:
    """Divisor that converts the file's uncertainties to standard uncertainties of a reflectance in [0, 1]."""
    title = title_of(table, deviation)
    k, scale = header_words.coverage_factor(title), header_words.uncertainty_scale(title)
    if divisor != 1 and scale == "fraction":
        return k
    if divisor != 1 and title and scale is None:
        log.warn(
            f"{in_words(table, deviation)} has no unit; percent was assumed, the unit of the reflectance. Write `{title} [%]` or "
            f"`{title} [1]` as its title."
        )
    return k * divisor


def _ordered(
    table: Columns, nm: Array, value: int, deviation: int | None, divisor: float, log: _Log
) -> tuple[Array, Array, Array | None]:
    """Sorted, unique wavelengths within the range of interest, with their reflectance and uncertainty."""
    values = table.values[:, [value]] / divisor
    if deviation is not None:
        u = table.values[:, [deviation]] / _u_divisor(table, deviation, divisor, log)
        values = np.concatenate([values, u], axis=1)
    odd_steps = columns.odd_steps(np.unique(nm[(nm >= _RANGE[0]) & (nm <= _RANGE[1])]))
    valid = np.isfinite(nm) & np.isfinite(values[:, 0])
    if not valid.all():
        log.history.append(f"{int((~valid).sum())} rows without a value were dropped")
    nm, values = nm[valid], values[valid]
    steps = np.diff(nm)
    if (steps < 0).any():
        log.history.append("rows were sorted by wavelength")
    if (steps < 0).any() and (steps > 0).any() and np.unique(nm).size == nm.size:
        log.warn("the wavelengths are not monotonic. Look for a mistyped one, or sort the rows.")
    log.warn(
        *(
            f"the step from {low:g} to {high:g} nm differs from the others. Look for a lost row or a mistyped wavelength."
            for low, high in odd_steps
        )
    )
    # Mean squares of uncertainties: repeated readings are not assumed to be independent.
    wavelength, means, merged = columns.merge_duplicates(nm, np.column_stack([values[:, :1], values[:, 1:] ** 2]))
    if merged:
        log.history.append(f"{merged} rows of repeated wavelength were averaged")
        mean = np.interp(nm, wavelength, means[:, 0])
        off = np.abs(values[:, 0] - mean)
        if (off > _REPEATABILITY * np.abs(mean) + _ABSOLUTE_REPEATABILITY).any():
            log.warn(
                f"readings at {nm[np.argmax(off)]:g} nm differ by {off.max():.3g} from their mean. Look for a mistyped wavelength, or for "
                "two samples in one file."
            )
    _require_coverage(table.file, wavelength)
    in_range = (wavelength >= _RANGE[0]) & (wavelength <= _RANGE[1])
    if not in_range.all():
        log.history.append(f"{int((~in_range).sum())} wavelengths outside {_RANGE[0]:g}–{_RANGE[1]:g} nm were left out")
    wavelength, reflectance = wavelength[in_range], means[in_range, 0]
    if deviation is None:
        return wavelength, reflectance, None
    uncertainty = np.sqrt(means[in_range, 1])
    absent = wavelength[np.isnan(uncertainty)]
    if absent.size:
        log.warn(
            f"the uncertainty is missing at {absent.size} wavelengths from {absent[0]:g} to {absent[-1]:g} nm, and stays missing in the "
            "result. Complete the column, or remove it."
        )
    largest = float(np.nan_to_num(uncertainty).max())
    if largest > 0.5 * reflectance.max():
        log.warn(
            f"the uncertainty reaches {largest:.3g}, more than half the largest reflectance. Is it a second sample? Rename the column in "
            "the file if it is."
        )
    return wavelength, reflectance, uncertainty


def _require_coverage(file: str, wavelength: Array) -> None:
    missing = columns.gaps(wavelength, *_REQUIRED, widest=_WIDEST_GAP)
    if not missing:
        return
    coverage = f"covers {wavelength[0]:g}–{wavelength[-1]:g} nm, " if wavelength.size else ""
    gaps = " and ".join(f"{low:g}–{high:g} nm" for low, high in missing)
    raise InputError(
        file,
        "the spectrum must cover 400–700 nm",
        found=f"{coverage}{gaps} {'is' if len(missing) == 1 else 'are'} missing",
        accepted=f"400–700 nm in steps of at most {_WIDEST_GAP:g} nm",
        key="spectrum.file",
    )


def _checked_values(wavelength: Array, reflectance: Array, allow_fluorescent: bool, log: _Log) -> Array:
    """The reflectance without noise below 0; implausible values are refused or warned about."""
    lowest, highest = int(np.argmin(reflectance)), int(np.argmax(reflectance))
    if reflectance[lowest] < -_NOISE:
        raise InputError(
            log.file,
            "negative reflectance",
            where=f"{wavelength[lowest]:g} nm",
            found=f"{reflectance[lowest]:.4g}",
            accepted=f"noise down to -{_NOISE:g}; check zero calibration and column",
            key="spectrum.column",
        )
    if reflectance[highest] > _BRIGHTEST and not allow_fluorescent:
        raise InputError(
            log.file,
            "reflectance above 1",
            where=f"{wavelength[highest]:g} nm",
            found=f"{reflectance[highest]:.4g}",
            accepted=f"up to {_BRIGHTEST:g}; `allow_fluorescent: true` for fluorescent samples",
            key="spectrum.allow_fluorescent",
        )
    above = wavelength[reflectance > 1]
    if above.size:
        log.warn(
            f"the reflectance exceeds 1 at {above.size} wavelengths from {above[0]:g} to {above[-1]:g} nm (up to {reflectance[highest]:.4g}). "
            "Check the white calibration; the BRDF of a fluorescent sample is not defined by this spectrum."
        )
    if reflectance[lowest] < 0:
        log.history.append(f"{int((reflectance < 0).sum())} reflectances between -{_NOISE:g} and 0 were set to 0")
    return np.maximum(reflectance, 0.0)


def _geometry(table: Columns, value: int, known: KnownGeometry, log: _Log) -> str:
    """Specular component included or excluded: from material.yaml, or else from the file; a fallback only where the file states none."""
    # The labels of the column count before the header, which may speak of other columns.
    stated = column_choice.stated_geometry(table, value) or column_choice.header_geometry(table)
    if stated is None and (unclear := column_choice.unclear_geometry(table, value)):
        log.warn(f"{specular_words.doubt(unclear)}.")
    geometry = known.name
    if geometry is None or (known.is_fallback and stated is not None):
        check_geometry(table.file, stated)
        instead = "" if geometry in (None, stated) else f", instead of the default {geometry}"
        log.history.append(f"geometry {stated} was read from the file{instead}")
        return str(stated)
    if stated not in (None, geometry):
        single_angle = next((line for line in table.header if line.startswith("SingleAngle")), str(stated).upper())
        log.warn(
            f"the header says {single_angle.partition(':')[0]}; `spectrum.geometry: {geometry}` in material.yaml was used. Correct the "
            "key if the header is right (SCE: specular excluded)."
        )
    return geometry


def _incidence(table: Columns, incidence: float | None, is_fallback: bool, log: _Log) -> float:
    """Angle of incidence in degree: from material.yaml, or else from the file; a fallback only where the file states none."""
    stated = header_words.incidence(" ".join(table.header))
    if incidence is None:
        return _INCIDENCE if stated is None else stated
    if is_fallback and stated is not None:
        if stated != incidence:
            log.history.append(f"incidence {stated:g}° was read from the file, instead of the default {incidence:g}°")
        return stated
    if stated is not None and abs(incidence - stated) >= 1:
        log.warn(
            f"the header says light from {stated:g} degree; `spectrum.incidence: {incidence:g}` in material.yaml was used. Set the key to "
            f"{stated:g} if the header is right."
        )
    return float(incidence)

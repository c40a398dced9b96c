"""Read colours measured at several geometries, from a CSV file or from material.yaml."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.columns import read_text
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.flakes.geometries import ACCEPTED, Directions, directions, refuse_mixed_signs
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")

_FEWEST, _MOST = 3, 1000
_BRIGHTEST = 100.0
"""Largest accepted reflectance factor; the brightest flakes near the gloss reach about ten."""
_CHROMATIC = 500.0
_STEP = 1e-3
"""Step of L*, a* and b* in numerical derivatives."""
_LAB = {"l": "L", "l*": "L", "a": "a", "a*": "a", "b": "b", "b*": "b"}
_XYZ = {"x": "X", "y": "Y", "z": "Z"}
_WAVELENGTH = re.compile(r"r?_?(\d{3,4}(?:[.,]\d+)?)\s*(?:nm)?", re.IGNORECASE)
_UNCERTAIN = re.compile(
    r"(?:u|std|sd|sigma|σ)[\s_(]+(?P<after>[^()]+)\)?|(?P<before>.+?)[\s_]+(?:u|std|sd|sigma|σ)", re.IGNORECASE
)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


class _Rows(NamedTuple):
    """Colours in the units of the file."""

    file: str
    where: tuple[str, ...]
    """Location of each row, for messages"""
    names: tuple[str, ...]
    directions: tuple[Directions, ...]
    kind: str
    """lab, xyz or reflectance"""
    values: Array
    wavelength: Array | None
    uncertainty: Array | None = None
    """Standard uncertainties, shaped like the values"""
    notes: tuple[str, ...] = ()


def ingest(spec: Mapping[str, Any], path: str | PathLike[str] | None = None) -> xr.Dataset:
    """Colours at several geometries from the ``multiangle`` section of material.yaml.

    Parameters
    ----------
    spec : ``{file}`` or ``{colours}``, a list of ``{geometry or theta_i, phi_i, theta_o, phi_o; lab, xyz or reflectance}`` of
        the same kind, with ``wavelength`` [nm] for reflectances; ``illuminant`` and ``observer`` of L*a*b* and XYZ; ``scale`` (fraction or
        percent) of reflectance factors. Of a CSV file the first line names the columns: ``geometry`` or the four angles, then
        L, a, b or X, Y, Z or wavelengths, and ``u_L``, ``u_a``, ``u_b`` (or ``u_X`` …, ``u_400`` …) where standard uncertainties
        are known; or ``colour_uncertainty`` is that of each value, in its unit. XYZ are on the scale of Y = 100 for the perfect diffuser
    path : path of the file, if it differs from the name in ``spec``

    Returns
    -------
    Dataset of kind ``multiangle``: ``tristimulus(geometry, channel)`` with attributes ``illuminant`` and ``observer``, or
        ``reflectance_factor(geometry, wavelength)``; ``theta_i``, ``phi_i``, ``theta_o``, ``phi_o`` [degree]; ``tristimulus_u`` or
        ``reflectance_factor_u`` (k = 1) where uncertainties are given. Those of L*, a* and b*, kept as ``lab_u``, are taken to be independent

    Raises
    ------
    InputError : with file and row: fewer than three colours, unknown geometries, missing colours or illuminant,
        uncertainties of some of the colours only, …
    """
    rows = _checked_rows(spec, path)
    dataset = _spectral(rows, spec) if rows.kind == "reflectance" else _tristimulus(rows, spec)
    for k, angle in enumerate(ANGLES):
        dataset[angle] = ("geometry", np.array([pair[k] for pair in rows.directions]))
    dataset = vocabulary.label(dataset, "multiangle")
    dataset = vocabulary.add_history(dataset, *rows.notes) if rows.notes else dataset
    mirror = [name for name, pair in zip(rows.names, rows.directions, strict=True) if _aspecular_angle(pair) < 10]
    if not mirror:
        return dataset
    return vocabulary.add_warning(
        dataset,
        f"{', '.join(mirror)}: closer than 10 degree to the mirror direction, where colours include the gloss of the clear coat; "
        "remove them from `multiangle` unless the gloss was excluded",
    )


def _checked_rows(spec: Mapping[str, Any], path: str | PathLike[str] | None) -> _Rows:
    if not isinstance(spec, Mapping) or ("file" in spec) == ("colours" in spec):
        accepted = "file: … or colours: […]"
        raise _refusal("material.yaml", "exactly one of `file` and `colours` is required", accepted, key="multiangle")
    rows = _inline(spec) if "colours" in spec else _table(Path(path if path is not None else str(spec["file"])))
    if not _FEWEST <= len(rows.names) <= _MOST:
        raise _refusal(rows.file, "wrong number of colours", f"{_FEWEST} to {_MOST}", len(rows.names), key="multiangle")
    if "colour_uncertainty" not in spec:
        return rows
    if rows.uncertainty is not None:
        problem, accepted = "the file has columns of uncertainties", "either these or `colour_uncertainty`"
        raise _refusal(rows.file, problem, accepted, key="multiangle.colour_uncertainty")
    return rows._replace(uncertainty=np.full_like(rows.values, float(spec["colour_uncertainty"])))


def _aspecular_angle(pair: Directions) -> float:
    """Angle from the mirror direction [degree]."""
    theta_i, phi_i, theta_o, phi_o = np.radians(pair)
    cosine = np.cos(theta_i) * np.cos(theta_o) - np.sin(theta_i) * np.sin(theta_o) * np.cos(phi_o - phi_i)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _illuminant(rows: _Rows, spec: Mapping[str, Any]) -> str:
    """Name of the illuminant of the colours; illuminant and observer are checked."""
    for key, accepted in (("illuminant", "D65, A, …"), ("observer", "2 or 10")):
        if key not in spec:
            raise _refusal(rows.file, f"the {key} of the colours is missing", accepted, key=f"multiangle.{key}")
    try:
        colorimetry.check_observer(spec["observer"])
        return colorimetry.illuminant_name(spec["illuminant"])
    except BrdfpipeError as error:
        key = "multiangle.observer" if "observer" in str(error) else "multiangle.illuminant"
        raise InputError(rows.file, str(error), where="multiangle", key=key) from error


def _tristimulus(rows: _Rows, spec: Mapping[str, Any]) -> xr.Dataset:
    illuminant = _illuminant(rows, spec)
    white, xyz = colorimetry.weights(illuminant, spec["observer"]).white, rows.values
    if rows.kind == "lab":
        _check_lab(rows)
        # A black that is not exactly neutral gives XYZ slightly below 0.
        xyz = np.maximum(colorimetry.lab_to_xyz(rows.values, white), 0.0)
    _check_xyz(rows, xyz)
    variables = {"tristimulus": (("geometry", "channel"), xyz)}
    if rows.uncertainty is not None:
        u = rows.uncertainty if rows.kind == "xyz" else _u_from_lab(rows.values, rows.uncertainty, white)
        variables["tristimulus_u"] = (("geometry", "channel"), u)
        if rows.kind == "lab":
            variables["lab_u"] = (("geometry", "component"), rows.uncertainty)
    return xr.Dataset(
        variables,
        coords={"geometry": list(rows.names), "channel": ["X", "Y", "Z"]},
        attrs={"illuminant": illuminant, "observer": int(spec["observer"])},
    )


def _check_xyz(rows: _Rows, xyz: Array) -> None:
    for where, name, values in zip(rows.where, rows.names, xyz, strict=True):
        if values.min() < 0 or values.max() > 100 * _BRIGHTEST:
            found = f"XYZ ({', '.join(f'{value:.4g}' for value in values)})"
            accepted = f"X, Y, Z from 0 to {100 * _BRIGHTEST:g}; check L*, a*, b* and their order"
            raise _refusal(rows.file, "tristimulus value out of range", accepted, found, f"{where} ({name})")


def _check_lab(rows: _Rows) -> None:
    for where, (lightness, a, b) in zip(rows.where, rows.values, strict=True):
        found = f"L*a*b* ({lightness:g}, {a:g}, {b:g})"
        if not 0 <= lightness <= 500 or max(abs(a), abs(b)) > _CHROMATIC:
            accepted = f"L* from 0 to 500, a* and b* within ±{_CHROMATIC:g}"
            raise _refusal(rows.file, "L*a*b* out of range", accepted, found, where)
        # X/X_n and Z/Z_n are these times 108/841 near black (CIE 15:2018); rounded blacks may be off by 1e-9 of white.
        if min(lightness / 116 + a / 500, lightness / 116 - b / 200) * 108 / 841 <= -1e-9:
            problem, accepted = "tristimulus value out of range", "X, Y, Z from 0; check L*, a*, b* and their order"
            raise _refusal(rows.file, problem, accepted, f"{found}: X or Z below 0", where)


def _u_from_lab(lab: Array, u: Array, white: Array) -> Array:
    """Standard uncertainties of X, Y, Z from those of L*, a* and b*, to first order."""
    return np.asarray(np.sqrt(np.einsum("gik,gi->gk", lab_slopes(lab, white) ** 2, u**2)))


def lab_slopes(lab: Array, white: Array) -> Array:
    """Derivatives of X, Y and Z by L*, a* and b*, (geometries, component, channel)."""
    step = _STEP * np.eye(3)
    above, below = (colorimetry.lab_to_xyz(lab[:, None, :] + sign * step, white) for sign in (1, -1))
    return np.asarray((above - below) / (2 * _STEP))


def _spectral(rows: _Rows, spec: Mapping[str, Any]) -> xr.Dataset:
    assert rows.wavelength is not None
    order = np.argsort(rows.wavelength)
    wavelength, values = rows.wavelength[order], rows.values[:, order]
    key = "multiangle.file" if "file" in spec else "multiangle.wavelength"
    if wavelength.size < 4 or not (np.diff(wavelength) > 0).all() or np.diff(wavelength).max() > 50:
        found = f"{wavelength.size} wavelengths, {wavelength.min():g} to {wavelength.max():g} nm"
        accepted = "each wavelength once, in steps of at most 50 nm"
        raise _refusal(rows.file, "unusable wavelengths", accepted, found, key=key)
    if wavelength[0] > 400 or wavelength[-1] < 700:
        found = f"{wavelength[0]:g} to {wavelength[-1]:g} nm"
        raise _refusal(rows.file, "must cover 400–700 nm", "400 to 700 nm or wider", found, key=key)
    scale, key = spec.get("scale"), "multiangle.scale"
    if scale not in ("fraction", "percent"):
        problem = "the scale of the reflectance factors is missing"
        raise _refusal(rows.file, problem, "fraction or percent", scale, key=key)
    unit = 100.0 if scale == "percent" else 1.0
    values = values / unit
    if values.min() < -1e-3 or values.max() > _BRIGHTEST:
        found = f"{values.min():.4g} to {values.max():.4g}"
        raise _refusal(rows.file, "reflectance factors out of range", f"0 to {_BRIGHTEST:g}", found, key=key)
    variables = {"reflectance_factor": (("geometry", "wavelength"), np.maximum(values, 0.0))}
    if rows.uncertainty is not None:
        variables["reflectance_factor_u"] = (("geometry", "wavelength"), rows.uncertainty[:, order] / unit)
    dataset = xr.Dataset(variables, coords={"geometry": list(rows.names), "wavelength": wavelength})
    below = int((values < 0).sum())
    if not below:
        return dataset
    return vocabulary.add_history(dataset, f"{below} reflectance factors between -0.001 and 0 were set to 0")


def _inline(spec: Mapping[str, Any]) -> _Rows:
    file, given = "material.yaml", spec["colours"]
    is_list = isinstance(given, Sequence) and not isinstance(given, str)
    if not is_list or not all(isinstance(item, Mapping) for item in given):
        raise _refusal(file, "`colours` is not a list of colours", "[{geometry: …, lab: […]}, …]")
    kinds = [tuple(kind for kind in ("lab", "xyz", "reflectance") if kind in item) for item in given]
    where = tuple(f"multiangle.colours, entry {k}" for k in range(1, len(given) + 1))
    for entry, present in zip(where, kinds, strict=True):
        if len(present) != 1 or present != kinds[0]:
            problem = "each entry needs one colour, all of the same kind"
            raise _refusal(file, problem, "lab, xyz or reflectance", ", ".join(present) or "none", entry)
    kind = kinds[0][0] if kinds else "lab"
    wavelength = _numbers(spec.get("wavelength"), None, "multiangle.wavelength") if kind == "reflectance" else None
    width = 3 if wavelength is None else wavelength.size
    values = []
    for item, entry in zip(given, where, strict=True):
        values.append(_numbers(item[kind], entry))
        if values[-1].size != width:
            raise _refusal(file, f"{kind} has the wrong length", str(width), values[-1].size, entry)
    return _rows(file, where, given, kind, np.array(values).reshape(len(values), width), wavelength)


def _rows(
    file: str,
    where: tuple[str, ...],
    items: Sequence[Mapping[str, Any]],
    kind: str,
    values: Array,
    wavelength: Array | None,
) -> _Rows:
    """Rows of values, with the directions and names of their geometries."""
    try:
        refuse_mixed_signs(item["geometry"] for item in items if "geometry" in item)
    except BrdfpipeError as error:
        raise InputError(file, str(error), where="geometry", key=_colours_key(file)) from error
    pairs = tuple(_directions_of(item, file, at) for item, at in zip(items, where, strict=True))
    names = [_geometry_name(item.get("geometry"), pair) for item, pair in zip(items, pairs, strict=True)]
    return _Rows(file, where, _unique(names), pairs, kind, values, wavelength)


def _numbers(given: object, where: str | None, key: str | None = None) -> Array:
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        values = np.empty((0, 0))
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all():
        problem, found = "not a list of finite numbers", repr(given)[:60]
        raise _refusal("material.yaml", problem, "[number, number, …]", found, where, key)
    return values


def _directions_of(item: Mapping[str, Any], file: str, where: str) -> Directions:
    given = [angle for angle in ANGLES if angle in item]
    if ("geometry" in item) == bool(given):
        raise _refusal(file, "either `geometry` or its angles are required", ACCEPTED, where=where)
    if not given:
        name = item["geometry"]
        if isinstance(name, int) and not isinstance(name, bool) and name >= 60:
            name = "{}:{}".format(*divmod(name, 60))  # YAML 1.1 reads an unquoted 45:0 as 45 minutes
        try:
            return directions(str(name))
        except BrdfpipeError as error:
            raise InputError(file, str(error), where=where, key=_colours_key(file)) from error
    angles = {angle: item.get(angle, 0.0 if angle == "phi_i" else None) for angle in ANGLES}
    for angle, value in angles.items():
        polar = angle.startswith("theta")
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else float("nan")
        if not (0 <= number < 90 if polar else -720 <= number <= 720):
            accepted = "0 <= degree < 90" if polar else "-720 to 720 degree"
            raise _refusal(file, f"invalid {angle}", accepted, repr(value)[:40], where)
    return Directions(*(float(angles[angle]) for angle in ANGLES))


def _geometry_name(name: object, pair: Directions) -> str:
    if isinstance(name, str) and name.strip():
        return name.strip()
    if pair.phi_i == 0 and pair.phi_o % 360 in (0.0, 180.0):
        return f"{pair.theta_i:g}:{pair.theta_o if pair.phi_o % 360 == 0 else -pair.theta_o:g}"
    return f"{pair.theta_i:g},{pair.phi_i:g}:{pair.theta_o:g},{pair.phi_o:g}"


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    """Number repeated names, since a geometry may be measured more than once."""
    counts: dict[str, int] = {}
    unique = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        unique.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return tuple(unique)


def _table(path: Path) -> _Rows:
    text, notes = read_text(path)
    numbered = enumerate(re.split(r"\r\n|\r|\n", text), start=1)
    lines = [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise _refusal(path.name, "the table is empty", "a line of column titles and a row per geometry")
    separator = next((mark for mark in (";", "\t", ",") if mark in lines[0][1]), ",")
    decimal = "," if separator == ";" else "."
    try:
        cells = (next(csv.reader([line], delimiter=separator), []) for _, line in lines)
        titles, *rows = ([cell.strip() for cell in row] for row in cells)
    except csv.Error as error:
        raise _refusal(path.name, f"not a table ({error})", "columns of titles and numbers") from error
    where = tuple(f"line {number}" for number, _ in lines[1:])
    geometry_columns = {name: k for k, name in enumerate(map(str.casefold, titles)) if name in ("geometry", *ANGLES)}
    kind, columns, wavelength = _colour_columns(path, titles)
    u_columns = _uncertainty_columns(path, titles, columns)
    numeric = (*(k for title, k in geometry_columns.items() if title != "geometry"), *columns, *u_columns)
    values, items = [], []
    for at, row in zip(where, rows, strict=True):
        if len(row) != len(titles):
            problem = "the row has a different number of cells than the title line"
            raise _refusal(path.name, problem, str(len(titles)), len(row), at)
        numbers = {k: _number(path, row[k], f"{at}, column {titles[k]}", decimal) for k in numeric}
        items.append({title: row[k] if title == "geometry" else numbers[k] for title, k in geometry_columns.items()})
        values.append([numbers[k] for k in (*columns, *u_columns)])
        for k in u_columns:
            if numbers[k] <= 0:
                column = f"{at}, column {titles[k]}"
                raise _refusal(path.name, "invalid standard uncertainty", "above 0", f"{numbers[k]:g}", column)
    stacked = np.array(values, dtype=float).reshape(len(values), len(columns) + len(u_columns))
    colours, uncertainty = np.split(stacked, [len(columns)], axis=1)
    if u_columns:
        notes.append("the uncertainties are taken as independent standard uncertainties (k = 1)")
    used = {*geometry_columns.values(), *columns, *u_columns}
    unused = [title for k, title in enumerate(titles) if k not in used]
    if unused:
        notes.append(f"{path.name}: ignored columns: {', '.join(unused)}"[:200])
    table = _rows(path.name, where, items, kind, colours, wavelength)
    return table._replace(uncertainty=uncertainty if u_columns else None, notes=tuple(notes))


def _uncertainty_columns(path: Path, titles: Sequence[str], columns: Sequence[int]) -> list[int]:
    """Columns of the standard uncertainties of ``columns``, in their order; empty if there are none."""
    by_quantity: dict[str | float, int] = {}
    for k, title in enumerate(titles):
        match = _UNCERTAIN.fullmatch(title)
        if match and k not in columns:
            by_quantity[_quantity(match["after"] or match["before"])] = k
    quantities = [_quantity(titles[k]) for k in columns]
    present = [quantity in by_quantity for quantity in quantities]
    if any(present) and not all(present):
        problem = f"the uncertainty of {titles[columns[present.index(False)]]} is missing"
        accepted = "one for each column of the colour, or none"
        raise _refusal(path.name, problem, accepted, ", ".join(titles)[:80], "titles")
    return [by_quantity[quantity] for quantity in quantities] if all(present) else []


def _quantity(title: str) -> str | float:
    """Quantity of a column from any spelling of its title: L, a, b, X, Y, Z or a wavelength in nm."""
    folded = title.strip().casefold()
    match = _WAVELENGTH.fullmatch(title.strip())
    return float(match[1].replace(",", ".")) if match else {**_LAB, **_XYZ}.get(folded, folded)


def _colour_columns(path: Path, titles: Sequence[str]) -> tuple[str, list[int], Array | None]:
    """Kind of the colours, their columns, and the wavelengths of spectra."""
    folded = [title.casefold() for title in titles]
    for kind, words, order in (("lab", _LAB, "Lab"), ("xyz", _XYZ, "XYZ")):
        at = {words[title]: k for k, title in enumerate(folded) if title in words}
        if set(at) == set(order):
            return kind, [at[letter] for letter in order], None
    matches = {k: match for k, title in enumerate(titles) if (match := _WAVELENGTH.fullmatch(title))}
    if matches:
        return "reflectance", list(matches), np.array([float(match[1].replace(",", ".")) for match in matches.values()])
    accepted = "geometry (or theta_i, phi_i, theta_o, phi_o), and L, a, b or X, Y, Z or wavelengths in nm"
    raise _refusal(path.name, "no colour columns in the title line", accepted, ", ".join(titles)[:80], "titles")


def _number(path: Path, cell: str, where: str, decimal: str) -> float:
    text = cell.replace(",", ".") if decimal == "," else cell
    text = text.replace("\N{MINUS SIGN}", "-")
    if not _NUMBER.fullmatch(text):
        raise _refusal(path.name, "not a number", "a number", repr(cell[:40]), where)
    return float(text)


def _refusal(
    file: str, problem: str, accepted: str, found: object = None, where: str | None = None, key: str | None = None
) -> InputError:
    where, key = where or "multiangle", key or _colours_key(file)
    return InputError(file, problem, where=where, found=found, accepted=accepted, key=key)


def _colours_key(file: str) -> str:
    """Key of material.yaml that holds the colours or names their file."""
    return "multiangle.colours" if file == "material.yaml" else "multiangle.file"

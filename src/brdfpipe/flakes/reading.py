"""Read colours measured at several geometries, from a CSV file or from material.yaml."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.flakes.geometries import ACCEPTED, Directions, directions, refuse_mixed_signs
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

FEWEST, MOST = 3, 1000
ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")

_MAX_BYTES = 2**22
_BRIGHTEST = 100.0
"""Largest accepted reflectance factor; the brightest flakes near the gloss reach about ten."""
_CHROMATIC = 500.0
_STEP = 1e-3
"""Step of L*, a* and b* in numerical derivatives."""
_SPAN = (400.0, 700.0)
_LAB = {"l": "L", "l*": "L", "a": "a", "a*": "a", "b": "b", "b*": "b"}
_XYZ = {"x": "X", "y": "Y", "z": "Z"}
_WAVELENGTH = re.compile(r"r?_?(\d{3,4}(?:[.,]\d+)?)\s*(?:nm)?", re.IGNORECASE)
_UNCERTAIN = re.compile(
    r"(?:u|std|sd|sigma|σ)[\s_(]+(?P<of>[^()]+)\)?|(?P<whose>.+?)[\s_]+(?:u|std|sd|sigma|σ)", re.IGNORECASE
)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


class _Rows(NamedTuple):
    """Colours in the units of the file."""

    file: str
    where: tuple[str, ...]
    """Location of each row, for messages"""
    names: tuple[str, ...]
    geometry: tuple[Directions, ...]
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
    spec : ``{file}`` or ``{colours}``, a list of ``{geometry or theta_i, phi_i, theta_o, phi_o; lab, xyz or reflectance}`` of one
        sort, with ``wavelength`` [nm] for reflectances; ``illuminant`` and ``observer`` of L*a*b* and XYZ; ``scale`` (fraction or
        percent) of reflectance factors. Of a CSV file the first line names the columns: ``geometry`` or the four angles, then
        L, a, b or X, Y, Z or wavelengths, and ``u_L``, ``u_a``, ``u_b`` (or ``u_X`` …, ``u_400`` …) where standard uncertainties
        are known. XYZ are on the scale of Y = 100 for the perfect diffuser
    path : path of the file, if it differs from the name in ``spec``

    Returns
    -------
    Dataset of kind ``multiangle``: ``tristimulus(geometry, channel)`` with attributes ``illuminant`` and ``observer``, or
        ``reflectance_factor(geometry, wavelength)``; ``theta_i``, ``phi_i``, ``theta_o``, ``phi_o`` [degree]; ``tristimulus_u`` or
        ``reflectance_factor_u`` (k = 1) where the file has uncertainties. Those of L*, a* and b* are taken to be independent

    Raises
    ------
    InputError : with file and row: fewer than three colours, unknown geometries, missing colours or illuminant,
        uncertainties of some of the colours only, …
    """
    if not isinstance(spec, Mapping) or ("file" in spec) == ("colours" in spec):
        raise _refusal(
            "material.yaml",
            "either `file` or `colours` is required",
            None,
            None,
            "file: … or colours: […]",
            "multiangle",
        )
    rows = _inline(spec) if "colours" in spec else _table(Path(path if path is not None else str(spec["file"])))
    if not FEWEST <= len(rows.names) <= MOST:
        accepted = f"{FEWEST} to {MOST}"
        raise _refusal(rows.file, "wrong number of colours", None, str(len(rows.names)), accepted, "multiangle")
    dataset = _spectral(rows, spec) if rows.kind == "reflectance" else _tristimulus(rows, spec)
    for k, angle in enumerate(ANGLES):
        dataset[angle] = ("geometry", np.array([pair[k] for pair in rows.geometry]))
    return _with_notes(vocabulary.label(dataset, "multiangle"), rows)


def _with_notes(dataset: xr.Dataset, rows: _Rows) -> xr.Dataset:
    dataset = vocabulary.add_history(dataset, *rows.notes) if rows.notes else dataset
    mirror = [name for name, at in zip(rows.names, rows.geometry, strict=True) if _from_mirror(at) < 10]
    if mirror:
        return vocabulary.add_warning(
            dataset,
            f"{', '.join(mirror)}: closer than 10 degree to the mirror direction, where colours include the gloss of the clear coat; "
            "remove them from `multiangle` unless the gloss was excluded",
        )
    return dataset


def _from_mirror(at: Directions) -> float:
    theta_i, phi_i, theta_o, phi_o = np.radians(at)
    cosine = np.cos(theta_i) * np.cos(theta_o) - np.sin(theta_i) * np.sin(theta_o) * np.cos(phi_o - phi_i)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


# --- colours


def _tristimulus(rows: _Rows, spec: Mapping[str, Any]) -> xr.Dataset:
    for key, accepted in (("illuminant", "D65, A, …"), ("observer", "2 or 10")):
        if key not in spec:
            raise _refusal(rows.file, f"the {key} of the colours is missing", None, None, accepted, f"multiangle.{key}")
    try:
        illuminant = colorimetry.illuminant_name(spec["illuminant"])
        table = colorimetry.weights(illuminant, spec["observer"])
    except BrdfpipeError as error:
        key = "multiangle.observer" if "observer" in str(error) else "multiangle.illuminant"
        raise InputError(rows.file, str(error), where="multiangle", key=key) from error
    xyz = rows.values if rows.kind == "xyz" else _from_lab(rows, table.white)
    for k, name in enumerate(rows.names):
        if (xyz[k] < 0).any() or xyz[k].max() > 100 * _BRIGHTEST:
            found = f"XYZ ({', '.join(f'{value:.4g}' for value in xyz[k])})"
            problem = "tristimulus value out of range"
            accepted = f"X, Y, Z from 0 to {100 * _BRIGHTEST:g}; check L*, a*, b* and their order"
            raise _refusal(rows.file, problem, f"{rows.where[k]} ({name})", found, accepted, "multiangle.colours")
    variables = {"tristimulus": (("geometry", "channel"), xyz)}
    if rows.uncertainty is not None:
        u = rows.uncertainty if rows.kind == "xyz" else _u_from_lab(rows.values, rows.uncertainty, table.white)
        variables["tristimulus_u"] = (("geometry", "channel"), u)
    return xr.Dataset(
        variables,
        coords={"geometry": list(rows.names), "channel": ["X", "Y", "Z"]},
        attrs={"illuminant": illuminant, "observer": int(spec["observer"])},
    )


def _from_lab(rows: _Rows, white: Array) -> Array:
    for where, (lightness, a, b) in zip(rows.where, rows.values, strict=True):
        if not 0 <= lightness <= 500 or max(abs(a), abs(b)) > _CHROMATIC:
            found, accepted = f"({lightness:g}, {a:g}, {b:g})", f"L* from 0 to 500, a* and b* within ±{_CHROMATIC:g}"
            raise _refusal(rows.file, "L*a*b* out of range", where, found, accepted, "multiangle.colours")
    xyz = colorimetry.lab_to_xyz(rows.values, white)
    # A black that is not exactly neutral gives XYZ slightly below 0.
    return np.where((xyz < 0) & (xyz > -1e-9 * white), 0.0, xyz)


def _u_from_lab(lab: Array, u: Array, white: Array) -> Array:
    """Standard uncertainties of X, Y, Z from those of L*, a* and b*, to first order."""
    step = _STEP * np.eye(3)
    above, below = (colorimetry.lab_to_xyz(lab[:, None, :] + sign * step, white) for sign in (1, -1))
    slope = (above - below) / (2 * _STEP)
    return np.asarray(np.sqrt(np.einsum("gik,gi->gk", slope**2, u**2)))


def _spectral(rows: _Rows, spec: Mapping[str, Any]) -> xr.Dataset:
    assert rows.wavelength is not None
    order = np.argsort(rows.wavelength)
    wavelength, values = rows.wavelength[order], rows.values[:, order]
    key = "multiangle.file" if "file" in spec else "multiangle.wavelength"
    if wavelength.size < 4 or not (np.diff(wavelength) > 0).all() or np.diff(wavelength).max() > 50:
        found = f"{wavelength.size} wavelengths, {wavelength.min():g} to {wavelength.max():g} nm"
        raise _refusal(
            rows.file, "unusable wavelengths", None, found, "each wavelength once, in steps of at most 50 nm", key
        )
    if wavelength[0] > _SPAN[0] or wavelength[-1] < _SPAN[1]:
        found = f"{wavelength[0]:g} to {wavelength[-1]:g} nm"
        raise _refusal(rows.file, "must cover 400–700 nm", None, found, "400 to 700 nm or wider", key)
    scale = spec.get("scale")
    if scale not in ("fraction", "percent"):
        raise _refusal(
            rows.file,
            "the scale of the reflectance factors is missing",
            None,
            scale,
            "fraction or percent",
            "multiangle.scale",
        )
    unit = 100.0 if scale == "percent" else 1.0
    values = values / unit
    if values.min() < -1e-3 or values.max() > _BRIGHTEST:
        found = f"{values.min():.4g} to {values.max():.4g}"
        raise _refusal(
            rows.file, "reflectance factors out of range", None, found, f"0 to {_BRIGHTEST:g}", "multiangle.scale"
        )
    variables = {"reflectance_factor": (("geometry", "wavelength"), np.maximum(values, 0.0))}
    if rows.uncertainty is not None:
        variables["reflectance_factor_u"] = (("geometry", "wavelength"), rows.uncertainty[:, order] / unit)
    dataset = xr.Dataset(variables, coords={"geometry": list(rows.names), "wavelength": wavelength})
    below = int((values < 0).sum())
    return (
        vocabulary.add_history(dataset, f"{below} reflectance factors between -0.001 and 0 were set to 0")
        if below
        else dataset
    )


# --- written out in material.yaml


def _inline(spec: Mapping[str, Any]) -> _Rows:
    given = spec["colours"]
    if (
        not isinstance(given, Sequence)
        or isinstance(given, str)
        or not all(isinstance(item, Mapping) for item in given)
    ):
        raise _refusal(
            "material.yaml",
            "`colours` is not a list of colours",
            None,
            None,
            "[{geometry: …, lab: […]}, …]",
            "multiangle.colours",
        )
    kinds = [tuple(sort for sort in ("lab", "xyz", "reflectance") if sort in item) for item in given]
    where = tuple(f"multiangle.colours, entry {k}" for k in range(1, len(given) + 1))
    for k, kinds_of_entry in enumerate(kinds):
        if len(kinds_of_entry) != 1 or kinds_of_entry != kinds[0]:
            words = ", ".join(kinds_of_entry) or "none"
            raise _refusal(
                "material.yaml",
                "each entry needs one colour, all of the same kind",
                where[k],
                words,
                "lab, xyz or reflectance",
                "multiangle.colours",
            )
    kind = kinds[0][0] if kinds else "lab"
    wavelength = (
        _numbers("material.yaml", spec.get("wavelength"), "multiangle", "multiangle.wavelength")
        if kind == "reflectance"
        else None
    )
    width = 3 if wavelength is None else wavelength.size
    _check_signs("material.yaml", (item["geometry"] for item in given if "geometry" in item))
    values, names, pairs = [], [], []
    for item, at in zip(given, where, strict=True):
        colour = _numbers("material.yaml", item[kind], at, "multiangle.colours")
        if colour.size != width:
            raise _refusal(
                "material.yaml", f"{kind} has the wrong length", at, str(colour.size), str(width), "multiangle.colours"
            )
        pair = _directions_of(item, "material.yaml", at)
        values.append(colour)
        pairs.append(pair)
        names.append(_geometry_name(item.get("geometry"), pair))
    stacked = np.array(values).reshape(len(values), width)
    return _Rows("material.yaml", where, _unique(names), tuple(pairs), kind, stacked, wavelength)


def _numbers(file: str, given: object, where: str, key: str) -> Array:
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        values = np.empty((0, 0))
    if values.ndim != 1 or values.size == 0 or not np.isfinite(values).all():
        raise _refusal(file, "not a list of finite numbers", where, repr(given)[:60], "[number, number, …]", key)
    return values


def _check_signs(file: str, names: Iterable[object]) -> None:
    try:
        refuse_mixed_signs(names)
    except BrdfpipeError as error:
        key = "multiangle.colours" if file == "material.yaml" else "multiangle.file"
        raise InputError(file, str(error), where="geometry", key=key) from error


def _directions_of(item: Mapping[str, Any], file: str, where: str) -> Directions:
    given = [angle for angle in ANGLES if angle in item]
    if ("geometry" in item) == bool(given):
        raise _refusal(
            file, "either `geometry` or its angles are required", where, None, ACCEPTED, "multiangle.colours"
        )
    if not given:
        name = item["geometry"]
        if isinstance(name, int) and not isinstance(name, bool) and name >= 60:
            name = "{}:{}".format(*divmod(name, 60))  # YAML 1.1 reads an unquoted 45:0 as 45 minutes
        try:
            return directions(str(name))
        except BrdfpipeError as error:
            raise InputError(file, str(error), where=where, key="multiangle.colours") from error
    angles = {angle: item.get(angle, 0.0 if angle == "phi_i" else None) for angle in ANGLES}
    for angle, value in angles.items():
        polar = angle.startswith("theta")
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else float("nan")
        if not (0 <= number < 90 if polar else -720 <= number <= 720):
            accepted = "0 <= degree < 90" if polar else "-720 to 720 degree"
            raise _refusal(file, f"invalid {angle}", where, repr(value)[:40], accepted, "multiangle.colours")
    return Directions(*(float(angles[angle]) for angle in ANGLES))


def _geometry_name(name: object, place: Directions) -> str:
    if isinstance(name, str) and name.strip():
        return name.strip()
    if place.phi_i == 0 and place.phi_o % 360 in (0.0, 180.0):
        return f"{place.theta_i:g}:{place.theta_o if place.phi_o % 360 == 0 else -place.theta_o:g}"
    return f"{place.theta_i:g},{place.phi_i:g}:{place.theta_o:g},{place.phi_o:g}"


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    """Number repeated names, since a geometry may be measured more than once."""
    counts: dict[str, int] = {}
    unique = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        unique.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return tuple(unique)


# --- a file


def _table(path: Path) -> _Rows:
    lines = _lines(path)
    if not lines:
        raise _refusal(
            path, "the table is empty", None, None, "a line of column titles and a row per geometry", "multiangle.file"
        )
    separator = _separator(lines[0][1])
    decimal = "," if separator == ";" else "."
    titles = [cell.strip().strip("\ufeff") for cell in _cells(lines[0][1], separator)]
    places = {title.casefold(): k for k, title in enumerate(titles) if title.casefold() in ("geometry", *ANGLES)}
    kind, columns, wavelength = _colour_columns(path, titles)
    u_columns = _uncertainty_columns(path, titles, columns)
    values, names, pairs, where = [], [], [], []
    for number, line in lines[1:]:
        cells, at = [cell.strip() for cell in _cells(line, separator)], f"line {number}"
        if len(cells) != len(titles):
            raise _refusal(
                path,
                "the row has a different number of cells than the title line",
                at,
                str(len(cells)),
                str(len(titles)),
                "multiangle.file",
            )
        item: dict[str, Any] = {
            title: cells[k] if title == "geometry" else _number(path, cells[k], at, titles[k], decimal)
            for title, k in places.items()
        }
        pair = _directions_of(item, path.name, at)
        values.append([_number(path, cells[k], at, titles[k], decimal) for k in (*columns, *u_columns)])
        for k, value in zip(u_columns, values[-1][len(columns) :], strict=True):
            if value <= 0:
                wrong = f"{at}, column {titles[k]}"
                raise _refusal(path, "invalid standard uncertainty", wrong, f"{value:g}", "above 0", "multiangle.file")
        pairs.append(pair)
        names.append(_geometry_name(item.get("geometry"), pair))
        where.append(at)
    _check_signs(path.name, names)
    stacked = np.array(values, dtype=float).reshape(len(values), len(columns) + len(u_columns))
    colours, u = np.split(stacked, [len(columns)], axis=1)
    notes = _notes(path, titles, {*places.values(), *columns, *u_columns}, bool(u_columns))
    rows = _Rows(path.name, tuple(where), _unique(names), tuple(pairs), kind, colours, wavelength)
    return rows._replace(uncertainty=u if u_columns else None, notes=tuple(notes))


def _notes(path: Path, titles: Sequence[str], used: set[int], known: bool) -> list[str]:
    unused = [title for k, title in enumerate(titles) if k not in used]
    notes = ["the uncertainties are taken as independent standard uncertainties (k = 1)"] if known else []
    return [*notes, f"{path.name}: ignored columns: {', '.join(unused)}"[:200]] if unused else notes


def _uncertainty_columns(path: Path, titles: Sequence[str], columns: Sequence[int]) -> list[int]:
    """Columns of the standard uncertainties of ``columns``, in their order; empty if there are none."""
    named: dict[str | float, int] = {}
    for k, title in enumerate(titles):
        match = _UNCERTAIN.fullmatch(title)
        if match and k not in columns:
            named[_quantity(match["of"] or match["whose"])] = k
    quantities = [_quantity(titles[k]) for k in columns]
    present = [quantity in named for quantity in quantities]
    if any(present) and not all(present):
        missing = titles[columns[present.index(False)]]
        accepted = "one for each column of the colour, or none"
        raise _refusal(
            path,
            f"the uncertainty of {missing} is missing",
            "titles",
            ", ".join(titles)[:80],
            accepted,
            "multiangle.file",
        )
    return [named[quantity] for quantity in quantities] if all(present) else []


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
    raise _refusal(
        path, "no colour columns in the title line", "titles", ", ".join(titles)[:80], accepted, "multiangle.file"
    )


def _lines(path: Path) -> list[tuple[int, str]]:
    """Numbered lines that are neither empty nor comments."""
    try:
        data = path.read_bytes()[: _MAX_BYTES + 1]
    except OSError as error:
        raise _refusal(
            path, f"cannot be read ({error.strerror})", None, None, "a CSV file", "multiangle.file"
        ) from error
    if len(data) > _MAX_BYTES:
        raise _refusal(path, "too large", None, f"over {_MAX_BYTES} bytes", "a table of colours", "multiangle.file")
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "\0" in text:
        raise _refusal(path, "not text", None, None, "a CSV file", "multiangle.file")
    numbered = enumerate(re.split(r"\r\n|\r|\n", text), start=1)
    return [(number, line) for number, line in numbered if line.strip() and not line.lstrip().startswith("#")]


def _separator(titles: str) -> str:
    return next((mark for mark in (";", "\t", ",") if mark in titles), ",")


def _cells(line: str, separator: str) -> list[str]:
    return next(iter(csv.reader([line], delimiter=separator)), [])


def _number(path: Path, cell: str, where: str, title: str, decimal: str) -> float:
    text = cell.replace(",", ".") if decimal == "," else cell
    text = text.replace("\N{MINUS SIGN}", "-")
    if not _NUMBER.fullmatch(text):
        raise _refusal(path, "not a number", f"{where}, column {title}", repr(cell[:40]), "a number", "multiangle.file")
    return float(text)


def _refusal(file: str | Path, problem: str, where: str | None, found: object, accepted: str, key: str) -> InputError:
    return InputError(file, problem, where=where or "multiangle", found=found, accepted=accepted, key=key)

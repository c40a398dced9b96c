"""What ``brdfpipe show`` says of a file or a folder of results."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import xarray as xr

from brdfpipe.cli import terminal_plots
from brdfpipe.cli.console import FILE_KINDS
from brdfpipe.errors import InputError, abbreviated, printable, shortened

_INCIDENCES = (0.0, 30.0, 60.0)
"""Of the cuts that ``show`` draws [degree]."""

_MOST_SCALARS = 40
_MOST_TEXT = 100
_MOST_CASES, _MOST_SCENES = 8, 4


def read_any(path: Path, kind: str | None = None, settings: tuple[str, ...] = ()) -> xr.Dataset:
    """The dataset of any file that this package reads.

    Raises InputError, StoreError: no reader for the suffix, or the reader refuses the file.
    """
    from brdfpipe import store
    from brdfpipe.catalogue import material_keys
    from brdfpipe.descriptions import reading
    from brdfpipe.exchange.conversion import open_bsdf
    from brdfpipe.optics.index import refractive_index
    from brdfpipe.spectra.ingestion import ingest as read_spectrum
    from brdfpipe.surfaces.reading import ingest as read_surface

    if path.suffix.lower() == ".nc":
        return store.open_dataset(path, kind)
    kind = kind or _kind_by_suffix(path)
    if kind == "bsdf":
        return open_bsdf(path)
    if kind == "index":
        return refractive_index({"file": path.name}, path)
    given = {"file": str(path)} | dict(map(_setting, settings))
    declared = {"surface": material_keys.MeasuredSurface, "spectrum": material_keys.MeasuredSpectrum}[kind]
    spec = reading.check(given, declared, path.name)
    try:
        return read_surface(path, spec) if kind == "surface" else read_spectrum(spec, path)
    except InputError as refusal:
        key = refusal.key or ""
        raise refusal.at_command_line({key: f"--set {key.rpartition('.')[2]}=…"}) from None


def _kind_by_suffix(path: Path) -> str:
    from brdfpipe.exchange.registry import FORMATS as TABLES
    from brdfpipe.file_formats import extensions
    from brdfpipe.spectra.formats.registry import FORMATS as SPECTRA
    from brdfpipe.surfaces.reading import FORMATS as SURFACES

    suffix, name = path.suffix.lower(), path.name.lower()
    of_tables = [ending for known in TABLES.values() for ending in known.readable_suffixes]
    candidates = [
        kind
        for kind, matches in (
            ("surface", suffix in extensions(SURFACES)),
            ("spectrum", suffix in extensions(SPECTRA)),
            ("bsdf", any(name.endswith(ending.lower()) for ending in of_tables)),
        )
        if matches
    ]
    if len(candidates) != 1:
        problem = "may hold several things" if candidates else "no reader for this file"
        found = ", ".join(candidates) or path.suffix or "no suffix"
        raise InputError(path, problem, found=found, accepted=", ".join(FILE_KINDS), option="--as")
    return candidates[0]


def _setting(text: str) -> tuple[str, object]:
    """A key and its value, as YAML reads it."""
    import yaml

    key, equals, value = text.partition("=")
    if not equals or not key:
        raise click.BadParameter(f"{printable(text)[:60]!r}; accepted: KEY=VALUE", param_hint="--set")
    try:
        return key, yaml.safe_load(value)
    except yaml.YAMLError:
        return key, value


def bsdf_of(folder: Path) -> Path:
    """The BSDF in the results of a material; that of a scene may be the one that all scenes share."""
    folder = folder.resolve()
    shared = [folder.parents[2] / folder.name] if folder.parent.parent.name == "scenes" else []
    for place in (folder, *shared):
        for name in ("bsdf.nc", "nominal_bsdf.nc", "planned.nc"):
            if (place / name).is_file():
                return place / name
    raise InputError(folder, "no BSDF in this folder", accepted="the results of a material, with bsdf.nc")


def of_folder(folder: Path) -> tuple[dict[str, Any], xr.Dataset | None]:
    """The figures of the results of a material, with its BSDF; or the materials of a folder of results."""
    from brdfpipe import store

    if (folder / "catalogue.nc").is_file():
        table = store.open_dataset(folder / "catalogue.nc")
        names = [str(name) for name in table["material"].values]
        materials = [_row(table.isel(material=number)) for number in range(len(names))]
        return {"results": str(folder), "materials": dict(zip(names, materials, strict=True))}, None
    if not (folder / "summary.nc").is_file():
        accepted = "a folder of results (catalogue.nc), or that of a material in it (summary.nc)"
        if scenes := sorted(path.parent for path in folder.glob("scenes/*/catalogue.nc")):
            accepted = f"the results of a scene: {abbreviated([str(path) for path in scenes], _MOST_SCENES)}"
        elif (folder.parent / "scenes").is_dir():
            accepted = f"those of the material in a scene, as {folder.parent / 'scenes' / '…' / folder.name}"
        raise InputError(folder, "no results of a build", accepted=accepted)
    row = store.open_dataset(folder / "summary.nc")
    bsdf = store.open_dataset(bsdf_of(folder), "bsdf")
    return {"material": str(row["material"].values[0]), **_row(row.isel(material=0))} | {"bsdf": of_dataset(bsdf)}, bsdf


def _row(row: xr.Dataset) -> dict[str, Any]:
    """What a row of the catalogue says of a material: its verdict and its quantities, as value and standard uncertainty."""
    from brdfpipe.appearance.quantities import quantities

    words = {name: str(row[name].item()) for name in ("description", "route", "verdict", "verdict_text") if name in row}
    known: dict[str, Any] = {name: text for name, text in words.items() if text}
    for one in quantities():
        if one.name in row and one.listed and math.isfinite(value := float(row[one.name])):
            u = float(row[one.u_name]) if one.u_name in row else math.nan
            unit = "" if one.unit == "1" else one.unit
            label = one.symbol or one.label
            known[label] = {"value": value, "u": u if math.isfinite(u) else None, "unit": unit}
    return known


def of_dataset(dataset: xr.Dataset) -> dict[str, Any]:
    """Kind, origin and figures of a dataset."""
    from brdfpipe import vocabulary
    from brdfpipe.bsdf import summary

    kind = dataset.attrs.get("kind", "")
    found: dict[str, Any] = {"kind": kind}
    if kind == "bsdf":
        incidences, names, values = summary.reflectances(dataset)
        found |= summary.properties(dataset)
        found["reflectance"] = {
            f"at {angle:g}°": {name: float(value) for name, value in zip(names, row, strict=True)}
            for angle, row in zip(incidences, values, strict=True)
        }
    else:
        found["sizes"] = {str(name): int(size) for name, size in dataset.sizes.items()}
        if kind == "surface":
            from brdfpipe.catalogue.raw_reading import relief_words

            found["heights"] = relief_words(dataset)
        scalars = [(name, value) for name, value in dataset.data_vars.items() if value.ndim == 0]
        for name, value in scalars[:_MOST_SCALARS]:
            # An axis is that of the page, from 0 to 180 degrees.
            number = round(value.item() % 180, 9) % 180 if name == "lay" else value.item()
            if not (isinstance(number, float) and math.isnan(number)):
                found[str(name)] = (
                    {"value": number, "unit": value.attrs.get("units", "")}
                    if isinstance(number, int | float)
                    else str(number)
                )
        for name, value in dataset.data_vars.items():
            # Figures of a few cases that have names, as the sparkles of pictures by geometry.
            if value.ndim == 1 and value.size <= _MOST_CASES and value.dims[0] in dataset.coords:
                cases = dataset[value.dims[0]]
                if cases.dtype.kind in "OU" and value.dtype.kind == "f":
                    unit = "" if (units := str(value.attrs.get("units", "1"))) == "1" else f" [{units}]"
                    known = zip(map(str, cases.values), value.values.tolist(), strict=True)
                    found[f"{name}{unit}"] = {case: number for case, number in known if math.isfinite(number)}
        for name in ("stage", "material", "method", "band", "history"):
            if text := str(dataset.attrs.get(name, "")):
                found[name] = " ".join(text.splitlines())
    if warned := vocabulary.warnings(dataset):
        found["warnings"] = warned
    return found


def lines(found: dict[str, Any]) -> list[str]:
    if "materials" in found:
        rows = found["materials"]
        width = max((len(name) for name in rows), default=8) + 2
        return [f"{found['results']}: {len(rows)} materials"] + [
            f"  {name:<{width}}{row.get('verdict', ''):<6}{row.get('route', ''):<11}{row.get('description', '')[:_MOST_TEXT]}".rstrip()
            for name, row in rows.items()
        ]
    return list(_listed(found, ""))


_ROUNDING = 1e-9
"""Below it a value without a unit, and its uncertainty, are nothing but rounding."""


def _number(value: float, u: float | None, unit: str = "") -> str:
    """A value, with the digits that its uncertainty leaves to it where that is known."""
    if u and not unit and max(abs(value), u) < _ROUNDING:
        return "0"
    if not u or not math.isfinite(u) or not math.isfinite(value):
        return f"{value:.6g}"
    digits = 1 - math.floor(math.log10(u))
    return f"{value:.{digits}f} ± {u:.{digits}f}" if 0 <= digits <= 6 else f"{value:.6g} ± {u:.2g}"


def _listed(found: dict[str, Any], indent: str) -> Iterator[str]:
    width = max((len(name) for name in found), default=0) + 2
    for name, value in found.items():
        if isinstance(value, dict) and "value" in value:
            unit = "" if value.get("unit") in ("", "1") else f" {'µm' if value['unit'] == 'um' else value['unit']}"
            yield f"{indent}{name:<{width}}{_number(value['value'], value.get('u'), unit)}{unit}"
        elif isinstance(value, dict) and all(isinstance(one, int | float) for one in value.values()):
            yield f"{indent}{name:<{width}}" + "  ".join(f"{key} {one:.4g}" for key, one in value.items())
        elif isinstance(value, dict):
            yield f"{indent}{name}"
            yield from _listed(value, f"{indent}  ")
        elif isinstance(value, list):
            yield from (f"{indent}{name.removesuffix('s')}: {one}" for one in value)
        else:
            yield f"{indent}{name:<{width}}{shortened(str(value), 2 * _MOST_TEXT)}"


def plot(dataset: xr.Dataset) -> list[str]:
    """A plot of what a dataset holds first of all."""
    kind = dataset.attrs.get("kind", "")
    if kind == "bsdf":
        return _cuts(dataset)
    if kind == "surface" and dataset["height"].ndim == 2:
        return ["height, the highest places full", *terminal_plots.relief(dataset["height"].values.astype(float))]
    if kind == "texture":
        name = "height" if "height" in dataset else "relative_light"
        shown, of = dataset[name], ""
        if "geometry" in shown.dims:
            shown, of = shown[0], f" at {dataset['geometry'].values[0]}"
        return [
            f"{name.replace('_', ' ')} of the tile{of}, the highest places full",
            *terminal_plots.relief(shown.values.astype(float)),
        ]
    for title, value in dataset.data_vars.items():
        if (
            value.ndim == 1
            and value.size > 2
            and np.issubdtype(value.dtype, np.number)
            and value.dims[0] in dataset.coords
            and np.issubdtype(dataset[value.dims[0]].dtype, np.number)
        ):
            along = dataset[value.dims[0]]
            label, unit = str(value.attrs.get("long_name", title)), value.attrs.get("units", "1")
            x_label = f"{along.name} [{along.attrs.get('units', '1')}]"
            return terminal_plots.curves(along.values.astype(float), [value.values], x_label, f"{label} [{unit}]")
    return []


def _cuts(bsdf: xr.Dataset) -> list[str]:
    from brdfpipe.report.plots import bsdf_sections

    theta = np.unique(np.concatenate([bsdf_sections.cut_angles(bsdf, angle) for angle in _INCIDENCES]))
    polar, turn = bsdf_sections.in_plane(theta)
    (plane, *_) = bsdf_sections.planes(bsdf)
    several = [bsdf_sections.value(bsdf, plane, angle, polar, turn) for angle in _INCIDENCES]
    angles = ", ".join(f"{angle:g}°" for angle in _INCIDENCES)
    title = f"BRDF {plane.words} at {angles} incidence, {bsdf_sections.wavelength_words(bsdf)} [sr⁻¹]".replace(
        "  ", " "
    )
    return terminal_plots.curves(theta, several, "angle of view [degree]", title, log=True)

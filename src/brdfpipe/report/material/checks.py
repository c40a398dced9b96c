"""Checks of the BRDF (verdicts and residuals), exported files, and provenance of every stage."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.verdicts import check_verdicts, json_object, refused_exports
from brdfpipe.exchange.records import errors_in_brief
from brdfpipe.exchange.registry import FORMATS, LOSSES, REFUSAL_ADVICE
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import quantity
from brdfpipe.texture.file_names import MAP_FILES

_RESIDUALS = (
    "reciprocity_residual",
    "energy_excess",
    "negative_fraction",
    "integral_residual",
    "closure_residual",
    "grazing_growth",
    "floor",
)


def checks_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Verdicts and numbers of the checks."""
    section = Section("Checks", verdicts=check_verdicts(datasets))
    if (checks := datasets.get("checks")) is not None:
        residuals = [checks[name] for name in _RESIDUALS if name in checks]
        rows = [(str(residual.attrs.get("long_name", residual.name)), quantity(residual)) for residual in residuals]
        section.tables.append(Table("Checks in numbers", ("Quantity", "Value"), rows))
    return section


def exports_table(datasets: Mapping[str, xr.Dataset], name: str) -> Table | None:
    """The exported files of a material with their errors, and the exports that were refused; None where there are none."""
    rows = [_exported(dataset) for dataset in datasets.values() if dataset.attrs.get("kind") == "export"]
    if "lambert_gauss" in datasets:
        description = "parameters of the Lambert + Gauss fit"
        rows.append((f"{name}.lambert_gauss.csv", "reflection", description, "", ""))
    if "texture" in datasets:
        rows.append(
            (
                ", ".join(f"{name}{end}" for end in MAP_FILES),
                "reflection",
                "height and normal map of the texture",
                "",
                "",
            )
        )
    if "picture_texture" in datasets:
        listed = ", ".join(_picture_files(datasets["picture_texture"], name))
        rows.append((listed, "reflection", "light over its mean, by geometry", "", ""))
        if files := json_object(datasets["picture_texture"].attrs.get("files")):
            rows.append((", ".join(files), "reflection", "materials of renderers with a texture of these", "", ""))
    if "unresolved" in datasets and (files := json_object(datasets["unresolved"].attrs.get("files"))):
        rows.append((", ".join(files), "reflection", "materials of renderers with these maps", "", ""))
    if "readings" in datasets:
        rows.append((f"{name}.readings.csv", "", "readings of instruments beside their predictions", "", ""))
    note = "In the folder `exports`. A `.json` beside a file states the error of the file against the BSDF, measured off its nodes."
    if refused_exports(datasets):
        note += f" {REFUSAL_ADVICE}."
    headings = "Files", "Side", "Description", "Error", "Not in the file"
    return Table("Exported files", headings, rows, note) if rows else None


def exported_files(datasets: Mapping[str, xr.Dataset], name: str) -> list[str]:
    """Names of the exported files, from the folder of the page."""
    files = [file for dataset in datasets.values() for file in json_object(dataset.attrs.get("files"))]
    named = {"lambert_gauss": "lambert_gauss.csv", "readings": "readings.csv"}
    files += [f"{name}{end}" for end in MAP_FILES if "texture" in datasets]
    if "picture_texture" in datasets:
        files += _picture_files(datasets["picture_texture"], name)
    files += [f"{name}.{suffix}" for stage, suffix in named.items() if stage in datasets]
    return [f"exports/{file}" for file in files]


def _picture_files(texture: xr.Dataset, name: str) -> list[str]:
    numbers = range(1, texture.sizes["geometry"] + 1)
    return [*(f"{name}.texture-{number}.{end}" for number in numbers for end in ("png", "exr")), f"{name}.texture.json"]


def _exported(dataset: xr.Dataset) -> tuple[str, ...]:
    """Files, side, description, error, and what the files leave out."""
    format, side = str(dataset.attrs["format"]), str(dataset.attrs["side"])
    described = FORMATS[format].description if format in FORMATS else format
    if refusals := vocabulary.warnings(dataset):
        return f"{format}: none", side, described, refusals[0], ""
    named = json_object(dataset.attrs["records"])
    errors = {file: errors_in_brief(record) for file, record in named.items()}
    if len(set(errors.values())) > 1:
        errors = {file: f"{file}: {text}" for file, text in errors.items()}
    stated = "; ".join(dict.fromkeys(errors.values()))
    lost = dict.fromkeys(LOSSES[key] for record in named.values() for key in record.get("left_out", {}))
    return ", ".join(json_object(dataset.attrs["files"])), side, described, stated, "; ".join(lost)


def provenance(stage: str, dataset: xr.Dataset) -> dict[str, Any]:
    """Provenance of one stage, for the template."""
    attrs = dataset.attrs
    parameters = json_object(attrs.get("parameters"))
    return {
        "stage": stage,
        "digest": str(attrs.get("digest", "")),
        "inputs": [(name, str(value)) for name, value in json_object(attrs.get("inputs")).items()],
        "parameters": [(name, json.dumps(value, ensure_ascii=False)) for name, value in parameters.items()],
        "software": ", ".join(f"{name} {value}" for name, value in json_object(attrs.get("software")).items()),
        "history": [line for line in str(attrs.get("history", "")).splitlines() if line],
    }

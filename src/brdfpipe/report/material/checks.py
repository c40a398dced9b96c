"""Checks of the BRDF (verdicts and residuals), exported files, and provenance of every stage."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

import xarray as xr

from brdfpipe.appearance.verdicts import check_verdicts, json_object
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange.records import Content, left_out
from brdfpipe.exchange.registry import FORMATS, PROPERTIES, Format
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import quantity

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


def exports_table(datasets: Mapping[str, xr.Dataset], name: str, formats: Collection[str]) -> Table | None:
    """The exported files of a material, described as their formats declare them; None where there are none."""
    bsdf = datasets.get("bsdf")
    sides = ("reflection", "transmission") if bsdf is not None and representation(bsdf).is_slab else ("reflection",)
    rows = [
        (
            ", ".join(f"{name}{suffix}" for suffix in FORMATS[format].suffixes(side)),
            side,
            FORMATS[format].description,
            "" if bsdf is None else _left_out(bsdf, FORMATS[format]),
        )
        for format in formats
        for side in sides
        if side in FORMATS[format].files
    ]
    if "lambert_gauss" in datasets:
        rows.append((f"{name}.lambert_gauss.csv", "reflection", "parameters of the Lambert + Gauss fit", ""))
    if "readings" in datasets:
        rows.append((f"{name}.readings.csv", "", "readings of instruments beside their predictions", ""))
    note = "In the folder `exports`. A `.json` beside a file states the error of the file against the BSDF."
    return Table("Exported files", ("Files", "Side", "Description", "Not in the file"), rows, note) if rows else None


def _left_out(bsdf: xr.Dataset, format: Format) -> str:
    """What the BSDF has and files of the format, with its default options, do not hold."""
    has_spectrum = "spectrum" in format.carries and not format.spectral
    content: Content = "spectrum" if has_spectrum else "luminous"
    return "; ".join(PROPERTIES[name] for name in left_out(bsdf, format, content))


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

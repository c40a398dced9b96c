"""Section of a material's page on the error of the prediction against reference solutions on its own scan."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import MISSING, fixed, number

_NAMES = {"traced": "Traced rays", "kirchhoff": "Diffraction"}
_NOTE = (
    "Predicted over reference light less 1, and predicted less reference gloss, ± 2 standard uncertainties, where a reference holds. Peak: where "
    "the predicted BRDF is above 0.3 of its peak; shoulder: above 0.03. g: variance of the phase of the light; rays hold from 20 on."
)


def model_error_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Light by region, and gloss, beside those of the reference solutions."""
    section = Section("Prediction against reference solutions")
    if (result := datasets.get("model_error")) is None:
        return section
    refusals = [f"{_NAMES[name]}: {text}." for name, text in json.loads(result.attrs["refusals"]).items()]
    section.tables = [_gloss_table(result), _light_table(result, " ".join([_NOTE, *refusals]))]
    return section


def _light_table(result: xr.Dataset, note: str) -> Table:
    rows = [
        (
            f"{theta_i:g}°",
            number(float(result["phase_variance"][row]), 2),
            _NAMES[str(name)],
            *(
                _difference(100 * error, 100 * uncertainty, 1, "\u202f%")
                for error, uncertainty in zip(
                    result["light_error"].sel(reference=name)[row].values,
                    result["light_error_u"].sel(reference=name)[row].values,
                    strict=True,
                )
            ),
        )
        for row, theta_i in enumerate(result["theta_i"].values)
        for name in result["reference"].values
        if result["valid"].sel(reference=name)[row]
    ]
    regions = [str(region).capitalize() for region in result["region"].values]
    return Table("Error of the predicted light", ("Incidence", "g", "Reference", *regions), rows, note)


def _gloss_table(result: xr.Dataset) -> Table:
    rows = []
    for row, angle in enumerate(result["gloss_angle"].values):
        cells = [
            _difference(
                float(result["gloss_error"].sel(reference=name)[row]),
                float(result["gloss_error_u"].sel(reference=name)[row]),
                2,
            )
            if result["gloss_valid"].sel(reference=name)[row]
            else MISSING
            for name in result["reference"].values
        ]
        rows.append((f"{angle:g}°", fixed(float(result["gloss"][row]), 2), *cells))
    header = ("Geometry", "Predicted", *(f"Less {_NAMES[str(name)].lower()}" for name in result["reference"].values))
    return Table("Error of the predicted gloss, without the diffuse part", header, rows)


def _difference(value: float, uncertainty: float, decimals: int, unit: str = "") -> str:
    if not np.isfinite(value):
        return MISSING
    return f"{fixed(value, decimals)}{unit} ± {fixed(2 * uncertainty, decimals)}{unit}"

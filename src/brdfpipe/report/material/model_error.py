"""Section of a material's page on the error of the prediction against reference solutions on its own scan."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import product

import numpy as np
import xarray as xr

from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import MISSING, STANDARD, fixed, number
from brdfpipe.report.material.inputs import facets_reflect
from brdfpipe.report.plots.masking import bistatic_figure

_NAMES = {"traced": "Traced rays", "kirchhoff": "Diffraction"}
_LIGHT_NOTE = (
    "Predicted over reference light less 1, where a reference holds. Peak: where "
    "the predicted BRDF is above 0.3 of its peak; shoulder: above 0.03. g: variance of the phase of the light; rays hold from 20 on, on smooth facets."
)
_NO_REFERENCE = "–: not compared. Rays hold where the variance of the phase g is 20 or more; diffraction on low slopes, away from grazing or where g is 1 or less."
_MASKING_NOTE = "Share of the facets facing both directions that both see, in the mirror direction. Smith: of the slopes of the lines cast."


def model_error_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Light by region, gloss and masking, beside those of the reference solutions."""
    section = Section("Prediction against reference solutions")
    if (result := datasets.get("model_error")) is None:
        return section
    section.tables = [_gloss_table(result), *([light] if (light := _light_table(result)).rows else [])]
    if facets_reflect(datasets.get("bsdf")):
        section.figures += filter(None, [bistatic_figure(result)])
        section.tables.append(_masking_table(result))
    return section


def _light_table(result: xr.Dataset) -> Table:
    rows = []
    # Plain arrays: to select from labelled ones takes a millisecond for each row.
    axes = "theta_i", "plane", "reference"
    valid, phase = result["valid"].transpose("theta_i", "reference").values, result["phase_variance"].values
    light, light_u = (result[name].transpose(*axes, "region").values for name in ("light_error", "light_error_u"))
    for (row, theta_i), (k, plane), (r, name) in product(*(enumerate(result[axis].values) for axis in axes)):
        if valid[row, r] and not np.isnan(light[row, k, r]).all():
            errors = zip(light[row, k, r], light_u[row, k, r], strict=True)
            rows.append(
                (
                    f"{theta_i:g}°" + _in_plane(result, plane),
                    number(float(phase[row]), 2),
                    _NAMES[str(name)],
                    *(_difference(100 * error, 100 * u, 1, "\u202f%") for error, u in errors),
                )
            )
    regions = [str(region).capitalize() for region in result["region"].values]
    return Table(
        f"Error of the predicted light ({STANDARD})", ("Incidence", "g", "Reference", *regions), rows, _LIGHT_NOTE
    )


def _gloss_table(result: xr.Dataset) -> Table:
    rows = []
    for (row, angle), plane in product(enumerate(result["gloss_angle"].values), result["plane"].values):
        one = result.sel(plane=plane).isel(gloss_angle=row)
        known = one["gloss_valid"].values.astype(bool)
        errors = zip(known, one["gloss_error"].values, one["gloss_error_u"].values, strict=True)
        cells = [_difference(float(error), float(u), 2) if valid else MISSING for valid, error, u in errors]
        rows.append((f"{angle:g}°" + _in_plane(result, plane), fixed(float(one["gloss"]), 2), *cells))
    header = ("Geometry", "Predicted", *(f"Less {_NAMES[str(name)].lower()}" for name in result["reference"].values))
    refusals = [f"{_NAMES[name]}: {text}." for name, text in json.loads(result.attrs["refusals"]).items()]
    note = " ".join(["Predicted less reference gloss, without the diffuse part.", _NO_REFERENCE, *refusals])
    return Table(f"Error of the predicted gloss ({STANDARD})", header, rows, note)


def _masking_table(result: xr.Dataset) -> Table:
    columns = (result[name].values for name in ("g2_raycast", "g2_raycast_u", "g2_height_correlated"))
    rows = [
        (f"{theta_i:g}°", _difference(cast, u, 3), fixed(smith, 3))
        for theta_i, cast, u, smith in zip(result["theta_i"].values, *columns, strict=True)
    ]
    title = f"G₂ by ray casting and after Smith ({STANDARD})"
    return Table(title, ("θ", "Ray casting", "Smith"), rows, _MASKING_NOTE)


def _in_plane(result: xr.Dataset, plane: object) -> str:
    return "" if result.sizes["plane"] == 1 else f", {plane}"


def _difference(value: float, uncertainty: float, decimals: int, unit: str = "") -> str:
    if not np.isfinite(value):
        return MISSING
    if not np.isfinite(uncertainty):
        return f"{fixed(value, decimals)}{unit}"
    return f"{fixed(value, decimals)}{unit} ± {fixed(uncertainty, decimals)}{unit}"

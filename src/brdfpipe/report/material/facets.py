"""Facets: slope density, masking, and the comparison with ray casting."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import attribute_note, fixed, grouped, number, quantity
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots import masking, slope_density

RAYCAST_LIMIT = 0.03
"""Difference of G1 by ray casting and after Smith above which the page explains it."""

_TITLES = {
    "slope_rms": "rms slope",
    "anisotropy": "Anisotropy, larger over smaller principal rms slope",
    "lay": "Lay, azimuth of the smaller principal rms slope",
    "facet_count": "Facets",
    "effective_count": "Independent facets",
    "correlation_length": "Correlation length of the heights (1/e)",
    "noise_ratio": "rms slope over 1 pixel / over 2 pixels",
}
_COUNTS = ("facet_count", "effective_count")


def facet_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Slope density and masking."""
    section = Section("Facets")
    if "facets" in datasets:
        section.figures += slope_density.facet_figures(datasets["facets"])
        section.tables.append(_facet_table(datasets["facets"]))
    if "masking" in datasets:
        section.figures.append(masking.raycast_figure(datasets["masking"], datasets.get("facets")))
        bistatic = masking.bistatic_figure(datasets["masking"])
        section.figures += [bistatic] if bistatic else []
        section.tables.append(_raycast_table(datasets["masking"]))
    return section


def _facet_table(facets: xr.Dataset) -> Table:
    rows = [(title, _facet_value(name, facets[name])) for name, title in _TITLES.items() if name in facets]
    if "slope_rms_scale" in facets and "scale" in facets.coords:
        rows += [
            (f"rms slope over {scale:g} pixel{'s' if scale != 1 else ''}", number(value))
            for scale, value in zip(facets["scale"].values, facets["slope_rms_scale"].values, strict=True)
        ]
    return Table("Facets in numbers", ("Quantity", "Value"), rows, attribute_note(facets, ("method", "band")))


def _facet_value(name: str, scalar: xr.DataArray) -> str:
    if name in _COUNTS:
        return grouped(float(scalar))
    return slope_density.axis_degrees(float(scalar)) if name == "lay" else quantity(scalar)


def _raycast_table(comparison: xr.Dataset) -> Table:
    columns = [
        comparison["theta"].values,
        comparison["g1_raycast"].values,
        2 * masking.raycast_uncertainty(comparison),
        comparison["g1_smith"].values,
    ]
    rows = [
        (f"{theta:g}°", fixed(raycast, 4), fixed(expanded_u, 4), fixed(smith, 4), fixed(raycast - smith, 4))
        for theta, raycast, expanded_u, smith in np.stack(columns, axis=1).tolist()
    ]
    header = ("θ", "Ray casting", "± 2 u", "Smith", "Difference")
    note = attribute_note(comparison, ("method",))
    return Table("G₁ by ray casting and after Smith", header, rows, note, _raycast_remark(comparison))


def _raycast_remark(comparison: xr.Dataset) -> str:
    """Reasons and remedies for a difference of G1 that is large and beyond its uncertainty; else empty."""
    difference = np.abs(comparison["g1_raycast"].values - comparison["g1_smith"].values)
    expanded_u = np.nan_to_num(2 * masking.raycast_uncertainty(comparison))
    largest = int(np.argmax(np.where(difference > expanded_u, difference, 0.0)))
    if difference[largest] <= max(RAYCAST_LIMIT, expanded_u[largest]):
        return ""
    return (
        f"Ray casting and Smith differ by up to {fixed(difference[largest], 2)}, at {comparison['theta'].values[largest]:g}°. "
        "For the slopes along one line they agree exactly. The facet distribution is therefore not that of the cast lines. Possible "
        "reasons: the slopes still grow towards one pixel (noise, or a pitch that is too wide); a lay is treated as isotropic; heights "
        "are missing; too few facets are independent. Measure at a smaller pitch, with less noise or over a larger area, or check "
        "`surface.isotropic`. Gloss and reflection at grazing angles have at least this uncertainty."
    )

"""Effect pigments: measured geometries, and the fit along the flake angle."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from brdfpipe.report.cards import Table
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots import flake_angle_plot

_GEOMETRY_NOTE = (
    "θf: flake angle. ΔE00: of the fitted colour. Left out: of the colour that a fit to the other geometries predicts here; needs four "
    "geometries or more."
)


def effect_pigment_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Measured geometries, and the fit."""
    section = Section("Effect pigments")
    flake, multiangle = datasets.get("flake"), datasets.get("multiangle")
    if flake is None or multiangle is None:
        return section
    section.figures.append(flake_angle_plot.flake_angle_plot(flake, multiangle))
    rows = flake_angle_plot.geometry_rows(flake, multiangle)
    section.tables.append(Table("Measured geometries", *rows, _GEOMETRY_NOTE))
    scale = "A and C on the scale of Y = 100." if "channel" in flake.dims else "A and C as fractions."
    section.tables.append(Table("Fit along the flake angle", *flake_angle_plot.parameter_rows(flake), scale))
    return section

"""Checks of the BRDF: verdicts and residuals."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from brdfpipe.appearance.verdicts import check_verdicts
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import quantity
from brdfpipe.report.material.sections import Section

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

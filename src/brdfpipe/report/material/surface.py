"""The measured surface: heights, and surface texture parameters."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import attribute_note, quantity
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots.surface import height_map, height_profile
from brdfpipe.surfaces.texture_parameters import NAMES


def surface_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Heights and surface texture parameters."""
    section = Section("Surface")
    if (surface := datasets.get("surface")) is None:
        return section
    section.figures.append(height_map(surface) if surface["height"].ndim == 2 else height_profile(surface))
    parameters = [surface[name] for name in NAMES if name in surface]
    if parameters:
        rows = [
            (str(parameter.name).replace("_", " "), quantity(parameter), str(parameter.attrs.get("long_name", "")))
            for parameter in parameters
        ]
        note = attribute_note(surface, ("levelling", "band"))
        section.tables.append(Table("Surface parameters", ("Parameter", "Value", "Definition"), rows, note))
    return section

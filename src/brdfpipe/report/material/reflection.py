"""Reflection and transmission: curves, maps and shares of the light, gloss, and the model."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import BrdfpipeError
from brdfpipe.report.material.gloss_table import gloss_table
from brdfpipe.report.material.model_table import model_table
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots import bsdf_cuts, directional_maps, polarisation, reflectance
from brdfpipe.report.plots.svg import sentence


def reflection_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """What the BRDF, and the BTDF where there is one, look like, and the gloss that follows."""
    bsdf = datasets.get("bsdf")
    transmits = bsdf is not None and representation(bsdf).transmits
    section = Section("Reflection and transmission" if transmits else "Reflection")
    if bsdf is not None:
        try:
            section.figures += [*bsdf_cuts.cuts(bsdf), *directional_maps.directional_maps(bsdf)]
        except BrdfpipeError as error:  # a measured table may not cover the directions shown
            section.figures.append(sentence("BRDF in the plane of incidence", f"Not shown: {error}"))
    section.figures += reflectance.shares(datasets.get("checks"), bsdf)
    polarised = polarisation.polarisation(bsdf) if bsdf is not None else None
    section.figures += [polarised] if polarised else []
    table = gloss_table(datasets)
    section.tables += [table] if table else []
    section.tables += [model_table(bsdf)] if bsdf is not None and "masking" in bsdf.attrs else []
    return section

"""Colour: L*a*b* at all geometries, flop index, and the spectrum that they follow from."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.origin import is_measured
from brdfpipe.appearance.quantities import quantity, viewing_conditions
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import STANDARD, basis_legend, fixed, labels, plus_minus_u
from brdfpipe.report.material.inputs import spectrum_section


def colour_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Colours, and for a prediction its spectrum and refractive index."""
    section = Section("") if is_measured(datasets) else spectrum_section(datasets)
    appearance = datasets.get("appearance")
    if appearance is not None and "lab" in appearance:
        section.tables.append(_lab_table(datasets, appearance))
    return Section("Colour", section.figures, section.tables)


def _lab_table(datasets: Mapping[str, xr.Dataset], appearance: xr.Dataset) -> Table:
    geometries, lab = labels(appearance["lab"], "geometry"), appearance["lab"]
    uncertainties = appearance.get("lab_u", xr.full_like(lab, np.nan))
    rows = [
        (geometry, *(f"{fixed(value, 2)} {plus_minus_u(u)}".rstrip() for value, u in zip(values, us, strict=True)))
        for geometry, values, us in zip(geometries, lab.values.tolist(), uncertainties.values.tolist(), strict=True)
    ]
    header: tuple[str, ...] = ("Geometry", "L*", "a*", "b*")
    notes = _lab_notes(datasets, appearance, geometries)
    if "lab_quality" in appearance:
        flags = [vocabulary.QUALITY_FLAGS[flag] for flag in appearance["lab_quality"].values]
        header, rows = (*header, "Basis"), [(*row, flag) for row, flag in zip(rows, flags, strict=True)]
        notes.append(basis_legend(flags))
    return Table(f"L*a*b*, {viewing_conditions(appearance)} ({STANDARD})", header, rows, " ".join(notes))


def _lab_notes(datasets: Mapping[str, xr.Dataset], appearance: xr.Dataset, geometries: list[str]) -> list[str]:
    notes = []
    total = str(appearance.attrs.get("total_geometry", ""))
    if total in geometries:
        notes.append(f"{total}: all reflected light, as an integrating sphere collects it.")
    flop = quantity("flop_index")
    if math.isfinite(value := flop.value(datasets)):
        u = float(appearance.get("flop_index_u", math.nan))
        notes.append(f"{flop.label} {fixed(value, flop.decimals)} {plus_minus_u(u)}".rstrip() + ".")
    elif reason := flop.exclusion(datasets):
        notes.append(f"No {flop.label.lower()}. {reason}")
    if "lab_u" in appearance and "angle_tolerance" in appearance.attrs:
        included = "lab_u_source" in appearance
        others = "from the inputs of the BRDF, its model, and" if included else "from"
        notes.append(
            f"±: standard uncertainty {others} ± {float(appearance.attrs['angle_tolerance']):g}° of the directions of light and of view, an "
            f"assumed tolerance of instruments. {'' if included else 'The uncertainty of the BRDF is not included. '}Apertures are not averaged "
            "over."
        )
        if included and total in geometries and np.isnan(appearance["lab_u"].values[geometries.index(total)]).all():
            notes.append(f"No ± of {total}: the uncertainty of the reflectance spectrum is not known.")
    return notes

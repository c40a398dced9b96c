"""Gloss and haze, with uncertainty and basis."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.appearance.applicability import HAZE_ANGLES, gloss_exclusion, gloss_units, haze_exclusion
from brdfpipe.appearance.gloss_basis import gloss_flags, worst_flag
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import basis_legend, fixed, labels, plus_minus_u

_STYLE_NOTE = "D523-style: computed from the BRDF with the apertures of the standard. Conformance is not claimed."


def gloss_table(datasets: Mapping[str, xr.Dataset]) -> Table | None:
    """Gloss at each geometry, haze after D4039, haze after ISO 13803; None where no gloss was computed."""
    appearance = datasets.get("appearance")
    gloss = gloss_units(appearance)
    if appearance is None or not gloss:
        return None
    header: tuple[str, ...] = ("Geometry", "Gloss units")
    if reason := gloss_exclusion(datasets):
        return Table("Gloss", header, [(", ".join(f"{angle:g}°" for angle in gloss), "not modelled")], reason)
    spread, flags = _tolerances(appearance), gloss_flags(appearance)
    rows = [
        *(
            (f"{angle:g}°", fixed(value, 2), spread.get(angle, ""), flags.get(angle, ""))
            for angle, value in gloss.items()
        ),
        *_d4039_rows(datasets, appearance),
        *_iso_13803_rows(appearance),
    ]
    columns, note = [0, 1], _STYLE_NOTE + _clear_coat_note(datasets.get("bsdf"))
    if spread:
        title, sentence = _uncertainty_words(appearance)
        columns, header, note = [*columns, 2], (*header, title), note + sentence
    if flags:
        columns, header, note = [*columns, 3], (*header, "Basis"), f"{note} {basis_legend(flags.values())}"
    return Table("Gloss", header, [[row[column] for column in columns] for row in rows], note)


def _d4039_rows(datasets: Mapping[str, xr.Dataset], appearance: xr.Dataset) -> list[tuple[str, str, str, str]]:
    """G60 − G20, called haze only where D4039 applies."""
    if "haze" not in appearance or not np.isfinite(appearance["haze"]):
        return []
    title = "60° − 20°" if haze_exclusion(datasets) else "Haze (D4039-style), 60° − 20°"
    u = plus_minus_u(float(appearance.get("haze_u", math.nan)))
    return [(title, fixed(float(appearance["haze"]), 2), u, worst_flag(appearance, *HAZE_ANGLES))]


def _iso_13803_rows(appearance: xr.Dataset) -> list[tuple[str, str, str, str]]:
    """Haze of every window."""
    if "reflectance_haze" not in appearance:
        return []
    haze = appearance["reflectance_haze"]
    uncertainties = appearance.get("reflectance_haze_u", xr.full_like(haze, np.nan)).values.tolist()
    values = zip(labels(haze, "haze_window"), haze.values.tolist(), uncertainties, strict=True)
    return [(f"Haze (ISO 13803-style), {window}", fixed(value, 2), plus_minus_u(u), "") for window, value, u in values]


def _tolerances(appearance: xr.Dataset) -> dict[float, str]:
    """± of gloss by geometry."""
    if "gloss_u" not in appearance:
        return {}
    angles, uncertainties = appearance["gloss_angle"].values.tolist(), appearance["gloss_u"].values.tolist()
    return {angle: plus_minus_u(u) for angle, u in zip(angles, uncertainties, strict=True) if math.isfinite(u)}


def _uncertainty_words(appearance: xr.Dataset) -> tuple[str, str]:
    """Title of the column, and a sentence on what the uncertainty contains."""
    if "BSDF" in str(appearance["gloss_u"].attrs.get("long_name", "")):
        return (
            "Uncertainty",
            " Uncertainty: standard uncertainty from the tolerances of apertures and axes; that of gloss includes the uncertainty of the "
            "BRDF, that of haze does not.",
        )
    return (
        "Tolerances",
        " Tolerances: standard uncertainty from the tolerances of apertures and axes. The uncertainty of the BRDF is not included.",
    )


def _clear_coat_note(bsdf: xr.Dataset | None) -> str:
    """The assumption on the clear coat of a paint; empty for other materials."""
    coat = "none" if bsdf is None else bsdf.attrs.get("clear_coat", "none")
    if bsdf is None or coat == "none":
        return ""
    if coat == "rough":
        slope = float(bsdf["clear_coat_slope"])
        return f" The slope of the clear coat is given ({slope:g}), not measured; gloss and haze follow from it."
    return " The clear coat is assumed smooth, not measured; gloss and haze follow from it."

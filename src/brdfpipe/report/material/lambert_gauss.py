"""The fit of a Lambertian and a Gaussian part at each angle of incidence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import number
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots import bsdf_sections

RESIDUAL_LIMIT = 0.2
"""Residual above which a Gaussian does not describe the lobe."""

_COLUMNS = (
    ("lambert", "Lambertian ρ", 1.0),
    ("gauss_peak", "Peak G₀, sr⁻¹", 1.0),
    ("gauss_fwhm_parallel", "FWHM ∥, °", 1.0),
    ("gauss_fwhm_perpendicular", "FWHM ⊥, °", 1.0),
    ("gauss_reflectance", "Gaussian ρ", 1.0),
    ("fit_residual", "Residual, %", 100.0),
)


def lambert_gauss_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """Parameters and residuals of the fit."""
    section = Section("Lambert + Gauss fit")
    fit = datasets.get("lambert_gauss")
    if fit is None or "theta_i" not in fit.coords:
        return section
    theta_i = np.atleast_1d(fit["theta_i"].values)
    present = [(name, title, factor) for name, title, factor in _COLUMNS if name in fit]
    columns = [
        np.broadcast_to(factor * bsdf_sections.at_reference(fit[name]).values, theta_i.shape)
        for name, _, factor in present
    ]
    rows = [(f"{angle:g}°", *(number(column[k]) for column in columns)) for k, angle in enumerate(theta_i)]
    note = "Residual: flux-weighted rms misfit over the flux-weighted rms BRDF."
    if "wavelength" in fit["lambert"].dims:
        note = f"Lambertian ρ {bsdf_sections.wavelength_words(fit)}. {note}"
    header = ("Incidence", *(title for _, title, _ in present))
    section.tables.append(Table("Fit at each angle of incidence", header, rows, note, _residual_remark(fit)))
    return section


def _residual_remark(fit: xr.Dataset) -> str:
    """Incidences at which the lobe is not a Gaussian; empty where there are none."""
    if "fit_residual" not in fit:
        return ""
    theta_i = np.atleast_1d(fit["theta_i"].values)
    poor = theta_i[np.broadcast_to(fit["fit_residual"].values, theta_i.shape) > RESIDUAL_LIMIT].tolist()
    if not poor:
        return ""
    angles = "every incidence" if len(poor) == theta_i.size > 1 else ", ".join(f"{angle:g}°" for angle in poor)
    return f"Residual above {100 * RESIDUAL_LIMIT:.0f}\u202f% at {angles}: the lobe is not a Gaussian there. Use the table or the BSDF itself."

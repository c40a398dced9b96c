"""Spectrum and refractive index."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.appearance.origin import is_measured
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.material.sections import Section
from brdfpipe.report.plots import dispersion
from brdfpipe.report.plots.spectrum import spectrum_figure

_LINES_F_D_C = np.array([486.1, 587.6, 656.3])
"""Wavelengths at which refractive indices are quoted [nm]."""


def spectrum_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The spectrum and the refractive index that a BRDF is modelled from."""
    section = Section("Spectrum and index")
    model = datasets.get("predicted" if is_measured(datasets) else "bsdf")
    if "spectrum" in datasets:
        section.figures.append(spectrum_figure(datasets["spectrum"], model))
        recovery = _recovery_table(datasets["spectrum"])
        section.tables += [recovery] if recovery else []
    if "index" in datasets:
        section.figures += dispersion.dispersion(datasets["index"], model)
        section.tables += [_index_table(datasets["index"])] if dispersion.dispersive(datasets["index"]) else []
    return section


def _recovery_table(spectrum: xr.Dataset) -> Table | None:
    """Residual of a spectrum recovered from a colour, and its difference from another recovery under other illuminants."""
    residual = float(spectrum.attrs.get("residual_delta_e", math.nan))
    if not math.isfinite(residual):
        return None
    other_method = str(spectrum.attrs.get("metamerism_against", ""))
    differences = {
        name.removeprefix("metamerism_"): float(value)
        for name, value in spectrum.attrs.items()
        if name.startswith("metamerism_") and name != "metamerism_against"
    }
    rows = [("ΔE*ab to the given colour", fixed(residual, 2))]
    rows += [(f"ΔE00 to {other_method} under {light}", fixed(value, 2)) for light, value in differences.items()]
    note = f"Recovered by {spectrum.attrs['method']}. Many spectra have the same colour."
    if differences:
        note += f" ΔE00: colour difference from the spectrum that {other_method} recovers, under another illuminant."
    else:
        note += " No other exact method reaches this colour: its uncertainty under another illuminant is not known."
    return Table("Recovery of the spectrum", ("Quantity", "Value"), rows, note)


def _index_table(index: xr.Dataset) -> Table:
    wavelength = np.atleast_1d(index["wavelength"].values) if "wavelength" in index.coords else _LINES_F_D_C
    n, k = (
        np.interp(_LINES_F_D_C, wavelength, np.broadcast_to(index[name].values, wavelength.shape))
        for name in ("n", "k")
    )
    lines = zip(_LINES_F_D_C, n, k, strict=True)
    rows = [(f"{line:g} nm", fixed(real, 4), number(imaginary)) for line, real, imaginary in lines]
    return Table("Refractive index at the lines F, d and C", ("Wavelength", "n", "k"), rows)

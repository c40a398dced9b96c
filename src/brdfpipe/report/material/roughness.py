"""Section on the roughness spectrum: its figure, the rms heights that it and the heights give, and what each frequency scatters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from brdfpipe.bsdf.light_shares import scattered_rms_height
from brdfpipe.report.cards import Section, Table
from brdfpipe.report.formatting import NOT_DETERMINED, STANDARD, attribute_note, number
from brdfpipe.report.plots.cutoffs import slope_by_cutoff
from brdfpipe.report.plots.roughness_spectrum import instrument_frequencies, roughness_spectrum


def roughness_section(datasets: Mapping[str, xr.Dataset]) -> Section:
    """The roughness spectrum; empty where there is none, or where the surface is flat."""
    section = Section("Roughness spectrum")
    psd = datasets.get("psd")
    if psd is None or not psd["psd"].values.any():
        return section
    section.figures.append(roughness_spectrum(psd))
    if psd.attrs["form"] == "measured" and "surface" in datasets:
        section.figures.append(slope_by_cutoff(psd, datasets["surface"]))
    section.tables += [_heights_table(psd, datasets.get("bsdf")), _frequency_table(psd)]
    return section


def _heights_table(psd: xr.Dataset, bsdf: xr.Dataset | None) -> Table:
    band = f"{number(float(psd['band_low']))} to {number(float(psd['band_high']))} µm⁻¹"
    waves = f"waves of {number(1 / float(psd['band_high']))} to {number(1 / float(psd['band_low']))} µm"
    rows = [("Band", band, waves)]
    if "scan_band_low" in psd:
        bands = zip(psd["scan_band_low"].values, psd["scan_band_high"].values, strict=True)
        rows += [
            (f"Band of scan {scan}", f"{number(float(low))} to {number(float(high))} µm⁻¹", "joined by uncertainty")
            for scan, (low, high) in enumerate(bands, start=1)
        ]
    if psd.attrs["form"] == "measured":
        slope = number(float(psd.get("long_slope", 0.0)))
        long = f"below the band; slope {slope}, so that their light stays near the mirror direction"
        rows += [
            (
                "rms height of the levelled heights",
                _nanometres(psd, "sigma_heights"),
                "all waves, also longer than the band; without noise",
            ),
            ("rms height of the spectrum", _nanometres(psd, "sigma"), "in its band"),
            *([("rms height of longer waves", _nanometres(psd, "long_sigma"), long)] if "long_sigma" in psd else []),
            ("rms height of the fitted form", _nanometres(psd, "fit_sigma"), "all waves, extrapolated"),
            (
                "Noise of the heights",
                _nanometres(psd, "noise_sigma"),
                "subtracted" if float(psd["noise_sigma"]) else "none known",
            ),
        ]
    else:
        rows.append(("rms height", _nanometres(psd, "sigma"), "assumed"))
    if bsdf is not None:
        rows.append(_scattered_height(bsdf))
    rows.append(("Correlation length ℓ", _with_u(psd, "fit_length", 1, "µm"), "of the form"))
    if psd["fit_slope"].notnull():
        rows.append(("Exponent of the decay", _with_u(psd, "fit_slope", 1), "of the form, at high frequencies"))
    if "fit_residual_log" in psd:
        rows.append(
            ("Scatter about the form", f"{number(100 * float(psd['fit_residual_log']))} %", "rms of the logarithm")
        )
    return Table(
        f"Roughness in numbers ({STANDARD})", ("Quantity", "Value", "Of"), rows, attribute_note(psd, ("form", "method"))
    )


def _scattered_height(bsdf: xr.Dataset) -> tuple[str, str, str]:
    """The rms height that the BSDF tells, beside those of the heights and of the spectrum."""
    height = scattered_rms_height(bsdf)
    name = "rms height that the BSDF scatters by"
    if np.isnan(height):
        return (
            name,
            "not recoverable",
            "nothing is mirrored coherently at 5° and 550 nm, or the BSDF does not part it from the rest",
        )
    return name, f"{number(1000 * height)} nm", "waves that scatter into the hemisphere, from TIS at 5° and 550 nm"


def _frequency_table(psd: xr.Dataset) -> Table:
    low, high = float(psd["band_low"]), float(psd["band_high"])
    rows = [
        (
            name,
            number(value),
            "measured" if low <= value <= high else "below the band" if value < low else "above the band",
        )
        for name, value in instrument_frequencies()
    ]
    note = "Spatial frequency that scatters light of 550 nm from the mirror direction to the place named, f = |sin θo − sin θi| / λ."
    return Table("Frequencies that matter", ("Direction", "µm⁻¹", "Spectrum"), rows, note)


def _nanometres(psd: xr.Dataset, name: str) -> str:
    return _with_u(psd, name, 1000, "nm")


def _with_u(psd: xr.Dataset, name: str, factor: float, unit: str = "") -> str:
    """Value, standard uncertainty and unit; ``not determined`` where the uncertainty exceeds the value."""
    value, u = factor * float(psd[name]), factor * float(psd.get(f"{name}_u", 0.0))
    if u > abs(value) > 0:
        return NOT_DETERMINED
    return " ".join(filter(None, (number(value), f"± {number(u, 2)}" if u else "", unit)))

"""Roughness spectrum with its band, noise floor and fit, and the frequencies that scatter into instruments."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from brdfpipe.appearance.gloss_meter import RECEPTOR
from brdfpipe.appearance.haze import WINDOWS
from brdfpipe.psd.analytic_spectra import spectrum_of
from brdfpipe.report.formatting import EXPANDED_UNCERTAINTY
from brdfpipe.report.plots.svg import Axis, Band, Figure, Line, Mark, chart, legend

WAVELENGTH = 0.55
"""Wavelength of the frequencies of instruments [um]."""
_DECADES_SHOWN = 12
_BAND_SPACING = 0.025
"""Distance between the bands of scans, over the height of the figure."""


def instrument_frequencies() -> list[tuple[str, float]]:
    """What lies beside the mirror direction, and the spatial frequency [um-1] that scatters light of 550 nm there, in the plane of incidence."""
    places = [
        (f"edge of the receptor, gloss {angle:g}°", angle, along / 2) for angle, (along, _) in sorted(RECEPTOR.items())
    ]
    places += [(f"haze window at {window.offset:g}°", window.angle, window.offset) for window in WINDOWS]
    found = [(name, _frequency(angle, offset)) for name, angle, offset in places]
    return [*found, ("grazing, normal incidence: 1/λ", 1 / WAVELENGTH)]


def _frequency(angle: float, offset: float) -> float:
    return abs(math.sin(math.radians(angle)) - math.sin(math.radians(angle - offset))) / WAVELENGTH


def roughness_spectrum(psd: xr.Dataset) -> Figure:
    """The spectrum, double logarithmic."""
    frequency, density, u = (psd[name].values for name in ("frequency", "psd", "psd_uncertainty"))
    marks: list[Mark] = []
    if np.any(u):
        marks.append(
            Band(frequency, np.maximum(density - 2 * u, density / 100), density + 2 * u, "c0", EXPANDED_UNCERTAINTY)
        )
    start, end = float(frequency[0]) / 1.5, float(frequency[-1]) * 1.5
    if "apparent_psd" in psd:
        apparent = psd["apparent_frequency"].values
        marks.append(Line(apparent, psd["apparent_psd"].values, "c1", "with noise, all frequencies", "dots"))
        start, end = min(start, float(apparent[0]) / 1.2), max(end, float(apparent[-1]) * 1.2)
    end = max(end, 1.2 / WAVELENGTH)
    marks.append(Line(frequency, density, "c0", "surface"))
    fine = np.geomspace(start, end, 200)
    title = "Gaussian" if psd["fit_slope"].isnull() else "K-correlation"
    marks.append(
        Line(
            fine,
            spectrum_of(psd)(fine),
            "ref",
            f"{title}, fitted" if psd.attrs["form"] == "measured" else title,
            "dash",
        )
    )
    top = 10.0 ** math.ceil(math.log10(float((density + 2 * u).max())) + 0.1)
    lowest = float(density[density > 0].min())
    if float(psd.get("noise_psd", 0.0)) > 0:
        lowest = min(lowest, float(psd["noise_psd"]))
        marks.append(Line([start, end], [float(psd["noise_psd"])] * 2, "c3", "noise, subtracted", "dash"))
    bottom = max(10.0 ** math.floor(math.log10(lowest) - 0.1), top * 10.0**-_DECADES_SHOWN)
    label = "into instruments, and 1/λ"
    for _, value in instrument_frequencies():
        if start < value < end:
            marks.append(Line([value, value], [bottom, top], "c4", label, "dots"))
            label = ""
    if "scan_band_low" in psd:
        label, height = "bands of the scans", top
        for low, high in zip(psd["scan_band_low"].values, psd["scan_band_high"].values, strict=True):
            height /= (top / bottom) ** _BAND_SPACING
            marks.append(Line([float(low), float(high)], [height, height], "c2", label))
            label = ""
    svg = chart(
        "Power spectral density of the heights against spatial frequency, both logarithmic",
        Axis("spatial frequency, µm⁻¹", start, end, log=True),
        Axis("spectral density S, µm⁴", bottom, top, log=True),
        marks,
    )
    return Figure(
        "Roughness spectrum",
        svg,
        legend(marks),
        "Upright lines: the frequencies that matter, of the table of this name.",
    )

"""Slope rms against the cutoff of a low-pass filter, for the choice of λs and λc."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array
from brdfpipe.report.plots.roughness_spectrum import WAVELENGTH
from brdfpipe.report.plots.svg import Axis, Figure, Line, Mark, Pattern, chart, legend
from brdfpipe.surfaces.filtering import ALPHA, LEAST_PITCHES

_CUTOFFS = 60


def slope_rms_behind(frequency: Array, density: Array, cutoff: Array) -> Array:
    """Slope rms √⟨p² + q²⟩ that remains behind a Gaussian low-pass filter.

    Parameters
    ----------
    frequency, density : (n,) µm⁻¹, increasing, and the spectral density of the heights over the plane of frequencies [µm⁴]
    cutoff : (m,) λs [µm]

    Returns
    -------
    (m,), of the waves in the band of the spectrum alone: ∫ (2πf)² S exp(−2π (α λs f)²) 2πf df, with α of ISO 16610
    """
    passed = np.exp(-2 * np.pi * (ALPHA * cutoff[:, None] * frequency) ** 2)
    integrand = (2 * np.pi * frequency) ** 2 * density * 2 * np.pi * frequency
    return np.asarray(np.sqrt(np.trapezoid(np.maximum(integrand, 0.0) * passed, frequency, axis=1)))


def slope_by_cutoff(psd: xr.Dataset, surface: xr.Dataset) -> Figure:
    """Slope rms behind λs, with the pitch, half a wavelength of light and the chosen cutoffs marked.

    Parameters
    ----------
    psd : kind ``psd``, measured
    surface : kind ``surface``, the first scan
    """
    pitch = max(float(surface.attrs[name]) for name in ("pitch_x", "pitch_y") if name in surface.attrs)
    frequency = psd["frequency"].values
    start, end = min(pitch, WAVELENGTH / 2) / 2, 1 / float(frequency[0])
    cutoff = np.geomspace(start, end, _CUTOFFS)
    slopes = slope_rms_behind(frequency, psd["psd"].values, cutoff)
    marks: list[Mark] = [Line(cutoff, slopes, "c0", "surface")]
    top = float(slopes.max())
    if "apparent_psd" in psd:
        noisy = slope_rms_behind(psd["apparent_frequency"].values, psd["apparent_psd"].values, cutoff)
        marks.append(Line(cutoff, noisy, "c1", "with noise", "dots"))
        top = max(top, float(noisy.max()))
    top = 10.0 ** math.ceil(math.log10(top) + 0.05)
    bottom = min(top / 100, 10.0 ** math.floor(math.log10(max(float(slopes.min()), top * 1e-4))))
    places: list[tuple[str, float, str, Pattern]] = [
        ("pitch", pitch, "c3", "dots"),
        (f"{LEAST_PITCHES} pitches, the least λs", LEAST_PITCHES * pitch, "c3", "dash"),
        ("half a wavelength of light", WAVELENGTH / 2, "c4", "dots"),
        *(
            (f"{symbol} in use", float(surface.attrs[name]), "c2", "line")
            for symbol, name in (("λs", "lambda_s"), ("λc", "lambda_c"))
            if name in surface.attrs
        ),
    ]
    marks += [
        Line([at, at], [bottom, top], colour, label, style) for label, at, colour, style in places if start < at < end
    ]
    svg = chart(
        "Root mean square slope of the surface behind a low-pass filter against its cutoff, both logarithmic",
        Axis("cutoff λs, µm", start, end, log=True),
        Axis("slope rms behind it", bottom, top, log=True),
        marks,
    )
    note = (
        "Where both curves part, noise carries the slopes: a λs there, of 4 pitches or more, removes it, or `surface.noise` subtracts it. A λc belongs "
        "where the curve is close to level zero, so that it removes form and waviness and no slopes. docs/materials.md, “Choosing λs and λc”."
    )
    return Figure("Slopes by cutoff", svg, legend(marks), note)

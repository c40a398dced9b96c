"""Reflectance spectrum, and the strip of visible colours below wavelength axes."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf.registry import representation
from brdfpipe.report.formatting import EXPANDED_UNCERTAINTY
from brdfpipe.report.plots.bsdf_sections import surface_words
from brdfpipe.report.plots.svg import Array, Axis, Band, Figure, Line, Mark, chart, legend, png
from brdfpipe.spectra.colorimetry import encoded_srgb, srgb_from_xyz, weights


def spectrum_figure(spectral: xr.Dataset, bsdf: xr.Dataset | None = None) -> Figure:
    """Measured reflectance, total reflectance where it differs, and the part that the facets reflect."""
    measured = spectral["total_reflectance"]
    wavelength, values = measured["wavelength"].values.astype(float), measured.values.astype(float)
    total = _total(spectral, bsdf)
    excluded = spectral.attrs.get("geometry") == "sce"
    style, label = ("c1", "measured, specular excluded") if excluded else ("c0", "total reflectance")
    marks: list[Mark] = []
    uncertainty = spectral.get("total_reflectance_u")
    if uncertainty is not None and np.isfinite(uncertainty.values).any():
        u = 2 * uncertainty.values
        marks.append(Band(wavelength, values - u, values + u, style, EXPANDED_UNCERTAINTY))
    if total is not None:
        marks.append(Line(*total, "c0", "total reflectance"))
    marks.append(Line(wavelength, values, style, label))
    specular = _specular_part(bsdf, wavelength)
    if specular is not None:
        marks.append(Line(wavelength, specular, "c2", surface_words(bsdf), "dash"))
    highest = max(float(np.nanmax(np.asarray(mark.y))) for mark in marks if isinstance(mark, Line))
    top = next((limit for limit in (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0) if highest * 1.03 <= limit), highest * 1.05)
    low, high = float(wavelength[0]), float(wavelength[-1])
    svg = chart(
        "Reflectance against wavelength: " + ", ".join(mark.label for mark in marks),
        Axis("wavelength, nm", low, high, step=50 if high - low < 500 else None),
        Axis("reflectance", 0.0, top),
        marks,
        strip=visible_strip(low, high),
    )
    body = "" if specular is None else " The light between both curves comes from the body: its shape is the colour."
    return Figure("Spectrum", svg, legend(marks), _measurement_note(spectral, total is not None) + body)


def visible_strip(low: float, high: float) -> str:
    """Colours of the spectrum between two wavelengths, as an image one pixel high."""
    light = weights("E", 2)
    linear = light.weights @ srgb_from_xyz(light.white).T
    wavelength = np.linspace(low, high, 140)
    channels = [np.interp(wavelength, light.wavelength, channel, 0.0, 0.0) for channel in (linear / linear.max()).T]
    return png((255 * encoded_srgb(np.stack(channels, axis=-1))).round().astype(np.uint8)[None])


def _total(spectral: xr.Dataset, bsdf: xr.Dataset | None) -> tuple[Array, Array] | None:
    """Wavelengths and total reflectance of the BSDF, where the spectrum was measured with the specular component excluded."""
    if spectral.attrs.get("geometry") != "sce" or bsdf is None or "total_reflectance" not in bsdf:
        return None
    total = bsdf["total_reflectance"]
    if total.dims != ("wavelength",):
        return None
    return total["wavelength"].values.astype(float), total.values.astype(float)


def _measurement_note(spectral: xr.Dataset, completed: bool) -> str:
    geometry = {"sci": "Specular included", "sce": "Specular excluded"}.get(str(spectral.attrs.get("geometry")), "")
    incidence, method = spectral.attrs.get("theta_i"), str(spectral.attrs.get("method", ""))
    method = {"lhtss": "recovered from L*a*b* as the smoothest spectrum (LHTSS)"}.get(method, method)
    angle = f"incidence {float(incidence):g}°" if incidence is not None else ""
    sentence = ", ".join(words for words in (geometry, angle, method) if words)
    note = sentence[:1].upper() + sentence[1:] + "." if sentence else ""
    excluded = " The total reflectance includes the mirrored light that the measurement excluded."
    return note + (excluded if completed else "")


def _specular_part(bsdf: xr.Dataset | None, wavelength: Array) -> Array | None:
    """Reflectance of the facets at the incidence of the measurement, mean over azimuths for a surface with a lay."""
    if bsdf is None or "theta_m" not in bsdf or (facets := representation(bsdf).without_diffuse()) is None:
        return None
    azimuth = hemisphere.azimuths(representation(bsdf).isotropic)
    incidence = np.full(azimuth.size, float(bsdf["theta_m"]))
    part = representation(facets).albedo(incidence, azimuth, None).mean(axis=0)
    if not part.any():
        return None
    return (
        np.full(wavelength.size, part[0]) if part.size == 1 else np.interp(wavelength, bsdf["wavelength"].values, part)
    )

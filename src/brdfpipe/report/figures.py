"""The figures of colour and relief; those of the facets: :mod:`.finish`, of the BSDF: :mod:`.reflection` and :mod:`.lobes`."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from brdfpipe import hemisphere
from brdfpipe.bsdf import representations
from brdfpipe.report import scattering
from brdfpipe.report.raster import false_colour, framed
from brdfpipe.report.svg import (
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    chart,
    legend,
    linear_ticks,
    nice_range,
    png,
)

_MAP_PIXELS = 300


def height_map(surface: xr.Dataset) -> Figure:
    """The levelled height map, in false colour."""
    height = surface["height"]
    extent_x, extent_y = (_extent(height[axis].values.astype(float)) for axis in ("x", "y"))
    values = height.values
    missing = float(np.mean(np.isnan(values)))
    small = _reduced(values)
    low, high = _robust_range(small)
    svg, to_scale = framed(
        f"Height map, {extent_x:.4g} by {extent_y:.4g} micrometres, heights from {low:.3g} to {high:.3g} micrometres",
        png(*false_colour(small, low, high)),
        ("x, µm", 0.0, extent_x),
        ("y, µm", 0.0, extent_y),
        "µm",
        [((value - low) / (high - low), name) for value, name in linear_ticks(low, high, count=5)],
    )
    key = (("missing", "", f"missing heights ({100 * missing:.2g} %)"),) if missing else ()
    note = f"{values.shape[1]} × {values.shape[0]} heights; colours span the middle 99 % of them."
    return Figure("Height, levelled", svg, key, note if to_scale else f"{note} x and y are not to the same scale.")


def profile(surface: xr.Dataset) -> Figure:
    """The levelled line profile."""
    x = surface["height"]["x"].values.astype(float)
    height = surface["height"].values.astype(float)
    low, high = nice_range(float(np.nanmin(height)), float(np.nanmax(height)), margin=0.06)
    axis_x = Axis("x, µm", 0.0, float(x[-1] - x[0]))
    axis_y = Axis("height, µm", low, high)
    shown_x, shown = _envelope(x - x[0], height)
    svg = chart("Levelled line profile, height against position", axis_x, axis_y, [Line(shown_x, shown)], height=240)
    missing = float(np.mean(np.isnan(height)))
    note = f"{height.size} heights" + (f", {100 * missing:.2g} % missing." if missing else ".")
    return Figure("Height, levelled", svg, note=note)


def spectrum(spectral: xr.Dataset, bsdf: xr.Dataset | None = None) -> Figure:
    """What was measured, the total reflectance where that is another thing, and the part that the facets mirror."""
    measured = spectral["total_reflectance"]
    wavelength, values = measured["wavelength"].values.astype(float), measured.values.astype(float)
    total = _total(spectral, bsdf)
    excluded = spectral.attrs.get("geometry") == "sce"
    style, words = ("c1", "measured, specular excluded") if excluded else ("c0", "total reflectance")
    marks: list[Mark] = []
    uncertainty = spectral.get("total_reflectance_u")
    if uncertainty is not None and np.isfinite(uncertainty.values).any():
        u = 2 * uncertainty.values
        marks.append(Band(wavelength, values - u, values + u, style, "± 2 standard uncertainties"))
    if total is not None:
        marks.append(Line(*total, "c0", "total reflectance"))
    marks.append(Line(wavelength, values, style, words))
    specular = _specular_part(bsdf, wavelength)
    if specular is not None:
        marks.append(Line(wavelength, specular, "c2", "mirrored by the facets", "dash"))
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
    return Figure("Spectrum", svg, legend(marks), _spectrum_words(spectral, total is not None))


def visible_strip(low: float, high: float) -> str:
    """Colours of the spectrum between two wavelengths, as an image one pixel high."""
    wavelength = np.linspace(low, high, 140)
    x, y, z = _tristimulus(wavelength)
    linear = np.stack(
        [
            3.2406 * x - 1.5372 * y - 0.4986 * z,
            -0.9689 * x + 1.8758 * y + 0.0415 * z,
            0.0557 * x - 0.2040 * y + 1.0570 * z,
        ],
        axis=-1,
    )
    linear = np.clip(linear, 0, None)
    linear = np.minimum(linear / 1.35, 1)
    return png(np.asarray((255 * linear ** (1 / 2.2)).round(), dtype=np.uint8)[None])


# --- data


def _total(spectral: xr.Dataset, bsdf: xr.Dataset | None) -> tuple[Array, Array] | None:
    """Wavelengths and total reflectance of the BSDF where the spectrum was measured with the specular excluded."""
    if spectral.attrs.get("geometry") != "sce" or bsdf is None or "total_reflectance" not in bsdf:
        return None
    total = bsdf["total_reflectance"]
    if total.dims != ("wavelength",):
        return None
    return total["wavelength"].values.astype(float), total.values.astype(float)


def _spectrum_words(spectral: xr.Dataset, completed: bool) -> str:
    geometry = {"sci": "Specular included", "sce": "Specular excluded"}.get(str(spectral.attrs.get("geometry")), "")
    incidence, method = spectral.attrs.get("theta_i"), str(spectral.attrs.get("method", ""))
    method = {"lhtss": "recovered from L*a*b* as the smoothest spectrum (LHTSS)"}.get(method, method)
    words = [geometry, f"incidence {float(incidence):g}°" if incidence is not None else "", method]
    sentence = ", ".join(word for word in words if word)
    sentence = sentence[:1].upper() + sentence[1:] + "." if sentence else ""
    added = " The total reflectance adds the mirrored light that the measurement excluded." if completed else ""
    return sentence + added


def _specular_part(bsdf: xr.Dataset | None, wavelength: Array) -> Array | None:
    """What the facets mirror at the incidence of the measurement, mean over the azimuths of a lay."""
    if bsdf is None or "theta_m" not in bsdf or (facets := scattering.facets_alone(bsdf)) is None:
        return None
    azimuth = hemisphere.azimuths(representations.isotropic(bsdf))
    incidence = np.full(azimuth.size, float(bsdf["theta_m"]))
    part = representations.albedo(facets, incidence, azimuth, None).mean(axis=0)
    if not part.any():
        return None
    if part.size == 1:
        return np.full(wavelength.size, float(part[0]))
    return np.asarray(np.interp(wavelength, bsdf["wavelength"].values, part))


# --- pictures


def _reduced(height: Array) -> Array:
    """At most ``_MAP_PIXELS`` along the longer side: means of blocks, missing where half of a block is."""
    step = math.ceil(max(height.shape) / _MAP_PIXELS)
    # A mean over four samples of each block, not over all: a map of 4096² heights must not hold up the page.
    stride = max(1, step // 2)
    sampled = height[::stride, ::stride]
    block = math.ceil(step / stride)
    rows, columns = sampled.shape[0] // block, sampled.shape[1] // block
    blocks = sampled[: rows * block, : columns * block].astype(float).reshape(rows, block, columns, block)
    present = np.isfinite(blocks)
    count = present.sum(axis=(1, 3))
    total = np.where(present, blocks, 0.0).sum(axis=(1, 3))
    return np.where(2 * count > block**2, total / np.maximum(count, 1), np.nan)


def _extent(positions: Array) -> float:
    pitch = (positions[-1] - positions[0]) / max(positions.size - 1, 1)
    return float(positions[-1] - positions[0] + pitch)


def _robust_range(values: Array) -> tuple[float, float]:
    present = values[np.isfinite(values)]
    if present.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(present, [0.5, 99.5])
    return (float(low), float(high)) if high > low else nice_range(float(low), float(high))


def _tristimulus(wavelength: Array) -> tuple[Array, Array, Array]:
    """CIE 1931 colour-matching functions by Gaussian lobes (Wyman 2013): close enough to paint a strip, not to measure."""

    def lobe(height: float, centre: float, below: float, above: float) -> Array:
        width = np.where(wavelength < centre, below, above)
        return np.asarray(height * np.exp(-0.5 * ((wavelength - centre) / width) ** 2))

    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2)
    y = lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    return x, y, z


def _envelope(x: Array, height: Array, columns: int = 440) -> tuple[Array, Array]:
    """A long profile as the lowest and highest of each column, so that no peak is lost."""
    if x.size <= 2 * columns:
        return x, height
    block = math.ceil(x.size / columns)
    rows = x.size // block
    blocks = height[: rows * block].reshape(rows, block)
    # A column without any height stays missing; nanmin would warn.
    low = np.where(np.isnan(blocks), np.inf, blocks).min(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).max(axis=1)
    pair = np.stack([low, high], axis=1)
    pair[~np.isfinite(pair)] = np.nan
    places = np.repeat(x[: rows * block].reshape(rows, block).mean(axis=1), 2)
    return places, pair.ravel()

"""The figures of a report, each from the datasets it shows."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.report.svg import (
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    chart,
    frame,
    image,
    legend,
    linear_ticks,
    nice_range,
    png,
    polar,
    text,
)

INCIDENCES = (0.0, 30.0, 60.0, 80.0)
"""Angles of incidence shown, degree."""

REFERENCE_WAVELENGTH = 550.0
"""Wavelength shown where one must stand for all, nm: near the peak of the eye's response."""

_MAP_PIXELS = 300
_MISSING_COLOUR = (240, 90, 120)
_LEVELS = 160
_DECADES_SHOWN = 6


def height_map(surface: xr.Dataset) -> Figure:
    """The levelled height map, in false colour."""
    height = surface["height"]
    x, y = height["x"].values.astype(float), height["y"].values.astype(float)
    values = height.values
    missing = float(np.mean(np.isnan(values)))
    small = _reduced(values)
    low, high = _robust_range(small)
    extent_x, extent_y = _extent(x), _extent(y)
    top, room_x, room_y = 28.0, 370.0, 400.0
    scale = min(room_x / extent_x, room_y / extent_y)
    # A long narrow map would be a line: it is widened, and the axes say by how much.
    wide, tall = max(extent_x * scale, 120.0), max(extent_y * scale, 120.0)
    left = 54 + (room_x - wide) / 2
    height_total = top + tall + 46
    parts = [image(png(*_false_colour(small, low, high)), left, top, wide, tall)]
    parts.append(f'<path class="a" d="M{left:g} {top:g}v{tall:.1f}h{wide:.1f}"/>')
    for position, name in linear_ticks(0, extent_x, count=max(2, round(5 * wide / room_x))):
        at = left + wide * position / extent_x
        parts.append(f'<path class="a" d="M{at:.1f} {top + tall:.1f}v4"/>')
        parts.append(text(at, top + tall + 17, name, "middle"))
    for position, name in linear_ticks(0, extent_y, count=5):
        at = top + tall * (1 - position / extent_y)
        parts.append(f'<path class="a" d="M{left:g} {at:.1f}h-4"/>')
        parts.append(text(left - 7, at + 4, name, "end"))
    parts.append(text(left + wide / 2, height_total - 8, "x, µm", "middle", "t"))
    parts.append(text(left - 50, 15, "y, µm", "start", "t"))
    parts += _colour_bar(left + wide + 18, top, tall, low, high)
    description = (
        f"Height map, {extent_x:.4g} by {extent_y:.4g} micrometres, heights from {low:.3g} to {high:.3g} micrometres"
    )
    key = (("missing", "", f"missing heights ({100 * missing:.2g} %)"),) if missing else ()
    note = f"{values.shape[1]} × {values.shape[0]} heights; colours span the middle 99 % of them."
    if not math.isclose(wide / extent_x, tall / extent_y, rel_tol=1e-6):
        note += " x and y are not to the same scale."
    return Figure("Height, levelled", frame(description, height_total, parts), key, note)


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


def slope_density(facets: xr.Dataset) -> Figure:
    """The density of facets in slope space, with its uncertainty, its extrapolated tail and a Beckmann of the same rms."""
    slope, density = facets["slope"].values, facets["slope_density"].values
    peak = float(density.max())
    shown = density > peak * 10.0**-_DECADES_SHOWN
    most = float(slope[shown][-1]) * 1.05
    slope_rms = _scalar(facets, "slope_rms")
    if math.isfinite(slope_rms):
        most = min(most, 8 * slope_rms)
    tail = _extrapolated(facets, slope.size) & (slope <= most)
    relative = _relative_uncertainty(facets, slope.size)
    marks: list[Mark] = []
    if relative is not None:
        # Two standard uncertainties, as factors: a band on a log axis must not reach zero.
        factor = np.exp(2 * relative)
        marks.append(Band(slope, density / factor, density * factor, "c0", "± 2 standard uncertainties"))
    marks.append(Line(slope, np.where(tail, np.nan, density), "c0", "measured" if tail.any() else "facets"))
    if tail.any():
        marks.append(Line(slope, np.where(_grown(tail), density, np.nan), "c3", "extrapolated", dashed=True))
    if math.isfinite(slope_rms):
        fine = np.linspace(0, most, 200)
        beckmann = np.exp(-((fine / slope_rms) ** 2)) / (np.pi * slope_rms**2)
        marks.append(Line(fine, beckmann, "ref", f"Beckmann of the same rms slope, {slope_rms:.3g}", dashed=True))
    top = 10.0 ** math.ceil(math.log10(peak) + 0.05)
    svg = chart(
        "Slope density against slope, logarithmic",
        Axis("slope, tan α", 0.0, most),
        Axis("slope density P₂₂", top * 10.0 ** -(_DECADES_SHOWN + 1), top, log=True),
        marks,
    )
    return Figure("Slope density of the facets", svg, legend(marks))


def facet_distribution(facets: xr.Dataset) -> Figure:
    """D(α), with a Beckmann of the same rms slope."""
    slope, density = facets["slope"].values.astype(float), facets["slope_density"].values
    alpha = np.degrees(np.arctan(slope))
    distribution = density * (1 + slope**2) ** 2
    present = distribution > distribution.max() * 1e-3
    most = min(90.0, float(alpha[present][-1]) * 1.1)
    marks: list[Mark] = []
    relative = _relative_uncertainty(facets, slope.size)
    if relative is not None:
        band = 2 * relative * distribution
        marks.append(
            Band(alpha, np.maximum(distribution - band, 0), distribution + band, "c0", "± 2 standard uncertainties")
        )
    marks.append(Line(alpha, distribution, "c0", "facets"))
    slope_rms, highest = _scalar(facets, "slope_rms"), float(distribution.max())
    if math.isfinite(slope_rms):
        fine = np.linspace(0, most, 200)
        s = np.tan(np.radians(np.minimum(fine, 89.9)))
        beckmann = np.exp(-((s / slope_rms) ** 2)) / (np.pi * slope_rms**2) * (1 + s**2) ** 2
        marks.append(Line(fine, beckmann, "ref", "Beckmann of the same rms slope", dashed=True))
        highest = max(highest, float(beckmann.max()))
    svg = chart(
        "Facet distribution D against the tilt of the facet",
        Axis("tilt of the facet α, degree", 0.0, most),
        Axis("D, sr⁻¹", 0.0, highest * 1.06),
        marks,
    )
    return Figure("Facet distribution D(α)", svg, legend(marks))


def masking(facets: xr.Dataset) -> Figure:
    """Smith's G1 against the angle."""
    theta = facets["theta"].values.astype(float)
    g1 = 1 / (1 + facets["lambda_smith"].values.astype(float))
    theta, g1 = np.r_[0.0, theta], np.r_[1.0, g1]
    marks: list[Mark] = [Line(theta, g1, "c0", "facets")]
    slope_rms = _scalar(facets, "slope_rms")
    if math.isfinite(slope_rms) and slope_rms > 0:
        fine = np.linspace(0.5, 89.5, 180)
        marks.append(Line(fine, _beckmann_g1(fine, slope_rms), "ref", "Beckmann of the same rms slope", dashed=True))
    svg = chart(
        "Masking G1 against the polar angle",
        Axis("angle from the normal θ, degree", 0.0, 90.0, step=15),
        Axis("G₁, visible fraction of the facets", 0.0, 1.02, step=0.2),
        marks,
    )
    return Figure("Masking G₁(θ)", svg, legend(marks), "1 / (1 + Λ), Smith.")


def polar_cuts(bsdf: xr.Dataset) -> tuple[Figure, Figure] | None:
    """The BRDF in the plane of incidence: a goniometric plot, and the same on Cartesian axes.

    Returns None where the BRDF is nowhere positive.
    """
    cuts = [(incidence, *_cut(bsdf, incidence)) for incidence in INCIDENCES]
    values = np.concatenate([value for _, _, value in cuts])
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size == 0:
        return None
    high = math.ceil(math.log10(float(positive.max())) - 1e-6)
    low = max(math.floor(math.log10(float(positive.min())) + 1e-6), high - _DECADES_SHOWN)
    low = min(low, high - 2)
    marks = [
        Line(theta, np.where(value > 0, value, np.nan), f"c{k}", f"{'' if k else 'incidence '}{incidence:g}°")
        for k, (incidence, theta, value) in enumerate(cuts)
    ]
    entries = legend(marks)
    where = wavelength_words(bsdf)
    gonio = polar(
        "BRDF in the plane of incidence at 0, 30, 60 and 80 degrees of incidence, logarithmic radius",
        (low, high),
        marks,
        INCIDENCES,
    )
    plane = chart(
        "BRDF in the plane of incidence against the angle of view, logarithmic",
        Axis("angle of view θₒ, degree (positive: away from the source)", -90.0, 90.0, step=30),
        Axis("BRDF, sr⁻¹", 10.0**low, 10.0**high, log=True),
        marks,
    )
    note = f"Plane of incidence, {where}. Triangles mark the sources."
    return (
        Figure("BRDF, goniometric", gonio, entries, note),
        Figure("BRDF, Cartesian", plane, entries, f"Plane of incidence, {where}."),
    )


def spectrum(spectral: xr.Dataset, bsdf: xr.Dataset | None = None) -> Figure:
    """Total reflectance over the visible, with the part that the facets mirror."""
    reflectance = spectral["total_reflectance"]
    wavelength = reflectance["wavelength"].values.astype(float)
    values = reflectance.values.astype(float)
    marks: list[Mark] = []
    uncertainty = spectral.get("total_reflectance_u")
    if uncertainty is not None and np.isfinite(uncertainty.values).any():
        u = 2 * uncertainty.values
        marks.append(Band(wavelength, values - u, values + u, "c0", "± 2 standard uncertainties"))
    marks.append(Line(wavelength, values, "c0", "total reflectance"))
    specular = _specular_part(bsdf, wavelength)
    if specular is not None:
        marks.append(Line(wavelength, specular, "c2", "mirrored by the facets", dashed=True))
    highest = max(float(np.nanmax(values)), 0.0 if specular is None else float(specular.max()))
    top = next((limit for limit in (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0) if highest * 1.03 <= limit), highest * 1.05)
    low, high = float(wavelength[0]), float(wavelength[-1])
    svg = chart(
        "Total reflectance against wavelength",
        Axis("wavelength, nm", low, high, step=50 if high - low < 500 else None),
        Axis("reflectance", 0.0, top),
        marks,
        strip=_visible_strip(low, high),
    )
    return Figure("Spectrum", svg, legend(marks), _spectrum_words(spectral))


def albedo(checks: xr.Dataset | None, bsdf: xr.Dataset | None) -> Figure | None:
    """Directional reflectance against the angle of incidence: all of it, and the part the facets mirror."""
    marks: list[Mark] = []
    if checks is not None and "albedo" in checks:
        total = at_reference(checks["albedo"])
        curve = _smooth(total["theta_i"].values.astype(float), total.values.astype(float))
        marks.append(Line(*curve, "c0", "total"))
    if bsdf is not None and "directional_albedo" in bsdf:
        part = at_reference(bsdf["directional_albedo"])
        marks.append(Line(part["theta_i"].values, part.values, "c2", "mirrored by the facets", dashed=True))
    if not marks:
        return None
    highest = max(float(np.nanmax(np.asarray(mark.y))) for mark in marks if isinstance(mark, Line))
    top = next((limit for limit in (0.2, 0.5, 1.0) if highest <= limit), highest * 1.05)
    svg = chart(
        "Directional reflectance against the angle of incidence",
        Axis("angle of incidence θᵢ, degree", 0.0, 90.0, step=15),
        Axis("directional reflectance", 0.0, top),
        marks,
    )
    source = bsdf if bsdf is not None else checks
    assert source is not None
    return Figure("Directional reflectance", svg, legend(marks), wavelength_words(source).capitalize() + ".")


# --- data


def _smooth(x: Array, y: Array) -> tuple[Array, Array]:
    """A curve through a few points that neither overshoots nor shows corners."""
    if x.size < 4 or not np.isfinite(y).all():
        return x, y
    from scipy.interpolate import PchipInterpolator

    fine = np.linspace(x[0], x[-1], 121)
    return fine, np.asarray(PchipInterpolator(x, y)(fine))


def _cut(bsdf: xr.Dataset, incidence: float) -> tuple[Array, Array]:
    """BRDF in the plane of incidence: signed angle of view in degree, and value."""
    import brdfpipe.bsdf  # noqa: F401  (registers the accessor)

    offsets = np.geomspace(0.02, 20, 40)
    theta = np.unique(np.r_[np.linspace(-89, 89, 179), incidence, incidence - offsets, incidence + offsets].round(4))
    theta = theta[np.abs(theta) <= 89]
    options = {} if _reference(bsdf) is None else {"wavelength": [_reference(bsdf)]}
    value = bsdf.bsdf.evaluate(
        theta_i=incidence, phi_i=0.0, theta_o=np.abs(theta), phi_o=np.where(theta >= 0, 180.0, 0.0), **options
    )
    return theta, np.asarray(value.values, dtype=float).reshape(theta.size, -1)[:, 0]


def _reference(dataset: xr.Dataset) -> float | None:
    """The dataset's own wavelength nearest to the reference, None where it has none."""
    if "wavelength" not in dataset.coords or dataset["wavelength"].ndim != 1:
        return None
    own = dataset["wavelength"].values
    return float(own[np.argmin(np.abs(own - REFERENCE_WAVELENGTH))])


def at_reference(values: xr.DataArray) -> xr.DataArray:
    if "wavelength" not in values.dims:
        return values
    return values.sel(wavelength=REFERENCE_WAVELENGTH, method="nearest")


def wavelength_words(dataset: xr.Dataset) -> str:
    wavelength = _reference(dataset)
    return "all wavelengths alike" if wavelength is None else f"at {wavelength:g} nm"


def _spectrum_words(spectral: xr.Dataset) -> str:
    geometry = {"sci": "Specular included", "sce": "Specular excluded"}.get(str(spectral.attrs.get("geometry")), "")
    incidence, method = spectral.attrs.get("theta_i"), str(spectral.attrs.get("method", ""))
    method = {"lhtss": "recovered from L*a*b* as the smoothest spectrum (LHTSS)"}.get(method, method)
    words = [geometry, f"incidence {float(incidence):g}°" if incidence is not None else "", method]
    sentence = ", ".join(word for word in words if word)
    return sentence[:1].upper() + sentence[1:] + "." if sentence else ""


def _specular_part(bsdf: xr.Dataset | None, wavelength: Array) -> Array | None:
    if bsdf is None or "directional_albedo" not in bsdf or "theta_m" not in bsdf:
        return None
    part = bsdf["directional_albedo"].interp(theta_i=float(bsdf["theta_m"]))
    if "wavelength" not in part.dims:
        return np.full(wavelength.size, float(part))
    return np.asarray(np.interp(wavelength, part["wavelength"].values, part.values))


def _scalar(dataset: xr.Dataset, name: str) -> float:
    return float(dataset[name]) if name in dataset else math.nan


def _extrapolated(facets: xr.Dataset, size: int) -> NDArray[np.bool_]:
    if "slope_density_quality" not in facets:
        return np.zeros(size, dtype=bool)
    return np.asarray(facets["slope_density_quality"].values == vocabulary.quality("extrapolated"))


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask and the point before it, so that two curves meet."""
    return np.asarray(mask | np.r_[mask[1:], False])


def _relative_uncertainty(facets: xr.Dataset, size: int) -> Array | None:
    """Relative standard uncertainty of the density on its slope nodes, from whichever of P22 and D carries it."""
    for name in ("slope_density", "D"):
        if f"{name}_u" in facets and facets[f"{name}_u"].size == size:
            value = facets[name].values
            with np.errstate(divide="ignore", invalid="ignore"):
                relative = np.where(value > 0, facets[f"{name}_u"].values / value, np.nan)
            return np.asarray(np.minimum(relative, 3.0))
    return None


def _beckmann_g1(theta: Array, width: float) -> Array:
    """Smith's G1 of a Beckmann surface (Heitz 2014, eq. 73)."""
    nu = 1 / (width * np.tan(np.radians(theta)))
    erf = np.array([math.erf(value) for value in nu.tolist()])  # scipy.special would cost its import for one curve
    return np.asarray(1 / (1 + (erf - 1) / 2 + np.exp(-(np.minimum(nu, 30.0) ** 2)) / (2 * nu * np.sqrt(np.pi))))


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


def _false_colour(values: Array, low: float, high: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Palette indices, top row first, and the palette; the last index is the missing one."""
    level = np.clip((values[::-1] - low) / (high - low), 0, 1) * (_LEVELS - 1)
    missing = np.isnan(level)
    indices = np.where(missing, _LEVELS, np.where(missing, 0, level).round()).astype(np.uint8)
    return indices, np.vstack([viridis(np.linspace(0, 1, _LEVELS)), [_MISSING_COLOUR]]).astype(np.uint8)


def _colour_bar(x: float, top: float, tall: float, low: float, high: float) -> list[str]:
    ramp = viridis(np.linspace(1, 0, 64))[:, None, :]
    parts = [image(png(ramp), x, top, 12, tall), text(x, 15, "µm", "start", "t")]
    for value, name in linear_ticks(low, high, count=5):
        at = top + tall * (high - value) / (high - low)
        parts.append(f'<path class="a" d="M{x + 12:.1f} {at:.1f}h4"/>')
        parts.append(text(x + 19, at + 4, name))
    return parts


def viridis(fraction: Array) -> NDArray[np.uint8]:
    """The viridis colour map, (…, 3) sRGB, by the sixth-degree polynomial fit of M. Zucker (public domain)."""
    coefficients = np.array(
        [
            [0.2777273272, 0.0054073445, 0.3340998053],
            [0.1050930431, 1.4046135299, 1.3845901626],
            [-0.3308618287, 0.2148475595, 0.0950951630],
            [-4.6342304990, -5.7991009734, -19.3324409563],
            [6.2282699363, 14.1799333668, 56.6905526007],
            [4.7763849977, -13.7451453777, -65.3530326334],
            [-5.4354558559, 4.6458526122, 26.3124352496],
        ]
    )
    powers = np.asarray(fraction, dtype=float)[..., None] ** np.arange(7)
    return np.asarray((np.clip(powers @ coefficients, 0, 1) * 255).round(), dtype=np.uint8)


def _visible_strip(low: float, high: float) -> str:
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

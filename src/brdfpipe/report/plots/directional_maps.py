"""Maps over the hemisphere of outgoing directions in false colour: BRDF and BTDF of one incidence, and polarisation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import half_vector
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.raster import Ticks, colour_bar, false_colour
from brdfpipe.report.plots.svg import Array, Axis, Figure, frame, image, path, png, text

MAP_INCIDENCE = 45.0
"""Angle of incidence of the maps of BRDF and BTDF [degree]."""

POLARISED_INCIDENCE = 60.0
"""Angle of incidence of the map of polarisation [degree]: the common gloss geometry, near Brewster's angle of most plastics."""

_DECADES_SHOWN = 6

_CENTRE_X, _CENTRE_Y, _RADIUS = 212.0, 186.0, 158.0
"""Disc of the hemisphere [figure units]."""
_PIXELS_TO_RIM = 92
_STEPS_PER_DECADE = 4
_CONSTANT = 1.02
"""Ratio of the largest to the smallest value below which a map would be one colour."""
_NARROW = 0.008
"""Slope below which the lobe is no larger than the ring around it."""


class _HemispherePixels:
    """Pixels of a disc of direction cosines, one of them exactly at the polar angle ``peak`` [degree]."""

    def __init__(self, peak: float) -> None:
        sine = math.sin(math.radians(peak))
        # Without a pixel at the peak, a narrow lobe would fall between two of them.
        step = sine / max(1, round(_PIXELS_TO_RIM * sine)) if sine > 1e-3 else 1 / _PIXELS_TO_RIM
        count = math.ceil(1.01 / step)
        cosines = step * np.arange(-count, count + 1)
        x, y = np.meshgrid(cosines, cosines)
        radius = np.hypot(x, y)
        self.inside: NDArray[np.bool_] = radius < 1
        self.theta = np.degrees(np.arcsin(radius[self.inside]))
        self.turn = np.degrees(np.arctan2(y[self.inside], x[self.inside]))
        self._upper: NDArray[np.bool_] = self.inside & (y >= 0)
        self.margin = step * (count + 0.5)
        """Direction cosine at the edges of the picture."""

    def values(self, bsdf: xr.Dataset, plane: Plane, incidence: float, *, through: bool = False) -> Array:
        """BRDF, or with ``through`` BTDF, of the pixels [sr-1]; half of them are evaluated where the halves of the disc are equal."""
        symmetric = representation(bsdf).isotropic and representation(bsdf).mirror_symmetric
        evaluated = self._upper[self.inside] if symmetric else np.ones(self.theta.size, dtype=bool)
        theta, turn = self.theta[evaluated], self.turn[evaluated]
        values = bsdf_sections.value(bsdf, plane, incidence, 180 - theta if through else theta, turn)
        if not symmetric:
            return values
        grid = np.full(self.inside.shape, np.nan)
        grid[self._upper] = values
        return np.where(self._upper, grid, grid[::-1])[self.inside]

    def figure(
        self,
        description: str,
        field: tuple[Array, float, float, int],
        unit: str,
        ticks: Ticks,
        marks: Sequence[str],
    ) -> Markup:
        """The hemisphere seen along the normal: field (values at the pixels, lowest, highest, number of colours) and marks on it."""
        values, low, high, levels = field
        grid = np.full(self.inside.shape, np.nan)
        grid[self.inside] = values
        side = 2 * _RADIUS * self.margin
        picture = png(*false_colour(grid, low, high, levels), clear=levels)
        parts = [image(picture, _CENTRE_X - side / 2, _CENTRE_Y - side / 2, side, side, smooth=True)]
        for angle in (30, 60, 90):
            r, is_rim = _RADIUS * np.sin(np.radians(angle)), angle == 90
            style = "a" if is_rim else "v"
            parts.append(f'<circle class="{style}" cx="{_CENTRE_X:g}" cy="{_CENTRE_Y:g}" r="{r:.1f}"/>')
            label_y = _CENTRE_Y - r + (-6 if is_rim else 14)
            parts.append(text(_CENTRE_X, label_y, f"{angle}°", "middle", "" if is_rim else "w"))
        parts += [*marks, *colour_bar(410, _CENTRE_Y - _RADIUS, 2 * _RADIUS, unit, ticks, levels)]
        return frame(description, _CENTRE_Y + _RADIUS + 14, parts)


def directional_maps(bsdf: xr.Dataset) -> Iterator[Figure]:
    """The BRDF, and the BTDF of a body that transmits, over all outgoing directions; with a lay, along and across it."""
    for through in (False, True) if representation(bsdf).transmits else (False,):
        for plane in bsdf_sections.planes(bsdf):
            figure = _map(bsdf, plane, through)
            if figure is not None:  # without a density, the figure of the cuts states so
                yield figure


def _map(bsdf: xr.Dataset, plane: Plane, through: bool) -> Figure | None:
    quantity = "BTDF" if through else "BRDF"
    peak = float(bsdf_sections.smooth_angles(bsdf, MAP_INCIDENCE)[0]) if through else MAP_INCIDENCE
    pixels = _HemispherePixels(peak)
    polar = 180 - pixels.theta if through else pixels.theta
    values = pixels.values(bsdf, plane, MAP_INCIDENCE, through=through)
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size == 0:
        return None
    title = plane.title(f"{quantity} over all directions, {MAP_INCIDENCE:g}° incidence")
    wavelength = bsdf_sections.wavelength_words(bsdf)
    if positive.size == values.size and positive.max() < _CONSTANT * positive.min():
        comma = "," if wavelength.startswith("all") else ""
        mean = number(float(positive.mean()))
        return Figure(title, note=f"Constant over all directions, {mean} sr⁻¹{comma} {wavelength}: perfectly diffuse.")
    low, high, levels = _colour_range(positive)
    axis = Axis("", 10.0**low, 10.0**high, log=True)
    svg = pixels.figure(
        f"{quantity} over the hemisphere of outgoing directions for light from {MAP_INCIDENCE:g} degrees {plane.words}, logarithmic colours",
        (np.log10(np.where(values > 0, values, np.nan)), low, high, levels),
        f"{quantity}, sr⁻¹ (log)",
        [(float(axis.fraction(value)), name) for value, name in axis.ticks()],
        _direction_marks(MAP_INCIDENCE, peak, _lay_turn(bsdf, plane)),
    )
    note = _map_note(bsdf, plane, through, float(positive.max()), positive.size < values.size)
    return Figure(title, svg, note=note + _unmeasured_note(bsdf, plane, polar, pixels.turn))


def _unmeasured_note(bsdf: xr.Dataset, plane: Plane, polar: Array, turn: Array) -> str:
    """The share of the map that was not measured; empty for a BSDF from a model."""
    flags = measurement_coverage.quality(bsdf, plane, MAP_INCIDENCE, polar, turn)
    if flags is None or (measured := measurement_coverage.known(flags)).all():
        return ""
    return f" {_percent(1 - float(measured.mean()))} of the disc is outside the measured directions."


def _colour_range(positive: Array) -> tuple[float, float, int]:
    """Exponents of ten of the first and the last colour, and the number of colours."""
    high = math.log10(float(positive.max()))
    # At the rim a reflectance may fall to zero: a few pixels must not take most of the colours.
    low = max(math.log10(float(np.percentile(positive, 2))), high - _DECADES_SHOWN)
    if high - low <= 1.5:
        return low, high, 16
    low = math.floor(low * 2 + 1e-6) / 2
    levels = math.ceil((high - low) * _STEPS_PER_DECADE - 1e-6)
    return low, low + levels / _STEPS_PER_DECADE, levels


def _map_note(bsdf: xr.Dataset, plane: Plane, through: bool, peak: float, dark: bool) -> str:
    slope, interface = representation(bsdf).lobe_slope, representation(bsdf).transmits_into_body
    marked = f"the {'mirror' if not through else 'refracted' if interface else 'straight'} direction"
    sentences = [
        f"Light comes from the left (arrow); the ring marks {marked}, {bsdf_sections.wavelength_words(bsdf)}.",
        "Equal areas receive equal shares of the light of a perfect diffuser.",
    ]
    if bsdf_sections.specular(bsdf, np.array([MAP_INCIDENCE]))[int(through)].any():
        sentences.append(f"The specular light in {marked} has no width and is not drawn.")
    elif slope is not None and slope < _NARROW:
        sentences.append(f"The lobe is narrower than the ring: largest {number(peak)} sr⁻¹.")
    else:
        sentences.append(f"Largest {number(peak)} sr⁻¹.")
    sentences += ["The dashed line is the lay."] if _lay_turn(bsdf, plane) is not None else []
    sentences += ["Blank: no light."] if dark else []
    return " ".join(sentences)


def polarisation(bsdf: xr.Dataset) -> Figure | None:
    """Degree of polarisation of light reflected from unpolarised light; None for a BSDF without index or facets."""
    plane, evaluator = bsdf_sections.planes(bsdf)[0], representation(bsdf)
    # Only single reflections keep the polarisation that a facet gives.
    facets = evaluator.single_reflection()
    facets = evaluator.without_diffuse() if facets is None else facets
    if not {"n", "k"} <= set(bsdf) or evaluator.is_slab or facets is None:
        return None
    title = plane.title(f"Degree of polarisation, {POLARISED_INCIDENCE:g}° incidence")
    if bsdf_sections.specular(bsdf, np.array([POLARISED_INCIDENCE]))[0].any():
        mirror = float(_facet_polarisation(bsdf, np.array([POLARISED_INCIDENCE]), np.zeros(1))[0])
        has_base = "diffuse" in bsdf and bool(np.any(bsdf["diffuse"].values > 0))
        base = " Light from the base below is not." if has_base else ""
        note = f"Of unpolarised light, {_percent(mirror)} of the mirrored ray is polarised.{base}"
        return Figure(title, note=note)
    pixels = _HemispherePixels(POLARISED_INCIDENCE)
    total, from_facets = (pixels.values(part, plane, POLARISED_INCIDENCE) for part in (bsdf, facets))
    if not total.max() > 0 or not from_facets.max() > 0:
        return None
    lit = total > total.max() * 10.0**-_DECADES_SHOWN
    share = np.divide(from_facets, total, out=np.zeros_like(from_facets), where=lit)
    degree = np.where(lit, share * _facet_polarisation(bsdf, pixels.theta, pixels.turn), np.nan)
    at_mirror = float(degree[np.argmin((pixels.theta - POLARISED_INCIDENCE) ** 2 + pixels.turn**2)])
    largest = int(np.nanargmax(degree))
    top = next(limit for limit in (0.1, 0.2, 0.5, 1.0) if degree[largest] <= limit * (1 + 1e-9))
    svg = pixels.figure(
        f"Degree of polarisation of light reflected from unpolarised light at {POLARISED_INCIDENCE:g} degrees {plane.words}",
        (degree, 0.0, top, 20),
        "polarised share",
        [(fifths / 5, f"{20 * fifths * top:g}\u202f%") for fifths in range(6)],
        _direction_marks(POLARISED_INCIDENCE, POLARISED_INCIDENCE, _lay_turn(bsdf, plane)),
    )
    blank = "" if lit.all() else " Blank: less than a millionth of the peak."
    note = (
        f"Of unpolarised light, {_percent(at_mirror)} of the light in the mirror direction (ring) is polarised. The largest degree is "
        f"{_percent(float(degree[largest]))}, at {pixels.theta[largest]:.0f}°, {bsdf_sections.wavelength_words(bsdf)}. Light from the "
        f"base and light reflected more than once counts as unpolarised.{blank}"
    )
    return Figure(title, svg, note=note)


def _facet_polarisation(bsdf: xr.Dataset, theta_o: Array, turn: Array) -> Array:
    """Degree of polarisation of unpolarised light after reflection from the facet that mirrors it towards a direction."""
    from brdfpipe.bsdf.microfacet.polarised import degree_of_polarisation, facet_mueller

    n, k = (float(bsdf_sections.at_reference(bsdf[name])) for name in ("n", "k"))
    # The degree of polarisation does not depend on the frame of the Stokes vector, which turns with the direction.
    cos_zeta = half_vector(POLARISED_INCIDENCE, 180.0, theta_o, turn).cos_zeta
    return degree_of_polarisation(facet_mueller(cos_zeta, n, k)[..., 0])


def _lay_turn(bsdf: xr.Dataset, plane: Plane) -> float | None:
    """Azimuth of the lay on the disc [degree]; None without a lay."""
    lay = representation(bsdf).lay
    return None if lay is None or not plane.words else lay - plane.azimuth


def _direction_marks(incidence: float, peak: float, lay: float | None) -> list[str]:
    """The source (arrow), the direction of a smooth surface (ring), and the lay (dashed line)."""
    marks = []
    if lay is not None:
        lay_x, lay_y = zip(_on_disc(90.0, lay), _on_disc(90.0, lay + 180), strict=True)
        marks.append(path(lay_x, lay_y, "v d"))
    source_x, source_y = _on_disc(incidence, 180.0)
    arrow = f"M{source_x - 26:.1f} {source_y:.1f}h20m-7 -6l8 6l-8 6"
    x, y = _on_disc(peak, 0.0)
    ring = f"M{x - 7:.1f} {y:.1f}a7 7 0 1 0 14 0a7 7 0 1 0 -14 0"
    return [*marks, *(f'<path class="{style}" d="{arrow}{ring}"/>' for style in ("k", "r"))]


def _on_disc(theta: float, azimuth: float) -> tuple[float, float]:
    """Position of a direction [degree] on the disc in figure units; azimuth 0 to the right, counter-clockwise."""
    r = _RADIUS * np.sin(np.radians(theta))
    return _CENTRE_X + r * np.cos(np.radians(azimuth)), _CENTRE_Y - r * np.sin(np.radians(azimuth))


def _percent(share: float) -> str:
    return f"{fixed(100 * share, 0 if share > 0.1 else 1)}\u202f%"

"""BRDF and BTDF of one incidence over all outgoing directions, as false-colour maps."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.bsdf.registry import representation
from brdfpipe.report.formatting import fixed, number
from brdfpipe.report.plots import bsdf_sections, measurement_coverage
from brdfpipe.report.plots.bsdf_sections import Plane
from brdfpipe.report.plots.raster import Ticks, disc, false_colour, on_disc
from brdfpipe.report.plots.svg import Array, Axis, Figure, path, png, sentence

MAP_INCIDENCE = 45.0
"""Angle of incidence of the directional maps, degree."""

_PIXELS_TO_RIM = 92

DECADES_SHOWN = 6

_STEPS_A_DECADE = 4

_FLAT = 1.02
"""Ratio of the largest to the smallest value below which a map would be one colour."""


def directional_maps(bsdf: xr.Dataset) -> Iterator[Figure]:
    """The BRDF, and the BTDF where light passes, over all outgoing directions; with a lay, along and across it."""
    for through in (False, True) if representation(bsdf).transmits else (False,):
        for plane in bsdf_sections.planes(bsdf):
            figure = _map(bsdf, plane, through)
            if figure is not None:  # no density: the cuts say so
                yield figure


class HemispherePixels:
    """Pixels of a disc of direction cosines, one of them exactly at a peak."""

    def __init__(self, peak: float) -> None:
        sine = math.sin(math.radians(peak))
        # Were no pixel at the peak, a narrow lobe would fall between two of them.
        step = sine / max(1, round(_PIXELS_TO_RIM * sine)) if sine > 1e-3 else 1 / _PIXELS_TO_RIM
        self.count = math.ceil(1.01 / step)
        cosines = step * np.arange(-self.count, self.count + 1)
        x, y = np.meshgrid(cosines, cosines)
        radius = np.hypot(x, y)
        self.inside: NDArray[np.bool_] = radius < 1
        self.theta = np.degrees(np.arcsin(radius[self.inside]))
        self.turn = np.degrees(np.arctan2(y[self.inside], x[self.inside]))
        self.margin = step * (self.count + 0.5)

    def picture(self, values: Array, low: float, high: float, levels: int) -> str:
        """Data URI; clear outside the disc and where values are missing."""
        grid = np.full(self.inside.shape, np.nan)
        grid[self.inside] = values
        return png(*false_colour(grid, low, high, levels), clear=levels)


def _map(bsdf: xr.Dataset, plane: Plane, through: bool) -> Figure | None:
    quantity = "BTDF" if through else "BRDF"
    peak = float(bsdf_sections.smooth_angles(bsdf, MAP_INCIDENCE)[0]) if through else MAP_INCIDENCE
    pixels = HemispherePixels(peak)
    polar = 180 - pixels.theta if through else pixels.theta
    values = bsdf_sections.value(bsdf, plane, MAP_INCIDENCE, polar, pixels.turn)
    positive = values[np.isfinite(values) & (values > 0)]
    title = f"{quantity} over all directions, {MAP_INCIDENCE:g}° incidence" + (f" {plane.words}" if plane.words else "")
    if positive.size == 0:
        return None
    if positive.size == values.size and positive.max() < _FLAT * positive.min():
        words = f"Constant over all directions, {number(float(positive.mean()))} sr⁻¹ {bsdf_sections.wavelength_words(bsdf)}: perfectly diffuse."
        return sentence(title, words.replace("sr⁻¹ all", "sr⁻¹, all"))
    low, high, levels = _colours(positive)
    logs = np.log10(np.where(values > 0, values, np.nan))
    axis = Axis("", 10.0**low, 10.0**high, log=True)
    ticks = [(float(axis.place(value)), name) for value, name in axis.ticks()]
    svg = hemisphere_figure(
        f"{quantity} over the hemisphere of outgoing directions for light from {MAP_INCIDENCE:g} degrees {plane.words}, logarithmic colours",
        pixels,
        (logs, low, high, levels),
        f"{quantity}, sr⁻¹ (log)",
        ticks,
        direction_marks(MAP_INCIDENCE, peak, lay_turn(bsdf, plane)),
    )
    note = _map_words(bsdf, plane, through, float(positive.max()), positive.size < values.size)
    return Figure(title, svg, note=note + _unmeasured(bsdf, plane, polar, pixels.turn))


def _unmeasured(bsdf: xr.Dataset, plane: Plane, polar: Array, turn: Array) -> str:
    """How much of a map was not measured; empty of a BSDF that rests on a model."""
    flags = measurement_coverage.quality(bsdf, plane, MAP_INCIDENCE, polar, turn)
    if flags is None or (measured := measurement_coverage.known(flags)).all():
        return ""
    return f" {map_percent(1 - float(measured.mean()))} of the disc is outside the measured directions."


def _colours(positive: Array) -> tuple[float, float, int]:
    """Exponents of ten of the first and the last colour, and how many colours there are."""
    high = math.log10(float(positive.max()))
    # At the rim a reflectance may fall to zero: a few pixels must not take all the colours.
    low = max(math.log10(float(np.percentile(positive, 2))), high - DECADES_SHOWN)
    if high - low > 1.5:
        low = math.floor(low * 2 + 1e-6) / 2
        return (
            low,
            low + math.ceil((high - low) * _STEPS_A_DECADE - 1e-6) / _STEPS_A_DECADE,
            math.ceil((high - low) * _STEPS_A_DECADE - 1e-6),
        )
    return low, high, 16


def _map_words(bsdf: xr.Dataset, plane: Plane, through: bool, peak: float, dark: bool) -> str:
    slope = representation(bsdf).lobe_slope
    mirrored = bsdf_sections.specular(bsdf, np.array([MAP_INCIDENCE]))[int(through)].any()
    refracted = representation(bsdf).is_interface
    marked = (
        "the mirror direction" if not through else "the refracted direction" if refracted else "the straight direction"
    )
    words = [
        f"Light comes from the left (arrow); the ring marks {marked}, {bsdf_sections.wavelength_words(bsdf)}.",
        "Equal areas receive equal shares of the light of a perfect diffuser.",
    ]
    if mirrored:
        words.append(f"The specular light in {marked} has no width and is not drawn.")
    elif slope is not None and slope < _NARROW:
        words.append(f"The lobe is narrower than the ring: largest {number(peak)} sr⁻¹.")
    else:
        words.append(f"Largest {number(peak)} sr⁻¹.")
    if lay_turn(bsdf, plane) is not None:
        words.append("The dashed line is the lay.")
    if dark:
        words.append("Blank: no light.")
    return " ".join(words)


_NARROW = 0.008
"""Slope below which the lobe is no larger than the ring about it."""


def lay_turn(bsdf: xr.Dataset, plane: Plane) -> float | None:
    """Azimuth of the lay on the disc, degree; None where there is none to show."""
    return float(bsdf["lay"]) - plane.azimuth if plane.words and "lay" in bsdf else None


def direction_marks(incidence: float, peak: float, lay: float | None) -> list[str]:
    """The source, the direction of a smooth surface, and the lay."""
    signs = []
    if lay is not None:
        ends = [on_disc(90.0, lay), on_disc(90.0, lay + 180)]
        signs.append(path([x for x, _ in ends], [y for _, y in ends], "v d"))
    source_x, source_y = on_disc(incidence, 180.0)
    arrow = f"M{source_x - 26:.1f} {source_y:.1f}h20m-7 -6l8 6l-8 6"
    x, y = on_disc(peak, 0.0)
    ring = f"M{x - 7:.1f} {y:.1f}a7 7 0 1 0 14 0a7 7 0 1 0 -14 0"
    return [*signs, *(f'<path class="{style}" d="{arrow}{ring}"/>' for style in ("k", "r"))]


def hemisphere_figure(
    description: str,
    pixels: HemispherePixels,
    field: tuple[Array, float, float, int],
    unit: str,
    ticks: Ticks,
    signs: list[str],
) -> Markup:
    return disc(description, pixels.picture(*field), pixels.margin, unit, ticks, signs, levels=field[3])


def map_percent(share: float) -> str:
    return f"{fixed(100 * share, 0 if share > 0.1 else 1)}\u202f%"

"""The figures of a BSDF as pictures: where the light of one incidence goes, over all directions, and how polarised it is."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from brdfpipe.bsdf import representations
from brdfpipe.geometry import half_vector
from brdfpipe.report import measurement_coverage as reach
from brdfpipe.report import scattering
from brdfpipe.report.pages import fixed, number
from brdfpipe.report.raster import Ticks, disc, false_colour, on_disc
from brdfpipe.report.scattering import Plane
from brdfpipe.report.svg import Array, Axis, Figure, path, png, sentence

MAP_INCIDENCE = 45.0
"""Angle of incidence of the directional maps, degree."""

POLARISED_INCIDENCE = 60.0
"""Angle of incidence of the map of polarisation, degree: that of the common gloss geometry, near Brewster's of most plastics."""

_PIXELS_TO_RIM = 92
_DECADES = 6
_STEPS_A_DECADE = 4
_FLAT = 1.02
"""Ratio of the largest to the smallest value below which a map would be one colour."""


def directional_maps(bsdf: xr.Dataset) -> Iterator[Figure]:
    """The BRDF, and the BTDF where light passes, over all outgoing directions; with a lay, along and across it."""
    for through in (False, True) if representations.transmits(bsdf) else (False,):
        for plane in scattering.planes(bsdf):
            found = _map(bsdf, plane, through)
            if found is not None:  # no density: the cuts say so
                yield found


class _Hemisphere:
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
    peak = float(scattering.smooth_angles(bsdf, MAP_INCIDENCE)[0]) if through else MAP_INCIDENCE
    pixels = _Hemisphere(peak)
    polar = 180 - pixels.theta if through else pixels.theta
    values = scattering.value(bsdf, plane, MAP_INCIDENCE, polar, pixels.turn)
    positive = values[np.isfinite(values) & (values > 0)]
    title = f"{quantity} over all directions, {MAP_INCIDENCE:g}° incidence" + (f" {plane.words}" if plane.words else "")
    if positive.size == 0:
        return None
    if positive.size == values.size and positive.max() < _FLAT * positive.min():
        words = f"The same in every direction, {number(float(positive.mean()))} sr⁻¹ {scattering.wavelength_words(bsdf)}: perfectly diffuse."
        return sentence(title, words.replace("sr⁻¹ all", "sr⁻¹, all"))
    low, high, levels = _colours(positive)
    logs = np.log10(np.where(values > 0, values, np.nan))
    axis = Axis("", 10.0**low, 10.0**high, log=True)
    ticks = [(float(axis.place(value)), name) for value, name in axis.ticks()]
    svg = _disc(
        f"{quantity} over the hemisphere of outgoing directions for light from {MAP_INCIDENCE:g} degrees {plane.words}, logarithmic colours",
        pixels,
        (logs, low, high, levels),
        f"{quantity}, sr⁻¹ (log)",
        ticks,
        _signs(MAP_INCIDENCE, peak, _lay_turn(bsdf, plane)),
    )
    note = _map_words(bsdf, plane, through, float(positive.max()), positive.size < values.size)
    return Figure(title, svg, note=note + _unmeasured(bsdf, plane, polar, pixels.turn))


def _unmeasured(bsdf: xr.Dataset, plane: Plane, polar: Array, turn: Array) -> str:
    """How much of a map was not measured; empty of a BSDF that rests on a model."""
    flags = reach.quality(bsdf, plane, MAP_INCIDENCE, polar, turn)
    if flags is None or (told := reach.known(flags)).all():
        return ""
    return f" {_percent(1 - float(told.mean()))} of the disc was neither measured nor lies between what was."


def _colours(positive: Array) -> tuple[float, float, int]:
    """Exponents of ten of the first and the last colour, and how many colours there are."""
    high = math.log10(float(positive.max()))
    # At the rim a reflectance may fall to zero: a few pixels must not take all the colours.
    low = max(math.log10(float(np.percentile(positive, 2))), high - _DECADES)
    if high - low > 1.5:
        low = math.floor(low * 2 + 1e-6) / 2
        return (
            low,
            low + math.ceil((high - low) * _STEPS_A_DECADE - 1e-6) / _STEPS_A_DECADE,
            math.ceil((high - low) * _STEPS_A_DECADE - 1e-6),
        )
    return low, high, 16


def _map_words(bsdf: xr.Dataset, plane: Plane, through: bool, peak: float, dark: bool) -> str:
    slope = representations.lobe_slope(bsdf)
    mirrored = scattering.specular(bsdf, np.array([MAP_INCIDENCE]))[int(through)].any()
    refracted = bsdf.attrs.get("transmission") == "interface"
    marked = (
        "the mirror direction" if not through else "the refracted direction" if refracted else "the straight direction"
    )
    words = [
        f"Light comes from the left (arrow); the ring marks {marked}, {scattering.wavelength_words(bsdf)}.",
        "Equal areas hold equal shares of the light of a perfect diffuser.",
    ]
    if mirrored:
        words.append(f"What the smooth surface sends into {marked} has no width and is not in the picture.")
    elif slope is not None and slope < _NARROW:
        words.append(f"The lobe is narrower than the ring: largest {number(peak)} sr⁻¹.")
    else:
        words.append(f"Largest {number(peak)} sr⁻¹.")
    if _lay_turn(bsdf, plane) is not None:
        words.append("The dashed line is the lay.")
    if dark:
        words.append("Blank: no light.")
    return " ".join(words)


_NARROW = 0.008
"""Slope below which the lobe is no larger than the ring about it."""


def _lay_turn(bsdf: xr.Dataset, plane: Plane) -> float | None:
    """Azimuth of the lay on the disc, degree; None where there is none to show."""
    return float(bsdf["lay"]) - plane.azimuth if plane.words and "lay" in bsdf else None


def _signs(incidence: float, peak: float, lay: float | None) -> list[str]:
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


def _disc(
    description: str,
    pixels: _Hemisphere,
    field: tuple[Array, float, float, int],
    unit: str,
    ticks: Ticks,
    signs: list[str],
) -> Markup:
    return disc(description, pixels.picture(*field), pixels.margin, unit, ticks, signs, levels=field[3])


# --- polarisation


def polarisation(bsdf: xr.Dataset) -> Figure | None:
    """Degree of polarisation of the light reflected from unpolarised light; None where a BSDF cannot tell."""
    plane = scattering.planes(bsdf)[0]
    if (
        not {"n", "k"} <= set(bsdf)
        or bsdf.attrs.get("transmission") == "slab"
        or (facets := _single_reflection(bsdf)) is None
    ):
        return None
    title = f"Degree of polarisation, {POLARISED_INCIDENCE:g}° incidence" + (f" {plane.words}" if plane.words else "")
    if scattering.specular(bsdf, np.array([POLARISED_INCIDENCE]))[0].any():
        mirror = float(_facet_polarisation(bsdf, np.array([POLARISED_INCIDENCE]), np.zeros(1))[0])
        words = "Light from the base below is not." if _has_base(bsdf) else ""
        return sentence(
            title, f"Of unpolarised light, {_percent(mirror)} of the mirrored ray is polarised. {words}".strip()
        )
    pixels = _Hemisphere(POLARISED_INCIDENCE)
    total = scattering.value(bsdf, plane, POLARISED_INCIDENCE, pixels.theta, pixels.turn)
    alone = scattering.value(facets, plane, POLARISED_INCIDENCE, pixels.theta, pixels.turn)
    if not total.max() > 0 or not alone.max() > 0:
        return None
    lit = total > total.max() * 10.0**-_DECADES
    share = np.divide(alone, total, out=np.zeros_like(alone), where=lit)
    degree = np.where(lit, share * _facet_polarisation(bsdf, pixels.theta, pixels.turn), np.nan)
    at_mirror = float(degree[np.argmin((pixels.theta - POLARISED_INCIDENCE) ** 2 + pixels.turn**2)])
    most = int(np.nanargmax(degree))
    top = next(limit for limit in (0.1, 0.2, 0.5, 1.0) if degree[most] <= limit * (1 + 1e-9))
    svg = _disc(
        f"Degree of polarisation of light reflected from unpolarised light at {POLARISED_INCIDENCE:g} degrees {plane.words}",
        pixels,
        (degree, 0.0, top, 20),
        "polarised share",
        [(fifths / 5, f"{20 * fifths * top:g}\u202f%") for fifths in range(6)],
        _signs(POLARISED_INCIDENCE, POLARISED_INCIDENCE, _lay_turn(bsdf, plane)),
    )
    blank = "" if lit.all() else " Blank: less than a millionth of the peak."
    note = (
        f"Of unpolarised light, {_percent(at_mirror)} of what leaves towards the mirror direction (ring) is polarised; most, "
        f"{_percent(float(degree[most]))}, at {pixels.theta[most]:.0f}°, {scattering.wavelength_words(bsdf)}. Light from the base "
        f"and light reflected more than once counts as unpolarised.{blank}"
    )
    return Figure(title, svg, note=note)


def _single_reflection(bsdf: xr.Dataset) -> xr.Dataset | None:
    """The part of a BSDF that keeps the polarisation a facet gives."""
    once = scattering.once_reflected(bsdf)
    return once if once is not None else scattering.facets_alone(bsdf)


def _has_base(bsdf: xr.Dataset) -> bool:
    return bool(np.any(bsdf["diffuse"].values > 0)) if "diffuse" in bsdf else False


def _facet_polarisation(bsdf: xr.Dataset, theta_o: Array, turn: Array) -> Array:
    """Degree of polarisation of unpolarised light after the one facet that mirrors it towards a direction."""
    from brdfpipe.bsdf.microfacet.polarised import degree_of_polarisation, facet_mueller

    n, k = (float(scattering.at_reference(bsdf[name])) for name in ("n", "k"))
    # The frame in which the light is described turns with the direction; how much of it is polarised does not.
    cos_zeta = half_vector(POLARISED_INCIDENCE, 180.0, theta_o, turn).cos_zeta
    return degree_of_polarisation(facet_mueller(cos_zeta, n, k)[..., 0])


def _percent(share: float) -> str:
    return f"{fixed(100 * share, 0 if share > 0.1 else 1)}\u202f%"

"""Slope density and facet distribution beside a Beckmann and a GGX of the same slopes; with a lay, its rose and sections."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.facets.analytic_distributions import EquivalentDensity, equivalent_densities
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.report.formatting import EXPANDED_UNCERTAINTY
from brdfpipe.report.plots.raster import false_colour, framed
from brdfpipe.report.plots.svg import (
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    Pattern,
    Points,
    chart,
    legend,
    png,
    power_of_ten,
    rose,
    with_neighbours,
)

_DECADES_SHOWN = 6
_HEAVY_TAIL = 25
"""Largest slope shown, in median slopes: a tail that falls like a power law would leave the rest a spike."""
_MAP_DECADES, _MAP_STEPS_PER_DECADE, _MAP_PIXELS = 5, 2, 241

_EQUIVALENTS: Mapping[str, tuple[str, Pattern]] = {"beckmann": ("Beckmann", "dash"), "ggx": ("GGX", "dots")}


def slope_density(facets: xr.Dataset) -> Figure:
    """Slope density with uncertainty and extrapolated tail, beside a Beckmann and a GGX."""
    slope, density = facets["slope"].values, facets["slope_density"].values
    peak = float(density.max())
    shown = density > peak * 10.0**-_DECADES_SHOWN
    slope_rms = float(facets.get("slope_rms", math.nan))
    tail_shown = 8 * slope_rms if math.isfinite(slope_rms) else _HEAVY_TAIL * RadialDensity.of(facets).median_slope
    slope_max = min(float(slope[shown][-1]) * 1.05, tail_shown)
    quality = facets.get("slope_density_quality", xr.zeros_like(facets["slope"])).values
    tail = (quality == vocabulary.quality("extrapolated")) & (slope <= slope_max)
    marks = _density_marks(slope, density, _relative_uncertainty(facets), tail)
    marks += _equivalent_lines(facets, np.linspace(0, slope_max, 200))
    top = 10.0 ** math.ceil(math.log10(peak) + 0.05)
    if "tail_slope" in facets:
        # Where extrapolation begins.
        marks.append(Line(np.full(2, float(facets["tail_slope"])), [top * 10.0 ** -(_DECADES_SHOWN + 1), top], "ref"))
    svg = chart(
        "Slope density against slope, logarithmic",
        Axis("slope, tan α", 0.0, slope_max),
        Axis("slope density P₂₂", top * 10.0 ** -(_DECADES_SHOWN + 1), top, log=True),
        marks,
    )
    return Figure("Slope density of the facets", svg, legend(marks), tail_note(facets))


def tail_note(facets: xr.Dataset) -> str:
    """A sentence on the extrapolated tail of a density; none where the density is not counted."""
    if "tail_share" not in facets or not float(facets["tail_share"]):
        return ""
    share, contribution = float(facets["tail_share"]), float(facets["tail_contribution"])
    begin = (
        f"From a slope of {float(facets['tail_slope']):.3g} on"
        if "tail_slope" in facets
        else "Beyond the counted slopes"
    )
    return f"{begin} the density is extrapolated: {100 * share:.2g} % of the facets, with {100 * contribution:.2g} % of their mean square slope."


def facet_distribution(facets: xr.Dataset) -> Figure:
    """Facet distribution D(α), beside a Beckmann and a GGX."""
    slope, density = facets["slope"].values.astype(float), facets["slope_density"].values
    alpha = np.degrees(np.arctan(slope))
    distribution = density * (1 + slope**2) ** 2
    present = distribution > distribution.max() * 1e-3
    alpha_max = min(90.0, float(alpha[present][-1]) * 1.1)
    marks: list[Mark] = []
    relative = _relative_uncertainty(facets)
    if relative is not None:
        band = 2 * relative * distribution
        marks.append(Band(alpha, np.maximum(distribution - band, 0), distribution + band, "c0", EXPANDED_UNCERTAINTY))
    marks.append(Line(alpha, distribution, "c0", "facets"))
    fine = np.linspace(0, alpha_max, 200)
    s = np.tan(np.radians(np.minimum(fine, 89.9)))
    equivalents = [replace(line, x=fine, y=line.y * (1 + s**2) ** 2) for line in _equivalent_lines(facets, s)]
    highest = max(float(np.max(values)) for values in (distribution, *(line.y for line in equivalents)))
    marks += equivalents
    svg = chart(
        "Facet distribution D against the tilt of the facet",
        Axis("tilt of the facet α, degree", 0.0, alpha_max),
        Axis("D, sr⁻¹", 0.0, highest * 1.06),
        marks,
    )
    note = "The wider the distribution, the wider the lobe; a measured curve beyond Beckmann at large tilts scatters more haze."
    return Figure("Facet distribution D(α)", svg, legend(marks), note)


def equivalent_label(density: EquivalentDensity) -> str:
    """``Beckmann of the same rms slope``"""
    return f"{_EQUIVALENTS[density.distribution][0]} of the same {density.matched} slope"


def _equivalent_lines(facets: xr.Dataset, slope: Array, axis: int | None = None) -> list[Line]:
    """Sections of the Beckmann and the GGX: of an isotropic surface, or along (axis 0) or across (1) a lay."""
    return [
        Line(
            slope,
            density.section(slope, axis or 0),
            "ref",
            equivalent_label(density) + (f", {density.widths[0]:.3g}" if axis is None else "s"),
            _EQUIVALENTS[density.distribution][1],
        )
        for density in equivalent_densities(facets)
    ]


def slope_by_scale(facets: xr.Dataset) -> Figure | None:
    """rms slope against the distance between the heights; None where fewer than two are known."""
    if "slope_rms_scale" not in facets or "scale" not in facets.coords:
        return None
    scale, slope_rms = facets["scale"].values.astype(float), facets["slope_rms_scale"].values.astype(float)
    known = np.isfinite(slope_rms) & (scale > 0)
    if known.sum() < 2:
        return None
    scale, slope_rms = scale[known], slope_rms[known]
    svg = chart(
        "Root mean square slope against the distance it is taken over",
        Axis(
            "distance, pixels (log)",
            float(scale[0]) / 1.15,
            float(scale[-1]) * 1.15,
            log=True,
            tick_values=tuple(scale),
        ),
        Axis("rms slope", 0.0, float(slope_rms.max()) * 1.12),
        [Line(scale, slope_rms, "c0"), Points(scale, slope_rms)],
        height=230,
    )
    note = "A slope that still rises towards 1 pixel shows that a smaller pitch would find steeper facets, or that noise adds slope."
    return Figure("Slope against scale", svg, note=note)


def figures_with_lay(facets: xr.Dataset, density: PlanarDensity) -> list[Figure]:
    """Rose of slopes, map of the density, and sections along and across the lay."""
    return [_lay_rose(facets, density), _density_map(density), *_sections(facets, density)]


def _lay_rose(facets: xr.Dataset, density: PlanarDensity) -> Figure:
    lay = density.azimuth
    azimuth = np.arange(0.0, 360.0, 3.0)
    finite = math.isfinite(float(facets.get("slope_rms", math.nan)))
    slope = density.rms_slope(azimuth) if finite else density.mean_slope(azimuth)
    quantity = "rms slope" if finite else "mean |slope|"
    label = f"lay {axis_degrees(lay)}"
    svg = rose(f"{quantity} against azimuth; {label}", f"{quantity} towards the azimuth", azimuth, slope, lay)
    along, across = (float(np.interp((lay + turn) % 360, azimuth, slope, period=360)) for turn in (0, 90))
    entries = (("line", "c0", quantity), ("dash", "c3", label))
    return Figure("Lay", svg, entries, f"{quantity.capitalize()} {along:.3g} along the lay, {across:.3g} across it.")


def _density_map(density: PlanarDensity) -> Figure:
    peak = float(density.density.max())
    top = math.ceil(math.log10(peak) * _MAP_STEPS_PER_DECADE) / _MAP_STEPS_PER_DECADE
    bottom = top - _MAP_DECADES
    shown = density.density > 10.0**bottom
    along, across = (
        float(np.abs(axis.nodes[shown.any(axis=k)]).max()) for axis, k in ((density.along, 0), (density.across, 1))
    )
    pixels = np.linspace(-1, 1, _MAP_PIXELS)
    levels = _MAP_DECADES * _MAP_STEPS_PER_DECADE
    values = np.log10(np.maximum(density.principal(along * pixels, across * pixels[:, None]), 1e-300))
    first = math.ceil(bottom - 1e-9)
    svg, to_scale = framed(
        f"Slope density over the slopes along the lay and across it, logarithmic colours; lay {axis_degrees(density.azimuth)}",
        png(*false_colour(values, bottom, top, levels)),
        ("slope along the lay", -along, along),
        ("slope across it", -across, across),
        "P₂₂ (log)",
        [((k - bottom) / _MAP_DECADES, power_of_ten(k)) for k in range(first, math.floor(top + 1e-9) + 1)],
        levels=levels,
    )
    note = (
        f"Two colour steps per decade. {'' if to_scale else 'The two slopes are not to the same scale. '}"
        f"The lay runs towards {axis_degrees(density.azimuth)} from x; slopes are smallest along it."
    )
    return Figure("Slope density, all azimuths", svg, note=note)


def _sections(facets: xr.Dataset, density: PlanarDensity) -> list[Figure]:
    """The density along the lay and across it, on common axes."""
    azimuths = (density.azimuth, density.azimuth + 90)
    peak = float(density.density.max())
    slope_max = max(
        min(shown, _HEAVY_TAIL * density.median_slope(azimuth))
        for shown, azimuth in zip(_slope_range_shown(density, peak), azimuths, strict=True)
    )
    slope = np.linspace(-slope_max, slope_max, 361)
    top = 10.0 ** math.ceil(math.log10(peak) + 0.05)
    figures = []
    for axis, (name, azimuth) in enumerate(zip(("along", "across"), azimuths, strict=True)):
        section = (slope, 0 * slope)[:: -1 if axis else 1]
        marks = _density_marks(slope, density.principal(*section), *_section_quality(facets, density, *section))
        marks += _equivalent_lines(facets, slope, axis)
        svg = chart(
            f"Slope density {name} the lay, logarithmic",
            Axis(f"slope towards {axis_degrees(azimuth)}", -slope_max, slope_max),
            Axis("slope density P₂₂", top * 10.0 ** -(_DECADES_SHOWN + 1), top, log=True),
            marks,
        )
        figures.append(Figure(f"Slope density {name} the lay", svg, legend(marks), "Through zero slope."))
    return figures


def axis_degrees(azimuth: float) -> str:
    """The azimuth of an axis, from 0 to 180 degree, as text."""
    return f"{round(azimuth % 180, 1) % 180:g}°" if math.isfinite(azimuth) else "–"


def _slope_range_shown(density: PlanarDensity, peak: float) -> tuple[float, float]:
    """Largest slopes along the lay and across it at which the density is shown."""
    shown = peak * 10.0**-_DECADES_SHOWN
    along, across = density.along.nodes, density.across.nodes
    return (
        1.05 * float(np.abs(along[density.principal(along, 0.0) > shown]).max()),
        1.05 * float(np.abs(across[density.principal(0.0, across) > shown]).max()),
    )


def _section_quality(
    facets: xr.Dataset, density: PlanarDensity, along: Array, across: Array
) -> tuple[Array | None, NDArray[np.bool_]]:
    """Relative uncertainty, and whether the density is extrapolated, at slopes along the lay and across it."""
    from scipy.ndimage import map_coordinates

    positions = np.stack([density.across.position(across), density.along.position(along)])

    def at(name: str, order: Literal[0, 1]) -> Array:
        grid = facets[name].transpose("slope_across", "slope_along").values.astype(float)
        return np.asarray(map_coordinates(grid, positions, order=order, mode="nearest"))

    tail = np.zeros(along.shape, dtype=bool)
    if "slope_density_quality" in facets:
        tail = at("slope_density_quality", 0) == vocabulary.quality("extrapolated")
    if "slope_density_u" not in facets:
        return None, tail
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.minimum(at("slope_density_u", 1) / density.principal(along, across), 3.0), tail


def _density_marks(slope: Array, density: Array, relative: Array | None, tail: NDArray[np.bool_]) -> list[Mark]:
    """Density, uncertainty and extrapolated tail for a log axis."""
    marks: list[Mark] = []
    if relative is not None:
        # Two standard uncertainties, as factors: a band on a log axis must not reach zero.
        factor = np.exp(2 * relative)
        marks.append(Band(slope, density / factor, density * factor, "c0", EXPANDED_UNCERTAINTY))
    marks.append(Line(slope, np.where(tail, np.nan, density), "c0", "measured" if tail.any() else "facets"))
    if tail.any():
        marks.append(Line(slope, np.where(with_neighbours(tail), density, np.nan), "c3", "extrapolated", "dash"))
    return marks


def _relative_uncertainty(facets: xr.Dataset) -> Array | None:
    """Relative standard uncertainty of the density on its slope nodes, from whichever of P22 and D carries it."""
    for name in ("slope_density", "D"):
        if name in facets and f"{name}_u" in facets and facets[f"{name}_u"].size == facets.sizes["slope"]:
            value = facets[name].values
            with np.errstate(divide="ignore", invalid="ignore"):
                relative = np.where(value > 0, facets[f"{name}_u"].values / value, np.nan)
            return np.asarray(np.minimum(relative, 3.0))
    return None

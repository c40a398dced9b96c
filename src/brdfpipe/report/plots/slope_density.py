"""Slope density and facet distribution; with a lay, its rose and sections."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.report.plots.equivalent_densities import (
    median_slope,
    median_slope_towards,
    planar_equivalents,
    radial_equivalents,
    rms_slope_towards,
    scalar_or_nan,
)
from brdfpipe.report.plots.masking import EXPANDED_UNCERTAINTY, smith_masking, smith_masking_with_lay
from brdfpipe.report.plots.raster import false_colour, framed
from brdfpipe.report.plots.svg import (
    Array,
    Axis,
    Band,
    Figure,
    Line,
    Mark,
    Points,
    chart,
    legend,
    png,
    power_of_ten,
    rose,
    sentence,
)

if TYPE_CHECKING:
    from brdfpipe.facets.planar_density import PlanarDensity


_DECADES_SHOWN = 6

_HEAVY_TAIL = 25
"""Median slopes shown at most: a tail that falls as a power would leave the rest a spike."""

_MAP_DECADES = 5

_MAP_PIXELS = 241

_STEPS_A_DECADE = 2


def facet_figures(facets: xr.Dataset) -> list[Figure]:
    """Every figure that a ``facets`` dataset has the variables for.

    Parameters
    ----------
    facets : kind ``facets``, isotropic (slope density over ``slope``) or with a lay (over ``slope_across``, ``slope_along``)
    """
    figures: list[Figure] = []
    if "slope_density" in facets and facets["slope_density"].size == 0:
        return [sentence("Slopes", "The surface is perfectly flat: all facets are level, and none masks another.")]
    if "slope_density" in facets and facets["slope_density"].dims == ("slope",):
        figures += [slope_density(facets), facet_distribution(facets)]
        figures += [smith_masking(facets)] if "lambda_smith" in facets else []
    elif "slope_density" in facets:
        figures += _with_lay(facets)
    by_scale = slope_by_scale(facets)
    return [*figures, by_scale] if by_scale else figures


def slope_density(facets: xr.Dataset) -> Figure:
    """The density of facets in slope space, with its uncertainty, its extrapolated tail, a Beckmann and a GGX."""
    slope, density = facets["slope"].values, facets["slope_density"].values
    peak = float(density.max())
    shown = density > peak * 10.0**-_DECADES_SHOWN
    most = float(slope[shown][-1]) * 1.05
    slope_rms = scalar_or_nan(facets, "slope_rms")
    most = min(most, 8 * slope_rms if math.isfinite(slope_rms) else _HEAVY_TAIL * median_slope(facets))
    tail = _extrapolated(facets) & (slope <= most)
    marks = _counted(slope, density, _relative_uncertainty(facets), tail)
    fine = np.linspace(0, most, 200)
    marks += [Line(fine, model(fine), "ref", label, pattern) for model, label, pattern in radial_equivalents(facets)]
    top = 10.0 ** math.ceil(math.log10(peak) + 0.05)
    svg = chart(
        "Slope density against slope, logarithmic",
        Axis("slope, tan α", 0.0, most),
        Axis("slope density P₂₂", top * 10.0 ** -(_DECADES_SHOWN + 1), top, log=True),
        marks,
    )
    return Figure("Slope density of the facets", svg, legend(marks))


def facet_distribution(facets: xr.Dataset) -> Figure:
    """D(α), with a Beckmann and a GGX."""
    slope, density = facets["slope"].values.astype(float), facets["slope_density"].values
    alpha = np.degrees(np.arctan(slope))
    distribution = density * (1 + slope**2) ** 2
    present = distribution > distribution.max() * 1e-3
    most = min(90.0, float(alpha[present][-1]) * 1.1)
    marks: list[Mark] = []
    relative = _relative_uncertainty(facets)
    if relative is not None:
        band = 2 * relative * distribution
        marks.append(Band(alpha, np.maximum(distribution - band, 0), distribution + band, "c0", EXPANDED_UNCERTAINTY))
    marks.append(Line(alpha, distribution, "c0", "facets"))
    fine = np.linspace(0, most, 200)
    s = np.tan(np.radians(np.minimum(fine, 89.9)))
    highest = float(distribution.max())
    for model, label, pattern in radial_equivalents(facets):
        values = model(s) * (1 + s**2) ** 2
        marks.append(Line(fine, values, "ref", label, pattern))
        highest = max(highest, float(values.max()))
    svg = chart(
        "Facet distribution D against the tilt of the facet",
        Axis("tilt of the facet α, degree", 0.0, most),
        Axis("D, sr⁻¹", 0.0, highest * 1.06),
        marks,
    )
    return Figure("Facet distribution D(α)", svg, legend(marks))


def slope_by_scale(facets: xr.Dataset) -> Figure | None:
    """The slope rms against the distance it is taken over; None where fewer than two are known."""
    if "slope_rms_scale" not in facets or "scale" not in facets.coords:
        return None
    scale, slope_rms = facets["scale"].values.astype(float), facets["slope_rms_scale"].values.astype(float)
    known = np.isfinite(slope_rms) & (scale > 0)
    if known.sum() < 2:
        return None
    scale, slope_rms = scale[known], slope_rms[known]
    svg = chart(
        "Root mean square slope against the distance it is taken over",
        Axis("distance, pixels (log)", float(scale[0]) / 1.15, float(scale[-1]) * 1.15, log=True, at=tuple(scale)),
        Axis("rms slope", 0.0, float(slope_rms.max()) * 1.12),
        [Line(scale, slope_rms, "c0"), Points(scale, slope_rms, np.full(scale.size, np.nan), "c0")],
        height=230,
    )
    note = "A slope that still rises towards 1 pixel shows that a smaller pitch would find steeper facets, or that noise adds slope."
    return Figure("Slope against scale", svg, note=note)


def _with_lay(facets: xr.Dataset) -> list[Figure]:
    density = _planar(facets)
    figures = [_lay_rose(facets, density), _density_map(density), *_sections(facets, density)]
    return [*figures, smith_masking_with_lay(facets, density.azimuth)] if "lambda_smith" in facets else figures


def _lay_rose(facets: xr.Dataset, density: PlanarDensity) -> Figure:
    lay = density.azimuth
    azimuth = np.arange(0.0, 360.0, 3.0)
    finite = math.isfinite(scalar_or_nan(facets, "slope_rms"))
    towards = rms_slope_towards(density, azimuth) if finite else _mean_towards(density, azimuth)
    quantity = "rms slope" if finite else "mean |slope|"
    label = f"lay {axis_degrees(lay)}"
    svg = rose(f"{quantity} against azimuth; {label}", f"{quantity} towards the azimuth", azimuth, towards, lay)
    along, across = (float(np.interp((lay + turn) % 360, azimuth, towards, period=360)) for turn in (0, 90))
    entries = (("line", "c0", quantity), ("dash", "c3", label))
    return Figure("Lay", svg, entries, f"{quantity.capitalize()} {along:.3g} along the lay, {across:.3g} across it.")


def _density_map(density: PlanarDensity) -> Figure:
    peak = float(density.density.max())
    top = math.ceil(math.log10(peak) * _STEPS_A_DECADE) / _STEPS_A_DECADE
    bottom = top - _MAP_DECADES
    present = density.density > 10.0**bottom
    along, across = (
        float(np.abs(axis.nodes[present.any(axis=k)]).max()) for axis, k in ((density.along, 0), (density.across, 1))
    )
    pixels = np.linspace(-1, 1, _MAP_PIXELS)
    levels = _MAP_DECADES * _STEPS_A_DECADE
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
    note = f"Two colour steps per decade. {'' if to_scale else 'The two slopes are not to the same scale. '}"
    lay = f"The lay runs towards {axis_degrees(density.azimuth)} from x; slopes are smallest along it."
    return Figure("Slope density, all azimuths", svg, note=f"{note}{lay}")


def _sections(facets: xr.Dataset, density: PlanarDensity) -> list[Figure]:
    """The density along the lay and across it, on common axes."""
    azimuths = (density.azimuth, density.azimuth + 90)
    peak = float(density.density.max())
    most = max(
        min(reach, _HEAVY_TAIL * median_slope_towards(density, azimuth))
        for reach, azimuth in zip(_reach(density, peak), azimuths, strict=True)
    )
    slope = np.linspace(-most, most, 361)
    top = 10.0 ** math.ceil(math.log10(peak) + 0.05)
    models = planar_equivalents(facets, density)
    figures = []
    for turn, (name, azimuth) in enumerate(zip(("along", "across"), azimuths, strict=True)):
        section = (slope, 0 * slope)[:: -1 if turn else 1]
        marks = _counted(slope, density.principal(*section), *_section_quality(facets, density, *section))
        marks += [Line(slope, model[turn](slope), "ref", label, pattern) for model, label, pattern in models]
        svg = chart(
            f"Slope density {name} the lay, logarithmic",
            Axis(f"slope towards {axis_degrees(azimuth)}", -most, most),
            Axis("slope density P₂₂", top * 10.0 ** -(_DECADES_SHOWN + 1), top, log=True),
            marks,
        )
        figures.append(Figure(f"Slope density {name} the lay", svg, legend(marks), "Through zero slope."))
    return figures


def axis_degrees(azimuth: float) -> str:
    """An axis, in words, as an azimuth from 0 to 180 degree."""
    return f"{round(azimuth % 180, 1) % 180:g}°" if math.isfinite(azimuth) else "–"


def _planar(facets: xr.Dataset) -> PlanarDensity:
    """The density as a function; loaded here because few surfaces have a lay."""
    from brdfpipe.facets.planar_density import PlanarDensity

    return PlanarDensity.of(facets)


def _mean_towards(density: PlanarDensity, azimuth: Array) -> Array:
    """Mean |slope| towards azimuths, which is finite where the rms is not."""
    p, q, weight = density.rule()
    angle = np.radians(azimuth)
    means = [np.sum(weight * np.abs(p * math.cos(a) + q * math.sin(a))) for a in angle.tolist()]
    return np.asarray(means) / weight.sum()


def _reach(density: PlanarDensity, peak: float) -> tuple[float, float]:
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
    """Relative uncertainty, and where the density was extrapolated, at slopes along the lay and across it."""
    from scipy.ndimage import map_coordinates

    places = np.stack([density.across.position(across), density.along.position(along)])

    def at(name: str, order: Literal[0, 1]) -> Array:
        grid = facets[name].transpose("slope_across", "slope_along").values.astype(float)
        return np.asarray(map_coordinates(grid, places, order=order, mode="nearest"))

    tail = np.zeros(along.shape, dtype=bool)
    if "slope_density_quality" in facets:
        tail = at("slope_density_quality", 0) == vocabulary.quality("extrapolated")
    if "slope_density_u" not in facets:
        return None, tail
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.minimum(at("slope_density_u", 1) / density.principal(along, across), 3.0), tail


def _counted(slope: Array, density: Array, relative: Array | None, tail: NDArray[np.bool_]) -> list[Mark]:
    """A counted density, its uncertainty and its extrapolated tail, on a log axis."""
    marks: list[Mark] = []
    if relative is not None:
        # Two standard uncertainties, as factors: a band on a log axis must not reach zero.
        factor = np.exp(2 * relative)
        marks.append(Band(slope, density / factor, density * factor, "c0", EXPANDED_UNCERTAINTY))
    marks.append(Line(slope, np.where(tail, np.nan, density), "c0", "measured" if tail.any() else "facets"))
    if tail.any():
        marks.append(Line(slope, np.where(_grown(tail), density, np.nan), "c3", "extrapolated", "dash"))
    return marks


def _extrapolated(facets: xr.Dataset) -> NDArray[np.bool_]:
    if "slope_density_quality" not in facets:
        return np.zeros(facets.sizes["slope"], dtype=bool)
    return np.asarray(facets["slope_density_quality"].values == vocabulary.quality("extrapolated"))


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask and its neighbours, so that two curves meet."""
    return np.asarray(mask | np.r_[mask[1:], False] | np.r_[False, mask[:-1]])


def _relative_uncertainty(facets: xr.Dataset) -> Array | None:
    """Relative standard uncertainty of the density on its slope nodes, from whichever of P22 and D carries it."""
    for name in ("slope_density", "D"):
        if name in facets and f"{name}_u" in facets and facets[f"{name}_u"].size == facets.sizes["slope"]:
            value = facets[name].values
            with np.errstate(divide="ignore", invalid="ignore"):
                relative = np.where(value > 0, facets[f"{name}_u"].values / value, np.nan)
            return np.asarray(np.minimum(relative, 3.0))
    return None

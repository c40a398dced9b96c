"""Facet distribution from line profiles, which contain only the slopes along the line.

A line gives the marginal P1(p) of the slope density, not the density. Three methods invert it to two dimensions:

``mixture``  P1 = Σ w_k N(0, σ_k²) is fitted; the same weights make P22 = Σ w_k N₂(0, σ_k²). Where the fit fails, ``abel`` is used.
``abel``     P22 as rings of constant density, whose marginals are fitted to P1 with non-negative heights, as smooth as the counts allow.
``crf``      the patent's: the histogram of arctan|p| is used as D. Approximate, for gentle Gaussian slopes only: wrong by K·cos²α.

The uncertainty comes from half-samples: each method is repeated with balanced halves of the stretches of the lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.facets.density_changes import changed, narrowing, planar_changes, radial_changes, with_changes
from brdfpipe.facets.facet_dataset import (
    noise_warning,
    planar_dataset,
    principal_ellipse,
    quality_flags,
    radial_dataset,
)
from brdfpipe.facets.line_inversion import (
    Mixture,
    RadialEstimate,
    estimate_from_mixture,
    estimate_from_patent,
    estimate_from_rings,
    fit_mixture,
    ratio_of,
)
from brdfpipe.facets.line_slope_counts import LineSlopeCounts, count_slopes
from brdfpipe.facets.noise_removal import with_noise_stated
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.facets.slope_histogram import FacetError
from brdfpipe.facets.slopes import SCALES, correlation_length, mean_square
from brdfpipe.geometry import Array
from brdfpipe.psd.noise_floor import NoiseFloor

METHODS = ("mixture", "abel", "crf")

MISFIT_LIMIT = 3.0
"""Reduced χ² above which a mixture of Gaussians does not fit the slopes."""

AZIMUTH_TOLERANCE = 1.0
"""Largest difference of the azimuths of lines in one direction, and of two perpendicular directions from 90 [degree]."""

COARSE_QUANTUM = 0.5
"""Slope of one height step, over the slope rms, above which a warning is given."""

MIN_INDEPENDENT = 1000
"""Independent slopes below which a warning is given: the relative uncertainty of the peak is then 15 % or more."""

_CORRELATION_COST = 100
"""Independent slopes at which the correlation of the slopes is so uncertain that half-samples understate the scatter by √2."""


class _Direction(NamedTuple):
    azimuth: float
    lines: Sequence[xr.Dataset]


def estimate_from_lines(
    lines: Sequence[xr.Dataset], method: str, isotropic: bool | None, noise: float | NoiseFloor | None
) -> xr.Dataset:
    """Facet distribution of levelled line profiles; see :func:`brdfpipe.facets.estimate`."""
    directions = check_directions(lines, method, isotropic)
    return _isotropic(lines, method, noise) if isotropic is True else _perpendicular(directions, noise)


def check_directions(lines: Sequence[xr.Dataset], method: str, isotropic: bool | None) -> list[_Direction]:
    """The directions of line profiles; none of an isotropic surface. A FacetError refuses those that do not show the slopes in all azimuths."""
    if isotropic is True:
        return []
    directions = _directions(lines)
    azimuths = ", ".join(f"{direction.azimuth:.4g}°" for direction in directions)
    if len(directions) == 1:
        raise FacetError(
            f"all lines run in one direction ({azimuths}), and the slopes across it are unknown; set `surface.isotropic: true` in "
            "material.yaml if the surface is isotropic, or add a line perpendicular to the first in `surface.scans`, with "
            "its `azimuth`"
        )
    turn = directions[1].azimuth - directions[0].azimuth
    if len(directions) > 2 or abs(turn - 90) > AZIMUTH_TOLERANCE:
        raise FacetError(
            f"lines of a surface with a lay must run in two perpendicular directions (within {AZIMUTH_TOLERANCE:g}°), along the "
            f"lay and across it; found {len(directions)}, at {azimuths}. Remove the others from `surface.scans`, correct their "
            "`azimuth`, or set `surface.isotropic: true` if the surface is isotropic"
        )
    if method != "mixture":
        raise FacetError(
            f"method {method!r} is for lines on an isotropic surface; accepted for two directions: mixture"
        )
    return directions


def _directions(lines: Sequence[xr.Dataset]) -> list[_Direction]:
    """Lines by azimuth in [0, 180), those within the tolerance of a neighbour together under their mean."""
    azimuths = np.array([float(line.attrs.get("azimuth", 0.0)) for line in lines])
    if not np.isfinite(azimuths).all():
        raise FacetError(
            "the azimuth of a line is not a finite number; accepted: degrees (`surface.azimuth`, `surface.scans`)"
        )
    azimuths %= 180
    order = np.argsort(azimuths, kind="stable")
    # A direction begins where the gap to the one before is wide; about 180° it may begin before 0°.
    begins = np.diff(azimuths[order], prepend=azimuths[order[-1]] - 180) > AZIMUTH_TOLERANCE
    first = int(np.argmax(begins))
    order, begins = np.roll(order, -first), np.roll(begins, -first)
    groups = np.split(order, np.flatnonzero(begins[1:]) + 1)
    directions = []
    for group in groups:
        about = azimuths[group[0]]
        mean = about + float(np.mean((azimuths[group] - about + 90) % 180 - 90))
        directions.append(_Direction(round(mean, 9) % 180, [lines[n] for n in group]))
    return sorted(directions, key=lambda direction: direction.azimuth)


def _isotropic(lines: Sequence[xr.Dataset], method: str, noise: float | NoiseFloor | None) -> xr.Dataset:
    marginal = count_slopes(lines, noise)
    history, warnings = ["declared isotropic"], []
    if method == "crf":
        inverted = estimate_from_patent(marginal)
        warnings.append(
            "method crf uses the histogram of the slopes along the line as the facet distribution: the error is a factor cos²α on "
            "Gaussian surfaces and larger on others; use method mixture"
        )
    else:
        fit = fit_mixture([marginal])
        inverted = estimate_from_mixture(marginal, fit)
    if method == "mixture":
        history.append(f"Gaussian scale mixture fitted to the slopes along the line, reduced χ² {fit.misfit:.2f}")
        if fit.misfit > MISFIT_LIMIT:
            warnings.append(
                f"a mixture of Gaussians does not fit the slopes along the line (reduced χ² {fit.misfit:.1f}); rings were fitted instead "
                "(method abel). The surface may be grooved or anisotropic; measure an areal map"
            )
            method = "abel"
    if method == "abel":
        rings = estimate_from_rings(marginal, fit)
        if rings is None:
            warnings.append(
                "rings (method abel) do not reproduce the mean slope along the line, probably because the height steps are coarse; a "
                "mixture of Gaussians was fitted instead. Measure with a finer height resolution, or an areal map"
            )
            method = "mixture"
            if fit.misfit > MISFIT_LIMIT:
                inverted = inverted._replace(relative_u=np.ones_like(inverted.relative_u))
        else:
            inverted = rings
    density, relative_u = inverted.density, _with_rounding_and_sampling(inverted.relative_u, [marginal])
    facets = radial_dataset(density, inverted.slope_rms)
    facets = facets.assign(
        slope_density_quality=("slope", quality_flags(density.slope <= marginal.measured_to)),
        D_u=("alpha", facets["D"].values * relative_u),
        line_count=("slope", marginal.on_nodes(density.slope)),
        tail_slope=marginal.measured_to,
    )
    s, weight = density.rule()
    facets = facets.assign(_tail_shares(s**2, weight, s > marginal.measured_to))
    facets = with_changes(facets, _changes(inverted, marginal))
    facets.attrs |= {"method": f"line profile, {method}", "band": str(lines[0].attrs["band"])}
    facets = vocabulary.add_warning(
        vocabulary.add_history(facets, *history), *warnings, *_short_line_warning([marginal], relative_u[0])
    )
    facets = _with_statistics(facets, lines, [marginal], np.sqrt(2) * _slope_rms_by_scale(lines, marginal))
    return vocabulary.label(facets, "facets")


def _tail_shares(squares: Array, weight: Array, extrapolated: NDArray[np.bool_]) -> dict[str, float]:
    """What the facets of the extrapolated tail are of all facets, and of their mean square slope, from a quadrature of the density."""
    part = squares * weight
    return {
        "tail_share": float(weight[extrapolated].sum() / weight.sum()),
        "tail_contribution": float(part[extrapolated].sum() / part.sum()),
    }


def _changes(inverted: RadialEstimate, marginal: LineSlopeCounts) -> dict[str, Array]:
    """Changes of the density (changes, nodes) by source."""
    few = np.sqrt(1 + _CORRELATION_COST / marginal.independent)
    of_facets = radial_changes(inverted.density, few * inverted.half_changes)
    if not marginal.noise_u:
        return {"facets": of_facets}
    log_change = narrowing(inverted.density, marginal.noise_u / marginal.rms**2)
    return {"facets": of_facets, "noise": changed(inverted.density, log_change[None])}


def _with_rounding_and_sampling(relative_u: Array, marginals: Sequence[LineSlopeCounts]) -> Array:
    """Relative uncertainty, with the parts that half-samples do not show: coarse height steps, noise, and few slopes."""
    few = 1 + _CORRELATION_COST / min(marginal.independent for marginal in marginals)
    rounding = max(marginal.rounding for marginal in marginals)
    noise = max(marginal.noise_u / marginal.rms**2 for marginal in marginals)
    return np.asarray(np.minimum(1.0, np.sqrt(relative_u**2 * few + rounding**2 + noise**2)))


def _short_line_warning(marginals: Sequence[LineSlopeCounts], peak_u: float) -> list[str]:
    independent = min(marginal.independent for marginal in marginals)
    if independent >= MIN_INDEPENDENT:
        return []
    return [
        f"only {independent:.0f} independent slopes along the line: the relative uncertainty of the peak density is {peak_u:.0%}; "
        "measure a longer line, or add lines of the same surface (`surface.scans`)"
    ]


def _with_statistics(
    facets: xr.Dataset, lines: Sequence[xr.Dataset], marginals: Sequence[LineSlopeCounts], by_scale: Array
) -> xr.Dataset:
    """Add the statistics of the lines, and warnings about coarse or noisy heights."""
    facets = facets.assign(
        facet_count=float(sum(marginal.size for marginal in marginals)),
        effective_count=float(sum(marginal.independent for marginal in marginals)),
        correlation_length=float(np.mean([correlation_length(line) for line in lines])),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1] if by_scale[1] else np.nan,
    ).assign_coords(scale=SCALES)
    history, warnings = [], []
    for marginal in marginals:
        warnings += marginal.outlying.warning("slopes along a line", "the slope rms is")
        step = f"multiples of up to {marginal.quantum:.3g}, {marginal.quantum / marginal.rms:.0%} of their rms"
        if marginal.quantum:
            history.append(
                f"the heights are quantised: slopes along a line are {step}, and were counted in whole multiples"
            )
        if marginal.quantum > COARSE_QUANTUM * marginal.rms:
            warnings.append(
                f"coarse height steps: slopes along a line are {step}; the density between these values is inferred. "
                "Measure with a finer height resolution, or at a larger pitch"
            )
    facets = vocabulary.add_history(facets, *history) if history else facets
    pitch = float(lines[0].attrs["pitch_x"])
    noisiest = max(marginals, key=lambda marginal: marginal.noise)
    noise = float(np.sqrt(noisiest.noise / 2)) * pitch
    noise_u = noisiest.noise_u * pitch**2 / (4 * noise) if noise else 0.0
    share = noisiest.noise / (noisiest.noise + noisiest.rms**2)
    facets = with_noise_stated(facets, noise, noise_u, share)
    return vocabulary.add_warning(facets, *warnings, *noise_warning(facets))


def _slope_rms_by_scale(lines: Sequence[xr.Dataset], marginal: LineSlopeCounts) -> Array:
    """Rms, about the mean of each line, of slopes over 1, 2, 4 and 8 pixels, less the mean square of the noise; without outlying ones."""
    squares = np.zeros(SCALES.size)
    for line in lines:
        height, pitch = line["height"].values[: 2**18].astype(float), float(line.attrs["pitch_x"])
        for index, n in enumerate(SCALES.astype(int)):
            slopes = (height[n:] - height[:-n]) / (n * pitch)
            slopes -= np.nanmean(slopes)
            if np.isfinite(marginal.outlying.slope):
                slopes[np.abs(slopes) >= marginal.outlying.slope] = np.nan
            squares[index] += mean_square(slopes) / len(lines)
    return np.sqrt(np.maximum(squares - marginal.noise / SCALES**2, squares / 20))


def _perpendicular(directions: Sequence[_Direction], noise: float | NoiseFloor | None) -> xr.Dataset:
    """Density of a surface with a lay along one of two perpendicular directions: elliptic, with one mixture for both.

    The slopes in each direction, over their rms, are drawn from one scale mixture; P22 = Σ w_k N(p; σ_k a) N(q; σ_k b).
    """
    counted = sorted(((count_slopes(item.lines, noise), item) for item in directions), key=lambda pair: pair[0].rms)
    marginals = [marginal for marginal, _ in counted]
    along, across = (marginal.rms for marginal in marginals)
    fit = fit_mixture([marginal.divided_by(marginal.rms) for marginal in marginals])
    ellipse = principal_ellipse(along, across, counted[0][1].azimuth)
    density = PlanarDensity.elliptic(fit.density, ellipse, 8.3 * fit.widest)
    facets = planar_dataset(density, float(np.hypot(along, across)))
    x, y = density.along.nodes, density.across.nodes[:, None]
    relative_u = _with_rounding_and_sampling(
        _planar_uncertainty(density, fit, marginals) * np.sqrt(max(1.0, fit.misfit)), marginals
    )
    trusted = (x / marginals[0].measured_to) ** 2 + (y / marginals[1].measured_to) ** 2 <= 1
    dims = ("slope_across", "slope_along")
    facets = facets.assign(
        slope_density_u=(dims, density.density * relative_u),
        slope_density_quality=(dims, quality_flags(trusted)),
        line_count_along=("slope_along", marginals[0].on_nodes(density.along.nodes)),
        line_count_across=("slope_across", marginals[1].on_nodes(density.across.nodes)),
    )
    facets = with_changes(facets, _planar_changes(density, fit, marginals))
    p, q, weight = density.principal_rule()
    extrapolated = (p / marginals[0].measured_to) ** 2 + (q / marginals[1].measured_to) ** 2 > 1
    facets = facets.assign(_tail_shares(p**2 + q**2, weight, extrapolated))
    lines = [line for direction in directions for line in direction.lines]
    facets.attrs |= {"method": "two perpendicular lines, Gaussian scale mixture", "band": str(lines[0].attrs["band"])}
    facets = vocabulary.add_history(
        facets, "the lay was taken to run along one of the two lines, and the density to be elliptic about it"
    )
    if fit.misfit > MISFIT_LIMIT:
        facets = vocabulary.add_warning(
            facets,
            f"one mixture of Gaussians does not fit the slopes along both lines (reduced χ² {fit.misfit:.1f}); measure an areal map",
        )
    facets = vocabulary.add_warning(
        facets, *_short_line_warning(marginals, float(relative_u.flat[relative_u.size // 2]))
    )
    by_scale = np.hypot(*(_slope_rms_by_scale(item.lines, marginal) for marginal, item in counted))
    return vocabulary.label(_with_statistics(facets, lines, marginals, by_scale), "facets")


def _planar_changes(density: PlanarDensity, fit: Mixture, marginals: Sequence[LineSlopeCounts]) -> dict[str, Array]:
    """Changes of the density (changes, across, along) by source: of the mixture and of the ratio of the widths, both by halves.

    The azimuth of the lay is taken as exact: it is that of the lines.
    """
    rings = estimate_from_mixture(marginals[0].divided_by(marginals[0].rms), fit)
    ring = rings.density.normalised()
    widths = _widths_of_halves(marginals)[:, 1:]
    ratio = (widths[0] - widths[1]) / 2 / np.sqrt(widths.shape[1])
    few = 1 + _CORRELATION_COST / min(marginal.independent for marginal in marginals)
    factor = np.sqrt(few * max(1.0, fit.misfit))
    along, across = (marginal.noise_u / marginal.rms**2 for marginal in marginals)
    noise = np.append(narrowing(ring, (along + across) / 2), [(across - along) / 2, 0.0])
    samples = factor * rings.half_changes, factor * np.stack([ratio, np.zeros_like(ratio)])
    return planar_changes(density, ring, *samples, noise[None] if along or across else noise[None][:0])


def _widths_of_halves(marginals: Sequence[LineSlopeCounts]) -> Array:
    """Mean square slopes (directions, 1 + halves) over those of all stretches, and over the mean of both directions.

    The common width is already in the uncertainty of the mixture.
    """
    widths = np.stack([marginal.rms_of_halves for marginal in marginals])
    sizes = np.array([[marginal.size] for marginal in marginals])
    relative = (widths / widths[:, :1]) ** 2
    return np.asarray(relative / ((sizes * relative).sum(axis=0) / sizes.sum()))


def _planar_uncertainty(density: PlanarDensity, fit: Mixture, marginals: Sequence[LineSlopeCounts]) -> Array:
    """Relative standard uncertainty (across, along), of halves of the stretches: of the mixture's, and of the ratio of the widths.

    As on an isotropic surface, the mean square is taken over slopes within a factor of 1.35.
    """
    from scipy.ndimage import uniform_filter

    relative = _widths_of_halves(marginals)
    middle = density.along.size // 2
    x, y = (axis.nodes[middle:] / axis.scale for axis in (density.along, density.across))
    # Densities of half-samples are symmetric: a quarter of the grid is enough.
    first = fit.density(x**2 + y[:, None] ** 2)
    square = np.zeros_like(first)
    for half, (ratio_x, ratio_y) in enumerate(relative.T[1:], start=1):
        values = fit.density(x**2 / ratio_x + y[:, None] ** 2 / ratio_y, half) / np.sqrt(ratio_x * ratio_y)
        square += (ratio_of(values, first) - 1) ** 2 / (relative.shape[1] - 1)
    whole = np.pad(square, ((middle, 0), (middle, 0)), mode="reflect")
    step = 2 * density.along.end / (density.along.size - 1)
    mean = uniform_filter(whole, 2 * round(0.3 / step) + 1, mode="nearest")
    return np.asarray(np.minimum(1.0, np.sqrt(np.maximum(mean, 0.0))))

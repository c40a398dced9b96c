"""Facet distribution from line profiles, which see only the slopes along themselves.

A line gives the marginal P1(p) of the slope density, not the density. Three ways lead from it to two dimensions:

``mixture``  P1 = Σ w_k N(0, σ_k²) is fitted; the same weights make P22 = Σ w_k N₂(0, σ_k²). Where the fit fails, ``abel``.
``abel``     P22 as rings of constant density, whose marginals are fitted to P1 with non-negative heights, as smooth as the counts allow.
``crf``      the patent's: the histogram of arctan|p| taken for D. Near-right for gentle Gaussian slopes only: off by K·cos²α.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.facets.assembly import planar_axes, planar_dataset, positive, radial_dataset, with_noise_warning
from brdfpipe.facets.counting import FacetError, histogram, redundancy_of
from brdfpipe.facets.slopes import SCALES, correlation_length, count_line, inner, mean_square
from brdfpipe.geometry import Array
from brdfpipe.planar import PlanarDensity

METHODS = ("mixture", "abel", "crf")

MISFIT_LIMIT = 3.0
"""Reduced χ² above which slopes are no mixture of Gaussians."""

_COMPONENTS = 24
_LEAST = 128
_BINS = 256
_RINGS = 64


class _Marginal(NamedTuple):
    """Slopes along a line, counted."""

    edges: Array
    """(bins + 1,) of |p|, from 0."""
    counts: Array
    redundancy: float
    rms: float
    median: float
    size: int

    @property
    def steepest(self) -> float:
        return float(self.edges[-1])


def of_lines(lines: Sequence[xr.Dataset], method: str, isotropic: bool | None) -> xr.Dataset:
    """Facet distribution of levelled line profiles; see :func:`brdfpipe.facets.estimate`."""
    if method not in METHODS:
        raise FacetError(f"unknown method {method!r} for a line profile; accepted: {', '.join(METHODS)}")
    azimuths = _axes(lines)
    if isotropic is True:
        return _isotropic(lines, method)
    if len(azimuths) == 2 and method != "mixture":
        raise FacetError(
            f"method {method!r} takes lines of an isotropic surface alone; accepted for two directions: mixture"
        )
    if len(azimuths) == 2 and abs(azimuths[1] - azimuths[0] - 90) < 1:
        return _perpendicular(lines, azimuths[0])
    raise FacetError(
        "a single line profile gives the slopes along the line alone; set `surface.isotropic: true` in material.yaml if the "
        "surface scatters alike in every azimuth, or give a second line perpendicular to the first"
    )


def slopes_along(line: xr.Dataset) -> Array:
    """Slopes between neighbouring points of a line, their mean removed; points next to a missing height are left out."""
    height = np.asarray(line["height"].values, dtype=float)
    along = height[1:] - height[:-1]
    along *= 1 / float(line.attrs["pitch_x"])
    total = float(along.sum())
    if not np.isfinite(total):
        along = along[np.isfinite(along)]
        total = float(along.sum())
    if along.size < _LEAST or not np.any(along):
        raise FacetError(
            f"the line profile has {along.size} slopes that are not all zero, at least {_LEAST} are needed"
        )
    along -= total / along.size
    return along


def _isotropic(lines: Sequence[xr.Dataset], method: str) -> xr.Dataset:
    along = slopes_along(lines[0]) if len(lines) == 1 else np.concatenate([slopes_along(line) for line in lines])
    marginal = _count(along)
    history, warnings = ["declared isotropic"], []
    if method == "crf":
        density, slope_rms = _patent(marginal)
        warnings.append(
            "method crf takes the histogram of the slopes along the line for the facet distribution: it differs from the "
            "distribution by cos²α on Gaussian surfaces and more on others; method mixture does not"
        )
    else:
        fit = _fit_mixture(marginal)
        density, slope_rms = _mixture_density(fit)
    if method == "mixture":
        history.append(f"Gaussian scale mixture fitted to the slopes along the line, reduced χ² {fit.misfit:.2f}")
        if fit.misfit > MISFIT_LIMIT:
            warnings.append(
                f"the slopes along the line are no mixture of Gaussians (reduced χ² {fit.misfit:.1f}), so rings were fitted instead "
                "(method abel): the surface may be grooved or not isotropic; measure an areal map"
            )
            method = "abel"
    if method == "abel":
        density, slope_rms, kept = _rings(marginal, fit)
        if not kept:
            warnings.append(
                "the slopes along the line take few distinct values, and rings do not keep their mean: a mixture of "
                "Gaussians was taken for what lies between; measure with a finer height resolution"
            )
            method = "mixture"
    facets = radial_dataset(density, slope_rms)
    relative_u = _relative_uncertainty(density, marginal)
    beyond = np.concatenate([np.cumsum(marginal.counts[::-1])[::-1], [0.0]])
    measured_to = float(marginal.edges[np.flatnonzero(beyond >= min(100 * marginal.redundancy, beyond[0]))[-1]])
    quality = np.where(density.slope <= measured_to, vocabulary.quality("measured"), vocabulary.quality("extrapolated"))
    facets = facets.assign(
        slope_density_quality=("slope", quality.astype(np.int8)), D_u=("alpha", facets["D"].values * relative_u)
    )
    facets = _with_line_statistics(facets, [list(lines), list(lines)], marginal)
    facets.attrs |= {"method": f"line profile, {method}", "band": str(lines[0].attrs["band"])}
    facets = vocabulary.add_warning(vocabulary.add_history(facets, *history), *warnings)
    return vocabulary.label(with_noise_warning(facets), "facets")


def _with_line_statistics(
    facets: xr.Dataset, directions: Sequence[Sequence[xr.Dataset]], marginal: _Marginal
) -> xr.Dataset:
    # Two perpendicular components; of an isotropic surface, the same lines stand for both.
    squares = [np.mean([_slope_rms_by_scale(line) ** 2 for line in lines], axis=0) for lines in directions]
    by_scale = np.sqrt(np.sum(squares, axis=0))
    return facets.assign(
        facet_count=float(marginal.size),
        effective_count=marginal.size / marginal.redundancy,
        correlation_length=float(np.mean([correlation_length(line) for lines in directions for line in lines])),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1],
    ).assign_coords(scale=SCALES)


def _slope_rms_by_scale(line: xr.Dataset) -> Array:
    height, pitch = line["height"].values[: 2**20].astype(float), float(line.attrs["pitch_x"])
    return np.array([np.sqrt(mean_square((height[n:] - height[:-n]) / (n * pitch))) for n in SCALES.astype(int)])


def _count(along: Array) -> _Marginal:
    rms = float(np.sqrt(inner(along, along) / along.size))
    edges, by_block, _ = histogram(count_line(along), rms / 2, _BINS)
    counts = by_block.sum(axis=0)
    cumulative = np.concatenate([[0.0], np.cumsum(counts)])
    median = float(np.interp(0.5 * cumulative[-1], cumulative, edges))
    return _Marginal(edges, counts, redundancy_of(by_block), rms, median, along.size)


# --- mixture


class _Mixture(NamedTuple):
    weight: Array
    sigma: Array
    misfit: float
    """Reduced χ²."""


def _fit_mixture(marginal: _Marginal) -> _Mixture:
    """Fit P1(p) = Σ w_k N(0, σ_k²), w >= 0, by expectation maximisation on binned |p|.

    The inversion to two dimensions divides each weight by σ_k²: a sliver of narrow components would ruin the peak. So the
    components begin at half the median slope, and the iteration stops when twenty more rounds no longer gain likelihood that
    the counts could tell from noise.
    """
    from scipy.special import erf

    edges, counts = marginal.edges, marginal.counts
    low = max(marginal.median / 2, marginal.rms / 50)
    sigma = np.geomspace(low, max(marginal.steepest / 2, 2 * marginal.rms), _COMPONENTS)
    probability = np.diff(erf(edges[:, None] / (np.sqrt(2) * sigma)), axis=0)
    weight = np.exp(-0.5 * np.log(sigma / marginal.rms) ** 2)
    weight /= weight.sum()
    likelihood = -np.inf
    for _ in range(100):
        for _ in range(20):
            weight = weight * (probability.T @ (counts / np.maximum(probability @ weight, 1e-300))) / counts.sum()
        former, likelihood = likelihood, float(counts @ np.log(np.maximum(probability @ weight, 1e-300)))
        if likelihood - former < 0.03 * marginal.redundancy:
            break
    weight = weight / weight.sum()
    return _Mixture(weight, sigma, _misfit(counts, counts.sum() * (probability @ weight), marginal.redundancy))


def _mixture_density(fit: _Mixture) -> tuple[RadialDensity, float]:
    variance = fit.sigma**2
    # An isotropic surface has twice the mean square slope of any line on it.
    slope_rms = float(np.sqrt(2 * fit.weight @ variance))
    widest = fit.sigma[fit.weight > 1e-9].max()
    slope = slope_rms * np.sinh(np.linspace(0, np.arcsinh(8.3 * widest / slope_rms), 384))
    density = (np.exp(-(slope[:, None] ** 2) / (2 * variance)) / (2 * np.pi * variance)) @ fit.weight
    return RadialDensity(slope, density), slope_rms


def _misfit(counts: Array, expected: Array, redundancy: float) -> float:
    """Reduced χ² over bins merged to 25 independent slopes each."""
    group = np.floor(np.cumsum(expected) / (25 * redundancy))
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    found, wanted = np.add.reduceat(counts, starts), np.add.reduceat(expected, starts)
    deviation = (found - wanted) ** 2 / np.maximum(wanted, 1e-300)
    return float(deviation.sum()) / redundancy / max(1, starts.size - 1)


# --- rings


def _rings(marginal: _Marginal, fit: _Mixture) -> tuple[RadialDensity, float, bool]:
    """Regularised Abel inversion: non-negative rings, as smooth as a fit to the counts of χ² = 1 allows.

    Also tells whether they keep the mean slope along the line, within a twentieth; where they do not, the mixture is given back:
    counts of slopes that take few distinct values hold no rings.
    """
    from scipy.optimize import nnls

    rings = marginal.rms * np.sinh(np.linspace(0, np.arcsinh(marginal.steepest / marginal.rms), _RINGS + 1))
    share = _ring_shares(rings, marginal.edges)
    counts = marginal.counts / marginal.counts.sum()
    root = 1 / np.sqrt(np.maximum(counts, 1 / marginal.counts.sum()) * marginal.redundancy / marginal.counts.sum())
    area = np.pi * np.diff(rings**2)
    middle = np.sqrt((rings[1:] ** 2 + rings[:-1] ** 2) / 2)
    # Smooth means: a slowly varying multiple of the nearest mixture, which has the right tails.
    mixture = _mixture_density(fit)[0](middle**2)
    smoothness = np.diff(np.eye(_RINGS), 2, axis=0) / (area * np.maximum(mixture, 1e-9 * mixture.max()))
    fits = []
    for strength in 10.0 ** np.arange(4.0, -4.5, -0.5):
        design = np.concatenate([root[:, None] * share, strength * smoothness])
        weight = nnls(design, np.concatenate([root * counts, np.zeros(_RINGS - 2)]), maxiter=50 * _RINGS)[0]
        fits.append((_misfit(marginal.counts, marginal.counts.sum() * (share @ weight), marginal.redundancy), weight))
    # The smoothest that the counts cannot tell from the closest.
    enough = max(1.0, min(misfit for misfit, _ in fits) + 0.2)
    best = next(weight for misfit, weight in fits if misfit <= enough)
    height = best / best.sum() / area
    slope = np.concatenate([[0.0], middle, rings[-1:]])
    values = np.maximum(np.concatenate([height[:1], height, height[-1:]]), 1e-12 * height.max())
    density = RadialDensity(slope, values)
    density = RadialDensity(slope, values / density.mass)
    s, weight = density.rule()
    # Of an isotropic surface the mean |p| along a line is 2/π of the mean slope; unlike a mean square, no tail upsets it.
    along = float(marginal.counts @ (marginal.edges[1:] + marginal.edges[:-1])) / 2 / float(marginal.counts.sum())
    if abs(2 / np.pi * float(weight @ s) / along - 1) > 0.05:
        return *_mixture_density(fit), False
    return density, float(np.sqrt(weight @ s**2)), True


def _ring_shares(rings: Array, edges: Array) -> Array:
    """Share of each ring's slopes whose component along the line has |p| in each bin, (bins, rings)."""

    def below(p: Array, radius: Array) -> Array:
        # ∫₀^p √(r² − t²) dt, the part of a disc's marginal below p.
        inside = np.minimum(p[:, None], radius)
        ratio = np.divide(inside, radius, out=np.zeros_like(inside), where=radius > 0)
        return (inside * np.sqrt(np.maximum(radius**2 - inside**2, 0)) + radius**2 * np.arcsin(ratio)) / 2

    disc = 4 * np.diff(below(edges, rings[None, :].repeat(edges.size, 0)), axis=0)
    return np.asarray(np.diff(disc, axis=1) / (np.pi * np.diff(rings**2)))


# --- the patent's


def _patent(marginal: _Marginal) -> tuple[RadialDensity, float]:
    """The histogram of α = arctan|p| taken for D and renormalised: P22 = P1(s) / (1 + s²) up to a constant.

    Patent US 9,395,299, step b, simplified mode.
    """
    least = 25 * marginal.redundancy
    cuts = [0]
    cumulative = np.concatenate([[0.0], np.cumsum(marginal.counts)])
    for cut in range(1, cumulative.size):
        if cumulative[cut] - cumulative[cuts[-1]] >= least:
            cuts.append(cut)
    edges = marginal.edges[cuts]
    middle = (edges[1:] + edges[:-1]) / 2
    marginal_density = np.diff(cumulative[cuts]) / np.diff(edges)
    slope = np.concatenate([[0.0], middle, edges[-1:]])
    values = np.concatenate([marginal_density[:1], marginal_density, marginal_density[-1:]]) / (1 + slope**2)
    density = RadialDensity(slope, values)
    density = RadialDensity(slope, values / density.mass)
    s, weight = density.rule()
    return density, float(np.sqrt(weight @ s**2))


# --- two perpendicular lines


def _perpendicular(lines: Sequence[xr.Dataset], azimuth: float) -> xr.Dataset:
    """Density of a surface with a lay along one of two perpendicular lines: elliptic, with one mixture for both.

    The slopes along each line, over their rms, are drawn from one scale mixture; P22 = Σ w_k N(p; σ_k a) N(q; σ_k b).
    """
    along = [
        np.concatenate([slopes_along(line) for line in lines if _azimuth(line) == angle]) for angle in _axes(lines)
    ]
    rms = [float(np.sqrt(np.mean(slopes**2))) for slopes in along]
    marginal = _count(np.concatenate([slopes / scale for slopes, scale in zip(along, rms, strict=True)]))
    fit = _fit_mixture(marginal)
    widest = float(fit.sigma[fit.weight > 1e-9].max())
    cos, sin = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    x, y = planar_axes(
        float(np.hypot(rms[0] * cos, rms[1] * sin)), float(np.hypot(rms[0] * sin, rms[1] * cos)), 8.3 * widest
    )
    p, q = np.meshgrid(x.nodes, y.nodes)
    square = ((p * cos + q * sin) / rms[0]) ** 2 + ((q * cos - p * sin) / rms[1]) ** 2
    values = sum(
        weight * np.exp(-np.minimum(square / (2 * sigma**2), 640.0)) / (2 * np.pi * sigma**2 * rms[0] * rms[1])
        for weight, sigma in zip(fit.weight, fit.sigma, strict=True)
    )
    density = PlanarDensity(x, y, positive(np.asarray(values)))
    facets = planar_dataset(density, float(np.hypot(rms[0], rms[1])))
    rough_first = rms[0] >= rms[1]
    directions = [[line for line in lines if _azimuth(line) == angle] for angle in _axes(lines)]
    facets = _with_line_statistics(facets, directions, marginal).assign(
        anisotropy=max(rms) / min(rms), lay=(azimuth + 90 * rough_first + 90) % 180 - 90
    )
    facets.attrs |= {"method": "two perpendicular lines, Gaussian scale mixture", "band": str(lines[0].attrs["band"])}
    facets = vocabulary.add_history(
        facets, "the lay was taken to run along one of the two lines, and the density to be elliptic about it"
    )
    if fit.misfit > MISFIT_LIMIT:
        facets = vocabulary.add_warning(
            facets,
            f"the slopes along the two lines do not share one mixture of Gaussians (reduced χ² {fit.misfit:.1f}); measure an areal map",
        )
    return vocabulary.label(with_noise_warning(facets), "facets")


def _azimuth(line: xr.Dataset) -> float:
    return float(line.attrs.get("azimuth", 0.0)) % 180


def _axes(lines: Sequence[xr.Dataset]) -> list[float]:
    return sorted({_azimuth(line) for line in lines})


def _relative_uncertainty(density: RadialDensity, marginal: _Marginal) -> Array:
    """Relative uncertainty of the density, from counting the slopes within a tenth of a decade of each node.

    Below half the median slope the fit has no detail of its own: the peak is as uncertain as the density there.
    """
    slope = np.maximum(density.slope, marginal.median / 2)
    weight = 2 * np.pi * slope**2 * density(slope**2) * 0.23
    return np.minimum(1.0, 1 / np.sqrt(np.maximum(marginal.size / marginal.redundancy * weight, 1.0)))

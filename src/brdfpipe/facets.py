"""From a measured surface to its facet distribution.

On a constant-pitch grid every facet has the same projected area, so facets are counted in slope space: the count is the
slope density P22, and D(m) = P22 / cos⁴α. Every quad is cut along both diagonals into four triangles; a single diagonal
would correlate the two slope components and show a false lay.

References
----------
Patent US 9,395,299 (CRF), steps a3 and b; Heitz 2014 (JCGT 3(2)); Ribardière 2019.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import masking, vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

DISTRIBUTIONS = ("beckmann", "ggx")

_BLOCKS = 8
_FINE_BINS = 2**14
_COARSE_BINS = 112
_TAIL_NODES = 24
_LEAST_BINS = 6
_MIXTURE_COMPONENTS = 24
_LEAST_LINE = 128


class FacetError(BrdfpipeError):
    """A surface does not yield a facet distribution."""


def estimate(surface: xr.Dataset, *, method: str = "mixture", isotropic: bool | None = None) -> xr.Dataset:
    """Facet distribution of a levelled surface, with counts and uncertainty.

    Parameters
    ----------
    surface : kind ``surface``, levelled; an areal map or a line profile
    method : how a line profile is turned into a two-dimensional density; ``mixture``: a scale mixture of Gaussians is fitted
        to the slopes along the line, whose inversion is exact
    isotropic : whether the surface scatters alike in every azimuth. A line profile must be declared isotropic; a map is
        taken as isotropic, with a warning where its principal slopes differ

    Returns
    -------
    Dataset of kind ``facets``

    Raises
    ------
    FacetError : a line profile is not declared isotropic, or there are too few independent facets.
    VocabularyError : the dataset is not of kind ``surface``.
    """
    vocabulary.validate(surface, "surface")
    if surface["height"].ndim == 1:
        return _of_line(surface, method, isotropic)
    return _of_map(surface, isotropic)


def analytic(distribution: str, a: float) -> xr.Dataset:
    """Facet distribution of a named isotropic density, for tests and for materials known by a roughness figure alone.

    Parameters
    ----------
    distribution : ``beckmann``: P22 = exp(−s²/a²)/(πa²), whose slope rms is a/√2 per axis and a in all;
        ``ggx``: P22 = a²/[π(a² + s²)²], which has no finite slope rms
    a : width, 1e-6 to 10 [1]

    Raises
    ------
    FacetError : the distribution is unknown or the width out of range.

    References
    ----------
    Beckmann & Spizzichino 1963; Walter 2007 (EGSR).
    """
    if distribution not in DISTRIBUTIONS:
        raise FacetError(f"unknown facet distribution {distribution!r}; accepted: {', '.join(DISTRIBUTIONS)}")
    if not 1e-6 <= a <= 10:
        raise FacetError(f"the width a of {distribution} is {a:g}; accepted: 1e-6 to 10")
    if distribution == "beckmann":
        # Beyond 8.3 a the density is 1e-30 of its peak: less than rounding in every integral.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(8.3), 512))
        density, slope_rms = np.exp(-((slope / a) ** 2)) / (np.pi * a**2), a
    else:
        # The tail decides the masking at grazing: 1e7 a leaves out 2e-7 of the mean slope.
        slope = a * np.sinh(np.linspace(0, np.arcsinh(1e7), 1024))
        density, slope_rms = 1 / (np.pi * a**2 * (1 + (slope / a) ** 2) ** 2), np.nan
    facets = _dataset(RadialDensity(slope, density), slope_rms)
    facets.attrs |= {"method": f"analytic {distribution}, a = {a:g}", "band": "none: not measured"}
    return vocabulary.label(facets, "facets")


# --- areal maps


class _Moments(NamedTuple):
    facets: int
    mean: Array
    """(2,) mean slope along x and y."""
    covariance: Array
    """(2, 2) about the mean."""
    steepest: float

    @property
    def slope_rms(self) -> float:
        return float(np.sqrt(np.trace(self.covariance) + self.mean @ self.mean))


def _of_map(surface: xr.Dataset, isotropic: bool | None) -> xr.Dataset:
    height = surface["height"].values
    pitch = float(surface.attrs["pitch_x"]), float(surface.attrs["pitch_y"])
    moments = _moments(height, pitch)
    if moments.facets == 0 or moments.steepest == 0:
        raise FacetError(
            "the surface is perfectly flat or has no complete facet; check the height unit and the missing heights"
        )
    histogram = _histogram(height, pitch, moments)
    binned, redundancy = _binned(histogram)
    density, quality, relative_u = _counted_density(binned, redundancy)
    facets = _dataset(density, moments.slope_rms)
    slopes_by_scale = _slope_rms_by_scale(height, pitch)
    eigenvalues, eigenvectors = np.linalg.eigh(moments.covariance)
    smaller = eigenvectors[:, 0]
    facets = facets.assign(
        count=("slope", binned.at_nodes(density.slope.size)),
        D_u=("alpha", facets["D"].values * relative_u),
        slope_density_quality=("slope", quality),
        anisotropy=np.sqrt(eigenvalues[1] / eigenvalues[0]) if eigenvalues[0] > 0 else np.nan,
        # An axis, not a direction: reported in [-90, 90).
        lay=(np.degrees(np.arctan2(smaller[1], smaller[0])) + 90) % 180 - 90,
        facet_count=float(moments.facets),
        effective_count=moments.facets / redundancy,
        correlation_length=_correlation_length(height, pitch),
        slope_rms_scale=("scale", slopes_by_scale),
        noise_ratio=slopes_by_scale[0] / slopes_by_scale[1],
    ).assign_coords(scale=_SCALES)
    facets.attrs |= {"method": "four triangles a quad", "band": surface.attrs["band"]}
    facets = _with_warnings(facets, moments, isotropic)
    return vocabulary.label(facets, "facets")


def _triangle_slopes(height: Array, pitch: tuple[float, float]) -> Iterator[tuple[int, Array, Array]]:
    """Slopes (p, q) of the four triangles of every quad, block of the map by block; a triangle that touches a missing height
    is left out."""
    rows = np.linspace(0, height.shape[0] - 1, _BLOCKS + 1).astype(int)
    columns = np.linspace(0, height.shape[1] - 1, _BLOCKS + 1).astype(int)
    for block in range(_BLOCKS**2):
        row, column = divmod(block, _BLOCKS)
        part = height[rows[row] : rows[row + 1] + 1, columns[column] : columns[column + 1] + 1].astype(float)
        along_x = np.diff(part, axis=1) / pitch[0]
        along_y = np.diff(part, axis=0) / pitch[1]
        for p in (along_x[:-1], along_x[1:]):
            for q in (along_y[:, :-1], along_y[:, 1:]):
                complete = np.isfinite(p) & np.isfinite(q)
                yield block, p[complete], q[complete]


def _moments(height: Array, pitch: tuple[float, float]) -> _Moments:
    count, total, products, steepest = 0, np.zeros(2), np.zeros((2, 2)), 0.0
    for _, p, q in _triangle_slopes(height, pitch):
        if p.size == 0:
            continue
        slopes = np.stack([p, q])
        count += p.size
        total += slopes.sum(axis=1)
        products += slopes @ slopes.T
        steepest = max(steepest, float(np.sqrt(np.max(p * p + q * q))))
    if count == 0:
        return _Moments(0, np.zeros(2), np.zeros((2, 2)), 0.0)
    mean = total / count
    return _Moments(count, mean, products / count - np.outer(mean, mean), steepest)


_SCALES = np.array([1.0, 2.0, 4.0, 8.0])


def _slope_rms_by_scale(height: Array, pitch: tuple[float, float]) -> Array:
    """Root mean square slope taken over 1, 2, 4 and 8 pixels; NaN where the map is too small."""
    values = []
    for step in _SCALES.astype(int):
        if min(height.shape) <= step:
            values.append(np.nan)
            continue
        p = (height[:, step:] - height[:, :-step]) / (step * pitch[0])
        q = (height[step:] - height[:-step]) / (step * pitch[1])
        values.append(np.sqrt(_mean_square(p) + _mean_square(q)))
    return np.asarray(values)


def _mean_square(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.mean(finite.astype(float) ** 2)) if finite.size else np.nan


def _correlation_length(height: Array, pitch: tuple[float, ...]) -> float:
    """Distance at which the height correlation falls to 1/e, the geometric mean over the axes; NaN where it never does."""
    lengths = [
        _axis_correlation_length(np.moveaxis(height, axis, -1).reshape(-1, height.shape[axis]), step)
        for axis, step in zip(range(height.ndim)[::-1], pitch, strict=True)
    ]
    return float(np.exp(np.mean(np.log(lengths)))) if np.isfinite(lengths).all() else np.nan


def _axis_correlation_length(lines: Array, pitch: float) -> float:
    from scipy.fft import irfft, next_fast_len, rfft

    present = np.isfinite(lines)
    centred = np.where(present, lines - np.nanmean(lines), 0.0).astype(np.float64)
    length = next_fast_len(2 * lines.shape[1], real=True)

    def power(values: Array) -> Array:
        spectrum = rfft(values, length, axis=1)
        return irfft((spectrum.real**2 + spectrum.imag**2).sum(axis=0), length)[: lines.shape[1] // 2]

    if present.all():
        pairs = lines.shape[0] * (lines.shape[1] - np.arange(lines.shape[1] // 2, dtype=float))
    else:
        pairs = power(present.astype(np.float64))
    correlation = power(centred) / np.maximum(pairs, 1.0)
    below = np.flatnonzero(correlation < correlation[0] / np.e)
    if correlation[0] <= 0 or below.size == 0:
        return np.nan
    k = below[0]
    step = (correlation[k - 1] - correlation[0] / np.e) / (correlation[k - 1] - correlation[k])
    return float((k - 1 + step) * pitch)


# --- from counts to a density


class _Histogram(NamedTuple):
    edges: Array
    """(bins + 1,) slopes, from 0 to the steepest."""
    counts: Array
    """(blocks, bins) facets of each block of the map."""
    sums: Array
    """(bins,) sum of the slopes in each bin."""


class _Binned(NamedTuple):
    edges: Array
    """(bins + 1,) slopes, from 0."""
    counts: Array
    """(bins,) facets in each bin."""
    tail: int
    """Facets steeper than the last edge."""
    tail_excess: float
    """Mean slope of those facets above the last edge."""

    @property
    def total(self) -> int:
        return int(self.counts.sum()) + self.tail

    def at_nodes(self, nodes: int) -> Array:
        """Counts on the density's nodes: bins at theirs, the tail at its first, none at the auxiliary nodes."""
        counts = np.zeros(nodes)
        counts[1 : 1 + self.counts.size] = self.counts
        if self.tail:
            counts[1 + self.counts.size] = self.tail
        return counts


def _histogram(height: Array, pitch: tuple[float, float], moments: _Moments) -> _Histogram:
    """Counts in bins that widen towards steep slopes."""
    steepest, scale = moments.steepest * (1 + 1e-12), 2 * moments.slope_rms
    edges = scale * np.sinh(np.linspace(0, np.arcsinh(steepest / scale), _COARSE_BINS + 1))
    # Binning through a fine uniform grid avoids a search per facet; edges move to the nearest fine one.
    cuts = np.unique(np.round(edges / steepest * _FINE_BINS).astype(int))
    coarse = np.repeat(np.arange(cuts.size - 1), np.diff(cuts))
    counts = np.zeros((_BLOCKS**2, cuts.size - 1))
    sums = np.zeros(cuts.size - 1)
    for block, p, q in _triangle_slopes(height, pitch):
        magnitude = np.sqrt(p * p + q * q)
        index = coarse[(magnitude * (_FINE_BINS / steepest)).astype(np.int64)]
        counts[block] += np.bincount(index, minlength=sums.size)
        sums += np.bincount(index, magnitude, minlength=sums.size)
    return _Histogram(cuts * (steepest / _FINE_BINS), counts, sums)


def _redundancy(counts: Array) -> float:
    """How many facets count as one independent facet: the variance of the counts between blocks over their mean.

    Neighbouring facets share heights and belong to the same grain, so n facets scatter like n / redundancy. The blocks also
    see what a correlation length does not: a map that is not the same everywhere.
    """
    share = counts.sum(axis=1, keepdims=True) / max(counts.sum(), 1.0)
    used = share[:, 0] > 0
    expected = share[used] * counts.sum(axis=0)
    freedom = max(1, np.count_nonzero(used) - 1)
    return max(1.0, float(np.sum((counts[used] - expected) ** 2) / freedom / (expected.sum() / np.count_nonzero(used))))


def _binned(histogram: _Histogram) -> tuple[_Binned, float]:
    """Bins of at least a hundred independent facets each, and how many facets count as one in them.

    Neighbouring facets share a wide bin more often than a narrow one, so merging bins raises the redundancy that decides how
    far to merge; two or three rounds settle it.
    """
    counts, redundancy = histogram.counts, 1.0
    for _ in range(6):
        found = max(redundancy, _redundancy(counts))
        binned = _merge_bins(histogram, 100 * found)
        if found < 1.05 * redundancy:
            break
        redundancy = found
        starts = np.searchsorted(histogram.edges, binned.edges[:-1])
        counts = np.add.reduceat(histogram.counts, starts, axis=1)
    return binned, redundancy


def _merge_bins(histogram: _Histogram, least: float) -> _Binned:
    """Merge bins until each holds at least ``least`` facets; what is left beyond the last is the tail."""
    counts = histogram.counts.sum(axis=0)
    cumulative = np.concatenate([[0.0], np.cumsum(counts)])
    kept = [0]
    for cut in range(1, cumulative.size):
        # Four times as many where there are plenty halve the noise; only the last bins make do with the least.
        plenty = cumulative[-1] - cumulative[kept[-1]] >= 8 * least
        if cumulative[cut] - cumulative[kept[-1]] >= (4 * least if plenty else least):
            kept.append(cut)
    if len(kept) - 1 < _LEAST_BINS:
        raise FacetError(
            f"too few independent facets: {cumulative[-1]:.0f} facets fill {len(kept) - 1} bins of at least {least:.0f}, "
            f"{_LEAST_BINS} are needed; measure a larger area, or at a finer pitch"
        )
    last = kept[-1]
    tail = int(cumulative[-1] - cumulative[last])
    excess = float(histogram.sums[last:].sum() / tail - histogram.edges[last]) if tail else 0.0
    return _Binned(histogram.edges[kept], np.diff(cumulative[kept]), tail, excess)


def _counted_density(binned: _Binned, redundancy: float) -> tuple[RadialDensity, NDArray[np.int8], Array]:
    """Density whose integral over every bin is that bin's share, with a log-linear tail that carries the tail's share.

    Returns the density, and on its nodes the quality flag and the relative standard uncertainty.
    """
    edges, share = binned.edges, binned.counts / binned.total
    tail_slope, tail_density = _tail(edges[-1], binned.tail / binned.total, binned.tail_excess)
    middle = np.sqrt((edges[1:] ** 2 + edges[:-1] ** 2) / 2)
    log_density = np.log(share / (np.pi * np.diff(edges**2)))
    slope = np.concatenate([[0.0], middle, tail_slope])
    split = np.sort(np.concatenate([edges, middle]))
    s, ds = panel_rule(split, 4)
    owner = np.minimum(np.searchsorted(edges, s, side="right") - 1, share.size - 1)

    def density_with(log_density: Array) -> RadialDensity:
        body = _with_ends(slope[: share.size + 2] ** 2, log_density, tail_density)
        return RadialDensity(slope, np.concatenate([np.exp(body), tail_density[1:]]))

    # A bin's mean is not the density at its middle: move each node until the interpolant holds the bin's share.
    for _ in range(12):
        mass = np.bincount(owner, 2 * np.pi * s * density_with(log_density)(s**2) * ds, minlength=share.size)
        log_density = log_density + np.log(share / mass)
    density = density_with(log_density)
    relative_u = np.sqrt(redundancy / binned.counts)
    tail_u = max(relative_u[-1], np.sqrt(redundancy / max(binned.tail, 1)))
    relative_u = np.concatenate([relative_u[:1], relative_u, np.full(tail_slope.size, min(tail_u, 1.0))])
    quality = np.full(slope.size, vocabulary.quality("measured"))
    quality[share.size + 1 :] = vocabulary.quality("extrapolated")
    return RadialDensity(slope, density.density / density.mass), quality, relative_u


def _with_ends(u: Array, log_density: Array, tail_density: Array) -> Array:
    """Extend bin values to zero slope, along the neighbouring secant but never downwards, and to where the tail begins."""
    first = log_density[0] + max((log_density[0] - log_density[1]) / (u[2] - u[1]), 0.0) * (u[1] - u[0])
    if tail_density.size > 1:
        last = np.log(tail_density[0])
    else:
        last = log_density[-1] + min((log_density[-1] - log_density[-2]) / (u[-2] - u[-3]), 0.0) * (u[-1] - u[-2])
    return np.concatenate([[first], log_density, [last]])


def _tail(start: float, share: float, excess: float) -> tuple[Array, Array]:
    """Log-linear tail P exp(−(s − start)/L) that holds the share of the facets beyond ``start`` and their mean slope.

    2π ∫ P s ds = 2πP (start·L + L²) and E[s − start] = L (start + 2L) / (start + L). Both decide the masking at grazing.
    Without facets beyond ``start`` the density ends there.
    """
    if share == 0:
        return np.array([start]), np.zeros(1)
    length = (excess - start + np.sqrt((start - excess) ** 2 + 8 * start * excess)) / 4
    step = np.concatenate([[0.0], np.geomspace(0.05, 40, _TAIL_NODES)])
    return start + length * step, share / (2 * np.pi * length * (start + length)) * np.exp(-step)


# --- line profiles


def _of_line(surface: xr.Dataset, method: str, isotropic: bool | None) -> xr.Dataset:
    if isotropic is not True:
        raise FacetError(
            "a single line profile gives the slopes along the line alone; "
            "set `surface.isotropic: true` in material.yaml if the surface scatters alike in every azimuth"
        )
    if method != "mixture":
        raise FacetError(f"unknown method {method!r} for a line profile; accepted: mixture")
    height, pitch = surface["height"].values.astype(float), float(surface.attrs["pitch_x"])
    along = np.diff(height) / pitch
    along = along[np.isfinite(along)]
    if along.size < _LEAST_LINE or not np.any(along):
        raise FacetError(f"the line profile has {along.size} slopes, at least {_LEAST_LINE} are needed")
    along = along - along.mean()
    fit = _fit_mixture(np.abs(along))
    redundancy = fit.redundancy
    # An isotropic surface has twice the mean square slope of any line on it.
    slope_rms = float(np.sqrt(2 * fit.weight @ fit.sigma**2))
    widest = fit.sigma[fit.weight > 1e-9].max()
    slope = slope_rms * np.sinh(np.linspace(0, np.arcsinh(8.3 * widest / slope_rms), 384))
    variance = fit.sigma**2
    density = (np.exp(-(slope[:, None] ** 2) / (2 * variance)) / (2 * np.pi * variance)) @ fit.weight
    measured_to = np.sort(np.abs(along))[-min(along.size, max(1, round(100 * redundancy)))]
    quality = np.where(slope <= measured_to, vocabulary.quality("measured"), vocabulary.quality("extrapolated"))
    facets = _dataset(RadialDensity(slope, density), slope_rms)
    steps = _SCALES.astype(int)
    by_scale = np.array([np.sqrt(2 * _mean_square((height[n:] - height[:-n]) / (n * pitch))) for n in steps])
    facets = facets.assign(
        slope_density_quality=("slope", quality.astype(np.int8)),
        D_u=("alpha", facets["D"].values * _line_uncertainty(slope, density, along.size / redundancy)),
        facet_count=float(along.size),
        effective_count=along.size / redundancy,
        correlation_length=_correlation_length(height, (pitch,)),
        slope_rms_scale=("scale", by_scale),
        noise_ratio=by_scale[0] / by_scale[1],
    ).assign_coords(scale=_SCALES)
    facets.attrs |= {"method": "line profile, Gaussian scale mixture", "band": surface.attrs["band"]}
    facets = vocabulary.add_history(
        facets,
        f"declared isotropic; {int(np.count_nonzero(fit.weight > 1e-6))} Gaussian components fitted to the slopes along the line, "
        f"reduced χ² {fit.reduced_chi_squared:.2f}",
    )
    if fit.reduced_chi_squared > 3:
        facets = vocabulary.add_warning(
            facets,
            f"the slopes along the line are no mixture of Gaussians (reduced χ² {fit.reduced_chi_squared:.1f}): "
            "the surface may be grooved or not isotropic; measure an areal map",
        )
    return vocabulary.label(_with_noise_warning(facets), "facets")


class _Mixture(NamedTuple):
    weight: Array
    sigma: Array
    redundancy: float
    reduced_chi_squared: float


def _fit_mixture(magnitude: Array) -> _Mixture:
    """Fit P1(p) = Σ w_k N(0, σ_k²), w >= 0, to slopes along a line, by expectation maximisation on binned |p|.

    The inversion to two dimensions divides each weight by σ_k²: a sliver of narrow components would ruin the peak. So the
    components begin at half the median slope, and the iteration stops when twenty more rounds no longer gain likelihood that
    the counts could tell from noise.
    """
    from scipy.special import erf

    rms = float(np.sqrt(np.mean(magnitude**2)))
    low = max(np.median(magnitude) / 2, rms / 50)
    sigma = np.geomspace(low, max(magnitude.max() / 2, 2 * rms), _MIXTURE_COMPONENTS)
    edges = rms * np.sinh(np.linspace(0, np.arcsinh(magnitude.max() / rms), 257))
    edges[-1] *= 1 + 1e-12
    counts, redundancy = _line_histogram(magnitude, edges)
    probability = np.diff(erf(edges[:, None] / (np.sqrt(2) * sigma)), axis=0)
    weight = np.exp(-0.5 * np.log(sigma / rms) ** 2)
    weight /= weight.sum()
    likelihood = -np.inf
    for _ in range(100):
        for _ in range(20):
            weight = weight * (probability.T @ (counts / np.maximum(probability @ weight, 1e-300))) / counts.sum()
        former, likelihood = likelihood, float(counts @ np.log(np.maximum(probability @ weight, 1e-300)))
        if likelihood - former < 0.03 * redundancy:
            break
    weight = weight / weight.sum()
    return _Mixture(weight, sigma, redundancy, _chi_squared(counts, counts.sum() * (probability @ weight), redundancy))


def _line_histogram(magnitude: Array, edges: Array) -> tuple[Array, float]:
    """Counts of the slopes along a line, and how many of them count as one (see :func:`_redundancy`)."""
    bins = edges.size - 1
    index = np.minimum(np.searchsorted(edges, magnitude, side="right") - 1, bins - 1)
    block = np.arange(magnitude.size) * _BLOCKS**2 // magnitude.size
    by_block = np.bincount(block * bins + index, minlength=_BLOCKS**2 * bins).reshape(-1, bins)
    return by_block.sum(axis=0).astype(float), _redundancy(by_block.astype(float))


def _chi_squared(counts: Array, expected: Array, redundancy: float) -> float:
    """Reduced χ² over bins merged to 25 independent slopes each."""
    merged_counts, merged_expected = _merge_for_chi_squared(counts, expected, 25 * redundancy)
    deviation = (merged_counts - merged_expected) ** 2 / np.maximum(merged_expected, 1e-300)
    return float(deviation.sum()) / redundancy / max(1, merged_counts.size - 1)


def _merge_for_chi_squared(counts: Array, expected: Array, least: float) -> tuple[Array, Array]:
    group = np.floor(np.cumsum(expected) / least)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    return np.add.reduceat(counts, starts).astype(float), np.add.reduceat(expected, starts)


def _line_uncertainty(slope: Array, density: Array, effective: float) -> Array:
    """Relative uncertainty of the density, taken from counting the slopes within a tenth of a decade of each node."""
    weight = 2 * np.pi * slope**2 * density * 0.23
    return np.minimum(1.0, 1 / np.sqrt(np.maximum(effective * weight, 1.0)))


# --- shared


def _dataset(density: RadialDensity, slope_rms: float) -> xr.Dataset:
    alpha = np.degrees(np.arctan(density.slope))
    lambda_smith = masking.smith_lambda(density)
    return xr.Dataset(
        {
            "slope_density": ("slope", density.density),
            "D": ("alpha", density.density * (1 + density.slope**2) ** 2),
            "lambda_smith": lambda_smith,
            "slope_rms": slope_rms,
        },
        coords={"slope": density.slope, "alpha": alpha},
    )


def _with_warnings(facets: xr.Dataset, moments: _Moments, isotropic: bool | None) -> xr.Dataset:
    anisotropy = float(facets["anisotropy"])
    if isotropic is not True and anisotropy > 1.2:
        facets = vocabulary.add_warning(
            facets,
            f"the surface has a lay (anisotropy {anisotropy:.2f}) and is treated as isotropic: its density is an average over "
            "azimuth; set `surface.isotropic: true` if that is wanted",
        )
    tilt = float(np.hypot(*moments.mean))
    if tilt > 0.1 * moments.slope_rms:
        facets = vocabulary.add_warning(
            facets,
            f"the mean slope {tilt:.2g} is {tilt / moments.slope_rms:.0%} of the slope rms: level the surface (`surface.form: plane`)",
        )
    return _with_noise_warning(facets)


def _with_noise_warning(facets: xr.Dataset) -> xr.Dataset:
    ratio = float(facets["noise_ratio"])
    if ratio > 1.2:
        facets = vocabulary.add_warning(
            facets,
            f"the slope rms over one pixel is {ratio:.2f} times that over two: the scan is limited by noise or by its pitch; "
            "measure with more averaging, or at a finer pitch",
        )
    return facets

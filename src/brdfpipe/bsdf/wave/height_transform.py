"""Transform of the phases that the heights of a surface give to reflected light, as a table.

For heights with a Gaussian distribution and the autocovariance σ²ρ(r), light that is reflected with the phase variance
g = [2πσ(cos θ_i + cos θ_o)/λ]² has the coherent share e^(−g), and the halo

    K(g, f) = 2π ∫ e^(−g) (e^(gρ(r)) − 1) J0(2πfr) r dr   [µm²]

at the spatial frequency f. K depends on the wavelength and on the directions through g and f alone, so that one table serves all of
them. The table holds ln(K/g), which tends to ln(S/σ²) as g → 0, S the roughness spectrum.

References
----------
Krywonos, Harvey & Choi 2011, J. Opt. Soc. Am. A 28, 1121 (surface transfer function, and its series for a Gaussian autocovariance);
Beckmann & Spizzichino 1963, §5.3; Hamilton 2000, Mon. Not. R. Astron. Soc. 312, 257, appendix B (logarithmic Hankel transform).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.fft import fhtoffset, irfft, rfft
from scipy.ndimage import spline_filter1d
from scipy.optimize import brentq
from scipy.special import expit, gammaln, kv, loggamma

from brdfpipe.geometry import Array

FREQUENCY_STEP, PHASE_STEP = 0.03, 0.06
"""Steps of the table in asinh(f/f0) and in ln g. A cubic spline between its nodes is accurate to 1e-6 of the largest K where the spectrum is a form, and to
1e-4 of it where it is measured: there its logarithm has corners, and where long waves meet the band it falls steeply."""

_MARGIN = 12
"""Nodes beyond the largest f and g, so that the ends of the spline do not matter."""
_LEAST_PHASE = 1e-6
"""Phase variance below which K is proportional to g."""
_DENSE_TERMS = 400.0
"""Phase variance above which not every term of a series is summed: its terms vary slowly, and a coarser sum is exact."""
_MOST_TERMS = 3000
_NOISE = 1e-13
"""Share of the largest K that a discrete transform cannot tell from 0."""
_CROSSOVER = 24
"""Order of the crossover at which long waves end, and power of f with which a measured spectrum falls below its band. A spectrum that
jumped would give a BRDF with a jump, for which no table and no quadrature converges; this one is as sharp as the steps of the table resolve."""
_SPREAD_NOISE = 1e-9
"""The same upon a coarser relief, where no order is known without a transform."""
_SERIES_PHASE, _SERIES_ORDERS = 0.3, np.arange(2, 18)
"""Phase variance up to which the orders of scattering are a short series: what follows them is 1e-23 of the largest K, far below its noise."""
_PHASES_AT_ONCE = 32
"""Phase variances that are transformed together, in about 20 MB."""
_NEAR = 40
"""Nodes of a cubic spline beyond which others do not matter: their part falls by a factor of 3.7 with each."""
_SMALL = 1e-3
"""Exponent gρ below which the exponential is a series."""
_RADII, _DECADES = 8192, 20
"""Nodes of the logarithmic Hankel transform, and its decades about the correlation length."""


class Autocorrelation(NamedTuple):
    """Isotropic roughness: its spectrum over its variance, and its correlation length."""

    spectrum: Callable[[Array], Array]
    """S/σ² [um2] at frequencies [um-1]; its integral over the plane is 1"""
    length: float
    """Distance at which ρ falls to about 1/e [um]"""
    form: str
    """``gaussian`` and ``exponential`` have series; ``any`` has none"""
    of_distance: Callable[[Array], Array] | None = None
    """ρ at distances [um]; None if it is found from the spectrum"""
    lowest: float = np.inf
    """Frequency at which the spectrum begins to vary, if not at 1/(2π · ``length``) [um-1]"""


def gaussian(length: float) -> Autocorrelation:
    """ρ = exp(−r²/ℓ²)."""
    peak = np.pi * length**2
    return Autocorrelation(lambda f: peak * np.exp(-((np.pi * length * f) ** 2)), length, "gaussian")


def k_correlation(length: float, slope: float) -> Autocorrelation:
    """ρ of the spectrum A′/(1 + (2πℓf)²)^(slope/2): exp(−r/ℓ) for the slope 3, else (x^ν K_ν(x))/(2^(ν−1) Γ(ν)), x = r/ℓ, ν = slope/2 − 1."""
    peak, order = 2 * np.pi * length**2 * (slope - 2), slope / 2 - 1

    def spectrum(f: Array) -> Array:
        return np.asarray(peak * (1 + (2 * np.pi * length * f) ** 2) ** (-slope / 2))

    def of_distance(r: Array) -> Array:
        x = np.clip(r / length, 1e-300, 700.0)
        with np.errstate(over="ignore", invalid="ignore"):
            rho = np.exp((1 - order) * np.log(2) - gammaln(order) + order * np.log(x)) * kv(order, x)
        return np.clip(np.nan_to_num(rho, nan=1.0, posinf=1.0), 0.0, 1.0)

    return Autocorrelation(spectrum, length, "exponential" if slope == 3 else "any", of_distance)


class LongWaves(NamedTuple):
    """Waves below the band of a measured spectrum."""

    sigma: float
    """Rms height [um]"""
    slope: float
    """Rms slope √⟨p² + q²⟩ [1]"""
    highest: float
    """Frequency at which the band begins [um-1]"""

    def spectrum(self) -> Callable[[Array], Array]:
        """S [um4] of a Gaussian form that ends where the band begins, with the rms height and slope; it is flat for larger slopes."""
        if not self.sigma > 0:
            return np.zeros_like
        # In units of the highest frequency.
        x = np.geomspace(1e-6, 4.0, 4001)
        weight = np.gradient(np.log(x)) * x**2 * _share_below(x)

        def moments(log_decay: float) -> tuple[float, float]:
            values = weight * np.exp(-np.exp(log_decay) * x**2)
            return float(values.sum()), float(values @ x**2)

        def excess(log_decay: float) -> float:
            variance, square = moments(log_decay)
            return float(np.log(square / variance)) - 2 * np.log(max(self.relative_frequency, 1e-5))

        flattest, narrowest = np.log(1e-4), np.log(1e10)
        # ⟨f²⟩ falls with the decay.
        found = float(brentq(excess, flattest, narrowest)) if excess(flattest) > 0 else flattest
        peak = self.sigma**2 / (2 * np.pi * self.highest**2 * moments(found)[0])
        decay = np.exp(found) / self.highest**2
        return lambda f: peak * np.exp(-decay * f**2) * _share_below(f / self.highest)

    @property
    def relative_frequency(self) -> float:
        """√⟨f²⟩ over the highest frequency [1]."""
        return self.slope / (2 * np.pi * self.sigma * self.highest) if self.sigma > 0 else 1.0


def _share_below(relative_frequency: Array) -> Array:
    """Share [1] of the long waves that is left at a frequency over the first of the band."""
    return np.asarray(expit(-_CROSSOVER * np.log(np.maximum(relative_frequency, 1e-300))))


def measured(
    frequency: Array, psd: Array, tail: Autocorrelation | None, long_waves: LongWaves | None = None
) -> tuple[Autocorrelation, float]:
    """Roughness of a measured spectrum, and its rms height [um].

    Parameters
    ----------
    frequency, psd : increasing [um-1], and S [um4]; logarithms are interpolated linearly
    tail : form that continues the spectrum above its last frequency, scaled to meet it; f⁻³ without one
    long_waves : what the heights have below the band. Without them the spectrum falls to 0 below its first frequency
    """
    log_f, log_s = np.log(frequency), np.log(np.maximum(psd, psd.max() * 1e-30))
    waves = LongWaves(0.0, 0.0, float(frequency[0])) if long_waves is None else long_waves
    below = waves.spectrum()
    end = float(tail.spectrum(frequency[-1:])[0]) if tail is not None else 1.0

    def continuation(high: Array) -> Array:
        """Spectrum beyond its last frequency over that at it, by the frequency over the last."""
        if tail is None:
            return np.asarray(high**-3)
        # A Gaussian form that has fallen below all numbers continues with nothing.
        return tail.spectrum(high * frequency[-1]) / end if end > 0 else np.where(high > 1, 0.0, 1.0)

    def spectrum(f: Array) -> Array:
        inside = np.exp(np.interp(np.log(f), log_f, log_s))
        # The band keeps all its light, and its fall below is no jump.
        low = np.minimum(f / waves.highest, 1.0)
        return np.asarray(inside * low**_CROSSOVER * continuation(np.maximum(f / frequency[-1], 1.0)) + below(f))

    lowest = 1e-5 * waves.highest * min(waves.relative_frequency, 1.0)
    grid = np.geomspace(lowest, 1e6 * frequency[-1], 20001)
    values = spectrum(grid)
    variance = 2 * np.pi * float(np.trapezoid(values * grid**2, np.log(grid)))
    # ρ falls to 1/e at about the distance where a Gaussian of the same peak and variance does.
    length = float(np.sqrt(values.max() / (np.pi * variance)))
    found = Autocorrelation(lambda f: spectrum(f) / variance, length, "any", lowest=waves.highest)
    return found, float(np.sqrt(variance))


def slope_variance(correlation: Autocorrelation, sigma: float, highest: float) -> float:
    """⟨p² + q²⟩ of the heights up to a frequency [um-1]."""
    grid = np.geomspace(min(1e-6 / correlation.length, 1e-3 * highest), highest, 4001)
    return float(sigma**2 * 8 * np.pi**3 * np.trapezoid(correlation.spectrum(grid) * grid**4, np.log(grid)))


def split(correlation: Autocorrelation, sigma: float, cut: float) -> tuple[Autocorrelation, float, float]:
    """The part of a roughness at frequencies above a cut [um-1], its rms height, and that of the other part [um].

    The spectrum is parted by exp(−(f/cut)⁴), sharp enough that long waves carry no height into the finer part, smooth enough that its
    autocorrelation hardly rings.
    """
    grid = np.geomspace(1e-6 * min(cut, 1 / correlation.length), 1e5 * max(cut, 1 / correlation.length), 20001)
    share = (
        2
        * np.pi
        * float(np.trapezoid(correlation.spectrum(grid) * -np.expm1(-((grid / cut) ** 4)) * grid**2, np.log(grid)))
    )
    share = min(max(share, 1e-15), 1.0)
    fine = Autocorrelation(
        lambda f: correlation.spectrum(f) * -np.expm1(-((f / cut) ** 4)) / share, 1 / (2 * np.pi * cut), "any"
    )
    return fine, float(sigma * np.sqrt(share)), float(sigma * np.sqrt(1 - share))


def tabulated(
    correlation: Autocorrelation,
    largest_phase: float,
    largest_frequency: float,
    coarse: Callable[[Array, float], Array] | None = None,
    phase_step: float = PHASE_STEP,
) -> xr.Dataset:
    """Table of ln(K/g) up to a phase variance and a frequency [um-1].

    ``coarse`` is a characteristic function by which the integrand is multiplied: of (distance [um], √g), for roughness upon a coarser
    relief, whose slopes spread the halo. ``phase_step`` is the step of ln g.

    Returns
    -------
    ``log_halo(phase_variance, halo_frequency)``, with nodes evenly spaced in ln g and in asinh(f/f0); f0 is ``frequency_scale``. The
    nodes go beyond the given ends
    """
    scale = min(1 / (2 * np.pi * correlation.length), correlation.lowest / 2)
    nodes = int(np.ceil(np.arcsinh(largest_frequency / scale) / FREQUENCY_STEP)) + _MARGIN
    frequency = scale * np.sinh(FREQUENCY_STEP * np.arange(nodes + 1))
    span = np.log(max(largest_phase, 2 * _LEAST_PHASE) / _LEAST_PHASE)
    phase = _LEAST_PHASE * np.exp(phase_step * np.arange(int(np.ceil(span / phase_step)) + _MARGIN + 1))
    if correlation.form == "any":
        values = _by_hankel_transform(correlation, phase, frequency, coarse)
    else:
        values = np.array([_by_series(correlation, g, frequency) for g in phase])
    return xr.Dataset(
        {"log_halo": (("phase_variance", "halo_frequency"), values), "frequency_scale": scale},
        coords={"phase_variance": phase, "halo_frequency": frequency},
    )


def log_transform(correlation: Autocorrelation, phase: Array, frequency: Array) -> Array:
    """ln(K/g) (phases, frequencies) at nodes of a table, as of :func:`tabulated`, by the transform for any spectrum."""
    return _by_hankel_transform(correlation, phase, frequency)


# --- series over the orders of scattering


def _by_series(correlation: Autocorrelation, g: float, frequency: Array) -> Array:
    """ln(K/g) at one g: Σ_m e^(−g) g^(m−1)/m! times the transform of ρ^m, which is known in closed form."""
    order, weight = _orders(correlation, g, float(frequency[-1]))
    x = (2 * np.pi * correlation.length * frequency[:, None]) ** 2
    terms = (order - 1) * np.log(g) - g - gammaln(order + 1) + np.log(weight)
    if correlation.form == "gaussian":
        terms = terms + np.log(np.pi * correlation.length**2 / order) - x / (4 * order)
    else:
        terms = terms + np.log(2 * np.pi * (correlation.length / order) ** 2) - 1.5 * np.log1p(x / order**2)
    largest = terms.max(axis=1)
    return np.asarray(largest + np.log(np.exp(terms - largest[:, None]).sum(axis=1)))


def _orders(correlation: Autocorrelation, g: float, largest_frequency: float) -> tuple[Array, Array]:
    """Orders m that contribute, and how many orders each stands for."""
    last = g + 12 * np.sqrt(g) + 20
    if correlation.form == "gaussian":
        # Far from the mirror direction high orders prevail.
        order = np.geomspace(1, 1e7, 500)
        exponent = (
            order * np.log(g) - gammaln(order + 1) - (np.pi * correlation.length * largest_frequency) ** 2 / order
        )
        prevailing = order[exponent.argmax()]
        last = max(last, prevailing + 12 * np.sqrt(prevailing) + 20)
    first = max(1.0, np.floor(g - 12 * np.sqrt(g))) if g > _DENSE_TERMS else 1.0
    step = max(1.0, np.floor(np.sqrt(g) / 3)) if g > _DENSE_TERMS else 1.0
    step = max(step, np.ceil((last - first) / _MOST_TERMS))
    order = np.arange(first, last + step, step)
    return order, np.full(order.size, step)


# --- Hankel transform


def _by_hankel_transform(
    correlation: Autocorrelation,
    phase: Array,
    frequency: Array,
    coarse: Callable[[Array, float], Array] | None = None,
) -> Array:
    """ln(K/g), (phases, frequencies), by one logarithmic Hankel transform for each g, or for each order of scattering where g is small.

    The first order, g e^(−g) S/σ², is known. The rest, e^(−g)(e^(gρ) − 1 − gρ), decays faster with distance, so that a discrete
    transform of it is accurate. It is >= 0, because every power of ρ is an autocorrelation.
    """
    step = _DECADES * np.log(10) / _RADII
    offset = fhtoffset(step, mu=0.0, bias=0.0)
    index = np.arange(_RADII) - (_RADII - 1) / 2
    distance, wave_number = (
        correlation.length * np.exp(index * step),
        np.exp(index * step + offset) / correlation.length,
    )
    grid = wave_number / (2 * np.pi)
    rho = _autocorrelation(correlation, distance)
    # Between the ends, where the periodic repetition of the transform does not reach.
    inside = slice(
        int(np.searchsorted(grid, 1e-3 * frequency[1], side="right")), int(np.searchsorted(grid, 10 * frequency[-1]))
    )
    first_order = correlation.spectrum(grid[inside])
    asked = np.log(np.maximum(frequency, 2e-3 * frequency[1]))
    values = np.empty((phase.size, frequency.size))

    def transformed(function: Array) -> Array:
        return 2 * np.pi * hankel_transform(function, step, offset)[:, inside] / wave_number[inside]

    in_series = int((phase <= _SERIES_PHASE).sum()) if coarse is None else 0
    if in_series <= _SERIES_ORDERS.size:
        in_series = 0
    of_orders = transformed(rho ** _SERIES_ORDERS[:, None] * distance) if in_series else np.empty(0)
    ends = [*range(0, in_series, _PHASES_AT_ONCE), *range(in_series, phase.size, _PHASES_AT_ONCE), phase.size]
    for start, end in pairwise(ends):
        rows = slice(start, end)
        g = phase[rows, None]
        if start < in_series:
            weight = np.exp((_SERIES_ORDERS - 1) * np.log(g) - g - gammaln(_SERIES_ORDERS + 1))
            total = weight @ of_orders
        else:
            if coarse is None:
                higher = _higher_orders(g, rho)
            else:
                slopes = np.stack([coarse(distance, float(np.sqrt(one))) for one in phase[rows]])
                higher = (_higher_orders(g, rho) + np.exp(-g) * (g * rho)) * slopes
            total = transformed(higher * distance) / g
        if coarse is None:
            total = np.exp(-g) * first_order + np.maximum(total, 0.0)
        floor = (_NOISE if coarse is None else _SPREAD_NOISE) * total.max(axis=1, keepdims=True)
        logs = np.log(np.maximum(total, floor))
        # The frequency that stands for 0 is decades below the others.
        for part in (slice(0, 1), slice(1, None)):
            values[rows, part] = _interpolated(np.log(grid[inside]), logs, asked[part])
    return values


def _interpolated(nodes: Array, values: Array, at: Array) -> Array:
    """Cubic splines through values (phases, nodes), at places, from the nodes about these: others change less than rounding does.

    The nodes are evenly spaced, so that the coefficients of all splines follow from one recursion. The places are :data:`_NEAR` nodes from
    the ends, or more.
    """
    place = (at - nodes[0]) * ((nodes.size - 1) / (nodes[-1] - nodes[0]))
    before = place.astype(int)
    first = max(int(before.min()) - _NEAR, 0)
    used = values[:, first : int(before.max()) + _NEAR]
    coefficients = spline_filter1d(used, order=3, axis=1, mode="mirror")
    x, y = place - before, 1 - place + before
    splines = y**3 / 6, 2 / 3 - x**2 * (1 - x / 2), 2 / 3 - y**2 * (1 - y / 2), x**3 / 6
    near = before - first - 1
    return np.asarray(sum(coefficients[:, near + number] * weight for number, weight in enumerate(splines)))


def _higher_orders(g: Array, rho: Array) -> Array:
    """e^(−g)(e^(gρ) − 1 − gρ), (phases, distances), of g (phases, 1) and ρ (distances,)."""
    few, many = np.flatnonzero(g.min() * rho < _SMALL), np.flatnonzero(g.max() * rho >= _SMALL)
    # Near distances, where gρ is small for no g, and far ones, where it is small for every g, are most of all.
    first = few[0] if few.size else rho.size
    last = many[-1] + 1 if many.size else 0
    first = min(first, last)
    result, exponent = np.empty((g.size, rho.size)), g * rho
    small, large = exponent[:, first:], exponent[:, :last]
    result[:, first:] = np.exp(-g) * small**2 * (0.5 + small / 6 + small**2 / 24)
    exact = np.exp(large - g) - np.exp(-g) * (1 + large)
    result[:, :first] = exact[:, :first]
    result[:, first:last] = np.where(large[:, first:] < _SMALL, result[:, first:last], exact[:, first:])
    return result


def _autocorrelation(correlation: Autocorrelation, distance: Array) -> Array:
    """ρ at distances evenly spaced in their logarithm."""
    if correlation.of_distance is not None:
        return correlation.of_distance(distance)
    step = float(np.log(distance[1] / distance[0]))
    offset = fhtoffset(step, mu=0.0, bias=0.0)
    frequency = np.exp(offset) / (2 * np.pi * distance[::-1])
    rho = hankel_transform(correlation.spectrum(frequency) * frequency, step, offset) / distance
    return np.clip(rho, -1.0, 1.0)


def hankel_transform(values: Array, step: float, offset: float) -> Array:
    """As :func:`scipy.fft.fht` of order 0, (…, nodes), whose coefficients take as long as many transforms."""
    coefficients = _hankel_coefficients(values.shape[-1], step, offset)
    return np.asarray(irfft(rfft(values) * coefficients, values.shape[-1])[..., ::-1])


@lru_cache(16)
def _hankel_coefficients(nodes: int, step: float, offset: float) -> NDArray[np.complex128]:
    """Of an even number of nodes: 2^(2iy) Γ(½ + iy)/Γ(½ − iy) at the wave numbers y of their transform (Hamilton 2000, eq. B18)."""
    y = np.linspace(0.0, np.pi * (nodes // 2) / (nodes * step), nodes // 2 + 1)
    coefficients: NDArray[np.complex128] = np.exp(2j * (loggamma(0.5 + 1j * y).imag + y * (np.log(2) - offset)))
    # The last one stands for both signs.
    coefficients[-1] = coefficients[-1].real
    return coefficients

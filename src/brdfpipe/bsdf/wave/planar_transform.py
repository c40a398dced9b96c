"""The transform of :mod:`brdfpipe.bsdf.wave.height_transform` for a surface with a lay, as a table over frequency and azimuth.

    K(g, f) = ∬ e^(−g) (e^(gρ(r)) − 1) e^(−2πi f·r) d²r   [µm²]

The plane of frequencies is stretched so that the spectrum is about as wide in all directions; the Fourier transform only takes the inverse
stretch. There ρ and K are sums of few harmonics of the azimuth φ, and the transform of a harmonic cos mφ is a Hankel transform of order m.

References
----------
Those of :mod:`brdfpipe.bsdf.wave.height_transform`; Baddour 2009, J. Opt. Soc. Am. A 26, 1767 (transform of harmonics, eq. 17 to 23).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from scipy.fft import fht
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import j0

from brdfpipe.bsdf.wave.halo import Stretch
from brdfpipe.bsdf.wave.height_transform import Autocorrelation
from brdfpipe.geometry import Array

Spectrum = Callable[[Array, Array], Array]
"""S/σ² [um2] at frequencies along x and y [um-1]"""

AZIMUTHS = 32
"""Nodes of azimuth over half a turn of the stretched plane: harmonics up to 32."""
FREQUENCY_STEP, PHASE_STEP = 0.06, 0.2
"""Steps of the table in asinh(f/f0) and in ln g."""
LARGEST_RATIO = 10.0
"""Limit of the stretch: widths of 1 to 100."""

_LEAST_PHASE = 1e-4
_MARGIN = 4
_RADII, _DECADES = 2048, 14
_PHASES_AT_ONCE = 8
_NEAR = 0.1  # of the correlation length, below which ρ is not from a discrete transform
_SMOOTHED_RADII, _SMOOTHED_AZIMUTHS = 0.15, 5.0  # widths of the smoothing: of ln f, and [degree]
_FLOOR = 1e-9  # of the largest K, below which a discrete transform is noise
_RING_NODES = 360
_LEAST_SHARE = 1e-5  # of the largest value in a ring, which a mean over modes cannot tell from 0
_INSIDE = 0.9  # of the band, beyond which a node of the planar spectrum lacks neighbours


def spectrum_with_lay(psd: xr.Dataset, mean: Autocorrelation) -> tuple[Spectrum, Stretch]:
    """The roughness spectrum of a ``psd`` dataset with ``psd_planar``, and the stretch that makes it nearly isotropic.

    Its mean over azimuth is that of ``mean`` at every frequency; its variation around a ring is that of ``psd_planar``, held beyond its band.
    """
    fy, fx, values = (psd[name].values for name in ("frequency_y", "frequency_x", "psd_planar"))
    high = _INSIDE * float(psd["band_high"])

    def planar(x: Array, y: Array) -> Array:
        inward = np.minimum(1.0, high / np.maximum(np.hypot(x, y), 1e-300))
        place = [_index(fy, y * inward), _index(fx, x * inward)]
        return np.asarray(map_coordinates(values, place, order=1, mode="nearest"))

    turn = np.radians(np.arange(_RING_NODES) * 180 / _RING_NODES)
    radius = np.geomspace(float(psd["band_low"]), high, 200)
    rings = planar(radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn))
    least = _LEAST_SHARE * rings.max(axis=1)
    level = np.maximum(rings, least[:, None]).mean(axis=1)

    def of_frequency(x: Array, y: Array) -> Array:
        f = np.maximum(np.hypot(x, y), 1e-300)
        around = np.maximum(planar(x, y), np.interp(f, radius, least)) / np.interp(f, radius, level)
        return np.asarray(mean.spectrum(f) * around)

    # Of the slopes: the direction in which the heights vary least, and how much less.
    weight = (
        mean.spectrum(radius)[:, None]
        * radius[:, None] ** 4
        * rings
        / level[:, None]
        * np.gradient(np.log(radius))[:, None]
    )
    xx, yy, xy = ((weight * part).sum() for part in (np.cos(turn) ** 2, np.sin(turn) ** 2, np.sin(turn) * np.cos(turn)))
    widths, axes = np.linalg.eigh([[xx, xy], [xy, yy]])
    lay = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])) % 180)
    return of_frequency, Stretch(lay, float(np.clip((widths[1] / max(widths[0], 1e-300)) ** 0.25, 1.0, LARGEST_RATIO)))


def _index(axis: Array, frequency: Array) -> Array:
    """Place of frequencies among the nodes of an axis of ``psd_planar``, which are low · sinh(step · k), k from below 0 to above."""
    middle = axis.size // 2
    one, two = axis[middle + 1 : middle + 3]
    step = np.arccosh(max(two / (2 * one), 1 + 1e-12))
    return np.asarray(middle + np.arcsinh(frequency * np.sinh(step) / one) / step)


def tabulated(
    spectrum: Spectrum, stretch: Stretch, length: float, largest_phase: float, largest_frequency: float
) -> xr.Dataset:
    """Table of ln(K/g) up to a phase variance and a frequency [um-1].

    Parameters
    ----------
    spectrum : with an integral of 1 over the plane
    stretch : of the frequencies
    length : distance at which ρ falls to about 1/e in the stretched plane [um]

    Returns
    -------
    ``log_halo(phase_variance, halo_frequency, halo_azimuth)`` over the stretched frequency and its azimuth from the lay, of half a turn;
    ``frequency_scale`` as of the table without a lay, ``halo_lay`` and ``halo_stretch``
    """
    scale = 1 / (2 * np.pi * length)
    nodes = int(np.ceil(np.arcsinh(largest_frequency * stretch.ratio / scale) / FREQUENCY_STEP)) + _MARGIN
    frequency = scale * np.sinh(FREQUENCY_STEP * np.arange(nodes + 1))
    span = np.log(max(largest_phase, 2 * _LEAST_PHASE) / _LEAST_PHASE)
    phase = _LEAST_PHASE * np.exp(PHASE_STEP * np.arange(int(np.ceil(span / PHASE_STEP)) + _MARGIN + 1))
    azimuth = np.arange(AZIMUTHS) * 180 / AZIMUTHS
    turn, lay = np.radians(azimuth), np.radians(stretch.lay)

    step = _DECADES * np.log(10) / _RADII
    index = np.arange(_RADII) - (_RADII - 1) / 2
    distance, grid = length * np.exp(index * step), np.exp(index * step) / (2 * np.pi * length)
    along, across = grid[:, None] * np.cos(turn) / stretch.ratio, grid[:, None] * np.sin(turn) * stretch.ratio
    density = spectrum(along * np.cos(lay) - across * np.sin(lay), along * np.sin(lay) + across * np.cos(lay))
    density = _smoothed(density, step)
    density /= 2 * np.pi * step * float(density.mean(axis=1) @ grid**2)
    rho = _correlation(density, grid, step, distance, length)
    # Towards frequency 0 the quotient of a discrete transform is noise, and the transform itself constant.
    inside = (grid > 0.1 * frequency[1]) & (grid < 10 * frequency[-1])
    asked = np.log(np.maximum(frequency, 0.3 * frequency[1]))
    log_density = np.log(np.maximum(density[inside], 1e-300))
    first_order = CubicSpline(np.log(grid[inside]), log_density)(asked)
    values = np.empty((phase.size, frequency.size, AZIMUTHS))
    for start in range(0, phase.size, _PHASES_AT_ONCE):
        rows = slice(start, start + _PHASES_AT_ONCE)
        g = phase[rows, None, None]
        exponent = g * rho
        higher = np.where(
            np.abs(exponent) < 1e-3,
            np.exp(-g) * exponent**2 * (0.5 + exponent / 6 + exponent**2 / 24),
            np.exp(exponent - g) - np.exp(-g) * (1 + exponent),
        )
        rest = _transform(higher, distance, step, grid)[:, inside] / g
        logs = np.log(np.maximum(rest, _FLOOR * rest.max(axis=(1, 2), keepdims=True)))
        values[rows] = np.logaddexp(first_order - g, CubicSpline(np.log(grid[inside]), logs, axis=1)(asked))
    return xr.Dataset(
        {
            "log_halo": (("phase_variance", "halo_frequency", "halo_azimuth"), values),
            "frequency_scale": scale,
            "halo_lay": stretch.lay,
            "halo_stretch": stretch.ratio,
        },
        coords={"phase_variance": phase, "halo_frequency": frequency, "halo_azimuth": azimuth},
    )


def _smoothed(density: Array, step: float) -> Array:
    """A spectrum (radii, azimuths) whose variation around each ring is smoothed: that of a mean over few modes is noise."""
    level = density.mean(axis=1, keepdims=True)
    around = density / np.maximum(level, 1e-300)
    widths = _SMOOTHED_RADII / step, _SMOOTHED_AZIMUTHS / (180 / density.shape[1])
    return np.asarray(level * gaussian_filter(around, widths, mode=("nearest", "wrap")))


def _correlation(density: Array, grid: Array, step: float, distance: Array, length: float) -> Array:
    """ρ, (distances, azimuths), of a spectrum (frequencies, azimuths) with an integral of 1.

    Where the distance is small a discrete transform is noise: there its mean over azimuth is 1 less the integral of (1 − J0) S,
    and its variation falls as the square of the distance.
    """
    rho = _transform(density, grid, step, distance)
    near = distance < _NEAR * length
    first = int(np.argmin(near))
    variation = (rho[first] - rho[first].mean()) * (distance[near, None] / distance[first]) ** 2
    ring = 2 * np.pi * step * density.mean(axis=1) * grid**2
    used = ring > 1e-12 * ring.max()
    loss = (1 - j0(2 * np.pi * distance[near, None] * grid[used])) @ ring[used]
    rho[near] = 1 - loss[:, None] + variation
    return np.clip(rho, -1.0, 1.0)


def _transform(values: Array, radius: Array, step: float, to: Array) -> Array:
    """∬ v e^(2πi f·r) over the plane of functions that are even, (…, radii, azimuths over half a turn), at the radii ``to``."""
    harmonics = np.moveaxis(np.fft.rfft(values * radius[:, None], axis=-1), -1, 0)
    transformed = np.empty_like(harmonics)
    for k, harmonic in enumerate(harmonics):
        transformed[k] = (-1) ** k * (fht(harmonic.real, step, 2.0 * k) + 1j * fht(harmonic.imag, step, 2.0 * k))
    whole = np.fft.irfft(np.moveaxis(transformed, 0, -1), n=values.shape[-1], axis=-1)
    return np.asarray(whole / to[:, None])

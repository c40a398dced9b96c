"""Slopes of a height map's facets, and what they say as a whole.

Every quad is cut along both diagonals into four triangles; a single diagonal would correlate the two slope components and
show a false lay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe.geometry import Array

SCALES = np.array([1.0, 2.0, 4.0, 8.0])
"""Distances, in pixels, over which the slope rms is reported."""

BLOCKS = 8
"""A map is cut into this many blocks along each axis, a line into their square."""


class Moments(NamedTuple):
    """First and second moments of the slopes."""

    facets: int
    mean: Array
    """(2,) mean slope along x and y."""
    covariance: Array
    """(2, 2) about the mean."""
    steepest: float

    @property
    def slope_rms(self) -> float:
        return float(np.sqrt(np.trace(self.covariance) + self.mean @ self.mean))

    @property
    def anisotropy(self) -> float:
        """Larger over smaller principal slope rms; NaN where one of them vanishes."""
        smaller, larger = np.linalg.eigvalsh(self.covariance)
        return float(np.sqrt(larger / smaller)) if smaller > 0 else float("nan")

    @property
    def lay(self) -> float:
        """Azimuth of the smaller principal slope rms, an axis in [-90, 90) degree."""
        x, y = np.linalg.eigh(self.covariance)[1][:, 0]
        return float((np.degrees(np.arctan2(y, x)) + 90) % 180 - 90)


def pitch_of(surface: xr.Dataset) -> tuple[float, float]:
    """Pitch along x and y of a map [um]."""
    return float(surface.attrs["pitch_x"]), float(surface.attrs["pitch_y"])


def triangle_slopes(maps: Sequence[xr.Dataset]) -> Iterator[tuple[int, Array, Array]]:
    """Slopes (p, q) of the four triangles of every quad, block by block; a triangle that touches a missing height is left out.

    Yields the number of the block, p and q.
    """
    for scan, surface in enumerate(maps):
        height, pitch = surface["height"].values, pitch_of(surface)
        rows = np.linspace(0, height.shape[0] - 1, BLOCKS + 1).astype(int)
        columns = np.linspace(0, height.shape[1] - 1, BLOCKS + 1).astype(int)
        for block in range(BLOCKS**2):
            row, column = divmod(block, BLOCKS)
            part = height[rows[row] : rows[row + 1] + 1, columns[column] : columns[column + 1] + 1]
            for p, q in _of_block(part, pitch):
                yield scan * BLOCKS**2 + block, p, q


def _of_block(height: Array, pitch: tuple[float, float]) -> Iterator[tuple[Array, Array]]:
    height = np.asarray(height, dtype=float)
    along_x = np.diff(height, axis=1) / pitch[0]
    along_y = np.diff(height, axis=0) / pitch[1]
    whole = bool(np.isfinite(height).all())
    for p in (along_x[:-1], along_x[1:]):
        for q in (along_y[:, :-1], along_y[:, 1:]):
            if whole:
                yield p.ravel(), q.ravel()
            else:
                complete = np.isfinite(p) & np.isfinite(q)
                yield p[complete], q[complete]


def moments(maps: Sequence[xr.Dataset]) -> Moments:
    """Moments of the slopes of one or several scans."""
    count, total, products, steepest = 0, np.zeros(2), np.zeros((2, 2)), 0.0
    for _, p, q in triangle_slopes(maps):
        if p.size == 0:
            continue
        pp, qq, pq = p @ p, q @ q, p @ q
        count += p.size
        total += p.sum(), q.sum()
        products += [[pp, pq], [pq, qq]]
        steepest = max(steepest, float((p * p + q * q).max()))
    if count == 0:
        return Moments(0, np.zeros(2), np.zeros((2, 2)), 0.0)
    mean = total / count
    return Moments(count, mean, products / count - np.outer(mean, mean), float(np.sqrt(steepest)))


def slope_rms_by_scale(surface: xr.Dataset) -> Array:
    """Root mean square slope of a map over 1, 2, 4 and 8 pixels; NaN where the map is too small."""
    height, pitch = surface["height"].values, pitch_of(surface)
    values = []
    for step in SCALES.astype(int):
        if min(height.shape) <= step:
            values.append(np.nan)
            continue
        squares = [
            mean_square(difference / (step * spacing))
            for difference, spacing in (
                (height[:, step:] - height[:, :-step], pitch[0]),
                (height[step:] - height[:-step], pitch[1]),
            )
        ]
        values.append(np.sqrt(sum(squares)))
    return np.asarray(values)


def mean_square(values: Array) -> float:
    """Mean square of the values that are there; NaN where none is."""
    finite = values[np.isfinite(values)]
    return float(finite @ finite.astype(float) / finite.size) if finite.size else float("nan")


def correlation_length(surface: xr.Dataset) -> float:
    """Distance at which the height correlation falls to 1/e, the geometric mean over the axes; NaN where it never does."""
    height = surface["height"].values
    pitches = [float(surface.attrs[f"pitch_{axis}"]) for axis in surface["height"].dims]
    lengths = [
        _along(np.moveaxis(height, axis, -1).reshape(-1, n), pitches[axis]) for axis, n in enumerate(height.shape)
    ]
    return float(np.exp(np.mean(np.log(lengths)))) if np.isfinite(lengths).all() else float("nan")


def _along(lines: Array, pitch: float) -> float:
    from scipy.fft import irfft, next_fast_len, rfft

    # A few hundred lines tell the correlation as well as all of them.
    lines = lines[:: max(1, lines.shape[0] // 256)]
    present = np.isfinite(lines)
    if not present.any():
        return float("nan")
    centred = np.where(present, lines - np.nanmean(lines), 0.0).astype(np.float64)
    length = next_fast_len(2 * lines.shape[1], real=True)
    lags = lines.shape[1] // 2

    def power(values: Array) -> Array:
        spectrum = np.zeros(length // 2 + 1)
        for part in np.array_split(values, max(1, values.size // 2**20)):
            transform = rfft(part, length, axis=1)
            spectrum += (transform.real**2 + transform.imag**2).sum(axis=0)
        return np.asarray(irfft(spectrum, length)[:lags])

    if present.all():
        pairs = lines.shape[0] * (lines.shape[1] - np.arange(lags, dtype=float))
    else:
        pairs = power(present.astype(np.float64))
    correlation = power(centred) / np.maximum(pairs, 1.0)
    below = np.flatnonzero(correlation < correlation[0] / np.e) if correlation.size else np.empty(0, int)
    if below.size == 0 or correlation[0] <= 0:
        return float("nan")
    k = below[0]
    step = (correlation[k - 1] - correlation[0] / np.e) / (correlation[k - 1] - correlation[k])
    return float((k - 1 + step) * pitch)

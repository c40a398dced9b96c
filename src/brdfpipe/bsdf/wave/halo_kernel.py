"""Compiled halo of many directions on one core: the table and the polarisation factor of :mod:`brdfpipe.bsdf.wave.halo`.

All compiled functions are in this module, because the compiler's cache of a function does not see changes in other modules.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from brdfpipe.compilation import compiled
from brdfpipe.geometry import Array, HalfVector

_TINY = 1e-300
_EDGE = 2  # nodes by which a spline is continued as its mirror image


class HaloTable(NamedTuple):
    """A cubic spline through ln(K/g) over phase variance, frequency and azimuth, all evenly spaced."""

    coefficients: Array
    """(phase variance, frequency, azimuth), continued at the ends of the first two; with one azimuth for a surface without a lay"""
    phase_matters: bool
    """False for the limit g → 0"""

    @classmethod
    def of(cls, spline: Array, phase_matters: bool) -> HaloTable:
        """Of the coefficients of a spline, (phase variance, frequency) or with an azimuth as third axis."""
        volume = spline[..., None] if spline.ndim == 2 else spline
        padded = np.pad(volume, [(_EDGE, _EDGE), (_EDGE, _EDGE), (0, 0)], mode="reflect")
        return cls(np.ascontiguousarray(padded), phase_matters)


class Place(NamedTuple):
    """Places of directions in tables, in steps from the first node."""

    phase: Array
    """(directions, wavelength) of ln g; below 0 is the first node"""
    frequency: Array
    """(directions, wavelength) of asinh(f/f0)"""
    azimuth: Array
    """(directions,) of the azimuth, for a surface with a lay"""


def transform_ratio(table: HaloTable, place: Place) -> Array:
    """K/g [um2], (directions, wavelength), at places of the table."""
    result = np.empty_like(place.frequency)
    _splines(table.coefficients, table.phase_matters, place, result)
    return np.exp(result, out=result)


@compiled
def _splines(coefficients: Array, phase_matters: bool, place: Place, result: Array) -> None:
    rows, columns, azimuths = coefficients.shape
    last_row, last_column = rows - 2 * _EDGE - 1, columns - 2 * _EDGE - 1
    for j in range(result.shape[0]):
        for w in range(result.shape[1]):
            row = place.phase[j, w]
            row = row if phase_matters and row > 0 else 0.0
            row, at = _mirrored(row, last_row), _mirrored(place.frequency[j, w], last_column)
            if azimuths == 1:
                result[j, w] = _on_surface(coefficients, row, at)
            else:
                result[j, w] = _in_volume(coefficients, row, at, place.azimuth[j])


def polarisation_factor(pair: HalfVector, azimuth: Array, n: Array) -> Array:
    """Q of unpolarised light on a body that does not absorb, (directions, wavelength), as :func:`~brdfpipe.bsdf.wave.halo.amplitudes`."""
    result = np.empty((azimuth.size, n.size))
    cos_i, sin_i, cos_o, sin_o, turned, index = (
        np.ascontiguousarray(values, dtype=float) for values in (*pair[2:], azimuth, n)
    )
    _polarisation_factor(cos_i, sin_i, cos_o, sin_o, turned, index, result)
    return result


@compiled
def _polarisation_factor(
    cosines_i: Array, sines_i: Array, cosines_o: Array, sines_o: Array, azimuth: Array, n: Array, result: Array
) -> None:
    for j in range(azimuth.size):
        turned = (180 - azimuth[j]) * (math.pi / 180)
        cos, sin = math.cos(turned), math.sin(turned)
        cos_i, cos_o, sines = cosines_i[j], cosines_o[j], sines_i[j] * sines_o[j]
        for w in range(n.size):
            contrast, epsilon = (n[w] - 1) * (n[w] + 1), n[w] * n[w]
            root_i, root_o = (
                math.sqrt(max(contrast + cos_i * cos_i, 0.0)),
                math.sqrt(max(contrast + cos_o * cos_o, 0.0)),
            )
            s_i, s_o = 1 / (cos_i + root_i + _TINY), 1 / (cos_o + root_o + _TINY)
            p_i, p_o = 1 / (epsilon * cos_i + root_i + _TINY), 1 / (epsilon * cos_o + root_o + _TINY)
            ss, sp = contrast * cos * s_i * s_o, contrast * sin * root_o * s_i * p_o
            ps, pp = (
                contrast * sin * root_i * p_i * s_o,
                contrast * (root_i * root_o * cos - epsilon * sines) * p_i * p_o,
            )
            result[j, w] = ((ss * ss + sp * sp) + (ps * ps + pp * pp)) / 2


@compiled
def _mirrored(place: float, last: int) -> float:
    """A fractional index between the first node and the last, as if the table went on as its mirror image."""
    if place <= last:
        return place
    place = place % (2 * last) if place < math.inf else 0.0
    return place if place <= last else 2 * last - place


@compiled
def _basis(x: float) -> tuple[float, float, float, float]:
    """The uniform cubic B-splines about a position between its two middle ones, 0 <= x <= 1."""
    y = 1 - x
    first, second, last = y * y * y / 6, 2 / 3 - x * x * (1 - x / 2), x * x * x / 6
    return first, second, 1 - (first + second + last), last


@compiled
def _on_surface(c: Array, row: float, column: float) -> float:
    i, j = np.uintp(np.int64(row)), np.uintp(np.int64(column))
    a, b = _basis(row - i), _basis(column - j)
    i, j, zero = i + np.uintp(_EDGE - 1), j + np.uintp(_EDGE - 1), np.uintp(0)
    value = 0.0
    for m in range(4):
        p = i + np.uintp(m)
        near = b[0] * c[p, j, zero] + b[1] * c[p, j + np.uintp(1), zero]
        value += a[m] * (near + (b[2] * c[p, j + np.uintp(2), zero] + b[3] * c[p, j + np.uintp(3), zero]))
    return value


@compiled
def _in_volume(c: Array, row: float, column: float, azimuth: float) -> float:
    i, j, k = np.uintp(np.int64(row)), np.uintp(np.int64(column)), np.uintp(np.int64(azimuth))
    a, b, d = _basis(row - i), _basis(column - j), _basis(azimuth - k)
    i, j, k = i + np.uintp(_EDGE - 1), j + np.uintp(_EDGE - 1), k - np.uintp(1)
    value = 0.0
    for m in range(4):
        p = i + np.uintp(m)
        for n in range(4):
            q = j + np.uintp(n)
            near = d[0] * c[p, q, k] + d[1] * c[p, q, k + np.uintp(1)]
            value += a[m] * b[n] * (near + (d[2] * c[p, q, k + np.uintp(2)] + d[3] * c[p, q, k + np.uintp(3)]))
    return value

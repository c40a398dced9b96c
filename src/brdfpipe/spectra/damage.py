"""Signs of damage in a reflectance spectrum: single outliers and jumps."""

from __future__ import annotations

import numpy as np

from brdfpipe.geometry import Array

_SPIKE, _RELATIVE_SPIKE = 0.001, 0.02
"""Tolerated deviation of a single value from its neighbours: absolute, and relative to them."""
_NEAR, _WINDOW = 3, 20
"""Neighbours on either side from which the curvature and the noise of a spectrum are estimated."""
_OUTLIER = 10.0
"""Limit over the median deviation of values from their neighbours: nearly 7 standard deviations of normal noise."""
_END = 20.0
"""Limit over the curvature of the neighbours at the first and last value, since whites fall steeply into the ultraviolet."""
_JUMP = 0.1
_STEEPER = 6.0
"""Least rise of a jump, and its slope over those around it."""


def outliers(wavelength: Array, reflectance: Array, digit: float) -> list[str]:
    """Warnings about values far from the line through their neighbours: mistyped or damaged digits.

    Parameters
    ----------
    wavelength, reflectance : (n,) nm, increasing; [1]
    digit : last digit of the reflectance in the file [1]
    """
    if wavelength.size < 5:
        return []
    between = _from_neighbours(wavelength, reflectance)
    off = np.abs(reflectance - between)
    least = np.maximum(_SPIKE, _RELATIVE_SPIKE * np.abs(between)) + 2 * digit
    usual = np.maximum(_usual_bend(wavelength, reflectance), _OUTLIER * np.nanmedian(_around(off, _WINDOW), axis=1))
    # A wrong value also shifts the deviation of its neighbours, by half as much.
    farthest = off >= np.nanmax(_around(np.concatenate([[0.0], off[1:-1], [0.0]]), 1), axis=1)
    return [
        f"{reflectance[i]:.4g} at {wavelength[i]:g} nm differs by {off[i]:.2g} from its neighbours. Look for a mistyped or damaged value."
        for i in np.flatnonzero(farthest & (off > np.maximum(least, usual)))
    ]


def _from_neighbours(wavelength: Array, reflectance: Array) -> Array:
    """Linear prediction of each value from its two neighbours; at the ends from the two nearest."""
    size = wavelength.size
    first = np.concatenate([[1], np.arange(size - 2), [size - 3]])
    second = np.concatenate([[2], np.arange(2, size), [size - 2]])
    slope = (reflectance[second] - reflectance[first]) / (wavelength[second] - wavelength[first])
    return np.asarray(reflectance[first] + slope * (wavelength - wavelength[first]))


def _usual_bend(wavelength: Array, reflectance: Array) -> Array:
    """Deviation from the neighbours that is normal at their curvature, on edges and peaks."""
    x, y = _around(wavelength, _NEAR), _around(reflectance, _NEAR)
    # One further neighbour is left out, the one that gives the smallest curvature: it may be damaged too. Not at the ends.
    fewer = np.min([_bend(np.delete(x, k, axis=1), np.delete(y, k, axis=1)) for k in range(2 * _NEAR)], axis=0)
    bend = np.where(np.isnan(y).any(axis=1), _bend(x, y), fewer)
    step = np.diff(wavelength)
    before, after = step[:-1], step[1:]
    room = np.concatenate([[_END * step[0]], 4 * before * after / (before + after), [_END * step[-1]]])
    return np.asarray(room * bend)


def _bend(x: Array, y: Array) -> Array:
    """Largest change of slope along each row; 0 if there are too few values."""
    change = np.abs(np.diff(np.diff(y, axis=1) / np.diff(x, axis=1), axis=1))
    return np.asarray(np.where(np.isnan(change), 0.0, change).max(axis=1))


def _around(values: Array, reach: int) -> Array:
    """(n, 2 reach) neighbours of each value on either side, without the value itself."""
    near = np.arange(values.size)[:, None] + np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)])
    missing = (near < 0) | (near >= values.size)
    return np.where(missing, np.nan, values[np.clip(near, 0, values.size - 1)])


def jumps(wavelength: Array, reflectance: Array) -> list[str]:
    """Warnings about a jump between two nearly level parts: lost, repeated or interchanged values."""
    rise = np.diff(reflectance)
    slope = np.abs(rise / np.diff(wavelength))
    return [
        f"the reflectance jumps by {abs(rise[i]):.3g} from {wavelength[i]:g} to {wavelength[i + 1]:g} nm. Look for missing, repeated or "
        "damaged values."
        for i in np.flatnonzero(np.abs(rise) > _JUMP)
        if slope[i] > _STEEPER * np.concatenate([slope[max(i - 2, 0) : i], slope[i + 1 : i + 3]]).max(initial=0.0)
    ]

"""Method ``lhtss``: the smoothest reflectance in (0, 1) that has a colour exactly, of many colours at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import Weights

_TOLERANCE = 1e-8
# On tristimulus values with Y = 1 for white: 4e-8 in L*a*b*, whose slope is 3900 at black.
_COLOUR_TOLERANCE = 1e-11
# r = 1/(1 + e^(2·25)) is 2e-22: beyond, a colour is out of reach and the system has lost its rank.
_LARGEST_Z = 25.0
_LONGEST_STEP = 2.0
_ITERATIONS = 100
_CHUNK = 256


class Recovered(NamedTuple):
    """Spectra of many colours, on the wavelengths of the weights."""

    reflectance: Array
    """(B, n) from the floor to 1; NaN where the colour is out of reach."""
    reached: NDArray[np.bool_]
    """(B,) whether a spectrum of the method between the floor and 1 has this colour."""
    weights: Array | None = None
    """(B, 4) of the basis spectra, of a method that mixes them."""


def lhtss(xyz: ArrayLike, table: Weights, floor: ArrayLike = 0.0) -> Recovered:
    """Spectra of many colours at once, by least hyperbolic tangent slope squared.

    Parameters
    ----------
    xyz : (B, 3) tristimulus values, Y = 100 for the perfect diffuser
    table : of :func:`brdfpipe.spectra.colorimetry.weights`
    floor : () or (n,), what every spectrum has beneath the smoothest (specular), 0 <= floor < 1: R = floor + (1 − floor) r

    Notes
    -----
    Minimises Σ (z_{i+1} − z_i)² subject to XYZ(r) = XYZ, with r = (1 + tanh z)/2, by Newton's method on the stationarity
    conditions, from z = atanh(2Y − 1). A step is shortened as a whole to |Δz| <= 2: shortening each element on its own turns
    the step away and loses one saturated colour in eight.

    References
    ----------
    Burns, "Numerical methods for smoothest reflectance reconstruction", Color Res. Appl. 45 (2020) 8–21.
    """
    under = np.broadcast_to(np.asarray(floor, dtype=float), table.wavelength.size)
    above = table.weights * (1 - under)[:, None]
    # Y = 1 for r = 1 throughout.
    white = float(above[:, 1].sum())
    colours = (np.atleast_2d(np.asarray(xyz, dtype=float)) - under @ table.weights) / white
    # Chunks keep the steps in the cache.
    parts = [_newton(colours[start : start + _CHUNK], above / white) for start in range(0, len(colours), _CHUNK)]
    z = np.concatenate(parts) if parts else np.empty((0, table.wavelength.size))
    reached = np.asarray(np.isfinite(z).all(axis=1))
    return Recovered(under + (1 - under) * _logistic(z), reached)


def _newton(xyz: Array, a: Array) -> Array:
    """The z (B, n) of colours (B, 3) for weights (n, 3), both with Y = 1 for white; NaN where no solution was reached."""
    count, size = len(xyz), len(a)
    z = np.full((count, size), np.nan)
    active = np.flatnonzero((xyz > 0).all(axis=1) & (xyz[:, 1] < 1))
    z_now = np.repeat(np.arctanh(2 * xyz[active, 1:2] - 1), size, axis=1)
    multiplier = np.zeros((active.size, 3))
    tolerance = np.concatenate([np.full(size, _TOLERANCE), np.full(3, _COLOUR_TOLERANCE)])
    for _ in range(_ITERATIONS):
        if active.size == 0:
            break
        r = _logistic(z_now)
        pull = multiplier @ a.T
        slope = 2 * r * (1 - r)
        residual = np.concatenate([_roughness_slope(z_now) + slope * pull, r @ a - xyz[active]], axis=1)
        done = (np.abs(residual) < tolerance).all(axis=1)
        z[active[done]] = z_now[done]
        active, z_now, multiplier = active[~done], z_now[~done], multiplier[~done]
        curvature = 2 * slope * (1 - 2 * r) * pull
        step = _step(a, slope[~done], curvature[~done], residual[~done])
        longest = np.abs(step[:, :size]).max(axis=1)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _TOLERANCE))[:, None]
        z_now, multiplier = z_now + step[:, :size], multiplier + step[:, size:]
        alive = np.isfinite(step).all(axis=1) & (np.abs(z_now).max(axis=1) < _LARGEST_Z)
        active, z_now, multiplier = active[alive], z_now[alive], multiplier[alive]
    return z


def _roughness_slope(z: Array) -> Array:
    """∂ Σ (z_{i+1} − z_i)² / ∂z, (B, n)."""
    rises = np.diff(z, axis=1)
    return 2 * (np.pad(rises, ((0, 0), (1, 0))) - np.pad(rises, ((0, 0), (0, 1))))


def _step(a: Array, slope: Array, curvature: Array, residual: Array) -> Array:
    """Newton's step (B, n + 3): of the z, whose rows form a tridiagonal matrix, and of the three multipliers that border it.

    All z but the last are eliminated in turn. The last stays with the multipliers, four unknowns solved with pivoting: as long as
    the multipliers are 0 the tridiagonal matrix, a second difference, has no inverse of its own.
    """
    count, size = slope.shape
    diagonal = curvature.T + np.where(np.isin(np.arange(size), (0, size - 1)), 2.0, 4.0)[:, None]
    # The border's three columns and the right side, (n, 4, B).
    rows = np.concatenate([a[:, :, None] * slope.T[:, None, :], -residual[:, None, :size].T], axis=1)
    pivot = np.empty_like(diagonal)
    pivot[0] = _off_zero(diagonal[0])
    for i in range(1, size):
        pivot[i] = _off_zero(diagonal[i] - 4 / pivot[i - 1])
        rows[i] += rows[i - 1] * (2 / pivot[i - 1])
    border, right = rows[:, :3], rows[:, 3]
    part = border[:-1] / pivot[:-1, None]
    system, constant = np.empty((count, 4, 4)), np.empty((count, 4))
    system[:, 0, 0] = pivot[-1]
    system[:, 0, 1:] = system[:, 1:, 0] = border[-1].T
    # Far below any weight: keeps a lost row from being singular without moving the solution.
    system[:, 1:, 1:] = -1e-14 * np.eye(3) - np.einsum("nib,njb->bij", part, border[:-1], optimize=True)
    constant[:, 0] = right[-1]
    constant[:, 1:] = -residual[:, size:] - np.einsum("nib,nb->bi", part, right[:-1])
    ends = _solved(system, constant)
    right = right - np.einsum("nib,bi->nb", border, ends[:, 1:])
    step = np.empty((size, count))
    step[-1] = ends[:, 0]
    for i in range(size - 2, -1, -1):
        step[i] = (right[i] + 2 * step[i + 1]) / pivot[i]
    return np.concatenate([step.T, ends[:, 1:]], axis=1)


def _off_zero(pivot: Array) -> Array:
    # A pivot may vanish where the matrix is indefinite; moved by less than a step's rounding, it costs Newton at most a step.
    return np.where(np.abs(pivot) < 1e-12, 1e-12, pivot)


def _solved(system: Array, constant: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(system, constant[..., None])[..., 0], dtype=np.float64)
    except np.linalg.LinAlgError:
        # One lost colour must not take the others with it.
        ranks = np.linalg.matrix_rank(system) == system.shape[1]
        solution = np.full_like(constant, np.nan)
        solution[ranks] = np.linalg.solve(system[ranks], constant[ranks][..., None])[..., 0]
        return solution


def _logistic(z: Array) -> Array:
    # (1 + tanh z)/2, with full relative precision near 0.
    return np.asarray(1 / (1 + np.exp(-2 * z)))

"""Levelling: subtract the form of the part, keep the texture.

Every form is a polynomial of up to second degree in the positions, fitted to the valid heights by least squares.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.vocabulary import add_history, validate

FORMS = ("plane", "polynomial-2", "cylinder", "none")
"""Forms of :func:`level`; the first one is the default."""

_DEGREE = {"plane": 1, "polynomial-2": 2, "cylinder": 2}
_NAMES = {"plane": "plane", "polynomial-2": "polynomial of degree 2", "cylinder": "parabolic cylinder"}
_LINE_NAMES = {"plane": "straight line", "polynomial-2": "parabola", "cylinder": "parabola"}
_BLOCK = 2**20
_WORST_CONDITION = 1e10
_TOO_FEW_LINES = "cannot level: the valid heights are on too few lines to determine the form"


class _Sums(NamedTuple):
    """The normal equations of the monomials up to a degree, in scaled positions t = (x − centre)/scale on each axis."""

    powers: list[tuple[int, ...]]
    """Exponents of each monomial along the axes of the heights."""
    matrix: Array
    moments: Array
    centres: list[float]
    scales: list[float]


def level(surface: xr.Dataset, form: str = FORMS[0]) -> xr.Dataset:
    """Subtract the least-squares form from a surface.

    Parameters
    ----------
    surface : kind ``surface``
    form : ``plane`` (of a line: a straight line); ``polynomial-2``: all monomials up to the second degree (of a line: a
        parabola); ``cylinder``: a plane and a parabola along one direction, which is fitted too (of a line: a parabola);
        or ``none``

    Returns
    -------
    Dataset of kind ``surface`` of the same floating type; missing heights stay missing and take no part; attribute
    ``levelling`` and history say what was done. A levelled surface has zero mean height, and a mean slope close to zero, as
    masking supposes.

    Raises
    ------
    VocabularyError : the dataset is not of kind ``surface``.
    BrdfpipeError : unknown form, or too few valid heights to fix the form.

    Notes
    -----
    The cylinder is the parabola that osculates it, not the circular arc: of an arc of radius R over a half width L, u⁴/8R³
    remains, whose rms slope is 0.09 (L/R)³. That is 1e-4 at an edge slope L/R of 0.1, and 2e-3 at 0.3.
    """
    validate(surface, "surface")
    if form not in FORMS:
        raise BrdfpipeError(f"cannot level by the form {form!r}; accepted: {', '.join(FORMS)}")
    if form == "none":
        return surface.assign_attrs(levelling="none")
    height = surface.height
    axes = [surface[dim].values for dim in height.dims]
    sums = _sums(height.values, axes, _DEGREE[form])
    if form == "cylinder" and height.ndim == 2:
        coefficients, words = _cylinder(sums)
    else:
        coefficients, words = np.asarray(np.linalg.solve(sums.matrix, sums.moments), dtype=np.float64), ""
    name = _LINE_NAMES[form] if height.ndim == 1 else _NAMES[form]
    levelled = surface.copy()
    levelled["height"] = height.copy(data=_subtract(height.values, axes, sums, coefficients))
    levelled["height"].attrs = {**height.attrs, "long_name": f"height above the least-squares {name}"}
    return add_history(
        levelled.assign_attrs(levelling=form),
        f"Levelled by a least-squares {name}: slope {_slopes(sums, coefficients, height.dims)}{words}.",
    )


def _sums(height: NDArray[np.floating], axes: Sequence[Array], degree: int) -> _Sums:
    """The normal equations of the fit; no design matrix is built, and blocks of rows keep the copies small."""
    counts = [_count(height, axis) for axis in range(height.ndim)]
    total = int(counts[0].sum())
    powers = [power for power in product(range(degree + 1), repeat=height.ndim) if sum(power) <= degree]
    powers.sort(key=sum)
    if total < len(powers):
        raise BrdfpipeError(f"cannot level: {total} valid heights, the form needs {len(powers)}")
    if min(map(np.count_nonzero, counts)) <= degree:
        raise BrdfpipeError(_TOO_FEW_LINES)
    centres = [float(count @ x) / total for count, x in zip(counts, axes, strict=True)]
    # Positions of unit spread keep the normal equations well conditioned.
    offsets = zip(counts, axes, centres, strict=True)
    spreads = [math.sqrt(float(count @ (x - centre) ** 2) / total) for count, x, centre in offsets]
    powers_of_x = [_powers(*axis, 2 * degree) for axis in zip(axes, centres, spreads, strict=True)]
    weights, moments = _moments(height, counts, powers_of_x, degree)
    matrix = np.array([[weights[tuple(np.add(a, b))] for b in powers] for a in powers])
    scaled = matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    if np.linalg.cond(scaled) > _WORST_CONDITION:
        raise BrdfpipeError(_TOO_FEW_LINES)
    return _Sums(powers, matrix, np.array([moments[power] for power in powers]), centres, spreads)


def _powers(x: Array, centre: float, scale: float, degree: int) -> Array:
    """Powers (n, degree + 1) of scaled positions."""
    return np.asarray(((x - centre) / scale)[:, None] ** np.arange(degree + 1))


def _count(height: NDArray[np.floating], axis: int) -> Array:
    """The number of valid heights at each position of an axis."""
    others = tuple(other for other in range(height.ndim) if other != axis)
    return np.asarray((~np.isnan(height)).sum(axis=others, dtype=np.float64))


def _moments(
    height: NDArray[np.floating], counts: Sequence[Array], powers: Sequence[Array], degree: int
) -> tuple[Array, Array]:
    """Sums of the powers of the positions, up to twice the degree, and of the heights times them, up to the degree."""
    complete = counts[0].sum() == height.size
    low = [power[:, : degree + 1] for power in powers]
    if height.ndim == 1:
        return counts[0] @ powers[0], np.nan_to_num(height.astype(np.float64)) @ low[0]
    columns = powers[1].shape[0]
    weights, moments = np.zeros((2 * degree + 1,) * 2), np.zeros((degree + 1,) * 2)
    if complete:
        weights = np.outer(powers[0].sum(axis=0), powers[1].sum(axis=0))
    rows = max(1, _BLOCK // columns)
    for start in range(0, height.shape[0], rows):
        part = slice(start, start + rows)
        block = height[part].astype(np.float64)
        if not complete:
            valid = ~np.isnan(block)
            weights += powers[0][part].T @ (valid.astype(np.float64) @ powers[1])
            block[~valid] = 0
        moments += low[0][part].T @ (block @ low[1])
    return weights, moments


def _cylinder(sums: _Sums) -> tuple[Array, str]:
    """Coefficients of the plane and the parabola along the direction of the smallest residual, and that direction in words.

    With the plane solved for, the decrease of the residual by a parabola along φ is a ratio of two quadratic forms in cos²φ, 2 cosφ sinφ and
    sin²φ, known from the sums alone: a scan over the half circle and a short search around its best find the direction.
    """
    from scipy.optimize import minimize_scalar

    linear = [index for index, power in enumerate(sums.powers) if sum(power) < 2]
    quadratic = [sums.powers.index(power) for power in ((0, 2), (1, 1), (2, 0))]
    plane, cross = sums.matrix[np.ix_(linear, linear)], sums.matrix[np.ix_(linear, quadratic)]
    reduced_matrix = sums.matrix[np.ix_(quadratic, quadratic)] - cross.T @ np.linalg.solve(plane, cross)
    right_side = sums.moments[quadratic] - cross.T @ np.linalg.solve(plane, sums.moments[linear])
    scale_y, scale_x = np.asarray(sums.scales) / math.sqrt(math.prod(sums.scales))

    def parabola(angle: float) -> Array:
        """u² for u = x cosφ + y sinφ, as coefficients of the scaled monomials."""
        x, y = scale_x * math.cos(angle), scale_y * math.sin(angle)
        return np.array([x * x, 2 * x * y, y * y])

    def curvature_factor(angle: float) -> float:
        """The least-squares factor of the parabola."""
        along = parabola(angle)
        return float(right_side @ along) / float(along @ reduced_matrix @ along)

    def residual_change(angle: float) -> float:
        return -curvature_factor(angle) * float(right_side @ parabola(angle))

    scan = np.radians(np.arange(180.0))
    coarse = float(scan[np.argmin([residual_change(angle) for angle in scan])])
    best = float(minimize_scalar(residual_change, bounds=(coarse - 0.02, coarse + 0.02), method="bounded").x)
    coefficients = np.zeros(len(sums.powers))
    coefficients[quadratic] = curvature_factor(best) * parabola(best)
    coefficients[linear] = np.linalg.solve(plane, sums.moments[linear] - cross @ coefficients[quadratic])
    curvature = 2 * curvature_factor(best) / math.prod(sums.scales)
    return coefficients, f", curvature {curvature:.4g} per um along {math.degrees(best) % 180:.1f} degree"


def _subtract(
    height: NDArray[np.floating], axes: Sequence[Array], sums: _Sums, coefficients: Array
) -> NDArray[np.floating]:
    """The heights above the form, in their own floating type."""
    degree = max(map(max, sums.powers))
    factors = np.zeros((degree + 1,) * height.ndim)
    for power, coefficient in zip(sums.powers, coefficients, strict=True):
        factors[power] = coefficient
    low = [_powers(*axis, degree) for axis in zip(axes, sums.centres, sums.scales, strict=True)]
    if height.ndim == 1:
        return (height - low[0] @ factors).astype(height.dtype, copy=False)
    along_x = factors @ low[1].T
    levelled = np.empty_like(height)
    rows = max(1, _BLOCK // height.shape[1])
    for start in range(0, height.shape[0], rows):
        part = slice(start, start + rows)
        levelled[part] = height[part] - low[0][part] @ along_x
    return levelled


def _slopes(sums: _Sums, coefficients: Array, dims: Sequence[Hashable]) -> str:
    """The slopes of the form at the mean position, in words."""
    slopes = []
    for axis, dim in enumerate(dims):
        power = tuple(int(other == axis) for other in range(len(dims)))
        slopes.append(f"{coefficients[sums.powers.index(power)] / sums.scales[axis]:.4g} along {dim}")
    return ", ".join(slopes)

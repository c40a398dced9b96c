"""Levelling: the form of the part goes, the texture stays."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.errors import BrdfpipeError
from brdfpipe.vocabulary import add_history, validate

FORMS = ("none", "plane")


def level(surface: xr.Dataset, form: str = "plane") -> xr.Dataset:
    """Subtract the least-squares form from a surface.

    Parameters
    ----------
    surface : kind ``surface``
    form : ``plane`` (for a line: a straight line), or ``none``

    Returns
    -------
    Dataset of kind ``surface`` of the same floating type; missing heights stay missing; attribute ``levelling`` and history
    say what was done. A levelled surface has zero mean height, and a mean slope close to zero, as
    masking supposes.

    Raises
    ------
    VocabularyError : the dataset is no surface.
    BrdfpipeError : unknown form, or too few valid heights to fix the form.
    """
    validate(surface, "surface")
    if form not in FORMS:
        raise BrdfpipeError(f"cannot level by the form {form!r}; accepted: {', '.join(FORMS)}")
    if form == "none":
        return surface.assign_attrs(levelling="none")
    height = surface.height
    axes = [surface[dim].values for dim in height.dims]
    mean, centres, slopes = _least_squares_plane(height.values, axes)
    form_heights = np.asarray(mean)
    for axis, (position, centre, slope) in enumerate(zip(axes, centres, slopes, strict=True)):
        along = [1] * height.ndim
        along[axis] = -1
        form_heights = form_heights + (slope * (position - centre)).reshape(along)
    levelled = surface.copy()
    attrs = {**height.attrs, "long_name": "height above the least-squares plane"}
    levelled["height"] = height.copy(data=(height.values - form_heights).astype(height.dtype, copy=False))
    levelled["height"].attrs = attrs
    tilt = ", ".join(f"{slope:.4g} along {dim}" for dim, slope in zip(height.dims, slopes, strict=True))
    shape = "straight line" if height.ndim == 1 else "plane"
    return add_history(levelled.assign_attrs(levelling="plane"), f"Levelled by a least-squares {shape}: slope {tilt}.")


def _least_squares_plane(
    height: NDArray[np.floating], axes: list[NDArray[np.float64]]
) -> tuple[float, list[float], list[float]]:
    """Mean height, centre and slope along each axis of the plane through the valid heights.

    Every moment is a sum along rows or columns: the n × 3 design matrix of a general solver, 30 times the map, is never built.
    """
    valid = ~np.isnan(height)
    complete = bool(valid.all())
    known = height if complete else np.where(valid, height, 0)
    count = int(valid.sum())
    if count < 3:
        raise BrdfpipeError(f"cannot level: {count} valid heights, a plane needs 3")
    weights = [_marginal(valid, axis) for axis in range(height.ndim)]
    centres = [float(w @ x) / count for w, x in zip(weights, axes, strict=True)]
    offsets = [x - centre for x, centre in zip(axes, centres, strict=True)]
    mean = float(known.sum(dtype=np.float64)) / count
    # About the centres the positions sum to zero: the mean height drops out of the slopes.
    moments = np.array([float(_marginal(known, axis) @ x) for axis, x in enumerate(offsets)])
    matrix: NDArray[np.float64] = np.diag(np.array([float(w @ x**2) for w, x in zip(weights, offsets, strict=True)]))
    if height.ndim == 2 and not complete:
        along_rows = np.where(valid, offsets[1], 0).sum(axis=1)
        matrix[0, 1] = matrix[1, 0] = float(along_rows @ offsets[0])
    if np.linalg.matrix_rank(matrix) < height.ndim:
        raise BrdfpipeError("cannot level: the valid heights lie on one line and fix no plane")
    return mean, centres, [float(slope) for slope in np.linalg.solve(matrix, moments)]


def _marginal(values: NDArray[Any], axis: int) -> NDArray[np.float64]:
    """The sum over every axis but one."""
    others = tuple(other for other in range(values.ndim) if other != axis)
    return np.asarray(values.sum(axis=others, dtype=np.float64))

"""Files that list a BRDF point by point: their JSON, and the grid of directions that the points lie on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.exchange.azimuths import circle
from brdfpipe.geometry import Array

LARGEST_FILE = 128 * 2**20
"""Bytes of JSON that are read."""
_LEAST_SHARE = 0.5
"""Of the cells of a grid that points must fill."""
_DECIMALS = 3
"""Of the angles [degree]: those of one node may differ by rounding."""


def read_object(path: Path) -> dict[str, Any]:
    """The object of a JSON file.

    Raises InputError: the file is too large, no JSON, or no object.
    """
    if path.stat().st_size > LARGEST_FILE:
        found = f"{path.stat().st_size >> 20} MiB"
        raise InputError(path, "the file is too large", found=found, accepted=f"at most {LARGEST_FILE >> 20} MiB")

    def refuse(word: str) -> float:
        raise InputError(path, "a number is not finite", found=word, accepted="numbers")

    try:
        content = json.loads(path.read_bytes(), parse_constant=refuse)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(path, "damaged JSON", found=str(error)[:80], accepted="an object") from error
    if not isinstance(content, dict):
        raise InputError(path, "not a JSON object", found=type(content).__name__, accepted="an object")
    return content


def numbers(path: Path, values: object, name: str) -> Array:
    """A list, or a list of rows, of numbers; NaN for ``null``.

    Raises InputError: there is something else in it.
    """
    try:
        found = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            path, f"{name} must be numbers", found=str(error)[:60], accepted="a list of numbers"
        ) from error
    if np.isinf(found).any():
        raise InputError(path, "a number is not finite", where=name, found="above 1e308", accepted="numbers")
    return found


def on_grid(path: Path, columns: Mapping[str, Array], fields: Array) -> tuple[dict[str, Array], Array]:
    """Points on the grid of their coordinates.

    Parameters
    ----------
    columns : ``phi_i``, ``theta_i``, ``theta_o``, ``phi_o`` relative to ``phi_i`` [degree] and ``channel``, (points,) each
    fields : (points, fields)

    Returns
    -------
    The axes, without ``phi_i`` where there is one, and values (axes…, channels, fields), NaN where there is no point; azimuths cover a circle, or the half of it

    Raises
    ------
    InputError : an angle is missing or out of range, a direction occurs twice, points fill less than half of a grid, or the azimuths are no circle.
    """
    rounded = {name: np.round(column, _DECIMALS if name != "channel" else 12) for name, column in columns.items()}
    nodes, places = {}, []
    for name, column in rounded.items():
        if np.isnan(column).any() or column.size == 0:
            raise InputError(path, f"no value of {name} in some rows", accepted="a number in each")
        if name.startswith("theta") and not (column.min() >= 0 and column.max() <= 90):
            found = f"{column.min():g} to {column.max():g} degree"
            raise InputError(path, f"the angles {name} are out of range", found=found, accepted="0 to 90 degree")
        nodes[name], place = np.unique(column, return_inverse=True)
        places.append(place)
    shape = tuple(axis.size for axis in nodes.values())
    cells = float(np.prod([float(size) for size in shape]))
    if cells * _LEAST_SHARE > fields.shape[0]:
        found = f"{fields.shape[0]} points for {' x '.join(map(str, shape))} values of {', '.join(nodes)}"
        raise InputError(
            path, "the points are no grid", found=found, accepted="points at all, or most, combinations of angles"
        )
    values = np.full((*shape, fields.shape[1]), np.nan)
    flat = np.ravel_multi_index(tuple(places), shape)
    if np.unique(flat).size != flat.size:
        at = int(flat[np.flatnonzero(np.bincount(flat, minlength=1)[flat] > 1)[0]])
        first = int(np.flatnonzero(flat == at)[0])
        found = ", ".join(f"{name} {column[first]:g}" for name, column in rounded.items())
        raise InputError(path, "a point occurs twice", found=found, accepted="one row for each")
    values.reshape(-1, fields.shape[1])[flat] = fields
    joined = values.reshape(*shape[:4], -1)
    axes = {name: nodes[name] for name in ("phi_i", "theta_i", "theta_o", "phi_o")}
    axes["phi_o"], joined = circle(axes["phi_o"], joined, path, "of the outgoing light")
    if axes["phi_i"].size == 1:
        axes.pop("phi_i")
        joined = joined[0]
    elif 0 < axes["phi_i"][-1] - axes["phi_i"][0] < 360:
        # A turn later the first azimuth comes again.
        axes["phi_i"] = np.append(axes["phi_i"], axes["phi_i"][0] + 360)
        joined = np.concatenate([joined, joined[:1]])
    return axes, joined.reshape(*joined.shape[:-1], shape[4], fields.shape[1])

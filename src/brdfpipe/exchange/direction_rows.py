"""Tables whose rows are pairs of directions with their values, as a grid about the normal.

The rows may come in any order. Rows that are missing are cells without a value; what follows from symmetry is filled: all azimuths at the normal are one direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdfpipe.errors import InputError
from brdfpipe.exchange.azimuths import closed
from brdfpipe.geometry import Array

MOST_VALUES = 40_000_000
"""Cells times channels of a grid."""
SMALLEST_SHARE = 0.05
"""Of cells that have a row; with fewer the directions are taken as scattered, not as a grid."""

_SAME = 1.5e-3
"""Angles that differ by less are one node [degree]: radian are written with five decimals or more."""
_NORMAL = 1e-3


@dataclass(frozen=True)
class Rows:
    """Pairs of directions [degree], (n,) each, and the values (n, channels)."""

    theta_i: Array
    phi_i: Array
    theta_o: Array
    phi_o: Array
    """From the same direction as ``phi_i``"""
    values: Array


@dataclass(frozen=True)
class RowGrid:
    """A grid about the normal, as of :class:`brdfpipe.exchange.read_table.ReadTable`."""

    axes: dict[str, Array]
    """``theta_i``, ``theta_o`` and ``phi_o`` relative to the azimuth of incidence; ``phi_i`` before them where there are several"""
    values: Array
    """(axes…, channels), NaN without a row"""
    notes: tuple[str, ...]


def gridded_rows(rows: Rows, path: Path) -> RowGrid:
    """The grid of the rows.

    One azimuth of incidence counts as 0, for a surface without a lay: azimuths on one side of the plane of incidence stand for both. A negative polar angle is that on
    the other side of the normal. Of rows of one direction the first is kept.

    Raises InputError: the directions are no grid, or it is too large.
    """
    notes: list[str] = []
    theta_o, phi_o = np.abs(rows.theta_o), np.where(rows.theta_o < 0, rows.phi_o + 180, rows.phi_o)
    theta_i, phi_i = np.abs(rows.theta_i), np.where(rows.theta_i < 0, rows.phi_i + 180, rows.phi_i)
    if (count := int((rows.theta_o < 0).sum() + (rows.theta_i < 0).sum())) > 0:
        notes.append(f"{count} negative polar angles were taken as those on the other side of the normal")
    # The horizon in few decimals may lie below it.
    theta_i, theta_o = (np.where(np.abs(angles - 90) < _SAME, 90.0, angles) for angles in (theta_i, theta_o))
    azimuths, of_phi_i = _nodes(_turned(phi_i))
    if azimuths.size == 1:
        phi_o = phi_o - phi_i
    nodes, index = zip(*(_nodes(angles) for angles in (theta_i, theta_o, _turned(phi_o))), strict=True)
    shape = (azimuths.size, *(axis.size for axis in nodes))
    _check_size(shape, rows.values.shape, path)
    cells = np.ravel_multi_index((of_phi_i, *index), shape)
    values, doubled = _dense(cells, rows.values, int(np.prod(shape)))
    if doubled:
        notes.append(f"{doubled} rows repeat a direction with another value; the first ones were kept")
    values = values.reshape(*shape, -1)
    _fill_at_normal(values, *nodes[:2])
    axes = dict(zip(("theta_i", "theta_o", "phi_o"), nodes, strict=True))
    if azimuths.size == 1:
        axes["phi_o"], values = _around(nodes[2], values[0], notes)
        return RowGrid(axes, values, tuple(notes))
    axes["phi_o"], values = _relative(azimuths, nodes[2], values, notes, path)
    azimuths, values = closed(azimuths, values, 0)
    return RowGrid({"phi_i": azimuths, **axes}, values, tuple(notes))


def _turned(angles: Array) -> Array:
    """Within one turn; just below it is 0."""
    turned = np.asarray(angles % 360)
    return np.where(turned > 360 - _SAME, 0.0, turned)


def _nodes(angles: Array) -> tuple[Array, NDArray[np.intp]]:
    """Different angles, and the number of that of each row."""
    found, inverse = np.unique(angles, return_inverse=True)
    begins = np.concatenate([[True], np.diff(found) > _SAME])
    return found[begins], (np.cumsum(begins) - 1)[inverse.ravel()]


def _check_size(shape: tuple[int, ...], rows: tuple[int, ...], path: Path) -> None:
    cells = float(np.prod([float(count) for count in shape]))
    if rows[0] < SMALLEST_SHARE * cells:
        raise InputError(
            path,
            "the directions are no grid about the normal",
            found=f"{rows[0]} rows, {' x '.join(map(str, shape))} azimuths and polar angles of incidence and of scatter",
            accepted="the same directions of scatter for each incidence",
        )
    if cells * rows[1] > MOST_VALUES:
        raise InputError(
            path, "the table is too large", found=f"{cells * rows[1]:.3g} values", accepted=f"at most {MOST_VALUES}"
        )


def _dense(cells: NDArray[np.intp], values: Array, size: int) -> tuple[Array, int]:
    """Values of all cells, NaN without a row, and the number of rows that contradict an earlier one of their cell."""
    _, first = np.unique(cells, return_index=True)
    dense = np.full((size, values.shape[1]), np.nan)
    dense[cells[first]] = values[first]
    return dense, int((~np.isclose(values, dense[cells], rtol=1e-4, atol=1e-12)).any(axis=1).sum())


def _fill_at_normal(values: Array, theta_i: Array, theta_o: Array) -> None:
    """One value for all azimuths of light from, and to, the normal; values (φ_i, θ_i, θ_o, φ_o, channels) are changed."""
    for axis, polar, at in ((0, theta_i, values[:, :1]), (3, theta_o, values[:, :, :1])):
        if polar[0] < _NORMAL and np.isnan(at).any():
            known = np.isfinite(at)
            total = np.where(known, at, 0.0).sum(axis=axis, keepdims=True)
            count = known.sum(axis=axis, keepdims=True)
            mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
            at[:] = np.where(known, at, mean)


def _around(phi_o: Array, values: Array, notes: list[str]) -> tuple[Array, Array]:
    """A half circle that is mirrored, or a closed circle, of values (θ_i, θ_o, φ_o, channels)."""
    if phi_o.size == 1:
        notes.append("the file has one azimuth of scatter, which stands for all")
        return np.array([0.0, 180.0]), np.repeat(values, 2, axis=-2)
    if (phi_o[phi_o > _NORMAL] >= 180 - _SAME).all() and phi_o[-1] > 180 + _SAME:
        # The nodes at 0 and 180 come first again.
        back = (360 - phi_o) % 360
        order = np.argsort(back)
        phi_o, values = back[order], values[..., order, :]
    if phi_o[-1] <= 180 + _SAME:
        if phi_o.size == 2 and phi_o[0] < _NORMAL and abs(phi_o[1] - 180) <= _SAME:
            notes.append("the file has values in the plane of incidence alone; those outside it were interpolated")
        else:
            notes.append("the file has azimuths on one side of the plane of incidence alone; they were mirrored")
        for end in (0.0, 180.0):
            if np.abs(phi_o - end).min() > _SAME:
                number = phi_o.size if end else 0
                phi_o, values = np.insert(phi_o, number, end), np.insert(values, number, np.nan, axis=-2)
        return np.concatenate([[0.0], phi_o[1:-1], [180.0]]), values
    gaps = np.diff(np.append(phi_o, phi_o[0] + 360))
    if gaps.max() >= 180:
        middle = (phi_o[gaps.argmax()] + gaps.max() / 2) % 360
        number = int(np.searchsorted(phi_o, middle))
        phi_o, values = np.insert(phi_o, number, middle), np.insert(values, number, np.nan, axis=-2)
    return closed(phi_o, values, values.ndim - 2)


def _relative(azimuths: Array, phi_o: Array, values: Array, notes: list[str], path: Path) -> tuple[Array, Array]:
    """Azimuths of scatter, a closed circle, relative to each azimuth of incidence, and the values (φ_i, θ_i, θ_o, φ_o, channels) there."""
    if phi_o.size < 3 or np.diff(np.append(phi_o, phi_o[0] + 360)).max() >= 180:
        found = f"{phi_o[0]:g} to {phi_o[-1]:g} degree"
        accepted = "a full circle of azimuths of scatter, because there are several azimuths of incidence"
        raise InputError(path, "the azimuths are no circle", found=found, accepted=accepted)
    wanted, _ = _nodes(np.sort(_turned(phi_o - azimuths[0])))
    turned, interpolated = np.empty_like(values), False
    for number, azimuth in enumerate(azimuths):
        relative = _turned(phi_o - azimuth)
        order = np.argsort(relative)
        relative, of_azimuth = relative[order], values[number][..., order, :]
        if np.allclose(relative, wanted, rtol=0, atol=_SAME):
            turned[number] = of_azimuth
            continue
        interpolated = True
        after = np.searchsorted(relative, wanted)
        low, high = (
            relative[after - 1] - 360.0 * (after == 0),
            relative[after % relative.size] + 360.0 * (after == relative.size),
        )
        share = ((wanted - low) / (high - low))[:, None]
        turned[number] = of_azimuth[..., after - 1, :] * (1 - share) + of_azimuth[..., after % relative.size, :] * share
    if interpolated:
        notes.append(
            "azimuths of scatter were interpolated, because those relative to each azimuth of incidence differ"
        )
    return closed(wanted, turned, 3)

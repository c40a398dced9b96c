"""Masking by ray casting on measured heights: the reference for Smith's formulas.

A line of heights is a chain of straight segments. Towards a viewer at polar angle θ the running maximum of z sin θ − x cos θ, from
the viewer's end backwards, is the horizon; a segment is visible where it rises above it. The result is exact for the lines used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, VocabularyError
from brdfpipe.geometry import Array, check_angles

THETA_MAX = 89.99
"""Largest polar angle of a ray [degree]."""
LEAST_POINTS = 32
"""Heights of the shortest piece of a line that is used."""

_GROUPS = 32  # groups of lines whose scatter is the uncertainty
_BLOCK_SAMPLES = 2**17  # heights that are processed at once


class RaycastError(BrdfpipeError):
    """A surface has no line along which rays could be cast."""


def raycast(surface: xr.Dataset, theta: ArrayLike, phi: ArrayLike = 0.0, *, lines: int | None = None) -> xr.Dataset:
    """Visible fraction of the facets that face a direction, by casting rays over the heights.

    Parameters
    ----------
    surface : kind ``surface``; a map, or a line profile (azimuths 0 and 180 only)
    theta : degree, a number or increasing values, 0 to 89.99
    phi : degree, a number or increasing values: the azimuth towards the viewer
    lines : cast along at most this many evenly spaced lines of an azimuth; default all

    Returns
    -------
    Dataset of kind ``raycast`` over (theta, phi), numbers giving no dimension: ``g1``, the visible over the whole
    projected area of the facets that face the direction, in (0, 1]; ``g1_u``; ``lambda_empirical`` = E[(p − cot θ)⁺] /
    cot θ of the same lines, p the slope towards the viewer, their mean slope removed.

    Raises
    ------
    VocabularyError : the dataset is not of kind ``surface``, or an angle is out of range or order.
    RaycastError : no line of 32 heights without a gap; or another azimuth than 0 and 180 on a line profile.

    Notes
    -----
    Exact at azimuths 0, 90, 180 and 270. At any other, heights are interpolated linearly on lines that cross one column (or row) a
    step, along the axis closer to the azimuth. ``docs/model.md`` states the method, its errors and the meaning of ``g1_u``.

    References
    ----------
    Smith 1967; Ashikhmin 2000; Heitz 2014 (JCGT 3(2)), eqs. 43 and 99; Ribardière 2019.
    """
    vocabulary.validate(surface, "surface")
    polar, azimuth = _axis("theta", theta, 0, THETA_MAX), _axis("phi", phi, -720, 720)
    sums = [_sums(_AzimuthLines.of(surface, direction), polar, lines) for direction in azimuth]
    g1, g1_u = np.stack([_ratio(visible, facing) for visible, facing, _ in sums], axis=-1)
    result = xr.Dataset(
        {
            "g1": (("theta", "phi"), g1),
            "g1_u": (("theta", "phi"), g1_u),
            "lambda_empirical": (("theta", "phi"), np.stack([smith_lambda for *_, smith_lambda in sums], axis=-1)),
        },
        coords={"theta": polar, "phi": azimuth},
        attrs={"method": "ray cast"},
    )
    single = {name: 0 for name, given in (("theta", theta), ("phi", phi)) if np.ndim(given) == 0}
    return vocabulary.label(result.isel(single), "raycast")


def bistatic(
    surface: xr.Dataset,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_o: ArrayLike,
    phi_o: ArrayLike,
    *,
    lines: int | None = None,
) -> xr.Dataset:
    """Fraction of the facets facing two directions that is visible from both, and Smith's predictions.

    Parameters
    ----------
    surface, lines : as in :func:`raycast`
    theta_i, phi_i, theta_o, phi_o : degree, broadcastable to a number or one dimension, θ 0 to 89.99

    Returns
    -------
    Dataset of kind ``raycast`` over ``direction`` (no dimension for numbers): ``g2`` and ``g2_u``; ``g2_separable`` =
    1/[(1 + Λ_i)(1 + Λ_o)] and ``g2_height_correlated`` = 1/(1 + Λ_i + Λ_o), with Λ of the same lines.

    Raises
    ------
    VocabularyError, RaycastError : as :func:`raycast`.

    Notes
    -----
    Facets count by their share of the mean plane, as they do in the slope density. In one plane (φ_o − φ_i = 0 or 180)
    the part of a segment that both see is exact: the smaller part where both are on one side, the overlap of the two
    ends where they are on opposite sides.

    Out of plane each direction's fraction is computed on its own lines and interpolated linearly to the cells of the map;
    a cell faces a direction by its mean slope, and within a cell that both see in part the two are taken as
    independent. This blurs shadow edges by a sample: structure should span ten samples or more. ``lines`` is not used
    there, and the memory is that of some ten maps. On a Gaussian map of slope rms 0.4 and a correlation length of
    sixteen samples the result is up to 0.02 below the exact one.
    """
    vocabulary.validate(surface, "surface")
    incidence = check_angles("theta_i", theta_i, 0, THETA_MAX), check_angles("phi_i", phi_i, -720, 720)
    outgoing = check_angles("theta_o", theta_o, 0, THETA_MAX), check_angles("phi_o", phi_o, -720, 720)
    angles = np.broadcast_arrays(*incidence, *outgoing)
    if angles[0].ndim > 1:
        raise VocabularyError(f"the directions have {angles[0].ndim} dimensions; accepted: none or one")
    dims = ("direction",) * angles[0].ndim
    ti, pi, to, po = (np.atleast_1d(angle) for angle in angles)
    names = ("g2", "g2_u", "g2_separable", "g2_height_correlated")
    values = np.empty((len(names), ti.size))
    for plane in np.unique(np.stack([pi, po]), axis=1).T:
        members = (pi == plane[0]) & (po == plane[1])
        turn = (plane[1] - plane[0]) % 180
        cast = _in_plane if min(turn, 180 - turn) < 1e-9 else _out_of_plane
        values[:, members] = cast(surface, ti[members], to[members], float(plane[0]), float(plane[1]), lines)
    result = xr.Dataset(
        {name: (dims, row.reshape(angles[0].shape)) for name, row in zip(names, values, strict=True)},
        coords={
            name: (dims, np.array(angle))
            for name, angle in zip(("theta_i", "phi_i", "theta_o", "phi_o"), angles, strict=True)
        },
        attrs={"method": "ray cast"},
    )
    return vocabulary.label(result, "raycast")


# --- sums over lines


def _sums(azimuth_lines: _AzimuthLines, theta: Array, lines: int | None) -> tuple[Array, Array, Array]:
    """Visible and facing projected area (theta, group), and Λ (theta,) from the slopes of the lines."""
    visible, facing = np.zeros((2, theta.size, _GROUPS))
    excess, segments = np.zeros(theta.size), 0
    for block in azimuth_lines.blocks(lines):
        segments += block.segments
        for row, angle in enumerate(theta):
            visible_area, facing_area = block.visible_and_facing(angle)
            visible[row] += block.by_group(visible_area)
            facing[row] += block.by_group(facing_area)
            excess[row] += block.excess(angle)
    return visible, facing, excess / (segments * np.cos(np.radians(theta)))


def _ratio(part: Array, whole: Array) -> tuple[Array, Array]:
    """Σ part / Σ whole over the groups (last axis), and its standard uncertainty from their scatter."""
    total = whole.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = part.sum(axis=-1) / total
        groups = np.count_nonzero(whole > 0, axis=-1)
        scatter = np.sum((part - ratio[..., None] * whole) ** 2, axis=-1)
        spread = np.where(groups > 1, groups / np.maximum(groups - 1, 1), np.nan)
        return ratio, np.sqrt(spread * scatter) / total


def _in_plane(
    surface: xr.Dataset, theta_i: Array, theta_o: Array, phi_i: float, phi_o: float, lines: int | None
) -> Array:
    """(4, m) G2, its uncertainty, and Smith's two forms, with both directions in one vertical plane."""
    azimuth_lines = _AzimuthLines.of(surface, phi_o)
    opposite = abs((phi_o - phi_i) % 360 - 180) < 90
    both, facing = np.zeros((2, theta_i.size, _GROUPS))
    excess_i, excess_o, segments = np.zeros(theta_i.size), np.zeros(theta_i.size), 0
    for block in azimuth_lines.blocks(lines):
        segments += block.segments
        other = block.reversed() if opposite else block
        for row, (incidence, outgoing) in enumerate(zip(theta_i, theta_o, strict=True)):
            visible_i, facing_i = other.fraction(incidence)
            visible_o, facing_o = block.fraction(outgoing)
            if opposite:
                visible_i, facing_i = (_reversed_rows(values, block.length - 1) for values in (visible_i, facing_i))
                # Each direction sees the end of the segment that is nearer to it.
                visible_share = np.maximum(visible_i + visible_o - 1, 0.0)
            else:
                visible_share = np.minimum(visible_i, visible_o)
            counted = facing_i & facing_o & block.inside
            both[row] += block.by_group(visible_share * counted)
            facing[row] += block.by_group(counted.astype(float))
            excess_i[row] += other.excess(incidence)
            excess_o[row] += block.excess(outgoing)
    lambda_i = excess_i / (segments * np.cos(np.radians(theta_i)))
    lambda_o = excess_o / (segments * np.cos(np.radians(theta_o)))
    return np.stack([*_ratio(both, facing), *_smith_pair(lambda_i, lambda_o)])


def _smith_pair(lambda_i: Array, lambda_o: Array) -> tuple[Array, Array]:
    return 1 / ((1 + lambda_i) * (1 + lambda_o)), 1 / (1 + lambda_i + lambda_o)


def _out_of_plane(
    surface: xr.Dataset, theta_i: Array, theta_o: Array, phi_i: float, phi_o: float, lines: int | None
) -> Array:
    """As :func:`_in_plane`, for two directions of any azimuth, on the cells of the map."""
    lines_i, lines_o = _AzimuthLines.of(surface, phi_i), _AzimuthLines.of(surface, phi_o)
    lambda_i, lambda_o = _sums(lines_i, theta_i, lines)[2], _sums(lines_o, theta_o, lines)[2]
    towards_i, towards_o = _cell_slope(surface, phi_i), _cell_slope(surface, phi_o)
    group = np.arange(towards_i.shape[0]) * _GROUPS // towards_i.shape[0]
    both, facing = np.zeros((2, theta_i.size, _GROUPS))
    for row, (incidence, outgoing) in enumerate(zip(theta_i, theta_o, strict=True)):
        visible_share = lines_i.cells(incidence) * lines_o.cells(outgoing)
        counted = np.isfinite(visible_share)
        for towards, angle in ((towards_i, incidence), (towards_o, outgoing)):
            counted &= towards * np.sin(np.radians(angle)) < np.cos(np.radians(angle))
        both[row] = _group_sums(group, np.where(counted, visible_share, 0.0).sum(axis=1))
        facing[row] = _group_sums(group, counted.sum(axis=1).astype(float))
    return np.stack([*_ratio(both, facing), *_smith_pair(lambda_i, lambda_o)])


def _cell_slope(surface: xr.Dataset, phi: float) -> Array:
    """Mean slope of every cell of four heights towards an azimuth; NaN where one of them is missing."""
    height = surface["height"].values.astype(float)
    along_x, along_y = np.diff(height, axis=1), np.diff(height, axis=0)
    p = (along_x[:-1] + along_x[1:]) / (2 * float(surface.attrs["pitch_x"]))
    q = (along_y[:, :-1] + along_y[:, 1:]) / (2 * float(surface.attrs["pitch_y"]))
    return p * np.cos(np.radians(phi)) + q * np.sin(np.radians(phi))


# --- lines of heights


@dataclass(frozen=True)
class _AzimuthLines:
    """Heights along one azimuth, as lines that run towards the viewer."""

    height: NDArray[np.floating]
    """(rows, columns), a view of the map; columns run towards the viewer."""
    step: float
    """Distance along a line from one column to the next [um]."""
    drift: float
    """Rows that a line crosses from one column to the next, −1 to 1."""
    restore: Callable[[Array], Array]
    """Rotates an array from this orientation to that of the map."""

    @classmethod
    def of(cls, surface: xr.Dataset, phi: float) -> _AzimuthLines:
        height, pitch_x = surface["height"].values, float(surface.attrs["pitch_x"])
        if height.ndim == 1:
            if min(phi % 180, 180 - phi % 180) > 1e-9:
                raise RaycastError(f"a line profile has no azimuth {phi:g}; accepted: 0 and 180")
            height, pitch_y = height[None], pitch_x
        else:
            pitch_y = float(surface.attrs["pitch_y"])
        # Samples crossed per µm.
        across = np.cos(np.radians(phi)) / pitch_x, np.sin(np.radians(phi)) / pitch_y
        turned = abs(across[1]) > abs(across[0])
        along, aside = across[::-1] if turned else across
        oriented = height.T if turned else height
        oriented = oriented[:, ::-1] if along < 0 else oriented

        def restore(values: Array) -> Array:
            values = values[:, ::-1] if along < 0 else values
            return values.T if turned else values

        drift = aside / abs(along)
        # The cosine of 90 degree is not quite zero.
        return cls(oriented, 1 / abs(along), 0.0 if abs(drift) < 1e-9 else float(drift), restore)

    @property
    def lines(self) -> int:
        return self.height.shape[0] + int(abs(self.drift) * (self.height.shape[1] - 1))

    @property
    def first(self) -> int:
        """Row in which line 0 begins; negative where lines enter the map from its side."""
        return -int(max(self.drift, 0.0) * (self.height.shape[1] - 1))

    def blocks(self, most: int | None) -> Iterator[_Block]:
        """The lines, or evenly spaced ones, as pieces without gaps, a bounded number of samples at a time."""
        most = self.lines if most is None else min(most, self.lines)
        chosen = np.unique(np.linspace(0, self.lines - 1, most).astype(int))
        at_once = max(1, _BLOCK_SAMPLES // self.height.shape[1])
        blocks = (
            block for begin in range(0, chosen.size, at_once) for block in self._pieces(chosen[begin : begin + at_once])
        )
        first = next(blocks, None)
        if first is None:
            raise RaycastError(
                f"no line has {LEAST_POINTS} heights without a gap; "
                "measure a larger area, or one with fewer missing heights"
            )
        yield first
        yield from blocks

    def _heights(self, lines: NDArray[np.intp]) -> Array:
        """(n, columns) along the lines; NaN where a line is off the map."""
        rows, columns = self.height.shape
        if self.drift == 0:
            return self.height[lines].astype(float)
        position = (lines + self.first)[:, None] + self.drift * np.arange(columns)
        below = np.clip(np.floor(position).astype(np.intp), 0, max(rows - 2, 0))
        column = np.arange(columns)
        low = self.height[below, column].astype(float)
        high = self.height[np.minimum(below + 1, rows - 1), column]
        on_map = (position >= 0) & (position <= rows - 1)
        return np.where(on_map, low + (position - below) * (high - low), np.nan)

    def _pieces(self, lines: NDArray[np.intp]) -> Iterator[_Block]:
        height = self._heights(lines)
        columns = height.shape[1]
        present = np.zeros((lines.size, columns + 1), dtype=bool)
        present[:, :-1] = np.isfinite(height)
        edges = np.flatnonzero(np.diff(present.ravel(), prepend=False))
        row, column = np.divmod(edges[::2], columns + 1)
        length = edges[1::2] - edges[::2]
        # Pieces of similar length share a block, so that padding at most doubles it.
        octave = np.where(length >= LEAST_POINTS, np.frexp(length)[1], 0)
        for size in np.unique(octave[octave > 0]):
            chosen = octave == size
            count, start = length[chosen], column[chosen]
            along = np.minimum(np.arange(count.max()), count[:, None] - 1)
            z = height[row[chosen][:, None], start[:, None] + along]
            z -= z[:, :1]
            z -= z[:, -1:] * (along / (count[:, None] - 1))
            start = lines[row[chosen]] * columns + start
            yield _Block(z, count, self.step, start, self.lines * columns, self.lines < _GROUPS)

    def cells(self, theta: float) -> Array:
        """Visible fraction of every cell of the map; NaN where unknown."""
        rows, columns = self.height.shape
        fractions = np.full((self.lines, columns), np.nan)
        for block in self.blocks(None):
            where = (block.start[:, None] + np.arange(block.inside.shape[1]))[block.inside]
            fractions.ravel()[where] = block.fraction(theta)[0][block.inside]
        column = np.arange(columns - 1)
        line = np.arange(rows - 1)[:, None] + 0.5 - self.drift * (column + 0.5) - self.first
        below = np.clip(np.floor(line).astype(np.intp), 0, self.lines - 2)
        low, high = fractions[below, column], fractions[below + 1, column]
        return self.restore(low + (line - below) * (high - low))


@dataclass(frozen=True)
class _Block:
    """Levelled pieces of lines, padded to equal length with their last height, which is zero."""

    height: Array
    """(n, m) um; begins and ends with zero."""
    length: NDArray[np.intp]
    """(n,) heights of each piece."""
    step: float
    start: NDArray[np.intp]
    """(n,) sample of the line at which each piece begins."""
    samples: int
    """Samples of a line."""
    few_lines: bool
    """Whether there are too few lines to estimate their scatter."""

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """(n, m − 1) whether a segment belongs to the piece and is not padding."""
        return np.arange(self.height.shape[1] - 1) < (self.length - 1)[:, None]

    @cached_property
    def padded(self) -> bool:
        return bool((self.length < self.height.shape[1]).any())

    @cached_property
    def slope(self) -> Array:
        """(n, m − 1) towards the viewer."""
        return np.diff(self.height, axis=1) / self.step

    @property
    def segments(self) -> int:
        return int(np.sum(self.length - 1))

    @cached_property
    def group(self) -> NDArray[np.intp]:
        """Index of the independent group of every piece (n, 1) or, if there are few lines, of every segment (n, m − 1)."""
        at = self.start[:, None] + (np.arange(self.height.shape[1] - 1) if self.few_lines else 0)
        return np.minimum(at * _GROUPS // self.samples, _GROUPS - 1)

    def visible_and_facing(self, theta: float) -> tuple[Array, Array]:
        """(n, m − 1) visible projected area, and projected area that faces the viewer, per width [um]."""
        cos, sin = np.cos(np.radians(theta)), np.sin(np.radians(theta))
        # Unlike z − x cot θ, this form includes normal incidence.
        elevation = sin * self.height - (cos * self.step) * np.arange(self.height.shape[1])
        horizon = np.maximum.accumulate(elevation[:, :0:-1], axis=1)[:, ::-1]
        # Of all that follows the piece, its first repetition rises highest.
        repeated = elevation.max(axis=1) - cos * self.step * (self.length - 1)
        horizon = np.maximum(horizon, repeated[:, None])
        facing = np.maximum(elevation[:, :-1] - elevation[:, 1:], 0.0)
        if self.padded:
            facing *= self.inside
        return np.clip(elevation[:, :-1] - horizon, 0.0, facing), facing

    def fraction(self, theta: float) -> tuple[Array, NDArray[np.bool_]]:
        """(n, m − 1) visible fraction of every segment, 0 where it faces away; whether it faces the viewer."""
        visible_share, whole = self.visible_and_facing(theta)
        facing = whole > 0
        return visible_share / np.where(facing, whole, 1.0), facing

    def excess(self, theta: float) -> float:
        """Σ (p sin θ − cos θ)⁺ over the segments, without the step length."""
        # Padding has no slope and adds nothing.
        return float(np.maximum(self.slope * np.sin(np.radians(theta)) - np.cos(np.radians(theta)), 0.0).sum())

    def by_group(self, values: Array) -> Array:
        """(group,) sums of a value of every segment."""
        return _group_sums(self.group, values) if self.few_lines else _group_sums(self.group[:, 0], values.sum(axis=1))

    def reversed(self) -> _Block:
        """The same pieces, in reverse direction."""
        return replace(self, height=_reversed_rows(self.height, self.length))


def _group_sums(group: NDArray[np.intp], values: Array) -> Array:
    group = np.broadcast_to(group, values.shape)
    return np.bincount(group.ravel(), values.ravel(), minlength=_GROUPS).astype(float)


def _reversed_rows(values: NDArray[Any], count: NDArray[np.intp]) -> NDArray[Any]:
    """Each row's first ``count`` values from last to first, then its first value repeated."""
    if (count == values.shape[1]).all():
        return values[:, ::-1]
    index = np.maximum(count[:, None] - 1 - np.arange(values.shape[1]), 0)
    return np.take_along_axis(values, index, axis=1)


def _axis(name: str, angles: ArrayLike, low: float, high: float) -> Array:
    values = np.atleast_1d(check_angles(name, angles, low, high))
    if values.ndim > 1 or values.size == 0 or not (np.diff(values) > 0).all():
        raise VocabularyError(f"{name} must be a number or increasing numbers in one dimension")
    return values
